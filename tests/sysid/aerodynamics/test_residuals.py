"""Residual coefficients of flights whose truth is known, with a model of three lines; noise by
closed form.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import COEFFICIENTS, MassProperties
from sysid.aerodynamics.residuals import (
    Cutoffs,
    Piece,
    Prediction,
    cut_pieces,
    residual_coefficients,
    steady_airspeed,
)
from sysid.record import FlightRecord
from tests.helpers.flown import fly
from tests.helpers.sixdof import Airframe, coefficients, thrust

AIRFRAME = Airframe()
NEEDED = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
KINDS = (("pitch-3211", 21.0), ("roll-yaw", 21.0))


def inertia(a: Airframe) -> np.ndarray:
    return np.array([[a.Ixx, 0.0, -a.Ixz], [0.0, a.Iyy, 0.0], [-a.Ixz, 0.0, a.Izz]])


def model_of(airframe: Airframe, increment: dict[str, float] | None = None):
    """The model of `sixdof`, less ``increment`` in each coefficient: its residual is the
    increment.
    """

    def predict(record: FlightRecord, piece: Piece) -> Prediction:
        rows = piece.rows
        get = {c: record[c][rows] for c in record.columns if c not in ("manoeuvre",)}
        V, rho = get["V_mps"], get["rho_kgpm3"]
        half = 0.5 / V
        u = np.column_stack([get[f"{s}_pos_deg"] for s in ("elevator", "aileron", "rudder")])
        hats = (
            get["p_radps"] * airframe.b * half,
            get["q_radps"] * airframe.c * half,
            get["r_radps"] * airframe.b * half,
        )
        at = zip(get["alpha_rad"], get["beta_rad"], *hats, u, strict=True)
        output = np.array([coefficients(airframe.coefficients, *values) for values in at])
        for name, value in (increment or {}).items():
            output[:, COEFFICIENTS.index(name)] -= value
        # Thrust by the command: in these manoeuvres the throttle, which lags, does not move.
        T = np.array([thrust(t, v, d) for t, v, d in zip(get["throttle_pct"], V, rho, strict=True)])
        force = np.column_stack([T, 0 * T, 0 * T])
        mass = MassProperties(airframe.m, inertia(airframe), airframe.S, airframe.b, airframe.c)
        return Prediction(
            output,
            force,
            np.zeros((len(V), 3)),
            0.5 * rho * V**2,
            mass,
            {"elevator_pos_deg": u[:, 0]},
        )

    return predict


@pytest.fixture(scope="module")
def flight_at_rest() -> FlightRecord:
    return fly(KINDS, seed=None)


def pieces_of(record: FlightRecord) -> list[Piece]:
    return cut_pieces(record, NEEDED)[0]


def test_a_model_that_is_the_truth_leaves_nothing(flight_at_rest):
    result = residual_coefficients(flight_at_rest, pieces_of(flight_at_rest), model_of(AIRFRAME))
    sizes = np.sqrt(np.mean(result.delta**2, axis=0))
    # The filter's own error across the sharp edges of servo moves; sensors' noise is a hundred
    # times larger.
    assert np.all(sizes < [5e-5, 1e-5, 2e-4, 5e-5, 3e-4, 3e-5])
    assert result.labels == ("pitch-3211", "roll-yaw")


@pytest.mark.parametrize("name", COEFFICIENTS)
def test_what_the_model_lacks_is_the_residual_with_its_sign(flight_at_rest, name):
    result = residual_coefficients(
        flight_at_rest, pieces_of(flight_at_rest), model_of(AIRFRAME, {name: 0.01})
    )
    k = COEFFICIENTS.index(name)
    assert np.mean(result.delta[:, k]) == pytest.approx(0.01, abs=3e-4)
    remaining = np.delete(np.abs(np.mean(result.delta, axis=0)), k)
    assert np.all(remaining < 3e-4)


def test_the_accelerometers_place_is_allowed_for(flight_at_rest):
    arm = np.array([0.4, -0.2, 0.1])
    rates = np.column_stack([flight_at_rest[f"{a}_radps"] for a in "pqr"])
    dots = np.gradient(rates, flight_at_rest.dt_s, axis=0)
    sensed = np.cross(dots, arm) + np.cross(rates, np.cross(rates, arm))
    offset = flight_at_rest.with_columns(
        {f"a{a}_mps2": flight_at_rest[f"a{a}_mps2"] + sensed[:, k] for k, a in enumerate("xyz")}
    )
    pieces = pieces_of(flight_at_rest)
    local = residual_coefficients(flight_at_rest, pieces, model_of(AIRFRAME)).delta
    present = residual_coefficients(offset, pieces, model_of(AIRFRAME), arm).delta
    ignored = residual_coefficients(offset, pieces, model_of(AIRFRAME)).delta
    size = np.sqrt(np.mean((present - local) ** 2, axis=0))
    invalid = np.sqrt(np.mean((ignored - local) ** 2, axis=0))
    assert np.all(size[:3] < 0.2 * invalid[:3])


def test_gaps_are_never_bridged(flight_at_rest):
    alpha = np.array(flight_at_rest["alpha_rad"])
    alpha[200:230] = np.nan
    airspeed = np.array(flight_at_rest["V_mps"])
    airspeed[700:720] = np.nan
    broken = flight_at_rest.with_columns({"alpha_rad": alpha, "V_mps": airspeed})
    result = residual_coefficients(broken, pieces_of(broken), model_of(AIRFRAME))
    assert np.isfinite(result.delta).all()
    times = np.concatenate([p.time_s for p in result.pieces])
    for gap in (flight_at_rest["time_s"][200:230], flight_at_rest["time_s"][700:720]):
        assert not np.any(
            (times > gap[0] - 2 * flight_at_rest.dt_s) & (times < gap[-1] + 2 * flight_at_rest.dt_s)
        )
    assert len(result.pieces) == 4


def test_the_airspeeds_low_pass_stops_at_gaps_and_keeps_slow_motion(flight_at_rest):
    time = flight_at_rest["time_s"]
    slow = 20.0 + np.sin(2 * np.pi * 0.1 * time)
    broken = slow.copy()
    broken[300:400] = np.nan
    broken[400:] += 30.0
    result = steady_airspeed(flight_at_rest.with_columns({"V_mps": broken}), 2.0)["V_mps"]
    assert np.isnan(result[300:400]).all()
    assert np.max(np.abs(result[10:290] - slow[10:290])) < 0.005
    assert np.max(np.abs(result[400:410] - broken[400:410])) < 0.05
    assert steady_airspeed(flight_at_rest, float("inf")) is flight_at_rest


def test_pieces_shorter_than_the_filter_are_refused(flight_at_rest):
    with pytest.raises(ValueError, match="raise the cut-off"):
        residual_coefficients(
            flight_at_rest,
            [Piece("x", slice(0, 20), 0.0, 0.4)],
            model_of(AIRFRAME),
            cutoffs=Cutoffs(0.2),
        )
