"""PX4's simulation in hardware, written a second time after aero.hpp and sih.cpp: one plate and one
state after the other.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.helpers.places import ROOT
from tests.uqharness.exchange.test_formats import REFERENCE, rows, states
from uqharness.cli import main as cli
from uqharness.exchange import px4_sih

WING = 0.86 * 0.21
KEYS = {"SIH_MASS": 0.7, "SIH_KDV": 0.13, "SIH_KDW": 0.02}
# Span, chord, zero-lift angle [deg], place, dihedral [deg], aspect ratio, flap, propeller radius.
PLATES = (
    (0.43, 0.21, -4.0, (0.0, -0.215, 0.0), 3.0, 0.86 / 0.21, 0.07, -1.0),
    (0.43, 0.21, -4.0, (0.0, 0.215, 0.0), -3.0, 0.86 / 0.21, 0.07, -1.0),
    (0.3, 0.1, 0.0, (-0.4, 0.0, 0.0), 0.0, 3.0, 0.05, 0.1),
    (0.25, 0.18, 0.0, (-0.45, 0.0, -0.1), -90.0, 0.25 / 0.18, 0.12, 0.1),
    (0.2, 0.8, 0.0, (0.0, 0.0, 0.0), -90.0, 0.25, 0.0, -1.0),
)


def newton(kp: float, dcl: float, a: float) -> float:
    kv = math.pi
    for _ in range(3):
        s, c = math.sin(a), math.cos(a)
        sign = (s > 1.1920929e-7) - (s < 1.1920929e-7)
        value = -kp * s * c * c - kv * abs(s) * s * c - dcl
        slope = kv * abs(s) * s * s - kv * abs(s) * c * c - kp * c**3
        slope += 2 * kp * c * s * s - kv * sign * c * c * s
        a -= value / slope
    return a


def plate(of: tuple[Any, ...], v: Any, w: Any, rho: float, flap: float, thrust: float) -> Any:
    span, mac, zero, place, dihedral, ar, cf, radius = of
    zero, angle = math.radians(zero), math.radians(dihedral)
    down = np.array([0.0, -math.sin(angle), math.cos(angle)])
    local = v + np.cross(w, place)
    vx, vz = local[0], local @ down
    if radius > 1e-4:
        vx += math.sqrt(2 * thrust / (rho * math.pi * radius**2))
    alpha = math.atan2(vz, vx) - zero
    kp = 2 * math.pi / (1 + 2 * (ar + 4) / (ar * (ar + 2)))
    kn = 0.41 * (1 - math.exp(-17 / ar))
    size = min(abs(flap), math.radians(70))
    eta = size * size * 0.0535 - 0.2688 * size + 0.5817
    theta = math.acos(2 * cf / mac - 1)
    dcl = kp * (1 - (theta - math.sin(theta)) / math.pi) * eta * flap

    def lift(a: float) -> float:
        s, c = math.sin(a), math.cos(a)
        return kp * s * c * c + math.pi * abs(s) * s * c

    stall = math.radians(20)
    base = newton(kp, dcl, zero)
    a = alpha - base
    maximum = base - newton(kp, lift(stall - zero) + (1 - cf / mac) * dcl, stall - zero)
    minimum = base - newton(kp, lift(-stall - zero) + (1 - cf / mac) * dcl, -stall - zero)
    chord = math.sqrt((mac - cf) ** 2 + cf**2 + 2 * (mac - cf) * cf * math.cos(abs(flap)))
    curved = a + math.asin(cf / chord * math.sin(flap))
    cn = (1.98 + 0.21 * flap - 0.0426 * flap**2) * math.sin(curved)
    cn *= 1 / (0.56 + 0.44 * math.sin(abs(curved))) - kn
    ct = 0.5 * 0.04 * math.cos(curved)
    cl, cd = (
        cn * math.cos(curved) - ct * math.sin(curved),
        cn * math.sin(curved) + ct * math.cos(curved),
    )
    cm = -cn * (0.25 - 7 / 40 * (1 - 2 / math.pi * abs(curved)))
    if a > 0:
        f = 0.5 * (1 - math.tanh(4 * (a - maximum) / math.radians(10)))
    else:
        f = 0.5 * (1 - math.tanh(-4 * (a - minimum) / math.radians(10)))
    cd = (0.04 + abs(cl * math.tan(a))) * f + cd * (1 - f)
    cl = lift(a) * f + cl * (1 - f)
    cm = -0.17 * math.pi * abs(math.sin(a)) * math.sin(a) * f + cm * (1 - f)
    q = 0.5 * rho * (vx * vx + vz * vz) * span * mac
    force = q * np.array([cl * math.sin(alpha) - cd * math.cos(alpha), 0.0, 0.0])
    force += q * (-cl * math.cos(alpha) - cd * math.sin(alpha)) * down
    right = np.array([0.0, math.cos(angle), math.sin(angle)])
    return force, q * mac * cm * right + np.cross(place, force)


def by_sih(V: float, x: dict[str, float], thrust: float, altitude: float) -> list[float]:
    v = V * np.array(
        [
            math.cos(x["alpha"]) * math.cos(x["beta"]),
            math.sin(x["beta"]),
            math.sin(x["alpha"]) * math.cos(x["beta"]),
        ]
    )
    w = 2 * V * np.array([x["p"] / 2.1, x["q"] / 0.36, x["r"] / 2.1])
    temperature = 288.15 - 0.0065 * altitude
    rho = 101325 * (1 - 0.0065 * altitude / 288.15) ** 5.2561 / 287.04 / temperature
    roll, pitch, yaw = x["da"] / 20.0, -x["de"] / 24.0, -x["dr"] / 28.0
    full = math.pi / 12
    force, moment = -KEYS["SIH_KDV"] * v, -KEYS["SIH_KDW"] * w
    for of, flap in zip(PLATES, (roll, -roll, -pitch, yaw, 0.0), strict=True):
        f, m = plate(of, v, w, rho, flap * full, thrust)
        force, moment = force + f, moment + m
    q = 0.5 * rho * V * V * WING
    return [*(force / q), *(moment / q / np.array([0.86, 0.21, 0.86]))]


def source(thrust_N: float = 3.0) -> Any:
    trim = SimpleNamespace(condition=SimpleNamespace(V_mps=20.0, altitude_m=200.0))
    return SimpleNamespace(trim=trim, reference=REFERENCE, thrust=lambda: (thrust_N, 0.0))


@pytest.mark.parametrize("thrust_N", [0.0, 40.0])
def test_the_programs_equations(thrust_N: float) -> None:
    of = states(500, 7)
    of.values["alpha"][:100] *= 4.0  # beyond the stall, too
    thrust = thrust_N * 0.7 / REFERENCE.mass_kg
    expected = [by_sih(V, x, thrust, 200.0) for V, x in rows(of)]
    computed = px4_sih.coefficients(KEYS, source(thrust_N), of)
    assert computed == pytest.approx(np.array(expected), rel=1e-11, abs=1e-11)


def test_commands_turn_the_program_the_right_way() -> None:
    at_rest = states(1)
    for value in at_rest.values.values():
        value[:] = 0.0
    plain = px4_sih.coefficients(KEYS, source(), at_rest)[0]
    # Right wing down, nose down and nose left, as the source's deflections do.
    for name, k, sign in (("da", 3, 1.0), ("de", 4, -1.0), ("dr", 5, -1.0)):
        at_rest.values[name][:] = 5.0
        assert sign * (px4_sih.coefficients(KEYS, source(), at_rest)[0] - plain)[k] > 1e-3
        at_rest.values[name][:] = 0.0


def test_parameters_of_an_aircraft(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    form = ROOT / "tests/fuzz/corpus/results/bounds/model-form.json"
    words = ["export", "espaaro", "--to", "px4-sih", "--out", str(tmp_path), "--states", "100"]
    words += ["--speed-mps", "22.2", "--bounds", str(form)]
    assert cli.main(words) == 1
    assert "Beyond the half-width of the bounds: CX" in capsys.readouterr().out
    assert not list(tmp_path.glob("*.params"))
    assert cli.main([*words, "--accept-loss"]) == 1
    lines = (tmp_path / "espaaro.params").read_text().splitlines()
    cells = [line.split("\t") for line in lines if not line.startswith("#")]
    values = {name: float(value) for _, _, name, value, _ in cells}
    assert [row[2] for row in cells if row[4] == "6"] == ["SIH_VEHICLE_TYPE"]
    share = WING / 1.97
    assert values["SIH_MASS"] == pytest.approx(21.34 * share, rel=1e-3)
    # Pitching by the chord, rolling and yawing by the span: q S c / Iyy stays.
    assert values["SIH_IYY"] == pytest.approx(8.26 * share * 0.21 / 0.53, rel=0.01)
    assert values["SIH_KDW"] > 0.0
    assert np.float32(values["SIH_MASS"]) == values["SIH_MASS"]
