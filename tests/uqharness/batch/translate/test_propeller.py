"""Propellers turned by electric motors, against JSBSim: levers and wind at random, from the first
initialising frame on.
"""

from __future__ import annotations

import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few

FRAMES = 400


NAMES = [*engines.of(0, engines.PROPELLER), *engines.of(1, [*engines.PROPELLER, "current-amperes"])]


CASE = engines.Case(
    engines.aircraft(
        engines.mounted("motor", "fixed", 0) + engines.mounted("brushless", "variable", 1)
    ),
    [*NAMES, *engines.TOTALS, *engines.MOTION],
    engines.levers(FRAMES, 2),
    engines.FILES,
)


@pytest.fixture(scope="module")
def theirs() -> dict:
    return CASE.theirs()


def test_two_propellers_fly_as_in_jsbsim(theirs: dict) -> None:
    assert flights.worst(flights.apart(theirs, CASE.ours())) < 1e-11


@pytest.mark.parametrize(
    ("file", "before", "after"),
    few(
        [
            ("fixed", "0.5 0.066", "0.5 0.0660001"),
            ("variable", "<maxpitch>30", "<maxpitch>29.99"),
            ("variable", "0.3 1.2", "0.3 1.20001"),
            ("brushless", "<noloadcurrent>1<", "<noloadcurrent>1.00001<"),
            *(
                pytest.param(*case, marks=pytest.mark.slow)
                for case in (
                    ("fixed", "0.5 0.053", "0.5 0.0530001"),
                    ("variable", "<gearratio>1.5", "<gearratio>1.50001"),
                    ("variable", "<maxrpm>2400", "<maxrpm>2400.01"),
                    ("variable", 'version="1.1"', 'version="1.0"'),
                    ("variable", "3000 0.8", "3000 0.80001"),
                    ("motor", "600", "600.001"),
                )
            ),
        ],
        2,
    ),
)
def test_each_propeller_number_matters(theirs: dict, file: str, before: str, after: str) -> None:
    name = f"Engines/{file}.xml"
    assert before in engines.FILES[name]
    changed = {**engines.FILES, name: engines.FILES[name].replace(before, after)}
    assert flights.worst(flights.apart(theirs, CASE.ours(files=changed))) > 1e-9


@pytest.mark.parametrize(
    ("before", "after", "output"),
    [
        ('name="C_POWER"', 'name="C_TORQUE"', "a propeller has a table C_POWER"),
        ('<ixx unit="SLUG*FT2">0.4</ixx>', "", "<propeller> has no <ixx>"),
    ],
)
def test_propeller_refusals(before: str, after: str, output: str) -> None:
    assert before in engines.FIXED_PITCH
    files = {**engines.FILES, "Engines/fixed.xml": engines.FIXED_PITCH.replace(before, after)}
    assert output in engines.refusal(engines.aircraft(engines.mounted("motor", "fixed")), files)


def test_a_propeller_at_rest_that_is_not_set_running() -> None:
    inputs = {
        name: values * 1e-4 if "throttle" in name else values
        for name, values in engines.levers(50, 2).items()
    }
    case = engines.Case(CASE.text, CASE.records, inputs, engines.FILES, events="")
    assert flights.worst(flights.apart(case.theirs(), case.ours())) < 1e-9
