"""Identification in turbulence: filter error takes over, only where the air moves, and its
intervals hold the truth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import uqharness as uq
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.airframes import write_aircraft
from tests.hidden_effects.cases import perturbed
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card

TRUTH = perturbed(Airframe(), np.random.default_rng(5))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An aircraft whose coefficients are 15 % off, and flights of the true one by independent
    equations: two in turbulence.
    """
    place = tmp_path_factory.mktemp("turbulence")
    write_aircraft("espaaro", Airframe(), place)
    request = [
        card(7, 21.0, seconds=30.0, w20_kt=12.0),
        card(8, 24.0, seconds=30.0, w20_kt=12.0, first=4),
        card(9, 22.0, seconds=25.0),
    ]
    for k, record in enumerate(fly([Flight(c, TRUTH) for c in request])):
        record.write(place / f"flight-{k}.parquet")
    return place


def truth_of(result: uq.Identification) -> np.ndarray:
    return np.array([TRUTH.coefficients[n.removeprefix("aero/")] for n in result.names])


@pytest.mark.slow
def test_intervals_hold_the_truth_and_predictions_are_white(folder: Path):
    """A filter that took gusts otherwise than they act, and controls to act at their rows, was
    twenty standard errors off.
    """
    result = uq.identify(
        folder / "espaaro", [folder / "flight-0.parquet", folder / "flight-1.parquet"], workers=1
    )
    assert (result.method, result.converged) == ("filter error", True)
    reference = np.array([result.status[n] == "identified" for n in result.names])
    z = ((result.theta - truth_of(result)) / result.std)[reference]
    assert reference.sum() >= 20
    assert np.sqrt(np.mean(z**2)) < 1.4
    assert np.abs(z).max() < 4.0
    assert result.whiteness.min() > 1e-4
    assert not [w for w in result.warnings if "moments act" in w]
    assert result.cov.shape == (reference.sum(), reference.sum())
    np.testing.assert_allclose(np.sqrt(np.diagonal(result.cov)), result.std[reference])
    # The sensors' noise, and the gusts of one sample.
    remaining = np.sqrt(np.nanmean(np.concatenate(result.residual) ** 2, axis=0)) / [
        result.noise[c] for c in result.outputs
    ]
    assert (remaining > 0.9).all()
    assert (remaining < 4.0).all()
    late = [v for n, v in result.nuisance.items() if n.startswith("delay/")]
    assert len(late) == 2
    assert all(abs(value) < 4.0 * std for value, std in late)


@pytest.mark.slow
def test_what_is_asked_for_is_estimated_and_no_more(folder: Path):
    request = ["Cm_0", "Cm_alpha", "Cm_q", "Cm_de"]
    outputs = (
        "V_mps",
        "alpha_rad",
        "beta_rad",
        "phi_rad",
        "theta_rad",
        "p_radps",
        "q_radps",
        "r_radps",
        "az_mps2",
    )
    result = uq.identify(
        folder / "espaaro",
        folder / "flight-0.parquet",
        parameters=request,
        outputs=outputs,
        biases=("q_radps",),
        delays=(),
        workers=1,
    )
    assert result.method == "filter error"
    assert result.names == tuple(f"aero/{n}" for n in request)
    assert result.outputs == outputs
    assert [n.split("/")[0] for n in result.nuisance] == ["bias"]
    assert all(
        m.shape[1] == len(outputs) for m in (*result.measured, *result.modelled, *result.residual)
    )


@pytest.mark.slow
def test_a_parameter_at_its_bound_is_not_identified(folder: Path):
    specific = Airframe().coefficients["Cm_q"]
    assert TRUTH.coefficients["Cm_q"] < 1.02 * specific
    card_ = write_aircraft("espaaro", Airframe(), folder / "bounded") / "airframe.toml"
    rows = card_.read_text(encoding="utf-8").splitlines()
    bounded = f'"aero/Cm_q" = {{ initial = {specific}, bounds = [{1.02 * specific}, 0.0] }}'
    card_.write_text(
        "\n".join(bounded if row.startswith('"aero/Cm_q"') else row for row in rows),
        encoding="utf-8",
    )
    result = uq.identify(folder / "bounded" / "espaaro", folder / "flight-0.parquet", workers=1)
    assert result.method == "filter error"
    assert result.status["aero/Cm_q"] == "not-identified"
    assert "at its lower bound" in result.reason["aero/Cm_q"]
    assert result.theta[result.names.index("aero/Cm_q")] == specific
    assert len(result.identified) == len(result.cov)
    # The others are estimated beside the value that it goes back to.
    single = uq.identify(
        folder / "bounded" / "espaaro",
        folder / "flight-0.parquet",
        parameters=[n for n in result.names if n != "aero/Cm_q"],
        workers=1,
    )
    at = [result.names.index(n) for n in single.names]
    np.testing.assert_allclose((result.theta[at] - single.theta) / single.std, 0.0, atol=0.5)


def test_without_moving_air_filter_error_is_output_error(folder: Path):
    result = uq.identify(
        folder / "espaaro", folder / "flight-2.parquet", method="filter-error", workers=1
    )
    assert result.method == "output error"
    assert any("filter error finds no air" in note for note in result.notes)


@pytest.mark.parametrize(
    ("turbulence", "method"),
    [("light", "filter error"), pytest.param("none", "output error", marks=pytest.mark.slow)],
)
def test_the_method_follows_the_air(tmp_path: Path, turbulence: str, method: str):
    flight = uq.fly(
        "espaaro", "flight-ident", duration_s=24, turbulence=turbulence, noise=True, seed=3
    )
    flight.write(tmp_path / "flight.parquet")
    result = uq.identify(
        "espaaro", tmp_path / "flight.parquet", parameters=["aero/Cm_q"], workers=1
    )
    assert result.method == method
    # Flown by the model itself: its value is the truth.
    assert abs(result.theta[0] - result.initial[0]) < 3.5 * result.std[0]
    assert result.std[0] < 0.1 * abs(result.theta[0])
