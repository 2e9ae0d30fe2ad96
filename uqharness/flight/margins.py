"""Gain, phase and delay margins of a control loop, measured in flight.

A multisine is added to one actuator's command while every loop stays closed, in calm air and without sensor noise. What
the controller puts out and what is applied (output + injection) are recorded; at the injected frequencies

    L(jw) = - output / applied

is the loop opened at that actuator with all the others closed: servo, airframe, sensors, control law, computing delay
and hold included, nothing modelled. Margins follow from L and from the fact that the flight was stable: growing or
shrinking the gain first loses stability where k L(jw) = -1, so the nearest crossings of the negative real axis on
either side of -1 are the margins, for conditionally stable loops too.

The simulator is handed in (`make_fdm`); nothing here knows JSBSim.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


class Simulator(Protocol):
    """The part of JSBSim's FGFDMExec that is needed."""

    def __getitem__(self, name: str) -> float: ...
    def __setitem__(self, name: str, value: float) -> None: ...
    def run(self) -> bool:
        """One step; False where the simulation ends."""
        ...

    def run_ic(self) -> bool:
        """Set the initial conditions."""
        ...


@dataclass(frozen=True)
class Loop:
    """One actuator loop: where to inject and what to record, and a multisine that suits its bandwidth."""

    name: str
    inject: str
    output: str
    applied: str
    rms: float  # of the injection, in the actuator's unit
    lowest_radps: float
    highest_radps: float
    period_s: float  # of the multisine; sets the spacing of the lines


def _loop(surface: str, unit: str, rms: float, lowest: float, highest: float, period_s: float) -> Loop:
    return Loop(
        name=surface,
        inject=f"ap/inject-{surface}-{unit}",
        output=f"ap/{surface}-out-{unit}",
        applied=f"ap/{surface}-cmd-{unit}",
        rms=rms,
        lowest_radps=lowest,
        highest_radps=highest,
        period_s=period_s,
    )


MAX_SCATTER = 0.1

# Amplitudes: large against the rounding of the log, small against servo rate (240 deg/s), throttle slew and the throws.
LOOPS: Mapping[str, Loop] = {
    "elevator": _loop("elevator", "deg", 0.3, 0.2, 60.0, 100.0),
    "aileron": _loop("aileron", "deg", 0.5, 0.2, 60.0, 100.0),
    "rudder": _loop("rudder", "deg", 0.5, 0.2, 60.0, 100.0),
    "throttle": _loop("throttle", "pct", 1.5, 0.05, 12.0, 250.0),
}

# A calm loiter on the circle: the flight begins heading north with the centre a radius to the east.
CALM_LOITER: Mapping[str, float] = {
    "sensor/noise": 0.0,
    "air/wind-mps": 0.0,
    "air/turbulence-w20-kt": 0.0,
    "ap/WP_LOITER_RAD": 120.0,
    "ap/loiter-center-north-m": 0.0,
    "ap/loiter-center-east-m": 120.0,
}

# A circle so wide (20 km, bank 0.14 deg) that it is a straight line.
CALM_STRAIGHT: Mapping[str, float] = {
    **CALM_LOITER,
    "ap/WP_LOITER_RAD": 2e4,
    "ap/loiter-center-east-m": 2e4,
}


@dataclass(frozen=True)
class Margins:
    """Distances of a stable loop from instability. Infinite where the measured band holds no crossing."""

    gain_up_dB: float  # smallest increase of gain that loses stability
    gain_down_dB: float  # smallest decrease that does, as a positive number; inf: none
    phase_deg: float  # smallest rotation, either way, over all gain crossovers
    delay_s: float  # smallest extra delay
    modulus: float  # closest approach of L to -1
    gain_crossovers_radps: tuple[float, ...]
    phase_crossovers_radps: tuple[float, ...]
    # Where each margin was read [rad/s]: NaN where it is infinite.
    gain_up_radps: float = math.nan
    gain_down_radps: float = math.nan
    phase_radps: float = math.nan
    delay_radps: float = math.nan


@dataclass(frozen=True)
class LoopMargins:
    """A measured loop: its margins and the frequency response they were read from."""

    loop: str
    margins: Margins
    frequency_radps: Floats = field(repr=False)
    response: Complexes = field(repr=False)
    scatter: Floats = field(repr=False)  # |difference between the two halves of the record| / |L|, per line

    @property
    def reliable(self) -> NDArray[np.bool_]:
        """The lines that the margins were read from: where L is very large, almost nothing is applied to divide by."""
        return np.asarray(self.scatter < MAX_SCATTER)


def multisine(lines: NDArray[np.int64], samples: int, rms: float) -> Floats:
    """Sum of equal cosines at whole `lines` per period, Schroeder's phases (low peak), one period of `samples`."""
    count = len(lines)
    index = np.arange(count)
    phase = -np.pi * index * (index + 1) / count
    angle = 2 * np.pi * np.outer(np.arange(samples), lines) / samples + phase
    return rms * math.sqrt(2 / count) * np.cos(angle).sum(axis=1)


