"""A whole refinement: flights in, refinement.json and a better aircraft out.

Train flights choose, test flights show.
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
from sysid.logs import FROM_COMMANDS
from sysid.parallel import Processes
from uqharness import __version__, checksums
from uqharness.files import inner_folder, scratch_folder
from uqharness.identification import choose_servos
from uqharness.identification.linearised import (
    FlightData,
    StagedModels,
    make_setup,
    positions,
    setup_in_gusts,
)
from uqharness.parallel import worker_map
from uqharness.plugin import bake_scales
from uqharness.refinement.document import document_of, refinement_view
from uqharness.refinement.evaluation import air_of
from uqharness.refinement.judge import Judged, Write, bare, flown_as, judge, written_at
from uqharness.refinement.mission import FOLDER as PBOX
from uqharness.refinement.mission import INTERVALS_FOLDER as INTERVALS
from uqharness.refinement.mission import (
    FlightSet,
    IntervalJob,
    Intervals,
    fit_intervals,
    intervals_document,
    no_pbox,
    write_forms,
)
from uqharness.refinement.round import FOLDER, Side, Stages, file_hash, refuse_shared
from uqharness.refinement.rounds import later, write_copy, write_staged
from uqharness.refinement.search import Found, Say, estimates_of, find_effects, remark
from uqharness.refinement.unnamed import EXPLAINED, UNNAMED, named_beside, offered
from uqharness.refinement.write_xml import Written
from uqharness.replay import CONTROLS, numbers_of_files, read_flights, unique_names
from uqharness.requests.refinement import RefineRequest
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

    ideal_servos: None for the likelier on the train flights; command: what is written beside
    effects, empty where no command repeats the refinement."""

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
    """The document, what the train flights say and the test flights, the aircraft refined and as
    given.

    ``earlier``: files of an earlier refinement in the folder that were damaged when this one began.
    """

    document: RefinementDocument
    chosen: Found
    judged: Judged
    aircraft: Aircraft
    given: Aircraft
    earlier: checksums.DamageRecord = field(default_factory=checksums.DamageRecord)

    def __repr__(self) -> str:
        return f"Refinement({self.document.verdict}, {self.aircraft!r})"

    def _repr_html_(self) -> str:
        return refinement_view(repr(self), self.document)


def refine(request: Job, say: Say = lambda _: None) -> Refinement:
    """Find, name, add and show. Raises BadInputError."""
    begun = time.perf_counter()
    aircraft = request.aircraft
    refuse_shared(request.train, request.test)
    if request.options.campaign is not None:
        from uqharness.refinement.mission import campaign_for

        campaign_for(aircraft, request.options.campaign)
    say("reading the flights")
    train = _read(request, request.train)
    if request.ideal_servos is None:
        say("servos: the card's or ideal ones")
        servos = choose_servos(
            aircraft, train.flights, train.measured, "auto", request.options.workers
        )
        request = replace(request, ideal_servos=servos.ideal)
        train = replace(
            train,
            flights=tuple(servos.with_note(train.flights)),
            ideal=_ideal_controls(request, train.measured),
        )
    test = _read(request, request.test)
    names = unique_names([f.name for f in test.flights])
    test = replace(
        test, flights=tuple(replace(f, name=n) for f, n in zip(test.flights, names, strict=True))
    )
    with worker_map(request.options.workers) as map_, scratch_folder() as scratch:
        work, write = scratch.path, _writer(request, scratch.path / "models")
        identity = _identity(request)
        stages = Stages(request.out / FOLDER, identity)
        setup = _setup(aircraft, train)
        chosen = stages(
            "effects",
            Found,
            lambda: find_effects(
                aircraft, setup, request.extra, work / "effects", map_, say, stages
            ),
        )
        train, test = (
            replace(side, flights=tuple(later(side.flights, chosen.late_s)))
            for side in (train, test)
        )
        whole = _whole(request, chosen, work / "chosen")
        side = _side(request, chosen, train)
        named = named_beside(chosen, side, whole, map_)
        if named.selection.chosen != chosen.selection.chosen:
            whole = _whole(request, named, work / "named")
        chosen = named
        say("flying the test flights with both models")
        # Kept where a mission follows, which takes minutes.
        shown = Stages(
            request.out / FOLDER if request.options.pbox else None, [*identity, *test.hashes]
        )

        def flown_both_ways() -> Judged:
            other = _side(request, chosen, test)
            if chosen.gusts is not None:
                other = replace(
                    other,
                    air=air_of(write(chosen), other.setup, map_, written_at(chosen), chosen.gusts),
                )
            return judge(chosen, whole, write, side, other, map_)

        judged = shown("judged", Judged, flown_both_ways)
        say("writing the aircraft")
        earlier = checksums.remove_sums(request.out)
        target = _put(write(judged.found), aircraft, request.out)
        baked = bake_scales(target.folder) if request.options.bake else None
        if baked is not None:
            target = find_aircraft(target.folder)

        def job(model: Found, made: Aircraft) -> IntervalJob:
            flown = flown_as(model, chosen, whole, lambda _: made)
            return IntervalJob(made, *flown, train, test, bool(request.ideal_servos))

        if judged.found.selection.chosen:
            plain = _put(write(bare(chosen)), aircraft, request.out / "before")
            models = {"before": plain, "after": target}
            jobs = [job(bare(chosen), plain), job(judged.found, target)]
        else:
            # One model is both.
            models, jobs = {"before": target}, [job(judged.found, target)]
            _remove_stale(request.out, aircraft)
        say("intervals of both models")
        intervals = shown("intervals", list[Intervals], lambda: list(map_(fit_intervals, jobs)))
        with StagedModels(aircraft, side.setup) as bench:
            controls = positions(bench.model, side.setup)
        document = document_of(chosen, judged, aircraft, controls)
        document = _with_smooth(document, *_unnamed(request, document, judged, write, map_, say))
    forms = write_forms(dict(zip(models, intervals, strict=True)), request.out)
    mission = _mission(request, models, forms, say)
    stages.forget()
    last: dict[str, Any] = {"seconds": round(time.perf_counter() - begun, 1)}
    if baked is not None:
        changed: dict[str, list[float | None]] = {n: [*v] for n, v in baked.changed.items()}
        last["baked"] = Baked(changed=changed, kept=list(baked.remaining))
    document = _complete(request, document, intervals, mission, last)
    return Refinement(document, chosen, judged, target, aircraft, earlier)


