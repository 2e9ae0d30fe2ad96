"""A whole refinement: flights in, refinement.json and a better aircraft out. Train flights choose, test flights show."""

from __future__ import annotations

import shlex
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from sysid.effects import Effect
from sysid.logs import FOUND
from sysid.parallel import Processes
from uqharness import __version__
from uqharness.files import inner_folder
from uqharness.parallel import worker_map
from uqharness.refinement.beside import named_beside
from uqharness.refinement.find import Found, estimates_of, find_effects, remark
from uqharness.refinement.fit import positions
from uqharness.refinement.judge import Judged, Write, bare, flown_as, judge, sensed_by
from uqharness.refinement.rounds import write_copy, write_staged
from uqharness.refinement.setup import Bench, file_hash, make_setup, refuse_shared, setup_in_gusts
from uqharness.refinement.showing.document import document_of
from uqharness.refinement.showing.intervals import FOLDER as INTERVALS
from uqharness.refinement.showing.intervals import (
    FlightSet,
    IntervalJob,
    Intervals,
    before_and_after,
    intervals_document,
    write_forms,
)
from uqharness.refinement.showing.notebook import refinement_view
from uqharness.refinement.showing.pboxes import FOLDER as PBOX
from uqharness.refinement.showing.pboxes import no_pbox
from uqharness.refinement.showing.show import air_of, write_bytes_tree
from uqharness.refinement.stages import FOLDER, Stages
from uqharness.refinement.timing import later
from uqharness.refinement.types import Setup, Side
from uqharness.refinement.unnamed import EXPLAINED, UNNAMED, offered
from uqharness.refinement.writing.effects import Written
from uqharness.refinement.writing.slopes import control_slopes
from uqharness.replay import CONTROLS, Flight, read_flights, renamed
from uqharness.scratch import scratch_folder
from uqharness.simulator import Aircraft, content_hash, copy_beside, engine, find_aircraft, open_aircraft

Say = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What the command was asked. pbox: whether a mission is flown before and after; campaign: which one."""

    aircraft: Aircraft
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    out: Path
    extra: tuple[Effect, ...] = ()
    manoeuvres: Path | None = None
    map_path: Path | None = None
    ideal_servos: bool = False
    workers: int | None = None
    command: tuple[str, ...] = ()
    pbox: bool = True
    campaign: Path | None = None


@dataclass(frozen=True)
class Refinement:
    """The document, and what figures are drawn from. train, test: setup and model before and after."""

    document: dict[str, Any]
    chosen: Found
    judged: Judged
    intervals: tuple[Intervals, Intervals]
    aircraft: Aircraft
    given: Aircraft

    def __repr__(self) -> str:
        return f"Refinement({self.document['verdict']}, {self.aircraft!r})"

    def _repr_html_(self) -> str:
        return refinement_view(repr(self), self.document)


@dataclass(frozen=True)
class _Flights:
    """One side's flights as read, and what is known of their controls."""

    flights: list[Flight]
    measured: tuple[str, ...]
    ideal: tuple[str, ...]
    hashes: tuple[str, ...]

    def setup(self, aircraft: Aircraft) -> Setup:
        return make_setup(aircraft, self.flights, self.measured, self.ideal)

    def later(self, seconds: float) -> _Flights:
        """Controls moved later than recorded."""
        return replace(self, flights=later(self.flights, seconds))

    def set(self) -> FlightSet:
        return FlightSet(tuple(self.flights), self.measured, self.hashes)


