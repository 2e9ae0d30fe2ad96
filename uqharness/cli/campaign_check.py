"""``uqharness campaign check``: what a campaign is going to cost, said without flying it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqharness.cli.verb_parser import add_verb, asked_campaign

if TYPE_CHECKING:
    from uqharness.campaign.cost import Cost

_EXAMPLE = """example:
  uqharness campaign check campaigns/demo/campaign.toml

Flights, flight hours, expected time on this machine and disk. Flies the check flight alone, and keeps nothing of it.
Exit codes: 0 done, 2 bad input (a model that cannot be flown included)."""


def register(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verb to those of ``campaign``."""
    check = add_verb(verbs, "check", "what a campaign costs, before it is flown", _EXAMPLE)
    check.add_argument(
        "campaign", type=Path, metavar="CAMPAIGN.toml", help="what would be flown: a file, or a name under campaigns/"
    )
    check.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    check.add_argument(
        "--hours", type=float, metavar="H", help="flight hours per corner and condition, in place of [aleatory] flights"
    )
    check.add_argument("--samples", type=int, metavar="N", help="epistemic samples to draw, in place of [epistemic] samples")
    check.set_defaults(handler=_check)


def _check(args: argparse.Namespace) -> int:
    from uqharness.campaign.aircraft import make_copy, needs_copy
    from uqharness.campaign.cost import Cost, one_case, size_of
    from uqharness.campaign.execution.processes import usable_cores
    from uqharness.campaign.run import find_mission, validate_model
    from uqharness.errors import BadInputError
    from uqharness.flight.fly import fly
    from uqharness.scratch import scratch_folder

    spec = asked_campaign(args)
    workers = usable_cores() if args.workers is None else args.workers
    if workers < 1:
        raise BadInputError(f"--workers {workers}: must be at least 1")
    with scratch_folder("check") as scratch:
        mission = find_mission(spec, scratch.path)
        if needs_copy(spec):
            make_copy(spec, mission, scratch.path)
        pace = validate_model(fly, one_case(spec, mission))
    cost = Cost(size_of(spec), 0, pace, workers)
    print(json.dumps(_as_json(cost)) if args.json else f"{args.campaign}: {cost.words}{_asked(cost)}")
    return 0


def _asked(cost: Cost) -> str:
    return "; more than a day of this machine: `campaign run` wants --yes or --hours" if cost.is_long else ""


def _as_json(cost: Cost) -> dict[str, Any]:
    size = cost.size
    return {
        "flights": size.flights,
        "at_most": size.at_most,
        "flights_each": size.aleatory,
        "conditions": size.conditions,
        "epistemic_samples": size.epistemic,
        "flight_hours": size.hours,
        "workers": cost.workers,
        "expected_s": cost.seconds,
        "disk_bytes": size.disk_bytes,
        "more_than_a_day": cost.is_long,
    }
