"""The aircraft prepared for replay: a copy without idle systems and, for measured surfaces, without
actuator dynamics.

JSBSim has no property that switches a servo's lag off, and a measured surface position must not
pass the lag a second time. `ReplayFolder` therefore edits a copy of the XML; all aerodynamic
numbers stay those of the original. The module also sets the height of the ground below a replay.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from lxml import etree

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from sysid.units import DEG_RAD
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.simulator import (
    Aircraft,
    Card,
    Staging,
    check_loadable,
    content_hash,
    engine,
    function_properties,
    parse_xml,
    position_factor,
    stage,
)
from uqharness.xml import declared_properties, position_names, without_unit

if TYPE_CHECKING:
    from uqharness.replay.segments import Segment

CONTROLS = ("elevator", "aileron", "rudder", "throttle")
_HEIGHT = re.compile(r"h-agl-(?:ft|km)|h_b-(?:mac|cg)-ft")
_RATES = re.compile(r"(?:alpha|beta)dot-(?:rad|deg)_sec")
_INTEGRATORS = tuple(
    f"simulation/integrator/{part}"
    for part in (
        "rate/rotational",
        "rate/translational",
        "position/rotational",
        "position/translational",
    )
)
_THIRD_ORDER = 4.0
"""JSBSim's number of Adams-Bashforth's rule of third order. One of second order would add 0.08 % to
a mode of 8.5 rad/s in runs of 5 ms."""
_ACTUATOR_DYNAMICS = ("lag", "rate_limit", "hysteresis_width", "deadband_width", "bias")


@dataclass(frozen=True)
class ReplayModel:
    """What a process needs to open the copy; picklable, valid while its `ReplayFolder` is open.

    Attributes
    ----------
    staging, card
        Folder layout of the copy, and the aircraft's card.
    controls : tuple of str
        Controls in the order of the columns of a segment.
    measured : tuple of str
        Controls given as positions, interpolated between samples; the others are commands, held.
    factor : tuple of float
        Record unit to property unit, one a control.
    lagging : tuple of str
        Controls whose commands pass an actuator with a lag or a rate limit.
    lags : Mapping
        Control to its lag and rate limit as text of the XML.
    settings : Mapping
        Properties set on every instance.
    throws : tuple
        One a control: (positions [deg], commands) of the aircraft's linkage over its travel, for
        normalised controls given as positions, whose two directions seldom share one factor; None
        where ``factor`` is enough.
    near_ground, by_rates : bool
        Whether the XML reads the height above the ground, or the rates of alpha or beta.
    identity : str
        Equal for copies that fly alike; the key of caches.
    varied : tuple of str
        Coefficients and effects that the XML declares; compiled programs accept any value of each.
    throttles : tuple of str
        Commands that JSBSim's first throttle stands for.
    servos : tuple of str
        Properties that the numbers of actuators refer to.
    """

    staging: Staging
    card: Card
    controls: tuple[str, ...]
    measured: tuple[str, ...]
    factor: tuple[float, ...]
    lagging: tuple[str, ...] = ()
    lags: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    settings: Mapping[str, float] = field(default_factory=dict)
    throws: tuple[tuple[tuple[float, ...], tuple[float, ...]] | None, ...] = ()
    near_ground: bool = False
    by_rates: bool = False
    identity: str = ""
    varied: tuple[str, ...] = ()
    throttles: tuple[str, ...] = ()
    servos: tuple[str, ...] = ()

    def current_values(self, dt_s: float, names: Sequence[str]) -> FloatArray:
        """Return the values (k,) of properties in the aircraft's XML, as JSBSim reads them.

        Raises BadInputError for a property that the aircraft lacks.
        """
        fdm = self.open(dt_s)
        engine.require(fdm, names)
        return np.array([fdm[n] for n in names])

    @property
    def jumping(self) -> tuple[str, ...]:
        """Return the controls whose surfaces follow a command step at once."""
        return tuple(c for c in self.controls if c not in self.measured and c not in self.lagging)

    def to_property(self, controls: FloatArray) -> FloatArray:
        """Convert controls (..., c) from the record's units to those of their properties."""
        out = controls * np.array(self.factor)
        for column, throw in enumerate(self.throws):
            if throw is not None:
                out[..., column] = np.interp(controls[..., column], *throw)
        return out

    def to_record(self, control: str, command: float) -> float:
        """Convert a command in its property's unit to the record's, degrees or percent."""
        column = self.controls.index(control)
        throw = self.throws[column]
        if throw is None:
            return command / self.factor[column]
        positions, commands = (np.array(row) for row in throw)
        order = np.argsort(commands)
        return float(np.interp(command, commands[order], positions[order]))

    def control_properties(self) -> tuple[tuple[str, ...], tuple[int, ...]]:
        """Return the properties that the controls set, and the index in ``controls`` of each.

        JSBSim's throttle sets every engine, so it may have several properties.
        """
        names: list[str] = []
        places: list[int] = []
        for place, control in enumerate(self.controls):
            prop = self.card.inputs[control].property
            commands = (self.throttles if prop == engine.THROTTLE else ()) or (prop,)
            names += commands
            places += [place] * len(commands)
        return tuple(names), tuple(places)

    def open(self, dt_s: float) -> Any:
        """Open a new ``FGFDMExec`` in the card's open-loop mode with the integrators of a replay.

        Raises BadInputError where a property does not exist.
        """
        fdm = engine.open_fdm(self.staging, dt_s)
        for name, value in {**self.card.modes.get("open_loop", {}), **self.settings}.items():
            engine.set_property(fdm, name, value)
        for name in _INTEGRATORS:
            fdm[name] = _THIRD_ORDER
        return fdm

    def position_unit(self, control: str) -> float:
        """Return the factor from a control's position property to the record's unit.

        A surface's position may be in another unit than its command; a throttle's is in the
        command's.
        """
        if control == "throttle":
            return 1.0 / self.factor[self.controls.index(control)]
        return position_factor(self.card.inputs[control])

    def positions(self) -> dict[str, str]:
        """Return control to position property, for the controls whose card names one."""
        return {c: p for c in self.controls if (p := self.card.inputs[c].position) is not None}


