"""Tanks against JSBSim, and the mass, place and inertia that follow."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few

FEEDS = "<feed>0</feed><feed>1</feed><feed>2</feed>"


TANKS = (
    engines.tank(0.06, "<priority>2</priority>")
    + engines.tank(
        0.05,
        '<unusable-volume unit="GAL">0.004</unusable-volume><density unit="LBS/GAL">6.1</density>',
    )
    + engines.tank(0.03)
)


OF_TANKS = [
    f"propulsion/tank{index}/{name}"
    for index in ("", "[1]", "[2]")
    for name in ("contents-lbs", "pct-full", "priority")
]


POINTMASS = (
    "</mass_balance>",
    """<pointmass name="p"><weight unit="LBS">90</weight><location unit="IN"><x>-30</x><y>9</y><z>4</z></location></pointmass>
</mass_balance>""",
)


def case(systems: str = "", inputs: dict | None = None, frames: int = 900) -> engines.Case:
    moved = engines.levers(frames)
    return engines.Case(
        engines.aircraft(
            engines.mounted("eng_io320", "prop_75in2f", feed=FEEDS) + TANKS,
            engines.HEAVY.replace(*POINTMASS),
            systems,
        ),
        [
            *OF_TANKS,
            *engines.of(
                0,
                [
                    "fuel-used-lbs",
                    "fuel-flow-rate-pps",
                    "fuel-flow-rate-gph",
                    "set-running",
                    "thrust-lbs",
                ],
            ),
            "propulsion/total-fuel-lbs",
            *engines.MASS,
            *engines.TOTALS,
            *engines.MOTION,
        ],
        {**moved, **(inputs or {}), "fcs/throttle-cmd-norm": np.ones(frames + 1)},
        engines.stock("eng_io320", "prop_75in2f"),
        start={"ic/u-fps": 150.0},
    )


def test_tanks_empty_in_their_order_and_the_engine_stops() -> None:
    result = case()
    theirs = result.theirs()
    ours = result.ours()
    assert flights.worst(flights.apart(theirs, ours)) < 1e-11
    # All of it has happened: the first two tanks gave until nothing was left, then the one of
    # second priority, then none.
    assert theirs["propulsion/tank[1]/contents-lbs"][-1] == pytest.approx(0.0244)
    assert theirs["propulsion/tank[2]/contents-lbs"][-1] == 0.0
    assert theirs["propulsion/tank/contents-lbs"][-1] == 0.0
    assert theirs["propulsion/engine/set-running"][0] == 1.0
    assert theirs["propulsion/engine/set-running"][-1] == 0.0
    assert ours["inertia/weight-lbs"][0] > ours["inertia/weight-lbs"][-1]


@pytest.mark.parametrize(
    ("before", "after"),
    few(
        [
            ("<priority>2", "<priority>1"),
            ('unit="GAL">0.004', 'unit="GAL">0.00401'),
            ("<feed>2</feed>", ""),
            ('<radius unit="IN">6', '<radius unit="IN">6.1'),
            ("<z>-6</z></drain", "<z>-6.01</z></drain"),
            ('LBS/GAL">6.1', 'LBS/GAL">6.11'),
        ],
        2,
    ),
)
def test_each_tank_number_matters(before: str, after: str) -> None:
    result = case()
    theirs = result.theirs()
    assert before in result.text
    assert (
        flights.worst(flights.apart(theirs, result.ours(result.text.replace(before, after)))) > 1e-9
    )


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ('<tank type="BATTERY"/>', "a tank of type 'BATTERY': allowed are FUEL and OXIDIZER"),
        (
            engines.tank(5.0)
            + '<engine file="motor"><feed>1</feed><thruster file="direct"/></engine>',
            "an engine feeds from tanks 0 to 0; received 1",
        ),
    ],
)
def test_tank_refusals(text: str, output: str) -> None:
    message = engines.refusal(engines.aircraft(text), engines.FILES)
    assert output in message
    assert "point.xml:" in message


@pytest.mark.parametrize("tank", few([engines.tank(6.0), ""], 1))
def test_an_electric_engine_takes_nothing_from_its_tank(tank: str) -> None:
    """With a tank, and with the number of one that is not there, as converted models have it."""
    text = engines.aircraft(engines.mounted("motor", "fixed", feed="<feed>0</feed>") + tank)
    records = [*engines.TOTALS, *engines.MOTION, "inertia/weight-lbs"]
    result = engines.Case(text, records, engines.levers(40), engines.FILES, "")
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-9
    assert np.ptp(theirs["inertia/weight-lbs"]) == 0.0
    changed = result.ours(text.replace("<y>-3</y>", "<y>-3.01</y>"))
    assert flights.worst(flights.apart(theirs, changed)) > 1e-8


SPIN = """<aerodynamics><axis name="ROLL"><function name="aero/r"><v>1</v></function></axis>
<axis name="PITCH"><function name="aero/q"><v>2</v></function></axis></aerodynamics>"""


@pytest.mark.parametrize("name", few(["ixy", "ixz", "iyz"], 1))
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
    result = engines.Case(
        text,
        [*engines.MASS, *engines.MOTION],
        {"propulsion/tank/contents-lbs": contents},
        engines.FILES,
    )
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-11
    assert (
        flights.worst(
            flights.apart(
                theirs, result.ours(text.replace("<z>-6</z></drain", "<z>-6.001</z></drain"))
            )
        )
        > 1e-9
    )
