"""The way through turbulence: filter error on the JSBSim model's own equations, thrust and everything else taken from JSBSim.

JSBSim cannot run under a Kalman filter, which needs a state's rate at any state; but a model that is linear in its coefficient
terms can be written in the open, with its mass, inertia and thrust read from JSBSim at the measured states.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import NOISE_START, NOISY, STATE_STD, OpenEquations, as_logged, split_name
from sysid.aerodynamics.equations import OUTPUTS, STATES
from sysid.estimation.filter_error import filter_error
from uqharness.errors import BadInputError
from uqharness.identification.result import Identification
from uqharness.identification.start import forced_at
from uqharness.replay import Flight, ReplayModel, states
from uqharness.simulator import engine

Array = NDArray[np.float64]
MAX_ITERATIONS, TOLERANCE = 60, 1e-2
"""Iterations of a descent at most, and the length of the step [standard errors] that ends it."""


def filter_route(
    found: Identification, model: ReplayModel, straight: ReplayModel, flights: Sequence[Flight],
    limits: Sequence[tuple[float, float]], biases: Sequence[str], told: Callable[[int, float], None] | None = None,
) -> Identification:  # fmt: skip
    """Output error's result replaced by filter error's, started from it; with a note saying so. told: as filter error has it.

    Raises BadInputError when a parameter asked for is no coefficient term.
    """
    begun = time.perf_counter()
    strange = [n for n in found.names if split_name(n) is None]
    if strange:
        raise BadInputError(
            f"filter error knows coefficient terms (aero/Cm_q and the like) alone, not {strange[0]}; use --method output-error"
        )
    fdm = model.open(0.01)
    here = [n for n in model.card.parameters if split_name(n) is not None and fdm.get_property_manager().hasNode(n)]
    terms = tuple(dict.fromkeys((*found.names, *here)))
    engine.require(fdm, terms)
    free = [n for n in found.names if found.status[n] != "not-identified"]
    values = [float(found.theta[found.names.index(n)]) if n in free else float(fdm[n]) for n in terms]
    outputs = tuple(c for c in found.outputs if c in OUTPUTS)
    biased = tuple(b for b in biases if b in outputs)
    equations: OpenEquations | None = None
    u, z, t, x0 = [], [], [], []
    pieces = [(f, p) for f in flights for p in f.pieces]
    measured = [states(flight, piece) for flight, piece in pieces]
    there = forced_at(model, straight, found.segments, measured, dict(zip(terms, values, strict=True)))
    for segment, (flight, piece), channels, (forced, variables) in zip(found.segments, pieces, measured, there, strict=True):
        equations = equations or OpenEquations(terms, biased, outputs, forced.mass)
        rest = equations.rest(forced.coefficients, variables, values)
        rho = 2.0 * forced.qbar / channels["V_mps"] ** 2
        deflections = np.column_stack([variables[k] for k in ("de", "da", "dr")])
        u.append(np.column_stack([deflections, forced.other_force, forced.other_moment, rho, rest]))
        z.append(np.column_stack([as_logged(flight.record, c, piece.rows) for c in outputs]))
        t.append(np.asarray(segment.time_s))
        x0.append(equations.start([float(channels[c][0]) for c in STATES]))
    assert equations is not None
    names = (*terms, *(f"bias/{b}" for b in biased))
    wide = dict(zip(found.names, limits, strict=True))
    try:
        fit = filter_error(
            equations.f, equations.g, x0, np.array([*values, *np.zeros(len(biased))]), u, z, t, names=list(names),
            bounds={n: wide.get(n, (-np.inf, np.inf)) for n in names},
            free=[*free, *(n for n in names if n.startswith("bias/"))], process_noise=list(NOISY),
            process_noise_start=NOISE_START, noise_start=np.array([found.noise[c] for c in outputs]), x0_std=STATE_STD,
            max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE, told=told,
        )  # fmt: skip
    except ValueError as error:
        raise BadInputError(f"filter error: {error}; use --method output-error") from None
    where = [names.index(n) for n in found.names]
    status = {n: fit.status[n] if n in free else found.status[n] for n in found.names}
    reason = {n: fit.reason[n] if n in free else found.reason[n] for n in found.names}
    kept = [i for n, i in zip(found.names, where, strict=True) if status[n] == "identified"]
    innovations = fit.residual if isinstance(fit.residual, list) else [fit.residual]
    every = (*STATES, "p_h", "h_q", "h_r", "c_u", "c_v")
    spectrum = zip(every, np.diagonal(fit.process_noise_cov), strict=True)
    gusts = ", ".join(f"{s} {np.sqrt(q):.3g}" for s, q in spectrum if q > 0)
    note = (
        "the residuals of output error showed process noise (turbulence), which it does not allow for: these are the estimates of "
        f"filter error on the same model's equations (process noise per root second: {gusts or 'none'}); time histories show its "
        "one-step predictions"
    )
    columns = [found.outputs.index(c) for c in outputs]
    return replace(
        found,
        theta=np.array([
            fit.theta[i] if status[n] == "identified" else start
            for n, i, start in zip(found.names, where, found.initial, strict=True)
        ]),
        std=fit.std[where], std_crb=fit.std_crb[where], status=status, reason=reason, cov=fit.cov[np.ix_(kept, kept)],
        nuisance={n: (float(fit.theta[i]), float(fit.std[i])) for i, n in enumerate(names) if n.startswith("bias/")},
        outputs=outputs, measured=[m[:, columns] for m in found.measured],
        modelled=[m - e for m, e in zip(z, innovations, strict=True)], residual=list(innovations), whiteness=fit.whiteness,
        method="filter error", converged=fit.converged, warnings=tuple(w for w in fit.warnings if not w.startswith("bias/")),
        notes=(*found.notes, note), simulations=found.simulations + fit.n_simulations,
        seconds=found.seconds + time.perf_counter() - begun,
    )  # fmt: skip