def refine(request: Request, say: Say = lambda _: None) -> Refinement:
    """Find, name, add and show. Raises BadInputError."""
    begun = time.perf_counter()
    aircraft = request.aircraft
    refuse_shared(request.train, request.test)
    if request.campaign is not None:
        from uqharness.refinement.showing.mission import campaign_for

        campaign_for(aircraft, request.campaign)
    say("reading the flights")
    train, test = _read(request, request.train), _read(request, request.test)
    names = renamed([f.name for f in test.flights])
    test = replace(test, flights=[replace(f, name=n) for f, n in zip(test.flights, names, strict=True)])
    with worker_map(request.workers) as map_, scratch_folder() as scratch:
        work = scratch.path
        identity = _identity(request)
        stages = Stages(request.out / FOLDER, identity)
        setup = train.setup(aircraft)
        chosen = stages(
            "effects",
            Found,
            lambda: find_effects(aircraft, setup, request.extra, work / "effects", map_, say, stages),
        )
        train, test = train.later(chosen.late_s), test.later(chosen.late_s)
        whole = _whole(request, chosen, work / "chosen")
        named = named_beside(chosen, _side(request, chosen, train), whole, map_)
        if named.selection.chosen != chosen.selection.chosen:
            whole = _whole(request, named, work / "named")
        chosen = named
        say("flying the test flights with both models")
        # Kept where a mission follows, which takes minutes.
        shown = Stages(request.out / FOLDER if request.pbox else None, [*identity, *test.hashes])
        judged = shown("judged", Judged, lambda: _judged(request, chosen, whole, train, test, work, map_))
        say("writing the aircraft")
        target = _put(_write(request, judged.found, work / "refined"), aircraft, request.out)

        def job(model: Found, made: Aircraft) -> IntervalJob:
            flown = flown_as(model, chosen, whole, lambda _: made)
            return IntervalJob(made, *flown, train.set(), test.set(), request.ideal_servos)

        jobs = [job(judged.found, target)]
        if judged.found.selection.chosen:
            plain = _put(_write(request, bare(chosen), work / "plain"), aircraft, request.out / "before")
            models = {"before": plain, "after": target}
            jobs = [job(bare(chosen), plain), *jobs]
        else:
            models = {"before": target}
            _remove_stale(request.out, aircraft)
        say("intervals of both models")
        intervals = shown("intervals", tuple[Intervals, Intervals], lambda: before_and_after(jobs, map_))
        document = document_of(chosen, judged, aircraft, _controls(aircraft, train))
        document["remaining"] |= _unnamed(request, document, judged, work, map_, say)
    forms = write_forms(dict(zip(models, intervals, strict=False)), request.out)
    mission = _mission(request, models, forms, say)
    document = _document(request, document, intervals, mission)
    stages.forget()
    document["seconds"] = round(time.perf_counter() - begun, 1)
    return Refinement(document, chosen, judged, intervals, target, aircraft)


def _read(request: Request, paths: Sequence[Path]) -> _Flights:
    flights, measured = read_flights(paths, request.aircraft, request.manoeuvres, request.map_path, align=False)
    ideal = tuple(c for c in CONTROLS if c not in measured) if request.ideal_servos else ()
    return _Flights(list(flights), tuple(measured), ideal, tuple(file_hash(p) for p in paths))


def _identity(request: Request) -> list[str]:
    """Everything that the choice depends on: aircraft, train flights, own effects, options, version. The test flights are
    not in it."""
    tables = [p for p in (request.manoeuvres, request.map_path) if p is not None and str(p) != FOUND]
    return [
        __version__, content_hash(request.aircraft), *(file_hash(p) for p in (*request.train, *tables)),
        *(p.name for p in request.train), repr(request.extra), str(request.ideal_servos), str(request.manoeuvres),
    ]  # fmt: skip


def _side(request: Request, chosen: Found, flights: _Flights) -> Side:
    """Flights as the chosen effects were judged on; the air is that of the train flights."""
    setup = flights.setup(request.aircraft)
    if chosen.gusts is not None:
        setup = setup_in_gusts(request.aircraft, setup)
    if setup.outputs == chosen.setup.outputs:
        setup = replace(setup, noise=chosen.setup.noise)
    return Side(setup, chosen.gusts)


def _whole(request: Request, chosen: Found, folder: Path) -> Aircraft:
    """The aircraft with every chosen effect, as the last round flew it."""
    slopes = chosen.slopes or control_slopes(chosen.before)
    effects = [Written(chosen.effects[c.key], c.value, "", slopes) for c in chosen.selection.chosen]
    return write_staged(request.aircraft, effects, folder)


def _judged(
    request: Request, chosen: Found, whole: Aircraft, train: _Flights, test: _Flights, work: Path, map_: Processes
) -> Judged:  # fmt: skip
    other = _side(request, chosen, test)
    if chosen.gusts is not None:
        model = _write(request, chosen, work / "air")
        air = air_of(model, other.setup, map_, sensed_by(chosen), chosen.gusts)
        other = replace(other, air=air)
    return judge(chosen, whole, _writer(request, work / "model"), _side(request, chosen, train), other, map_)


