"""Run a refinement: flights in, refinement.json and an improved aircraft out.

Training flights select effects, hold-out flights test them.
"""

from __future__ import annotations

import shlex
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

from sysid.effects import Effect
from sysid.foreign.regular_files import file_sha256
from sysid.logs import FROM_COMMANDS
from sysid.parallel import Processes
from uqharness import __version__, checksums
from uqharness.errors import BadInputError
from uqharness.files import inner_folder, scratch_folder
from uqharness.heartbeat import Callback, Forecast, forecast_shown, silent
from uqharness.identification import choose_servos
from uqharness.identification.linearised import (
    FlightData,
    make_flight_data,
    positions,
    stage_models,
)
from uqharness.parallel import SHORT_COMMAND_S, worker_map
from uqharness.plugin import bake_scales
from uqharness.refinement.baseline import shifted_flights
from uqharness.refinement.candidate_model import write_at_zero, write_copy
from uqharness.refinement.document import document_of, refinement_view
from uqharness.refinement.effect_search import find_effects
from uqharness.refinement.estimators import Dataset
from uqharness.refinement.hold_out import (
    HoldOutResult,
    HoldOutTest,
    Write,
    flown_as,
    point_as_written,
    without_effects,
)
from uqharness.refinement.mission import (
    INTERVALS_FOLDER,
    PBOX_FOLDER,
    FlightSet,
    IntervalJob,
    Intervals,
    fit_intervals,
    intervals_document,
    no_pbox,
    write_forms,
)
from uqharness.refinement.search_result import SearchResult, parameter_estimates, remark
from uqharness.refinement.smooth_terms import EXPLAINED, SMOOTH_FOLDER, find_smooth_term
from uqharness.refinement.stages import STAGES_FOLDER, Stages
from uqharness.refinement.unclear_effects import drop_unclear_effects
from uqharness.refinement.write_xml import EffectToWrite
from uqharness.replay import CONTROLS, numbers_of_files, read_flights, unique_names
from uqharness.requests.refinement import STAGES, RefineRequest
from uqharness.results.refinement import Baked, Gaps, Mission, SmoothTerm
from uqharness.results.refinement import Refinement as RefinementDocument
from uqharness.simulator import (
    Aircraft,
    content_hash,
    copy_folder,
    copy_shared_parts,
    engine,
    find_aircraft,
    open_aircraft,
)


@dataclass(frozen=True)
class Job:
    """A request with its aircraft, the files of its flights, and the user's effects.

    ``ideal_servos`` is None to choose by likelihood on the training flights. ``command`` is written
    beside effects; it is empty if no command repeats the refinement.
    """

    options: RefineRequest
    aircraft: Aircraft
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    extra: tuple[Effect, ...] = ()
    ideal_servos: bool | None = False
    command: tuple[str, ...] = ()

    @property
    def out(self) -> Path:
        """Folder of the results."""
        return self.options.out


@dataclass(frozen=True)
class Refinement:
    """Result of a refinement.

    Attributes
    ----------
    document : RefinementDocument
        Content of refinement.json.
    chosen : SearchResult
        The selection on the training flights.
    hold_out : HoldOutResult
        What remains after the hold-out test.
    aircraft, original : Aircraft
        Refined and original aircraft.
    earlier_damage : DamageRecord
        Files of an earlier refinement in the folder that were damaged before this one.
    """

    document: RefinementDocument
    chosen: SearchResult
    hold_out: HoldOutResult
    aircraft: Aircraft
    original: Aircraft
    earlier_damage: checksums.DamageRecord = field(default_factory=checksums.DamageRecord)

    def __repr__(self) -> str:
        """Return verdict and aircraft."""
        return f"Refinement({self.document.verdict}, {self.aircraft!r})"

    def _repr_html_(self) -> str:
        """Return a summary for notebooks."""
        return refinement_view(repr(self), self.document)


def _with_forecast(callback: Callback, forecast: Forecast) -> Callback:
    """Return the callback, extended to update the forecast of the remaining time at each stage."""

    def stage(text: str) -> object:
        """Report a stage."""
        forecast.begin(next((name for name in STAGES if text.startswith(name)), ""))
        return callback(text)

    return stage


def refine(job: Job, callback: Callback = silent) -> Refinement:
    """Find missing effects, write them into the aircraft and test them.

    Raises BadInputError.
    """
    forecast = Forecast(job.options.expected_s())
    with forecast_shown(forecast):
        return _refine(job, _with_forecast(callback, forecast), forecast)


