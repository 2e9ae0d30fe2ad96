"""``<propulsion>`` as a whole: functions of engine files, what is refused, what a script leaves at
the start.
"""

from __future__ import annotations

import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights

FUNCTIONS = """<?xml version="1.0"?><electric_engine name="m"><power unit="WATTS">600</power>
<function name="propulsion/engine[#]/before"><product><v>3</v><p>propulsion/engine[#]/thrust-lbs</p></product></function>
<function name="propulsion/engine[#]/behind" type="post"><product><v>3</v>
<p>propulsion/engine[#]/thrust-lbs</p></product></function>
</electric_engine>"""


def test_functions_of_an_engine_bear_its_number() -> None:
    files = {**engines.FILES, "Engines/f.xml": FUNCTIONS}
    made = engines.Case(
        engines.aircraft(engines.mounted("f", "fixed", 0) + engines.mounted("f", "fixed", 1)),
        [*engines.of(0, ["before", "behind"]), *engines.of(1, ["before", "behind"])],
        engines.levers(60, 2),
        files,
    )
    theirs = made.theirs()
    assert flights.worst(flights.apart(theirs, made.ours())) < 1e-11
    changed = {**files, "Engines/f.xml": FUNCTIONS.replace(' type="post"', "")}
    assert flights.worst(flights.apart(theirs, made.ours(files=changed))) > 1e-6


@pytest.mark.parametrize(
    ("propulsion", "said"),
    [
        (
            "<function name='f'><v>1</v></function>",
            "point.xml:7: <function> of <propulsion> is not understood",
        ),
        (
            '<engine file="fixed"><thruster file="direct"/></engine>',
            "<propeller> is not understood by the batch engine; electric_engine",
        ),
        (
            '<engine file="brushless"><thruster file="direct"/></engine>',
            "a brushless motor turns a propeller",
        ),
        (
            '<engine file="nothing"><thruster file="direct"/></engine>',
            "file 'nothing.xml' was not found",
        ),
        ("<engine/>", "<engine> names a file or has one of electric_engine"),
    ],
)
def test_what_is_not_understood_is_refused(propulsion: str, said: str) -> None:
    assert said in engines.refusal(engines.aircraft(propulsion), engines.FILES)


@pytest.mark.parametrize(
    "name",
    ["propulsion/engine/set-running", "propulsion/fuel_freeze", "propulsion/engine/propeller-rpm"],
)
def test_what_acts_otherwise_than_as_a_value_is_not_set(name: str) -> None:
    systems = f"""<system name="s"><channel name="c"><fcs_function name="s/a"><function><v>1</v></function>
    <output>{name}</output></fcs_function></channel></system>"""
    said = flights.refused(
        engines.aircraft(engines.mounted("motor", "fixed"), systems=systems), files=engines.FILES
    )
    assert name in said
    assert "point.xml:" in said
