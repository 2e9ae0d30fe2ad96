"""What the loops of the linear filter work on: named tuples, which compiled code takes as they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.arrays import FloatArray

STARTS = 8
"""Columns of the start state."""


class Seen(NamedTuple):
    """A segment's linear system with what was measured of it: there (n, m), z (n, m) less the reference's outputs, H (n, m, x),
    D (n, m, 6); phi, defect, g0, g1, dt_s and start (x, 8) as in `Steps`. Where nothing was measured z is zero."""

    there: NDArray[np.bool_]
    z: FloatArray
    H: FloatArray
    D: FloatArray
    phi: FloatArray
    defect: FloatArray
    g0: FloatArray
    g1: FloatArray
    dt_s: float
    start: FloatArray

    @classmethod
    def of(cls, steps: Steps, measured: FloatArray, which: Sequence[int]) -> Seen:
        """which: rows of OUTPUTS that ``measured`` (n, m) holds, NaN where nothing is."""
        rows = list(which)
        there = np.isfinite(measured)
        z = np.where(there, measured - steps.y_ref[:, rows], 0.0)
        H, D, phi, defect, g0, g1 = (
            np.ascontiguousarray(part)
            for part in (
                steps.H[:, rows],
                steps.D[:, rows],
                steps.phi,
                steps.defect,
                steps.g0,
                steps.g1,
            )
        )
        start = np.eye(H.shape[2], STARTS) if steps.start is None else steps.start
        return cls(there, z, H, D, phi, defect, g0, g1, float(steps.dt_s), start)


class Gains(NamedTuple):
    """gain (n, m, x) of each channel of each sample behind those before it; spread (n, m): variance of its innovation; whole (n,
    m): the same before any of the sample. 0, 1 and 1 where nothing was measured."""

    gain: FloatArray
    spread: FloatArray
    whole: FloatArray

    @property
    def logdet(self) -> float:
        """Sum of the logarithms of the innovations' deviations."""
        return 0.5 * float(np.log(self.spread).sum())


class Acting(NamedTuple):
    """What columns do: column own[e] has values[:, e] (n, e) of the coefficient coefficient[e], ends[:, e] just before each row and
    felt[:, e] of what the channels of that row have seen; column direct[e] has added[:, :, e] (n, m, e) of the channels. Columns
    count from 1: before them stands the state."""

    own: NDArray[np.intp]
    coefficient: NDArray[np.intp]
    values: FloatArray
    ends: FloatArray
    felt: FloatArray
    direct: NDArray[np.intp]
    added: FloatArray

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        inputs: Mapping[str, tuple[int, FloatArray]],
        outputs: Mapping[str, FloatArray],
        n: int,
        m: int,
        ends: Mapping[str, FloatArray] | None = None,
        felt: Mapping[str, FloatArray] | None = None,
    ) -> Acting:
        """inputs: column -> (index of the coefficient CX..Cn, values (n,)), or (-1, values (n, 6)) for all six; outputs: column ->
        (n, m) added to the measured channels; ends, felt: column -> the values just before each row, and what the row's channels
        have seen of them, of the same shape, where these are others than the values themselves."""
        own: list[int] = []
        coefficient: list[int] = []
        values = [np.zeros((n, 0))]
        others: list[list[FloatArray]] = [[np.zeros((n, 0))], [np.zeros((n, 0))]]
        for k, name in enumerate(names, 1):
            if name in inputs:
                index, found = inputs[name]
                which = list(range(6)) if index < 0 else [index]
                own += [k] * len(which)
                coefficient += which
                values.append(np.reshape(found, (n, len(which))))
                for made, given in zip(others, (ends, felt), strict=True):
                    made.append(np.reshape((given or {}).get(name, found), values[-1].shape))
        direct = [k for k, name in enumerate(names, 1) if name in outputs]
        added = (
            np.stack([outputs[names[k - 1]] for k in direct], axis=2)
            if direct
            else np.zeros((n, m, 0))
        )
        places = [np.array(some, dtype=np.intp) for some in (own, coefficient, direct)]
        at_rows = np.hstack(values)
        before, seen = (
            np.hstack(made) if given else at_rows
            for made, given in zip(others, (ends, felt), strict=True)
        )
        return cls(
            places[0], places[1], at_rows, before, seen, places[2], np.ascontiguousarray(added)
        )
