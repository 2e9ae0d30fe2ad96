"""Noise added once more, to see by experiment what a figure owes to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sysid.arrays import FloatArray

NOISY = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)


def with_noise(
    channels: Mapping[str, FloatArray], noise_std: Mapping[str, float], rng: np.random.Generator
) -> dict[str, FloatArray]:
    """The channels (n,) with white noise of ``noise_std`` (channel -> std) added; those without a finite figure as they are."""
    return {
        c: v + noise_std[c] * rng.standard_normal(len(v))
        if np.isfinite(noise_std.get(c, np.nan))
        else v
        for c, v in channels.items()
    }


def floor_of(changes: Sequence[FloatArray]) -> FloatArray:
    """(k,) rms of what added noise changed in k quantities: the mean over experiments of (n, k) each."""
    return np.asarray(np.sqrt(sum(np.mean(change**2, axis=0) for change in changes) / len(changes)))
