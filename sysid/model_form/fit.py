"""Fit intervals to residual coefficients: regression on polynomials of flight states.

`fit_bounds` makes a `ModelForm`'s intervals (dissertation eqs 2.17, 2.18); `missing_terms` looks
for terms that the polynomials lack.

Where the pieces have their sensor noise, `components` separates model error from it: noise belongs
to the sensors and to no bounds. ``noise = "inside"`` keeps the published interval of measured
samples, noise included.

The published interval counts every sample as independent. Residuals sampled at 50 Hz and filtered
at some hertz are not: n samples have an effective size of n/tau, tau their integral time. By
default the degrees of freedom, the residual variance and the leverage's weight follow the effective
size; ``samples = "all"`` is the published way.
"""

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
    make_blocks,
    separate,
    split_long_pieces,
)
from sysid.model_form.model_form import CoefficientBounds, Hull, Parts

# Regressor states without sensor noise, as far as their spectra allow.
#
# Noise of a channel is in a state and in the residual alike, and a regression would take one for
# a function of the other. Bands of frequency whose power does not exceed that of the known noise
# are removed; others are reduced to the share of signal (Wiener, "Extrapolation, Interpolation and
# Smoothing of Stationary Time Series" (1949); regression calibration: Carroll et al., "Measurement
# Error in Nonlinear Models" (2006), ch. 4). A piece's mean is kept.

_BANDS_HZ = np.geomspace(0.1, 25.0, 20)
_SIGNAL_SIGMA = 2.0
"""Standard deviations of a band's noise power by which its power must exceed it to be signal."""


def remove_state_noise(residuals: Residuals) -> Residuals:
    """Return the residuals with denoised states; unchanged where a piece lacks its noise."""
    if any(p.noise is None for p in residuals.pieces):
        return residuals
    clean = denoised_states(residuals.pieces, residuals.dt_s)
    pieces = tuple(
        replace(p, states=states) for p, states in zip(residuals.pieces, clean, strict=True)
    )
    return replace(residuals, pieces=pieces)


def denoised_states(pieces: Sequence[ResidualPiece], dt_s: float) -> list[dict[str, FloatArray]]:
    """Return the states (n,) of each piece without the noise in `ResidualPiece.noise`."""
    out = [dict(p.states) for p in pieces]
    for name in out[0]:
        if any(p.noise is None or name not in p.noise.states for p in pieces):
            continue
        for states, clean in zip(out, _denoise(pieces, name, dt_s), strict=True):
            states[name] = clean
    return out


def _denoise(pieces: Sequence[ResidualPiece], name: str, dt_s: float) -> list[FloatArray]:
    """Remove noise from one state of all pieces by a Wiener filter in bands."""
    waves, noise, bands = [], [], []
    for piece in pieces:
        assert piece.noise is not None
        std, weights = piece.noise.states[name]
        n = len(piece)
        waves.append(fft.dct(piece.states[name], norm="ortho"))
        noise.append(std**2 * cosine_variance(n, autocorrelation(weights)))
        bands.append(np.digitize(np.arange(n) / (2.0 * n * dt_s), _BANDS_HZ))
    share = _signal_share(
        np.concatenate([w[1:] ** 2 for w in waves]),
        np.concatenate([v[1:] for v in noise]),
        np.concatenate([b[1:] for b in bands]),
    )
    return [
        fft.idct(np.concatenate([w[:1], w[1:] * share[b[1:]]]), norm="ortho")
        for w, b in zip(waves, bands, strict=True)
    ]


def _signal_share(power: FloatArray, noise: FloatArray, band: NDArray[np.intp]) -> FloatArray:
    """Return the share of signal in each band; 0 where noise alone explains the power.

    Bands are treated one by one, because the motion fills few of them.
    """
    share = np.zeros(len(_BANDS_HZ) + 1)
    for k in range(len(share)):
        in_band = band == k
        count = int(in_band.sum())
        if not count:
            share[k] = share[k - 1] if k else 1.0
            continue
        ratio = float(np.mean(power[in_band]) / np.mean(noise[in_band]))
        if ratio >= 1.0 + _SIGNAL_SIGMA * np.sqrt(2.0 / count):
            share[k] = 1.0 - 1.0 / ratio
    return share


