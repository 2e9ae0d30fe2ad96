"""Command ``export``: a model in another simulator's format, with the loss measured."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.foreign.regular_files import ParseError, parse_json, read_regular
from uqharness.campaign import (
    epistemic_samples,
    read_campaign,
    read_manifest,
    spec_of,
    uq_properties,
)
from uqharness.commands.flights import AnyAircraft, carded_aircraft
from uqharness.errors import BadInputError
from uqharness.exchange import (
    CoefficientLoss,
    ComparedModel,
    FlightStates,
    Reference,
    SourceModel,
    ardupilot_jsbsim,
    ardupilot_json,
    box,
    box_around,
    derivatives,
    differences,
    fmu,
    gazebo,
    in_reference,
    losses,
    order_dependence,
    px4_sih,
    slips,
    source_model,
    sweeps,
    worst,
)
from uqharness.files import (
    check_output_folder,
    results_folder,
    scratch_folder,
    write_bytes,
    write_json,
    write_text,
)
from uqharness.heartbeat import Callback, silent
from uqharness.identification import load_form
from uqharness.requests.authoring import ExportRequest
from uqharness.requests.base import command_line
from uqharness.requests.simulation import MODEL_FILES
from uqharness.results.authoring import Loss, LossOfCoefficient, ModelDifference, ModelSlip
from uqharness.results.base import Outcome
from uqharness.simulator import Aircraft, content_hash
from uqharness.text_tables import csv_text, text_table

_MEMORY = 0.01
_SURFACES = "deflections are positive nose down, right wing down, nose left in the source"


def export(request: ExportRequest, callback: Callback = silent) -> Outcome[Loss]:
    """Fit the format's model, compare it with the source, and write both."""
    # Refuse what cannot be written before the fits, which take minutes.
    aircraft = carded_aircraft(request.aircraft)
    assert request.out is not None
    members = _members(request)
    names = {member: _program_name(aircraft.name, member, request.to) for member in members}
    _check_output(request.out, request.to, aircraft, names)
    if request.to == "fmu":
        fmu.builder()
    form = None if request.bounds is None else load_form(request.bounds)
    # A format that holds one model is fitted once for each member of a family.
    exports, by_coefficient = [], dict[str, CoefficientLoss]()
    for member, properties in members.items():
        place = f"member {member}: " if member else ""
        callback(f"{place}trim")
        source = source_model(aircraft, request.speed_mps, {**request.properties, **properties})
        states = box(source, request.states, request.seed)
        callback(f"{place}fit of the format's model")
        fitted = _FORMATS[request.to](source, states, names[member])
        exports.append((member, fitted))
        callback(f"{place}loss")
        # The loss of a family is that of its worst member.
        by_coefficient = worst(by_coefficient, losses(source, fitted[1], states, form))
    files, losses_in_words, notes = _together(exports, names)
    is_beyond = any(loss.is_beyond for loss in by_coefficient.values())
    verdict: Literal["within", "beyond", "no bounds"]
    verdict = "no bounds" if form is None else "beyond" if is_beyond else "within"
    # A loss beyond the bounds is written only if the user accepts it.
    refused = is_beyond and not request.accept_loss
    file_names = [] if refused else sorted(files)
    if names.get("", aircraft.name) != aircraft.name:
        notes = (
            f"{aircraft.name} is called {names['']}: the program may not take its name",
            *notes,
        )
    if len(exports) > 1:
        notes = (f"the loss is the largest of {len(exports)} members", *notes)
    document = Loss(
        aircraft=aircraft.name,
        format=request.to,
        speed_mps=source.trim.condition.V_mps,
        states=len(states),
        verdict=verdict,
        coefficients={name: _loss(loss) for name, loss in by_coefficient.items()},
        lost=list(losses_in_words),
        notes=list(notes),
        files=[*file_names, "loss.csv", "loss.json"],
        command=command_line(request),
    )
    # The loss is written in every case; it says why the model is not. A model of an earlier export
    # does not stay beside it.
    out = results_folder(request.out)
    write_json(out / "loss.json", document.as_json())
    write_text(out / "loss.csv", csv_text(_rows(document.coefficients, ".17g")))
    for name in files:
        if name not in file_names:
            (out / name).unlink(missing_ok=True)
            continue
        results_folder((out / name).parent)
        write_bytes(out / name, files[name])
    warnings = []
    dependence = order_dependence(source, states)
    if dependence > _MEMORY:
        warnings.append(
            f"{aircraft.name}: its control system has a memory (filters, integrators): coefficients"
            f" of one state differ by {dependence:.0%} of their variation, by the states before;"
            " model and loss are as uncertain"
        )
    # Bounds of another model are a warning: half-widths still give a scale.
    if form is not None and form.aircraft.sha256 != content_hash(aircraft):
        warnings.append(
            f"{request.bounds}: made for another model ({form.aircraft.name}) than {aircraft.name};"
            " its half-widths are compared all the same"
        )
    lines = _lines(document, out, refused)
    return Outcome(document, document, lines, code=int(is_beyond), warnings=warnings)


