"""Propulsion against JSBSim: motors, rockets, thrusters; numbers and units of engine files."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.batch_flights import apart, worst
from tests.helpers.few import few
from uqharness.batch.translate.engine_files import UNITS

FUNCTIONS = """<?xml version="1.0"?><electric_engine name="m"><power unit="WATTS">600</power>
<function name="propulsion/engine[#]/before"><product><v>3</v><p>propulsion/engine[#]/thrust-lbs</p></product></function>
<function name="propulsion/engine[#]/behind" type="post"><product><v>3</v>
<p>propulsion/engine[#]/thrust-lbs</p></product></function>
</electric_engine>"""


def test_functions_of_an_engine_bear_its_number() -> None:
    files = {**engines.FILES, "Engines/f.xml": FUNCTIONS}
    result = engines.Case(
        engines.aircraft(engines.mounted("f", "fixed", 0) + engines.mounted("f", "fixed", 1)),
        [*engines.of(0, ["before", "behind"]), *engines.of(1, ["before", "behind"])],
        engines.levers(60, 2),
        files,
    )
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-11
    changed = {**files, "Engines/f.xml": FUNCTIONS.replace(' type="post"', "")}
    assert flights.worst(flights.apart(theirs, result.ours(files=changed))) > 1e-6


@pytest.mark.parametrize(
    ("propulsion", "output"),
    [
        (
            "<function name='f'><v>1</v></function>",
            "point.xml:7: <function> of <propulsion> is not supported",
        ),
        (
            '<engine file="fixed"><thruster file="direct"/></engine>',
            "<propeller> is not supported by the batch engine; electric_engine",
        ),
        (
            '<engine file="brushless"><thruster file="direct"/></engine>',
            "a brushless motor turns a propeller",
        ),
    ],
)
def test_propulsion_refusals(propulsion: str, output: str) -> None:
    assert output in engines.refusal(engines.aircraft(propulsion), engines.FILES)


@pytest.mark.parametrize(
    "name",
    ["propulsion/engine/set-running", "propulsion/fuel_freeze", "propulsion/engine/propeller-rpm"],
)
def test_what_acts_otherwise_than_as_a_value_is_not_set(name: str) -> None:
    systems = f"""<system name="s"><channel name="c"><fcs_function name="s/a"><function><v>1</v></function>
    <output>{name}</output></fcs_function></channel></system>"""
    output = flights.refused(
        engines.aircraft(engines.mounted("motor", "fixed"), systems=systems), files=engines.FILES
    )
    assert name in output
    assert "point.xml:" in output


@pytest.mark.parametrize("motor", few(["brushless", "motor"], 1))
@pytest.mark.parametrize("events", few(["", engines.RUNNING], 1))
def test_a_motor_starts_and_brakes(motor: str, events: str) -> None:
    throttle = np.concatenate(
        [np.full(21, 1e-5), np.full(40, -0.5), np.full(40, 2e-5), np.full(20, 0.0)]
    )
    result = engines.Case(
        engines.aircraft(engines.mounted(motor, "fixed", 0), engines.HEAVY),
        [*engines.of(0, engines.PROPELLER), *engines.TOTALS],
        {"fcs/throttle-cmd-norm": throttle},
        engines.FILES,
        events,
    )
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-10
    changed = {
        name: text.replace("<coilresistance>0.05", "<coilresistance>0.0501")
        for name, text in engines.FILES.items()
    }
    changed["Engines/motor.xml"] = engines.MOTOR.replace("600", "600.01")
    assert flights.worst(flights.apart(theirs, result.ours(files=changed))) > 1e-9


def test_a_number_that_lacks_is_refused() -> None:
    files = {
        **engines.FILES,
        "Engines/brushless.xml": engines.BRUSHLESS.replace("<maxvolts>12</maxvolts>", ""),
    }
    output = engines.refusal(engines.aircraft(engines.mounted("brushless", "fixed")), files)
    assert "brushless.xml:1: <brushless_dc_motor> has no <maxvolts>" in output


LIQUID = """<?xml version="1.0"?><rocket_engine name="l"><isp>230</isp>
<slfuelflowmax unit="KG/SEC">.6</slfuelflowmax><sloxiflowmax unit="LBS/SEC">1.9</sloxiflowmax>
<minthrottle>.25</minthrottle></rocket_engine>"""


SOLID = """<?xml version="1.0"?><rocket_engine name="s"><isp><function><sum><value>240</value>
<product><value>.001</value><property>aero/qbar-psf</property></product></sum></function></isp>
<builduptime>.4</builduptime><variation><thrust>.01</thrust><total_isp>-.02</total_isp></variation>
<thrust_table name="t" type="internal"><tableData>
 0  900
 3 1200
40  300</tableData></thrust_table></rocket_engine>"""


OXIDIZER = engines.tank(3.0, capacity=20.0).replace('type="FUEL"', 'type="OXIDIZER"')


GRAIN = engines.tank(30.0, capacity=40.0).replace(
    "<capacity",
    '<grain_config type="CYLINDRICAL"><length unit="FT">2</length>'
    '<bore_diameter unit="IN">3</bore_diameter></grain_config><capacity',
)


NAMES = ("thrust-lbs", "vacuum-thrust_lbs", "fuel-flow-rate-pps", "isp")


def case(motor: str, tanks: str, feeds: str, frames: int = 500) -> engines.Case:
    feed = "".join(f"<feed>{k}</feed>" for k in feeds)
    text = engines.aircraft(
        engines.mounted(motor, "nozzle", feed=feed, extra="") + tanks, engines.HEAVY
    )
    inputs = engines.levers(frames)
    if motor == "solid":
        inputs["fcs/throttle-cmd-norm"][40:60] = 1.0
    files: Mapping[str, str] = {
        **engines.FILES,
        "Engines/liquid.xml": LIQUID,
        "Engines/solid.xml": SOLID,
    }
    records = [*engines.of(0, NAMES), "propulsion/tank/contents-lbs", *engines.MASS]
    return engines.Case(text, [*records, *engines.TOTALS, *engines.MOTION], inputs, files, "")


@pytest.mark.parametrize(
    ("motor", "tanks", "feeds"),
    few(
        [
            ("liquid", OXIDIZER + engines.tank(6.0), "01"),
            ("solid", GRAIN, "0"),
            ("liquid", engines.tank(3.0), "0"),
            ("solid", GRAIN.replace("CYLINDRICAL", "ENDBURNING"), "0"),
        ],
        2,
    ),
)
def test_thrust_propellant_and_inertia_are_jsbsims(motor: str, tanks: str, feeds: str) -> None:
    result = case(motor, tanks, feeds)
    theirs = result.theirs()
    assert worst(apart(theirs, result.ours())) < 1e-9
    assert theirs["propulsion/engine/thrust-lbs"].max() > 100.0
    if feeds == "01":
        # The propellant is used up.
        assert theirs["propulsion/engine/thrust-lbs"][-1] == 0.0


@pytest.mark.parametrize(
    ("motor", "old", "new"),
    few(
        [
            ("liquid", "<isp>230", "<isp>230.1"),
            ("liquid", ">1.9<", ">1.901<"),
            ("liquid", "<minthrottle>.25", "<minthrottle>.6"),
            ("solid", "<builduptime>.4", "<builduptime>.41"),
            ("solid", "<total_isp>-.02", "<total_isp>-.021"),
            ("solid", " 3 1200", " 3 1201"),
        ],
        1,
    ),
)
def test_each_rocket_number_matters(motor: str, old: str, new: str) -> None:
    tanks, feeds = (GRAIN, "0") if motor == "solid" else (OXIDIZER + engines.tank(6.0), "01")
    result = case(motor, tanks, feeds, 200)
    name = f"Engines/{motor}.xml"
    assert old in result.files[name]
    files = {**result.files, name: result.files[name].replace(old, new)}
    assert worst(apart(result.theirs(), result.ours(files=files))) > 1e-8


@pytest.mark.parametrize(
    ("old", "new", "output"),
    [
        ("<isp>230</isp>", "", "<rocket_engine> has no <isp>"),
        ('type="OXIDIZER"', 'type="AIR"', "allowed are FUEL and OXIDIZER"),
        ('file="nozzle"', 'file="fixed"', "a rocket has a <nozzle> or <direct> thruster"),
    ],
)
def test_rocket_refusals(old: str, new: str, output: str) -> None:
    result = case("liquid", OXIDIZER + engines.tank(6.0), "01", 1)
    files = {name: text.replace(old, new) for name, text in result.files.items()}
    assert output in engines.refusal(result.text.replace(old, new), files)


POINTS = """<pointmass name="a"><weight unit="LBS">6</weight><location unit="M"><x>.2</x><y>.1</y>
<z>-.1</z></location></pointmass><pointmass name="b"><form shape="cylinder"><radius unit="FT">1.5
</radius><length unit="FT">3</length></form><weight unit="LBS">4</weight><location unit="IN"><x>9
</x><y>-3</y><z>2</z></location></pointmass></mass_balance>"""


LOADS = """<system name="loads"><property value="0">i/load</property><channel><pure_gain
 name="i/w"><input>i/load</input><gain>5</gain><output>inertia/pointmass-weight-lbs[1]</output>
</pure_gain><pure_gain name="i/x"><input>i/load</input><gain>SHIFT</gain>
<output>inertia/pointmass-location-X-inches[1]</output></pure_gain></channel></system>"""


@pytest.mark.parametrize("tank", few([engines.tank(6.0), ""], 1))
def test_point_masses_that_the_xml_moves_are_jsbsims(tank: str) -> None:
    mounted = engines.mounted("motor", "fixed", feed="<feed>0</feed>" if tank else "")
    text = engines.aircraft(
        mounted + tank,
        engines.HEAVY.replace("</mass_balance>", POINTS),
        LOADS.replace("SHIFT", "7"),
    )
    inputs = {**engines.levers(200), "i/load": np.repeat([0.0, 1.0, 2.5, 0.5, 0.0], 50)[:201]}
    result = engines.Case(text, [*engines.MASS, *engines.MOTION], inputs, engines.FILES, "")
    theirs = result.theirs()
    assert worst(apart(theirs, result.ours())) < 1e-9
    assert np.ptp(theirs["inertia/weight-lbs"]) > 5.0
    assert worst(apart(theirs, result.ours(text.replace(">7<", ">7.01<")))) > 1e-8


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


def case_thruster(propulsion: str, systems: str = "", count: int = 1) -> engines.Case:
    names = [name for k in range(count) for name in engines.of(k, ["thrust-lbs", "power-hp"])]
    return engines.Case(
        engines.aircraft(propulsion, systems=systems),
        [*names, *engines.TOTALS, *engines.MOTION],
        engines.levers(120, count),
        {**engines.FILES, "Engines/motor.xml": engines.MOTOR.replace("600", "30")},
        events="",
    )


@pytest.mark.parametrize(
    ("result", "before", "after"),
    few(
        [
            (
                case_thruster(engines.mounted("motor", "direct", extra="")),
                "<pitch>3",
                "<pitch>3.00001",
            ),
            (
                case_thruster(engines.mounted("motor", "nozzle", extra="") + POINTED, count=2),
                "<y>.1</y>",
                "<y>.10001</y>",
            ),
            (
                case_thruster(engines.mounted("motor", "nozzle", extra="") + POINTED, count=2),
                "<y>.2</y>",
                "<y>.20001</y>",
            ),
            (
                case_thruster(engines.mounted("motor", "direct", extra=""), VECTOR),
                "<v>.2</v>",
                "<v>.20001</v>",
            ),
        ],
        2,
    ),
)
def test_thrust_acts_as_in_jsbsim(result: engines.Case, before: str, after: str) -> None:
    theirs = result.theirs()
    assert flights.worst(flights.apart(theirs, result.ours())) < 1e-11
    assert before in result.text
    assert (
        flights.worst(flights.apart(theirs, result.ours(result.text.replace(before, after)))) > 1e-9
    )


@pytest.mark.parametrize(
    ("thruster", "output"),
    [
        (
            '<thruster file="motor"/>',
            (
                "<electric_engine> is not supported by the batch engine; propeller, direct,"
                " nozzle are"
            ),
        ),
        ("", "an engine has a <thruster>"),
    ],
)
def test_thruster_refusals(thruster: str, output: str) -> None:
    message = engines.refusal(
        engines.aircraft(f'<engine file="motor">{thruster}</engine>'), engines.FILES
    )
    assert output in message
    assert ".xml:" in message


SHOWN = {
    "IN": (
        "propulsion/engine/x-reference-position",
        '<thruster><location unit="{unit}"><x>1</x></location><direct/></thruster>',
    ),
    "RAD": (
        "propulsion/engine/pitch-angle-rad",
        '<thruster><orient unit="{unit}"><pitch>1</pitch></orient><direct/></thruster>',
    ),
    "LBS": (
        "propulsion/tank/contents-lbs",
        '<capacity>99</capacity><contents unit="{unit}">1</contents>',
    ),
}


@pytest.mark.parametrize(
    ("expected", "unit"), [(expected, unit) for expected in SHOWN for unit in UNITS[expected]]
)
def test_units_are_converted_as_by_jsbsim(expected: str, unit: str) -> None:
    name, text = SHOWN[expected]
    inside = text.format(unit=unit)
    if "thruster" in inside:
        propulsion = f"<engine><electric_engine/>{inside}</engine>"
    else:
        propulsion = (
            "<tank"
            f' type="FUEL"><location/>{inside}</tank><engine><electric_engine/><thruster><direct/></thruster></engine>'
        )
    with flights.craft(engines.aircraft(propulsion)) as result:
        assert result.open()[name] == pytest.approx(UNITS[expected][unit], rel=1e-15)
