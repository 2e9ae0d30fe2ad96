"""List the flights of a campaign in their one order and give each an identity.

`build_cases` turns a validated campaign file and the files it flies into cases. A case holds the
request of one flight (`FlightSpec`), its place in the design of experiments, and an id that is a
hash over everything that defines the flight. The same campaign gives the same cases on every
machine, which is what makes runs resumable and shards mergeable.

The order is aleatory sample, then condition, then epistemic sample. A run that is stopped early has
flown every corner equally often, so its p-boxes are usable.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.foreign.regular_files import sha256_hex
from uqharness.campaign.conditions import counted_radii
from uqharness.campaign.processes import BATCH, JSBSIM, Group
from uqharness.campaign.sampling import NOMINAL, Epistemic, epistemic_samples
from uqharness.campaign.spec import CampaignSpec, VariableSection
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
    """The files that a campaign flies and the hashes of their content.

    Paths are not part of a case's identity; the hashes are.

    Attributes
    ----------
    aircraft : Path
        Folder of the aircraft that is flown.
    aircraft_hash : str
        SHA-256 over the content of that folder.
    script : Path
        Run script.
    script_hash : str
        SHA-256 of the script.
    source : Path
        Folder of the original aircraft if ``aircraft`` is a copy of it; else the empty path.
    """

    aircraft: Path
    aircraft_hash: str
    script: Path
    script_hash: str
    source: Path = Path()


@dataclass(frozen=True, slots=True)
class Case:
    """One flight of a campaign.

    Attributes
    ----------
    case_id : str
        16 hex digits, see `case_id`.
    epistemic_id : str
        Id of the epistemic sample, e.g. ``010011`` for a corner.
    levels : mapping of str to float
        Constant level of each uncertain coefficient, 0 at the lower bound and 1 at the upper.
    aleatory_id : int
        Number of the aleatory sample; flights that share it meet the same gusts and sensor noise.
    wind_mps : float
        Mean wind [m/s].
    turbulence : str
        Intensity: none, light, moderate or severe.
    seed : int
        Seed of the turbulence stream.
    flight : FlightSpec
        Request that a worker needs to fly the case.
    inputs : mapping of str to float
        Further values drawn or chosen for the flight, by column name of cases.parquet.
    engine : str
        Name of the engine that flies it.
    """

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
    """Return the JSBSim properties that put the plugin's deltas at the levels of a sample.

    Numeric bounds of the campaign file replace those of the aircraft; a coefficient that is not
    uncertain gets the bounds (0, 0). If the aircraft computes its bounds itself, they stay, and
    such a coefficient is switched off by ``uq/<C>/active = 0``.
    """
    # A driver moves its coefficients in flight; without one the levels are constant.
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
    """A part of a campaign.

    Attributes
    ----------
    aleatory_ids : range
        Aleatory samples.
    conditions : tuple of (float, str)
        Mean wind [m/s] and turbulence.
    samples : range, optional
        Places in the list of epistemic samples; None selects all.
    """

    aleatory_ids: range
    conditions: tuple[tuple[float, str], ...]
    samples: range | None = None


def build_cases(spec: CampaignSpec, mission: Mission, part: Part | None = None) -> tuple[Case, ...]:
    """Return the cases of a campaign, or of a part of it, in case order.

    The result depends on the arguments alone: no clock, no file and no random state is read.

    Parameters
    ----------
    spec : CampaignSpec
        Validated campaign. An engine that is not chosen yet ("auto") counts as JSBSim.
    mission : Mission
        Files to fly and their hashes.
    part : Part, optional
        Selection; default: everything.

    Returns
    -------
    tuple of Case
        Aleatory sample slowest, then condition, then epistemic sample.

    Raises
    ------
    BadInputError
        If a property is both a random variable and an epistemic input.
    """
    air = spec.aleatory
    all_cases = Part(range(air.flights), tuple(itertools.product(air.wind_mps, air.turbulence)))
    return tuple(_cases(spec, mission, part or all_cases))


def _cases(spec: CampaignSpec, mission: Mission, part: Part) -> Iterator[Case]:
    """Yield the cases of a part; seeds and draws are made once per aleatory sample."""
    air, root_seed = spec.aleatory, spec.campaign.seed
    engine = BATCH if spec.campaign.engine == BATCH else JSBSIM
    # An engine that is not chosen yet counts as JSBSim.
    radii = counted_radii(dict(spec.metrics))
    requested_samples = epistemic_samples(spec)
    if part.samples is not None:
        requested_samples = requested_samples[part.samples.start : part.samples.stop]
    # What cases have in common is made once and shared: a million cases must fit into memory.
    samples = [
        (sample, uq_properties(spec, sample) | dict(sample.parameters), _columns(sample))
        for sample in requested_samples
    ]
    duration_s, burn_in_s, wind_from_deg, rearm_m = map(
        float, (air.duration_s, air.burn_in_s, air.wind_from_deg, spec.metrics.rearm_m)
    )
    _refuse_conflicting_properties(samples[0][1], air.variables)
    for aleatory_id in part.aleatory_ids:
        # All corners and conditions of an aleatory sample share these streams: common random
        # numbers.
        seed_turbulence = flight_seed(root_seed, aleatory_id, "turbulence")
        seed_noise = flight_seed(root_seed, aleatory_id, "noise")
        # One draw per variable and aleatory sample: all corners fly with the same payload, for
        # example.
        draws = {
            name: unit_draw(root_seed, aleatory_id, name, item)
            for name, item in air.variables.items()
        }
        # The transient error has its own stream per aleatory id, common to all corners.
        transient = _transient(spec, aleatory_id)
        for wind_mps, turbulence in part.conditions:
            wind_mps = float(wind_mps)
            for sample, properties, columns in samples:
                values = {
                    name: item.value(draws[name], sample.means.get(name, 0.5))
                    for name, item in air.variables.items()
                }
                flight = FlightSpec(
                    aircraft=mission.aircraft,
                    script=mission.script,
                    duration_s=duration_s,
                    burn_in_s=burn_in_s,
                    wind_mps=wind_mps,
                    wind_from_deg=wind_from_deg,
                    turbulence=turbulence,
                    turbulence_source=air.turbulence_source,
                    sensor_noise=air.sensor_noise is not False,
                    seed_turbulence=seed_turbulence,
                    seed_noise=seed_noise,
                    properties=properties | values if values else properties,
                    excursion_radius_m=radii,
                    rearm_m=rearm_m,
                    levels=sample.driver,
                    # The nominal model flies without any model error.
                    transient=None if sample.epistemic_id.startswith(NOMINAL) else transient,
                )
                yield Case(
                    case_id=case_id(flight, mission, engine),
                    epistemic_id=sample.epistemic_id,
                    levels=sample.levels,
                    aleatory_id=aleatory_id,
                    wind_mps=wind_mps,
                    turbulence=turbulence,
                    seed=seed_turbulence,
                    flight=flight,
                    inputs=columns | {f"variable_{name}": x for name, x in values.items()}
                    if values
                    else columns,
                    engine=engine,
                )


def _transient(spec: CampaignSpec, aleatory_id: int) -> TransientDriver | None:
    """Return the driver of the transient model error of one flight; None if none is flown."""
    rates = spec.inputs.transient_rates
    if not rates:
        return None
    return TransientDriver(
        spec.campaign.seed, aleatory_id, tuple(rates), tuple(map(float, rates.values()))
    )


def unit_draw(root_seed: int, aleatory_id: int, name: str, variable: VariableSection) -> float:
    """Draw a variable in its own unit: standard normal, or uniform in -1..1.

    The draw depends on (root seed, aleatory id, property) alone, so that another variable added to
    the file leaves it unchanged.
    """
    seed_sequence = numbered_stream(root_seed, "variable", aleatory_id, name)
    if variable.distribution == "normal":
        return float(random_numbers.draw_normals(seed_sequence, 1)[0])
    return float(np.random.Generator(np.random.PCG64(seed_sequence)).uniform(-1.0, 1.0))


def _columns(sample: Epistemic) -> dict[str, float]:
    """Return the means and parameters of a sample by column name of cases.parquet."""
    columns = {f"level_{name}": level for name, level in sample.means.items()}
    return columns | {f"parameter_{name}": value for name, value in sample.parameters.items()}


def _refuse_conflicting_properties(
    properties: Mapping[str, float], variables: Mapping[str, VariableSection]
) -> None:
    """Raise BadInputError if a property is set by [epistemic] and drawn by [aleatory.variables]."""
    conflicting = [name for name in variables if name in properties]
    if conflicting:
        raise BadInputError(
            f'[aleatory.variables."{conflicting[0]}"]: the property is set by [epistemic] too; make'
            " it either aleatory or epistemic (an unknown mean is an interval)"
        )


_FIELDS = tuple(
    field.name
    for field in dataclasses.fields(FlightSpec)
    if field.name not in ("levels", "transient")
)


def case_id(flight: FlightSpec, mission: Mission, engine: str = JSBSIM) -> str:
    """Return 16 hex digits over everything that defines a flight.

    Parameters
    ----------
    flight : FlightSpec
        Request; its numbers, seeds and properties enter the hash, its paths do not.
    mission : Mission
        Hashes of aircraft and script.
    engine : str
        Name of the engine.

    Returns
    -------
    str
        The first 16 hex digits of a SHA-256 over canonical JSON.
    """
    identity = {name: getattr(flight, name) for name in _FIELDS}
    # Fields added later enter the hash only if they are used, so that ids of older campaigns stay
    # valid.
    identity |= {"levels": dataclasses.asdict(flight.levels)} if flight.levels is not None else {}
    identity |= (
        {"transient": dataclasses.asdict(flight.transient)} if flight.transient is not None else {}
    )
    identity |= {"engine": engine} if engine != JSBSIM else {}
    identity |= {
        "aircraft": mission.aircraft_hash,
        "script": mission.script_hash,
        "properties": dict(flight.properties),
    }
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"))
    return sha256_hex(text.encode())[:16]


# Grouping of cases for the batch engine: all corners of one aleatory sample fly side by side.

GROUP_S = 20.0
"""Core time [s] that a group should take. A killed worker loses at most one group, and at this
length the cost of starting a group is negligible.
"""
FLIGHT_S_PER_CORE_S = 90_000.0
"""Flight seconds that the batch engine flies in a second of one core, roughly. Only group sizes
depend on it.
"""
MAX_LANES = 1024
MIN_LANES = 64
"""With fewer flights side by side the batch engine uses vector units and shared steps badly."""
_GROUPS_PER_WORKER = 4


def lanes_per_group(cases: Sequence[Case], workers: int) -> int:
    """Return how many cases of a list to fly together.

    A group takes about `GROUP_S` of a core, and each worker gets at least four groups if there are
    enough cases.
    """
    flight = cases[0].flight
    # Lanes that fill the target time of a group, and lanes that give each worker several groups.
    by_time = GROUP_S * FLIGHT_S_PER_CORE_S / (flight.duration_s + flight.burn_in_s)
    by_worker = math.ceil(len(cases) / (_GROUPS_PER_WORKER * max(workers, 1)))
    return min(MAX_LANES, max(1, int(by_time)), max(MIN_LANES, by_worker))


def group_cases(cases: Sequence[Case], workers: int) -> list[Group]:
    """Split cases into groups for the batch engine.

    A group holds cases of one condition in case order. The largest groups come first, so that no
    worker waits long for the last one.

    Parameters
    ----------
    cases : sequence of Case
        Cases still to be flown.
    workers : int
        Number of processes.

    Returns
    -------
    list of Group
        Each case is in exactly one group.
    """
    if not cases:
        return []
    lanes = lanes_per_group(cases, workers)
    corners = len({case.epistemic_id for case in cases})
    if lanes > corners:
        # Complete aleatory samples: gust and noise streams are then made once for all corners.
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
    # Longest first; ties in case order, so that the order is reproducible.
    return sorted(groups, key=lambda group: (-len(group.cases), place[group.cases[0][0]]))
