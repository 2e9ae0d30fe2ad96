"""From residual coefficients to intervals: regression on polynomials of flight states (dissertation
eqs 2.17, 2.18).

Where the pieces know their sensor noise, model error is taken apart from it (components.py): what
persists through a manoeuvre or a flight, what changes within one, and noise, which belongs to the
sensors and to no bounds. ``noise = "inside"`` keeps the published interval, of measured samples,
noise and all.

The published interval counts every sample as news. Residuals sampled at 50 Hz and filtered at some
hertz are not: n samples are worth n/tau independent ones, tau their integral time
(autocorrelation.py). By default the degrees of freedom, the residual variance and the leverage's
weight are those of the independent ones; ``samples = "all"`` is the published way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sysid.aerodynamics import (
    COEFFICIENTS,
    ResidualPiece,
    Residuals,
    Term,
    autocorrelation,
    cosine_variance,
    full_polynomial,
    noise_variance,
    regressors,
    stack,
    term_name,
)
from sysid.aerodynamics.coefficients import STATES
from sysid.arrays import FloatArray
from sysid.distributions import student_quantile
from sysid.estimation import effective_samples
from sysid.estimation.stepwise import stepwise
from sysid.model_form.components import (
    STRONG,
    Components,
    Separation,
    blocks_of,
    separate,
    stretches,
)
from sysid.model_form.model_form import CoefficientBounds, Hull, Parts

# States that a residual is regressed on, freed of sensor noise as far as their spectra tell.
#
# Noise of a channel is in a state and in the residual alike: left in the regressors, a
# regression would take one for a function of the other. In bands of frequency whose power does
# not rise above what the known noise alone gives, nothing is kept; in the others the share that
# is signal (Wiener, "Extrapolation, Interpolation and Smoothing of Stationary Time Series"
# (1949); regression calibration: Carroll et al., "Measurement Error in Nonlinear Models"
# (2006), ch. 4). A piece's mean is kept as it is.

_BANDS_HZ = np.geomspace(0.1, 25.0, 20)
_SURE = 2.0
"""Standard deviations of a band's noise power by which its power must exceed it to be signal."""


def quiet(residuals: Residuals) -> Residuals:
    """The residuals with states freed of noise; as they are where a piece does not know its
    noise.
    """
    if any(p.noise is None for p in residuals.pieces):
        return residuals
    clean = quiet_states(residuals.pieces, residuals.dt_s)
    pieces = tuple(
        replace(p, states=states) for p, states in zip(residuals.pieces, clean, strict=True)
    )
    return replace(residuals, pieces=pieces)


def quiet_states(pieces: Sequence[ResidualPiece], dt_s: float) -> list[dict[str, FloatArray]]:
    """Per piece state -> (n,) without the noise that `ResidualPiece.noise` tells of; other states
    as they are.
    """
    out = [dict(p.states) for p in pieces]
    for name in out[0]:
        if any(p.noise is None or name not in p.noise.states for p in pieces):
            continue
        for states, clean in zip(out, _quiet(pieces, name, dt_s), strict=True):
            states[name] = clean
    return out


def _quiet(pieces: Sequence[ResidualPiece], name: str, dt_s: float) -> list[FloatArray]:
    waves, noise, bands = [], [], []
    for piece in pieces:
        assert piece.noise is not None
        std, weights = piece.noise.states[name]
        n = len(piece)
        waves.append(fft.dct(piece.states[name], norm="ortho"))
        noise.append(std**2 * cosine_variance(n, autocorrelation(weights)))
        bands.append(np.digitize(np.arange(n) / (2.0 * n * dt_s), _BANDS_HZ))
    share = _signal(
        np.concatenate([w[1:] ** 2 for w in waves]),
        np.concatenate([v[1:] for v in noise]),
        np.concatenate([b[1:] for b in bands]),
    )
    return [
        fft.idct(np.concatenate([w[:1], w[1:] * share[b[1:]]]), norm="ortho")
        for w, b in zip(waves, bands, strict=True)
    ]


