"""Read and check campaign.toml.

`read_campaign` returns a `CampaignSpec` whose sections fit each other: metrics, turbulence model,
model form. It reports every mistake with its line, and fills in the number of flights that the
stopping rule requests.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from uqharness.campaign.sampling import epistemic_samples
from uqharness.campaign.spec import (
    AleatorySection,
    CampaignSpec,
    Document,
    read_inputs,
    without_flights,
)
from uqharness.errors import BadInputError
from uqharness.flight import (
    BELOW_CEILING,
    TURBULENCE_CEILING_M,
)
from uqharness.toml import as_toml, explain, line_of, read_toml


def read_campaign(path: str | Path) -> CampaignSpec:
    """Read and validate a campaign file.

    Parameters
    ----------
    path : str or Path
        campaign.toml.

    Returns
    -------
    CampaignSpec
        With the number of flights that its stopping rule requests.

    Raises
    ------
    BadInputError
        Lists every mistake as ``file:line: ...``.
    """
    path = Path(path)
    data, text = read_toml(path)
    return campaign_from(data, path, text)


def checked_settings(data: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a manifest with defaults filled in.

    No file is read. Raises pydantic's ValidationError.
    """
    document = Document.model_validate(without_flights(data))
    return document.model_dump(mode="json", exclude_none=True)


def campaign_from(data: dict[str, Any], path: Path, text: str = "") -> CampaignSpec:
    """Validate the content of a campaign file, as TOML or a manifest holds it.

    ``path`` is where the files that it names are looked up. Raises BadInputError.
    """
    try:
        document = Document.model_validate(without_flights(data))
    except ValidationError as error:
        # Report all mistakes at once, in the order of their lines.
        problems = explain(Document, text, data, error)
        lines = [f"{path}:{line}: {message}" for line, message in problems]
        raise BadInputError(*dict.fromkeys(lines)) from None
    sections = {name: getattr(document, name) for name in Document.model_fields}
    inputs = read_inputs(document.epistemic, path.resolve().parent)
    spec = CampaignSpec(path, text, **sections, inputs=inputs)
    return with_planned_flights(spec, has_flights="flights" in data["aleatory"])


def with_planned_flights(spec: CampaignSpec, has_flights: bool) -> CampaignSpec:
    """Return the campaign with the number of flights that its rule requests.

    ``has_flights`` says whether the file gives a number as well. Raises BadInputError, with the
    line, if the two differ or if sections contradict each other.
    """
    _check_turbulence_model(spec)
    _check_metrics(spec)
    _check_model_form(spec)
    planned_spec, reason = _plan_flights(spec)
    if has_flights and planned_spec.aleatory.flights != spec.aleatory.flights:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('aleatory', 'flights'))}: [aleatory] flights ="
            f" {spec.aleatory.flights}, but [stop] {reason} needs"
            f" {planned_spec.aleatory.flights}; omit [aleatory] flights"
        )
    return planned_spec


def replan_flights(spec: CampaignSpec) -> CampaignSpec:
    """Return the campaign with the flights of its rule, after another setting was changed."""
    return _plan_flights(spec)[0]


def _check_metrics(spec: CampaignSpec) -> None:
    """Refuse a [stop] that does not fit [metrics]."""
    stop, metrics = spec.stop, spec.metrics
    if stop.radius_m is not None and stop.radius_m not in metrics.excursion_radius_m:
        radii = ", ".join(f"{radius:g}" for radius in metrics.excursion_radius_m)
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('stop', 'radius_m'))}: [stop] radius_m ="
            f" {stop.radius_m:g}: must be among [metrics] excursion_radius_m ({radii})"
        )
    zone = stop.indifference_per_h
    if zone is not None and not zone[0] <= metrics.acceptable_per_h <= zone[1]:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('stop', 'indifference_per_h'))}: [stop]"
            f" indifference_per_h = [{zone[0]:g}, {zone[1]:g}]: must hold [metrics]"
            f" acceptable_per_h = {metrics.acceptable_per_h:g}"
        )


def _check_turbulence_model(spec: CampaignSpec) -> None:
    """Refuse a [start] above the validity of the turbulence model; script starts are checked in
    flight.
    """
    air, start = spec.aleatory, spec.start
    turbulent = [name for name in air.turbulence if name != "none"]
    if start is None or not turbulent or air.turbulence_source != "spec":
        return
    if start.altitude_m > TURBULENCE_CEILING_M:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('start', 'altitude_m'))}: [start] altitude_m ="
            f" {start.altitude_m:g}: [aleatory] turbulence = {as_toml(turbulent)} is the"
            f" low-altitude model of MIL-F-8785C, which reaches to {TURBULENCE_CEILING_M:g} m (1000"
            f" ft); {BELOW_CEILING}"
        )


@contextlib.contextmanager
def naming_keys(spec: CampaignSpec) -> Iterator[None]:
    """Add file, line and section to a flight's refusal that begins with a key of [aleatory]."""
    try:
        yield
    except BadInputError as error:
        key = str(error).partition(" = ")[0]
        if type(error) is not BadInputError or key not in AleatorySection.model_fields:
            raise
        # A campaign from a dictionary has no lines.
        place = f"{spec.path}:{line_of(spec.source, ('aleatory', key))}: " if spec.source else ""
        raise BadInputError(f"{place}[aleatory] {error}") from None


def _check_model_form(spec: CampaignSpec) -> None:
    """Refuse [epistemic] settings that need a model form with other content."""
    section, form = spec.epistemic, spec.inputs.model_form
    if section.transient and not spec.inputs.has_parts:
        lacks = "bounds are no model-form.json" if form is None else f"{form} has no transient part"
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('epistemic', 'transient'))}: [epistemic] transient"
            f" = true: {lacks}; make a model-form.json with `uqharness bounds`, or omit transient"
        )
    if section.set == "ellipsoid" and form is None:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('epistemic', 'set'))}: [epistemic] set ="
            ' "ellipsoid": this needs intervals of known confidence, bounds = "model-form.json";'
            " bounds that are numbers, or in the aircraft, are a box"
        )


def _plan_flights(spec: CampaignSpec) -> tuple[CampaignSpec, str]:
    """Return the campaign with the flights of its rule, and the text that explains them."""
    stop = spec.stop
    if stop.rule == "hours" and stop.hours is not None:
        reason = f"hours = {stop.hours:g} of flights of {spec.aleatory.duration_s:g} s"
        return spec.with_hours(stop.hours), reason
    if stop.rule == "band-width":
        # Imported here because only this rule needs pandas and scipy.
        from uqharness.campaign.conditions import CONFIDENCE
        from uqharness.statistics import flights_for_band

        assert stop.band_width is not None
        samples = len(epistemic_samples(spec))
        flights = flights_for_band(stop.band_width, samples, CONFIDENCE)
        reason = f"band_width = {stop.band_width:g} over {samples} epistemic samples"
        return spec.with_flights(flights), reason
    return spec, ""


def with_samples(spec: CampaignSpec, samples: int) -> CampaignSpec:
    """Return the campaign with another number of drawn epistemic samples.

    Raises BadInputError if none are drawn.
    """
    if spec.epistemic.samples is None:
        raise BadInputError(
            f"--samples {samples}: {spec.path} draws no epistemic samples (method ="
            f' "{spec.epistemic.method}"), so their number cannot be changed'
        )
    return replan_flights(
        dataclasses.replace(spec, epistemic=spec.epistemic.model_copy(update={"samples": samples}))
    )
