"""The page of an identification, from fit.json and histories.parquet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uqharness.replay.channel_units import shown_channel
from uqharness.replay.histories import HISTORIES, read_histories
from uqharness.report.history import MOST_SEGMENTS, Model, history_section
from uqharness.report.parts import Bullets, Cell, Facts, Figure, Figures, Page, Say, Section, Table, Words, shown
from uqharness.report.svg import Chart, Scale
from uqharness.result_documents import Fit, read_document

FIT = "fit.json"
NEAR_NOISE = 1.15
_IDENTIFIED = "identified"


def identify_page(folder: Path, prefix: str = "", segments: int = MOST_SEGMENTS) -> Page:
    """The page of the folder that ``uqharness identify`` wrote. Raises BadInputError."""
    fit = read_document(folder / FIT, Fit)
    parameters = fit["parameters"]
    sections = [_parameter_section(parameters, prefix), _fit_section(fit["fit"])]
    noise = {c: row.get("noise") for c, row in fit["fit"].items()}
    model = Model("_model", "first", "model with the estimates")
    histories = history_section(
        read_histories(folder / HISTORIES), noise, [model], "Log against model", prefix=f"{prefix}fit-", most=segments
    )
    if histories is not None:
        sections.append(histories)
    said = (*fit.get("warnings", ()), *fit.get("notes", ()))
    if said:
        sections.append(Section("Warnings and notes", (Bullets(tuple(said)),)))
    sections.append(_provenance(fit))
    flights = ", ".join(fit["flights"])
    asked = f"Which values of {len(parameters)} parameters of {fit['aircraft']} agree with {flights}, and how surely?"
    return Page(f"Identification of {fit['aircraft']}", asked, _verdict(fit), tuple(sections))


def _verdict(fit: Mapping[str, Any]) -> tuple[Say, ...]:
    parameters = fit["parameters"]
    known = [n for n, row in parameters.items() if row["status"] == _IDENTIFIED]
    missing = [n for n in parameters if n not in known]
    said = [
        Say(f"The estimation settled ({fit.get('method', 'method not recorded')}).", "good")
        if fit.get("converged")
        else Say("The estimation did not settle: nothing below is an answer.", "bad")
    ]
    if missing:
        text = f"{len(known)} of {len(parameters)} parameters are identified; not identified: {', '.join(missing)}."
        said.append(Say(text, "warn" if known else "bad"))
    else:
        said.append(Say(f"All {len(parameters)} parameters are identified.", "good"))
    ratios = {c: _ratio(row) for c, row in fit["fit"].items()}
    above = {c: r for c, r in ratios.items() if r is not None and r > NEAR_NOISE}
    if above:
        worst = ", ".join(f"{shown_channel(c)[0]} {r:.2f}" for c, r in sorted(above.items(), key=lambda item: -item[1]))
        text = f"The model with the estimates does not reach the sensors' noise: rms over noise is {worst}."
        said.append(
            Say(
                f"{text} Something that no parameter can be is missing: compare, bounds and refine go on from here.",
                "warn",
            )
        )
    elif any(r is not None for r in ratios.values()):
        said.append(Say(f"Every channel with known noise is within {NEAR_NOISE:g} times its noise.", "good"))
    return tuple(said)


def _ratio(row: Mapping[str, Any]) -> float | None:
    return row["rms"] / row["noise"] if row.get("rms") is not None and row.get("noise") else None


def _parameter_section(parameters: Mapping[str, Mapping[str, Any]], prefix: str) -> Section:
    rows = []
    for name, row in parameters.items():
        known = row["status"] == _IDENTIFIED
        status = Cell(row["status"], "good" if known else "warn", row.get("reason") or "")
        spread = (shown(row["std"], ".2g"), shown(row["std_crb"], ".2g")) if known else ("not identified", "not identified")
        value = shown(row["value"], ".5g")
        rows.append((Cell(name, code=True), shown(row.get("initial"), ".5g"), value, *spread, status))
    head = ("Parameter", "Initial value", "Estimate", "Standard error", "Cramér-Rao bound", "Status")
    table = Table("Parameters in the unit that the XML declares.", head, tuple(rows))
    words = Words(
        "The standard error allows for coloured residuals, the Cramér-Rao bound does not. What is not identified keeps its "
        "initial value.",
        note=True,
    )
    figure = _change(parameters, prefix)
    return Section("Parameters", (words, *((Figures((figure,)),) if figure else ()), table))


def _change(parameters: Mapping[str, Mapping[str, Any]], prefix: str) -> Figure | None:
    """Change of each identified parameter from its initial value, in percent of that, with its 95 % interval."""
    rows = [
        (name.removeprefix("aero/"), 100.0 * (r["value"] / r["initial"] - 1.0), 196.0 * r["std"] / abs(r["initial"]))
        for name, r in parameters.items()
        if r["status"] == _IDENTIFIED and r.get("initial") and r.get("std") is not None
    ]
    if not rows:
        return None
    reach = min(150.0, max(5.0, 1.1 * max(abs(change) + half for _, change, half in rows)))
    names = tuple((float(k), name) for k, (name, _, _) in enumerate(rows))
    beyond = sum(abs(change) > reach for _, change, _ in rows)
    label = f"Change of {len(rows)} parameters from their initial values [%], with 95 % intervals."
    x = Scale("change from the initial value [%]", -reach, reach)
    chart = Chart(f"{prefix}parameters", label, x, Scale("", len(rows) - 0.5, -0.5, names), height=70 + 14 * len(rows))
    chart.upright(0.0, "zero")
    for k, (_, change, half) in enumerate(rows):
        chart.line(np.array([change - half, change + half]), np.array([float(k), float(k)]), "plain")
        chart.marker(change, float(k), "first", "disc")
    note = f" {beyond} beyond the frame: see the table." if beyond else ""
    caption = f"Change of the identified parameters that had an initial value [%]; bars: 95 % intervals.{note}"
    return Figure(chart.name, chart.svg(), caption)


def _fit_section(fit: Mapping[str, Mapping[str, Any]]) -> Section:
    rows = []
    for channel, row in fit.items():
        quantity, unit, factor = shown_channel(channel)
        ratio = _ratio(row)
        level = Cell("undefined") if ratio is None else Cell(f"{ratio:.2f}", "good" if ratio <= NEAR_NOISE else "warn")
        rms, noise = (None if row.get(k) is None else factor * row[k] for k in ("rms", "noise"))
        share = row.get("predictable_share")
        rows.append((f"{quantity} [{unit}]", shown(rms, ".3g"), shown(noise, ".3g"), level, shown(share, ".2f")))
    head = ("Channel", "rms of log minus model", "Noise", "Ratio", "Share predictable from its past")
    return Section("Fit by channel", (Table("What is left between log and model, by channel.", head, tuple(rows)),))


def _provenance(fit: Mapping[str, Any]) -> Section:
    items = [("Command", fit.get("command") or "not recorded"), ("Method", fit.get("method", "not recorded"))]
    hashes = fit.get("flights_sha256") or []
    items += [(f"Flight {name} (SHA-256)", digest) for name, digest in zip(fit["flights"], hashes, strict=False)]
    if fit.get("simulations") is not None:
        items.append(("Effort", f"{fit['simulations']} simulations, {shown(fit.get('seconds'), '.1f')} s"))
    items.append(
        (
            "Files",
            "fit.json, parameters.csv, histories.parquet, aircraft/ (the XML with the estimates), beside this page",
        )
    )
    return Section("Where it came from", (Facts(tuple(items)),))
