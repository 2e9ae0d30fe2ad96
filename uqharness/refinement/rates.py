"""At which rate limit a servo's slowness shows: nothing happens down to the fastest motion asked of it, then more and more.

One slope for all of that is right nowhere: a limit a little below the fastest motion would be estimated above it, where it does
nothing. So some limits are tried, each against the servo's own, for the one whose estimated change is the change it makes; its
column stands for the effect. Once an effect is flown, its column is the slope at the limit that flies. So are dead zones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import Choice, Columns, Gusts, Selection, corrected, scores
from uqharness.identification.linearised import HERE, NEAR, Fit, Setup, in_dead_zone, surface_change
from uqharness.refinement.round import Round, column_evidence
from uqharness.replay import CONTROLS, runs_per_row
from uqharness.simulator import Actuator

SHARES = (0.98, 0.95, 0.9, 0.85, 0.75, 0.6, 0.45, 0.3)
"""Limits tried, of the fastest motion."""
FASTER = (0.75, 0.5, 0.25, 0.0)
"""Limits tried above the servo's own: its share in the travel time of a degree, the rest that of the fastest motion."""

WIDTHS_DEG = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Dead zones tried: about as wide as the one that there is, a column has its form; a narrow one moves a surface at once."""


def limits_tried(setup: Setup, fit: Fit, gusts: Gusts | None) -> Setup:
    """The setup with the rate limit and the dead zone of each servo whose estimated change is the change it makes, by a fit without
    effects."""
    if not setup.servos:
        return setup
    tried = {surface: _asked(setup, surface, servo) for surface, servo in setup.servos.items()}
    columns = []
    for segment, p in zip(setup.segments, fit.probes, strict=True):
        inputs: dict[str, tuple[int, FloatArray]] = {}
        for surface, servo in setup.servos.items():
            k = CONTROLS.index(surface)
            moved = {
                _key(surface, x): surface_change("rate_limit", servo, segment, k, (servo.rate, x))
                for x in tried[surface]
            }
            moved |= {
                _zone(surface, width): in_dead_zone(p.controls[:, k], width) for width in WIDTHS_DEG
            }
            inputs |= {
                name: (-1, p.by_control[:, :, k] * by[:, None]) for name, by in moved.items()
            }
        columns.append(Columns(tuple(inputs), inputs, {}))
    evidence, free = column_evidence(setup, fit, columns, gusts), fit.columns[0].names
    widths, limits, zones = np.array(WIDTHS_DEG), {}, {}
    for surface, servo in setup.servos.items():
        found = scores(evidence, free, [_zone(surface, width) for width in WIDTHS_DEG])
        zone = just_so(widths, found.estimate / widths, found.t)
        if zone is not None:
            zones[surface] = zone
        found = scores(evidence, free, [_key(surface, limit) for limit in tried[surface]])
        speeds = np.array(tried[surface])
        wanted = found.estimate / (1.0 / speeds - 1.0 / servo.rate)
        strength = np.where(wanted > 0.0, np.abs(found.t), 0.0)
        side = max(
            (speeds < servo.rate, speeds > servo.rate), key=lambda s: strength[s].max(initial=0.0)
        )
        best = just_so(speeds[side], wanted[side], found.t[side])
        if best is not None:
            limits[surface] = (servo.rate, best)
    return replace(setup, limits=limits, zones=zones)


def _asked(setup: Setup, surface: str, servo: Actuator) -> list[float]:
    """Limits to try [deg/s]: below the fastest motion and the servo's own, falling; and above its own, up to the fastest motion
    without a limit, rising."""
    fastest, free = (_fastest(setup, surface, s) for s in (servo, replace(servo, rate=np.inf)))
    slower = [
        limit for share in SHARES if 1.0 < (limit := share * min(fastest, servo.rate)) < servo.rate
    ]
    # A quarter of the way and so on, in travel time per degree; at the end the limit does nothing any more.
    faster = (
        [1.0 / (share / servo.rate + (1.0 - share) / free) for share in FASTER]
        if free > servo.rate / NEAR
        else []
    )
    return [*slower, *faster]


def _key(surface: str, limit: float) -> str:
    return f"{surface}@{limit:g}"


def _zone(surface: str, width: float) -> str:
    return f"{surface}~{width:g}"


def just_so(limit: FloatArray, wanted: FloatArray, t: FloatArray) -> float | None:
    """The limit [deg/s] whose estimated share is 1; ``wanted`` (n,): estimated shares at limits (n,) further and further from the
    servo's own.

    Else the one of which they say most; None where all speaks against such a servo.
    """
    fine = np.isfinite(wanted) & (wanted > 0.0)
    if not fine.any():
        return None
    limit, share, t = limit[fine], np.log(wanted[fine]), t[fine]
    for k in range(len(limit) - 1):
        if share[k] >= 0.0 > share[k + 1]:
            return float(
                limit[k] + (limit[k + 1] - limit[k]) * share[k] / (share[k] - share[k + 1])
            )
    return float(limit[int(np.argmax(np.abs(t)))])


def _fastest(setup: Setup, surface: str, servo: Actuator) -> float:
    """Fastest motion of a surface [deg/s], from row to row."""
    k = CONTROLS.index(surface)
    return max(
        float(
            np.abs(
                np.diff(servo.follow(s.controls[:, k], s.dt_s, s.dt_s / runs_per_row(s.dt_s)))
            ).max(initial=0.0)
        )
        / s.dt_s
        for s in (segment.at_commands() for segment in setup.segments)
    )


def _surface(key: str) -> str:
    """Of which surface's servo an effect is; another text where it is of none."""
    return key.removeprefix("effect/actuator.").partition("/")[0]