def choose_lines(lowest_radps: float, highest_radps: float, period_s: float, count: int = 60) -> NDArray[np.int64]:
    """Harmonics of the period, evenly spread in log frequency."""
    base = 2 * np.pi / period_s
    wanted = np.geomspace(max(lowest_radps / base, 1.0), highest_radps / base, count)
    return np.unique(np.rint(wanted).astype(np.int64))


def margins_of(frequency_radps: Floats, response: Complexes) -> Margins:
    """Margins of a loop known to be stable, from L at rising frequencies (log-linear between them)."""
    log_w = np.log(frequency_radps)
    log_gain = np.log(np.abs(response))
    phase = np.unwrap(np.angle(response))

    def at(log_frequency: float) -> tuple[float, float]:
        return float(np.interp(log_frequency, log_w, log_gain)), float(np.interp(log_frequency, log_w, phase))

    def crossings(signal: Floats) -> list[float]:
        found = []
        for i in range(len(signal) - 1):
            a, b = signal[i], signal[i + 1]
            if a == 0.0 or a * b < 0.0:
                found.append(float(log_w[i] + (log_w[i + 1] - log_w[i]) * a / (a - b)))
        return found

    gain_crossings = crossings(log_gain)
    turns = range(math.floor((phase.min() / np.pi - 1) / 2), math.ceil((phase.max() / np.pi + 1) / 2) + 1)
    phase_crossings = sorted(x for k in turns for x in crossings(phase - np.pi * (2 * k + 1)))

    # Each the smallest of (size, log frequency); NaN for a frequency that is none.
    up = down = phase_margin = delay = (math.inf, math.nan)
    for x in phase_crossings:
        log_factor = -at(x)[0]  # gain factor that puts this crossing on -1
        if log_factor >= 0:
            up = min(up, (log_factor, x))
        else:
            down = min(down, (-log_factor, x))
    for x in gain_crossings:
        lag = (at(x)[1] + np.pi) % (2 * np.pi)  # how far it may lag before it meets -1
        phase_margin = min(phase_margin, (min(lag, 2 * np.pi - lag), x))
        delay = min(delay, (lag / math.exp(x), x))
    decibel = 20 / math.log(10)
    return Margins(
        gain_up_dB=up[0] * decibel,
        gain_down_dB=down[0] * decibel,
        phase_deg=math.degrees(phase_margin[0]),
        delay_s=delay[0],
        modulus=float(np.abs(1 + response).min()),
        gain_crossovers_radps=tuple(math.exp(x) for x in gain_crossings),
        phase_crossovers_radps=tuple(math.exp(x) for x in phase_crossings),
        gain_up_radps=math.exp(up[1]),
        gain_down_radps=math.exp(down[1]),
        phase_radps=math.exp(phase_margin[1]),
        delay_radps=math.exp(delay[1]),
    )


def measure_loop(
    make_fdm: Callable[[], Simulator],
    loop: Loop,
    *,
    condition: Mapping[str, float] = CALM_LOITER,
    settle_s: float = 120.0,
    periods: int = 2,
) -> LoopMargins:
    """Fly, inject, and read the margins of one loop.

    `make_fdm` returns a simulator with the aircraft loaded and its initial conditions set; `condition` is set before
    initialising. One period of injection is flown to let the transient die and is not used; `periods` (even) are.
    """
    if periods < 2 or periods % 2:
        raise ValueError("periods must be even and at least 2: the halves are compared")
    fdm = make_fdm()
    for name, value in condition.items():
        fdm[name] = value
    fdm.run_ic()
    fdm["ap/engaged"] = 1.0
    dt = fdm["simulation/dt"]
    samples = round(loop.period_s / dt)
    lines = choose_lines(loop.lowest_radps, loop.highest_radps, loop.period_s)
    excitation = multisine(lines, samples, loop.rms)

    for _ in range(round(settle_s / dt)):
        fdm.run()
    output = np.empty((periods, samples))
    applied = np.empty((periods, samples))
    for period in range(-1, periods):
        for i in range(samples):
            fdm[loop.inject] = float(excitation[i])
            fdm.run()
            if period >= 0:
                output[period, i] = fdm[loop.output]
                applied[period, i] = fdm[loop.applied]
    fdm[loop.inject] = 0.0

    out_lines = np.fft.rfft(output, axis=1)[:, lines]
    applied_lines = np.fft.rfft(applied, axis=1)[:, lines]
    if not np.all(np.isfinite(out_lines)):
        raise ValueError(f"{loop.name}: the flight did not stay finite")
    response = -out_lines.sum(axis=0) / applied_lines.sum(axis=0)
    half = periods // 2
    first = -out_lines[:half].sum(axis=0) / applied_lines[:half].sum(axis=0)
    second = -out_lines[half:].sum(axis=0) / applied_lines[half:].sum(axis=0)
    scatter = np.abs(first - second) / np.abs(response)
    frequency = np.asarray(2 * np.pi * lines / (samples * dt), dtype=np.float64)
    good = scatter < MAX_SCATTER
    if np.count_nonzero(good) < 10:
        raise ValueError(f"{loop.name}: the two halves of the record disagree, the flight was not steady")
    return LoopMargins(
        loop=loop.name,
        margins=margins_of(frequency[good], response[good]),
        frequency_radps=frequency,
        response=response,
        scatter=scatter,
    )
