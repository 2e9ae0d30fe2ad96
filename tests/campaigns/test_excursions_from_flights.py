"""Tables 3.1 and 3.2 with bounds from flights: which aircraft flies, within whose bounds, beside
which campaign.
"""

from __future__ import annotations

import importlib
import shutil

import pytest

from campaigns.excursions.full_size import plan as stand_ins
from campaigns.library.plan import COPY, Plan
from campaigns.library.store import cell_table, records
from uqharness.campaign import read_bounds
from uqharness.campaign.engines import bounds_notes, named_aircraft
from uqharness.simulator import content_hash, find_aircraft

full_size = importlib.import_module("campaigns.excursions-from-flights.full_size")


@pytest.mark.parametrize("model", sorted(full_size.MODELS))
def test_a_model_flies_within_the_bounds_of_its_own_flights_in_the_air_of_the_stand_ins(model):
    plan, other = full_size.plan(model), stand_ins()
    assert bounds_notes(plan.spec) == []
    assert (len(plan.conditions), len(plan.epistemic_ids), plan.spec.aleatory.flights) == (
        24,
        64,
        50,
    )
    flown = find_aircraft(plan.mission.aircraft)
    assert (
        content_hash(flown) == plan.mission.aircraft_hash != content_hash(named_aircraft(plan.spec))
    )
    ours, theirs = (next(iter(p.only(["severe-3"]))) for p in (plan, other))
    for mine, stand_in in zip(plan.cases(ours)[::400], other.cases(theirs)[::400], strict=True):
        assert (mine.flight.seed_turbulence, mine.flight.seed_noise) == (
            stand_in.flight.seed_turbulence,
            stand_in.flight.seed_noise,
        )
        assert mine.flight.aircraft == plan.mission.aircraft


def test_refinement_leaves_narrower_bounds_of_what_it_named():
    """Cl_de, Cm_p2 and CX_q are in the refined model, and what they did is no longer in its
    bounds.
    """
    lasting = {}
    for model in full_size.MODELS:
        form = read_bounds(full_size.HOME / model / "model-form.json")
        lasting[model] = {name: c.parts.persistent for name, c in form.coefficients.items()}
    ratio = {
        name: lasting["refined"][name] / lasting["identified"][name] for name in lasting["refined"]
    }
    assert max(ratio[c] for c in ("CX", "Cl", "Cm")) < 0.5
    assert min(ratio[c] for c in ("CZ", "Cn")) > 0.8


def test_a_copy_that_is_missing_is_made_again(tmp_path):
    for name in ("aircraft", "model-form.json", "campaign.toml"):
        source = full_size.HOME / "refined" / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    text = (tmp_path / "campaign.toml").read_text().replace("../../../scripts/loiter.xml", "loiter")
    (tmp_path / "campaign.toml").write_text(text)
    first = Plan.read(tmp_path / "campaign.toml", 25)
    shutil.rmtree(tmp_path / COPY)
    again = Plan.read(tmp_path / "campaign.toml", 25)
    assert first.mission == again.mission
    assert content_hash(find_aircraft(again.mission.aircraft)) == again.mission.aircraft_hash


@pytest.mark.parametrize("model", sorted(full_size.MODELS))
def test_shards_are_of_these_files_and_whole(model):
    plan, shards = full_size.plan(model), full_size.HOME / model / "shards"
    for condition in plan.conditions[:: len(plan.conditions) // 3]:
        if records(shards, condition):
            frame, used = cell_table(plan, shards, condition)
            assert len(frame) == 1600 * len(used)
            assert (frame["status"] == "ok").mean() > 0.9


@pytest.mark.parametrize("words", [[], ["other", "status"]])
def test_another_model_is_refused(words, capsys):
    assert full_size.run(words) == 2
    assert "there are identified, refined" in capsys.readouterr().err
