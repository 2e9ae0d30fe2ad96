"""Which candidates are in the data: forward selection with exchange and removal on the linearised
likelihood, by a fixed rule.

A candidate enters when it explains most (gain less its odds), when its t, corrected for the colour
of what it leaves, stands above what the largest of all candidates reaches by chance (Sidak), and
when two parts of the flights do not contradict each other in it. What it replaces is taken out
again. Candidates without which the answer would be as likely are its alternatives."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from sysid.distributions import normal_quantile
from sysid.effects.catalogue import TWINS
from sysid.effects.score import (
    DEPENDENT,
    Evidence,
    agreement,
    corrected,
    corrected_each,
    likeness,
    projected,
    scores,
)
from sysid.effects.tuned import COMPARABLE, DIFFERENT, FAMILY, INSEPARABLE_SHARE, UNLIKE

DRAWS, DRAWN_IN = 40_000, 8
LOOKED_AT = 12
TURNS = 3
MOST_ALTERNATIVES = 3


@dataclass(frozen=True)
class Alternative:
    """Another candidate for the same residual: its gain in the effect's place, the effect's t
    beside it, correlation of the two.

    companions: terms left free beside it when the two were distinguished
    """

    key: str
    gain: float
    t_beside: float
    likeness: float
    separable: bool
    companions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Choice:
    """One effect: estimate, corrected and white standard error, t, gain, agreement with the
    confirming part (gain there, difference)."""

    key: str
    value: float
    std: float
    t: float
    gain: float
    confirmed_gain: float
    difference: float
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class Refusal:
    """The best candidate that did not enter, and why. strong: it stands well above chance, so
    something is there; unconfirmed: parts of the flights contradict each other in it."""

    key: str
    t: float
    gain: float
    why: str
    strong: bool = False
    unconfirmed: bool = False


@dataclass(frozen=True)
class Selection:
    """What the choice came to: effects in order of choice, the candidate refused if any, and the
    steps in words.
    """

    chosen: tuple[Choice, ...]
    refused: Refusal | None = None
    trail: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Values of the effects by key, in order of choice."""
        return {c.key: c.value for c in self.chosen}


def threshold(candidates: int, family: float = FAMILY) -> float:
    """|t| that the largest of so many candidates exceeds with probability ``family`` when nothing
    is there (Sidak).
    """
    return -float(normal_quantile(0.5 * (1.0 - (1.0 - family) ** (1.0 / max(candidates, 1)))))


