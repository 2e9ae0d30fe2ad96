"""Instrument an aircraft: plan, write the folder, and fly it against the untouched aircraft.

`instrument_aircraft` adds the plugin to a copy, `undo` removes it to the byte, and `with_card`
gives an aircraft without airframe.toml a temporary copy with one. `check_in_child` flies the copy
against the untouched aircraft. Mass properties can be changed on the way, and `write_estimates`
writes identified values into the XML, keeping its formatting.
"""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS
from sysid.units import FT_M, IN_M, LB_KG, SLUG_FT2_KGM2, SLUG_LB
from uqharness.child_process import describe_exit, give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.files import Scratch, scratch_folder
from uqharness.plugin.instrument import (
    FILE_NAME,
    Bounds,
    Change,
    Plan,
    make_change,
    metrics_of,
    plan,
    read_record,
    restore,
    to_json,
)
from uqharness.simulator import (
    INSIDE,
    Aircraft,
    check_loadable,
    content_hash,
    copy_folder,
    copy_shared_parts,
    describe_fuel,
    engine,
    find_aircraft,
    fuel_edits,
    fuel_levels,
    host_properties,
    model_files,
    open_mid_envelope,
    read_xml,
    staged,
    staging,
    with_rotor_inertia,
    with_step,
    xml_numbers_for,
)
from uqharness.simulator import facts as aircraft_facts
from uqharness.xml import (
    Document,
    Insertion,
    Node,
    append_child,
    apply,
    attribute,
    comment,
    declarations,
    folder_documents,
    parse_document,
    read_document,
    replace_attribute,
)

# Check of the plugin: an instrumented aircraft flown against the untouched one.
#
# Both fly the same ten seconds in mid-envelope with engines running and controls moving, and
# all common properties must be identical. Then one coefficient at a time is switched on for one
# frame: body force and moment must change by q S dC, q S b dC or q S c dC about the CG.
# `check_in_child` runs this in a child process, because an aircraft may crash the interpreter.

DELTA = 0.02
DURATION_S = 10.0
SAMPLE_EVERY = 20
SWITCHED_AFTER = 60
"""Frames flown before a coefficient is switched on for one."""

_MAY_CHANGE = re.compile(
    r"uq/|forces/(fb[xyz]-(aero|total)-lbs|f[ws][xyz]-aero-lbs|lod-norm|hold-down|load-factor)|"
    r"moments/([lmn]-(aero|total)-lbsft|(roll|pitch|yaw)-(stab|wind)-aero-lbsft)|accelerations/"
)
_UNINITIALISED = re.compile(
    r"gear/unit(\[\d+\])?/side_friction_coeff|propulsion/engine(\[\d+\])?/engtemp-c"
)
"""Properties that JSBSim 1.3.3 does not initialise: FGLGear::FCoeff, FGTurboProp::Eng_Temperature.
"""
_AIR_OWNS = re.compile(r"atmosphere/(turb-type|severity|windspeed_at_20ft.*|psiw-rad|wind-mag-fps)")
_FORCES = tuple(f"forces/fb{axis}-{kind}-lbs" for kind in ("aero", "total") for axis in "xyz")
_MOMENTS = tuple(f"moments/{axis}-{kind}-lbsft" for kind in ("aero", "total") for axis in "lmn")


@dataclass(frozen=True)
class Verdict:
    """Result of the check.

    Attributes
    ----------
    status : str
        ``works``; ``wrong`` (the plugin is at fault); ``fails`` (the untouched aircraft does not
        load or fly).
    reason : str
        Why it does not work.
    properties, unsteady : int
        Compared properties, and those that differ between two flights of the untouched aircraft.
    worst : float
        Largest relative error of a force or moment increment.
    dt_s : float
        Step of the flights [s].
    """

    status: str
    reason: str = ""
    properties: int = 0
    unsteady: int = 0
    worst: float = math.nan
    dt_s: float = math.nan


