"""Estimate the cost of a campaign before it flies: flights, flight hours, run time and disk.

`size_of` counts flights from the campaign file without building a case. `measure_pace` times a few
flights on this machine. `Cost` combines both; the command line prints it, and a campaign that takes
more than a day is refused unless the user confirms.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from uqharness.campaign.cases import Case, Mission, Part, build_cases
from uqharness.campaign.processes import BATCH, JSBSIM
from uqharness.campaign.spec import SAMPLED, CampaignSpec
from uqharness.errors import BadInputError
from uqharness.flight import TURBULENCE_W20_KT, FlightSpec

DISK_BYTES_PER_FLIGHT = 2000
"""Measured with 100,000 flights: 1400 bytes of journal and 500 of tables."""

DAY_S = 86_400.0
"""Run time [s] from which a campaign must be confirmed."""

FASTEST_HOURS_PER_CORE_HOUR = {JSBSIM: 10_000.0, BATCH: 1_000_000.0}
"""Flight hours per core hour that no machine reaches: ten times the E-SPAARO at 100 Hz. A campaign
that is too long at this pace need not be tried out.
"""

TRIAL_CONDITIONS = 32
"""Maximum number of conditions that are tried out before a campaign, so that the work does not grow
with the grid. While the campaign flies, the first flight of each condition is compared with
JSBSim.
"""

_CALIBRATION_S = 60.0
# Run time [s] of the check flight from which a second, longer flight adds nothing.
_SLOW_S = 0.2


@dataclass(frozen=True)
class Size:
    """Numbers of flights of a campaign.

    Attributes
    ----------
    aleatory, conditions, epistemic : int
        Flights per corner and condition, conditions, and epistemic samples.
    flights : int
        All flights, or those of the largest shard.
    flight_s : float
        Simulated time of each [s], burn-in included.
    at_most : bool
        Whether the stopping rule may end the campaign sooner.
    interior : int
        Epistemic samples between the corners.
    """

    aleatory: int
    conditions: int
    epistemic: int
    flights: int
    flight_s: float
    at_most: bool
    interior: int = 0
    trial_conditions: int = 0
    """Conditions that are tried out before the campaign."""

    @property
    def hours(self) -> float:
        """Flight hours, burn-in included."""
        return self.flights * self.flight_s / 3600.0

    @property
    def disk_bytes(self) -> int:
        """Bytes of journal and tables."""
        return self.flights * DISK_BYTES_PER_FLIGHT


@dataclass(frozen=True)
class Pace:
    """Pace of one process of this machine.

    Attributes
    ----------
    flight_s : float
        Run time per flight [s], whatever its length.
    per_second : float
        Run time per simulated second.
    startup_s : float
        Run time before the first flight ends [s]: processes, loading, compiling.
    """

    flight_s: float
    per_second: float
    startup_s: float = 0.0

    def seconds(self, flight_s: float) -> float:
        """Return the run time [s] of a flight that simulates ``flight_s`` seconds."""
        return self.flight_s + self.per_second * flight_s


@dataclass(frozen=True)
class Cost:
    """Cost of a campaign: its size at the pace of this machine.

    Attributes
    ----------
    size : Size
        Flights of the whole campaign.
    done : int
        Flights stored by earlier runs.
    pace : Pace or None
        None if it was not measured.
    workers : int
        Number of processes.
    engine : str
        Fastest engine that may fly it.
    """

    size: Size
    done: int
    pace: Pace | None
    workers: int
    engine: str = JSBSIM

    @property
    def missing(self) -> int:
        """Flights still to be flown."""
        return max(self.size.flights - self.done, 0)

    @property
    def seconds(self) -> float | None:
        """Expected run time [s] of the missing flights; None if the pace is not known."""
        if self.pace is None:
            return None
        if self.missing == 0:
            return 0.0
        flying = self.missing * self.pace.seconds(self.size.flight_s) / max(self.workers, 1)
        return self.pace.startup_s + flying

    @property
    def min_seconds(self) -> float:
        """Run time [s] of the missing flights at the fastest conceivable pace."""
        hours = self.missing * self.size.flight_s / 3600.0
        return 3600.0 * hours / FASTEST_HOURS_PER_CORE_HOUR[self.engine] / max(self.workers, 1)

    @property
    def is_long(self) -> bool:
        """Whether the campaign takes more than a day on this machine."""
        return max(self.seconds or 0.0, self.min_seconds) > DAY_S

    @property
    def words(self) -> str:
        """The cost in one line."""
        size = self.size
        at_most = "at most " if size.at_most else ""
        interior = f", {size.interior} of them between the corners" if size.interior else ""
        text = (
            f"{at_most}{size.flights} flights"
            f" ({_count(size.epistemic, 'epistemic sample')}{interior},"
            f" {_count(size.conditions, 'condition')}, {size.aleatory} each),"
            f" {hours_in_words(size.hours)} flight h"
        )
        text += f", {self.done} flights done before" if self.done else ""
        processes = _count(self.workers, "process", "processes")
        if self.seconds is not None:
            text += f"; about {time_in_words(self.seconds)} on {processes} of this machine"
        elif self.is_long:
            text += f"; at least {time_in_words(self.min_seconds)} on {processes} of this machine"
        return f"{text}, {disk_in_words(size.disk_bytes)} of disk"


def size_of(spec: CampaignSpec, shards: int = 1) -> Size:
    """Return the size of a campaign, or of the largest of its shards, without building cases.

    Parameters
    ----------
    spec : CampaignSpec
        Validated campaign.
    shards : int
        Number of shards; flights are rounded up.
    """
    air, samples = spec.aleatory, epistemic_count(spec)
    conditions = len(air.wind_mps) * len(air.turbulence)
    # Round up: the largest shard determines the run time.
    flights = -(-air.flights * conditions * samples // shards)
    flight_s = float(air.duration_s) + float(air.burn_in_s)
    at_most = spec.stop.rule == "decide"
    return Size(
        air.flights,
        conditions,
        samples,
        flights,
        flight_s,
        at_most,
        spec.interior_samples * _draws(spec),
        len(trial_conditions(air.wind_mps, air.turbulence)),
    )


def epistemic_count(spec: CampaignSpec) -> int:
    """Return the number of epistemic samples without building one."""
    section = spec.epistemic
    if section.method in SAMPLED:
        return int(section.samples or 0)
    # Corners, interior points and the nominal model; each with every draw of parameters.
    points = spec.corner_count + spec.interior_samples + section.flies_nominal
    return points * _draws(spec)


def _draws(spec: CampaignSpec) -> int:
    """Return the number of parameter draws flown at each corner.

    1 without [epistemic.parameters].
    """
    section = spec.epistemic
    return section.samples if section.parameters is not None and section.samples else 1


def one_case(spec: CampaignSpec, mission: Mission) -> Case:
    """Return a case in the strongest turbulence, without building the others."""
    strongest = max(spec.aleatory.turbulence, key=lambda name: TURBULENCE_W20_KT[name])
    return one_case_each(with_conditions(spec, spec.aleatory.wind_mps[:1], (strongest,)), mission)[
        0
    ]


def with_conditions(
    spec: CampaignSpec, wind_mps: tuple[float, ...], turbulence: tuple[str, ...]
) -> CampaignSpec:
    """Return the campaign with another grid of conditions."""
    return dataclasses.replace(
        spec,
        aleatory=spec.aleatory.model_copy(update={"wind_mps": wind_mps, "turbulence": turbulence}),
    )


def trial_conditions(
    winds_mps: Collection[float], turbulences: Collection[str]
) -> tuple[tuple[float, str], ...]:
    """Return the conditions of a grid to try out: all, or at most `TRIAL_CONDITIONS`.

    Each turbulence is tried with winds [m/s] evenly spaced over the sorted list, the weakest and
    the strongest included.
    """
    winds_per_turbulence = max(2, TRIAL_CONDITIONS // len(turbulences))
    sorted_winds = sorted(winds_mps)
    # Select evenly spaced places of the sorted winds, both ends included.
    if len(sorted_winds) > winds_per_turbulence:
        last = len(sorted_winds) - 1
        places = {
            round(step * last / (winds_per_turbulence - 1)) for step in range(winds_per_turbulence)
        }
        chosen = {sorted_winds[place] for place in places}
        winds_mps = [wind for wind in winds_mps if wind in chosen]
    return tuple(itertools.product(winds_mps, turbulences))


def one_case_each(spec: CampaignSpec, mission: Mission) -> tuple[Case, ...]:
    """Return a case of each condition that is tried out, without building the others."""
    section = spec.epistemic
    changes: dict[str, object] = {"samples": 1} if section.samples is not None else {}
    # One corner without interior points: the flight costs the same at every corner.
    if section.method in ("corners", "levels"):
        changes |= {
            "method": "levels",
            "levels": (1.0,),
            "set": "box",
            "interior": 0,
            "nominal": None,
        }
    air = spec.aleatory
    conditions = trial_conditions(air.wind_mps, air.turbulence)
    return build_cases(
        dataclasses.replace(spec, epistemic=section.model_copy(update=changes)),
        mission,
        Part(range(1), conditions),
    )


def measure_pace(
    fly: Callable[[FlightSpec], bool], brief: FlightSpec, full: FlightSpec
) -> Pace | None:
    """Measure the pace from flights of a process that has flown ``brief`` before.

    Two lengths of flight separate the time per flight from the time per simulated second.

    Parameters
    ----------
    fly : callable
        Flies and returns whether the flight ended well.
    brief : FlightSpec
        Short flight.
    full : FlightSpec
        Flight as the campaign flies it.

    Returns
    -------
    Pace or None
        None if a flight does not end well.
    """
    length_s = min(_CALIBRATION_S, full.burn_in_s + full.duration_s)
    brief_s = _flight_time(fly, brief)
    if brief_s is None:
        return None
    # A slow or short flight is measured well enough by the check flight alone.
    if brief_s > _SLOW_S or length_s < 2.0 * brief.duration_s:
        return Pace(0.0, brief_s / brief.duration_s)
    long_s = _flight_time(fly, dataclasses.replace(brief, duration_s=length_s))
    if long_s is None:
        return None
    per_second = max(long_s - brief_s, 0.0) / (length_s - brief.duration_s)
    # The intercept is the time per flight, which cannot be negative.
    return Pace(max(brief_s - per_second * brief.duration_s, 0.0), per_second)


def _flight_time(fly: Callable[[FlightSpec], bool], flight: FlightSpec) -> float | None:
    """Return the shorter of two run times [s]: other work on the machine can only add time."""
    shortest_s = math.inf
    for _ in range(2):
        start_s = time.monotonic()
        if not fly(flight):
            return None
        shortest_s = min(shortest_s, time.monotonic() - start_s)
    return shortest_s


def refuse_if_long(cost: Cost, confirmed: bool, path: object) -> None:
    """Raise BadInputError if a campaign takes more than a day and was not confirmed."""
    if cost.is_long and not confirmed:
        raise BadInputError(
            f"{path}: {cost.words}: more than a day on this machine; give --yes to run it, or"
            " --hours H for fewer flights per corner and condition"
        )


def _count(number: int, one: str, many: str = "") -> str:
    """Return a number with its noun in singular or plural."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def hours_in_words(hours: float) -> str:
    """Return flight hours with three digits, in full from 1000 on."""
    return f"{hours:.0f}" if hours >= 1000 else f"{hours:.3g}"


def time_in_words(seconds: float) -> str:
    """Return a duration as ``40 s``, ``12 min``, ``3.5 h``, ``2.1 days`` or ``40 years``."""
    for unit, length in (("years", 365.25 * DAY_S), ("days", DAY_S), ("h", 3600.0), ("min", 60.0)):
        if seconds >= (2.0 if unit == "days" else 1.0) * length:
            return (
                f"{seconds / length:.2g} {unit}"
                if seconds < 100 * length
                else f"{seconds / length:.0f} {unit}"
            )
    return f"{math.ceil(seconds)} s"


def disk_in_words(size: float) -> str:
    """Return a size as ``12 kB``, ``3.4 MB``, ``1.2 GB`` or ``2 TB``."""
    # Largest unit that the size reaches.
    for unit, length in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= length:
            return (
                f"{size / length:.2g} {unit}"
                if size < 100 * length
                else f"{size / length:.0f} {unit}"
            )
    return f"{math.ceil(size / 1000)} kB"
