"""Command refine: find effects that a model lacks, add them, and test the result."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from sysid.effects import read_effects
from uqharness.commands.flights import carded_aircraft, flights_of
from uqharness.files import check_output_folder, scratch_folder
from uqharness.refinement import Job, Refinement
from uqharness.refinement.run import refine as run_refinement
from uqharness.replay import shown_channel, unique_names
from uqharness.report import write_report
from uqharness.report.refinement import write_results
from uqharness.requests.base import Callback, command_words, silent
from uqharness.requests.refinement import RefineRequest
from uqharness.results.base import Outcome
from uqharness.results.refinement import ResidualTables
from uqharness.simulator import Aircraft

_MOST_QUANTITIES = 8


def refine(request: RefineRequest, callback: Callback = silent) -> Outcome[Refinement]:
    """Refine an aircraft and write the results; the answer is no where residuals stay
    unexplained.
    """
    aircraft = carded_aircraft(request.aircraft)
    check_output_folder(request.out)
    # Read the user's effects first: errors in the file should not cost a refinement.
    extra = tuple(read_effects(request.effects)) if request.effects else ()
    with scratch_folder("flights") as scratch:
        train, test = (
            _files(flights, aircraft, scratch.path / name)
            for name, flights in (("train", request.train), ("test", request.test))
        )
        # Only flights from files have a command that repeats the refinement.
        in_files = all(scratch.path not in file.parents for file in (*train, *test))
        job = Job(
            request,
            aircraft,
            train,
            test,
            extra,
            None if request.servos == "auto" else request.servos == "ideal",
            tuple(command_words(request)) if in_files else (),
        )
        done = run_refinement(job, callback)
    callback("report")
    write_results(done, request.out)
    report = write_report(request.out, request.figures)
    code = 1 if done.document.verdict == "unexplained" else 0
    lines = [*report.verdict, _gap_line(done.document.gap.test)]
    return Outcome(done, done.document, lines, code, report.path)


def _gap_line(gap: ResidualTables) -> str:
    """Return the quantities with the largest residuals over noise, before and after."""
    ratios = {
        shown_channel(name)[0]: (row.rms_before / row.noise_rms, row.rms_after / row.noise_rms)
        for name, row in (gap.channels | gap.coefficients).items()
        if row.rms_before is not None and row.rms_after is not None and row.noise_rms
    }
    names = sorted(ratios, key=lambda name: -ratios[name][0])[:_MOST_QUANTITIES]
    parts = [f"{name} {ratios[name][0]:.2f} to {ratios[name][1]:.2f}" for name in names]
    return f"Residual over noise on the test flights, before to after: {', '.join(parts)}."


def _files(flights: Sequence[Any], aircraft: Aircraft, folder: Path) -> tuple[Path, ...]:
    """Return a file for each flight, writing those in memory into ``folder``."""
    in_memory = [flight for flight in flights if not isinstance(flight, str | PathLike)]
    records = flights_of(in_memory, aircraft) if in_memory else []
    new_files = [folder / f"{name}.parquet" for name in unique_names([r.name for r in records])]
    folder.mkdir()
    for file, flight in zip(new_files, records, strict=True):
        flight.record.write(file)
    next_file = iter(new_files)
    return tuple(
        Path(flight) if isinstance(flight, str | PathLike) else next(next_file)
        for flight in flights
    )
