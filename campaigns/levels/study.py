"""Simulated campaigns of known truth, repeated: how often limits miss, as a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from campaigns.library.study import cells, exit_code, study_parser, write_csv
from uqharness.errors import BadInputError
from uqharness.text_tables import text_table


def allowed(error: float, repeats: int) -> float:
    """Return the share of repeats that may be wrong at a chance of ``error`` each: three standard
    deviations above it."""
    return error + 3.0 * math.sqrt(error * (1.0 - error) / repeats)


Results = Sequence[tuple[Any, dict[str, float]]]
"""Truths and what was measured of each."""


@dataclass(frozen=True)
class LevelStudy:
    """Truths, what is measured of each in so many repeats, and the table of both.

    ``columns``: attributes of the truth or of the level, as ``cells`` takes them, and ``kept``;
    ``passes`` judges truths, levels and repeats together.
    """

    doc: str
    table: str
    repeats: int
    least: int
    columns: str
    truths: Sequence[Any]
    measured: Callable[[Any, int], dict[str, float]]
    keeps_level: Callable[[Any, int], bool]
    passes: Callable[[Results, int], bool]

    def main(self, argv: Sequence[str] | None = None) -> int:
        """Run the study and return the process's exit code."""
        parser = study_parser(self.doc, out=self.table)
        parser.add_argument("--repeats", type=int, default=self.repeats)
        args = parser.parse_args(argv)

        def run() -> int:
            if args.repeats < self.least:
                raise BadInputError(f"--repeats: {self.least} at least, or nothing is shown")
            results = [(truth, self.measured(truth, args.repeats)) for truth in self.truths]
            rows = [self.row(truth, level, args.repeats) for truth, level in results]
            write_csv(args.out / self.table, rows)
            print("\n".join(text_table(rows)))
            return 0 if self.passes(results, args.repeats) else 1

        return exit_code(run)

    def row(self, truth: Any, level: Any, repeats: int) -> dict[str, str]:
        """Return a row of the table."""
        names = [column.partition(":")[0] for column in self.columns.split()]
        values = {n: level[n] if n in level else getattr(truth, n, None) for n in names}
        return cells(values | {"kept": self.keeps_level(level, repeats)}, self.columns)
