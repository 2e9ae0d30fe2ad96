"""The modal example of the dissertation's section 4.7.1 beside its Tables 4.4 to 4.6, and the same through JSBSim.

    python -m campaigns.modal.reproduce --out campaigns/modal/results

The published study is one run; its size is not printed. Ours has E = 1024, A = 100 and is repeated, so that the spread of one
run is known and a printed number can be judged by it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.modal.through_jsbsim import jsbsim_study, what_is_left_out
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.sensitivity import (
    METHODS,
    Index,
    MethodResult,
    PairRange,
    Sensitivity,
    analyse,
    write_study,
)
from uqharness.sensitivity.modal import OUTPUTS, READINGS, modal_sensitivity
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft

TABLES = dict(zip(OUTPUTS, ("4_4", "4_5", "4_6"), strict=True))
PUBLISHED = PROJECT_ROOT / "tests" / "reference"
LOCAL_WITHIN, ENDS_WITHIN, STD_WITHIN = 0.001, 0.002, 3.0


def published(output: str) -> pd.DataFrame:
    """The printed table of one output as text, indexed by parameter: digits tell the rounding. Raises BadInputError."""
    path = PUBLISHED / f"table_{TABLES[output]}.csv"
    if not path.is_file():
        raise BadInputError(
            f"{path}: not there; the printed tables come with the project's source, not with the package"
        )
    return pd.read_csv(path, comment="#", index_col=0, dtype=str)


@dataclass(frozen=True)
class Cell:
    """One printed number beside ours. ``error`` is the distance allowed; ``agrees`` whether the print lies within."""

    output: str
    parameter: str
    column: str
    printed: str
    ours: float
    std: float
    error: float

    @property
    def agrees(self) -> bool:
        """Whether the printed value lies within what sampling and rounding explain."""
        return abs(float(self.printed) - self.ours) <= self.error


def compare(found: Sensitivity) -> tuple[list[Cell], dict[str, float]]:
    """Every printed cell beside ours, and the factor per output that the local cells share.

    Local cells carry the one p-box width that the author's samples happened to have: one factor per table, fitted. Monte Carlo
    cells may differ by three standard deviations of one run and by half a unit of the last printed place.
    """
    cells, factors = [], {}
    for output in OUTPUTS:
        table = published(output)
        methods = found[output]
        ours = np.array([_single(methods["local"], name).value for name in table.index])
        printed = table["local"].to_numpy(dtype=float)
        factors[output] = float(printed @ ours / (ours @ ours))
        for k, name in enumerate(table.index):
            for column in table.columns:
                text = str(table.loc[name, column])
                value, std = _ours(methods, name, k, column)
                if column == "local":
                    value *= factors[output]
                half_unit = 0.5 * 10.0 ** -(len(text.partition(".")[2]))
                error = {
                    "local": LOCAL_WITHIN,
                    "proposed_min": ENDS_WITHIN,
                    "proposed_max": ENDS_WITHIN,
                }.get(column, STD_WITHIN * std + (half_unit if "." in text else 0.5e-4))
                cells.append(Cell(output, name, column, text, value, std, error))
    return cells, factors


def _single(result: MethodResult, name: str) -> Index:
    index = result.indices[name]
    assert isinstance(index, Index)
    return index


def _ours(
    methods: Mapping[str, MethodResult], name: str, k: int, column: str
) -> tuple[float, float]:
    method, _, end = column.partition("_")
    result = methods[method]
    index = result.indices[name]
    if isinstance(index, PairRange):
        index = index.minimum if end == "min" else index.maximum
    return index.value, float(result.details["std_of_one_run"][k])


def table_text(output: str, cells: Sequence[Cell], factor: float) -> str:
    """One table as Markdown: ours, the standard deviation of one run, and the print; a miss in bold."""
    columns = [*METHODS[:-1], "proposed_min", "proposed_max"]
    head = f"| parameter | {' | '.join(column.replace('_', ' ') for column in columns)} |"
    lines = [
        f"Table {TABLES[output].replace('_', '.')}, {output}: ours ± one run (print). Local x {factor:.3f}.",
        "",
        head,
    ]
    lines.append("|" + "---|" * (len(columns) + 1))
    mine = [cell for cell in cells if cell.output == output]
    for name in dict.fromkeys(cell.parameter for cell in mine):
        row = [
            next(cell for cell in mine if (cell.parameter, cell.column) == (name, column))
            for column in columns
        ]
        lines.append(f"| `{name}` | " + " | ".join(map(_cell_text, row)) + " |")
    return "\n".join(lines)


def _cell_text(cell: Cell) -> str:
    spread = f" ± {cell.std:.4f}" if cell.column in ("scatter", "anova", "pbox") else ""
    text = f"{cell.ours:.4f}{spread} ({cell.printed})"
    return text if cell.agrees else f"**{text}**"


def beside_jsbsim(
    as_published: Sensitivity, as_corrected: Sensitivity, jsbsim: Sensitivity, output: str
) -> str:
    """Markdown: the proposed method's ranges of both readings and of JSBSim's model, and JSBSim's local shares."""
    lines = [
        "| parameter | as_published | as_corrected | JSBSim | JSBSim, local |",
        "|---|---|---|---|---|",
    ]
    for name in jsbsim[output]["proposed"].indices:
        row = [
            _range(item[output]["proposed"].indices[name])
            for item in (as_published, as_corrected, jsbsim)
        ]
        lines.append(
            f"| `{name}` | {' | '.join(row)} | {_single(jsbsim[output]['local'], name).value:.4f} |"
        )
    return "\n".join(lines)


