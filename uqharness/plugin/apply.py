"""Instrument an aircraft: plan, write the folder, fly it beside the untouched aircraft."""

from __future__ import annotations

import logging
import math
import os
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

from sysid.units import IN_M, LB_KG, SLUG_FT2_KGM2, SLUG_LB
from uqharness.errors import BadInputError
from uqharness.files import Scratch, scratch_folder
from uqharness.plugin.check import Verdict, check_in_child
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
    engine,
    find_aircraft,
    model_files,
    read_xml,
    undefined_properties,
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
    declaration,
    declarations,
    folder_documents,
    parse_document,
    read_document,
    replace_attribute,
)

# Engines, propellers and systems that an aircraft takes from beside its folder: a copy that
# goes elsewhere has to carry them.


def carried_files(aircraft: Aircraft, out: Path) -> dict[str, bytes]:
    """Files to put into ``out`` (name within it to content): those that JSBSim would not find from
    there, or find others of.

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


# An instrumented aircraft's folder, whole or not at all: the copy with a plan carried out, and
# the way back.


def write(aircraft: Aircraft, planned: Plan, out: Path) -> None:
    """Copy the aircraft's folder to ``out`` with the plan carried out, and the record beside it;
    whole or not at all.

    ``out`` may be the aircraft's own folder; any other folder that exists has to be empty or an
    earlier result. Raises BadInputError."""
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
    """Write to ``out`` what ``folder`` was before it was instrumented; (file, what became of it).
    ``out`` may be ``folder``.

    Raises BadInputError where a file changed since in a way that leaves no clean way back; nothing
    is written then."""
    changes = read_record(folder)
    done = []
    with tempfile.TemporaryDirectory(dir=out.absolute().parent, prefix=".instrument-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(folder, copy, keep_links=out.resolve() == folder.resolve())
        for name, change in changes.items():
            path = copy / name
            if not path.is_file():
                if change.edited:
                    raise BadInputError(f"{folder / name}: is gone; undo cannot bring it back")
                continue
            content = restore(folder / name, change, path.read_bytes())
            if content is None:
                path.unlink()
                if not any(path.parent.iterdir()):
                    path.parent.rmdir()
                done.append((name, "removed"))
            else:
                _write_file(path, content)
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
    path.parent.mkdir(parents=True, exist_ok=True)
    # Written through a link, the file of another aircraft would change.
    if path.is_symlink():
        path.unlink()
    path.write_bytes(content)


def _swap(new: Path, out: Path, old: Path) -> None:
    """Put ``new`` in the place of ``out``; whatever fails, ``out`` is one of the two."""
    if (out / ".git").exists():
        # A working copy's own data are not ours to copy: they go over.
        os.rename(out / ".git", new / ".git")
    if out.exists():
        out.rename(old)
    try:
        new.rename(out)
    except OSError:
        if old.exists():
            old.rename(out)
        raise


def _merge_records(old: Mapping[str, Change], new: Mapping[str, Change]) -> dict[str, Change]:
    """The record of both: what an earlier instrumentation changed goes on being undone to the
    author's own bytes.
    """
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


# Mass, inertia and centre of gravity given as numbers, and the aircraft's <mass_balance> edited
# so that it has them.

_STEP = re.compile(r"(\w+)(?:\[@name='(\w+)'\])?")
# Factor from the option's unit to the property's; JSBSim's inertia/ixz-slugs_ft2 is minus the
# product of inertia.
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
    """What is known of the aircraft as it flew, fuel and loads on board included; None: as the XML
    has it.

    ``mass_kg``; moments of inertia about the centre of gravity in body axes [kg m2], ``ixz_kgm2``
    the product, the integral of x z over the mass; ``cg_x_m`` ... in the XML's own structural frame
    [m], x aft, y right, z up."""

    mass_kg: float | None = None
    ixx_kgm2: float | None = None
    iyy_kgm2: float | None = None
    izz_kgm2: float | None = None
    ixz_kgm2: float | None = None
    cg_x_m: float | None = None
    cg_y_m: float | None = None
    cg_z_m: float | None = None

    def specified(self) -> dict[str, float]:
        """Those that are given, by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: float(value) for name, value in values if value is not None}


