"""Mass properties from numbers: what JSBSim then computes, what stays, and the way back."""

from __future__ import annotations

import math

import pytest

from uqharness.errors import BadInputError
from uqharness.plugin.apply import MassProperties, instrument_aircraft, mass_insertions, undo
from uqharness.plugin.instrument import Bounds
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.xml import read_document

SLUG_FT2 = 1.3558179483314
WANTED = MassProperties(mass_kg=998.0, iyy_kgm2=1700.0, ixz_kgm2=25.0, cg_x_m=1.03)


def stands_at(aircraft, *names):
    fdm = open_aircraft(aircraft)
    engine.run_ic(fdm)
    return [float(fdm[f"inertia/{name}"]) for name in names]


def test_jsbsim_computes_what_was_asked_and_undo_gives_the_authors_bytes(tmp_path):
    stock = find_aircraft("c172x")
    done = instrument_aircraft(stock, Bounds(), tmp_path / "c172x", mass=WANTED)
    # Flown beside the stock aircraft with the same masses: the plugin itself changes nothing.
    assert done.verdict is not None
    assert done.verdict.status == "works"
    mine = find_aircraft(tmp_path / "c172x")
    names = ("mass-slugs", "iyy-slugs_ft2", "ixz-slugs_ft2", "cg-x-in")
    # Factors by hand: 14.5939 kg a slug, minus the product of inertia, 39.37 in a metre.
    wanted = [998.0 / 14.59390, 1700.0 / SLUG_FT2, -25.0 / SLUG_FT2, 1.03 / 0.0254]
    assert stands_at(mine, *names) == pytest.approx(wanted, rel=1e-6)
    assert stands_at(stock, *names)[0] != pytest.approx(998.0 / 14.59390, rel=0.01)
    undo(tmp_path / "c172x", tmp_path / "back")
    assert (tmp_path / "back" / "c172x.xml").read_bytes() == stock.xml.read_bytes()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass_kg": -1.0}, "mass_kg = -1: a positive number"),
        ({"cg_x_m": math.nan}, "cg_x_m = nan: a finite number"),
        ({"ixx_kgm2": 1.0, "iyy_kgm2": 1.0, "izz_kgm2": 3.0}, "no body has"),
    ],
)
def test_what_no_body_has_is_refused(given, message):
    aircraft = find_aircraft("c172x")
    with pytest.raises(BadInputError, match=message):
        mass_insertions(aircraft, read_document(aircraft.xml), MassProperties(**given))


def test_nothing_given_changes_nothing():
    aircraft = find_aircraft("c172x")
    assert mass_insertions(aircraft, read_document(aircraft.xml), MassProperties()) == ()