def _program_name(name: str, member: str, to: str) -> str:
    """Return what the aircraft is called in the other program.

    SDF, C and command lines take letters, digits and underscores. ArduPilot looks for words such
    as "-jet", "vtail" and "elevon" in the name and flies another frame.
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    if member:
        plain += "_" + re.sub(r"[^A-Za-z0-9_]" if to == "fmu" else r"[^A-Za-z0-9_-]", "_", member)
    plain = re.sub(r"(?i)(v)(tail)|(e)(levon)", lambda m: "_".join(filter(None, m.groups())), plain)
    is_reserved = plain == "world" or plain.startswith("__") or (to == "fmu" and plain[0].isdigit())
    return f"aircraft_{plain}" if is_reserved else plain


_OUTPUTS: Mapping[str, Sequence[str]] = {
    "ardupilot-jsbsim": ("aircraft/{}", "{}.parm"),
    "ardupilot-json": ("{}.json",),
    "gazebo": ("model.sdf", "model-classic.sdf"),
    "px4-sih": ("{}.params",),
    "fmu": ("{}.fmu",),
    "csv": ("coefficients.csv",),
}
"""Files and folders that each format writes for a name, beside the loss."""


def _check_output(out: Path, to: str, aircraft: Aircraft, names: Mapping[str, str]) -> None:
    """Raise BadInputError where an export would overwrite what it has not written.

    Files of an earlier export of the aircraft to the format, which its loss.json tells, may be
    replaced.
    """
    check_output_folder(out)
    if out.resolve().is_relative_to(aircraft.folder.resolve()):
        raise BadInputError(
            f"--out {out}: lies in the folder of the aircraft, {aircraft.folder}; choose another"
        )
    with contextlib.suppress(OSError, ParseError, AttributeError):
        previous_loss = parse_json(read_regular(out / "loss.json", 10_000_000))
        if (previous_loss.get("aircraft"), previous_loss.get("format")) == (aircraft.name, to):
            return
    places = [pattern.format(name) for name in names.values() for pattern in _OUTPUTS[to]]
    places += [f"{member}/{place}" for member in names if member for place in places]
    for place in ("loss.json", "loss.csv", *places):
        if (out / place).exists():
            raise BadInputError(
                f"--out {out}: has {place}, which no export of {aircraft.name} to {to} wrote;"
                " choose another folder"
            )


def _members(request: ExportRequest) -> dict[str, dict[str, float]]:
    """Return id to properties of the members to export; the id is empty without --member."""
    if request.member is None:
        if request.campaign is not None:
            raise BadInputError(
                f"--campaign {request.campaign}: needs --member with the id of one of its epistemic"
                " samples, or all"
            )
        return {"": {}}
    if request.campaign is not None:
        available = _campaign_members(request.campaign)
    else:
        available = {
            "".join(digits): _corner_properties(digits)
            for digits in itertools.product("01-", repeat=len(COEFFICIENTS))
        }
    if request.member == "all":
        return {name: row for name, row in available.items() if request.campaign or "-" not in name}
    if request.member not in available:
        first = ", ".join(list(available)[:3])
        allowed = (
            "six digits 0, 1 or - in the order CX CY CZ Cl Cm Cn, such as 010011, or all"
            if request.campaign is None
            else f"one of the {len(available)} epistemic samples ({first}, ...) or all"
        )
        raise BadInputError(f"--member {request.member}: no such member; allowed: {allowed}")
    return {request.member: available[request.member]}


def _corner_properties(digits: Sequence[str]) -> dict[str, float]:
    """Return the properties of a corner of the aircraft's own bounds."""
    properties = {"uq/active": 1.0}
    for name, digit in zip(COEFFICIENTS, digits, strict=True):
        if digit == "-":
            properties[f"uq/{name}/active"] = 0.0
        else:
            properties[f"uq/{name}/level"] = float(digit)
    return properties