def mass_insertions(
    aircraft: Aircraft, document: Document, mass: MassProperties
) -> tuple[Insertion, ...]:
    """The edits of ``document``, the aircraft's XML, after which JSBSim computes those mass
    properties. Empty for none.

    The other inertias stay as JSBSim computes them. Raises BadInputError for values that no body
    has, and where a number is not in this file."""
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
    if None not in moments and max(moments) > sum(moments) - max(moments):  # type: ignore[type-var, arg-type, operator]
        raise BadInputError(
            f"ixx, iyy, izz = {moments} kg m2: no body has one moment of inertia above the sum of"
            " the other two"
        )
    target = {_PROPERTIES[name][0]: _PROPERTIES[name][1] * value for name, value in values.items()}
    texts = xml_numbers_for(aircraft, target)
    return tuple(_edit(document, path, text) for path, text in texts.items())


def _edit(document: Document, path: str, text: str) -> Insertion:
    """The element at ``path`` with that number, made where there is none."""
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
"""Flight time [s] of the comparison with the untouched aircraft."""


@dataclass(frozen=True)
class Instrumented:
    """What was done to an aircraft.

    planned  files, axes and places of the deltas        notes  what to know of the result
    verdict  the comparison with the untouched aircraft; None where none was flown
    unmeasured  control -> why it could not be measured, so that its part of the card is assumed
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
    """Copy the aircraft to ``out`` with the plugin in it. ``check``: fly it beside the untouched
    one; ``dry_run``: write nothing; ``mass``: properties that the copy is to have, and with which
    it is then flown beside the untouched one.

    Raises BadInputError for an aircraft that cannot be instrumented and for a folder that cannot be
    written."""
    undefined_properties(aircraft)
    plan(aircraft, bounds, None, air)
    facts, notes = None, []
    if not aircraft.has_card:
        try:
            facts = aircraft_facts.measure_facts_in_child(aircraft.folder)
        except BadInputError as error:
            if check:
                raise BadInputError(
                    f"{error}; --no-check instruments it unflown, for a host that knows better"
                ) from None
            facts = aircraft_facts.assumed_facts(*metrics_of(aircraft))
            notes.append(f"unflown, so the card is a guess: {error}")
    unmeasured = {
        name: control.unmeasured
        for name, control in (facts.controls if facts is not None else {}).items()
        if control.unmeasured
    }
    notes += [
        f"{name} could not be measured, so its sense and throw in airframe.toml are assumed:"
        f" {reason}"
        for name, reason in unmeasured.items()
    ]
    edits = mass_insertions(aircraft, read_document(aircraft.xml), mass or MassProperties())
    planned = plan(aircraft, bounds, facts, air, edits)
    verdict = None
    if not dry_run:
        other = out.resolve() != aircraft.folder
        write(aircraft, planned, out)
        undefined_properties(find_aircraft(out))
        if check and other and not planned.had_plugin:
            verdict = _checked(aircraft, out, edits)
    return Instrumented(out, planned, (*planned.notes, *notes), verdict, unmeasured)


def _checked(aircraft: Aircraft, out: Path, edits: tuple[Insertion, ...]) -> Verdict:
    """The comparison with the aircraft that differs from its author's by ``edits`` alone."""
    if not edits:
        return check_in_child(aircraft.folder, out, CHECK_S)
    with scratch_folder("mass") as scratch:
        folder = scratch.path / "aircraft" / aircraft.folder.name
        copy_folder(aircraft.folder, folder)
        copy_shared_parts(aircraft, scratch.path, engine.default_root())
        document = read_document(folder / aircraft.xml.name)
        document.path.write_bytes(apply(document, list(edits)))
        return check_in_child(folder, out, CHECK_S)