def _unnamed(
    request: Request, document: Mapping[str, Any], judged: Judged, work: Path, map_: Processes, say: Say
) -> dict[str, Any]:  # fmt: skip
    """A smooth term where nothing of the catalogue explains what is left, and its aircraft beside the refined one."""
    stale = request.out / UNNAMED / "aircraft" / request.aircraft.folder.name
    if (stale / request.aircraft.xml.name).is_file():
        shutil.rmtree(stale)
    if document["verdict"] != "unexplained":
        return {"smooth": None, "smooth_reason": EXPLAINED}
    say("looking for a smooth term in what is left")
    found = offered(judged, _writer(request, work / "unnamed"), map_)
    if isinstance(found, str):
        return {"smooth": None, "smooth_reason": found}
    made = _put(found.aircraft, request.aircraft, request.out / UNNAMED)
    model = f"{UNNAMED}/aircraft/{made.folder.name}/{made.xml.name}"
    return {"smooth": {**found.document, "model": model}, "smooth_reason": None}


def _writer(request: Request, folder: Path) -> Write:
    """Writes each model as an aircraft in a folder of its own: the name of ``folder``, and a number."""
    number = count()
    return lambda found: _write(request, found, folder.with_name(f"{folder.name}{next(number)}"))


def _write(request: Request, found: Found, folder: Path) -> Aircraft:
    """The aircraft as given with the effects and parameters of ``found``, in ``folder``."""
    aircraft, names = request.aircraft, [p.name for p in request.train]
    fdm = open_aircraft(aircraft)
    estimates = estimates_of(found, names, {n: float(fdm[n]) for n in found.names})
    slopes, command = found.slopes or control_slopes(found.before), shlex.join(request.command)
    effects = [
        Written(found.effects[c.key], c.value, remark(c, found.effects[c.key], names, command, found.limit), slopes)
        for c in found.selection.chosen
    ]
    return write_copy(aircraft, effects, estimates, folder)


def _put(made: Aircraft, given: Aircraft, root: Path) -> Aircraft:
    """The aircraft in its place under ``root``, with the engines and systems that lie beside the one given."""
    target = inner_folder(root, "aircraft") / made.folder.name
    write_bytes_tree(made.folder, target)
    copy_beside(given, root, engine.default_root())
    return find_aircraft(target)


def _remove_stale(out: Path, aircraft: Aircraft) -> None:
    """What an earlier refinement with an effect left in the folder, and one without does not write over."""
    before = out / "before" / "aircraft" / aircraft.folder.name
    if (before / aircraft.xml.name).is_file():
        shutil.rmtree(before)
    if (mission := out / PBOX / "after").is_dir():
        from uqharness.campaign.folder import MANIFEST

        if (mission / MANIFEST).is_file():
            shutil.rmtree(mission)
    (out / INTERVALS / "after.json").unlink(missing_ok=True)


def _controls(aircraft: Aircraft, train: _Flights) -> list[Any]:
    setup = train.setup(aircraft)
    with Bench(aircraft, setup) as bench:
        return positions(bench.model, setup)


def _mission(
    request: Request, models: Mapping[str, Aircraft], forms: Mapping[str, Path], say: Say
) -> dict[str, Any]:  # fmt: skip
    if not request.pbox:
        return no_pbox("left out (--no-pbox)")
    lacking = [name for name in models if name not in forms]
    if lacking:
        return no_pbox(f"no intervals {' and '.join(lacking)} to fly within: see gap.test.intervals")
    # Campaigns are much to load, and not every refinement flies one.
    from uqharness.refinement.showing.mission import Model, fly_missions

    say("flying the mission with both models")
    both = {name: Model(aircraft, forms[name]) for name, aircraft in models.items()}
    return fly_missions(both, request.campaign, request.out, request.workers, say)


def _document(
    request: Request, document: dict[str, Any], intervals: tuple[Intervals, Intervals], mission: dict[str, Any]
) -> dict[str, Any]:
    gap = document["gap"]
    gap["test"] |= {"intervals": intervals_document(*intervals), "pbox": mission}
    gap["train"] |= {"pbox": no_pbox("a mission belongs to no flight: see gap.test")}
    return document | {
        "model": f"aircraft/{request.aircraft.folder.name}/{request.aircraft.xml.name}",
        "train": [p.name for p in request.train],
        "test": [p.name for p in request.test],
        "command": shlex.join(request.command),
    }
