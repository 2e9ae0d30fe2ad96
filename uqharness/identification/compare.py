"""Comparison of a flight with the model: gap by channel, coefficient and manoeuvre.

The flight is replayed by segment with the aerodynamics unchanged. Start states of the segments,
constant sensor biases and delays are estimated, because a replay from a start that is wrong by the
sensors' noise misses the flight with any model. Each channel's residual is set against its noise,
and sign, scale and delay are stated where the flight determines them.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.estimation import (
    NOISE_FLOOR,
    Shift,
    Theil,
    channel_noise,
    largest_residuals,
    rms,
    theil,
    time_shift,
)
from sysid.logs import Relation, relate
from sysid.model_form import noise_floor
from uqharness.errors import BadInputError
from uqharness.heartbeat import Callback, silent
from uqharness.identification.replay_fit import (
    BIASES,
    OUTPUTS,
    Observed,
    coefficient_gaps,
    fit_replays,
    jumping_flights,
)
from uqharness.replay import (
    CHANNELS,
    CONTROL_DELAY,
    CONTROLS,
    SENSOR_OF,
    Flight,
    History,
    Replay,
    ReplayFolder,
    ReplayModel,
    Segment,
    delayed,
    late_limit_s,
    measured_outputs,
    nuisance_layout,
    replay_pool,
    states,
)
from uqharness.replay.flights import segments
from uqharness.simulator import Aircraft
from uqharness.text_tables import TabularResult

if TYPE_CHECKING:
    import pandas as pd


# Relation of a measured channel to the modelled one: sign, scale and delay, each only where the
# flight determines it.

MOTION_SIGMA = 1.0
"""Smallest modelled motion, rms about a straight line in units of the noise, for which sign, scale
and delay are determined. Below, the correlation of noise and start states passes for a huge scale.
"""
MAX_DELAY_S = 0.2
"""Largest delay that is searched for, either way [s]."""
DELAY_STD_S = 0.25 * MAX_DELAY_S
"""Standard error above which a delay is undefined [s]: its 95 % interval would span the search
range.
"""
SCALE_MARGIN = 0.33
"""Deviation of the scale from 1 that errors of derivatives can explain; more suggests a
wrong unit.
"""
SLIP_SHARE = 0.5
"""Share of a channel's gap that a wrong sign or scale must remove to be named. Gusts that the
controls answer leave a scale far from 1, too, which removes hardly anything."""
_ANSWER_HZ = (0.1, 2.5)
_NO_RELATION = Relation(math.nan, math.nan, math.nan, math.inf, 0.0, 0)


@dataclass(frozen=True)
class ChannelResponse:
    """How a measured channel follows the modelled one.

    Attributes
    ----------
    relation : Relation
        The measured channel as a multiple of the modelled one; without evidence where the model
        hardly moves.
    shift : Shift
        Delay of the measured channel, NaN where ``undefined`` gives a reason.
    """

    relation: Relation
    shift: Shift
    undefined: str = ""


def describe_slip(answer: Relation) -> str:
    """Describe a sign or scale that is certainly wrong; "" where it is right or undetermined."""
    if not answer.evident or answer.allows(1.0, SCALE_MARGIN):
        return ""
    # Powers over that of the model: both limits give the common and the measured one.
    sign = math.copysign(1.0, answer.scale)
    common, measured = abs(answer.low), answer.low * answer.high
    gap, removed = measured - 2.0 * sign * common + 1.0, (common - sign) ** 2
    if not removed > SLIP_SHARE * gap:
        return ""
    size = f"{answer.scale:.2f} times the model's (between {answer.low:.2f} and {answer.high:.2f})"
    return f"reversed: {size}" if answer.scale < 0.0 else f"out of scale: {size}"


def motion(modelled: Sequence[FloatArray]) -> float:
    """Return the rms of a modelled channel about a straight line in each segment (n,).

    NaN where no segment was flown to its end.
    """
    squares = []
    for y in modelled:
        # Short or diverged segments say nothing about the motion.
        if len(y) >= 8 and np.isfinite(y).all():
            at = np.arange(len(y), dtype=float)
            squares.append((y - np.polynomial.Polynomial.fit(at, y, 1)(at)) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else math.nan


def channel_response(
    measured: Sequence[FloatArray], modelled: Sequence[FloatArray], noise: float, dt_s: float
) -> ChannelResponse:
    """Determine sign, scale and delay of a channel.

    Parameters
    ----------
    measured, modelled : sequence of ndarray
        (n,) by segment; measured is NaN between logged samples.
    noise : float
        Standard deviation of the measured channel, in its unit.
    dt_s : float
        Sample time [s].

    Returns
    -------
    Answer
        Without evidence or delay where they are undetermined.
    """
    # Order of the tests: enough motion, right sign and scale, a defined delay.
    rms_motion = motion(modelled)
    if not rms_motion >= MOTION_SIGMA * noise:
        return ChannelResponse(_NO_RELATION, _no_shift(), _motion_note(rms_motion / noise))
    relation = _relation(measured, modelled, dt_s)
    if slip := describe_slip(relation):
        return ChannelResponse(relation, _no_shift(), slip.split(":")[0])
    shift = time_shift(measured, modelled, dt_s, MAX_DELAY_S)
    if not math.isfinite(shift.seconds):
        return ChannelResponse(relation, _no_shift(), "the model does not move")
    # NaN must fail too, hence the negation.
    if not shift.std <= DELAY_STD_S:
        return ChannelResponse(
            relation, _no_shift(), f"its standard error is {1e3 * shift.std:.0f} ms"
        )
    if abs(shift.seconds) >= MAX_DELAY_S:
        return ChannelResponse(
            relation, _no_shift(), f"no minimum within {1e3 * MAX_DELAY_S:.0f} ms"
        )
    return ChannelResponse(relation, shift)


def _motion_note(sigma: float) -> str:
    """Describe a motion that is too small."""
    return (
        f"the model moves {sigma:.1f} sigma" if math.isfinite(sigma) else "the model does not move"
    )


def _no_shift() -> Shift:
    return Shift(math.nan, math.nan)


def _relation(
    measured: Sequence[FloatArray], modelled: Sequence[FloatArray], dt_s: float
) -> Relation:
    """Relate measured to modelled values; logged samples are connected linearly."""
    x, y = [], []
    for z, m in zip(measured, modelled, strict=True):
        at, logged = np.arange(len(z)), np.isfinite(z)
        # Sparse channels would be mostly interpolation.
        if logged.sum() > 0.1 * len(z) and np.isfinite(m).all() and logged.sum() > 8:
            x.append(np.interp(at, at[logged], m[logged]))
            y.append(np.interp(at, at[logged], z[logged]))
    return relate(x, y, dt_s, *_ANSWER_HZ)


LIMIT = NOISE_FLOOR
"""Ratio of rms to noise up to which a judged channel counts as at the noise floor."""
_DELAY_SIGMA = 2.0
"""Standard errors by which the controls' delay must exceed its limit for a record to count as
shifted.
"""
_MAX_MOMENTS = 20
_RESPONSES = {
    "elevator": {"q_radps", "alpha_rad", "az_mps2", "theta_rad"},
    "aileron": {"p_radps", "phi_rad"},
    "rudder": {"r_radps", "beta_rad", "ay_mps2"},
}
"""Channels that show the effect of a control first."""


@dataclass(frozen=True)
class ChannelGap:
    """Gap of one channel over all segments.

    Attributes
    ----------
    rms, noise : float
        Rms of measured minus modelled, after the estimated delay, and noise, in the channel's unit.
    judged : bool
        Whether it decides the verdict. Height and heading do not: they are integrals of others and
        drift.
    allowed_s : float
        Estimated delay that was allowed for [s], 0 where none was estimated.
    shift : Shift
        Remaining delay [s]; NaN where the flight does not determine it.
    theil : Theil
        Inequality coefficient with its shares.
    answer : Relation
        The measured channel as a multiple of the modelled one.
    undefined : str
        Why the delay is NaN.
    """

    rms: float
    noise: float
    judged: bool
    allowed_s: float
    shift: Shift
    theil: Theil
    answer: Relation
    undefined: str = ""

    @property
    def slip(self) -> str:
        """Describe a wrong sign or scale of the measured channel; "" where nothing is certain."""
        return describe_slip(self.answer)

    @property
    def ratio(self) -> float:
        """Return the rms over the channel's noise; 1 is the noise floor."""
        return self.rms / self.noise