def _signal(power: FloatArray, noise: FloatArray, band: NDArray[np.intp]) -> FloatArray:
    """Share of signal in each band: none where noise alone explains the power.

    Each band for itself: a band of few waves may show nothing below others that hold the whole
    motion."""
    share = np.zeros(len(_BANDS_HZ) + 1)
    for k in range(len(share)):
        of_band = band == k
        count = int(of_band.sum())
        if not count:
            share[k] = share[k - 1] if k else 1.0
            continue
        ratio = float(np.mean(power[of_band]) / np.mean(noise[of_band]))
        if ratio >= 1.0 + _SURE * np.sqrt(2.0 / count):
            share[k] = 1.0 - 1.0 / ratio
    return share


LONGITUDINAL = ("V_mps", "alpha_rad", "q_radps", "theta_rad")
LATERAL = ("V_mps", "beta_rad", "p_radps", "r_radps")
MIN_SAMPLES_PER_TERM = 2.0
"""Effective samples a term needs; below, the polynomial's order is lowered rather than a residual
fitted away.
"""
_STILL = {
    "V_mps": 0.2,
    "alpha_rad": 0.002,
    "beta_rad": 0.002,
    "phi_rad": 0.006,
    "theta_rad": 0.006,
    "p_radps": 0.004,
    "q_radps": 0.004,
    "r_radps": 0.004,
    "throttle_pct": 0.5,
}
_STILL_SURFACE_DEG = 0.1
"""A state whose deviation is below this varied hardly more than filtered sensor noise (Table 2.1 of
the dissertation): a polynomial in it, and above all its growth beyond such data, would be made of
noise."""
_COLLINEAR = 1e-6  # part of a regressor's length that the ones before it must leave


@dataclass(frozen=True)
class Design:
    """What one coefficient is regressed on: states, and its terms; without terms the full
    polynomial of ``order``.
    """

    states: tuple[str, ...]
    terms: tuple[Term, ...] | None = None
    order: int = 2


def default_designs() -> dict[str, Design]:
    """Full second-order polynomials: CX CZ Cm in V, alpha, q, theta; CY Cl Cn in V, beta, p, r."""
    return {c: Design(LONGITUDINAL if c in ("CX", "CZ", "Cm") else LATERAL) for c in COEFFICIENTS}


@dataclass(frozen=True)
class FitOptions:
    """confidence of the interval; samples: how autocorrelation counts; select: all terms, or those
    a statistic asks for.

    noise: "apart" leaves the sensors' noise out of the intervals, where the residuals know it;
    "inside" is the published way."""

    confidence: float = 0.95
    samples: Literal["effective", "all"] = "effective"
    select: Literal["full", "stepwise"] = "full"
    noise: Literal["apart", "inside"] = "apart"


@dataclass(frozen=True)
class FittedBounds:
    """An interval, what is left of the residual in each piece (flight minus fit, [(n,)]), and what
    was done about its terms.

    separation: of model error from noise, block by block of `stretches`; None where noise is inside
    the interval."""

    bounds: CoefficientBounds
    left: list[FloatArray]
    notes: tuple[str, ...] = field(default=())
    separation: Separation | None = None


def fit_bounds(
    residuals: Residuals,
    designs: Mapping[str, Design] | None = None,
    options: FitOptions | None = None,
) -> dict[str, FittedBounds]:
    """Intervals of the coefficients in ``designs`` (default: all six). Raises ValueError: a missing
    state, too short a flight.

    Terms in a state that hardly varied are left out with a note; it stays in the envelope box.
    States are normalised by their mean and deviation over all samples, the same for every
    coefficient, so that coefficients with the same states share one (X'X)^-1."""
    designs, options = designs or default_designs(), options or FitOptions()
    apart = options.noise == "apart" and all(p.noise is not None for p in residuals.pieces)
    if apart:
        # Noise that is in a state and in the residual alike would pass for a function of that
        # state.
        residuals = quiet(residuals)
    states = residuals.states
    wanted = dict.fromkeys(s for d in designs.values() for s in d.states)
    missing = [s for s in wanted if s not in states]
    if missing:
        raise ValueError(
            f"these flights have no {', '.join(missing)} throughout; they have {', '.join(states)}"
        )
    scaling = {}
    for name in wanted:
        scaling[name] = (float(states[name].mean()), max(float(states[name].std()), _still(name)))
    fit = _fit_apart if apart else _fit
    return {c: fit(residuals, c, d, scaling, options) for c, d in designs.items()}