def _campaign_members(path: Path) -> dict[str, dict[str, float]]:
    """Return id to properties of the epistemic samples of a campaign file or folder."""
    spec = spec_of(read_manifest(path)) if path.is_dir() else read_campaign(path)
    members = {}
    for sample in epistemic_samples(spec):
        if sample.driver is not None:
            raise BadInputError(
                f"{path}: its members vary in flight, which a frozen model cannot; choose a"
                " campaign with method = corners, levels or latin-hypercube"
            )
        members[sample.epistemic_id] = {**uq_properties(spec, sample), **sample.parameters}
    return members


def _together(
    exports: Sequence[tuple[str, Fitted]], names: Mapping[str, str]
) -> tuple[dict[str, bytes], tuple[str, ...], tuple[str, ...]]:
    """Return files, losses and notes of all members; each member's files have a place of their
    own.
    """
    files: dict[str, bytes] = {}
    for member, (contents, _, _, _) in exports:
        separate = len(exports) > 1 and not all(names[member] in name for name in contents)
        files |= {f"{member}/{name}" if separate else name: c for name, c in contents.items()}
    _, (_, _, losses_in_words, notes) = exports[0]
    return files, losses_in_words, notes


def _loss(loss: CoefficientLoss) -> LossOfCoefficient:
    """Return the loss of one coefficient as it is stored."""
    return LossOfCoefficient(
        max=loss.largest,
        rms=loss.rms,
        quantile_95=loss.quantile,
        source_std=loss.spread,
        half_width=loss.half_width,
        beyond=loss.is_beyond,
    )


Fitted = tuple[Mapping[str, bytes], FloatArray, tuple[str, ...], tuple[str, ...]]
"""Files by name, the target's coefficients at the states, what is lost, and notes."""


def _ardupilot_jsbsim(source: SourceModel, states: FlightStates, name: str) -> Fitted:
    """Write the folder of ArduPilot's JSBSim backend and start it as the backend does."""
    scratch = scratch_folder("export-")
    copy = ardupilot_jsbsim.write_folder(source, name, scratch.path)
    start = ardupilot_jsbsim.ground_start(copy, scratch.path)
    gear: tuple[str, ...] = ()
    if start.failure:
        gear = (f"its contact points are replaced by three wheels: {start.failure}",)
        copy = ardupilot_jsbsim.write_folder(source, name, scratch.path, replace_contacts=True)
        start = ardupilot_jsbsim.ground_start(copy, scratch.path)
    if start.failure:
        raise BadInputError(
            f"{source.aircraft.name}: has no trim on the ground from ArduPilot's start, 1.3 m"
            f" high and 13 deg nose up: {start.failure}"
        )
    target = replace(source, aircraft=copy, properties={}).coefficients(states)
    files = {
        path.relative_to(scratch.path).as_posix(): path.read_bytes()
        for path in sorted(scratch.path.rglob("*"))
        if path.is_file()
    }
    files[f"{name}.parm"] = ardupilot_jsbsim.parameters(source, derivatives(source)).encode()
    notes = (
        (
            f"start with arduplane --model jsbsim:{name} --autotest-dir DIR"
            f" --defaults DIR/{name}.parm --home LAT,LON,0,HEADING; JSBSim must be on PATH and DIR"
            " writable"
        ),
        (
            f"or copy DIR/aircraft/{name} to Tools/autotest/aircraft and use sim_vehicle.py"
            f" -v ArduPlane -f jsbsim:{name} --add-param-file DIR/{name}.parm"
        ),
        f"stands {start.height_m:.2f} m high at {math.degrees(start.theta_rad):.1f} deg pitch",
        *gear,
    )
    return files, target, ardupilot_jsbsim.LOST_TERMS, notes


