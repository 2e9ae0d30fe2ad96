"""Output error: maximum likelihood for measurement noise alone.

    J(theta) = 1/2 sum_i [z(i) - y(i)]' R^-1 [z(i) - y(i)] + N/2 ln det R

with R at its own maximum-likelihood value for every theta (relaxation), so that the cost followed is the concentrated
likelihood and falls at every accepted step. Klein and Morelli, "Aircraft System Identification" (2006), ch. 6;
Jategaonkar, R. V., "Flight Vehicle System Identification", 2nd ed. (2015), ch. 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.arrays import (
    FloatArray,
    as_bounds,
    as_free,
    as_names,
    as_parameters,
    as_segments,
    is_many,
)
from sysid.estimation.gaps import white_noise
from sysid.estimation.gauss_newton import Minimum, Told, minimise
from sysid.estimation.output_problem import OutputErrorProblem
from sysid.estimation.report import Findings, judge, unjudged
from sysid.estimation.result import OutputErrorFit, split
from sysid.estimation.sensitivities import MapLike, SafeSimulation, first_steps

POORLY = 0.3  # share of an output's variance left over that counts as nothing explained
FAR_OFF, WORTH = (
    5.0,
    0.01,
)  # left over: so many times the noise, such a share of the variance, to look for another minimum
HORIZONS = (0.1, 0.2, 0.4)  # shares of each segment fitted first when the whole leads nowhere


def output_error(
    simulate: Callable[[FloatArray], Any],
    theta0: ArrayLike,
    measured: Any,
    *,
    names: Sequence[str] | None = None,
    bounds: Any = None,
    free: Any = None,
    noise: str = "diagonal",
    map: MapLike | None = None,
    differences: str = "auto",
    max_iterations: int = 100,
    tolerance: float = 1e-5,
    errors: bool = True,
    told: Told | None = None,
) -> OutputErrorFit:
    """Estimate theta (k,) such that simulate(theta) comes closest to what was measured.

    Parameters
    ----------
    simulate : callable
        theta (k,) -> (n, m) array, or a list of them, one per segment, at the measured samples, in the units of `measured`. It
        may raise or return NaN at a trial point: a shorter step is tried. With a method ``moved(j)`` it says which segments
        theta[j] moves (their numbers; None: all): parameters that move different ones are perturbed in the same simulation.
    theta0 : array_like
        (k,) start; zeros are fine, but simulate(theta0) must be finite.
    measured : array_like
        (n, m) or (n,) array, or a list of them; NaN is not measured (dropout).
    names : sequence of str, optional
        k unique names; by default theta0, theta1, ...
    bounds : optional
        k pairs (lower, upper), None = open; or two vectors; or {name: (lower, upper)}.
    free : optional
        Names, indices or a mask of the parameters to estimate; the others stay at theta0.
    noise : {"diagonal", "full"}
        Independent outputs, or not.
    map : callable, optional
        Like the built-in map(function, points), e.g. a process pool's: runs the perturbed simulations.
    differences : {"auto", "central", "secant"}
        "auto" takes forward differences between the first iteration and the last ones; "secant", for smooth simulations that
        are dear, carries sensitivities on from iteration to iteration.
    max_iterations, tolerance
        Stop when the next step is shorter than `tolerance` standard errors.
    errors : bool
        False for the estimates alone: standard errors, covariances and variance inflation are then NaN, nothing is judged.
    told : callable, optional
        Called in each iteration of a descent with its number and the length of the next step in standard errors.

    Returns
    -------
    OutputErrorFit
        ``theta`` (k,), ``std`` (k,) corrected for coloured residuals (see coloured.py), ``std_crb`` (k,) the Cramer-Rao bound.
        Parameters that the data do not determine, or that end on a bound, are "not-identified": their std is NaN and
        fit.reason says why; the others are still estimated. Where it did not converge, ``converged`` and ``warnings`` say so.

    Raises
    ------
    ValueError
        When inputs disagree, theta0 lies outside the bounds, there are fewer measured values than parameters, or the simulation
        fails at theta0.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, eq. 2.4 to 2.9. V. Klein, E. A. Morelli, Aircraft System Identification, 2006.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid
    >>> t = np.linspace(0.0, 5.0, 100)
    >>> measured = 2.0 * np.exp(-0.5 * t) + 0.01 * np.sin(40.0 * t)
    >>> fit = sysid.output_error(lambda theta: theta[0] * np.exp(-theta[1] * t), [1.0, 1.0], measured)
    >>> [round(float(value), 1) for value in fit.theta]
    [2.0, 0.5]
    """
    theta = as_parameters(theta0)
    labels = as_names(names, theta.size, "theta")
    lower, upper = as_bounds(bounds, theta, labels)
    mask = as_free(free, labels)
    segments = as_segments(measured, "measured", dropouts=True)
    if noise not in ("diagonal", "full"):
        raise ValueError(f'noise is {noise!r}; allowed are "diagonal" and "full"')
    if differences not in ("auto", "central", "secant"):
        raise ValueError(
            f'differences is {differences!r}; allowed are "auto", "central" and "secant"'
        )
    stacked = np.concatenate(segments)
    counts = np.isfinite(stacked).sum(axis=0)
    if (counts == 0).any():
        raise ValueError(
            f"measured output(s) {np.flatnonzero(counts == 0).tolist()} hold no sample at all; leave them out"
        )
    columns = [int(index) for index in np.flatnonzero(mask)]
    if counts.sum() <= len(columns):
        raise ValueError(
            f"{int(counts.sum())} measured values for {len(columns)} parameters; measure more or free fewer"
        )
    with np.errstate(invalid="ignore"):
        spread = np.nanstd(stacked, axis=0)
    size = np.nanmax(np.abs(stacked), axis=0)
    spread = np.where(spread > 1e-12 * size, spread, np.where(size > 0.0, size, 1.0))

    simulation = SafeSimulation(
        simulate, tuple(part.shape[0] for part in segments), stacked.shape[1]
    )
    problem = OutputErrorProblem(
        simulation,
        stacked,
        theta,
        columns,
        (lower, upper),
        spread,
        noise == "full",
        map,
        first_steps(theta, lower, upper),
        differences == "secant",
        told,
    )
    start = problem.evaluate(theta[columns])
    if start is None:
        raise ValueError(
            f"the simulation fails at theta0: {problem.last_failure}; start from values that can be simulated"
        )
    edges = [0, *np.cumsum([part.shape[0] for part in segments]).tolist()]
    limits = (lower[columns], upper[columns])

    def descend(
        point: FloatArray, state: tuple[float, FloatArray], iterations: int, length: float
    ) -> Minimum:
        return minimise(
            problem,
            point,
            state,
            *limits,
            tolerance=length,
            max_iterations=iterations,
            always_central=differences == "central",
        )

    best = descend(theta[columns], start, max_iterations, tolerance)
    if _lost(problem, best, edges):
        other = _from_short_horizons(
            problem, theta[columns], edges, descend, max_iterations, tolerance
        )
        best = other if other is not None and other.cost < best.cost else best

    again = problem.evaluate(best.theta)
    assert again is not None
    residual = stacked - again[1]
    if not errors:
        said = unjudged(problem.noise(again[1]), len(columns))
        return _assemble(
            theta, columns, labels, best, problem, said, split(residual, edges), is_many(measured)
        )
    line = problem.settle(best.theta, again[1])
    findings = judge(
        theta=best.theta,
        gradient=line.gradient,
        sensitivity=problem.sensitivity,
        residual=residual,
        motion=again[1],
        edges=edges,
        names=tuple(labels[index] for index in columns),
        bounds=(lower[columns], upper[columns]),
        floor=problem.floor,
        full=problem.full,
        method="output error",
    )
    return _assemble(
        theta, columns, labels, best, problem, findings, split(residual, edges), is_many(measured)
    )


def _lost(problem: OutputErrorProblem, best: Minimum, edges: list[int]) -> bool:
    """Perhaps not the minimum that was meant: no output explained even to 70 %, or not converged, or, where simulations are cheap,
    an output left much further off than its white noise. Where they are dear, a descent that has not converged but explains every
    output to 70 % is no longer far off: another start would end in the same valley."""
    found = problem.evaluate(best.theta)
    if found is None or not (best.converged or problem.secant):
        return True
    residual = problem.measured - found[1]
    left = np.nanmean(residual**2, axis=0)
    if problem.secant:
        share = left / problem.spread**2
        return bool((share.min() if best.converged else share.max()) > POORLY)
    noise = np.array(
        [
            white_noise([problem.measured[a:b, k] for a, b in pairwise(edges)])
            for k in range(residual.shape[1])
        ]
    )
    with np.errstate(invalid="ignore"):
        far = (left > FAR_OFF**2 * noise**2) & (left > WORTH * problem.spread**2)
    return bool((left / problem.spread**2).min() > POORLY or far.any())


def _from_short_horizons(
    problem: OutputErrorProblem,
    theta: FloatArray,
    edges: list[int],
    descend: Callable[..., Minimum],
    max_iterations: int,
    tolerance: float,
) -> Minimum | None:
    """The minimum reached from theta (k,) by way of the first tenth, third and whole of every segment.

    Far from the truth a long simulation says little about where to go: it diverges, or swings out of phase. Its
    beginning is nearly linear in the parameters.
    """
    complete = problem.measured
    try:
        for share in HORIZONS:
            problem.measured = complete.copy()
            for first, last in pairwise(edges):
                problem.measured[first + max(int(share * (last - first)), 1) : last] = np.nan
            if not (np.isfinite(problem.measured).sum(axis=0) > theta.size).all():
                continue
            start = problem.evaluate(theta)
            if start is None:
                return None
            theta = descend(theta, start, 20, 0.1).theta
    finally:
        problem.measured = complete
    start = problem.evaluate(theta)
    return None if start is None else descend(theta, start, max_iterations, tolerance)


def _assemble(
    theta: FloatArray,
    columns: list[int],
    labels: tuple[str, ...],
    best: Any,
    problem: OutputErrorProblem,
    findings: Findings,
    residual: list[FloatArray],
    many: bool,
) -> OutputErrorFit:
    """The findings over the free parameters, spread over all of them."""
    k = theta.size
    out = theta.copy()
    out[columns] = best.theta
    cov, crb, vif = np.full((k, k), np.nan), np.full((k, k), np.nan), np.full(k, np.inf)
    cov[np.ix_(columns, columns)] = findings.cov
    crb[np.ix_(columns, columns)] = findings.cov_crb
    vif[columns] = findings.vif
    status, reason = dict.fromkeys(labels, "fixed"), dict.fromkeys(labels, "held at theta0 (free=)")
    for position, index in enumerate(columns):
        status[labels[index]] = "identified" if findings.identified[position] else "not-identified"
        reason[labels[index]] = findings.reason[position]
    warnings = list(findings.warnings)
    converged = best.converged and bool(findings.identified.any())
    if not best.converged:
        warnings.insert(0, f"not converged: {best.message}")
    elif not converged:
        warnings.insert(
            0, "not converged: no parameter is identified at the point reached; try another start"
        )
    if best.failed:
        warnings.append(
            f"{best.failed} trial point(s) could not be simulated and were rejected: {problem.last_failure}"
        )
    return OutputErrorFit(
        names=labels,
        theta=out,
        std=np.sqrt(np.diagonal(cov)),
        std_crb=np.sqrt(np.diagonal(crb)),
        cov=cov,
        cov_crb=crb,
        status=status,
        reason=reason,
        vif=vif,
        noise_cov=findings.noise.cov,
        residual=residual if many else residual[0],
        whiteness=findings.colour.p_value,
        converged=converged,
        warnings=warnings,
        iterations=best.iterations,
        n_simulations=problem.runs,
        cost=best.cost,
        cost_history=np.array(best.cost_history),
    )