@dataclass(frozen=True)
class CoefficientGap:
    """Gap of one coefficient: rms of demanded minus predicted, rms by sensor noise alone, mean."""

    rms: float
    noise: float
    mean: float


@dataclass(frozen=True)
class Moment:
    """One of the largest residuals: time [s], channel, manoeuvre, size, and size over noise."""

    time_s: float
    channel: str
    manoeuvre: str
    gap: float
    noises: float


@dataclass(frozen=True)
class Comparison(TabularResult):
    """All gaps of one flight.

    Attributes
    ----------
    aircraft, flight : str
        What was compared.
    channels, coefficients : Mapping
        Gaps by name.
    manoeuvres, manoeuvre_coefficients : Mapping
        Label to name to rms over noise.
    moments : tuple of Moment
        The largest residuals.
    segments, outputs, measured, modelled
        Segments, channels and their (n, m) arrays, one per segment.
    demanded, predicted : list of ndarray
        Coefficients (n, 6), one array a segment.
    nuisance : Mapping
        Estimated start states, biases and delays.
    notes : tuple of str
        Sentences for the user.
    controls_late_s, controls_late_std_s : float
        Delay of the controls and its standard error [s], NaN where the flight does not determine
        it.
    late_limit_s : float
        Delay that a record allows [s]; infinite for a log, whose channels are stamped when written.
    controls_late_share : float
        Share of the gap beyond the noise that this delay removes; 1 where it is within its limit.
    """

    aircraft: str
    flight: str
    channels: Mapping[str, ChannelGap]
    coefficients: Mapping[str, CoefficientGap]
    manoeuvres: Mapping[str, Mapping[str, float]]
    manoeuvre_coefficients: Mapping[str, Mapping[str, float]]
    moments: tuple[Moment, ...]
    segments: tuple[Segment, ...]
    outputs: tuple[str, ...]
    measured: list[FloatArray]
    modelled: list[FloatArray]
    demanded: list[FloatArray]
    predicted: list[FloatArray]
    nuisance: Mapping[str, float]
    notes: tuple[str, ...]
    controls_late_s: float = 0.0
    late_limit_s: float = math.inf
    controls_late_std_s: float = 0.0
    controls_late_share: float = 1.0

    def __repr__(self) -> str:
        return (
            f"Comparison({self.aircraft!r}, {self.flight!r}, above:"
            f" {', '.join(self.above) or 'none'})"
        )

    def _facts(self) -> Mapping[str, object]:
        return {
            "reaches the noise floor": "yes" if self.reached else "no",
            "above it": ", ".join(self.above) or "none",
        }

    @property
    def aligned(self) -> bool:
        """Check that the commands of the record act when it says.

        A shift of one row would otherwise pass for a lag of every servo.
        """
        return not (
            _exceeds(self.controls_late_s, self.controls_late_std_s, self.late_limit_s)
            and self.controls_late_share > SLIP_SHARE
        )

    @property
    def slips(self) -> tuple[str, ...]:
        """Describe judged channels of wrong sign or scale, and the control that explains them."""
        slips = {c: g.slip for c, g in self.channels.items() if g.judged and g.slip}
        # Two channels that reverse with one control point at the control, not at the sensors.
        reversed_ = {c for c, text in slips.items() if text.startswith("reversed")}
        reversed_controls = [
            f"the {control} is reversed: {' and '.join(sorted(reversed_ & answers))} answer it with"
            " the opposite sign"
            for control, answers in _RESPONSES.items()
            if len(reversed_ & answers) >= 2
        ]
        return (*reversed_controls, *(f"{c} is {text}" for c, text in slips.items()))

    @property
    def reached(self) -> bool:
        """Check that the controls are aligned and every judged channel is within LIMIT of its
        noise.
        """
        return self.aligned and all(
            gap.ratio <= LIMIT for gap in self.channels.values() if gap.judged
        )

    @property
    def above(self) -> tuple[str, ...]:
        """Return the judged channels above the limit, the worst first."""
        ratios = [
            (g.ratio, c) for c, g in self.channels.items() if g.judged and not g.ratio <= LIMIT
        ]
        return tuple(c for _, c in sorted(ratios, reverse=True))

    def to_dataframe(self) -> pd.DataFrame:
        """Return the table of channels: rms, noise, ratio, whether judged, and delay [s]."""
        import pandas as pd

        rows = {
            c: {
                "rms": g.rms,
                "noise": g.noise,
                "ratio": g.ratio,
                "judged": g.judged,
                "delay_s": g.allowed_s + g.shift.seconds,
            }
            for c, g in self.channels.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("channel")

    def histories(self) -> list[History]:
        """Return the channels of each segment as measured and, ending in ``_model``, as
        replayed.
        """
        return [
            History(
                number,
                segment.flight,
                segment.label,
                segment.time_s,
                {
                    **{c: z[:, k] for k, c in enumerate(self.outputs)},
                    **{f"{c}_model": y[:, k] for k, c in enumerate(self.outputs)},
                },
            )
            for number, (segment, z, y) in enumerate(
                zip(self.segments, self.measured, self.modelled, strict=True)
            )
        ]


def compare(
    aircraft: Aircraft,
    flight: Flight,
    measured: Sequence[str],
    *,
    biases: Sequence[str] = BIASES,
    delays: Sequence[str] | None = None,
    ideal_servos: bool = False,
    workers: int | None = None,
    callback: Callback = silent,
) -> Comparison:
    """Replay a flight and measure its gap to the model.

    Parameters
    ----------
    aircraft : Aircraft
        The model.
    flight : Flight
        Ready for replay.
    measured : sequence of str
        Surfaces whose columns are positions.
    biases : sequence of str
        Channels with a constant sensor bias.
    delays : sequence of str, optional
        Channels whose delay is estimated; by default as in `identify`.
    ideal_servos : bool
        Whether surfaces and throttle follow their commands at once.
    workers : int, optional
        Processes.
    callback : callable
        Called with the name of each stage.

    Returns
    -------
    Comparison
        All gaps.

    Raises
    ------
    BadInputError
        When the model cannot fly any segment.
    """
    arm = aircraft.accelerometer_m
    cut_segments = segments(flight, measured, arm)
    # All recorded channels are compared, but only OUTPUTS decide the verdict.
    present = tuple(
        c for c in CHANNELS if c in flight.record and np.isfinite(flight.record[c]).any()
    )
    judged_channels = tuple(c for c in OUTPUTS if c in present)
    data = measured_outputs(flight, present)
    noise = channel_noise(data, present, aircraft.card.sensors.noise_std)
    ideal = tuple(c for c in CONTROLS if c not in measured) if ideal_servos else ()
    with ReplayFolder(aircraft, measured=measured, ideal=ideal) as model:
        callback("start states, biases and delays")
        # Fit the nuisance parameters to the judged channels only.
        with replay_pool(workers) as pool:
            fitted_biases = [b for b in biases if b in judged_channels]
            late = delayed([flight], judged_channels, delays)
            theta, layout_names, flyable, notes, late_std_s = _fit_starts(
                model,
                cut_segments,
                judged_channels,
                data,
                present,
                fitted_biases,
                late=late,
                pool=pool,
            )
        # Replay all channels with the estimated nuisance parameters.
        replay = Replay(model, cut_segments, layout_names, present, uuid.uuid4().hex)
        modelled = replay(theta)
        late_s = _control_delay_s(layout_names, theta)
        late_limit = late_limit_s(flight, cut_segments[0].command_s)
        share = 1.0
        if _exceeds(late_s, late_std_s, late_limit):
            # In moving air the delay of an autopilot's controls is biased, and explains little.
            is_delay = [name.endswith(f"/{CONTROL_DELAY}") for name in layout_names]
            excess, excess_at_rows = (
                _excess(outputs, data, flyable, present, judged_channels, noise)
                for outputs in (modelled, replay(np.where(is_delay, 0.0, theta)))
            )
            share = 1.0 - excess / excess_at_rows if excess_at_rows > 0.0 else 0.0
        callback("coefficients")
        with ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as direct_model:
            demand, predicted, floor = _coefficients(
                model,
                direct_model,
                flight,
                cut_segments,
                noise,
                late_s,
            )
    # Drop the segments that the model cannot fly.
    data = [d for d, ok in zip(data, flyable, strict=True) if ok]
    modelled = [y for y, ok in zip(modelled, flyable, strict=True) if ok]
    cut_segments = [s for s, ok in zip(cut_segments, flyable, strict=True) if ok]
    demand = [d for d, ok in zip(demand, flyable, strict=True) if ok]
    predicted = [d for d, ok in zip(predicted, flyable, strict=True) if ok]
    # Everything below is statistics of measured minus modelled.
    gaps = [z - y for z, y in zip(data, modelled, strict=True)]
    estimates = [c for c in judged_channels if c in flight.record.metadata.estimates]
    if estimates:
        # A vane's noise does not apply to an angle that a filter computed from other sensors.
        notes = [
            *notes,
            f"estimates of the log, listed but not in the verdict: {', '.join(estimates)}",
        ]
        judged_channels = tuple(c for c in judged_channels if c not in estimates)
    missing = [c for c in OUTPUTS if c not in present]
    if missing:
        notes = [*notes, f"not in the record and not compared: {', '.join(missing)}"]
    return Comparison(
        aircraft=aircraft.name,
        flight=flight.name,
        channels={
            c: _channel_gap(
                k,
                c,
                data,
                modelled,
                gaps,
                cut_segments,
                noise=noise,
                judged=c in judged_channels,
                allowed_s=_allowed_delay_s(layout_names, theta, c),
            )
            for k, c in enumerate(present)
        },
        coefficients={
            c: _coefficient_gap(k, demand, predicted, floor) for k, c in enumerate(COEFFICIENTS)
        },
        manoeuvres=_by_manoeuvre(cut_segments, gaps, present, noise),
        manoeuvre_coefficients=_by_manoeuvre(
            cut_segments,
            [d - s for d, s in zip(demand, predicted, strict=True)],
            COEFFICIENTS,
            dict(zip(COEFFICIENTS, floor, strict=True)),
        ),
        moments=_moments(cut_segments, gaps, judged_channels, present, noise),
        segments=tuple(cut_segments),
        outputs=present,
        measured=data,
        modelled=modelled,
        demanded=demand,
        predicted=predicted,
        nuisance=dict(zip(layout_names, theta.tolist(), strict=True)),
        notes=(*flight.notes, *notes),
        controls_late_s=late_s,
        late_limit_s=late_limit,
        controls_late_std_s=late_std_s,
        controls_late_share=share,
    )


def _exceeds(late_s: float, std_s: float, limit_s: float) -> bool:
    """Return whether the delay of the controls certainly exceeds a limit [s]."""
    return abs(late_s) - _DELAY_SIGMA * std_s > limit_s


def _excess(
    modelled: Sequence[FloatArray],
    data: Sequence[FloatArray],
    flyable: Sequence[bool],
    present: Sequence[str],
    judged_channels: Sequence[str],
    noise: Mapping[str, float],
) -> float:
    """Return the sum of squares over the noise by which the judged channels exceed the noise."""
    columns = [list(present).index(c) for c in judged_channels]
    scales = np.array([noise[c] for c in judged_channels])
    squares = np.concatenate(
        [
            np.square((z - y)[:, columns] / scales)
            for z, y, ok in zip(data, modelled, flyable, strict=True)
            if ok
        ]
    )
    return float(np.nansum(squares)) - np.count_nonzero(np.isfinite(squares))


def _fit_starts(
    model: ReplayModel,
    segments: list[Segment],
    judged_channels: Sequence[str],
    data: list[FloatArray],
    present: Sequence[str],
    biases: Sequence[str],
    *,
    late: Mapping[str, Sequence[str]],
    pool: Any,
) -> tuple[FloatArray, tuple[str, ...], list[bool], list[str], float]:
    """Estimate start states, biases and delays.

    Returns theta and its names, flags of the segments that the model can fly, notes, and the
    standard error of the controls' delay [s], NaN where the flight does not determine it.
    """
    columns = [list(present).index(c) for c in judged_channels]
    layout = nuisance_layout(
        (),
        (),
        segments,
        biases,
        judged_channels,
        late=late,
        jumping=jumping_flights(model, segments, late),
    )
    token = uuid.uuid4().hex
    # A replay without nuisance parameters shows which segments can be flown.
    plain = Replay(model, segments, (), judged_channels, token)
    flyable = [bool(np.isfinite(y).all()) for y in plain(np.zeros(0))]
    if not any(flyable):
        raise BadInputError(
            "the model diverges in every segment (its state is no longer finite); check its XML and"
            " the controls' signs"
        )
    notes = [
        f"{s.label} at {s.time_s[0]:.1f} s is omitted: the model's state diverges there"
        for s, ok in zip(segments, flyable, strict=True)
        if not ok
    ]
    flyable_segments = [s for s, ok in zip(segments, flyable, strict=True) if ok]
    flyable_data = [z[:, columns] for z, ok in zip(data, flyable, strict=True) if ok]
    # No parameter is free: this is output error of the nuisance parameters alone.
    fitted = fit_replays(
        model,
        Observed(flyable_segments, tuple(judged_channels), flyable_data, biases, late),
        (),
        [np.zeros(0)],
        (),
        pool,
    )
    fit, inner = fitted.fit, fitted.layout
    if not fit.converged:
        notes.append("start states and biases did not converge: the gaps may be too large")
    # Renumber the start states: the fit counts flyable segments only.
    number = [i for i, ok in enumerate(flyable) if ok]
    theta = np.zeros(len(layout.names))
    for name, value in zip(inner.names, fit.theta, strict=True):
        if name.startswith("start/"):
            _, k, state = name.split("/")
            name = f"start/{number[int(k)]}/{state}"
        theta[layout.names.index(name)] = value
    # Standard error of the controls' delay, if it was estimated.
    errors = [
        s for n, s in zip(inner.names, fit.std, strict=True) if n.endswith(f"/{CONTROL_DELAY}")
    ]
    return theta, layout.names, flyable, notes, float(errors[0]) if errors else math.nan


def _coefficients(
    model: ReplayModel,
    direct_model: ReplayModel,
    flight: Flight,
    segments: Sequence[Segment],
    noise: Mapping[str, float],
    late_s: float,
) -> tuple[list[FloatArray], list[FloatArray], FloatArray]:
    """Return demanded and predicted coefficients (n, 6) by segment, and the rms (6,) by noise
    alone.

    The latter is an experiment: noise is added once more to the measured channels and states.
    """
    # A fixed seed: equal input gives equal output.
    rng = np.random.default_rng(1)
    channels = [states(flight, piece) for piece in flight.pieces]
    gaps = coefficient_gaps(model, direct_model, segments, channels, noise, rng, late_s=late_s)
    demand, predicted, change = (list(part) for part in zip(*gaps, strict=True))
    return demand, predicted, noise_floor([np.concatenate(change)])


def _control_delay_s(names: Sequence[str], theta: FloatArray) -> float:
    """Return the estimated delay of the controls [s]; 0 where none was estimated."""
    ends = zip(names, theta.tolist(), strict=True)
    return float(sum(v for n, v in ends if n.endswith(f"/{CONTROL_DELAY}")))


def _allowed_delay_s(names: Sequence[str], theta: FloatArray, channel: str) -> float:
    """Return the estimated delay of a channel after the commands [s]: the controls' and its
    sensor's.
    """
    ends = (f"/{CONTROL_DELAY}", f"/{SENSOR_OF.get(channel, channel)}")
    return float(
        sum(
            v
            for n, v in zip(names, theta, strict=True)
            if n.startswith("delay/") and n.endswith(ends)
        )
    )


def _channel_gap(
    k: int,
    name: str,
    data: list[FloatArray],
    modelled: list[FloatArray],
    gaps: list[FloatArray],
    segments: list[Segment],
    *,
    noise: Mapping[str, float],
    judged: bool,
    allowed_s: float,
) -> ChannelGap:
    """Compute the gap of one channel."""
    z, y = [d[:, k] for d in data], [m[:, k] for m in modelled]
    answer = channel_response(z, y, noise[name], segments[0].dt_s)
    return ChannelGap(
        rms(np.concatenate([g[:, k] for g in gaps])),
        noise[name],
        judged,
        allowed_s,
        answer.shift,
        theil(np.concatenate(z), np.concatenate(y)),
        answer.relation,
        answer.undefined,
    )


def _coefficient_gap(
    k: int, demand: list[FloatArray], predicted: list[FloatArray], floor: FloatArray
) -> CoefficientGap:
    """Compute the gap of one coefficient."""
    gap = np.concatenate([d[:, k] - s[:, k] for d, s in zip(demand, predicted, strict=True)])
    return CoefficientGap(rms(gap), float(floor[k]), float(np.nanmean(gap)))


def _by_manoeuvre(
    segments: Sequence[Segment],
    gaps: Sequence[FloatArray],
    names: Sequence[str],
    noise: Mapping[str, float],
) -> dict[str, dict[str, float]]:
    """Return rms over noise by manoeuvre and name."""
    out = {}
    for label in dict.fromkeys(s.label for s in segments):
        pooled = np.concatenate(
            [g for s, g in zip(segments, gaps, strict=True) if s.label == label]
        )
        out[label] = {c: rms(pooled[:, k]) / noise[c] for k, c in enumerate(names)}
    return out


def _moments(
    segments: Sequence[Segment],
    gaps: Sequence[FloatArray],
    judged_channels: Sequence[str],
    present: Sequence[str],
    noise: Mapping[str, float],
) -> tuple[Moment, ...]:
    """Return the largest residuals of the judged channels."""
    moments = []
    for segment, gap in zip(segments, gaps, strict=True):
        for channel in judged_channels:
            # At most three moments of a channel and segment, one second apart.
            for at, size in largest_residuals(
                gap[:, list(present).index(channel)], segment.time_s, noise[channel], 3, 1.0
            ):
                moments.append(Moment(at, channel, segment.label, size, abs(size) / noise[channel]))
    return tuple(sorted(moments, key=lambda m: -m.noises)[:_MAX_MOMENTS])
