"""Which engine flies a campaign, settled once for all its flights, and why."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uqharness.campaign.aircraft import make_copy, needs_copy
from uqharness.campaign.cases import Mission
from uqharness.campaign.cost import one_case_each
from uqharness.campaign.execution.flying import BATCH, JSBSIM, Batch, OwnBatch, fly_group
from uqharness.campaign.execution.worker import FlightFunction, GroupFunction, OneByOne
from uqharness.campaign.folder.manifest import MANIFEST, read_manifest
from uqharness.campaign.folder.shards import SHARDS, shard_folders
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec
from uqharness.scratch import scratch_folder
from uqharness.simulator import SCRIPT

_ASKED = "it was asked for"
_SHOWN = 8


@dataclass(frozen=True)
class Engines:
    """What there is to fly with: ``fly`` is JSBSim's, ``fly_group`` flies in any engine, ``batch`` says what it understands.

    ``no_batch`` is why there is no ``batch``.
    """

    fly: FlightFunction
    fly_group: GroupFunction
    batch: Batch | None
    no_batch: str = ""

    @staticmethod
    def of(fly: FlightFunction | Engines | None) -> Engines:
        """This program's own where nothing is given; a flight function by itself flies one flight after the other."""
        if isinstance(fly, Engines):
            return fly
        if fly is not None:
            return Engines(
                fly, OneByOne(fly), None, "the flights are flown by a function of their own"
            )
        from uqharness.flight.fly import fly as own

        return Engines(own, fly_group, OwnBatch())

    def unavailable(self) -> str | None:
        """Why the batch engine cannot fly on this machine; None if it can."""
        return self.no_batch if self.batch is None else self.batch.available()


@dataclass(frozen=True)
class Settled:
    """A campaign whose engine is settled: ``spec`` has its name, ``asked`` what was asked for, ``why`` the reasons."""

    spec: CampaignSpec
    asked: str
    why: tuple[str, ...]

    @property
    def engine(self) -> str:
        """Name of the engine: batch or jsbsim."""
        return self.spec.campaign.engine

    @property
    def words(self) -> str:
        """The engine and why, in one line."""
        return engine_words(self.engine, self.why)

    def as_dict(self) -> dict[str, Any]:
        """What a manifest keeps beside the engine's name."""
        return {"asked": self.asked, "why": list(self.why)}


def engine_words(engine: str, why: tuple[str, ...]) -> str:
    """``jsbsim, because ...``: the first reasons."""
    more = f"; and {len(why) - _SHOWN} more" if len(why) > _SHOWN else ""
    return f"{engine}, because {'; '.join(why[:_SHOWN])}{more}" if why else engine


@dataclass(frozen=True)
class Earlier:
    """The engine of a campaign that has begun, and why it was taken."""

    engine: str
    why: tuple[str, ...] = ()


def settle(
    spec: CampaignSpec, mission: Mission, engines: Engines, earlier: Earlier | None = None
) -> Settled:
    """Settle the engine of a campaign: what is asked for, else that of its ``earlier`` flights, else batch where it can fly it.

    Raises BadInputError where the batch engine is asked for, or flew before, and cannot fly it here.
    """
    asked = spec.campaign.engine
    goes_on = earlier is not None and asked in ("auto", earlier.engine)
    wanted, why = (
        (earlier.engine, earlier.why) if earlier is not None and goes_on else (asked, (_ASKED,))
    )
    if wanted == JSBSIM:
        return Settled(spec.with_engine(JSBSIM), asked, why)
    if goes_on and wanted == BATCH:
        # What it understands was asked at the first run, of the same aircraft and version.
        reason = engines.unavailable()
        if reason is not None:
            raise BadInputError(
                f"{spec.path}: this campaign flies in the batch engine, and {reason}; fly it where it began"
            )
        return Settled(spec.with_engine(BATCH), asked, why)
    reasons = reasons_against(spec, mission, engines)
    if wanted == BATCH:
        if reasons:
            raise BadInputError(
                f"{spec.path}: the batch engine was asked for and cannot fly this campaign:",
                *reasons,
            )
        return Settled(spec.with_engine(BATCH), asked, (_ASKED,))
    if reasons:
        return Settled(spec.with_engine(JSBSIM), asked, reasons)
    return Settled(
        spec.with_engine(BATCH), asked, ("it understands the whole aircraft and mission",)
    )


def reasons_against(spec: CampaignSpec, mission: Mission, engines: Engines) -> tuple[str, ...]:
    """Why the batch engine cannot fly this campaign, a sentence each; empty if it can."""
    reason = engines.unavailable()
    if reason is not None or engines.batch is None:
        return (reason or engines.no_batch,)
    varying = varying_properties(spec)
    with laid_out(spec, mission) as there:
        found = [
            text
            for case in one_case_each(spec, there)
            for text in _refusals(engines.batch, case.flight, varying)
        ]
        return tuple(
            dict.fromkeys(
                text.replace(str(there.aircraft), str(mission.aircraft)) for text in found
            )
        )


def _refusals(batch: Batch, flight: FlightSpec, varying: tuple[str, ...]) -> tuple[str, ...]:
    try:
        return batch.refusals(flight, varying)
    except Exception as error:
        # A defect of one engine is no reason to fly in none.
        return (
            f"the batch engine failed at reading {flight.aircraft.name}: {type(error).__name__}: {error}",
        )


def varying_properties(spec: CampaignSpec) -> tuple[str, ...]:
    """Properties whose values differ between the cases of a campaign."""
    moved = () if spec.epistemic.method == "none" else spec.inputs.coefficients
    names = [f"uq/{name}/level" for name in moved]
    if spec.epistemic.parameters is not None and spec.inputs.estimates is not None:
        names += spec.inputs.estimates.names
    return tuple(dict.fromkeys([*names, *spec.aleatory.variables]))


def earlier_engine(folder: Path) -> Earlier | None:
    """Engine of the campaign whose flights ``folder`` holds, or those of the shards beside it; None where there are none."""
    beside = shard_folders(folder.parent.parent) if folder.parent.name == SHARDS else []
    for place in (folder, *beside):
        if (place / MANIFEST).exists():
            # What is wrong with it is said by whoever goes on with the campaign.
            with contextlib.suppress(BadInputError):
                manifest = read_manifest(place)
                engine = str(manifest["campaign"]["campaign"]["engine"])
                if engine in (BATCH, JSBSIM):
                    return Earlier(engine, tuple(manifest.get("engine", {}).get("why", ())))
    return None


@contextlib.contextmanager
def laid_out(spec: CampaignSpec, mission: Mission) -> Iterator[Mission]:
    """The mission with an aircraft to look at, where the copy that is going to fly has not been made yet."""
    if not needs_copy(spec) or mission.aircraft.exists():
        yield mission
        return
    with scratch_folder("engine") as scratch:
        aircraft = scratch.path / mission.aircraft.parent.name / mission.aircraft.name
        script = scratch.path / SCRIPT if spec.start is not None else mission.script
        there = dataclasses.replace(mission, aircraft=aircraft, script=script)
        make_copy(spec, there, scratch.path)
        yield there
