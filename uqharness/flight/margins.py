"""Gain, phase and delay margins of a control loop, measured in flight.

A multisine is added to one controller's output while every loop stays closed, in calm air and
without sensor noise. What the controller puts out and what is applied (output + injection) are
recorded; at the injected frequencies

    L(jw) = - output / applied

is the loop opened at that output with all the others closed: servo, airframe, sensors, control law,
computing delay and hold included, nothing modelled. Where the autopilot mixes the output into a
second actuator, the injection is mixed in too: the loop is open on both paths, and L is
proportional to the gains of its controller.

The multisine is flown with both signs, and the difference is read: what does not change sign with
it, such as the turn of the loiter and the loss of speed that follows any deflection, cancels out.

Margins follow from L and from the fact that the flight was stable: growing or shrinking the gain
first loses stability where k L(jw) = -1, so the nearest crossings of the negative real axis on
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
    """The part of JSBSim's FGFDMExec that is used."""

    def __getitem__(self, name: str) -> float: ...
    def __setitem__(self, name: str, value: float) -> None: ...
    def run(self) -> bool:
        """Run one step; return False at the end of the simulation."""
        ...

    def run_ic(self) -> bool:
        """Set the initial conditions."""
        ...


@dataclass(frozen=True)
class CoupledActuator:
    """A second actuator moved by the same output, by ``sign`` times the property ``gain``."""

    inject: str
    gain: str
    sign: float


@dataclass(frozen=True)
class Loop:
    """A control loop and the multisine that measures it.

    Attributes
    ----------
    name : str
        Name of the actuator.
    inject, output, applied : str
        Properties: injected signal, controller's output, and their sum.
    rms : float
        Of the injection, in the actuator's unit.
    lowest_radps, highest_radps : float
        Frequency band [rad/s].
    period_s : float
        Period of the multisine [s], which sets the spacing of its lines.
    mixed : tuple of Mixed
        Actuators that follow the same output.
    """

    name: str
    inject: str
    output: str
    applied: str
    rms: float  # of the injection, in the actuator's unit
    lowest_radps: float
    highest_radps: float
    period_s: float  # of the multisine; sets the spacing of the lines
    mixed: tuple[CoupledActuator, ...] = ()

    @property
    def properties(self) -> tuple[str, ...]:
        """Return the properties that the aircraft must have."""
        return (
            self.inject,
            self.output,
            self.applied,
            *(name for item in self.mixed for name in (item.inject, item.gain)),
        )


def _loop(
    surface: str,
    unit: str,
    rms: float,
    lowest: float,
    highest: float,
    period_s: float,
    *mixed: CoupledActuator,
) -> Loop:
    """Return a loop with the autopilot's property names."""
    return Loop(
        name=surface,
        inject=f"ap/inject-{surface}-{unit}",
        output=f"ap/{surface}-out-{unit}",
        applied=f"ap/{surface}-cmd-{unit}",
        rms=rms,
        lowest_radps=lowest,
        highest_radps=highest,
        period_s=period_s,
        mixed=mixed,
    )


MAX_SCATTER = 0.1
"""Largest relative difference of L between the records of either sign, at a line that is used."""
_MIN_LINES = 10

# Amplitudes are large against rounding, and small against servo rate (240 deg/s), throttle slew and
# throws.
LOOPS: Mapping[str, Loop] = {
    "elevator": _loop("elevator", "deg", 0.3, 0.2, 60.0, 100.0),
    # +aileron is right wing down and +rudder nose left: mixing moves the rudder the other way.
    "aileron": _loop(
        "aileron",
        "deg",
        0.5,
        0.2,
        60.0,
        100.0,
        CoupledActuator("ap/inject-rudder-deg", "ap/KFF_RDDRMIX", -1.0),
    ),
    "rudder": _loop("rudder", "deg", 0.5, 0.2, 60.0, 100.0),
    "throttle": _loop("throttle", "pct", 1.5, 0.05, 12.0, 250.0),
}

