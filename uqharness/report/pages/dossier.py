"""Build the dossier of a folder of results: the evidence for a model, as one printable document.

It lists provenance, a proof of match against the tolerances for flight simulators, credibility
factors, statements with their assumptions, the validity envelope, what was not done, and all source
files with their hashes. It claims no compliance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness import __version__
from uqharness.campaign import Manifest
from uqharness.dossier import (
    ABSENT,
    FAIL,
    INCONCLUSIVE,
    NOT_ASSESSED,
    PASS,
    REGULATION,
    STANDARD,
    TESTS,
    BoundsEvidence,
    Evidence,
    Match,
    Row,
    SegmentResult,
    Step,
    factors,
    limits,
    proof_of_match,
    simulating_models,
)
from uqharness.dossier import Band as Tolerance
from uqharness.errors import BadInputError
from uqharness.replay import History, axis_label, shown_channel
from uqharness.report.campaign import CampaignReport, read_campaign_report
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Figure,
    Figures,
    Level,
    Page,
    Section,
    Sentence,
    Sentences,
    Table,
    Words,
    format_value,
    level_of,
    percent,
)
from uqharness.report.svg import Chart, Scale, scale
from uqharness.results.identification import Compare, Coverage, Fit
from uqharness.results.refinement import Refinement
from uqharness.results.study import Study
from uqharness.simulator import folder_hash

# Proof of match: tests, tolerances, segments, and the worst segment of each test.

_LEVELS: dict[str, Level] = {PASS: "good", FAIL: "bad", INCONCLUSIVE: "warn", ABSENT: ""}
_MAX_ROWS = 60
_MAX_DOTS = 250


@dataclass(frozen=True)
class LogComparison:
    """Log and model of a step.

    Attributes
    ----------
    step : Step
        Step of the evidence.
    segments : sequence of History
        Time histories.
    suffix : str
        Ending of the model's columns.
    model : str
        Which model on which flights, in words.
    match : Match
        Results of the tests.
    """

    step: Step
    segments: Sequence[History]
    suffix: str
    model: str
    match: Match


def compare_with_log(evidence: Evidence) -> LogComparison | None:
    """Return the basis of the proof of match.

    Parameters
    ----------
    evidence : Evidence
        Steps of the folder.

    Returns
    -------
    LogComparison or None
        Hold-out flights of the last refinement, else a comparison, else the identification; None
        without time histories.
    """
    # Prefer flights that were not used for choosing or fitting the model.
    for kind, suffix, model in (
        (
            "refine",
            "_after",
            (
                "the refined model on hold-out flights, which were used neither for choosing nor"
                " for fitting"
            ),
        ),
        ("compare", "_model", "the model on a flight that it was compared with"),
        (
            "identify",
            "_model",
            (
                "the identified model on the flights that it was identified from: no hold-out"
                " flight is here"
            ),
        ),
    ):
        for step in reversed(evidence.of(kind)):
            segments = [
                s for s in evidence.histories(step) if any(c.endswith(suffix) for c in s.columns)
            ]
            if segments:
                return LogComparison(
                    step, segments, suffix, model, proof_of_match(segments, suffix, _noise(step))
                )
    return None


def _noise(step: Step) -> dict[str, float | None]:
    """Return the noise of each channel from the document of a step."""
    document = step.document
    # Each command stores the noise elsewhere.
    if isinstance(document, Refinement):
        return {c: r.noise_rms for c, r in document.gap.test.channels.items()}
    if isinstance(document, Fit):
        return {c: r.noise for c, r in document.fit.items()}
    assert isinstance(document, Compare)
    return {c: r.noise for c, r in document.channels.items()}


def match_section(title: str, source: LogComparison | None) -> Section:
    """Return the section on the proof of match.

    Parameters
    ----------
    title : str
        Heading.
    source : LogComparison or None
        Basis of the proof; None without time histories.

    Returns
    -------
    Section
        Basis, a row per test, a row per segment, and the worst segment of each test drawn.
    """
    # Without time histories the section says why it is empty.
    if source is None:
        text = (
            "Not in the data: the folder has no time histories of log and model, so none of the"
            f" tests of {REGULATION} is here."
        )
        return Section(title, (Words(text),))
    match = source.match
    intro = (
        f"Judged is {source.model} ({source.step.kind}, {source.step.place}). Start states, sensor"
        " biases and delays of each segment are estimated from that segment. Nothing is filtered:"
        " the sensors' noise is part of what was measured. The controls are those of the log. A"
        " segment counts for a test where the test's control moves and no other does, whatever the"
        " size of the input."
    )
    about = (
        f"Tolerances of {REGULATION}, edition of 1 January 2014, which is written for the"
        " evaluation of full flight simulators. The numbers are used here as a yardstick. Flight"
        " conditions, configurations and the other tests of the table are not looked at. Of two"
        " tolerances for one parameter the less restrictive counts."
    )
    # Summary of the tests before their details and charts.
    blocks: list[Block] = [Words(intro), Words(about, note=True), _summary(match), *_details(match)]
    figures = _figures(source)
    if figures:
        legend = (
            ("dot", "measured"),
            ("fill1", "tolerance about what was measured"),
            ("first", "model"),
        )
        blocks.append(Figures(figures, legend))
    return Section(title, tuple(blocks))


def _summary(match: Match) -> Table:
    """Return the table of tests with their answers."""
    rows = []
    # A test fails if one of its segments fails.
    for test in TESTS:
        results = match.of(test.entry)
        answers = [j.answer for j in results]
        answer = next((a for a in (FAIL, INCONCLUSIVE, PASS) if a in answers), ABSENT)
        words = ", ".join(
            f"{answers.count(a)} {a}" for a in (PASS, FAIL, INCONCLUSIVE) if a in answers
        )
        small = words if results else match.missing.get(test.entry, "")
        rows.append(
            (
                f"{test.entry} {test.title}",
                test.tolerance,
                str(len(results)),
                Cell(answer, _LEVELS[answer], small=small),
            )
        )
    head = ("Test", "Tolerance", "Segments", "Answer")
    return Table(
        "Tests that the flights may contain. A test fails where one of its segments does.",
        head,
        tuple(rows),
    )


def _details(match: Match) -> list[Block]:
    """Return the table of segments, the largest difference over tolerance first."""
    # Worst segment of each test first.
    segments = sorted(match.results, key=lambda j: (j.test.entry, -_worst(j)))
    if not segments:
        return []
    rows = []
    for j in segments[:_MAX_ROWS]:
        differences = "; ".join(_row_words(r) for r in j.rows)
        segment = f"{j.segment.flight}, {j.segment.manoeuvre}, {j.segment.time_s[0]:.1f} s"
        rows.append(
            (j.test.entry, segment, differences, Cell(j.answer, _LEVELS[j.answer], small=j.reason))
        )
    caption = (
        "Segments by test, the largest difference over its tolerance first: greatest difference /"
        " tolerance at that time."
    )
    if len(segments) > _MAX_ROWS:
        caption += f" {_MAX_ROWS} of {len(segments)} segments; dossier --json has all."
    return [Table(caption, ("Test", "Segment", "Greatest difference", "Answer"), tuple(rows))]


def _worst(result: SegmentResult) -> float:
    """Return the largest ratio of difference to tolerance; infinite if none is finite."""
    ratios = [r.ratio for r in result.rows if math.isfinite(r.ratio)]
    return max(ratios, default=math.inf)


def _row_words(row: Row) -> str:
    """Return one compared quantity as text."""
    quantity, unit, factor = shown_channel(row.quantity)
    unit = "" if unit == "-" else f" {unit}"
    # Oscillation periods and dampings are compared as two numbers.
    if math.isfinite(row.measured):
        values = (
            f"measured {format_value(factor * row.measured)}, model"
            f" {format_value(factor * row.model)}"
        )
        return (
            f"{quantity} {values}, tolerance {format_value(factor * row.band)}{unit}: {row.answer}"
        )
    share = "" if row.share == 1.0 else f", {100.0 * row.share:.1f} % inside"
    return (
        f"{quantity} {format_value(factor * abs(row.worst))} /"
        f" {format_value(factor * row.band)}{unit}{share}"
    )


def _figures(source: LogComparison) -> tuple[Figure, ...]:
    """Draw the worst segment of each test."""
    out = []
    for test in TESTS:
        results = source.match.of(test.entry)
        if not results:
            continue
        # Draw the segment with the largest difference over tolerance.
        worst = max(results, key=_worst)
        bands: list[tuple[str, Tolerance | None]] = [(b.channel, b) for b in test.bands]
        if test.oscillation is not None:
            bands = [(test.oscillation.channel, None)]
        for channel, band in bands:
            if (
                channel in worst.segment.columns
                and f"{channel}{source.suffix}" in worst.segment.columns
            ):
                out += _test_figures(worst, channel, band, source.suffix, len(results))
    return tuple(out)


def _test_figures(
    result: SegmentResult, channel: str, band: Tolerance | None, suffix: str, segment_count: int
) -> list[Figure]:
    """Draw measurement and model with the tolerance, and their difference on a separate scale.

    Parameters
    ----------
    result : Judged
        Segment with the largest difference.
    channel : str
        Channel to draw.
    band : Tolerance or None
        Tolerance; None for tests of an oscillation.
    suffix : str
        Ending of the model's columns.
    segment_count : int
        Number of segments of the test.
    """
    segment = result.segment
    quantity, unit, factor = shown_channel(channel)
    measured, model = (factor * segment.columns[c] for c in (channel, f"{channel}{suffix}"))
    name = f"match-{result.test.entry.replace('.', '-')}-{channel}"
    label = (
        f"{result.test.entry} {result.test.title}: {quantity} [{unit}] against time, measured and"
        f" model, {segment.title}."
    )
    selection = (
        f"the worst of {segment_count} segments" if segment_count > 1 else "the only segment"
    )
    caption = f"{result.test.entry}, {quantity}: {segment.manoeuvre}, {selection}"
    # Without a tolerance band both curves share one chart.
    if band is None:
        return [
            _chart(
                name,
                label,
                segment,
                [("dot", measured), ("first", model)],
                None,
                axis_label(channel),
                caption=caption,
            )
        ]
    # The tolerance around the measurement, possibly relative to its size.
    half = factor * limits(band, segment.columns[channel])
    row = next((r for r in result.rows if r.quantity == channel), None)
    share = (
        "" if row is None else f"; {100.0 * row.share:.1f} % of the samples within the tolerance"
    )
    series: list[tuple[str, FloatArray]] = [("dot", measured), ("first", model)]
    gap = f"{quantity} measured minus model [{unit}]"
    return [
        _chart(
            name,
            label,
            segment,
            series,
            (measured - half, measured + half),
            axis_label(channel),
            caption=caption,
        ),
        _chart(
            f"{name}-gap",
            f"{result.test.entry}: {gap}, {segment.title}.",
            segment,
            [("dot", measured - model)],
            (-half, half),
            gap,
            caption=f"The same, measured minus model{share}",
        ),
    ]


def _chart(
    name: str,
    label: str,
    segment: History,
    series: Sequence[tuple[str, FloatArray]],
    band: tuple[FloatArray, FloatArray] | None,
    axis: str,
    *,
    caption: str,
) -> Figure:
    """Draw series of a segment with an optional band."""
    t = segment.time_s
    curves = [*(y for _, y in series), *(band or ())]
    chart = Chart(
        name,
        label,
        Scale("time of the log [s]", float(t[0]), float(t[-1])),
        scale(axis, curves),
        height=160,
    )
    if band is not None:
        chart.band(t, *band, "fill1")
    for kind, y in series:
        if kind == "dot":
            # A few hundred dots per chart.
            few = np.unique(np.linspace(0, y.size - 1, min(y.size, _MAX_DOTS)).round().astype(int))
            chart.dots(t[few], y[few], kind)
        else:
            chart.line(t, y, kind)
    if band is not None and len(series) == 1:
        # The line of dots is thinned, but samples outside the band are all drawn.
        out = (series[0][1] < band[0]) | (series[0][1] > band[1])
        chart.dots(t[out], series[0][1][out], "dotout", radius=1.6)
    return Figure(name, chart.svg(), caption)


_MAX_SOURCES = 120
_MAX_SENTENCES = 24
_MAX_PARAMETERS = 60
_STATES = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "h_m",
)
_CONTROLS = ("elevator", "aileron", "rudder", "throttle")
_TITLES = (
    "Provenance of the model",
    "Proof of match",
    "Credibility",
    "Statements and their assumptions",
    "Validity envelope",
    "What was not done",
    "Sources",
)


@dataclass(frozen=True)
class Dossier:
    """The page, the proof of match (None without time histories) and the missing evidence."""

    page: Page
    source: LogComparison | None
    missing: tuple[str, ...]


def dossier_of(evidence: Evidence) -> Dossier:
    """Return the dossier of a folder's evidence; the same folder gives the same bytes.

    Parameters
    ----------
    evidence : Evidence
        Steps, documents and source files of the folder. Errors met while the sections are built are
        added to its list of missing items.

    Returns
    -------
    Dossier
        Page, proof of match, and what is missing.
    """
    source = compare_with_log(evidence)
    match = Match((), {}) if source is None else source.match
    campaigns = _campaigns(evidence)
    # Build all sections, then the list of what is missing.
    numbered = [f"{k}. {title}" for k, title in enumerate(_TITLES, start=1)]
    histories = {
        s.place: evidence.histories(s)
        for kind in ("identify", "refine", "compare")
        for s in evidence.of(kind)
    }
    sections = [
        _provenance(numbered[0], evidence),
        match_section(numbered[1], source),
        _credibility(numbered[2], evidence, match),
        _statement_section(numbered[3], evidence, campaigns, source),
        _envelope(numbered[4], evidence, histories, campaigns),
        _not_done(numbered[5], evidence, source),
        _sources(numbered[6], evidence),
    ]
    # Last, because building the sections reveals what is missing.
    missing = tuple(evidence.missing)
    front = [Section("Contents", (Bullets(tuple(numbered)),))]
    if missing:
        front.append(Section("Missing or damaged", (Bullets(missing, key=True),)))
    title = f"Dossier: {_name(evidence)}"
    question = (
        "Which flights are the evidence for the model, how well does it match them, and what is"
        " unknown?"
    )
    return Dossier(
        Page(title, question, _verdict(match, missing, evidence), (*front, *sections)),
        source,
        missing,
    )


def _name(evidence: Evidence) -> str:
    """Return the name of aircraft or study."""
    for step in reversed(evidence.steps):
        document = step.document or {}
        if isinstance(document, Manifest):
            return Path(document.settings.campaign.aircraft).name
        if document.get("study") or isinstance(document.get("aircraft"), str):
            return str(document.get("study") or document["aircraft"])
    return "results"


def _verdict(match: Match, missing: Sequence[str], evidence: Evidence) -> tuple[Sentence, ...]:
    """Return the verdict: missing files, simulated flights, and tests passed, failed or absent."""
    sentences = [
        Sentence(
            "This dossier lays out evidence. It claims no compliance with any regulation or"
            " standard."
        )
    ]
    if missing:
        sentences.append(
            Sentence(
                f"The folder is incomplete or damaged: {len(missing)} points, listed below.", "bad"
            )
        )
    for aircraft in simulating_models(evidence):
        sentences.append(
            Sentence(
                f"The flights are simulated with the model {aircraft}, not real.",
                "warn",
            )
        )
    # Answer of each test: fail before inconclusive before pass.
    tests: dict[str, str] = {}
    for test in TESTS:
        answers = [j.answer for j in match.of(test.entry)]
        tests[test.entry] = next((a for a in (FAIL, INCONCLUSIVE, PASS) if a in answers), "")
    counts = {
        a: [e for e, found_answer in tests.items() if found_answer == a]
        for a in (PASS, FAIL, INCONCLUSIVE, "")
    }
    if match.results:
        sentences.append(
            Sentence(
                f"Within tolerance in every segment: {_list(counts[PASS])}.",
                "good" if counts[PASS] else "",
            )
        )
        if counts[FAIL]:
            sentences.append(Sentence(f"Outside tolerance: {_list(counts[FAIL])}.", "bad"))
        if counts[INCONCLUSIVE]:
            sentences.append(Sentence(f"Inconclusive: {_list(counts[INCONCLUSIVE])}.", "warn"))
    sentences.append(
        Sentence(
            f"Not in the data: {_list(counts[''])}, of {len(TESTS)} tests that flights may contain."
        )
    )
    return tuple(sentences)


def _list(names: Sequence[str]) -> str:
    """Join names; "none" for an empty list."""
    return ", ".join(names) if names else "none"


def _provenance(title: str, evidence: Evidence) -> Section:
    """Return the steps and the models they wrote or used."""
    rows = []
    # One row per step with the model that it wrote or used.
    for number, step in enumerate(evidence.steps, start=1):
        model = _model(step)
        digest = Cell(model[:16], code=True) if model else Cell("")
        where = "this folder" if step.place == "." else step.place
        rows.append((f"S{number}", step.kind, where, _outcome(step), digest))
    text = (
        "Steps in the order in which they were made, each with the model that it wrote or used (the"
        " first 16 digits of the SHA-256 over its files). Commands and versions are listed with the"
        " sources."
    )
    blocks: list[Block] = [
        Words(text, note=True),
        Table("Steps.", ("Step", "Command", "Folder", "What it found", "Model"), tuple(rows)),
    ]
    for step, refinement in evidence.results(Refinement):
        blocks += _effects(step, refinement)
    return Section(title, (*blocks, *_parameters(evidence)))


def _parameters(evidence: Evidence) -> list[Block]:
    """Return each parameter at the beginning and after every step that estimated it."""
    fits = [
        s for s in evidence.steps if s.kind in ("identify", "refine") and s.document is not None
    ]
    tables: list[Mapping[str, Any]] = [(s.document or {}).get("parameters", {}) for s in fits]
    names = list(dict.fromkeys(n for table in tables for n in table))
    if not names:
        return []
    # Initial values are those of the first identification.
    initial = next((t for s, t in zip(fits, tables, strict=True) if s.kind == "identify"), {})
    rows: list[tuple[str | Cell, ...]] = []
    for name in names[:_MAX_PARAMETERS]:
        values = [_estimate(table.get(name)) for table in tables]
        rows.append(
            (
                Cell(name, code=True),
                format_value(initial.get(name, {}).get("initial"), ".5g"),
                *values,
            )
        )
    head = ("Parameter", "Initial", *(s.place if s.place != "." else s.kind for s in fits))
    caption = "Parameters from step to step: estimate and standard error."
    if len(names) > _MAX_PARAMETERS:
        caption += f" The first {_MAX_PARAMETERS} of {len(names)}."
    return [Table(caption, head, tuple(rows))]


def _estimate(row: Mapping[str, Any] | None) -> str:
    """Format an estimate with its standard error."""
    if row is None:
        return "not estimated"
    if row.get("status", "identified") != "identified":
        return "not identified"
    return f"{format_value(row.get('value'), '.5g')} ± {format_value(row.get('std'), '.2g')}"


def _model(step: Step) -> str:
    """Return the hash of the model that a step wrote or used; empty if there is none."""
    if isinstance(step.document, BoundsEvidence):
        return step.document.aircraft_sha256
    if isinstance(step.document, Manifest):
        return step.document.hashes["aircraft"]
    if step.kind not in ("identify", "refine"):
        return ""
    try:
        # identify writes the aircraft there, refine one folder further down.
        # identify and refine write an aircraft folder.
        home = step.folder / "aircraft"
        # The aircraft folder itself, or the one below it.
        places = [home, *(p for p in sorted(home.glob("*")) if p.is_dir())]
        return next(
            (
                folder_hash(p)
                for p in places
                if (p / "airframe.toml").is_file() or (p / f"{p.name}.xml").is_file()
            ),
            "",
        )
    except BadInputError:
        return "cannot be read"


def _outcome(step: Step) -> str:
    """Return the outcome of a step as text."""
    document = step.document
    if document is None:
        return "cannot be read"
    if isinstance(document, Fit):
        rows = document.parameters.values()
        identified = sum(r.status == "identified" for r in rows)
        converged = "converged" if document.converged else "did not converge"
        return (
            f"{identified} of {len(rows)} parameters of {document.aircraft} from"
            f" {_list(document.flights)}; {converged}"
        )
    if isinstance(document, Refinement):
        effect_names = "; ".join(e.name for e in document.effects)
        flights = f"chosen on {_list(document.train)}, shown on {_list(document.test)}"
        return f"{document.verdict}: {effect_names or 'no effect'}; {flights}"
    if isinstance(document, Compare):
        return f"{document.aircraft} compared with {document.flight}"
    if isinstance(document, BoundsEvidence):
        return f"intervals for {len(document.coefficients)} coefficients"
    if isinstance(document, Coverage):
        verdicts = "; ".join(f"{c} {v}" for c, v in document.verdicts.items())
        return verdicts or "coverage of the intervals"
    if isinstance(document, Manifest):
        aircraft = Path(document.settings.campaign.aircraft).as_posix()
        return f"{document.cases} flights of {aircraft}"
    return f"study {document['study']}: {document.get('state', 'running')}"


def _effects(step: Step, refinement: Refinement) -> list[Block]:
    """Return the table of effects that a refinement added or withdrew."""
    rows = []
    for decision, effects in (("kept", refinement.effects), ("withdrawn", refinement.withdrawn)):
        for e in effects:
            t = e.evidence.t
            unit = "" if e.unit in (None, "1", "-") else f" {e.unit}"
            value = f"{format_value(e.value, '.4g')} ± {format_value(e.std, '.2g')}{unit}"
            # Alternatives that the flights cannot separate from the effect.
            alike = [a.name.removesuffix(" off") for a in e.alternatives if not a.separable]
            tested = e.test.gap if e.test is not None else "not tested"
            name = Cell(e.name, small=f"confounded with {'; '.join(alike)}" if alike else "")
            where = Cell(e.property or e.subsystem or "", code=True)
            rows.append(
                (
                    name,
                    where,
                    value,
                    format_value(None if t is None else abs(t), ".1f"),
                    tested,
                    decision,
                )
            )
    if not rows:
        return [Words(f"{step.place}: no effect was added to the model.")]
    head = (
        "Effect",
        "In the model as",
        "Estimate",
        "|t| [-]",
        "Gap on the hold-out flights",
        "Kept",
    )
    lines = _lines(step.folder / "model.diff")
    return [
        Table(
            f"Effects that {step.kind} ({step.place}) added; model.diff has {lines} changed lines.",
            head,
            tuple(rows),
        )
    ]


def _lines(path: Path) -> int:
    """Return the number of changed lines of a difference."""
    if not path.is_file():
        return 0
    text = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return sum(line[:1] in "+-" and line[:3] not in ("+++", "---") for line in text if line)


def _credibility(title: str, evidence: Evidence, match: Match) -> Section:
    """Return the evidence by credibility factor."""
    text = (
        f"Factors of credibility after {STANDARD}, with the evidence that this folder holds. No"
        " level is given: that is for those who decide with the model's results. The names of the"
        " factors are to be checked against the edition that applies."
    )
    rows = []
    for factor in factors(evidence, match):
        evidence_text = "; ".join(factor.evidence)
        rows.append((factor.name, factor.about, evidence_text or Cell(NOT_ASSESSED, "warn")))
    return Section(
        title,
        (
            Words(text, note=True),
            Table("Evidence by factor.", ("Factor", "About", "Evidence"), tuple(rows)),
        ),
    )


def _campaigns(evidence: Evidence) -> list[tuple[Step, CampaignReport]]:
    """Return the complete campaigns that can be read; errors are added to the evidence."""
    out = []
    for step in evidence.of("campaign"):
        try:
            out.append((step, read_campaign_report(step.folder)))
        except BadInputError as error:
            evidence.add_error(error)
    return out


def _statements(
    evidence: Evidence, campaigns: Sequence[tuple[Step, CampaignReport]]
) -> list[tuple[str, tuple[Sentence, ...]]]:
    """Return the conclusions of the study, or else the verdicts of the campaigns, by place."""
    statements: list[tuple[str, tuple[Sentence, ...]]] = []
    for _, study in evidence.results(Study):
        conclusions = tuple(Sentence(v.text, level_of(v.level)) for v in study.verdict or ())
        statements += [("study", conclusions)] if conclusions else []
    return statements or [(step.place, campaign.verdict) for step, campaign in campaigns]


def _statement_section(
    title: str,
    evidence: Evidence,
    campaigns: Sequence[tuple[Step, CampaignReport]],
    source: LogComparison | None,
) -> Section:
    """Return the statements and their assumptions."""
    blocks: list[Block] = []
    statements = _statements(evidence, campaigns)
    for where, sentences in statements:
        head = (
            "The study's own sentences:"
            if where == "study"
            else f"Campaign {where}:"
            if where != "."
            else "The campaign:"
        )
        blocks += [Words(head), Sentences(sentences[:_MAX_SENTENCES])]
        if len(sentences) > _MAX_SENTENCES:
            blocks.append(
                Words(
                    f"{len(sentences) - _MAX_SENTENCES} further sentences are in report.html.",
                    note=True,
                )
            )
    if not statements:
        blocks.append(
            Words("No statement about performance is in the folder: it holds no complete campaign.")
        )
    blocks += [
        Words("They hold under these assumptions:"),
        Bullets(tuple(_assumptions(evidence, source))),
    ]
    return Section(title, tuple(blocks))


def _assumptions(evidence: Evidence, source: LogComparison | None) -> list[str]:
    """Return the assumptions on which the statements rest."""
    lines = [
        "The aircraft is as it was in the flights: mass, centre of gravity, configuration, servos."
    ]
    if source is not None:
        lines.append(
            "Sensors are where the aircraft's card puts them, and their noise is white with the"
            " standard deviations estimated."
        )
    if evidence.of("bounds"):
        lines.append(
            "Outside the flight states of the flights that they were made from, intervals of the"
            " model's error are extrapolated."
        )
    for step, manifest in evidence.results(Manifest):
        # Turbulence model, flight length and uncertainty of each campaign.
        air = manifest.settings.aleatory
        lines.append(
            f"{step.place if step.place != '.' else 'Campaign'}: Dryden turbulence"
            f" ({air.turbulence_source}), steady wind; flights of {air.duration_s:g} s; the"
            f" model's error lies within its bounds ({manifest.settings.epistemic.method})."
        )
    return lines


def _envelope(
    title: str,
    evidence: Evidence,
    histories: Mapping[str, Sequence[History]],
    campaigns: Sequence[tuple[Step, CampaignReport]],
) -> Section:
    """Return the range of flight states that flights cover."""
    shares = _extrapolated(campaigns)
    columns = [
        (s, histories.get(s.place, ()))
        for kind in ("identify", "refine", "compare")
        for s in evidence.of(kind)
    ]
    columns = [(s, h) for s, h in columns if h]
    if not columns:
        return Section(
            title,
            (
                Words(
                    "The folder has no time histories, so it tells no envelope of flight states."
                ),
                *shares,
            ),
        )
    rows = []
    for name in (*_STATES, *_CONTROLS):
        # Range of each state in the segments of each step.
        cells = [_range(name, segments) for _, segments in columns]
        if any(cells):
            quantity, unit, _ = shown_channel(name)
            rows.append((f"{quantity} [{unit}]", *(c or "not recorded" for c in cells)))
    flights = {
        "identify": "identified from",
        "refine": "shown on (hold-out)",
        "compare": "compared with",
    }
    head = (
        "Quantity",
        *(f"{s.place if s.place != '.' else s.kind}: {flights[s.kind]}" for s, _ in columns),
    )
    text = (
        "Smallest and largest measured values of the segments. Outside them no flight supports the"
        " model."
    )
    return Section(
        title,
        (Words(text, note=True), Table("Envelope box of the flights.", head, tuple(rows)), *shares),
    )


def _extrapolated(campaigns: Sequence[tuple[Step, CampaignReport]]) -> list[Block]:
    """Return the share of each campaign's time outside the flight states of its bounds."""
    rows: dict[tuple[str, str], str] = {}
    for step, campaign in campaigns:
        for statement in campaign.signed:
            where = step.place if step.place != "." else step.kind
            # Constant bounds have no envelope, so nothing is recorded.
            share = statement.extrapolated_share
            words = (
                "not recorded: its bounds are constants or have no envelope"
                if math.isnan(share)
                else percent(share, ".2g")
            )
            rows[where, statement.cell.condition.label] = words
    if not rows:
        return []
    head = ("Campaign", "Condition", "Outside [%]")
    caption = "Share of the simulated time outside the flight states of the bounds' data."
    return [Table(caption, head, tuple((*key, value) for key, value in rows.items()))]


