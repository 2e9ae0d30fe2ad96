"""Ground tracks beside the answer: the model and its worst corner, before and after, in the same air of the hardest condition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.digests import sha256_hex
from uqharness.campaign import (
    Statement,
    cases,
    find_mission,
    hardest_of,
    in_condition,
    make_copy,
    needs_copy,
)
from uqharness.campaign.execution import ProcessExecutor
from uqharness.campaign.folder import read_manifest, spec_of
from uqharness.errors import BadInputError
from uqharness.flight import FlightResult, FlightSpec, record_mission, staged_mission
from uqharness.parallel import process_count
from uqharness.parquet_files import write_table
from uqharness.scratch import scratch_folder
from uqharness.simulator import Source

if TYPE_CHECKING:
    import pandas as pd

TRACKS = "tracks.parquet"
NOMINAL, WORST = "nominal", "worst corner"
_LARGEST = "cross_track_max_m"
_DISTANCE = "cross_track"
_RATE_HZ = 5.0
_NORTH, _EAST = "nav/north-m", "nav/east-m"


@dataclass(frozen=True)
class Asked:
    """A finished campaign: its folder, its flights, and the statement of the smallest radius in the condition drawn, if any."""

    folder: Path
    frame: pd.DataFrame
    statement: Statement | None


def fly_tracks(out: Path, asked: Mapping[str, Asked], workers: int | None = None) -> dict[str, Any]:
    """Fly them into ``out``/tracks.parquet; what study.json keeps of it. ``asked``: when -> campaign, the last one chooses the air.

    The air is that in which the last campaign's worst corner went farthest from its path. Columns: when, model (``nominal``:
    plugin off; ``worst corner``), epistemic_id, time_s, north_m, east_m, distance_m. Without such flights the reason is told.
    """
    *_, last = asked.values()
    air = None if any(item.statement is None for item in asked.values()) else _air(last)
    if air is None or last.statement is None:
        return {"reason": "no flight of the hardest condition has a distance from its path"}
    condition = last.statement.cell.condition
    try:
        flights = {
            (when, model, name): spec
            for when, item in asked.items()
            for model, name, spec in _flights(item, air)
        }
        import pandas as pd
        import pyarrow as pa

        frame = pd.concat(_flown(flights, workers), ignore_index=True)
        write_table(pa.Table.from_pandas(frame, preserve_index=False), out / TRACKS)
    except BadInputError as error:
        return {"reason": str(error)}
    return {
        "wind_mps": condition.wind_mps,
        "turbulence": condition.turbulence,
        "aleatory_id": air,
        "radius_m": last.statement.cell.radius_m,
    }


def hardest(found: Sequence[Statement]) -> Statement | None:
    """The statement about the smallest radius in the hardest condition; None where no distance from a path is known."""
    here = [item for item in found if item.cell.distance == "horizontal"]
    if not here:
        return None
    condition = hardest_of(item.cell.condition for item in here)
    return min(
        (item for item in here if item.cell.condition == condition),
        key=lambda item: item.cell.radius_m,
    )


def _air(asked: Asked) -> int | None:
    """The air in which the worst corner went farthest."""
    assert asked.statement is not None
    rows = in_condition(asked.frame, asked.statement.cell.condition)
    rows = rows[
        (rows["epistemic_id"] == asked.statement.worst.epistemic_id) & (rows["status"] == "ok")
    ]
    if _LARGEST not in rows or rows[_LARGEST].isna().any() or rows.empty:
        return None
    return int(rows["aleatory_id"].iloc[int(rows[_LARGEST].to_numpy(dtype=float).argmax())])


def _flights(asked: Asked, air: int) -> Iterator[tuple[str, str, FlightSpec]]:
    """Model, epistemic id and flight of both: that of the worst corner as the campaign flew it, and without the plugin's deltas."""
    spec = spec_of(read_manifest(asked.folder))
    mission = find_mission(spec, asked.folder)
    if needs_copy(spec):
        make_copy(spec, mission, asked.folder)
    assert asked.statement is not None
    condition = asked.statement.cell.condition
    part = cases.Part(range(air, air + 1), ((condition.wind_mps, condition.turbulence),))
    wanted = asked.statement.worst.epistemic_id
    case = next(
        case for case in cases.build_cases(spec, mission, part) if case.epistemic_id == wanted
    )
    plain = {
        name: value for name, value in case.flight.properties.items() if not name.startswith("uq/")
    }
    yield NOMINAL, "", replace(case.flight, properties=plain, levels=None, transient=None)
    yield WORST, wanted, case.flight


@dataclass(frozen=True)
class _Recorder:
    """A flight function for a worker: flies in JSBSim and leaves place and distance from the path in ``folder``."""

    folder: Path

    def __call__(self, spec: FlightSpec) -> FlightResult:
        import pandas as pd

        mission = staged_mission(spec)
        metric = mission.aircraft.card.metrics.get(_DISTANCE)
        if metric is None:
            raise BadInputError(
                f"{mission.aircraft.name}: its card has no metric {_DISTANCE}, so no track can be drawn beside a path"
            )
        table = {
            "north_m": Source(_NORTH),
            "east_m": Source(_EAST),
            "distance_m": Source(metric.true),
        }
        flown = record_mission(mission, replace(spec, record_rate_hz=_RATE_HZ), table)
        pd.DataFrame(flown.signals).to_parquet(self.folder / _file(spec), index=False)
        return FlightResult(flown.status, flown.reason, flown.flown_s, {}, {}, {})


def _timeout_s(flight: FlightSpec) -> float:
    return 120.0 + 0.5 * (flight.duration_s + flight.burn_in_s)


def _file(spec: FlightSpec) -> str:
    return sha256_hex(repr(spec).encode()) + ".parquet"


def _flown(
    flights: Mapping[tuple[str, str, str], FlightSpec], workers: int | None
) -> Iterator[pd.DataFrame]:
    import pandas as pd

    numbered = {str(k): spec for k, spec in enumerate(flights.values())}
    with scratch_folder() as scratch:
        folder = scratch.path
        executor = ProcessExecutor(process_count(workers), timeout_s=_timeout_s, retries=0)
        for outcome in (
            item for batch in executor.run(_Recorder(folder), numbered.items()) for item in batch
        ):
            if not (folder / _file(numbered[outcome.case_id])).is_file():
                raise BadInputError(
                    f"the flights of the ground track were not flown: {outcome.reason or outcome.status}"
                )
        for (when, model, name), spec in flights.items():
            frame = pd.read_parquet(folder / _file(spec))
            frame.insert(0, "when", when)
            frame.insert(1, "model", model)
            frame.insert(2, "epistemic_id", name)
            yield frame
