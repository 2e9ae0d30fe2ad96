"""What a study of rare excursions leaves on disk: levels.json, replicates.csv, plain.csv, jsbsim.csv, and hits/ by replicate.

A piece counts once its row stands in its table; a kill at any moment costs the piece in the air.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from campaigns.rare_events.states import NAMES
from campaigns.rare_events.study import Counted, Tuned
from uqharness.campaign.rare_events import DistancePredictor, FirstExcursion
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import Split
from uqharness.statistics import Levels
from uqharness.text_tables import csv_rows, csv_text

LEVELS, REPLICATES, PLAIN, JSBSIM = "levels.json", "replicates.csv", "plain.csv", "jsbsim.csv"
_NUMBERS = ("number", "flights", "ended", "path_s", "most", "core_s")
_TEXTS = ("flights_id", "version")
_BY_RADIUS = ("probability", "events", "squares")


@dataclass(frozen=True)
class Line:
    """A piece in its table: its number, what it counted, the digest of what it flew, and the version that flew it."""

    number: int
    counted: Counted
    flights_id: str
    version: str


@dataclass(frozen=True)
class Folder:
    """The folder of one study, whose excursions are counted at ``radii_m``."""

    path: Path
    radii_m: tuple[float, ...]

    def tuned(self) -> Tuned | None:
        """What the pilot chose, if it has flown. Raises BadInputError for a damaged file."""
        file = self.path / LEVELS
        if not file.exists():
            return None
        try:
            known = json.loads(file.read_bytes())
            levels = Levels(tuple(map(float, known["scores"])), int(known["copies"]))
            found = known["predicted"]
            if found.pop("regressors") != list(NAMES):
                raise ValueError("predictions of other regressors")
            rows = tuple(tuple(map(float, row)) for row in found.pop("coefficients"))
            lists = {
                name: tuple(map(float, found[name]))
                for name in ("horizons_s", "constants", "sigmas")
            }
            predicted = DistancePredictor(float(found["radius_m"]), coefficients=rows, **lists)
            return Tuned(levels, predicted, float(known["core_s"]), float(known["plain_h"]))
        except (ValueError, KeyError, TypeError) as error:
            raise BadInputError(
                f"{file}: no levels of a pilot ({error}); remove it and its replicates, and fly again"
            ) from error

    def keep_tuned(self, tuned: Tuned) -> None:
        """Write levels.json: levels in standard deviations, and the predictions' coefficients by horizon and regressor."""
        known = {
            "scores": tuned.levels.scores,
            "copies": tuned.levels.copies,
            "core_s": tuned.core_s,
            "plain_h": tuned.plain_h,
        }
        self._write(LEVELS, known | {"predicted": {"regressors": NAMES} | asdict(tuned.predicted)})

    def lines(self, table: str) -> dict[int, Line]:
        """Pieces of replicates.csv or plain.csv by number. Raises BadInputError for a damaged table."""
        file = self.path / table
        if not file.exists():
            return {}
        columns = {name: [f"{name}_{radius:g}m" for radius in self.radii_m] for name in _BY_RADIUS}
        numbers = [
            *_NUMBERS,
            *(name for each in ("probability", "events") for name in columns[each]),
        ]
        found = {}
        for row in csv_rows(file.read_bytes(), file, numbers, _TEXTS, columns["squares"]):
            by_radius = {
                name: tuple(float(row[each] or "nan") for each in columns[name])
                for name in _BY_RADIUS
            }
            counted = Counted(
                flights=int(row["flights"]),
                **by_radius,
                ended=float(row["ended"]),
                path_s=float(row["path_s"]),
                most=int(row["most"]),
                core_s=float(row["core_s"]),
            )
            found[int(row["number"])] = Line(
                int(row["number"]), counted, row["flights_id"], row["version"]
            )
        return found

    def add(self, table: str, line: Line) -> None:
        """Add a piece to its table."""
        kept = self.lines(table) | {line.number: line}
        rows = []
        for number in sorted(kept):
            one = kept[number]
            row: dict[str, Any] = {"number": number}
            for name, value in asdict(one.counted).items():
                by_radius = zip(self.radii_m, value, strict=True) if name in _BY_RADIUS else ()
                row |= {f"{name}_{radius:g}m": each for radius, each in by_radius} or {name: value}
            rows.append(
                {
                    name: "" if value != value else str(value)
                    for name, value in (
                        row | {"flights_id": one.flights_id, "version": one.version}
                    ).items()
                }
            )
        self._table(table, rows)

    def hits(self) -> list[FirstExcursion]:
        """Excursions that were kept with their path, of the replicates that count."""
        found = []
        for number in self.lines(REPLICATES):
            known = json.loads((self.path / "hits" / f"{number:03d}.json").read_bytes())
            found += [
                FirstExcursion(
                    **{**each, "splits": tuple(Split(**split) for split in each["splits"])}
                )
                for each in known
            ]
        return found

    def keep_hits(self, number: int, hits: Sequence[FirstExcursion]) -> None:
        """Write those of one replicate."""
        self._write(f"hits/{number:03d}.json", [asdict(hit) for hit in hits])

    def reflown(self) -> list[dict[str, str]]:
        """Rows of jsbsim.csv. Raises BadInputError for a damaged table."""
        file = self.path / JSBSIM
        return (
            csv_rows(file.read_bytes(), file, ["difference_m", "distance_m"], ["first_row_beyond"])
            if file.exists()
            else []
        )

    def keep_reflown(self, rows: Sequence[Mapping[str, str]]) -> None:
        """Write jsbsim.csv."""
        self._table(JSBSIM, rows)

    def _table(self, name: str, rows: Sequence[Mapping[str, str]]) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        write_bytes(self.path / name, csv_text(rows).encode())

    def _write(self, name: str, known: object) -> None:
        (self.path / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(self.path / name, (json.dumps(known) + "\n").encode())