class ReplayFolder:
    """Context that holds the copy of an aircraft for replay, and yields its `ReplayModel`.

    Parameters
    ----------
    aircraft : Aircraft
        The model.
    controls : sequence of str
        Controls that are replayed, in the order of a segment's columns.
    measured : sequence of str
        Controls whose record columns are surface positions: their actuators pass values through;
        stops remain.
    ideal : sequence of str
        Further controls whose actuators pass values through, though their columns are commands.
    settings : Mapping, optional
        Properties set on every instance.

    Raises
    ------
    BadInputError
        When the card lacks one of the controls.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        controls: Sequence[str] = CONTROLS,
        measured: Sequence[str] = (),
        ideal: Sequence[str] = (),
        settings: Mapping[str, float] | None = None,
    ) -> None:
        check_loadable(aircraft)
        missing = [name for name in controls if name not in aircraft.card.inputs]
        if missing:
            raise BadInputError(
                f"aircraft '{aircraft.name}': its airframe.toml has no [inputs.{missing[0]}]; a"
                " replay needs to know which property that control is"
            )
        # All edits are made in a temporary copy.
        self._scratch = scratch_folder("replay")
        staging = stage(aircraft, self._scratch.path)
        copy, card = staging.folder, aircraft.card
        lagging, servos = _strip_dynamics(copy, aircraft.xml.name, card, (*measured, *ideal))
        self.model = ReplayModel(
            staging,
            card,
            tuple(controls),
            tuple(measured),
            tuple(_factor(card, name) for name in controls),
            tuple(c for c in controls if c in lagging),
            {c: lagging[c] for c in controls if c in lagging},
            dict(settings or {}),
            near_ground=_xml_mentions(_HEIGHT, copy),
            by_rates=_xml_mentions(_RATES, copy),
            identity=repr(
                (
                    content_hash(aircraft),
                    tuple(controls),
                    tuple(measured),
                    tuple(ideal),
                    dict(settings or {}),
                )
            ),
            varied=(*declared_properties(copy, "aero/"), *declared_properties(copy, "effect/")),
            servos=servos,
        )
        # The model must load before its linkages can be measured.
        throttles = _declare_orphans(self.model, staging.xml, aircraft.dt_s)
        self.model = replace(self.model, throttles=throttles)
        self.model = replace(
            self.model, throws=_throws(self.model, (*measured, *ideal), aircraft.dt_s)
        )

    def __enter__(self) -> ReplayModel:
        return self.model

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._scratch.close()


def _xml_mentions(names: re.Pattern[str], folder: Path) -> bool:
    """Check whether any XML file of a folder contains a property name of a pattern."""
    texts = (
        p.read_bytes().decode("utf-8", errors="replace") for p in sorted(folder.rglob("*.xml"))
    )
    return any(names.search(text) is not None for text in texts)


def _factor(card: Card, control: str) -> float:
    """Return the factor from a control's record unit [deg, %] to its property unit."""
    unit, limits = card.inputs[control].unit, card.inputs[control].limits
    if unit == "rad":
        return DEG_RAD
    if unit != "norm":
        return 1.0
    if control == "throttle":
        return 0.01
    # A symmetric throw of the card converts degrees to the normalised command.
    if (throw := card.inputs[control].throw_deg) is not None:
        return 1.0 / throw
    raise BadInputError(
        f"[inputs.{control}] is normalised (limits {limits}) and a record is in degrees: the"
        " deflection at 1 is undefined; give the card a property in deg or rad, or throw_deg"
    )


