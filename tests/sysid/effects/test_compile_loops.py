"""What is compiled ahead is what real flights ask for: they compile nothing more."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics import transitions
from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.flight_equations import loops
from sysid.aerodynamics.rigid_body import OUTPUTS, MassProperties, Reference, linearise
from sysid.effects.compile_loops import compile_loops
from sysid.effects.prediction import Columns, filter_segments, whiten, whiten_filtered, with_air
from sysid.effects.turbulence import AirLikelihood
from sysid.estimation import kalman_loops
from sysid.estimation.kalman import Process

N, M = 12, len(OUTPUTS)
MASS = MassProperties(18.0, np.diag([2.0, 3.0, 4.0]), 1.9, 3.7, 0.5)


def compiled() -> dict[str, int]:
    """How many kinds of arguments each loop is compiled for."""
    result = {
        name: getattr(kalman_loops, name)
        for name in (
            "filter_gains",
            "whiten_states",
            "whiten_columns",
            "noise_columns",
            "backward",
        )
    } | loops()._asdict()
    result |= {"discretise": transitions.discretise, "replace_state": transitions.replace_state}
    return {name: len(loop.signatures) for name, loop in result.items()}


def test_a_flight_compiles_nothing_that_was_not_compiled_ahead() -> None:
    compile_loops()
    before = compiled()
    assert all(before.values())
    rng = np.random.default_rng(2)
    # As they come from replays and records: single columns of wider arrays, with effects of all
    # coefficients and of a channel.
    x = (np.zeros((N, 20)) + np.array([20.0, *np.zeros(19)]) + 0.01 * rng.standard_normal((N, 20)))[
        :, :8
    ]
    wide = rng.standard_normal((N, 12))
    reference = Reference(
        0.02,
        x,
        wide[:, :3],
        wide[:, 3:6],
        rng.standard_normal((N, 6, 6)),
        np.full(N, 200.0),
        np.zeros(3),
        False,
        by_flow=rng.standard_normal((N, 6, 2)),
        frame_s=0.01,
    )
    measured = rng.standard_normal((N, M + 3))[:, :M]
    measured[3, 4] = np.nan
    inputs = {"a": (-1, wide[:, :6]), "b": (2, wide[:, 7])}
    columns = [Columns(("a", "b", "c"), inputs, {"c": rng.standard_normal((N, M))})]
    process = Process(np.full((1, 13), 0.1), np.full((1, 13), 0.2))
    in_earth = GustStates(3.7, turning_with=False, in_earth=True)
    for air in (None, in_earth, GustStates(3.7, rotating=False)):
        steps = linearise(reference, MASS, gusts=air)
        whiten([steps], [measured], columns, range(M), np.ones(M), None if air is None else process)
    followed = filter_segments([steps], [measured], range(M), np.ones(M), process)
    whiten_filtered(with_air(followed, process, np.ones(M)), columns)
    AirLikelihood([steps], [measured], range(M))(np.ones(M), process)
    assert compiled() == before


@pytest.mark.slow
def test_another_kind_of_array_would_be_seen() -> None:
    compile_loops()
    before = compiled()
    transitions.discretise(
        np.zeros((2, 4, 4)),
        np.zeros((2, 4, 12))[:, :, ::2],
        0.1,
        *np.empty((2, 1, 4, 4)),
        *np.empty((2, 1, 4, 6)),
    )
    assert compiled() != before
