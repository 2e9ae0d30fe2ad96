"""Bad files, the cache of imported records, and several boots in one log."""

from __future__ import annotations

import struct
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.card import AirframeCard
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.info import log_info
from sysid.logs.load import import_log, store
from sysid.logs.time_base import boundaries
from sysid.record import FlightRecord
from tests.helpers.log_writers import px4_topics, write_text_log, write_tlog, write_ulog
from tests.helpers.synthetic import flight

LIMIT_S = 20.0  # a clean import of these logs takes well under a second


def attempt(path: Path) -> str:
    """ "record", or the error's text; anything but LogError escapes."""
    start = time.monotonic()
    try:
        record = import_log(path)
        log_info(record)
        outcome = "record"
    except LogError as e:
        outcome = str(e)
        assert str(path) in outcome
        assert "\n" not in outcome.strip()
        assert len(outcome) > len(str(path)) + 10
    assert time.monotonic() - start < LIMIT_S
    return outcome


def test_empty_missing_folder_and_zip(tmp_path: Path) -> None:
    (tmp_path / "empty.bin").write_bytes(b"")
    assert "empty" in attempt(tmp_path / "empty.bin")
    assert "no such file" in attempt(tmp_path / "missing.bin")
    assert "folder" in attempt(tmp_path)
    with zipfile.ZipFile(tmp_path / "log.bin", "w") as archive:
        archive.writestr("a.bin", b"x" * 100)
    assert "ZIP" in attempt(tmp_path / "log.bin")


# Where imported logs are kept.


def test_store_writes_whole_records_or_none(tmp_path: Path) -> None:
    record = flight(1.0)
    store(record, tmp_path / "new" / "a.parquet")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.parquet"]
    assert len(FlightRecord.read(tmp_path / "new" / "a.parquet")) == len(record)
    (tmp_path / "file").write_text("")
    store(record, tmp_path / "file" / "a.parquet")
    (tmp_path / "b.parquet").mkdir()  # cannot be replaced by a file
    store(record, tmp_path / "b.parquet")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.parquet", "file", "new"]


# Several boots in one log: told apart, listed, one read; damage and lines out of order are no
# boots.

_RATE = 100.0


def stamps(*spans: tuple[float, float]) -> np.ndarray:
    """Stamps of a stream of records that covers each span in turn."""
    return np.concatenate([np.arange(start, end, 1.0 / _RATE) for start, end in spans])


def begins(time_s: np.ndarray, headers: tuple[int, ...] = ()) -> list[int]:
    return boundaries(np.arange(len(time_s)), time_s, headers)


def test_boundaries_where_a_clock_begins_again() -> None:
    assert begins(stamps((3.0, 20.0), (0.5, 60.0))) == [1700]
    assert begins(stamps((0.0, 20.0), (0.0, 20.0), (5.0, 9.0))) == [2000, 4000]


def test_boundaries_ignore_disorder_and_wrong_stamps() -> None:
    time_s = stamps((0.0, 60.0))
    rng = np.random.default_rng(1)
    shuffled = time_s.copy()
    for k in rng.integers(0, len(time_s) - 30, 100):
        shuffled[[k, k + 20]] = shuffled[[k + 20, k]]
    spikes = time_s.copy()
    spikes[rng.integers(0, len(time_s), 60)] = rng.choice([0.0, 1e9, 4e6, -3.0, np.nan], 60)
    late = np.concatenate([time_s[:1000], time_s[1500:3000], time_s[1000:1500], time_s[3000:]])
    wrong_clock = time_s.copy()
    wrong_clock[2000:2200] += 900.0
    for damaged in (shuffled, spikes, late, wrong_clock):
        assert begins(damaged) == []


def test_boundaries_at_repeated_headers() -> None:
    assert begins(stamps((0.0, 20.0), (45.0, 60.0)), (2000,)) == [2000]
    assert begins(stamps((0.0, 20.0), (45.0, 60.0))) == []
    assert begins(stamps((0.0, 20.0), (20.0, 60.0)), (2000,)) == []


@pytest.fixture(scope="module")
def brief() -> FlightRecord:
    return flight(duration_s=20.0, start_s=5.0)


def early(brief: FlightRecord) -> FlightRecord:
    """Eight seconds of another boot, told from the long flight by airspeeds of 30 m/s more."""
    part = brief.between(10.0, 18.0)
    return part.with_columns({"time_s": part["time_s"] - 7.0, "V_mps": part["V_mps"] + 30.0})


