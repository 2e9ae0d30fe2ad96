"""Performance: a parabolic polar has closed forms; an aircraft's sheet agrees with its trims."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from uqharness.authoring.performance import Polar, performance, sheet
from uqharness.cli.main import main
from uqharness.simulator import SteadyCondition, find_aircraft, find_trim

W, S, RHO, CD0, K = 20.0, 0.35, 1.225, 0.03, 0.05
CL_MAX = 1.2


@pytest.fixture(scope="module")
def parabola():
    cl = np.linspace(0.0, CL_MAX, 24001)
    polar = Polar(cl / 5.0, cl, CD0 + K * cl**2)
    # Thrust is constant: level speeds and turns have closed forms as well.
    return sheet(polar, W, S, RHO, np.array([0.0, 60.0]), np.array([6.0, 6.0])).figures


def speed_at(cl):
    return math.sqrt(2 * W / (RHO * S * cl))


def test_glide(parabola):
    cl_best = math.sqrt(CD0 / K)
    assert parabola["stall_speed"] == pytest.approx(speed_at(CL_MAX), rel=1e-4)
    assert parabola["best_glide_ratio"] == pytest.approx(1 / (2 * math.sqrt(CD0 * K)), rel=1e-6)
    assert parabola["best_glide_speed"] == pytest.approx(speed_at(cl_best), rel=1e-3)
    # Least sink at sqrt(3) times the lift of the best glide; here that is below the stall's.
    cl_sink = math.sqrt(3.0) * cl_best
    assert cl_sink > CL_MAX
    assert parabola["least_sink_speed"] == pytest.approx(speed_at(CL_MAX), rel=1e-4)


def test_least_sink_of_a_draggy_polar():
    cl = np.linspace(0.0, 1.5, 24001)
    polar = Polar(cl / 5.0, cl, 0.01 + 0.05 * cl**2)
    figures = sheet(polar, W, S, RHO, np.array([0.0, 60.0]), np.zeros(2)).figures
    cl_sink = math.sqrt(3.0 * 0.01 / 0.05)
    assert figures["least_sink_speed"] == pytest.approx(speed_at(cl_sink), rel=1e-3)
    sink = speed_at(cl_sink) * 4.0 * 0.01 / cl_sink
    assert figures["least_sink_rate"] == pytest.approx(sink, rel=1e-5)
    assert math.isnan(figures["climb_rate"])


def test_greatest_speed_and_turn(parabola):
    # T = q S CD0 + K W^2/(q S)
    thrust = 6.0
    q = (thrust + math.sqrt(thrust**2 - 4 * CD0 * K * W**2)) / (2 * S * CD0)
    assert parabola["greatest_speed"] == pytest.approx(math.sqrt(2 * q / RHO), rel=1e-3)
    # Fastest turn: load n = (q S/W) sqrt((T/(q S) - CD0)/K), limited by the stall.
    speeds = np.linspace(speed_at(CL_MAX), 60.0, 20001)
    pressure = 0.5 * RHO * speeds**2 * S
    cl = np.minimum(np.sqrt(np.maximum(thrust / pressure - CD0, 0.0) / K), CL_MAX)
    load = cl * pressure / W
    rate = np.degrees(9.80665 * np.sqrt(np.maximum(load**2 - 1, 0.0)) / speeds)
    assert parabola["turn_rate"] == pytest.approx(rate.max(), rel=2e-3)


def test_climb(parabola):
    # Climb = V (T - D)/W on the parabola, maximised over speed.
    speeds = np.linspace(speed_at(CL_MAX), 60.0, 20001)
    pressure = 0.5 * RHO * speeds**2 * S
    climb = speeds * (6.0 - pressure * CD0 - K * W**2 / pressure) / W
    assert parabola["climb_rate"] == pytest.approx(climb.max(), rel=1e-4)


def test_sheet_of_an_aircraft_agrees_with_its_trims():
    aircraft = find_aircraft("espaaro")
    result = performance(aircraft, altitude_m=100.0, with_bounds=False)
    row = min(result.nominal.rows, key=lambda r: abs(r["V_mps"] - 24.0))
    trim = find_trim(aircraft, SteadyCondition(row["V_mps"], 100.0))
    assert trim.converged
    # Thrust carries part of the weight and is not along the path: some percent.
    assert row["drag_N"] == pytest.approx(trim.thrust_N * math.cos(trim.alpha_rad), rel=0.06)
    assert row["alpha_deg"] == pytest.approx(math.degrees(trim.alpha_rad), abs=0.6)
    assert result.nominal.figures["ceiling"] > 1000.0


def test_command_has_intervals(capsys):
    assert main(["performance", "espaaro", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    low, high = figures["best_glide_ratio"]["interval"]
    assert low < figures["best_glide_ratio"]["value"] < high
    assert figures["stall_speed"]["unit"] == "m/s"
