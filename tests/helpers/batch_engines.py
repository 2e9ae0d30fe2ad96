"""Small aircraft with engines, for ``batch_flights``: their XML, and levers that move at random."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.helpers import batch_flights as flights
from uqharness.batch.translate.engines import read_propulsion
from uqharness.batch.translate.frame import Values
from uqharness.errors import BadInputError
from uqharness.simulator import engine

RUNNING = '<property value="-1">propulsion/set-running</property>'
"""For a script: every engine runs."""
HEAVY = (
    flights.MASS.replace(">47<", ">2000<")
    .replace(">4<", ">1000<")
    .replace(">6<", ">1400<")
    .replace(">8<", ">2000<")
)
MOTOR = (
    '<?xml version="1.0"?><electric_engine name="m"><power'
    ' unit="WATTS">600</power></electric_engine>'
)
BRUSHLESS = (
    '<?xml version="1.0"?><brushless_dc_motor'
    ' name="m"><maxvolts>12</maxvolts><velocityconstant>90</velocityconstant>'
    "<coilresistance>0.05</coilresistance><noloadcurrent>1</noloadcurrent></brushless_dc_motor>"
)
FIXED_PITCH = """<?xml version="1.0"?><propeller name="p"><ixx unit="SLUG*FT2">0.4</ixx><diameter unit="IN">30</diameter>
<numblades>2</numblades>
<table name="C_THRUST" type="internal"><tableData>
0.0 0.073
0.5 0.066
0.8 0.045
1.2 -0.006
5.0 -0.073</tableData></table>
<table name="C_POWER" type="internal"><tableData>
0.0 0.066
0.5 0.053
0.8 0.0426
1.2 0.0155
5.0 0.0493</tableData></table></propeller>"""
VARIABLE_PITCH = """<?xml version="1.0"?><propeller name="p" version="1.1">
<ixx unit="KG*M2">0.6</ixx><diameter unit="FT">2.5</diameter>
<gearratio>1.5</gearratio><minpitch>10</minpitch><maxpitch>30</maxpitch><minrpm>1000</minrpm><maxrpm>2400</maxrpm>
<ct_factor>1.1</ct_factor><cp_factor>0.9</cp_factor>
<table name="C_THRUST" type="internal"><tableData>
    10    20   35
0.0 0.073 0.09 0.12
0.5 0.066 0.08 0.11
0.8 0.045 0.05 0.07
1.2 -0.006 0.01 0.02
5.0 -0.073 -0.06 -0.04</tableData></table>
<table name="C_POWER" type="internal"><tableData>
    10 35
