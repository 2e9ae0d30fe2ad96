"""What a flight's residual coefficients hold beside the model's error: noise of its sensors, and the air's own rotation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
from uqharness.replay import Flight, ReplayPair, flight_residuals, prediction_of
from uqharness.simulator import Aircraft, content_hash
from uqharness.text_tables import Tabled

if TYPE_CHECKING:
    import pandas as pd

VANES = ("alpha_rad", "beta_rad")


def noise_sizes(
    flight: Flight, stated: Mapping[str, float], cutoffs: Cutoffs
) -> dict[str, NoiseSize]:
    """White noise of each channel: what the flight's samples show above the filter's cut-off, the card's figure as prior.

    stated: channel -> standard deviation that the card gives.
    """
    record = flight.record
    out = {}
    for name in SENSOR_CHANNELS:
        if name not in record:
            continue
        pieces = [np.asarray(record[name][p.rows], dtype=float) for p in flight.pieces]
        found = noise_size(
            [x for x in pieces if np.isfinite(x).all()],
            record.dt_s,
            cutoffs.all_hz,
            stated.get(name),
        )
        if found is not None:
            out[name] = found
    return out


@dataclass(frozen=True)
class NoisyFlight:
    """A flight's residuals with the noise that its own sensors have put in, and what tells of the air's rotation.

    std   channel -> of its noise        air   none where alpha or beta come from an estimator, which feels no gusts
    """

    residuals: Residuals
    std: Mapping[str, float]
    air: Sequence[AirPiece] | None
    arm_m: tuple[float, ...]

    @staticmethod
    def of(
        pair: ReplayPair, flight: Flight, residuals: Residuals, aircraft: Aircraft
    ) -> NoisyFlight:
        """Asks the model for what noise and rotation would change."""
        sizes = noise_sizes(flight, aircraft.card.sensors.noise_std, residuals.cutoffs)
        std = {c: found.std for c, found in sizes.items()}
        # Rates moved by noise's probe and by rotation's are the same states: asked once.
        model, arm = pair.around(flight), tuple(aircraft.accelerometer_m)
        pair.ahead_near(flight, offset_records(flight.record, residuals.cutoffs), flight.pieces)
        noisy = with_sensor_noise(
            residuals,
            flight.record,
            flight.pieces,
            model,
            arm,
            std,
            relative_std={c: found.relative_std for c, found in sizes.items()},
        )
        felt = not set(VANES) & set(flight.record.metadata.estimates)
        air = (
            air_pieces(flight.record, flight.pieces, model, residuals.cutoffs.airspeed_hz)
            if felt
            else None
        )
        return NoisyFlight(noisy, std, air, arm)

    def in_still_air(self, residuals: Residuals) -> tuple[Residuals, AirRotation | None]:
        """Residuals of the flight behind any filter, with noise, without the rotation of the air."""
        return (
            (residuals, None)
            if self.air is None
            else without_air_rotation(residuals, self.air, self.arm_m, self.std)
        )


def noisy_residuals(
    pair: ReplayPair, flight: Flight, residuals: Residuals, aircraft: Aircraft
) -> Residuals:
    """A flight's residuals with the noise of its sensors and of the air's rolling, without the air's rotation."""
    noisy = NoisyFlight.of(pair, flight, residuals, aircraft)
    return noisy.in_still_air(noisy.residuals)[0]


def said_of_air(flight: Flight, air: AirRotation) -> str:
    """What was taken for the air's."""
    return (
        f"{flight.name}: {100.0 * air.share:.0f} ± {100.0 * air.std:.0f} % of the rotation that frozen gusts have is in the "
        "residuals; it is the air's, not the model's, and was taken out"
    )


# Model-form bounds of a JSBSim aircraft: flights in, a ModelForm and all that is needed to
# judge it out. Writes nothing.


@dataclass(frozen=True)
class BoundsOptions:
    """How bounds are made. outside: what the intervals do beyond the data; checks: noise floor, leave-one-out, other cut-offs.
    values: of properties that are not to be as in the aircraft's XML."""

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
    """One other filter: its cut-offs, and per coefficient the mean width."""

    cutoffs: Cutoffs
    width: Mapping[str, float]


