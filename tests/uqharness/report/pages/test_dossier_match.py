"""The proof of match on the page: which model is judged, and its figures."""

import numpy as np

from tests.helpers import report_folders as folders
from uqharness.dossier import read_evidence
from uqharness.replay.histories import write_pieces
from uqharness.report.pages.dossier import compare_with_log, match_section
from uqharness.report.parts import Page as WholePage
from uqharness.report.parts import Section, Table, render

T = np.arange(0.0, 6.0, 0.02)


def with_rudder(folder, gap_radps, suffixes=("_after",)):
    """Histories of a rudder doublet whose yaw rate differs by a constant."""
    rudder = 4.0 * ((T >= 1.0) & (T < 1.5)) - 4.0 * ((T >= 1.5) & (T < 2.0))
    steady = np.zeros(T.size)
    columns = {"rudder": [rudder], "elevator": [steady], "r_radps": [steady + gap_radps]} | {
        f"r_radps{s}": [steady] for s in suffixes
    }
    write_pieces(folder / "histories.parquet", [("b", "yaw <doublet>", T)], columns)
    return folder


def section_of(folder) -> Section:
    return match_section("Proof of match", compare_with_log(read_evidence(folder)))


def texts(section):
    return render(WholePage("t", "a", (), (section,)))


def test_the_refined_model_on_hold_out_flights_is_preferred(tmp_path):
    with_rudder(folders.identified(tmp_path / "fit"), 0.0, ("_model",))
    assert "no hold-out flight is here" in compare_with_log(read_evidence(tmp_path)).model
    with_rudder(folders.refined(tmp_path / "refined"), 0.0)
    source = compare_with_log(read_evidence(tmp_path))
    assert (source.step.kind, source.suffix) == ("refine", "_after")
    assert "hold-out" in source.model


def test_proof_of_match_passes_and_fails(tmp_path):
    valid = section_of(with_rudder(folders.refined(tmp_path / "good"), 0.01))
    invalid = section_of(with_rudder(folders.refined(tmp_path / "bad"), 0.05))
    for section, word in ((valid, "pass"), (invalid, "fail")):
        table = next(b for b in section.blocks if isinstance(b, Table))
        answers = {row[0].split()[0]: row[3].text for row in table.rows}
        assert answers["2.d.6"] == word
        assert answers["2.c.10"] == "not in the data"
    assert "yaw &lt;doublet&gt;" in texts(invalid)
