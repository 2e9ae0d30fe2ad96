"""Which engine flies a campaign, settled once for all its flights, and why."""

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

from sysid.digests import sha256_hex
from uqharness.campaign.cases import Case, Mission
from uqharness.campaign.conditions import Condition
from uqharness.campaign.cost import Pace, one_case_each, trial_conditions
from uqharness.campaign.execution.processes import ProcessExecutor
from uqharness.campaign.execution.worker import (
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
    fly_group,
)
from uqharness.campaign.folder.manifest import MANIFEST, read_manifest
from uqharness.campaign.folder.shards import SHARDS, shard_folders
from uqharness.campaign.folder.tables import (
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
from uqharness.campaign.spec.campaign import CampaignSpec, read_bounds
from uqharness.errors import BadInputError, EnginesDifferError
from uqharness.files import inner_folder, scratch_folder
from uqharness.flight import FlightSpec
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.simulator import (
    SCRIPT,
    Aircraft,
    content_hash,
    copy_beside,
    copy_folder,
    engine,
    find_aircraft,
    parse_xml,
    read_xml,
    walk,
    write_steady_start,
)

# The aircraft of a campaign where it is not the author's own files: with bounds from a model
# form, with a trimmed start, or both.
#
# Such an aircraft is a copy in the campaign's folder, so that what was flown stays with what
# came out.

SYSTEM = "model-form"
_COPIED = "aircraft"
_UNFINISHED = ".aircraft-"
_SENSOR = b"sensor/V-mps"
"""Property by which a sensors system is recognised."""
_ACTIVE = b"uq/active"  # the switch of the plugin's deltas


def needs_copy(spec: CampaignSpec) -> bool:
    """Whether the campaign flies a copy of the aircraft."""
    return spec.inputs.model_form is not None or spec.start is not None


def named_aircraft(spec: CampaignSpec) -> Aircraft:
    """The aircraft that the campaign names: beside its own file, else as ``uqharness fly`` finds
    it. Raises BadInputError.
    """
    relative_path = spec.path.resolve().parent / spec.campaign.aircraft
    return find_aircraft(relative_path if relative_path.is_dir() else spec.campaign.aircraft)


def has_sensors(aircraft: Aircraft) -> bool:
    """Whether the aircraft's files have a sensors system, whose output the noise of the sensors is
    added to.
    """
    paths = (path for _, path in walk(aircraft.folder) if path.suffix.lower() == ".xml")
    return any(_SENSOR in path.read_bytes() for path in paths)


def require_plugin(spec: CampaignSpec, aircraft: Aircraft) -> None:
    """Raise BadInputError where the campaign moves coefficients and nothing in the aircraft's files
    adds their deltas.
    """
    if spec.epistemic.method == "none" or not spec.epistemic.coefficients:
        return
    paths = (path for _, path in walk(aircraft.folder) if path.suffix.lower() == ".xml")
    if not any(_ACTIVE in path.read_bytes() for path in paths):
        system_file(aircraft)


def with_noise_of(spec: CampaignSpec, aircraft: Aircraft) -> CampaignSpec:
    """The campaign with ``sensor_noise`` settled: where the file does not say, on if the aircraft
    has a sensors system.
    """
    if spec.aleatory.sensor_noise is not None:
        return spec
    return spec.with_sensor_noise(has_sensors(aircraft))


def with_default_noise(spec: CampaignSpec, mission: Mission) -> CampaignSpec:
    """Return the campaign with ``sensor_noise`` settled by the aircraft that the mission flies."""
    # A copy of the aircraft may not have been made yet; its sensors are those of its source.
    source = mission.source if mission.source != Path() else mission.aircraft
    return with_noise_of(spec, find_aircraft(source))


def noise_notes(spec: CampaignSpec) -> list[str]:
    """That a campaign which says nothing of sensor noise flies without. Raises BadInputError."""
    aircraft = named_aircraft(spec)
    if spec.aleatory.sensor_noise is not None or has_sensors(aircraft):
        return []
    return [
        (
            f"aircraft '{aircraft.name}' has no sensors system: it is flown without sensor noise"
            " ([aleatory] sensor_noise = false)"
        )
    ]


def bounds_notes(spec: CampaignSpec) -> list[str]:
    """What to know before flying: bounds that were made for other files than the aircraft's.

    Raises BadInputError.
    """
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
            f"{path}: the bounds were made for aircraft {origin} (SHA-256 {made_for.sha256[:12]}...);"
            f" {consequence}"
        )
    ]


