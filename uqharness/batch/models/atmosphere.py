"""US Standard Atmosphere 1976 as JSBSim 1.3.3 has it, dry, with its uniform temperature bias and sea level pressure.

Layers are those of the standard up to 298,556 ft of geopotential height; JSBSim's height is the distance from the sea level
ellipsoid along the radius.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from sysid.units import FT_M, G0_MPS2
from uqharness.batch.form.ir import Value
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

PRODUCED = ("atmosphere/T-R", "atmosphere/P-psf", "atmosphere/rho-slugs_ft3", "atmosphere/a-fps")
SETTINGS = {"atmosphere/delta-T": 0.0, "atmosphere/P-sl-psf": 2116.228}
"""What may be set, and the standard day's values."""

STANDARD_DENSITY_SLUGS_FT3 = SETTINGS["atmosphere/P-sl-psf"] / (_R_DRY * _LAYERS[0][1])
"""At sea level of the standard day."""


def trace_atmosphere(frame: Frame) -> None:
    """Temperature, pressure, density and speed of sound at the height of this frame."""
    height = frame.get("position/h-sl-ft")
    b = frame.builder
    potential = (height * _EARTH_RADIUS_FT) / (height + _EARTH_RADIUS_FT)
    bias = frame.get("atmosphere/delta-T")
    pressures = _breakpoints(bias, frame.get("atmosphere/P-sl-psf"))

    def pick(choices: list[Value | float]) -> Value:
        found = b.value(choices[0])
        for (base, _), choice in zip(_LAYERS[1:], choices[1:], strict=False):
            found = potential.lt(base).choose(found, choice)
        return found

    base = pick([h for h, _ in _LAYERS[:-1]])
    slope = pick(list(_SLOPES))
    at_base = pick([t + bias for _, t in _LAYERS[:-1]])
    above = potential - base
    temperature = pick([t for _, t in _LAYERS[:-1]]) + slope * above + bias
    exponent = _G0_FPS2 / _R_DRY
    isothermal = slope.eq(0.0)
    # P = Pb (Tb/(Tb + L dh))^(g/RL), or Pb exp(-g dh/RTb) in an isothermal layer: eqs 33a and 33b of the standard
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
    """Pressure at the foot of each layer."""
    b = bias.builder
    found = [at_sea_level]
    for ((h0, t0), (h1, _)), slope in zip(itertools.pairwise(_LAYERS), _SLOPES, strict=True):
        foot = t0 + bias
        if slope:
            factor = b.op(
                "exp",
                (_G0_FPS2 / (_R_DRY * slope)) * b.op("log", foot / (foot + slope * (h1 - h0))),
            )
        else:
            factor = b.op("exp", -(_G0_FPS2 * (h1 - h0) / _R_DRY / foot))
        found.append(found[-1] * factor)
    return found[:-1]


def _trace_altitudes(frame: Frame) -> None:
    """Density and pressure altitude: geometric heights [ft] at which the standard day has this density or pressure."""
    b = frame.builder
    density, pressure = frame.get("atmosphere/rho-slugs_ft3"), frame.get("atmosphere/P-psf")
    pressures = _breakpoints(b.constant(0.0), b.constant(SETTINGS["atmosphere/P-sl-psf"]))
    densities = [foot / (_R_DRY * t) for foot, (_, t) in zip(pressures, _LAYERS, strict=False)]
    exponents = [-1.0 / (1.0 + _G0_FPS2 / (_R_DRY * slope)) if slope else 0.0 for slope in _SLOPES]
    frame.write("atmosphere/density-altitude", _standard_height(density, densities, exponents))
    exponents = [-_R_DRY * slope / _G0_FPS2 for slope in _SLOPES]
    frame.write("atmosphere/pressure-altitude", _standard_height(pressure, pressures, exponents))


def _standard_height(value: Value, feet: list[Value], exponents: list[float]) -> Value:
    """Geometric height [ft]; ``feet`` are the values at the foot of each layer."""
    b = value.builder

    def pick(choices: Sequence[Value | float]) -> Value:
        found = b.value(choices[-1])
        for foot, choice in zip(reversed(feet[1:]), reversed(choices[:-1]), strict=True):
            found = value.ge(foot).choose(choice, found)
        return found

    logarithm = b.op("log", value / pick(feet))
    layers = list(zip(_LAYERS, _SLOPES, strict=False))
    scale = pick([t / slope if slope else 0.0 for (_, t), slope in layers])
    flat = pick([0.0 if slope else -_R_DRY * t / _G0_FPS2 for (_, t), slope in layers])
    # Eqs 33a and 33b of the standard solved for the height
    rise = flat.ne(0.0).choose(
        flat * logarithm, scale * (b.op("exp", pick(exponents) * logarithm) - 1.0)
    )
    height = pick([h for (h, _), _ in layers]) + rise
    return height * _EARTH_RADIUS_FT / (_EARTH_RADIUS_FT - height)
