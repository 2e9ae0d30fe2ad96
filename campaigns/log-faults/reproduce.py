"""Are faults of a log named with channel and size, and are healthy logs left alone? Three logs,
faults.py, healthy logs.

python -m campaigns.log-faults.reproduce [--genuine LOG.BIN ...] [--flights DIR] [--out DIR]
"""

from __future__ import annotations

import math
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from campaigns.library.study import study_parser, write_csv
from sysid.errors import Finding
from sysid.logs import import_log
from sysid.logs.assemble import assemble
from sysid.logs.card import AirframeCard, parse_card, read_card
from sysid.logs.load import read_raw
from sysid.logs.signal_map import shipped_map
from sysid.record import FlightRecord
from tests.helpers.log_writers import px4_topics, write_ulog
from uqharness.simulator import find_aircraft

from .faults import FAULTS, Fault, part_of, seeded

HOME = Path(__file__).parent
WITHIN = 0.1
"""Relative, of a factor or a lateness; lateness has 0.03 s more, since a channel is known on its
own samples alone."""
GENUINE_S = 130.0
"""Of the genuine log, from the release on: all faults in the whole of it would take an hour."""

IDENT = "espaaro_truth --script flight-ident --noise --seed 1"
PX4 = "espaaro_truth --script flight-bounds --noise --seed 2"
HEALTHY, HELD_OUT = (
    tuple((HOME / f"{name}.txt").read_text().splitlines()) for name in ("healthy", "held_out")
)
"""Flights of healthy logs, as words of `uqharness fly`; no check was made or changed with those of
HELD_OUT."""
TRUE = frozenset({"estimate:alpha_rad", "estimate:beta_rad", "delay:ground velocity"})
"""True of every ArduPlane log without vanes: AOA is computed, and a receiver's velocity comes a
tenth of a second late. Gaps are where the logger dropped records."""
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
    """A log, its dialect, its card and the span of it that is used (None: all)."""

    name: str
    path: Path
    dialect: str
    card: AirframeCard
    span_s: tuple[float, float] | None = None


def flight_log(folder: Path, arguments: str, suffix: str) -> Path:
    """Return the log of a flight, flown unless it exists."""
    path = folder / (arguments.replace("--", "").replace(" ", "-") + suffix)
    name, *remaining = shlex.split(arguments)
    _run("fly", str(aircraft_of(folder, name)), *remaining, "--out", str(path), makes=path)
    return path


def aircraft_of(folder: Path, name: str) -> Path:
    """Return the aircraft's folder; of JSBSim's collection a copy with a card, which servo outputs
    and noise need."""
    if name.startswith("espaaro"):
        return find_aircraft(name).folder
    copy = folder / f"my-{name}"
    _run("instrument", name, "--out", str(copy), "--no-check", makes=copy)
    return copy