def find_copied_mission(
    spec: CampaignSpec, aircraft: Aircraft, script: Path | None, folder: Path
) -> Mission:
    """The mission that a copy in ``folder`` is going to fly, with the hashes of what it will hold;
    nothing is left behind.

    ``script`` None: the steady flight of [start]. Raises BadInputError as :func:`make_copy` does.
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
        aircraft.folder,
    )


def make_copy(spec: CampaignSpec, mission: Mission, folder: Path) -> None:
    """Make the copy that ``mission`` flies in ``folder``, unless it is there already.

    Raises BadInputError if the aircraft does not carry the plugin, cannot have these bounds, or has
    no trim."""
    for unfinished in folder.glob(f"{_UNFINISHED}*"):
        shutil.rmtree(unfinished, ignore_errors=True)
    target = mission.aircraft
    if target.exists() and content_hash(find_aircraft(target)) == mission.aircraft_hash:
        return
    with tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=folder) as name:
        copy = _copy_aircraft(spec, find_aircraft(mission.source), Path(name))
        # A folder with flights of another aircraft is refused before; what is left to find here is
        # half a copy.
        shutil.rmtree(target, ignore_errors=True)
        for entry in ("engine", "systems", SCRIPT):
            if (Path(name) / entry).exists():
                shutil.rmtree(folder / entry, ignore_errors=True)
                os.replace(Path(name) / entry, folder / entry)
        os.replace(copy, inner_folder(folder, _COPIED) / target.name)


def _copy_aircraft(spec: CampaignSpec, aircraft: Aircraft, root: Path) -> Path:
    copy = root / _COPIED / aircraft.folder.name
    copy_folder(aircraft.folder, copy)
    copy_beside(aircraft, root, engine.default_root())
    if spec.inputs.model_form is not None:
        put_bounds(copy, aircraft, spec.inputs.model_form)
    if spec.start is not None:
        write_steady_start(find_aircraft(copy), spec.start, root / SCRIPT, str(spec.path))
    return copy


def put_bounds(copy: Path, aircraft: Aircraft, model_form: Path) -> None:
    """Give the copy ``copy`` of an aircraft the bounds of a model-form.json.

    Raises BadInputError as :func:`make_copy` does.
    """
    text = model_form_xml(read_bounds(model_form), aircraft)
    destination = copy / system_file(aircraft).relative_to(aircraft.folder)
    destination.unlink()
    destination.write_bytes(text)


def system_file(aircraft: Aircraft) -> Path:
    """The file of the aircraft's model-form system."""
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
        f'{aircraft.xml}: carries no <system file="{SYSTEM}"/>, so no bounds can act on it; '
        f"add the plugin first: uqharness instrument {aircraft.name} --out DIR"
    )


_REQUESTED = "it was asked for"
_MAX_REASONS = 8


@dataclass(frozen=True)
class Engines:
    """What there is to fly with: ``fly`` is JSBSim's, ``fly_group`` flies in any engine, ``batch``
    says what it understands.

    ``no_batch`` is why there is no ``batch``.
    """

    fly: FlightFunction
    fly_group: GroupFunction
    batch: Batch | None
    no_batch: str = ""

    @staticmethod
    def of(fly: FlightFunction | Engines | None) -> Engines:
        """This program's own where nothing is given; a flight function by itself flies one flight
        after the other.
        """
        if isinstance(fly, Engines):
            return fly
        if fly is not None:
            return Engines(
                fly, OneByOne(fly), None, "the flights are flown by a function of their own"
            )
        from uqharness.flight.fly import fly as own

        return Engines(own, fly_group, LocalBatch())

    def unavailable(self) -> str | None:
        """Why the batch engine cannot fly on this machine; None if it can."""
        return self.no_batch if self.batch is None else self.batch.available()


