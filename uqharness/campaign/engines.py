"""Choose the engine of a campaign, prepare its aircraft, and compare the batch engine with JSBSim.

Three parts. First, the copy of the aircraft that campaigns with bounds from a model form or with a
trimmed start fly. Second, the choice of the engine: once per campaign, batch where it understands
aircraft and mission completely, else JSBSim. Third, the comparison: every campaign in the batch
engine flies some of its cases in JSBSim as well, and no campaign completes if they differ.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import os
import shutil
import tempfile
import time
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.foreign.regular_files import sha256_hex
from uqharness.campaign import read_bounds
from uqharness.campaign.cases import Case, Mission
from uqharness.campaign.conditions import Condition
from uqharness.campaign.cost import Pace, one_case_each, trial_conditions
from uqharness.campaign.manifest import MANIFEST, read_manifest
from uqharness.campaign.processes import (
    BATCH,
    JSBSIM,
    JUDGE,
    NEAREST,
    ONE_ULP_OFF,
    Batch,
    CaseOutcome,
    FlightFunction,
    Group,
    GroupFunction,
    LocalBatch,
    OneByOne,
    ProcessExecutor,
    fly_group,
)
from uqharness.campaign.shards import SHARDS, shard_folders
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.tables import (
    ENGINE_CHECK,
    FULL_FLIGHT,
    START,
    STATUS,
    CheckRow,
    as_number,
    as_text,
    read_check,
    write_check,
)
from uqharness.errors import BadInputError, EnginesDifferError
from uqharness.files import inner_folder, scratch_folder
from uqharness.flight import FlightSpec
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.simulator import (
    SCRIPT,
    Aircraft,
    content_hash,
    copy_folder,
    copy_shared_parts,
    engine,
    find_aircraft,
    parse_xml,
    read_xml,
    walk,
    write_steady_start,
)

# Copy of the aircraft, for campaigns with bounds from a model form or with a trimmed start. It
# stays in the campaign's folder, so that what was flown is kept with the results.

SYSTEM = "model-form"
"""Name of the plugin's system in an aircraft file."""
_COPIED = "aircraft"
_UNFINISHED = ".aircraft-"
_SENSOR = b"sensor/V-mps"
"""Property that identifies a sensors system."""
_ACTIVE = b"uq/active"  # the switch of the plugin's deltas


def needs_copy(spec: CampaignSpec) -> bool:
    """Return whether the campaign flies a copy of the aircraft."""
    return spec.inputs.model_form is not None or spec.start is not None


def named_aircraft(spec: CampaignSpec) -> Aircraft:
    """Return the aircraft that a campaign names.

    It is looked up relative to the campaign file first, then as ``uqharness fly`` does. Raises
    BadInputError.
    """
    relative_path = spec.path.resolve().parent / spec.campaign.aircraft
    return find_aircraft(relative_path if relative_path.is_dir() else spec.campaign.aircraft)


