"""Bounds held against flights that they have not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sysid.aerodynamics import Cutoffs, Residuals, together
from sysid.errors import LogError
from sysid.model_form import Coverage, ModelForm, Verdict, read_model_form, verdict
from sysid.model_form.coverage import coverage
from uqharness.errors import BadInputError
from uqharness.identification.model_form import flight_warnings
from uqharness.identification.noisy_flight import noisy_residuals
from uqharness.replay import Flight, flight_residuals, prediction_of
from uqharness.simulator import Aircraft, content_hash


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
        residuals = together(
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
