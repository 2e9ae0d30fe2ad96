"""Split of one ordinary flight: parts alike, and no row used twice."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import uqharness as uq
from sysid.record import FlightRecord
from uqharness.cli.main import main
from uqharness.identification.ordinary import Instruments
from uqharness.identification.split import (
    MIN_LEFT_S,
    inside,
    rows_in,
    seconds,
    split_in_time,
    used_for_model,
    without,
)
from uqharness.replay import Flight

DT_S = 0.02


def _record(seconds_long: float, gap: bool = False) -> FlightRecord:
    """Return a flight of circles of 30 s: blocks of 15 s see one half of the circle only."""
    t = DT_S * np.arange(round(seconds_long / DT_S))
    if gap:
        t = t[(t < 50.0) | (t > 62.0)]
    phi = 0.5 * np.sign(np.sin(2.0 * np.pi * t / 30.0))
    return FlightRecord({"time_s": t, "phi_rad": phi, "V_mps": 20.0 + 0.01 * (t % 7.0)})


@pytest.mark.parametrize("gap", [False, True])
def test_both_parts_see_all_conditions_and_share_no_row(gap: bool) -> None:
    record = _record(300.0, gap)
    split = split_in_time(record)
    assert split.block_s != 15.0
    assert split.difference < 0.2
    used, held_out = (inside(record, part) for part in (split.used_s, split.held_out_s))
    assert np.array_equal(used, ~held_out)
    assert 0.4 < used.mean() < 0.6
    # The next command takes every second block of the rest; nothing is used twice.
    remainder = without(record, split.used_s)
    assert remainder is not None
    second = split_in_time(remainder)
    last = without(remainder, second.used_s)
    assert last is not None
    assert not set(rows_in(remainder, second.used_s)["time_s"]) & set(last["time_s"])
    assert seconds(second.used_s) + len(last) * DT_S == pytest.approx(len(remainder) * DT_S, abs=1)
    assert without(last, second.held_out_s) is None


def test_short_or_requested_flights_stay_complete() -> None:
    short = split_in_time(_record(60.0))
    assert not short.held_out_s
    assert "90 s are needed" in short.note("f", "bounds")
    assert not split_in_time(_record(300.0), enabled=False).held_out_s


@pytest.mark.parametrize("length_s", [90.0, 180.0])
def test_three_commands_have_rows_of_their_own(length_s: float) -> None:
    record = _record(length_s)
    first = split_in_time(record)
    remainder = without(record, first.used_s)
    assert remainder is not None
    second = split_in_time(remainder, min_s=2.0 * MIN_LEFT_S)
    assert min(seconds(second.used_s), seconds(second.held_out_s)) > 0.18 * length_s
    assert without(remainder, second.used_s) is not None
    assert not split_in_time(remainder, min_s=length_s).held_out_s


def test_unreadable_evidence_beside_an_aircraft_lists_no_rows(tmp_path: Path) -> None:
    aircraft = SimpleNamespace(folder=tmp_path / "aircraft")
    assert used_for_model(aircraft, "a") == ()
    for split in ('{"used_s": [[1]]}', "null", '{"used_s": [[0.0, 5.0]]}'):
        (tmp_path / "fit.json").write_text(f'{{"flights_sha256": ["a"], "split": {split}}}')
        expected = ((0.0, 5.0),) if "5.0" in split else ()
        assert used_for_model(aircraft, "a") == expected
        assert used_for_model(aircraft, "b") == ()
        assert Instruments.of_model(aircraft, "a") is None


def test_instruments_are_those_of_the_flight_or_of_another_one(tmp_path: Path) -> None:
    numbers = {
        "delay/f/controls": 0.05,
        "delay/f/aileron": 0.06,
        "lag/f/aileron": 0.04,
        "delay/g/controls": 0.07,
        "sensor.alpha_rad/scale": 1.5,
    }
    document = {
        "method": "equation error",
        "flights_sha256": ["a", "b"],
        "nuisance": {n: {"value": v, "std": 0.01} for n, v in numbers.items()},
        "servos": "ideal",
    }
    (tmp_path / "fit.json").write_text(json.dumps(document))
    aircraft = SimpleNamespace(folder=tmp_path / "aircraft")
    first, second, other = (Instruments.of_model(aircraft, digest) for digest in "abc")
    assert first is not None
    assert second is not None
    assert first == other
    assert (first.delay_s, first.servos, first.ideal) == (0.05, {"aileron": (0.06, 0.04)}, True)
    assert (second.delay_s, second.servos) == (0.07, {})
    t = DT_S * np.arange(200)
    step = np.where(t >= 1.0, 1.0, 0.0)
    columns = {"time_s": t, "alpha_rad": 0.3 + 0.0 * t, "aileron_deg": step, "elevator_deg": step}
    flight = Flight("f", FlightRecord(columns), (), ())
    corrected = first.correct(flight)
    assert corrected.record["alpha_rad"] == pytest.approx(0.2)
    fine_s = DT_S / corrected.per_row
    aileron, elevator = (
        np.interp(1.1, fine_s * np.arange(len(v)), v)
        for v in (corrected.commands["aileron_deg"], corrected.commands["elevator_deg"])
    )
    # A lag of 40 ms, 40 ms after the step arrives.
    assert aileron == pytest.approx(1.0 - np.exp(-1.0), abs=0.06)
    assert elevator == 1.0


@pytest.mark.slow
def test_commands_after_one_another_judge_on_rows_of_their_own(tmp_path: Path) -> None:
    flight = uq.fly("espaaro", script="loiter", duration_s=260.0, noise=True, turbulence="light")
    flight.write(tmp_path / "f.parquet")
    file = str(tmp_path / "f.parquet")
    out = {name: str(tmp_path / name) for name in ("fit", "bounds", "coverage", "contest")}
    identified = f"{out['fit']}/aircraft"
    assert main(["identify", "espaaro", "--flight", file, "--out", out["fit"]]) == 0
    assert main(["bounds", identified, "--flight", file, "--out", out["bounds"]]) == 0
    form = f"{out['bounds']}/model-form.json"
    words = ["validate-bounds", identified, form, "--flight", file, "--out", out["coverage"]]
    assert main(words) in (0, 1)
    warnings = json.loads(Path(out["coverage"], "coverage.json").read_text())["warnings"]
    assert not any("validates nothing" in w for w in warnings)
    fit = json.loads(Path(out["fit"], "fit.json").read_text())["split"]
    used = json.loads(Path(form).read_text())["flights"][0]["parts_s"]
    assert not np.any(inside(flight.record, fit["used_s"]) & inside(flight.record, used))
    words = ["compare", "espaaro", identified, "--flight", file, "--out", out["contest"]]
    assert main(words) == 0
    notes = json.loads(Path(out["contest"], "compare.json").read_text())["notes"]
    assert any("no earlier result was made from" in n for n in notes)
