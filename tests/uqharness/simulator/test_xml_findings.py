"""Errors of the author's XML: named with file, line and mend, all at once, and only if refused."""

from __future__ import annotations

import re

import pytest

from tests.helpers import foreign_aircraft
from uqharness.errors import BadInputError
from uqharness.simulator import engine, find_aircraft, open_aircraft
from uqharness.simulator.aircraft import _findings

TABLE = (
    '<function name="aero/extra"><table>\n<independentVar lookup="row">aero/alpha-rad'
    "</independentVar>{}<tableData>\n{}\n</tableData></table></function>"
)
COLUMN = '<independentVar lookup="column">aero/beta-rad</independentVar>'
THIRD = '<independentVar lookup="table">velocities/mach</independentVar>'


def table(axes, data):
    return "<aerodynamics>", "<aerodynamics>" + TABLE.format(axes, data)


CASES = {
    "number": (("<x>45</x>", "<x>-32.5.0</x>"), r"single\.xml:\d+: <x> is '-32\.5\.0', no number"),
    "comma": (("<max>0.35</max>", "<max>0,35</max>"), r"'0,35', no number; .* such as 0\.35"),
    "value": (("<value>4.8</value>", "<value>4.8.1</value>"), r"<value> is '4\.8\.1'"),
    "axes": (table(COLUMN, "0 1\n0.1 2\n0.2 3"), r'remove the axis with lookup="column"'),
    "third axis": (table(COLUMN + THIRD, "0 1\n0.1 2 3\n0.2 4 5"), "no breakPoint"),
    "row": (table("", "0 1\n0.1 2 7\n0.2 3"), r"has 3 numbers; 2 are needed"),
    "order": (table("", "0 1\n0.3 2\n0.2 3"), r"the row of 0\.2 follows that of 0\.3"),
    "entry": (table("", "0 1\n0.3 2.0.1"), r"'2\.0\.1' in <tableData> is no number"),
    "double": (
        (
            "<aerodynamics>",
            "<aerodynamics>" + '<function name="a/b"><value>1</value></function>\n' * 2,
        ),
        r'<function name="a/b"> is there already \(line \d+\)',
    ),
    "system": (('file="switchboard"', 'file="swichboard"'), r"no such file; put swichboard\.xml"),
    "engine": (('file="flat_four"', 'file="flat_for"'), r"did you mean flat_four\?"),
    "unit": (('unit="FT2"', 'unit="FT^2"'), r'unit="FT\^2">: no unit of JSBSim; did you mean FT2'),
}


def broken(tmp_path, *changes):
    folder = foreign_aircraft.write("single", tmp_path)
    xml = folder / "single.xml"
    text = xml.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    xml.write_text(text)
    return find_aircraft(folder)


@pytest.mark.parametrize("case", CASES)
def test_an_error_is_named_with_its_place_and_its_mend(tmp_path, case):
    change, message = CASES[case]
    texts = _findings(broken(tmp_path, change), refused=True)
    assert any(re.search(message, text) for text in texts), texts
    assert all(re.match(r"/.*\.xml:\d+: ", text) for text in texts)


def test_all_errors_are_named_at_once(tmp_path):
    changes = [CASES[case][0] for case in ("number", "value", "order", "engine")]
    with pytest.raises(BadInputError) as raised:
        open_aircraft(broken(tmp_path, *changes))
    message = str(raised.value)
    assert message.startswith("4 errors in the XML: (1) ")
    for case in ("number", "value", "order", "engine"):
        assert re.search(CASES[case][1], message)


def test_operations_that_jsbsim_would_ignore_are_refused_together(tmp_path):
    name = '<aerodynamics><function name="a/b"><plus><value>1</value></plus></function>'
    more = '<function name="a/c"><times><value>1</value></times></function>'
    with pytest.raises(BadInputError, match=r"^2 errors .*<plus> is no op.*<times> is no op"):
        open_aircraft(broken(tmp_path, ("<aerodynamics>", name + more)))


def test_stock_aircraft_that_jsbsim_loads_have_no_findings():
    # Negative control: the rules do not call ordinary files wrong.
    folder = engine.default_root() / "aircraft"
    judged = {
        path.name: _findings(find_aircraft(path), refused=True)
        for path in sorted(folder.iterdir())
        if path.is_dir() and path.name != "blank"
    }
    assert len(judged) > 50
    assert {name: texts for name, texts in judged.items() if texts} == {}
