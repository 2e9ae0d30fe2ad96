"""The modal example of the dissertation's section 4.7.1 beside its Tables 4.4 to 4.6, and the same
through JSBSim.

    python -m campaigns.modal.reproduce --out campaigns/modal/results

The published study is one run; its size is not printed. Ours has E = 1024, A = 100 and is repeated,
so that the spread of one run is known and a printed number can be judged by it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from campaigns.library.study import exit_code, published_table, study_parser
from campaigns.modal.through_jsbsim import jsbsim_study, successive_models
from uqharness.files import write_text
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
from uqharness.simulator.aircraft import find_aircraft

TABLES = dict(zip(OUTPUTS, ("4.4", "4.5", "4.6"), strict=True))
LOCAL_WITHIN, ENDS_WITHIN, STD_WITHIN = 0.001, 0.002, 3.0


def published(output: str) -> pd.DataFrame:
    """Read the printed table of one output as text, by parameter: digits show the rounding. Raises
    BadInputError."""
    return published_table(TABLES[output], index_col=0, dtype=str)


@dataclass(frozen=True)
class Cell:
    """One printed number beside ours. ``error`` is the distance allowed; ``agrees`` whether the
    print lies within."""

    output: str
    parameter: str
    column: str
    printed: str
    ours: float
    std: float
    error: float

    @property
    def agrees(self) -> bool:
        """Whether sampling and rounding explain the difference from the printed value."""
        return abs(float(self.printed) - self.ours) <= self.error

    @property
    def text(self) -> str:
        """The cell as Markdown."""
        scatter = f" ± {self.std:.4f}" if self.column in ("scatter", "anova", "pbox") else ""
        text = f"{self.ours:.4f}{scatter} ({self.printed})"
        return text if self.agrees else f"**{text}**"


def compare(results: Sensitivity) -> tuple[list[Cell], dict[str, float]]:
    """Compare every printed cell with ours, and return the factor per output that the local cells
    share.

    Local cells carry the one p-box width that the author's samples happened to have: one factor per
    table, fitted. Monte Carlo cells may differ by three standard deviations of one run and by half
    a unit of the last printed place.
    """
    cells, factors = [], {}
    for output in OUTPUTS:
        table, methods = published(output), results[output]
        ours = np.array([_single(methods["local"], name).value for name in table.index])
        printed = table["local"].to_numpy(dtype=float)
        factors[output] = float(printed @ ours / (ours @ ours))
        for k, name in enumerate(table.index):
            for column in table.columns:
                text = str(table.loc[name, column])
                value, std = _ours(methods, name, k, column)
                value *= factors[output] if column == "local" else 1.0
                rounding = 0.5 * 10.0 ** -len(text.partition(".")[2]) if "." in text else 0.5e-4
                error = STD_WITHIN * std + rounding
                if column in ("local", "proposed_min", "proposed_max"):
                    error = LOCAL_WITHIN if column == "local" else ENDS_WITHIN
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
    """Return one table as Markdown: ours, the standard deviation of one run, and the print; a miss
    in bold."""
    columns = [*METHODS[:-1], "proposed_min", "proposed_max"]
    title = f"Table {TABLES[output]}, {output}: ours ± one run (print). Local x {factor:.3f}."
    lines = [title, "", _line("parameter", *(column.replace("_", " ") for column in columns))]
    lines.append("|" + "---|" * (len(columns) + 1))
    by_place = {(c.parameter, c.column): c for c in cells if c.output == output}
    for name in dict.fromkeys(parameter for parameter, _ in by_place):
        lines.append(_line(f"`{name}`", *(by_place[name, column].text for column in columns)))
    return "\n".join(lines)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def beside_jsbsim(readings: Sequence[Sensitivity], jsbsim: Sensitivity, output: str) -> str:
    """Return Markdown of the proposed method's ranges by both readings and JSBSim's model, and
    JSBSim's local shares."""
    lines = [_line("parameter", "as_published", "as_corrected", "JSBSim", "JSBSim, local")]
    lines.append("|" + "---|" * 5)
    for name in jsbsim[output]["proposed"].indices:
        indices = (item[output]["proposed"].indices[name] for item in (*readings, jsbsim))
        ranges = (f"{i.minimum.value:.4f} .. {i.maximum.value:.4f}" for i in indices)
        local = _single(jsbsim[output]["local"], name).value
        lines.append(_line(f"`{name}`", *ranges, f"{local:.4f}"))
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Write tables.md and jsbsim.npz, and return the process's exit code."""
    parser = study_parser(__doc__, out="tables.md and jsbsim.npz")
    words = "repeats of each reading (20)"
    parser.add_argument("--repeats", type=int, default=20, metavar="R", help=words)
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    args.out.mkdir(parents=True, exist_ok=True)
    aircraft = find_aircraft("espaaro")
    by_reading = {
        reading: modal_sensitivity(reading, args.repeats, on_progress=_callback(reading))
        for reading in READINGS
    }
    cells, factors = compare(by_reading["as_published"])
    study = jsbsim_study(aircraft, callback=_callback("JSBSim"))
    write_study(study, args.out / "jsbsim.npz")
    parts = [table_text(output, cells, factors[output]) for output in OUTPUTS]
    missed = [
        f"{c.output} {c.parameter} {c.column}: {c.ours:.4f} for {c.printed}"
        for c in cells
        if not c.agrees
    ]
    agree = f"{len(cells) - len(missed)} of {len(cells)} cells agree"
    parts.append(f"{agree}. Not: {'; '.join(missed) or 'none'}.")
    through = analyse(study, ("local", "proposed"))
    readings = by_reading["as_published"], by_reading["as_corrected"]
    for output in OUTPUTS:
        parts.append(f"{output}, three models\n\n{beside_jsbsim(readings, through, output)}")
    lines = [_line("model", "phugoid zeta", "wn, rad/s", "short-period zeta", "wn, rad/s")]
    lines.append("|" + "---|" * 5)
    for name, row in successive_models(aircraft):
        lines.append(_line(name, *(f"{value:.4f}" for value in row)))
    parts.append("What the linear model leaves out\n\n" + "\n".join(lines))
    write_text(args.out / "tables.md", "\n\n".join(parts) + "\n")
    print(args.out / "tables.md")
    return 0


def _callback(name: str) -> Callable[[int, int], None]:
    def update(done: int, total: int) -> None:
        if sys.stderr.isatty():
            end = "\n" if done == total else ""
            print(f"\r{name}: {done} of {total}", end=end, file=sys.stderr, flush=True)

    return update


if __name__ == "__main__":
    sys.exit(main())
