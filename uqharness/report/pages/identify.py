"""Build the page of an identification and write its files.

The page comes from fit.json and histories.parquet; `write_results` writes fit.json, the parameter
table, histories and the aircraft with the estimates.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sysid.estimation import STRONG_SHARE, WHITENESS_LEVEL, colour, rms
from uqharness.files import finite, write_json, write_text
from uqharness.identification import Identification
from uqharness.plugin import Estimate, write_estimates
from uqharness.replay import (
    CHANNELS,
    CONTROLS,
    HISTORIES,
    columns_of,
    read_histories,
    shown_channel,
    with_shown_names,
    write_histories,
)
from uqharness.report.history import MOST_SEGMENTS, Model, file_name, history_section
from uqharness.report.pages.compare import LIMIT
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
from uqharness.results.base import read_document
from uqharness.results.identification import Fit
from uqharness.simulator import Aircraft
from uqharness.text_tables import csv_text

FIT = "fit.json"
_IDENTIFIED = "identified"
FILTER = "filter error"
_NOT_COVERED = (
    ", and standard errors, which take the model for right, do not say how far off the estimates"
    " are. Next: compare, bounds or refine."
)


def identify_page(
    folder: Path,
    prefix: str = "",
    segments: int | None = MOST_SEGMENTS,
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
    fit = read_document(folder / FIT, Fit)
    parameters = fit["parameters"]
    # Parameters and fit first, then the segments with the largest residuals.
    sections = [_parameter_section(parameters, prefix), _fit_section(fit["fit"])]
    noise = {c: row.get("noise") for c, row in fit["fit"].items()}
    model = Model("_model", "first", "model with the estimates")
    histories = read_histories(folder / HISTORIES)
    if is_wanted(title := "Log against model", only):
        sections += history_section(
            histories,
            noise,
            [model],
            title,
            f"{prefix}fit-",
            segments,
            lambda _, h: file_name(f"{h.flight}-{h.number:02d}-{h.manoeuvre}"),
        )
    remark_texts = {
        key: [with_shown_names(text, CHANNELS) for text in fit.get(key, ())]
        for key in ("warnings", "notes")
    }
    sections += [*remarks(remark_texts), _provenance(fit)]
    flights = ", ".join(fit["flights"])
    question = (
        f"Which values of {len(parameters)} parameters of {fit['aircraft']} agree with {flights},"
        " and how accurately?"
    )
    return Page(f"Identification of {fit['aircraft']}", question, _verdict(fit), tuple(sections))


def _verdict(fit: Mapping[str, Any]) -> tuple[Sentence, ...]:
    """Return convergence, the number of identified parameters, and the quality of the fit."""
    parameters = fit["parameters"]
    # Estimates that were refused keep their initial values.
    identified = [n for n, row in parameters.items() if row["status"] == _IDENTIFIED]
    missing = [n for n in parameters if n not in identified]
    sentences = [
        (
            Sentence(f"Estimation converged ({fit.get('method', 'method not recorded')}).")
            if fit.get("converged")
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
    sentences += (
        _filter_residual_sentences(fit["fit"], bool(identified))
        if fit.get("method") == FILTER
        else _output_residual_sentences(fit["fit"])
    )
    return tuple(sentences)


def _output_residual_sentences(channels: Mapping[str, Mapping[str, Any]]) -> list[Sentence]:
    """Return whether the residuals of output error are at the noise of the sensors."""
    # Channels whose residuals exceed the noise point to a missing term.
    ratios = {c: _ratio(row) for c, row in channels.items()}
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
    channels: Mapping[str, Mapping[str, Any]], identified: bool
) -> list[Sentence]:
    """Return whether the innovations of filter error are white.

    Their size is not a criterion, because it contains the gusts of a sample.
    """
    # Bonferroni over the channels.
    level = WHITENESS_LEVEL / max(len(channels), 1)
    coloured = {
        c: row["predictable_share"]
        for c, row in channels.items()
        if row.get("whiteness_p") is not None
        and row["whiteness_p"] < level
        and (row.get("predictable_share") or 0.0) > STRONG_SHARE
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
            "Filter error's innovations are white: the model and the process noise found explain"
            " the flights.",
            "good",
        )
    ]


def _ratio(row: Mapping[str, Any]) -> float | None:
    """Return residual rms over noise; None if one of them is unknown."""
    return row["rms"] / row["noise"] if row.get("rms") is not None and row.get("noise") else None


def _parameter_section(parameters: Mapping[str, Mapping[str, Any]], prefix: str) -> Section:
    """Return the table of parameters and the chart of their changes."""
    rows = []
    notes = _shared_reasons(parameters)
    for name, row in parameters.items():
        is_identified = row["status"] == _IDENTIFIED
        # A reason that several parameters share becomes a numbered note.
        reason = row.get("reason") or ""
        text = f"{row['status']} ({notes.index(reason) + 1})" if reason in notes else row["status"]
        status = Cell(text, "" if is_identified else "warn", "" if reason in notes else reason)
        errors = (
            (format_value(row["std"], ".2g"), format_value(row["std_crb"], ".2g"))
            if is_identified
            else ("not identified", "not identified")
        )
        # Parameters keep the unit of the XML.
        value = format_value(row["value"], ".5g")
        rows.append(
            (Cell(name, code=True), format_value(row.get("initial"), ".5g"), value, *errors, status)
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
        "The standard error allows for coloured residuals, the Cramér-Rao bound does not. What is"
        " not identified keeps its initial value.",
        note=True,
    )
    figure = _change(parameters, prefix)
    figures = (Figures((figure,)),) if figure else ()
    lines = tuple(f"({number}) {reason}" for number, reason in enumerate(notes, 1))
    reasons = (Bullets(lines, key=True),) if lines else ()
    return Section("Parameters", (words, *figures, table, *reasons))


def _shared_reasons(parameters: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return reasons that several parameters share; a note below the table gives each once."""
    count = Counter(row["reason"] for row in parameters.values() if row.get("reason"))
    return [reason for reason, times in count.items() if times > 1]


