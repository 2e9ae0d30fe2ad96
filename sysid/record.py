"""FlightRecord: the waist between logs and everything that works on flights. Columns as in the
vocabulary, SI.

Parquet keeps the metadata in the file's schema; CSV keeps it in a comment line in front of the
header."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding, LogError, finding_from_dict, one_line
from sysid.foreign.limited import read_record
from sysid.foreign.regular_files import parse_json
from sysid.vocabulary import LABELS, SIGNALS

_METADATA_KEY = b"flight_record"
_CSV_ROWS = 200_000


@dataclass(frozen=True)
class Loiter:
    """A circle that the autopilot was told to fly, from ``start_s`` to ``end_s``.

    north_m, east_m  centre, from the start point as the record's columns      radius_m  positive
    source  what says so"""

    start_s: float
    end_s: float
    north_m: float
    east_m: float
    radius_m: float
    clockwise: bool
    source: str


@dataclass(frozen=True)
class Boot:
    """One of several boots of the autopilot in a log, on its own clock; ``free_flight_s`` is None
    where it holds no flight.
    """

    number: int
    start_s: float
    end_s: float
    free_flight_s: tuple[float, float] | None

    @property
    def flight_s(self) -> float:
        """Length of its free flight, s."""
        return 0.0 if self.free_flight_s is None else self.free_flight_s[1] - self.free_flight_s[0]


@dataclass(frozen=True)
class Metadata:
    """Where a record comes from and what is known to be wrong with it.

    source       file name of the log (no folder, so that records compare across machines)
    sha256       of the log's content, "" when not computed
    dialect      dataflash | dataflash-text | tlog | ulog | record | jsbsim-csv | simulation
    vehicle      what the log says it is, e.g. "ArduPlane V4.7.0"
    start        {"lat_deg", "lon_deg", "alt_m", "unix_s"} of the start point where known
    native_hz    rate at which each channel was logged; a value below the grid's rate means it was
    filled in between
    channels     what each channel was made from, e.g. "IMU[0].GyrY"
    estimates    channels that an estimator computed and no sensor measured (alpha, beta without
    vanes) free_flight_s  stretches [start, end] of free flight
    loiters      circles that the autopilot was told to fly
    findings     everything the checks had to say
    flights      the boots of a log that holds several; empty for one      flight_number  the one
    that the record is of"""

    source: str = ""
    sha256: str = ""
    dialect: str = ""
    vehicle: str = ""
    aircraft: str = ""
    grid_hz: float = float("nan")
    start: Mapping[str, float] = field(default_factory=dict)
    native_hz: Mapping[str, float] = field(default_factory=dict)
    channels: Mapping[str, str] = field(default_factory=dict)
    estimates: tuple[str, ...] = ()
    free_flight_s: tuple[tuple[float, float], ...] = ()
    findings: tuple[Finding, ...] = ()
    loiters: tuple[Loiter, ...] = ()
    flights: tuple[Boot, ...] = ()
    flight_number: int = 1

    @property
    def warnings(self) -> list[str]:
        """Messages of the findings that are warnings or errors."""
        return [f.message for f in self.findings if f.severity != "info"]

    def to_json(self) -> str:
        """JSON text; NaN is written as null."""
        data = {
            "source": self.source,
            "sha256": self.sha256,
            "dialect": self.dialect,
            "vehicle": self.vehicle,
            "aircraft": self.aircraft,
            "grid_hz": None if np.isnan(self.grid_hz) else self.grid_hz,
            "start": dict(self.start),
            "native_hz": dict(self.native_hz),
            "channels": dict(self.channels),
            "estimates": list(self.estimates),
            "free_flight_s": [list(s) for s in self.free_flight_s],
            "loiters": [asdict(loiter) for loiter in self.loiters],
            "findings": [f.as_dict() for f in self.findings],
        }
        if self.flights:
            data |= {
                "flights": [asdict(boot) for boot in self.flights],
                "flight_number": self.flight_number,
            }
        return json.dumps(data, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Metadata:
        """Inverse of `to_json`; unknown keys are ignored so that newer files stay readable."""
        d: dict[str, Any] = parse_json(text)
        return cls(
            source=str(d.get("source", "")),
            sha256=str(d.get("sha256", "")),
            dialect=str(d.get("dialect", "")),
            vehicle=str(d.get("vehicle", "")),
            aircraft=str(d.get("aircraft", "")),
            grid_hz=float("nan") if d.get("grid_hz") is None else float(d["grid_hz"]),
            start={str(k): float(v) for k, v in d.get("start", {}).items()},
            native_hz={str(k): float(v) for k, v in d.get("native_hz", {}).items()},
            channels={str(k): str(v) for k, v in d.get("channels", {}).items()},
            estimates=tuple(str(e) for e in d.get("estimates", ())),
            free_flight_s=tuple((float(a), float(b)) for a, b in d.get("free_flight_s", ())),
            findings=tuple(finding_from_dict(f) for f in d.get("findings", ())),
            loiters=tuple(_loiter_from_dict(x) for x in d.get("loiters", ())),
            flights=tuple(_boot_from_dict(x) for x in d.get("flights", ())),
            flight_number=int(d.get("flight_number", 1)),
        )


def _boot_from_dict(d: Mapping[str, Any]) -> Boot:
    span = d["free_flight_s"]
    free_s = None if span is None else (float(span[0]), float(span[1]))
    return Boot(int(d["number"]), float(d["start_s"]), float(d["end_s"]), free_s)


def _loiter_from_dict(d: Mapping[str, Any]) -> Loiter:
    start_s, end_s, north_m, east_m, radius_m = (
        float(d[n]) for n in ("start_s", "end_s", "north_m", "east_m", "radius_m")
    )
    return Loiter(start_s, end_s, north_m, east_m, radius_m, bool(d["clockwise"]), str(d["source"]))


@dataclass(frozen=True)
class FlightRecord:
    """One flight on one time grid.

    columns   name -> (n,) float array, (n,) object array of str for labels; `time_s` always present
    and increasing metadata  provenance and findings

    Absent channels are absent. NaN marks dropouts and gaps: nothing may be integrated or
    interpolated across one (`segments` gives the stretches without). Raises LogError for unknown
    names, unequal lengths or time that does not increase."""

    columns: Mapping[str, NDArray[Any]]
    metadata: Metadata = field(default_factory=Metadata)

    def __post_init__(self) -> None:
        if "time_s" not in self.columns:
            raise LogError(
                f"a flight record needs the column time_s; received {sorted(self.columns)}"
            )
        unknown = sorted(set(self.columns) - set(SIGNALS))
        if unknown:
            raise LogError(f"unknown columns {unknown}; allowed are {sorted(SIGNALS)}")
        frozen: dict[str, NDArray[Any]] = {}
        n = len(self.columns["time_s"])
        for name in SIGNALS:
            if name not in self.columns:
                continue
            values = np.asarray(self.columns[name], dtype=object if name in LABELS else np.float64)
            if values.shape != (n,):
                raise LogError(f"column {name} has shape {values.shape}, time_s has ({n},)")
            if values.flags.writeable:
                # A caller keeps its array; one that is read-only already is shared, which big logs
                # need.
                values = values.copy()
                values.setflags(write=False)
            frozen[name] = values
        time = frozen["time_s"]
        if not np.all(np.isfinite(time)):
            raise LogError("time_s holds NaN or infinity; every sample needs its time")
        steps = np.diff(time)
        if np.any(steps <= 0):
            k = int(np.argmax(steps <= 0))
            raise LogError(
                f"time_s does not increase at row {k + 1}: {time[k]:.6f} then {time[k + 1]:.6f} s"
            )
        object.__setattr__(self, "columns", frozen)

    def __repr__(self) -> str:
        return f"FlightRecord({len(self)} rows of {len(self.columns)} columns)"

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The column; LogError names what is there when it is not."""
        if name not in self.columns:
            raise LogError(f"this record has no {name}; it has {', '.join(self.columns)}")
        return self.columns[name]

    @cached_property
    def dt_s(self) -> float:
        """Median step of the grid, s (NaN below two samples)."""
        return float(np.median(np.diff(self["time_s"]))) if len(self) > 1 else float("nan")

    def rows(self, mask: NDArray[np.bool_] | slice) -> FlightRecord:
        """The same record with the rows of `mask` only."""
        return FlightRecord({k: v[mask] for k, v in self.columns.items()}, self.metadata)

    def between(self, start_s: float, end_s: float) -> FlightRecord:
        """Rows with start_s <= time_s <= end_s (sharing this record's memory)."""
        t = self["time_s"]
        return self.rows(
            slice(int(np.searchsorted(t, start_s, "left")), int(np.searchsorted(t, end_s, "right")))
        )

    def with_columns(
        self, columns: Mapping[str, NDArray[Any]], metadata: Metadata | None = None
    ) -> FlightRecord:
        """A copy in which `columns` are added or replaced."""
        return FlightRecord({**self.columns, **columns}, metadata or self.metadata)

    def segments(self, names: tuple[str, ...], min_s: float = 0.0) -> list[slice]:
        """Maximal stretches in which every channel of `names` is finite and time has no gap (step >
        1.5 dt).

        Returns slices of rows in order; stretches shorter than `min_s` seconds are left out.
        """
        t = self["time_s"]
        is_complete = np.ones(len(self), dtype=bool)
        for name in names:
            is_complete &= np.isfinite(self[name])
        breaks = np.zeros(len(self) + 1, dtype=bool)
        breaks[0] = breaks[-1] = True
        if len(self) > 1:
            breaks[1:-1] = (np.diff(t) > 1.5 * self.dt_s) | (np.diff(is_complete.astype(int)) != 0)
        edges = np.flatnonzero(breaks)
        pairs = itertools.pairwise(edges)
        return [
            slice(int(a), int(b)) for a, b in pairs if is_complete[a] and t[b - 1] - t[a] >= min_s
        ]

    def write(self, path: Path) -> None:
        """Write Parquet (.parquet) or CSV (.csv) by suffix; LogError for any other suffix."""
        if path.suffix.lower() == ".parquet":
            import pyarrow as pa
            import pyarrow.parquet as pq

            # From the arrays as they are: a DataFrame would be a second copy of a big log.
            table = pa.table(
                {
                    n: pa.array(v) if n not in LABELS else pa.array(v, pa.string())
                    for n, v in self.columns.items()
                }
            )
            pq.write_table(
                table.replace_schema_metadata({_METADATA_KEY: self.metadata.to_json().encode()}),
                path,
            )
        elif path.suffix.lower() == ".csv":
            import pandas as pd

            with path.open("w", encoding="utf-8", newline="") as handle:
                handle.write(f"# flight_record {self.metadata.to_json()}\n")
                for start in range(0, max(1, len(self)), _CSV_ROWS):
                    part = {n: v[start : start + _CSV_ROWS] for n, v in self.columns.items()}
                    pd.DataFrame(part).to_csv(
                        handle, index=False, header=start == 0, lineterminator="\n"
                    )
        else:
            raise LogError(f"cannot write suffix '{path.suffix}'; use .parquet or .csv", path)

    @classmethod
    def read(cls, path: Path) -> FlightRecord:
        """Read what `write` wrote (or a plain table with the vocabulary's names), recognised by
        content.

        Raises LogError naming file and column for anything else.
        """
        columns, meta = read_record(path)
        try:
            metadata = (
                Metadata.from_json(meta) if meta else Metadata(source=path.name, dialect="record")
            )
        except (
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            OverflowError,
            RecursionError,
        ) as e:
            raise LogError(
                f"its metadata is damaged ({one_line(e)}); write the record again", path
            ) from None
        try:
            return cls(columns, metadata)
        except LogError as e:
            raise LogError(str(e), path) from None
