"""How clearly flights show a hidden effect: |t| of the true term in output error, errors corrected
for coloured residuals.

What the effect does to the outputs, d = y(with) - y(without), less whatever the nuisance could have
made of it (the aircraft's own parameters, each segment's start state, each flight's gyro biases),
is what an estimator told the truth has to go by:

    d_perp = d - S (S'S)^-1 S'd,     |t| = |d_perp|^2 / sqrt(d_perp' Rvv d_perp)      in units of
    the noise

with the identity for Rvv where residuals are white. For a term that enters linearly this is |size|
/ std of output error with every parameter free; it is defined for tables, dead zones and sensors
too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation.coloured_residuals import coloured_information
from tests.helpers.sixdof import TABLE_2_6
from tests.hidden_effects.effects import PLACES, Effect
from tests.hidden_effects.flights import NOISE, Flight, Flown, sensed, substeps
from tests.hidden_effects.manoeuvres import Manoeuvre
from tests.hidden_effects.motion import History, Model, integrate

OUTPUTS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
REPLAY_STEP_S = (
    0.01  # sensitivities need no more: servos are exact, and what is compared has the same step
)
ABSENT = (
    "CZ_q",
    "Cm_dr",
    "Cl_de",
    "Cn_de",
)  # carried at zero: an effect if the data want them, no parameter
PARAMETERS = tuple(n for n in TABLE_2_6 if n not in ABSENT)
_STARTS = 8  # u v w p q r phi theta
_MOVES = np.array([1e-2, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])


@dataclass(frozen=True)
class Strength:
    """|t| of each effect beside the other; ``share`` of it that the parameters leave, 0 .. 1; rms
    of d in units of the noise.
    """

    t: float
    share: float
    gap: float


def strengths(
    flights: Sequence[Flight],
    flown: Sequence[Flown],
    corrected: bool = False,
    step_s: float = REPLAY_STEP_S,
) -> list[Strength]:
    """Of each effect of the flights (the same in all, at one sample rate), the others counting as
    nuisance.

    corrected: with the colour of the residuals that a still-air model of the truth leaves in these
    records (turbulence)."""
    effects = flights[0].effects
    without = [effects[:i] + effects[i + 1 :] for i in range(len(effects))]
    columns, changes, residual = _sensitivities(flights, flown, without, corrected, step_s)
    return [
        _Nuisance(_beside(columns, changes, i), residual).judge([c[i] for c in changes])
        for i in range(len(effects))
    ]


def strengths_alone(
    flights: Sequence[Flight],
    flown: Sequence[Flown],
    candidates: Sequence[Effect],
    corrected: bool = False,
    step_s: float = REPLAY_STEP_S,
) -> list[Strength]:
    """Of each candidate by itself in these flights, in which it does not act: what |t| its size
    would have.
    """
    with_it = [(*flights[0].effects, e) for e in candidates]
    columns, changes, residual = _sensitivities(flights, flown, with_it, corrected, step_s)
    nuisance = _Nuisance(columns, residual)
    return [nuisance.judge([c[i] for c in changes]) for i in range(len(candidates))]


def _sensitivities(
    flights: Sequence[Flight],
    flown: Sequence[Flown],
    variants: Sequence[tuple[Effect, ...]],
    corrected: bool,
    step_s: float,
) -> tuple[list[FloatArray], list[list[FloatArray]], list[FloatArray] | None]:
    """Of each segment: columns (n, m, k) of the nuisance, changes (n, m) between its effects and
    each variant, residual.
    """
    pieces = [
        _Piece(f, told, m, variants)
        for f, told in zip(flights, flown, strict=True)
        for m in f.card.manoeuvres
    ]
    widths = len(PARAMETERS) + _STARTS * len(pieces) + 3 * len(flights)
    changes, columns, residual = [], [], []
    for at, (piece, (y, others, S)) in enumerate(
        zip(pieces, _replayed(pieces, step_s), strict=True)
    ):
        scale = np.array([piece.flight.card.noise * NOISE[c] for c in OUTPUTS])
        whole = np.zeros((*y.shape, widths))
        whole[:, :, : len(PARAMETERS)] = S[:, :, : len(PARAMETERS)]
        start = len(PARAMETERS) + _STARTS * at
        whole[:, :, start : start + _STARTS] = S[:, :, len(PARAMETERS) :]
        bias = widths - 3 * len(flights) + 3 * [f is piece.flight for f in flights].index(True)
        for axis in range(3):
            whole[:, 5 + axis, bias + axis] = 1.0
        changes.append([(y - other) / scale for other in others])
        columns.append(whole / scale[None, :, None])
        if corrected:
            residual.append(
                (np.column_stack([piece.flown.record[c][piece.rows] for c in OUTPUTS]) - y) / scale
            )
    return columns, changes, residual if corrected else None


class _Nuisance:
    """What an effect has to stand out from: columns S (n, m, k) a segment and, in turbulence, the
    residual that is left of them.
    """

    def __init__(self, columns: list[FloatArray], residual: list[FloatArray] | None) -> None:
        self.S, self.left, self.size = columns, None, np.ones(columns[0].shape[1])
        if residual is not None:  # R is re-estimated: the residual's own variance
            theta = self._fit(residual)
            left = [r - part @ theta for r, part in zip(residual, self.S, strict=True)]
            self.size = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))
            self.left = [part / self.size for part in left]
            self.S = [part / self.size[None, :, None] for part in self.S]
        flat = [part.reshape(-1, part.shape[2]) for part in self.S]
        self.inverse = _inverse(np.asarray(sum(f.T @ f for f in flat)))

    def _fit(self, blocks: list[FloatArray]) -> FloatArray:
        flat = [part.reshape(-1, part.shape[2]) for part in self.S]
        return np.asarray(
            _inverse(np.asarray(sum(f.T @ f for f in flat)))
            @ sum(f.T @ d.ravel() for f, d in zip(flat, blocks, strict=True))
        )

    def judge(self, change: list[FloatArray]) -> Strength:
        d = [part / self.size for part in change]
        theta = self.inverse @ sum(
            part.reshape(-1, part.shape[2]).T @ e.ravel() for part, e in zip(self.S, d, strict=True)
        )
        perp = [e - part @ theta for e, part in zip(d, self.S, strict=True)]
        square, whole = sum(float(np.sum(p**2)) for p in perp), sum(float(np.sum(p**2)) for p in d)
        if square <= 0.0:
            return Strength(0.0, 0.0, 0.0)
        spread = (
            square
            if self.left is None
            else float(coloured_information([p[:, :, None] for p in perp], self.left)[0, 0])
        )
        count = sum(p.size for p in d)
        return Strength(
            square / float(np.sqrt(spread)),
            float(np.sqrt(square / whole)),
            float(np.sqrt(whole / count)),
        )


def _beside(
    columns: list[FloatArray], changes: list[list[FloatArray]], which: int
) -> list[FloatArray]:
    """The columns with what every other effect does among them."""
    others = [i for i in range(len(changes[0])) if i != which]
    return [
        np.concatenate([c, *(d[i][:, :, None] for i in others)], axis=2)
        for c, d in zip(columns, changes, strict=True)
    ]


def _inverse(information: FloatArray) -> FloatArray:
    """Pseudo-inverse after scaling to a unit diagonal: nuisance that the flights do not show takes
    nothing up.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(information), 1e-30))
    found = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray(found * np.outer(scale, scale))


