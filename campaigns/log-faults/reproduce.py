"""Are faults of a log named with channel and size, and are healthy logs left alone? Three logs, faults.py, healthy logs.

python -m campaigns.log-faults.reproduce [--genuine LOG.BIN ...] [--flights DIR] [--out DIR]
"""

from __future__ import annotations

import argparse
import csv
import importlib
import math
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.errors import Finding
from sysid.logs import import_log
from sysid.logs.assemble import assemble
from sysid.logs.card import AirframeCard, parse_card, read_card
from sysid.logs.load import read_raw
from sysid.logs.signal_map import shipped_map
from sysid.record import FlightRecord
from tests.helpers.log_writers import px4_topics, write_ulog
from uqharness.simulator import find_aircraft

FAULTS: Any = importlib.import_module("campaigns.log-faults.faults")
HOME = Path(__file__).parent
WITHIN = 0.1
"""Relative, of a factor or a lateness; lateness has 0.03 s more, since a channel is known on its own samples alone."""
GENUINE_S = 130.0
"""Of the genuine log, from the release on: all faults in the whole of it would take an hour."""

IDENT = "espaaro_truth --script flight-ident --noise --seed 1"
PX4 = "espaaro_truth --script flight-bounds --noise --seed 2"
HEALTHY = (
    *(f"espaaro --script doublet-elevator --noise --seed {seed}" for seed in range(1, 9)),
    "espaaro --script doublet-aileron --noise --seed 21",
    "espaaro_truth --script flight-bounds --noise --seed 12",
    "espaaro_truth --script flight-validation --noise --seed 13",
    "espaaro --duration-s 60 --wind-mps 3 --turbulence moderate --noise --seed 7",
    "espaaro --duration-s 60 --wind-mps 7 --turbulence severe --noise --seed 8",
    "espaaro --script doublet-elevator",
    "c172p --mission doublets --speed-mps 50 --noise --seed 2",
    "c172p --mission steady --speed-mps 50 --duration-s 60 --turbulence light --noise --seed 3",
    "c172p --mission 3-2-1-1 --speed-mps 55 --noise --seed 6",
    "espaaro --script doublet-rudder --noise --seed 22",
    "c310 --mission doublets --speed-mps 62 --noise --seed 4",
    "J3Cub --mission doublets --speed-mps 28 --wind-mps 4 --turbulence light --noise --seed 5",
    "pa28 --mission 3-2-1-1 --speed-mps 40 --noise --seed 9",
    "T38 --mission doublets --speed-mps 170 --noise --seed 10",
    "737 --mission 3-2-1-1 --speed-mps 140 --wind-mps 10 --turbulence moderate --noise --seed 11",
    "sgs233 --mission steady --speed-mps 28 --duration-s 60 --turbulence light --noise --seed 15",
    "c310 --mission 3-2-1-1 --speed-mps 60 --turbulence light --noise --seed 113",
    "c310 --mission doublets --speed-mps 64 --wind-mps 8 --turbulence moderate --noise --seed 120",
)
HELD_OUT = (
    *(
        f"espaaro --duration-s 40 --wind-mps {w} --turbulence {t} --noise --seed {s}"
        for w, t, s in ((2, "light", 201), (4, "moderate", 202), (7, "severe", 203))
    ),
    "espaaro_truth --script flight-ident --noise --seed 204",
    "espaaro_truth --script flight-validation --noise --seed 205",
    "espaaro --script 3-2-1-1 --noise --seed 206",
    "espaaro --script doublet-rudder --noise --seed 207",
    "c172p --mission doublets --speed-mps 40 --turbulence light --noise --seed 208",
    "c172p --mission 3-2-1-1 --speed-mps 52 --wind-mps 9 --turbulence moderate --noise --seed 209",
    "c172p --mission steady --speed-mps 48 --duration-s 60 --turbulence severe --noise --seed 210",
    "J3Cub --mission doublets --speed-mps 29 --turbulence moderate --noise --seed 211",
    "J3Cub --mission 3-2-1-1 --speed-mps 27 --wind-mps 5 --turbulence light --noise --seed 212",
    "c310 --mission doublets --speed-mps 61 --turbulence severe --noise --seed 213",
    "c310 --mission 3-2-1-1 --speed-mps 65 --noise --seed 214",
    "pa28 --mission doublets --speed-mps 39 --turbulence moderate --noise --seed 215",
    "pa28 --mission 3-2-1-1 --speed-mps 37 --turbulence light --noise --seed 216",
    "T38 --mission doublets --speed-mps 190 --turbulence moderate --noise --seed 217",
    "737 --mission 3-2-1-1 --speed-mps 135 --turbulence light --noise --seed 218",
    "A320 --mission doublets --speed-mps 130 --noise --seed 219",
    "B747 --mission doublets --speed-mps 140 --turbulence light --noise --seed 220",
)
"""Flights that no check was made or mended with."""
TRUE = frozenset({"estimate:alpha_rad", "estimate:beta_rad", "delay:ground velocity"})
"""True of every ArduPlane log without vanes: AOA is computed, and a receiver's velocity comes a tenth of a second late. Gaps are
where the logger dropped records."""
CARD = "\n".join(
    f"[inputs.{name}]\nproperty = 'fcs/{name}'\nservo_pwm = {table}\nchannel = {channel}\n"
    for name, channel, table in (
        ("aileron", 1, "[[1100, -20], [1900, 20]]"),
        ("elevator", 2, "[[1100, -20], [1900, 20]]"),
        ("throttle", 3, "[[1000, 0], [2000, 100]]"),
        ("rudder", 4, "[[1100, -20], [1900, 20]]"),
    )
)


