"""Select effects by stepwise regression on the linearised likelihood.

A candidate enters if three conditions hold. Its gain in 2 ln L exceeds the gain required of it by
more than any other's. Its |t|, corrected for coloured residuals, exceeds the critical value for the
largest of all candidates (Sidak). Two parts of the flights agree on its value. Then selected
effects may be exchanged or removed. Candidates that explain nearly as much are its alternatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile
from sysid.effects import tuned
from sysid.effects.catalogue import TWINS
from sysid.effects.information import (
    DEPENDENT,
    Information,
    column_correlations,
    compare_parts,
    corrected_estimate,
    corrected_estimates,
    project_out,
    score_tests,
)

DRAWS, DRAW_PARTS = 40_000, 8
MAX_EFFECTS = 6
MAX_RUNNERS_UP = 12
MAX_ENTRY_ATTEMPTS = 3
MAX_ALTERNATIVES = 3
LEAST_FOR_SPREAD = 5
"""Other candidates whose median |t| measures the spread: of five, two may be true effects."""


@dataclass(frozen=True)
class Alternative:
    """Another candidate that explains the same residual.

    Attributes
    ----------
    key : str
    gain : float
        Its gain in the effect's place.
    t_beside : float
        The effect's t with the alternative in the model.
    likeness : float
        Correlation of the two.
    separable : bool
        Whether the data distinguish them.
    companions : tuple of str
        Terms that were estimated with the alternative in that comparison.
    """

    key: str
    gain: float
    t_beside: float
    likeness: float
    separable: bool
    companions: tuple[str, ...] = ()


@dataclass(frozen=True)
class SelectedEffect:
    """A selected effect.

    Attributes
    ----------
    key : str
    value, std, t : float
        Estimate, standard error for coloured residuals, and their ratio.
    gain : float
        Increase of 2 ln L.
    confirmed_gain, difference : float
        Gain on the part of the flights that did not estimate it (the smaller of the two), and
        difference of the two estimates in standard errors; NaN with one part.
    alternatives : tuple of Alternative
    """

    key: str
    value: float
    std: float
    t: float
    gain: float
    confirmed_gain: float
    difference: float
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class RejectedCandidate:
    """The best candidate that was rejected, and the reason.

    Attributes
    ----------
    strong : bool
        Whether its |t| is so large that the model lacks something.
    unconfirmed : bool
        Whether parts of the flights contradict each other about its value.
    """

    key: str
    t: float
    gain: float
    reason: str
    strong: bool = False
    unconfirmed: bool = False


@dataclass(frozen=True)
class Selection:
    """Result of a selection.

    Attributes
    ----------
    chosen : tuple of SelectedEffect
        The strongest first.
    refusals : tuple of RejectedCandidate
        The candidates that were rejected last, the best first; little alike.
    trail : tuple of str
        The steps in words.
    """

    chosen: tuple[SelectedEffect, ...]
    refusals: tuple[RejectedCandidate, ...] = ()
    trail: tuple[str, ...] = ()

    @property
    def refused(self) -> RejectedCandidate | None:
        """The best candidate that was rejected last."""
        return self.refusals[0] if self.refusals else None

    @property
    def values(self) -> dict[str, float]:
        """Values of the effects by key."""
        return {c.key: c.value for c in self.chosen}

    @property
    def gain(self) -> float:
        """Sum of the effects' gains, each beside the others."""
        return sum(c.gain for c in self.chosen)

    def with_each(self, change: Callable[[SelectedEffect], SelectedEffect]) -> Selection:
        """Return the selection with each effect changed."""
        return replace(self, chosen=tuple(map(change, self.chosen)))


def sidak_critical_t(candidates: int, family: float = tuned.FAMILY_ERROR_RATE) -> float:
    """Return the |t| that the largest of independent candidates exceeds with probability ``family``
    if the model lacks nothing (Sidak).
    """
    return -float(normal_quantile(0.5 * (1.0 - (1.0 - family) ** (1.0 / max(candidates, 1)))))