@dataclass(frozen=True)
class MadeBounds(Tabled):
    """A model form with its evidence.

    widths       coefficient -> mean width of the bounds over the data         noise  -> rms of the sensors' noise in a sample
    baseline     the default states' bounds where other states were asked for, for comparison
    left_out     manoeuvre -> coefficient -> share inside the bounds of the others        cutoffs  other filters
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
        """The table of coefficients: samples, effective ones, standard deviation, mean width, noise, walk rate, parts."""
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
    """Sizes of the parts [-]; none where noise and model error were kept together."""
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
    say: Callable[[str], object] = lambda stage: None,
) -> MadeBounds:
    """Fit the intervals. hashes: SHA-256 of each flight's file; ``say`` is told each stage.

    Raises BadInputError when the flights are too short for any fit.
    """
    arm = aircraft.accelerometer_m
    flights = [f.with_commands_as_felt() for f in flights] if options.ideal_servos else flights
    with prediction_of(aircraft, measured, options.ideal_servos, options.values) as pair:
        say("residual coefficients")
        parts = [flight_residuals(pair, f, arm, options.cutoffs) for f in flights]
        say("sensor noise")
        noisy = [NoisyFlight.of(pair, f, r, aircraft) for f, r in zip(flights, parts, strict=True)]
        still = (
            [n.in_still_air(n.residuals) for n in noisy]
            if options.fit.noise == "apart"
            else [(n.residuals, None) for n in noisy]
        )
        residuals = combine_flights([r for r, _ in still])
        say("model error apart from noise" if options.fit.noise == "apart" else "intervals")
        fitted = _fit(residuals, options.designs, options.fit)
        table = []
        if options.checks:
            say("other filters")
            table = [
                _other(pair, flights, noisy, arm, c, options)
                for c in _other_cutoffs(options.cutoffs)
            ]
    walks = {
        c: variation(residuals, c, f.bounds, options.walk_cutoff_hz, options.outside)
        for c, f in fitted.items()
    }
    form = ModelForm(
        aircraft=AircraftReference(aircraft.name, content_hash(aircraft)),
        flights=tuple(_used(f, r, h) for f, r, h in zip(flights, parts, hashes, strict=True)),
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
    say("leaving manoeuvres out")
    left_out = (
        leave_one_out(residuals, options.designs, options.fit, options.outside, fitted)
        if options.checks
        else {}
    )
    said = [
        said_of_air(f, air)
        for f, (_, air) in zip(flights, still, strict=True)
        if air is not None and air.level > 0.0
    ]
    return MadeBounds(
        form=form,
        residuals=residuals,
        fitted=fitted,
        baseline=_baseline(residuals, options),
        variations=walks,
        widths=mean_widths(form, residuals),
        noise=_forced(combine_flights([n.residuals for n in noisy])),
        left_out=left_out,
        cutoffs=tuple(table),
        notes=(
            *(n for f in flights for n in f.notes),
            *said,
            *_notes_of(fitted),
        ),
        warnings=tuple(_warnings(aircraft, flights, hashes, form, walks, options.cutoffs)),
    )


def _notes_of(fitted: Mapping[str, FittedBounds]) -> list[str]:
    """Return the notes of all coefficients; one that several share names them and stands once."""
    coefficients: dict[str, list[str]] = {}
    for c, f in fitted.items():
        for note in f.notes:
            coefficients.setdefault(note.removeprefix(f"{c}: "), []).append(c)
    return [f"{', '.join(names)}: {text}" for text, names in coefficients.items()]


def _fit(
    residuals: Residuals, designs: Mapping[str, Design], options: FitOptions
) -> dict[str, FittedBounds]:
    try:
        return fit_bounds(residuals, designs, options)
    except ValueError as error:
        raise BadInputError(str(error)) from None


def _baseline(residuals: Residuals, options: BoundsOptions) -> dict[str, CoefficientBounds]:
    """Default bounds of the coefficients whose states or terms were chosen by the user (Fig 2.10's blue lines)."""
    usual = default_designs()
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
    """Mean width of the bounds over a flight's own states."""
    return {
        c: float(np.mean(high - low)) for c, (low, high) in form.bounds(residuals.states).items()
    }


def _forced(residuals: Residuals) -> dict[str, float]:
    """Root mean square of the sensors' noise in each coefficient's samples [-]."""
    variance = np.concatenate(
        [noise_variance(p.noise) for p in residuals.pieces if p.noise is not None]
    )
    return dict(zip(COEFFICIENTS, np.sqrt(variance.mean(axis=0)).tolist(), strict=True))


def _other_cutoffs(used: Cutoffs) -> list[Cutoffs]:
    """Half and twice the filter, and the airspeed at half, twice and without its low-pass."""
    return [
        Cutoffs(0.5 * used.all_hz, used.airspeed_hz),
        Cutoffs(2.0 * used.all_hz, used.airspeed_hz),
        *([Cutoffs(used.all_hz, 0.5 * used.airspeed_hz)] if np.isfinite(used.airspeed_hz) else []),
        Cutoffs(used.all_hz, float("inf")),
    ]


def _other(
    pair: ReplayPair,
    flights: Sequence[Flight],
    used: Sequence[NoisyFlight],
    arm: Sequence[float],
    cutoffs: Cutoffs,
    options: BoundsOptions,
) -> CutoffRow:
    try:
        parts = [
            with_noise_of(flight_residuals(pair, f, arm, cutoffs), u.residuals)
            for f, u in zip(flights, used, strict=True)
        ]
        if options.fit.noise == "apart":
            parts = [u.in_still_air(r)[0] for u, r in zip(used, parts, strict=True)]
        residuals = combine_flights(parts)
        fitted = fit_bounds(residuals, options.designs, options.fit)
    except (ValueError, BadInputError):
        return CutoffRow(cutoffs, dict.fromkeys(options.designs, float("nan")))
    return CutoffRow(cutoffs, {c: _mean_width(f.bounds, residuals) for c, f in fitted.items()})


def _mean_width(bounds: CoefficientBounds, residuals: Residuals) -> float:
    low, high = bounds.bounds(residuals.states)
    return float(np.mean(high - low))


def mean_left_out(
    residuals: Residuals, left_out: Mapping[str, Mapping[str, float]]
) -> dict[str, float]:
    """Share inside when manoeuvres are left out, over all samples; NaN without a second manoeuvre."""
    if not left_out:
        return dict.fromkeys(COEFFICIENTS, float("nan"))
    named = with_distinct_labels(residuals)
    n = {label: sum(named.only([label]).lengths) for label in left_out}
    names = next(iter(left_out.values()))
    return {
        c: float(np.average([left_out[m][c] for m in left_out], weights=[n[m] for m in left_out]))
        for c in names
    }


def _used(flight: Flight, residuals: Residuals, sha256: str) -> FlightUsed:
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
    out = [*flight_warnings(flights, form, cutoffs), *_identified_from(aircraft, flights, hashes)]
    short = [c for c, w in walks.items() if not np.isfinite(w.rate)]
    if short:
        out.append(
            f"no piece is long enough for a rate of variation of {', '.join(short)} at {form.filtering.walk_cutoff_hz:g} Hz"
        )
    return out


def flight_warnings(flights: Sequence[Flight], form: ModelForm, cutoffs: Cutoffs) -> list[str]:
    """What weakens these flights' residuals: estimated angles, channels slower than the filter, other rates than the form's."""
    out = []
    for flight in flights:
        record = flight.record
        estimated = [c for c in record.metadata.estimates if c in SENSOR_CHANNELS]
        if estimated:
            out.append(
                f"{flight.name}: {', '.join(estimated)} come from an estimator, not a sensor: its errors are in the intervals"
            )
        slow = [
            c
            for c, hz in record.metadata.native_hz.items()
            if c in SENSOR_CHANNELS and hz < 2.5 * cutoffs.all_hz and c != "V_mps"
        ]
        if slow:
            out.append(
                f"{flight.name}: {', '.join(slow)} were logged too slowly for a filter at {cutoffs.all_hz:g} Hz; lower --cutoff-hz"
            )
        rate = 1.0 / record.dt_s
        if abs(rate / form.filtering.rate_hz - 1.0) > 0.1:
            out.append(
                f"{flight.name}: {rate:.0f} samples a second, the form's first flight had {form.filtering.rate_hz:.0f}: the same "
                "cut-off passes another share of the noise"
            )
    return out


def _identified_from(
    aircraft: Aircraft, flights: Sequence[Flight], hashes: Sequence[str]
) -> list[str]:
    """Flights that the aircraft's parameters were estimated from, by the fit.json beside an identified aircraft."""
    path = aircraft.folder.parent / "fit.json"
    try:
        document = parse_json(read_regular(path))
        known, names = document.get("flights_sha256", []), document.get("flights", [])
        known, names = ([text for text in row if isinstance(text, str)] for row in (known, names))
    except (OSError, ValueError, AttributeError, TypeError):
        return []
    out = []
    for flight, sha256 in zip(flights, hashes, strict=True):
        if sha256 in known or (not known and any(Path(n).stem == flight.name for n in names)):
            out.append(
                f"{flight.name}: {path} says that the model was identified from this flight; its residuals are too small for "
                "bounds. Use another flight"
            )
    return out


# How the polynomials of bounds are written on the command line: --states, --terms, --order,
# --roll-terms.

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
    """Designs from --states, --terms, --order and --roll-terms. Raises BadInputError."""
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
                f"--states {text}: {f'unknown state {unknown[0]}' if unknown else 'a state is named twice'}; "
                f"allowed are {', '.join(_SHORT)}"
            )
        designs[coefficient] = Design(tuple(_SHORT.get(n, n) for n in names), None, order)
    for text in terms:
        coefficient, names = _assignment("--terms", text, list(designs))
        written = ["*".join(_long(f) for f in name.split("*")) for name in names]
        used = tuple(
            s
            for s in STATES
            if any(s == f.split("^")[0] for name in written for f in name.split("*"))
        )
        try:
            chosen = tuple(parse_term(name, used) for name in written)
        except ValueError as error:
            raise BadInputError(
                f"--terms {text}: {error}; states are {', '.join(_SHORT)}"
            ) from None
        if len(set(chosen)) < len(chosen) or not used:
            raise BadInputError(
                f"--terms {text}: {'a term is named twice' if used else 'no term depends on a state'}"
            )
        designs[coefficient] = Design(used, chosen)
    return designs