@dataclass(frozen=True)
class Sample:
    """A log, its dialect, its card and the span of it that is used (None: the whole)."""

    name: str
    path: Path
    dialect: str
    card: AirframeCard
    span_s: tuple[float, float] | None = None


def flown(folder: Path, arguments: str, suffix: str) -> Path:
    """The log of a flight, flown unless it is there."""
    path = folder / (arguments.replace("--", "").replace(" ", "-") + suffix)
    if not path.exists():
        name, *others = shlex.split(arguments)
        _ran("fly", str(aircraft_of(folder, name)), *others, "--out", str(path), makes=path)
    return path


def aircraft_of(folder: Path, name: str) -> Path:
    """The aircraft's folder; of JSBSim's own a copy with a card, which servo outputs and noise need."""
    if name.startswith("espaaro"):
        return find_aircraft(name).folder
    copy = folder / f"my-{name}"
    if not copy.exists():
        _ran("instrument", name, "--out", str(copy), "--no-check", makes=copy)
    return copy


def _ran(*words: str, makes: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "uqharness", *words], capture_output=True, text=True, check=False
    )
    if not makes.exists():
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")


def samples(folder: Path, genuine: Path | None) -> Iterator[Sample]:
    """The logs that faults are built into."""
    card = read_card(find_aircraft("espaaro").folder)
    yield Sample("simulated DataFlash", flown(folder, IDENT, ".bin"), "dataflash", card)
    px4 = folder / "px4.ulg"
    write_ulog(px4, px4_topics(FlightRecord.read(flown(folder, PX4, ".parquet"))))
    yield Sample("ULog", px4, "ulog", parse_card(CARD, Path("airframe.toml")))
    if genuine is not None:
        start, _ = import_log(
            genuine, None, find_aircraft("espaaro").folder
        ).metadata.free_flight_s[0]
        yield Sample("ArduPlane", genuine, "dataflash", card, (start, start + GENUINE_S))


def findings(sample: Sample, fault: Any | None) -> list[Finding] | None:
    """Warnings and errors of a log with a fault built in; None where the log has no such channel."""
    signals = shipped_map(sample.dialect)
    raw = read_raw(sample.path, sample.dialect, signals)
    if sample.span_s is not None:
        raw = FAULTS.cut(raw, *sample.span_s)
    card: AirframeCard | None = sample.card
    if fault is not None:
        changed = FAULTS.seeded(raw, signals, card, fault)
        if changed is None:
            return None
        raw, card = changed
    return [f for f in assemble(raw, signals, card).metadata.findings if f.severity != "info"]


def size_of(finding: Finding) -> float:
    """The size that a finding states, in the terms of a fault; NaN where it states none."""
    numbers = finding.numbers
    if "slope" in numbers:
        return float(numbers["slope"])
    if "delay_s" in numbers:
        return float(numbers["delay_s"])
    if "native_hz" in numbers:
        return float(numbers["logged_hz"] / numbers["native_hz"])
    if "start_s" in numbers:
        return float(numbers["end_s"] - numbers["start_s"])
    return float(numbers.get("values", math.nan))  # values of a wrapped number