def critical_t_of(
    information: Information,
    free: Sequence[str],
    candidates: Sequence[str],
    family: float = tuned.FAMILY_ERROR_RATE,
) -> float:
    """Return the |t| that the largest of the candidates exceeds with probability ``family`` if the
    model lacks nothing.

    It is drawn from the candidates' correlation, with the free columns projected out. It is never
    above Sidak's value, which holds for independent candidates.
    """
    informative = [
        k
        for k, share in zip(
            candidates, score_tests(information, free, candidates).share, strict=True
        )
        if share > DEPENDENT
    ]
    if len(informative) < 2:
        return sidak_critical_t(len(informative), family)
    projected_information, _ = project_out(
        *information.total, information.index(free), information.index(informative)
    )
    size = np.sqrt(np.diagonal(projected_information))
    values, vectors = np.linalg.eigh(projected_information / np.outer(size, size))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).astype(np.float32)
    rng = np.random.default_rng(len(informative))
    parts = (
        rng.standard_normal((DRAWS // DRAW_PARTS, len(informative)), np.float32) @ root.T
        for _ in range(DRAW_PARTS)
    )
    largest = np.concatenate([np.abs(part).max(axis=1) for part in parts])
    return min(
        sidak_critical_t(len(informative), family), float(np.quantile(largest, 1.0 - family))
    )


def select(
    information: Information,
    free: Sequence[str],
    required_gains: Mapping[str, float],
    *,
    chosen: Sequence[str] = (),
    critical_t: float | None = None,
    empirical: bool = False,
    decisive_t: float = np.inf,
) -> Selection:
    """Select effects.

    Parameters
    ----------
    information : Information
        Normal equations of all columns.
    free : sequence of str
        Columns that are always estimated.
    required_gains : mapping
        Candidate to the gain in 2 ln L that is required of it.
    chosen : sequence of str
        Effects at the start, which may be exchanged or removed.
    critical_t : float, optional
        Smallest |t| of an effect, by default `critical_t_of`.
    empirical : bool
        Whether |t| must also exceed critical_t, at most Sidak's value, times the spread of the
        other candidates' t (Efron, JASA 99, 2004), which is one for noise alone.
    decisive_t : float
        |t| of an entering effect that ends the selection.

    Returns
    -------
    Selection
    """
    if critical_t is None:
        critical_t = critical_t_of(information, free, list(required_gains))
    search = _Stepwise(information, free, required_gains, critical_t, empirical)
    current, trail = list(chosen), list[str]()
    refusals: tuple[RejectedCandidate, ...] = ()
    for _ in range(3 * MAX_EFFECTS):
        before, refusals = list(current), ()
        search.exchange(current, trail)
        search.prune(current, trail)
        entering = search.entering(current) if len(current) < MAX_EFFECTS else ()
        if isinstance(entering, tuple):
            refusals = entering
        else:
            current.append(entering.key)
            trail.append(f"+ {entering.key} t {entering.t:.1f} gain {entering.gain:.0f}")
            if abs(entering.t) > decisive_t:
                break
        if current == before:
            break
    return Selection(
        estimate_selected(information, free, current, list(required_gains)), refusals, tuple(trail)
    )


@dataclass(frozen=True)
class _Stepwise:
    """Steps of `select`; they change the keys ``current`` and append a line to ``trail``."""

    information: Information
    free: Sequence[str]
    required_gains: Mapping[str, float]
    critical_t: float
    empirical: bool

    def penalised_gains(self, selected: Sequence[str], keys: Sequence[str]) -> FloatArray:
        """Return the gain of each candidate beside other effects, less the one required of it."""
        gain = score_tests(self.information, [*self.free, *selected], keys).gain
        required = np.array([self.required_gains[k] for k in keys])
        return np.nan_to_num(gain - required, nan=-np.inf)

    def exchange(self, current: list[str], trail: list[str]) -> None:
        """Replace each selected effect by a candidate that explains more in its place."""
        for k, key in enumerate(current):
            keys = [c for c in self.required_gains if c not in current or c == key]
            gain = self.penalised_gains([*current[:k], *current[k + 1 :]], keys)
            best = int(np.argmax(gain))
            if keys[best] != key and gain[best] > gain[keys.index(key)] + tuned.SIGNIFICANT_Z**2:
                current[k] = keys[best]
                trail.append(f"{key} -> {keys[best]}")

    def prune(self, current: list[str], trail: list[str]) -> None:
        """Remove the weakest effect until all |t| reach critical_t; a single effect stays."""
        while len(current) > 1:
            estimates = corrected_estimates(self.information, [*self.free, *current], current)
            t = [abs(value / std) for value, std, _ in estimates.values()]
            worst = int(np.argmin(t))
            if t[worst] >= self.critical_t:
                break
            trail.append(f"- {current.pop(worst)} t {t[worst]:.1f}")

    def entering(self, current: Sequence[str]) -> SelectedEffect | tuple[RejectedCandidate, ...]:
        """Return the candidate that enters, or those that are rejected.

        If the flights contradict each other about the best candidate, another missing effect may
        bias it: candidates with little correlation to it (`UNRELATED_CORRELATION`) are tried next.
        It is tried again after one of them has entered.
        """
        keys = [c for c in self.required_gains if c not in current]
        refusals: list[RejectedCandidate] = []
        for _ in range(MAX_ENTRY_ATTEMPTS):
            best = self.best_candidate(current, keys)
            if isinstance(best, SelectedEffect):
                return best
            if best is not None:
                refusals.append(best)
            if best is None or not best.unconfirmed:
                break
            alike = column_correlations(self.information, [*self.free, *current], best.key, keys)
            keys = [
                k
                for k, a in zip(keys, alike, strict=True)
                if k != best.key and abs(np.nan_to_num(a)) < tuned.UNRELATED_CORRELATION
            ]
        return tuple(refusals)

    def best_candidate(
        self, current: Sequence[str], keys: Sequence[str]
    ) -> SelectedEffect | RejectedCandidate | None:
        """Return the candidate of largest penalised gain, or its rejection."""
        gain, critical_t = self.penalised_gains(current, keys), self.critical_t
        if not np.isfinite(gain).any():
            return None
        free = [*self.free, *current]
        best, *runners_up = np.argsort(-gain)[:MAX_RUNNERS_UP].tolist()
        choice = _estimate_one(self.information, free, keys[best])
        if not abs(choice.t) > critical_t:
            # Colour may increase the standard error of one candidate more than of the next.
            next_best = (
                _estimate_one(self.information, free, keys[k])
                for k in runners_up
                if gain[k] >= critical_t**2
            )
            choice = next((c for c in next_best if abs(c.t) > critical_t), choice)
        t, z = abs(choice.t), float(np.sqrt(choice.gain))
        refused = RejectedCandidate(choice.key, choice.t, choice.gain, "")
        if not t > critical_t:
            return replace(refused, reason=f"|t| {t:.1f} is not above {critical_t:.1f}")
        others = [k for k in keys if k != choice.key]
        dispersion = self.dispersion([*free, choice.key], others)
        # Errors of the gust model are in critical_t already; the spread is of what chance gives.
        chance_t = min(critical_t, sidak_critical_t(len(self.required_gains)))
        if not z > chance_t * dispersion:
            reason = (
                f"|t| {z:.1f} is not above {chance_t:.1f} times {dispersion:.2f},"
                " the spread of the others"
            )
            return replace(refused, reason=reason)
        if choice.confirmed_gain <= 0.0 and abs(choice.difference) > tuned.SIGNIFICANT_Z:
            # If the parts agree, t contains all evidence. A candidate that is estimated alone may
            # be slightly biased in both parts.
            reason = (
                "two parts of the flights differ in it by"
                f" {abs(choice.difference):.1f} standard errors"
            )
            strong = not self.empirical and t > critical_t + tuned.SIGNIFICANT_Z
            return replace(refused, reason=reason, strong=strong, unconfirmed=True)
        return choice

    def dispersion(self, free: Sequence[str], keys: Sequence[str]) -> float:
        """Return the spread of candidates' t, at least 1; 1 where only noise is counted.

        With the candidate in question among the ``free`` columns: a true effect changes the t of
        all that resemble it, in a few flights more than their median ignores. Fewer than
        `LEAST_FOR_SPREAD` other candidates have no spread.
        """
        if not self.empirical:
            return 1.0
        t = np.abs(score_tests(self.information, free, keys).t) if keys else np.zeros(0)
        t = t[np.isfinite(t)]
        if len(t) < LEAST_FOR_SPREAD:
            return 1.0
        return max(1.0, float(np.median(t)) / normal_quantile(0.75))


def estimate_selected(
    information: Information, free: Sequence[str], keys: Sequence[str], candidates: Sequence[str]
) -> tuple[SelectedEffect, ...]:
    """Estimate the effects ``keys`` jointly, and find the alternatives of each among the
    candidates.

    Returns the strongest effect first.
    """
    unselected = [k for k in candidates if k not in keys]
    out = []
    for key in keys:
        free_beside = [*free, *(o for o in keys if o != key)]
        out.append(
            _with_alternatives(
                information, free_beside, _estimate_one(information, free_beside, key), unselected
            )
        )
    return tuple(sorted(out, key=lambda c: -c.gain))


def _estimate_one(information: Information, free: Sequence[str], key: str) -> SelectedEffect:
    """Estimate an effect beside the free columns, without alternatives."""
    value, std, white_std = corrected_estimate(information, free, key)
    gain = float(score_tests(information, free, [key]).gain[0])
    confirmed = difference = float("nan")
    if (confirming := information.confirming) is not None:
        confirmed, difference = compare_parts(information, free, key, ~confirming)
        confirmed = min(confirmed, compare_parts(information, free, key, confirming)[0])
        # Colour increases the parts' standard errors like that of all flights.
        difference *= white_std / std
    return SelectedEffect(key, value, std, value / std, gain, confirmed, difference)


def _companions(
    information: Information, free: Sequence[str], companions: Sequence[str]
) -> list[str]:
    """Return the terms to estimate together with a confounded effect.

    They are the given ones, and for each selected effect in roll or yaw the same term about the
    other axis, because a wrong product of inertia couples the two.
    """
    if not companions:
        return []
    axes = ("effect/Cl/", "effect/Cn/"), ("effect/Cn/", "effect/Cl/")
    swapped = [o.replace(a, b) for o in free for a, b in axes if o.startswith(a)]
    return [
        c
        for c in dict.fromkeys((*companions, *swapped))
        if c in information.names and c not in free
    ]


def _with_alternatives(
    information: Information, free: Sequence[str], choice: SelectedEffect, unselected: Sequence[str]
) -> SelectedEffect:
    """Add the candidates that explain nearly as much in the effect's place.

    Inseparable ones come first, then those of larger gain.
    """
    if not unselected:
        return choice
    # Candidates of comparable gain, and the effect's twins.
    gains = np.nan_to_num(score_tests(information, free, unselected).gain, nan=-np.inf)
    least_gain = min(tuned.COMPARABLE_SHARE * choice.gain, choice.gain - tuned.SIGNIFICANT_Z**2)
    strongest = np.argsort(-gains)[:MAX_RUNNERS_UP].tolist()
    places = [i for i in strongest if gains[i] > least_gain]
    places += [
        i
        for i, k in enumerate(unselected)
        if (choice.key, k) in TWINS and i not in places and np.isfinite(gains[i])
    ]
    keys = [unselected[i] for i in places]
    correlations = column_correlations(information, free, choice.key, keys)
    effect_information = float(score_tests(information, free, [choice.key]).information[0])
    # The effect's t beside its rival is corrected for coloured residuals like that of the effect
    # alone.
    colour = abs(choice.t) / np.sqrt(choice.gain) if choice.gain > 0 else 1.0
    rows = []
    for i, key, correlation in zip(places, keys, correlations, strict=True):
        companions = _companions(information, free, TWINS.get((choice.key, key), ()))
        scores = score_tests(information, [*free, key, *companions], [choice.key])
        t = float(np.nan_to_num(scores.t[0])) * colour
        share = float(np.nan_to_num(scores.information[0])) / effect_information
        separable = not abs(t) < tuned.SIGNIFICANT_Z and not (
            companions and share < tuned.INSEPARABLE_SHARE
        )
        rows.append(
            Alternative(key, float(gains[i]), t, float(correlation), separable, tuple(companions))
        )
    # List physically equivalent causes before other forms of the same term: the effect's twins,
    # then those of the nearest alternative.
    twins = {key for one, key in TWINS if one == choice.key}
    alike = [r for r in rows if not r.separable]
    nearest = next((a.key for a in alike if a.key not in twins), "")
    alike.sort(key=lambda a: (a.key not in twins, a.key != nearest, (nearest, a.key) not in TWINS))
    separable_rows = [r for r in rows if r.separable]
    return replace(choice, alternatives=(*alike[: MAX_ALTERNATIVES - 1], *separable_rows[:1]))


# Intervals of a selected effect, conditional on its selection.
#
# An effect is selected because its |t| is large, so estimates little above critical_t are biased
# away from zero. Z ~ N(theta, 1) that is observed only if |Z| > c has a truncated normal
# distribution. The interval holds every theta under which the observation lies in neither tail of
# that distribution (Lee, Sun, Sun and Taylor, Annals of Statistics 44, 2016, section 5). Far above
# critical_t it equals the ordinary interval.

_SEARCH_RANGE = 40.0
"""Limit of the search for theta, in standard errors."""


def conditional_interval(value: float, std: float, critical_t: float) -> tuple[float, float]:
    """Return the 95 % interval of an effect, selected because |value / std| > ``critical_t``.

    It is the ordinary interval if ``critical_t`` is NaN or |t| does not exceed it, and NaN if
    ``std`` is not positive.
    """
    if not (std > 0.0 and math.isfinite(value) and math.isfinite(std)):
        return math.nan, math.nan
    tail = 0.5 * (1.0 - 0.95)
    t = abs(value) / std
    if not t > critical_t:
        reach = -float(special.ndtri(tail)) * std
        return value - reach, value + reach

    def excess(theta: float, share: float) -> float:
        """Return the conditional probability beyond t minus a share."""
        # P(|Z| > c, Z > t) and P(|Z| > c), as upper tails, in logarithms: they may underflow.
        above = special.log_ndtr(theta - t)
        tails = special.log_ndtr([theta - critical_t, -critical_t - theta])
        return float(np.exp(above - np.logaddexp(*tails))) - share

    ends = (
        optimize.brentq(excess, -min(_SEARCH_RANGE, 8.0 + t), t + 8.0, (share,), xtol=1e-10)
        for share in (tail, 1.0 - tail)
    )
    low, high = (theta * std for theta in ends)
    return (low, high) if value > 0.0 else (-high, -low)
