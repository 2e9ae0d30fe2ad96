"""Differences between two models in flight, ranked by time, cause and effect.

`fly_matched` flies both models from the same start with the same controls and air.
`differing_terms` lists the XML elements that differ. `differences` reports channels whose
difference exceeds what rounding explains, the earliest and the closest to the cause first, each
with the XML elements that may explain it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import SequenceMatcher
from pathlib import Path

import numpy as np

from sysid.arrays import FloatArray
from uqharness.differences.elsewhere import (
    GROUPS,
    Channel,
    FlightSettings,
    RefusedError,
    channels_of,
    fly_elsewhere,
    fly_frames,
)
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder, write_bytes
from uqharness.flight import COEFFICIENTS
from uqharness.isolation import ProcessEndedError
from uqharness.simulator import (
    MISSIONS,
    Aircraft,
    StartSection,
    copy_folder,
    copy_shared_parts,
    engine,
    find_aircraft,
    open_aircraft,
    read_script,
    write_own_mission,
)
from uqharness.xml import Node, folder_documents

# Matched flights of two models, and variations of the first one.


def fly_variations(
    aircraft: Aircraft,
    script: Path,
    channels: Sequence[Channel],
    settings: FlightSettings,
    repeats: int,
    bounds: bool,
) -> list[dict[str, FloatArray]]:
    """Fly one model in other air and at the ends of its bounds, as `fly_frames` does.

    Parameters
    ----------
    aircraft, script, channels, settings
        As of `fly_frames`.
    repeats : int
        Number of further seeds of turbulence.
    bounds : bool
        Whether to fly each coefficient at its lower and its upper bound.

    Raises
    ------
    BadInputError
        If there is no turbulence to repeat, or no bound.
    """
    if repeats and settings.turbulence == "none":
        raise BadInputError(
            "--repeats: still air has no other seed; give --turbulence light, moderate or severe"
        )
    variations = [replace(settings, seed=settings.seed + k) for k in range(1, repeats + 1)]
    variations += [
        replace(settings, properties=corner)
        for corner in (_bound_settings(aircraft) if bounds else ())
    ]
    return [fly_frames(aircraft, script, channels, other) for other in variations]


def largest_deviation(
    flight: Mapping[str, FloatArray], variations: Iterable[Mapping[str, FloatArray]]
) -> dict[str, float]:
    """Return the largest deviation of the variations from a flight, by channel, in their units.

    Flights of different length are compared over the shorter one.
    """
    deviations = dict.fromkeys(flight, 0.0)
    for other in variations:
        for name, values in flight.items():
            n = min(len(values), len(other[name]))
            deviations[name] = max(
                deviations[name], float(np.max(np.abs(other[name][:n] - values[:n]), initial=0.0))
            )
    return deviations


def _bound_settings(aircraft: Aircraft) -> list[dict[str, float]]:
    """Return properties for each coefficient alone at its lower and at its upper bound."""
    # The instance must outlive its manager, or absolute names are not found.
    probe = open_aircraft(aircraft)
    exists = probe.get_property_manager().hasNode
    bounded = [c for c in COEFFICIENTS if exists(f"uq/{c}/level")]
    if not bounded:
        raise BadInputError(
            f"--bounds: aircraft '{aircraft.name}' has none; add them with uqharness instrument"
            f" {aircraft.name} --bounds model-form.json"
        )
    return [
        {
            "uq/active": 1.0,
            **{f"uq/{other}/active": 0.0 for other in bounded if other != c},
            f"uq/{c}/level": level,
        }
        for c in bounded
        for level in (0.0, 1.0)
    ]


SCRIPT_LIMIT_S = 60.0
"""Longest flight of a run script [s]; generated missions end by themselves."""


@dataclass(frozen=True)
class MatchedRequest:
    """What `fly_matched` flies.

    Attributes
    ----------
    speeds_mps, altitude_m : tuple of float, float
        True airspeeds [m/s] and altitude [m] at which A is trimmed.
    missions : tuple of str
        Generated manoeuvres at each speed.
    scripts : tuple of Path
        Further run scripts.
    turbulence, seed
        Air of all flights.
    properties : tuple of str
        Properties compared in addition to `channels_of`.
    python_b : Path or None
        Interpreter that flies B with another JSBSim; None for this one.
    repeats, bounds
        Variations of A, as of `fly_variations`.
    """

    speeds_mps: tuple[float, ...] = ()
    altitude_m: float = 200.0
    missions: tuple[str, ...] = MISSIONS
    scripts: tuple[Path, ...] = ()
    turbulence: str = "none"
    seed: int = 1
    properties: tuple[str, ...] = ()
    python_b: Path | None = None
    repeats: int = 0
    bounds: bool = False


@dataclass(frozen=True)
class MatchedFlight:
    """One flight of both models.

    Attributes
    ----------
    name : str
        Manoeuvre or script.
    time_s : ndarray
        Time [s] of the frames that both flew, (n,).
    a, b, nudged : mapping
        Channel to (n,). `nudged` is A from an initial velocity one unit in the last place larger:
        the effect of rounding.
    only_a, only_b : tuple of str
        Channels that only one model has.
    reason : str
        Why there is no flight of B, or why it is shorter; empty otherwise.
    jsbsim_b : str
        Version of JSBSim that flew B; empty for this process's own.
    varied : mapping
        Channel to the largest deviation of A's variations; empty without any.
    """

    name: str
    time_s: FloatArray
    a: Mapping[str, FloatArray]
    b: Mapping[str, FloatArray]
    nudged: Mapping[str, FloatArray]
    only_a: tuple[str, ...] = ()
    only_b: tuple[str, ...] = ()
    reason: str = ""
    jsbsim_b: str = ""
    varied: Mapping[str, float] = field(default_factory=dict)


def fly_matched(
    a: Aircraft,
    b: Aircraft,
    request: MatchedRequest,
    on_progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Channel], list[MatchedFlight]]:
    """Fly all requested flights in both models.

    Parameters
    ----------
    a, b : Aircraft
        The two models; A is trimmed, and B starts from A's trim.
    request : MatchedRequest
        What to fly.
    on_progress : callable, optional
        Called with the numbers of finished and of all flights.

    Returns
    -------
    channels : list of Channel
        Channels of A.
    flights : list of MatchedFlight
        In the order of the request.

    Raises
    ------
    BadInputError
        If nothing is requested, or A cannot be flown.
    """
    if not request.speeds_mps and not request.scripts:
        raise BadInputError("no manoeuvre: give a speed at which the aircraft trims, or a script")
    channels = channels_of(a, open_aircraft(a), request.properties)
    flights: list[MatchedFlight] = []
    n_flights = len(request.speeds_mps) * len(request.missions) + len(request.scripts)

    def add_flight(flight: MatchedFlight) -> None:
        flights.append(flight)
        if on_progress is not None:
            on_progress(len(flights), n_flights)

    with scratch_folder("diff") as scratch:
        copy_a, copy_b = _copy(a, scratch.path / "a"), _copy(b, scratch.path / "b")
        for speed in request.speeds_mps:
            start = StartSection(V_mps=speed, altitude_m=request.altitude_m)
            for kind in request.missions:
                # B flies the start and script that were written for A's trim.
                existing_names = {p.name for p in copy_a.folder.iterdir()}
                path, _ = write_own_mission(copy_a, start, kind)
                # B gets the files that were written for A.
                for mission_file in copy_a.folder.iterdir():
                    if (
                        mission_file.name not in existing_names
                        or mission_file == path
                        or mission_file.name == "steady-start.xml"
                    ):
                        content = mission_file.read_bytes()
                        if mission_file == path:
                            content = _with_open_loop(content, copy_a, copy_b)
                        write_bytes(copy_b.folder / mission_file.name, content)
                add_flight(
                    _fly_both(
                        copy_a,
                        copy_b,
                        path,
                        copy_b.folder / path.name,
                        name=f"{kind} at {speed:g} m/s",
                        channels=channels,
                        request=request,
                        limit_s=1e9,
                    )
                )
        for script in request.scripts:
            # A script's initial conditions may exist in A only.
            initial = read_script(script).initialize
            for source in (copy_a.folder / initial, copy_a.folder / f"{initial}.xml"):
                if source.is_file():
                    write_bytes(copy_b.folder / source.name, source.read_bytes())
            add_flight(
                _fly_both(
                    copy_a,
                    copy_b,
                    script,
                    script,
                    name=script.stem,
                    channels=channels,
                    request=request,
                    limit_s=SCRIPT_LIMIT_S,
                )
            )
    return channels, flights


def _with_open_loop(script: bytes, a: Aircraft, b: Aircraft) -> bytes:
    """Return a script of A that also sets what only B's card needs for commands to pass."""
    first, other = (aircraft.card.modes.get("open_loop", {}) for aircraft in (a, b))
    lines = "".join(
        f'\n    <property value="{value:.9g}">{name}</property>'
        for name, value in other.items()
        if name not in first
    )
    return re.sub(rb"<run [^>]*>", lambda run: run[0] + lines.encode(), script, count=1)


