"""Commands about models and flights: bounds of the model's error.

Each function takes a request, writes the folder of results if the request names one, and returns an
`Outcome`: the result for Python, the document for ``--json``, and the lines that are printed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from sysid.aerodynamics import Cutoffs, term_name
from sysid.model_form import FitOptions
from uqharness import __version__
from uqharness.commands.flights import carded_aircraft, replay_flights
from uqharness.files import check_output_folder, results_folder, write_bytes, write_json, write_text
from uqharness.identification import (
    BoundsOptions,
    CutoffRow,
    MadeBounds,
    choose_servos,
    make_bounds,
    mean_left_out,
    parse_designs,
)
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.replay import cut_for_residuals, read_histories
from uqharness.report import forced_width, write_figures, write_report, write_residuals
from uqharness.report.pages import RESIDUALS, slice_section, variation_section
from uqharness.requests.base import Callback, command_line, silent
from uqharness.requests.identification import BoundsRequest
from uqharness.results.base import Outcome
from uqharness.results.identification import Bounds, BoundsOfCoefficient, Filters


def bounds(request: BoundsRequest, callback: Callback = silent) -> Outcome[MadeBounds]:
    """Fit the bounds of a model's error and write the model form, its evidence and a page."""
    aircraft = carded_aircraft(request.aircraft)
    if request.out is not None:
        # Fail before the work if results cannot be written.
        check_output_folder(request.out)
    options = _bounds_options(request)
    callback("reading the flights")
    ready = replay_flights(request, aircraft)
    # Residual coefficients need more channels than a replay.
    flights = [cut_for_residuals(flight, ready.measured) for flight in ready.flights]
    if request.servos == "auto":
        callback("comparing the card's servos with ideal ones")
    servos = choose_servos(aircraft, flights, ready.measured, request.servos)
    flights, options = servos.with_note(flights), replace(options, ideal_servos=servos.ideal)
    made = make_bounds(aircraft, flights, ready.measured, ready.sha256, options, callback)
    document = _bounds_document(made)
    if request.out is None:
        lines = [f"{c}: mean width {made.widths[c]:.3g}" for c in made.form.coefficients]
        return Outcome(made, document, lines, warnings=made.warnings)
    # Render the XML before anything is written: it may refuse the aircraft.
    system = model_form_xml(made.form, aircraft)
    out = results_folder(request.out)
    write_bytes(out / "model-form.xml", system)
    # The provenance is stored in the folder, but is no part of ``--json``.
    stored = document.model_copy(update={"command": command_line(request), "version": __version__})
    write_json(out / "bounds.json", stored.as_json())
    write_residuals(made.form, made.residuals, ", ".join(f.name for f in flights), out)
    write_text(out / "model-form.json", made.form.to_json())
    callback("report")
    report = write_report(out, request.figures)
    if request.figures:
        _write_bounds_figures(made, out)
    return Outcome(made, document, [report.text], report=report.path, warnings=made.warnings)


def _bounds_options(request: BoundsRequest) -> BoundsOptions:
    """Return the options of the fit. Raises BadInputError for unknown states and terms."""
    states, terms = (
        [f"{c}={','.join(names)}" for c, names in by_coefficient.items()]
        for by_coefficient in (request.states, request.terms)
    )
    return BoundsOptions(
        designs=parse_designs(states, terms, request.order, request.roll_terms),
        fit=FitOptions(
            request.confidence,
            request.sample_size or "all",
            request.select,
            "inside" if request.as_published else "apart",
        ),
        # 0 means no low-pass of the airspeed.
        cutoffs=Cutoffs(request.cutoff_hz, request.airspeed_cutoff_hz or math.inf),
        walk_cutoff_hz=request.walk_cutoff_hz,
        outside=request.outside,
        checks=request.checks,
    )


def _bounds_document(made: MadeBounds) -> Bounds:
    """Return bounds.json of a fit, without its provenance."""
    form = made.form
    return Bounds(
        aircraft=form.aircraft.name,
        flights=[f.name for f in form.flights],
        confidence=form.confidence,
        outside=form.outside,
        coefficients={c: _bounds_of(made, c) for c in form.coefficients},
        left_out={m: dict(row) for m, row in made.left_out.items()},
        cutoffs=[_filters(row) for row in made.cutoffs],
        warnings=list(made.warnings),
        notes=list(made.notes),
    )


def _bounds_of(made: MadeBounds, coefficient: str) -> BoundsOfCoefficient:
    """Return the bounds of one coefficient."""
    b = made.form.coefficients[coefficient]
    noise = made.noise.get(coefficient, math.nan)
    parts: dict[str, Any] = {}
    if b.parts is not None:
        parts = {
            name: getattr(b.parts, name)
            for name in (
                "persistent",
                "transient",
                "transient_half_width",
                "transient_time_s",
                "flight",
                "noise_scale",
                "not_above",
                "found",
            )
        }
    return BoundsOfCoefficient(
        states=list(b.states),
        terms=[term_name(t, b.states) for t in b.terms],
        n=b.n,
        n_effective=b.n_effective,
        s=math.sqrt(b.s2),
        mean_width=made.widths[coefficient],
        noise_width=forced_width(noise, b.confidence),
        left_out_share=mean_left_out(made.residuals, made.left_out).get(coefficient, math.nan),
        walk_rate=b.walk_rate,
        walk_sigma=made.variations[coefficient].sigma,
        noise_std=noise,
        **parts,
    )


def _filters(row: CutoffRow) -> Filters:
    """Return the mean widths with another filter."""
    return Filters(
        cutoff_hz=row.cutoffs.all_hz,
        airspeed_cutoff_hz=row.cutoffs.airspeed_hz,
        mean_width=dict(row.width),
    )


def _write_bounds_figures(made: MadeBounds, out: Path) -> None:
    """Draw what the folder does not store: the changes of levels, and the bounds with default
    states.
    """
    sections = [variation_section(made.variations)]
    if made.baseline:
        sections.append(
            slice_section(made.form, read_histories(out / RESIDUALS), baseline=made.baseline)
        )
    write_figures(out, sections, f"Model-form bounds of {made.form.aircraft.name}")