def _moving(
    coefficient: str, design: Design, scaling: Mapping[str, tuple[float, float]]
) -> tuple[tuple[Term, ...] | None, tuple[str, ...]]:
    """Terms without states that stood still (None: all orders are open), and a note saying so."""
    still = [k for k, s in enumerate(design.states) if scaling[s][1] <= _still(s)]
    if not still:
        return design.terms, ()
    names = ", ".join(design.states[k] for k in still)
    wanted = (
        design.terms
        if design.terms is not None
        else full_polynomial(len(design.states), design.order)
    )
    terms = tuple(t for t in wanted if not any(t[k] for k in still))
    them = "it" if len(still) == 1 else "them"
    note = (
        f"{coefficient}: {names} hardly varied; the bounds do not depend on {them}, and any other"
        " value is outside the data"
    )
    return terms or (tuple(0 for _ in design.states),), (note,)


def _still(state: str) -> float:
    return _STILL.get(state, _STILL_SURFACE_DEG)


def _fit(
    residuals: Residuals,
    coefficient: str,
    design: Design,
    scaling: Mapping[str, tuple[float, float]],
    options: FitOptions,
) -> FittedBounds:
    y = residuals.columns(coefficient)
    n = sum(residuals.lengths)
    open_terms, said_of_states = _moving(coefficient, design, scaling)
    asked = (
        open_terms if open_terms is not None else full_polynomial(len(design.states), design.order)
    )
    orders = [None] if design.terms is not None else range(design.order, -1, -1)
    n_effective, notes = float(n), list[str]()
    for order in orders:
        terms = asked if order is None else tuple(t for t in asked if sum(t) <= order)
        kept, said = _chosen(residuals, coefficient, design, terms, scaling, options)
        if n <= len(kept):
            continue
        x = _design_matrix(residuals, design, kept, scaling)
        left = _left(x, np.concatenate(y), residuals.lengths)
        n_effective = effective_samples(left) if options.samples == "effective" else float(n)
        if n_effective >= MIN_SAMPLES_PER_TERM * len(kept):
            if order is not None and order < design.order:
                notes.append(
                    f"{coefficient}: too short a flight for order {design.order}; order {order} was"
                    " fitted"
                )
            bounds = _bounds(
                residuals, design, kept, scaling, x, np.concatenate(y), left, n_effective, options
            )
            return FittedBounds(bounds, left, (*said_of_states, *notes, *said))
    raise ValueError(
        f"{coefficient}: {n} samples are worth {n_effective:.0f} independent ones, at least"
        f" {MIN_SAMPLES_PER_TERM:g} a term are needed; fly longer or choose fewer terms"
    )