def _copy(aircraft: Aircraft, root: Path) -> Aircraft:
    """Copy an aircraft to where scripts can be written; engines and systems stay the original's."""
    copy_folder(aircraft.folder, root / "aircraft" / aircraft.copy_name)
    copy_shared_parts(aircraft, root, engine.default_root())
    copied = find_aircraft(root / "aircraft" / aircraft.copy_name)
    return replace(copied, engine_path=aircraft.engine_path, systems_path=aircraft.systems_path)


def _fly_both(
    copy_a: Aircraft,
    copy_b: Aircraft,
    script_a: Path,
    script_b: Path,
    *,
    name: str,
    channels: Sequence[Channel],
    request: MatchedRequest,
    limit_s: float,
) -> MatchedFlight:
    """Fly one script with A, with A nudged by one unit in the last place, and with B."""
    settings = FlightSettings(limit_s, copy_a.dt_s, request.turbulence, request.seed)
    try:
        flight_a, nudged_flight = (
            fly_frames(copy_a, script_a, channels, replace(settings, one_ulp_off=nudged))
            for nudged in (False, True)
        )
    except ProcessEndedError as error:
        raise BadInputError(f"{name}: A cannot be simulated: {error}") from None
    try:
        flight_b, version = _fly_b(copy_b, script_b, channels, settings, request.python_b)
    except RefusedError as error:
        return MatchedFlight(
            name, flight_a["time_s"], flight_a, {}, nudged_flight, reason=str(error)
        )
    variations = fly_variations(
        copy_a, script_a, channels, settings, request.repeats, request.bounds
    )
    # Compare the frames that all flights have.
    rows = min(len(x["time_s"]) for x in (flight_a, nudged_flight, flight_b))
    a, b, nudged = (
        {k: v[:rows] for k, v in x.items() if k != "time_s"}
        for x in (flight_a, flight_b, nudged_flight)
    )
    only_a, only_b = tuple(sorted(a.keys() - b.keys())), tuple(sorted(b.keys() - a.keys()))
    lengths = len(flight_a["time_s"]), len(flight_b["time_s"])
    reason = "" if lengths[0] == lengths[1] else f"A flew {lengths[0]} frames and B {lengths[1]}"
    return MatchedFlight(
        name,
        flight_a["time_s"][:rows],
        a,
        b,
        nudged,
        only_a,
        only_b,
        reason,
        version,
        largest_deviation(a, variations) if variations else {},
    )


