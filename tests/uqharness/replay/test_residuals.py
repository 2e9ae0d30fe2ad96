"""A model's answers are asked for once, and flights that lack a channel are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.aerodynamics.residuals import Cutoffs, Piece
from tests.helpers.synthetic import flight
from uqharness.errors import BadInputError
from uqharness.replay import residuals
from uqharness.replay.flights import Flight
from uqharness.replay.residuals import (
    NEEDED,
    PREDICTED_FIELDS,
    ReplayPair,
    cut_for_residuals,
    flight_residuals,
    prediction_of,
    sampled_rows,
    with_sampled_change,
)
from uqharness.simulator import find_aircraft

RECORD = flight(30.0)


def made(record=RECORD) -> Flight:
    return Flight("f", record, (Piece("m", slice(0, 200), 0.0, 4.0),), ("a note", "how it was cut"))


def test_the_same_states_are_asked_for_once(monkeypatch):
    asked = []
    monkeypatch.setattr(
        residuals.JsbsimPrediction,
        "predict",
        lambda self, some: [asked.append(one) or len(asked) for one in some],
    )
    pair = ReplayPair(None, None, ())
    piece = made().pieces[0]
    ask = pair.of(made())
    assert ask(RECORD, piece) == ask(RECORD, piece) == 1
    # Other states, another piece or another flight are another question.
    moved = RECORD.with_columns({"alpha_rad": RECORD["alpha_rad"] + 1e-3})
    assert ask(moved, piece) == 2
    assert ask(RECORD, replace(piece, rows=slice(0, 100))) == 3
    assert pair.of(replace(made(), name="g"))(RECORD, piece) == 4


def test_a_flight_is_cut_where_every_channel_is_there():
    holes = np.array(RECORD["beta_rad"])
    holes[600:700] = np.nan
    found = cut_for_residuals(made(RECORD.with_columns({"beta_rad": holes})), ())
    rows = np.concatenate([np.arange(p.rows.start, p.rows.stop) for p in found.pieces])
    assert not set(rows) & set(range(600, 700))
    assert len(rows) > 1000
    assert found.notes[0] == "a note"
    assert found.notes[-1].startswith(f"f: {len(found.pieces)} pieces")


def test_what_is_missing_is_named():
    bare = replace(RECORD, columns={n: v for n, v in RECORD.columns.items() if n != "alpha_rad"})
    with pytest.raises(BadInputError, match="f: the record has no alpha_rad; residual"):
        cut_for_residuals(made(bare), ())
    holes = {n: np.where(np.arange(len(RECORD)) % 40 == 0, np.nan, RECORD[n]) for n in NEEDED}
    with pytest.raises(BadInputError, match="no stretch of two seconds"):
        cut_for_residuals(made(RECORD.with_columns(holes)), ())


def test_a_refusal_bears_the_flights_name(monkeypatch):
    def refuse(self, asked):
        raise ValueError("too short")

    monkeypatch.setattr(residuals.JsbsimPrediction, "predict", refuse)
    with pytest.raises(BadInputError, match=r"^f: too short$"):
        flight_residuals(ReplayPair(None, None, ()), made(), (0.0, 0.0, 0.0), Cutoffs())


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


def test_a_property_with_another_value_than_in_the_xml_is_flown():
    flown = with_positions()
    surfaces = ("elevator", "aileron", "rudder")
    with (
        prediction_of(find_aircraft("espaaro"), surfaces) as plain,
        prediction_of(find_aircraft("espaaro"), surfaces, values={"aero/Cm_q": 0.0}) as without,
    ):
        given, less = (
            pair.of(flown)(flown.record, flown.pieces[0]).coefficients for pair in (plain, without)
        )
    changed_by = np.abs(given - less).max(axis=0)
    assert changed_by[4] > 1e-3
    np.testing.assert_array_equal(np.delete(changed_by, 4), 0.0)


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