@dataclass(frozen=True)
class EngineChoice:
    """A campaign whose engine is settled: ``spec`` has its name, ``asked`` what was asked for,
    ``why`` the reasons.
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
        """The engine and why, in one line."""
        return engine_words(self.engine, self.reasons)

    def as_dict(self) -> dict[str, Any]:
        """What a manifest keeps beside the engine's name."""
        return {"asked": self.requested, "why": list(self.reasons)}


def engine_words(engine: str, reasons: tuple[str, ...]) -> str:
    """``jsbsim, because ...``: the first reasons."""
    more = f"; and {len(reasons) - _MAX_REASONS} more" if len(reasons) > _MAX_REASONS else ""
    return f"{engine}, because {'; '.join(reasons[:_MAX_REASONS])}{more}" if reasons else engine


@dataclass(frozen=True)
class PreviousEngine:
    """The engine of a campaign that has begun, and why it was taken."""

    engine: str
    reasons: tuple[str, ...] = ()


def choose_engine(
    spec: CampaignSpec, mission: Mission, engines: Engines, previous: PreviousEngine | None = None
) -> EngineChoice:
    """Settle the engine of a campaign: what is asked for, else that of its ``previous`` flights,
    else batch where it can fly it.

    Raises BadInputError where the batch engine is asked for, or flew before, and cannot fly it
    here."""
    requested = spec.campaign.engine
    continues = previous is not None and requested in ("auto", previous.engine)
    engine_name, given_reasons = (
        (previous.engine, previous.reasons)
        if previous is not None and continues
        else (requested, (_REQUESTED,))
    )
    if engine_name == JSBSIM:
        return EngineChoice(spec.with_engine(JSBSIM), requested, given_reasons)
    if continues and engine_name == BATCH:
        # What it understands was asked at the first run, of the same aircraft and version.
        reason = engines.unavailable()
        if reason is not None:
            raise BadInputError(
                f"{spec.path}: this campaign flies in the batch engine, and {reason}; fly it where"
                " it began"
            )
        return EngineChoice(spec.with_engine(BATCH), requested, given_reasons)
    reasons = reasons_against(spec, mission, engines)
    if engine_name == BATCH:
        if reasons:
            raise BadInputError(
                f"{spec.path}: the batch engine was asked for and cannot fly this campaign:",
                *reasons,
            )
        return EngineChoice(spec.with_engine(BATCH), requested, (_REQUESTED,))
    if reasons:
        return EngineChoice(spec.with_engine(JSBSIM), requested, reasons)
    return EngineChoice(
        spec.with_engine(BATCH), requested, ("it understands the whole aircraft and mission",)
    )


def reasons_against(spec: CampaignSpec, mission: Mission, engines: Engines) -> tuple[str, ...]:
    """Why the batch engine cannot fly this campaign, a sentence each; empty if it can."""
    reason = engines.unavailable()
    if reason is not None or engines.batch is None:
        return (reason or engines.no_batch,)
    varying = varying_properties(spec)
    with staged_mission_of(spec, mission) as staged:
        refusals = [
            text
            for case in one_case_each(spec, staged)
            for text in _refusals(engines.batch, case.flight, varying)
        ]
        return tuple(
            dict.fromkeys(
                text.replace(str(staged.aircraft), str(mission.aircraft)) for text in refusals
            )
        )


def _refusals(batch: Batch, flight: FlightSpec, varying: tuple[str, ...]) -> tuple[str, ...]:
    try:
        return batch.refusals(flight, varying)
    except Exception as error:
        # A defect of one engine is no reason to fly in none.
        return (
            (
                f"the batch engine failed at reading {flight.aircraft.name}:"
                f" {type(error).__name__}: {error}"
            ),
        )


def varying_properties(spec: CampaignSpec) -> tuple[str, ...]:
    """Properties whose values differ between the cases of a campaign."""
    coefficients = () if spec.epistemic.method == "none" else spec.inputs.coefficients
    names = [f"uq/{name}/level" for name in coefficients]
    if spec.epistemic.parameters is not None and spec.inputs.estimates is not None:
        names += spec.inputs.estimates.names
    return tuple(dict.fromkeys([*names, *spec.aleatory.variables]))


