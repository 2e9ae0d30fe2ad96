"""Steady flight as a mission of any aircraft: trim it, and write initial conditions and a run script that begin in that trim.

The controls stay where they are (what an aircraft does by itself), so flights should be short: seconds to a minute or two.
"""

from __future__ import annotations

import math
from pathlib import Path

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, content_hash, open_aircraft
from uqharness.simulator.forced_state import TRIM_LATITUDE_DEG, body_velocity
from uqharness.simulator.start import MARK, StartSection
from uqharness.simulator.trim import SteadyCondition, Trim, find_trim

SCRIPT = "steady-mission.xml"
INITIALIZE = "steady-start"

# A campaign makes its copy more than once (to know it, to fly it, to see that nothing was edited); a trim takes a second.
_trims: dict[tuple[str, StartSection], Trim] = {}


def write_steady_start(aircraft: Aircraft, start: StartSection, script: Path, source: str) -> Trim:
    """Trim ``aircraft`` and write its folder's steady-start.xml and the run script. Raises BadInputError where there is no trim.

    Numbers carry nine digits: what a solver leaves in the last ones would be another file on another machine.
    """
    condition = SteadyCondition(
        start.V_mps,
        start.altitude_m,
        math.radians(start.climb_deg or 0.0),
        heading_rad=math.radians(start.heading_deg),
    )
    key = (content_hash(aircraft), start)
    if key not in _trims:
        _trims[key] = find_trim(aircraft, condition)
    trim = _trims[key]
    if not trim.converged:
        raise BadInputError(
            f"{source}: [start] aircraft '{aircraft.name}' has {trim.reason}; "
            f"try another V_mps, altitude_m or climb_deg (uqharness modes {aircraft.name} --speed-mps V --altitude-m H tells)"
        )
    write_bytes(aircraft.folder / f"{INITIALIZE}.xml", _initialize(trim).encode())
    write_bytes(script, _script(aircraft, trim).encode())
    return trim


def _initialize(trim: Trim) -> str:
    condition = trim.condition
    u, v, w = (
        speed / FT_M for speed in body_velocity(condition.V_mps, trim.alpha_rad, trim.beta_rad)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!-- {_path(condition)} at {condition.V_mps:g} m/s true and {condition.altitude_m:g} m above flat ground at sea level. -->
<initialize name="{INITIALIZE}">
  <latitude unit="DEG" type="geodetic"> {TRIM_LATITUDE_DEG:g} </latitude>
  <longitude unit="DEG"> 0 </longitude>
  <elevation unit="M"> 0 </elevation>
  <altitudeMSL unit="M"> {condition.altitude_m:.9g} </altitudeMSL>
  <phi unit="RAD"> {condition.bank_rad:.9g} </phi>
  <theta unit="RAD"> {trim.theta_rad:.9g} </theta>
  <psi unit="RAD"> {condition.heading_rad:.9g} </psi>
  <ubody unit="FT/SEC"> {u:.9g} </ubody>
  <vbody unit="FT/SEC"> {v:.9g} </vbody>
  <wbody unit="FT/SEC"> {w:.9g} </wbody>
</initialize>
"""


def _path(condition: SteadyCondition) -> str:
    if condition.climb_rad == 0.0:
        return "Level flight"
    return f"Steady flight on a path of {math.degrees(condition.climb_rad):.3f} deg"


def _script(aircraft: Aircraft, trim: Trim) -> str:
    fdm = open_aircraft(aircraft)
    engines = fdm.get_propulsion().get_num_engines()
    marks = [(MARK, 1.0), *([(trim.rest.mark, 1.0)] if trim.rest is not None else [])]
    properties = [*marks, *aircraft.card.modes.get("open_loop", {}).items()]
    if engines:
        # Before the throttle, which starting an engine opens.
        properties += [
            ("propulsion/set-running", -1.0),
            *((name, 1.0) for name in engine.levers(fdm)),
        ]
    for control, value in trim.controls.items():
        name = aircraft.card.inputs[control].property
        properties.append((name, value))
        if name == "fcs/throttle-cmd-norm":
            properties += [(f"{name}[{index}]", value) for index in range(1, engines)]
    lines = "\n".join(
        f'    <property value="{value:.9g}">{name}</property>' for name, value in properties
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!-- Steady flight of {aircraft.name}, trimmed as the nominal model, controls fixed. -->
<runscript name="steady">
  <use aircraft="{aircraft.name}" initialize="{INITIALIZE}"/>
  <run start="0" end="60" dt="{aircraft.dt_s:g}">
{lines}
  </run>
</runscript>
"""
