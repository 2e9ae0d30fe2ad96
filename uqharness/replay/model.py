"""The aircraft made ready for replay: a copy without idle systems and, where surfaces are given,
without actuators.

A copy, because JSBSim offers no property that takes a servo's lag away: a measured surface position
must not go through the lag a second time. Only the copy differs; every number of the aerodynamics
is the original's."""

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
from uqharness.xml import declared_in

if TYPE_CHECKING:
    from uqharness.replay.segments import Segment

THROTTLE = "fcs/throttle-cmd-norm"
"""JSBSim's throttle of the first engine."""
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

    ``measured`` controls whose values are positions, continuous between samples; the others are
    commands, held. ``lagging`` controls whose commands go through an actuator with a lag; ``lags``
    its lag and rate limit, as the XML has them. ``factor`` record unit -> property unit of each
    control, in the order of ``controls``. ``throws`` positions and the commands at which the
    aircraft's own linkage puts them, of normalised controls whose values are positions: both ends
    of a travel seldom have one factor. ``identity`` of what flies: two copies of one aircraft,
    opened alike, have the same. ``near_ground`` whether its XML reads the height above the ground,
    ``by_rates`` whether it reads the rates of alpha or beta. ``varied`` coefficients and effects
    that its XML declares: programs compiled from it take each of them at any value. ``engines``
    number of them in its <propulsion>; ``servos`` properties that the numbers of its actuators are.
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
    engines: int = 0
    servos: tuple[str, ...] = ()

    @property
    def jumping(self) -> tuple[str, ...]:
        """Controls that jump with their commands."""
        return tuple(c for c in self.controls if c not in self.measured and c not in self.lagging)

    def to_property(self, controls: FloatArray) -> FloatArray:
        """(..., c) values of the controls in the record's units, in those of their properties."""
        out = controls * np.array(self.factor)
        for column, throw in enumerate(self.throws):
            if throw is not None:
                out[..., column] = np.interp(controls[..., column], *throw)
        return out

    def control_properties(self) -> tuple[tuple[str, ...], tuple[int, ...]]:
        """Properties that the controls set, and the place in ``controls`` of the one that sets
        each: JSBSim's throttle is that of every engine."""
        names, places = [], []
        for place, control in enumerate(self.controls):
            prop = self.card.inputs[control].property
            engine_numbers = range(1, self.engines) if prop == THROTTLE else ()
            names += [prop, *(f"{prop}[{k}]" for k in engine_numbers)]
            places += [place] * (1 + len(engine_numbers))
        return tuple(names), tuple(places)

    def open(self, dt_s: float) -> Any:
        """A fresh ``FGFDMExec`` in the card's open-loop mode with the replay's integrators, nothing
        run. Raises BadInputError.
        """
        fdm = engine.open_fdm(self.staging, dt_s)
        for name, value in {**self.card.modes.get("open_loop", {}), **self.settings}.items():
            engine.set_property(fdm, name, value)
        for name in _INTEGRATORS:
            fdm[name] = _THIRD_ORDER
        return fdm

    def position_unit(self, control: str) -> float:
        """Unit of a control's position in the record's: a surface's may be in another unit than its
        command, a throttle's is in the command's."""
        if control == "throttle":
            return 1.0 / self.factor[self.controls.index(control)]
        return position_factor(self.card.inputs[control])

    def positions(self) -> dict[str, str]:
        """Control -> property of its position, of those controls whose card names one."""
        return {c: p for c in self.controls if (p := self.card.inputs[c].position) is not None}


class ReplayFolder:
    """Context that holds the copy of an aircraft for replay.

    measured  controls whose record columns are surface positions: their actuators pass everything
    through (stops remain)
    ideal     further controls whose actuators pass everything through, though their columns are
    commands settings  properties set on every instance Raises BadInputError when the card lacks a
    control asked for."""

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
            tuple(c for c in controls if card.inputs[c].position in lagging),
            {c: lagging[p] for c in controls if (p := card.inputs[c].position) in lagging},
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
            varied=(*declared_in(copy, "aero/"), *declared_in(copy, "effect/")),
            servos=servos,
        )
        engines = _declare_orphans(self.model, staging.xml, aircraft.dt_s)
        self.model = replace(self.model, engines=engines)
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
    """Whether any XML of an aircraft's folder has one of such property names."""
    texts = (
        p.read_bytes().decode("utf-8", errors="replace") for p in sorted(folder.rglob("*.xml"))
    )
    return any(names.search(text) is not None for text in texts)


