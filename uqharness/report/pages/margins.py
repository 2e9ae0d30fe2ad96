"""Build the page of an autopilot's stability margins: Bode and Nichols charts of each loop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid.arrays import FloatArray
from uqharness.flight import LoopMargins
from uqharness.report.parts import (
    Figure,
    Figures,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    provenance,
)
from uqharness.report.svg import Chart, Scale, log_scale, scale

_TURN = 360.0
_SPACED_DEG = (30.0, 45.0, 90.0, 180.0, 360.0)
"""Tick distances of a phase axis [deg]."""
_MAX_TICKS = 8


def margins_page(aircraft: str, flight: str, measured: Sequence[LoopMargins], command: str) -> Page:
    """Return the page of loops measured in a flight.

    Parameters
    ----------
    aircraft, flight : str
        Name, and loiter or straight.
    measured : sequence of LoopMargins
        Responses and margins.
    command : str
        Command line.
    """
    question = (
        f"How far are the loops of {aircraft}'s autopilot from instability? Measured in flight"
        f" ({flight}, calm air, no sensor noise): each loop is opened at its controller's output,"
        " the others stay closed."
    )
    verdict = tuple(Sentence(_sentence(item)) for item in measured)
    sections = [_table(measured), *(_loop(item) for item in measured)]
    text = (
        "The response is L = -output/applied at the frequencies of an injected multisine, with"
        " servo, airframe, sensors, control law, computing delay and hold in it. If the autopilot"
        " mixes the output into a second actuator, so is the injection. The multisine is injected"
        " with both signs, and the difference is used. The flight was stable, so the nearest"
        " crossings of the negative real axis on either side of -1 are the gain margins. Gain and"
        " phase are interpolated over the logarithm of frequency. Grey dots are frequencies at"
        " which the responses of the two signs differ by 10 % or more; they are not used."
    )
    sections.append(Section("How it was measured", (Words(text),)))
    return Page(
        f"Stability margins of {aircraft}, {flight}",
        question,
        verdict,
        (*sections, provenance(("Command", command))),
    )


def _decibel(value: float) -> str:
    """Format a gain margin."""
    return f"{value:.1f} dB" if math.isfinite(value) else "none in the measured band"


def _sentence(item: LoopMargins) -> str:
    """Return the margins of a loop as a sentence."""
    # Margins in words; infinite ones are absent.
    m = item.margins
    phase = f"{m.phase_deg:.1f} deg" if math.isfinite(m.phase_deg) else "none"
    delay = f"{1000.0 * m.delay_s:.0f} ms" if math.isfinite(m.delay_s) else "none"
    return (
        f"{item.loop.capitalize()}: gain margin up {_decibel(m.gain_up_dB)}, down"
        f" {_decibel(m.gain_down_dB)}; phase margin {phase}; delay margin {delay}; smallest |1+L|"
        f" {m.modulus:.2f}."
    )


def _table(measured: Sequence[LoopMargins]) -> Section:
    """Return the table of margins."""

    def at(value: float, form: str, radps: float) -> str:
        """Format a margin with its frequency."""
        return f"{value:{form}} at {radps:.3g}" if math.isfinite(value) else "none"

    # A margin without a crossover is "none", not a number.
    rows = []
    for item in measured:
        m = item.margins
        rows.append(
            (
                item.loop,
                at(m.gain_up_dB, ".1f", m.gain_up_radps),
                at(m.gain_down_dB, ".1f", m.gain_down_radps),
                at(m.phase_deg, ".1f", m.phase_radps),
                at(1000.0 * m.delay_s, ".0f", m.delay_radps),
                f"{m.modulus:.2f}",
                ", ".join(f"{w:.2f}" for w in m.gain_crossovers_radps) or "none",
            )
        )
    head = (
        "Loop",
        "Gain up [dB], at [rad/s]",
        "Gain down [dB], at [rad/s]",
        "Phase [deg], at [rad/s]",
        "Delay [ms], at [rad/s]",
        "Smallest |1+L| [-]",
        "Gain crossovers [rad/s]",
    )
    return Section(
        "Margins",
        (
            Table(
                "Margins of each loop, and the frequency at which each is read.", head, tuple(rows)
            ),
        ),
    )


def _loop(item: LoopMargins) -> Section:
    """Return the charts of one loop."""
    response = _Response(item)
    figures = (_gain(response), _phase(response), _nichols(response))
    return Section(
        f"{item.loop.capitalize()} loop",
        (Figures(figures, narrow=True, file=f"margins-{item.loop}"),),
    )


class _Response:
    """A loop's gain [dB] and phase [deg] at its reliable frequencies.

    The branch of the phase is the one on which the phase margin is read at -180 deg.
    """

    def __init__(self, item: LoopMargins) -> None:
        """Unwrap the phase and shift it to that branch."""
        self.item, self.margins = item, item.margins
        is_reliable = item.reliable
        self.w = item.frequency_radps[is_reliable]
        self.log_w = np.log(self.w)
        self.gain = 20.0 * np.log10(np.abs(item.response[is_reliable]))
        # Continuous phase, known up to whole turns.
        phase = np.degrees(np.unwrap(np.angle(item.response[is_reliable])))
        at = self.margins.phase_radps
        margin_phase = (
            float(np.interp(math.log(at), self.log_w, phase))
            if math.isfinite(at)
            else float(np.median(phase))
        )
        # Shift the curve so that the phase margin is read at -180 deg.
        lag = (margin_phase + 180.0) % _TURN
        self.phase = phase + ((lag if lag <= 180.0 else lag - _TURN) - 180.0 - margin_phase)
        # Frequencies without a reliable response: their phase on the branch next to the curve.
        self.bad_w = item.frequency_radps[~is_reliable]
        self.bad_gain = 20.0 * np.log10(np.abs(item.response[~is_reliable]))
        # Unreliable points go to the branch next to the curve.
        raw = np.degrees(np.angle(item.response[~is_reliable]))
        curve_phase = np.interp(np.log(self.bad_w), self.log_w, self.phase)
        self.bad_phase = raw + _TURN * np.round((curve_phase - raw) / _TURN)

    def at(self, radps: float) -> tuple[float, float]:
        """Return gain [dB] and phase [deg] at a frequency [rad/s], interpolated over its
        logarithm.
        """
        x = math.log(radps)
        return float(np.interp(x, self.log_w, self.gain)), float(
            np.interp(x, self.log_w, self.phase)
        )

    @property
    def delayed(self) -> FloatArray | None:
        """Phase [deg] with the delay margin added; None without such a margin."""
        delay = self.margins.delay_s
        return self.phase - np.degrees(self.w * delay) if math.isfinite(delay) else None

    @property
    def gain_margins(self) -> list[tuple[float, str, str]]:
        """Frequency [rad/s], class and words of each gain margin."""
        m = self.margins
        margins = [
            (m.gain_up_radps, "second", f"gain up {m.gain_up_dB:.1f} dB"),
            (m.gain_down_radps, "mark", f"gain down {m.gain_down_dB:.1f} dB"),
        ]
        return [row for row in margins if math.isfinite(row[0])]


def _critical(low: float, high: float) -> list[float]:
    """Return the phases [deg] of the point -1 within a range."""
    return [
        _TURN * k - 180.0
        for k in range(math.ceil((low + 180.0) / _TURN), math.floor((high + 180.0) / _TURN) + 1)
    ]


def _phase_scale(values: Sequence[FloatArray]) -> Scale:
    """Return a phase axis with round ticks."""
    axis = scale("phase of L [deg]", [*values, np.array([-180.0])])
    # The finest tick distance that gives few enough ticks.
    step = next((s for s in _SPACED_DEG if (axis.high - axis.low) / s <= _MAX_TICKS), 720.0)
    ticks = [step * k for k in range(math.ceil(axis.low / step), math.floor(axis.high / step) + 1)]
    return Scale(
        axis.label, axis.low, axis.high, tuple((t, f"{t:g}".replace("-", "−")) for t in ticks)
    )


def _gain_scale(r: _Response) -> Scale:
    """Return a gain axis."""
    return scale("gain of L [dB]", [r.gain, r.bad_gain, np.zeros(1)])


def _gain(r: _Response) -> Figure:
    """Draw the gain over frequency."""
    loop = r.item.loop
    label = f"Gain of the {loop} loop [dB] over frequency [rad/s]; {_sentence(r.item)}"
    chart = Chart(
        f"bode-gain-{loop}", label, log_scale("frequency [rad/s]", [r.w, r.bad_w]), _gain_scale(r)
    )
    chart.level(0.0, "limit")
    chart.dots(r.bad_w, r.bad_gain, "dot", "not read", radius=1.8)
    chart.line(r.w, r.gain, "first", "L, measured")
    chart.dots(r.w, r.gain, "dotfirst", radius=1.6)
    # Gain margins from the curve to 0 dB.
    for w, kind, words in r.gain_margins:
        chart.path(np.array([w, w]), np.array([r.at(w)[0], 0.0]), kind, words)
    if math.isfinite(r.margins.phase_radps):
        chart.marker(r.margins.phase_radps, 0.0, "second", "ring", "phase margin read here")
    return Figure(
        chart.name,
        chart.svg(),
        f"{loop.capitalize()}, Bode: gain. Gain margins reach from the curve to 0 dB.",
    )


def _phase(r: _Response) -> Figure:
    """Draw the phase over frequency."""
    loop, m = r.item.loop, r.margins
    delayed = r.delayed
    y = _phase_scale([r.phase, r.bad_phase])
    label = f"Phase of the {loop} loop [deg] over frequency [rad/s]; {_sentence(r.item)}"
    chart = Chart(f"bode-phase-{loop}", label, log_scale("frequency [rad/s]", [r.w, r.bad_w]), y)
    for tick in _critical(y.low, y.high):
        chart.level(tick, "limit")
    chart.dots(r.bad_w, r.bad_phase, "dot", "not read", radius=1.8)
    if delayed is not None:
        chart.line(r.w, delayed, "third", f"with {1000.0 * m.delay_s:.0f} ms more delay")
    chart.line(r.w, r.phase, "first", "L, measured")
    chart.dots(r.w, r.phase, "dotfirst", radius=1.6)
    if math.isfinite(m.phase_deg):
        _, phase_deg = r.at(m.phase_radps)
        chart.path(
            np.array([m.phase_radps] * 2),
            np.array([phase_deg, -180.0]),
            "second",
            f"phase margin {m.phase_deg:.1f} deg",
        )
    for w, _, _ in r.gain_margins:
        chart.marker(w, r.at(w)[1], "second", "square", "gain margin read here")
    caption = f"{loop.capitalize()}, Bode: phase. Dashed levels: −180 deg and whole turns from it."
    return Figure(chart.name, chart.svg(), caption)


def _nichols(r: _Response) -> Figure:
    """Draw gain over phase, with the circle of the smallest distance from -1."""
    loop, m = r.item.loop, r.margins
    x = _phase_scale([r.phase])
    y = _gain_scale(r)
    label = f"Nichols chart of the {loop} loop, gain [dB] over phase [deg]; {_sentence(r.item)}"
    chart = Chart(f"nichols-{loop}", label, x, y, 290)
    chart.level(0.0, "zero")
    angle = np.linspace(0.0, 2.0 * math.pi, 241)
    # Circle around -1 that touches the response, as a curve of gain over phase.
    circle = -1.0 + m.modulus * np.exp(1j * angle)
    phase = np.degrees(np.unwrap(np.angle(circle)))
    if m.modulus < 1.0:  # a larger circle holds the origin and is no closed line here
        phase += -180.0 - 0.5 * (phase.min() + phase.max())
        for k, turn in enumerate(_critical(x.low - 90.0, x.high + 90.0)):
            words = f"|1+L| = {m.modulus:.2f}" if k == 0 else ""
            chart.path(phase + turn + 180.0, 20.0 * np.log10(np.abs(circle)), "limit2", words)
    delayed = r.delayed
    if delayed is not None:
        chart.path(delayed, r.gain, "third", f"with {1000.0 * m.delay_s:.0f} ms more delay")
    chart.path(r.phase, r.gain, "first", "L, measured")
    chart.dots(r.phase, r.gain, "dotfirst", radius=1.6)
    for w, kind, words in r.gain_margins:
        gain, phase_deg = r.at(w)
        chart.path(np.array([phase_deg, phase_deg]), np.array([gain, 0.0]), kind, words)
    if math.isfinite(m.phase_deg):
        _, phase_deg = r.at(m.phase_radps)
        chart.path(
            np.array([phase_deg, -180.0]),
            np.zeros(2),
            "second thin",
            f"phase margin {m.phase_deg:.1f} deg",
        )
    for turn in _critical(x.low, x.high):
        chart.marker(turn, 0.0, "", "cross", "the point −1")
    rising = f"{format_value(float(r.w[0]))} to {format_value(float(r.w[-1]))} rad/s"
    return Figure(
        chart.name,
        chart.svg(),
        f"{loop.capitalize()}, Nichols, {rising}. Dots are the measured frequencies.",
    )