def _fit_apart(
    residuals: Residuals,
    coefficient: str,
    design: Design,
    scaling: Mapping[str, tuple[float, float]],
    options: FitOptions,
) -> FittedBounds:
    """The interval of the model's error alone.

    Its prior holds the polynomial finite: no flight is too short for its order.
    """
    open_terms, said_of_states = _moving(coefficient, design, scaling)
    asked = (
        open_terms if open_terms is not None else full_polynomial(len(design.states), design.order)
    )
    terms, said = _chosen(residuals, coefficient, design, asked, scaling, options)
    blocks = stretches(residuals)
    x = _design_matrix(blocks, design, terms, scaling)
    separation = separate(blocks_of(blocks, coefficient, _parts(x, blocks)))
    found = separation.components()
    left = [
        y - part @ found.beta
        for y, part in zip(residuals.columns(coefficient), _parts(x, residuals), strict=True)
    ]
    n = len(x)
    n_effective = effective_samples(left)
    s2 = sum(float(e @ e) for e in left) / n
    inverse = found.covariance / (s2 * (n / n_effective))
    leverage = float(np.einsum("nj,nj->n", x @ inverse, x).max())
    noise = np.concatenate(
        [
            noise_variance(p.noise)[:, COEFFICIENTS.index(coefficient)]
            for p in residuals.pieces
            if p.noise
        ]
    )
    bounds = CoefficientBounds(
        states=design.states,
        centre=np.array([scaling[s][0] for s in design.states]),
        scale=np.array([scaling[s][1] for s in design.states]),
        terms=terms,
        beta_hat=found.beta,
        XtX_inv=inverse,
        s2=s2,
        dof=found.lasting.dof,
        t=1.0,
        confidence=options.confidence,
        leverage_factor=n / n_effective,
        n=n,
        n_effective=n_effective,
        walk_rate=float("nan"),
        hull=_hull(stack(residuals.states, design.states), leverage),
    )
    bounds = with_components(bounds, found, float(np.sqrt(noise.mean())))
    return FittedBounds(bounds, left, (*said_of_states, *said), separation)


def with_components(
    bounds: CoefficientBounds, found: Components, noise: float
) -> CoefficientBounds:
    """The interval with other components of the same terms; noise: rms of the sensors' in the
    samples as presumed [-].
    """
    parts = Parts(
        persistent=float(np.sqrt(found.persistent)),
        transient=float(np.sqrt(found.transient)),
        flight=float(np.sqrt(found.flight)),
        transient_time_s=found.time_s,
        noise=found.noise_factor * noise,
        noise_scale=found.noise_factor,
        total_dof=found.whole.dof,
        total_t=found.whole.quantile(bounds.confidence) * found.tail,
        not_above=found.not_above,
        found=found.log_odds >= STRONG,
    )
    return replace(
        bounds,
        beta_hat=found.beta,
        XtX_inv=found.covariance / (bounds.s2 * bounds.leverage_factor),
        dof=found.lasting.dof,
        t=found.lasting.quantile(bounds.confidence),
        walk_rate=parts.transient_rate_per_sqrt_s,
        parts=parts,
    )


def _parts(x: FloatArray, residuals: Residuals) -> list[FloatArray]:
    return list(np.split(x, np.cumsum(residuals.lengths)[:-1]))


def _hull(states: FloatArray, leverage: float) -> Hull:
    return Hull(
        states.min(axis=0),
        states.max(axis=0),
        leverage,
        np.percentile(states, [25, 50, 75], axis=0).T,
    )


def _design_matrix(
    residuals: Residuals,
    design: Design,
    terms: Sequence[Term],
    scaling: Mapping[str, tuple[float, float]],
) -> FloatArray:
    centre, scale = (np.array([scaling[s][k] for s in design.states]) for k in (0, 1))
    return regressors((stack(residuals.states, design.states) - centre) / scale, terms)


def _chosen(
    residuals: Residuals,
    coefficient: str,
    design: Design,
    terms: Sequence[Term],
    scaling: Mapping[str, tuple[float, float]],
    options: FitOptions,
) -> tuple[tuple[Term, ...], list[str]]:
    """Terms that the data tell apart, in order (those that a stepwise choice keeps, if asked for),
    and what was left out.
    """
    x = _design_matrix(residuals, design, terms, scaling)
    independent, basis = [], np.zeros((len(x), 0))
    for k in range(x.shape[1]):
        length = float(np.linalg.norm(x[:, k]))
        own = x[:, k] / length if length > 0.0 else x[:, k]
        for _ in range(2):
            own = own - basis @ (basis.T @ own)
        rest = float(np.linalg.norm(own))
        if rest > _COLLINEAR:
            independent.append(k)
            basis = np.column_stack([basis, own / rest])
    notes = []
    lost = [term_name(terms[k], design.states) for k in range(len(terms)) if k not in independent]
    if lost:
        notes.append(
            f"{coefficient}: the flights do not separate {', '.join(lost)} from other terms;"
            " left out"
        )
    if options.select == "stepwise":
        constant = [i for i, k in enumerate(independent) if not any(terms[k])]
        y = np.concatenate(residuals.columns(coefficient))
        chosen = stepwise(x[:, independent], y, keep=constant, segments=residuals.lengths)
        independent = [independent[i] for i in chosen.selected]
        names = ", ".join(term_name(terms[k], design.states) for k in independent)
        notes.append(f"{coefficient}: stepwise choice of {names or 'no term'} among {len(terms)}")
    return tuple(terms[k] for k in independent), notes