def _factor(card: Card, control: str) -> float:
    """Record unit (deg, percent) to the property's unit."""
    unit, limits = card.inputs[control].unit, card.inputs[control].limits
    if unit == "rad":
        return DEG_RAD
    if unit != "norm":
        return 1.0
    if control == "throttle":
        return 0.01
    if (throw := card.inputs[control].throw_deg) is not None:
        return 1.0 / throw
    raise BadInputError(
        f"[inputs.{control}] is normalised (limits {limits}) and a record is in degrees: nothing"
        " says what throw 1 means; give the card a property in deg or rad, or throw_deg"
    )


def _throws(
    model: ReplayModel, direct: Sequence[str], dt_s: float
) -> tuple[tuple[tuple[float, ...], tuple[float, ...]] | None, ...]:
    """For every control its positions [deg] and commands over the travel, None where a factor
    serves.
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
) -> tuple[dict[str | None, tuple[str, str]], tuple[str, ...]]:
    """Take idle systems out of the main file, dynamics out of the actuators of ``direct`` in every
    file.

    An actuator moves a control if its name or an output is the card's position, be it in another
    unit. Returns the positions whose actuators keep a lag, with that lag and rate limit, and the
    properties that actuators' numbers are."""
    lagging: dict[str | None, tuple[str, str]] = {}
    number_properties: set[str] = set()
    surfaces = {
        _without_unit(position): position
        for entry in card.inputs.values()
        if (position := entry.position) is not None
    }
    positions = {card.inputs[name].position for name in direct} - {None}
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
            output_names = [
                str(actuator.get("name")),
                *((o.text or "").strip() for o in actuator.findall("output")),
            ]
            moved_positions = {
                surfaces[_without_unit(name)]
                for name in output_names
                if _without_unit(name) in surfaces
            }
            if moved_positions & positions:
                for kind in _ACTUATOR_DYNAMICS:
                    for element in actuator.findall(kind):
                        actuator.remove(element)
                        changed = True
            if actuator.find("lag") is not None:
                # A rate limit counts in the unit of the actuator's own output.
                texts = [(actuator.findtext(kind) or "").strip() for kind in ("lag", "rate_limit")]
                lagging |= {
                    position: (texts[0], texts[1] if position in output_names else "")
                    for position in moved_positions
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


def _without_unit(name: str) -> str:
    """A position property without its unit: one surface has several."""
    return re.sub(r"-(deg|rad|norm)$", "", name if "/" in name else f"fcs/{name}")


def _declare_orphans(model: ReplayModel, xml: Path, dt_s: float) -> int:
    """Declare, at zero, the properties that only the systems left out used to make.

    The number of engines.
    """
    fdm = engine.open_fdm(model.staging, dt_s)
    engines = int(fdm.get_propulsion().get_num_engines())
    manager = fdm.get_property_manager()
    names = [n for n in model.card.modes.get("open_loop", {}) if not manager.hasNode(n)]
    read = (name for name, _, _ in function_properties(model.staging))
    names += engine.undefined_properties(fdm, read)
    if not names:
        return engines
    tree = parse_xml(xml)
    root = tree.getroot()
    system = etree.Element("system", name="left out of the replay")
    for name in names:
        etree.SubElement(system, "property", value="0").text = name
    first = next(
        (e for e in root if e.tag in ("system", "autopilot", "flight_control", "aerodynamics")),
        None,
    )
    if first is None:
        root.append(system)
    else:
        first.addprevious(system)
    tree.write(str(xml), encoding="UTF-8", xml_declaration=True)
    return engines


def control_setters(fdm: Any, model: ReplayModel) -> list[list[Any]]:
    """For every control of the model the setters of its properties: one, or JSBSim's throttle of
    every engine.
    """
    setters = []
    for name in model.controls:
        prop = model.card.inputs[name].property
        handles = [engine.handle(fdm, prop).set_double_value]
        if prop == THROTTLE:
            engines = fdm.get_propulsion().get_num_engines()
            handles += [
                engine.handle(fdm, f"{prop}[{i}]").set_double_value for i in range(1, engines)
            ]
        setters.append(handles)
    return setters


# How far the ground is in a replay: as recorded where the aircraft's aerodynamics ask for it,
# out of reach elsewhere.
#
# A record's height counts from where it was started. One that starts in the air at its own zero
# does not say how high that was, and neither does one without a height.

OUT_OF_REACH_M = 2000.0
_BEGINNING_S, _ZERO_M, _AT_REST_MPS = 0.5, 0.5, 5.0
_HALF_WINDOW_S = 4.0
"""Heights within this time of a row say how high it is: of a barometer's noise of 1.5 m at 50 Hz .1
m is left, at an end .2 m.
"""


def has_ground_heights(record: FlightRecord) -> bool:
    """Whether a record's heights are above the ground: it starts elsewhere than at its zero, or at
    rest.
    """
    if (
        "h_m" not in record
        or not np.isfinite(record["h_m"]).any()
        or not np.nanmedian(record["h_m"]) > 0.0
    ):
        return False
    beginning = slice(0, max(1, round(_BEGINNING_S / record.dt_s)))
    first = {c: np.array(record[c][beginning]) for c in ("h_m", "V_mps") if c in record}
    low = {c: float(np.median(v[np.isfinite(v)])) for c, v in first.items() if np.isfinite(v).any()}
    return abs(low.get("h_m", 0.0)) > _ZERO_M or low.get("V_mps", np.inf) < _AT_REST_MPS


def heights(channels: Mapping[str, FloatArray], dt_s: float) -> FloatArray:
    """(n,) heights [m] along a stretch: the climb that airspeed, wind angles and attitude make
    (Stevens and Lewis, rate of climb), and what the recorded heights are above it, by a straight
    line through those about each row. channels: of the stretch, without gaps."""
    V, a, b, phi, theta, h = (
        channels[n] for n in ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "h_m")
    )
    across = np.sin(b) * np.sin(phi) + np.sin(a) * np.cos(b) * np.cos(phi)
    climb = V * (np.cos(a) * np.cos(b) * np.sin(theta) - across * np.cos(theta))
    path = dt_s * np.concatenate([[0.0], np.cumsum(0.5 * (climb[1:] + climb[:-1]))])
    return path + _local_lines(h - path, max(1, round(_HALF_WINDOW_S / dt_s)))


