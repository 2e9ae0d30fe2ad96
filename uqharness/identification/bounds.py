"""Model-form bounds of a JSBSim aircraft from flights, and their validation on other flights.

Residual coefficients (demanded minus predicted) are corrected for sensor noise and for the rotation
of the air, then bounded as functions of the flight state (`sysid.model_form`). `make_bounds` fits
the bounds with their evidence, `validate` counts how much of a new flight lies inside, and
`parse_designs` reads the polynomials of the command line. Nothing is written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.aerodynamics import (
    COEFFICIENTS,
    AirPiece,
    AirRotation,
    Cutoffs,
    Residuals,
    air_pieces,
    combine_flights,
    noise_variance,
    offset_records,
    with_noise_of,
    with_sensor_noise,
    without_air_rotation,
)
from sysid.errors import LogError
from sysid.estimation import NoiseSize, noise_size
from sysid.foreign.regular_files import parse_json, read_regular
from sysid.model_form import (
    MAX_SHARE_ERROR,
    SENSOR_CHANNELS,
    WALK_CUTOFF_HZ,
    AircraftReference,
    CoefficientBounds,
    Coverage,
    Design,
    Filtering,
    FitOptions,
    FittedBounds,
    FlightUsed,
    ModelForm,
    Outside,
    Variation,
    Verdict,
    default_designs,
    fit_bounds,
    leave_one_out,
    read_model_form,
    variation,
    verdict,
    with_distinct_labels,
    with_walk_rates,
)
from sysid.model_form.coverage import coverage
from uqharness.errors import BadInputError
from uqharness.heartbeat import Callback, silent
from uqharness.identification.split import inside, used_for_bounds, used_for_model
from uqharness.replay import Flight, ReplayPair, flight_residuals, prediction_of
from uqharness.simulator import Aircraft, content_hash
from uqharness.text_tables import TabularResult

if TYPE_CHECKING:
    import pandas as pd

VANES = ("alpha_rad", "beta_rad")


def noise_sizes(
    flight: Flight, stated: Mapping[str, float], cutoffs: Cutoffs
) -> dict[str, NoiseSize]:
    """Estimate the white noise of each channel from samples above the filter's cut-off.

    ``stated`` are the card's standard deviations by channel, used as priors.
    """
    record = flight.record
    out = {}
    for name in SENSOR_CHANNELS:
        if name not in record:
            continue
        # Pieces with gaps have no spectrum above the cut-off.
        pieces = [np.asarray(record[name][p.rows], dtype=float) for p in flight.pieces]
        size = noise_size(
            [x for x in pieces if np.isfinite(x).all()],
            record.dt_s,
            cutoffs.all_hz,
            stated.get(name),
        )
        if size is not None:
            out[name] = size
    return out


@dataclass(frozen=True)
class NoisyFlight:
    """A flight's residuals with the noise of its sensors.

    Attributes
    ----------
    residuals : Residuals
        Residual coefficients with their noise.
    std : Mapping
        Standard deviation of the noise by channel.
    air : sequence of AirPiece, optional
        Data on the air's rotation; None where alpha or beta come from an estimator, which does not
        sense gusts.
    arm_m : tuple
        Position of the accelerometers from the CG [m].
    """

    residuals: Residuals
    std: Mapping[str, float]
    air: Sequence[AirPiece] | None
    arm_m: tuple[float, ...]

    @staticmethod
    def of(
        pair: ReplayPair, flight: Flight, residuals: Residuals, aircraft: Aircraft
    ) -> NoisyFlight:
        """Evaluate the model for the effect of sensor noise and of the air's rotation."""
        sizes = noise_sizes(flight, aircraft.card.sensors.noise_std, residuals.cutoffs)
        std = {c: size.std for c, size in sizes.items()}
        # The probes of noise and of rotation perturb the same states, which are evaluated once.
        model, arm = pair.model_near(flight), tuple(aircraft.accelerometer_m)
        pair.prefetch_near(flight, offset_records(flight.record, residuals.cutoffs), flight.pieces)
        noisy = with_sensor_noise(
            residuals,
            flight.record,
            flight.pieces,
            model,
            arm,
            std,
            relative_std={c: size.relative_std for c, size in sizes.items()},
        )
        # Angles of an estimator do not contain the rotation of gusts.
        measures_wind_angles = not set(VANES) & set(flight.record.metadata.estimates)
        air = (
            air_pieces(flight.record, flight.pieces, model, residuals.cutoffs.airspeed_hz)
            if measures_wind_angles
            else None
        )
        return NoisyFlight(noisy, std, air, arm)

    def in_still_air(self, residuals: Residuals) -> tuple[Residuals, AirRotation | None]:
        """Return residuals of any filter with noise and without the air's rotation, and the
        rotation found.
        """
        return (
            (residuals, None)
            if self.air is None
            else without_air_rotation(residuals, self.air, self.arm_m, self.std)
        )


