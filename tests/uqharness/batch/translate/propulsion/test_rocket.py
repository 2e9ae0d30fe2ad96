"""Liquid and solid rockets against JSBSim, with their propellant and its inertia."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers.batch_flights import apart, worst
from tests.helpers.few import few

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
    made = case(motor, tanks, feeds)
    theirs = made.theirs()
    assert worst(apart(theirs, made.ours())) < 1e-9
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
def test_each_number_matters(motor: str, old: str, new: str) -> None:
    tanks, feeds = (GRAIN, "0") if motor == "solid" else (OXIDIZER + engines.tank(6.0), "01")
    made = case(motor, tanks, feeds, 200)
    name = f"Engines/{motor}.xml"
    assert old in made.files[name]
    files = {**made.files, name: made.files[name].replace(old, new)}
    assert worst(apart(made.theirs(), made.ours(files=files))) > 1e-8


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<isp>230</isp>", "", "<rocket_engine> has no <isp>"),
        ('type="OXIDIZER"', 'type="AIR"', "allowed are FUEL and OXIDIZER"),
        ('file="nozzle"', 'file="fixed"', "a rocket has a <nozzle> or <direct> thruster"),
    ],
)
def test_what_is_not_understood_is_refused(old: str, new: str, said: str) -> None:
    made = case("liquid", OXIDIZER + engines.tank(6.0), "01", 1)
    files = {name: text.replace(old, new) for name, text in made.files.items()}
    assert said in engines.refusal(made.text.replace(old, new), files)


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
    made = engines.Case(text, [*engines.MASS, *engines.MOTION], inputs, engines.FILES, "")
    theirs = made.theirs()
    assert worst(apart(theirs, made.ours())) < 1e-9
    assert np.ptp(theirs["inertia/weight-lbs"]) > 5.0
    assert worst(apart(theirs, made.ours(text.replace(">7<", ">7.01<")))) > 1e-8
