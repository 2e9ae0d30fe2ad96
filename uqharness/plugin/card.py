"""airframe.toml for an aircraft that came without one: what JSBSim and a short flight of the aircraft could tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sysid.units import FT_M
from uqharness.plugin.host import SWITCH
from uqharness.plugin.scale_functions import Scaled
from uqharness.simulator import ALTITUDE_M, MEMS_NOISE_STD, AircraftFacts, ControlFacts
from uqharness.toml import as_toml, dotted

DT_S = 0.01
_ASSUMED_THROW_DEG = 20.0
ERRORS_SYSTEM = "path-errors"
_POSITIVE = {
    "elevator": ("nose down", "nose up"),
    "aileron": ("right wing down", "left wing down"),
    "rudder": ("nose left", "nose right"),
    "throttle": ("more thrust", "less thrust"),
}


def card_text(
    name: str, xml: str, facts: AircraftFacts, scaled: Sequence[Scaled], errors: bool
) -> str:
    """The card's TOML. ``errors``: the system path-errors goes with it, and missions are scored by its properties."""
    shown = as_toml(name)[1:-1]
    lines = [
        f"# What XML cannot say of {shown}. Written by `uqharness instrument`, which measured the aircraft in JSBSim{_where(facts)}:",
        "# read it before trusting it. A throw is degrees of surface per unit of the normalised command, mean of both ends, with + as",
        "# a flight record counts (nose down, right wing down, nose left).",
        "",
        "[aircraft]",
        f"name = {as_toml(name)}",
        f"xml = {as_toml(xml)}",
        f"dt_s = {DT_S}",
        "",
        "[reference]                                   # the XML's metrics",
        f"S_m2 = {facts.S_m2!r}",
        f"b_m = {facts.b_m!r}",
        f"c_m = {facts.c_m!r}",
    ]
    for control, found in facts.controls.items():
        remark = _remark(found)
        lines += [
            "",
            f"[inputs.{control}]{' ' * (45 - len(control) - 9)}{remark}".rstrip(),
            f'property = "fcs/{control}-cmd-norm"',
            'unit = "norm"',
        ]
        lines += [
            f'positive = "{_POSITIVE[control][found.sense < 0]}"',
            f"limits = {[0, 1] if control == 'throttle' else [-1, 1]}",
        ]
        throw = found.throw_deg
        if control != "throttle":
            assumed = "" if throw is not None else "     # assumed: the XML tells no angle"
            if throw is None:
                throw = _ASSUMED_THROW_DEG if found.sense else 1.0
            lines.append(f"throw_deg = {(found.sense or 1) * throw:.6g}{assumed}")
        lines.append(
            f"servo_pwm = {_pulses(control, throw)}     # assumed: your log's, if it has others"
        )
        if found.position is not None:
            lines.append(f"position = {as_toml(found.position)}")
    if facts.host:
        lines += [
            "",
            "[modes.open_loop]                              # FlightGear's properties are passed on",
            f'"{SWITCH}" = 1',
        ]
    lines += ["", "[sensors.noise_std]                            # assumed: small MEMS units; SI"]
    lines += [f"{name} = {std!r}" for name, std in MEMS_NOISE_STD.items()]
    if errors:
        lines += [
            "",
            f"[metrics]                                     # from the line the flight began on: Systems/{ERRORS_SYSTEM}.xml",
            'cross_track = { true = "nav/cross-track-m" }',
            'altitude = { true = "nav/altitude-error-m" }',
            'speed = { true = "nav/speed-error-mps" }',
            'distance_3d = { true = "nav/distance-3d-m" }',
            "",
            "[replay]                                      # nothing in the aircraft reads it",
            f'without_systems = ["{ERRORS_SYSTEM}"]',
        ]
    if scaled:
        lines += [
            "",
            "# Factors on the aircraft's own functions. The biases (uq/bias/...) of one axis act alike, so none is a default.",
            "[parameters]",
        ]
        lines += [f"{dotted((row.scale,))} = {_inline(scale_entry(row))}" for row in scaled]
    return "\n".join(lines) + "\n"