def noisy_residuals(
    pair: ReplayPair, flight: Flight, residuals: Residuals, aircraft: Aircraft
) -> Residuals:
    """Return residuals with the noise of sensors and of the air's rolling, without the air's
    rotation.
    """
    noisy = NoisyFlight.of(pair, flight, residuals, aircraft)
    return noisy.in_still_air(noisy.residuals)[0]


def air_note(flight: Flight, air: AirRotation) -> str:
    """Describe the rotation of the air that was removed."""
    return (
        f"{flight.name}: the residuals contain {100.0 * air.share:.0f} ± {100.0 * air.std:.0f} %"
        " of the rotation of frozen gusts; it is an effect of the air, not a model error, and is"
        " removed"
    )


# Fitting of bounds.


@dataclass(frozen=True)
class BoundsOptions:
    """Options of `make_bounds`.

    Attributes
    ----------
    designs : Mapping
        Polynomial of each coefficient.
    fit : FitOptions
        Confidence, sample size, selection and treatment of noise.
    cutoffs : Cutoffs
        Filters of the residual coefficients [Hz].
    walk_cutoff_hz : float
        Low-pass for the rate of variation [Hz].
    outside : {"grow", "clamp"}
        What the bounds do beyond the data.
    ideal_servos : bool
        Whether surfaces follow their commands at once.
    checks : bool
        Whether leave-one-out and other filters are computed.
    values : Mapping
        Properties that differ from the aircraft's XML.
    """

    designs: Mapping[str, Design] = field(default_factory=default_designs)
    fit: FitOptions = field(default_factory=FitOptions)
    cutoffs: Cutoffs = field(default_factory=Cutoffs)
    walk_cutoff_hz: float = WALK_CUTOFF_HZ
    outside: Outside = "grow"
    ideal_servos: bool = False
    checks: bool = True
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CutoffRow:
    """Mean widths by coefficient with another filter."""

    cutoffs: Cutoffs
    width: Mapping[str, float]


