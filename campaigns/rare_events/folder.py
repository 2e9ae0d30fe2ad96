"""What a study of rare excursions leaves on disk: levels.json, replicates.csv, plain.csv,
jsbsim.csv and hits.parquet.

A piece counts once its row stands in its table: an interruption costs the piece in the air.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from campaigns.library.study import write_csv
from campaigns.rare_events.states import NAMES
from campaigns.rare_events.study import Counts, Tuning
from uqharness.campaign.rare_events import DistancePredictor, FirstExcursion
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import Split
from uqharness.parquet_files import read_table, write_table
from uqharness.statistics import Levels
from uqharness.text_tables import csv_rows

LEVELS, REPLICATES, PLAIN, JSBSIM = "levels.json", "replicates.csv", "plain.csv", "jsbsim.csv"
HITS = "hits.parquet"
_NUMBERS = ("number", "flights", "ended", "path_s", "most", "core_s")
_TEXTS = ("flights_id", "version")
_BY_RADIUS = ("probability", "events", "squares")
_LISTS = ("horizons_s", "constants", "sigmas")


@dataclass(frozen=True)
class Piece:
    """A piece in its table: its number, what it counted, the digest of what it flew, and the
    version that flew it."""

    number: int
    counts: Counts
    flights_id: str
    version: str


@dataclass(frozen=True)
class Folder:
    """The folder of one study, whose excursions are counted at ``radii_m``."""

    path: Path
    radii_m: tuple[float, ...]

    def tuning(self) -> Tuning | None:
        """Read what the pilot chose, if it has flown. Raises BadInputError for a damaged file."""
        file = self.path / LEVELS
        if not file.exists():
            return None
        try:
            content = json.loads(file.read_bytes())
            levels = Levels(tuple(map(float, content["scores"])), int(content["copies"]))
            fit = content["predicted"]
            if fit["regressors"] != list(NAMES):
                raise ValueError("predictions of other regressors")
            rows = tuple(tuple(map(float, row)) for row in fit["coefficients"])
            lists = {name: tuple(map(float, fit[name])) for name in _LISTS}
            predicted = DistancePredictor(float(fit["radius_m"]), coefficients=rows, **lists)
            return Tuning(levels, predicted, float(content["core_s"]), float(content["plain_h"]))
        except (ValueError, KeyError, TypeError) as error:
            raise BadInputError(
                f"{file}: no levels of a pilot ({error}); remove it and its replicates, and fly "
                "again"
            ) from error

    def keep_tuning(self, tuning: Tuning) -> None:
        """Write levels.json: levels in standard deviations, and the predictions' coefficients by
        horizon and regressor."""
        content = {"scores": tuning.levels.scores, "copies": tuning.levels.copies}
        content |= {"core_s": tuning.core_s, "plain_h": tuning.plain_h}
        content |= {"predicted": {"regressors": NAMES} | asdict(tuning.predicted)}
        self.path.mkdir(parents=True, exist_ok=True)
        write_bytes(self.path / LEVELS, (json.dumps(content) + "\n").encode())

    def pieces(self, table: str) -> dict[int, Piece]:
        """Read the pieces of replicates.csv or plain.csv by number. Raises BadInputError for a
        damaged table."""
        file = self.path / table
        if not file.exists():
            return {}
        columns = {name: [f"{name}_{radius:g}m" for radius in self.radii_m] for name in _BY_RADIUS}
        numbers = [*_NUMBERS, *columns["probability"], *columns["events"]]
        pieces = {}
        for row in csv_rows(file.read_bytes(), file, numbers, _TEXTS, columns["squares"]):
            by_radius = [tuple(float(row[c] or "nan") for c in columns[n]) for n in _BY_RADIUS]
            cost = float(row["ended"]), float(row["path_s"]), int(row["most"]), float(row["core_s"])
            counts, number = Counts(int(row["flights"]), *by_radius, *cost), int(row["number"])
            pieces[number] = Piece(number, counts, row["flights_id"], row["version"])
        return pieces

    def add(self, table: str, piece: Piece) -> None:
        """Add a piece to its table."""
        pieces = self.pieces(table) | {piece.number: piece}
        rows = []
        for number in sorted(pieces):
            row: dict[str, Any] = {"number": number}
            for name, value in asdict(pieces[number].counts).items():
                values = value if name in _BY_RADIUS else ()
                by_radius = zip(self.radii_m, values, strict=name in _BY_RADIUS)
                row |= {f"{name}_{radius:g}m": each for radius, each in by_radius}
                row |= {} if name in _BY_RADIUS else {name: value}
            row |= {name: getattr(pieces[number], name) for name in _TEXTS}
            rows.append({n: "" if value != value else str(value) for n, value in row.items()})
        write_csv(self.path / table, rows)

    def hits(self) -> list[FirstExcursion]:
        """Read the excursions that were kept with their path, of the replicates that count."""
        counted, hits = self.pieces(REPLICATES), []
        for row in self._hit_rows():
            splits = tuple(Split(**split) for split in row.pop("splits"))
            if row.pop("replicate") in counted:
                hits.append(FirstExcursion(**row, splits=splits))
        return hits

    def keep_hits(self, number: int, hits: Sequence[FirstExcursion]) -> None:
        """Write the excursions of one replicate."""
        rows = [row for row in self._hit_rows() if row["replicate"] != number]
        rows += [{"replicate": number} | asdict(hit) for hit in hits]
        self.path.mkdir(parents=True, exist_ok=True)
        if rows:
            write_table(pa.Table.from_pylist(rows), self.path / HITS)

    def _hit_rows(self) -> list[dict[str, Any]]:
        file = self.path / HITS
        return read_table(file).to_pylist() if file.exists() else []

    def reflown(self) -> list[dict[str, str]]:
        """Read jsbsim.csv. Raises BadInputError for a damaged table."""
        file, numbers = self.path / JSBSIM, ["difference_m", "distance_m"]
        if not file.exists():
            return []
        return csv_rows(file.read_bytes(), file, numbers, ["first_row_beyond"])

    def keep_reflown(self, rows: Sequence[Mapping[str, str]]) -> None:
        """Write jsbsim.csv."""
        write_csv(self.path / JSBSIM, rows)
