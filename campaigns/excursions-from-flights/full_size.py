"""Tables 3.1 and 3.2 with bounds from flights: 24 cells of wind and turbulence, 64 corners, 50
flights of an hour each.

    python -m campaigns.excursions-from-flights.full_size identified fly  # resumes too
    python -m campaigns.excursions-from-flights.full_size refined status
    python -m campaigns.excursions-from-flights.full_size identified tables
    python -m campaigns.excursions-from-flights.full_size identified rerun --cell severe-3
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from campaigns.excursions.full_size import tables
from campaigns.library.command import Study, main
from campaigns.library.plan import Plan

HOME = Path(__file__).parent
MODELS = {
    "identified": "Tables 3.1 and 3.2: the identified model within the bounds of its flights",
    "refined": "Tables 3.1 and 3.2: the refined model within the bounds of its flights",
}
FLIGHTS, AIRS = 50, 25
"""Flights of an hour per corner and cell, and those of a shard: 1600 hours, some 145 s of each of
two cores that fly."""


def plan(model: str) -> Plan:
    """Plan all cells of a model."""
    return Plan.read(HOME / model / "campaign.toml", AIRS).with_flights(FLIGHTS)


def study(model: str) -> Study:
    """Return the campaign of a model of MODELS."""
    module = f"campaigns.excursions-from-flights.full_size {model}"
    return Study(module, MODELS[model], lambda: plan(model), HOME / model, tables)


def run(words: Sequence[str]) -> int:
    """Run a command of campaigns/library/command.py for the model that the first word names; 2 for
    another."""
    if not words or words[0] not in MODELS:
        print(
            f"which model? received {words[0] if words else 'none'}; there are {', '.join(MODELS)}",
            file=sys.stderr,
        )
        return 2
    return main(study(words[0]), words[1:])


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
