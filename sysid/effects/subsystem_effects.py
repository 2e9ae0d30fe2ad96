"""Candidate effects that are no coefficient term: stall, ground, propulsion, mass, actuators, sensors."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.effects.catalogue import JATEGAONKAR, Effect
from sysid.effects.tuned import ODDS

_POSITIVE = ("delay", "lag", "deadband", "rate_limit", "separation", "dynamic")
_WIND = ("V_mps", "alpha_rad", "beta_rad")
# subsystem, term, name, physics, regime, unit
_AIRCRAFT = (
    (
        "stall",
        "separation",
        "lift lost by separation",
        "flow separates from the trailing edge at high angle of attack",
        "high angle of attack",
        "1",
    ),
    (
        "stall",
        "dynamic",
        "lift lost by separation that lags",
        "separation follows angle of attack late (eq 2.40)",
        "fast changes at high angle of attack",
        "1",
    ),
    (
        "ground",
        "lift",
        "lift gained near the ground",
        "the ground holds up the wing's downwash: normal force grows by a share that falls off as exp(-2 h/b)",
        "low height",
        "1",
    ),
    (
        "propulsion",
        "thrust_scale",
        "thrust off by a factor",
        "propeller or battery give more or less than the map",
        "throttle changes",
        "1",
    ),
    (
        "propulsion",
        "inflow",
        "inflow at the propeller off by a factor",
        "the propeller meets the air faster or slower than the map has it",
        "throttle and speed changes",
        "1",
    ),
    (
        "propulsion",
        "airspeed",
        "thrust off by a factor that goes with airspeed",
        "propeller and motor are matched at another speed",
        "throttle and speed changes",
        "1",
    ),
    (
        "propulsion",
        "torque",
        "propeller torque",
        "the motor's reaction rolls the aircraft against the propeller",
        "throttle changes",
        "1",
    ),
    (
        "propulsion",
        "p_factor",
        "p-factor",
        "the descending blade sees more angle of attack: yaw with alpha, pitch with beta",
        "throttle at angle of attack",
        "1",
    ),
    (
        "propulsion",
        "slipstream",
        "slipstream over the tail",
        "tail surfaces act in more dynamic pressure as thrust grows",
        "elevator and rudder at different power",
        "1",
    ),
    (
        "mass",
        "cg_x",
        "centre of gravity further forward",
        "the moments are about another point",
        "all manoeuvres",
        "m",
    ),
    (
        "mass",
        "Ixz",
        "product of inertia Ixz off",
        "roll and yaw accelerations are coupled, and pitch with roll rate squared",
        "aileron and rudder doublets",
        "kg m^2",
    ),
)


def _effect(
    subsystem: str, term: str, name: str, physics: str, regime: str, unit: str, odds: float = ODDS
) -> Effect:
    return Effect(
        None, subsystem, term, name, physics, regime, "", JATEGAONKAR, unit, odds, term in _POSITIVE
    )


def subsystem_effects(
    surfaces: Sequence[str],
    channels: Sequence[str],
    delays: Sequence[str],
    parts: Sequence[str] = (),
) -> list[Effect]:
    """Effects that are no coefficient term, for the surfaces, measured channels and sensors (for delays) at hand.

    parts: channels of a sensor with several, whose filter may be another than the others'.
    """
    found = [_effect(*row) for row in _AIRCRAFT]
    for s in surfaces:
        servo = f"actuator.{s}"
        found += [
            _effect(
                servo,
                "lag",
                f"{s} servo's lag other than modelled",
                "first-order lag of the servo",
                f"{s} steps",
                "s",
            ),
            _effect(
                servo,
                "deadband",
                f"{s} servo with a deadband",
                "small commands do not move the surface",
                f"small {s} commands",
                "deg",
            ),
            _effect(
                servo,
                "rate_limit",
                f"{s} servo's rate limit other than modelled",
                "the servo's speed is limited",
                f"large {s} steps",
                "s/deg",
            ),
        ]
    any_, abrupt, twice = "all manoeuvres", "abrupt manoeuvres", 2.0 * ODDS
    for c in channels:
        short, unit = c.split("_")
        physics = "position error or upwash at the sensor" if c in _WIND else "calibration"
        found.append(
            _effect(
                f"sensor.{c}", "scale", f"{short} sensor's scale off", physics, any_, "1", twice
            )
        )
        if short not in ("p", "q", "r"):
            physics = "calibration or misalignment"
            found.append(
                _effect(
                    f"sensor.{c}", "bias", f"{short} sensor's zero off", physics, any_, unit, twice
                )
            )
    if {"ax_mps2", "ay_mps2", "az_mps2"} & set(channels):
        physics = "they feel the rotation about the CG"
        found += [
            _effect(
                "sensor.accelerometer",
                f"place_{axis}",
                f"accelerometers further {way}",
                physics,
                abrupt,
                "m",
                twice,
            )
            for axis, way in (("x", "forward"), ("y", "right"), ("z", "down"))
        ]
    if {"V_mps", "q_radps", "r_radps"} <= set(channels) and {"alpha_rad", "beta_rad"} & set(
        channels
    ):
        physics = "they move with pitch and yaw rate"
        found.append(
            _effect(
                "sensor.vane", "place_x", "wind vanes further forward", physics, abrupt, "m", twice
            )
        )
    late = [(c, "sensor late", "filtering and transport of the signal", twice) for c in delays]
    late += [
        (c, "alone late", "filtered otherwise than the other channels of its sensor", 2.0 * twice)
        for c in parts
    ]
    return found + [
        _effect(
            f"sensor.{c}",
            "delay",
            f"{c.split('_')[0]} {name}",
            physics,
            "fast manoeuvres",
            "s",
            odds,
        )
        for c, name, physics, odds in late
    ]
