"""Is the excursion rate acceptable? Wrong no more often than stated, however often one looks.

A cell is one condition with all its corners. "yes": every corner's rate is below the threshold; "no": some corner's is above. Only
one of the two can be wrong in a given cell, so each may use the cell's whole error rate:

* "no" asks for evidence against "all corners are at or below the threshold": the mean of the corners' evidence, whatever their
  dependence, is itself evidence of that kind, so nothing is paid for the corner that was picked;
* "yes" asks for evidence from every corner. It is wrong only if the corner that is in truth above the threshold was let pass, so
  nothing is paid for their number either.

Corners share their air; the arguments need the flights of one corner to be independent of each other and a corner that has been
settled never to fly again, no more. Pure: counts in, answers out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uqharness.statistics.rates import Array, bet_logs, log_e_above, log_e_below

YES, NO, OPEN = "yes", "no", "open"
WITHIN_ZONE, USED_UP = "within the indifference zone", "all flights flown"


@dataclass(frozen=True)
class Question:
    """What is to be settled, in mean excursions per flight (rate times duration).

    ``error_rate`` is that of one cell, of each corner of it where ``every_corner`` is asked for. ``zone`` around the threshold: a
    corner shown to lie within is not flown further, its answer stays open.
    """

    threshold: float
    zone: tuple[float, float]
    dispersion: float
    error_rate: float
    every_corner: bool = False


@dataclass(frozen=True)
class Evidence:
    """What the flights of one cell say so far, per corner (c,).

    ``total`` excursions with failed flights bounded from above, ``squares`` of them; logarithms of the ``bets`` against the
    threshold and of ``bets_zone`` against the zone's lower end, counted from below. ``answers``: of each corner, "" while it flies.
    """

    flights: Array
    total: Array
    squares: Array
    bets: Array
    bets_zone: Array
    answers: tuple[str, ...]
    cell: str = ""
    reason: str = ""

    @property
    def open(self) -> NDArray[np.bool_]:
        """Corners to be flown further."""
        return np.array([answer == "" and not self.cell for answer in self.answers])

    @property
    def dispersion(self) -> Array:
        """Observed variance over mean of each corner's counts."""
        n = np.maximum(self.flights, 2.0)
        mean = self.total / n
        spread = np.maximum(self.squares - n * mean**2, 0.0) / (n - 1.0)
        return np.where((self.flights >= 2) & (mean > 0), spread / np.where(mean > 0, mean, 1.0), 1.0)


def begin(corners: int) -> Evidence:
    """No flight flown."""
    none, bets = np.zeros(corners), bet_logs(np.zeros((corners, 1)), 1.0).sum(axis=1) * 0.0
    return Evidence(none, none, none, bets, bets, ("",) * corners)


def add(evidence: Evidence, question: Question, low: Array, high: Array) -> Evidence:
    """Evidence with one round more: least and most excursions (c, k) of each flight of the open corners, NaN elsewhere."""
    flown = np.isfinite(high)
    counted, upper = np.where(flown, low, 0.0), np.where(flown, high, 0.0)
    bets = np.where(flown[..., None], bet_logs(counted, question.threshold), 0.0).sum(axis=1)
    zone = np.where(flown[..., None], bet_logs(counted, question.zone[0]), 0.0).sum(axis=1)
    return replace(
        evidence,
        flights=evidence.flights + flown.sum(axis=1),
        total=evidence.total + upper.sum(axis=1),
        squares=evidence.squares + (upper**2).sum(axis=1),
        bets=evidence.bets + bets,
        bets_zone=evidence.bets_zone + zone,
    )


def look(evidence: Evidence, question: Question) -> Evidence:
    """Answer what the evidence settles: corners first, then the cell. A settled answer stays."""
    if evidence.cell:
        return evidence
    wanted = -np.log(question.error_rate)
    dispersion = np.maximum(evidence.dispersion, question.dispersion)

    def below(mean: float) -> NDArray[np.bool_]:
        return log_e_below(evidence.flights, evidence.total, mean, dispersion, question.dispersion) >= wanted

    above = log_e_above(evidence.bets)
    acceptable = below(question.threshold)
    marginal = below(question.zone[1]) & (log_e_above(evidence.bets_zone) >= wanted)
    answers = list(evidence.answers)
    for corner in np.flatnonzero(evidence.open):
        if question.every_corner and above[corner] >= wanted:
            answers[corner] = NO
        elif acceptable[corner]:
            answers[corner] = YES
        elif marginal[corner]:
            answers[corner] = OPEN
    some_above = float(np.logaddexp.reduce(above)) - np.log(above.size) >= wanted and not question.every_corner
    cell = reason = ""
    if some_above or (all(answers) and NO in answers):
        cell = NO
    elif all(answer == YES for answer in answers):
        cell = YES
    elif all(answers):
        cell, reason = OPEN, WITHIN_ZONE
    return replace(evidence, answers=tuple(answers), cell=cell, reason=reason)


def close(evidence: Evidence) -> Evidence:
    """The end of the flights: what is not settled stays open; one corner shown to be above answers for its cell."""
    if evidence.cell:
        return evidence
    answers = tuple(answer or OPEN for answer in evidence.answers)
    return replace(evidence, answers=answers, cell=NO if NO in answers else OPEN, reason="" if NO in answers else USED_UP)
