"""Generated missions: steady flight and manoeuvres for any aircraft, without a run script.

`write_steady_start` trims the aircraft and writes a script that starts in the trim.
`write_own_mission` adds doublets and 3-2-1-1 inputs, sized by the linear model so that each reaches
a few degrees. Step lengths follow the excited mode: 2.3/wn for a doublet, 1.6/wn for 3-2-1-1 (R. V.
Jategaonkar, Flight Vehicle System Identification, chapter 2). `script` writes the identification
flights of this project's aircraft, flown on its autopilot between manoeuvres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.requests.simulation import MISSIONS
from uqharness.simulator import engine
from uqharness.simulator.aircraft import SECOND_ORDER, Aircraft, content_hash, open_aircraft
from uqharness.simulator.forced_state import TRIM_LATITUDE_DEG, body_velocity
from uqharness.simulator.linear import STATE_NAMES, LinearModel, linearise, modes
from uqharness.simulator.mission import MANOEUVRE_PROPERTY
from uqharness.simulator.trim import SteadyCondition, Trim, find_trim
from uqharness.toml import Number, Section

# Section [start] of campaign.toml.

STEADY = "steady"
"""Name of the mission that [start] describes."""

MARK = "flight/steady-start"
"""Run property of such a mission: engines start settled, and deviations count from the start."""


class StartSection(Section):
    """Steady flight, wings level, above flat ground at sea level.

    Attributes
    ----------
    V_mps : float
        True airspeed [m/s].
    altitude_m : float
        Altitude above sea level [m].
    heading_deg : float
        True heading [deg].
    climb_deg : float or None
        Flight-path angle [deg]; None for level flight. Solved for if the throttle gives no thrust.
    autopilot : bool
        Whether the card's ``[modes] autopilot`` flies; by default the trimmed controls are fixed.
    """

    V_mps: Number = Field(gt=0, le=1000)
    altitude_m: Number = Field(gt=0, le=30_000)
    heading_deg: Number = Field(default=0.0, ge=0, le=360)
    climb_deg: Number | None = Field(default=None, ge=-45, le=45)
    autopilot: bool = False


# Steady flight as a mission. Controls are fixed, so flights should last seconds to two minutes.

SCRIPT = "steady-mission.xml"
INITIALIZE = "steady-start"

# Trims by content and start, and the scripts that begin in them: a campaign stages its aircraft
# several times.
_trims: dict[tuple[str, StartSection], Trim] = {}
_scripts: dict[tuple[str, StartSection, str], str] = {}


def write_steady_start(aircraft: Aircraft, start: StartSection, script: Path, source: str) -> Trim:
    """Trim the aircraft and write its initial conditions and a run script.

    Parameters
    ----------
    aircraft : Aircraft
        Its folder receives ``steady-start.xml``.
    start : StartSection
        Flight condition.
    script : Path
        Run script to write.
    source : str
        Begins an error message.

    Returns
    -------
    Trim
        The converged trim.

    Raises
    ------
    BadInputError
        If there is no trim.

    Notes
    -----
    Numbers have nine digits; the last digits of the solver differ between machines.
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
            f"{source}: [start] aircraft '{aircraft.name}' has {trim.reason}; try another V_mps,"
            f" altitude_m or climb_deg (uqharness modes {aircraft.name} --speed-mps V --altitude-m"
            " H lists trims)"
        )
    mode = "autopilot" if start.autopilot else "open_loop"
    if start.autopilot and mode not in aircraft.card.modes:
        raise BadInputError(
            f"{source}: [start] autopilot = true: airframe.toml of '{aircraft.name}' has no"
            ' autopilot = { "PROPERTY" = VALUE } in [modes] that engages one'
        )
    write_bytes(aircraft.folder / f"{INITIALIZE}.xml", _initialize(trim).encode())
    script_key = (*key, aircraft.name)
    if script_key not in _scripts:
        _scripts[script_key] = _script(aircraft, trim, mode)
    write_bytes(script, _scripts[script_key].encode())
    return trim