def _fly_b(
    copy_b: Aircraft,
    script: Path,
    channels: Sequence[Channel],
    settings: FlightSettings,
    python: Path | None,
) -> tuple[dict[str, FloatArray], str]:
    """Fly B; return its channels and its JSBSim version, empty for this process's own.

    Raises RefusedError if B does not fly.
    """
    if python is not None:
        return fly_elsewhere(python, copy_b, script, channels, settings)
    try:
        return fly_frames(copy_b, script, channels, settings), ""
    except BadInputError as error:
        raise RefusedError(str(error)) from None


# Differing XML elements: numbers, names, and elements added or removed. Comments, white space and
# the order of attributes do not count.

_AXIS = {
    "DRAG": "CX",
    "LIFT": "CZ",
    "SIDE": "CY",
    "X": "CX",
    "Y": "CY",
    "Z": "CZ",
    "AXIAL": "CX",
    "NORMAL": "CZ",
    "ROLL": "Cl",
    "PITCH": "Cm",
    "YAW": "Cn",
    "FORWARD": "CX",
    "RIGHT": "CY",
    "DOWN": "CZ",
}
_GROUP = {
    "mass_balance": "mass and CG",
    "propulsion": "propulsion",
    "flight_control": "surfaces",
    "system": "surfaces",
    "autopilot": "surfaces",
    "external_reactions": "external forces",
    "engine": "propulsion",
    "propeller": "propulsion",
    "aerodynamics": "force coefficients",
    "metrics": "force coefficients",
}