def _range(index: Index | PairRange) -> str:
    assert isinstance(index, PairRange)
    return f"{index.minimum.value:.4f} .. {index.maximum.value:.4f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Write tables.md and jsbsim.npz; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.modal.reproduce", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for tables.md and jsbsim.npz"
    )
    parser.add_argument(
        "--repeats", type=int, default=20, metavar="R", help="repeats of each reading (default 20)"
    )
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    aircraft = find_aircraft("espaaro")
    by_reading = {
        reading: modal_sensitivity(reading, args.repeats, on_progress=_say(reading))
        for reading in READINGS
    }
    cells, factors = compare(by_reading["as_published"])
    study = jsbsim_study(aircraft, on_progress=_say("JSBSim"))
    write_study(study, args.out / "jsbsim.npz")
    through = analyse(study, ("local", "proposed"))
    parts = [table_text(output, cells, factors[output]) for output in OUTPUTS]
    missed = [
        f"{c.output} {c.parameter} {c.column}: {c.ours:.4f} for {c.printed}"
        for c in cells
        if not c.agrees
    ]
    parts.append(
        f"{len(cells) - len(missed)} of {len(cells)} cells agree. Not: {'; '.join(missed) or 'none'}."
    )
    for output in OUTPUTS:
        models = by_reading["as_published"], by_reading["as_corrected"], through
        parts.append(f"{output}, three models\n\n{beside_jsbsim(*models, output)}")
    lines = [
        "| model | phugoid zeta | wn, rad/s | short-period zeta | wn, rad/s |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | " + " | ".join(f"{value:.4f}" for value in row) + " |"
        for name, row in what_is_left_out(aircraft)
    ]
    parts.append("What the linear model leaves out\n\n" + "\n".join(lines))
    write_bytes(args.out / "tables.md", ("\n\n".join(parts) + "\n").encode())
    print(args.out / "tables.md")
    return 0


def _say(what: str) -> Callable[[int, int], None]:
    def update(done: int, total: int) -> None:
        if sys.stderr.isatty():
            print(
                f"\r{what}: {done} of {total}",
                end="\n" if done == total else "",
                file=sys.stderr,
                flush=True,
            )

    return update


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BadInputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