def _left(x: FloatArray, y: FloatArray, lengths: Sequence[int]) -> list[FloatArray]:
    """What least squares leaves of y (n,), piece by piece."""
    beta = np.linalg.lstsq(x, y, rcond=None)[0] if x.shape[1] else np.zeros(0)
    return list(np.split(y - x @ beta, np.cumsum(lengths)[:-1]))


def _bounds(
    residuals: Residuals,
    design: Design,
    terms: tuple[Term, ...],
    scaling: Mapping[str, tuple[float, float]],
    x: FloatArray,
    y: FloatArray,
    left: Sequence[FloatArray],
    n_effective: float,
    options: FitOptions,
) -> CoefficientBounds:
    q, r = np.linalg.qr(x)
    inverse = np.linalg.inv(r)
    beta = inverse @ (q.T @ y)
    n, m = x.shape
    dof = n_effective - m  # n - (k + 1) with k regressors beside the constant
    # Residual sum over its degrees of freedom; with every sample counted it is the published mean
    # squared error.
    s2 = sum(float(e @ e) for e in left) / n * n_effective / dof
    states = stack(residuals.states, design.states)
    return CoefficientBounds(
        states=design.states,
        centre=np.array([scaling[s][0] for s in design.states]),
        scale=np.array([scaling[s][1] for s in design.states]),
        terms=terms,
        beta_hat=beta,
        XtX_inv=inverse @ inverse.T,
        s2=s2,
        dof=float(dof),
        t=float(student_quantile(0.5 + 0.5 * options.confidence, dof)),
        confidence=options.confidence,
        leverage_factor=n / n_effective,
        n=n,
        n_effective=n_effective,
        walk_rate=float("nan"),
        hull=_hull(states, float(np.max(np.sum(q**2, axis=1)))),
    )


def with_walk_rates(
    fitted: Mapping[str, FittedBounds], rates: Mapping[str, float]
) -> dict[str, CoefficientBounds]:
    """The intervals with their rates of variation [1/sqrt(s)]; one with parts keeps that of its
    transient part.
    """
    return {
        c: f.bounds if f.bounds.parts else replace(f.bounds, walk_rate=rates[c])
        for c, f in fitted.items()
    }


# Noise added once more, to see by experiment what a figure owes to it.

NOISY = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)


def with_noise(
    channels: Mapping[str, FloatArray], noise_std: Mapping[str, float], rng: np.random.Generator
) -> dict[str, FloatArray]:
    """The channels (n,) with white noise of ``noise_std`` (channel -> std) added; those without a
    finite figure as they are.
    """
    return {
        c: (
            v + noise_std[c] * rng.standard_normal(len(v))
            if np.isfinite(noise_std.get(c, np.nan))
            else v
        )
        for c, v in channels.items()
    }


def floor_of(changes: Sequence[FloatArray]) -> FloatArray:
    """(k,) rms of what added noise changed in k quantities: the mean over experiments of (n, k)
    each.
    """
    return np.asarray(np.sqrt(sum(np.mean(change**2, axis=0) for change in changes) / len(changes)))


# Terms that an interval's polynomial lacks: what scatters about it and is not noise, by name.
#
# More data of the same kind leave such scatter where it is. Candidates are all products up to
# second order of the states that the flights have, surfaces and throttle among them, that are
# not in the polynomial already; a stepwise choice that allows for coloured residuals
# (selection.py) says which belong there.