def _ardupilot_json(source: SourceModel, states: FlightStates, name: str) -> Fitted:
    """Fit ArduPilot's JSON model."""
    keys = ardupilot_json.parameters(source, derivatives(source))
    target = ardupilot_json.coefficients(keys, states, source.reference.throw_deg)
    notes = (
        f"area and inertia are scaled to the program's {ardupilot_json.PROGRAM_MASS_KG:g} kg",
        "+1 is full nose up, right wing down, nose right",
        f"start with --model plane:{name}.json",
        "thrust is the program's own, throttle times its weight over 0.7",
    )
    files = {f"{name}.json": ardupilot_json.text(keys).encode()}
    return files, target, ardupilot_json.LOST_TERMS, notes


def _gazebo(source: SourceModel, states: FlightStates, name: str) -> Fitted:
    """Fit Gazebo's AdvancedLiftDrag."""
    model = gazebo.parameters(source, derivatives(source))
    files = {
        "model.sdf": gazebo.text(model, source, name),
        "model-classic.sdf": gazebo.text(model, source, name, classic=True),
    }
    notes = (
        "a joint turns by the deflection times its <direction>",
        "gz-sim before its change 3817 of July 2026 ignores Cem0 and Cema; use a later one",
        _SURFACES,
    )
    return files, gazebo.coefficients(model, states), gazebo.LOST_TERMS, notes


def _px4_sih(source: SourceModel, states: FlightStates, name: str) -> Fitted:
    """Set the parameters of PX4's simulation in hardware."""
    keys = px4_sih.parameters(source, states)
    mass, area = keys["SIH_MASS"], source.reference.S_m2
    notes = (
        (
            f"{mass:.4g} kg on the program's {px4_sih.AREA_M2:.3g} m2 stand for"
            f" {source.reference.mass_kg:.4g} kg on {area:.4g} m2; inertia and thrust are scaled"
        ),
        "commands: +1 is right wing down, nose up, nose right",
        f"start make px4_sitl_sih sihsim_airplane and load {name}.params in QGroundControl",
    )
    files = {f"{name}.params": px4_sih.text(keys, name).encode()}
    return files, px4_sih.coefficients(keys, source, states), px4_sih.LOST_TERMS, notes


def _fmu(source: SourceModel, states: FlightStates, name: str) -> Fitted:
    """Pack a functional mock-up unit."""
    with scratch_folder("export-") as scratch:
        root = Path(scratch)
        copy = fmu.write_copy(source, name, root)
        model = fmu.description(source, copy)
        unit = fmu.build(model, root)
        target = replace(source, aircraft=copy, properties={}).coefficients(states)
    notes = (
        "FMI 3.0, co-simulation; the importing program's Python needs the package jsbsim",
        f"inputs {', '.join(row['name'] for row in model['commands'])} and the wind",
        "parameters: the levels of the model form",
        f"starts in the trim; frames of {model['dt_s']:g} s",
        _SURFACES,
    )
    return {f"{model['identifier']}.fmu": unit}, target, fmu.LOST_TERMS, notes


def _csv(source: SourceModel, states: FlightStates, _: str) -> Fitted:
    """Tabulate the source over one variable at a time."""
    tables = sweeps.sweeps(source)
    files = {"coefficients.csv": sweeps.text(tables).encode()}
    loss = ("products of two variables", "the dependence on speed")
    notes = (
        "angles in rad, deflections in deg, rates as pb/2V, qc/2V, rb/2V",
        _SURFACES,
    )
    return files, sweeps.coefficients(source, tables, states), loss, notes


_FORMATS = {
    "ardupilot-jsbsim": _ardupilot_jsbsim,
    "ardupilot-json": _ardupilot_json,
    "gazebo": _gazebo,
    "px4-sih": _px4_sih,
    "fmu": _fmu,
    "csv": _csv,
}


def _rows(losses_by_name: Mapping[str, LossOfCoefficient], digits: str) -> list[dict[str, str]]:
    """Return the table of losses as texts."""
    columns = {
        "rms": "rms",
        "95 %": "quantile_95",
        "max": "max",
        "half-width": "half_width",
        "source's std": "source_std",
    }
    rows = []
    for name, loss in losses_by_name.items():
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
        *text_table(_rows(document.coefficients, ".2g")),
        f"Lost: {'; '.join(document.lost)}.",
        *document.notes,
        f"Files in {out}: {', '.join(document.files)}",
    ]


# Comparison of model files of other programs, with an aircraft or with each other.

_SUFFIXES = dict(zip(MODEL_FILES, ("ardupilot-json", "gazebo"), strict=True))
_STATES = 1500