def _where(facts: AircraftFacts) -> str:
    if not math.isfinite(facts.V_mps):
        return ""
    return f" at {facts.V_mps:.0f} m/s, {ALTITUDE_M:.0f} m"


def _remark(facts: ControlFacts) -> str:
    """What the card says of a control behind its heading; empty where its keys say all."""
    if facts.unmeasured:
        return f"# not measured, so sense and throw are assumed: {facts.unmeasured}"
    if not facts.sense:
        return "# moves nothing in this aircraft"
    if facts.thrust_N is not None:
        closed, opened = (round(thrust, 3) + 0.0 for thrust in facts.thrust_N)
        return f"# thrust {closed:.4g} N closed, {opened:.4g} N open"
    return ""


def _pulses(control: str, throw_deg: float | None) -> list[list[float]]:
    """Servo pulses [us] and what they mean: degrees as a record counts, percent of a throttle."""
    if control == "throttle" or throw_deg is None:
        return [[1000, 0], [2000, 100]]
    reach = float(f"{abs(throw_deg):.6g}")
    return [[1000, -reach], [1500, 0], [2000, reach]]


def scale_entry(row: Scaled) -> dict[str, Any]:
    """What [parameters] says of a factor."""
    return {"initial": 1.0, "bounds": [-1, 4], "unit": "1", "source": f"factor on {row.function}"}


def _inline(entry: Mapping[str, Any]) -> str:
    return "{ " + ", ".join(f"{key} = {as_toml(value)}" for key, value in entry.items()) + " }"


IDLE_SYSTEM = "idle-throttle"
IDLE_XML = b"""<?xml version="1.0" encoding="UTF-8"?>
<!-- JSBSim makes this property for aircraft with engines alone; hosts set it and records have a column for it. -->
<system name="idle-throttle">
  <property value="0">fcs/throttle-cmd-norm</property>
</system>
"""

ERRORS_XML = f"""<?xml version="1.0" encoding="UTF-8"?>
<!--
  How far the flight is from the steady straight one it began as: for scoring a mission of an aircraft that has no navigation.
  Read ten times a second at a step of 0.01 s; nothing in the aircraft reads it.

    nav/cross-track-m      m    distance from the line of the initial velocity over the ground, + to the right of it
    nav/altitude-error-m   m    height above the initial one
    nav/speed-error-mps    m/s  true airspeed less the initial one
    nav/distance-3d-m      m    distance from the line, height included
-->
<system name="path-errors">
  <channel name="Errors" execrate="10">
    <fcs_function name="nav/cross-track-m">
      <function>
        <quotient>
          <product>
            <value>{FT_M}</value>
            <difference>
              <product> <property>position/from-start-neu-e-ft</property> <property>ic/vn-fps</property> </product>
              <product> <property>position/from-start-neu-n-ft</property> <property>ic/ve-fps</property> </product>
            </difference>
          </product>
          <sqrt>
            <sum>
              <product> <property>ic/vn-fps</property> <property>ic/vn-fps</property> </product>
              <product> <property>ic/ve-fps</property> <property>ic/ve-fps</property> </product>
            </sum>
          </sqrt>
        </quotient>
      </function>
    </fcs_function>
    <fcs_function name="nav/altitude-error-m">
      <function>
        <product>
          <value>{FT_M}</value>
          <difference> <property>position/h-sl-ft</property> <property>ic/h-sl-ft</property> </difference>
        </product>
      </function>
    </fcs_function>
    <fcs_function name="nav/speed-error-mps">
      <function>
        <product>
          <value>{FT_M}</value>
          <difference> <property>velocities/vt-fps</property> <property>ic/vt-fps</property> </difference>
        </product>
      </function>
    </fcs_function>
    <fcs_function name="nav/distance-3d-m">
      <function>
        <sqrt>
          <sum>
            <product> <property>nav/cross-track-m</property> <property>nav/cross-track-m</property> </product>
            <product> <property>nav/altitude-error-m</property> <property>nav/altitude-error-m</property> </product>
          </sum>
        </sqrt>
      </function>
    </fcs_function>
  </channel>
</system>
""".encode()