def has_sensors(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has a sensors system, to whose output sensor noise is added."""
    paths = (path for _, path in walk(aircraft.folder) if path.suffix.lower() == ".xml")
    return any(_SENSOR in path.read_bytes() for path in paths)


def require_plugin(spec: CampaignSpec, aircraft: Aircraft) -> None:
    """Raise BadInputError if a campaign varies coefficients and no file of the aircraft adds their
    deltas.
    """
    if spec.epistemic.method == "none" or not spec.epistemic.coefficients:
        return
    paths = (path for _, path in walk(aircraft.folder) if path.suffix.lower() == ".xml")
    if not any(_ACTIVE in path.read_bytes() for path in paths):
        system_file(aircraft)


def with_noise_of(spec: CampaignSpec, aircraft: Aircraft) -> CampaignSpec:
    """Return the campaign with ``sensor_noise`` filled in: on if the aircraft has a sensors
    system.
    """
    if spec.aleatory.sensor_noise is not None:
        return spec
    return spec.with_sensor_noise(has_sensors(aircraft))


def with_default_noise(spec: CampaignSpec, mission: Mission) -> CampaignSpec:
    """Return the campaign with ``sensor_noise`` filled in from the aircraft of its mission."""
    # The copy may not exist yet; it has the sensors of its source.
    source = mission.source if mission.source != Path() else mission.aircraft
    return with_noise_of(spec, find_aircraft(source))


def noise_notes(spec: CampaignSpec) -> list[str]:
    """Return a note if the campaign flies without sensor noise by default. Raises BadInputError."""
    aircraft = named_aircraft(spec)
    if spec.aleatory.sensor_noise is not None or has_sensors(aircraft):
        return []
    return [
        (
            f"aircraft '{aircraft.name}' has no sensors system: it is simulated without sensor"
            " noise ([aleatory] sensor_noise = false)"
        )
    ]


def bounds_notes(spec: CampaignSpec) -> list[str]:
    """Return a note if the bounds were made for other aircraft files. Raises BadInputError."""
    if spec.inputs.model_form is None:
        return []
    made_for, aircraft = read_bounds(spec.inputs.model_form).aircraft, named_aircraft(spec)
    if made_for.sha256 == content_hash(aircraft):
        return []
    origin = f"'{made_for.name}' as it was then"
    if made_for.name != aircraft.name:
        origin = f"'{made_for.name}', not '{aircraft.name}'"
    consequence = "they mean something only if its aerodynamics are the same"
    path = spec.inputs.model_form
    return [
        (
            f"{path}: the bounds were made for aircraft {origin} (SHA-256"
            f" {made_for.sha256[:12]}...); {consequence}"
        )
    ]


def find_copied_mission(
    spec: CampaignSpec, aircraft: Aircraft, script: Path | None, folder: Path
) -> Mission:
    """Return the mission that a copy of the aircraft in ``folder`` will fly, with its hashes.

    The copy is made in a temporary folder to compute the hashes. ``script`` None means the steady
    flight of [start]. Raises BadInputError as `make_copy` does.
    """
    with scratch_folder("copy") as scratch:
        copy = _copy_aircraft(spec, aircraft, scratch.path)
        aircraft_hash = content_hash(find_aircraft(copy))
        script_hash = sha256_hex(read_xml(script or scratch.path / SCRIPT))
    place = folder.resolve()
    return Mission(
        place / _COPIED / copy.name,
        aircraft_hash,
        (script or place / SCRIPT).resolve(),
        script_hash,
        aircraft.source,
    )


def make_copy(spec: CampaignSpec, mission: Mission, folder: Path) -> None:
    """Make the copy that ``mission`` flies in ``folder``, unless it is there.

    Raises BadInputError if the aircraft lacks the plugin, cannot have these bounds, or cannot be
    trimmed.
    """
    for unfinished in folder.glob(f"{_UNFINISHED}*"):
        shutil.rmtree(unfinished, ignore_errors=True)
    target = mission.aircraft
    if target.exists() and content_hash(find_aircraft(target)) == mission.aircraft_hash:
        return
    with tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=folder) as name:
        copy = _copy_aircraft(spec, find_aircraft(mission.source), Path(name))
        # A folder with flights of another aircraft was refused earlier, so what is here is an
        # incomplete copy.
        shutil.rmtree(target, ignore_errors=True)
        for entry in ("engine", "systems", SCRIPT):
            if (Path(name) / entry).exists():
                shutil.rmtree(folder / entry, ignore_errors=True)
                os.replace(Path(name) / entry, folder / entry)
        os.replace(copy, inner_folder(folder, _COPIED) / target.name)


def _copy_aircraft(spec: CampaignSpec, aircraft: Aircraft, root: Path) -> Path:
    """Copy the aircraft below ``root`` and apply bounds and start; return the copied folder."""
    copy = root / _COPIED / aircraft.copy_name
    # The aircraft with what JSBSim needs next to it (engine, systems).
    copy_folder(aircraft.folder, copy)
    copy_shared_parts(aircraft, root, engine.default_root())
    if spec.inputs.model_form is not None:
        put_bounds(copy, aircraft, spec.inputs.model_form)
    if spec.start is not None:
        write_steady_start(find_aircraft(copy), spec.start, root / SCRIPT, str(spec.path))
    return copy


def put_bounds(copy: Path, aircraft: Aircraft, model_form: Path) -> None:
    """Write the bounds of a model-form.json into the copy of an aircraft.

    Raises BadInputError as `make_copy` does.
    """
    text = model_form_xml(read_bounds(model_form), aircraft)
    destination = copy / system_file(aircraft).relative_to(aircraft.folder)
    destination.unlink()
    destination.write_bytes(text)


def system_file(aircraft: Aircraft) -> Path:
    """Return the file of the aircraft's model-form system.

    Raises BadInputError if there is none.
    """
    # JSBSim looks for a system file below Systems/ first, then in the aircraft's folder.
    for system in parse_xml(aircraft.xml).getroot().iter("system"):
        system_name = system.get("file", "").removesuffix(".xml")
        if system_name == SYSTEM:
            for path in (
                aircraft.folder / "Systems" / f"{SYSTEM}.xml",
                aircraft.folder / f"{SYSTEM}.xml",
            ):
                if path.is_file():
                    return path
    raise BadInputError(
        f'{aircraft.xml}: no <system file="{SYSTEM}"/>, so bounds have no effect; '
        f"add the plugin first: uqharness instrument {aircraft.name} --out DIR"
    )


_REQUESTED = "it was requested"
_MAX_REASONS = 8


@dataclass(frozen=True)
class Engines:
    """The functions to fly with.

    Attributes
    ----------
    fly : callable
        Flies one flight in JSBSim.
    fly_group : callable
        Flies a group in the engine of a given name.
    batch : Batch or None
        Reports what the batch engine understands.
    no_batch : str
        Why ``batch`` is None.
    """

    fly: FlightFunction
    fly_group: GroupFunction
    batch: Batch | None
    no_batch: str = ""

    @staticmethod
    def of(fly: FlightFunction | Engines | None) -> Engines:
        """Return the engines of this program, or those around a flight function given by the
        caller.
        """
        if isinstance(fly, Engines):
            return fly
        if fly is not None:
            return Engines(
                fly, OneByOne(fly), None, "a function of the caller simulates the flights"
            )
        from uqharness.flight.fly import fly as own

        return Engines(own, fly_group, LocalBatch())

    def unavailable(self) -> str | None:
        """Return why the batch engine cannot fly on this machine; None if it can."""
        return self.no_batch if self.batch is None else self.batch.available()


@dataclass(frozen=True)
class EngineChoice:
    """A campaign whose engine is chosen.

    Attributes
    ----------
    spec : CampaignSpec
        Campaign with the name of its engine.
    requested : str
        Engine that the campaign file requests: auto, batch or jsbsim.
    reasons : tuple of str
        Reasons of the choice.
    """

    spec: CampaignSpec
    requested: str
    reasons: tuple[str, ...]

    @property
    def engine(self) -> str:
        """Name of the engine: batch or jsbsim."""
        return self.spec.campaign.engine

    @property
    def words(self) -> str:
        """The engine and the reasons in one line."""
        return engine_words(self.engine, self.reasons)

    def as_dict(self) -> dict[str, Any]:
        """Return the request and the reasons as the manifest stores them."""
        return {"asked": self.requested, "why": list(self.reasons)}


def engine_words(engine: str, reasons: tuple[str, ...]) -> str:
    """Return ``jsbsim, because ...`` with the first reasons."""
    more = f"; and {len(reasons) - _MAX_REASONS} more" if len(reasons) > _MAX_REASONS else ""
    return f"{engine}, because {'; '.join(reasons[:_MAX_REASONS])}{more}" if reasons else engine


@dataclass(frozen=True)
class PreviousEngine:
    """The engine of a campaign that has begun, and the reasons of its choice."""

    engine: str
    reasons: tuple[str, ...] = ()


def choose_engine(
    spec: CampaignSpec, mission: Mission, engines: Engines, previous: PreviousEngine | None = None
) -> EngineChoice:
    """Choose the engine of a campaign from the campaign file, earlier flights and what batch
    understands.

    A campaign that has begun keeps its engine. Otherwise batch is taken if it can fly the campaign.

    Parameters
    ----------
    spec : CampaignSpec
        Validated campaign.
    mission : Mission
        Files to fly.
    engines : Engines
        Functions to fly with.
    previous : PreviousEngine, optional
        Engine of flights that are stored already.

    Raises
    ------
    BadInputError
        If the batch engine is requested, or flew before, and cannot fly the campaign here.
    """
    requested = spec.campaign.engine
    # A campaign that has begun keeps its engine unless the file names another one.
    continues = previous is not None and requested in ("auto", previous.engine)
    engine_name, given_reasons = (
        (previous.engine, previous.reasons)
        if previous is not None and continues
        else (requested, (_REQUESTED,))
    )
    if engine_name == JSBSIM:
        return EngineChoice(spec.with_engine(JSBSIM), requested, given_reasons)
    if continues and engine_name == BATCH:
        # The first run checked what batch understands, for the same aircraft and version.
        reason = engines.unavailable()
        if reason is not None:
            raise BadInputError(
                f"{spec.path}: this campaign uses the batch engine, and {reason}; resume it on the"
                " machine where it began"
            )
        return EngineChoice(spec.with_engine(BATCH), requested, given_reasons)
    # Ask the batch engine whether it understands aircraft and mission.
    reasons, left_out = _support(spec, mission, engines)
    if engine_name == BATCH:
        if reasons:
            raise BadInputError(
                f"{spec.path}: the batch engine was requested and does not support this campaign:",
                *reasons,
            )
        return EngineChoice(spec.with_engine(BATCH), requested, (_REQUESTED,))
    if reasons:
        return EngineChoice(spec.with_engine(JSBSIM), requested, reasons)
    if not left_out:
        return EngineChoice(
            spec.with_engine(BATCH), requested, ("it supports the complete aircraft and mission",)
        )
    return EngineChoice(
        spec.with_engine(BATCH),
        requested,
        (
            "it supports all that the flight reads",
            *(f"left out, since nothing reads it: {text}" for text in left_out),
        ),
    )


def _support(
    spec: CampaignSpec, mission: Mission, engines: Engines
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what the batch engine refuses of a campaign and what it leaves out of the aircraft.

    One case of each condition is asked. The sentences name the author's files.
    """
    reason = engines.unavailable()
    batch = engines.batch
    if reason is not None or batch is None:
        return (reason or engines.no_batch,), ()
    varying = varying_properties(spec)
    # Both questions read one staged copy, so the engine translates the mission once.
    with staged_mission_of(spec, mission) as staged:
        flights = [case.flight for case in one_case_each(spec, staged)]

        def in_authors_files(texts: Iterable[str]) -> tuple[str, ...]:
            """Return the sentences with the author's path in the place of the copy's."""
            return tuple(
                dict.fromkeys(
                    text.replace(str(staged.aircraft), str(mission.aircraft)) for text in texts
                )
            )

        refused = in_authors_files(
            text for flight in flights for text in _refusals(batch, flight, varying)
        )
        if refused:
            return refused, ()
        return (), in_authors_files(
            text for flight in flights for text in batch.left_out(flight, varying)
        )


def _refusals(batch: Batch, flight: FlightSpec, varying: tuple[str, ...]) -> tuple[str, ...]:
    """Return what the batch engine does not understand; an exception in it is a reason as well."""
    try:
        return batch.refusals(flight, varying)
    except Exception as error:
        # A defect of the batch engine must not prevent a campaign in JSBSim.
        return (
            (
                f"the batch engine failed at reading {flight.aircraft.name}:"
                f" {type(error).__name__}: {error}"
            ),
        )


def varying_properties(spec: CampaignSpec) -> tuple[str, ...]:
    """Return the properties whose values differ between the cases of a campaign."""
    coefficients = () if spec.epistemic.method == "none" else spec.inputs.coefficients
    names = [f"uq/{name}/level" for name in coefficients]
    if spec.epistemic.parameters is not None and spec.inputs.estimates is not None:
        names += spec.inputs.estimates.names
    return tuple(dict.fromkeys([*names, *spec.aleatory.variables]))


def previous_engine(folder: Path) -> PreviousEngine | None:
    """Return the engine of the flights in ``folder`` or in the shards next to it; None without
    flights.
    """
    sibling_shards = shard_folders(folder.parent.parent) if folder.parent.name == SHARDS else []
    for place in (folder, *sibling_shards):
        if (place / MANIFEST).exists():
            # A damaged manifest is reported by the command that continues the campaign.
            with contextlib.suppress(BadInputError):
                manifest = read_manifest(place)
                engine = str(manifest["campaign"]["campaign"]["engine"])
                if engine in (BATCH, JSBSIM):
                    return PreviousEngine(engine, tuple(manifest.get("engine", {}).get("why", ())))
    return None


@contextlib.contextmanager
def staged_mission_of(spec: CampaignSpec, mission: Mission) -> Iterator[Mission]:
    """Yield the mission with an aircraft that can be read, making a temporary copy if necessary."""
    if not needs_copy(spec) or mission.aircraft.exists():
        yield mission
        return
    with scratch_folder("engine") as scratch:
        aircraft = scratch.path / mission.aircraft.parent.name / mission.aircraft.name
        script = scratch.path / SCRIPT if spec.start is not None else mission.script
        staged = dataclasses.replace(mission, aircraft=aircraft, script=script)
        make_copy(spec, staged, scratch.path)
        yield staged


# Comparison of the batch engine with JSBSim.

TOLERANCE = 1e-6
"""Largest difference of a metric relative to its scale."""
MIN_SHARE_OF_MEDIAN, MIN_SCALE = 1e-3, 1e-2
"""Lower limits of the scale of a metric: as a share of the median, and in the metric's unit.

Positions are rounded to about 1e-9 m, so without a lower limit a condition without scatter would be
compared by its rounding.
"""
RADIUS_MARGIN_M = 1e-6
"""A count may differ if the flight came this close to a radius."""
ONE_IN = 1000
"""One in so many cases is flown in JSBSim as well, in addition to the first of each condition."""

_JSBSIM_PREFIX = "jsbsim:"
_FLIGHTS_FOR_SCALE = 64
# Another order of summation changes a signal by about 1e-10, one unit in the last place by 1e-16,
# and damped flight hides both. After loss of control both grow alike, which gives this factor.
_TIMES_ROUNDING = 1e5
_LOSS_OF_CONTROL = "loss_of_control"
_TIMEOUT, _NOT_COMPARED = (
    "timeout",
    "a flight had no result within its time limit: nothing is compared",
)
_EQUAL, _EXCUSED, _DIFFERS = "alike", "excused", "differs"

Scales = Mapping[str, float]
Refly = Callable[[Case], CaseOutcome]


class EngineComparison:
    """Compare flights of the batch engine with JSBSim's as they come in and keep engine-check.csv.

    A metric may differ by `TOLERANCE` times its interquartile range over the condition. After loss
    of control, and for the way a flight ends, the reference is JSBSim itself from a start that is
    moved by one unit in the last place: it shows how much rounding alone can change.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    cases : sequence of Case
        Cases of the run.
    refly : callable
        Flies a case in JSBSim from a start that is one unit in the last place off.
    finished : iterable of CaseOutcome
        Flights of earlier runs.
    """

    def __init__(
        self,
        folder: Path,
        cases: Sequence[Case],
        refly: Refly,
        finished: Iterable[CaseOutcome] = (),
    ) -> None:
        self._folder, self._refly = folder, refly
        # Conditions and sizes, cases to compare, and values for the scales.
        self._condition = {case.case_id: condition_of(case) for case in cases}
        self._in_condition = dict.fromkeys(self._condition.values(), 0)
        for condition in self._condition.values():
            self._in_condition[condition] += 1
        self._cases = {case.case_id: case for case in _cases_to_compare(cases)}
        self._values: dict[Condition, dict[str, array[float]]] = {
            condition: {} for condition in self._in_condition
        }
        self._flown = dict.fromkeys(self._in_condition, 0)
        self._batch: dict[str, CaseOutcome] = {}
        self._jsbsim: dict[str, CaseOutcome] = {}
        self._rows: dict[tuple[str, str], list[CheckRow]] = {}
        self._remember(read_check(folder))
        for outcome in finished:
            self._learn(outcome)

    def groups(self, cases: Iterable[Case]) -> list[Group]:
        """Return JSBSim flights of these cases that are needed and not there yet, one per group."""
        uncompared = [
            case
            for case in cases
            if case.case_id in self._cases and case.case_id not in self._jsbsim
        ]
        return [
            Group(JUDGE, ((_JSBSIM_PREFIX + case.case_id, case.flight),)) for case in uncompared
        ]

    def take(self, outcomes: Iterable[CaseOutcome]) -> list[CaseOutcome]:
        """Record outcomes and return those of the campaign itself.

        JSBSim flights carry a prefix in their id and are kept here.
        """
        campaign_outcomes: list[CaseOutcome] = []
        for outcome in outcomes:
            if outcome.case_id.startswith(_JSBSIM_PREFIX):
                case_id = outcome.case_id.removeprefix(_JSBSIM_PREFIX)
                self._jsbsim[case_id] = dataclasses.replace(outcome, case_id=case_id)
            else:
                self._learn(outcome)
                campaign_outcomes.append(outcome)
        return campaign_outcomes

    def compare(self, final: bool) -> None:
        """Compare new pairs; with ``final`` all pairs, by the scales of all flights.

        Raises EnginesDifferError.
        """
        scales: dict[Condition, Scales] = {}
        has_new = False
        for case_id, case in self._cases.items():
            if case_id not in self._batch or case_id not in self._jsbsim:
                continue
            condition = self._condition[case_id]
            # The scale is usable once enough flights of the condition are there.
            is_scale_known = self._flown[condition] >= min(
                _FLIGHTS_FOR_SCALE, self._in_condition[condition]
            )
            if not (final or (is_scale_known and (FULL_FLIGHT, case_id) not in self._rows)):
                continue
            if condition not in scales:
                scales[condition] = {
                    name: difference_scale(values)
                    for name, values in self._values[condition].items()
                }
            # Both outcomes are there: compare them and store the rows.
            pair = (self._batch[case_id], self._jsbsim[case_id])
            self._rows[FULL_FLIGHT, case_id] = compare_outcomes(
                FULL_FLIGHT, case, pair, scales[condition], self._refly
            )
            has_new = True
        if has_new:
            self._write()

    def begin(self, rows: Sequence[CheckRow]) -> None:
        """Store the comparison of the first seconds. Raises EnginesDifferError."""
        self._rows = {
            key: rows_of_case for key, rows_of_case in self._rows.items() if key[0] != START
        }
        for row in rows:
            self._rows.setdefault((START, row.case_id), []).append(row)
        self._write()

    def _write(self) -> None:
        """Write engine-check.csv and raise EnginesDifferError if a row differs.

        The first seconds come first, then flights in the campaign's order, whichever ended first.
        """
        place = {case_id: k for k, case_id in enumerate(self._cases)}
        keys = sorted(
            self._rows, key=lambda key: (key[0] != START, place.get(key[1], len(place)), key[1])
        )
        rows = [row for key in keys for row in self._rows[key]]
        write_check(self._folder, rows)
        refuse_difference(self._folder, rows)

    def _learn(self, outcome: CaseOutcome) -> None:
        """Record a batch flight for the comparison and for the scales of its condition."""
        condition = self._condition.get(outcome.case_id)
        if condition is None:
            return
        self._flown[condition] += 1
        if outcome.case_id in self._cases:
            self._batch[outcome.case_id] = outcome
        if outcome.status == "ok":
            for name, value in outcome.metrics.items():
                self._values[condition].setdefault(name, array("d")).append(value)

    def _remember(self, rows: Sequence[CheckRow]) -> None:
        """Reuse JSBSim flights of an earlier run, except those that differed or timed out."""
        by_flight: dict[tuple[str, str], list[CheckRow]] = {}
        for row in rows:
            by_flight.setdefault((row.part, row.case_id), []).append(row)
        for (part, case_id), flight_rows in by_flight.items():
            status = [row.jsbsim for row in flight_rows if row.metric == STATUS]
            is_usable = (
                len(status) == 1
                and status[0] != _TIMEOUT
                and all(row.verdict != _DIFFERS for row in flight_rows)
            )
            if part == FULL_FLIGHT and case_id in self._cases and is_usable:
                metrics = {
                    row.metric: as_number(row.jsbsim) for row in flight_rows if row.metric != STATUS
                }
                self._jsbsim[case_id] = CaseOutcome(case_id, status[0], "", 0.0, metrics)
                self._rows[part, case_id] = flight_rows


def _cases_to_compare(cases: Sequence[Case]) -> Iterator[Case]:
    """Yield the first case of each condition and one in `ONE_IN` by its hash."""
    visited: set[Condition] = set()
    for case in cases:
        condition = condition_of(case)
        if condition not in visited or int(case.case_id, 16) % ONE_IN == 0:
            visited.add(condition)
            yield case


def condition_of(case: Case) -> Condition:
    """Return the condition of a case."""
    return Condition(case.wind_mps, case.turbulence)


def difference_scale(values: Sequence[float]) -> float:
    """Return the scale for differences of a metric: its interquartile range, with lower limits."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return MIN_SCALE
    # Interquartile range, limited from below.
    low, middle, high = np.percentile(finite, (25.0, 50.0, 75.0))
    return float(max(high - low, MIN_SHARE_OF_MEDIAN * abs(middle), MIN_SCALE))


def compare_outcomes(
    part: str, case: Case, pair: tuple[CaseOutcome, CaseOutcome], scales: Scales, refly: Refly
) -> list[CheckRow]:
    """Return the rows of engine-check.csv for one case.

    Parameters
    ----------
    part : str
        start (first seconds) or whole.
    case : Case
        The case.
    pair : tuple of CaseOutcome
        Its outcomes in the batch engine and in JSBSim.
    scales : mapping of str to float
        Scale of each metric in its unit.
    refly : callable
        Flies the case in JSBSim with a perturbed start; called at most once.
    """
    batch, jsbsim = pair
    # A timeout depends on the load of the machine, not on the engine.
    timed_out = _TIMEOUT in (batch.status, jsbsim.status)
    perturbed: list[CaseOutcome] = []

    def perturbed_outcome() -> CaseOutcome:
        """Return JSBSim's outcome from the perturbed start, flown on first use."""
        if not perturbed:
            perturbed.append(refly(case))
        return perturbed[0]

    def row(
        metric: str, ours: str, theirs: str, share: tuple[str, str], verdict: tuple[str, str]
    ) -> CheckRow:
        """Return one row."""
        return CheckRow(
            part, condition_of(case).label, case.case_id, metric, ours, theirs, *share, *verdict
        )

    # The first row compares how the flight ended.
    is_equal = batch.status == jsbsim.status
    is_excused = not is_equal and (timed_out or perturbed_outcome().status != jsbsim.status)
    excuse = _NOT_COMPARED if timed_out else "JSBSim's own differs after one ulp"
    rows = [
        row(STATUS, batch.status, jsbsim.status, ("", ""), _verdict(is_equal, is_excused, excuse))
    ]
    for name in sorted(batch.metrics.keys() | jsbsim.metrics.keys()):
        ours, theirs = batch.metrics.get(name, math.nan), jsbsim.metrics.get(name, math.nan)
        if name.startswith(NEAREST):
            rows.append(row(name, "", as_text(theirs), ("", ""), (_EQUAL, "")))
            continue
        # Counts are compared exactly, other metrics relative to their scale.
        scale = 1.0 if is_count(name) else scales.get(name, MIN_SCALE)
        share = (
            0.0
            if ours == theirs or (math.isnan(ours) and math.isnan(theirs))
            else abs(ours - theirs) / scale
        )
        is_equal = share <= TOLERANCE
        excuse = (
            ""
            if is_equal
            else _NOT_COMPARED
            if timed_out
            else _excuse(name, pair, perturbed_outcome)
        )
        if batch.status != jsbsim.status and not excuse:
            # Metrics of a flight that ended differently are covered by the row on its status.
            excuse = "the flight ended otherwise" if rows[0].verdict == _EXCUSED else ""
        rows.append(
            row(
                name,
                as_text(ours),
                as_text(theirs),
                (as_text(scale), as_text(share)),
                _verdict(is_equal, bool(excuse), excuse),
            )
        )
    return rows


def _verdict(is_equal: bool, is_excused: bool, reason: str) -> tuple[str, str]:
    """Return the verdict and the remark of a row."""
    return (_EQUAL, "") if is_equal else (_EXCUSED, reason) if is_excused else (_DIFFERS, "")


def _excuse(
    name: str, pair: tuple[CaseOutcome, CaseOutcome], perturbed_outcome: Callable[[], CaseOutcome]
) -> str:
    """Return why a difference is not the fault of the batch engine; empty if it is."""
    batch, jsbsim = pair
    if is_count(name) and jsbsim.metrics.get(NEAREST + name, math.inf) <= RADIUS_MARGIN_M:
        return f"the flight came within {RADIUS_MARGIN_M:g} m of the radius"
    # Only after loss of control may rounding explain a difference.
    lost_control = any(outcome.metrics.get(_LOSS_OF_CONTROL, 0.0) != 0.0 for outcome in pair)
    if not lost_control:
        return ""
    ours, theirs, perturbed = (
        outcome.metrics.get(name, math.nan) for outcome in (batch, jsbsim, perturbed_outcome())
    )
    if abs(ours - theirs) <= _TIMES_ROUNDING * abs(perturbed - theirs):
        return "control was lost, and JSBSim's own differs after one ulp"
    return ""


def is_count(name: str) -> bool:
    """Return whether a metric is an integer, which must agree exactly."""
    return name.startswith("excursions_") or name == _LOSS_OF_CONTROL


def refuse_difference(folder: Path, rows: Sequence[CheckRow]) -> None:
    """Raise EnginesDifferError that names the largest difference, if a row differs."""
    differing = [row for row in rows if row.verdict == _DIFFERS]
    if not differing:
        return
    # Report the largest difference; undefined values count as infinite.
    worst = max(
        differing,
        key=lambda row: math.inf if row.difference in ("", "nan") else float(row.difference),
    )
    when = " in its first seconds" if worst.part == START else ""
    distance = (
        f", {float(worst.difference):.2g} of its spread apart (at most {TOLERANCE:g})"
        if worst.difference
        else ""
    )
    raise EnginesDifferError(
        f"{folder}: the batch engine differs from JSBSim: case {worst.case_id}"
        f" ({worst.condition}){when} has {worst.metric} {worst.batch or 'undefined'} in the batch"
        f" engine and {worst.jsbsim or 'undefined'} in JSBSim{distance}; {len(differing)} such rows"
        f" in {folder / ENGINE_CHECK}. The results in this folder are not valid: run the campaign"
        " with --engine jsbsim into another --out, and report the aircraft"
    )


# Comparison of the first seconds, and the pace of this machine.

START_S = 10.0
"""Simulated time [s] of the comparison before any case."""
CASES_EACH = 8
"""Cases of each condition flown for it; their scatter is the scale of differences."""
STORING_S = 2e-3
"""Run time [s] of scoring and storing a flight, measured."""

_LIMIT_S = 120.0
_FIRST_SECONDS_ALIKE = 1e-6
_PACE_LANES, _PACE_S = 64, 60.0


def throwaway_process() -> ProcessExecutor:
    """Return a worker process for flights that may end the interpreter; it is kept for several
    calls.
    """
    return ProcessExecutor(1, timeout_s=lambda flight: _LIMIT_S, retries=0, keep=True)


def compare_start(
    engines: Engines, cases: Sequence[Case], process: ProcessExecutor
) -> list[CheckRow]:
    """Fly the first seconds of some cases in both engines and return the rows of the comparison.

    The conditions are those of `trial_conditions`. Raises BadInputError if they cannot be flown.
    """
    rows: list[CheckRow] = []
    by_condition: dict[Condition, list[Case]] = {}
    for case in cases:
        by_condition.setdefault(condition_of(case), []).append(case)
    winds, turbulences = (
        list(dict.fromkeys(values))
        for values in zip(*((air.wind_mps, air.turbulence) for air in by_condition), strict=True)
    )
    # A shard may lack a condition.
    trial = {
        Condition(*pair) for pair in trial_conditions(winds, turbulences)
    } & by_condition.keys()
    for members in (by_condition[air] for air in by_condition if air in trial):
        # Evenly spaced cases of the condition, cut to their first seconds.
        picked = [
            _brief(case) for case in members[:: max(1, len(members) // CASES_EACH)][:CASES_EACH]
        ]
        batch = _fly_by_case(
            engines, process, [Group(BATCH, tuple((case.case_id, case.flight) for case in picked))]
        )
        jsbsim = _fly_by_case(
            engines, process, [Group(JUDGE, ((case.case_id, case.flight),)) for case in picked]
        )
        values: dict[str, array[float]] = {}
        for outcome in batch.values():
            for name, value in outcome.metrics.items():
                values.setdefault(name, array("d")).append(value)
        scales = {name: difference_scale(metric_values) for name, metric_values in values.items()}
        for case in picked:
            pair = (batch[case.case_id], jsbsim[case.case_id])
            rows_of_case = compare_outcomes(
                START, case, pair, scales, lambda case: one_ulp_off(engines, case, process)
            )
            differs = any(row.verdict == _DIFFERS for row in rows_of_case)
            if differs and is_rounding(engines, case, process):
                rows_of_case = [
                    dataclasses.replace(row, verdict=_EXCUSED, remark=_GROWTH)
                    if row.verdict == _DIFFERS
                    else row
                    for row in rows_of_case
                ]
            rows += rows_of_case
    return rows


_GROWTH = "JSBSim's own grows as fast after one ulp"
_HALVINGS = 6


def is_rounding(engines: Engines, case: Case, process: ProcessExecutor) -> bool:
    """Return whether rounding that grows in an unstable model explains how the engines differ.

    JSBSim flies the case again from a start that is one unit in the last place off. The difference
    of the engines may be `_TIMES_ROUNDING` times what that changes. In a flight long enough for
    rounding to grow to the size of the signals anything is allowed, so ever shorter flights are
    compared, each half as long as the one before, down to the first that agrees without growth. A
    wrong translation is larger than a unit in the last place in every frame and grows alike, so one
    of them shows it.
    """
    for halvings in range(_HALVINGS + 1):
        duration_s = min(START_S, case.flight.duration_s) / 2.0**halvings
        brief = dataclasses.replace(
            case, flight=dataclasses.replace(case.flight, duration_s=duration_s, burn_in_s=0.0)
        )
        lane = ((case.case_id, brief.flight),)
        ours, theirs, perturbed = (
            next(iter(_outcomes(engines, process, [Group(engine, lane)])))
            for engine in (BATCH, JUDGE, ONE_ULP_OFF)
        )
        if any(outcome.status != "ok" for outcome in (ours, theirs, perturbed)):
            if len({outcome.status for outcome in (ours, theirs, perturbed)}) == 1:
                continue
            return False
        agrees = True
        for name, value in theirs.metrics.items():
            if name.startswith(NEAREST) or not math.isfinite(value):
                continue
            gap = abs(ours.metrics.get(name, value) - value)
            growth = _TIMES_ROUNDING * abs(perturbed.metrics.get(name, value) - value)
            limit = _FIRST_SECONDS_ALIKE * max(abs(value), 1.0)
            if not gap <= max(limit, growth):
                return False
            agrees = agrees and gap <= limit
        if agrees:
            return True
    return False


def choose_engine_by_flight(
    spec: CampaignSpec,
    mission: Mission,
    engines: Engines,
    previous: PreviousEngine | None,
    process: ProcessExecutor,
) -> EngineChoice:
    """Choose the engine as `choose_engine` does, and verify an automatic choice of batch by a
    flight in ``process``, a `throwaway_process`.

    If the first seconds differ between the engines, JSBSim is taken and the difference is the
    reason.
    """
    choice = choose_engine(spec, mission, engines, previous)
    # Only an automatic choice is verified by a flight.
    if choice.requested != "auto" or choice.engine != BATCH or previous is not None:
        return choice
    with staged_mission_of(spec, mission) as staged:
        case = _brief(one_case_each(choice.spec, staged)[-1])
        # The last condition is the most severe of those tried out.
        ours, theirs = (
            next(iter(_outcomes(engines, process, [Group(engine, ((case.case_id, case.flight),))])))
            for engine in (BATCH, JUDGE)
        )
        difference = _first_difference(ours, theirs)
        if difference is None or is_rounding(engines, case, process):
            return choice
    return EngineChoice(spec.with_engine(JSBSIM), choice.requested, (difference,))


def _first_difference(ours: CaseOutcome, theirs: CaseOutcome) -> str | None:
    """Return a sentence on the first difference of two short flights; None if there is none.

    If JSBSim cannot fly the case, the check flight of the run reports it.
    """
    if theirs.bad_input or theirs.status != "ok":
        return None
    message = f"in the first {START_S:g} s the batch engine differs from JSBSim"
    if ours.status != "ok":
        return f"{message}: {ours.status}, {ours.reason}"
    for name, value in theirs.metrics.items():
        batch_value = ours.metrics.get(name, value)
        if math.isfinite(value) and not abs(batch_value - value) <= _FIRST_SECONDS_ALIKE * max(
            abs(value), 1.0
        ):
            return f"{message}: {name} {batch_value:.6g}, in JSBSim {value:.6g}"
    return None


def one_ulp_off(engines: Engines, case: Case, process: ProcessExecutor) -> CaseOutcome:
    """Fly a case in JSBSim from a start that is one unit in the last place off."""
    return _fly_by_case(engines, process, [Group(ONE_ULP_OFF, ((case.case_id, case.flight),))])[
        case.case_id
    ]


def one_ulp_off_alone(engines: Engines, case: Case) -> CaseOutcome:
    """Fly as `one_ulp_off` does, in a separate process."""
    with contextlib.closing(throwaway_process()) as process:
        return one_ulp_off(engines, case, process)


def batch_pace(engines: Engines, cases: Sequence[Case], process: ProcessExecutor) -> Pace | None:
    """Measure the pace of one process in the batch engine; None if a flight does not end well."""
    full = cases[0].flight
    length = min(_PACE_S, full.duration_s + full.burn_in_s)
    # Short flights side by side, cycling through the conditions.
    lanes = tuple(
        (f"{number}", dataclasses.replace(case.flight, duration_s=length, burn_in_s=0.0))
        for number, case in zip(range(_PACE_LANES), itertools.cycle(cases), strict=False)
    )
    shortest_s = float("inf")
    for _ in range(2):
        start_s = time.monotonic()
        if any(
            outcome.status != "ok" for outcome in _outcomes(engines, process, [Group(BATCH, lanes)])
        ):
            return None
        # Other work on the machine can only add time.
        shortest_s = min(shortest_s, time.monotonic() - start_s)
    return Pace(STORING_S, shortest_s / (len(lanes) * length))


def _brief(case: Case) -> Case:
    """Return the case cut to its first seconds, without burn-in."""
    flight = case.flight
    return dataclasses.replace(
        case,
        flight=dataclasses.replace(
            flight, duration_s=min(START_S, flight.duration_s), burn_in_s=0.0
        ),
    )


def _fly_by_case(
    engines: Engines, process: ProcessExecutor, groups: Iterable[Group]
) -> dict[str, CaseOutcome]:
    """Fly groups and return outcomes by case id. Raises BadInputError for a refused flight."""
    outcomes = {outcome.case_id: outcome for outcome in _outcomes(engines, process, groups)}
    for outcome in outcomes.values():
        if outcome.bad_input:
            raise BadInputError(outcome.reason)
    return outcomes


def _outcomes(
    engines: Engines, process: ProcessExecutor, groups: Iterable[Group]
) -> list[CaseOutcome]:
    """Fly groups and return their outcomes."""
    return [outcome for batch in process.run_groups(engines.fly_group, groups) for outcome in batch]
