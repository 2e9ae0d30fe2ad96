"""Build the page of an identification, from fit.json and histories.parquet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from sysid.estimation import STRONG_SHARE, WHITENESS_LEVEL
from uqharness.identification import LIMIT
from uqharness.replay import (
    CHANNELS,
    HISTORIES,
    History,
    read_histories,
    shown_channel,
    with_shown_names,
)
from uqharness.report.history import MAX_SEGMENTS, Model, file_name, history_section
from uqharness.report.parts import (
    Bullets,
    Cell,
    Figure,
    Figures,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    is_wanted,
    provenance,
    remarks,
)
from uqharness.report.svg import Scale, rows_chart
from uqharness.results.base import read_result
from uqharness.results.identification import Fit, FitChannel, Parameter

FIT = "fit.json"
FILTER, EQUATION = "filter error", "equation error"
_NOT_COVERED = (
    ". Standard errors assume that the model form is correct. Next: compare, bounds or refine."
)


def identify_page(
    folder: Path,
    prefix: str = "",
    segments: int | None = MAX_SEGMENTS,
    only: Collection[str] | None = None,
) -> Page:
    """Return the page of a folder that ``uqharness identify`` wrote.

    Parameters
    ----------
    folder : Path
        Folder of results.
    prefix : str
        Prefix of figure names.
    segments : int, optional
        Number of segments with histories; None for all.
    only : collection of str, optional
        Titles of the sections to build; default: all.

    Raises
    ------
    BadInputError
        If the folder cannot be read.
    """
    return identify_page_of(
        read_result(folder / FIT, Fit), read_histories(folder / HISTORIES), prefix, segments, only
    )


def identify_page_of(
    fit: Fit,
    histories: Sequence[History] = (),
    prefix: str = "",
    segments: int | None = MAX_SEGMENTS,
    only: Collection[str] | None = None,
) -> Page:
    """Return the page of an identification from its document and the replayed segments.

    The other parameters are those of `identify_page`.
    """
    # Parameters and fit first, then the segments with the largest residuals.
    sections = [_parameter_section(fit.parameters, prefix), _fit_section(fit.fit)]
    noise = {c: row.noise for c, row in fit.fit.items()}
    model = Model("_model", "first", "model with the estimates")
    if is_wanted(title := "Log against model", only):
        sections += history_section(
            histories,
            noise,
            [model],
            title,
            f"{prefix}fit-",
            segments,
            file=lambda _, h: file_name(f"{h.flight}-{h.number:02d}-{h.manoeuvre}"),
        )
    remark_texts = {
        key: [with_shown_names(text, CHANNELS) for text in texts]
        for key, texts in (("warnings", fit.warnings), ("notes", fit.notes))
    }
    sections += [*remarks(remark_texts, key=("notes",)), _provenance(fit)]
    question = (
        f"Which values of {len(fit.parameters)} parameters of {fit.aircraft} agree with"
        f" {', '.join(fit.flights)}, and how accurately?"
    )
    return Page(f"Identification of {fit.aircraft}", question, _verdict(fit), tuple(sections))


def _verdict(fit: Fit) -> tuple[Sentence, ...]:
    """Return convergence, the number of identified parameters, and the quality of the fit."""
    parameters = fit.parameters
    # Estimates that were refused keep their initial values.
    identified = [n for n, row in parameters.items() if row.is_identified]
    missing = [n for n in parameters if n not in identified]
    sentences = [
        (
            Sentence(f"Estimation converged ({fit.method or 'method not recorded'}).")
            if fit.converged
            else Sentence("Estimation did not converge: the estimates below are not valid.", "bad")
        )
    ]
    if missing:
        text = (
            f"{len(identified)} of {len(parameters)} parameters are identified; not identified:"
            f" {', '.join(missing)}."
        )
        sentences.append(Sentence(text, "warn" if identified else "bad"))
    else:
        sentences.append(Sentence(f"All {len(parameters)} parameters are identified."))
    if fit.method == FILTER:
        sentences += _filter_residual_sentences(fit.fit, bool(identified))
    # Equation error is not a fit of replays, which lack the gusts: their residuals are no test.
    elif fit.method != EQUATION:
        sentences += _output_residual_sentences(fit.fit)
    return tuple(sentences)


def _output_residual_sentences(channels: Mapping[str, FitChannel]) -> list[Sentence]:
    """Return whether the residuals of output error are at the noise of the sensors."""
    # Channels whose residuals exceed the noise point to a missing term.
    ratios = {c: row.ratio_to_noise for c, row in channels.items()}
    above = {c: r for c, r in ratios.items() if r is not None and r > LIMIT}
    if above:
        worst = ", ".join(
            f"{shown_channel(c)[0]} {r:.2f}"
            for c, r in sorted(above.items(), key=lambda item: -item[1])
        )
        text = (
            "The model with the estimates does not reach the sensors' noise: rms over noise is"
            f" {worst}."
        )
        return [
            Sentence(
                f"{text} A model term is missing: these parameters cannot remove the"
                f" residual{_NOT_COVERED}",
                "warn",
            )
        ]
    if any(r is not None for r in ratios.values()):
        return [
            Sentence(f"Every channel with known noise is within {LIMIT:g} times its noise.", "good")
        ]
    return []


def _filter_residual_sentences(
    channels: Mapping[str, FitChannel], identified: bool
) -> list[Sentence]:
    """Return whether the innovations of filter error are white.

    Their size is not a criterion, because it contains the gusts of a sample.
    """
    # Bonferroni over the channels.
    level = WHITENESS_LEVEL / max(len(channels), 1)
    coloured = {
        c: share
        for c, row in channels.items()
        if row.whiteness_p is not None
        and row.whiteness_p < level
        and (share := row.predictable_share or 0.0) > STRONG_SHARE
    }
    if coloured:
        worst = ", ".join(
            f"{shown_channel(c)[0]} {100.0 * s:.0f} %"
            for c, s in sorted(coloured.items(), key=lambda item: -item[1])
        )
        text = (
            "Filter error does not explain the flights: its innovations can be predicted from"
            f" their past: {worst}."
        )
        return [
            Sentence(
                f"{text} A model term, or the noise of a state, is missing{_NOT_COVERED}", "warn"
            )
        ]
    if not identified:
        # White innovations do not confirm a model whose estimates were refused for another reason.
        return [Sentence("Filter error's innovations are white.")]
    return [
        Sentence(
            "Filter error's innovations are white: model and process noise explain the flights.",
            "good",
        )
    ]


def _parameter_section(parameters: Mapping[str, Parameter], prefix: str) -> Section:
    """Return the table of parameters and the chart of their changes."""
    rows = []
    notes = _shared_reasons(parameters)
    for name, row in parameters.items():
        # A reason that several parameters share becomes a numbered note.
        reason = row.reason or ""
        text = f"{row.status} ({notes.index(reason) + 1})" if reason in notes else row.status
        status = Cell(text, "" if row.is_identified else "warn", "" if reason in notes else reason)
        errors = (
            (format_value(row.std, ".2g"), format_value(row.std_crb, ".2g"))
            if row.is_identified
            else ("not identified", "not identified")
        )
        # Parameters keep the unit of the XML.
        value = format_value(row.value, ".5g")
        rows.append(
            (Cell(name, code=True), format_value(row.initial, ".5g"), value, *errors, status)
        )
    head = (
        "Parameter",
        "Initial value",
        "Estimate",
        "Standard error",
        "Cramér-Rao bound",
        "Status",
    )
    table = Table("Parameters in the unit that the XML declares.", head, tuple(rows), key=True)
    words = Words(
        "The standard error allows for coloured residuals, the Cramér-Rao bound does not."
        " Parameters that are not identified keep their initial values.",
        note=True,
    )
    figure = _change(parameters, prefix)
    figures = (Figures((figure,)),) if figure else ()
    lines = tuple(f"({number}) {reason}" for number, reason in enumerate(notes, 1))
    reasons = (Bullets(lines, key=True),) if lines else ()
    return Section("Parameters", (words, *figures, table, *reasons))


def _shared_reasons(parameters: Mapping[str, Parameter]) -> list[str]:
    """Return reasons that several parameters share; a note below the table gives each once."""
    count = Counter(row.reason for row in parameters.values() if row.reason)
    return [reason for reason, times in count.items() if times > 1]


def _change(parameters: Mapping[str, Parameter], prefix: str) -> Figure | None:
    """Draw the change of each identified parameter from its initial value [%], with 95 % limits."""
    rows = [
        (
            name.removeprefix("aero/"),
            100.0 * (r.value / r.initial - 1.0),
            196.0 * r.std / abs(r.initial),
        )
        for name, r in parameters.items()
        if r.is_identified and r.value is not None and r.initial and r.std is not None
    ]
    if not rows:
        return None
    # Symmetric axis; huge changes are left to the table.
    reach = min(150.0, max(5.0, 1.1 * max(abs(change) + half for _, change, half in rows)))
    outside_frame = sum(abs(change) > reach for _, change, _ in rows)
    label = f"Change of {len(rows)} parameters from their initial values [%], with 95 % intervals."
    x = Scale("change from the initial value [%]", -reach, reach)
    chart = rows_chart(f"{prefix}parameters", label, x, [name for name, _, _ in rows], 14)
    chart.upright(0.0, "zero")
    for k, (_, change, half) in enumerate(rows):
        chart.across(change - half, change + half, k, "plain")
        chart.marker(change, float(k), "first", "disc")
    note = f" {outside_frame} beyond the frame: see the table." if outside_frame else ""
    caption = (
        "Change of the identified parameters that had an initial value [%]; bars: 95 %"
        f" intervals.{note}"
    )
    return Figure(chart.name, chart.svg(), caption)


def _fit_section(fit: Mapping[str, FitChannel]) -> Section:
    """Return the residuals by channel."""
    rows = []
    for channel, row in fit.items():
        quantity, unit, factor = shown_channel(channel)
        ratio = row.ratio_to_noise
        level = (
            Cell("undefined")
            if ratio is None
            else Cell(f"{ratio:.2f}", "good" if ratio <= LIMIT else "warn")
        )
        rms, noise = (None if x is None else factor * x for x in (row.rms, row.noise))
        tint = (
            format_value(row.whiteness_p, ".2g"),
            format_value(row.predictable_share, ".2f"),
        )
        rows.append((f"{quantity} [{unit}]", format_value(rms), format_value(noise), level, *tint))
    head = (
        "Channel",
        "rms of log minus model",
        "Noise",
        "Ratio",
        "Whiteness p",
        "Share predictable from its past",
    )
    return Section(
        "Fit by channel",
        (Table("Residuals by channel.", head, tuple(rows)),),
    )


def _provenance(fit: Fit) -> Section:
    """Return command, method, hashes of the flights, and effort."""
    items = [
        ("Command", fit.command or "not recorded"),
        ("Method", fit.method or "not recorded"),
    ]
    # Older documents have no hashes.
    hashes = fit.flights_sha256 or []
    items += [
        (f"Flight {name} (SHA-256)", digest)
        for name, digest in zip(fit.flights, hashes, strict=False)
    ]
    if fit.simulations is not None:
        effort = f"{fit.simulations} simulations, {format_value(fit.seconds, '.1f')} s"
        items.append(("Effort", effort))
    items.append(
        (
            "Files",
            (
                "fit.json, parameters.csv, histories.parquet, aircraft/ (the XML with the"
                " estimates), next to this page"
            ),
        )
    )
    return provenance(*items)