@dataclass(frozen=True)
class Term:
    """An XML element that differs.

    Attributes
    ----------
    path : str
        Place in words, such as ``aerodynamics / axis PITCH / function aero/coefficient/Cmalpha``.
    a, b : str
        Content in each model; empty if it has no such element.
    a_where, b_where : str
        ``file:line``, empty likewise.
    group : str
        Group of channels that it affects; empty if unknown.
    channel : str
        Coefficient of its axis; empty outside the aerodynamics.
    """

    path: str
    a: str
    b: str
    a_where: str
    b_where: str
    group: str = ""
    channel: str = ""


@dataclass(frozen=True)
class _Line:
    """An XML element as a line of text for the comparison."""

    key: str
    path: str
    content: str
    where: str
    group: str
    channel: str


def differing_terms(a: Path, b: Path) -> list[Term]:
    """Return the XML elements in which two aircraft folders differ, in the order of the files.

    Raises
    ------
    BadInputError
        If a folder holds no XML.
    """
    first, second = _lines(a), _lines(b)
    terms: list[Term] = []
    for name in sorted({*first, *second}):
        one, two = first.get(name, []), second.get(name, [])
        # Lines are matched in order, so that an inserted element shifts nothing.
        matcher = SequenceMatcher(None, [x.key for x in one], [x.key for x in two], autojunk=False)
        for _, i, i_end, j, j_end in (code for code in matcher.get_opcodes() if code[0] != "equal"):
            terms += _paired(one[i:i_end], two[j:j_end])
    return _without_inner(_without_moved(terms))


def _without_moved(terms: list[Term]) -> list[Term]:
    """Return the terms without elements that only moved within their parent."""
    removed = [(t.path, t.a) for t in terms if not t.b_where]
    added = [(t.path, t.b) for t in terms if not t.a_where]
    moved = [key for key in removed if key in added]
    return [
        t
        for t in terms
        if (t.path, t.a if not t.b_where else t.b) not in moved or (t.a_where and t.b_where)
    ]


def _without_inner(terms: list[Term]) -> list[Term]:
    """Return the terms without children of elements that are themselves added or removed."""
    out: list[Term] = []
    outer = ""
    for t in terms:
        one_sided = not (t.a_where and t.b_where)
        if one_sided and outer and t.path.startswith(f"{outer} / "):
            continue
        outer = t.path if one_sided else ""
        out.append(t)
    return out


def _paired(lines_a: list[_Line], lines_b: list[_Line]) -> list[Term]:
    """Pair differing lines of equal path; the others have no counterpart."""
    unpaired = list(lines_b)
    terms = []
    for x in lines_a:
        y = next((y for y in unpaired if y.path == x.path), None)
        if y is not None:
            unpaired.remove(y)
        terms.append(
            Term(
                x.path,
                x.content,
                y.content if y else "",
                x.where,
                y.where if y else "",
                x.group,
                x.channel,
            )
        )
    terms += [Term(y.path, "", y.content, "", y.where, y.group, y.channel) for y in unpaired]
    return terms


