"""Steps of commands: found under feedback, and valid where gusts outlast earlier motion."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.arrays import FloatArray
from sysid.estimation import command_steps_of, filtered_steps, fuller
from sysid.record import FlightRecord

DT_S, L_P, L_DA = 0.02, -8.0, 30.0


def _rolling(seed: int, steps: bool) -> tuple[FlightRecord, FloatArray, FloatArray]:
    """Return a roll axis in gusts of 2 s under feedback, its acceleration, and an innocent sensor's
    noise; the pilot turns every 15 s, or never.
    """
    rng = np.random.default_rng(seed)
    n = 9000
    p, phi, aileron, rate = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    gust, bank = 0.0, 0.0
    for k in range(n - 1):
        gust += -DT_S / 2.0 * gust + 0.4 * np.sqrt(DT_S) * rng.normal()
        if steps and k % 750 == 0:
            bank = float(rng.choice([-0.5, 0.5]))
        aileron[k] = 0.15 * (2.0 * (bank - phi[k]) - p[k])
        rate[k] = L_P * p[k] + L_DA * aileron[k] + 2.0 * gust
        p[k + 1], phi[k + 1] = p[k] + DT_S * rate[k], phi[k] + DT_S * p[k]
    columns = {"time_s": DT_S * np.arange(n), "phi_rad": phi, "p_radps": p, "aileron_deg": aileron}
    return FlightRecord(columns), rate, rng.normal(size=n)


def test_steps_find_the_control_power_that_gusts_hide() -> None:
    inside, errors = [], []
    for seed in range(6):
        record, rate, _ = _rolling(seed, steps=True)
        steps = command_steps_of(record, {"aileron": "aileron_deg"})["aileron"]
        x = np.column_stack([record["p_radps"], record["aileron_deg"]])
        block = (record["time_s"] // 10.0).astype(int)
        fit = fuller(rate, x, filtered_steps([steps], DT_S), block)
        assert fit is not None
        std = np.sqrt(np.diagonal(fit.cov))
        inside += (np.abs(fit.theta - [L_P, L_DA]) < 1.96 * std).tolist()
        errors.append(fit.theta / [L_P, L_DA] - 1.0)
        assert fit.moment / fit.variance < 5.0 * fit.excess
        # Least squares has both at less than three quarters.
        plain = np.linalg.lstsq(x, rate, rcond=None)[0]
        assert np.all(plain / [L_P, L_DA] < 0.75)
    assert np.mean(inside) > 0.8
    assert np.mean(errors, axis=0) == pytest.approx(0.0, abs=0.12)


def test_feedback_alone_has_no_steps() -> None:
    record, _, noise = _rolling(1, steps=False)
    assert command_steps_of(record, {"aileron": "aileron_deg"}) == {}
    # Noise of a sensor that the log lacks is no step either.
    noisy = record.with_columns({"aileron_deg": record["aileron_deg"] + 0.05 * noise})
    assert command_steps_of(noisy, {"aileron": "aileron_deg"}) == {}


def test_too_few_or_collinear_columns_have_no_estimate() -> None:
    rng = np.random.default_rng(2)
    z, block = rng.normal(size=(500, 1)), np.arange(500) // 50
    x = z + rng.normal(size=(500, 1))
    assert fuller(x[:, 0], np.column_stack([x, rng.normal(size=500)]), z, block) is None
    assert fuller(x[:, 0], np.zeros((500, 1)), z, block) is None