def _local_lines(values: FloatArray, half: int) -> FloatArray:
    """(n,) where the straight line through the values at most ``half`` samples away is, at each of
    them.
    """
    n = len(values)
    at = np.arange(n)
    first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, n)
    sums = np.cumsum(
        np.pad(np.stack([np.ones(n), at, at**2, values, at * values]), ((0, 0), (1, 0))), axis=1
    )
    count, x, xx, y, xy = sums[:, last] - sums[:, first]
    denominator = count * xx - x**2
    slope = np.divide(count * xy - x * y, denominator, out=np.zeros(n), where=denominator > 0.0)
    return np.asarray(y / count + slope * (at - x / count))


def terrain_m(model: ReplayModel, segment: Segment) -> float:
    """Elevation [m] of the ground under a replay, above sea level."""
    return segment.altitude_m - (segment.h_m if _ground_counts(model, segment) else OUT_OF_REACH_M)


def altitudes(model: ReplayModel, segment: Segment, h_m: FloatArray) -> FloatArray:
    """Altitude [m] above sea level at recorded heights: the segment's throughout where the ground
    does not count.
    """
    return segment.altitude_m + (
        h_m - segment.h_m if _ground_counts(model, segment) else np.zeros(len(h_m))
    )


def _ground_counts(model: ReplayModel, segment: Segment) -> bool:
    return model.near_ground and segment.above_ground
