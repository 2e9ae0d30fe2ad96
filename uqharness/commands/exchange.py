"""Command ``export``: a model in another simulator's format, with the loss measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from uqharness.commands.flights import carded_aircraft
from uqharness.errors import BadInputError
from uqharness.exchange import (
    FlightStates,
    SourceModel,
    ardupilot_json,
    box,
    derivatives,
    gazebo,
    losses,
    source_model,
    sweeps,
)
from uqharness.files import check_output_folder, results_folder, write_bytes, write_json, write_text
from uqharness.identification import load_form
from uqharness.requests.base import Callback, command_line, silent
from uqharness.requests.exchange import ExportRequest
from uqharness.results.base import Outcome
from uqharness.results.exchange import Loss, LossOfCoefficient
from uqharness.simulator import content_hash
from uqharness.text_tables import csv_text, text_table

_SURFACES = "deflections are positive nose down, right wing down, nose left in the source"


def export(request: ExportRequest, callback: Callback = silent) -> Outcome[Loss]:
    """Fit the format's model, compare it with the source, and write both."""
    aircraft = carded_aircraft(request.aircraft)
    assert request.out is not None
    check_output_folder(request.out)
    form = None if request.bounds is None else load_form(request.bounds)
    properties = _settings(request.properties)
    callback("trim")
    source = source_model(aircraft, request.speed_mps, properties)
    states = box(source, request.states, request.seed)
    callback("fit of the format's model")
    files, target, lost, notes = _FORMATS[request.to](source, states)
    callback("loss")
    by_coefficient = losses(source, target, states, form)
    beyond = any(loss.is_beyond for loss in by_coefficient.values())
    verdict = "no bounds" if form is None else "beyond" if beyond else "within"
    refused = beyond and not request.accept_loss
    written = [] if refused else sorted(files)
    document = Loss(
        aircraft=aircraft.name,
        format=request.to,
        speed_mps=source.trim.condition.V_mps,
        states=len(states),
        verdict=verdict,
        coefficients={
            name: LossOfCoefficient(
                max=loss.largest,
                rms=loss.rms,
                quantile_95=loss.quantile,
                source_std=loss.spread,
                half_width=loss.half_width,
                beyond=loss.is_beyond,
            )
            for name, loss in by_coefficient.items()
        },
        lost=list(lost),
        notes=list(notes),
        files=[*written, "loss.csv", "loss.json"],
        command=command_line(request),
    )
    out = results_folder(request.out)
    for name in written:
        write_bytes(out / name, files[name])
    write_text(out / "loss.csv", csv_text(_rows(document, ".17g")))
    write_json(out / "loss.json", document.as_json())
    warnings = []
    if form is not None and form.aircraft.sha256 != content_hash(aircraft):
        warnings.append(
            f"{request.bounds}: made for another model ({form.aircraft.name}) than {aircraft.name};"
            " its half-widths are compared all the same"
        )
    lines = _lines(document, out, refused)
    return Outcome(document, document, lines, code=int(beyond), warnings=warnings)


def _settings(properties: Mapping[str, Any]) -> dict[str, float]:
    """Return properties with finite numbers. Raises BadInputError."""
    values = {}
    for name, value in properties.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInputError(f"--set {name}={value}: a finite number is needed")
        values[name] = float(value)
    return values


Fitted = tuple[Mapping[str, bytes], FloatArray, tuple[str, ...], tuple[str, ...]]
"""Files by name, the target's coefficients at the states, what is lost, and notes."""


def _ardupilot_json(source: SourceModel, states: FlightStates) -> Fitted:
    """Fit ArduPilot's JSON model."""
    keys = ardupilot_json.parameters(source, derivatives(source))
    target = ardupilot_json.coefficients(keys, states, source.reference.throw_deg)
    notes = (
        f"area and inertia are scaled to the program's {ardupilot_json.PROGRAM_MASS_KG:g} kg",
        "+1 is full nose up, right wing down, nose right",
        f"start with --model plane:{source.aircraft.name}.json",
        "thrust is the program's own, throttle times its weight over 0.7",
    )
    name = f"{source.aircraft.name}.json"
    files = {name: ardupilot_json.text(keys).encode()}
    return files, target, ardupilot_json.LOST, notes


def _gazebo(source: SourceModel, states: FlightStates) -> Fitted:
    """Fit Gazebo's AdvancedLiftDrag."""
    model = gazebo.parameters(source, derivatives(source))
    files = {
        "model.sdf": gazebo.text(model, source),
        "model-classic.sdf": gazebo.text(model, source, classic=True),
    }
    notes = (
        "a joint turns by the deflection times its <direction>",
        "gz-sim before its change 3817 of July 2026 ignores Cem0 and Cema; use a later one",
        _SURFACES,
    )
    return files, gazebo.coefficients(model, states), gazebo.LOST, notes


def _csv(source: SourceModel, states: FlightStates) -> Fitted:
    """Tabulate the source over one variable at a time."""
    tables = sweeps.sweeps(source)
    files = {"coefficients.csv": sweeps.text(tables).encode()}
    lost = ("products of two variables", "the dependence on speed")
    notes = (
        "angles in rad, deflections in the card's unit, rates as pb/2V, qc/2V, rb/2V",
        _SURFACES,
    )
    return files, sweeps.coefficients(source, tables, states), lost, notes


_FORMATS = {"ardupilot-json": _ardupilot_json, "gazebo": _gazebo, "csv": _csv}


def _rows(document: Loss, digits: str) -> list[dict[str, str]]:
    """Return the table of losses as texts."""
    columns = {
        "rms": "rms",
        "95 %": "quantile_95",
        "max": "max",
        "half-width": "half_width",
        "source's std": "source_std",
    }
    rows = []
    for name, loss in document.coefficients.items():
        numbers = {title: getattr(loss, column) for title, column in columns.items()}
        texts = {t: "" if n is None else format(n, digits) for t, n in numbers.items()}
        rows.append({"coefficient": name, **texts})
    return rows


def _lines(document: Loss, out: Path, refused: bool) -> list[str]:
    """Return what the command prints: verdict, losses, and what cannot be held."""
    worst = [c for c in COEFFICIENTS if document.coefficients[c].beyond]
    answer = {
        "within": "Every coefficient's loss is within the half-width of the bounds.",
        "beyond": f"Beyond the half-width of the bounds: {', '.join(worst)}.",
        "no bounds": "No --bounds: the loss is compared with the source's own variation alone.",
    }[document.verdict]
    if refused:
        answer += " The model is not written; --accept-loss writes it all the same."
    return [
        answer,
        f"{document.states} states around {document.speed_mps:.4g} m/s, {document.format}:",
        *text_table(_rows(document, ".2g")),
        f"Lost: {'; '.join(document.lost)}.",
        *document.notes,
        f"Files in {out}: {', '.join(document.files)}",
    ]