class _Piece:
    """One labelled manoeuvre of a flight: its rows and the lanes flown for it."""

    def __init__(
        self,
        flight: Flight,
        flown: Flown,
        manoeuvre: Manoeuvre,
        variants: Sequence[tuple[Effect, ...]],
    ) -> None:
        self.flight, self.flown = flight, flown
        self.dt = 1.0 / flight.card.rate_hz
        first = int(np.ceil(manoeuvre.at_s / self.dt - 1e-6))
        self.rows = slice(first, min(first + round(manoeuvre.length_s / self.dt), len(flown.x)))
        k = flight.airframe.coefficients
        every = flight.effects
        self.drive = flight.drive
        self.lanes = [(flight.airframe, every)] * (1 + _STARTS)
        self.lanes += [(flight.airframe, hidden) for hidden in variants]
        self.variants = len(variants)
        self.steps = np.array([1e-4 * max(abs(k[name]), 1e-3) for name in PARAMETERS])
        for name, step in zip(PARAMETERS, self.steps, strict=True):
            self.lanes.append((flight.airframe.with_coefficient(name, k[name] + step), every))

    def starts(self) -> FloatArray:
        x0 = np.repeat(self.flown.x[self.rows.start][:, None], len(self.lanes), axis=1)
        for i in range(_STARTS):
            x0[i, 1 + i] += _MOVES[i]
        return x0

    def commands(self, n: int) -> FloatArray:
        """(n, 4, lanes), the last one held on."""
        own = self.flown.commands[self.rows]
        return np.repeat(
            np.concatenate([own, np.repeat(own[-1:], n - len(own), axis=0)])[:, :, None],
            len(self.lanes),
            axis=2,
        )


def _replayed(
    pieces: list[_Piece], step_s: float
) -> list[tuple[FloatArray, list[FloatArray], FloatArray]]:
    """Of each piece: outputs (n, m) in still air from the true start; those of each variant;
    sensitivities (n, m, k).
    """
    n = max(p.rows.stop - p.rows.start for p in pieces)
    dt = pieces[0].dt
    commands = np.concatenate([p.commands(n) for p in pieces], axis=2)
    lanes = [lane for p in pieces for lane in p.lanes]
    model = Model(
        [a for a, _ in lanes], [e for _, e in lanes], [p.drive for p in pieces for _ in p.lanes]
    )
    x0 = np.concatenate([p.starts() for p in pieces], axis=1)
    begun = np.concatenate([np.full(len(p.lanes), p.rows.start * dt) for p in pieces])
    history = integrate(
        model,
        x0,
        commands[0],
        n,
        dt,
        substeps(dt, step_s),
        lambda j, air, x: commands[j],
        begun_s=begun,
    )
    y = _outputs(history)
    for lane, (_, hidden) in enumerate(lanes):
        for e in hidden:
            if e.subject.startswith("sensor.") and e.subject not in PLACES:
                column = OUTPUTS.index(e.subject.removeprefix("sensor."))
                y[:, column, lane] = sensed(y[:, column, lane], e, dt)
    out, at = [], 0
    for p in pieces:
        own = y[: p.rows.stop - p.rows.start, :, at : at + len(p.lanes)]
        at += len(p.lanes)
        first, parameters = 1 + _STARTS, 1 + _STARTS + p.variants
        base = own[:, :, 0]
        S = np.concatenate(
            [
                (own[:, :, parameters:] - base[:, :, None]) / p.steps,
                (own[:, :, 1:first] - base[:, :, None]) / _MOVES,
            ],
            axis=2,
        )
        out.append((base, [own[:, :, first + i] for i in range(p.variants)], S))
    return out


def _outputs(h: History) -> FloatArray:
    """(n, 11, lanes) as OUTPUTS."""
    own = np.stack(
        [h.V, h.alpha, h.beta, h.x[:, 6], h.x[:, 7], h.x[:, 3], h.x[:, 4], h.x[:, 5]], axis=1
    )
    return np.concatenate([own, h.felt], axis=1)
