"""Manoeuvres that are found in a record's commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.errors import LogError
from sysid.logs.load import import_log
from sysid.logs.manoeuvres import Manoeuvre, find_manoeuvres, label_from_commands, with_manoeuvres
from sysid.record import FlightRecord, Metadata

DT = 0.02


def record(seconds: float = 60.0, hz: float = 50.0, **commands: np.ndarray) -> FlightRecord:
    time = np.arange(round(seconds / DT)) * DT
    meta = Metadata(native_hz=dict.fromkeys(commands, hz))
    return FlightRecord({"time_s": time, **commands}, meta)


def pulses(
    start_s: float, size: float, *lengths_s: float, seconds: float = 60.0, trim: float = -1.3
) -> np.ndarray:
    """A command that leaves its trim for pulses of alternate sign."""
    time, out, begin, sign = (
        np.arange(round(seconds / DT)) * DT,
        np.full(round(seconds / DT), trim),
        start_s,
        1.0,
    )
    for length in lengths_s:
        out[(time >= begin - 1e-9) & (time < begin + length - 1e-9)] += sign * size
        begin, sign = begin + length, -sign
    return out


@pytest.mark.parametrize(
    ("lengths_s", "kind"),
    [
        ((0.5, 0.5), "doublet"),
        ((0.9, 0.6, 0.3, 0.3), "3-2-1-1"),
        ((1.0,), "pulse"),
        ((0.4, 1.2), "pulses"),
        ((0.4, 0.4, 0.4), "pulses"),
    ],
)
@pytest.mark.parametrize("size", [-4.0, 2.0])
def test_kind_axis_size_and_times(lengths_s: tuple[float, ...], kind: str, size: float) -> None:
    (found,) = find_manoeuvres(
        record(elevator_deg=pulses(20.0, size, *lengths_s), aileron_deg=pulses(70.0, 1.0))
    )
    assert found == Manoeuvre(
        kind,
        "pitch",
        pytest.approx(20.0),
        pytest.approx(20.0 + sum(lengths_s)),
        pytest.approx(size),
        "deg",
    )
    assert found.name == f"pitch {kind}"


def test_controls_in_order_of_time() -> None:
    found = find_manoeuvres(
        record(
            rudder_deg=pulses(30.0, 5.0, 0.8, 0.8),
            throttle_pct=pulses(10.0, 20.0, 1.5, 1.5, trim=50.0),
        )
    )
    assert [(m.name, m.unit) for m in found] == [("throttle doublet", "%"), ("yaw doublet", "deg")]


def test_a_doublet_by_hand_over_a_trim_that_drifts() -> None:
    time = np.arange(3000) * DT
    # A stick takes a fifth of a second, and is not still.
    hand = (
        np.convolve(pulses(25.0, 6.0, 1.0, 1.0, trim=0.0), np.ones(10) / 10.0, "same")
        + 0.02 * time
        + 0.05 * np.sin(9.0 * time)
    )
    (found,) = find_manoeuvres(record(aileron_deg=hand))
    assert (found.name, found.start_s) == ("roll doublet", pytest.approx(25.0, abs=0.1))


def test_what_an_autopilot_does_is_no_manoeuvre() -> None:
    rng, time = np.random.default_rng(3), np.arange(6000) * DT
    gusts = np.convolve(rng.standard_normal(6200), np.exp(-np.arange(200) / 30.0), "valid")[:6000]
    turn = np.where(time > 60.0, 9.0 * np.exp(-(time - 60.0) / 0.8), 0.0)
    assert (
        find_manoeuvres(record(120.0, elevator_deg=0.5 * gusts, aileron_deg=turn + 0.02 * gusts))
        == ()
    )
    # Nor what is logged too slowly to show an edge.
    assert find_manoeuvres(record(elevator_deg=pulses(20.0, 4.0, 0.5, 0.5), hz=8.3)) == ()


def test_labels_reach_from_before_the_input_into_the_answer() -> None:
    both = record(elevator_deg=pulses(20.0, 3.0, 0.5, 0.5), aileron_deg=pulses(23.0, 3.0, 0.5, 0.5))
    labels, time = label_from_commands(both)["manoeuvre"], both["time_s"]
    pitch, roll = (time[labels == name] for name in ("pitch doublet", "roll doublet"))
    assert (pitch[0], pitch[-1]) == (pytest.approx(19.0), pytest.approx(22.0, abs=DT))
    assert (roll[0], roll[-1]) == (pytest.approx(22.0), pytest.approx(27.0))
    with pytest.raises(LogError, match="no manoeuvre was found"):
        label_from_commands(record(elevator_deg=np.zeros(3000)))


def test_a_table_or_the_word_found_labels_a_record(tmp_path: Path) -> None:
    flown = record(elevator_deg=pulses(20.0, 3.0, 0.5, 0.5))
    table = tmp_path / "found.csv"
    table.write_text("manoeuvre,start_s,end_s\nmine,30,40\n", encoding="utf-8")
    assert set(with_manoeuvres(flown, Path("found"), "one")["manoeuvre"]) == {"", "pitch doublet"}
    assert set(with_manoeuvres(flown, table, "one")["manoeuvre"]) == {"", "mine"}


def test_a_genuine_flights_list(flight_data: Path, card_path: Path) -> None:
    folder = flight_data / "espaaro-ardupilot"
    listed = pd.read_csv(folder / "manoeuvres.csv")
    kinds = {
        "aileron-doublet": "roll doublet",
        "rudder-doublet": "yaw doublet",
        "pitch-doublet": "pitch doublet",
        "pitch-3211": "pitch 3-2-1-1",
    }
    flown = import_log(folder / "flight2_uncertainty.BIN", None, card_path)
    found = find_manoeuvres(flown.between(*flown.metadata.free_flight_s[0]))
    rows = [
        row
        for row in listed.itertuples()
        if row.flight == "flight2_uncertainty" and row.manoeuvre in kinds
    ]
    hits = [
        m
        for row in rows
        for m in found
        if m.name == kinds[row.manoeuvre] and abs(m.start_s - row.start_s) < 0.6
    ]
    assert len(hits) == len(rows) == 21