def _initialize(trim: Trim) -> str:
    """Return the initial conditions of a trim as XML."""
    condition = trim.condition
    u, v, w = (
        speed / FT_M for speed in body_velocity(condition.V_mps, trim.alpha_rad, trim.beta_rad)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!-- {_path(condition)} at {condition.V_mps:g} m/s true and {condition.altitude_m:g} m \
above flat ground at sea level. -->
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
    """Return the flight path as text."""
    if condition.climb_rad == 0.0:
        return "Level flight"
    return f"Steady flight on a path of {math.degrees(condition.climb_rad):.3f} deg"


def _leaned(fdm: Any, trim: Trim) -> dict[str, float]:
    """Return the mixtures that the trim leaned at its altitude."""
    engine.start_engines(fdm)
    fdm["ic/h-sl-ft"] = trim.condition.altitude_m / FT_M
    engine.run_ic(fdm)
    return engine.lean_mixtures(fdm)


def _script(aircraft: Aircraft, trim: Trim, mode: str) -> str:
    """Return a run script that begins with the trimmed controls, in a mode of the card."""
    fdm = open_aircraft(aircraft)
    pulling, lifting = engine.throttles(fdm)
    marks = [(MARK, 1.0), *([(trim.equilibrium.mark, 1.0)] if trim.equilibrium is not None else [])]
    properties = [*marks, *aircraft.card.modes.get(mode, {}).items()]
    if pulling:
        # Starting an engine opens its throttle, so the throttle follows.
        properties += [
            ("propulsion/set-running", -1.0),
            *(dict.fromkeys(engine.levers(fdm), 1.0) | _leaned(fdm, trim)).items(),
            *((name, 0.0) for name in lifting),
        ]
    for control, value in trim.controls.items():
        name = aircraft.card.inputs[control].property
        names = pulling if name == engine.THROTTLE and pulling else [name]
        properties += [(command, value) for command in names]
    lines = "\n".join(
        f'    <property value="{value:.9g}">{name}</property>' for name, value in properties
    )
    way = "on its autopilot" if mode == "autopilot" else "controls fixed"
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!-- Steady flight of {aircraft.name}, trimmed as the nominal model, {way}. -->
<runscript name="steady">
  <use aircraft="{aircraft.name}" initialize="{INITIALIZE}"/>
  <run start="0" end="60" dt="{aircraft.dt_s:g}">
{lines}
  </run>
</runscript>
"""


# Run scripts of three identification flights: open-loop manoeuvres between autopilot phases. Each
# manoeuvre starts from the positions at which the autopilot left the controls and adds its steps,
# so that one script serves any aircraft with this autopilot, at any speed and in turbulence.

STEP_S = 0.01
_COMMAND = {
    "elevator": ("fcs/elevator-cmd-deg", "fcs/elevator-pos-deg"),
    "aileron": ("fcs/aileron-cmd-deg", "fcs/aileron-pos-deg"),
    "rudder": ("fcs/rudder-cmd-deg", "fcs/rudder-pos-deg"),
    "throttle": ("fcs/throttle-cmd-pct", "fcs/throttle-pos-pct"),
}
DOUBLET = ((1, 1.0), (1, -1.0))
THREE_TWO_ONE_ONE = ((3, -1.0), (2, 1.0), (1, -1.0), (1, 1.0))
QUIET_S = 1.0  # open loop before the first step: the segment's start state is estimated from it


@dataclass(frozen=True)
class Manoeuvre:
    """Steps of one control about its present position.

    Attributes
    ----------
    name, control : str
        Name, and the control that moves.
    size : float
        Step size [deg or percent].
    unit_s : float
        Length of a unit [s].
    pattern : tuple of (int, float)
        (units, sign) of each step.
    rest_s, recovery_s : float
        Open loop after the last step, then on the autopilot [s].
    speed_mps : float or None
        Commanded airspeed of the recovery [m/s]; None for no change.
    """

    name: str
    control: str
    size: float
    unit_s: float
    pattern: tuple[tuple[int, float], ...] = DOUBLET
    rest_s: float = 3.5
    recovery_s: float = 5.0
    speed_mps: float | None = None


@dataclass(frozen=True)
class Plan:
    """A flight: ``settle_s`` on the autopilot at ``speed_mps``, then the manoeuvres."""

    name: str
    purpose: str
    speed_mps: float
    manoeuvres: tuple[Manoeuvre, ...]
    settle_s: float = 4.0

    @property
    def end_s(self) -> float:
        """Return the end time [s]."""
        return self.settle_s + sum(_length(m) for m in self.manoeuvres)


PLANS = (
    Plan(
        "flight-ident",
        "identification",
        22.0,
        (
            Manoeuvre("pitch doublet, 22 m/s", "elevator", 3.0, 0.5),
            Manoeuvre("3-2-1-1, 22 m/s", "elevator", 2.5, 0.3, THREE_TWO_ONE_ONE, recovery_s=5.0),
            Manoeuvre("roll doublet, 22 m/s", "aileron", 8.0, 0.6, rest_s=2.0),
            Manoeuvre("yaw doublet, 22 m/s", "rudder", 8.0, 0.7),
            Manoeuvre(
                "throttle doublet, 22 m/s",
                "throttle",
                22.0,
                1.6,
                rest_s=1.5,
                recovery_s=6.0,
                speed_mps=19.0,
            ),
            Manoeuvre("pitch doublet, 19 m/s", "elevator", -6.0, 0.6),
            Manoeuvre("roll doublet, 19 m/s", "aileron", -8.0, 0.6, rest_s=2.0),
            Manoeuvre("yaw doublet, 19 m/s", "rudder", -8.0, 0.8, recovery_s=6.5, speed_mps=24.0),
            Manoeuvre("3-2-1-1, 24 m/s", "elevator", -2.5, 0.3, THREE_TWO_ONE_ONE, recovery_s=1.0),
        ),
    ),
    Plan(
        "flight-bounds",
        "model-form bounds",
        21.0,
        (
            Manoeuvre("3-2-1-1, 21 m/s", "elevator", -3.0, 0.35, THREE_TWO_ONE_ONE),
            Manoeuvre("yaw doublet, 21 m/s", "rudder", -6.0, 0.8),
            Manoeuvre("roll doublet, 21 m/s", "aileron", -10.0, 0.5, rest_s=2.0),
            Manoeuvre(
                "pitch doublet, 21 m/s", "elevator", -3.5, 0.5, recovery_s=6.0, speed_mps=23.5
            ),
            Manoeuvre("pitch doublet, 23.5 m/s", "elevator", 2.5, 0.4),
            Manoeuvre("yaw doublet, 23.5 m/s", "rudder", 7.0, 0.6),
            Manoeuvre(
                "throttle doublet, 23.5 m/s",
                "throttle",
                -22.0,
                1.6,
                rest_s=1.5,
                recovery_s=6.5,
                speed_mps=19.5,
            ),
            Manoeuvre("roll doublet, 19.5 m/s", "aileron", 7.0, 0.8, rest_s=2.0),
            Manoeuvre("pitch doublet, 19.5 m/s", "elevator", -5.5, 0.7, recovery_s=1.0),
        ),
    ),
    Plan(
        "flight-validation",
        "validation",
        20.0,
        (
            Manoeuvre("roll doublet, 20 m/s", "aileron", 9.0, 0.5, rest_s=2.0),
            Manoeuvre("pitch doublet, 20 m/s", "elevator", -6.0, 0.6),
            Manoeuvre("yaw doublet, 20 m/s", "rudder", 7.0, 0.9),
            Manoeuvre(
                "3-2-1-1, 20 m/s",
                "elevator",
                2.5,
                0.4,
                THREE_TWO_ONE_ONE,
                recovery_s=6.0,
                speed_mps=22.5,
            ),
            Manoeuvre("pitch doublet, 22.5 m/s", "elevator", 3.5, 0.4),
            Manoeuvre("roll doublet, 22.5 m/s", "aileron", -7.0, 0.7, rest_s=2.0),
            Manoeuvre("throttle doublet, 22.5 m/s", "throttle", 18.0, 2.0, rest_s=1.5),
            Manoeuvre("yaw doublet, 22.5 m/s", "rudder", -8.0, 0.7),
            Manoeuvre(
                "3-2-1-1, 22.5 m/s", "elevator", -2.5, 0.3, THREE_TWO_ONE_ONE, recovery_s=1.0
            ),
        ),
    ),
)


def _length(m: Manoeuvre) -> float:
    """Return the duration of a manoeuvre with its recovery [s]."""
    return QUIET_S + m.unit_s * sum(units for units, _ in m.pattern) + m.rest_s + m.recovery_s


def _event(time_s: float, name: str, sets: Sequence[str], step_s: float) -> str:
    """Return an event of a run script at a time [s]."""
    # Half a step early, so that rounding of the clock cannot shift it by a frame.
    lines = "".join(f"\n      {text}" for text in sets)
    return (
        f'    <event name="{name}">\n      <condition>simulation/sim-time-sec ge'
        f" {time_s - step_s / 2:.3f}</condition>{lines}\n    </event>\n"
    )


def _events(plan: Plan, step_s: float) -> Iterator[str]:
    """Yield the events of a plan."""
    time = plan.settle_s
    for number, m in enumerate(plan.manoeuvres, start=1):
        # Hold the commands at the present positions, so that the open loop starts without a jump.
        hold = [
            f'<set name="{command}"><function> <sum> <property>{position}</property>'
            " <value>0</value> </sum> </function></set>"
            for command, position in _COMMAND.values()
        ]
        yield _event(
            time, m.name, [*hold, '<set name="ap/engaged" value="0"/>', _count(number)], step_s
        )
        time += QUIET_S
        previous_sign = 0.0
        for units, sign in (*m.pattern, (0, 0.0)):
            step = m.size * (sign - previous_sign)
            where = "back" if units == 0 else f"{m.control} {m.size * sign:+g}"
            yield _event(
                time,
                f"{time:.2f} s, {where}",
                [f'<set name="{_COMMAND[m.control][0]}" type="FG_DELTA" value="{step:g}"/>'],
                step_s,
            )
            previous_sign, time = sign, time + units * m.unit_s
        time += m.rest_s
        recovery = ['<set name="ap/engaged" value="1"/>', _count(0)]
        if m.speed_mps is not None:
            recovery.append(f'<set name="ap/airspeed-cmd-mps" value="{m.speed_mps:g}"/>')
        yield _event(time, f"{time:.2f} s, autopilot", recovery, step_s)
        time += m.recovery_s


def _count(number: int) -> str:
    """Return the element that sets the manoeuvre's number."""
    return f'<set name="{MANOEUVRE_PROPERTY}" value="{number}"/>'


def script(plan: Plan, step_s: float = STEP_S) -> str:
    """Return the run script of a plan as text.

    Parameters
    ----------
    plan : Plan
        The flight.
    step_s : float
        Integration step [s], at least 2 ms.
    """
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!--
  Flight for {plan.purpose}, made by uqharness/simulator/own_mission.py: do not edit, \
change the plan there.

  On the autopilot along a wide circle, with manoeuvres open loop in between. A manoeuvre \
starts from where the
  autopilot left the controls and adds its steps to that, so this serves any aircraft with \
this project's autopilot.
  {MANOEUVRE_PROPERTY} counts the manoeuvres, 0 in between; the event that sets a number \
bears the manoeuvre's name.
-->
<runscript name="{plan.name}">
  <description>Flight for {plan.purpose}: {len(plan.manoeuvres)} manoeuvres</description>
  <use aircraft="espaaro" initialize="cruise"/>
  <run start="0" end="{plan.end_s:g}" dt="{step_s:g}">
    <property value="0">{MANOEUVRE_PROPERTY}</property>           \
<!-- 1, 2, ... during a manoeuvre -->
    <!-- Second-order integration of the motion: JSBSim's own choice for rates is Euler's rule, \
which at 0.01 s acts as 4 % more
         roll damping, and an identification from this flight would find that. -->
    <property value="3">simulation/integrator/rate/rotational</property>
    <property value="3">simulation/integrator/rate/translational</property>
    <property value="3">simulation/integrator/position/rotational</property>
    <property value="1">ap/engaged</property>
    <!-- A wide circle, bank 1.4 deg. The autopilot, as ArduPlane, scales the radius \
by (true over equivalent airspeed)^2:
         2019 m at 100 m above the sea. -->
    <property value="2000">ap/WP_LOITER_RAD</property>            <!-- m -->
    <property value="0">ap/loiter-center-north-m</property>       <!-- m -->
    <property value="2019">ap/loiter-center-east-m</property>     <!-- m -->
    <property value="30">ap/NAVL1_PERIOD</property>               \
<!-- s, gentle: a manoeuvre should not begin in a turn -->
    <property value="20">ap/ROLL_LIMIT_DEG</property>             <!-- deg -->
    <property value="100">ap/altitude-cmd-m</property>            <!-- m above ground -->
    <property value="{plan.speed_mps:g}">ap/airspeed-cmd-mps</property>         <!-- m/s, true -->
    <property value="0">air/wind-mps</property>                   <!-- m/s -->
    <property value="270">air/wind-from-deg</property>            <!-- deg -->
    <property value="0">air/turbulence-w20-kt</property>          \
<!-- kt; 0 none, 15 light, 30 moderate, 45 severe -->
    <property value="1">sensor/noise</property>                   \
<!-- 1: what the autopilot is told carries Table 2.1's noise -->
    <property value="1">sensor/log</property>                     \
<!-- 1: all channels of a flight log -->
    <property value="1">simulation/randomseed</property>          <!-- sensors; 1 .. 2147483646 -->
    <property value="2">atmosphere/randomseed</property>          \
<!-- turbulence; unset, it would share the sensors' stream -->
{"".join(_events(plan, step_s))}  </run>
</runscript>
"""


EXCURSION_DEG = 4.0
"""Largest angle [deg] of incidence, sideslip or pitch by the linear model; three times for bank."""
MAX_STEP_S = 0.0025
"""Longest step [s] of these missions, as that of the replays compared with them."""
SETTLE_S, REST_S = 2.0, 4.0
STEADY_S = 20.0
_MODE = {"elevator": "short_period", "aileron": "roll", "rudder": "dutch_roll"}
_AXIS = {"elevator": "pitch", "aileron": "roll", "rudder": "yaw"}
_UNITS_S = (
    0.2,
    1.5,
)  # a step that a servo can follow, and one that the aircraft does not leave its trim by
# steps fall on rows of a record at 25, 50 or 100 Hz: between two rows they would be dated too late
_GRID_S = 0.04
_BANK_WEIGHT = 3.0
_MAX_TRAVEL_SHARE = 0.5  # of what is left of a control's travel
_DT_S = 0.01
_RATES = ("simulation/integrator/rate/rotational", "simulation/integrator/rate/translational")
_EULER = 1.0


@dataclass(frozen=True)
class Step:
    """A manoeuvre of one control.

    Attributes
    ----------
    name, control : str
        Name, and the control that moves.
    size : float
        Step size in the control's unit.
    unit_s : float
        Length of a unit [s].
    pattern : tuple of (int, float)
        (units, sign) of each step.
    """

    name: str
    control: str
    size: float
    unit_s: float
    pattern: tuple[tuple[int, float], ...]

    @property
    def length_s(self) -> float:
        """Return the time from the first step to the return [s]."""
        return self.unit_s * sum(units for units, _ in self.pattern)


def write_own_mission(
    aircraft: Aircraft, start: StartSection, kind: str, *, restarting: bool = False
) -> tuple[Path, list[Step]]:
    """Trim an aircraft and write initial conditions and a run script into its folder.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft; its folder is written to.
    start : StartSection
        Flight condition.
    kind : str
        One of `MISSIONS`.
    restarting : bool
        Whether the flight is integrated by SECOND_ORDER, which is restarted at every step of a
        control.

    Returns
    -------
    path : Path
        The run script.
    steps : list of Step
        Its manoeuvres.

    Raises
    ------
    BadInputError
        If there is no trim, no control turns the aircraft, or controls command body rates.
    """
    if kind not in MISSIONS:
        raise BadInputError(f"mission '{kind}': allowed are {', '.join(MISSIONS)}")
    path = aircraft.folder / SCRIPT
    trim = write_steady_start(aircraft, start, path, f"mission {kind}")
    if kind != "steady" and trim.equilibrium is not None and trim.equilibrium.free:
        raise BadInputError(
            f"aircraft '{aircraft.name}': its control laws turn commands into body rates, so steps"
            " cannot be sized by a surface's moment; use mission steady, or --script with other"
            " commands"
        )
    steps = [] if kind == "steady" else manoeuvres(aircraft, linearise(aircraft, trim), kind)
    if kind != "steady" and not steps:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no surface has a moment at {start.V_mps:g} m/s, so there"
            " is no manoeuvre"
        )
    text = path.read_text(encoding="utf-8")
    end = STEADY_S if kind == "steady" else SETTLE_S + sum(step.length_s + REST_S for step in steps)
    # The steady script ends after 60 s; this one after the last manoeuvre.
    text = text.replace('end="60"', f'end="{end:.2f}"')
    properties = (
        "" if kind == "steady" else f'    <property value="0">{MANOEUVRE_PROPERTY}</property>\n'
    )
    write_bytes(
        path,
        text.replace(
            "  </run>", f"{properties}{_step_events(aircraft, steps, restarting)}  </run>"
        ).encode(),
    )
    return path, steps


def with_fine_step(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft with a step of at most MAX_STEP_S.

    At 10 ms JSBSim responds to a command half a step late.
    """
    section = aircraft.card.aircraft
    fine = section.model_copy(update={"dt_s": min(section.dt_s, MAX_STEP_S)})
    return replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": fine}))


def manoeuvres(aircraft: Aircraft, model: LinearModel, kind: str) -> list[Step]:
    """Return the steps of every surface that turns the aircraft, sized for EXCURSION_DEG."""
    frequency = {mode.name: mode.wn_radps for mode in modes(model)}
    coupled = frequency.get("other", 0.0)  # ailerons excite it where roll and spiral have joined
    steps = []
    for control, mode in _MODE.items():
        if control not in model.controls:
            continue
        pattern, cycles = (
            (THREE_TWO_ONE_ONE, 1.6)
            if kind == "3-2-1-1" and control == "elevator"
            else (DOUBLET, 2.3)
        )
        # Length by the mode's frequency, limited, and rounded to the grid.
        unit_s = _GRID_S * round(
            min(max(cycles / max(frequency.get(mode, coupled), 1e-3), _UNITS_S[0]), _UNITS_S[1])
            / _GRID_S
        )
        greatest = _excursion_rad(model, control, unit_s, pattern)
        if not greatest > 1e-9:
            continue
        low, high = aircraft.card.inputs[control].limits
        at = model.trim.controls[control]
        # By the target angle, limited to half of the remaining travel.
        size = min(
            math.radians(EXCURSION_DEG) / greatest, _MAX_TRAVEL_SHARE * min(high - at, at - low)
        )
        if size > 0.0:
            name = "3-2-1-1" if pattern is THREE_TWO_ONE_ONE else f"{_AXIS[control]} doublet"
            steps.append(Step(name, control, size, unit_s, pattern))
    return steps


def _excursion_rad(
    model: LinearModel, control: str, unit_s: float, pattern: tuple[tuple[int, float], ...]
) -> float:
    """Return the largest angle [rad] per unit of the control, bank divided by three."""
    # Processes that only fly missions need no more of scipy.
    from scipy.linalg import expm

    n = len(STATE_NAMES)
    control_column = model.B[:, [model.controls.index(control)]]
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n:] = model.A, control_column
    # Zero-order hold: exp of [[A, b], [0, 0]] dt gives transition matrix and input column.
    step: NDArray[np.float64] = expm(augmented * _DT_S)
    x, greatest = np.zeros(n), 0.0
    V = model.trim.condition.V_mps
    # v/V and w/V are sideslip and incidence.
    weight = {"v": 1.0 / V, "w": 1.0 / V, "phi": 1.0 / _BANK_WEIGHT, "theta": 1.0}
    weights = np.array([weight.get(name, 0.0) for name in STATE_NAMES])
    for units, sign in pattern:
        for _ in range(round(units * unit_s / _DT_S)):
            x = step[:n, :n] @ x + step[:n, n] * sign
            greatest = max(greatest, float(np.max(np.abs(weights * x))))
    return greatest