def _lines(folder: Path) -> dict[str, list[_Line]]:
    """Return the elements of each XML file of a folder, file headers left out."""
    lines_by_file: dict[str, list[_Line]] = {}
    for document in folder_documents(folder):
        relative = document.path.relative_to(folder).as_posix()
        # The aircraft's main file is named after its folder, which may differ.
        name = "aircraft" if document.path.stem == folder.name else relative
        lines = lines_by_file.setdefault(name, [])
        for node in document.root.walk():
            if node.tag in ("fileheader",) or any(
                ancestor.tag == "fileheader" for ancestor in _ancestors(node)
            ):
                continue
            if node is document.root:
                continue
            lines.append(_line(node, f"{relative}:{node.line}", document.root.tag))
    if not lines_by_file:
        raise BadInputError(f"{folder}: no XML to compare")
    return lines_by_file


def _line(node: Node, where: str, root: str) -> _Line:
    """Return an element as a line with its place, content, and affected channels."""
    chain = [*reversed(list(_ancestors(node))), node][1:]
    path = " / ".join(_label(n) for n in chain)
    attributes = " ".join(
        f'{k}="{_normalise_number(v)}"' for k, v in sorted(node.attributes.items())
    )
    content = " ".join(x for x in (_normalise_text(node.text), attributes) if x) or f"<{node.tag}>"
    section = chain[0].tag if chain else ""
    # The coefficient of the axis that holds the element.
    axis = next((n.attributes.get("name", "").upper() for n in chain if n.tag == "axis"), "")
    group = _GROUP.get(section, _GROUP.get(root, ""))
    return _Line(f"{path}|{content}", path, content, where, group, _AXIS.get(axis, ""))


def _ancestors(node: Node) -> Iterator[Node]:
    """Yield the parents of an element, the nearest first."""
    ancestor = node.parent
    while ancestor is not None:
        yield ancestor
        ancestor = ancestor.parent


def _label(node: Node) -> str:
    """Return an element's tag and name."""
    name = node.attributes.get("name", "")
    if node.tag == "property" and not name:
        name = node.text.strip()
    return f"{node.tag} {name}".strip()


def _normalise_text(text: str) -> str:
    """Return text with numbers by value and single blanks."""
    return " ".join(_normalise_number(word) for word in text.split())


def _normalise_number(word: str) -> str:
    """Return a number by its value, and any other word unchanged."""
    try:
        return repr(float(word) + 0.0)
    except ValueError:
        return word.strip()


ROUNDING = 1e-9
"""Relative difference (of a channel's range) that a different order of summation may cause."""
NUDGE_FACTOR = 1000.0
"""Allowed multiple of the nudged flight's deviation: rounding acts in every frame, not once."""


