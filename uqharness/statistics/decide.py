"""Is the excursion rate acceptable? Wrong no more often than stated, however often one looks.

A cell is one condition with all its corners. "yes": every corner's rate is below the threshold;
"no": some corner's is above. Only one of the two can be wrong in a given cell, so each may use the
cell's whole error rate:

* "no" asks for evidence against "all corners are at or below the threshold": the mean of the
  corners' evidence, whatever their dependence, is itself evidence of that kind, so nothing is paid
  for the corner that was picked;
* "yes" asks for evidence from every corner. It is wrong only if the corner that is in truth above
  the threshold was let pass, so nothing is paid for their number either.

The same is asked of aborted flights. "yes" needs both, each at half the error rate: of excursions
and of aborted flights per hour flown, in which the time that an aborted flight did not fly is
charged at the tested rate. "no" takes a weighted mean of the evidence of both.

Corners share their air; the arguments need the flights of one corner to be independent of each
other and a corner that has been settled never to fly again, no more. Pure: counts in, answers out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.statistics.rates import bet_logs, log_e_above, log_e_below

YES, NO, OPEN = "yes", "no", "open"
WITHIN_ZONE, USED_UP = "within the indifference zone", "all flights flown"


LOSS_WEIGHT = 0.1


@dataclass(frozen=True)
class Question:
    """What is to be settled, in mean excursions per flight (rate times duration).

    ``loss_threshold`` is that of aborted flights. ``error_rate`` is that of one cell, of each
    corner of it where ``every_corner`` is asked for. ``zone`` around the threshold: a corner shown
    to lie within is not flown further, its answer stays open."""

    threshold: float
    zone: tuple[float, float]
    dispersion: float
    error_rate: float
    every_corner: bool = False
    loss_threshold: float = np.inf


@dataclass(frozen=True)
class Evidence:
    """What the flights of one cell say so far, per corner (c,).

    ``total`` excursions with failed flights bounded from above, ``squares`` of them; logarithms of
    the ``bets`` against the threshold and of ``bets_zone`` against the zone's lower end, counted
    from below. ``lost`` flights were aborted, ``bets_lost`` against their threshold, ``missing`` is
    the sum of the shares of their time they did not fly, ``ended`` the largest count of a flight
    that ended early. ``answers``: of each corner, "" while it flies."""

    flights: FloatArray
    total: FloatArray
    squares: FloatArray
    bets: FloatArray
    bets_zone: FloatArray
    aborted: FloatArray
    bets_lost: FloatArray
    missing: FloatArray
    ended: FloatArray
    answers: tuple[str, ...]
    cell: str = ""
    reason: str = ""

    @property
    def open(self) -> NDArray[np.bool_]:
        """Corners to be flown further."""
        return np.array([answer == "" and not self.cell for answer in self.answers])

    @property
    def dispersion(self) -> FloatArray:
        """Observed variance over mean of each corner's counts."""
        n = np.maximum(self.flights, 2.0)
        mean = self.total / n
        variance = np.maximum(self.squares - n * mean**2, 0.0) / (n - 1.0)
        return np.where(
            (self.flights >= 2) & (mean > 0), variance / np.where(mean > 0, mean, 1.0), 1.0
        )


def begin(corners: int) -> Evidence:
    """No flight flown."""
    none, bets = np.zeros(corners), bet_logs(np.zeros((corners, 1)), 1.0).sum(axis=1) * 0.0
    return Evidence(none, none, none, bets, bets, none, bets, none, none, ("",) * corners)


