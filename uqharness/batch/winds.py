"""Trace wind, gusts and JSBSim's Dryden turbulence (atmosphere/turb-type 4, Tustin discretisation).

Turbulence: J. Yeager, "Implementation and testing of turbulence models for the F18-HARV", NASA
CR-1998-206937; intensities and scale lengths of MIL-F-8785C, figures 7, 10 and 11. Deviations of
JSBSim 1.3.3 (height above sea level, axes along the wind's azimuth with the rotation's sign
reversed, sign of q) are reproduced; docs/jsbsim-traps.md lists them, and the air system corrects
them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from sysid.units import FT_M
from uqharness.batch.ir import Value
from uqharness.batch.maths import Vector, direction, matvec, round_to_even
from uqharness.batch.motion import MATRIX, matrix
from uqharness.batch.program import Stream, When
from uqharness.batch.translate.frame import Frame, integer_hook
from uqharness.errors import BadInputError

AXES = ("north", "east", "down")
TYPE = "atmosphere/turb-type"
TUSTIN = 4.0
_SEVERITY = "atmosphere/turbulence/milspec/severity"
_W20 = "atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"
_PSI = "atmosphere/psiw-rad"
DRAWS = tuple(f"#turbulence/nu-{k}" for k in ("u", "v", "w", "p"))
COUNTER = "#turbulence/row"
NORMALS = Stream("turbulence", DRAWS, counter=COUNTER)
"""Standard normals of JSBSim's atmosphere generator, one row per frame in which the filters run."""
MASK, HIGH = "#turbulence/on", "#turbulence/high"

