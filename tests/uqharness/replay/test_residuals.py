"""Predicted coefficients of a flight: one by one, together, and at some rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.aerodynamics.residuals import Piece
from tests.helpers.synthetic import flight
from uqharness.replay.flights import Flight
from uqharness.replay.residuals import (
    PREDICTED_FIELDS,
    prediction_of,
    sampled_rows,
    with_sampled_change,
)
from uqharness.simulator import find_aircraft

RECORD = flight(30.0)


def build(record=RECORD) -> Flight:
    return Flight("f", record, (Piece("m", slice(0, 200), 0.0, 4.0),), ("a note", "how it was cut"))


def with_positions() -> Flight:
    steady = np.zeros(len(RECORD["V_mps"]))
    return build(
        RECORD.with_columns({f"{c}_pos_deg": steady for c in ("elevator", "aileron", "rudder")})
    )


def test_what_is_asked_ahead_is_what_is_asked_one_by_one():
    trajectory = with_positions()
    pieces = [replace(trajectory.pieces[0], rows=slice(a, a + 40)) for a in (0, 60, 300)]
    moved = trajectory.record.with_columns({"q_radps": trajectory.record["q_radps"] + 0.01})
    trajectory = replace(trajectory, pieces=tuple(pieces))
    with prediction_of(find_aircraft("espaaro"), ("elevator", "aileron", "rudder")) as pair:
        single = [
            [pair.of(trajectory)(record, p).coefficients for p in pieces]
            for record in (trajectory.record, moved)
        ]
    with prediction_of(find_aircraft("espaaro"), ("elevator", "aileron", "rudder")) as pair:
        pair.prefetch(trajectory, [trajectory.record, moved], pieces)
        assert len(pair.predictions) == 6
        ahead = [
            [pair.of(trajectory)(record, p).coefficients for p in pieces]
            for record in (trajectory.record, moved)
        ]
        assert len(pair.predictions) == 6
    np.testing.assert_allclose(ahead, single, rtol=0.0, atol=1e-9)
    assert np.abs(np.array(ahead[0]) - np.array(ahead[1])).max() > 1e-3


def test_changes_asked_for_at_some_rows_are_those_of_all_rows():
    trajectory = with_positions()
    record, piece = trajectory.record, trajectory.pieces[0]
    moved = record.with_columns({"alpha_rad": record["alpha_rad"] + 1e-3})
    with prediction_of(find_aircraft("espaaro"), ("elevator", "aileron", "rudder")) as pair:
        exact, close = pair.of(trajectory), pair.model_near(trajectory)
        base = close(record, piece)
        assert close(record, piece) is base is exact(record, piece)
        some, complete = close(moved, piece), exact(moved, piece)
        # Its own states are not asked for again, and what is known of every row is not drawn
        # between some.
        assert len(pair.predictions) == 3
        assert close(moved, piece) is complete
    change, error = (
        np.abs(a.coefficients - complete.coefficients).max(axis=0) for a in (base, some)
    )
    assert (error <= 0.01 * change.max()).all()
    assert change.max() > 1e-4
    # A change that is not drawn from the states themselves is not that of all rows.
    other = with_sampled_change(
        base,
        replace(complete, **{n: getattr(base, n)[sampled_rows(200, 4)] for n in PREDICTED_FIELDS}),
        4,
    )
    assert np.abs(other.coefficients - complete.coefficients).max() > 10.0 * error.max()