def check(untouched: Aircraft, instrumented: Aircraft, duration_s: float = DURATION_S) -> Verdict:
    """Fly both aircraft and compare.

    A BadInputError from either aircraft is a verdict too. If the air system was added, its settings
    of the atmosphere may differ.
    """
    if not untouched.has_card:
        # The same commands move both, and both have the same host.
        card = untouched.card.model_copy(
            update={"inputs": instrumented.card.inputs, "host": instrumented.card.host}
        )
        untouched = with_step(replace(untouched, card=card), instrumented.dt_s)
    steps = max(SWITCHED_AFTER + 1, round(duration_s / untouched.dt_s))
    try:
        names, first = _fly(untouched, steps, None)
        # Properties that differ between two equal flights cannot be compared.
        repeated = _fly(untouched, steps, names)[1]
    except (BadInputError, engine.RuntimeFailure) as error:
        return Verdict("fails", " ".join(str(error).split()))
    # A flight that diverges or hits the ground proves nothing.
    height, speed = (names.index(n) for n in ("position/h-sl-ft", "velocities/vt-fps"))
    if not np.isfinite(first[:, [height, speed]]).all():
        return Verdict("fails", "the state does not stay finite")
    if first[:, height].min() <= 0.0:
        return Verdict(
            "fails",
            "reaches the ground after"
            f" {SAMPLE_EVERY * untouched.dt_s * first[:, height].argmin():.1f} s",
        )
    steady = np.all((first == repeated) | (np.isnan(first) & np.isnan(repeated)), axis=0)
    # The air system sets properties of the atmosphere.
    if _has_air(instrumented) and not _has_air(untouched):
        steady &= np.array([not _AIR_OWNS.fullmatch(name) for name in names])
    compared = [name for name, is_steady in zip(names, steady, strict=True) if is_steady]
    verdict_fields: dict[str, Any] = {
        "properties": len(compared),
        "unsteady": len(names) - len(compared),
        "dt_s": untouched.dt_s,
    }
    try:
        idle = _fly(instrumented, steps, compared)[1]
        reference = first[:, steady]
        differs = ~np.all((idle == reference) | (np.isnan(idle) & np.isnan(reference)), axis=0)
        if differs.any():
            changed = [
                name for name, is_changed in zip(compared, differs, strict=True) if is_changed
            ]
            return Verdict(
                "wrong",
                f"with uq/active 0 {len(changed)} properties differ: {', '.join(changed[:5])}",
                **verdict_fields,
            )
        return _switch_each(instrumented, compared, verdict_fields)
    except (BadInputError, engine.RuntimeFailure) as error:
        return Verdict("wrong", " ".join(str(error).split()), **verdict_fields)


def _switch_each(aircraft: Aircraft, names: Sequence[str], same: Mapping[str, Any]) -> Verdict:
    """Switch each coefficient on for one frame and check the increments."""
    all_names = [*names, *(n for n in (*_FORCES, *_MOMENTS) if n not in names)]
    idle = _frame(aircraft, all_names, None)[0]
    at = {name: k for k, name in enumerate(all_names)}
    worst = 0.0
    for index, name in enumerate(COEFFICIENTS):
        moved, delta, scales = _frame(aircraft, all_names, name)
        if not delta:
            return Verdict(
                "wrong", f"uq/{name}/delta stays 0 with uq/active and uq/{name}/active 1", **same
            )
        # Force or moment increment of the coefficient that is on.
        expected = np.zeros(6)
        expected[index] = delta * scales[index]
        for kind in (0, 1):
            keys = (*_FORCES[3 * kind : 3 * kind + 3], *_MOMENTS[3 * kind : 3 * kind + 3])
            before, after = (np.array([row[at[key]] for key in keys]) for row in (idle, moved))
            error = np.abs(after - before - expected).max()
            worst = max(worst, float(error / abs(expected[index])))
            # Rounding of two large sums may exceed the share of a small difference.
            digits = 8.0 * np.finfo(float).eps * np.abs(before).max()
            if not error <= max(1e-9 * abs(expected[index]), digits):
                return Verdict(
                    "wrong",
                    f"{name}: the increment is off by {error:.2g} of {expected[index]:.3g}",
                    worst=worst,
                    **same,
                )
        # Nothing else may change in the first frame.
        changed = moved != idle
        changed &= ~(np.isnan(moved) & np.isnan(idle))
        unexpected = [
            n
            for n, is_changed in zip(all_names, changed, strict=True)
            if is_changed and not _MAY_CHANGE.match(n)
        ]
        if unexpected:
            return Verdict(
                "wrong",
                f"{name} changes {', '.join(unexpected[:5])} in its first frame",
                worst=worst,
                **same,
            )
    return Verdict("works", worst=worst, **same)


