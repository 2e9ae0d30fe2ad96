"""`log info` and `log import`: arguments, printing, exit codes (0 done, 1 the answer is no, 2 bad input, 130 stopped).

`add_arguments` plugs the two into a larger command; `python -m sysid.logs.commands` runs them alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from sysid.errors import Finding, LogError
from sysid.foreign.raw import Progress
from sysid.logs.info import LogInfo, log_info
from sysid.logs.load import default_cache, import_log
from sysid.logs.manoeuvres import label_manoeuvres
from sysid.record import FlightRecord
from sysid.terminal import clean_terminal, drawing, visible

_LOG_HELP = "DataFlash .bin or .log, MAVLink .tlog, PX4 .ulg, JSBSim's CSV, a flight record in Parquet or CSV"


def add_arguments(subparsers: Any) -> None:
    """Register `info` and `import` on the subparsers of a `log` command; each sets `run(args) -> exit code`."""
    info = subparsers.add_parser(
        "info",
        help="what a log holds and what it is good for",
        description="Say what a log holds and, purpose by purpose, what it is good for. Exit code 1: for nothing.",
        epilog="example: log info flight1.bin --aircraft aircraft/espaaro",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _common(info)
    info.set_defaults(run=run_info)
    importing = subparsers.add_parser(
        "import",
        help="turn a log into a flight record",
        description="Turn a log into a flight record (Parquet or CSV by the suffix of --out).",
        epilog="example: log import flight1.bin --aircraft aircraft/espaaro --out flight1.parquet",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _common(importing)
    importing.add_argument("--out", type=Path, required=True, metavar="FILE", help="FILE.parquet or FILE.csv")
    importing.add_argument("--whole", action="store_true", help="keep ground and tow; without it free flight alone is kept")
    importing.add_argument(
        "--manoeuvres",
        type=Path,
        metavar="FILE.csv",
        help="table with the columns manoeuvre, start_s, end_s (and flight) that labels the record",
    )
    importing.set_defaults(run=run_import)


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", type=Path, metavar="LOG", help=_LOG_HELP)
    parser.add_argument("--map", type=Path, metavar="MAP.toml", help="your own signal map, laid over the dialect's")
    parser.add_argument("--aircraft", metavar="AIRCRAFT", help="name under aircraft/, folder, or airframe.toml")
    parser.add_argument("--cache", type=Path, metavar="DIR", help=f"cache of imported logs (default {default_cache()})")
    parser.add_argument("--no-cache", action="store_true", help="neither read nor write the cache")
    parser.add_argument("--json", action="store_true", help="print JSON for machines")


def run_info(args: argparse.Namespace) -> int:
    """0 when the log serves a purpose, 1 when it serves none."""
    info = log_info(_load(args))
    print(json.dumps(info.as_dict(), indent=2) if args.json else format_info(info))
    return 0 if info.serves else 1


def run_import(args: argparse.Namespace) -> int:
    """Write the record; 0."""
    if args.out.suffix.lower() not in (".parquet", ".csv"):
        raise LogError(f"--out ends in '{args.out.suffix}'; allowed are .parquet and .csv", args.out)
    record = _load(args)
    if args.manoeuvres is not None:
        record = label_manoeuvres(record, args.manoeuvres, args.log.stem)
    whole = (float(record["time_s"][0]), float(record["time_s"][-1]))
    kept = whole
    if not args.whole and record.metadata.free_flight_s and record.metadata.dialect != "record":
        kept = record.metadata.free_flight_s[0]
        record = record.between(*kept)
    try:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        record.write(args.out)
    except OSError as e:
        raise LogError(f"cannot be written ({e.strerror})", args.out) from None
    report = {
        "out": str(args.out),
        "rows": len(record),
        "grid_hz": record.metadata.grid_hz,
        "kept_s": list(kept),
        "log_s": list(whole),
        "columns": list(record.columns),
        "findings": [f.as_dict() for f in record.metadata.findings],
    }
    print(json.dumps(report, indent=2) if args.json else _format_import(record, args.out, kept, whole))
    return 0


def _load(args: argparse.Namespace) -> FlightRecord:
    cache = None if args.no_cache else (args.cache or default_cache())
    card = None if args.aircraft is None else find_aircraft(args.aircraft)
    with _ProgressLine(args.log.name) as progress:
        return import_log(args.log, args.map, card, cache=cache, progress=progress)


def find_aircraft(name: str) -> Path:
    """A folder or file as given, else aircraft/NAME below the working directory. LogError when neither is there."""
    for candidate in (Path(name), Path("aircraft") / name):
        if candidate.is_file() or (candidate / "airframe.toml").is_file():
            return candidate
    known = sorted(p.parent.name for p in Path("aircraft").glob("*/airframe.toml"))
    raise LogError(f"no aircraft '{name}': neither a folder with an airframe.toml nor one of aircraft/ {known}")


class _ProgressLine:
    """A percentage on a terminal's standard error; silent in a pipe."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.shown = -1

    def __enter__(self) -> Progress | None:
        return self._show if sys.stderr.isatty() else None

    def __exit__(self, *_: object) -> None:
        if self.shown >= 0:
            drawing(sys.stderr).write("\r\x1b[K")

    def _show(self, share: float) -> None:
        percent = int(100 * share)
        if percent != self.shown:
            self.shown = percent
            drawing(sys.stderr).write(f"\rreading {visible(self.title)} {percent} %")
            sys.stderr.flush()


