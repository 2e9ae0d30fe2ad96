"""Trace the US Standard Atmosphere 1976 as in JSBSim 1.3.3, and air data.

The atmosphere is dry, with JSBSim's uniform temperature bias and sea-level pressure. Layers are
those of the standard up to 298,556 ft of geopotential height; JSBSim's height is the distance from
the sea-level ellipsoid along the radius.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from sysid.units import FT_M, G0_MPS2, KT_MPS
from uqharness.batch.ir import Builder, Value
from uqharness.batch.translate.frame import Frame

_LAYERS = (
    (0.0, 518.67),
    (36089.2388, 389.97),
    (65616.7979, 389.97),
    (104986.8766, 411.57),
    (154199.4751, 487.17),
    (167322.8346, 487.17),
    (232939.6325, 386.37),
    (278385.8268, 336.5028),
    (298556.4304, 336.5028),
)
"""Geopotential height [ft] and temperature [deg R] of the breakpoints."""
_EARTH_RADIUS_FT = 6356766.0 / FT_M
_G0_FPS2 = G0_MPS2 / FT_M
_R_DRY = 1716.5571582043528
"""Gas constant of dry air, ft2/(s2 R)."""
_GAMMA = 1.4
_SLOPES = tuple((t1 - t0) / (h1 - h0) for (h0, t0), (h1, t1) in itertools.pairwise(_LAYERS))

SETTINGS = {"atmosphere/delta-T": 0.0, "atmosphere/P-sl-psf": 2116.228}
"""Settable properties, with the values of the standard day."""

STANDARD_DENSITY_SLUGS_FT3 = SETTINGS["atmosphere/P-sl-psf"] / (_R_DRY * _LAYERS[0][1])
"""Density at sea level on the standard day."""


def trace_atmosphere(frame: Frame) -> None:
    """Publish temperature, pressure, density and speed of sound at this frame's height."""
    height = frame.get("position/h-sl-ft")
    b = frame.builder
    # Geopotential height
    potential = (height * _EARTH_RADIUS_FT) / (height + _EARTH_RADIUS_FT)
    bias = frame.get("atmosphere/delta-T")
    pressures = _breakpoints(bias, frame.get("atmosphere/P-sl-psf"))

    def pick(choices: list[Value | float]) -> Value:
        """Return the choice of the layer."""
        result = b.value(choices[0])
        for (base, _), choice in zip(_LAYERS[1:], choices[1:], strict=False):
            result = potential.lt(base).choose(result, choice)
        return result

    base = pick([h for h, _ in _LAYERS[:-1]])
    slope = pick(list(_SLOPES))
    at_base = pick([t + bias for _, t in _LAYERS[:-1]])
    above = potential - base
    temperature = pick([t for _, t in _LAYERS[:-1]]) + slope * above + bias
    exponent = _G0_FPS2 / _R_DRY
    isothermal = slope.eq(0.0)
    # P = Pb (Tb/(Tb + L dh))^(g/RL), or Pb exp(-g dh/RTb) in an isothermal layer: eqs 33a and 33b
    # of the standard
    ratio = isothermal.choose(1.0, at_base / (at_base + slope * above))
    power = isothermal.choose(
        -(exponent * above / at_base),
        (exponent / isothermal.choose(1.0, slope)) * b.op("log", ratio),
    )
    pressure = pick(list(pressures)) * b.op("exp", power)
    frame.write("atmosphere/T-R", temperature)
    frame.write("atmosphere/P-psf", pressure)
    frame.write("atmosphere/rho-slugs_ft3", pressure / (_R_DRY * temperature))
    frame.write("atmosphere/a-fps", b.op("sqrt", _GAMMA * _R_DRY * temperature))
    sl_temperature = _LAYERS[0][1] + bias
    frame.write("atmosphere/T-sl-R", sl_temperature)
    frame.write(
        "atmosphere/rho-sl-slugs_ft3", frame.get("atmosphere/P-sl-psf") / (_R_DRY * sl_temperature)
    )
    frame.write("atmosphere/a-sl-fps", b.op("sqrt", _GAMMA * _R_DRY * sl_temperature))
    _trace_altitudes(frame)


def _breakpoints(bias: Value, at_sea_level: Value) -> list[Value]:
    """Return the pressure at the bottom of each layer."""
    b = bias.builder
    pressures = [at_sea_level]
    for ((h0, t0), (h1, _)), slope in zip(itertools.pairwise(_LAYERS), _SLOPES, strict=True):
        foot = t0 + bias
        if slope:
            factor = b.op(
                "exp",
                (_G0_FPS2 / (_R_DRY * slope)) * b.op("log", foot / (foot + slope * (h1 - h0))),
            )
        else:
            factor = b.op("exp", -(_G0_FPS2 * (h1 - h0) / _R_DRY / foot))
        pressures.append(pressures[-1] * factor)
    return pressures[:-1]


def _trace_altitudes(frame: Frame) -> None:
    """Publish density and pressure altitude: the geometric heights [ft] at which the standard day
    has this density or pressure.
    """
    b = frame.builder
    density, pressure = frame.get("atmosphere/rho-slugs_ft3"), frame.get("atmosphere/P-psf")
    pressures = _breakpoints(b.constant(0.0), b.constant(SETTINGS["atmosphere/P-sl-psf"]))
    densities = [foot / (_R_DRY * t) for foot, (_, t) in zip(pressures, _LAYERS, strict=False)]
    exponents = [-1.0 / (1.0 + _G0_FPS2 / (_R_DRY * slope)) if slope else 0.0 for slope in _SLOPES]
    frame.write("atmosphere/density-altitude", _standard_height(density, densities, exponents))
    exponents = [-_R_DRY * slope / _G0_FPS2 for slope in _SLOPES]
    frame.write("atmosphere/pressure-altitude", _standard_height(pressure, pressures, exponents))