def _step_events(aircraft: Aircraft, steps: list[Step], restarting: bool) -> str:
    """Return the events of all steps."""
    events, time = [], SETTLE_S
    half = aircraft.dt_s / 2.0  # early, so that rounding of the clock cannot shift it by a frame
    for number, step in enumerate(steps, start=1):
        events.append(
            _timed_event(
                time - half, step.name, f'<set name="{MANOEUVRE_PROPERTY}" value="{number}"/>'
            )
        )
        previous_sign, name = 0.0, aircraft.card.inputs[step.control].property
        for units, sign in (*step.pattern, (0, 0.0)):
            delta = step.size * (sign - previous_sign)
            change = f'<set name="{name}" type="FG_DELTA" value="{delta:.9g}"/>'
            events.append(_timed_event(time - half, f"{time:.2f} s, {step.control}", change))
            if restarting:
                events.append(_restart(time, aircraft.dt_s))
            previous_sign, time = sign, time + units * step.unit_s
        time += REST_S
    return "".join(events)


def _restart(time_s: float, dt_s: float) -> str:
    """Return events that restart the Adams-Bashforth rule by one frame of Euler's.

    The rule extrapolates accelerations of the frame before. Across a jump of a surface that shifts
    the rates of all later rows by half a frame.
    """
    events = []
    for frames, rule, name in ((0.5, _EULER, "begin anew"), (1.5, None, "go on")):
        changes = "\n      ".join(
            f'<set name="{rate}" value="{SECOND_ORDER[rate] if rule is None else rule:g}"/>'
            for rate in _RATES
        )
        events.append(_timed_event(time_s + frames * dt_s, f"{time_s:.2f} s, {name}", changes))
    return "".join(events)


def _timed_event(time_s: float, name: str, change: str) -> str:
    """Return an event of a generated mission."""
    return (
        f'    <event name="{name}">\n      <condition>simulation/sim-time-sec ge'
        f" {time_s:.5f}</condition>\n      {change}\n    </event>\n"
    )