def add(
    evidence: Evidence,
    question: Question,
    low: FloatArray,
    high: FloatArray,
    aborted_flights: FloatArray | None = None,
    missing: FloatArray | None = None,
) -> Evidence:
    """Evidence with one round more: least and most excursions (c, k) of each flight of the open
    corners, NaN elsewhere.

    ``aborted_flights`` (c, k) is 1 where a flight was aborted, ``missing`` (c, k) the share of its time that
    it did not fly; none by default."""
    has_flown = np.isfinite(high)
    counted, upper = np.where(has_flown, low, 0.0), np.where(has_flown, high, 0.0)
    absent = np.where(has_flown, 0.0 if missing is None else missing, 0.0)

    def earned(counts: FloatArray, mean: float) -> FloatArray:
        log_earnings: FloatArray = np.where(
            has_flown[..., None], bet_logs(counts + mean * absent, mean), 0.0
        ).sum(axis=1)
        return log_earnings

    bets, zone = earned(counted, question.threshold), earned(counted, question.zone[0])
    aborted = np.where(has_flown, 0.0 if aborted_flights is None else aborted_flights, 0.0)
    bets_lost = np.zeros_like(bets)
    if np.isfinite(question.loss_threshold):
        bets_lost = earned(aborted, question.loss_threshold)
    return replace(
        evidence,
        aborted=evidence.aborted + aborted.sum(axis=1),
        bets_lost=evidence.bets_lost + bets_lost,
        missing=evidence.missing + absent.sum(axis=1),
        ended=np.maximum(
            evidence.ended, np.where(absent > 0.0, upper, 0.0).max(axis=1, initial=0.0)
        ),
        flights=evidence.flights + has_flown.sum(axis=1),
        total=evidence.total + upper.sum(axis=1),
        squares=evidence.squares + (upper**2).sum(axis=1),
        bets=evidence.bets + bets,
        bets_zone=evidence.bets_zone + zone,
    )


def decide_cell(evidence: Evidence, question: Question) -> Evidence:
    """Answer what the evidence settles: corners first, then the cell. A settled answer stays."""
    if evidence.cell:
        return evidence
    threshold, halved_threshold = -np.log(question.error_rate), -np.log(question.error_rate / 2.0)
    # A flight that ended early counts as a cluster of what it had seen (rates.py).
    dispersion = np.maximum(np.maximum(evidence.dispersion, evidence.ended), question.dispersion)

    def below(mean: float) -> NDArray[np.bool_]:
        return (
            log_e_below(
                evidence.flights,
                evidence.total,
                mean,
                dispersion,
                question.dispersion,
                evidence.missing,
            )
            >= halved_threshold
        )

    above = log_e_above(evidence.bets)
    acceptable = below(question.threshold)
    if np.isfinite(question.loss_threshold):
        # A flight is aborted once: its count clusters no more than independent ones do.
        unit_dispersion, limit = np.ones_like(evidence.aborted), question.loss_threshold
        acceptable &= (
            log_e_below(
                evidence.flights, evidence.aborted, limit, unit_dispersion, 1.0, evidence.missing
            )
            >= halved_threshold
        )
        above = evidence_of_either(above, log_e_above(evidence.bets_lost))
    marginal = below(question.zone[1]) & (log_e_above(evidence.bets_zone) >= threshold)
    answers = list(evidence.answers)
    for corner in np.flatnonzero(evidence.open):
        if question.every_corner and above[corner] >= threshold:
            answers[corner] = NO
        elif acceptable[corner]:
            answers[corner] = YES
        elif marginal[corner]:
            answers[corner] = OPEN
    some_above = (
        float(np.logaddexp.reduce(above)) - np.log(above.size) >= threshold
        and not question.every_corner
    )
    cell = reason = ""
    if some_above or (all(answers) and NO in answers):
        cell = NO
    elif all(answer == YES for answer in answers):
        cell = YES
    elif all(answers):
        cell, reason = OPEN, WITHIN_ZONE
    return replace(evidence, answers=tuple(answers), cell=cell, reason=reason)


def evidence_of_either(excursions: FloatArray, losses: FloatArray) -> FloatArray:
    """Logarithm of the evidence that one of two means is too large: the weighted mean of that of
    each, for any weights.

    Most of the weight lies on excursions, of which there are more.
    """
    log_e: FloatArray = np.logaddexp(
        excursions + np.log(1.0 - LOSS_WEIGHT), losses + np.log(LOSS_WEIGHT)
    )
    return log_e


def close(evidence: Evidence) -> Evidence:
    """The end of the flights: what is not settled stays open; one corner shown to be above answers
    for its cell.
    """
    if evidence.cell:
        return evidence
    answers = tuple(answer or OPEN for answer in evidence.answers)
    return replace(
        evidence,
        answers=answers,
        cell=NO if NO in answers else OPEN,
        reason="" if NO in answers else USED_UP,
    )