0.0 0.066 .09
0.5 0.053 .07
0.8 0.0426 .06
1.2 0.0155 .03
5.0 0.0493 .08</tableData></table>
<table name="CT_MACH" type="internal"><tableData>
0.02 1.0
1.05 0.8</tableData></table>
<table name="CP_MACH" type="internal"><tableData>
0.02 1.0
0.3 1.2
2.0 1.8</tableData></table>
<table name="CT_RPM_FACTOR" type="internal"><tableData>
0 1.0
3000 0.8</tableData></table>
<table name="CP_RPM_FACTOR" type="internal"><tableData>
0 1.0
3000 1.1</tableData></table></propeller>"""
FILES: Mapping[str, str] = {
    "Engines/motor.xml": MOTOR,
    "Engines/brushless.xml": BRUSHLESS,
    "Engines/fixed.xml": FIXED_PITCH,
    "Engines/variable.xml": VARIABLE_PITCH,
    "Engines/direct.xml": '<?xml version="1.0"?><direct name="d"/>',
    "Engines/nozzle.xml": (
        '<?xml version="1.0"?><nozzle name="n"><area unit="FT2">0.0001</area></nozzle>'
    ),
}
AERODYNAMICS = """<aerodynamics>
<axis name="LIFT"><function name="aero/l"><product><p>aero/qbar-area</p><v>5</v><p>aero/alpha-rad</p></product></function></axis>
<axis name="DRAG"><function name="aero/d"><product><p>aero/qbar-area</p><v>.3</v></product></function></axis>
<axis name="PITCH"><function name="aero/m"><product><p>aero/qbar-area</p><v>-.1</v>
<sum><p>aero/alpha-rad</p><p>velocities/q-aero-rad_sec</p></sum></product></function></axis>
<axis name="ROLL"><function name="aero/r"><product><p>aero/qbar-area</p><v>-.1</v>
<p>velocities/p-aero-rad_sec</p></product></function></axis>
<axis name="YAW"><function name="aero/n"><product><p>aero/qbar-area</p><v>.1</v>
<difference><p>aero/beta-rad</p><p>velocities/r-aero-rad_sec</p></difference></product></function></axis></aerodynamics>"""
TOTALS = [f"forces/fb{a}-{which}-lbs" for a in "xyz" for which in ("prop", "total")] + [
    f"moments/{a}-{which}-lbsft" for a in "lmn" for which in ("prop", "total")
]
MASS = ["inertia/mass-slugs", "inertia/weight-lbs", *(f"inertia/cg-{a}-in" for a in "xyz")] + [
    f"inertia/{name}-slugs_ft2" for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
]
MOTION = [
    "velocities/u-fps",
    "velocities/p-rad_sec",
    "velocities/q-rad_sec",
    "attitude/phi-rad",
    "accelerations/udot-ft_sec2",
]
PROPELLER = (
    "propeller-rpm",
    "engine-rpm",
    "thrust-lbs",
    "advance-ratio",
    "blade-angle",
    "thrust-coefficient",
    "helical-tip-Mach",
    "prop-induced-velocity_fps",
    "propeller-power-ftlbps",
    "propeller-torque-ftlb",
    "y-position",
    "z-position",
    "power-hp",
)


def mounted(
    motor: str, thruster: str, number: int = 0, feed: str = "", extra: str | None = None
) -> str:
    """An ``<engine>`` that names its files; each number has another place, direction and sense."""
    k = number
    more = f"<sense>{1 - 2 * k}</sense><p_factor>{5 * k}</p_factor>" if extra is None else extra
    return (
        f'<engine file="{motor}">{feed}<thruster file="{thruster}">'
        f'<location unit="IN"><x>-20</x><y>{4 * k - 3}</y><z>{k}</z></location>'
        "<orient"
        f' unit="DEG"><roll>{10 * k}</roll><pitch>3</pitch><yaw>-2</yaw></orient>{more}</thruster></engine>'
    )


def tank(contents: float, more: str = "", capacity: float = 12.0) -> str:
    """A tank whose contents move as they are used."""
    return (
        '<tank type="FUEL"><location'
        ' unit="IN"><x>12</x><y>3</y><z>-2</z></location><drain_location'
        ' unit="IN"><x>10</x><y>3</y><z>-6</z></drain_location><radius'
        f' unit="IN">6</radius><capacity unit="LBS">{capacity}</capacity><contents'
        f' unit="LBS">{contents}</contents>{more}</tank>'
    )


def aircraft(propulsion: str, mass: str = flights.MASS, systems: str = "") -> str:
    """An aircraft with this in its ``<propulsion>``."""
    return flights.aircraft(
        f"<propulsion>{propulsion}</propulsion>{systems}{AERODYNAMICS}", mass=mass
    )


def of(number: int, names: tuple[str, ...] | list[str]) -> list[str]:
    """Properties of an engine."""
    base = f"propulsion/engine[{number}]/" if number else "propulsion/engine/"
    return [base + name for name in names]


def levers(
    frames: int, engines: int = 1, seed: int = 0, maximum: float = 1.0
) -> dict[str, np.ndarray]:
    """Throttle, propeller and feather levers and a wind that step at random."""
    rng = np.random.default_rng(seed)

    def steps(length: int, low: float, high: float) -> np.ndarray:
        return np.repeat(rng.uniform(low, high, frames // length + 2), length)[: frames + 1]

    out = {}
    for k in range(engines):
        index = f"[{k}]" if k else ""
        out[f"fcs/throttle-cmd-norm{index}"] = steps(20, -0.1, maximum)
        out[f"fcs/advance-cmd-norm{index}"] = steps(50, 0.0, 1.0)
        out[f"fcs/feather-cmd-norm{index}"] = (steps(100, 0.0, 1.0) > 0.8) * 1.0
    out["atmosphere/wind-north-fps"] = steps(10, -30.0, 30.0)
    # Initialising blows the wind of the initial conditions.
    out["atmosphere/wind-north-fps"][:2] = 0.0
    return out


def stock(*names: str) -> dict[str, str]:
    """Engine files that come with JSBSim."""
    root = engine.default_root() / "engine"
    return {f"Engines/{name}.xml": (root / f"{name}.xml").read_text() for name in names}


@dataclass(frozen=True)
class Case:
    """An aircraft with engines, flown by both."""

    text: str
    records: Sequence[str]
    inputs: Mapping[str, np.ndarray]
    files: Mapping[str, str]
    events: str = RUNNING
    start: Mapping[str, float] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """How many frames are flown."""
        return len(next(iter(self.inputs.values()))) - 1

    def theirs(self) -> dict[str, np.ndarray]:
        """What JSBSim has behind its initialising frames and behind each frame."""
        with self._craft(self.text, self.files, self.events) as result:
            fdm = result.open()
            for name, values in self.inputs.items():
                fdm[name] = float(values[0])
            return flights.by_jsbsim(fdm, self.inputs, self.records, self.frames)

    def ours(
        self,
        text: str | None = None,
        files: Mapping[str, str] | None = None,
        events: str | None = None,
    ) -> dict[str, np.ndarray]:
        """The same by the translation, of other files where they are given."""
        with self._craft(
            text or self.text, files or self.files, self.events if events is None else events
        ) as result:
            return flights.by_batch(result, self.inputs, self.records, self.frames)

    def _craft(
        self, text: str, files: Mapping[str, str], events: str
    ) -> AbstractContextManager[flights.Craft]:
        return flights.craft(text, {**flights.START, **self.start}, events, files)


def refusal(text: str, files: Mapping[str, str], events: str = "") -> str:
    """What is said of a ``<propulsion>`` when it is read; JSBSim itself may refuse it too, and is
    not asked.
    """
    with (
        flights.craft(text, files=files, events=events) as result,
        pytest.raises(BadInputError) as error,
    ):
        read_propulsion(result.sources(), Values(lambda _: 0.0))
    return str(error.value)