def _refine(job: Job, callback: Callback, forecast: Forecast) -> Refinement:
    """Run the steps of `refine`."""
    start_s = time.perf_counter()
    # 1. Check and read the flights.
    refuse_shared_flights(job.train, job.test)
    if job.options.campaign is not None:
        from uqharness.refinement.mission import campaign_for

        campaign_for(job.aircraft, job.options.campaign)
    callback("reading the flights")
    job, train_read, test_read = _read_both(job, callback)
    times = [f.record["time_s"] for f in (*train_read.flights, *test_read.flights)]
    forecast.expect(job.options.expected_s(float(sum(t[-1] - t[0] for t in times))))
    identity = _identity(job)
    stages = Stages(job.out / STAGES_FOLDER, identity)
    # The stages of the test are kept if a mission follows, which takes minutes.
    hold_out_stages = Stages(
        job.out / STAGES_FOLDER if job.options.pbox else None, [*identity, *test_read.hashes]
    )
    with worker_map(job.options.workers, SHORT_COMMAND_S) as pool, scratch_folder() as scratch:
        write = _writer(job, scratch.path / "models")
        # 2. Search for effects on the training flights, and correct the controls' time in all.
        data = _flight_data(job.aircraft, train_read)
        selected = stages(
            "effects",
            SearchResult,
            lambda: find_effects(
                job.aircraft,
                data,
                job.extra,
                scratch.path / "effects",
                pool=pool,
                callback=callback,
                stages=stages,
            ),
        )
        train, test = (
            replace(s, flights=tuple(shifted_flights(s.flights, selected.late_s)))
            for s in (train_read, test_read)
        )
        # 3. Name those that are clear beside what stays unexplained.
        train_dataset = _dataset(job, selected, train)
        with_all = _with_all_effects(job, selected, scratch.path / "chosen")
        chosen = drop_unclear_effects(selected, train_dataset, with_all, pool)
        complete = (
            with_all
            if chosen.selection.chosen == selected.selection.chosen
            else _with_all_effects(job, chosen, scratch.path / "named")
        )
        # 4. Test them on the hold-out flights.
        callback("simulating the hold-out flights with both models")
        hold_out = hold_out_stages(
            "judged",
            HoldOutResult,
            lambda: _hold_out_test(
                job, chosen, complete, write, train_dataset=train_dataset, test=test, pool=pool
            ),
        )
        # 5. Write the aircraft, and the one without effects beside it.
        callback("writing the aircraft")
        earlier_damage = checksums.remove_sums(job.out)
        target = _place(write(hold_out.result), job.aircraft, job.out)
        baked = bake_scales(target.folder) if job.options.bake else None
        target = target if baked is None else find_aircraft(target.folder)
        models, results = {"before": target}, {"before": hold_out.result}
        if hold_out.result.selection.chosen:
            plain = without_effects(chosen)
            before = _place(write(plain), job.aircraft, job.out / "before")
            models = {"before": before, "after": target}
            results = {"before": plain, "after": hold_out.result}
        else:
            # One model is both.
            _remove_stale(job.out, job.aircraft)
        # 6. Intervals of the coefficients' errors, of both models.
        callback("intervals of both models")
        jobs = [
            _interval_job(job, results[name], models[name], chosen, complete, (train, test))
            for name in models
        ]
        intervals = hold_out_stages(
            "intervals", list[Intervals], lambda: list(pool(fit_intervals, jobs))
        )
        # 7. What remains.
        with stage_models(job.aircraft, train_dataset.data) as staged:
            controls = positions(staged.model, train_dataset.data)
        document = document_of(chosen, hold_out, job.aircraft, controls)
        smooth, reason = _smooth_term(job, document, hold_out, write, pool, callback)
        remaining = document.remaining.model_copy(
            update={"smooth": smooth, "smooth_reason": reason}
        )
        parts: dict[str, Any] = {"remaining": remaining}
    # 8. Fly the mission with both models.
    forms = write_forms(dict(zip(models, intervals, strict=True)), job.out)
    mission = _mission(job, models, forms, callback)
    stages.remove()
    parts["seconds"] = round(time.perf_counter() - start_s, 1)
    if baked is not None:
        changed: dict[str, list[float | None]] = {n: [*v] for n, v in baked.changed.items()}
        parts["baked"] = Baked(changed=changed, kept=list(baked.remaining))
    final = _complete(job, document, intervals, mission, parts)
    return Refinement(final, chosen, hold_out, target, job.aircraft, earlier_damage)


def _hold_out_test(
    job: Job,
    chosen: SearchResult,
    complete: Aircraft,
    write: Write,
    *,
    train_dataset: Dataset,
    test: FlightSet,
    pool: Processes,
) -> HoldOutResult:
    """Test the selected effects on the hold-out flights, whose air is their own."""
    test_dataset = _dataset(job, chosen, test)
    if not chosen.estimator.uses_replays:
        point = point_as_written(chosen)
        air = chosen.estimator.turbulence_of(write(chosen), test_dataset.data, point, pool)
        test_dataset = replace(test_dataset, turbulence=air)
    return HoldOutTest(chosen, complete, write, train_dataset, test_dataset, pool).run()


