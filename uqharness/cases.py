"""Campaign -> cases: every flight of a campaign, in its one order, with its identity.

Order: aleatory sample, then condition, then epistemic sample. A run that is stopped early has therefore flown every
corner equally often, and its p-boxes mean something.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from uqharness.campaign_spec import CampaignSpec
from uqharness.flight_spec import COEFFICIENTS, FlightSpec
from uqharness.seeds import flight_seed


@dataclass(frozen=True)
class Mission:
    """The files a campaign flies: where they are, and the hash of what is in them (a path is no part of an identity)."""

    aircraft: Path
    aircraft_hash: str
    script: Path
    script_hash: str


@dataclass(frozen=True)
class Epistemic:
    """One epistemic sample: its id and the level, 0..1, of each coefficient that is uncertain in it."""

    epistemic_id: str
    levels: Mapping[str, float]


@dataclass(frozen=True)
class Case:
    """One flight of a campaign. ``seed`` is the turbulence stream's; ``flight`` is all that a worker needs."""

    case_id: str
    epistemic_id: str
    levels: Mapping[str, float]
    aleatory_id: int
    wind_mps: float
    turbulence: str
    seed: int
    flight: FlightSpec


def epistemic_samples(spec: CampaignSpec) -> tuple[Epistemic, ...]:
    """The epistemic samples, first coefficient slowest.

    A corner's id has one digit per coefficient in the order CX CY CZ Cl Cm Cn (``-`` for one that is not uncertain).
    """
    section = spec.epistemic
    if section.method == "none":
        return (Epistemic("nominal", {}),)
    values = (0.0, 1.0) if section.method == "corners" else section.levels or ()
    separator = "" if section.method == "corners" else "/"
    samples = []
    for combination in itertools.product(values, repeat=len(section.coefficients)):
        levels: dict[str, float] = dict(zip(section.coefficients, combination, strict=True))
        marks = (f"{levels[name]:.17g}" if name in levels else "-" for name in COEFFICIENTS)
        samples.append(Epistemic(separator.join(marks), levels))
    return tuple(samples)


def uq_properties(spec: CampaignSpec, sample: Epistemic) -> dict[str, float]:
    """Properties that put the plugin's deltas at the sample's levels. A certain coefficient gets bounds of zero."""
    if not sample.levels:
        return {}
    properties = {"uq/active": 1.0}
    bounds = spec.epistemic.bounds
    for name in COEFFICIENTS:
        if name in sample.levels:
            properties[f"uq/{name}/level"] = float(sample.levels[name])
            if bounds is None:
                continue
            lower, upper = bounds[name]  # type: ignore[index]
        else:
            lower = upper = 0.0
        properties[f"uq/{name}/lower"], properties[f"uq/{name}/upper"] = lower, upper
    return properties


def build_cases(spec: CampaignSpec, mission: Mission) -> tuple[Case, ...]:
    """All cases of the campaign, in case order. Depends on nothing but its arguments."""
    return tuple(_cases(spec, mission))


def _cases(spec: CampaignSpec, mission: Mission) -> Iterator[Case]:
    air, root_seed = spec.aleatory, spec.campaign.seed
    samples = [(sample, uq_properties(spec, sample)) for sample in epistemic_samples(spec)]
    for aleatory_id in range(air.flights):
        seed_turbulence = flight_seed(root_seed, aleatory_id, "turbulence")
        seed_noise = flight_seed(root_seed, aleatory_id, "noise")
        for wind_mps, turbulence in itertools.product(air.wind_mps, air.turbulence):
            for sample, properties in samples:
                flight = FlightSpec(
                    aircraft=mission.aircraft,
                    script=mission.script,
                    duration_s=float(air.duration_s),
                    burn_in_s=float(air.burn_in_s),
                    wind_mps=float(wind_mps),
                    wind_from_deg=float(air.wind_from_deg),
                    turbulence=turbulence,
                    turbulence_source=air.turbulence_source,
                    sensor_noise=air.sensor_noise,
                    seed_turbulence=seed_turbulence,
                    seed_noise=seed_noise,
                    properties=properties,
                    excursion_radius_m=tuple(map(float, spec.metrics.excursion_radius_m)),
                    rearm_m=float(spec.metrics.rearm_m),
                )
                yield Case(
                    case_id=case_id(flight, mission),
                    epistemic_id=sample.epistemic_id,
                    levels=sample.levels,
                    aleatory_id=aleatory_id,
                    wind_mps=flight.wind_mps,
                    turbulence=turbulence,
                    seed=seed_turbulence,
                    flight=flight,
                )


_FIELDS = tuple(field.name for field in dataclasses.fields(FlightSpec))


def case_id(flight: FlightSpec, mission: Mission) -> str:
    """16 hex digits over everything that defines the flight: content of the files, numbers, seeds, properties."""
    identity = {name: getattr(flight, name) for name in _FIELDS}
    identity |= {
        "aircraft": mission.aircraft_hash,
        "script": mission.script_hash,
        "properties": dict(flight.properties),
    }
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