def previous_engine(folder: Path) -> PreviousEngine | None:
    """Engine of the campaign whose flights ``folder`` holds, or those of the shards beside it; None
    where there are none.
    """
    sibling_shards = shard_folders(folder.parent.parent) if folder.parent.name == SHARDS else []
    for place in (folder, *sibling_shards):
        if (place / MANIFEST).exists():
            # What is wrong with it is said by whoever goes on with the campaign.
            with contextlib.suppress(BadInputError):
                manifest = read_manifest(place)
                engine = str(manifest["campaign"]["campaign"]["engine"])
                if engine in (BATCH, JSBSIM):
                    return PreviousEngine(engine, tuple(manifest.get("engine", {}).get("why", ())))
    return None


@contextlib.contextmanager
def staged_mission_of(spec: CampaignSpec, mission: Mission) -> Iterator[Mission]:
    """The mission with an aircraft to look at, where the copy that is going to fly has not been
    made yet.
    """
    if not needs_copy(spec) or mission.aircraft.exists():
        yield mission
        return
    with scratch_folder("engine") as scratch:
        aircraft = scratch.path / mission.aircraft.parent.name / mission.aircraft.name
        script = scratch.path / SCRIPT if spec.start is not None else mission.script
        staged = dataclasses.replace(mission, aircraft=aircraft, script=script)
        make_copy(spec, staged, scratch.path)
        yield staged


# JSBSim as the judge of the batch engine in every campaign: some flights in both, and no
# campaign where they differ.
#
# A metric may differ by a millionth of its spread over the condition's flights. Beyond lost
# control, and in how a flight ends, what JSBSim itself makes of a start that is moved by one
# unit in the last place tells how much rounding alone may do.

TOLERANCE = 1e-6
"""Largest difference of a metric over its spread."""
MIN_SHARE_OF_MEDIAN, MIN_SCALE = 1e-3, 1e-2
"""A spread is the interquartile range of the condition's flights, at least that share of the
median, and that in the metric's unit: positions are rounded to some 1e-9 m, so a condition without
any chance would otherwise be judged by rounding."""
RADIUS_MARGIN_M = 1e-6
"""A count may differ where the flight came so near to a radius."""
ONE_IN = 1000
"""Share of the cases that are flown in JSBSim as well, beside the first of each condition."""

_JSBSIM_PREFIX = "jsbsim:"
_FLIGHTS_FOR_SCALE = 64
# Other sums in another order are worth some 1e-10 of a signal, where one unit in the last place is
# 1e-16, and damped flight hides most of either: from there on both grow alike.
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
    """Compares a campaign's flights in the batch engine with JSBSim's as they come in, and keeps
    engine-check.csv.

    ``refly`` flies a case in JSBSim from a start that is one unit in the last place off;
    ``finished`` are flights of earlier runs."""

    def __init__(
        self,
        folder: Path,
        cases: Sequence[Case],
        refly: Refly,
        finished: Iterable[CaseOutcome] = (),
    ) -> None:
        self._folder, self._refly = folder, refly
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
        """JSBSim's flights that are still wanted of these cases."""
        uncompared = [
            case
            for case in cases
            if case.case_id in self._cases and case.case_id not in self._jsbsim
        ]
        return [
            Group(JUDGE, ((_JSBSIM_PREFIX + case.case_id, case.flight),)) for case in uncompared
        ]

    def take(self, outcomes: Iterable[CaseOutcome]) -> list[CaseOutcome]:
        """Learn what was flown; the flights that are the campaign's own.

        Raises EnginesDifferError once that is certain.
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
        """Compare what is new, or (``final``) everything by the spreads of all flights.

        Raises EnginesDifferError.
        """
        scales: dict[Condition, Scales] = {}
        has_new = False
        for case_id, case in self._cases.items():
            if case_id not in self._batch or case_id not in self._jsbsim:
                continue
            condition = self._condition[case_id]
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
            pair = (self._batch[case_id], self._jsbsim[case_id])
            self._rows[FULL_FLIGHT, case_id] = compare_outcomes(
                FULL_FLIGHT, case, pair, scales[condition], self._refly
            )
            has_new = True
        if has_new:
            self._write()

    def begin(self, rows: Sequence[CheckRow]) -> None:
        """Keep the comparison of the flights' first seconds. Raises EnginesDifferError."""
        self._rows = {
            key: rows_of_case for key, rows_of_case in self._rows.items() if key[0] != START
        }
        for row in rows:
            self._rows.setdefault((START, row.case_id), []).append(row)
        self._write()

    def _write(self) -> None:
        rows = [row for flight_rows in self._rows.values() for row in flight_rows]
        write_check(self._folder, rows)
        refuse_difference(self._folder, rows)

    def _learn(self, outcome: CaseOutcome) -> None:
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
        """JSBSim's flights of an earlier run; those that differed, or had no result in time, are
        flown again.
        """
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
    """The first case of each condition, and those whose hash says so."""
    visited: set[Condition] = set()
    for case in cases:
        condition = condition_of(case)
        if condition not in visited or int(case.case_id, 16) % ONE_IN == 0:
            visited.add(condition)
            yield case


