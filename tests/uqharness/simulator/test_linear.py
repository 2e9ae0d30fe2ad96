"""Names of modes: every eigenvalue once, for every arrangement of pairs and real roots."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.units import FT_M
from tests.helpers.few import few
from uqharness.cli.main import main
from uqharness.flight.handling import assess
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.linear import STATE_NAMES, linearise, modes, step_notes
from uqharness.simulator.trim import SteadyCondition, find_trim

AT = {name: k for k, name in enumerate(STATE_NAMES)}
V_MPS = 22.2
# A light aircraft at 22.2 m/s: derivatives in m, s, rad; short period, phugoid, dutch roll, roll
# and spiral are all conventional.
CONVENTIONAL = {
    "u": {"u": -0.26, "w": 0.4, "q": -0.3, "theta": -9.8},
    "v": {"v": -0.37, "p": 0.15, "r": -21.9, "phi": 9.8},
    "w": {"u": -0.82, "w": -4.2, "q": 22.2, "theta": -0.14},
    "p": {"v": -0.145, "p": -8.8, "r": 0.23},
    "q": {"u": 0.012, "w": -0.84, "q": -6.3},
    "r": {"v": 0.4, "p": -0.54, "r": -1.16},
    "phi": {"p": 1.0, "r": 0.015},
    "theta": {"q": 1.0},
}


def linear_model(**changes):
    """The conventional aircraft with some entries changed, as q_w=0.2 for the effect of w on q."""
    A = np.zeros((8, 8))
    for row, entries in CONVENTIONAL.items():
        for column, value in entries.items():
            A[AT[row], AT[column]] = value
    for key, value in changes.items():
        row, column = key.split("_")
        A[AT[row], AT[column]] = value
    return SimpleNamespace(A=A, trim=SimpleNamespace(condition=SimpleNamespace(V_mps=V_MPS)))


def roots(result):
    return np.sort_complex(
        [
            value
            for m in result
            for value in {complex(m["real"], m["imag"]), complex(m["real"], -m["imag"])}
        ]
    )


def names(result):
    return [mode.name for mode in result]


PAIRS = ["short_period", "phugoid"]
LATERAL = ["dutch_roll", "roll", "spiral"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, PAIRS + LATERAL),
        # Statically unstable: real, pair, real; four real roots; two real roots and the phugoid.
        ({"q_w": 0.5, "q_u": 0.0}, ["short_period", "phugoid", "third", *LATERAL]),
        ({"q_w": 0.1, "q_u": 0.0}, ["short_period"] * 2 + ["phugoid"] * 2 + LATERAL),
        ({"q_w": -0.04, "q_u": 0.012}, ["short_period"] * 2 + ["phugoid"] + LATERAL),
        # Directionally unstable, and roll joined with spiral, stable and unstable.
        ({"r_v": -0.4}, PAIRS + ["dutch_roll"] * 2 + ["roll", "spiral"]),
        ({"p_p": -0.3, "p_r": 0.0}, [*PAIRS, "dutch_roll", "other"]),
        ({"p_p": 0.0, "p_v": 0.1, "p_r": -2.0, "r_v": 0.1}, [*PAIRS, "dutch_roll", "other"]),
        # Unstable dutch roll.
        ({"r_r": 2.0}, PAIRS + LATERAL),
    ],
)
def test_every_arrangement_of_roots_has_its_names_and_each_root_once(changes, expected):
    model = linear_model(**changes)
    result = modes(model)
    assert names(result) == expected
    printed = roots([vars(m) for m in result])
    assert printed == pytest.approx(np.sort_complex(np.linalg.eigvals(model.A)), abs=1e-12)


@pytest.mark.parametrize(
    ("cm_alpha", "cm_q", "expected"), [(0.2, -13.8, "phugoid"), (1.0, -20.0, "phugoid")]
)
def test_the_divergence_of_an_unstable_aircraft_is_told(cm_alpha, cm_q, expected):
    properties = {"aero/Cm_alpha": cm_alpha, "aero/Cm_q": cm_q}
    aircraft = find_aircraft("espaaro")
    model = linearise(aircraft, find_trim(aircraft, SteadyCondition(22.2, properties=properties)))
    result = modes(model)
    largest = max(np.linalg.eigvals(model.A).real)
    unstable = max(result, key=lambda m: m.real)
    assert (unstable.name, unstable.real) == (expected, pytest.approx(largest))
    worst = max((a for a in assess(model, result) if a.mode == expected), key=lambda a: a.level)
    assert worst.value == pytest.approx(math.log(2.0) / largest)
    assert worst.level == (3 if worst.value >= 6.0 else 4)


STOCK = [("c172x", 55.0), ("SGS", 25.0), ("T38", 150.0), ("J3Cub", 30.0), ("x24b", 196.1)]


@pytest.mark.parametrize(("name", "speed"), few(STOCK, 1))
def test_the_command_prints_the_eigenvalues_of_stock_aircraft_each_once(name, speed, capsys):
    words = ["modes", name, "--speed-mps", str(speed), "--altitude-m", "1000", "--json"]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)["modes"]
    aircraft = find_aircraft(name)
    model = linearise(aircraft, find_trim(aircraft, SteadyCondition(speed, 1000.0)))
    assert roots(printed) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(model.A)), abs=1e-7, rel=1e-7
    )


def test_a_roll_too_fast_for_jsbsims_step_decays_in_jsbsim_as_the_note_says():
    aircraft = find_aircraft("minisgs")
    trim = find_trim(aircraft, SteadyCondition(17.5))
    fastest = min(modes(linearise(aircraft, trim)), key=lambda m: m.real)
    assert fastest.name == "roll"
    for dt_s in (0.002, 0.01):
        fdm = open_aircraft(aircraft, dt_s)
        for name, value in {
            "vt-fps": 17.5 / FT_M,
            "h-sl-ft": 3000.0,
            "alpha-deg": math.degrees(trim.alpha_rad),
            "gamma-deg": math.degrees(trim.theta_rad - trim.alpha_rad),
            "p-rad_sec": 0.2,
        }.items():
            fdm[f"ic/{name}"] = value
        fdm.run_ic()
        fdm.run()
        assert fdm["velocities/p-rad_sec"] / 0.2 == pytest.approx(
            1.0 + fastest.real * dt_s, abs=0.01
        )
    assert step_notes([fastest], 0.002) == []
    (note,) = step_notes([fastest], 0.01)
    assert "decays in 12 ms, but in 5.3 ms in steps of 10 ms" in note
    assert note.endswith("to 0.002")
    slow = replace(fastest, real=-20.5)
    (note,) = step_notes([slow], 0.01)
    assert note.endswith("to 0.005")
    assert step_notes([slow], 0.005) == []
