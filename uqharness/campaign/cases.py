"""Campaign -> cases: every flight of a campaign, in its one order, with its identity.

Order: aleatory sample, then condition, then epistemic sample. A run that is stopped early has
therefore flown every corner equally often, and its p-boxes mean something."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.digests import sha256_hex
from uqharness.campaign.conditions import counted_radii
from uqharness.campaign.execution.worker import BATCH, JSBSIM, Group
from uqharness.campaign.spec.campaign import CampaignSpec, VariableSection
from uqharness.campaign.spec.samples import NOMINAL, Epistemic, epistemic_samples
from uqharness.errors import BadInputError
from uqharness.flight import (
    COEFFICIENTS,
    FlightSpec,
    TransientDriver,
    flight_seed,
    numbered_stream,
    random_numbers,
)


@dataclass(frozen=True)
class Mission:
    """The files a campaign flies: where they are, and the hash of what is in them (a path is no
    part of an identity).

    ``source`` is the aircraft that ``aircraft`` is a copy of, where it is one.
    """

    aircraft: Path
    aircraft_hash: str
    script: Path
    script_hash: str
    source: Path = Path()


@dataclass(frozen=True)
class Case:
    """One flight of a campaign. ``seed`` is the turbulence stream's; ``flight`` is all that a
    worker of ``engine`` needs.

    ``levels`` holds the levels that stand still; ``inputs``, by column name, what else was drawn or
    chosen for it."""

    case_id: str
    epistemic_id: str
    levels: Mapping[str, float]
    aleatory_id: int
    wind_mps: float
    turbulence: str
    seed: int
    flight: FlightSpec
    inputs: Mapping[str, float] = dataclasses.field(default_factory=dict)
    engine: str = JSBSIM


def uq_properties(spec: CampaignSpec, sample: Epistemic) -> dict[str, float]:
    """Properties that put the plugin's deltas at the sample's levels and switch off the
    coefficients that are certain.

    Bounds given as numbers are written over the aircraft's own, those of a certain coefficient as
    zero; bounds that the aircraft computes stay, and a certain coefficient is switched off by its
    uq/<C>/active."""
    varied = sample.driver.coefficients if sample.driver is not None else tuple(sample.levels)
    if not varied:
        return {}
    properties = {"uq/active": 1.0}
    bounds = spec.epistemic.bounds
    for name in COEFFICIENTS:
        if name in sample.levels:
            properties[f"uq/{name}/level"] = float(sample.levels[name])
        if isinstance(bounds, dict):
            lower, upper = bounds[name] if name in varied else (0.0, 0.0)  # type: ignore[index]
            properties[f"uq/{name}/lower"], properties[f"uq/{name}/upper"] = lower, upper
        elif name not in varied:
            properties[f"uq/{name}/active"] = 0.0
    return properties


@dataclass(frozen=True)
class Part:
    """Part of a campaign: aleatory ids, conditions (wind [m/s], turbulence), and places of its
    epistemic samples (None: all).
    """

    aleatory_ids: range
    conditions: tuple[tuple[float, str], ...]
    samples: range | None = None


def build_cases(spec: CampaignSpec, mission: Mission, part: Part | None = None) -> tuple[Case, ...]:
    """All cases of the campaign, or of a part of it, in case order. Depends on nothing but its
    arguments.

    An engine not settled is JSBSim.
    """
    air = spec.aleatory
    all_cases = Part(range(air.flights), tuple(itertools.product(air.wind_mps, air.turbulence)))
    return tuple(_cases(spec, mission, part or all_cases))


def _cases(spec: CampaignSpec, mission: Mission, part: Part) -> Iterator[Case]:
    air, root_seed = spec.aleatory, spec.campaign.seed
    engine = BATCH if spec.campaign.engine == BATCH else JSBSIM
    radii = counted_radii(dict(spec.metrics))
    requested_samples = epistemic_samples(spec)
    if part.samples is not None:
        requested_samples = requested_samples[part.samples.start : part.samples.stop]
    samples = [
        (sample, uq_properties(spec, sample) | dict(sample.parameters))
        for sample in requested_samples
    ]
    _refuse_conflicting_properties(samples[0][1], air.variables)
    for aleatory_id in part.aleatory_ids:
        seed_turbulence = flight_seed(root_seed, aleatory_id, "turbulence")
        seed_noise = flight_seed(root_seed, aleatory_id, "noise")
        draws = {
            name: unit_draw(root_seed, aleatory_id, name, item)
            for name, item in air.variables.items()
        }
        transient = _transient(spec, aleatory_id)
        for wind_mps, turbulence in part.conditions:
            for sample, properties in samples:
                values = {
                    name: item.value(draws[name], sample.means.get(name, 0.5))
                    for name, item in air.variables.items()
                }
                flight = FlightSpec(
                    aircraft=mission.aircraft,
                    script=mission.script,
                    duration_s=float(air.duration_s),
                    burn_in_s=float(air.burn_in_s),
                    wind_mps=float(wind_mps),
                    wind_from_deg=float(air.wind_from_deg),
                    turbulence=turbulence,
                    turbulence_source=air.turbulence_source,
                    sensor_noise=air.sensor_noise is not False,
                    seed_turbulence=seed_turbulence,
                    seed_noise=seed_noise,
                    properties=properties | values if values else properties,
                    excursion_radius_m=radii,
                    rearm_m=float(spec.metrics.rearm_m),
                    levels=sample.driver,
                    transient=None if sample.epistemic_id.startswith(NOMINAL) else transient,
                )
                yield Case(
                    case_id=case_id(flight, mission, engine),
                    epistemic_id=sample.epistemic_id,
                    levels=sample.levels,
                    aleatory_id=aleatory_id,
                    wind_mps=flight.wind_mps,
                    turbulence=turbulence,
                    seed=seed_turbulence,
                    flight=flight,
                    inputs=_columns(sample, values),
                    engine=engine,
                )


def _transient(spec: CampaignSpec, aleatory_id: int) -> TransientDriver | None:
    rates = spec.inputs.transient_rates
    if not rates:
        return None
    return TransientDriver(
        spec.campaign.seed, aleatory_id, tuple(rates), tuple(map(float, rates.values()))
    )


def unit_draw(root_seed: int, aleatory_id: int, name: str, variable: VariableSection) -> float:
    """A variable's draw in its unit: standard normal, or uniform in -1..1.

    Depends on (root seed, aleatory id, property) alone.
    """
    seed_sequence = numbered_stream(root_seed, "variable", aleatory_id, name)
    if variable.distribution == "normal":
        return float(random_numbers.drawn(seed_sequence, 1)[0])
    return float(np.random.Generator(np.random.PCG64(seed_sequence)).uniform(-1.0, 1.0))


def _columns(sample: Epistemic, values: Mapping[str, float]) -> dict[str, float]:
    columns = {f"level_{name}": level for name, level in sample.means.items()}
    columns |= {f"parameter_{name}": value for name, value in sample.parameters.items()}
    return columns | {f"variable_{name}": value for name, value in values.items()}


def _refuse_conflicting_properties(
    properties: Mapping[str, float], variables: Mapping[str, VariableSection]
) -> None:
    conflicting = [name for name in variables if name in properties]
    if conflicting:
        raise BadInputError(
            f'[aleatory.variables."{conflicting[0]}"]: the property is set by [epistemic] as well; it can'
            " be either random from flight to flight or unknown, not both: give one of them (an"
            " unknown mean is an interval)"
        )


_FIELDS = tuple(
    field.name
    for field in dataclasses.fields(FlightSpec)
    if field.name not in ("levels", "transient")
)


def case_id(flight: FlightSpec, mission: Mission, engine: str = JSBSIM) -> str:
    """16 hex digits over everything that defines the flight: content of the files, numbers, seeds,
    properties, engine.
    """
    identity = {name: getattr(flight, name) for name in _FIELDS}
    # A flight whose levels stand still is the flight it was before they could move.
    identity |= {"levels": dataclasses.asdict(flight.levels)} if flight.levels is not None else {}
    identity |= (
        {"transient": dataclasses.asdict(flight.transient)} if flight.transient is not None else {}
    )
    # JSBSim's are the flights they were before there was another engine.
    identity |= {"engine": engine} if engine != JSBSIM else {}
    identity |= {
        "aircraft": mission.aircraft_hash,
        "script": mission.script_hash,
        "properties": dict(flight.properties),
    }
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"))
    return sha256_hex(text.encode())[:16]


# Which cases the batch engine flies together: all corners in the same air side by side, several
# airs of one condition.

GROUP_S = 20.0
"""Core time that a group should take: a kill loses no more, and what a worker does once a group
does not show.
"""
FLIGHT_S_PER_CORE_S = 90_000.0
"""Flight time over core time of the batch engine, roughly; only sizes of groups depend on it."""
MAX_LANES = 1024
MIN_LANES = 64
"""Below that vectors and steps are badly used."""
_GROUPS_PER_WORKER = 4


def lanes_per_group(cases: Sequence[Case], workers: int) -> int:
    """Cases to fly together: some 20 s of a core, and a few groups for every worker where there are
    cases enough.
    """
    flight = cases[0].flight
    by_time = GROUP_S * FLIGHT_S_PER_CORE_S / (flight.duration_s + flight.burn_in_s)
    by_worker = math.ceil(len(cases) / (_GROUPS_PER_WORKER * max(workers, 1)))
    return min(MAX_LANES, max(1, int(by_time)), max(MIN_LANES, by_worker))


def group_cases(cases: Sequence[Case], workers: int) -> list[Group]:
    """Cases of one condition each, in case order; the largest groups first, so that no worker waits
    long for the last.
    """
    if not cases:
        return []
    lanes = lanes_per_group(cases, workers)
    corners = len({case.epistemic_id for case in cases})
    if lanes > corners:
        # Whole airs: streams of air and noise are made once for all who fly in it.
        lanes -= lanes % corners
    place = {case.case_id: number for number, case in enumerate(cases)}
    by_condition: dict[tuple[float, str], list[Case]] = {}
    for case in cases:
        by_condition.setdefault((case.wind_mps, case.turbulence), []).append(case)
    groups = [
        Group(BATCH, tuple((case.case_id, case.flight) for case in members[first : first + lanes]))
        for members in by_condition.values()
        for first in range(0, len(members), lanes)
    ]
    return sorted(groups, key=lambda group: (-len(group.cases), place[group.cases[0][0]]))
