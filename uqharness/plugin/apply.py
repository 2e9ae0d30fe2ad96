"""Instrument an aircraft: plan, write the folder, fly it beside the untouched aircraft."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.plugin.check import Verdict, check_in_child
from uqharness.plugin.folder import write
from uqharness.plugin.instrument import Bounds, Plan, metrics_of, plan
from uqharness.simulator import Aircraft, aircraft_facts, check_loadable, find_aircraft

CHECK_S = 1.0
"""Flight time [s] of the comparison with the untouched aircraft."""


@dataclass(frozen=True)
class Instrumented:
    """What was done to an aircraft.

    planned  files, axes and places of the deltas        notes  what to know of the result
    verdict  the comparison with the untouched aircraft; None where none was flown
    """

    folder: Path
    planned: Plan
    notes: tuple[str, ...]
    verdict: Verdict | None

    def __repr__(self) -> str:
        return f"Instrumented({str(self.folder)!r}, {self.verdict.status if self.verdict is not None else 'not flown'})"


def instrument_aircraft(
    aircraft: Aircraft, bounds: Bounds, out: Path, *, air: bool = False, check: bool = True, dry_run: bool = False
) -> Instrumented:
    """Copy the aircraft to ``out`` with the plugin in it. ``check``: fly it beside the untouched one; ``dry_run``: write nothing.

    Raises BadInputError for an aircraft that cannot be instrumented and for a folder that cannot be written.
    """
    check_loadable(aircraft)
    plan(aircraft, bounds, None, air)
    facts, notes = None, []
    if not aircraft.has_card:
        try:
            facts = aircraft_facts.ask_in_child(aircraft.folder)
        except BadInputError as error:
            if check:
                raise BadInputError(f"{error}; --no-check instruments it unflown, for a host that knows better") from None
            facts = aircraft_facts.assumed(*metrics_of(aircraft))
            notes.append(f"unflown, so the card is a guess: {error}")
    planned = plan(aircraft, bounds, facts, air)
    verdict = None
    if not dry_run:
        untouched = aircraft.folder if out.resolve() != aircraft.folder else None
        write(aircraft, planned, out)
        check_loadable(find_aircraft(out))
        if check and untouched is not None and not planned.had_plugin:
            verdict = check_in_child(untouched, out, CHECK_S)
    return Instrumented(out, planned, (*planned.notes, *notes), verdict)