LONGITUDINAL = ("V_mps", "alpha_rad", "q_radps", "theta_rad")
LATERAL = ("V_mps", "beta_rad", "p_radps", "r_radps")
MIN_SAMPLES_PER_TERM = 2.0
"""Effective samples per term; with fewer the polynomial's order is lowered."""
_MIN_VARIATION = {
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
_MIN_SURFACE_VARIATION_DEG = 0.1
"""Smallest standard deviation of a state that counts as varying.

Below it a state varied hardly more than filtered sensor noise (Table 2.1 of the dissertation), and
a polynomial in it, above all its growth outside such data, would fit noise.
"""
_COLLINEAR = 1e-6
"""Smallest share of a regressor's length that is independent of the regressors before it."""


@dataclass(frozen=True)
class Design:
    """States and terms of one coefficient's regression.

    Attributes
    ----------
    states : tuple of str
        Record columns.
    terms : tuple of Term, optional
        None: the full polynomial of ``order``.
    order : int
        Order of the full polynomial.
    """

    states: tuple[str, ...]
    terms: tuple[Term, ...] | None = None
    order: int = 2


def default_designs() -> dict[str, Design]:
    """Return full second-order polynomials for all coefficients.

    CX CZ Cm in V, alpha, q, theta; CY Cl Cn in V, beta, p, r.
    """
    return {c: Design(LONGITUDINAL if c in ("CX", "CZ", "Cm") else LATERAL) for c in COEFFICIENTS}


@dataclass(frozen=True)
class FitOptions:
    """Options of `fit_bounds`.

    Attributes
    ----------
    confidence : float
        Level of the interval.
    samples : {"effective", "all"}
        Allow for autocorrelation, or count every sample.
    select : {"full", "stepwise"}
        All terms, or those that a stepwise regression selects.
    noise : {"apart", "inside"}
        Leave sensor noise out of the intervals where it is known, or include it (published).
    """

    confidence: float = 0.95
    samples: Literal["effective", "all"] = "effective"
    select: Literal["full", "stepwise"] = "full"
    noise: Literal["apart", "inside"] = "apart"


@dataclass(frozen=True)
class FittedBounds:
    """Result of `fit_bounds` for one coefficient.

    Attributes
    ----------
    bounds : CoefficientBounds
        The interval.
    residual : list of array (n,)
        Flight minus fit, piece by piece.
    notes : tuple of str
        What was done about its terms.
    separation : Separation or None
        Of model error from noise, by blocks of `split_long_pieces`; None where noise is inside the
        interval.
    """

    bounds: CoefficientBounds
    residual: list[FloatArray]
    notes: tuple[str, ...] = field(default=())
    separation: Separation | None = None


def fit_bounds(
    residuals: Residuals,
    designs: Mapping[str, Design] | None = None,
    options: FitOptions | None = None,
) -> dict[str, FittedBounds]:
    """Fit the intervals of the coefficients in ``designs``.

    Terms in a state that hardly varied are left out with a note; the state stays in the envelope
    box. States are normalised by mean and deviation over all samples, the same for every
    coefficient, so that coefficients with the same states share one (X'X)^-1.

    Parameters
    ----------
    residuals : Residuals
        Of all flights.
    designs : mapping of str to Design, optional
        By default `default_designs`.
    options : FitOptions, optional
        See there.

    Returns
    -------
    dict of str to FittedBounds
        One per coefficient.

    Raises
    ------
    ValueError
        For a missing state, or a flight that is too short.
    """
    designs, options = designs or default_designs(), options or FitOptions()
    separate_noise = options.noise == "apart" and all(p.noise is not None for p in residuals.pieces)
    if separate_noise:
        # Noise that is in a state and in the residual would look like a function of that state.
        residuals = remove_state_noise(residuals)
    states = residuals.states
    state_names = dict.fromkeys(s for d in designs.values() for s in d.states)
    missing = [s for s in state_names if s not in states]
    if missing:
        raise ValueError(
            f"these flights have no {', '.join(missing)} throughout; they have {', '.join(states)}"
        )
    scaling = {}
    for name in state_names:
        scaling[name] = (
            float(states[name].mean()),
            max(float(states[name].std()), _min_variation(name)),
        )
    fit = _fit_separated if separate_noise else _fit
    return {c: fit(residuals, c, d, scaling, options) for c, d in designs.items()}


def _terms_of_varying_states(
    coefficient: str, design: Design, scaling: Mapping[str, tuple[float, float]]
) -> tuple[tuple[Term, ...] | None, tuple[str, ...]]:
    """Return the terms without states that hardly varied, and a note on these states.

    None instead of terms leaves the order open.
    """
    constant = [k for k, s in enumerate(design.states) if scaling[s][1] <= _min_variation(s)]
    if not constant:
        return design.terms, ()
    names = ", ".join(design.states[k] for k in constant)
    candidate_terms = (
        design.terms
        if design.terms is not None
        else full_polynomial(len(design.states), design.order)
    )
    terms = tuple(t for t in candidate_terms if not any(t[k] for k in constant))
    pronoun = "it" if len(constant) == 1 else "them"
    note = (
        f"{coefficient}: {names} hardly varied; the bounds do not depend on {pronoun}, and any"
        " other value is outside the data"
    )
    return terms or (tuple(0 for _ in design.states),), (note,)


def _min_variation(state: str) -> float:
    """Return the smallest standard deviation of a state that counts as varying."""
    return _MIN_VARIATION.get(state, _MIN_SURFACE_VARIATION_DEG)


def _fit(
    residuals: Residuals,
    coefficient: str,
    design: Design,
    scaling: Mapping[str, tuple[float, float]],
    options: FitOptions,
) -> FittedBounds:
    """Fit the interval of measured samples, noise included; short flights lower the order."""
    y = residuals.columns(coefficient)
    n = sum(residuals.lengths)
    open_terms, state_notes = _terms_of_varying_states(coefficient, design, scaling)
    candidate_terms = (
        open_terms if open_terms is not None else full_polynomial(len(design.states), design.order)
    )
    # Lower the order of a full polynomial until the samples suffice.
    orders = [None] if design.terms is not None else range(design.order, -1, -1)
    n_effective, notes = float(n), list[str]()
    for order in orders:
        terms = (
            candidate_terms
            if order is None
            else tuple(t for t in candidate_terms if sum(t) <= order)
        )
        selected_terms, selection_notes = _choose_terms(
            residuals, coefficient, design, terms, scaling, options
        )
        # Samples correlate: what counts is how many independent ones they are worth.
        if n <= len(selected_terms):
            continue
        x = _design_matrix(residuals, design, selected_terms, scaling)
        residual = _least_squares_residual(x, np.concatenate(y), residuals.lengths)
        n_effective = effective_samples(residual) if options.samples == "effective" else float(n)
        if n_effective >= MIN_SAMPLES_PER_TERM * len(selected_terms):
            if order is not None and order < design.order:
                notes.append(
                    f"{coefficient}: too short a flight for order {design.order}; order {order} was"
                    " fitted"
                )
            bounds = _bounds(
                residuals,
                design,
                selected_terms,
                scaling,
                x,
                np.concatenate(y),
                residual=residual,
                n_effective=n_effective,
                options=options,
            )
            return FittedBounds(bounds, residual, (*state_notes, *notes, *selection_notes))
    raise ValueError(
        f"{coefficient}: {n} samples are worth {n_effective:.0f} independent ones, at least"
        f" {MIN_SAMPLES_PER_TERM:g} a term are needed; fly longer or choose fewer terms"
    )


def _fit_separated(
    residuals: Residuals,
    coefficient: str,
    design: Design,
    scaling: Mapping[str, tuple[float, float]],
    options: FitOptions,
) -> FittedBounds:
    """Fit the interval of the model error alone.

    Its prior keeps the polynomial finite, so that no flight is too short for the order.
    """
    open_terms, state_notes = _terms_of_varying_states(coefficient, design, scaling)
    candidate_terms = (
        open_terms if open_terms is not None else full_polynomial(len(design.states), design.order)
    )
    terms, selection_notes = _choose_terms(
        residuals, coefficient, design, candidate_terms, scaling, options
    )
    # Long pieces in blocks keep the matrices of the likelihood small.
    blocks = split_long_pieces(residuals)
    x = _design_matrix(blocks, design, terms, scaling)
    # Posterior of the components, block by block.
    separation = separate(make_blocks(blocks, coefficient, _parts(x, blocks)))
    components = separation.components()
    residual = [
        y - part @ components.beta
        for y, part in zip(residuals.columns(coefficient), _parts(x, residuals), strict=True)
    ]
    # The posterior in the form of a regression: s2 and (X'X)^-1 that give its covariance.
    n = len(x)
    n_effective = effective_samples(residual)
    s2 = sum(float(e @ e) for e in residual) / n
    inverse = components.covariance / (s2 * (n / n_effective))
    leverage = float(np.einsum("nj,nj->n", x @ inverse, x).max())
    # Mean variance of sensor noise in this coefficient, which the interval does not include.
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
        beta_hat=components.beta,
        XtX_inv=inverse,
        s2=s2,
        dof=components.persistent_variance.dof,
        t=1.0,
        confidence=options.confidence,
        leverage_factor=n / n_effective,
        n=n,
        n_effective=n_effective,
        walk_rate=float("nan"),
        hull=_hull(stack(residuals.states, design.states), leverage),
    )
    bounds = with_components(bounds, components, float(np.sqrt(noise.mean())))
    return FittedBounds(bounds, residual, (*state_notes, *selection_notes), separation)