def _interval_job(
    job: Job,
    model: SearchResult,
    target: Aircraft,
    chosen: SearchResult,
    complete: Aircraft,
    flights: tuple[FlightSet, FlightSet],
) -> IntervalJob:
    """Return the job that makes the intervals of a model, written as the aircraft ``target``, on
    training and hold-out ``flights``.
    """
    aircraft_and_values = flown_as(model, chosen, complete, lambda _: target)
    return IntervalJob(target, *aircraft_and_values, *flights, bool(job.ideal_servos))


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's content; raises BadInputError."""
    try:
        return file_sha256(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None


def refuse_shared_flights(train: Sequence[Path], test: Sequence[Path]) -> None:
    """Raise BadInputError if a hold-out file has the content of a training file."""
    hashes = {file_hash(path): path for path in train}
    for path in test:
        other = hashes.get(file_hash(path))
        if other is not None:
            raise BadInputError(
                f"--test {path}: the same flight as --train {other}; hold-out flights must not be"
                " training flights: give another one"
            )


def _read_both(job: Job, callback: Callback) -> tuple[Job, FlightSet, FlightSet]:
    """Read training and hold-out flights; return them with the request and its servos.

    The servos are chosen on the training flights.
    """
    train = _read(job, job.train)
    if job.ideal_servos is None:
        callback("servos: the card's or ideal ones")
        servos = choose_servos(
            job.aircraft, train.flights, train.measured, "auto", job.options.workers
        )
        job = replace(job, ideal_servos=servos.ideal)
        train = replace(
            train,
            flights=tuple(servos.with_note(train.flights)),
            ideal=_ideal_controls(job, train.measured),
        )
    test = _read(job, job.test)
    names = unique_names([f.name for f in test.flights])
    flights = tuple(replace(f, name=n) for f, n in zip(test.flights, names, strict=True))
    return job, train, replace(test, flights=flights)


def _read(job: Job, paths: Sequence[Path]) -> FlightSet:
    """Read the flights of some files."""
    files = (*job.train, *job.test)
    numbers = numbers_of_files(job.options.flight_number, len(files))
    first = files.index(paths[0])
    flights, measured = read_flights(
        paths,
        job.aircraft,
        job.options.manoeuvres,
        job.options.signal_map,
        align=False,
        flight_numbers=[n for n in numbers[first : first + len(paths)] if n is not None],
    )
    ideal = _ideal_controls(job, measured)
    return FlightSet(tuple(flights), tuple(measured), tuple(file_hash(p) for p in paths), ideal)


def _ideal_controls(job: Job, measured: Sequence[str]) -> tuple[str, ...]:
    """Return the controls without an actuator."""
    return tuple(c for c in CONTROLS if c not in measured) if job.ideal_servos else ()


def _flight_data(aircraft: Aircraft, flights: FlightSet) -> FlightData:
    """Return the data of flights."""
    return make_flight_data(aircraft, flights.flights, flights.measured, flights.ideal)


def _identity(job: Job) -> list[str]:
    """Return everything that the selection depends on.

    That is aircraft, training flights, the user's effects, options and version, not the hold-out
    flights.
    """
    tables = [
        p
        for p in (job.options.manoeuvres, job.options.signal_map)
        if p is not None and str(p) != FROM_COMMANDS
    ]
    return [
        __version__,
        content_hash(job.aircraft),
        *(file_hash(p) for p in (*job.train, *tables)),
        *(p.name for p in job.train),
        repr(job.extra),
        str(job.ideal_servos),
        str(job.options.manoeuvres),
        str(job.options.flight_number),
    ]


def _dataset(job: Job, chosen: SearchResult, flights: FlightSet) -> Dataset:
    """Return flights in the form in which the selected effects were judged, with the training
    flights' air.
    """
    data = _flight_data(job.aircraft, flights)
    data = chosen.estimator.prepare(job.aircraft, data)
    if data.outputs == chosen.data.outputs:
        data = replace(data, noise=chosen.data.noise)
    return Dataset(data, chosen.turbulence)


def _with_all_effects(job: Job, chosen: SearchResult, folder: Path) -> Aircraft:
    """Return the aircraft with every selected effect, as the last model had it."""
    effects = [
        EffectToWrite(chosen.effects[c.key], c.value, "", chosen.slopes)
        for c in chosen.selection.chosen
    ]
    return write_at_zero(job.aircraft, effects, folder)


def _smooth_term(
    job: Job,
    document: RefinementDocument,
    hold_out: HoldOutResult,
    write: Write,
    pool: Processes,
    callback: Callback,
) -> tuple[SmoothTerm | None, str | None]:
    """Return a smooth term if no effect of the catalogue explains the residuals.

    Its aircraft is written beside the refined one. Otherwise the reason is returned.
    """
    stale = job.out / SMOOTH_FOLDER / "aircraft" / job.aircraft.folder.name
    if (stale / job.aircraft.card.aircraft.xml).is_file():
        shutil.rmtree(stale)
    if document.verdict != "unexplained":
        return None, EXPLAINED
    callback("searching the residuals for a smooth term")
    result = find_smooth_term(hold_out, write, pool)
    if isinstance(result, str):
        return None, result
    aircraft, smooth = result
    placed = _place(aircraft, job.aircraft, job.out / SMOOTH_FOLDER)
    model = f"{SMOOTH_FOLDER}/aircraft/{placed.folder.name}/{placed.card.aircraft.xml}"
    return smooth.model_copy(update={"model": model}), None


def _writer(job: Job, folder: Path) -> Write:
    """Return a function that writes the original aircraft with the effects and parameters of a
    model.

    It uses a new numbered folder of ``folder`` each time.
    """
    aircraft, names, number = job.aircraft, [p.name for p in job.train], count()

    def write(result: SearchResult) -> Aircraft:
        """Write the aircraft of a model."""
        fdm = open_aircraft(aircraft)
        initial = {n: float(fdm[n]) for n in result.names}
        estimates = parameter_estimates(result, names, initial)
        command = shlex.join(job.command)
        effects = [
            EffectToWrite(
                result.effects[c.key],
                c.value,
                remark(c, result.effects[c.key], names, command, result.critical_t),
                result.slopes,
            )
            for c in result.selection.chosen
        ]
        return write_copy(aircraft, effects, estimates, folder / str(next(number)))

    return write


def _place(copy: Aircraft, original: Aircraft, root: Path) -> Aircraft:
    """Move an aircraft to its place under ``root``, beside the engines and systems of the
    original.
    """
    target = inner_folder(root, "aircraft") / copy.folder.name
    # Copied beside its place and put there at once; an earlier one is replaced.
    temporary = target.with_name(f".{target.name}.part")
    shutil.rmtree(temporary, ignore_errors=True)
    copy_folder(copy.folder, temporary)
    if target.exists():
        shutil.rmtree(target)
    temporary.rename(target)
    copy_shared_parts(original, root, engine.default_root())
    return find_aircraft(target)


def _remove_stale(out: Path, aircraft: Aircraft) -> None:
    """Remove files of an earlier refinement that this one does not overwrite."""
    before = out / "before" / "aircraft" / aircraft.folder.name
    if (before / aircraft.card.aircraft.xml).is_file():
        shutil.rmtree(before)
    if (mission := out / PBOX_FOLDER / "after").is_dir():
        from uqharness.campaign import MANIFEST

        if (mission / MANIFEST).is_file():
            shutil.rmtree(mission)
    (out / INTERVALS_FOLDER / "after.json").unlink(missing_ok=True)


def _mission(
    job: Job, models: Mapping[str, Aircraft], forms: Mapping[str, Path], callback: Callback
) -> Mission:
    """Return the mission's p-boxes, or the reason why there are none."""
    if not job.options.pbox:
        return no_pbox("omitted (--no-pbox)")
    lacking = [name for name in models if name not in forms]
    if lacking:
        return no_pbox(f"no intervals {' and '.join(lacking)}: see gap.test.intervals")
    # Campaigns are much to load, and not every refinement flies one.
    from uqharness.refinement.mission import fly_missions

    callback("simulating the mission with both models")
    return fly_missions(models, forms, job.options.campaign, job.out, job.options.workers, callback)


def _complete(
    job: Job,
    document: RefinementDocument,
    intervals: Sequence[Intervals],
    mission: Mission,
    parts: Mapping[str, Any],
) -> RefinementDocument:
    """Return the document with intervals, mission and provenance."""
    assert document.gap.train is not None
    test_parts = {"intervals": intervals_document(intervals[0], intervals[-1]), "pbox": mission}
    chosen_on = {"pbox": no_pbox("a mission belongs to no flight: see gap.test")}
    gap = Gaps(
        train=document.gap.train.model_copy(update=chosen_on),
        test=document.gap.test.model_copy(update=test_parts),
    )
    return document.model_copy(
        update={
            "gap": gap,
            "model": "/".join(
                ("aircraft", job.aircraft.folder.name, job.aircraft.card.aircraft.xml)
            ),
            "train": [p.name for p in job.train],
            "test": [p.name for p in job.test],
            "command": shlex.join(job.command),
            **parts,
        }
    )