def _change(parameters: Mapping[str, Mapping[str, Any]], prefix: str) -> Figure | None:
    """Draw the change of each identified parameter from its initial value [%], with 95 % limits."""
    rows = [
        (
            name.removeprefix("aero/"),
            100.0 * (r["value"] / r["initial"] - 1.0),
            196.0 * r["std"] / abs(r["initial"]),
        )
        for name, r in parameters.items()
        if r["status"] == _IDENTIFIED and r.get("initial") and r.get("std") is not None
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


def _fit_section(fit: Mapping[str, Mapping[str, Any]]) -> Section:
    """Return the residuals by channel."""
    rows = []
    for channel, row in fit.items():
        quantity, unit, factor = shown_channel(channel)
        ratio = _ratio(row)
        level = (
            Cell("undefined")
            if ratio is None
            else Cell(f"{ratio:.2f}", "good" if ratio <= LIMIT else "warn")
        )
        rms, noise = (None if row.get(k) is None else factor * row[k] for k in ("rms", "noise"))
        tint = (
            format_value(row.get("whiteness_p"), ".2g"),
            format_value(row.get("predictable_share"), ".2f"),
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
        (Table("What is left between log and model, by channel.", head, tuple(rows)),),
    )


def _provenance(fit: Mapping[str, Any]) -> Section:
    """Return command, method, hashes of the flights, and effort."""
    items = [
        ("Command", fit.get("command") or "not recorded"),
        ("Method", fit.get("method", "not recorded")),
    ]
    # Older documents have no hashes.
    hashes = fit.get("flights_sha256") or []
    items += [
        (f"Flight {name} (SHA-256)", digest)
        for name, digest in zip(fit["flights"], hashes, strict=False)
    ]
    if fit.get("simulations") is not None:
        items.append(
            (
                "Effort",
                f"{fit['simulations']} simulations, {format_value(fit.get('seconds'), '.1f')} s",
            )
        )
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


# Files of an identification.


def fit_document(
    identification: Identification,
    flights: Sequence[str],
    command: Sequence[str],
    hashes: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the content of fit.json (docs/identification.md); numbers that are not finite are
    null.

    Parameters
    ----------
    identification : Identification
        Result.
    flights : sequence of str
        Names of the flights.
    command : sequence of str
        Command line.
    hashes : sequence of str
        SHA-256 of the flight files.
    """
    names = identification.identified
    # Residuals of all segments, channel by channel.
    residual = [
        np.concatenate([block[:, k] for block in identification.residual])
        for k in range(len(identification.outputs))
    ]
    # Whiteness of the residuals, with the model output as context.
    tint = colour(list(identification.residual), list(identification.modelled))
    fit = {}
    for k, channel in enumerate(identification.outputs):
        fit[channel] = {
            "rms": finite(rms(residual[k])),
            "noise": finite(identification.noise[channel]),
            "whiteness_p": finite(tint.p_value[k]),
            "predictable_share": finite(tint.predictable[k]),
        }
    return {
        "aircraft": identification.aircraft,
        "method": identification.method,
        "converged": identification.converged,
        "parameters": {
            n: {
                "value": finite(identification.theta[i]),
                "std": finite(identification.std[i]),
                "std_crb": finite(identification.std_crb[i]),
                "status": identification.status[n],
                "reason": identification.reason[n],
                "initial": finite(identification.initial[i]),
            }
            for i, n in enumerate(identification.names)
        },
        "names": list(names),
        "cov": [[float(v) for v in row] for row in identification.cov],
        "warnings": list(identification.warnings),
        "fit": fit,
        "nuisance": {
            n: {"value": finite(v), "std": finite(s)}
            for n, (v, s) in identification.nuisance.items()
        },
        "segments": [
            {
                "flight": s.flight,
                "label": s.label,
                "start_s": float(s.time_s[0]),
                "end_s": float(s.time_s[-1]),
            }
            for s in identification.segments
        ],
        "flights": list(flights),
        "flights_sha256": list(hashes),
        "notes": list(identification.notes),
        "command": shlex.join(command),
        "simulations": identification.simulations,
        "seconds": round(identification.seconds, 2),
        "speed": (
            None
            if identification.speed is None
            else {k: round(v, 1) for k, v in asdict(identification.speed).items()}
        ),
    }


def parameter_rows(identification: Identification) -> list[dict[str, str]]:
    """Return the table of parameters as text.

    The columns are those of Table 2.6 of the dissertation: initial value, estimate, corrected
    standard error, Cramér-Rao bound, status.
    """
    rows = []
    for i, name in enumerate(identification.names):
        is_identified = identification.status[name] == "identified"
        rows.append(
            {
                "parameter": name,
                "initial": f"{identification.initial[i]:.5g}",
                "estimate": f"{identification.theta[i]:.5g}",
                "std": f"{identification.std[i]:.2g}" if is_identified else "",
                "crb": f"{identification.std_crb[i]:.2g}" if is_identified else "",
                "status": identification.status[name],
                "reason": identification.reason[name],
            }
        )
    return rows


def write_results(
    identification: Identification,
    aircraft: Aircraft,
    flights: Sequence[str],
    command: Sequence[str],
    out: Path,
    hashes: Sequence[str] = (),
) -> dict[str, Any]:
    """Write fit.json, parameters.csv, histories.parquet and aircraft/; return the document.

    Parameters
    ----------
    identification : Identification
        Result.
    aircraft : Aircraft
        Aircraft whose XML receives the estimates.
    flights : sequence of str
        Names of the flights.
    command : sequence of str
        Command line.
    out : Path
        Folder.
    hashes : sequence of str
        SHA-256 of the flight files; bounds use them to recognise flights of the identification.

    Raises
    ------
    BadInputError
        If a file cannot be written.
    """
    document = fit_document(identification, flights, command, hashes)
    # Only identified parameters are written into the XML.
    estimates = {
        n: Estimate(
            float(identification.theta[i]),
            f"{identification.theta[i]:.4g} +/- {identification.std[i]:.2g} by"
            f" {identification.method} from {', '.join(flights)}: uqharness identify",
        )
        for i, n in enumerate(identification.names)
        if identification.status[n] == "identified"
    }
    # Parameters that the XML does not declare are reported.
    unwritten = write_estimates(aircraft, estimates, out / "aircraft")
    if unwritten:
        document["warnings"].append(
            "not written into the XML, which does not declare them as <property value=...>:"
            f" {', '.join(unwritten)}"
        )
    write_text(out / "parameters.csv", csv_text(parameter_rows(identification)))
    write_histories(
        out,
        identification.segments,
        {
            **columns_of(identification.outputs, identification.measured),
            **columns_of(identification.outputs, identification.modelled, "_model"),
            **columns_of(CONTROLS, [s.controls for s in identification.segments]),
        },
    )
    write_json(out / "fit.json", document)
    return document