def judged(fault: Any, found: Sequence[Finding], before: Sequence[Finding]) -> dict[str, Any]:
    """A row of the table: whether the fault is named with channel and size, and what else is said that was not before."""
    known = {(f.code, f.channel) for f in before}
    right = {f.channel: f for f in found if f.code in fault.codes and f.channel in fault.named}
    sizes = [size_of(f) for f in right.values()]
    slack = 0.03 if fault.kind == "late" else 0.0
    # A channel that was late before comes later still.
    due = {
        c: fault.size
        + sum(
            f.numbers["delay_s"]
            for f in before
            if fault.kind == "late" and (f.code, f.channel) == ("delay", c)
        )
        for c in right
    }
    sized = all(
        math.isnan(s) or abs(s - due[c]) <= WITHIN * abs(fault.size) + slack
        for c, s in zip(right, sizes, strict=True)
    )
    own = {*fault.channels, *fault.named}
    beside = [f for f in found if (f.code, f.channel) not in known and f.channel not in own]
    return {
        "channels": " ".join(fault.named),
        "size": round(fault.size, 6),
        "named": int(set(right) == set(fault.named)),
        "sized": int(bool(right) and sized),
        "stated": " ".join(f"{s:.4g}" for s in sizes),
        "beside": " ".join(f"{f.code}:{f.channel}" for f in beside),
    }


def healthy(
    folder: Path, flights: Sequence[str], genuine: Sequence[Path]
) -> Iterator[dict[str, Any]]:
    """A row a healthy log: flights of simulations, and genuine ones, of which some findings are known to be true."""
    logs = [
        (words, flown(folder, words, (".parquet", ".bin")[k % 2]))
        for k, words in enumerate(flights)
    ]
    for name, log in [*logs, *((path.stem, path) for path in genuine)]:
        card = aircraft_of(
            folder, "espaaro" if log in genuine else name.split()[0].removesuffix("_truth")
        )
        begin = time.process_time()
        told = {
            f"{f.code}:{f.channel}"
            for f in import_log(log, None, card).metadata.findings
            if f.severity != "info"
        }
        seconds = time.process_time() - begin
        true = {t for t in told if log in genuine and (t in TRUE or t.startswith("gap:"))}
        row = {
            "flight": name,
            "format": log.suffix[1:].lower(),
            "findings": " ".join(sorted(told - true)),
            "true": " ".join(sorted(true)),
            "cpu_s": round(seconds, 2),
        }
        print(row, flush=True)
        yield row


def main(argv: Sequence[str] | None = None) -> int:
    """Write faults.csv, healthy.csv and held_out.csv."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--genuine",
        type=Path,
        nargs="+",
        default=[],
        help="ArduPlane logs of the E-SPAARO: faults are built into the first, and all count as healthy",
    )
    parser.add_argument(
        "--flights", type=Path, default=Path("flights"), help="where simulated logs are kept"
    )
    parser.add_argument("--out", type=Path, default=HOME)
    parser.add_argument("--part", choices=("faults", "healthy", "held-out", "all"), default="all")
    args = parser.parse_args(argv)
    args.flights.mkdir(parents=True, exist_ok=True)
    if args.part in ("faults", "all"):
        rows = list(faulty(args.flights, args.genuine[0] if args.genuine else None))
        _write(args.out / "faults.csv", rows)
        print(
            f"{sum(row['named'] and row['sized'] for row in rows)} of {len(rows)} faults named with channel and size"
        )
    for part, flights, genuine in (("healthy", HEALTHY, args.genuine), ("held-out", HELD_OUT, [])):
        if args.part in (part, "all"):
            clean = list(healthy(args.flights, flights, genuine))
            _write(args.out / f"{part.replace('-', '_')}.csv", clean)
            print(
                f"{part}: {sum(bool(row['findings']) for row in clean)} of {len(clean)} healthy logs with a finding"
            )
    return 0


def faulty(folder: Path, genuine: Path | None) -> Iterator[dict[str, Any]]:
    """A row a log and fault."""
    for sample in samples(folder, genuine):
        before = findings(sample, None)
        assert before is not None
        for fault in FAULTS.FAULTS:
            found = findings(sample, fault)
            if found is not None:
                row = {"log": sample.name, "fault": fault.name, **judged(fault, found, before)}
                print(row, flush=True)
                yield row


def _write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.DictWriter(handle, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    sys.exit(main())