def with_components(
    bounds: CoefficientBounds, components: Components, noise: float
) -> CoefficientBounds:
    """Replace the components of an interval, with the same terms.

    ``noise`` is the rms of the presumed sensor noise in the samples [-].
    """
    parts = Parts(
        persistent=float(np.sqrt(components.persistent)),
        transient=float(np.sqrt(components.transient)),
        flight=float(np.sqrt(components.flight)),
        transient_time_s=components.time_s,
        noise=components.noise_factor * noise,
        noise_scale=components.noise_factor,
        total_dof=components.total_variance.dof,
        total_t=components.total_variance.quantile(bounds.confidence) * components.tail,
        not_above=components.not_above,
        found=components.log_odds >= STRONG,
    )
    return replace(
        bounds,
        beta_hat=components.beta,
        XtX_inv=components.covariance / (bounds.s2 * bounds.leverage_factor),
        dof=components.persistent_variance.dof,
        t=components.persistent_variance.quantile(bounds.confidence),
        walk_rate=parts.transient_rate_per_sqrt_s,
        parts=parts,
    )


def _parts(x: FloatArray, residuals: Residuals) -> list[FloatArray]:
    """Split the rows of x by pieces."""
    return list(np.split(x, np.cumsum(residuals.lengths)[:-1]))


