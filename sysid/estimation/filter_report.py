"""From the filter's optimum to a FilterErrorFit: bounds, gate, warnings."""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation.coloured import coloured_information
from sysid.estimation.diagnostics import colour, colour_warnings
from sysid.estimation.ekf import Record
from sysid.estimation.gauss_newton import Minimum
from sysid.estimation.identifiability import assess, masked_covariance
from sysid.estimation.innovations import FilterProblem
from sysid.estimation.report import at_bound, idle_bound, outward
from sysid.estimation.result import FilterErrorFit


def assemble(
    problem: FilterProblem,
    best: Minimum,
    labels: tuple[str, ...],
    low: FloatArray,
    high: FloatArray,
    record: Record,
    many: bool,
) -> FilterErrorFit:
    """Bounds, gate and warnings at the optimum."""
    layout = problem.layout
    again = problem.evaluate(best.theta)
    assert again is not None
    line = problem.settle(best.theta, again[1])
    held = outward(best.theta, line.gradient, low, high)
    inside = np.flatnonzero(~held)
    every_name = layout.names(labels)
    gate = assess(line.information[np.ix_(inside, inside)], tuple(every_name[i] for i in inside))
    pieces, whites = problem.whitened(again[1])
    # (MK) of coloured.py for the innovations' share of the information; the covariances' share is left as it is.
    sensitivities = [piece[:, :, inside] for piece in pieces]
    plain = np.zeros((inside.size, inside.size))
    for piece in sensitivities:
        flat = np.nan_to_num(piece).reshape(-1, inside.size)
        plain += flat.T @ flat
    bracket = (
        coloured_information(sensitivities, whites)
        + line.information[np.ix_(inside, inside)]
        - plain
    )
    total, k_free = best.theta.size, layout.columns.size
    cov, crb, vif = (
        np.full((total, total), np.nan),
        np.full((total, total), np.nan),
        np.full(total, np.inf),
    )
    at = np.ix_(inside, inside)
    cov[at] = masked_covariance(gate.inverse @ bracket @ gate.inverse, gate.identified)
    crb[at] = masked_covariance(gate.inverse, gate.identified)
    vif[inside] = gate.vif
    reason = [""] * total
    for position, index in enumerate(inside.tolist()):
        reason[index] = gate.reason[position]
    for index in np.flatnonzero(held).tolist():
        reason[index] = at_bound(best.theta[index], low[index], high[index])
    for index in range(k_free):
        reason[index] = reason[index] or idle_bound(
            float(np.sqrt(cov[index, index])), high[index] - low[index]
        )
    identified = np.array([not text for text in reason])
    cov, crb = masked_covariance(cov, identified), masked_covariance(crb, identified)

    theta, q, r, x0 = layout.unpack(best.theta, problem.initial)
    k = theta.size
    spread_cov, spread_crb, spread_vif = (
        np.full((k, k), np.nan),
        np.full((k, k), np.nan),
        np.full(k, np.inf),
    )
    block = np.ix_(layout.columns, layout.columns)
    spread_cov[block], spread_crb[block] = cov[:k_free, :k_free], crb[:k_free, :k_free]
    spread_vif[layout.columns] = vif[:k_free]
    status, why = dict.fromkeys(labels, "fixed"), dict.fromkeys(labels, "held at theta0 (free=)")
    warnings = [note for note in gate.notes if any(name in note for name in labels)]
    for position, index in enumerate(layout.columns):
        status[labels[index]] = "not-identified" if reason[position] else "identified"
        why[labels[index]] = reason[position]
        if reason[position]:
            warnings.append(f"{labels[index]} not identified: {reason[position]}")
    if not best.converged:
        warnings.insert(0, f"not converged: {best.message}")
    found = colour(whites)
    ratio = np.sqrt(np.diagonal(cov)[:k_free]), np.sqrt(np.diagonal(crb)[:k_free])
    warnings += colour_warnings(found, *ratio, "filter error")
    innovation = [again[1].base.raw[:length, :, s] for s, length in enumerate(record.lengths)]
    q_std = np.full(q.size, np.nan)
    q_std[layout.noisy] = np.sqrt(np.diagonal(cov)[k_free : k_free + layout.noisy.size])
    return FilterErrorFit(
        names=labels,
        theta=theta,
        std=np.sqrt(np.diagonal(spread_cov)),
        std_crb=np.sqrt(np.diagonal(spread_crb)),
        cov=spread_cov,
        cov_crb=spread_crb,
        status=status,
        reason=why,
        vif=spread_vif,
        noise_cov=np.diag(r**2),
        residual=innovation if many else innovation[0],
        whiteness=found.p_value,
        converged=best.converged,
        warnings=warnings,
        iterations=best.iterations,
        n_simulations=problem.runs,
        cost=best.cost,
        cost_history=np.array(best.cost_history),
        process_noise_cov=np.diag(q),
        process_noise_std=q_std,
        x0=[x0[:, s] for s in range(x0.shape[1])],
    )
