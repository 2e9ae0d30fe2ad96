"""Arrays on which the compiled loops of the Kalman filter work, as named tuples.

Compiled code takes named tuples as they are. They stand apart from `sysid.estimation.kalman_loops`
because importing that module loads numba.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Steps
from sysid.arrays import FloatArray

START_COLUMNS = 8
"""Number of start states, the first columns of every pass."""


class MeasuredSystem(NamedTuple):
    """A segment's linear system with its measurements.

    Attributes
    ----------
    is_measured : array (n, m)
        Whether a channel was measured.
    z : array (n, m)
        Measurement less the reference's output; 0 where not measured.
    H, D : array (n, m, x), (n, m, 6)
        Output matrices with the states and the extra coefficients.
    phi, defect, g0, g1, dt_s, start
        As in `sysid.aerodynamics.Steps`.
    """

    is_measured: NDArray[np.bool_]
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
    def of(cls, steps: Steps, measured: FloatArray, output_rows: Sequence[int]) -> MeasuredSystem:
        """Combine a linear system with measurements (n, m), NaN where there are none.

        ``output_rows`` are the indices of the m channels in OUTPUTS.
        """
        rows = list(output_rows)
        is_measured = np.isfinite(measured)
        z = np.where(is_measured, measured - steps.y_ref[:, rows], 0.0)
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
        start = np.eye(H.shape[2], START_COLUMNS) if steps.start is None else steps.start
        return cls(is_measured, z, H, D, phi, defect, g0, g1, float(steps.dt_s), start)


class Gains(NamedTuple):
    """Gains and innovation variances of a segment.

    Attributes
    ----------
    gain : array (n, m, x)
        Gain of each channel after the channels before it in the same sample; 0 where not measured.
    variance : array (n, m)
        Variance of its innovation; 1 where not measured.
    prior_variance : array (n, m)
        The same before any channel of the sample; 1 where not measured.
    """

    gain: FloatArray
    variance: FloatArray
    prior_variance: FloatArray

    @property
    def logdet(self) -> float:
        """Sum of the logarithms of the innovations' standard deviations."""
        return 0.5 * float(np.log(self.variance).sum())


class ColumnInputs(NamedTuple):
    """Effects of the columns on states and channels; columns count from 1, after the state.

    Attributes
    ----------
    column, coefficient : array (e,)
        Column and coefficient (index of CX ... Cn) of each input.
    values : array (n, e)
        Values at the rows.
    ends : array (n, e)
        Values just before each row.
    feedthrough : array (n, e)
        Values that act directly on the channels of each row.
    direct : array (f,)
        Columns that are added to channels.
    added : array (n, m, f)
        What they add.
    """

    column: NDArray[np.intp]
    coefficient: NDArray[np.intp]
    values: FloatArray
    ends: FloatArray
    feedthrough: FloatArray
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
        feedthrough: Mapping[str, FloatArray] | None = None,
    ) -> ColumnInputs:
        """Arrange the effects of named columns.

        Parameters
        ----------
        names : sequence of str
            Columns.
        inputs : mapping
            Column to (index of the coefficient CX ... Cn, values (n,)), or to (-1, values (n, 6))
            for all six.
        outputs : mapping
            Column to the array (n, m) that it adds to the channels.
        n, m : int
            Samples and channels.
        ends, feedthrough : mapping, optional
            Column to the values just before each row, and to those that the row's channels
            measured, where they differ from the values at the row (jumps).
        """
        columns: list[int] = []
        coefficient: list[int] = []
        values = [np.zeros((n, 0))]
        overrides: list[list[FloatArray]] = [[np.zeros((n, 0))], [np.zeros((n, 0))]]
        for k, name in enumerate(names, 1):
            if name in inputs:
                index, column_values = inputs[name]
                indices = list(range(6)) if index < 0 else [index]
                columns += [k] * len(indices)
                coefficient += indices
                values.append(np.reshape(column_values, (n, len(indices))))
                for blocks, override in zip(overrides, (ends, feedthrough), strict=True):
                    blocks.append(
                        np.reshape((override or {}).get(name, column_values), values[-1].shape)
                    )
        direct = [k for k, name in enumerate(names, 1) if name in outputs]
        added = (
            np.stack([outputs[names[k - 1]] for k in direct], axis=2)
            if direct
            else np.zeros((n, m, 0))
        )
        places = [np.array(some, dtype=np.intp) for some in (columns, coefficient, direct)]
        at_rows = np.hstack(values)
        end_rows, feedthrough_rows = (
            np.hstack(blocks) if override else at_rows
            for blocks, override in zip(overrides, (ends, feedthrough), strict=True)
        )
        return cls(
            places[0],
            places[1],
            at_rows,
            end_rows,
            feedthrough_rows,
            places[2],
            np.ascontiguousarray(added),
        )
