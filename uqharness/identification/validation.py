"""Bounds held against flights that they have not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sysid.aerodynamics import Cutoffs, Residuals, together
from sysid.errors import LogError
from sysid.model_form import Coverage, ModelForm, read_model_form
from sysid.model_form.coverage import coverage
from uqharness.errors import BadInputError
from uqharness.identification.model_form import flight_warnings
from uqharness.replay import Flight, flight_residuals, prediction_of
from uqharness.simulator import Aircraft, content_hash

HOLDS_FROM = 0.85
"""Share of a new flight that 95 % bounds must contain to be said to hold: single flights scatter by 0.02 to 0.04."""


@dataclass(frozen=True)
class Validation:
    """Coverage of a form on flights it has not seen. warnings: why it may mean less than it seems to."""

    coverage: Mapping[str, Coverage]
    residuals: Residuals
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def load_form(path: Path) -> ModelForm:
    """Read model-form.json. Raises BadInputError."""
    try:
        return read_model_form(path)
    except LogError as error:
        raise BadInputError(str(error)) from None


def validate(
    aircraft: Aircraft, form: ModelForm, flights: Sequence[Flight], measured: Sequence[str], hashes: Sequence[str],
    ideal_servos: bool = False,
) -> Validation:  # fmt: skip
    """Filter the flights as the form's own were, and count. Raises BadInputError for another aircraft's form and missing states."""
    if form.aircraft.name != aircraft.name:
        raise BadInputError(
            f"the bounds belong to aircraft '{form.aircraft.name}', not to '{aircraft.name}': residuals of another model are "
            "another thing; make bounds for this one (uqharness bounds)"
        )
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    arm = aircraft.accelerometer_m
    flights = [f.with_commands_as_felt() for f in flights] if ideal_servos else flights
    with prediction_of(aircraft, measured, ideal_servos) as pair:
        residuals = together([flight_residuals(pair, f, arm, cutoffs) for f in flights])
    missing = [s for s in form.states if s not in residuals.states]
    if missing:
        raise BadInputError(f"the bounds depend on {', '.join(missing)}, which these flights do not have throughout")
    warnings = flight_warnings(flights, form, cutoffs)
    if form.aircraft.sha256 != content_hash(aircraft):
        warnings.append(f"aircraft '{aircraft.name}' has changed since the bounds were made: they belong to the model as it was")
    for flight, sha256 in zip(flights, hashes, strict=True):
        if sha256 in {f.sha256 for f in form.flights}:
            warnings.append(f"{flight.name}: the bounds were made from this flight; coverage on it validates nothing")
    return Validation(coverage(form, residuals), residuals, tuple(n for f in flights for n in f.notes), tuple(warnings))


def failed(found: Validation) -> tuple[str, ...]:
    """Coefficients whose 95 % bounds contain less than HOLDS_FROM of the samples."""
    return tuple(c for c, row in found.coverage.items() if not row.share[0.95] >= HOLDS_FROM)
