"""A campaign of many hours as shards, each some minutes of one core, in the order in which they are
flown."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from campaigns.library.grid import RESOLUTION
from uqharness.campaign import CampaignSpec
from uqharness.campaign.cases import Case, Mission, Part, build_cases
from uqharness.campaign.conditions import Condition
from uqharness.campaign.engines import make_copy, needs_copy
from uqharness.campaign.manifest import digest_of_rows
from uqharness.campaign.read_spec import read_campaign, with_samples
from uqharness.campaign.run import find_mission
from uqharness.campaign.sampling import epistemic_samples
from uqharness.errors import BadInputError

COPY = "results-copy"
"""Folder of what flies where the campaign's own aircraft gets bounds; it is made again where it is
missing."""


@dataclass(frozen=True)
class Shard:
    """Flights of one condition that are flown in one go: some aleatory ids, some or all epistemic
    samples."""

    condition: Condition
    number: int
    part: Part

    @property
    def cell(self) -> str:
        """Folder of its condition: ``severe-3``."""
        return cell_name(self.condition)

    @property
    def file(self) -> str:
        """Path within the folder of shards."""
        return f"{self.cell}/{self.number:03d}.parquet"


@dataclass(frozen=True)
class Plan:
    """A campaign, and the flights of a shard: ``airs`` aleatory ids, ``samples`` epistemic ones (0:
    all), ``lanes`` side by side.

    ``resolution`` is that of the grid on which medians and maxima are kept
    (campaigns/library/grid.py). Memory is bounded by the lanes: a process that flies 256 flights of
    an hour at 100 Hz takes 1.15 GB at most.
    """

    spec: CampaignSpec
    mission: Mission
    airs: int
    samples: int = 0
    lanes: int = 256
    resolution: float = RESOLUTION

    @classmethod
    def read(
        cls, campaign: Path, airs: int, samples: int = 0, resolution: float = RESOLUTION
    ) -> Plan:
        """Plan a campaign file in the batch engine; an aircraft with bounds from a model form is
        copied to COPY beside the file.

        Raises BadInputError.
        """
        spec, folder = read_campaign(campaign).with_engine("batch"), campaign.parent / COPY
        mission = find_mission(spec, folder)
        if needs_copy(spec):
            folder.mkdir(exist_ok=True)
            make_copy(spec, mission, folder)
        return cls(spec, mission, airs, samples, resolution=resolution)

    @property
    def conditions(self) -> list[Condition]:
        """All conditions, the hardest air first: it decides, and has its hours first."""
        air = self.spec.aleatory
        return [
            Condition(float(wind), kind)
            for kind in reversed(air.turbulence)
            for wind in reversed(air.wind_mps)
        ]

    @property
    def epistemic_ids(self) -> list[str]:
        """Ids of the epistemic samples in order."""
        return [sample.epistemic_id for sample in epistemic_samples(self.spec)]

    def shards(self) -> Iterator[Shard]:
        """Yield all shards: a first one of every condition before the second of any, so that all
        have hours at any time."""
        flights, count = self.spec.aleatory.flights, len(self.epistemic_ids)
        each = self.samples or count
        blocks = list(itertools.product(range(0, flights, self.airs), range(0, count, each)))
        for number, (air, sample) in enumerate(blocks):
            ids = range(air, min(air + self.airs, flights))
            samples = range(sample, min(sample + each, count))
            for condition in self.conditions:
                air_of = ((condition.wind_mps, condition.turbulence),)
                yield Shard(condition, number, Part(ids, air_of, samples))

    def cases(self, shard: Shard) -> tuple[Case, ...]:
        """Build the shard's flights in case order."""
        return build_cases(self.spec, self.mission, shard.part)

    def condition(self, cell: str) -> Condition:
        """Return the condition of a cell's folder. Raises BadInputError."""
        by_name = {cell_name(condition): condition for condition in self.conditions}
        if cell not in by_name:
            raise BadInputError(f"--cell {cell}: not one of {', '.join(by_name)}")
        return by_name[cell]

    def only(self, cells: list[str]) -> Iterator[Shard]:
        """Return the shards of some cells, of all where none is named. Raises BadInputError."""
        conditions = {self.condition(cell) for cell in cells} or set(self.conditions)
        return (shard for shard in self.shards() if shard.condition in conditions)

    def with_flights(self, flights: int) -> Plan:
        """Return the plan with other flights per epistemic sample and condition."""
        return dataclasses.replace(self, spec=self.spec.with_flights(flights))

    def with_samples(self, samples: int) -> Plan:
        """Return the plan with another number of drawn epistemic samples. Raises BadInputError
        where none are drawn."""
        return dataclasses.replace(self, spec=with_samples(self.spec, samples))


def cell_name(condition: Condition) -> str:
    """Return the folder of a condition."""
    return f"{condition.turbulence}-{condition.wind_mps:g}"


def identity(cases: tuple[Case, ...]) -> str:
    """Digest everything that defines the flights: files' content, numbers, seeds, engine."""
    return digest_of_rows(case.case_id for case in cases)