@dataclass(frozen=True)
class Difference:
    """A channel in which two models differ in one flight.

    Attributes
    ----------
    channel, unit, group, flight : str
        Which channel in which flight.
    from_s : float
        Time [s] of the first frame beyond the benign difference.
    size, at_s : float
        Largest difference [unit] and its time [s].
    share : float
        Size over the channel's range in A's flight (its magnitude if it hardly moves).
    times : float
        Size over the benign difference at that time.
    a, b : float
        Values of both models at that time.
    terms : tuple of Term
        Differing XML elements, the most likely cause first.
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
    flights: Iterable[MatchedFlight],
    terms: Sequence[Term],
    tolerance: float = ROUNDING,
) -> list[Difference]:
    """Return all differences beyond the benign ones, ranked.

    The order is by time of the first frame, then from cause to effect, then by size.

    Parameters
    ----------
    channels : sequence of Channel
        Channels to compare.
    flights : iterable of MatchedFlight
        Matched flights.
    terms : sequence of Term
        Differing XML elements.
    tolerance : float
        Share of a channel's range that is always benign.
    """
    ranked: list[tuple[tuple[float, ...], Difference]] = []
    for order, flight in enumerate(flights):
        for channel in channels:
            if channel.name not in flight.a or channel.name not in flight.b:
                continue
            row = _difference(channel, flight, terms, tolerance)
            if row is not None:
                # Order: time, cause before effect, larger relative size, flight.
                first, difference = row
                ranked.append(((difference.from_s, channel.rank, -first, float(order)), difference))
    return [d for _, d in sorted(ranked, key=lambda pair: pair[0])]


def by_channel(ranked: Sequence[Difference]) -> list[Difference]:
    """Return the first difference of each channel, in order."""
    first_rows: dict[str, Difference] = {}
    for d in ranked:
        first_rows.setdefault(d.channel, d)
    return list(first_rows.values())


def scale_of(channel: Channel, values: FloatArray) -> float:
    """Return the scale of a channel in a flight, in its unit.

    Its range, or its magnitude if it hardly moves, but at least its floor.
    """
    # A channel that hardly moves is scaled by its magnitude.
    reach = float(np.ptp(values)) if len(values) else 0.0
    magnitude = float(np.max(np.abs(values), initial=0.0))
    return max(reach if reach > 1e-3 * magnitude else magnitude, channel.floor)


def _difference(
    channel: Channel, flight: MatchedFlight, terms: Sequence[Term], tolerance: float
) -> tuple[float, Difference] | None:
    """Return (relative size at the first frame, difference); None if all is benign."""
    a, b = flight.a[channel.name], flight.b[channel.name]
    scale = scale_of(channel, a)
    # Benign: a multiple of the largest deviation so far of the nudged flight, a share of the range,
    # and what A varies by itself.
    benign = np.maximum(
        NUDGE_FACTOR * np.maximum.accumulate(np.abs(flight.nudged[channel.name] - a)),
        tolerance * scale,
    )
    benign = np.maximum(benign, flight.varied.get(channel.name, 0.0))
    # NaN in one model only counts as a difference, because NaN <= benign is False.
    distance = np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(b - a))
    exceeds = ~(distance <= benign)
    if not exceeds.any():
        return None
    start, worst = (
        int(np.argmax(exceeds)),
        int(np.nanargmax(np.where(np.isnan(distance), np.inf, distance))),
    )
    size = float(distance[worst])
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
        rank_terms(channel, terms),
    )
    return float(distance[start] / scale), difference


_NAMES = {
    "CX": ("CX", "CD"),
    "CY": ("CY",),
    "CZ": ("CZ", "CL"),
    "Cl": ("Cl",),
    "Cm": ("Cm",),
    "Cn": ("Cn",),
}
"""Prefixes of names that authors use for the terms of a coefficient."""


def _name_matches(term: Term, channel: Channel) -> bool:
    """Return whether some name in a term's path begins like the coefficient's names."""
    words = (word for part in term.path.split(" / ") for word in part.split(" ")[1:])
    return any(
        word.rpartition("/")[2].startswith(_NAMES.get(channel.name, ("?",))) for word in words
    )


def rank_terms(channel: Channel, terms: Sequence[Term]) -> tuple[Term, ...]:
    """Sort terms by how likely they affect a channel.

    First the terms of its own axis, then of its group, then of groups before it.
    """

    def penalty(term: Term) -> float:
        if _name_matches(term, channel):
            return -1.0
        if term.channel and term.channel == channel.name:
            return 0.0
        if not term.group:
            return 9.0
        # Terms of later groups cannot cause the difference.
        rank = GROUPS.index(term.group)
        if rank > channel.rank:
            return 8.0
        # Aerodynamics of another axis are less likely than a part that acts on all axes.
        other_axis = term.channel and channel.group.endswith("coefficients")
        return 1.0 + (channel.rank - rank) * 0.5 + (2.0 if other_axis else 0.0)

    return tuple(sorted(terms, key=penalty))
