"""How many samples of a coloured series count as one."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.arrays import FloatArray


def integral_time(pieces: Sequence[FloatArray]) -> float:
    """Samples that count as one independent sample: 1 + 2 (r1 + r2 + ...) up to the first zero of the autocorrelation.

    pieces  [(n,)] of one zero-mean series; products never cross a join. The variance of the series' mean is this many times
    that of as many independent samples (Bayley and Hammersley, J. R. Stat. Soc. Suppl. 8 (1946) 184). 1 for white noise or zeros.
    """
    total, longest = 1.0, max(len(e) for e in pieces) // 3
    power = sum(float(e @ e) for e in pieces)
    for lag in range(1, longest):
        r = (
            sum(float(e[lag:] @ e[:-lag]) for e in pieces if len(e) > lag) / power
            if power > 0
            else 0.0
        )
        if r <= 0.0:
            break
        total += 2.0 * r
    return total


def effective_samples(pieces: Sequence[FloatArray]) -> float:
    """Independent samples that pieces of a series, taken about zero, are worth; at most their number."""
    return sum(len(e) for e in pieces) / integral_time(pieces)
