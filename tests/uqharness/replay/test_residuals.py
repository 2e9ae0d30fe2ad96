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


def made(record=RECORD) -> Flight:
    return Flight("f", record, (Piece("m", slice(0, 200), 0.0, 4.0),), ("a note", "how it was cut"))


def with_positions() -> Flight:
    still = np.zeros(len(RECORD["V_mps"]))
    return made(
        RECORD.with_columns({f"{c}_pos_deg": still for c in ("elevator", "aileron", "rudder")})
    )


def test_what_is_asked_ahead_is_what_is_asked_one_by_one():
    flown = with_positions()
    pieces = [replace(flown.pieces[0], rows=slice(a, a + 40)) for a in (0, 60, 300)]
    moved = flown.record.with_columns({"q_radps": flown.record["q_radps"] + 0.01})
    flown = replace(flown, pieces=tuple(pieces))
    with prediction_of(find_aircraft("espaaro"), ("elevator", "aileron", "rudder")) as pair:
        single = [
            [pair.of(flown)(record, p).coefficients for p in pieces]
            for record in (flown.record, moved)
        ]
    with prediction_of(find_aircraft("espaaro"), ("elevator", "aileron", "rudder")) as pair:
        pair.prefetch(flown, [flown.record, moved], pieces)
        assert len(pair.predictions) == 6
        ahead = [
            [pair.of(flown)(record, p).coefficients for p in pieces]
            for record in (flown.record, moved)
        ]
        assert len(pair.predictions) == 6
    np.testing.assert_allclose(ahead, single, rtol=0.0, atol=1e-9)
    assert np.abs(np.array(ahead[0]) - np.array(ahead[1])).max() > 1e-3


def test_changes_asked_for_at_some_rows_are_those_of_all_rows():
    flown = with_positions()
    record, piece = flown.record, flown.pieces[0]
    moved = record.with_columns({"alpha_rad": record["alpha_rad"] + 1e-3})
    with prediction_of(find_aircraft("espaaro"), ("elevator", "aileron", "rudder")) as pair:
        exact, near = pair.of(flown), pair.model_near(flown)
        base = near(record, piece)
        assert near(record, piece) is base is exact(record, piece)
        some, whole = near(moved, piece), exact(moved, piece)
        # Its own states are not asked for again, and what is known of every row is not drawn
        # between some.
        assert len(pair.predictions) == 3
        assert near(moved, piece) is whole
    change, error = (np.abs(a.coefficients - whole.coefficients).max(axis=0) for a in (base, some))
    assert (error <= 0.01 * change.max()).all()
    assert change.max() > 1e-4
    # A change that is not drawn from the states themselves is not that of all rows.
    other = with_sampled_change(
        base,
        replace(whole, **{n: getattr(base, n)[sampled_rows(200, 4)] for n in PREDICTED_FIELDS}),
        4,
    )
    assert np.abs(other.coefficients - whole.coefficients).max() > 10.0 * error.max()