def condition_of(case: Case) -> Condition:
    """Wind and turbulence of a case."""
    return Condition(case.wind_mps, case.turbulence)


def difference_scale(values: Sequence[float]) -> float:
    """What a difference is measured by: the interquartile range, bounded from below."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if finite.size == 0:
        return MIN_SCALE
    low, middle, high = np.percentile(finite, (25.0, 50.0, 75.0))
    return float(max(high - low, MIN_SHARE_OF_MEDIAN * abs(middle), MIN_SCALE))


def compare_outcomes(
    part: str, case: Case, pair: tuple[CaseOutcome, CaseOutcome], scales: Scales, refly: Refly
) -> list[CheckRow]:
    """Rows of one case flown in the batch engine and in JSBSim, which are the ``pair``."""
    batch, jsbsim = pair
    # A limit on time says how busy the machine is, and nothing of either engine.
    timed_out = _TIMEOUT in (batch.status, jsbsim.status)
    perturbed: list[CaseOutcome] = []

    def perturbed_outcome() -> CaseOutcome:
        if not perturbed:
            perturbed.append(refly(case))
        return perturbed[0]

    def row(
        metric: str, ours: str, theirs: str, share: tuple[str, str], verdict: tuple[str, str]
    ) -> CheckRow:
        return CheckRow(
            part, condition_of(case).label, case.case_id, metric, ours, theirs, *share, *verdict
        )

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
            # What is left of a flight that ended otherwise is judged by how it ended.
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
    return (_EQUAL, "") if is_equal else (_EXCUSED, reason) if is_excused else (_DIFFERS, "")


def _excuse(
    name: str, pair: tuple[CaseOutcome, CaseOutcome], perturbed_outcome: Callable[[], CaseOutcome]
) -> str:
    """Why a difference is no fault of the engine; empty where it is."""
    batch, jsbsim = pair
    if is_count(name) and jsbsim.metrics.get(NEAREST + name, math.inf) <= RADIUS_MARGIN_M:
        return f"the flight came within {RADIUS_MARGIN_M:g} m of the radius"
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
    """Whether a metric is a whole number that is alike or not."""
    return name.startswith("excursions_") or name == _LOSS_OF_CONTROL


def refuse_difference(folder: Path, rows: Sequence[CheckRow]) -> None:
    """EnginesDifferError that names the worst of what differs."""
    differing = [row for row in rows if row.verdict == _DIFFERS]
    if not differing:
        return
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
        f" engine and {worst.jsbsim or 'undefined'} in JSBSim{distance}; {len(differing)} such rows in"
        f" {folder / ENGINE_CHECK}. The results in this folder are not valid: fly the campaign with"
        " --engine jsbsim into another --out, and report the aircraft"
    )


# Before a campaign in the batch engine: the first seconds of each condition in both engines,
# and how fast this machine flies.

START_S = 10.0
"""Flight time of the comparison before any case."""
CASES_EACH = 8
"""Cases of each condition that are flown for it: their spread is what differences are
measured by.
"""
STORING_S = 2e-3
"""Scoring and storing a flight, measured."""

_LIMIT_S = 120.0
_FIRST_SECONDS_ALIKE = 1e-6
_PACE_LANES, _PACE_S = 64, 60.0


def throwaway_process() -> ProcessExecutor:
    """A process of its own, so that a flight that ends the interpreter ends only that; kept for
    several calls.
    """
    return ProcessExecutor(1, timeout_s=lambda flight: _LIMIT_S, retries=0, keep=True)


def compare_start(
    engines: Engines, cases: Sequence[Case], process: ProcessExecutor
) -> list[CheckRow]:
    """Fly the first seconds of some cases of some conditions in both engines; what came of it, a
    row a metric.

    The conditions are those of `trial_conditions`: all of a grid that is not large.

    Raises BadInputError where they cannot be flown at all.
    """
    rows: list[CheckRow] = []
    by_condition: dict[Condition, list[Case]] = {}
    for case in cases:
        by_condition.setdefault(condition_of(case), []).append(case)
    winds, turbulences = (
        list(dict.fromkeys(values))
        for values in zip(*((air.wind_mps, air.turbulence) for air in by_condition), strict=True)
    )
    # A shard need not hold a case of each condition.
    trial = {
        Condition(*pair) for pair in trial_conditions(winds, turbulences)
    } & by_condition.keys()
    for members in (by_condition[air] for air in by_condition if air in trial):
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
            rows += compare_outcomes(
                START, case, pair, scales, lambda case: one_ulp_off(engines, case, process)
            )
    return rows


def choose_engine_by_flight(
    spec: CampaignSpec, mission: Mission, engines: Engines, previous: PreviousEngine | None
) -> EngineChoice:
    """``settle``; where the batch engine would be taken by itself, both fly a few seconds, and
    JSBSim is taken if they differ.

    Raises BadInputError as ``settle`` does.
    """
    choice = choose_engine(spec, mission, engines, previous)
    if choice.requested != "auto" or choice.engine != BATCH or previous is not None:
        return choice
    with (
        staged_mission_of(spec, mission) as staged,
        contextlib.closing(throwaway_process()) as process,
    ):
        case = _brief(one_case_each(choice.spec, staged)[-1])
        ours, theirs = (
            next(iter(_outcomes(engines, process, [Group(engine, ((case.case_id, case.flight),))])))
            for engine in (BATCH, JUDGE)
        )
    difference = _first_difference(ours, theirs)
    return (
        choice
        if difference is None
        else EngineChoice(spec.with_engine(JSBSIM), choice.requested, (difference,))
    )


def _first_difference(ours: CaseOutcome, theirs: CaseOutcome) -> str | None:
    """A sentence if two short flights differ; what cannot be flown by either is told by whoever
    flies first.
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
    """JSBSim's flight of the case from a start that is one unit in the last place off."""
    return _fly_by_case(engines, process, [Group(ONE_ULP_OFF, ((case.case_id, case.flight),))])[
        case.case_id
    ]


def one_ulp_off_alone(engines: Engines, case: Case) -> CaseOutcome:
    """The same in a process that it has for itself."""
    with contextlib.closing(throwaway_process()) as process:
        return one_ulp_off(engines, case, process)


def batch_pace(engines: Engines, cases: Sequence[Case], process: ProcessExecutor) -> Pace | None:
    """How fast one process flies in the batch engine; None where the flights that tell do not end
    well.
    """
    full = cases[0].flight
    length = min(_PACE_S, full.duration_s + full.burn_in_s)
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
        # Other work on the machine only ever adds.
        shortest_s = min(shortest_s, time.monotonic() - start_s)
    return Pace(STORING_S, shortest_s / (len(lanes) * length))


def _brief(case: Case) -> Case:
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
    outcomes = {outcome.case_id: outcome for outcome in _outcomes(engines, process, groups)}
    for outcome in outcomes.values():
        if outcome.bad_input:
            raise BadInputError(outcome.reason)
    return outcomes


def _outcomes(
    engines: Engines, process: ProcessExecutor, groups: Iterable[Group]
) -> list[CaseOutcome]:
    return [outcome for batch in process.run_groups(engines.fly_group, groups) for outcome in batch]