def _hull(states: FloatArray, leverage: float) -> Hull:
    """Return the region of the data (n, k)."""
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
    """Evaluate the terms at normalised states, (n, m)."""
    centre, scale = (np.array([scaling[s][k] for s in design.states]) for k in (0, 1))
    return regressors((stack(residuals.states, design.states) - centre) / scale, terms)


def _choose_terms(
    residuals: Residuals,
    coefficient: str,
    design: Design,
    terms: Sequence[Term],
    scaling: Mapping[str, tuple[float, float]],
    options: FitOptions,
) -> tuple[tuple[Term, ...], list[str]]:
    """Choose the terms that the data separate, in order, by Gram-Schmidt and optionally stepwise.

    Returns the terms and notes on those left out.
    """
    x = _design_matrix(residuals, design, terms, scaling)
    independent, basis = [], np.zeros((len(x), 0))
    for k in range(x.shape[1]):
        # Gram-Schmidt, twice for the sake of rounding.
        length = float(np.linalg.norm(x[:, k]))
        direction = x[:, k] / length if length > 0.0 else x[:, k]
        for _ in range(2):
            direction = direction - basis @ (basis.T @ direction)
        remainder = float(np.linalg.norm(direction))
        if remainder > _COLLINEAR:
            independent.append(k)
            basis = np.column_stack([basis, direction / remainder])
    notes = []
    dropped = [
        term_name(terms[k], design.states) for k in range(len(terms)) if k not in independent
    ]
    if dropped:
        notes.append(
            f"{coefficient}: the flights do not separate {', '.join(dropped)} from other terms;"
            " left out"
        )
    # A stepwise regression keeps the constant and selects among the others.
    if options.select == "stepwise":
        constant = [i for i, k in enumerate(independent) if not any(terms[k])]
        y = np.concatenate(residuals.columns(coefficient))
        chosen = stepwise(x[:, independent], y, keep=constant, segments=residuals.lengths)
        independent = [independent[i] for i in chosen.selected]
        names = ", ".join(term_name(terms[k], design.states) for k in independent)
        notes.append(f"{coefficient}: stepwise choice of {names or 'no term'} among {len(terms)}")
    return tuple(terms[k] for k in independent), notes


