"""An aircraft in the middle of its envelope, with every axis in motion: what checks fly that know nothing of the aircraft."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from sysid.units import FT_M
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.forced_state import TRIM_LATITUDE_DEG, BodyState, body_velocity
from uqharness.simulator.staging import staged

_LIFT_COEFFICIENT = 0.5
_SPEEDS_FPS = (40.0, 900.0)
_ALTITUDE_FT = 5000.0
ALTITUDE_M = _ALTITUDE_FT * FT_M
THROTTLE = 0.6
_ALPHA, _BETA, _PHI, _THETA = (math.radians(angle) for angle in (4.0, 2.0, 5.0, 3.0))
_RATES_RADPS = (0.03, 0.02, -0.02)


def open_mid_envelope(
    aircraft: Aircraft, dt_s: float | None = None
) -> tuple[Any, Callable[[int], None]]:
    """An initialised instance in the middle of the aircraft's envelope, and a function that flies frame k.

    Level at 5000 ft above the sea, at the speed where a lift coefficient of 0.5 carries the weight (12 to 274 m/s), with a little
    incidence, sideslip and rotation; engines run settled at 60 % and the controls move, so that no axis is idle. Raises BadInputError.
    """
    state = mid_envelope_state(aircraft)
    speed_fps = math.hypot(state.u, state.v, state.w) / FT_M
    fdm = _open(aircraft, dt_s)
    _initial(fdm, speed_fps)
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        # A propeller that is let go at rest gives some electric aircraft a torque in the first frames that ends the flight.
        engine.start_engines(fdm)
        for k in range(engines):
            fdm["fcs/throttle-cmd-norm" + (f"[{k}]" if k else "")] = THROTTLE
    engine.run_ic(fdm)
    if engines:
        engine.settle_engines(fdm)
    dt = fdm.get_delta_t()
    surfaces = [
        (engine.handle(fdm, f"fcs/{name}-cmd-norm").set_double_value, 2.0 * math.pi * rate * dt)
        for name, rate in (("elevator", 0.5), ("aileron", 0.7), ("rudder", 0.3))
    ]

    def step(k: int) -> None:
        for put, phase in surfaces:
            put(0.05 * math.sin(phase * k))
        fdm.run()

    return fdm, step


def mid_envelope_state(aircraft: Aircraft) -> BodyState:
    """The state of `open_mid_envelope`. Raises BadInputError."""
    fdm = _open(aircraft, None)
    _initial(fdm, 150.0)
    engine.run_ic(fdm)
    weight, area, rho = (
        fdm[n] for n in ("inertia/weight-lbs", "metrics/Sw-sqft", "atmosphere/rho-slugs_ft3")
    )
    speed_fps = math.sqrt(2.0 * weight / (rho * max(area, 1e-3) * _LIFT_COEFFICIENT))
    V_mps = min(max(speed_fps, _SPEEDS_FPS[0]), _SPEEDS_FPS[1]) * FT_M
    return BodyState(*body_velocity(V_mps, _ALPHA, _BETA), _PHI, _THETA, 0.0, *_RATES_RADPS)


def _open(aircraft: Aircraft, dt_s: float | None) -> Any:
    return engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)


def _initial(fdm: Any, speed_fps: float) -> None:
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"] = TRIM_LATITUDE_DEG, _ALTITUDE_FT
    fdm["ic/theta-rad"], fdm["ic/phi-rad"] = _THETA, _PHI
    for name, value in zip("uvw", body_velocity(speed_fps, _ALPHA, _BETA), strict=True):
        fdm[f"ic/{name}-fps"] = value
    for name, value in zip("pqr", _RATES_RADPS, strict=True):
        fdm[f"ic/{name}-rad_sec"] = value
