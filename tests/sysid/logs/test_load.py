"""Every importer against damage: a record or a LogError, in bounded time, and never
anything else.
"""

from __future__ import annotations

import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.card import AirframeCard
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_text_log, write_tlog, write_ulog

FORMATS = ("bin", "log", "tlog", "ulg", "csv", "jsbsim", "parquet")
LIMIT_S = 20.0  # a clean import of these logs takes well under a second


@pytest.fixture(scope="module")
def samples(
    tmp_path_factory: pytest.TempPathFactory, flown: FlightRecord, card: AirframeCard
) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("fuzz")
    short = flown.rows(slice(0, 600))
    out = {}
    write_dataflash(short, folder / "a.bin", card)
    write_text_log(folder / "a.log", short)
    write_tlog(folder / "a.tlog", short)
    us = np.rint(short["time_s"] * 1e6).astype(np.int64)
    names = {
        "gyro_rad": ("p_radps", "q_radps", "r_radps"),
        "accelerometer_m_s2": ("ax_mps2", "ay_mps2", "az_mps2"),
    }
    imu = {f"{g}[{i}]": short[n] for g, members in names.items() for i, n in enumerate(members)}
    write_ulog(
        folder / "a.ulg",
        {"sensor_combined": (us, imu), "airspeed": (us, {"true_airspeed_m_s": short["V_mps"]})},
    )
    short.write(folder / "a.csv")
    short.write(folder / "a.parquet")
    header = "Time,/fdm/jsbsim/velocities/vtrue-fps,/fdm/jsbsim/velocities/q-rad_sec,/fdm/jsbsim/fcs/elevator-cmd-deg"
    table = np.column_stack(
        [short["time_s"], short["V_mps"] / 0.3048, short["q_radps"], short["elevator_deg"]]
    )
    np.savetxt(folder / "a.jsbsim", table, delimiter=",", header=header, comments="", fmt="%.9g")
    for kind in FORMATS:
        out[kind] = (folder / f"a.{kind}").read_bytes()
    return out


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """One of: cut, flipped bits, a zeroed or random stretch, a stretch twice, a stretch missing."""
    n = len(data)
    a = int(rng.integers(0, n))
    b = min(n, a + int(rng.integers(1, max(2, n // 10))))
    kind = int(rng.integers(0, 7))
    if kind == 0:
        return data[:a]
    if kind in (1, 2):
        out = bytearray(data)
        # Headers steer a reader more than payload does: half of the damage goes into the first 2
        # kB.
        span = min(n, 2048) if kind == 1 else n
        for k in rng.integers(0, span, int(rng.integers(1, 60))):
            out[int(k)] ^= 1 << int(rng.integers(0, 8))
        return bytes(out)
    if kind == 3:
        return data[:a] + bytes(b - a) + data[b:]
    if kind == 4:
        return data[:a] + rng.bytes(b - a) + data[b:]
    if kind == 5:
        return data[:b] + data[a:b] + data[b:]
    return data[:a] + data[b:]


def attempt(path: Path) -> str:
    """ "record", or the error's text; anything but LogError escapes."""
    started = time.monotonic()
    try:
        record = import_log(path)
        log_info(record)
        outcome = "record"
    except LogError as e:
        outcome = str(e)
        assert str(path) in outcome
        assert "\n" not in outcome.strip()
        assert len(outcome) > len(str(path)) + 10
    assert time.monotonic() - started < LIMIT_S
    return outcome


def fuzz(data: bytes, kind: str, folder: Path, seeds: range) -> dict[str, int]:
    counts = {"record": 0, "refused": 0}
    for seed in seeds:
        path = folder / f"{kind}-{seed}.dat"
        path.write_bytes(damaged(data, np.random.default_rng([seed, FORMATS.index(kind)])))
        counts["record" if attempt(path) == "record" else "refused"] += 1
        path.unlink()
    return counts


@pytest.mark.parametrize("kind", FORMATS)
def test_undamaged_samples_are_read(kind: str, samples: dict[str, bytes], tmp_path: Path) -> None:
    path = tmp_path / "renamed.xyz"
    path.write_bytes(samples[kind])
    record = import_log(path)
    assert len(record) > 100
    assert "q_radps" in record


@pytest.mark.parametrize("kind", FORMATS)
def test_damage_gives_a_record_or_a_clear_refusal(
    kind: str, samples: dict[str, bytes], tmp_path: Path
) -> None:
    counts = fuzz(samples[kind], kind, tmp_path, range(8))
    assert sum(counts.values()) == 8


@pytest.mark.slow
@pytest.mark.parametrize("kind", FORMATS)
def test_much_damage(kind: str, samples: dict[str, bytes], tmp_path: Path) -> None:
    fuzz(samples[kind], kind, tmp_path, range(1000, 2000))


@pytest.mark.parametrize("kind", FORMATS)
def test_every_early_cut(kind: str, samples: dict[str, bytes], tmp_path: Path) -> None:
    data = samples[kind]
    for size in [0, 1, 2, 3, 7, 8, 9, 16, 17, 30, 64, 89, 90, 200, len(data) // 2, len(data) - 1]:
        path = tmp_path / "cut.bin"
        path.write_bytes(data[:size])
        attempt(path)


FOREIGN = {
    "picture.bin": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20,
    "archive.ulg": b"PK\x03\x04" + bytes(500),
    "notes.log": b"This is a text about flying.\nNothing else.\n" * 50,
    "zeros.tlog": bytes(10000),
    "noise.bin": np.random.default_rng(3).bytes(20000),
    "noise.tlog": np.random.default_rng(4).bytes(20000),
    "words.csv": b"name,colour\nsparrow,brown\nrobin,red\n" * 20,
    "page.html": b"<html><body>a, b, c</body></html>\n" * 30,
    "magic-only.bin": b"\xa3\x95",
    "magic.ulg": b"ULog\x01\x12\x35\x01",
    "magic.parquet": b"PAR1 and nothing more PAR1",
}


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_files_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(FOREIGN[name])
    assert attempt(path) != "record"


def test_empty_missing_folder_and_zip(tmp_path: Path) -> None:
    (tmp_path / "empty.bin").write_bytes(b"")
    assert "empty" in attempt(tmp_path / "empty.bin")
    assert "no such file" in attempt(tmp_path / "missing.bin")
    assert "folder" in attempt(tmp_path)
    with zipfile.ZipFile(tmp_path / "log.bin", "w") as archive:
        archive.writestr("a.bin", b"x" * 100)
    assert "ZIP" in attempt(tmp_path / "log.bin")