def _least_squares_residual(
    x: FloatArray, y: FloatArray, lengths: Sequence[int]
) -> list[FloatArray]:
    """Return the least-squares residual of y (n,), piece by piece."""
    beta = np.linalg.lstsq(x, y, rcond=None)[0] if x.shape[1] else np.zeros(0)
    return list(np.split(y - x @ beta, np.cumsum(lengths)[:-1]))


def _bounds(
    residuals: Residuals,
    design: Design,
    terms: tuple[Term, ...],
    scaling: Mapping[str, tuple[float, float]],
    x: FloatArray,
    y: FloatArray,
    *,
    residual: Sequence[FloatArray],
    n_effective: float,
    options: FitOptions,
) -> CoefficientBounds:
    """Build the interval from the regression."""
    q, r = np.linalg.qr(x)
    inverse = np.linalg.inv(r)
    beta = inverse @ (q.T @ y)
    n, m = x.shape
    dof = n_effective - m  # n - (k + 1) with k regressors beside the constant
    # Residual sum over its degrees of freedom; the published mean squared error if every sample
    # counts.
    s2 = sum(float(e @ e) for e in residual) / n * n_effective / dof
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
    """Set the intervals' rates of variation [1/sqrt(s)]; those with parts keep the transient
    part's.
    """
    return {
        c: f.bounds if f.bounds.parts else replace(f.bounds, walk_rate=rates[c])
        for c, f in fitted.items()
    }


# Noise floor by experiment: noise is added once more.

