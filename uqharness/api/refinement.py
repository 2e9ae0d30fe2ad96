"""Refinement in Python: the function that ``uqharness refine`` corresponds to.

Flights in memory are written to temporary files, because a refinement reads files and names them in
its provenance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Literal

from sysid.effects import read_effects
from sysid.record import FlightRecord
from uqharness.arguments import flag, instance, one_of, path, require
from uqharness.arguments import workers as given_workers
from uqharness.commands import (
    AnyAircraft,
    AnyFlight,
    AnyPath,
    Flight,
    carded_aircraft,
    flights_of,
)
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, scratch_folder
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.refinement import Refinement, Request
from uqharness.refinement import run as running
from uqharness.replay import unique_names
from uqharness.report import write_report
from uqharness.report.refinement import write_results
from uqharness.simulator import Aircraft


@notebook_line("refine")
@isolated
def refine(
    aircraft: AnyAircraft,
    *,
    train: AnyFlight | Iterable[AnyFlight],
    test: AnyFlight | Iterable[AnyFlight],
    out: AnyPath,
    effects: AnyPath | None = None,
    servos: Literal["auto", "card", "ideal"] = "auto",
    campaign: AnyPath | None = None,
    pbox: bool = True,
    bake: bool = False,
    figures: bool = True,
    workers: int | None = None,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Refinement:
    """Find effects that a model lacks, and add them, as ``uqharness refine`` does.

    The same call resumes an interrupted refinement.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model.
    train : flight or sequence of flights
        Flights to choose and fit effects: paths, FlightRecords, or results of `fly` and
        `read_flights`.
    test : flight or sequence of flights
        Hold-out flights, used for testing only.
    out : str or Path
        Folder for the results.
    effects : str or Path, optional
        User effects in addition to the catalogue, TOML (docs/extend.md).
    servos : {"auto", "card", "ideal"}
        As for `identify`.
    campaign : str or Path, optional
        Mission that both models fly within their intervals; by default the aircraft's loiter, if it
        has one.
    pbox : bool
        Whether that mission is flown.
    bake : bool
        Whether estimated scales are written into the numbers of the author's functions.
    figures : bool
        Whether figures are drawn into ``out``.
    workers : int, optional
        Processes; by default one a core, 8 at most.
    on_stage : callable, optional
        Called with a sentence at each stage.

    Returns
    -------
    Refinement
        ``document``, which is refinement.json (verdict, effects with estimate, standard deviation
        and unit, gaps before and after), and ``aircraft``, the refined one, which every function
        here takes.

    Raises
    ------
    BadInputError
        For flights that cannot be used or that train and test share, and a card without
        ``[parameters]``.
    LogError
        For a file of effects that cannot be used.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, section 2.7. docs/refine.md has the method.

    Examples
    --------
    >>> import uqharness as uq
    >>> train, test = (
    ...     uq.fly("espaaro_truth", "flight-ident", noise=True, seed=seed) for seed in (1, 2)
    ... )
    >>> result = uq.refine(
    ...     "espaaro", train=train, test=test, out="refined", pbox=False, figures=False
    ... )
    >>> result.document["verdict"]
    'effects-found'
    """
    model, folder, workers = carded_aircraft(aircraft), path("out", out), given_workers(workers)
    one_of("servos", servos, ("auto", "card", "ideal"))
    flag("figures", figures)
    require("on_stage", on_stage, callable(on_stage), "a function of a text")
    effects_file, mission = (
        None if f is None else path(n, f) for n, f in (("effects", effects), ("campaign", campaign))
    )
    if not flag("pbox", pbox) and campaign is not None:
        raise BadInputError(
            "campaign and pbox = False: a campaign is flown for its p-box; leave out one of them"
        )
    check_output_folder(folder)
    extra = tuple(read_effects(effects_file)) if effects_file is not None else ()
    with scratch_folder("flights") as scratch:
        # A refinement reads files: flights in memory are written to a temporary folder.
        files = {
            name: _files(flights, model, scratch.path / name)
            for name, flights in (("train", train), ("test", test))
        }
        options: dict[str, object] = {
            "--servos": servos if servos != "auto" else None,
            "--effects": effects_file,
            "--campaign": mission,
            "--no-pbox": not pbox,
            "--bake": flag("bake", bake),
            "--workers": workers,
            "--no-figures": not figures,
        }
        # Only flights from files have a command that repeats the refinement.
        in_files = all(
            scratch.path not in file.parents for flights in files.values() for file in flights
        )
        request = Request(
            model,
            files["train"],
            files["test"],
            folder,
            extra,
            ideal_servos=None if servos == "auto" else servos == "ideal",
            workers=workers,
            command=_command(aircraft, files, options) if in_files else (),
            pbox=pbox,
            campaign=mission,
            bake=bake,
        )
        done = running.refine(request, on_stage)
    write_results(done, folder)
    write_report(folder, figures)
    return done


def _files(
    flights: AnyFlight | Iterable[AnyFlight], aircraft: Aircraft, folder: Path
) -> tuple[Path, ...]:
    """Return a file for each flight, writing those in memory into ``folder``."""
    several = [flights] if isinstance(flights, str | PathLike | FlightRecord | Flight) else flights
    flight_list = list(
        instance(
            "flights", several, Iterable, "a path, a FlightRecord, a Flight or several of them"
        )
    )
    in_memory = [flight for flight in flight_list if not isinstance(flight, str | PathLike)]
    records = flights_of(in_memory, aircraft) if in_memory else []
    new_files = iter(
        [folder / f"{name}.parquet" for name in unique_names([flight.name for flight in records])]
    )
    folder.mkdir()
    files = [
        Path(flight) if isinstance(flight, str | PathLike) else next(new_files)
        for flight in flight_list
    ]
    for file, flight in zip((p for p in files if p.parent == folder), records, strict=True):
        flight.record.write(file)
    if not files:
        raise BadInputError("refine needs at least one flight to train on and one to test on")
    return tuple(files)


def _command(
    aircraft: AnyAircraft, files: Mapping[str, Sequence[Path]], options: Mapping[str, object]
) -> tuple[str, ...]:
    """Return the equivalent command: file names only, no option at its default."""
    words = [
        "uqharness",
        "refine",
        aircraft.name if isinstance(aircraft, Aircraft) else str(aircraft),
    ]
    for role, paths in files.items():
        words += [f"--{role}", *(file.name for file in paths)]
    for option, value in options.items():
        if value is True:
            words.append(option)
        elif value is not None and value is not False:
            words += [option, value.name if isinstance(value, Path) else str(value)]
    return tuple(words)