# Calm loiter: the flight starts northwards with the centre one radius to the east.
CALM_LOITER: Mapping[str, float] = {
    "sensor/noise": 0.0,
    "air/wind-mps": 0.0,
    "air/turbulence-w20-kt": 0.0,
    "ap/WP_LOITER_RAD": 120.0,
    "ap/loiter-center-north-m": 0.0,
    "ap/loiter-center-east-m": 120.0,
}

# A circle of 20 km (bank 0.14 deg) is a straight line.
CALM_STRAIGHT: Mapping[str, float] = {
    **CALM_LOITER,
    "ap/WP_LOITER_RAD": 2e4,
    "ap/loiter-center-east-m": 2e4,
}


@dataclass(frozen=True)
class Margins:
    """Stability margins; infinite if the measured band has no crossing."""

    gain_up_dB: float  # smallest increase of gain that loses stability
    gain_down_dB: float  # smallest decrease that does, as a positive number; inf: none
    phase_deg: float  # smallest rotation, either way, over all gain crossovers
    delay_s: float  # smallest extra delay
    modulus: float  # closest approach of L to -1
    gain_crossovers_radps: tuple[float, ...]
    phase_crossovers_radps: tuple[float, ...]
    # Frequency of each margin [rad/s]; NaN if it is infinite.
    gain_up_radps: float = math.nan
    gain_down_radps: float = math.nan
    phase_radps: float = math.nan
    delay_radps: float = math.nan


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a loop and the frequency response (n,) that they were read from."""

    loop: str
    margins: Margins
    frequency_radps: Floats = field(repr=False)
    response: Complexes = field(repr=False)
    scatter: Floats = field(
        repr=False
    )  # |difference between the records of either sign| / |L|, per line

    @property
    def reliable(self) -> NDArray[np.bool_]:
        """Return which lines were used; where L is very large, hardly anything is applied."""
        return np.asarray(self.scatter < MAX_SCATTER)


def multisine(lines: NDArray[np.int64], samples: int, rms: float) -> Floats:
    """Return one period (samples,) of equal cosines at whole ``lines`` with Schroeder phases.

    The phases give a low peak; ``rms`` is that of the sum.
    """
    count = len(lines)
    index = np.arange(count)
    phase = -np.pi * index * (index + 1) / count
    angle = 2 * np.pi * np.outer(np.arange(samples), lines) / samples + phase
    return rms * math.sqrt(2 / count) * np.cos(angle).sum(axis=1)


def choose_lines(
    lowest_radps: float, highest_radps: float, period_s: float, count: int = 60
) -> NDArray[np.int64]:
    """Return harmonics of the period, evenly spaced in log frequency."""
    base = 2 * np.pi / period_s
    harmonics = np.geomspace(max(lowest_radps / base, 1.0), highest_radps / base, count)
    return np.unique(np.rint(harmonics).astype(np.int64))


def margins_of(frequency_radps: Floats, response: Complexes) -> Margins:
    """Return the margins of a stable loop.

    Parameters
    ----------
    frequency_radps : ndarray
        Rising frequencies (n,) [rad/s]; L is interpolated log-linearly.
    response : ndarray
        Loop transfer function L (n,), complex.
    """
    log_w = np.log(frequency_radps)
    log_gain = np.log(np.abs(response))
    phase = np.unwrap(np.angle(response))

    def at(log_frequency: float) -> tuple[float, float]:
        return float(np.interp(log_frequency, log_w, log_gain)), float(
            np.interp(log_frequency, log_w, phase)
        )

    def crossings(signal: Floats) -> list[float]:
        log_frequencies = []
        for i in range(len(signal) - 1):
            a, b = signal[i], signal[i + 1]
            if a == 0.0 or a * b < 0.0:
                log_frequencies.append(float(log_w[i] + (log_w[i + 1] - log_w[i]) * a / (a - b)))
        return log_frequencies

    gain_crossings = crossings(log_gain)
    turns = range(
        math.floor((phase.min() / np.pi - 1) / 2), math.ceil((phase.max() / np.pi + 1) / 2) + 1
    )
    phase_crossings = sorted(x for k in turns for x in crossings(phase - np.pi * (2 * k + 1)))

    # Each is the smallest (size, log frequency); NaN stands for no frequency.
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
    periods: int = 1,
    on_progress: Callable[[float], None] | None = None,
) -> LoopMargins:
    """Fly, inject, and read the margins of one loop.

    Parameters
    ----------
    make_fdm : callable
        Returns a simulator with the aircraft loaded and initial conditions set.
    loop : Loop
        The loop.
    condition : mapping
        Properties set before initialisation.
    settle_s : float
        Flight time before the injection [s].
    periods : int
        Periods read with either sign, after one for the transient.
    on_progress : callable, optional
        Called with the share of the flight that is done, 0 to 1.

    Raises
    ------
    ValueError
        If the flight does not stay finite or does not repeat itself.
    """
    if periods < 1:
        raise ValueError(f"periods {periods}: at least 1 is read")
    fdm = make_fdm()
    for name, value in condition.items():
        fdm[name] = value
    fdm.run_ic()
    fdm["ap/engaged"] = 1.0
    dt = fdm["simulation/dt"]
    samples = round(loop.period_s / dt)
    lines = choose_lines(loop.lowest_radps, loop.highest_radps, loop.period_s)
    excitation = multisine(lines, samples, loop.rms)
    settling = round(settle_s / dt)
    total_steps = settling + 2 * (periods + 1) * samples
    callback = on_progress or (lambda _share: None)

    for _ in range(settling):
        fdm.run()
    callback(settling / total_steps)
    output, applied = [], []  # at the lines, of the injection as it is and with the other sign
    for k, sign in enumerate((1.0, -1.0)):
        records = []
        for period in range(1 + periods):
            records.append(_fly_period(fdm, loop, sign * excitation))
            callback((settling + (k * (periods + 1) + period + 1) * samples) / total_steps)
        # The transform at the lines of the injection.
        out, on = (
            sign * np.fft.rfft(np.sum(signal, axis=0))[lines]
            for signal in zip(*records[1:], strict=True)
        )
        output.append(out)
        applied.append(on)
    for name in (loop.inject, *(item.inject for item in loop.mixed)):
        fdm[name] = 0.0

    if not np.all(np.isfinite(output)):
        raise ValueError(f"{loop.name}: the flight did not stay finite")
    # The difference of both signs cancels what does not depend on the injection.
    response = -(output[0] + output[1]) / (applied[0] + applied[1])
    scatter = np.abs(output[0] / applied[0] - output[1] / applied[1]) / np.abs(response)
    frequency = np.asarray(2 * np.pi * lines / (samples * dt), dtype=np.float64)
    reliable = scatter < MAX_SCATTER
    if np.count_nonzero(reliable) < _MIN_LINES:
        raise ValueError(
            f"{loop.name}: the records of either sign of the injection disagree, the flight was not"
            " steady"
        )
    return LoopMargins(
        loop=loop.name,
        margins=margins_of(frequency[reliable], response[reliable]),
        frequency_radps=frequency,
        response=response,
        scatter=scatter,
    )


def _fly_period(fdm: Simulator, loop: Loop, excitation: Floats) -> tuple[Floats, Floats]:
    """Return the controller's output and the applied signal, (samples,) each, over one period."""
    output, applied = np.empty(excitation.size), np.empty(excitation.size)
    mixed = [(item.inject, item.sign * fdm[item.gain]) for item in loop.mixed]
    for i, value in enumerate(excitation.tolist()):
        fdm[loop.inject] = value
        for name, share in mixed:
            fdm[name] = share * value
        fdm.run()
        output[i] = fdm[loop.output]
        applied[i] = fdm[loop.applied]
    return output, applied