def format_info(info: LogInfo) -> str:
    """The report as text."""
    flight = "none" if info.flight_s is None else f"{info.flight_s[0]:.1f} to {info.flight_s[1]:.1f} s"
    lines = [
        f"{info.source}  ({info.dialect})",
        f"vehicle      {info.vehicle or 'not said'}",
        f"duration     {info.duration_s:.1f} s from {info.start_s:.1f} s, grid {info.grid_hz:.1f} Hz",
        f"free flight  {flight}",
        "",
        "channels",
    ]
    lines += [f"  {n:18} {info.rates_hz.get(n, float('nan')):7.1f} Hz  {label}" for n, label in info.channels.items()]
    lines += ["", "findings"]
    lines += [f"  {line}" for line in condensed(info.findings)] or ["  none"]
    lines += ["", "good for"]
    lines += [f"  {'yes' if p.serves else 'no ':4} {p.name}: {p.reason}" for p in info.purposes]
    return "\n".join(lines)


def _format_import(record: FlightRecord, out: Path, kept: tuple[float, float], whole: tuple[float, float]) -> str:
    span = f"{kept[0]:.2f} to {kept[1]:.2f} s of {whole[0]:.2f} to {whole[1]:.2f} s"
    lines = [
        f"{out}: {len(record)} rows at {record.metadata.grid_hz:g} Hz, {span}",
        f"columns: {', '.join(record.columns)}",
    ]
    return "\n".join(lines + condensed([f for f in record.metadata.findings if f.severity != "info"]))


def condensed(findings: Sequence[Finding]) -> list[str]:
    """One line per code and severity: the first message, and the channels of which the same can be said."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        groups.setdefault((f.severity, f.code), []).append(f)
    lines = []
    for (severity, code), members in groups.items():
        others = [f.channel for f in members[1:] if f.channel]
        more = f" (also: {', '.join(others)})" if others else ""
        lines.append(f"{severity:8} {code}: {members[0].message}{more}")
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run `info` or `import` alone."""
    parser = argparse.ArgumentParser(prog="python -m sysid.logs.commands", description="Flight logs: what is in them.")
    add_arguments(parser.add_subparsers(required=True, metavar="info|import"))
    with clean_terminal():
        args = parser.parse_args(argv)
        run: Callable[[argparse.Namespace], int] = args.run
        try:
            return run(args)
        except LogError as e:
            print(f"error: {e}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return 130


if __name__ == "__main__":
    sys.exit(main())