def _throws(
    model: ReplayModel, direct: Sequence[str], dt_s: float
) -> tuple[tuple[tuple[float, ...], tuple[float, ...]] | None, ...]:
    """Tabulate each control's positions [deg] and commands over its travel; None where a factor is
    enough.
    """
    throws: list[tuple[tuple[float, ...], tuple[float, ...]] | None] = []
    for control in model.controls:
        card = model.card.inputs[control]
        if (
            control not in direct
            or control == "throttle"
            or card.unit != "norm"
            or card.position is None
        ):
            throws.append(None)
            continue
        # Measure the linkage: command steps over the travel, the position read back from JSBSim.
        commands = np.linspace(*card.limits, 41)
        fdm = model.open(dt_s)
        (set_command,) = control_setters(fdm, replace(model, controls=(control,)))[0]
        read = engine.handle(fdm, card.position).get_double_value
        positions = np.empty(len(commands))
        for k, command in enumerate(commands):
            set_command(float(command))
            # Twice: a property in degrees may be made of the radians of the frame before.
            engine.run_ic(fdm)
            engine.run_ic(fdm)
            positions[k] = read() * position_factor(card)
        step = np.diff(positions)
        rising = bool((step >= 0.0).all()) and positions[-1] > positions[0]
        if rising or ((step <= 0.0).all() and positions[-1] < positions[0]):
            # Keep strictly increasing positions only, as interpolation needs; stops repeat a
            # position.
            order = np.argsort(positions, kind="stable")
            increasing = order[np.append(True, np.diff(positions[order]) > 0.0)]
            throws.append(
                (tuple(positions[increasing].tolist()), tuple(commands[increasing].tolist()))
            )
        else:
            throws.append(None)
    return tuple(throws)


