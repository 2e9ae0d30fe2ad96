"""Instrument an aircraft: plan, write the folder, fly it beside the untouched aircraft."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.plugin.check import Verdict, check_in_child
from uqharness.plugin.folder import write
from uqharness.plugin.instrument import Bounds, Plan, metrics_of, plan
from uqharness.plugin.mass import MassProperties, mass_insertions
from uqharness.scratch import scratch_folder
from uqharness.simulator import (
    Aircraft,
    aircraft_facts,
    copy_beside,
    copy_folder,
    engine,
    find_aircraft,
    undefined_properties,
)
from uqharness.xml import Insertion, apply, read_document

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
        return f"Instrumented({str(self.folder)!r}, {self.verdict.status if self.verdict is not None else 'not flown'})"


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
    """Copy the aircraft to ``out`` with the plugin in it. ``check``: fly it beside the untouched one; ``dry_run``: write nothing;
    ``mass``: properties that the copy is to have, and with which it is then flown beside the untouched one.

    Raises BadInputError for an aircraft that cannot be instrumented and for a folder that cannot be written.
    """
    undefined_properties(aircraft)
    plan(aircraft, bounds, None, air)
    facts, notes = None, []
    if not aircraft.has_card:
        try:
            facts = aircraft_facts.ask_in_child(aircraft.folder)
        except BadInputError as error:
            if check:
                raise BadInputError(
                    f"{error}; --no-check instruments it unflown, for a host that knows better"
                ) from None
            facts = aircraft_facts.assumed(*metrics_of(aircraft))
            notes.append(f"unflown, so the card is a guess: {error}")
    unmeasured = {
        name: control.unmeasured
        for name, control in (facts.controls if facts is not None else {}).items()
        if control.unmeasured
    }
    notes += [
        f"{name} could not be measured, so its sense and throw in airframe.toml are assumed: {reason}"
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
        copy_beside(aircraft, scratch.path, engine.default_root())
        document = read_document(folder / aircraft.xml.name)
        document.path.write_bytes(apply(document, list(edits)))
        return check_in_child(folder, out, CHECK_S)
