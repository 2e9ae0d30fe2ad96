"""``uqharness sensitivity``: which uncertainty to reduce first, from a corner campaign or for the dissertation's modal example."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.terminal import drawing, visible
from uqharness.errors import BadInputError

if TYPE_CHECKING:
    from uqharness.campaign.sensitivity import MetricSensitivity

READINGS = ("as_corrected", "as_published")

_EXAMPLE = """examples:
  uqharness sensitivity campaigns/demo/results
  uqharness sensitivity campaigns/demo/results --interior campaigns/demo/middle --json
  uqharness sensitivity --modal as_published

On a campaign: writes DIR/sensitivity.csv and DIR/figures/sensitivity-*.svg; no flight is flown. --interior names a second
campaign, method = "levels" and the same seed, whose flights check that levels between the bounds stay inside the corners' p-box.
Exit codes: 0 done, 1 nothing could be compared (too many flights failed, or no metric differs), 2 bad input."""

_SHOWN = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")
_TITLES = ("median cross-track error", "median altitude error", "median speed error")


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``sensitivity`` to a parser."""
    parser = commands.add_parser(
        "sensitivity",
        help="which uncertainty to reduce first",
        description="Rank uncertain coefficients by the width they give to the p-box.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help="folder of a finished corner campaign")
    parser.add_argument("--interior", type=Path, metavar="DIR2", help="a campaign of levels inside the bounds, as a check")
    parser.add_argument("--modal", choices=READINGS, help="the dissertation's modal example, in one of two readings")
    parser.add_argument("--repeats", type=int, default=10, metavar="R", help="with --modal: independent repeats (default 10)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the repeats or of the resampling (default 0)")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    if (args.folder is None) == (args.modal is None):
        raise BadInputError("sensitivity takes either a campaign folder DIR or --modal as_corrected|as_published")
    if args.seed < 0:
        raise BadInputError(f"--seed {args.seed}: must not be negative")
    return _modal(args) if args.modal else _campaign(args)


def _modal(args: argparse.Namespace) -> int:
    from uqharness.sensitivity.modal import modal_sensitivity

    if args.interior is not None:
        raise BadInputError("--interior belongs to a campaign folder, not to --modal")
    if not 2 <= args.repeats <= 1000:
        raise BadInputError(f"--repeats {args.repeats}: 2 to 1000, so that the repeats' spread can be seen")
    with _progress("repeats") as update:
        found = modal_sensitivity(args.modal, args.repeats, args.seed, on_progress=update)
    if args.json:
        print(json.dumps({output: _modal_json(methods) for output, methods in found.results.items()}))
    else:
        print(f"{args.modal}: mean of {args.repeats} repeats, E = 1024, A = 100; 95 % interval of the mean")
        print(found.text())
    return 0


def _modal_json(methods: Any) -> dict[str, dict[str, Any]]:
    """Per parameter the five numbers, then the interval of each, one run's standard deviation, and reasons where undefined."""
    from uqharness.sensitivity.result import number

    found: dict[str, dict[str, Any]] = {}
    for method, result in methods.items():
        for k, (name, index) in enumerate(result.indices.items()):
            cell, as_dict = found.setdefault(name, {}), index.as_dict()
            cell[method] = as_dict["value"]
            cell.setdefault("interval", {})[method] = as_dict["interval"]
            cell.setdefault("std_of_one_run", {})[method] = number(float(result.details["std_of_one_run"][k]))
            if index.reason:
                cell.setdefault("reason", {})[method] = index.reason
    return found


def _campaign(args: argparse.Namespace) -> int:
    from uqharness.campaign.folder.files import record_table
    from uqharness.campaign.sensitivity import analyse_campaign, read_corner_campaign, read_interior_campaign
    from uqharness.campaign.sensitivity_tables import SENSITIVITY, as_csv, as_json

    flown = read_corner_campaign(args.folder)
    interior = None if args.interior is None else read_interior_campaign(args.interior, flown)
    with _progress("metrics") as update:
        found = analyse_campaign(flown, interior, seed=args.seed, on_progress=update)
    record_table(args.folder, SENSITIVITY, as_csv(found))
    figures = _figures(args.folder, found)
    if args.json:
        written = {"csv": str(args.folder / SENSITIVITY), "figures": [str(path) for path in figures]}
        print(json.dumps({"sensitivity": as_json(found), **written}))
    else:
        print(_campaign_text(args.folder, found, figures))
    return 0 if any(item.ranking.first for item in found) else 1


def _figures(folder: Path, found: Sequence[MetricSensitivity]) -> list[Path]:
    from uqharness.files import inner_folder, write_bytes
    from uqharness.report.plots.sensitivity import Panel, RangeBar, draw_ranges
    from uqharness.sensitivity.result import PairRange

    figures, paths = inner_folder(folder, "figures"), []
    for condition in dict.fromkeys(item.condition for item in found):
        panels = []
        for metric, title in zip(_SHOWN, _TITLES, strict=True):
            for item in found:
                if item.condition == condition and item.metric == metric and item.ranking.first:
                    bars = []
                    for name, index in item.result.indices.items():
                        assert isinstance(index, PairRange)
                        ends = index.minimum.value, index.maximum.value
                        bars.append(RangeBar(name, _or(index.minimum.low, ends[0]), *ends, _or(index.maximum.high, ends[1])))
                    panels.append(Panel(title, sorted(bars, key=lambda bar: -(bar.minimum + bar.maximum))))
        if panels:
            name = f"sensitivity-{condition.wind_mps:g}mps-{condition.turbulence}"
            paths.append(figures / f"{name}.svg")
            write_bytes(paths[-1], draw_ranges(panels, name).encode())
    return paths


def _or(value: float, other: float) -> float:
    return other if math.isnan(value) else value


def _campaign_text(folder: Path, found: Sequence[MetricSensitivity], figures: Sequence[Path]) -> str:
    from uqharness.campaign.sensitivity_tables import SENSITIVITY
    from uqharness.sensitivity.analysis import cell

    lines = []
    for condition in dict.fromkeys(item.condition for item in found):
        shown = [item for metric in _SHOWN for item in found if item.condition == condition and item.metric == metric]
        lines.append(f"{condition.words}: share of the p-box's width, smallest..largest over the pairs [95 % interval of both]")
        lines.append(f"  {'':<4}" + "".join(f"{item.metric:>32}" for item in shown))
        for name in shown[0].result.indices if shown else ():
            lines.append(f"  {name:<4}" + "".join(f"{cell(item.result.indices[name]):>32}" for item in shown))
        lines += [f"  {item.words}" for item in shown]
        lines += [f"  {statement}" for statement in dict.fromkeys(item.result.statement for item in shown if item.ranking.first)]
        lines.append("")
    written = ", ".join(str(path) for path in (folder / SENSITIVITY, *figures))
    return "\n".join([*lines, f"written: {written}"])


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A counter on a terminal, nothing in a pipe."""
    terminal = sys.stderr.isatty()

    def update(done: int, total: int) -> None:
        if terminal:
            print(f"\r{visible(what)}: {done} of {total}", end="", file=drawing(sys.stderr), flush=True)

    yield update
    if terminal:
        print(file=sys.stderr)
