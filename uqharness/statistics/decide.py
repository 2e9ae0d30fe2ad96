"""Sequential decision: is the excursion rate of a cell acceptable?

A cell is one condition with all its corners. "yes": every corner's rate is below the threshold;
"no": some corner's is above. The error rate holds however often the evidence is examined. Only one
of the two answers can be wrong in a given cell, so each may use the cell's full error rate:

* "no" needs evidence against "all corners are at or below the threshold". The mean of the corners'
  e-values is an e-value for that hypothesis, whatever their dependence, so picking a corner costs
  nothing.
* "yes" needs evidence from every corner. It is wrong only if a corner above the threshold passes,
  so the number of corners costs nothing.

Aborted flights are tested in the same way. "yes" needs both tests, each at half the error rate: of
excursions and of aborted flights per hour flown, where the time that an aborted flight did not fly
is charged at the tested rate. "no" takes a weighted mean of both e-values.

Corners share their air. The flights of one corner must be independent of each other, and a corner
with an answer is not flown again. `uqharness.campaign` calls `begin`, `add`, `decide_cell` and
`close` in this order.
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
"""Weight of aborted flights in the evidence for "no"."""


@dataclass(frozen=True)
class Question:
    """What is to be decided, in mean excursions per flight (rate times duration).

    Attributes
    ----------
    threshold : float
        Acceptable mean.
    zone : tuple of two floats
        Indifference zone around it: a corner shown to lie within is not flown further, its answer
        stays open.
    dispersion : float
        Variance over mean that is allowed for.
    error_rate : float
        Of one cell, or of each corner with ``every_corner``.
    every_corner : bool
        Answer for every corner.
    loss_threshold : float
        Acceptable mean of aborted flights.
    """

    threshold: float
    zone: tuple[float, float]
    dispersion: float
    error_rate: float
    every_corner: bool = False
    loss_threshold: float = np.inf


@dataclass(frozen=True)
class Evidence:
    """Evidence of the flights of one cell, per corner (c,).

    Attributes
    ----------
    flights : array (c,)
        Number of flights.
    total, squares : array (c,)
        Excursions, with an upper bound for failed flights, and the sum of their squares.
    bets, bets_zone : array (c, bets)
        Log factors against the threshold and against the zone's lower end, from lower counts.
    aborted, bets_lost : array (c,), (c, bets)
        Aborted flights, and log factors against their threshold.
    missing : array (c,)
        Sum of the shares of time not flown.
    ended : array (c,)
        Largest count of a flight that ended early.
    answers : tuple of str
        Of each corner; "" while it is flown.
    cell, reason : str
        Answer of the cell, and why it is open.
    """

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
        """Whether each corner is to be flown further."""
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
    """Return the evidence before the first flight."""
    zeros, bets = np.zeros(corners), bet_logs(np.zeros((corners, 1)), 1.0).sum(axis=1) * 0.0
    return Evidence(zeros, zeros, zeros, bets, bets, zeros, bets, zeros, zeros, ("",) * corners)


def add(
    evidence: Evidence,
    question: Question,
    low: FloatArray,
    high: FloatArray,
    aborted_flights: FloatArray | None = None,
    missing: FloatArray | None = None,
) -> Evidence:
    """Add the flights of one round.

    Parameters
    ----------
    evidence : Evidence
        Before the round.
    question : Question
        Thresholds.
    low, high : array (c, k)
        Least and most excursions of each flight of the open corners, NaN elsewhere.
    aborted_flights : array (c, k), optional
        1 where a flight was aborted.
    missing : array (c, k), optional
        Share of time that a flight did not fly.

    Returns
    -------
    Evidence
        After the round.
    """
    # Corners that are decided fly no more: their rows count nothing.
    has_flown = np.isfinite(high)
    counted, upper = np.where(has_flown, low, 0.0), np.where(has_flown, high, 0.0)
    time_missing = np.where(has_flown, 0.0 if missing is None else missing, 0.0)

    def earned(counts: FloatArray, mean: float) -> FloatArray:
        """Sum the log factors of a round against a mean."""
        log_earnings: FloatArray = np.where(
            has_flown[..., None], bet_logs(counts + mean * time_missing, mean), 0.0
        ).sum(axis=1)
        return log_earnings

    # Lower counts for the lower side; charge the time not flown at the tested mean.
    bets, zone = earned(counted, question.threshold), earned(counted, question.zone[0])
    aborted = np.where(has_flown, 0.0 if aborted_flights is None else aborted_flights, 0.0)
    bets_lost = np.zeros_like(bets)
    if np.isfinite(question.loss_threshold):
        bets_lost = earned(aborted, question.loss_threshold)
    return replace(
        evidence,
        aborted=evidence.aborted + aborted.sum(axis=1),
        bets_lost=evidence.bets_lost + bets_lost,
        missing=evidence.missing + time_missing.sum(axis=1),
        ended=np.maximum(
            evidence.ended, np.where(time_missing > 0.0, upper, 0.0).max(axis=1, initial=0.0)
        ),
        flights=evidence.flights + has_flown.sum(axis=1),
        total=evidence.total + upper.sum(axis=1),
        squares=evidence.squares + (upper**2).sum(axis=1),
        bets=evidence.bets + bets,
        bets_zone=evidence.bets_zone + zone,
    )


def decide_cell(evidence: Evidence, question: Question) -> Evidence:
    """Answer the corners that the evidence decides, then the cell. An answer is never revised.

    Parameters
    ----------
    evidence : Evidence
        So far.
    question : Question
        Thresholds and error rate.

    Returns
    -------
    Evidence
        With answers.
    """
    if evidence.cell:
        return evidence
    threshold, halved_threshold = -np.log(question.error_rate), -np.log(question.error_rate / 2.0)
    # The excursions of a flight that ended early count as one cluster (`rates`).
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
    # "yes" needs excursions and aborted flights below their thresholds.
    acceptable = below(question.threshold)
    if np.isfinite(question.loss_threshold):
        # A flight is aborted at most once, so its dispersion is at most 1.
        unit_dispersion, limit = np.ones_like(evidence.aborted), question.loss_threshold
        acceptable &= (
            log_e_below(
                evidence.flights, evidence.aborted, limit, unit_dispersion, 1.0, evidence.missing
            )
            >= halved_threshold
        )
        above = evidence_of_either(above, log_e_above(evidence.bets_lost))
    # Within the indifference zone: below its upper end and above its lower end.
    marginal = below(question.zone[1]) & (log_e_above(evidence.bets_zone) >= threshold)
    answers = list(evidence.answers)
    for corner in np.flatnonzero(evidence.open):
        if question.every_corner and above[corner] >= threshold:
            answers[corner] = NO
        elif acceptable[corner]:
            answers[corner] = YES
        elif marginal[corner]:
            answers[corner] = OPEN
    # "no" needs the mean of the corners' e-values above 1/error rate.
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
    """Combine the log evidence that one of two means is too large, by a weighted mean.

    Any fixed weights are valid; most of the weight is on excursions, which are more frequent.
    """
    log_e: FloatArray = np.logaddexp(
        excursions + np.log(1.0 - LOSS_WEIGHT), losses + np.log(LOSS_WEIGHT)
    )
    return log_e


def close(evidence: Evidence) -> Evidence:
    """Close the evidence at the end of the flights.

    Undecided corners are open; one corner above the threshold decides its cell.
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