def _range(name: str, segments: Sequence[History]) -> str:
    """Format the range of a channel over segments; empty if it is not recorded."""
    factor = shown_channel(name)[2]
    values = [s.columns[name][np.isfinite(s.columns[name])] for s in segments if name in s.columns]
    finite = np.concatenate(values) if values else np.empty(0)
    return f"{factor * finite.min():.3g} to {factor * finite.max():.3g}" if finite.size else ""


def _not_done(title: str, evidence: Evidence, source: LogComparison | None) -> Section:
    """Return the list of tests, steps and assessments that are missing."""
    # Tests of the proof of match that the flights do not allow.
    lines = [
        f"{t.entry} {t.title}: {source.match.missing[t.entry]}."
        for t in TESTS
        if source and t.entry in source.match.missing
    ]
    if source is None:
        lines.append(
            "No test of the proof of match: the folder has no time histories of log and model."
        )
    lines.append(
        f"Tests of {REGULATION} on the ground, at take-off and landing, of engines, control forces"
        " and failures."
    )
    # Steps of the chain without results in the folder.
    for kind, words in (
        ("identify", "identification"),
        ("refine", "refinement"),
        ("bounds", "bounds of the model's error"),
        ("validate-bounds", "validation of bounds on a new flight"),
        ("campaign", "campaign"),
    ):
        if not evidence.of(kind):
            lines.append(f"No {words} is in this folder.")
    # What the results themselves leave open.
    for _, fit in evidence.results(Fit):
        unidentified = [n for n, r in fit.parameters.items() if r.status != "identified"]
        lines += (
            [f"Not identified, left at their initial values: {', '.join(unidentified)}."]
            if unidentified
            else []
        )
    for step, refinement in evidence.results(Refinement):
        if refinement.remaining.unexplained:
            lines.append(f"{step.place}: a residual remains that no effect explains.")
    lines += [
        f"{f.name}: {NOT_ASSESSED}."
        for f in factors(evidence, Match((), {}) if source is None else source.match)
        if not f.evidence
    ]
    # Simulated flights are no evidence about a real aircraft.
    if simulating_models(evidence):
        lines.append("No flight of a real aircraft.")
    return Section(title, (Bullets(tuple(lines)),))


