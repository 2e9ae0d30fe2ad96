"""Commands about models and flights: parameters, the gap to a flight, bounds of the model's error.

Each function takes a request, writes the folder of results if the request names one, and returns an
`Outcome`: the result for Python, the document for ``--json``, and the lines that are printed.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.aerodynamics import Cutoffs, term_name
from sysid.distributions import normal_quantile
from sysid.estimation import colour, rms
from sysid.model_form import Bin, FitOptions, ModelForm
from uqharness import __version__
from uqharness.arguments import path as argument_path
from uqharness.commands.flights import ReplayFlights, carded_aircraft, replay_flights
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, results_folder, write_bytes, write_json, write_text
from uqharness.heartbeat import Callback, silent
from uqharness.identification import (
    BIASES,
    MIN_LEFT_S,
    MIN_SPLIT_S,
    BoundsOptions,
    Comparison,
    CutoffRow,
    ForecastContest,
    Forecaster,
    Identification,
    Instruments,
    Intervals,
    MadeBounds,
    ServoChoice,
    Split,
    Validation,
    choose_servos,
    compare_models,
    failed,
    is_ordinary,
    load_form,
    make_bounds,
    mean_left_out,
    parse_designs,
    read_prior,
    rows_in,
    seconds,
    split_in_time,
    used_for_bounds,
    used_for_model,
    validate,
    verdicts,
    whole_flight,
    without,
)
from uqharness.identification.compare import compare as measure_gap
from uqharness.identification.identify import identify as estimate
from uqharness.plugin import Estimate, write_estimates
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.replay import (
    CONTROLS,
    NEEDED,
    Flight,
    columns_of,
    cut_for_residuals,
    read_histories,
    write_histories,
)
from uqharness.replay import flights as replayed
from uqharness.report import (
    NOISE_FLOOR_RULE,
    first_lines,
    gap_verdict,
    write_figures,
    write_report,
    write_residuals,
    write_tables,
)
from uqharness.report.pages import (
    RESIDUALS,
    compare_page_of,
    coverage_page_of,
    identify_page_of,
    slice_section,
    variation_section,
)
from uqharness.requests.base import command_line
from uqharness.requests.fields import channel_names
from uqharness.requests.identification import (
    BoundsRequest,
    CompareRequest,
    IdentifyRequest,
    ValidateBoundsRequest,
)
from uqharness.results.base import Outcome
from uqharness.results.identification import (
    BetterModel,
    Bounds,
    BoundsOfCoefficient,
    Channel,
    Compare,
    Conformal,
    Coverage,
    Filters,
    Fit,
    FitChannel,
    FlightPiece,
    Gap,
    Manoeuvre,
    ModelScore,
    Moment,
    Nuisance,
    Parameter,
    ReplaySpeed,
    ScoreDifference,
    Share,
    SplitInTime,
    StateBin,
)
from uqharness.simulator import Aircraft
from uqharness.text_tables import csv_text

AnyRequest = IdentifyRequest | CompareRequest | BoundsRequest | ValidateBoundsRequest


def _aircraft(request: AnyRequest) -> Aircraft:
    """Return the aircraft of a request. Raises BadInputError if results cannot be written."""
    aircraft = carded_aircraft(request.aircraft)
    if request.out is not None:
        check_output_folder(request.out)
    return aircraft


def _with_servos(
    request: AnyRequest,
    aircraft: Aircraft,
    ready: ReplayFlights,
    callback: Callback,
    workers: int | None = None,
    models: Sequence[Aircraft] = (),
) -> tuple[list[Flight], bool]:
    """Return the flights with a note of the chosen servos, and whether these are ideal.

    The first of ``models`` that was identified from an ordinary flight says how late controls act
    and how wrong the air data are.
    """
    if request.servos == "auto":
        logged = all(f.record.metadata.native_hz for f in ready.flights)
        for model in models if logged else ():
            instruments = Instruments.of_model(model, ready.sha256[0])
            if instruments is not None:
                flights = [instruments.correct(f) for f in ready.flights]
                choice = ServoChoice(instruments.ideal, note=instruments.text)
                return choice.with_note(flights), instruments.ideal
        callback("comparing the card's servos with ideal ones")
    servos = choose_servos(aircraft, ready.flights, ready.measured, request.servos, workers)
    return servos.with_note(ready.flights), servos.ideal


def _part_of_flight(
    ready: ReplayFlights,
    aircraft: Aircraft,
    used: Intervals,
    *,
    halve: bool,
    held_out_for: str = "",
    min_s: float = 0.0,
    align: bool = True,
) -> tuple[ReplayFlights, Split | None]:
    """Return one ordinary flight without the rows of earlier results, and which rows it has.

    With ``halve`` every second block of the rest is held out, if it lasts ``min_s``. Several
    flights and flights with manoeuvres stay as they are.
    """
    if len(ready.sources) != 1 or not is_ordinary(ready.flights[0]):
        return ready, None
    (source,) = ready.sources
    remainder = without(source.record, used)
    # Nothing is left: the result warns that it judges a model on its own data.
    if remainder is None:
        return ready, split_in_time(source.record, False)
    split = split_in_time(remainder, halve, min_s)
    chosen = rows_in(remainder, split.used_s)
    too_short = halve and seconds(split.used_s) < min_s and not split.held_out_s
    if split.held_out_s or too_short:
        note = split.note(source.name, held_out_for, min_s)
    else:
        note = f"{source.name}: {seconds(split.used_s):.0f} s that no earlier result was made from"
    if len(chosen) == len(source.record):
        # The complete flight needs no note, unless something should have been held out.
        if too_short:
            flight = ready.flights[0]
            ready = replace(ready, flights=[replace(flight, notes=(note, *flight.notes))])
        return ready, split
    (flight,), measured = replayed.prepare_together([source.name], [chosen], aircraft, align=align)
    logging.getLogger("uqharness").info(note)
    flight = replace(flight, notes=(note, *flight.notes))
    return replace(ready, flights=[flight], measured=measured), split


def _split_document(split: Split | None) -> SplitInTime | None:
    """Return the split as a part of a document."""
    if split is None:
        return None
    used_s, held_out_s = (
        [list(pair) for pair in part] for part in (split.used_s, split.held_out_s)
    )
    return SplitInTime(**asdict(split) | {"used_s": used_s, "held_out_s": held_out_s})


# Parameters.


def identify(request: IdentifyRequest, callback: Callback = silent) -> Outcome[Identification]:
    """Estimate parameters; write them, their evidence, a page and an aircraft with them."""
    # Records are cut and aligned once, whatever servos are chosen.
    aircraft = _aircraft(request)
    callback("reading the flights")
    ready, split = _part_of_flight(
        replay_flights(request, aircraft),
        aircraft,
        (),
        halve=request.split == "auto" and request.method == "auto",
        held_out_for="bounds and compare",
        min_s=MIN_SPLIT_S,
    )
    flights, ideal = _with_servos(request, aircraft, ready, callback, request.workers)
    biases = channel_names(request.biases)
    priors = {} if request.prior is None else read_prior(request.prior)
    if unknown := sorted(
        set(priors) - set(aircraft.card.parameters) - set(request.parameters or ())
    ):
        raise BadInputError(
            f"{request.prior}: {', '.join(unknown[:5])} is no parameter of {aircraft.name}'s card;"
            " remove it, or add it to [parameters] of airframe.toml"
        )
    result = estimate(
        aircraft,
        flights,
        ready.measured,
        request.parameters,
        start=request.start,
        biases=BIASES if biases is None else biases,
        delays=channel_names(request.delays),
        outputs=channel_names(request.outputs),
        ideal_servos=ideal,
        method=request.method,
        prior={n: (p.mean, p.std) for n, p in priors.items()},
        workers=request.workers,
        callback=callback,
        message_callback=logging.getLogger("uqharness").info,
    )
    # The document is what the page, --json and the Python result show.
    document = _fit(result, ready, command_line(request)).model_copy(
        update={"split": _split_document(split), "servos": "ideal" if ideal else "card"}
    )
    code = 0 if result.converged and result.identified else 1
    details = [note for flight in flights for note in flight.notes]
    details += [] if result.speed is None else [result.speed.text()]
    # Without a folder the page is only summarised.
    if request.out is None:
        lines = [*first_lines(identify_page_of(document)), *details]
        return Outcome(result, document, lines, code, warnings=document.warnings)
    # The aircraft with the estimates is written first: fit.json names it.
    callback("report")
    out = results_folder(request.out)
    document = _write_estimates(result, aircraft, document, out)
    write_text(out / "parameters.csv", csv_text(_parameter_rows(result)))
    write_histories(
        out,
        result.segments,
        {
            **columns_of(result.outputs, result.measured),
            **columns_of(result.outputs, result.modelled, "_model"),
            **columns_of(CONTROLS, [s.controls for s in result.segments]),
        },
    )
    write_json(out / "fit.json", document.as_json())
    report = write_report(out, request.figures)
    lines = [report.text, *details]
    return Outcome(result, document, lines, code, report.path, document.warnings)


def _fit(result: Identification, ready: ReplayFlights, command: str) -> Fit:
    """Return fit.json of an identification."""
    # Residuals of all segments, channel by channel.
    residual = [
        np.concatenate([block[:, k] for block in result.residual])
        for k in range(len(result.outputs))
    ]
    # Whiteness of the residuals, with the model output as context.
    tint = colour(list(result.residual), list(result.modelled))
    return Fit(
        aircraft=result.aircraft,
        method=result.method,
        converged=result.converged,
        parameters={
            n: Parameter(
                value=result.theta[i],
                std=result.std[i],
                std_crb=result.std_crb[i],
                status=result.status[n],
                reason=result.reason[n],
                initial=result.initial[i],
                **({"basis": result.labels[n]} if n in result.labels else {}),
            )
            for i, n in enumerate(result.names)
        },
        names=list(result.identified),
        cov=result.cov.tolist(),
        warnings=list(result.warnings),
        fit={
            channel: FitChannel(
                rms=rms(residual[k]),
                noise=result.noise[channel],
                whiteness_p=tint.p_value[k],
                predictable_share=tint.predictable[k],
            )
            for k, channel in enumerate(result.outputs)
        },
        nuisance={n: Nuisance(value=v, std=s) for n, (v, s) in result.nuisance.items()},
        segments=[
            FlightPiece(flight=s.flight, label=s.label, start_s=s.time_s[0], end_s=s.time_s[-1])
            for s in result.segments
        ],
        flights=ready.files,
        # Digests identify the flights, so that `bounds` can warn of their reuse.
        flights_sha256=ready.sha256,
        notes=list(result.notes),
        command=command,
        simulations=result.simulations,
        seconds=round(result.seconds, 2),
        speed=None
        if result.speed is None
        else ReplaySpeed(**{k: round(v, 1) for k, v in asdict(result.speed).items()}),
    )


def _write_estimates(result: Identification, aircraft: Aircraft, document: Fit, out: Path) -> Fit:
    """Write the aircraft with the identified parameters; return the document with a warning of
    those that the XML does not declare.
    """
    estimates = {
        n: Estimate(
            float(result.theta[i]),
            f"{result.theta[i]:.4g} +/- {result.std[i]:.2g} by {result.method} from"
            f" {', '.join(document.flights)}: uqharness identify",
        )
        for i, n in enumerate(result.names)
        if n in result.identified
    }
    unwritten = write_estimates(aircraft, estimates, out / "aircraft")
    if not unwritten:
        return document
    warning = (
        "not written into the XML, which does not declare them as <property value=...>:"
        f" {', '.join(unwritten)}"
    )
    return document.model_copy(update={"warnings": [*document.warnings, warning]})


def _parameter_rows(result: Identification) -> list[dict[str, str]]:
    """Return the table of parameters as text.

    The columns are those of Table 2.6 of the dissertation: initial value, estimate, corrected
    standard error, Cramér-Rao bound, status.
    """
    return [
        {
            "parameter": name,
            "initial": f"{result.initial[i]:.5g}",
            "estimate": f"{result.theta[i]:.5g}",
            "std": f"{result.std[i]:.2g}" if name in result.identified else "",
            "crb": f"{result.std_crb[i]:.2g}" if name in result.identified else "",
            "status": result.status[name],
            "reason": result.reason[name],
            "basis": result.labels.get(name, ""),
        }
        for i, name in enumerate(result.names)
    ]


# The gap to a flight.


def compare(
    request: CompareRequest, callback: Callback = silent
) -> Outcome[Comparison] | Outcome[ForecastContest]:
    """Measure the gap between a model and a flight; write tables, histories and a page.

    With a second aircraft, decide which of the two predicts the flight better.
    """
    aircraft = _aircraft(request)
    if request.other is not None:
        return _better_model(request, aircraft, carded_aircraft(request.other), callback)
    callback("reading the flight")
    # Late channels stay late: their delays are estimated and reported.
    ready = replay_flights(request, aircraft, align=False)
    used = used_for_model(aircraft, ready.sha256[0])
    ready, _ = _part_of_flight(ready, aircraft, used, halve=False, align=False)
    (flight,), ideal = _with_servos(
        request, aircraft, ready, callback, request.workers, models=[aircraft]
    )
    biases = channel_names(request.biases)
    comparison = measure_gap(
        aircraft,
        flight,
        ready.measured,
        biases=BIASES if biases is None else biases,
        delays=channel_names(request.delays),
        ideal_servos=ideal,
        workers=request.workers,
        callback=callback,
    )
    document = _compared(comparison, command_line(request))
    code = 0 if comparison.reached else 1
    if request.out is None:
        return Outcome(comparison, document, first_lines(compare_page_of(document)), code)
    callback("report")
    out = results_folder(request.out)
    write_tables(comparison, out)
    write_json(out / "compare.json", document.as_json())
    report = write_report(out, request.figures)
    return Outcome(comparison, document, [report.text], code, report.path)


def _better_model(
    request: CompareRequest, aircraft: Aircraft, other: Aircraft, callback: Callback
) -> Outcome[ForecastContest]:
    """Decide which of two models predicts a flight better."""
    forecasters = []
    for one in (aircraft, other):
        callback("reading the flight")
        ready = replay_flights(request, one)
        used = tuple(i for m in (aircraft, other) for i in used_for_model(m, ready.sha256[0]))
        ready, _ = _part_of_flight(ready, one, used, halve=False)
        (flight,), ideal = _with_servos(
            request, one, ready, callback, request.workers, models=[aircraft, other]
        )
        forecasters.append(Forecaster(one, flight, ready.measured, ideal))
    contest = compare_models(forecasters[0], forecasters[1], callback=callback)
    result = contest.comparison
    document = BetterModel(
        better=result.better,
        a=contest.models[0],
        b=contest.models[1],
        flight=contest.flight,
        horizon_s=result.horizon_s,
        score=ScoreDifference(difference=result.difference, low=result.low, high=result.high),
        horizons=[
            ModelScore(
                horizon_s=horizon,
                difference=difference,
                low=low,
                high=high,
                rms_a=dict(zip(contest.channels, result.rms[0][k].tolist(), strict=True)),
                rms_b=dict(zip(contest.channels, result.rms[1][k].tolist(), strict=True)),
            )
            for k, (horizon, (difference, low, high)) in enumerate(
                zip(result.horizons_s, result.by_horizon, strict=True)
            )
        ],
        channels=list(contest.channels),
        starts=result.starts,
        blocks=result.blocks,
        controls_late_s=list(contest.delays_s),
        notes=list(contest.notes),
        command=command_line(request),
    )
    if request.out is not None:
        write_json(results_folder(request.out) / "compare.json", document.as_json())
    # Models of one name, as before and after `identify`, differ by their places.
    names = contest.models if len(set(contest.models)) == 2 else (request.aircraft, request.other)
    return Outcome(contest, document, _contest_lines(contest, names))


def _contest_lines(contest: ForecastContest, models: Sequence[object]) -> list[str]:
    """Return the answer of a contest of two ``models``, with a line for each horizon."""
    result = contest.comparison
    names = dict(zip("AB", map(str, models), strict=True))
    if result.better == "no difference":
        answer = f"no difference: {names['A']} (A) and {names['B']} (B) predict {contest.flight}"
        answer += " alike"
    else:
        loser = "B" if result.better == "A" else "A"
        answer = (
            f"{result.better}: {names[result.better]} predicts {contest.flight} better than"
            f" {names[loser]} ({loser})"
        )
        if math.isfinite(result.horizon_s):
            answer += f", from a horizon of {result.horizon_s:g} s"
    score = (
        f"score {_percent_interval(result.difference, result.low, result.high)} in favour of A"
        f" (CRPS over {len(contest.channels)} channels, {result.starts} predictions,"
        f" {result.blocks} blocks of time)"
    )
    lines = [answer, score]
    for horizon, difference in zip(result.horizons_s, result.by_horizon, strict=True):
        lines.append(f"  {horizon:4g} s  {_percent_interval(*difference)}")
    if any(contest.delays_s):
        a, b = (f"{1e3 * delay:.0f} ms" for delay in contest.delays_s)
        lines.append(f"controls late by {a} (A) and {b} (B), where each predicts best")
    return [*lines, *contest.notes]


def _percent_interval(value: float, low: float, high: float) -> str:
    """Return a relative difference with its 95 % interval."""
    if not math.isfinite(low):
        return f"{100.0 * value:+.1f} % (too few blocks of time for an interval)"
    return f"{100.0 * value:+.1f} % ({100.0 * low:+.1f} to {100.0 * high:+.1f} %)"


def _compared(comparison: Comparison, command: str) -> Compare:
    """Return compare.json of a comparison."""
    return Compare(
        aircraft=comparison.aircraft,
        flight=comparison.flight,
        reached_noise_floor=comparison.reached,
        rule=NOISE_FLOOR_RULE,
        verdict=gap_verdict(comparison),
        controls_late_s=comparison.controls_late_s,
        aligned=comparison.aligned,
        above=list(comparison.above),
        # Residuals and delays of the outputs, each beside its noise.
        channels={
            c: Channel(
                rms=g.rms,
                noise=g.noise,
                ratio=g.ratio,
                judged=g.judged,
                delay_s=g.allowed_s + g.shift.seconds,
                delay_std_s=g.shift.std,
                theil_u=g.theil.u,
                theil_bias=g.theil.bias,
                theil_variance=g.theil.variance,
                theil_covariance=g.theil.covariance,
                slip=g.slip,
                delay_undefined=g.undefined,
            )
            for c, g in comparison.channels.items()
        },
        # Residuals of the force and moment coefficients.
        coefficients={
            c: Gap(rms=g.rms, noise=g.noise, mean=g.mean)
            for c, g in comparison.coefficients.items()
        },
        manoeuvres={
            m: Manoeuvre(
                channels=dict(row), coefficients=dict(comparison.manoeuvre_coefficients[m])
            )
            for m, row in comparison.manoeuvres.items()
        },
        moments=[Moment(**vars(m)) for m in comparison.moments],
        # Biases are nuisance parameters of the replay; delays stand in the channels.
        biases={n: v for n, v in comparison.nuisance.items() if n.startswith("bias/")},
        notes=list(comparison.notes),
        command=command,
    )


# Bounds of the model's error.


def bounds(request: BoundsRequest, callback: Callback = silent) -> Outcome[MadeBounds]:
    """Fit the bounds of a model's error and write the model form, its evidence and a page."""
    aircraft, options = _aircraft(request), _bounds_options(request)
    callback("reading the flights")
    ready = replay_flights(request, aircraft)
    ready, split = _part_of_flight(
        ready,
        aircraft,
        used_for_model(aircraft, ready.sha256[0]),
        halve=request.split == "auto",
        held_out_for="validate-bounds",
        min_s=2.0 * MIN_LEFT_S,
    )
    ready = _for_residuals(ready)
    flights, ideal = _with_servos(request, aircraft, ready, callback, models=[aircraft])
    options = replace(options, ideal_servos=ideal)
    result = make_bounds(aircraft, flights, ready.measured, ready.sha256, options, callback)
    if split is not None:
        (used,) = result.form.flights
        form = replace(result.form, flights=(replace(used, parts_s=split.used_s),))
        result = replace(result, form=form)
    document = _bounds_document(result).model_copy(update={"split": _split_document(split)})
    if request.out is None:
        lines = [f"{c}: mean width {result.widths[c]:.3g}" for c in result.form.coefficients]
        return Outcome(result, document, lines, warnings=result.warnings)
    # Render the XML before anything is written: it may refuse the aircraft.
    system = model_form_xml(result.form, aircraft)
    out = results_folder(request.out)
    write_bytes(out / "model-form.xml", system)
    # The provenance is stored in the folder; ``--json`` does not print it.
    stored = document.model_copy(update={"command": command_line(request), "version": __version__})
    write_json(out / "bounds.json", stored.as_json())
    write_residuals(result.form, result.residuals, ", ".join(f.name for f in flights), out)
    write_text(out / "model-form.json", result.form.to_json())
    callback("report")
    report = write_report(out, request.figures)
    if request.figures:
        _write_bounds_figures(result, out)
    return Outcome(result, document, [report.text], report=report.path, warnings=result.warnings)


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
        # Width of an interval due to noise alone.
        noise_width=2.0 * normal_quantile(0.5 + 0.5 * b.confidence) * noise,
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


