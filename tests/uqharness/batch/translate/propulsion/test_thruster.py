"""Where thrusters stand and point: ``<direct>``, ``<nozzle>``, ``<pointing>``, vectored thrust,
against JSBSim.
"""

from __future__ import annotations

import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few

VECTOR = """<system name="v"><channel name="v">
<fcs_function name="v/pitch"><function><product><v>.2</v><p>fcs/throttle-cmd-norm</p></product></function>
<output>propulsion/engine/pitch-angle-rad</output></fcs_function>
<fcs_function name="v/reverse"><function><p>fcs/throttle-cmd-norm</p></function>
<output>propulsion/engine/reverser-angle-rad</output></fcs_function></channel></system>"""
POINTED = (
    '<engine file="motor"><thruster file="direct"><location'
    ' unit="M"><x>1</x><y>.2</y><z>.1</z></location>'
    "<pointing><x>.8</x><y>.1</y><z>-.6</z></pointing></thruster></engine>"
)


def case(propulsion: str, systems: str = "", count: int = 1) -> engines.Case:
    names = [name for k in range(count) for name in engines.of(k, ["thrust-lbs", "power-hp"])]
    return engines.Case(
        engines.aircraft(propulsion, systems=systems),
        [*names, *engines.TOTALS, *engines.MOTION],
        engines.levers(120, count),
        {**engines.FILES, "Engines/motor.xml": engines.MOTOR.replace("600", "30")},
        events="",
    )


@pytest.mark.parametrize(
    ("made", "before", "after"),
    few(
        [
            (case(engines.mounted("motor", "direct", extra="")), "<pitch>3", "<pitch>3.00001"),
            (
                case(engines.mounted("motor", "nozzle", extra="") + POINTED, count=2),
                "<y>.1</y>",
                "<y>.10001</y>",
            ),
            (
                case(engines.mounted("motor", "nozzle", extra="") + POINTED, count=2),
                "<y>.2</y>",
                "<y>.20001</y>",
            ),
            (
                case(engines.mounted("motor", "direct", extra=""), VECTOR),
                "<v>.2</v>",
                "<v>.20001</v>",
            ),
        ],
        2,
    ),
)
def test_thrust_acts_as_in_jsbsim(made: engines.Case, before: str, after: str) -> None:
    theirs = made.theirs()
    assert flights.worst(flights.apart(theirs, made.ours())) < 1e-11
    assert before in made.text
    assert flights.worst(flights.apart(theirs, made.ours(made.text.replace(before, after)))) > 1e-9


@pytest.mark.parametrize(
    ("thruster", "said"),
    [
        (
            '<thruster file="motor"/>',
            (
                "<electric_engine> is not understood by the batch engine; propeller, direct,"
                " nozzle are"
            ),
        ),
        ("", "an engine has a <thruster>"),
        ("<thruster/>", "<thruster> names a file or has one of propeller, direct, nozzle"),
    ],
)
def test_what_is_not_understood_is_refused(thruster: str, said: str) -> None:
    message = engines.refusal(
        engines.aircraft(f'<engine file="motor">{thruster}</engine>'), engines.FILES
    )
    assert said in message
    assert ".xml:" in message
