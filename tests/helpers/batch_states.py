"""One frame from a copied state: JSBSim is flown a few frames with random forces, its state put
into slots, both go on by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tests.helpers.batch_flights import START, aircraft, apart, craft, flown, translated
from uqharness.batch.motion import WEIGHTS_PARTS, slots
from uqharness.batch.program import Feed
from uqharness.simulator import engine

INPUTS = (
    "i/x",
    "i/y",
    "i/z",
    "i/l",
    "i/m",
    "i/n",
    "atmosphere/wind-north-fps",
    "atmosphere/wind-east-fps",
    "atmosphere/gust-down-fps",
)
BODY = f"""<system name="host">{"".join(f"<property>{name}</property>" for name in INPUTS[:6])}</system>
<aerodynamics>
 <function name="aero/old"><product><property>aero/alphadot-rad_sec</property><property>aero/bi2vel</property></product></function>
 <axis name="X"><function name="aero/fx"><sum><property>i/x</property>
  <product><property>aero/qbar-psf</property><value>-.3</value></product></sum></function></axis>
 <axis name="Y"><function name="aero/fy"><sum><property>i/y</property>
  <product><property>aero/qbar-psf</property><property>aero/beta-rad</property><value>-6</value></product></sum></function></axis>
 <axis name="Z"><function name="aero/fz"><sum><property>i/z</property><property>aero/old</property></sum></function>
  <function name="aero/at" apply_at_cg="true">
  <product><property>aero/alpha-rad</property><value>2</value></product></function></axis>
 <axis name="ROLL"><function name="aero/l"><property>i/l</property></function></axis>
 <axis name="PITCH"><function name="aero/m"><sum><property>i/m</property>
  <product><property>velocities/q-aero-rad_sec</property><value>-3</value></product></sum></function></axis>
 <axis name="YAW"><function name="aero/n"><property>i/n</property></function></axis>
</aerodynamics>"""
RECORDS = (
    *(f"position/{f}-{a}-ft" for f in ("eci", "ecef") for a in "xyz"),
    *(f"velocities/eci-{a}-fps" for a in "xyz"),
    "position/h-sl-ft",
    "position/geod-alt-ft",
    "position/h-agl-ft",
    "position/lat-geod-rad",
    "position/long-gc-rad",
    "position/radius-to-vehicle-ft",
    "inertial/sea-level-radius_ft",
    *(f"velocities/{a}-fps" for a in "uvw"),
    *(f"velocities/v-{a}-fps" for a in ("north", "east", "down")),
    *(f"velocities/{a}-rad_sec" for a in "pqr"),
    *(f"velocities/{a}i-rad_sec" for a in "pqr"),
    *(f"attitude/{a}-rad" for a in ("phi", "theta", "psi")),
    *(f"velocities/{a}dot-rad_sec" for a in ("phi", "theta", "psi")),
    "atmosphere/T-R",
    "atmosphere/P-psf",
    "atmosphere/rho-slugs_ft3",
    "atmosphere/a-fps",
    "velocities/vt-fps",
    "velocities/mach",
    "velocities/ve-fps",
    "velocities/vg-fps",
    "aero/qbar-psf",
    "aero/alpha-rad",
    "aero/beta-rad",
    "aero/alphadot-rad_sec",
    "aero/betadot-rad_sec",
    "aero/bi2vel",
    "aero/ci2vel",
    "flight-path/gamma-rad",
    "flight-path/psi-gt-rad",
    *(f"forces/fb{a}-total-lbs" for a in "xyz"),
    *(f"moments/{a}-total-lbsft" for a in "lmn"),
    *(f"accelerations/{a}dot-ft_sec2" for a in "uvw"),
    *(f"accelerations/{a}dot-rad_sec2" for a in "pqr"),
    *(f"accelerations/{a}idot-rad_sec2" for a in "pqr"),
    "accelerations/gravity-ft_sec2",
    *(f"accelerations/{a}" for a in ("Nx", "Ny", "Nz")),
    *(f"accelerations/a-pilot-{a}-ft_sec2" for a in "xyz"),
)
INTEGRATOR = "simulation/integrator/{}/{}"
STATES: Mapping[str, Mapping[str, float]] = {
    "rapid roll": {
        "ic/p-rad_sec": 6.0,
        "ic/q-rad_sec": -1.0,
        "ic/r-rad_sec": 0.5,
        "ic/lat-geod-rad": 0.8,
    },
    "60 degrees north, high": {
        "ic/lat-geod-rad": 1.05,
        "ic/h-sl-ft": 30000.0,
        "ic/u-fps": 400.0,
        "ic/phi-rad": 1.2,
    },
    "southern hemisphere, reversed": {
        "ic/lat-geod-rad": -0.6,
        "ic/long-gc-rad": -2.5,
        "ic/psi-true-rad": 4.5,
        "ic/v-fps": 20.0,
    },
    "nearly vertical": {"ic/theta-rad": 1.5607, "ic/w-fps": 8.0, "ic/lat-geod-rad": 0.1},
    "slow, tumbling": {
        "ic/u-fps": 5.0,
        "ic/w-fps": 30.0,
        "ic/q-rad_sec": 2.0,
        "ic/theta-rad": -1.0,
    },
}
"""Starts beside ``START``."""
_BACK = 5


def _turn(axis: int, angle: float) -> np.ndarray:
    q = np.zeros(4)
    q[0], q[axis] = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return q


def _after(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array(
        [a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))]
    )


def attitude(fdm: Any) -> np.ndarray:
    """The quaternion from inertial to body axes, from JSBSim's angles: about z, y and x in turn."""
    q = _turn(3, fdm["position/epa-rad"] + fdm["position/long-gc-rad"])
    q = _after(q, _turn(2, -(fdm["position/lat-geod-rad"] + 0.5 * np.pi)))
    for axis, name in ((3, "psi"), (2, "theta"), (1, "phi")):
        q = _after(q, _turn(axis, fdm[f"attitude/{name}-rad"]))
    return q


