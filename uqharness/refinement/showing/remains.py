"""Where the strongest of what a refinement leaves sits: flight, stretch of time, channel, band, state, and what comes nearest.

The place is that of largest gain in `scan.loudest`, over the channels that are above their noise or coloured, on train and hold-out
flights. Where every channel is at its noise and a candidate is asked for all the same, the place is that of the candidate's own
trace in the residual. What candidates would leave is told by the linearised likelihood of the train flights, everything estimated
again beside each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import Effect, scores
from sysid.estimation import rms
from uqharness.identification.linearised import Flown, Setup
from uqharness.refinement.find import Found
from uqharness.refinement.judge import Judged, evidence_of
from uqharness.refinement.rounds import eligible
from uqharness.refinement.showing.scan import (
    BY_CHANCE,
    LEAST_SAMPLES,
    With,
    band_of,
    densest,
    goes_with,
    loudest,
)
from uqharness.refinement.showing.show import Shown
from uqharness.refinement.showing.words import would_tell

NEAREST = 3
LOOKED_AT = 12
"""Candidates of largest gain that are asked what they leave of the channel."""
NOTHING = (
    "every channel of the train and hold-out flights is at its noise, and no candidate is asked for"
)
_STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
_CONTROLS = ("elevator_deg", "aileron_deg", "rudder_deg", "throttle_pct")


@dataclass(frozen=True)
class Series:
    """One channel of one segment: residual over noise (n,) at time_s (n,), where it was measured; states at all rows."""

    flights: str
    flight: str
    manoeuvre: str
    channel: str
    white: FloatArray
    time_s: FloatArray
    states: Mapping[str, FloatArray]

    @property
    def present(self) -> FloatArray:
        """Residual at the rows at which the channel was measured."""
        return self.white[np.isfinite(self.white)]

    @property
    def rate_hz(self) -> float:
        """Measured rows a second; NaN below two."""
        t = self.time_s[np.isfinite(self.white)]
        return float((len(t) - 1) / (t[-1] - t[0])) if len(t) > 1 else float("nan")


def place_of(
    judged: Judged,
    left: Mapping[str, Sequence[str]],
    asked: Sequence[str],
    controls: Sequence[FloatArray],
) -> dict[str, Any]:
    """`remaining.place` of refinement.json where something remains.

    left      "train", "test" -> channels that are above their noise or coloured there
    asked     keys of what the train flights ask for beside the effects, or of effects that have another form than what is missing
    controls  positions in every train segment
    """
    setup, _, shown = judged.train
    other, _, fitted = judged.test
    both = series_of("train", setup, shown, controls) + series_of(
        "test", other, fitted, [s.controls for s in other.segments]
    )
    nearest = Nearest(judged.found)
    if any(left.values()):
        place, goes = where_loudest([s for s in both if s.channel in left[s.flights]])
    else:
        place, goes = _where_asked(nearest, [s for s in both if s.flights == "train"], asked[0])
    candidates, now = nearest.leaving(place["channel"], {c.key for c in judged.withdrawn})
    effects = [judged.found.effects[k] for k, _, _ in candidates]
    return place | {
        "channel_on_train": now,
        "candidates": [
            {**label(e), "name": e.name, "t": t, "leaves": leaves}
            for e, (_, t, leaves) in zip(effects, candidates, strict=True)
        ],
        "would_tell": would_tell(
            None if goes is None else goes.state, effects, _loudest_manoeuvre(both, place)
        ),
    }


def no_place(reason: str) -> dict[str, Any]:
    """The place of nothing."""
    names = (
        "flights",
        "flight",
        "manoeuvre",
        "channel",
        "from_s",
        "to_s",
        "from_Hz",
        "to_Hz",
        "rms_over_noise",
        "share_of_excess",
    )
    empty: dict[str, Any] = dict.fromkeys((*names, "p", "state", "channel_on_train", "would_tell"))
    return empty | {"candidates": [], "reason": reason, "state_reason": reason}


def series_of(
    flights: str, setup: Setup, shown: Shown, controls: Sequence[FloatArray]
) -> list[Series]:
    """Every channel of every segment of one side's flights."""
    return [
        Series(flights, s.flight, s.kind, c, w[:, k], s.time_s, states)
        for s, w, states in zip(
            setup.segments, shown.white, states_along(shown.flown, controls), strict=True
        )
        for k, c in enumerate(setup.outputs)
    ]


def states_along(flown: Flown, controls: Sequence[FloatArray]) -> list[dict[str, FloatArray]]:
    """States and controls by name, each (n,), one mapping a segment."""
    both = zip(flown.x, controls, strict=True)
    return [
        dict(zip(_STATES, x.T, strict=False)) | dict(zip(_CONTROLS, u.T, strict=False))
        for x, u in both
    ]


