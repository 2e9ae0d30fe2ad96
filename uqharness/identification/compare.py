"""A flight beside the model: replay by segment, gap per channel, coefficient and manoeuvre, and what the gap looks like.

The aerodynamics stay as they are. Start states of the segments and constant sensor biases are estimated, because a replay from a
start wrong by the sensors' noise misses the flight whatever the model.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Mapping, Sequence
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
from uqharness.identification.replay_fit import (
    BIASES,
    OUTPUTS,
    Observed,
    coefficient_gaps,
    fit_replays,
    jumping_in,
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
from uqharness.text_tables import Tabled

if TYPE_CHECKING:
    import pandas as pd


# How a measured channel answers the model's: sign, scale and delay, each stated only where the
# flight determines it. Pure.

MOTION_SIGMA = 1.0
"""Standard deviations of the sensor's noise that the model's motion must have, rms about a straight line, before sign, scale or
delay are looked for: below, what noise and start states have in common passes for a scale of hundreds."""
MOST_DELAY_S = 0.2
"""Delays are looked for up to this, either way."""
DELAY_STD_S = 0.25 * MOST_DELAY_S
"""Standard error above which a delay is undefined: two of them on either side are the whole range that is looked through."""
SAME = 0.33
"""By how much a channel may be larger or smaller than the model's before its unit is doubted: derivatives are that wrong."""
_ANSWER_HZ = (0.1, 2.5)
_NO_RELATION = Relation(math.nan, math.nan, math.nan, math.inf, 0.0, 0)


@dataclass(frozen=True)
class Answer:
    """relation: the measured channel as a multiple of the model's, without evidence where the model hardly moves.

    shift: delay of the measured channel, NaN where ``undefined`` says why there is none.
    """

    relation: Relation
    shift: Shift
    undefined: str = ""


def slip_of(answer: Relation) -> str:
    """Sign or scale that is wrong for sure, in words; "" when it cannot be told or is right."""
    if not answer.evident or answer.allows(1.0, SAME):
        return ""
    size = f"{answer.scale:.2f} times the model's (between {answer.low:.2f} and {answer.high:.2f})"
    return f"reversed: {size}" if answer.scale < 0.0 else f"out of scale: {size}"


