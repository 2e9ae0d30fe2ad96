"""An aircraft in the middle of its envelope, with every axis in motion: what checks fly that know nothing of the aircraft."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.staging import staged

_LIFT_COEFFICIENT = 0.5
_SPEEDS_FPS = (40.0, 900.0)
_ALTITUDE_FT = 5000.0


def open_mid_envelope(
    aircraft: Aircraft, dt_s: float | None = None
) -> tuple[Any, Callable[[int], None]]:
    """An initialised instance in the middle of the aircraft's envelope, and a function that flies frame k.

    Level at 5000 ft above the sea, at the speed where a lift coefficient of 0.5 carries the weight (12 to 274 m/s), with a little
    incidence, sideslip and rotation; engines run at 60 % and the controls move, so that no axis is idle. Raises BadInputError.
    """
    fdm = _open(aircraft, dt_s)
    _initial(fdm, 150.0)
    engine.run_ic(fdm)
    weight, area, rho = (
        fdm[n] for n in ("inertia/weight-lbs", "metrics/Sw-sqft", "atmosphere/rho-slugs_ft3")
    )
    fdm = _open(aircraft, dt_s)
    speed = math.sqrt(2.0 * weight / (rho * max(area, 1e-3) * _LIFT_COEFFICIENT))
    _initial(fdm, min(max(speed, _SPEEDS_FPS[0]), _SPEEDS_FPS[1]))
    manager = fdm.get_property_manager()
    for k in range(fdm.get_propulsion().get_num_engines()):
        index = f"[{k}]" if k else ""
        for name, value in (("throttle", 0.6), ("mixture", 0.9), ("advance", 1.0)):
            if manager.hasNode(f"fcs/{name}-cmd-norm{index}"):
                fdm[f"fcs/{name}-cmd-norm{index}"] = value
    engine.run_ic(fdm)
    if fdm.get_propulsion().get_num_engines():
        fdm["propulsion/set-running"] = -1
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


def _open(aircraft: Aircraft, dt_s: float | None) -> Any:
    return engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)


def _initial(fdm: Any, speed_fps: float) -> None:
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/theta-deg"], fdm["ic/phi-deg"] = (
        45.0,
        _ALTITUDE_FT,
        3.0,
        5.0,
    )
    alpha, beta = math.radians(4.0), math.radians(2.0)
    fdm["ic/u-fps"] = speed_fps * math.cos(alpha) * math.cos(beta)
    fdm["ic/v-fps"] = speed_fps * math.sin(beta)
    fdm["ic/w-fps"] = speed_fps * math.sin(alpha) * math.cos(beta)
    fdm["ic/p-rad_sec"], fdm["ic/q-rad_sec"], fdm["ic/r-rad_sec"] = 0.03, 0.02, -0.02
