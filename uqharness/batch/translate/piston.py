"""Translate ``<piston_engine>`` (JSBSim 1.3.3): manifold pressure, superchargers, flows of air and
fuel, power, temperatures.

Volumetric efficiency: Taylor, The Internal Combustion Engine, vol 1, eq 6-10; friction: Lumley,
Engines, fig 4.4. The starter does not turn in flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sysid.units import FT_M
from uqharness.batch.ir import Value
from uqharness.batch.translate.engine_files import (
    MANIFOLD_PA_INHG,
    MANIFOLD_PA_PSF,
    Part,
    grid,
    lookup,
    number,
    refuse_tags,
)
from uqharness.batch.translate.frame import Frame, Scope
from uqharness.batch.translate.functions import Grid
from uqharness.batch.translate.propeller import Jet, Propeller
from uqharness.xml import Node

_R_AIR, _CALORIFIC, _CP_AIR, _CP_FUEL = 287.3, 47.3e6, 1005.0, 1700.0
_STANDARD_PA, _HP_FTLBPS = 101320.73, 550.0
_MIN_INDICATED_HP = 0.125
MAGNETOS = "magnetos"
"""Memory of the magneto switch of all engines."""
BOTH_MAGNETOS = 3.0
_MANIFOLD_GAMMA = 1.3
_COMBUSTION = Grid(
    (0.0, 0.9, 1.0, 1.05, 1.1, 1.15, 1.2, 1.3, 1.4, 1.5, 1.6, 2.0),
    (),
    tuple((x,) for x in (0.98, 0.98, 0.97, 0.95, 0.9, 0.85, 0.79, 0.7, 0.63, 0.57, 0.525, 0.345)),
)
_MIXTURE = Grid(
    (
        0.05,
        0.05137,
        0.05179,
        0.0543,
        0.05842,
        0.06312,
        0.06942,
        0.07786,
        0.08845,
        0.0927,
        0.1012,
        0.11455,
        0.12158,
        0.12435,
        0.125,
    ),
    (),
    tuple(
        (x,)
        for x in (
            0.0,
            0.00862,
            0.21552,
            0.48276,
            0.7069,
            0.83621,
            0.93103,
            1.0,
            1.0,
            0.98276,
            0.93103,
            0.72414,
            0.4569,
            0.23276,
            0.0,
        )
    ),
)


@dataclass(frozen=True)
class PistonData:
    """Numbers of an engine file, with JSBSim's defaults; units are in the names."""

    displacement_in3: float
    idle_rpm: float
    max_rpm: float
    max_hp: float
    cycles: float
    stroke_in: float
    cylinders: float
    compression: float
    spark_drop: float
    lag_s: float
    peak_piston_fps: float
    fmep_dynamic: float
    fmep_static: float
    head_mass_kg: float
    throttle_impedance: float
    oil: tuple[float, float, float, float]


@dataclass(frozen=True)
class Boost:
    """A supercharger; tuples have an entry per speed.

    Attributes
    ----------
    factor : tuple of float
        Pressure ratio at the rated speed.
    rated_rpm, rated_pa, takeoff_pa : tuple of float
        Rated engine speed, and manifold pressures to which rated and takeoff settings limit.
    switch_pa : tuple of float
        Ambient pressure around which the next speed is engaged.
    has_takeoff, limits, manual : bool
        Whether there is a takeoff setting, whether pressure is limited, and whether
        ``boost-speed`` selects the speed.
    loss : float
        Factor of the power that the supercharger takes.
    """

    factor: tuple[float, ...]
    rated_rpm: tuple[float, ...]
    rated_pa: tuple[float, ...]
    takeoff_pa: tuple[float, ...]
    switch_pa: tuple[float, ...]
    has_takeoff: bool
    limits: bool
    manual: bool
    loss: float

    def gain(self, rpm: Value | float, speed: int) -> Value | float:
        """Return manifold pressure over the pressure before the supercharger."""
        return (self.factor[speed] - 1.0) / self.rated_rpm[speed] * rpm + 1.0