def motion(modelled: Sequence[FloatArray]) -> float:
    """Rms of the model's channel about a straight line in each segment (n,); NaN without a segment that was flown through."""
    squares = []
    for y in modelled:
        if len(y) >= 8 and np.isfinite(y).all():
            at = np.arange(len(y), dtype=float)
            squares.append((y - np.polynomial.Polynomial.fit(at, y, 1)(at)) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else math.nan


def answer_of(
    measured: Sequence[FloatArray], modelled: Sequence[FloatArray], noise: float, dt_s: float
) -> Answer:
    """What a channel's segments [(n,)], measured (NaN between logged samples) and modelled, say of sign, scale and delay.

    noise: standard deviation of the measured channel, its own unit
    """
    moved = motion(modelled)
    if not moved >= MOTION_SIGMA * noise:
        return Answer(_NO_RELATION, _no_shift(), _too_little(moved / noise))
    relation = _relation(measured, modelled, dt_s)
    if slip := slip_of(relation):
        return Answer(relation, _no_shift(), slip.split(":")[0])
    shift = time_shift(measured, modelled, dt_s, MOST_DELAY_S)
    if not math.isfinite(shift.seconds):
        return Answer(relation, _no_shift(), "the model does not move")
    if not shift.std <= DELAY_STD_S:
        return Answer(relation, _no_shift(), f"its standard error is {1e3 * shift.std:.0f} ms")
    if abs(shift.seconds) >= MOST_DELAY_S:
        return Answer(relation, _no_shift(), f"no minimum within {1e3 * MOST_DELAY_S:.0f} ms")
    return Answer(relation, shift)


def _too_little(sigma: float) -> str:
    return (
        f"the model moves {sigma:.1f} sigma" if math.isfinite(sigma) else "the model does not move"
    )


def _no_shift() -> Shift:
    return Shift(math.nan, math.nan)


def _relation(
    measured: Sequence[FloatArray], modelled: Sequence[FloatArray], dt_s: float
) -> Relation:
    """Where the channel was logged, straight lines between samples."""
    x, y = [], []
    for z, m in zip(measured, modelled, strict=True):
        at, good = np.arange(len(z)), np.isfinite(z)
        if good.sum() > 0.1 * len(z) and np.isfinite(m).all() and good.sum() > 8:
            x.append(np.interp(at, at[good], m[good]))
            y.append(np.interp(at, at[good], z[good]))
    return relate(x, y, dt_s, *_ANSWER_HZ)


LIMIT = NOISE_FLOOR
"""The noise floor is reached when no judged channel's rms is above this many times its noise."""
_SURE = 2.0
"""Standard errors by which the controls' delay must pass its limit before the record counts as not aligned."""
_WORST = 20
_ANSWERS = {
    "elevator": {"q_radps", "alpha_rad", "az_mps2", "theta_rad"},
    "aileron": {"p_radps", "phi_rad"},
    "rudder": {"r_radps", "beta_rad", "ay_mps2"},
}
"""Channels that show a control's effect first."""


@dataclass(frozen=True)
class ChannelGap:
    """One channel over all segments: rms of measured minus model, noise, delay of the measured channel, Theil's coefficient.

    rms is what is left after the delay that was allowed for (``allowed_s``, 0 where none was estimated); shift is on top of it.

    answer is the measured channel as a multiple of the model's, without evidence where the model hardly moves; the delay is NaN
    where the flight does not determine it, and ``undefined`` says why. ``judged`` channels decide the verdict; height and heading
    do not (integrals of others, drifting sensors).
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
        """What is wrong with sign or scale of the measured channel against the model's, "" when nothing is for sure."""
        return slip_of(self.answer)

    @property
    def ratio(self) -> float:
        """Rms of measured minus model over the channel's noise; 1 is the noise floor."""
        return self.rms / self.noise


@dataclass(frozen=True)
class CoefficientGap:
    """One coefficient: rms of demanded minus model, rms that sensor noise alone would give, mean difference."""

    rms: float
    noise: float
    mean: float


@dataclass(frozen=True)
class Moment:
    """One of the worst moments: where, how large, in units of noise."""

    time_s: float
    channel: str
    manoeuvre: str
    gap: float
    noises: float


@dataclass(frozen=True)
class Comparison(Tabled):
    """All gaps of one flight.

    manoeuvres  label -> channel -> rms over noise        demanded, predicted  coefficients (n, 6), one array a segment
    controls_late_s  how late the controls act, estimated, and its standard error, NaN where the flight does not determine it;
    late_limit_s  what a record allows, infinite for a log, whose channels are stamped when they are written
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

    def __repr__(self) -> str:
        return f"Comparison({self.aircraft!r}, {self.flight!r}, above: {', '.join(self.above) or 'none'})"

    def _facts(self) -> Mapping[str, object]:
        return {
            "reaches the noise floor": "yes" if self.reached else "no",
            "above it": ", ".join(self.above) or "none",
        }

    @property
    def aligned(self) -> bool:
        """The record's commands act when it says they do. A row of difference would otherwise pass for a lag in every servo."""
        return not abs(self.controls_late_s) - _SURE * self.controls_late_std_s > self.late_limit_s

    @property
    def slips(self) -> tuple[str, ...]:
        """Judged channels whose sign or scale is not the model's, in words, and the control that explains it where one does."""
        wrong = {c: g.slip for c, g in self.channels.items() if g.judged and g.slip}
        reversed_ = {c for c, text in wrong.items() if text.startswith("reversed")}
        said = [
            f"the {control} is reversed: {' and '.join(sorted(reversed_ & answers))} answer it with the opposite sign"
            for control, answers in _ANSWERS.items()
            if len(reversed_ & answers) >= 2
        ]
        return (*said, *(f"{c} is {text}" for c, text in wrong.items()))

    @property
    def reached(self) -> bool:
        """Every judged channel's rms is within LIMIT times its noise, and the controls are where the record puts them."""
        return self.aligned and all(
            gap.ratio <= LIMIT for gap in self.channels.values() if gap.judged
        )

    @property
    def above(self) -> tuple[str, ...]:
        """Judged channels above the limit, the worst first."""
        found = [
            (g.ratio, c) for c, g in self.channels.items() if g.judged and not g.ratio <= LIMIT
        ]
        return tuple(c for _, c in sorted(found, reverse=True))

    def to_dataframe(self) -> pd.DataFrame:
        """The table of channels: rms of measured minus model, noise, their ratio, whether it is judged, and the delay [s]."""
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
        """Each segment's channels as measured and, ending in ``_model``, as replayed: what ``plot_overlay`` draws."""
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
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Comparison:
    """Replay a flight and measure the gap; ``on_stage`` is told what is being done.

    Raises BadInputError when the model cannot fly any segment.
    """
    arm = aircraft.accelerometer_m
    cut = segments(flight, measured, arm)
    present = tuple(
        c for c in CHANNELS if c in flight.record and np.isfinite(flight.record[c]).any()
    )
    judged = tuple(c for c in OUTPUTS if c in present)
    data = measured_outputs(flight, present)
    noise = channel_noise(data, present, aircraft.card.sensors.noise_std)
    ideal = tuple(c for c in CONTROLS if c not in measured) if ideal_servos else ()
    with ReplayFolder(aircraft, measured=measured, ideal=ideal) as model:
        on_stage("start states, biases and delays")
        with replay_pool(workers) as spread:
            wanted = [b for b in biases if b in judged]
            late = delayed([flight], judged, delays)
            theta, layout_names, kept, notes, late_std_s = _starts(
                model, cut, judged, data, present, wanted, late, spread
            )
        replay = Replay(model, cut, layout_names, present, uuid.uuid4().hex)
        modelled = replay(theta)
        on_stage("coefficients")
        with ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as straight:
            demand, said, floor = _coefficients(
                model, straight, flight, cut, noise, _control_delay_s(layout_names, theta)
            )
    data = [d for d, ok in zip(data, kept, strict=True) if ok]
    modelled = [y for y, ok in zip(modelled, kept, strict=True) if ok]
    cut = [s for s, ok in zip(cut, kept, strict=True) if ok]
    demand = [d for d, ok in zip(demand, kept, strict=True) if ok]
    said = [d for d, ok in zip(said, kept, strict=True) if ok]
    gaps = [z - y for z, y in zip(data, modelled, strict=True)]
    estimates = [c for c in judged if c in flight.record.metadata.estimates]
    if estimates:
        # A vane's noise says nothing of an angle that a filter computed from other sensors.
        notes = [*notes, f"estimates of the log, listed and not judged: {', '.join(estimates)}"]
        judged = tuple(c for c in judged if c not in estimates)
    missing = [c for c in OUTPUTS if c not in present]
    if missing:
        notes = [*notes, f"not in the record and not compared: {', '.join(missing)}"]
    return Comparison(
        aircraft=aircraft.name,
        flight=flight.name,
        channels={
            c: _channel(
                k,
                c,
                data,
                modelled,
                gaps,
                cut,
                noise,
                c in judged,
                _allowed(layout_names, theta, c),
            )
            for k, c in enumerate(present)
        },
        coefficients={c: _coefficient(k, demand, said, floor) for k, c in enumerate(COEFFICIENTS)},
        manoeuvres=_by_manoeuvre(cut, gaps, present, noise),
        manoeuvre_coefficients=_by_manoeuvre(
            cut,
            [d - s for d, s in zip(demand, said, strict=True)],
            COEFFICIENTS,
            dict(zip(COEFFICIENTS, floor, strict=True)),
        ),
        moments=_moments(cut, gaps, judged, present, noise),
        segments=tuple(cut),
        outputs=present,
        measured=data,
        modelled=modelled,
        demanded=demand,
        predicted=said,
        nuisance=dict(zip(layout_names, theta.tolist(), strict=True)),
        notes=(*flight.notes, *notes),
        controls_late_s=_control_delay_s(layout_names, theta),
        late_limit_s=late_limit_s(flight, cut[0].command_s),
        controls_late_std_s=late_std_s,
    )


def _starts(
    model: ReplayModel,
    cut: list[Segment],
    judged: Sequence[str],
    data: list[FloatArray],
    present: Sequence[str],
    biases: Sequence[str],
    late: Mapping[str, Sequence[str]],
    spread: Any,
) -> tuple[FloatArray, tuple[str, ...], list[bool], list[str], float]:
    """Start states and biases (and their names) that bring the replay nearest; which segments the model can fly; notes; standard
    error of the controls' delay [s], NaN where the flight does not determine it."""
    columns = [list(present).index(c) for c in judged]
    layout = nuisance_layout((), (), cut, biases, judged, late, jumping_in(model, cut, late))
    token = uuid.uuid4().hex
    plain = Replay(model, cut, (), judged, token)
    kept = [bool(np.isfinite(y).all()) for y in plain(np.zeros(0))]
    if not any(kept):
        raise BadInputError(
            "the model leaves the flight in every segment (its state is no longer finite); check its XML and the controls' signs"
        )
    notes = [
        f"{s.label} at {s.time_s[0]:.1f} s was left out: the model's state is no longer finite there"
        for s, ok in zip(cut, kept, strict=True)
        if not ok
    ]
    flown = [s for s, ok in zip(cut, kept, strict=True) if ok]
    wanted = [z[:, columns] for z, ok in zip(data, kept, strict=True) if ok]
    fitted = fit_replays(
        model, Observed(flown, tuple(judged), wanted, biases, late), (), [np.zeros(0)], (), spread
    )
    fit, inner = fitted.found, fitted.layout
    if not fit.converged:
        notes.append("start states and biases did not converge: the gaps may be too large")
    # Numbers of the segments flown back to numbers of all segments.
    number = [i for i, ok in enumerate(kept) if ok]
    theta = np.zeros(len(layout.names))
    for name, value in zip(inner.names, fit.theta, strict=True):
        if name.startswith("start/"):
            _, k, state = name.split("/")
            name = f"start/{number[int(k)]}/{state}"
        theta[layout.names.index(name)] = value
    errors = [
        s for n, s in zip(inner.names, fit.std, strict=True) if n.endswith(f"/{CONTROL_DELAY}")
    ]
    return theta, layout.names, kept, notes, float(errors[0]) if errors else math.nan


def _coefficients(
    model: ReplayModel,
    straight: ReplayModel,
    flight: Flight,
    cut: Sequence[Segment],
    noise: Mapping[str, float],
    late_s: float,
) -> tuple[list[FloatArray], list[FloatArray], FloatArray]:
    """Demanded and predicted coefficients (n, 6) by segment, and the rms (6,) that the sensors' noise alone gives.

    The latter by experiment: noise is added once more, to what the flight demanded and to the states the model was asked at.
    """
    rng = np.random.default_rng(1)
    every = [states(flight, piece) for piece in flight.pieces]
    found = coefficient_gaps(model, straight, cut, every, noise, rng, late_s=late_s)
    demand, said, change = (list(part) for part in zip(*found, strict=True))
    return demand, said, noise_floor([np.concatenate(change)])


def _control_delay_s(names: Sequence[str], theta: FloatArray) -> float:
    """Read the estimate of how late the controls of the flight act; 0 where none was estimated."""
    ends = zip(names, theta.tolist(), strict=True)
    return float(sum(v for n, v in ends if n.endswith(f"/{CONTROL_DELAY}")))


def _allowed(names: Sequence[str], theta: FloatArray, channel: str) -> float:
    """How late, s, the channel was let come after the commands: the controls' delay and its own sensor's."""
    ends = (f"/{CONTROL_DELAY}", f"/{SENSOR_OF.get(channel, channel)}")
    return float(
        sum(
            v
            for n, v in zip(names, theta, strict=True)
            if n.startswith("delay/") and n.endswith(ends)
        )
    )


def _channel(
    k: int,
    name: str,
    data: list[FloatArray],
    modelled: list[FloatArray],
    gaps: list[FloatArray],
    cut: list[Segment],
    noise: Mapping[str, float],
    judged: bool,
    allowed_s: float,
) -> ChannelGap:
    z, y = [d[:, k] for d in data], [m[:, k] for m in modelled]
    answer = answer_of(z, y, noise[name], cut[0].dt_s)
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


def _coefficient(
    k: int, demand: list[FloatArray], said: list[FloatArray], floor: FloatArray
) -> CoefficientGap:
    gap = np.concatenate([d[:, k] - s[:, k] for d, s in zip(demand, said, strict=True)])
    return CoefficientGap(rms(gap), float(floor[k]), float(np.nanmean(gap)))


def _by_manoeuvre(
    cut: Sequence[Segment],
    gaps: Sequence[FloatArray],
    names: Sequence[str],
    noise: Mapping[str, float],
) -> dict[str, dict[str, float]]:
    out = {}
    for label in dict.fromkeys(s.label for s in cut):
        together = np.concatenate([g for s, g in zip(cut, gaps, strict=True) if s.label == label])
        out[label] = {c: rms(together[:, k]) / noise[c] for k, c in enumerate(names)}
    return out


def _moments(
    cut: Sequence[Segment],
    gaps: Sequence[FloatArray],
    judged: Sequence[str],
    present: Sequence[str],
    noise: Mapping[str, float],
) -> tuple[Moment, ...]:
    found = []
    for segment, gap in zip(cut, gaps, strict=True):
        for channel in judged:
            for at, size in largest_residuals(
                gap[:, list(present).index(channel)], segment.time_s, noise[channel], 3, 1.0
            ):
                found.append(Moment(at, channel, segment.label, size, abs(size) / noise[channel]))
    return tuple(sorted(found, key=lambda m: -m.noises)[:_WORST])
