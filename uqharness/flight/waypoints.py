"""Waypoint missions for the built-in autopilot: QGroundControl's .plan, ArduPilot's .waypoints.

The autopilot has ArduPlane's loiter law alone. `WaypointGuide` moves its circle in every frame: on
a leg the circle is wide and touches the leg abeam of the aircraft, so that the law is that of a
straight line; a turn of more than 90 degrees is a circle of the loiter radius. Items that the
autopilot cannot fly are refused with their line; those that do not move the aircraft are noted.

Sources: mavlink.io (mission protocol, MAV_CMD), docs.qgroundcontrol.com (plan format), ArduPlane's
commands_logic.cpp and AP_L1_Control.cpp (when an item is complete, when a turn begins).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import ParseError, parse_json, read_regular_text
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import engine

_EARTH_M = 6378137.0
_LEG_RADIUS_M = 5e4
_ACCEPTANCE_M, _LOITER_M, _HEIGHT_M = 90.0, 60.0, 5.0
"""ArduPlane's WP_RADIUS and WP_LOITER_RAD, and its tolerance of LOITER_TO_ALT."""
_MAX_ITEMS = 5000
_WAYPOINT, _UNLIM, _TURNS, _TIME, _RTL, _LAND, _TO_ALT = 16, 17, 18, 19, 20, 21, 31
_TAKEOFFS, _LANDINGS = (22, 84), (_LAND, 85)
_JUMP, _SPEED, _TAG, _JUMP_TAG = 177, 178, 600, 601
_MOTIONLESS = {
    *(201, 203, 205, 206, 214, 530, 531, 532, 2000, 2001, 2500, 2501),
    *(112, 114, 115, 181, 182, 183, 184, _TAG),
    *(*_TAKEOFFS, 189, 212),
}
"""Commands that do not move an aeroplane in the air: cameras, servos, delays; take-off and markers
of a landing."""
_NAMES = {
    _LAND: "NAV_LAND",
    82: "NAV_SPLINE_WAYPOINT",
    85: "NAV_VTOL_LAND",
    30: "NAV_CONTINUE_AND_CHANGE_ALT",
    93: "NAV_DELAY",
    92: "NAV_GUIDED_ENABLE",
    94: "NAV_PAYLOAD_PLACE",
    83: "NAV_ALTITUDE_WAIT",
    42702: "NAV_SCRIPT_TIME",
}
_SET = (
    "loiter-center-north-m",
    "loiter-center-east-m",
    "loiter-direction",
    "WP_LOITER_RAD",
    "altitude-cmd-m",
    "airspeed-cmd-mps",
)
_DASHED = {name.replace("-", "_") for name in _SET if "-" in name}
_FRAMES = {
    **dict.fromkeys((0, 5), "above sea level"),
    **dict.fromkeys((3, 6), "above home"),
    **dict.fromkeys((10, 11), "above the ground"),
}


@dataclass(frozen=True)
class Waypoint:
    """One item that is flown.

    Attributes
    ----------
    number : int
        Number of the item in the file.
    kind : str
        ``leg``, ``loiter`` (for ever), ``turns``, ``time``, ``to-altitude``, ``home``.
    north_m, east_m, height_m : float
        From home; NaN where the item takes the place or height of the one before.
    radius_m : float
        Of the loiter, negative for left turns; NaN for the default. Of a leg its acceptance.
    amount : float
        Turns, or seconds.
    speed_mps : float
        Airspeed from this item on; NaN keeps it.
    """

    number: int
    kind: str
    north_m: float
    east_m: float
    height_m: float
    radius_m: float = math.nan
    amount: float = math.nan
    speed_mps: float = math.nan


