"""A fit that leaves a third of a channel's motion identifies nothing; one that leaves noise, or a
small term, does.
"""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.flown import fly
from uqharness.cli.main import main
from uqharness.identification.identify import unexplained, withdraw_invalid
from uqharness.identification.replay_fit import Identification

TIME = np.linspace(0.0, 8.0, 401)
Q = 0.3 * np.sin(2.0 * TIME)
RNG = np.random.default_rng(3)


def column(values):
    return [np.asarray(values)[:, None]]


@pytest.mark.parametrize(
    "remaining", [0.003 * RNG.standard_normal(401), 0.2 * Q, 0.02 * np.cos(9.0 * TIME)]
)
def test_noise_and_small_terms_leave_a_channel_explained(remaining):
    assert unexplained(column(remaining), column(Q), ["q_radps"], {"q_radps": 0.003}) == {}


def test_half_of_the_motion_left_is_unexplained_by_its_sigma_and_share():
    invalid = unexplained(column(0.5 * Q), column(Q), ["q_radps"], {"q_radps": 0.003})
    sigma, share = invalid["q_radps"]
    assert sigma == pytest.approx(0.5 * np.sqrt(np.mean(Q**2)) / 0.003)
    assert share == pytest.approx(0.25 * np.mean(Q**2) / np.var(Q))


def test_a_channel_that_hardly_moves_is_judged_by_a_sensor_s_noise_not_by_its_own_cleanness():
    tiny = 1e-5 * np.sin(TIME)
    assert unexplained(column(tiny), column(tiny), ["p_radps"], {"p_radps": 1e-8}) == {}


def test_dropouts_and_channels_without_samples_are_left_out():
    gaps = np.where(TIME < 4.0, np.nan, 0.5 * Q)
    assert set(unexplained(column(gaps), column(Q), ["q_radps"], {"q_radps": 0.003})) == {"q_radps"}
    empty = np.full(401, np.nan)
    assert unexplained(column(empty), column(empty), ["q_radps"], {"q_radps": float("nan")}) == {}


def find(residual):
    values = {f.name: None for f in dataclasses.fields(Identification)}
    inputs = SimpleNamespace(
        names=("aero/Cm_q", "aero/Cm_de"),
        initial=np.array([-9.7, -0.02]),
        theta=np.array([3.0, 1.0]),
        std=np.array([0.1, 0.1]),
        std_crb=np.array([0.1, 0.1]),
        status={"aero/Cm_q": "identified", "aero/Cm_de": "not-identified"},
        reason={"aero/Cm_q": "", "aero/Cm_de": "no effect"},
        cov=np.eye(1),
        residual=column(residual),
        measured=column(Q),
        outputs=("q_radps",),
        noise={"q_radps": 0.003},
        warnings=("another",),
        innovation_std={},
        converged=True,
    )
    return Identification(**(values | vars(inputs)))


def test_what_was_fitted_to_it_is_withdrawn_with_the_reason():
    fitted = find(0.5 * Q)
    retained = withdraw_invalid(fitted)
    assert retained.identified == ()
    assert retained.theta.tolist() == [-9.7, -0.02]
    assert np.isnan(retained.std).all()
    assert retained.cov.shape == (0, 0)
    assert "q_radps is 35 sigma" in retained.reason["aero/Cm_q"]
    assert retained.reason["aero/Cm_de"] == "no effect"
    assert "check units, signs" in retained.warnings[0]
    assert retained.warnings[1:] == ("another",)
    valid = find(0.003 * RNG.standard_normal(401))
    assert withdraw_invalid(valid) is valid


def test_innovations_in_turbulence_are_judged_by_what_gusts_predict():
    innovations = find(0.5 * Q)
    predicted = float(np.sqrt(np.mean((0.5 * Q) ** 2)))
    gusty = dataclasses.replace(innovations, innovation_std={"q_radps": predicted})
    assert withdraw_invalid(gusty) is gusty
    weak = dataclasses.replace(innovations, innovation_std={"q_radps": 0.05 * predicted})
    assert withdraw_invalid(weak).identified == ()


def test_a_fit_that_did_not_converge_has_no_estimates_and_no_standard_errors():
    valid = find(0.003 * RNG.standard_normal(401))
    stopped = withdraw_invalid(dataclasses.replace(valid, converged=False))
    assert stopped.identified == ()
    assert stopped.theta.tolist() == [-9.7, -0.02]
    assert np.isnan(stopped.std).all()
    assert "not converged" in stopped.reason["aero/Cm_q"]
    assert stopped.reason["aero/Cm_de"] == "no effect"


def test_a_flight_with_reversed_elevator_identifies_nothing(tmp_path, capsys):
    flight = fly((("pitch-doublet", 22.0),), seed=4, seconds=6.5)
    invalid = flight.with_columns(
        {c: -flight[c] for c in ("elevator_deg", "elevator_pos_deg") if c in flight}
    )
    invalid.write(tmp_path / "flight.parquet")
    words = [
        "identify",
        "espaaro",
        "--flight",
        str(tmp_path / "flight.parquet"),
        "--params",
        "aero/CZ_0,aero/CX_0",
    ]
    assert main([*words, "--out", str(tmp_path / "out"), "--workers", "1", "--no-figures"]) == 1
    fit = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert fit["names"] == []
    assert fit["parameters"]["aero/CZ_0"]["value"] == fit["parameters"]["aero/CZ_0"]["initial"]
    assert "does not explain the flights" in fit["parameters"]["aero/CZ_0"]["reason"]