_SWITCH_HYSTERESIS_PA = 1000.0
_LOSS_GAMMA = 1.414
_TAKEOFF_THROTTLE = 0.98


@dataclass(frozen=True)
class Piston:
    """A piston engine; ``magnetos`` before the flight, 0 to 3: off, left, right, both."""

    name: str
    index: str
    numbers: PistonData
    combustion: Grid
    mixture: Grid
    magnetos: float
    boost: Boost | None = None

    @property
    def key(self) -> str:
        """Prefix of the names of its memory."""
        return f"engine{self.index}"

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """Return the shaft power [ft lbf/s]."""
        b, n, name = frame.builder, self.numbers, self.name
        rpm = thruster.engine_rpm(frame) if isinstance(thruster, Propeller) else b.constant(0.0)
        outside = frame.get("atmosphere/P-psf") * MANIFOLD_PA_PSF
        ram = (frame.get("propulsion/pt-lbs_sqft") * MANIFOLD_PA_PSF - outside) * frame.get(
            f"{name}ram-air-factor"
        ) + outside
        ambient_k = frame.get("atmosphere/T-R") / 1.8
        piston_fps = rpm * n.stroke_in / 360.0
        # Manifold pressure and air flow.
        running = self._ignition(frame, rpm)
        intake = self._intake(frame, ram, piston_fps)
        manifold, loss = self._boosted(frame, intake, outside, rpm)
        frame.store(f"{name}map-pa", manifold)
        frame.store(f"{name}map-inhg", manifold / MANIFOLD_PA_INHG)
        efficiency = frame.get(f"{name}volumetric-efficiency")
        pumping = (intake - outside) * efficiency
        air_volume = self._air_volume(manifold, outside, rpm) * efficiency
        if self.boost is not None:
            frame.remember(f"{self.key}/air-volume", air_volume)
        air = air_volume * (manifold / (_R_AIR * ambient_k))
        starved = frame.memory(f"{self.key}/starved").ne(0.0)
        # Fuel by the mixture lever; 14.7 is the stoichiometric ratio.
        mixture = 1.3 * frame.get(f"fcs/mixture-pos-norm{self.index}")
        rich = starved.choose(0.0, mixture * 101325.0 / outside)
        fuel = starved.choose(0.0, air * rich / 14.7)
        lbs_per_s = fuel * 2.2046
        frame.store(f"{name}fuel-flow-rate-pps", lbs_per_s)
        # Indicated power less friction and pumping.
        static = frame.get(f"{name}friction-hp")
        spark = self._switch(frame).eq(BOTH_MAGNETOS).choose(1.0, n.spark_drop)
        mixed = lookup(self.mixture, fuel / air)
        burning = lbs_per_s * 3600.0 / frame.get(f"{name}bsfc-lbs_hphr") * mixed * spark - static
        indicated = running.choose(burning, -static)
        friction = running.choose(-n.fmep_dynamic * piston_fps * FT_M - n.fmep_static, 0.0)
        volume = n.displacement_in3 * _IN3_M3
        hp = indicated + (pumping + friction) * volume * rpm / (n.cycles * 22371.0) - loss
        running = b.op("and", running, b.op("not", indicated.lt(_MIN_INDICATED_HP)))
        frame.store(f"{name}set-running", running.choose(1.0, 0.0))
        frame.store(f"{name}power-hp", hp)
        frame.store(f"{name}AFR", fuel.gt(0.0).choose(air / fuel, math.inf))
        self._temperatures(frame, (running, air, fuel, rich), (rpm, outside, ambient_k))
        power = hp * _HP_FTLBPS
        return b.op("and", rpm.le(0.1), power.lt(0.0)).choose(0.0, power)

    def _switch(self, frame: Frame) -> Value:
        """Return the magneto switch, which the aircraft's systems may turn."""
        if frame.is_commanded(MAGNETOS):
            return frame.memory(MAGNETOS, self.magnetos)
        return frame.builder.constant(self.magnetos)

    def _ignition(self, frame: Frame, rpm: Value) -> Value:
        """Return whether the engine runs: it needs a spark, fuel and speed, and restarts when the
        air turns the propeller.
        """
        b = frame.builder
        burns = b.op(
            "and",
            frame.get(f"{self.name}fuel-flow-rate-pps").gt(0.0),
            self._switch(frame).ne(0.0),
        )
        minimum_rpm = self.numbers.idle_rpm * 0.8
        stays = b.op("and", burns, b.op("not", rpm.lt(minimum_rpm)))
        starts = b.op("and", burns, rpm.gt(minimum_rpm))
        ran = frame.get(f"{self.name}set-running").ne(0.0)
        return b.op("or", b.op("and", ran, stays), b.op("and", b.op("not", ran), starts))

    def _intake(self, frame: Frame, ram: Value, piston_fps: Value) -> Value:
        """Return the pressure behind the throttle [Pa]: ram pressure across the impedances of
        intake, throttle and engine, with a lag.
        """
        n = self.numbers
        closed = 1.0 - frame.get(f"fcs/throttle-pos-norm{self.index}")
        throttle = closed * closed * n.throttle_impedance
        engine = piston_fps.gt(0.0).choose(n.peak_piston_fps / piston_fps, 999999.0)
        # Pressures divide as impedances in series.
        share = engine / (engine + frame.get(f"{self.name}air-intake-impedance-factor") + throttle)
        slot, first = f"{self.key}/intake", self._first_intake(frame)
        before = (
            frame.get(f"{self.name}map-pa") if self.boost is None else frame.memory(slot, first)
        )
        step = frame.step
        difference = before - ram * share
        difference = (
            frame.builder.constant(n.lag_s)
            .gt(step)
            .choose(difference * (step / n.lag_s if n.lag_s else step), difference)
        )
        intake = before - difference
        if self.boost is not None:
            frame.remember(slot, intake, first)
        return intake

    def _first_intake(self, frame: Frame) -> float:
        """Return the pressure behind the throttle before the first frame [Pa]; JSBSim reports the
        manifold's, which equals it unless a script started the engine.
        """
        n, boost = self.numbers, self.boost

        def value(name: str) -> float:
            """Return a property before the first frame."""
            return frame.values.get(name) or 0.0

        manifold, rpm = value(f"{self.name}map-pa"), value(f"{self.name}engine-rpm")
        if boost is None or not rpm:
            return manifold
        gain = boost.gain(rpm, 0)
        assert isinstance(gain, float)
        if not boost.limits or manifold < boost.takeoff_pa[0] * (1.0 - 1e-9):
            return manifold / gain
        # Limited: the steady state at full throttle in the air before the first frame.
        engine = n.peak_piston_fps / (rpm * n.stroke_in / 360.0)
        outside, total = value("atmosphere/P-psf"), value("propulsion/pt-lbs_sqft")
        ram = outside + (total - outside) * value(f"{self.name}ram-air-factor")
        airbox = value(f"{self.name}air-intake-impedance-factor")
        return ram * MANIFOLD_PA_PSF * engine / (engine + airbox)

    def _boosted(
        self, frame: Frame, intake: Value, outside: Value, rpm: Value
    ) -> tuple[Value, Value]:
        """Return the manifold pressure [Pa] and the power of the supercharger [hp]."""
        b, boost, name = frame.builder, self.boost, self.name
        if boost is None:
            return intake, b.constant(0.0)
        # Pressure rises in proportion to rpm at the speed in use.
        speed = self._speed(frame, boost, outside)

        def of_speed(values: tuple[float, ...]) -> Value:
            """Return the entry of the speed in use."""
            result = b.constant(values[0])
            for k, entry in enumerate(values[1:], start=1):
                result = speed.ge(float(k)).choose(entry, result)
            return result

        rate = of_speed(
            tuple((f - 1.0) / r for f, r in zip(boost.factor, boost.rated_rpm, strict=True))
        )
        manifold = intake * (rate * rpm + 1.0)
        # The limiter cuts at the rated pressure, beyond the gate at that for take-off.
        if boost.limits:
            limit = of_speed(boost.rated_pa)
            if boost.has_takeoff:
                at_gate = frame.get(f"fcs/throttle-pos-norm{self.index}").gt(_TAKEOFF_THROTTLE)
                limit = at_gate.choose(of_speed(boost.takeoff_pa), limit)
            manifold = manifold.gt(limit).choose(limit, manifold)
        if not boost.loss > 0.0:
            return manifold, b.constant(0.0)
        # Adiabatic compression of the air of the frame before
        gamma = _LOSS_GAMMA
        volume = frame.memory(f"{self.key}/air-volume", self._first_air_volume(frame))
        ratio = b.op("pow", manifold / intake, b.constant((gamma - 1.0) / gamma)) - 1.0
        loss = intake * volume * gamma / (gamma - 1.0) * ratio * boost.loss / 745.7
        frame.store(f"{name}boostloss-hp", loss)
        return manifold, loss

    def _speed(self, frame: Frame, boost: Boost, outside: Value) -> Value:
        """Return the number of the speed in use: by hand, or by ambient pressure with
        hysteresis.
        """
        b, last = frame.builder, float(len(boost.factor) - 1)
        speed = frame.get(f"{self.name}boost-speed")
        if boost.manual:
            speed = speed.gt(last).choose(last, speed)
            speed = speed.lt(0.0).choose(0.0, speed)
        elif last:
            for k, pressure in reversed(list(enumerate(boost.switch_pa))):
                up = b.op("and", speed.eq(float(k)), outside.lt(pressure - _SWITCH_HYSTERESIS_PA))
                speed = up.choose(k + 1.0, speed)
            for k, pressure in enumerate(boost.switch_pa):
                down = b.op(
                    "and",
                    speed.eq(k + 1.0),
                    outside.gt(pressure + _SWITCH_HYSTERESIS_PA),
                )
                speed = down.choose(float(k), speed)
        frame.store(f"{self.name}boost-speed", speed)
        return speed

    def _first_air_volume(self, frame: Frame) -> float:
        """Return the volume of air per second before the first frame [m3/s]."""

        def value(name: str) -> float:
            """Return a property before the first frame."""
            return frame.values.get(name) or 0.0

        manifold = value(f"{self.name}map-pa")
        outside = value("atmosphere/P-psf") * MANIFOLD_PA_PSF
        c, g = self.numbers.compression, _MANIFOLD_GAMMA
        ratio = c if manifold < 1.0 else min(outside / manifold, c)
        share = (g - 1.0) / g + (c - ratio) / (g * (c - 1.0))
        swept = self.numbers.displacement_in3 * _IN3_M3 * (value(f"{self.name}engine-rpm") / 60.0)
        return swept / 2.0 * share * value(f"{self.name}volumetric-efficiency")

    def _air_volume(self, manifold: Value, outside: Value, rpm: Value) -> Value:
        """Return the volume of air per second [m3/s] at a volumetric efficiency of 1."""
        c, g = self.numbers.compression, _MANIFOLD_GAMMA
        ratio = manifold.lt(1.0).choose(c, outside / manifold)
        ratio = ratio.gt(c).choose(c, ratio)
        loss = (g - 1.0) / g + (c - ratio) / (g * (c - 1.0))
        return self.numbers.displacement_in3 * _IN3_M3 * (rpm / 60.0) / 2.0 * loss

    def _temperatures(
        self, frame: Frame, burning: tuple[Value, ...], state: tuple[Value, ...]
    ) -> None:
        """Add temperatures of exhaust, cylinder head and oil; only their properties depend on
        them.
        """
        b, n, name, step = frame.builder, self.numbers, self.name, frame.step
        running, air, fuel, rich = burning
        rpm, outside, ambient_k = state
        hot = b.op("and", running, air.gt(0.0))
        # Exhaust: 30 % of the heat of combustion goes into the gas.
        share = hot.choose(lookup(self.combustion, rich), 0.0)
        exhaust = _kelvin(frame.get(f"{name}egt-degF"))
        burnt = ambient_k + fuel * _CALORIFIC * share * 0.30 / (_CP_AIR * air + _CP_FUEL * fuel)
        frame.store(
            f"{name}egt-degF",
            _fahrenheit(hot.choose(burnt, exhaust + (ambient_k - exhaust) / 100.0 * step)),
        )
        # Cylinder head: 33 % of the heat, less cooling by airflow, rpm and natural convection.
        head = _kelvin(frame.get(f"{name}cht-degF"))
        above, area = head - ambient_k, n.displacement_in3 / 360.0
        wind = (
            area
            * (frame.get("velocities/vc-kts") * frame.get(f"{name}cooling-factor"))
            * (outside / (_R_AIR * ambient_k))
        )
        heat = (
            fuel * _CALORIFIC * share * 0.33
            + (-3.95 * wind * above - 140.0 * rpm * above / n.max_rpm)
            - 95.0 * above * area
        )
        head = head + heat / (800.0 * (n.head_mass_kg * n.cylinders)) * step
        frame.store(f"{name}cht-degF", _fahrenheit(head))
        # Oil: pressure by speed up to the relief valve, temperature towards the head's.
        relief, design_k, viscosity, full_rpm = n.oil
        pressure, oil = (
            frame.get(f"{name}oil-pressure-psi"),
            _kelvin(frame.get(f"{name}oil-temperature-degF")),
        )
        slowly = pressure.gt(5.0).choose(5000.0 / pressure, 1000.0)
        oil = oil + (head + 0.667 * (ambient_k - head) - oil) / slowly * step
        frame.store(f"{name}oil-temperature-degF", _fahrenheit(oil))
        by_speed = relief / full_rpm * rpm
        by_speed = by_speed.ge(relief).choose(relief, by_speed)
        frame.store(
            f"{name}oil-pressure-psi", by_speed + (design_k - oil) * viscosity * by_speed / relief
        )

    def fuel_rate(self, frame: Frame) -> Value:
        """Return the fuel taken from the tanks [lbs/s]."""
        return frame.get(f"{self.name}fuel-flow-rate-pps")