def _for_residuals(ready: ReplayFlights) -> ReplayFlights:
    """Return flights cut where residual coefficients have their channels: ordinary flights
    completely, others in their manoeuvres.
    """
    flights = [cut_for_residuals(f, ready.measured) for f in ready.flights]
    return replace(
        ready,
        flights=[
            whole_flight(f, ready.measured, NEEDED)
            if is_ordinary(replace(f, record=source.record))
            else f
            for f, source in zip(flights, ready.sources, strict=True)
        ],
    )


# Coverage of bounds on a new flight.


def validate_bounds(
    request: ValidateBoundsRequest, callback: Callback = silent
) -> Outcome[Validation]:
    """Count how much of a flight lies inside bounds from others; write the evidence and a page."""
    aircraft, form = _aircraft(request), _model_form(request.form)
    callback("reading the flights")
    ready = replay_flights(request, aircraft)
    sha256 = ready.sha256[0]
    used = (*used_for_model(aircraft, sha256), *used_for_bounds(form, sha256))
    ready = _for_residuals(_part_of_flight(ready, aircraft, used, halve=False)[0])
    flights, ideal = _with_servos(request, aircraft, ready, callback, models=[aircraft])
    callback("residual coefficients")
    validation = validate(aircraft, form, flights, ready.measured, ready.sha256, ideal_servos=ideal)
    document = _coverage(validation)
    code = 0 if set(document.verdicts.values()) == {"holds"} else 1
    if request.out is None:
        lines = first_lines(coverage_page_of(document))
        return Outcome(validation, document, lines, code, warnings=validation.warnings)
    callback("report")
    out = results_folder(request.out)
    write_residuals(form, validation.residuals, ", ".join(f.name for f in flights), out)
    # The provenance is stored in the folder; ``--json`` does not print it.
    stored = document.model_copy(update={"command": command_line(request), "version": __version__})
    write_json(out / "coverage.json", stored.as_json())
    report = write_report(out, figures=True)
    return Outcome(validation, document, [report.text], code, report.path, validation.warnings)


