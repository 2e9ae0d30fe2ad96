"""Fly one case of a campaign again with all signals recorded, and compare it with the stored
outcome.

The flight runs in a separate process. Record and result go to ``rerun/<case id>`` in the
campaign's folder.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.units import FT_M
from uqharness.campaign.cases import Case, build_cases
from uqharness.campaign.engines import make_copy, needs_copy
from uqharness.campaign.manifest import (
    describe,
    read_manifest,
    refuse_if_different,
    refuse_without_digests,
    spec_of,
)
from uqharness.campaign.processes import (
    JSBSIM,
    CaseOutcome,
    ProcessExecutor,
    fly_group,
    unavailable_reason,
)
from uqharness.campaign.run import find_mission
from uqharness.campaign.store import Store
from uqharness.errors import BadInputError
from uqharness.files import inner_folder, remove, write_bytes
from uqharness.flight import (
    COEFFICIENTS,
    FlightResult,
    FlightSpec,
    record_mission,
    staged_mission,
    write_record,
)
from uqharness.results.campaign import RerunDocument
from uqharness.simulator import Source
from uqharness.simulator import aircraft as properties

RERUN = "rerun"
"""Folder of repeated flights within a campaign folder."""
RECORD_HZ = 50.0
"""Highest record rate [Hz]."""


@dataclass(frozen=True)
class RerunResult:
    """A repeated flight.

    Attributes
    ----------
    case : Case
        The case.
    outcome : CaseOutcome
        New outcome.
    same : bool or None
        Whether status and all metrics equal the stored ones; None if the case had not been flown.
    differences : tuple of str
        What differs.
    folder : Path
        Folder of the files.
    files : tuple of Path
        result.json and the record.
    """

    case: Case
    outcome: CaseOutcome
    same: bool | None
    differences: tuple[str, ...]
    folder: Path
    files: tuple[Path, ...]


@dataclass(frozen=True)
class RecordedFlight:
    """Fly and score a case as the campaign does, then once more in JSBSim with all signals to
    ``path``.

    The record is JSBSim's even if the campaign flies in the batch ``engine``.
    """

    path: Path
    engine: str = JSBSIM

    def __call__(self, spec: FlightSpec) -> FlightResult:
        """Fly, write the record and return the scored result."""
        import pandas as pd

        (result,) = fly_group(self.engine, [spec])
        mission = staged_mission(spec)
        table = {
            name: source
            for name, source in properties.sources(mission.aircraft).items()
            if name != "time_s"
        }
        optional = (
            {}
            if mission.aircraft.has_card
            else {name: table.pop(name) for name in set(table) - set(properties.STANDARD)}
        )
        # Signals beyond the card are recorded if the aircraft has them.
        optional |= properties.standard_positions() | _extra_signals(mission.aircraft.card.metrics)
        rate_hz = min(RECORD_HZ, 1.0 / mission.aircraft.dt_s)
        full = record_mission(mission, _at_rate(spec, rate_hz), table, optional, keep_burn_in=True)
        frame = pd.DataFrame(full.signals)
        frame["scored"] = frame["time_s"] >= spec.burn_in_s
        write_record(frame, self.path)
        return result


def rerun_case(folder: Path, case_id: str) -> RerunResult:
    """Fly a case again into ``folder``/rerun/<case id>.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    case_id : str
        Id of the case, or its unique beginning.

    Raises
    ------
    BadInputError
        If there is no campaign, the id is unknown, or aircraft, script or versions have changed.
    """
    manifest = read_manifest(folder)
    refuse_without_digests(folder, manifest)
    spec = spec_of(manifest)
    mission = find_mission(spec, folder)
    refuse_if_different(folder, manifest, describe(spec, mission, manifest["cases"], ""))
    # The case is built from the manifest, so its flight is the stored one.
    case = _find_case(build_cases(spec, mission), case_id, folder)
    reason = unavailable_reason(case.engine)
    if reason is not None:
        raise BadInputError(
            f"{folder}: this campaign uses the batch engine, and {reason}; repeat the case on the"
            " machine of the campaign"
        )
    if needs_copy(spec):
        make_copy(spec, mission, folder)
    stored = _stored(folder, case.case_id)
    target = inner_folder(folder, RERUN, case.case_id)
    record = target / "record.parquet"
    remove(record)
    # The flight may end its interpreter, so it needs another one than this.
    executor = ProcessExecutor(
        1, timeout_s=lambda flight: 120.0 + 0.5 * (flight.duration_s + flight.burn_in_s), retries=0
    )
    (outcome,) = [
        item
        for batch in executor.run(
            RecordedFlight(record, case.engine), [(case.case_id, case.flight)]
        )
        for item in batch
    ]
    if outcome.bad_input:
        raise BadInputError(outcome.reason)
    # Compare with the stored outcome, bit by bit.
    differences = () if stored is None else tuple(_differences(stored, outcome))
    same = None if stored is None else not differences
    files = _write(target, case, outcome, same, differences, record)
    return RerunResult(case, outcome, same, differences, target, files)


def _at_rate(spec: FlightSpec, rate_hz: float) -> FlightSpec:
    """Return the flight with another record rate [Hz]."""
    from dataclasses import replace

    return replace(spec, record_rate_hz=rate_hz)


def _extra_signals(metrics: Mapping[str, Any]) -> dict[str, Source]:
    """Return the signals recorded in addition to those of a flight record.

    These are errors as scored, position, levels, bounds and deltas of the coefficients, and wind.
    """
    table = {f"error_{key}": Source(card.true) for key, card in metrics.items()}
    table |= {
        f"error_{key}_measured": Source(card.measured)
        for key, card in metrics.items()
        if card.measured
    }
    table |= {
        "north_m": Source("nav/north-m"),
        "east_m": Source("nav/east-m"),
        "load_factor": Source("accelerations/Nz"),
    }
    for name in COEFFICIENTS:
        for quantity in ("level", "lower", "upper", "delta", "transient-level"):
            table[f"{quantity.replace('-', '_')}_{name}"] = Source(f"uq/{name}/{quantity}")
    table |= {name: Source(f"uq/{name}") for name in ("extrapolated", "extrapolation")}
    return table | {
        f"wind_{axis}_mps": Source(f"atmosphere/total-wind-{axis}-fps", FT_M)
        for axis in ("north", "east", "down")
    }


def _find_case(cases: tuple[Case, ...], case_id: str, folder: Path) -> Case:
    """Return the case with that id. Raises BadInputError if there is none or more than one."""
    matches = [case for case in cases if case_id and case.case_id.startswith(case_id)]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise BadInputError(
            f"--case {case_id}: {len(matches)} cases of {folder} begin so; give more of the id"
        )
    raise BadInputError(
        f"--case {case_id}: {folder} has no such case; ids are in cases.parquet and, for failed"
        " ones, in report.html"
    )


def _stored(folder: Path, case_id: str) -> CaseOutcome | None:
    """Return the stored outcome; None if the case was not flown. Raises DamageError."""
    with Store(folder, read_only=True) as store:
        outcome = store.outcome(case_id)
        if outcome is None:
            # Not flown yet, if all that was flown is there.
            store.finished()
        return outcome


def _differences(stored: CaseOutcome, outcome: CaseOutcome) -> list[str]:
    """Return what differs between two outcomes, NaN counting as equal to NaN."""
    differences = (
        []
        if stored.status == outcome.status
        else [f"status {stored.status} then, {outcome.status} now"]
    )
    for name in sorted(stored.metrics.keys() | outcome.metrics.keys()):
        stored_value, new_value = (item.metrics.get(name, math.nan) for item in (stored, outcome))
        if stored_value != new_value and not (math.isnan(stored_value) and math.isnan(new_value)):
            differences.append(f"{name} {stored_value!r} then, {new_value!r} now")
    return differences


def _write(
    target: Path,
    case: Case,
    outcome: CaseOutcome,
    same: bool | None,
    differences: tuple[str, ...],
    record: Path,
) -> tuple[Path, ...]:
    """Write result.json and return the files."""
    levels, transient = case.flight.levels, case.flight.transient
    document = RerunDocument(
        case_id=case.case_id,
        epistemic_id=case.epistemic_id,
        aleatory_id=case.aleatory_id,
        wind_mps=case.wind_mps,
        turbulence=case.turbulence,
        status=outcome.status,
        reason=outcome.reason,
        flown_s=outcome.flown_s,
        same_as_stored=same,
        differences=list(differences),
        metrics=dict(sorted(outcome.metrics.items())),
        properties=dict(case.flight.properties),
        levels=None if levels is None else dict(vars(levels)),
        transient=None if transient is None else dict(vars(transient)),
    )
    files = [target / "result.json"]
    write_bytes(files[0], (json.dumps(document.as_json(), indent=1) + "\n").encode())
    if record.is_file():
        files.append(record)
    return tuple(files)