@dataclass(frozen=True)
class MadeBounds(TabularResult):
    """A model form with its evidence.

    Attributes
    ----------
    form : ModelForm
        The bounds.
    residuals : Residuals
        What they were fitted to.
    fitted : Mapping
        Fit of each coefficient.
    baseline : Mapping
        Bounds with the default states, where other states were requested.
    variations : Mapping
        Rate of variation by coefficient.
    widths : Mapping
        Mean width of the bounds over the data [-].
    noise : Mapping
        Rms of the sensors' noise in a sample [-].
    left_out : Mapping
        Manoeuvre to coefficient to the share inside the bounds of the other manoeuvres.
    cutoffs : tuple of CutoffRow
        Widths with other filters.
    notes, warnings : tuple of str
        Sentences for the user.
    """

    form: ModelForm
    residuals: Residuals
    fitted: Mapping[str, FittedBounds]
    baseline: Mapping[str, CoefficientBounds]
    variations: Mapping[str, Variation]
    widths: Mapping[str, float]
    noise: Mapping[str, float]
    left_out: Mapping[str, Mapping[str, float]]
    cutoffs: tuple[CutoffRow, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        return f"MadeBounds({self.form!r}, {len(self.warnings)} warnings)"

    def to_dataframe(self) -> pd.DataFrame:
        """Return the table of coefficients: samples, standard deviation, mean width, noise, walk
        rate, parts.
        """
        import pandas as pd

        rows = {
            c: {
                "n": b.n,
                "n_effective": b.n_effective,
                "s": math.sqrt(b.s2),
                "mean_width": self.widths[c],
                "noise": self.noise.get(c, math.nan),
                "walk_rate_per_sqrt_s": b.walk_rate,
                **_parts_of(b),
            }
            for c, b in self.form.coefficients.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("coefficient")


def _parts_of(bounds: CoefficientBounds) -> dict[str, float]:
    """Return the parts of the model error [-]; empty where noise and model error were kept
    together.
    """
    p = bounds.parts
    if p is None:
        return {}
    return {
        "persistent": p.persistent,
        "transient": p.transient,
        "transient_time_s": p.transient_time_s,
        "not_above": p.not_above,
        "found": p.found,
    }


def make_bounds(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    hashes: Sequence[str],
    options: BoundsOptions,
    callback: Callback = silent,
) -> MadeBounds:
    """Fit model-form bounds to flights.

    Parameters
    ----------
    aircraft : Aircraft
        The model.
    flights : sequence of Flight
        Flights that the model was not identified from.
    measured : sequence of str
        Surfaces whose columns are positions.
    hashes : sequence of str
        SHA-256 of each flight's file.
    options : BoundsOptions
        What is fitted.
    callback : callable
        Called with the name of each stage.

    Returns
    -------
    MadeBounds
        The model form and its evidence.

    Raises
    ------
    BadInputError
        When the flights are too short for any fit.
    """
    # Ideal servos move at once; their commands are delayed as the smoothed rates are.
    arm = aircraft.accelerometer_m
    flights = [f.with_smoothing_delay() for f in flights] if options.ideal_servos else flights
    with prediction_of(aircraft, measured, options.ideal_servos, options.values) as pair:
        callback("residual coefficients")
        # 1: demanded minus predicted coefficients of every flight.
        parts = [flight_residuals(pair, f, arm, options.cutoffs) for f in flights]
        callback("sensor noise")
        # 2: sensor noise in each sample, by probing the model.
        noisy = [NoisyFlight.of(pair, f, r, aircraft) for f, r in zip(flights, parts, strict=True)]
        # 3: remove the rotation of the air, unless noise and model error are kept together.
        calm_residuals = (
            [n.in_still_air(n.residuals) for n in noisy]
            if options.fit.noise == "apart"
            else [(n.residuals, None) for n in noisy]
        )
        residuals = combine_flights([r for r, _ in calm_residuals])
        callback("model error apart from noise" if options.fit.noise == "apart" else "intervals")
        # 4: bounds as functions of the flight state.
        fitted = _fit(residuals, options.designs, options.fit)
        cutoff_rows = []
        if options.checks:
            callback("other filters")
            cutoff_rows = [
                _with_cutoffs(pair, flights, noisy, arm, c, options)
                for c in _other_cutoffs(options.cutoffs)
            ]
    # Rates of variation of the residuals within their bounds, for walks between levels.
    walks = {
        c: variation(residuals, c, f.bounds, options.walk_cutoff_hz, options.outside)
        for c, f in fitted.items()
    }
    # The form records what is needed to repeat the fit: flights, filters, confidence.
    form = ModelForm(
        aircraft=AircraftReference(aircraft.name, content_hash(aircraft)),
        flights=tuple(
            _flight_used(f, r, h) for f, r, h in zip(flights, parts, hashes, strict=True)
        ),
        filtering=Filtering(
            options.cutoffs.all_hz,
            options.cutoffs.airspeed_hz,
            options.walk_cutoff_hz,
            1.0 / residuals.dt_s,
        ),
        confidence=options.fit.confidence,
        outside=options.outside,
        coefficients=with_walk_rates(fitted, {c: w.rate for c, w in walks.items()}),
    )
    callback("leaving manoeuvres out")
    left_out = (
        leave_one_out(residuals, options.designs, options.fit, options.outside, fitted)
        if options.checks
        else {}
    )
    air_notes = [
        air_note(f, air)
        for f, (_, air) in zip(flights, calm_residuals, strict=True)
        if air is not None and air.level > 0.0
    ]
    return MadeBounds(
        form=form,
        residuals=residuals,
        fitted=fitted,
        baseline=_baseline(residuals, options),
        variations=walks,
        widths=mean_widths(form, residuals),
        noise=_noise_rms(combine_flights([n.residuals for n in noisy])),
        left_out=left_out,
        cutoffs=tuple(cutoff_rows),
        notes=(
            *(n for f in flights for n in f.notes),
            *air_notes,
            *_notes_of(fitted),
        ),
        warnings=tuple(_warnings(aircraft, flights, hashes, form, walks, options.cutoffs)),
    )


def _notes_of(fitted: Mapping[str, FittedBounds]) -> list[str]:
    """Return the notes of all coefficients; one that several share names all of them."""
    coefficients: dict[str, list[str]] = {}
    for c, f in fitted.items():
        for note in f.notes:
            coefficients.setdefault(note.removeprefix(f"{c}: "), []).append(c)
    return [f"{', '.join(names)}: {text}" for text, names in coefficients.items()]


def _fit(
    residuals: Residuals, designs: Mapping[str, Design], options: FitOptions
) -> dict[str, FittedBounds]:
    """Fit the intervals. Raises BadInputError for too little data."""
    try:
        return fit_bounds(residuals, designs, options)
    except ValueError as error:
        raise BadInputError(str(error)) from None


def _baseline(residuals: Residuals, options: BoundsOptions) -> dict[str, CoefficientBounds]:
    """Return default bounds of the coefficients whose states or terms the user chose (Hale, Fig
    2.10).
    """
    usual = default_designs()
    # Only coefficients with other states or terms than the default need a second fit.
    changed = {c: usual[c] for c, d in options.designs.items() if d != usual[c]}
    try:
        return (
            {c: f.bounds for c, f in fit_bounds(residuals, changed, options.fit).items()}
            if changed
            else {}
        )
    except ValueError:
        return {}


def mean_widths(form: ModelForm, residuals: Residuals) -> dict[str, float]:
    """Return the mean width of the bounds over a flight's states [-]."""
    return {
        c: float(np.mean(high - low)) for c, (low, high) in form.bounds(residuals.states).items()
    }


def _noise_rms(residuals: Residuals) -> dict[str, float]:
    """Return the rms of the sensors' noise in each coefficient's samples [-]."""
    variance = np.concatenate(
        [noise_variance(p.noise) for p in residuals.pieces if p.noise is not None]
    )
    return dict(zip(COEFFICIENTS, np.sqrt(variance.mean(axis=0)).tolist(), strict=True))


def _other_cutoffs(used: Cutoffs) -> list[Cutoffs]:
    """Return half and twice the filter, and half, twice and no low-pass of the airspeed."""
    return [
        Cutoffs(0.5 * used.all_hz, used.airspeed_hz),
        Cutoffs(2.0 * used.all_hz, used.airspeed_hz),
        *([Cutoffs(used.all_hz, 0.5 * used.airspeed_hz)] if np.isfinite(used.airspeed_hz) else []),
        Cutoffs(used.all_hz, float("inf")),
    ]


def _with_cutoffs(
    pair: ReplayPair,
    flights: Sequence[Flight],
    used: Sequence[NoisyFlight],
    arm: Sequence[float],
    cutoffs: Cutoffs,
    options: BoundsOptions,
) -> CutoffRow:
    """Fit the bounds with another filter; NaN widths where that fails."""
    try:
        parts = [
            with_noise_of(flight_residuals(pair, f, arm, cutoffs), u.residuals)
            for f, u in zip(flights, used, strict=True)
        ]
        if options.fit.noise == "apart":
            parts = [u.in_still_air(r)[0] for u, r in zip(used, parts, strict=True)]
        residuals = combine_flights(parts)
        fitted = fit_bounds(residuals, options.designs, options.fit)
    # A filter may leave too few samples; that is a result, not an error.
    except (ValueError, BadInputError):
        return CutoffRow(cutoffs, dict.fromkeys(options.designs, float("nan")))
    return CutoffRow(cutoffs, {c: _mean_width(f.bounds, residuals) for c, f in fitted.items()})


def _mean_width(bounds: CoefficientBounds, residuals: Residuals) -> float:
    """Return the mean width of one coefficient's bounds over the residuals' states [-]."""
    low, high = bounds.bounds(residuals.states)
    return float(np.mean(high - low))


def mean_left_out(
    residuals: Residuals, left_out: Mapping[str, Mapping[str, float]]
) -> dict[str, float]:
    """Return the leave-one-manoeuvre-out coverage over all samples; NaN without a second
    manoeuvre.
    """
    if not left_out:
        return dict.fromkeys(COEFFICIENTS, float("nan"))
    by_manoeuvre = with_distinct_labels(residuals)
    # Weigh each manoeuvre by its samples.
    n = {label: sum(by_manoeuvre.only([label]).lengths) for label in left_out}
    names = next(iter(left_out.values()))
    return {
        c: float(np.average([left_out[m][c] for m in left_out], weights=[n[m] for m in left_out]))
        for c in names
    }


def _flight_used(flight: Flight, residuals: Residuals, sha256: str) -> FlightUsed:
    """Describe a flight for the model form."""
    seconds = sum(p.time_s[-1] - p.time_s[0] for p in residuals.pieces)
    estimates = tuple(c for c in flight.record.metadata.estimates if c in SENSOR_CHANNELS)
    return FlightUsed(
        flight.name, sha256, round(float(seconds), 6), sum(residuals.lengths), estimates
    )


def _warnings(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    hashes: Sequence[str],
    form: ModelForm,
    walks: Mapping[str, Variation],
    cutoffs: Cutoffs,
) -> list[str]:
    """Collect warnings about flights and bounds."""
    out = [*flight_warnings(flights, form, cutoffs), *_identified_from(aircraft, flights, hashes)]
    short = [c for c, w in walks.items() if not np.isfinite(w.rate)]
    if short:
        out.append(
            f"no piece is long enough for a rate of variation of {', '.join(short)} at"
            f" {form.filtering.walk_cutoff_hz:g} Hz"
        )
    return out


_RATE_OVER_CUTOFF = 2.5
"""Least sample rate of a channel in units of the filter's cut-off: Nyquist with a margin."""
_INERTIAL = ("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2")


def _slow_channels(flight: Flight, cutoffs: Cutoffs, channels: Sequence[str]) -> list[str]:
    """Return the channels that were logged too slowly for the filter."""
    rates = flight.record.metadata.native_hz
    return [c for c in channels if rates.get(c, np.inf) < _RATE_OVER_CUTOFF * cutoffs.all_hz]


def flight_warnings(flights: Sequence[Flight], form: ModelForm, cutoffs: Cutoffs) -> list[str]:
    """Return what weakens the residuals of flights: estimated angles, slow channels, another sample
    rate.
    """
    out = []
    for flight in flights:
        record = flight.record
        estimated = [c for c in record.metadata.estimates if c in SENSOR_CHANNELS]
        if estimated:
            out.append(
                f"{flight.name}: {', '.join(estimated)} come from an estimator, not a sensor; the"
                " intervals include its errors"
            )
        # The airspeed has its own, lower cut-off.
        slow = _slow_channels(flight, cutoffs, [c for c in SENSOR_CHANNELS if c != "V_mps"])
        if slow:
            out.append(
                f"{flight.name}: {', '.join(slow)} were logged too slowly for a filter at"
                f" {cutoffs.all_hz:g} Hz; lower --cutoff-hz"
            )
        # Noise variance after the filter depends on the sample rate.
        rate = 1.0 / record.dt_s
        if abs(rate / form.filtering.rate_hz - 1.0) > 0.1:
            out.append(
                f"{flight.name}: {rate:.0f} samples a second, the form's first flight had"
                f" {form.filtering.rate_hz:.0f}: the same cut-off passes another share of the noise"
            )
    return out


def _identified_from(
    aircraft: Aircraft, flights: Sequence[Flight], hashes: Sequence[str]
) -> list[str]:
    """Warn of flights from which the model was identified, by the fit.json of an identified
    aircraft.
    """
    # The file is optional and may be of any origin: unreadable content is ignored.
    path = aircraft.folder.parent / "fit.json"
    try:
        document = parse_json(read_regular(path))
        digests, names = document.get("flights_sha256", []), document.get("flights", [])
        digests, names = (
            [text for text in row if isinstance(text, str)] for row in (digests, names)
        )
    except (OSError, ValueError, AttributeError, TypeError):
        return []
    out = []
    for flight, sha256 in zip(flights, hashes, strict=True):
        used = used_for_model(aircraft, sha256)
        # Rows that the estimation left out are as good as those of another flight.
        if used and not inside(flight.record, used).any():
            continue
        # Older files have names only.
        if sha256 in digests or (not digests and any(Path(n).stem == flight.name for n in names)):
            out.append(
                f"{flight.name}: the model was identified from this flight ({path}); its residuals"
                " are too small for bounds. Use another flight"
            )
    return out


# Polynomials on the command line: --states, --terms, --order, --roll-terms.

_SHORT = {
    "V": "V_mps",
    "alpha": "alpha_rad",
    "beta": "beta_rad",
    "phi": "phi_rad",
    "theta": "theta_rad",
    "p": "p_radps",
    "q": "q_radps",
    "r": "r_radps",
    "de": "elevator_pos_deg",
    "da": "aileron_pos_deg",
    "dr": "rudder_pos_deg",
    "dt": "throttle_pct",
}


def parse_designs(
    states: Sequence[str], terms: Sequence[str], order: int, roll_terms: bool
) -> dict[str, Design]:
    """Parse --states, --terms, --order and --roll-terms to designs. Raises BadInputError.

    >>> parse_designs(["CX=V,alpha"], [], 1, False)["CX"].states
    ('V_mps', 'alpha_rad')
    """
    from sysid.aerodynamics import parse_term
    from sysid.aerodynamics.coefficients import STATES
    from sysid.model_form import Design, default_designs

    designs = {c: Design(d.states, None, order) for c, d in default_designs().items()}
    if roll_terms:
        designs["Cm"] = Design((*designs["Cm"].states, "p_radps"), None, order)
    for text in states:
        coefficient, names = _assignment("--states", text, list(designs))
        unknown = [n for n in names if _SHORT.get(n, n) not in STATES]
        if unknown or len(set(names)) < len(names):
            raise BadInputError(
                f"--states {text}:"
                f" {f'unknown state {unknown[0]}' if unknown else 'a state is named twice'};"
                f" allowed are {', '.join(_SHORT)}"
            )
        designs[coefficient] = Design(tuple(_SHORT.get(n, n) for n in names), None, order)
    for text in terms:
        coefficient, names = _assignment("--terms", text, list(designs))
        long_names = ["*".join(_long_name(f) for f in name.split("*")) for name in names]
        # States of the terms, in canonical order.
        used = tuple(
            s
            for s in STATES
            if any(s == f.split("^")[0] for name in long_names for f in name.split("*"))
        )
        try:
            chosen = tuple(parse_term(name, used) for name in long_names)
        except ValueError as error:
            raise BadInputError(
                f"--terms {text}: {error}; states are {', '.join(_SHORT)}"
            ) from None
        if len(set(chosen)) < len(chosen) or not used:
            raise BadInputError(
                f"--terms {text}:"
                f" {'a term is named twice' if used else 'no term depends on a state'}"
            )
        designs[coefficient] = Design(used, chosen)
    return designs


def _long_name(factor: str) -> str:
    """Expand the short state of a factor such as ``alpha^2``."""
    state, caret, power = factor.strip().partition("^")
    return f"{_SHORT.get(state, state)}{caret}{power}"


def _assignment(option: str, text: str, coefficients: list[str]) -> tuple[str, list[str]]:
    """Parse ``C=name,name``. Raises BadInputError."""
    coefficient, equals, names_text = text.partition("=")
    names = [n.strip() for n in names_text.split(",") if n.strip()]
    if not equals or not names or coefficient not in coefficients:
        raise BadInputError(
            f"{option} {text}: C=name,name with C one of {', '.join(coefficients)} is needed, such"
            f" as {option} CX=V,alpha"
        )
    return coefficient, names


# Validation on other flights.


@dataclass(frozen=True)
class Validation:
    """Coverage of a model form on flights that it was not made from.

    Attributes
    ----------
    coverage : Mapping
        Coverage of each coefficient's intervals.
    residuals : Residuals
        Residual coefficients of the flights.
    notes, warnings : tuple of str
        Sentences for the user; warnings weaken the coverage.
    flight_std : Mapping
        Standard deviation of the model error from flight to flight [-], NaN where it cannot be
        estimated.
    """

    coverage: Mapping[str, Coverage]
    residuals: Residuals
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    flight_std: Mapping[str, float] = field(default_factory=dict)


def load_form(path: Path) -> ModelForm:
    """Read model-form.json. Raises BadInputError."""
    try:
        return read_model_form(path)
    except LogError as error:
        raise BadInputError(str(error)) from None


def validate(
    aircraft: Aircraft,
    form: ModelForm,
    flights: Sequence[Flight],
    measured: Sequence[str],
    hashes: Sequence[str],
    *,
    ideal_servos: bool = False,
    values: Mapping[str, float] | None = None,
) -> Validation:
    """Count the residuals of flights that lie inside a form's bounds.

    Parameters
    ----------
    aircraft : Aircraft
        The model of the bounds.
    form : ModelForm
        The bounds; the flights are filtered as its own were.
    flights, measured, hashes
        As for `make_bounds`.
    ideal_servos : bool
        Whether surfaces follow their commands at once.
    values : Mapping, optional
        Properties that differ from the aircraft's XML.

    Returns
    -------
    Validation
        Coverage, residuals and warnings.

    Raises
    ------
    BadInputError
        For bounds of another aircraft, and for flights without the states of the bounds.
    """
    if form.aircraft.name != aircraft.name:
        raise BadInputError(
            f"the bounds belong to aircraft '{form.aircraft.name}', not to '{aircraft.name}':"
            " residuals of one model say nothing about another; make bounds for this one"
            " (uqharness bounds)"
        )
    # Coverage is meaningful only with the filters of the form.
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    for flight in flights:
        slow = _slow_channels(flight, cutoffs, _INERTIAL)
        if slow:
            rates = flight.record.metadata.native_hz
            raise BadInputError(
                f"{flight.name}: {', '.join(slow)} were logged at"
                f" {min(rates[c] for c in slow):.0f} Hz; bounds with a filter at"
                f" {cutoffs.all_hz:g} Hz need {_RATE_OVER_CUTOFF * cutoffs.all_hz:.0f} Hz, or the"
                " logger's rate is judged in place of the model. Make bounds with a lower"
                " --cutoff-hz, or use a log with faster rates and accelerations"
            )
    arm = aircraft.accelerometer_m
    flights = [f.with_smoothing_delay() for f in flights] if ideal_servos else flights
    with prediction_of(aircraft, measured, ideal_servos, values) as pair:
        parts = [flight_residuals(pair, f, arm, cutoffs) for f in flights]
        residuals = combine_flights(
            [noisy_residuals(pair, f, r, aircraft) for f, r in zip(flights, parts, strict=True)]
        )
    # Bounds cannot be evaluated without their states.
    missing = [s for s in form.states if s not in residuals.states]
    if missing:
        raise BadInputError(
            f"the bounds depend on {', '.join(missing)}, which these flights do not have throughout"
        )
    warnings = flight_warnings(flights, form, cutoffs)
    if form.aircraft.sha256 != content_hash(aircraft):
        warnings.append(
            f"aircraft '{aircraft.name}' has changed since the bounds were made; they belong to the"
            " earlier model"
        )
    for flight, sha256 in zip(flights, hashes, strict=True):
        used = used_for_bounds(form, sha256)
        if sha256 in {f.sha256 for f in form.flights} and (
            not used or inside(flight.record, used).any()
        ):
            warnings.append(
                f"{flight.name}: the bounds were made from this flight; coverage on it validates"
                " nothing"
            )
    std = {
        c: b.parts.flight if b.parts is not None else float("nan")
        for c, b in form.coefficients.items()
    }
    shares = coverage(form, residuals)
    return Validation(
        shares,
        residuals,
        (*(n for f in flights for n in f.notes), *_needed_notes(shares, residuals)),
        tuple(warnings),
        std,
    )


def _needed_notes(shares: Mapping[str, Coverage], residuals: Residuals) -> list[str]:
    """Return how many seconds would decide about the bounds that a flight is too short for."""
    seconds = sum(float(p.time_s[-1] - p.time_s[0]) for p in residuals.pieces)
    # The standard error of a share falls with the square root of the time.
    needed = {
        c: seconds * (row.error[0.95] / MAX_SHARE_ERROR) ** 2
        for c, row in shares.items()
        if verdict(row.share[0.95], row.error[0.95], 0.95) == "inconclusive"
    }
    text = ", ".join(f"{c} {s:.0f} s" for c, s in needed.items() if np.isfinite(s))
    return (
        [f"{seconds:.0f} s are judged; about as much is needed to decide: {text}"] if text else []
    )


def verdicts(validation: Validation) -> dict[str, Verdict]:
    """Return, by coefficient, whether its 95 % bounds hold on these flights."""
    return {
        c: verdict(row.share[0.95], row.error[0.95], 0.95) for c, row in validation.coverage.items()
    }


def failed(validation: Validation) -> tuple[str, ...]:
    """Return the coefficients whose 95 % bounds do not hold."""
    return tuple(c for c, outcome in verdicts(validation).items() if outcome == "fails")