def _run(*words: str, makes: Path) -> None:
    """Run a command of uqharness unless what it makes exists."""
    if makes.exists():
        return
    command = [sys.executable, "-m", "uqharness", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not makes.exists():
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")


def samples(folder: Path, genuine: Path | None) -> Iterator[Sample]:
    """Yield the logs that faults are built into."""
    card = read_card(find_aircraft("espaaro").folder)
    yield Sample("simulated DataFlash", flight_log(folder, IDENT, ".bin"), "dataflash", card)
    px4 = folder / "px4.ulg"
    write_ulog(px4, px4_topics(FlightRecord.read(flight_log(folder, PX4, ".parquet"))))
    yield Sample("ULog", px4, "ulog", parse_card(CARD, Path("airframe.toml")))
    if genuine is not None:
        log = import_log(genuine, None, find_aircraft("espaaro").folder)
        start, _ = log.metadata.free_flight_s[0]
        yield Sample("ArduPlane", genuine, "dataflash", card, (start, start + GENUINE_S))


def findings(sample: Sample, fault: Fault | None) -> list[Finding] | None:
    """Return warnings and errors of a log with a fault built in; None where the log has no such
    channel."""
    signals = shipped_map(sample.dialect)
    raw = read_raw(sample.path, sample.dialect, signals)
    if sample.span_s is not None:
        raw = part_of(raw, *sample.span_s)
    card: AirframeCard | None = sample.card
    if fault is not None:
        changed = seeded(raw, signals, card, fault)
        if changed is None:
            return None
        raw, card = changed
    return [f for f in assemble(raw, signals, card).metadata.findings if f.severity != "info"]


def size_of(finding: Finding) -> float:
    """Return the size that a finding states, in the terms of a fault; NaN where it states none."""
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


def score(fault: Fault, after: Sequence[Finding], before: Sequence[Finding]) -> dict[str, Any]:
    """Return a row: whether the fault is named with channel and size, and findings of other
    channels that were not there before."""
    previous = {(f.code, f.channel) for f in before}
    right = {f.channel: f for f in after if f.code in fault.codes and f.channel in fault.named}
    sizes = {channel: size_of(finding) for channel, finding in right.items()}
    late = fault.kind == "late"
    # A channel that was late before comes later still.
    delays = [f for f in before if late and f.code == "delay"]
    due = {
        c: fault.size + sum(f.numbers["delay_s"] for f in delays if f.channel == c) for c in right
    }
    slack = WITHIN * abs(fault.size) + (0.03 if late else 0.0)
    sized = all(math.isnan(size) or abs(size - due[c]) <= slack for c, size in sizes.items())
    expected = {*fault.channels, *fault.named}
    reference = [
        f for f in after if (f.code, f.channel) not in previous and f.channel not in expected
    ]
    return {
        "channels": " ".join(fault.named),
        "size": round(fault.size, 6),
        "named": int(set(right) == set(fault.named)),
        "sized": int(bool(right) and sized),
        "stated": " ".join(f"{size:.4g}" for size in sizes.values()),
        "beside": " ".join(f"{f.code}:{f.channel}" for f in reference),
    }


def healthy(
    folder: Path, flights: Sequence[str], genuine: Sequence[Path]
) -> Iterator[dict[str, Any]]:
    """Yield a row per healthy log: flights of simulations, and genuine ones, of which some findings
    are true."""
    logs = [
        (words, flight_log(folder, words, (".parquet", ".bin")[k % 2]))
        for k, words in enumerate(flights)
    ]
    for name, log in [*logs, *((path.stem, path) for path in genuine)]:
        aircraft = "espaaro" if log in genuine else name.split()[0].removesuffix("_truth")
        card, start = aircraft_of(folder, aircraft), time.process_time()
        metadata = import_log(log, None, card).metadata
        seconds = time.process_time() - start
        codes = {f"{f.code}:{f.channel}" for f in metadata.findings if f.severity != "info"}
        true = {c for c in codes if log in genuine and (c in TRUE or c.startswith("gap:"))}
        row = {
            "flight": name,
            "format": log.suffix[1:].lower(),
            "findings": " ".join(sorted(codes - true)),
            "true": " ".join(sorted(true)),
            "cpu_s": round(seconds, 2),
        }
        print(row, flush=True)
        yield row


def faulty(folder: Path, genuine: Path | None) -> Iterator[dict[str, Any]]:
    """Yield a row per log and fault."""
    for sample in samples(folder, genuine):
        before = findings(sample, None)
        assert before is not None
        for fault in FAULTS:
            after = findings(sample, fault)
            if after is not None:
                row = {"log": sample.name, "fault": fault.name, **score(fault, after, before)}
                print(row, flush=True)
                yield row


def main(argv: Sequence[str] | None = None) -> int:
    """Write faults.csv, healthy.csv and held_out.csv."""
    parser = study_parser(__doc__, out=HOME)
    option, words = (
        parser.add_argument,
        "ArduPlane logs of the E-SPAARO: the first gets faults, all count as healthy",
    )
    option("--genuine", type=Path, nargs="+", default=[], help=words)
    option("--flights", type=Path, default=Path("flights"), help="where simulated logs are kept")
    option("--part", choices=("faults", "healthy", "held-out", "all"), default="all")
    args = parser.parse_args(argv)
    args.flights.mkdir(parents=True, exist_ok=True)
    if args.part in ("faults", "all"):
        rows = list(faulty(args.flights, args.genuine[0] if args.genuine else None))
        _write(args.out / "faults.csv", rows)
        listed = sum(row["named"] and row["sized"] for row in rows)
        print(f"{listed} of {len(rows)} faults named with channel and size")
    for part, flights, genuine in (("healthy", HEALTHY, args.genuine), ("held-out", HELD_OUT, [])):
        if args.part in (part, "all"):
            rows = list(healthy(args.flights, flights, genuine))
            _write(args.out / f"{part.replace('-', '_')}.csv", rows)
            count = sum(bool(row["findings"]) for row in rows)
            print(f"{part}: {count} of {len(rows)} healthy logs with a finding")
    return 0


def _write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    write_csv(path, [{name: str(value) for name, value in row.items()} for row in rows])


if __name__ == "__main__":
    sys.exit(main())