def chance_limit(
    evidence: Evidence, free: Sequence[str], candidates: Sequence[str], family: float = FAMILY
) -> float:
    """|t| that the largest of the candidates exceeds with probability ``family`` when nothing is
    there.

    Candidates resemble each other, so the largest of 400 is the largest of fewer: drawn from their
    own correlation, what the free columns take up removed. Never above Sidak's limit, which is for
    candidates that have nothing in common."""
    known = [
        k
        for k, share in zip(candidates, scores(evidence, free, candidates).share, strict=True)
        if share > DEPENDENT
    ]
    if len(known) < 2:
        return threshold(len(known), family)
    left, _ = projected(*evidence.everything, evidence.index(free), evidence.index(known))
    size = np.sqrt(np.diagonal(left))
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).astype(np.float32)
    rng = np.random.default_rng(len(known))
    parts = (
        rng.standard_normal((DRAWS // DRAWN_IN, len(known)), np.float32) @ root.T
        for _ in range(DRAWN_IN)
    )
    largest = np.concatenate([np.abs(part).max(axis=1) for part in parts])
    return min(threshold(len(known), family), float(np.quantile(largest, 1.0 - family)))


def select(
    evidence: Evidence,
    free: Sequence[str],
    candidates: Mapping[str, float],
    chosen: Sequence[str] = (),
    most: int = 6,
    limit: float | None = None,
    empirical: bool = False,
    alone: float = np.inf,
) -> Selection:
    """Choose effects.

    free        columns that are estimated in any case; candidates: key -> odds
    chosen      effects to begin with, which may be exchanged or removed again
    limit       smallest |t| of an effect (default: chance_limit)
    empirical   whether |t| must also exceed the limit times the standard deviation of all
                candidates' t (Efron, JASA 99, 2004), which is one for noise alone
    alone       |t| from which one that enters is the last to do so
    """
    limit = chance_limit(evidence, free, list(candidates)) if limit is None else limit
    here: list[str] = list(chosen)
    trail: list[str] = []
    refused: Refusal | None = None
    for _ in range(3 * most):
        before = list(here)
        _exchange(evidence, free, candidates, here, trail)
        _prune(evidence, free, here, trail, limit)
        refused = None
        if len(here) < most:
            rest = [c for c in candidates if c not in here]
            found = _entering(evidence, [*free, *here], rest, candidates, limit, empirical)
            if isinstance(found, Refusal):
                refused = found
            elif found is not None:
                here.append(found.key)
                trail.append(f"+ {found.key} t {found.t:.1f} gain {found.gain:.0f}")
                if abs(found.t) > alone:
                    break
        if here == before:
            break
    return Selection(judged(evidence, free, here, list(candidates)), refused, tuple(trail))


def judged(
    evidence: Evidence, free: Sequence[str], here: Sequence[str], candidates: Sequence[str]
) -> tuple[Choice, ...]:
    """The effects ``here`` as they stand, each beside the others, with alternatives among the
    candidates; the strongest first.
    """
    open_ = [k for k in candidates if k not in here]
    out = []
    for key in here:
        others = [*free, *(o for o in here if o != key)]
        out.append(_with_alternatives(evidence, others, _judged(evidence, others, key), open_))
    return tuple(sorted(out, key=lambda c: -c.gain))


def _judged(evidence: Evidence, free: Sequence[str], key: str) -> Choice:
    value, std, _ = corrected(evidence, free, key)
    gain = float(scores(evidence, free, [key]).gain[0])
    there = difference = float("nan")
    if (confirming := evidence.confirming) is not None:
        there, difference = agreement(evidence, free, key, ~confirming)
        there = min(there, agreement(evidence, free, key, confirming)[0])
    return Choice(key, value, std, value / std, gain, there, difference)


def _entering(
    evidence: Evidence,
    free: Sequence[str],
    open_: Sequence[str],
    odds: Mapping[str, float],
    limit: float,
    empirical: bool,
) -> Choice | Refusal | None:
    """The candidate to enter. One in which the flights contradict each other may be disturbed by
    another that is missing as well: those that do not resemble it are then asked; it comes to its
    turn again beside them."""
    first: Refusal | None = None
    for _ in range(TURNS):
        found = _best(evidence, free, open_, odds, limit, empirical)
        if not (isinstance(found, Refusal) and found.unconfirmed):
            return found if isinstance(found, Choice) else first or found
        first = first or found
        alike = likeness(evidence, free, found.key, open_)
        open_ = [
            k
            for k, a in zip(open_, alike, strict=True)
            if k != found.key and abs(np.nan_to_num(a)) < UNLIKE
        ]
    return first


def _best(
    evidence: Evidence,
    free: Sequence[str],
    open_: Sequence[str],
    odds: Mapping[str, float],
    limit: float,
    empirical: bool,
) -> Choice | Refusal | None:
    found = scores(evidence, free, open_)
    merit = np.nan_to_num(found.gain - np.array([odds[k] for k in open_]), nan=-np.inf)
    if not np.isfinite(merit).any():
        return None
    # A candidate that is really there moves few of the others: their median does not know of it.
    spread = (
        max(1.0, float(np.nanmedian(np.abs(found.t))) / normal_quantile(0.75)) if empirical else 1.0
    )
    best, *next_ = np.argsort(-merit)[:LOOKED_AT].tolist()
    choice = _judged(evidence, free, open_[best])
    if not abs(choice.t) > limit:
        # Colour may weigh on one candidate more than on the next.
        others = (_judged(evidence, free, open_[k]) for k in next_ if merit[k] >= limit**2)
        choice = next((c for c in others if abs(c.t) > limit), choice)
        if not abs(choice.t) > limit:
            return Refusal(
                choice.key,
                choice.t,
                choice.gain,
                f"|t| {abs(choice.t):.1f} is not above {limit:.1f}",
            )
    if not np.sqrt(choice.gain) > limit * spread:
        why = (
            f"|t| {np.sqrt(choice.gain):.1f} is not above {limit:.1f} times {spread:.2f}, the"
            " spread of all candidates"
        )
        return Refusal(choice.key, choice.t, choice.gain, why)
    if choice.confirmed_gain <= 0.0 and abs(choice.difference) > DIFFERENT:
        # Where the parts agree, all that they say of it together is in its t; one that fits both is
        # somewhat off, being alone.
        why = (
            f"two parts of the flights differ in it by {abs(choice.difference):.1f} standard errors"
        )
        return Refusal(
            choice.key,
            choice.t,
            choice.gain,
            why,
            not empirical and abs(choice.t) > limit + DIFFERENT,
            True,
        )
    return choice


def _exchange(
    evidence: Evidence,
    free: Sequence[str],
    odds: Mapping[str, float],
    here: list[str],
    trail: list[str],
) -> None:
    """Every chosen effect against every other candidate in its place."""
    for k, key in enumerate(here):
        others = [*free, *here[:k], *here[k + 1 :]]
        open_ = [c for c in odds if c not in here or c == key]
        merit = np.nan_to_num(
            scores(evidence, others, open_).gain - np.array([odds[c] for c in open_]), nan=-np.inf
        )
        best = int(np.argmax(merit))
        if open_[best] != key and merit[best] > merit[open_.index(key)] + DIFFERENT**2:
            here[k] = open_[best]
            trail.append(f"{key} -> {open_[best]}")


def _prune(
    evidence: Evidence, free: Sequence[str], here: list[str], trail: list[str], limit: float
) -> None:
    """The weakest effect below the limit taken out, again and again; one that is alone stays."""
    while len(here) > 1:
        t = [
            abs(value / std)
            for value, std, _ in corrected_each(evidence, [*free, *here], here).values()
        ]
        worst = int(np.argmin(t))
        if t[worst] >= limit:
            break
        trail.append(f"- {here.pop(worst)} t {t[worst]:.1f}")


def _companions(evidence: Evidence, others: Sequence[str], named: Sequence[str]) -> list[str]:
    """Terms to be left free beside a confounded effect: those named, and for every effect in roll
    or yaw that stands the same one about the other axis, because a wrong product of inertia turns
    the one into the other."""
    if not named:
        return []
    both = ("effect/Cl/", "effect/Cn/"), ("effect/Cn/", "effect/Cl/")
    swapped = [o.replace(a, b) for o in others for a, b in both if o.startswith(a)]
    return [c for c in dict.fromkeys((*named, *swapped)) if c in evidence.names and c not in others]


def _with_alternatives(
    evidence: Evidence, others: Sequence[str], choice: Choice, open_: Sequence[str]
) -> Choice:
    """The effect with the candidates that would do nearly as well in its place, the best first;
    inseparable ones before.
    """
    if not open_:
        return choice
    gains = np.nan_to_num(scores(evidence, others, open_).gain, nan=-np.inf)
    alone = float(scores(evidence, others, [choice.key]).information[0])
    least = min(COMPARABLE * choice.gain, choice.gain - DIFFERENT**2)
    near = [i for i in np.argsort(-gains)[:LOOKED_AT].tolist() if gains[i] > least]
    near += [
        i
        for i, k in enumerate(open_)
        if (choice.key, k) in TWINS and i not in near and np.isfinite(gains[i])
    ]
    rows = []
    for i, same in zip(
        near, likeness(evidence, others, choice.key, [open_[i] for i in near]), strict=True
    ):
        key = open_[i]
        companions = _companions(evidence, others, TWINS.get((choice.key, key), ()))
        beside = scores(evidence, [*others, key, *companions], [choice.key])
        # White t of the effect beside its rival, brought to the colour of the residuals by the
        # ratio found for the effect alone.
        t = float(np.nan_to_num(beside.t[0])) * (
            abs(choice.t) / np.sqrt(choice.gain) if choice.gain > 0 else 1.0
        )
        kept = float(np.nan_to_num(beside.information[0])) / alone
        inseparable = abs(t) < DIFFERENT or (bool(companions) and kept < INSEPARABLE_SHARE)
        rows.append(
            Alternative(key, float(gains[i]), t, float(same), not inseparable, tuple(companions))
        )
    # Causes that physics makes alike before a third form of the same: those of the effect, then of
    # the nearest alternative.
    kin = {key for one, key in TWINS if one == choice.key}
    alike = [r for r in rows if not r.separable]
    nearest = next((a.key for a in alike if a.key not in kin), "")
    together = sorted(
        alike,
        key=lambda a: (
            0 if a.key in kin else 1 if a.key == nearest else 2 if (nearest, a.key) in TWINS else 3
        ),
    )
    return replace(
        choice,
        alternatives=(*together[: MOST_ALTERNATIVES - 1], *[r for r in rows if r.separable][:1]),
    )


# Intervals of an effect that was named because its |t| was large: conditional on having been
# chosen.
#
# What stands out does so by its truth and by luck, so that a value and its plain interval are
# too large where |t| is little above the limit. With Z ~ N(theta, 1) seen only if |Z| > c, its
# distribution is the normal one cut at -c and c; the interval holds every theta under which
# what was seen is neither in the lower nor in the upper tail (Lee, Sun, Sun and Taylor, Annals
# of Statistics 44, 2016, section 5). Well above the limit it is the plain interval.

_FAR = 40.0
"""Standard errors beyond which nothing is looked for."""


def conditional_interval(
    value: float, std: float, limit: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Interval of an effect estimated at ``value`` +/- ``std`` and named because |value / std| is
    above ``limit``.

    Without a limit (NaN), or where |t| is not above it, the plain interval. NaN where std is no
    positive number."""
    if not (std > 0.0 and math.isfinite(value) and math.isfinite(std)):
        return math.nan, math.nan
    tail = 0.5 * (1.0 - confidence)
    t = abs(value) / std
    if not t > limit:
        reach = -float(special.ndtri(tail)) * std
        return value - reach, value + reach

    def excess(theta: float, share: float) -> float:
        # P(|Z| > c, Z > t) and P(|Z| > c): upper tails, which keep their figures where they are
        # small.
        above, beyond = (
            special.ndtr(theta - t),
            special.ndtr(theta - limit) + special.ndtr(-limit - theta),
        )
        return float(above / beyond) - share

    ends = (
        optimize.brentq(excess, -min(_FAR, 8.0 + t), t + 8.0, (share,), xtol=1e-10)
        for share in (tail, 1.0 - tail)
    )
    low, high = (theta * std for theta in ends)
    return (low, high) if value > 0.0 else (-high, -low)
