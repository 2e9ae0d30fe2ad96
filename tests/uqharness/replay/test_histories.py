"""histories.parquet: written, read back and refused; names and units of channels."""

from __future__ import annotations

import numpy as np

from sysid.vocabulary import SIGNALS
from uqharness.replay.histories import (
    HISTORIES,
    columns_of,
    have_columns,
    read_histories,
    shown_channel,
    write_histories,
    write_pieces,
)
from uqharness.replay.segments import Segment

TIMES = [np.arange(4) * 0.02, 10.0 + np.arange(3) * 0.02]
BLOCKS = [np.arange(8.0).reshape(4, 2), np.array([[1.0, np.nan], [2.0, 3.0], [4.0, 5.0]])]


def pieces():
    return [("f", "pitch", TIMES[0]), ("g", "roll", TIMES[1])]


def test_what_is_written_comes_back(tmp_path):
    columns = columns_of(("q_radps", "V_mps"), BLOCKS) | columns_of(
        ("q_radps", "V_mps"), BLOCKS, "_model"
    )
    segments = [
        Segment(m, f, t, np.zeros((len(t), 4)), np.zeros(9), 0.0, 0.0) for f, m, t in pieces()
    ]
    write_histories(tmp_path, segments, columns)
    first, second = read_histories(tmp_path / HISTORIES)
    assert (first.number, first.flight, first.manoeuvre) == (0, "f", "pitch")
    assert second.title == "g, roll, from 10.0 s"
    np.testing.assert_array_equal(second.time_s, TIMES[1])
    np.testing.assert_array_equal(second.columns["V_mps"], BLOCKS[1][:, 1])
    np.testing.assert_array_equal(first.columns["q_radps_model"], BLOCKS[0][:, 0])
    assert have_columns([first, second], ["q_radps", "V_mps_model"])
    assert not have_columns([first, second], ["q_radps", "other"])
    assert not have_columns([], [])
    # The same input makes the same bytes.
    before = (tmp_path / HISTORIES).read_bytes()
    write_pieces(tmp_path / HISTORIES, pieces(), columns)
    assert (tmp_path / HISTORIES).read_bytes() == before


# Channels as they are shown: quantity, unit, factor.


def test_every_channel_of_a_record_has_its_unit():
    """rpm is a name without one, N is not drawn."""
    unknown = {
        name
        for name, signal in SIGNALS.items()
        if signal.kind != "label" and shown_channel(name)[1] == "-"
    }
    assert unknown <= {"rpm", "thrust_N", "mode", "manoeuvre"}