def _sources(title: str, evidence: Evidence) -> Section:
    """Return commands and source files with hashes."""
    commands = tuple(
        (f"S{k}", Cell(s.command or "not recorded", code=True), s.version or "not recorded")
        for k, s in enumerate(evidence.steps, start=1)
    )
    rows = tuple(
        (
            Cell(s.file, code=True),
            Cell(s.sha256, code=True),
            _step_of(evidence, s.file),
            s.version or "not recorded",
        )
        for s in evidence.sources[:_MAX_SOURCES]
    )
    caption = f"Files with their SHA-256. {len(evidence.sources)} files"
    caption += (
        "."
        if len(evidence.sources) <= _MAX_SOURCES
        else f", the first {_MAX_SOURCES} of which are listed; dossier --json has all."
    )
    text = (
        f"Written by uqharness {__version__} from the files below only; nothing was simulated or"
        " fitted for it."
    )
    blocks = (
        Words(text, note=True),
        Table("Commands.", ("Step", "Command", "Version of uqharness"), commands),
        Table(caption, ("File", "SHA-256", "Command", "Version"), rows),
    )
    return Section(title, blocks)


def _step_of(evidence: Evidence, file: str) -> str:
    """Return the step in whose folder a file lies, the deepest first."""
    best, name = -1, ""
    for number, step in enumerate(evidence.steps, start=1):
        # A deeper folder is more specific.
        depth = 0 if step.place == "." else len(Path(step.place).parts)
        if depth > best and (depth == 0 or Path(file).is_relative_to(step.place)):
            best, name = depth, f"S{number}"
    return name