def _read(request: Job, paths: Sequence[Path]) -> FlightSet:
    files = (*request.train, *request.test)
    numbers = numbers_of_files(request.options.flight_number, len(files))
    first = files.index(paths[0])
    flights, measured = read_flights(
        paths,
        request.aircraft,
        request.options.manoeuvres,
        request.options.signal_map,
        align=False,
        flight_numbers=[n for n in numbers[first : first + len(paths)] if n is not None],
    )
    ideal = _ideal_controls(request, measured)
    return FlightSet(tuple(flights), tuple(measured), tuple(file_hash(p) for p in paths), ideal)


def _ideal_controls(request: Job, measured: Sequence[str]) -> tuple[str, ...]:
    """Controls whose commands are passed straight through."""
    return tuple(c for c in CONTROLS if c not in measured) if request.ideal_servos else ()


def _setup(aircraft: Aircraft, given: FlightSet) -> FlightData:
    return make_setup(aircraft, given.flights, given.measured, given.ideal)


def _identity(request: Job) -> list[str]:
    """Everything that the choice depends on, the test flights not: aircraft, train flights, own
    effects, options, version.
    """
    tables = [
        p
        for p in (request.options.manoeuvres, request.options.signal_map)
        if p is not None and str(p) != FROM_COMMANDS
    ]
    return [
        __version__,
        content_hash(request.aircraft),
        *(file_hash(p) for p in (*request.train, *tables)),
        *(p.name for p in request.train),
        repr(request.extra),
        str(request.ideal_servos),
        str(request.options.manoeuvres),
        str(request.options.flight_number),
    ]


def _side(request: Job, chosen: Found, given: FlightSet) -> Side:
    """Flights as the chosen effects were judged on; the air is that of the train flights."""
    setup = _setup(request.aircraft, given)
    if chosen.gusts is not None:
        setup = setup_in_gusts(request.aircraft, setup)
    if setup.outputs == chosen.setup.outputs:
        setup = replace(setup, noise=chosen.setup.noise)
    return Side(setup, chosen.gusts)


def _whole(request: Job, chosen: Found, folder: Path) -> Aircraft:
    """The aircraft with every chosen effect, as the last round flew it."""
    effects = [
        Written(chosen.effects[c.key], c.value, "", chosen.slopes) for c in chosen.selection.chosen
    ]
    return write_staged(request.aircraft, effects, folder)


