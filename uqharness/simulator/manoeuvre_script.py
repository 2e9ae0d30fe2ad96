"""Run scripts of the three identification flights: manoeuvres flown open loop, the autopilot in between.

A manoeuvre begins where the autopilot left the controls: the surfaces' and the motor's own positions become the open-loop
commands, the autopilot lets go, and the steps are added to what it held, so that one script serves any aircraft with this
project's autopilot, at any speed, in turbulence. ``flight/manoeuvre`` counts the manoeuvres; `uqharness fly` turns the
count into the name of the event that set it, and the record's column ``manoeuvre``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from uqharness.simulator.mission import MANOEUVRE_PROPERTY

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
    """Steps of one control about where it stands: ``pattern`` of (units, sign), ``unit_s`` s, ``size`` deg or percent.

    ``rest_s`` open loop after the last step; then the autopilot recovers for ``recovery_s`` at ``speed_mps`` (None: as before).
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
    """A flight: ``speed_mps`` to begin with, ``settle_s`` on the autopilot, then manoeuvres one after the other."""

    name: str
    purpose: str
    speed_mps: float
    manoeuvres: tuple[Manoeuvre, ...]
    settle_s: float = 4.0

    @property
    def end_s(self) -> float:
        """When the script ends [s]."""
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
    return QUIET_S + m.unit_s * sum(units for units, _ in m.pattern) + m.rest_s + m.recovery_s


def _event(time_s: float, name: str, sets: Sequence[str], step_s: float) -> str:
    # Half a step early, so that rounding of the clock cannot shift it by a frame.
    lines = "".join(f"\n      {text}" for text in sets)
    return (
        f'    <event name="{name}">\n      <condition>simulation/sim-time-sec ge {time_s - step_s / 2:.3f}</condition>'
        f"{lines}\n    </event>\n"
    )


def _events(plan: Plan, step_s: float) -> Iterator[str]:
    time = plan.settle_s
    for number, m in enumerate(plan.manoeuvres, start=1):
        take = [
            f'<set name="{command}"><function> <sum> <property>{position}</property> <value>0</value> </sum> </function></set>'
            for command, position in _COMMAND.values()
        ]
        yield _event(
            time, m.name, [*take, '<set name="ap/engaged" value="0"/>', _count(number)], step_s
        )
        time += QUIET_S
        before = 0.0
        for units, sign in (*m.pattern, (0, 0.0)):
            step = m.size * (sign - before)
            where = "back" if units == 0 else f"{m.control} {m.size * sign:+g}"
            yield _event(
                time,
                f"{time:.2f} s, {where}",
                [f'<set name="{_COMMAND[m.control][0]}" type="FG_DELTA" value="{step:g}"/>'],
                step_s,
            )
            before, time = sign, time + units * m.unit_s
        time += m.rest_s
        after = ['<set name="ap/engaged" value="1"/>', _count(0)]
        if m.speed_mps is not None:
            after.append(f'<set name="ap/airspeed-cmd-mps" value="{m.speed_mps:g}"/>')
        yield _event(time, f"{time:.2f} s, autopilot", after, step_s)
        time += m.recovery_s


def _count(number: int) -> str:
    return f'<set name="{MANOEUVRE_PROPERTY}" value="{number}"/>'


def script(plan: Plan, step_s: float = STEP_S) -> str:
    """The run script of a plan as text, for a step of ``step_s`` (2 ms or more)."""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!--
  Flight for {plan.purpose}, made by uqharness/simulator/manoeuvre_script.py: do not edit, change the plan there.

  On the autopilot along a wide circle, with manoeuvres open loop in between. A manoeuvre starts from where the
  autopilot left the controls and adds its steps to that, so this serves any aircraft with this project's autopilot.
  {MANOEUVRE_PROPERTY} counts the manoeuvres, 0 in between; the event that sets a number bears the manoeuvre's name.
-->
<runscript name="{plan.name}">
  <description>Flight for {plan.purpose}: {len(plan.manoeuvres)} manoeuvres</description>
  <use aircraft="espaaro" initialize="cruise"/>
  <run start="0" end="{plan.end_s:g}" dt="{step_s:g}">
    <property value="0">{MANOEUVRE_PROPERTY}</property>           <!-- 1, 2, ... during a manoeuvre -->
    <!-- Second-order integration of the motion: JSBSim's own choice for rates is Euler's rule, which at 0.01 s acts as 4 % more
         roll damping, and an identification from this flight would find that. -->
    <property value="3">simulation/integrator/rate/rotational</property>
    <property value="3">simulation/integrator/rate/translational</property>
    <property value="3">simulation/integrator/position/rotational</property>
    <property value="1">ap/engaged</property>
    <!-- A wide circle, bank 1.4 deg. The autopilot, as ArduPlane, scales the radius by (true over equivalent airspeed)^2:
         2019 m at 100 m above the sea. -->
    <property value="2000">ap/WP_LOITER_RAD</property>            <!-- m -->
    <property value="0">ap/loiter-center-north-m</property>       <!-- m -->
    <property value="2019">ap/loiter-center-east-m</property>     <!-- m -->
    <property value="30">ap/NAVL1_PERIOD</property>               <!-- s, gentle: a manoeuvre should not begin in a turn -->
    <property value="20">ap/ROLL_LIMIT_DEG</property>             <!-- deg -->
    <property value="100">ap/altitude-cmd-m</property>            <!-- m above ground -->
    <property value="{plan.speed_mps:g}">ap/airspeed-cmd-mps</property>         <!-- m/s, true -->
    <property value="0">air/wind-mps</property>                   <!-- m/s -->
    <property value="270">air/wind-from-deg</property>            <!-- deg -->
    <property value="0">air/turbulence-w20-kt</property>          <!-- kt; 0 none, 15 light, 30 moderate, 45 severe -->
    <property value="1">sensor/noise</property>                   <!-- 1: what the autopilot is told carries Table 2.1's noise -->
    <property value="1">sensor/log</property>                     <!-- 1: all channels of a flight log -->
    <property value="1">simulation/randomseed</property>          <!-- sensors; 1 .. 2147483646 -->
    <property value="2">atmosphere/randomseed</property>          <!-- turbulence; unset, it would share the sensors' stream -->
{"".join(_events(plan, step_s))}  </run>
</runscript>
"""