def _long(factor: str) -> str:
    state, caret, power = factor.strip().partition("^")
    return f"{_SHORT.get(state, state)}{caret}{power}"


def _assignment(option: str, text: str, known: list[str]) -> tuple[str, list[str]]:
    coefficient, equals, rest = text.partition("=")
    names = [n.strip() for n in rest.split(",") if n.strip()]
    if not equals or not names or coefficient not in known:
        raise BadInputError(
            f"{option} {text}: C=name,name with C one of {', '.join(known)} is needed, such as {option} CX=V,alpha"
        )
    return coefficient, names


# Bounds held against flights that they have not seen.


@dataclass(frozen=True)
class Validation:
    """Coverage of a form on flights it has not seen. warnings: why it may mean less than it seems to.

    flight_std: coefficient -> standard deviation of model error from flight to flight [-], NaN: not estimable from the flights
    behind the form.
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
    ideal_servos: bool = False,
    values: Mapping[str, float] | None = None,
) -> Validation:
    """Filter the flights as the form's own were, and count. Raises BadInputError for another aircraft's form and missing states.

    values: of properties that are not to be as in the aircraft's XML.
    """
    if form.aircraft.name != aircraft.name:
        raise BadInputError(
            f"the bounds belong to aircraft '{form.aircraft.name}', not to '{aircraft.name}': residuals of one model "
            "say nothing about another; make bounds for this one (uqharness bounds)"
        )
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    arm = aircraft.accelerometer_m
    flights = [f.with_commands_as_felt() for f in flights] if ideal_servos else flights
    with prediction_of(aircraft, measured, ideal_servos, values) as pair:
        parts = [flight_residuals(pair, f, arm, cutoffs) for f in flights]
        residuals = combine_flights(
            [noisy_residuals(pair, f, r, aircraft) for f, r in zip(flights, parts, strict=True)]
        )
    missing = [s for s in form.states if s not in residuals.states]
    if missing:
        raise BadInputError(
            f"the bounds depend on {', '.join(missing)}, which these flights do not have throughout"
        )
    warnings = flight_warnings(flights, form, cutoffs)
    if form.aircraft.sha256 != content_hash(aircraft):
        warnings.append(
            f"aircraft '{aircraft.name}' has changed since the bounds were made: they belong to the model as it was"
        )
    for flight, sha256 in zip(flights, hashes, strict=True):
        if sha256 in {f.sha256 for f in form.flights}:
            warnings.append(
                f"{flight.name}: the bounds were made from this flight; coverage on it validates nothing"
            )
    std = {
        c: b.parts.flight if b.parts is not None else float("nan")
        for c, b in form.coefficients.items()
    }
    return Validation(
        coverage(form, residuals),
        residuals,
        tuple(n for f in flights for n in f.notes),
        tuple(warnings),
        std,
    )


def verdicts(found: Validation) -> dict[str, Verdict]:
    """Coefficient -> whether its 95 % bounds hold on these flights."""
    return {c: verdict(row.share[0.95], row.error[0.95], 0.95) for c, row in found.coverage.items()}


def failed(found: Validation) -> tuple[str, ...]:
    """Coefficients whose 95 % bounds do not hold."""
    return tuple(c for c, said in verdicts(found).items() if said == "fails")
