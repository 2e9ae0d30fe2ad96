"""Tables 3.1 and 3.2 with bounds from flights: the bounds, and the flights that are kept."""

from __future__ import annotations

import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS, case_tables, records, settings
from uqharness.campaign.spec import read_bounds
from uqharness.simulator.aircraft import PROJECT_ROOT

HOME = PROJECT_ROOT / "campaigns" / "excursions-from-flights"
MODELS = ("identified", "refined")


def test_refinement_leaves_narrower_bounds_of_what_it_named():
    """Cl_de, Cm_p2 and CX_q are in the refined model, and what they did is no longer in its
    bounds.
    """
    lasting = {}
    for model in MODELS:
        form = read_bounds(HOME / model / "model-form.json")
        lasting[model] = {name: c.parts.persistent for name, c in form.coefficients.items()}
    ratio = {
        name: lasting["refined"][name] / lasting["identified"][name] for name in lasting["refined"]
    }
    assert max(ratio[c] for c in ("CX", "Cl", "Cm")) < 0.5
    assert min(ratio[c] for c in ("CZ", "Cn")) > 0.8


@pytest.mark.parametrize("model", MODELS)
def test_the_flights_are_those_of_the_file_in_the_air_of_the_stand_ins(model):
    ours, theirs = (settings(folder / FLIGHTS) for folder in (HOME / model, EXCURSIONS))
    assert {**ours["aleatory"], "flights": 0} == {**theirs["aleatory"], "flights": 0}
    assert ours["campaign"]["seed"] == theirs["campaign"]["seed"]
    assert len(records(HOME / model / FLIGHTS)) == 24
    frame = next(case_tables(HOME / model / FLIGHTS, cell="severe-7"))
    assert frame.groupby("epistemic_id").size().tolist() == [50] * 64
    assert (frame["status"] == "ok").mean() > 0.9
