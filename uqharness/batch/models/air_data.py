"""What follows from airspeed and atmosphere alone: calibrated airspeed, total pressure and temperature, Reynolds number, ratios.

Calibrated airspeed: AFFTC-TIH-99-01, "Aircraft performance flight testing", sections 4.6 to 4.8, with Rayleigh's formula behind a
shock. Viscosity: U.S. Standard Atmosphere 1976, eq 51.
"""

from __future__ import annotations

from sysid.units import FT_M, KT_MPS
from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.translate.frame import Frame

_KT = FT_M / KT_MPS
"""Knots in a foot per second."""
_P0_PSF, _A0_FPS = 2116.228, 1116.4485575897318
"""Standard day at sea level, as JSBSim 1.3.3 has it."""
_VISCOSITY, _SUTHERLAND_R = 2.269690e-8, 198.72
"""Sutherland's constants, slug/(s ft sqrt(R)) and deg R."""
_RAYLEIGH, _SUPERSONIC = 166.9215800931683, 0.8812848543473311
"""1.2^3.5 6^2.5, and 1.2^-1.75 (6/7)^-1.25."""
_TURNS = 10
"""Iterations of a supersonic Mach number."""


def trace_air_data(frame: Frame) -> None:
    """Write them; behind the auxiliary model's airspeed and Mach number."""
    b = frame.builder
    speed, mach = frame.get("velocities/vt-fps"), frame.get("velocities/mach")
    pressure, temperature, density = (
        frame.get(f"atmosphere/{name}") for name in ("P-psf", "T-R", "rho-slugs_ft3")
    )
    total = _pitot(b, mach, pressure)
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
    """Write the atmosphere over that of the same day at sea level."""
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
    """Total pressure [psf] behind a normal shock, if there is one, at a ratio of specific heats of 1.4."""
    square = mach * mach
    slow = 1.0 + 0.2 * square
    fast = 7.0 * square - 1.0
    behind = _RAYLEIGH * (square * square * square * mach) / _to_2_5(b, fast)
    return pressure * mach.lt(1.0).choose(slow * _to_2_5(b, slow), behind)


def _mach(b: Builder, ratio: Value) -> Value:
    """The Mach number at which total over static pressure is ``ratio``."""
    slow = b.op("sqrt", 5.0 * (b.op("pow", ratio, b.constant(2.0 / 7.0)) - 1.0))
    found = slow
    for _ in range(_TURNS):
        found = _SUPERSONIC * b.op("sqrt", ratio * _to_2_5(b, 1.0 - 1.0 / (7.0 * found * found)))
    return slow.gt(1.0).choose(found, slow)


def _to_2_5(b: Builder, x: Value) -> Value:
    return x * x * b.op("sqrt", x)