def _strip_dynamics(
    folder: Path, main: str, card: Card, direct: Sequence[str]
) -> tuple[dict[str, tuple[str, str]], tuple[str, ...]]:
    """Remove idle systems from the main file, and the dynamics from the actuators of ``direct``
    controls.

    An actuator moves a control if its name or one of its outputs is the card's position or one of
    JSBSim's, in whatever unit. Returns control to (lag, rate limit) of actuators that keep one, and
    the properties that the actuators' numbers refer to.
    """
    lagging: dict[str, tuple[str, str]] = {}
    number_properties: set[str] = set()
    surfaces = {name: control for control in card.inputs for name in position_names(card, control)}
    for path in sorted(folder.rglob("*.xml")):
        tree = parse_xml(path)
        root = tree.getroot()
        changed = False
        if path.name == main and path.parent == folder:
            for system in root.findall("system"):
                if system.get("file") in card.replay.without_systems:
                    root.remove(system)
                    changed = True
        for actuator in root.iter("actuator"):
            name = str(actuator.get("name"))
            output_names = [
                name if "/" in name else f"fcs/{name}",
                *((o.text or "").strip() for o in actuator.findall("output")),
            ]
            moved_controls = {
                surfaces[position]
                for position in map(without_unit, output_names)
                if position in surfaces
            }
            # A measured or ideal surface follows its column without delay; stops are left in place.
            if moved_controls & {*direct}:
                for kind in _ACTUATOR_DYNAMICS:
                    for element in actuator.findall(kind):
                        actuator.remove(element)
                        changed = True
            if any(actuator.find(kind) is not None for kind in ("lag", "rate_limit")):
                # A rate limit counts in the unit of the actuator's own output.
                texts = [(actuator.findtext(kind) or "").strip() for kind in ("lag", "rate_limit")]
                lagging |= {
                    control: (
                        texts[0],
                        texts[1] if card.inputs[control].position in output_names else "",
                    )
                    for control in moved_controls
                }
            numbers = (
                (e.text or "").strip()
                for kind in _ACTUATOR_DYNAMICS
                for e in actuator.findall(kind)
            )
            number_properties |= {text for text in numbers if "/" in text}
        if changed:
            tree.write(str(path), encoding="UTF-8", xml_declaration=True)
    return lagging, tuple(sorted(number_properties))


def _declare_orphans(model: ReplayModel, xml: Path, dt_s: float) -> tuple[str, ...]:
    """Declare, at zero, the properties that only removed systems created; return the throttles of
    the engines that pull.
    """
    fdm = engine.open_fdm(model.staging, dt_s)
    throttles = tuple(engine.throttles(fdm)[0])
    manager = fdm.get_property_manager()
    names = [n for n in model.card.modes.get("open_loop", {}) if not manager.hasNode(n)]
    read = (name for name, _, _ in function_properties(model.staging))
    # Functions that read an undefined property would not load.
    names += engine.undefined_properties(fdm, read)
    if not names:
        return throttles
    tree = parse_xml(xml)
    root = tree.getroot()
    system = etree.Element("system", name="left out of the replay")
    for name in names:
        etree.SubElement(system, "property", value="0").text = name
    # The declarations must precede their first use.
    first = next(
        (e for e in root if e.tag in ("system", "autopilot", "flight_control", "aerodynamics")),
        None,
    )
    if first is None:
        root.append(system)
    else:
        first.addprevious(system)
    tree.write(str(xml), encoding="UTF-8", xml_declaration=True)
    return throttles


def control_setters(fdm: Any, model: ReplayModel) -> list[list[Any]]:
    """Return the property setters of each control: one, or JSBSim's throttle of every engine."""
    setters = []
    for name in model.controls:
        prop = model.card.inputs[name].property
        commands = engine.throttles(fdm)[0] if prop == engine.THROTTLE else []
        setters.append([engine.handle(fdm, one).set_double_value for one in commands or [prop]])
    return setters


# Height of the ground below a replay. It is the recorded height where the aerodynamics read it,
# and out of reach elsewhere: a record that starts in the air at its own zero, or has no height,
# does not determine the distance to the ground.