def _model_form(form: Any) -> ModelForm:
    """Return bounds given as an object or as a file. Raises BadInputError."""
    form = form.form if isinstance(form, MadeBounds) else form
    return form if isinstance(form, ModelForm) else load_form(argument_path("form", form))


def _coverage(validation: Validation) -> Coverage:
    """Return coverage.json of a validation, without its provenance."""
    rows = validation.coverage
    return Coverage(
        coverage={
            c: Share(
                **{"0.95": row.share[0.95], "0.68": row.share[0.68]},
                n_effective=row.n_effective,
                mean_width=row.mean_width,
            )
            for c, row in rows.items()
        },
        errors={c: _by_level(row.error) for c, row in rows.items()},
        outside_data={c: row.outside for c, row in rows.items()},
        manoeuvres={
            m: {c: _by_level(row.manoeuvres[m]) for c, row in rows.items()}
            for m in validation.residuals.labels
        },
        by_speed=_bins({c: row.speeds for c, row in rows.items()}, "V_mps"),
        by_incidence=_bins({c: row.incidences for c, row in rows.items()}, "alpha_rad"),
        conformal={
            c: Conformal(**asdict(row.conformal))
            for c, row in rows.items()
            if row.conformal is not None
        },
        verdicts=dict(verdicts(validation)),
        flight_variance={c: validation.flight_std.get(c, math.nan) for c in rows},
        failed=list(failed(validation)),
        warnings=list(validation.warnings),
        notes=list(validation.notes),
    )


def _by_level(shares: Mapping[float, float]) -> dict[str, float | None]:
    """Return shares by confidence with the confidence as text."""
    return {str(level): share for level, share in shares.items()}


def _bins(bins: Mapping[str, Sequence[Bin]], state: str) -> list[StateBin]:
    """Return the coverage by thirds of a state, which are the same for all coefficients."""
    longest = max(bins.values(), key=len)
    return [
        StateBin(
            state=state,
            **{"from": first.low, "to": first.high},
            samples=first.n,
            share={c: items[k].share for c, items in bins.items() if k < len(items)},
        )
        for k, first in enumerate(longest)
    ]