def felt(chosen: Sequence[Choice], setup: Setup) -> tuple[Choice, ...]:
    """The choices, rate limits no higher than the fastest motion asked of their servo: above it any limit is the same."""

    def within(c: Choice) -> Choice:
        least = least_felt(setup, c.key)
        return c if c.value >= least else replace(c, value=least, t=least / c.std)

    return tuple(within(c) for c in chosen)


def least_felt(setup: Setup, key: str) -> float:
    """Value [s/deg] of a servo's rate limit effect below which nothing changes any more; of any other effect -inf."""
    surface = _surface(key)
    servo = setup.servos.get(surface)
    if not key.endswith("/rate_limit") or servo is None or not np.isfinite(servo.rate):
        return -np.inf
    fastest = _fastest(setup, surface, replace(servo, rate=np.inf))
    if servo.lag is not None:
        # A servo is fastest where its command jumps, and slows down to the next row.
        rows = servo.lag * setup.segments[0].at_commands().dt_s
        fastest *= rows / -np.expm1(-rows)
    return float(min(1.0 / fastest - 1.0 / servo.rate, 0.0))


def as_known_here(selection: Selection, found: Round) -> Selection:
    """Rate limits above the servos' own where their slope at the flown value has them, with the standard errors of that; where the
    flights say nothing of it, the way to the fastest motion is the error. |t|, of the whole change, stays."""

    def local(c: Choice) -> Choice:
        here = c.key + HERE
        if here not in found.evidence.names:
            return c
        least = least_felt(found.setup, c.key)
        value = found.flown[c.key]
        flown = found.evidence.taken_out({c.key: -value})
        step, std, _ = corrected(flown, [n for n in found.free if n != c.key], here)
        if not np.isfinite(std):
            return replace(c, std=max(c.std, value - least))
        return replace(c, value=float(np.clip(value + step, least, 0.0)), std=std)

    return replace(selection, chosen=tuple(map(local, selection.chosen)))


def is_fastest(choice: Choice, setup: Setup) -> bool:
    """Whether a rate limit lies within its error of the fastest motion asked of the servo, so that it may be any number above."""
    return bool(choice.value - 2.0 * choice.std <= least_felt(setup, choice.key))
