"""FlightRecord: one flight on one time grid, in SI units.

Importers produce records, and every estimator, replay and report consumes them. The columns are
the signals of `sysid.vocabulary`. A record is stored as Parquet, with its metadata in the file's
schema, or as CSV, with its metadata in a comment line above the header.
"""

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
    """A circle that the autopilot was commanded to fly.

    Attributes
    ----------
    start_s, end_s : float
        Log time, s.
    north_m, east_m : float
        Centre, from the start point of the record.
    radius_m : float
        Positive.
    clockwise : bool
        Sense, seen from above.
    source : str
        Log fields and parameters that it was read from.
    """

    start_s: float
    end_s: float
    north_m: float
    east_m: float
    radius_m: float
    clockwise: bool
    source: str


@dataclass(frozen=True)
class Boot:
    """One of several boots of the autopilot in a log, on its own clock.

    Attributes
    ----------
    number : int
        Counted from 1 in the order of the file.
    start_s, end_s : float
        First and last time of this boot, s.
    free_flight_s : tuple of float or None
        Start and end of its free flight; None if it holds none.
    """

    number: int
    start_s: float
    end_s: float
    free_flight_s: tuple[float, float] | None

    @property
    def flight_s(self) -> float:
        """Duration of its free flight, s; 0 if there is none."""
        return 0.0 if self.free_flight_s is None else self.free_flight_s[1] - self.free_flight_s[0]


@dataclass(frozen=True)
class Metadata:
    """Origin of a record and everything that the checks reported.

    Attributes
    ----------
    source : str
        File name of the log, without folder, so that records compare across machines.
    sha256 : str
        Digest of the log; "" if not computed.
    dialect : str
        dataflash, dataflash-text, tlog, ulog, mat, record, jsbsim-csv or simulation.
    vehicle : str
        Vehicle as the log names it, such as "ArduPlane V4.7.0".
    aircraft : str
        Name on the airframe card; "" without a card.
    grid_hz : float
        Rate of the rows, Hz; NaN if unknown.
    start : mapping
        lat_deg, lon_deg, alt_m and unix_s of the start point, as far as known.
    native_hz : mapping
        Logged rate of each channel, Hz. Below ``grid_hz`` the channel was interpolated.
    channels : mapping
        Log field of each channel, such as "IMU[0].GyrY".
    estimates : tuple of str
        Channels that an estimator computed (alpha and beta without vanes).
    free_flight_s : tuple of pairs
        Start and end of each stretch of free flight, s.
    findings : tuple of Finding
        Results of the checks.
    loiters : tuple of Loiter
        Commanded circles.
    flights : tuple of Boot
        Boots of a log that holds several; empty for one.
    flight_number : int
        Number of the boot that the record was made from.
    """

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
        """Return the metadata as JSON, with null for NaN."""
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
        """Return the metadata that `to_json` wrote.

        Unknown keys are ignored, so that older versions read newer files.
        """
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
    """Return a boot from its dictionary."""
    span = d["free_flight_s"]
    free_s = None if span is None else (float(span[0]), float(span[1]))
    return Boot(int(d["number"]), float(d["start_s"]), float(d["end_s"]), free_s)


def _loiter_from_dict(d: Mapping[str, Any]) -> Loiter:
    """Return a loiter from its dictionary."""
    start_s, end_s, north_m, east_m, radius_m = (
        float(d[n]) for n in ("start_s", "end_s", "north_m", "east_m", "radius_m")
    )
    return Loiter(start_s, end_s, north_m, east_m, radius_m, bool(d["clockwise"]), str(d["source"]))


@dataclass(frozen=True)
class FlightRecord:
    """One flight on one time grid.

    Channels that were not logged are absent. NaN marks dropouts and gaps; nothing may be
    integrated or interpolated across one (`segments` returns the stretches between them). Arrays
    are read-only.

    Parameters
    ----------
    columns : mapping
        Signal name to float array of shape (n,), or object array of str for labels. ``time_s`` is
        required and increases strictly.
    metadata : Metadata
        Origin and findings.

    Raises
    ------
    LogError
        If a name is not in the vocabulary, lengths differ, or time does not increase.

    Examples
    --------
    >>> record = FlightRecord({"time_s": np.arange(3) * 0.1, "V_mps": np.full(3, 20.0)})
    >>> len(record), round(record.dt_s, 3), "V_mps" in record
    (3, 0.1, True)
    """

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
        """Return a column; LogError lists the available ones if it is absent."""
        if name not in self.columns:
            raise LogError(f"this record has no {name}; it has {', '.join(self.columns)}")
        return self.columns[name]

    @cached_property
    def dt_s(self) -> float:
        """Median step of the grid, s; NaN below two samples."""
        return float(np.median(np.diff(self["time_s"]))) if len(self) > 1 else float("nan")

    def rows(self, mask: NDArray[np.bool_] | slice) -> FlightRecord:
        """Return a record of the rows selected by ``mask``."""
        return FlightRecord({k: v[mask] for k, v in self.columns.items()}, self.metadata)

    def between(self, start_s: float, end_s: float) -> FlightRecord:
        """Return a record of the rows with start_s <= time_s <= end_s, without copying."""
        t = self["time_s"]
        return self.rows(
            slice(int(np.searchsorted(t, start_s, "left")), int(np.searchsorted(t, end_s, "right")))
        )

    def with_columns(
        self, columns: Mapping[str, NDArray[Any]], metadata: Metadata | None = None
    ) -> FlightRecord:
        """Return a record in which ``columns`` are added or replaced."""
        return FlightRecord({**self.columns, **columns}, metadata or self.metadata)

    def segments(self, names: tuple[str, ...], min_s: float = 0.0) -> list[slice]:
        """Return the longest stretches without dropouts and gaps.

        Parameters
        ----------
        names : tuple of str
            Channels that must be finite.
        min_s : float
            Shortest stretch that is returned, s.

        Returns
        -------
        list of slice
            Rows, in order of time. A step of the time above 1.5 ``dt_s`` is a gap.
        """
        t = self["time_s"]
        is_complete = np.ones(len(self), dtype=bool)
        for name in names:
            is_complete &= np.isfinite(self[name])
        # Break where time jumps and where any channel becomes finite or stops being finite.
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
        """Write Parquet or CSV, chosen by the suffix; LogError for any other suffix."""
        if path.suffix.lower() == ".parquet":
            import pyarrow as pa
            import pyarrow.parquet as pq

            # Use the arrays directly: a DataFrame would be a second copy of a large log.
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
    def read(cls, path: str | Path) -> FlightRecord:
        """Read a file of `write`, or a plain table with the names of the vocabulary.

        The format is recognised by content. Raises LogError with file and column for anything
        else.
        """
        path = Path(path)
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
