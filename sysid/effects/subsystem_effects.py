"""Candidate effects that are no coefficient term: stall, ground, propulsion, mass, actuators, sensors."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.effects.catalogue import JATEGAONKAR, Effect
from sysid.effects.tuned import ODDS

_POSITIVE = ("delay", "lag", "deadband", "rate_limit", "separation", "dynamic", "lift")
_WIND = ("V_mps", "alpha_rad", "beta_rad")
# subsystem, term, name, physics, regime, unit, odds
_Row = tuple[str, str, str, str, str, str, float]
_AIRCRAFT: tuple[_Row, ...] = (
    ("stall", "separation", "lift lost by separation", "flow separates from the trailing edge at high angle of attack",
     "high angle of attack", "1", ODDS),
    ("stall", "dynamic", "lift lost by separation that lags", "separation follows angle of attack late (eq 2.40)",
     "fast changes at high angle of attack", "1", ODDS),
    ("ground", "lift", "lift gained near the ground",
     "the ground holds up the wing's downwash: normal force grows by a share that falls off as exp(-2 h/b)",
     "low height", "1", ODDS),
    ("propulsion", "thrust_scale", "thrust off by a factor", "propeller or battery give more or less than the map",
     "throttle changes", "1", ODDS),
    ("propulsion", "inflow", "inflow at the propeller off by a factor",
     "the propeller meets the air faster or slower than the map has it",
     "throttle and speed changes", "1", ODDS),
    ("propulsion", "airspeed", "thrust off by a factor that goes with airspeed", "propeller and motor are matched at another speed",
     "throttle and speed changes", "1", ODDS),
    ("propulsion", "torque", "propeller torque", "the motor's reaction rolls the aircraft against the propeller",
     "throttle changes", "1", ODDS),
    ("propulsion", "p_factor", "p-factor", "the descending blade sees more angle of attack: yaw with alpha, pitch with beta",
     "throttle at angle of attack", "1", ODDS),
    ("propulsion", "slipstream", "slipstream over the tail", "tail surfaces act in more dynamic pressure as thrust grows",
     "elevator and rudder at different power", "1", ODDS),
    ("mass", "cg_x", "centre of gravity further forward", "the moments are about another point", "all manoeuvres", "m", ODDS),
    ("mass", "Ixz", "product of inertia Ixz off",
     "roll and yaw accelerations are coupled, and pitch with roll rate squared", "aileron and rudder doublets", "kg m^2", ODDS),
)  # fmt: skip


def _effect(row: _Row) -> Effect:
    subsystem, term, name, physics, regime, unit, odds = row
    return Effect(None, subsystem, term, name, physics, regime, "", JATEGAONKAR, unit, odds, term in _POSITIVE)


def subsystem_effects(
    surfaces: Sequence[str], channels: Sequence[str], delays: Sequence[str], parts: Sequence[str] = ()
) -> list[Effect]:
    """Effects that are no coefficient term, for the surfaces, measured channels and sensors (for delays) at hand.

    parts: channels of a sensor with several, whose filter may be another than the others'.
    """
    rows = [*_AIRCRAFT]
    for s in surfaces:
        rows += [
            (f"actuator.{s}", "lag", f"{s} servo's lag other than modelled", "first-order lag of the servo", f"{s} steps", "s",
             ODDS),
            (f"actuator.{s}", "deadband", f"{s} servo with a deadband", "small commands do not move the surface",
             f"small {s} commands", "deg", ODDS),
            (f"actuator.{s}", "rate_limit", f"{s} servo's rate limit other than modelled", "the servo's speed is limited",
             f"large {s} steps", "s/deg", ODDS),
        ]  # fmt: skip
    for c in channels:
        short, unit = c.split("_")[0], c.split("_")[1]
        wind = c in _WIND
        physics = "position error or upwash at the sensor" if wind else "calibration"
        rows.append(
            (
                f"sensor.{c}",
                "scale",
                f"{short} sensor's scale off",
                physics,
                "all manoeuvres",
                "1",
                2.0 * ODDS,
            )
        )
        if short not in ("p", "q", "r"):
            rows.append(
                (
                    f"sensor.{c}",
                    "bias",
                    f"{short} sensor's zero off",
                    "calibration or misalignment",
                    "all manoeuvres",
                    unit,
                    2.0 * ODDS,
                )
            )
    if {"ax_mps2", "ay_mps2", "az_mps2"} & set(channels):
        rows += [
            ("sensor.accelerometer", f"place_{axis}", f"accelerometers further {way}", "they feel the rotation about the CG",
             "abrupt manoeuvres", "m", 2.0 * ODDS)
            for axis, way in (("x", "forward"), ("y", "right"), ("z", "down"))
        ]  # fmt: skip
    if {"V_mps", "q_radps", "r_radps"} <= set(channels) and {"alpha_rad", "beta_rad"} & set(channels):
        physics = "they move with pitch and yaw rate"
        rows.append(("sensor.vane", "place_x", "wind vanes further forward", physics, "abrupt manoeuvres", "m", 2.0 * ODDS))
    rows += [
        (f"sensor.{c}", "delay", f"{c.split('_')[0]} sensor late", "filtering and transport of the signal",
         "fast manoeuvres", "s", 2.0 * ODDS)
        for c in delays
    ] + [
        (f"sensor.{c}", "delay", f"{c.split('_')[0]} alone late", "filtered otherwise than the other channels of its sensor",
         "fast manoeuvres", "s", 4.0 * ODDS)
        for c in parts
    ]  # fmt: skip
    return [_effect(row) for row in rows]
