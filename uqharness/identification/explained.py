"""Whether a fit explains its flights at all. One that does not gives the nearest values of a wrong model, and identifies none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sysid.arrays import FloatArray
from uqharness.identification.result import Identification
from uqharness.simulator import MEMS_NOISE_STD

UNEXPLAINED_SIGMA = 10.0
"""Residual in sigma above which a channel may count as unexplained: small missing terms, which `refine` names, leave some 4."""
UNEXPLAINED_SHARE = 0.1
"""Share of a channel's variance left over above which it does: a third of the motion's size."""


def unexplained(
    residual: Sequence[FloatArray],
    measured: Sequence[FloatArray],
    outputs: Sequence[str],
    noise: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """Channels that a fit does not explain: rms of the residual in sigma, and its share of the channel's variance.

    residual, measured  [(n, m)] by segment, NaN where nothing was logged; the variance is about each segment's mean
    noise               by channel, its own unit; a record cleaner than a small MEMS unit is judged by that unit's noise
    """
    out = {}
    for k, channel in enumerate(outputs):
        left, moved, samples = 0.0, 0.0, 0
        for r, z in zip(residual, measured, strict=True):
            good = np.isfinite(r[:, k]) & np.isfinite(z[:, k])
            if good.any():
                left += float(np.sum(r[good, k] ** 2))
                moved += float(np.sum((z[good, k] - z[good, k].mean()) ** 2))
                samples += int(good.sum())
        size = max(noise[channel], MEMS_NOISE_STD.get(channel, 0.0))
        if not samples or not size > 0.0:
            continue
        sigma = float(np.sqrt(left / samples)) / size
        share = left / moved if moved > 0.0 else np.inf
        if sigma > UNEXPLAINED_SIGMA and share > UNEXPLAINED_SHARE:
            out[channel] = (sigma, share)
    return out


def withdrawn(found: Identification) -> Identification:
    """``found`` itself where it converged and explains its flights; else the same with no parameter identified, each at its start,
    and why: neither values nor standard errors hold of a fit that has not ended, or of a model that is not the aircraft's."""
    why = _why_withdrawn(found) if found.identified else ""
    if not why:
        return found
    advice = "check units, signs, mass, inertia and servos with compare, or let refine look for a missing effect"
    return replace(
        found,
        theta=found.initial.copy(),
        std=np.full(len(found.names), np.nan),
        std_crb=np.full(len(found.names), np.nan),
        status=dict.fromkeys(found.names, "not-identified"),
        reason={
            n: why if found.status[n] == "identified" else found.reason[n] for n in found.names
        },
        cov=np.zeros((0, 0)),
        warnings=(f"no parameter is identified: {why}; {advice}", *found.warnings),
    )


def _why_withdrawn(found: Identification) -> str:
    """Empty where the estimates stand."""
    wrong = unexplained(found.residual, found.measured, found.outputs, found.noise)
    if wrong:
        channel = max(wrong, key=lambda c: wrong[c][1])
        sigma, share = wrong[channel]
        others = (
            f" ({', '.join(c for c in wrong if c != channel)} as well)" if len(wrong) > 1 else ""
        )
        return (
            f"the model does not explain the flights: the residual of {channel} is {sigma:.0f} sigma, "
            f"{100.0 * share:.0f} % of its variance{others}"
        )
    return "" if found.converged else "not converged; values unchanged"