def where_loudest(series: Sequence[Series]) -> tuple[dict[str, Any], With | None]:
    """Place of the largest gain over noise; where chance alone would give it, the loudest channel without an interval."""
    long = [s for s in series if len(s.present) >= LEAST_SAMPLES]
    found = [(burst, s) for s in long if (burst := loudest(s.present, s.rate_hz)) is not None]
    burst, best = max(
        found, key=lambda f: f[0].gain, default=(None, max(series, key=lambda s: rms(s.white)))
    )
    alike = [s for s in series if (s.flights, s.channel) == (best.flights, best.channel)]
    goes = goes_with([s.white for s in alike], [s.states for s in alike])
    p = 1.0 if burst is None else min(1.0, burst.p * len(found))
    named = no_place("") | {
        "flights": best.flights,
        "channel": best.channel,
        "p": p,
        **_state(goes),
    }
    named["rms_over_noise"] = rms(np.concatenate([s.white for s in alike]))
    if burst is None or p > BY_CHANCE:
        return named | {
            "reason": f"no stretch and no band stands above the noise by more than chance gives (p {p:.2g})"
        }, goes
    rows = np.flatnonzero(np.isfinite(best.white))[burst.start : burst.stop]
    inside = best.white[rows]
    excess = sum(float(np.nansum(s.white**2 - np.isfinite(s.white))) for s in alike)
    held = float(np.sum(inside**2 - 1.0))
    return named | {
        "flight": best.flight,
        "manoeuvre": best.manoeuvre,
        "from_s": float(best.time_s[rows[0]]),
        "to_s": float(best.time_s[rows[-1]]),
        "from_Hz": burst.low_hz,
        "to_Hz": burst.high_hz,
        "rms_over_noise": rms(inside),
        "share_of_excess": min(held / excess, 1.0) if held > 0.0 and excess > 0.0 else None,
        "reason": None,
    }, goes


class Nearest:
    """Candidates beside the chosen effects, on the linearised likelihood of the train flights."""

    def __init__(self, found: Found) -> None:
        self.found = found
        self.evidence = evidence_of(found, list(found.effects))
        self.free = [n for n in self.evidence.names if n not in found.effects] + [
            c.key for c in found.selection.chosen
        ]
        rest = [e for e in found.effects.values() if e.key not in self.free]
        # What flew and does not stand is among the columns of the fit, beside which nothing of it would be left.
        flew = [e.key for e in rest if e.key in found.flown]
        open_ = eligible(
            [e for e in rest if e.key not in flew],
            found.setup,
            found.after.columns[0].names,
            self.evidence,
        )
        self.scores = scores(self.evidence, self.free, [*open_, *flew])

    def residual(self, *more: str, without: str = "") -> list[FloatArray]:
        """[(n, m)] residuals over noise with everything fitted beside these candidates, less one effect."""
        free = [n for n in (*self.free, *more) if n != without]
        return self.evidence.residual(self.evidence.fitted(self.evidence.index(free)))

    def trace(self, key: str) -> list[FloatArray]:
        """[(n, m)] what a candidate would explain beside the effects, or an effect does beside the others."""
        having = self.residual(*(() if key in self.free else (key,)))
        return [a - b for a, b in zip(self.residual(without=key), having, strict=True)]

    def leaving(self, channel: str, gone: set[str]) -> tuple[list[tuple[str, float, float]], float]:
        """Three candidates (key, t, rms over noise that each leaves of the channel), and what is there without any. gone: keys that
        the hold-out flights spoke against."""
        k = self.found.setup.outputs.index(channel)
        order = np.argsort(-np.nan_to_num(self.scores.gain, nan=-1.0))
        asked = [
            i for i in order if self.scores.names[i] not in gone and np.isfinite(self.scores.t[i])
        ][:LOOKED_AT]
        rows = [
            (self.scores.names[i], float(self.scores.t[i]), self._rms(k, self.scores.names[i]))
            for i in asked
        ]
        return sorted(rows, key=lambda r: r[2])[:NEAREST], self._rms(k)

    def _rms(self, k: int, *more: str) -> float:
        return rms(np.concatenate([e[:, k] for e in self.residual(*more)]))


def _where_asked(
    nearest: Nearest, series: Sequence[Series], key: str
) -> tuple[dict[str, Any], With | None]:
    """Place of what a candidate or an effect explains on the train flights: the half of it that lies closest together in time,
    and in frequency."""
    setup, trace = nearest.found.setup, nearest.trace(key)
    power = np.array([np.nansum(d**2, axis=0) for d in trace])
    k = int(np.argmax(power.sum(axis=0)))
    s = int(np.argmax(power[:, k]))
    alike = [e for e in series if e.channel == setup.outputs[k]]
    best, d = alike[s], np.nan_to_num(trace[s][:, k])
    start, stop = densest(d**2)
    low, high = band_of(d, 1.0 / setup.segments[s].dt_s)
    goes = goes_with([e[:, k] for e in trace], [e.states for e in alike], certain=True)
    return {
        "flights": "train",
        "flight": best.flight,
        "manoeuvre": best.manoeuvre,
        "channel": best.channel,
        "from_s": float(best.time_s[start]),
        "to_s": float(best.time_s[stop - 1]),
        "from_Hz": low,
        "to_Hz": high,
        "rms_over_noise": rms(np.concatenate([e.white for e in alike])),
        "share_of_excess": float(np.sum(d[start:stop] ** 2) / power[:, k].sum()),
        "p": None,
        **_state(goes),
        "reason": None,
    }, goes


def _state(goes: With | None) -> dict[str, Any]:
    if goes is None:
        return {
            "state": None,
            "state_reason": "no state and no control explains more of it than chance does",
        }
    return {"state": asdict(goes), "state_reason": None}


def label(effect: Effect) -> dict[str, str]:
    """An effect's coefficient or subsystem, and its term."""
    where = (
        {"coefficient": effect.coefficient}
        if effect.coefficient is not None
        else {"subsystem": effect.subsystem or ""}
    )
    return {**where, "term": effect.term}


def _loudest_manoeuvre(series: Sequence[Series], place: Mapping[str, Any]) -> tuple[str, float]:
    """Kind of manoeuvre in which the channel's residual is largest, and its rms over noise there."""
    mine = [s for s in series if (s.flights, s.channel) == (place["flights"], place["channel"])]
    kinds = dict.fromkeys(s.manoeuvre for s in mine)
    sizes = {
        kind: rms(np.concatenate([s.white for s in mine if s.manoeuvre == kind])) for kind in kinds
    }
    return max(sizes.items(), key=lambda size: size[1])