def _frame(
    aircraft: Aircraft, names: Sequence[str], coefficient: str | None
) -> tuple[NDArray[np.float64], float, list[float]]:
    """Return properties after SWITCHED_AFTER frames with one coefficient on, its delta, and force
    or moment per unit.
    """
    fdm, step = open_mid_envelope(aircraft)
    for k in range(SWITCHED_AFTER):
        step(k)
    if coefficient is not None:
        for name in COEFFICIENTS:
            engine.set_property(fdm, f"uq/{name}/active", float(name == coefficient))
        engine.set_property(fdm, f"uq/{coefficient}/level", 1.0)
        if not fdm[f"uq/{coefficient}/upper"]:
            # Without bounds, a separate delta.
            engine.set_property(fdm, f"uq/{coefficient}/upper", DELTA)
        engine.set_property(fdm, "uq/active", 1.0)
    step(SWITCHED_AFTER)
    row = np.array([_get(fdm, name) for name in names])
    reference = aircraft.card.reference
    # The card's reference values, as the plugin uses them.
    S = reference.S_m2 / FT_M**2 if reference.S_m2 else fdm["metrics/Sw-sqft"]
    b = reference.b_m / FT_M if reference.b_m else fdm["metrics/bw-ft"]
    c = reference.c_m / FT_M if reference.c_m else fdm["metrics/cbarw-ft"]
    pressure = fdm["aero/qbar-psf"] * S
    delta = fdm[f"uq/{coefficient}/delta"] if coefficient is not None else 0.0
    return row, delta, [pressure, pressure, pressure, pressure * b, pressure * c, pressure * b]


def _fly(
    aircraft: Aircraft, steps: int, names: Sequence[str] | None
) -> tuple[list[str], NDArray[np.float64]]:
    """Return names and rows of properties, recorded every SAMPLE_EVERY frames."""
    fdm, step = open_mid_envelope(aircraft)
    recorded_names = list(names) if names is not None else _readable(fdm)
    rows = []
    for k in range(steps):
        step(k)
        if k % SAMPLE_EVERY == 0 or k == steps - 1:
            rows.append([_get(fdm, name) for name in recorded_names])
    return recorded_names, np.array(rows)