# part of the largest state's deviation over its mean size below which a state did not move
_MISSING_TERMS_STILL = 1e-3
MOST = 4
LEAST_SHARE = 0.05
"""Of the scatter's variance; a chosen term that takes less is not worth a word."""


@dataclass(frozen=True)
class MissingTerm:
    """``name`` as polynomial.py writes it; ``share`` of the scatter's variance that it takes away,
    after those before it.
    """

    name: str
    states: tuple[str, ...]
    share: float


def missing_terms(
    residuals: Residuals, coefficient: str, bounds: CoefficientBounds, most: int = MOST
) -> list[MissingTerm]:
    """Terms that flights show to be missing, the most telling first; empty when what is left is
    noise.

    residuals: of the flights behind the bounds. Raises ValueError if they lack a state of the
    bounds."""
    there = residuals.states
    lacking = [s for s in bounds.states if s not in there]
    if lacking:
        raise ValueError(
            f"these flights have no {', '.join(lacking)} throughout; they have {', '.join(there)}"
        )
    moving = tuple(s for s in STATES if s in there and (s in bounds.states or _moves(there[s])))
    X = regressors((stack(there, bounds.states) - bounds.centre) / bounds.scale, bounds.terms)
    y = np.concatenate(residuals.columns(coefficient))
    inside = {term_name(t, bounds.states) for t in bounds.terms}
    values = stack(there, moving)
    z = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-300)
    terms = [
        t
        for t in full_polynomial(len(moving), 2)
        if any(t) and not _among(t, moving, bounds, inside)
    ]
    candidates = regressors(z, terms)
    basis = np.linalg.qr(X)[0]
    apart = [k for k in range(len(terms)) if _apart(candidates[:, k], basis)]
    both = np.column_stack([X, candidates[:, apart]])
    kept = list(range(X.shape[1]))
    chosen = stepwise(both, y, keep=kept, segments=residuals.lengths, max_terms=len(kept) + most)
    new = [k for k in chosen.selected if k >= X.shape[1]]
    found = _ordered(both, y, kept, new, [terms[k] for k in apart], moving)
    return [term for term in found if term.share >= LEAST_SHARE]


def _among(
    term: Sequence[int], moving: Sequence[str], bounds: CoefficientBounds, inside: set[str]
) -> bool:
    powers = {s: n for s, n in zip(moving, term, strict=True) if n}
    if not set(powers) <= set(bounds.states):
        return False
    return term_name(tuple(powers.get(s, 0) for s in bounds.states), bounds.states) in inside


def _moves(values: FloatArray) -> bool:
    return float(values.std()) > _MISSING_TERMS_STILL * max(float(np.abs(values).max()), 1e-9)


def _apart(column: FloatArray, basis: FloatArray) -> bool:
    rest = column - basis @ (basis.T @ column)
    return bool(np.linalg.norm(rest) > 1e-3 * np.linalg.norm(column))


def _ordered(
    both: FloatArray,
    y: FloatArray,
    kept: Sequence[int],
    new: Sequence[int],
    terms: Sequence[tuple[int, ...]],
    moving: tuple[str, ...],
) -> list[MissingTerm]:
    """The chosen terms, each time the one that takes most of what scatters."""
    out: list[MissingTerm] = []
    inside, left = list(kept), list(new)
    total = now = _rest(both[:, inside], y)
    while left:
        best = min(left, key=lambda k: _rest(both[:, [*inside, k]], y))
        then = _rest(both[:, [*inside, best]], y)
        term = terms[best - len(kept)]
        states = tuple(s for s, n in zip(moving, term, strict=True) if n)
        out.append(
            MissingTerm(
                term_name(term, moving), states, (now - then) / total if total > 0.0 else 0.0
            )
        )
        inside.append(best)
        left.remove(best)
        now = then
    return out


def _rest(X: FloatArray, y: FloatArray) -> float:
    e = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    return float(e @ e)