_HEIGHTS = (
    500.0,
    1750.0,
    3750.0,
    7500.0,
    15000.0,
    25000.0,
    35000.0,
    45000.0,
    55000.0,
    65000.0,
    75000.0,
    80000.0,
)
_SIGMA = (
    (3.2, 2.2, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (4.2, 3.6, 3.3, 1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0),
    (8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0),
    (11.8, 13.0, 16.0, 15.1, 11.6, 9.7, 8.1, 8.2, 7.9, 4.9, 3.2, 2.1),
    (15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1),
    (18.7, 21.5, 28.4, 30.2, 30.7, 31.0, 25.2, 23.1, 17.5, 10.7, 8.4, 7.2),
)
"""Root mean square of the vertical gust [ft/s] by severity 1 to 7 and height [ft]: MIL-F-8785C,
figure 7.
"""


def set_psi(frame: Frame, value: Value) -> None:
    """Write atmosphere/psiw-rad: JSBSim turns the steady wind to this azimuth."""
    size = _size(frame)
    b = frame.builder
    # Without wind JSBSim resets the azimuth.
    none = size.eq(0.0)
    cosine, sine = b.op("cos", value), b.op("sin", value)
    frame.store(_PSI, none.choose(0.0, value))
    _keep_direction(frame, none.choose(1.0, cosine), none.choose(0.0, sine))
    frame.store(
        "atmosphere/wind-north-fps",
        none.choose(frame.get("atmosphere/wind-north-fps"), size * cosine),
    )
    frame.store(
        "atmosphere/wind-east-fps", none.choose(frame.get("atmosphere/wind-east-fps"), size * sine)
    )
    frame.store("atmosphere/wind-down-fps", none.choose(frame.get("atmosphere/wind-down-fps"), 0.0))


def set_size(frame: Frame, value: Value) -> None:
    """Write atmosphere/wind-mag-fps: along the wind's azimuth, to the north if there was no
    wind.
    """
    none = _size(frame).eq(0.0)
    cosine, sine = _direction(frame)
    frame.store(_PSI, none.choose(0.0, frame.get(_PSI)))
    _keep_direction(frame, none.choose(1.0, cosine), none.choose(0.0, sine))
    frame.store("atmosphere/wind-north-fps", none.choose(value, value * cosine))
    east, down = frame.get("atmosphere/wind-east-fps"), frame.get("atmosphere/wind-down-fps")
    frame.store("atmosphere/wind-east-fps", none.choose(east, value * sine))
    frame.store("atmosphere/wind-down-fps", none.choose(down, 0.0))


WRITES: Mapping[str, Callable[[Frame, Value], None]] = {
    _PSI: set_psi,
    "atmosphere/wind-mag-fps": set_size,
    TYPE: integer_hook(TYPE),
    _SEVERITY: integer_hook(_SEVERITY),
}
"""For ``Frame.hooks``: properties whose setting changes others, or that are truncated."""


def _size(frame: Frame) -> Value:
    """Return the wind speed [ft/s]."""
    n, e, d = (frame.get(f"atmosphere/wind-{axis}-fps") for axis in AXES)
    return frame.builder.op("sqrt", n * n + e * e + d * d)


def _direction(frame: Frame) -> tuple[Value, Value]:
    """Return cosine and sine of the wind's azimuth."""
    if _PSI in frame.inputs:
        psi = frame.get(_PSI)
        return frame.builder.op("cos", psi), frame.builder.op("sin", psi)
    return frame.memory("wind/cosine", 1.0), frame.memory("wind/sine")


def _keep_direction(frame: Frame, cosine: Value, sine: Value) -> None:
    """Store cosine and sine of the wind's azimuth."""
    frame.remember("wind/cosine", cosine, 1.0)
    frame.remember("wind/sine", sine)


def turn_gusts(frame: Frame) -> None:
    """Convert host gusts [m/s] in heading axes to JSBSim's gusts, for an aircraft without the air
    system.
    """
    b = frame.builder
    psi = frame.get("attitude/psi-rad")
    u, v, w = (frame.get(f"air/host/{name}-mps") for name in "uvw")
    c, s = b.op("cos", psi) * (1.0 / FT_M), b.op("sin", psi) * (1.0 / FT_M)
    frame.write("atmosphere/gust-north-fps", u * c - v * s)
    frame.write("atmosphere/gust-east-fps", u * s + v * c)
    frame.write("atmosphere/gust-down-fps", w * (1.0 / FT_M))


def trace_winds(frame: Frame) -> None:
    """Trace turbulence in a section that runs only while it is on, then the total wind.

    Raises BadInputError for turbulence that is on from the start.
    """
    with frame.section("turbulence: whether"):
        kind = frame.get(TYPE)
        # A constant type means that turbulence can never be switched on.
        if kind.constant is None:
            _switch_turbulence(frame, kind)
        elif kind.constant != 0.0 and frame.get(_SEVERITY).constant != 0.0:
            raise BadInputError(
                f"{TYPE} is {kind.constant:g} from the start of the flight: the batch engine"
                " supports turbulence of type 4, and only if it is switched on in flight, as the"
                " air system does"
            )
    if kind.constant is None:
        with frame.section("turbulence: aloft", When(mask=HIGH)):
            frame.remember("turbulence/aloft", _sigma_aloft(frame, frame.get("position/h-sl-ft")))
        with frame.section("turbulence", When(mask=MASK)):
            _filters(frame)
    with frame.section("wind"):
        _total_wind(frame)


def _switch_turbulence(frame: Frame, kind: Value) -> None:
    """Set the masks of the turbulence sections."""
    b = frame.builder
    speed = _airspeed(frame)
    on = b.op("and", b.op("and", kind.eq(TUSTIN), frame.get(_SEVERITY).ne(0.0)), speed.ne(0.0))
    frame.remember(MASK[1:], on.choose(1.0, 0.0))
    frame.remember("turbulence/speed", speed)
    high = b.op("and", on, frame.get("position/h-sl-ft").gt(1000.0))
    frame.remember(HIGH[1:], high.choose(1.0, 0.0))
    # Off, or severity 0: JSBSim sets the velocities to 0 and keeps the filters' states. Other
    # types are not supported: NaN.
    is_supported = b.op(
        "or", b.op("or", kind.eq(0.0), kind.eq(TUSTIN)), frame.get(_SEVERITY).eq(0.0)
    )
    for name in OUTPUTS:
        frame.write(name, on.choose(frame.get(name), is_supported.choose(0.0, math.nan)))


def _total_wind(frame: Frame) -> None:
    """Publish the total wind and the steady wind's azimuth."""
    for axis in AXES:
        parts = [frame.get(f"atmosphere/{kind}-{axis}-fps") for kind in ("wind", "gust", "turb")]
        frame.write(f"atmosphere/total-wind-{axis}-fps", parts[0] + parts[1] + parts[2])
    b = frame.builder
    north, east = (frame.get(f"atmosphere/wind-{axis}-fps") for axis in AXES[:2])
    is_defined, old = north.ne(0.0), frame.get(_PSI)
    psi = is_defined.choose(b.op("atan2", east, north), old)
    frame.store(_PSI, psi.lt(0.0).choose(psi + 2.0 * math.pi, psi))
    if frame.initialising:
        _keep_direction(frame, b.op("cos", psi), b.op("sin", psi))
        return
    cosine, sine = _direction(frame)
    new_cosine, new_sine = direction(north, east)
    _keep_direction(frame, is_defined.choose(new_cosine, cosine), is_defined.choose(new_sine, sine))


OUTPUTS = (
    *(f"atmosphere/turb-{axis}-fps" for axis in AXES),
    *(f"atmosphere/{k}-turb-rad_sec" for k in "pqr"),
)


def _airspeed(frame: Frame) -> Value:
    """Return the airspeed without turbulence, at which the filters move [ft/s]."""
    b = frame.builder
    total = b.constant(0.0)
    for axis in AXES:
        speed = frame.get(f"velocities/v-{axis}-fps")
        relative = speed - (
            frame.get(f"atmosphere/wind-{axis}-fps") + frame.get(f"atmosphere/gust-{axis}-fps")
        )
        total = total + relative * relative
    return b.op("sqrt", total)


def _scales_and_sigmas(frame: Frame) -> tuple[Value, Value, Value, Value]:
    """Return scale lengths Lu and Lw [ft] and standard deviations u and w [ft/s]."""
    b = frame.builder
    h = frame.get("position/h-sl-ft")
    # The model starts at 10 ft.
    h = h.le(10.0).choose(10.0, h)
    low, high = h.le(1000.0), h.gt(2000.0)
    w20 = frame.get(_W20)
    # MIL-F-8785C, figures 10 and 11: (0.177 + 0.000823 h)^1.2 and ^0.4, of which the one is the
    # cube of the other.
    root = b.op("exp", -0.4 * b.op("log", 0.177 + 0.000823 * b.op("min", h, b.constant(1000.0))))
    lw_low, sw_low = h, 0.1 * w20
    lu_low = h * (root * root * root)
    su_low = sw_low * root
    aloft = frame.memory("turbulence/aloft")
    # Linear between 1000 and 2000 ft.
    between = (h - 1000.0) / 1000.0
    l_high = high.choose(1750.0, 1000.0 + between * 750.0)
    s_high = high.choose(aloft, sw_low + between * (aloft - sw_low))
    return (
        low.choose(lu_low, l_high),
        low.choose(lw_low, l_high),
        low.choose(su_low, s_high),
        low.choose(sw_low, s_high),
    )


def _sigma_aloft(frame: Frame, h: Value) -> Value:
    """Interpolate figure 7 over height, at an integer severity."""
    severity = frame.get(_SEVERITY)
    b = frame.builder

    def row(sigmas: Sequence[float]) -> Value:
        """Interpolate one severity."""
        sigma: Value = b.constant(sigmas[-1])
        for k in range(len(_HEIGHTS) - 2, -1, -1):
            weight = (h - _HEIGHTS[k]) / (_HEIGHTS[k + 1] - _HEIGHTS[k])
            sigma = h.lt(_HEIGHTS[k + 1]).choose(
                sigmas[k] + weight * (sigmas[k + 1] - sigmas[k]), sigma
            )
        return h.lt(_HEIGHTS[0]).choose(sigmas[0], sigma)

    result: Value = b.constant(math.nan)
    for number, sigmas in enumerate(_SIGMA, start=1):
        result = severity.eq(float(number)).choose(row(sigmas), result)
    return result


def _filters(frame: Frame) -> None:
    """Run the filters of all six components.

    Equations are divided by 1/tau, so that of the pre-warped c = 1/(tau tan(dt/2 tau)) only c tau =
    cot(dt/2 tau) remains.
    """
    b = frame.builder
    span = frame.get("metrics/bw-ft")
    span = span.eq(0.0).choose(30.0, span)
    dt = frame.step
    half = dt / 2.0
    speed = frame.memory("turbulence/speed")
    slow = 1.0 / speed
    lu, lw, su, sw = _scales_and_sigmas(frame)
    # 1/sqrt(length speed), with tau_p = length / (2.6 speed) and sigma_p = 1.9 sigma_w / length.
    root_p = 1.0 / b.op("sqrt", b.op("sqrt", lw * span) * speed)
    steep_q, steep_r = math.pi / (4.0 * span), math.pi / (3.0 * span)
    nu = [frame.memory(name[1:]) for name in DRAWS]
    above, below = _cotangent(half * speed / lu)
    fu, fw = _weights(above, below), _weights(above * lw, below * lu)
    fp = _weights(*_cotangent(2.6 * half * ((speed * root_p) * (speed * root_p))))
    fq, fr = (_weights(*_cotangent(half * steep * speed)) for steep in (steep_q, steep_r))
    first, second = b.op("sqrt", 2.0 / dt), b.op("sqrt", 3.0 / dt)
    size_u, size_w = su * b.op("sqrt", lu * slow), sw * b.op("sqrt", lw * slow)
    u = _first_order(frame, "u", fu, size_u * first, nu[0])
    v = _second_order(frame, "v", fu, size_u * second, nu[1])
    w = _second_order(frame, "w", fw, size_w * second, nu[2])
    p = _first_order(frame, "p", fp, sw * root_p * (1.9 / math.sqrt(2.6) * first), nu[3])
    q = _slope(frame, "q", fq, steep_q, w)
    r = _slope(frame, "r", fr, steep_r, v)
    for name, (new, _) in (("v", v), ("w", w)):
        frame.remember(f"turbulence/{name}1", new)
    cosine, sine = _direction(frame)
    # From axes along the wind's azimuth to north, east, down; then rates to body axes.
    velocities = (cosine * u + sine * v[0], cosine * v[0] - sine * u, w[0])
    rates: Vector = (cosine * p + sine * q, cosine * q - sine * p, r)
    for name, value in zip(
        OUTPUTS, (*velocities, *matvec(matrix(frame, MATRIX), rates)), strict=True
    ):
        frame.write(name, value)
    frame.remember(COUNTER[1:], frame.memory(COUNTER[1:]) + 1.0)


def _cotangent(angle: Value) -> tuple[Value, Value]:
    """Return numerator and denominator of the cotangent of a non-negative angle, to 5e-16.

    Lambert's continued fraction of the tangent of half the angle, after removing multiples of pi.
    """
    remainder = angle - round_to_even(angle * (1.0 / math.pi)) * math.pi
    x = 0.5 * remainder
    z = x * x
    above = ((6930.0 - 36.0 * z) * z - 270270.0) * z + 2027025.0
    below = (((z - 630.0) * z + 51975.0) * z - 945945.0) * z + 2027025.0
    return below * below - z * (above * above), remainder * (above * below)


class _Weights(NamedTuple):
    """(1 - k)/(1 + k), 1/(1 + k) and k/(1 + k) of k = c tau."""

    pole: Value
    one: Value
    k: Value


def _weights(above: Value, below: Value) -> _Weights:
    """Return the weights of k = above / below."""
    inverse = 1.0 / (above + below)
    return _Weights((below - above) * inverse, below * inverse, above * inverse)


def _first_order(frame: Frame, name: str, by: _Weights, size: Value, nu: Value) -> Value:
    """Step a first-order filter (Yeager 1998, eqs 18 and 21)."""
    old, nu_old = frame.memory(f"turbulence/{name}1"), frame.memory(f"turbulence/nu-{name}1")
    x = size * by.one * (nu + nu_old) - by.pole * old
    frame.remember(f"turbulence/{name}1", x)
    frame.remember(f"turbulence/nu-{name}1", nu)
    return x


def _second_order(
    frame: Frame, name: str, by: _Weights, size: Value, nu: Value
) -> tuple[Value, Value]:
    """Step a second-order filter (Yeager 1998, eq 20); return the new and the last value.

    `_slope` needs both, so the caller stores the new one.
    """
    x1, x2 = frame.memory(f"turbulence/{name}1"), frame.memory(f"turbulence/{name}2")
    nu1, nu2 = frame.memory(f"turbulence/nu-{name}1"), frame.memory(f"turbulence/nu-{name}2")
    third = by.one * (1.0 / math.sqrt(3.0))
    drive = (by.k + third) * nu + 2.0 * third * nu1 + (third - by.k) * nu2
    x = size * by.one * drive - 2.0 * by.pole * x1 - by.pole * by.pole * x2
    frame.remember(f"turbulence/{name}2", x1)
    frame.remember(f"turbulence/nu-{name}2", nu1)
    frame.remember(f"turbulence/nu-{name}1", nu)
    return x, x1


def _slope(
    frame: Frame, name: str, by: _Weights, steep: Value, values: tuple[Value, Value]
) -> Value:
    """Step the filter of a rate from the slope of a velocity (Yeager 1998, eqs 23 and 25);
    ``steep`` is 1/(tau speed).
    """
    old = frame.memory(f"turbulence/{name}1")
    x = steep * by.k * (values[0] - values[1]) - by.pole * old
    frame.remember(f"turbulence/{name}1", x)
    return x
