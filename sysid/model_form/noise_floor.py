"""What sensor noise alone does to residual coefficients: noise is added once more, and the change passes the same filter.

A width far above 2 t times this is the model's; one near it is the sensors', and says little about the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Cutoffs, Model, Piece, residual_coefficients
from sysid.record import FlightRecord

FloatArray = NDArray[np.float64]
MAX_SAMPLES = 10_000
NOISY = (
    "V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2",
)  # fmt: skip


def with_noise(
    channels: Mapping[str, FloatArray], noise_std: Mapping[str, float], rng: np.random.Generator
) -> dict[str, FloatArray]:
    """The channels (n,) with white noise of ``noise_std`` (channel -> std) added; those without a finite figure as they are."""
    return {
        c: v + noise_std[c] * rng.standard_normal(len(v)) if np.isfinite(noise_std.get(c, np.nan)) else v
        for c, v in channels.items()
    }


def floor_of(changes: Sequence[FloatArray]) -> FloatArray:
    """(k,) rms of what added noise changed in k quantities: the mean over experiments of (n, k) each."""
    return np.asarray(np.sqrt(sum(np.mean(change**2, axis=0) for change in changes) / len(changes)))


def noise_floor(
    record: FlightRecord, pieces: Sequence[Piece], model: Model, noise_std: Mapping[str, float], arm_m: Sequence[float],
    cutoffs: Cutoffs, repeats: int = 3, seed: int = 1,
) -> FloatArray:  # fmt: skip
    """(6,) standard deviation of each residual coefficient under white noise of ``noise_std`` (channel -> std), by experiment.

    Over the pieces, or as many of them, evenly chosen, as MAX_SAMPLES allows.
    """
    pieces = _some(pieces)
    plain = residual_coefficients(record, pieces, model, arm_m, cutoffs).delta
    rng = np.random.default_rng(seed)
    channels = {c: record[c] for c in NOISY if np.isfinite(noise_std.get(c, np.nan))}

    def change() -> FloatArray:
        noisy = record.with_columns(with_noise(channels, noise_std, rng))
        return residual_coefficients(noisy, pieces, model, arm_m, cutoffs).delta - plain

    return floor_of([change() for _ in range(repeats)])


def _some(pieces: Sequence[Piece]) -> list[Piece]:
    rows = sum(p.rows.stop - p.rows.start for p in pieces)
    stride = max(1, int(np.ceil(rows / MAX_SAMPLES)))
    return list(pieces[::stride])