OUT_OF_REACH_M = 2000.0
_BEGINNING_S, _ZERO_M, _AT_REST_MPS = 0.5, 0.5, 5.0
_HALF_WINDOW_S = 4.0
"""Half width of the window that smooths recorded heights [s]. It reduces a barometer's noise of 1.5
m at 50 Hz to 0.1 m, and to 0.2 m at the ends."""


def has_ground_heights(record: FlightRecord) -> bool:
    """Check whether a record's heights are above the ground: it starts off its zero, or at rest."""
    if (
        "h_m" not in record
        or not np.isfinite(record["h_m"]).any()
        or not np.nanmedian(record["h_m"]) > 0.0
    ):
        return False
    beginning = slice(0, max(1, round(_BEGINNING_S / record.dt_s)))
    first = {c: np.array(record[c][beginning]) for c in ("h_m", "V_mps") if c in record}
    # Medians over half a second are robust to single outliers.
    low = {c: float(np.median(v[np.isfinite(v)])) for c, v in first.items() if np.isfinite(v).any()}
    return abs(low.get("h_m", 0.0)) > _ZERO_M or low.get("V_mps", np.inf) < _AT_REST_MPS


def heights(channels: Mapping[str, FloatArray], dt_s: float) -> FloatArray:
    """Return smoothed heights (n,) [m] along a stretch.

    The climb follows from airspeed, wind angles and attitude (Stevens and Lewis, rate of climb);
    the offset from the recorded heights is a straight line through those near each row.
    ``channels`` belong to the stretch and have no gaps.
    """
    V, a, b, phi, theta, h = (
        channels[n] for n in ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "h_m")
    )
    # Rate of climb of the body-axis velocity, Stevens and Lewis: V times the vertical direction
    # cosine.
    across = np.sin(b) * np.sin(phi) + np.sin(a) * np.cos(b) * np.cos(phi)
    climb = V * (np.cos(a) * np.cos(b) * np.sin(theta) - across * np.cos(theta))
    # Trapezoidal integration of the climb; only its offset from the recorded heights is smoothed.
    path = dt_s * np.concatenate([[0.0], np.cumsum(0.5 * (climb[1:] + climb[:-1]))])
    return path + _local_lines(h - path, max(1, round(_HALF_WINDOW_S / dt_s)))


def _local_lines(values: FloatArray, half: int) -> FloatArray:
    """Fit a straight line to the values within ``half`` samples of each row; return its value
    there, (n,).
    """
    n = len(values)
    at = np.arange(n)
    first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, n)
    # Running sums give all windows' normal equations at once.
    sums = np.cumsum(
        np.pad(np.stack([np.ones(n), at, at**2, values, at * values]), ((0, 0), (1, 0))), axis=1
    )
    count, x, xx, y, xy = sums[:, last] - sums[:, first]
    denominator = count * xx - x**2
    slope = np.divide(count * xy - x * y, denominator, out=np.zeros(n), where=denominator > 0.0)
    return np.asarray(y / count + slope * (at - x / count))


def terrain_m(model: ReplayModel, segment: Segment) -> float:
    """Return the elevation of the ground under a replay, above sea level [m]."""
    # The ground is placed relative to the start, whose altitude comes from the air density.
    return segment.altitude_m - (segment.h_m if _ground_counts(model, segment) else OUT_OF_REACH_M)


def altitudes(model: ReplayModel, segment: Segment, h_m: FloatArray) -> FloatArray:
    """Return altitudes above sea level (n,) [m] at recorded heights.

    They equal the segment's throughout where the ground does not matter.
    """
    return segment.altitude_m + (
        h_m - segment.h_m if _ground_counts(model, segment) else np.zeros(len(h_m))
    )


def _ground_counts(model: ReplayModel, segment: Segment) -> bool:
    """Check whether the model reads the height above ground and the record has one."""
    return model.near_ground and segment.above_ground