def _has_air(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has the air system."""
    return bool(
        engine.open_fdm(staged(aircraft), aircraft.dt_s)
        .get_property_manager()
        .hasNode("air/wind-mps")
    )


def _readable(fdm: Any) -> list[str]:
    """Return the properties that can be compared."""
    manager = fdm.get_property_manager()
    names = dict.fromkeys(engine.catalog(fdm))
    return [name for name in names if manager.hasNode(name) and not _UNINITIALISED.fullmatch(name)]


def _get(fdm: Any, name: str) -> float:
    """Return the value of a property."""
    return float(fdm.get_property_value(name))


def check_in_child(
    untouched: Path, instrumented: Path, duration_s: float = DURATION_S, timeout_s: float = 300.0
) -> Verdict:
    """Check in a child process.

    If the child dies or takes longer than ``timeout_s`` [s], the verdict is ``fails``.
    """
    ended = run_module(__name__, untouched, instrumented, repr(duration_s), timeout_s=timeout_s)
    if ended.code is None:
        return Verdict("fails", f"no answer within {timeout_s:g} s")
    if ended.answer:
        return Verdict(**ended.answer)
    return Verdict(
        "fails",
        f"the process ended with {describe_exit(ended.code)}: {ended.errors or 'no message'}",
    )


def _main(untouched: str, instrumented: str, duration_s: str) -> None:
    """Check and answer the parent."""
    give_answer(
        asdict(check(find_aircraft(untouched), find_aircraft(instrumented), float(duration_s)))
    )


# Engines, propellers and systems outside the aircraft's folder, which a copy must contain.


def carried_files(aircraft: Aircraft, out: Path) -> dict[str, bytes]:
    """Return name to content of files that ``out`` needs and JSBSim would not find from there.

    Empty for a stock aircraft, whose parts every JSBSim has. Raises BadInputError.
    """
    root = out.absolute().parent.parent
    stock = engine.default_root()
    files = {}
    parts = model_files(aircraft)
    for place in parts.shared:
        kind, _, name = place.partition("/")
        if any(f"{folder}/{name}".lstrip("/") in parts.local for folder in INSIDE[kind]):
            continue
        # Nothing to copy if JSBSim finds the same content from the new place.
        content = read_xml(
            (aircraft.engine_path if kind == "engine" else aircraft.systems_path) / name
        )
        shared = root / kind
        existing = (shared if shared.is_dir() else stock / kind) / name
        if not (existing.is_file() and read_xml(existing) == content):
            folders = [folder for folder in INSIDE[kind] if folder]
            subfolder = next(
                (folder for folder in folders if (aircraft.folder / folder).is_dir()), folders[0]
            )
            files[f"{subfolder}/{name}"] = content
    return files


# Writing an instrumented folder atomically, and undoing it.


def write(aircraft: Aircraft, planned: Plan, out: Path) -> None:
    """Copy the aircraft's folder to ``out`` with the plan carried out, atomically.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    planned : Plan
        Files to write, and the record of changes.
    out : Path
        The aircraft's own folder, a new or empty one, or an earlier result.

    Raises
    ------
    BadInputError
        If ``out`` holds anything else, or an earlier instrumentation must be undone first.
    """
    # The aircraft's own folder may be replaced.
    in_place = out.exists() and out.resolve() == aircraft.folder
    if (
        out.exists()
        and not in_place
        and not (out / FILE_NAME).is_file()
        and (not out.is_dir() or any(out.iterdir()))
    ):
        raise BadInputError(
            f"{out}: exists and is no instrumented aircraft; remove it or choose another --out"
        )
    out.absolute().parent.mkdir(parents=True, exist_ok=True)
    changes, files = dict(planned.changes), dict(planned.files)
    if not in_place:
        for name, content in carried_files(aircraft, out).items():
            files[name], changes[name] = content, make_change(None, content)
    for name, (content, _) in with_rotor_inertia(aircraft, staging.model_files(aircraft)).items():
        path = aircraft.folder / name
        before = read_xml(path) if path.is_file() else None
        files[name], changes[name] = content, make_change(before, content)
    if (aircraft.folder / FILE_NAME).is_file():
        changes = _merge_records(read_record(aircraft.folder), changes)
    with tempfile.TemporaryDirectory(dir=out.absolute().parent, prefix=".instrument-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(aircraft.folder, copy, keep_links=in_place)
        for name, content in files.items():
            _write_file(copy / name, content)
        (copy / FILE_NAME).write_bytes(to_json(changes))
        _swap(copy, out, Path(temporary) / "old")


def undo(folder: Path, out: Path) -> list[tuple[str, str]]:
    """Write to ``out`` what ``folder`` was before it was instrumented.

    Parameters
    ----------
    folder, out : Path
        Instrumented folder, and result; they may be the same.

    Returns
    -------
    list of (str, str)
        File, and what became of it.

    Raises
    ------
    BadInputError
        If a file has changed so that the plugin cannot be removed; nothing is written then.
    """
    changes = read_record(folder)
    done = []
    with tempfile.TemporaryDirectory(dir=out.absolute().parent, prefix=".instrument-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(folder, copy, keep_links=out.resolve() == folder.resolve())
        for name, change in changes.items():
            path = copy / name
            if not path.is_file():
                if change.edited:
                    raise BadInputError(f"{folder / name}: is missing; undo cannot restore it")
                continue
            # None: the file was added and is removed.
            content = restore(folder / name, change, path.read_bytes())
            if content is None:
                path.unlink()
                if not any(path.parent.iterdir()):
                    path.parent.rmdir()
                done.append((name, "removed"))
            else:
                _write_file(path, content)
                # Identical to the original, or with later changes of the author.
                same = make_change(None, content).after == change.before
                done.append(
                    (
                        name,
                        (
                            "as it was, byte for byte"
                            if same
                            else "without the plugin; other changes since are kept"
                        ),
                    )
                )
        (copy / FILE_NAME).unlink()
        if (
            out.exists()
            and out.resolve() != folder.resolve()
            and not (out / FILE_NAME).is_file()
            and any(out.iterdir())
        ):
            raise BadInputError(
                f"{out}: exists and is no instrumented aircraft; remove it or choose another --out"
            )
        _swap(copy, out, Path(temporary) / "old")
    return done


def _write_file(path: Path, content: bytes) -> None:
    """Write a file; never through a link."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # Through a link, another aircraft's file would change.
    if path.is_symlink():
        path.unlink()
    path.write_bytes(content)


def _swap(new: Path, out: Path, old: Path) -> None:
    """Put ``new`` in the place of ``out``; if anything fails, ``out`` is one of the two."""
    if (out / ".git").exists():
        # A repository's data are moved, not copied.
        os.rename(out / ".git", new / ".git")
    if out.exists():
        # Two renames; the first is undone if the second fails.
        out.rename(old)
    try:
        new.rename(out)
    except OSError:
        if old.exists():
            old.rename(out)
        raise


def _merge_records(old: Mapping[str, Change], new: Mapping[str, Change]) -> dict[str, Change]:
    """Return the record of both instrumentations, so that undo restores the author's bytes."""
    merged = dict(old)
    for name, change in new.items():
        first = old.get(name)
        if first is None:
            merged[name] = change
        elif first.edited or change.edited:
            raise BadInputError(f"{name}: was instrumented before; undo that first (--undo)")
        else:
            merged[name] = Change(first.before, change.after, (), first.content)
    return merged


# Mass, inertia and CG given as numbers, set by editing <mass_balance>.

_STEP = re.compile(r"(\w+)(?:\[@name='(\w+)'\])?")
# Factor from the option's unit to the property's; JSBSim's ixz is minus the product of inertia.
_PROPERTIES: Mapping[str, tuple[str, float]] = {
    "mass_kg": ("inertia/mass-slugs", 1.0 / (SLUG_LB * LB_KG)),
    "ixx_kgm2": ("inertia/ixx-slugs_ft2", 1.0 / SLUG_FT2_KGM2),
    "iyy_kgm2": ("inertia/iyy-slugs_ft2", 1.0 / SLUG_FT2_KGM2),
    "izz_kgm2": ("inertia/izz-slugs_ft2", 1.0 / SLUG_FT2_KGM2),
    "ixz_kgm2": ("inertia/ixz-slugs_ft2", -1.0 / SLUG_FT2_KGM2),
    "cg_x_m": ("inertia/cg-x-in", 1.0 / IN_M),
    "cg_y_m": ("inertia/cg-y-in", 1.0 / IN_M),
    "cg_z_m": ("inertia/cg-z-in", 1.0 / IN_M),
}


@dataclass(frozen=True)
class MassProperties:
    """Mass properties of the aircraft as flown, with fuel and loads; None keeps the XML's value.

    Attributes
    ----------
    mass_kg : float or None
        Mass [kg].
    ixx_kgm2, iyy_kgm2, izz_kgm2 : float or None
        Moments of inertia about the CG in body axes [kg m2].
    ixz_kgm2 : float or None
        Product of inertia, the integral of x z over the mass [kg m2].
    cg_x_m, cg_y_m, cg_z_m : float or None
        CG in the XML's structural frame [m]: x aft, y right, z up.
    """

    mass_kg: float | None = None
    ixx_kgm2: float | None = None
    iyy_kgm2: float | None = None
    izz_kgm2: float | None = None
    ixz_kgm2: float | None = None
    cg_x_m: float | None = None
    cg_y_m: float | None = None
    cg_z_m: float | None = None

    def specified(self) -> dict[str, float]:
        """Return the values that are not None, by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: float(value) for name, value in values if value is not None}


def mass_insertions(
    aircraft: Aircraft, document: Document, mass: MassProperties
) -> tuple[Insertion, ...]:
    """Return the edits of the aircraft's XML after which JSBSim computes the mass properties.

    Other inertias keep their values.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    document : Document
        Its XML.
    mass : MassProperties
        Target values.

    Raises
    ------
    BadInputError
        For impossible values, and if a number is not in this file.
    """
    values = mass.specified()
    if not values:
        return ()
    for name, value in values.items():
        free = name.startswith(("cg", "ixz"))
        if not math.isfinite(value) or not (free or value > 0.0):
            raise BadInputError(
                f"{name} = {value:g}: a {'finite' if free else 'positive'} number is needed"
            )
    moments = [values.get(f"i{axis}{axis}_kgm2") for axis in "xyz"]
    specified = [moment for moment in moments if moment is not None]
    if len(specified) == 3 and max(specified) > sum(specified) - max(specified):
        raise BadInputError(
            f"ixx, iyy, izz = {moments} kg m2: no body has one moment of inertia above the sum of"
            " the other two"
        )
    # Numbers in the XML follow from properties in JSBSim's units.
    target = {_PROPERTIES[name][0]: _PROPERTIES[name][1] * value for name, value in values.items()}
    texts = xml_numbers_for(aircraft, target)
    return tuple(_edit(document, path, text) for path, text in texts.items())


def _edit(document: Document, path: str, text: str) -> Insertion:
    """Return the edit that writes a number into the element at ``path``, made if absent."""
    node = document.root
    steps = path.split("/")
    for step in steps[:-1]:
        node = _child(document, node, step)
    old = node.find(steps[-1])
    if old is None:
        return append_child(
            document, node, [f'<{steps[-1]} unit="SLUG*FT2"> {text} </{steps[-1]}>']
        )
    raw = document.raw
    new = (
        raw[old.start : old.open_end] + f" {text} ".encode("ascii") + raw[old.close_start : old.end]
    )
    return Insertion(old.start, new, raw[old.start : old.end])


def _child(document: Document, node: Node, step: str) -> Node:
    """Return the child that a step of a path names. Raises BadInputError."""
    match = _STEP.fullmatch(step)
    assert match is not None
    for child in node.all(match[1]):
        if match[2] is None or attribute(child, "name") == match[2]:
            return child
    raise BadInputError(
        f"{document.where(node)}: <{step}> is not in this file, so that mass properties cannot be"
        " changed"
    )


CHECK_S = 1.0
"""Flight time of the comparison with the untouched aircraft [s]."""


@dataclass(frozen=True)
class Instrumented:
    """Result of instrumenting an aircraft.

    Attributes
    ----------
    folder : Path
        Folder of the copy.
    planned : Plan
        Files, axes and places of the deltas.
    notes : tuple of str
        Remarks for the user.
    verdict : Verdict or None
        Comparison with the untouched aircraft; None if it was not flown.
    unmeasured : mapping
        Control to the reason why it could not be measured and is assumed.
    """

    folder: Path
    planned: Plan
    notes: tuple[str, ...]
    verdict: Verdict | None
    unmeasured: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"Instrumented({str(self.folder)!r},"
            f" {self.verdict.status if self.verdict is not None else 'not flown'})"
        )


def instrument_aircraft(
    aircraft: Aircraft,
    bounds: Bounds,
    out: Path,
    *,
    air: bool = False,
    check: bool = True,
    dry_run: bool = False,
    mass: MassProperties | None = None,
) -> Instrumented:
    """Copy an aircraft to ``out`` with the plugin added.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    bounds : Bounds
        Error bounds.
    out : Path
        Folder of the copy.
    air : bool
        Whether to add the air system (wind and turbulence).
    check : bool
        Whether to fly the copy against the untouched aircraft.
    dry_run : bool
        Whether to write nothing.
    mass : MassProperties, optional
        Mass properties of the copy, and of the aircraft that it is compared with.

    Returns
    -------
    Instrumented
        What was done.

    Raises
    ------
    BadInputError
        If the aircraft cannot be instrumented or the folder cannot be written.
    """
    check_loadable(aircraft)
    # A first plan refuses what cannot be instrumented before the aircraft is measured.
    plan(aircraft, bounds, None, air)
    facts, notes = None, []
    if not aircraft.has_card:
        try:
            # Sense, throws and thrust are measured in a child process.
            facts = aircraft_facts.measure_facts_in_child(aircraft.source)
        except BadInputError as error:
            if check:
                raise BadInputError(
                    f"{error}; --no-check instruments it without a simulation, for another host"
                ) from None
            facts = aircraft_facts.assumed_facts(*metrics_of(aircraft))
            facts = replace(facts, host=host_properties(aircraft))
            notes.append(f"not simulated, so the card is a guess: {error}")
    unmeasured = {
        name: control.unmeasured
        for name, control in (facts.controls if facts is not None else {}).items()
        if control.unmeasured
    }
    notes += [
        f"{name} is commanded by {control.property}, found by its effect"
        for name, control in (facts.controls if facts is not None else {}).items()
        if control.property not in ("", aircraft.card.inputs[name].property)
    ]
    assumed_rows = {row.name: row.source for row in host_properties(aircraft)}
    notes += [
        f"{row.name} is {row.source}: without it a control moves nothing"
        if re.fullmatch(r"[\d.e+-]+", row.source)
        else f"{row.name} follows {row.source}: both command one control"
        for row in (facts.host if facts is not None else ())
        if row.source != assumed_rows.get(row.name)
    ]
    if facts is not None and facts.dt_s < aircraft.dt_s:
        notes.append(
            f"its propellers are unstable at a step of {aircraft.dt_s:g} s: airframe.toml has dt_s"
            f" = {facts.dt_s:g}"
        )
    notes += [
        f"{name} could not be measured, so its sense and throw in airframe.toml are assumed:"
        f" {reason}"
        for name, reason in unmeasured.items()
    ]
    document = read_document(aircraft.xml)
    edits = mass_insertions(aircraft, document, mass or MassProperties())
    if levels := fuel_levels(aircraft):
        edits += tuple(Insertion(e.at, e.new, e.old) for e in fuel_edits(document.raw, levels))
        notes.append(describe_fuel(levels))
    # Measured facts know more: which systems must be on for a control to move.
    rows = facts.host if facts is not None and facts.host else host_properties(aircraft)
    rows = tuple(row for row in rows if not row.misspelt)
    planned = plan(aircraft, bounds, facts, air, edits, rows)
    verdict = None
    if not dry_run:
        other = out.resolve() != aircraft.folder
        write(aircraft, planned, out)
        host_properties(find_aircraft(out))
        if check and other and not planned.had_plugin:
            # The copy is flown unless it replaces the original or had the plugin before.
            verdict = _checked(aircraft, out, edits)
    return Instrumented(out, planned, (*planned.notes, *notes), verdict, unmeasured)


def _checked(aircraft: Aircraft, out: Path, edits: tuple[Insertion, ...]) -> Verdict:
    """Return the comparison with the aircraft that only differs from the author's by ``edits``."""
    if not edits:
        return check_in_child(aircraft.source, out, CHECK_S)
    with scratch_folder("mass") as scratch:
        folder = scratch.path / "aircraft" / aircraft.copy_name
        copy_folder(aircraft.folder, folder)
        copy_shared_parts(aircraft, scratch.path, engine.default_root())
        document = read_document(folder / aircraft.card.aircraft.xml)
        document.path.write_bytes(apply(document, list(edits)))
        return check_in_child(folder, out, CHECK_S)


# Temporary copies with a card, for aircraft without airframe.toml.

_LOG = logging.getLogger("uqharness")
_instrumented: dict[str, tuple[Scratch, Aircraft]] = {}


def with_card(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft if it has a card, else an instrumented copy with zero bounds.

    The copy flies identically, lasts as long as the process, and is made once for the same files.
    Raises BadInputError if the aircraft does not fly or cannot be instrumented.
    """
    if aircraft.has_card:
        return aircraft
    key = content_hash(aircraft)
    if key not in _instrumented:
        check_loadable(
            aircraft
        )  # names the user's file; later checks would name the copy and its lines
        scratch = scratch_folder("card")
        folder = scratch.path / "aircraft" / aircraft.copy_name
        folder.parent.mkdir()
        done = instrument_aircraft(aircraft, Bounds(), folder, check=False)
        for control, reason in done.unmeasured.items():
            _LOG.info(
                "%s: %s could not be measured and is assumed: %s", aircraft.name, control, reason
            )
        _instrumented[key] = scratch, find_aircraft(folder)
    return _instrumented[key][1]


# Identified values written into XML: only the number and a comment change.

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_REMARK = re.compile(rb"[ \t]*<!-- identified [^>]*?-->")


@dataclass(frozen=True)
class Estimate:
    """New value of a property, and the comment behind it in the XML (no double hyphen)."""

    value: float
    remark: str


def write_estimates(aircraft: Aircraft, estimates: Mapping[str, Estimate], out: Path) -> list[str]:
    """Copy an aircraft's folder to ``out`` with estimates written into its XML, atomically.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    estimates : mapping
        Property to estimate.
    out : Path
        New folder, or an aircraft's folder to replace.

    Returns
    -------
    list of str
        Properties that no XML file declares.

    Raises
    ------
    BadInputError
        If ``out`` holds anything but an aircraft.
    """
    if out.exists() and not (out / "airframe.toml").is_file() and any(out.iterdir()):
        raise BadInputError(
            f"{out}: exists and is no aircraft folder of an earlier run; remove it or choose"
            " another --out"
        )
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".aircraft-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(aircraft.folder, copy)
        undeclared = put_values(copy, estimates)
        old = Path(temporary) / "old"
        if out.exists():
            out.rename(old)
        copy.rename(out)
    return undeclared


def _edits(document: Document, node: Node, estimate: Estimate) -> list[Insertion]:
    """Return the edits of a declaration: its value, and the comment on its line.

    An earlier comment of this program is replaced, the author's comments are kept.
    """
    end = document.raw.find(b"\n", node.end)
    old = document.raw[node.end : None if end < 0 else end].removesuffix(b"\r")
    other_text = _REMARK.sub(b"", old).rstrip(b" \t")
    # A comment cannot be added where another comment continues on the next line.
    runs_on = b"<!--" in _COMMENT.sub(b"", other_text)
    remark = b"" if runs_on else document.encoded(f"  {comment(f'identified {estimate.remark}')}")
    number = replace_attribute(document, node, "value", f"{estimate.value:.8g}")
    return [number, Insertion(node.end, other_text + remark, old)]


def put_values(folder: Path, values: Mapping[str, Estimate]) -> list[str]:
    """Write values of properties into the XML files of a folder, in place.

    Returns the names that no file declares.
    """
    remaining = dict(values)
    for document in folder_documents(folder):
        edited = document
        # Declarations on one line are edited one after the other.
        while edits := _edits_by_line(edited, remaining):
            edited = parse_document(document.path, apply(edited, edits))
        if edited is not document:
            document.path.write_bytes(edited.raw)
    return list(remaining)


def _edits_by_line(document: Document, remaining: dict[str, Estimate]) -> list[Insertion]:
    """Return edits of declarations, one per line, and remove their names from ``remaining``."""
    edits: list[Insertion] = []
    until = -1
    for name, node in declarations(document):
        if name in remaining and node.start > until:
            edits += _edits(document, node, remaining.pop(name))
            end = document.raw.find(b"\n", node.end)
            until = len(document.raw) if end < 0 else end
    return edits


if __name__ == "__main__":
    _main(*sys.argv[1:4])