SENSOR_CHANNELS = (
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
    """Add white noise of ``noise_std`` (channel to standard deviation) to channels (n,).

    Channels without a finite figure are unchanged.
    """
    return {
        c: (
            v + noise_std[c] * rng.standard_normal(len(v))
            if np.isfinite(noise_std.get(c, np.nan))
            else v
        )
        for c, v in channels.items()
    }


def noise_floor(changes: Sequence[FloatArray]) -> FloatArray:
    """Return the rms (k,) of the changes (n, k) that added noise caused, over all experiments."""
    return np.asarray(np.sqrt(sum(np.mean(change**2, axis=0) for change in changes) / len(changes)))


# Terms that an interval's polynomial lacks.
#
# More data of the same kind do not reduce such scatter. Candidates are all products up to second
# order of the states that the flights have, including surfaces and throttle, that are not in the
# polynomial. A stepwise regression that allows for coloured residuals selects among them.

_MIN_RELATIVE_VARIATION = 1e-3
"""Standard deviation over largest value of a state below which it did not move."""
MAX_MISSING_TERMS = 4
"""Missing terms reported at most."""
MIN_SHARE = 0.05
"""Smallest share of the scatter's variance of a missing term that is reported."""


@dataclass(frozen=True)
class MissingTerm:
    """A term that the polynomial lacks.

    Attributes
    ----------
    name : str
        As `sysid.aerodynamics.term_name` writes it.
    states : tuple of str
        Its states.
    share : float
        Share of the scatter's variance that it removes, after the terms before it.
    """

    name: str
    states: tuple[str, ...]
    share: float


def missing_terms(
    residuals: Residuals,
    coefficient: str,
    bounds: CoefficientBounds,
    max_terms: int = MAX_MISSING_TERMS,
) -> list[MissingTerm]:
    """Find terms that the data show to be missing, the strongest first.

    Parameters
    ----------
    residuals : Residuals
        Of the flights behind the bounds.
    coefficient : str
        Among COEFFICIENTS.
    bounds : CoefficientBounds
        Its interval.
    max_terms : int
        Number of terms at most.

    Returns
    -------
    list of MissingTerm
        Empty if the scatter is noise.

    Raises
    ------
    ValueError
        If the flights lack a state of the bounds.
    """
    states = residuals.states
    lacking = [s for s in bounds.states if s not in states]
    if lacking:
        raise ValueError(
            f"these flights have no {', '.join(lacking)} throughout; they have {', '.join(states)}"
        )
    moving = tuple(s for s in STATES if s in states and (s in bounds.states or _moves(states[s])))
    X = regressors((stack(states, bounds.states) - bounds.centre) / bounds.scale, bounds.terms)
    y = np.concatenate(residuals.columns(coefficient))
    existing_names = {term_name(t, bounds.states) for t in bounds.terms}
    values = stack(states, moving)
    z = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-300)
    terms = [
        t
        for t in full_polynomial(len(moving), 2)
        if any(t) and not _is_included(t, moving, bounds, existing_names)
    ]
    # Candidates with a part outside the polynomial.
    candidates = regressors(z, terms)
    basis = np.linalg.qr(X)[0]
    independent = [k for k in range(len(terms)) if _is_independent(candidates[:, k], basis)]
    design = np.column_stack([X, candidates[:, independent]])
    existing = list(range(X.shape[1]))
    chosen = stepwise(
        design, y, keep=existing, segments=residuals.lengths, max_terms=len(existing) + max_terms
    )
    # Terms that entered, ordered by what they explain.
    new = [k for k in chosen.selected if k >= X.shape[1]]
    missing = _ordered(design, y, existing, new, [terms[k] for k in independent], moving)
    return [term for term in missing if term.share >= MIN_SHARE]


def _is_included(
    term: Sequence[int], moving: Sequence[str], bounds: CoefficientBounds, inside: set[str]
) -> bool:
    """Return whether the polynomial has a term."""
    powers = {s: n for s, n in zip(moving, term, strict=True) if n}
    if not set(powers) <= set(bounds.states):
        return False
    return term_name(tuple(powers.get(s, 0) for s in bounds.states), bounds.states) in inside


def _moves(values: FloatArray) -> bool:
    """Return whether a state varied."""
    return float(values.std()) > _MIN_RELATIVE_VARIATION * max(float(np.abs(values).max()), 1e-9)


def _is_independent(column: FloatArray, basis: FloatArray) -> bool:
    """Return whether a column has a part outside the basis."""
    remainder = column - basis @ (basis.T @ column)
    return bool(np.linalg.norm(remainder) > 1e-3 * np.linalg.norm(column))


def _ordered(
    design: FloatArray,
    y: FloatArray,
    existing: Sequence[int],
    new: Sequence[int],
    terms: Sequence[tuple[int, ...]],
    moving: tuple[str, ...],
) -> list[MissingTerm]:
    """Order the selected terms, each time the one that reduces the scatter most."""
    out: list[MissingTerm] = []
    columns, remaining = list(existing), list(new)
    total = current_sum = _residual_sum(design[:, columns], y)
    while remaining:
        best = min(remaining, key=lambda k: _residual_sum(design[:, [*columns, k]], y))
        new_sum = _residual_sum(design[:, [*columns, best]], y)
        term = terms[best - len(existing)]
        states = tuple(s for s, n in zip(moving, term, strict=True) if n)
        out.append(
            MissingTerm(
                term_name(term, moving),
                states,
                (current_sum - new_sum) / total if total > 0.0 else 0.0,
            )
        )
        columns.append(best)
        remaining.remove(best)
        current_sum = new_sum
    return out


def _residual_sum(X: FloatArray, y: FloatArray) -> float:
    """Return the residual sum of squares of a regression."""
    e = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    return float(e @ e)