def is_model_file(source: object) -> bool:
    """Return whether a source is a file of a format that this module reads."""
    return isinstance(source, str | PathLike) and (
        Path(source).suffix in _SUFFIXES and Path(source).is_file()
    )


def diff_models(
    first: AnyAircraft, second: AnyAircraft, speed_mps: float | None = None
) -> Outcome[ModelDifference]:
    """Compare two models, of which one at least is a model file, and name the slips between them.

    Parameters
    ----------
    first, second : str, Path or Aircraft
        An aircraft, or a file: ArduPilot's JSON model, or SDF with AdvancedLiftDrag.
    speed_mps : float, optional
        True airspeed of the aircraft's trim [m/s].
    """
    sources = {
        name: source_model(carded_aircraft(name), speed_mps)
        for name in (first, second)
        if not is_model_file(name)
    }
    source = next(iter(sources.values()), None)
    # SDF says the mass and the travel that ArduPilot's file leaves open.
    names = [name for name in (first, second) if name not in sources]
    names.sort(key=lambda name: _SUFFIXES[Path(str(name)).suffix] != "gazebo")
    common, files = None if source is None else source.reference, dict[AnyAircraft, _ModelFile]()
    for name in names:
        files[name] = _read(name, common)
        common = common or files[name].reference
    assert common is not None
    middle = {"alpha": 0.05} if source is None else source.middle
    states = box_around(common, middle, None if source is None else source.trim, _STATES)
    a, b = (
        _of_aircraft(sources[name], common) if name in sources else _of_file(files[name], common)
        for name in (first, second)
    )
    findings = slips(a, b, states, middle)
    by_coefficient = differences(b.coefficients(states), a.coefficients(states))
    document = ModelDifference(
        models=[a.name, b.name],
        differ=bool(findings),
        findings=[
            ModelSlip(where=f.where, first=f.first, second=f.second, cause=f.cause)
            for f in findings
        ],
        coefficients={name: _loss(loss) for name, loss in by_coefficient.items()},
        states=len(states),
    )
    answer = (
        f"No slip between {a.name} and {b.name}."
        if not findings
        else f"{len(findings)} differences between {a.name} and {b.name}:"
    )
    lines = [answer, *(f.text(a.name, b.name) for f in findings)]
    lines += text_table(_rows(document.coefficients, ".2g"))
    return Outcome(document, document, lines, code=int(bool(findings)))


@dataclass(frozen=True)
class _ModelFile:
    """A model file: its content, and the geometry, mass and inertia that it stands for."""

    name: str
    content: gazebo.LiftDragModel | dict[str, Any]
    reference: Reference


def _read(name: AnyAircraft, other: Reference | None) -> _ModelFile:
    """Read a model file.

    ArduPilot's area and inertia are those of its own mass; ``other`` says which mass they stand
    for.
    """
    path = Path(str(name))
    if _SUFFIXES[path.suffix] == "gazebo":
        return _ModelFile(path.name, *gazebo.read(path))
    keys = ardupilot_json.read(path)
    mass_kg = math.nan if other is None else other.mass_kg
    if not math.isfinite(mass_kg):
        mass_kg = ardupilot_json.PROGRAM_MASS_KG
    throw = {} if other is None else other.throw_deg
    return _ModelFile(path.name, keys, ardupilot_json.reference(keys, mass_kg, throw))


def _of_aircraft(source: SourceModel, common: Reference) -> ComparedModel:
    """Return an aircraft in the common reference."""
    return ComparedModel(
        source.aircraft.name,
        lambda states: in_reference(source.coefficients(states), source.reference, common),
        source.reference,
    )


def _of_file(file: _ModelFile, common: Reference) -> ComparedModel:
    """Return a model file in the common reference."""
    content, reference = file.content, file.reference
    if isinstance(content, gazebo.LiftDragModel):
        return ComparedModel(
            file.name,
            lambda states: in_reference(gazebo.coefficients(content, states), reference, common),
            reference,
            gazebo.parts(content),
            content.axes,
        )
    return ComparedModel(
        file.name,
        lambda states: in_reference(
            ardupilot_json.coefficients(content, states, common.throw_deg), reference, common
        ),
        reference,
        # Forces beside the centre of gravity give moments of every variable.
        terms=None if any(ardupilot_json.cg_offset(content)) else ardupilot_json.TERMS,
    )
