"""Command refine: find effects that a model lacks, add them, test the result, write its files."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import read_effects
from uqharness.checksums import write_sums
from uqharness.commands.flights import carded_aircraft, flights_of
from uqharness.files import check_output_folder, remove, scratch_folder, write_bytes, write_json
from uqharness.heartbeat import Callback, silent
from uqharness.refinement import Job, Refinement
from uqharness.refinement.run import refine as run_refinement
from uqharness.replay import CONTROLS, columns_of, shown_channel, unique_names, write_histories
from uqharness.report import write_report
from uqharness.requests.base import command_words
from uqharness.requests.refinement import RefineRequest
from uqharness.results.base import Outcome
from uqharness.results.refinement import ResidualTables
from uqharness.simulator import Aircraft

FIGURES = (
    "gap.svg",
    "history.svg",
    "intervals.svg",
    "pbox.svg",
    "candidates.svg",
    "coefficients.svg",
    "unnamed.svg",
)
"""Figures of a refinement; those of an earlier run are removed."""


def write_results(done: Refinement, out: Path) -> None:
    """Write the files of a refinement.

    Parameters
    ----------
    done : Refinement
        Result.
    out : Path
        Folder for refinement.json, model.diff and histories.parquet.
    """
    write_json(out / "refinement.json", done.document.as_json())
    write_bytes(out / "model.diff", model_diff(done).encode("utf-8", errors="surrogateescape"))
    for name in FIGURES:
        remove(out / "figures" / name)
    # Histories of the hold-out flights: measurement, controls, and both models.
    test = done.hold_out.test
    setup, models = test.data, {"_before": test.before, "_after": test.after}
    columns = columns_of(setup.outputs, setup.measured) | columns_of(
        CONTROLS, [s.controls for s in setup.segments]
    )
    for suffix, evaluation in models.items():
        # Model output = measurement minus residual.
        modelled = [z - r for z, r in zip(setup.measured, evaluation.residual, strict=True)]
        columns |= columns_of(setup.outputs, modelled, suffix)
        columns |= columns_of(COEFFICIENTS, evaluation.coefficients, f"_gap{suffix}")
    write_histories(out, setup.segments, columns)
    write_sums(out, done.earlier_damage)


def model_diff(done: Refinement) -> str:
    """Return the unified difference of all XML files of two aircraft folders."""
    old, new = done.original.folder, done.aircraft.folder
    # Compare every XML file that exists in either folder.
    names = sorted({p.relative_to(f).as_posix() for f in (old, new) for p in f.rglob("*.xml")})
    out: list[str] = []
    for name in names:
        a, b = (
            (
                (f / name)
                .read_bytes()
                .decode("utf-8", errors="surrogateescape")
                .splitlines(keepends=True)
                if (f / name).is_file()
                else []
            )
            for f in (old, new)
        )
        out += difflib.unified_diff(a, b, f"a/{name}", f"b/{name}")
    return "".join(out)


_MAX_QUANTITIES = 8


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
    names = sorted(ratios, key=lambda name: -ratios[name][0])[:_MAX_QUANTITIES]
    parts = [f"{name} {ratios[name][0]:.2f} to {ratios[name][1]:.2f}" for name in names]
    return f"Residual over noise on the hold-out flights, before to after: {', '.join(parts)}."


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