# An aircraft that comes without airframe.toml, given one: an instrumented copy that lasts as
# long as the process.

_LOG = logging.getLogger("uqharness")
_instrumented: dict[str, tuple[Scratch, Aircraft]] = {}


def with_card(aircraft: Aircraft) -> Aircraft:
    """``aircraft`` itself where it has a card, else a copy as ``instrument`` writes it, with bounds
    of zero: it flies the same.

    Made once a process for the same files. Raises BadInputError for an aircraft that does not fly
    or cannot be instrumented."""
    if aircraft.has_card:
        return aircraft
    key = content_hash(aircraft)
    if key not in _instrumented:
        check_loadable(
            aircraft
        )  # names the user's file; later checks would name the copy and its lines
        scratch = scratch_folder("card")
        folder = scratch.path / "aircraft" / aircraft.folder.name
        folder.parent.mkdir()
        done = instrument_aircraft(aircraft, Bounds(), folder, check=False)
        for control, reason in done.unmeasured.items():
            _LOG.info(
                "%s: %s could not be measured and is assumed: %s", aircraft.name, control, reason
            )
        _instrumented[key] = scratch, find_aircraft(folder)
    return _instrumented[key][1]


# Write numbers into an aircraft's XML as a hand would: the value changes, formatting and
# comments stay, a remark says why.

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_REMARK = re.compile(rb"[ \t]*<!-- identified [^>]*?-->")


@dataclass(frozen=True)
class Estimate:
    """New value of a property and the remark that stands behind it in the XML (no double
    hyphen).
    """

    value: float
    remark: str


def write_estimates(aircraft: Aircraft, estimates: Mapping[str, Estimate], out: Path) -> list[str]:
    """Copy the aircraft's folder to ``out`` with the estimates in its XML; names that no XML file
    declares are returned.

    The copy appears whole or not at all; an existing ``out`` is replaced only if it is an
    aircraft's folder. Raises BadInputError."""
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


def with_value(document: Document, name: str, estimate: Estimate) -> bytes | None:
    """The file with another number in ``<property value="...">name</property>``; None where it does
    not declare the property.

    An earlier remark of ours is replaced as well; the author's comments are not.
    """
    node = declaration(document, name)
    return None if node is None else apply(document, _edits(document, node, estimate))


def _edits(document: Document, node: Node, estimate: Estimate) -> list[Insertion]:
    end = document.raw.find(b"\n", node.end)
    old = document.raw[node.end : None if end < 0 else end].removesuffix(b"\r")
    other_text = _REMARK.sub(b"", old).rstrip(b" \t")
    # A remark inside a comment that runs over lines would end it early; such a line keeps its
    # number alone.
    runs_on = b"<!--" in _COMMENT.sub(b"", other_text)
    remark = b"" if runs_on else document.encoded(f"  {comment(f'identified {estimate.remark}')}")
    number = replace_attribute(document, node, "value", f"{estimate.value:.8g}")
    return [number, Insertion(node.end, other_text + remark, old)]


def put_values(folder: Path, values: Mapping[str, Estimate]) -> list[str]:
    """Write values of properties into the XML files of a folder, in place; names that no file
    declares are returned.
    """
    remaining = dict(values)
    for document in folder_documents(folder):
        edited = document
        while edits := _edits_by_line(edited, remaining):
            edited = parse_document(document.path, apply(edited, edits))
        if edited is not document:
            document.path.write_bytes(edited.raw)
    return list(remaining)


def _edits_by_line(document: Document, remaining: dict[str, Estimate]) -> list[Insertion]:
    """Edits of the declarations of a file's properties ``remaining``, one to a line; the properties are
    taken out of ``remaining``.
    """
    edits: list[Insertion] = []
    until = -1
    for name, node in declarations(document):
        if name in remaining and node.start > until:
            edits += _edits(document, node, remaining.pop(name))
            end = document.raw.find(b"\n", node.end)
            until = len(document.raw) if end < 0 else end
    return edits