def logs(kind: str, first: FlightRecord, second: FlightRecord, folder: Path, card: AirframeCard):
    """The path of a log of ``kind`` with two boots."""
    parts = []
    for k, record in enumerate((first, second)):
        path = folder / f"{k}.part"
        if kind.startswith("dataflash-text"):
            write_text_log(path, record)
            lines = path.read_text().splitlines(keepends=True)
            keep = [x for x in lines if not x.startswith(("FMT", "MSG"))]
            parts.append("".join(keep if k and kind.endswith("headless") else lines).encode())
        elif kind == "dataflash":
            write_dataflash(record, path, card)
            parts.append(path.read_bytes())
        elif kind == "tlog":
            write_tlog(path, record, every=1)
            parts.append(path.read_bytes())
        else:
            write_ulog(path, px4_topics(record))
            data = path.read_bytes()
            at = 16
            while kind.endswith("headless") and k and data[at + 2 : at + 3] != b"D":
                at += 3 + struct.unpack_from("<H", data, at)[0]
            parts.append(data[at:] if at > 16 else data)
    path = folder / "two.log"
    path.write_bytes(b"".join(parts))
    return path


KINDS = ("dataflash", "dataflash-text", "dataflash-text headless", "tlog", "ulog", "ulog headless")


@pytest.mark.parametrize("kind", KINDS)
def test_boots_of_every_dialect_are_listed_and_one_is_read(
    kind: str, tmp_path: Path, brief: FlightRecord, card: AirframeCard, card_path: Path
) -> None:
    path = logs(kind, early(brief), brief, tmp_path, card)
    longest = import_log(path, None, card_path)
    assert longest.metadata.flight_number == 2
    assert [b.number for b in longest.metadata.flights] == [1, 2]
    spans = [b.end_s - b.start_s for b in longest.metadata.flights]
    assert spans == pytest.approx([8.0, 20.0], abs=0.3)
    (finding,) = (f for f in longest.metadata.findings if f.code == "clock-restart")
    assert finding.severity == "warning"
    assert "--flight-number" in finding.message
    assert not any(f.code == "time-backwards" for f in longest.metadata.findings)
    # Nothing of the other boot: its airspeeds are 30 m/s higher.
    fast = np.nanmax(brief["V_mps"]) + 5.0
    assert np.nanmax(longest["V_mps"]) < fast
    first = import_log(path, None, card_path, flight_number=1)
    assert np.nanmin(first["V_mps"]) > fast
    assert first["time_s"][-1] - first["time_s"][0] == pytest.approx(8.0, abs=0.3)
    with pytest.raises(LogError, match="flights 1 to 2"):
        import_log(path, None, card_path, flight_number=3)


def test_parameters_are_those_of_the_boot(
    tmp_path: Path, brief: FlightRecord, card: AirframeCard, card_path: Path
) -> None:
    other = replace(
        card,
        servos={
            n: replace(s, table=tuple((p, 2 * a) for p, a in s.table))
            for n, s in card.servos.items()
        },
    )
    paths = [tmp_path / "a.bin", tmp_path / "b.bin"]
    write_dataflash(brief, paths[0], card)
    write_dataflash(early(brief), paths[1], other, parameters={"SERVO2_REVERSED": 1.0})
    pair = tmp_path / "both.bin"
    pair.write_bytes(b"".join(p.read_bytes() for p in paths))
    single = import_log(paths[0], None, card_path)
    assert np.array_equal(
        import_log(pair, None, card_path)["elevator_deg"], single["elevator_deg"], equal_nan=True
    )


def test_the_boots_stay_with_a_record_and_its_cache(
    tmp_path: Path, brief: FlightRecord, card: AirframeCard, card_path: Path
) -> None:
    path = logs("dataflash", early(brief), brief, tmp_path, card)
    cache = tmp_path / "cache"
    for number in (None, 1, None):
        record = import_log(path, None, card_path, flight_number=number, cache=cache)
        assert record.metadata.flight_number == (number or 2)
    record = import_log(path, None, card_path, flight_number=1, cache=cache)
    record.write(tmp_path / "one.parquet")
    repeat = FlightRecord.read(tmp_path / "one.parquet")
    assert repeat.metadata.flights == record.metadata.flights
    assert repeat.metadata.flight_number == 1


def test_one_boot_lists_nothing_and_holds_no_second(bin_log: Path, card_path: Path) -> None:
    record = import_log(bin_log, None, card_path)
    assert record.metadata.flights == ()
    assert len(import_log(bin_log, None, card_path, flight_number=1)) == len(record)
    with pytest.raises(LogError, match="holds one flight"):
        import_log(bin_log, None, card_path, flight_number=2)