def _row(fdm: Any, names: Sequence[str]) -> np.ndarray:
    return np.array([fdm[name] for name in names])


def derivatives(fdm: Any) -> dict[str, np.ndarray]:
    """What moves each part of the state on, read from JSBSim."""
    q, rates = attitude(fdm), _row(fdm, [f"velocities/{a}i-rad_sec" for a in "pqr"])
    return {
        "attitude": 0.5 * _after(q, np.array([0.0, *rates])),
        "rates": _row(fdm, [f"accelerations/{a}idot-rad_sec2" for a in "pqr"]),
        "position": _row(fdm, [f"velocities/eci-{a}-fps" for a in "xyz"]),
        "velocity": _row(fdm, [f"accelerations/{a}idot-ft_sec2" for a in "uvw"]),
    }


def state(fdm: Any) -> dict[str, np.ndarray]:
    """The parts of the state."""
    return {
        "attitude": attitude(fdm),
        "rates": _row(fdm, [f"velocities/{a}i-rad_sec" for a in "pqr"]),
        "position": _row(fdm, [f"position/eci-{a}-ft" for a in "xyz"]),
        "velocity": _row(fdm, [f"velocities/eci-{a}-fps" for a in "xyz"]),
    }


def integrators(rotation: int, translation: int, attitude: int, position: int) -> dict[str, float]:
    """JSBSim's settings of the four."""
    numbers = {
        ("rate", "rotational"): rotation,
        ("rate", "translational"): translation,
        ("position", "rotational"): attitude,
        ("position", "translational"): position,
    }
    return {INTEGRATOR.format(*key): float(number) for key, number in numbers.items()}


def one_frame(
    start: Mapping[str, float], seed: int = 0, changed: str | None = None, late_wind: bool = False
) -> dict[str, float]:
    """Differences of one frame from a copied state. ``changed`` is the aircraft that is translated,
    ``late_wind`` has it meet the wind of the frame before: for negative controls."""
    rng = np.random.default_rng(seed)
    text, start = aircraft(BODY), {**START, **start}
    scale = np.array([5.0, 5.0, 20.0, 3.0, 3.0, 3.0, 30.0, 30.0, 10.0])
    rows = rng.normal(size=(_BACK + 2, len(INPUTS))) * scale
    with craft(text, start) as result:
        fdm = result.open()
        engine.run_ic(fdm)
        nodes = [engine.handle(fdm, name) for name in INPUTS]
        history = []
        for row in rows[:-1]:
            for node, value in zip(nodes, row, strict=True):
                node.set_double_value(float(value))
            fdm.run()
            history.append(derivatives(fdm))
        constant = {
            f"#{name}": [v]
            for part, values in state(fdm).items()
            for name, v in zip(slots(part), values, strict=True)
        }
        for part in WEIGHTS_PARTS:
            for back in range(4):
                values = history[-1 - back][part]
                constant |= {
                    f"#{name}": [v] for name, v in zip(slots(part, back), values, strict=True)
                }
        constant["#earth/angle"] = [fdm["position/epa-rad"]]
        transported = {
            name: fdm[name]
            for name in RECORDS
            if name.startswith(("accelerations/", "velocities/", "aero/"))
        }
        total = _row(fdm, [f"forces/fb{a}-total-lbs" for a in "xyz"]) / fdm["inertia/mass-slugs"]
        constant |= {f"#body-acceleration/{k}": [value] for k, value in enumerate(total)}
        for node, value in zip(nodes, rows[-1], strict=True):
            node.set_double_value(float(value))
        fdm.run()
        theirs = {name: np.array([fdm[name]]) for name in RECORDS}
    with craft(changed or text, start) as result:
        flight = translated(result, RECORDS, INPUTS)
        values = {
            name: np.array(value) for name, value in constant.items() if name in flight.frame.slots
        }
        values |= {
            name: np.array([value])
            for name, value in transported.items()
            if name in flight.frame.slots
        }
        fed = np.where(
            np.array([late_wind and name.startswith("atmosphere/") for name in INPUTS]),
            rows[-2],
            rows[-1],
        )
        feed = Feed(np.ascontiguousarray(fed[None, :]), 0, np.zeros(1, dtype=np.int64))
        _, records = flown(flight.frame, values, 1, {"inputs": feed})
    return apart(theirs, dict(zip(RECORDS, records, strict=True)), floor=1e-2)