def _standard_height(value: Value, feet: list[Value], exponents: list[float]) -> Value:
    """Return the geometric height [ft] of a value; ``feet`` are the values at the bottom of each
    layer.
    """
    b = value.builder

    def pick(choices: Sequence[Value | float]) -> Value:
        """Return the choice of the layer."""
        result = b.value(choices[-1])
        for foot, choice in zip(reversed(feet[1:]), reversed(choices[:-1]), strict=True):
            result = value.ge(foot).choose(choice, result)
        return result

    logarithm = b.op("log", value / pick(feet))
    layers = list(zip(_LAYERS, _SLOPES, strict=False))
    scale = pick([t / slope if slope else 0.0 for (_, t), slope in layers])
    flat = pick([0.0 if slope else -_R_DRY * t / _G0_FPS2 for (_, t), slope in layers])
    # Eqs 33a and 33b of the standard solved for the height
    rise = flat.ne(0.0).choose(
        flat * logarithm, scale * (b.op("exp", pick(exponents) * logarithm) - 1.0)
    )
    height = pick([h for (h, _), _ in layers]) + rise
    # Back to geometric height
    return height * _EARTH_RADIUS_FT / (_EARTH_RADIUS_FT - height)


# Air data: calibrated airspeed, total pressure and temperature, Reynolds number, ratios.
# Calibrated airspeed: AFFTC-TIH-99-01, "Aircraft performance flight testing", sections 4.6 to
# 4.8, with Rayleigh's formula behind a shock. Viscosity: US Standard Atmosphere 1976, eq 51.

_KT = FT_M / KT_MPS
"""Knots per foot per second."""
_P0_PSF, _A0_FPS = 2116.228, 1116.4485575897318
"""Standard day at sea level, with the digits of JSBSim 1.3.3."""
_VISCOSITY, _SUTHERLAND_R = 2.269690e-8, 198.72
"""Sutherland's constants, slug/(s ft sqrt(R)) and deg R."""
_RAYLEIGH, _SUPERSONIC = 166.9215800931683, 0.8812848543473311
"""1.2^3.5 6^2.5, and 1.2^-1.75 (6/7)^-1.25."""
_TURNS = 10
"""Iterations for a supersonic Mach number."""


def trace_air_data(frame: Frame) -> None:
    """Publish air data; runs after the auxiliary model's airspeed and Mach number."""
    b = frame.builder
    speed, mach = frame.get("velocities/vt-fps"), frame.get("velocities/mach")
    pressure, temperature, density = (
        frame.get(f"atmosphere/{name}") for name in ("P-psf", "T-R", "rho-slugs_ft3")
    )
    total = _pitot(b, mach, pressure)
    # Mach number at sea level that gives the same impact pressure
    calibrated = mach.ne(0.0).choose(_A0_FPS * _mach(b, (total - pressure) / _P0_PSF + 1.0), 0.0)
    frame.write("velocities/vc-fps", calibrated)
    frame.write("velocities/vc-kts", calibrated * _KT)
    frame.write("velocities/ve-kts", frame.get("velocities/ve-fps") * _KT)
    frame.write("velocities/vtrue-kts", speed * _KT)
    hot = temperature * (1.0 + 0.2 * mach * mach)
    frame.write("propulsion/pt-lbs_sqft", total)
    frame.write("propulsion/tat-r", hot)
    frame.write("propulsion/tat-c", (hot - 491.67) / 1.8)
    viscosity = (
        _VISCOSITY * (temperature * b.op("sqrt", temperature)) / (_SUTHERLAND_R + temperature)
    )
    frame.write("aero/Re", speed * frame.get("metrics/cbarw-ft") / (viscosity / density))


def trace_ratios(frame: Frame) -> None:
    """Publish the atmosphere relative to sea level of the same day."""
    for name, of, below in (
        ("theta", "T-R", "T-sl-R"),
        ("delta", "P-psf", "P-sl-psf"),
        ("sigma", "rho-slugs_ft3", "rho-sl-slugs_ft3"),
        ("a-ratio", "a-fps", "a-sl-fps"),
    ):
        frame.write(
            f"atmosphere/{name}", frame.get(f"atmosphere/{of}") / frame.get(f"atmosphere/{below}")
        )


def _pitot(b: Builder, mach: Value, pressure: Value) -> Value:
    """Return the total pressure [psf], behind a normal shock if there is one; ratio of specific
    heats 1.4.
    """
    square = mach * mach
    slow = 1.0 + 0.2 * square
    fast = 7.0 * square - 1.0
    behind = _RAYLEIGH * (square * square * square * mach) / _power_2_5(b, fast)
    return pressure * mach.lt(1.0).choose(slow * _power_2_5(b, slow), behind)


def _mach(b: Builder, ratio: Value) -> Value:
    """Return the Mach number at which total over static pressure is ``ratio``."""
    slow = b.op("sqrt", 5.0 * (b.op("pow", ratio, b.constant(2.0 / 7.0)) - 1.0))
    mach = slow
    # Fixed-point iteration of Rayleigh's formula.
    for _ in range(_TURNS):
        mach = _SUPERSONIC * b.op("sqrt", ratio * _power_2_5(b, 1.0 - 1.0 / (7.0 * mach * mach)))
    return slow.gt(1.0).choose(mach, slow)


def _power_2_5(b: Builder, x: Value) -> Value:
    """Return x^2.5."""
    return x * x * b.op("sqrt", x)
