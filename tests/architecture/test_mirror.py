"""Every module has its tests in the mirrored folder, in a file of its name or one that imports it. The exceptions may only become
fewer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tests.architecture.rooms import imported_by, modules
from tests.helpers.places import ROOT, TESTS

# Modules without, and the file that tests them through what uses them.
ELSEWHERE: Mapping[str, str] = {
    "sysid.estimation.filter_report": "sysid/estimation/test_filter_error.py",
    "uqharness.batch.translate.frame": "uqharness/batch/translate/test_channels.py",
    "uqharness.batch.translate.rotations": "uqharness/batch/translate/test_functions.py",
    "uqharness.campaign.convergence": "uqharness/campaign/test_area.py",
    "uqharness.campaign.folder.journal_recovery": "stories/test_fuzz_findings.py",
    "uqharness.campaign.folder.salvage": "stories/test_damaged_campaigns.py",
    "uqharness.campaign.folder.tables": "uqharness/campaign/test_run.py",
    "uqharness.campaign.folder.verify": "stories/test_damaged_campaigns.py",
    "uqharness.cli.bounds": "uqharness/identification/test_model_form.py",
    "uqharness.cli.campaign.studies": "uqharness/campaign/test_area.py",
    "uqharness.cli.compare": "uqharness/identification/test_compare.py",
    "uqharness.cli.identify": "uqharness/identification/test_identify.py",
    "uqharness.cli.refine": "uqharness/refinement/test_refine.py",
    "uqharness.cli.report": "uqharness/report/pages/test_index.py",
    "uqharness.cli.sensitivity": "uqharness/campaign/test_sensitivity.py",
    "uqharness.cli.study": "uqharness/study/test_run.py",
    "uqharness.cli.validate_bounds": "uqharness/identification/test_model_form.py",
    "uqharness.flight.stepping": "uqharness/flight/test_fly.py",
    "uqharness.identification.start": "uqharness/identification/test_identify.py",
    "uqharness.refinement.timing": "uqharness/refinement/test_refine.py",
    "uqharness.refinement.writing.numbers": "uqharness/refinement/writing/test_effects.py",
    "uqharness.refinement.writing.terms": "uqharness/refinement/writing/test_effects.py",
    "uqharness.report.compare": "uqharness/report/pages/test_compare.py",
    "uqharness.report.identify": "uqharness/report/pages/test_identify.py",
    "uqharness.report.model_form": "uqharness/report/pages/test_model_form.py",
    "uqharness.report.next_flight": "uqharness/report/pages/test_next_flight.py",
    "uqharness.report.next_flight_words": "uqharness/report/pages/test_next_flight.py",
    "uqharness.report.pages.campaign": "uqharness/report/test_campaign.py",
    "uqharness.report.refinement": "uqharness/refinement/showing/test_show.py",
    "uqharness.report.statements": "uqharness/report/test_campaign.py",
    "uqharness.simulator.mid_envelope": "uqharness/plugin/test_instrument.py",
}


def own_tests(name: str, path: Path) -> list[Path]:
    """Test files of a module in its mirrored folder."""
    folder = TESTS / path.relative_to(ROOT).parent
    found = [folder / f"test_{path.stem}.py"] if (folder / f"test_{path.stem}.py").is_file() else []
    for test in folder.rglob("test_*.py"):
        if any(name in names for names in imported_by(test.read_text(encoding="utf-8"))):
            found.append(test)
    return found


def untested() -> set[str]:
    """Modules without a test file of their own."""
    return {name for name, path in modules().items() if path.stem not in ("__init__", "__main__") and not own_tests(name, path)}


def test_every_module_has_its_tests():
    assert untested() == set(ELSEWHERE)


def test_exceptions_lead_somewhere():
    known = modules()
    for name, place in ELSEWHERE.items():
        assert name in known
        assert (TESTS / place).is_file(), place


def test_a_module_without_tests_is_seen():
    assert own_tests("uqharness.flight.nothing", ROOT / "uqharness" / "flight" / "nothing.py") == []
    assert own_tests("uqharness.flight.seeds", ROOT / "uqharness" / "flight" / "seeds.py") != []