def _unnamed(
    request: Job,
    document: RefinementDocument,
    judged: Judged,
    write: Write,
    map_: Processes,
    say: Say,
) -> tuple[SmoothTerm | None, str | None]:
    """A smooth term where nothing of the catalogue explains what is left, and its aircraft beside
    the refined one.
    """
    stale = request.out / UNNAMED / "aircraft" / request.aircraft.folder.name
    if (stale / request.aircraft.xml.name).is_file():
        shutil.rmtree(stale)
    if document.verdict != "unexplained":
        return None, EXPLAINED
    say("looking for a smooth term in what is left")
    found = offered(judged, write, map_)
    if isinstance(found, str):
        return None, found
    aircraft, smooth = found
    made = _put(aircraft, request.aircraft, request.out / UNNAMED)
    model = f"{UNNAMED}/aircraft/{made.folder.name}/{made.xml.name}"
    return smooth.model_copy(update={"model": model}), None


def _with_smooth(
    document: RefinementDocument, smooth: SmoothTerm | None, reason: str | None
) -> RefinementDocument:
    """The document with a smooth term, or the reason why there is none."""
    parts = {"smooth": smooth, "smooth_reason": reason}
    return document.model_copy(update={"remaining": document.remaining.model_copy(update=parts)})


def _writer(request: Job, folder: Path) -> Write:
    """Writes the aircraft as given with the effects and parameters of a model, each time in a
    numbered folder of ``folder``.
    """
    aircraft, names, number = request.aircraft, [p.name for p in request.train], count()

    def write(found: Found) -> Aircraft:
        fdm = open_aircraft(aircraft)
        estimates = estimates_of(found, names, {n: float(fdm[n]) for n in found.names})
        command = shlex.join(request.command)
        effects = [
            Written(
                found.effects[c.key],
                c.value,
                remark(c, found.effects[c.key], names, command, found.limit),
                found.slopes,
            )
            for c in found.selection.chosen
        ]
        return write_copy(aircraft, effects, estimates, folder / str(next(number)))

    return write


def _put(made: Aircraft, given: Aircraft, root: Path) -> Aircraft:
    """The aircraft in its place under ``root``, with the engines and systems that lie beside the
    one given.
    """
    target = inner_folder(root, "aircraft") / made.folder.name
    # Copied beside its place and put there at once; an earlier one is replaced.
    beside = target.with_name(f".{target.name}.part")
    shutil.rmtree(beside, ignore_errors=True)
    copy_folder(made.folder, beside)
    if target.exists():
        shutil.rmtree(target)
    beside.rename(target)
    copy_shared_parts(given, root, engine.default_root())
    return find_aircraft(target)


def _remove_stale(out: Path, aircraft: Aircraft) -> None:
    """What an earlier refinement with an effect left in the folder, and one without does not write
    over.
    """
    before = out / "before" / "aircraft" / aircraft.folder.name
    if (before / aircraft.xml.name).is_file():
        shutil.rmtree(before)
    if (mission := out / PBOX / "after").is_dir():
        from uqharness.campaign import MANIFEST

        if (mission / MANIFEST).is_file():
            shutil.rmtree(mission)
    (out / INTERVALS / "after.json").unlink(missing_ok=True)


def _mission(
    request: Job, models: Mapping[str, Aircraft], forms: Mapping[str, Path], say: Say
) -> Mission:
    if not request.options.pbox:
        return no_pbox("left out (--no-pbox)")
    lacking = [name for name in models if name not in forms]
    if lacking:
        return no_pbox(
            f"no intervals {' and '.join(lacking)} to fly within: see gap.test.intervals"
        )
    # Campaigns are much to load, and not every refinement flies one.
    from uqharness.refinement.mission import fly_missions

    say("flying the mission with both models")
    return fly_missions(
        models, forms, request.options.campaign, request.out, request.options.workers, say
    )


def _complete(
    request: Job,
    document: RefinementDocument,
    intervals: Sequence[Intervals],
    mission: Mission,
    last: Mapping[str, Any],
) -> RefinementDocument:
    """The document with intervals, mission and provenance."""
    assert document.gap.train is not None
    shown = {"intervals": intervals_document(intervals[0], intervals[-1]), "pbox": mission}
    chosen_on = {"pbox": no_pbox("a mission belongs to no flight: see gap.test")}
    gap = Gaps(
        train=document.gap.train.model_copy(update=chosen_on),
        test=document.gap.test.model_copy(update=shown),
    )
    return document.model_copy(
        update={
            "gap": gap,
            "model": f"aircraft/{request.aircraft.folder.name}/{request.aircraft.xml.name}",
            "train": [p.name for p in request.train],
            "test": [p.name for p in request.test],
            "command": shlex.join(request.command),
            **last,
        }
    )
