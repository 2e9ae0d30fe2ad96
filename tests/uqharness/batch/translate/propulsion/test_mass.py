"""Mass, place and inertia with fuel: the aircraft without it, and products of inertia, against
JSBSim and by hand.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few
from uqharness.batch.translate.tanks import DRY, Tank, dry_aircraft

SPIN = """<aerodynamics><axis name="ROLL"><function name="aero/r"><v>1</v></function></axis>
<axis name="PITCH"><function name="aero/q"><v>2</v></function></axis></aerodynamics>"""


def test_the_dry_aircraft_is_a_point_that_weighs_what_is_left() -> None:
    tank = Tank("propulsion/tank/", None, 100.0, 0.0)
    values = {
        "inertia/weight-lbs": 32.174049,
        "inertia/cg-x-in": 6.0,
        "inertia/cg-y-in": 0.0,
        "inertia/cg-z-in": 0.0,
        **dict.fromkeys(
            (f"inertia/{name}-slugs_ft2" for name in ("ixx", "ixy", "ixz", "iyz")), 0.0
        ),
        "inertia/iyy-slugs_ft2": 0.25,
        "inertia/izz-slugs_ft2": 0.25,
        "propulsion/tank/contents-lbs": 32.174049 / 2.0,
        "propulsion/tank/x-position": 12.0,
        "propulsion/tank/y-position": 0.0,
        "propulsion/tank/z-position": 0.0,
    }
    # Two half slugs a foot apart turn about their middle with 2 (1/2)(1/2)^2 slug ft2; one is fuel.
    dry = dry_aircraft([tank], [], values.__getitem__)
    assert dry[DRY[0]] == pytest.approx(32.174049 / 2.0)
    assert [dry[name] for name in DRY[1:]] == pytest.approx([0.0] * 9, abs=1e-12)


@pytest.mark.parametrize("name", few(["ixy", "ixz", "iyz"], 2))
@pytest.mark.parametrize("negated", few(["true", "false"], 1))
def test_products_of_inertia_turn_as_in_jsbsim(name: str, negated: str) -> None:
    tag = f'<{name} unit="SLUG*FT2">.3</{name}>'
    mass = flights.MASS.replace('<ixz unit="SLUG*FT2">.3</ixz>', tag)
    mass = mass.replace("<mass_balance", f'<mass_balance negated_crossproduct_inertia="{negated}"')
    text = flights.aircraft(SPIN, mass=mass)
    records = ["velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"]
    assert flights.worst(flights.compared(text, records, frames=60)) < 1e-11
    assert (
        flights.worst(
            flights.compared(text, records, frames=60, changed=text.replace(">.3<", ">-.3<"))
        )
        > 1e-4
    )


def test_mass_moves_with_the_fuel() -> None:
    contents = np.linspace(11.0, 0.5, 81)
    text = engines.aircraft(
        engines.mounted("motor", "fixed") + engines.tank(6.0) + engines.tank(2.0)
    )
    made = engines.Case(
        text,
        [*engines.MASS, *engines.MOTION],
        {"propulsion/tank/contents-lbs": contents},
        engines.FILES,
    )
    theirs = made.theirs()
    assert flights.worst(flights.apart(theirs, made.ours())) < 1e-11
    assert (
        flights.worst(
            flights.apart(
                theirs, made.ours(text.replace("<z>-6</z></drain", "<z>-6.001</z></drain"))
            )
        )
        > 1e-9
    )
