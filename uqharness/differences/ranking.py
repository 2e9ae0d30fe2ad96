"""Where two models part: channels beyond what rounding makes, the earliest and nearest to the cause first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.differences.channels import GROUPS, Channel
from uqharness.differences.matched import Matched
from uqharness.differences.terms import Term

ROUNDING = 1e-9
"""Share of a channel's range within which two orders of the same sums stay."""
NUDGES = 1000.0
"""How often the difference that one unit in the last place of the start makes is allowed: rounding acts in every frame."""


@dataclass(frozen=True)
class Difference:
    """A channel in which two models differ in one flight.

    from_s    time of the first frame beyond benign; size: largest difference in the channel's unit, at at_s
    share     size over the channel's range in the flight of A (or its magnitude where it does not move)
    times     size over what is benign there
    terms     differing elements of the XML that may make it, the likeliest first
    """

    channel: str
    unit: str
    group: str
    flight: str
    from_s: float
    size: float
    at_s: float
    share: float
    times: float
    a: float
    b: float
    terms: tuple[Term, ...] = ()


def differences(
    channels: Sequence[Channel],
    flights: Iterable[Matched],
    terms: Sequence[Term],
    tolerance: float = ROUNDING,
) -> list[Difference]:
    """Everything beyond benign, ranked: first the flight and frame in which it shows first, then cause before effect.

    tolerance: share of a channel's range that is benign in any case.
    """
    found: list[tuple[tuple[float, ...], Difference]] = []
    for order, flight in enumerate(flights):
        for channel in channels:
            if channel.name not in flight.a or channel.name not in flight.b:
                continue
            row = _difference(channel, flight, terms, tolerance)
            if row is not None:
                first, difference = row
                found.append(((difference.from_s, channel.rank, -first, float(order)), difference))
    return [d for _, d in sorted(found, key=lambda pair: pair[0])]


def by_channel(found: Sequence[Difference]) -> list[Difference]:
    """The first row of each channel, in order."""
    seen: dict[str, Difference] = {}
    for d in found:
        seen.setdefault(d.channel, d)
    return list(seen.values())


def scale_of(channel: Channel, values: FloatArray) -> float:
    """Range of a channel in a flight, or its magnitude where it hardly moves; never below its floor."""
    reach = float(np.ptp(values)) if len(values) else 0.0
    magnitude = float(np.max(np.abs(values), initial=0.0))
    return max(reach if reach > 1e-3 * magnitude else magnitude, channel.floor)


def _difference(
    channel: Channel, flight: Matched, terms: Sequence[Term], tolerance: float
) -> tuple[float, Difference] | None:
    a, b = flight.a[channel.name], flight.b[channel.name]
    scale = scale_of(channel, a)
    # A start that is one unit off moves everything after it: what it has moved so far is what rounding may have.
    benign = np.maximum(
        NUDGES * np.maximum.accumulate(np.abs(flight.nudged[channel.name] - a)), tolerance * scale
    )
    benign = np.maximum(benign, flight.varied.get(channel.name, 0.0))
    apart = np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(b - a))
    beyond = ~(apart <= benign)
    if not beyond.any():
        return None
    start, worst = (
        int(np.argmax(beyond)),
        int(np.nanargmax(np.where(np.isnan(apart), np.inf, apart))),
    )
    size = float(apart[worst])
    difference = Difference(
        channel.name,
        channel.unit,
        channel.group,
        flight.name,
        float(flight.time_s[start]),
        size,
        float(flight.time_s[worst]),
        size / scale,
        size / float(benign[worst]),
        float(a[worst]),
        float(b[worst]),
        likeliest(channel, terms),
    )
    return float(apart[start] / scale), difference


_NAMES = {
    "CX": ("CX", "CD"),
    "CY": ("CY",),
    "CZ": ("CZ", "CL"),
    "Cl": ("Cl",),
    "Cm": ("Cm",),
    "Cn": ("Cn",),
}
"""How authors begin the names of a coefficient's terms."""


def _named(term: Term, channel: Channel) -> bool:
    """Whether some part of a term's path has a name that begins as the coefficient's do."""
    words = (word for part in term.path.split(" / ") for word in part.split(" ")[1:])
    return any(
        word.rpartition("/")[2].startswith(_NAMES.get(channel.name, ("?",))) for word in words
    )


def likeliest(channel: Channel, terms: Sequence[Term]) -> tuple[Term, ...]:
    """Terms that may move a channel: those of its own axis, then of its group, then of any group before it."""

    def nearness(term: Term) -> float:
        if _named(term, channel):
            return -1.0
        if term.channel and term.channel == channel.name:
            return 0.0
        if not term.group:
            return 9.0
        rank = GROUPS.index(term.group)
        if rank > channel.rank:
            return 8.0
        # Aerodynamics of another axis is farther than a part that acts on all.
        other_axis = term.channel and channel.group.endswith("coefficients")
        return 1.0 + (channel.rank - rank) * 0.5 + (2.0 if other_axis else 0.0)

    return tuple(sorted(terms, key=nearness))