@dataclass(frozen=True)
class WaypointMission:
    """Items in the order in which they are flown, and what the file has beyond them."""

    path: Path
    items: tuple[Waypoint, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FlownItem:
    """How an item was flown: from and to [s], and the distance from the leg or circle [m]."""

    number: int
    kind: str
    from_s: float
    to_s: float
    complete: bool
    cross_track_median_m: float
    cross_track_max_m: float


@dataclass(frozen=True)
class _Item:
    """A command of a file: latitude and longitude [deg], altitude [m]."""

    number: int
    place: str
    frame: int
    command: int
    parameters: tuple[float, float, float, float]
    latitude: float
    longitude: float
    altitude: float


def read_mission(path: Path) -> WaypointMission:
    """Read a ``.plan`` or a QGC WPL 110 file.

    Raises
    ------
    BadInputError
        With the line or item: a file of another kind, a frame, position or command that the
        built-in autopilot cannot fly.
    """
    try:
        text = read_regular_text(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise BadInputError(f"{path}: not a text file in UTF-8") from None
    notes: list[str] = []
    is_plan = text.lstrip().startswith("{")
    home, items = (_plan if is_plan else _waypoints)(path, text, notes)
    if len(items) > _MAX_ITEMS:
        raise BadInputError(f"{path}: {len(items)} items; at most {_MAX_ITEMS} are flown")
    # A change of speed belongs to the next item; commands without motion are counted.
    passed: list[Waypoint] = []
    speed = math.nan
    motionless: dict[int, int] = {}
    landing: _Item | None = None
    for item in _unrolled(path, items, notes):
        if item.command == _SPEED:
            speed = _speed(item)
        elif item.command in _MOTIONLESS:
            motionless[item.command] = motionless.get(item.command, 0) + 1
        elif item.command in _LANDINGS and landing is None:
            landing = item
        else:
            # A landing on the way is refused as any other command that is not flown.
            passed.append(replace(_waypoint(landing or item, home), speed_mps=speed))
            speed = math.nan
    if not passed:
        raise BadInputError(f"{path}: holds no item that moves the aircraft")
    if landing is not None:
        notes.append(f"{landing.place}: the landing is left out: the aircraft returns home")
    for event, rows in (
        ("heights above terrain count from home", [i for i in items if i.frame in (10, 11)]),
        ("holds are left out, as by ArduPlane", [i for i in items if _has_hold(i)]),
    ):
        if rows:
            notes.append(f"{rows[0].place}: {event}")
    if motionless.keys() & _TAKEOFFS:
        notes.append("the take-off is left out: flights begin in the air")
    others = sum(count for command, count in motionless.items() if command not in _TAKEOFFS)
    if others:
        notes.append(f"{others} items that do not move the aircraft are left out")
    return WaypointMission(path, tuple(passed), tuple(notes))


def _has_hold(item: _Item) -> bool:
    """Return whether an item is a waypoint at which a multirotor would wait."""
    return item.command == _WAYPOINT and item.parameters[0] > 0.0


Home = tuple[float, float, float]


def _waypoints(path: Path, text: str, notes: list[str]) -> tuple[Home, list[_Item]]:
    """Return home (item 0) and the items of a QGC WPL 110 file."""
    lines = text.splitlines()
    if not lines or lines[0].split() not in (["QGC", "WPL", "110"], ["QGC", "WPL", "120"]):
        raise BadInputError(
            f"{path}:1: received {(lines[0] if lines else '')[:40]!r}; a .plan (JSON) or a file"
            " that begins with QGC WPL 110 is needed"
        )
    items = []
    for line, words in enumerate((row.split() for row in lines[1:]), start=2):
        if not words or words[0].startswith("#"):
            continue
        numbers = _numbers(words)
        if len(numbers) != 12:
            raise BadInputError(
                f"{path}:{line}: received {len(words)} fields; 12 numbers are needed"
            )
        number, _, frame, command, p1, p2, p3, p4, lat, lon, alt, _ = numbers
        items.append(
            _Item(
                int(number),
                f"{path}:{line}",
                int(frame),
                int(command),
                (p1, p2, p3, p4),
                lat,
                lon,
                alt,
            )
        )
    if len(items) < 2:
        raise BadInputError(f"{path}: holds home and no item")
    first = items[0]
    if not (first.latitude or first.longitude):
        # Planners write zeros where no home was set.
        first = next((i for i in items[1:] if i.latitude or i.longitude), first)
        notes.append(f"the file has no home: item {first.number} is taken")
        first = replace(first, altitude=0.0)
    _check_place(first)
    return (first.latitude, first.longitude, first.altitude), items[1:]


def _numbers(words: Sequence[str]) -> list[float]:
    """Return words as numbers; none where one is no finite number."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return []
    return numbers if all(math.isfinite(x) for x in numbers) else []


def _plan(path: Path, text: str, notes: list[str]) -> tuple[Home, list[_Item]]:
    """Return home and the items of a plan; complex items by the simple ones that they hold."""
    try:
        document: Any = parse_json(text.encode())
    except ParseError as error:
        raise BadInputError(f"{path}: {error}; a plan of QGroundControl is JSON") from None
    mission = document.get("mission") if isinstance(document, dict) else None
    if not isinstance(mission, dict) or not isinstance(mission.get("items"), list):
        raise BadInputError(f"{path}: holds no mission with items; a .plan of QGroundControl does")
    home = mission.get("plannedHomePosition")
    place = [x if isinstance(x, int | float) else math.nan for x in home or ()]
    if len(place) != 3 or not all(map(math.isfinite, place)):
        raise BadInputError(f"{path}: plannedHomePosition {home!r}: latitude, longitude, altitude")
    for name, key in (("geofence", "geoFence"), ("rally points", "rallyPoints")):
        part = document.get(key)
        if isinstance(part, dict) and any(isinstance(v, list) and v for v in part.values()):
            notes.append(f"the {name} are not observed")
    # Simple items stand in the file in the order in which they are read; each has one command.
    keys = re.finditer(r'"command"\s*:', text)
    lines = iter([text.count("\n", 0, key.start()) + 1 for key in keys])
    items: list[_Item] = []
    for index, row in enumerate(mission["items"], start=1):
        items += _plan_items(path, index, row, items, lines)
    return (place[0], place[1], place[2]), items


def _plan_items(
    path: Path, index: int, row: Any, before: Sequence[_Item], lines: Iterator[int]
) -> list[_Item]:
    """Return the simple items of one item of a plan; ``lines`` are theirs in the file."""
    where = f"{path}: item {index}"
    if not isinstance(row, dict):
        raise BadInputError(f"{where}: received {str(row)[:30]}; an object is needed")
    if row.get("type") == "ComplexItem":
        parts = [row.get("TransectStyleComplexItem"), row]
        inner = next((p["Items"] for p in parts if isinstance(p, dict) and "Items" in p), None)
        kind = row.get("complexItemType", "a complex item")
        if kind == "fwLandingPattern":
            return [_Item(len(before) + 1, where, 3, _LAND, (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0)]
        if not isinstance(inner, list):
            raise BadInputError(
                f"{where}: {kind} without its own items"
                " cannot be flown; save the plan as single waypoints"
            )
        out: list[_Item] = []
        for part in inner:
            out += _plan_items(path, index, part, [*before, *out], lines)
        return out
    if "command" in row:
        where = f"{path}:{next(lines, 0)}: item {index}"
    parameters = row.get("params")
    if not isinstance(parameters, list) or len(parameters) != 7:
        raise BadInputError(f"{where}: params {str(parameters)[:40]}: seven numbers are needed")
    numbers = [x if isinstance(x, int | float) else math.nan for x in parameters]
    p1, p2, p3, p4, lat, lon, alt = (0.0 if math.isnan(x) else float(x) for x in numbers)
    number: Any = row.get("doJumpId", len(before) + 1)
    command: Any = row.get("command")
    frame: Any = row.get("frame", 3)
    if not all(isinstance(x, int) for x in (number, command, frame)):
        raise BadInputError(f"{where}: command {command!r}, frame {frame!r}: numbers are needed")
    return [_Item(number, where, frame, command, (p1, p2, p3, p4), lat, lon, alt)]


def _unrolled(path: Path, items: Sequence[_Item], notes: list[str]) -> list[_Item]:
    """Return the items with DO_JUMP carried out; a jump for ever is one of many rounds."""
    targets = {
        _JUMP: {item.number: k for k, item in enumerate(items)},
        _JUMP_TAG: {int(i.parameters[0]): k for k, i in enumerate(items) if i.command == _TAG},
    }
    jumps_left: dict[int, int] = {}
    out: list[_Item] = []
    k = 0
    while k < len(items) and len(out) < _MAX_ITEMS:
        item = items[k]
        k += 1
        if item.command not in targets:
            out.append(item)
            continue
        target, count = int(item.parameters[0]), int(item.parameters[1])
        if target not in targets[item.command]:
            name = "DO_JUMP to item" if item.command == _JUMP else "DO_JUMP_TAG to tag"
            raise BadInputError(f"{item.place}: {name} {target}, which does not exist")
        if count < 0 and k < len(items) and item.number not in jumps_left:
            notes.append(f"items behind the endless jump of item {item.number} are never reached")
        remaining = jumps_left.setdefault(item.number, count)
        if remaining != 0:
            jumps_left[item.number] = remaining - 1
            k = targets[item.command][target]
    return out


def _speed(item: _Item) -> float:
    """Return the airspeed of a DO_CHANGE_SPEED. Raises BadInputError for a ground speed."""
    kind, speed = item.parameters[0], item.parameters[1]
    if kind != 0.0 or not speed > 0.0:
        raise BadInputError(
            f"{item.place}: DO_CHANGE_SPEED of type {kind:g} to {speed:g}: the autopilot holds an"
            " airspeed (type 0) above 0"
        )
    return speed


def _check_place(item: _Item) -> None:
    """Raise BadInputError for a latitude or longitude that is none."""
    if not (abs(item.latitude) <= 89.0 and abs(item.longitude) <= 180.0):
        raise BadInputError(
            f"{item.place}: position {item.latitude:g}, {item.longitude:g} deg is none"
        )


def _waypoint(item: _Item, home: Home) -> Waypoint:
    """Return an item that moves the aircraft. Raises BadInputError for one that is not flown."""
    p1, p2, p3, _ = item.parameters
    # Kind, radius and amount (turns or seconds) of each command, by MAVLink's numbering.
    kinds = {
        _WAYPOINT: ("leg", p2, math.nan),
        _UNLIM: ("loiter", p3, math.nan),
        _TURNS: ("turns", p3, p1),
        _TIME: ("time", p3, p1),
        _TO_ALT: ("to-altitude", p2, math.nan),
        _RTL: ("home", math.nan, math.nan),
    }
    if item.command not in kinds:
        name = _NAMES.get(item.command, f"command {item.command}")
        raise BadInputError(
            f"{item.place}: {name} cannot be flown; the built-in autopilot flies waypoints, loiters"
            " and the return home (commands 16 to 20, 31), changes of airspeed and jumps"
        )
    kind, radius, amount = kinds[item.command]
    # What an aeroplane or a flat earth cannot do is refused at its item.
    if kind in ("turns", "time") and not amount > 0.0:
        raise BadInputError(f"{item.place}: a loiter of {amount:g}; more than 0 is needed")
    if kind == "home":
        return Waypoint(item.number, kind, 0.0, 0.0, math.nan)
    if item.frame not in _FRAMES:
        raise BadInputError(
            f"{item.place}: frame {item.frame}: heights above home (3), sea level (0) or terrain"
            " (10) can be flown"
        )
    # Positions become metres north and east of home; 0, 0 means "where the aircraft is".
    height = item.altitude - (home[2] if _FRAMES[item.frame] == "above sea level" else 0.0)
    north = east = math.nan
    if item.latitude or item.longitude:
        _check_place(item)
        north = math.radians(item.latitude - home[0]) * _EARTH_M
        east = math.radians((item.longitude - home[1] + 180.0) % 360.0 - 180.0) * _EARTH_M
        east *= math.cos(math.radians(home[0]))
        if math.hypot(north, east) > 5e4:
            raise BadInputError(
                f"{item.place}: {math.hypot(north, east) / 1e3:.0f} km from home; 50 km at most"
            )
    elif kind == "leg":
        raise BadInputError(f"{item.place}: a waypoint without a position")
    if not 0.0 < height < 1e4:
        raise BadInputError(f"{item.place}: {height:g} m above home; more than 0 is needed")
    return Waypoint(item.number, kind, north, east, height, radius or math.nan, amount)


class WaypointGuide:
    """Flies a mission by moving the autopilot's circle, height and airspeed.

    Raises BadInputError for an aircraft without the built-in autopilot.
    """

    def __init__(self, mission: WaypointMission, fdm: Any) -> None:
        # The autopilot is needed before the first frame.
        needed = [
            *(f"ap/{name}" for name in _SET),
            *("ap/NAVL1_PERIOD", "ap/NAVL1_DAMPING", "ap/EAS2TAS", "ap/engaged"),
        ]
        manager = fdm.get_property_manager()
        absent = [name for name in needed if not manager.hasNode(name)]
        if absent:
            raise BadInputError(
                f"{mission.path}: the aircraft has no autopilot for waypoints (no"
                f" {absent[0]}); espaaro has one (docs/autopilot.md)"
            )
        self._fdm, self._items = fdm, mission.items
        self._get = {
            name: engine.handle(fdm, prop).get_double_value
            for name, prop in {
                "north": "position/from-start-neu-n-ft",
                "east": "position/from-start-neu-e-ft",
                "vn": "velocities/v-north-fps",
                "ve": "velocities/v-east-fps",
                "height": "position/h-agl-ft",
                "stretch": "ap/EAS2TAS",
            }.items()
        }
        # Radius and L1 distance per speed, as ArduPlane computes them from its parameters.
        self._default_radius = abs(float(fdm["ap/WP_LOITER_RAD"])) or _LOITER_M
        self._l1_s = float(fdm["ap/NAVL1_DAMPING"]) * float(fdm["ap/NAVL1_PERIOD"]) / math.pi
        # Progress along the mission: the item, its start, and the angle swept around a loiter.
        self._rows: list[FlownItem] = []
        self._distances: list[float] = []
        self._number = -1
        self._origin = np.zeros(2)
        self._target = np.zeros(2)
        self._begin_s = 0.0
        self._side = 0.0
        self._turn: tuple[float, float, float] | None = None
        self._angle: float | None = None
        self._swept = 0.0
        self._arrived_s = math.nan

    def around(self, advance: Callable[[int], None]) -> Callable[[int], None]:
        """Return a loop that guides before each of n frames."""

        def stepped(count: int) -> None:
            for _ in range(count):
                self._guide()
                advance(1)

        return stepped

    def report(self) -> list[FlownItem]:
        """Return how the items were flown, the last one perhaps not to its end."""
        return [*self._rows, self._row(False)]

    def _row(self, complete: bool) -> FlownItem:
        item = self._item
        distances = np.abs(self._distances)
        return FlownItem(
            item.number,
            item.kind,
            self._begin_s,
            float(self._fdm.get_sim_time()),
            complete,
            float(np.median(distances)) if distances.size else math.nan,
            float(distances.max()) if distances.size else math.nan,
        )

    @property
    def _item(self) -> Waypoint:
        # Behind the last item ArduPlane returns home.
        home = Waypoint(len(self._items) + 1, "home", 0.0, 0.0, math.nan)
        return self._items[self._number] if self._number < len(self._items) else home

    def _set(self, **values: float) -> None:
        for name, value in values.items():
            self._fdm[f"ap/{name.replace('_', '-') if name in _DASHED else name}"] = value

    def _guide(self) -> None:
        """Set the circle for the next frame, and go on to the next item where one is complete."""
        get = self._get
        place = np.array([get["north"](), get["east"]()]) * FT_M
        velocity = np.array([get["vn"](), get["ve"]()]) * FT_M
        if self._number < 0:
            self._target = place
            self._next(place)
        if self._item.kind == "leg":
            self._fly_leg(place, velocity)
        else:
            self._fly_loiter(place)

    def _next(self, place: FloatArray) -> None:
        """Begin the next item."""
        if self._number >= 0:
            self._rows.append(self._row(True))
        self._number += 1
        item = self._item
        self._distances, self._side, self._turn = [], 0.0, None
        self._angle, self._swept, self._arrived_s = None, 0.0, math.nan
        self._begin_s = float(self._fdm.get_sim_time())
        # A leg runs from the waypoint before, not from where the turn began.
        self._origin = self._target
        north = item.north_m if math.isfinite(item.north_m) else float(place[0])
        east = item.east_m if math.isfinite(item.east_m) else float(place[1])
        self._target = np.array([north, east])
        if math.isfinite(item.height_m):
            self._set(altitude_cmd_m=item.height_m)
        if math.isfinite(item.speed_mps):
            self._set(airspeed_cmd_mps=item.speed_mps)

    def _fly_leg(self, place: FloatArray, velocity: FloatArray) -> None:
        """Set a wide circle that touches the leg abeam of the aircraft."""
        leg = self._target - self._origin
        length = float(np.linalg.norm(leg))
        if length < 1.0:
            self._next(place)
            return
        direction = leg / length
        right = np.array([-direction[1], direction[0]])
        done, error = (
            float((place - self._origin) @ direction),
            float((place - self._origin) @ right),
        )
        ground_speed = float(np.linalg.norm(velocity))
        if done >= length - self._turn_distance(direction, ground_speed):
            self._next(place)
            return
        self._distances.append(error)
        if self._turn is not None or float(velocity @ direction) < 0.0:
            self._turn_back(place, velocity, direction, right)
            if self._turn is not None:
                return
        if not self._side:
            # Outside the circle the law captures it from any distance, inside it does not.
            self._side = -1.0 if error > 0.0 else 1.0
        foot = self._origin + done * direction
        radius = _LEG_RADIUS_M * self._get["stretch"]() ** 2
        centre = foot + self._side * radius * right
        self._set(
            loiter_center_north_m=float(centre[0]),
            loiter_center_east_m=float(centre[1]),
            WP_LOITER_RAD=_LEG_RADIUS_M,
            loiter_direction=self._side,
        )

    def _turn_back(
        self, place: FloatArray, velocity: FloatArray, along: FloatArray, right: FloatArray
    ) -> None:
        """Fly a circle of the loiter radius until the leg lies ahead."""
        if self._turn is None:
            side = 1.0 if float(velocity @ right) < 0.0 else -1.0
            # Towards the leg's direction: a right turn where it lies to the right.
            cross = velocity[0] * along[1] - velocity[1] * along[0]
            side = math.copysign(1.0, cross) if abs(cross) > 1e-6 else side
            across = np.array([-velocity[1], velocity[0]]) / max(np.linalg.norm(velocity), 1e-6)
            centre = place + side * self._default_radius * across
            self._turn = (float(centre[0]), float(centre[1]), side)
        north, east, side = self._turn
        self._set(
            loiter_center_north_m=north,
            loiter_center_east_m=east,
            WP_LOITER_RAD=self._default_radius,
            loiter_direction=side,
        )
        if float(velocity @ along) > 0.5 * float(np.linalg.norm(velocity)):
            self._turn = None

    def _turn_distance(self, along: FloatArray, ground_speed: float) -> float:
        """Return how far before a waypoint the turn to the next leg begins (AP_L1_Control)."""
        following = self._items[self._number + 1 : self._number + 2]
        if not following or following[0].kind != "leg":
            return 0.0
        item = self._item
        limit = item.radius_m if item.radius_m > 0.0 else _ACCEPTANCE_M
        leg = np.array([following[0].north_m, following[0].east_m]) - self._target
        cosine = float(leg @ along) / max(float(np.linalg.norm(leg)), 1e-6)
        angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        return min(limit, self._l1_s * ground_speed) * min(angle / 90.0, 1.0)

    def _fly_loiter(self, place: FloatArray) -> None:
        """Set the item's circle, and count its turns or seconds from the arrival on."""
        item = self._item
        signed = item.radius_m if math.isfinite(item.radius_m) else self._default_radius
        radius = abs(signed) or self._default_radius
        direction = math.copysign(1.0, signed)
        self._set(
            loiter_center_north_m=float(self._target[0]),
            loiter_center_east_m=float(self._target[1]),
            WP_LOITER_RAD=radius,
            loiter_direction=direction,
        )
        offset = place - self._target
        distance = float(np.linalg.norm(offset))
        time_s = float(self._fdm.get_sim_time())
        if math.isnan(self._arrived_s):
            # The circle that the law flies is wider at height.
            if distance > 1.1 * radius * self._get["stretch"]() ** 2:
                return
            self._arrived_s = time_s
        self._distances.append(distance - radius)
        angle = math.atan2(offset[1], offset[0])
        if self._angle is not None:
            step = (angle - self._angle + math.pi) % (2.0 * math.pi) - math.pi
            self._swept += direction * step
        self._angle = angle
        height = self._get["height"]() * FT_M
        complete = {
            "turns": self._swept >= 2.0 * math.pi * item.amount,
            "time": time_s - self._arrived_s >= item.amount,
            "to-altitude": abs(height - item.height_m) < _HEIGHT_M,
        }
        if complete.get(item.kind, False):
            self._next(place)
