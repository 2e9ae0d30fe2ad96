"""report.html of a campaign: one file that says what was asked, what came out, how sure it is and where it came from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from markupsafe import Markup

from uqharness.campaign_manifest import read_manifest
from uqharness.campaign_tables import (
    CONFIDENCE,
    Condition,
    ExcursionCell,
    conditions,
    excursion_cells,
    in_condition,
    samples,
)
from uqharness.case_table import CASES, UNCOMMANDED_METRICS, read_table
from uqharness.errors import BadInputError
from uqharness.pbox import ExcursionRate, PBox, best_and_worst, pbox, poisson_upper
from uqharness.pbox_plot import PBoxFigure, Svg, draw
from uqharness.whole_files import write_bytes

REPORT = "report.html"
CONDITIONS_DRAWN = 4
"""Conditions whose p-boxes are drawn in the page; the tables hold all."""

_FAILURES_LISTED = 40
_QUANTITIES = (
    ("cross_track", "cross-track", "m"), ("altitude", "altitude", "m"), ("speed", "speed", "mps"), ("heading", "heading", "deg"),
)  # fmt: skip
_UNITS = {"m": "m", "mps": "m/s", "deg": "deg"}
# Medians of the published flight (Hale 2016, section 3.9), measured by its own sensors; 3 m/s wind, moderate to severe.
_PUBLISHED = {"cross_track": 9.41, "altitude": 2.16, "speed": 0.61}
_PUBLISHED_AIRCRAFT, _PUBLISHED_WIND_MPS, _PUBLISHED_AIR = "espaaro", 3.0, ("moderate", "severe")


@dataclass(frozen=True)
class Report:
    """What was written, and the verdict as plain sentences."""

    path: Path
    figures: tuple[Path, ...]
    verdict: tuple[str, ...]


@dataclass(frozen=True)
class _Finding:
    """One p-box of a median error."""

    quantity: str
    words: str
    unit: str
    measured: bool
    condition: Condition
    box: PBox
    published: float | None
    svg: Svg | None

    @property
    def title(self) -> str:
        seen = "as the sensors measured it" if self.measured else "true, without sensor noise"
        return f"Median {self.words} error, {seen}"


def write_report(folder: Path) -> Report:
    """Write report.html and figures/*.svg into a complete campaign's folder. Same folder, same bytes. Raises BadInputError."""
    manifest = read_manifest(folder)
    if manifest["state"] != "complete":
        command = manifest["command"] or "the command that began it"
        raise BadInputError(f"{folder}: the campaign is not complete; finish it first with: {command}")
    frame = read_table(folder / CASES).to_pandas()
    campaign = manifest["campaign"]
    findings = _findings(frame, campaign)
    cells = excursion_cells(frame, campaign["metrics"]["excursion_radius_m"])
    verdict = tuple(_verdict(frame, campaign, findings, cells))
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uqharness", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html.j2").render(
        name=Path(campaign["campaign"]["aircraft"]).name,
        asked=_asked(frame, campaign),
        verdict=verdict,
        figures=[(item.title, item.condition.words, Markup(item.svg.inline)) for item in findings if item.svg],
        undrawn=max(0, len(conditions(frame)) - CONDITIONS_DRAWN),
        medians=[_median_row(item) for item in findings],
        excursions=[_excursion_row(cell) for cell in cells],
        failures=_failures(frame),
        failures_listed=_FAILURES_LISTED,
        manifest=manifest,
        confidence=f"{CONFIDENCE:.0%}".replace("%", " %"),
    )
    path = folder / REPORT
    write_bytes(path, page.encode())
    return Report(path, tuple(_write_figures(folder, findings)), verdict)


def _write_figures(folder: Path, findings: list[_Finding]) -> list[Path]:
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    paths = []
    for item in findings:
        if item.svg is not None:
            paths.append(figures / f"{item.svg.name}.svg")
            write_bytes(paths[-1], item.svg.file.encode())
    return paths


def _findings(frame: pd.DataFrame, campaign: Mapping[str, Any]) -> list[_Finding]:
    """P-boxes of the medians: per condition, per quantity, measured before true (the published flight is measured)."""
    found = []
    for number, condition in enumerate(conditions(frame)):
        rows = in_condition(frame, condition)
        for quantity, words, unit in _QUANTITIES:
            for measured in (True, False):
                metric = f"{quantity}_median_{unit}" + ("_measured" if measured else "")
                corners = samples(rows, metric) if metric in rows else []
                if (measured and not campaign["aleatory"]["sensor_noise"]) or not any(c.values.size for c in corners):
                    continue
                box = pbox(corners, CONFIDENCE)
                published = _published(campaign, condition, quantity) if measured else None
                item = _Finding(quantity, words, _UNITS[unit], measured, condition, box, published, None)
                svg = draw(_figure(item, metric, corners)) if number < CONDITIONS_DRAWN else None
                found.append(_Finding(quantity, words, _UNITS[unit], measured, condition, box, published, svg))
    return found


def _figure(item: _Finding, metric: str, corners: list[Any]) -> PBoxFigure:
    seen = "measured" if item.measured else "true"
    return PBoxFigure(
        name=f"pbox-{metric.replace('_', '-')}-{item.condition.wind_mps:g}mps-{item.condition.turbulence}",
        axis=f"median |{item.words} error|, {seen} [{item.unit}]",
        box=item.box,
        samples=corners,
        published=item.published,
        published_label="" if item.published is None else f"published flight, {item.published:g} {item.unit}",
    )


def _published(campaign: Mapping[str, Any], condition: Condition, quantity: str) -> float | None:
    """The published flight's median, where it was flown in this condition by this aircraft."""
    same_aircraft = Path(campaign["campaign"]["aircraft"]).name == _PUBLISHED_AIRCRAFT
    same_air = condition.wind_mps == _PUBLISHED_WIND_MPS and condition.turbulence in _PUBLISHED_AIR
    return _PUBLISHED[quantity] if same_aircraft and same_air else None


def _asked(frame: pd.DataFrame, campaign: Mapping[str, Any]) -> str:
    air, epistemic = campaign["aleatory"], campaign["epistemic"]
    corners = frame["epistemic_id"].nunique()
    within = f"within the intervals of {', '.join(epistemic['coefficients'])}"
    samples_text = {
        "none": "the model as it is, without model-form uncertainty",
        "corners": f"{corners} corners of the model-form intervals of {', '.join(epistemic['coefficients'])}",
        "levels": f"{corners} combinations of levels {within}",
        "lhs": f"{corners} fixed levels, a Latin hypercube, {within}",
        "white": f"{corners} samples of levels redrawn at every step {within}",
        "walk": f"{corners} random walks {within}",
    }[epistemic["method"]]
    if epistemic["method"] == "walk":
        rates = epistemic["walk_rate_per_sqrt_s"]
        samples_text += (
            " at " + ", ".join(f"{name} {rate:.3g}" for name, rate in rates.items()) + " per square root of a second"
        )
    if "parameters" in epistemic:
        samples_text += f"; parameters drawn from {Path(epistemic['parameters']['fit']).name}"
    winds = ", ".join(f"{wind:g}" for wind in air["wind_mps"])
    noise = "noisy" if air["sensor_noise"] else "noise-free"
    return (
        f"How far do the errors and excursions of this mission depend on what is not known of the model? "
        f"{samples_text[0].upper()}{samples_text[1:]}; {air['flights']} flights each, of {air['duration_s']:g} s scored "
        f"after {air['burn_in_s']:g} s of burn-in; wind {winds} m/s from {air['wind_from_deg']:g} deg, "
        f"turbulence {', '.join(air['turbulence'])} ({air['turbulence_source']}), {noise} sensors."
    )


def _verdict(
    frame: pd.DataFrame, campaign: Mapping[str, Any], findings: list[_Finding], cells: list[ExcursionCell]
) -> list[str]:
    """The answer in words with numbers: the hardest condition, its medians, its excursions, and what failed."""
    hardest = _hardest(conditions(frame))
    duration = campaign["aleatory"]["duration_s"]
    sentences = [f"Hardest condition flown: {hardest.words}."]
    if UNCOMMANDED_METRICS[0] in frame:
        sentences.append("Nothing was commanded: errors are deviations from the state in which scoring began.")
    for quantity, _, _ in _QUANTITIES:
        both = [item for item in findings if item.condition == hardest and item.quantity == quantity]
        if both:
            sentences.append(_median_sentence(both, duration))
    for cell in cells:
        if cell.condition == hardest and cell.distance == "horizontal":
            sentences.append(_excursion_sentence(cell))
    failed = int((frame["status"] != "ok").sum())
    counted = f"{failed} failed; they are bounded at the worst, not dropped" if failed else "all ended as planned"
    sentences.append(f"Of {len(frame)} flights, {counted}.")
    losses = int(frame["loss_of_control"].fillna(0).sum())
    sentences.append(
        f"Control was lost in {losses} of them." if losses else "Control was lost in none that was scored."
    )
    return sentences


def _hardest(found: list[Condition]) -> Condition:
    order = ("none", "light", "moderate", "severe")
    return max(found, key=lambda item: (order.index(item.turbulence), item.wind_mps))


def _median_sentence(both: list[_Finding], duration_s: float) -> str:
    """One quantity, true and (where there is one) measured, against the published flight."""
    parts = []
    for item in sorted(both, key=lambda finding: finding.measured):
        low, high = item.box.quantile(0.5)
        parts.append(f"{_span(low, high)} {item.unit} {'as measured' if item.measured else 'in truth'}")
    text = (
        f"Median {both[0].words} error of a typical {duration_s:g} s flight, best to worst corner: {', '.join(parts)}"
    )
    for item in both:
        if item.published is not None:
            low, high = item.box.value[0], item.box.value[-1]
            where = "within" if low <= item.published <= high else "below" if item.published < low else "above"
            text += (
                f"; the published flight's {item.published:g} {item.unit} lies {where} what single flights measured, "
            )
            text += f"{low:.3g} to {high:.3g} {item.unit}"
    return text + "."


def _span(low: float, high: float) -> str:
    if math.isinf(high):
        return f"at least {low:.3g}"
    return f"{low:.3g} to {high:.3g}" if low != high else f"{low:.3g}"


def _excursion_sentence(cell: ExcursionCell) -> str:
    best, worst = best_and_worst(cell.rates)
    text = f"Excursions beyond {cell.radius_m:g} m per flight hour: "
    if math.isnan(best.rate):
        return text + "undefined, for no flight was scored."
    text += f"{best.rate:.3g} at the best corner, {worst.rate_upper:.3g} at the worst"
    text += f" ({CONFIDENCE:.0%} limits over all corners {best.simultaneous[0]:.2g} to {worst.simultaneous[1]:.3g}; "
    return text.replace("%", " %") + f"{worst.hours:.3g} h per corner)."


def _median_row(item: _Finding) -> dict[str, str]:
    low, high = item.box.quantile(0.5)
    band_low, band_high = item.box.band_quantile(0.5)
    return {
        "what": item.title,
        "unit": item.unit,
        "condition": item.condition.label,
        "middle": _span(low, high),
        "band": f"{_open(band_low)} to {_open(band_high)}",
        "published": "" if item.published is None else f"{item.published:g}",
    }


def _open(value: float) -> str:
    return "open" if math.isinf(value) else f"{value:.3g}"


def _excursion_row(cell: ExcursionCell) -> dict[str, str]:
    best, worst = best_and_worst(cell.rates)
    return {
        "condition": cell.condition.label,
        "radius": f"{cell.radius_m:g} m, {'3-D' if cell.distance == '3d' else 'horizontal'}",
        "best": _rate(best, best.rate, best.events),
        "best_corner": best.epistemic_id,
        "worst": _rate(worst, worst.rate_upper, worst.events_upper),
        "worst_corner": worst.epistemic_id,
        "all": f"{best.simultaneous[0]:.2g} to {worst.simultaneous[1]:.3g}",
        "hours": f"{worst.hours:.3g}",
        "failed": str(sum(rate.failed for rate in cell.rates)),
    }


def _rate(item: ExcursionRate, rate: float, events: int) -> str:
    if math.isnan(rate):
        return "undefined: no hours"
    if events == 0:
        return f"0 (< {poisson_upper(0, item.hours, CONFIDENCE):.2g})"
    return f"{rate:.3g} [{item.limits[0]:.2g}, {item.limits[1]:.3g}]"


def _failures(frame: pd.DataFrame) -> list[dict[str, Any]]:
    failed = frame[frame["status"] != "ok"]
    names = ["case_id", "epistemic_id", "aleatory_id", "wind_mps", "turbulence", "status", "reason"]
    return [dict(zip(names, row, strict=True)) for row in failed[names].itertuples(index=False)]
