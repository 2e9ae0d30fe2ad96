"""What JSBSim ignores, the translation ignores as well: elements and attributes that JSBSim does not
look up, repeated elements, operations that it does not know.
"""

from __future__ import annotations

import pytest

from tests.helpers import batch_engines as engines
from tests.helpers.batch_flights import apart, worst
from tests.helpers.batch_systems import judged, random_inputs

A = "<input>i/a</input>"
SYSTEMS = {
    "elements of a component": f"""<pure_gain name="g" colour="red">{A}<gain>@2</gain><gain>3</gain>
<bias>4</bias><wheels/></pure_gain><actuator name="a">{A}<lag>@3</lag><lag>9</lag><gain>7</gain>
</actuator><sensor name="s">{A}<gain>@1.5</gain><axis>Z</axis></sensor>""",
    "a property and an unknown component in a channel": f"""<property value="5">i/unread</property>
<wobbler name="w">{A}</wobbler><summer name="g">{A}<bias>@2</bias></summer>""",
    "a second default and a misspelt attribute": """<switch name="s"><default value="@2"/>
<default value="3"/><test value="4" login="OR">i/a gt 1</test></switch>""",
    "operations": f"""<fcs_function name="f">{A}<function name="f/x"><sum>text<v>@1.5</v>
<wobble><v>3</v></wobble><function><v>7</v></function><p>i/b</p></sum></function></fcs_function>""",
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_systems_have_jsbsims_bits(name: str) -> None:
    body = f"<thing/><channel>{SYSTEMS[name]}</channel>"
    differences, control = judged(body, random_inputs(300))
    assert differences == {}
    assert control != {}


def test_named_tables_and_operations_are_properties() -> None:
    body = """<function name="o/f"><sum><product name="o/p"><v>@2.5</v><p>i/a</p></product>
<table name="o/t"><independentVar>i/b</independentVar><tableData>
-1 0
 2 @3</tableData></table></sum></function>
<channel><summer name="o/s"><input>o/p</input><input>o/t</input></summer></channel>"""
    differences, control = judged(body, random_inputs(300))
    assert differences == {}
    assert control != {}


def test_elements_of_engines_aerodynamics_and_the_aircraft_are_ignored() -> None:
    """JSBSim takes the first of two <aerodynamics>."""
    mounted = engines.mounted("motor", "fixed").replace(
        "</engine>", "<colour>1</colour></engine><wings/>"
    )
    fixed = engines.FIXED_PITCH.replace(
        "<numblades>2</numblades>",
        "<numblades>2</numblades><blades>7</blades><table name='C_NOISE' type='internal'>"
        "<tableData>0 1</tableData></table>",
    )
    text = (
        engines.aircraft(mounted)
        .replace('<axis name="DRAG">', "<gradient/><axis name=\"DRAG\" colour='red'><note/>")
        .replace("</fdm_config>", "<wings/><aerodynamics/></fdm_config>")
    )
    case = engines.Case(
        text,
        [*engines.TOTALS, *engines.MOTION],
        engines.levers(30),
        {**engines.FILES, "Engines/fixed.xml": fixed},
        "",
    )
    theirs = case.theirs()
    assert worst(apart(theirs, case.ours())) < 1e-9
    other = case.ours(text.replace("<v>.3</v>", "<v>.30001</v>"))
    assert worst(apart(theirs, other)) > 1e-7