_IN3_M3 = (1.0 / 12.0) ** 3 * FT_M**3


def _kelvin(fahrenheit: Value) -> Value:
    """Convert deg F to K with JSBSim's constants."""
    return (fahrenheit + 459.4) / 1.8


def _fahrenheit(kelvin: Value) -> Value:
    """Convert K to deg F with JSBSim's constants."""
    return 1.8 * kelvin - 459.4


def read_piston(scope: Scope, part: Part, name: str, index: str, magnetos: float) -> Piston:
    """Read a ``<piston_engine>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node)
    tables = {"COMBUSTION": _COMBUSTION, "MIXTURE": _MIXTURE}
    # The file may replace both tables.
    for table in node.all("table"):
        title = table.attributes.get("name", "")
        # JSBSim ignores other tables.
        if title not in tables:
            continue
        tables[title] = grid(scope, table)
        if tables[title].columns:
            scope.refuse(table, f"table {title} has one dimension")

    def get(tag: str, default: float, unit: str = "") -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default, unit)

    idle, max_rpm, stroke = get("idlerpm", 600.0), get("maxrpm", 2800.0), get("stroke", 4.375, "IN")
    peak = get("peak-piston-speed", 100.0)
    min_pa = get("minmp", 6.5, "INHG") * MANIFOLD_PA_INHG
    max_pa = min(get("maxmp", 28.5, "INHG"), 29.9) * MANIFOLD_PA_INHG
    # Without a number the impedance follows from the rated manifold pressure.
    airbox = get("air-intake-impedance-factor", -999.0)
    if airbox < 0.0:
        rated = peak / (max_rpm * stroke / 360.0)
        airbox = _STANDARD_PA * rated / max_pa - rated
    # Impedance of the closed throttle from the idle manifold pressure.
    throttle = peak / (idle * stroke / 360.0) * (_STANDARD_PA / min_pa - 1.0) - airbox
    oil = (
        get("oil-pressure-relief-valve-psi", 60.0, "PSI"),
        get("design-oil-temp-degK", 358.0),
        get("oil-viscosity-index", 0.25),
        get("oil-pressure-rpm-max", max_rpm * 0.75),
    )
    drop = get("sparkfaildrop", 0.0)
    numbers = PistonData(
        get("displacement", 360.0, "IN3"),
        idle,
        max_rpm,
        get("maxhp", 200.0, "HP"),
        get("cycles", 4.0),
        stroke,
        get("cylinders", 4.0),
        get("compression-ratio", 8.5),
        min(max(1.0 - drop, 0.0), 1.0),
        get("man-press-lag", 1.0),
        peak,
        get("dynamic-fmep", 18400.0, "PA"),
        get("static-fmep", 46500.0, "PA"),
        get("cylinder-head-mass", 2.0, "KG"),
        throttle,
        oil,
    )
    return Piston(
        name,
        index,
        numbers,
        tables["COMBUSTION"],
        tables["MIXTURE"],
        magnetos,
        _read_boost(scope, node),
    )


_MAX_SPEEDS = 3
_PSI_PA = 6895.0


def _read_boost(scope: Scope, node: Node) -> Boost | None:
    """Read the supercharger; None without a usable speed."""

    def get(tag: str, default: float, unit: str = "") -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default, unit)

    count = int(get("numboostspeeds", 0.0))
    if count > _MAX_SPEEDS:
        scope.refuse(node, f"numboostspeeds is at most {_MAX_SPEEDS}; received {count}")
    # Ratings of the speeds: boost, power, height.
    rated = [get(f"ratedboost{k}", 0.0, "PSI") for k in (1, 2, 3)]
    power = [get(f"ratedpower{k}", 0.0, "HP") for k in (1, 2, 3)]
    heights = [get(f"ratedaltitude{k}", 0.0, "FT") for k in (1, 2, 3)]
    usable = 0
    # JSBSim drops the last speed where it meets one without rating.
    while usable < count:
        k = usable
        if rated[k] <= 0.0 or power[k] <= 0.0 or heights[k] < (heights[k - 1] if k else 0.0):
            count -= 1
            break
        usable += 1
    if usable < count:
        scope.refuse(node, f"ratings of the {usable + 1}. boost speed are missing")
    if count < 1:
        return None
    # Pressures that the speeds hold, and the one for take-off above the first.
    rated_pa = [_STANDARD_PA + boost * _PSI_PA for boost in rated[:count]]
    takeoff = get("takeoffboost", 0.0, "PSI")
    extra = max(takeoff - rated[0], 0.0) * _PSI_PA
    # Pressure ratios at the rated heights, and pressures at which the next speed takes over.
    return Boost(
        tuple(
            pa / (_standard_psf(height) * MANIFOLD_PA_PSF)
            for pa, height in zip(rated_pa, heights, strict=False)
        ),
        tuple(get(f"ratedrpm{k + 1}", 2500.0) for k in range(count)),
        tuple(rated_pa),
        tuple(pa + extra for pa in rated_pa),
        tuple(
            _standard_psf(height + 1000.0 if height > 0.0 else height) * MANIFOLD_PA_PSF
            for height in heights[: count - 1]
        ),
        takeoff > rated[0],
        int(get("boostoverride", 0.0)) != 1,
        int(get("boostmanual", 0.0)) == 1,
        get("boost-loss-factor", 0.0),
    )


def _standard_psf(height_ft: float) -> float:
    """Return the pressure of JSBSim's polynomial [psf]."""
    height = min(height_ft, 100000.0)
    coefficients = (2116.217, -7.648932746e-2, 1.0925498604e-6, -7.1135726027e-12, 1.7470331356e-17)
    return math.fsum(c * height**k for k, c in enumerate(coefficients))
