"""Tables of the coefficients over one variable at a time, with the intervals of a model form.

Whoever reads the table adds the changes of all variables to the coefficients of the trim.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from uqharness.exchange.states import VARIABLES, FlightStates, SourceModel, box

_POINTS = 21


def sweeps(source: SourceModel) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return, for each variable, its values (n,) and the coefficients there (n, 6)."""
    ends = box(source, 4000, seed=2, spread=False)
    tables = {}
    for name in VARIABLES:
        values = np.linspace(ends.values[name].min(), ends.values[name].max(), _POINTS)
        states = at_middle(source, _POINTS)
        tables[name] = (
            values,
            source.coefficients(replace(states, values={**states.values, name: values})),
        )
    return tables


def at_middle(source: SourceModel, n: int) -> FlightStates:
    """Return n times the trim."""
    middle = source.middle
    return FlightStates(
        np.full(n, source.trim.condition.V_mps),
        {name: np.full(n, middle.get(name, 0.0)) for name in VARIABLES},
        source.reference.b_m,
        source.reference.c_m,
    )


def coefficients(
    source: SourceModel, tables: Mapping[str, tuple[FloatArray, FloatArray]], states: FlightStates
) -> FloatArray:
    """Return CX CY CZ Cl Cm Cn (n, 6): those of the trim, plus each variable's change."""
    middle = source.coefficients(at_middle(source, 1))[0]
    total = np.tile(middle, (len(states), 1))
    for name, (values, rows) in tables.items():
        for k in range(len(COEFFICIENTS)):
            total[:, k] += np.interp(states.values[name], values, rows[:, k]) - middle[k]
    return total


def text(tables: Mapping[str, tuple[FloatArray, FloatArray]]) -> str:
    """Return the table as CSV: variable, value, and the six coefficients."""
    lines = [",".join(("variable", "value", *COEFFICIENTS))]
    for name, (values, rows) in tables.items():
        lines += [
            ",".join((name, repr(float(value)), *(repr(float(c)) for c in row)))
            for value, row in zip(values, rows, strict=True)
        ]
    return "\n".join(lines) + "\n"
