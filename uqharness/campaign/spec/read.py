"""campaign.toml read: every mistake named with its line, and the number of flights that its rule asks for."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from uqharness.campaign.inputs import read_inputs
from uqharness.campaign.spec.campaign import AleatorySection, CampaignSpec, Document
from uqharness.campaign.spec.epistemic import MOST_SAMPLES
from uqharness.campaign.spec.stop import without_flights
from uqharness.errors import BadInputError
from uqharness.flight import BELOW_CEILING, TURBULENCE_CEILING_M
from uqharness.toml import as_toml, explain, line_of, read_toml


def read_campaign(path: str | Path) -> CampaignSpec:
    """Read and validate a campaign file. Raises BadInputError that lists every mistake as ``file:line: ...``."""
    path = Path(path)
    data, text = read_toml(path)
    return campaign_from(data, path, text)


def checked_settings(data: dict[str, Any]) -> dict[str, Any]:
    """Settings of a campaign as a manifest holds them, defaults filled in. Looks at no file; raises pydantic's ValidationError."""
    document = Document.model_validate(without_flights(data))
    return document.model_dump(mode="json", exclude_none=True)


def campaign_from(data: dict[str, Any], path: Path, text: str = "") -> CampaignSpec:
    """Validate the content of a campaign file, as TOML or a manifest holds it. ``path`` is where files it names are looked for."""
    try:
        document = Document.model_validate(without_flights(data))
    except ValidationError as error:
        problems = [explain(Document, text, data, dict(item)) for item in error.errors()]
        lines = [f"{path}:{line}: {message}" for line, message in sorted(problems)]
        raise BadInputError(*dict.fromkeys(lines)) from None
    sections = {name: getattr(document, name) for name in Document.model_fields}
    inputs = read_inputs(document.epistemic, path.resolve().parent)
    spec = CampaignSpec(path, text, **sections, inputs=inputs)
    return settled(spec, stated="flights" in data["aleatory"])


def settled(spec: CampaignSpec, stated: bool) -> CampaignSpec:
    """The campaign with the number of flights its rule asks for; ``stated``: the file gives a number as well.

    Raises BadInputError, with the line, where the two differ, where [stop] and [metrics] do not belong together, and where
    [epistemic] asks for what its bounds do not hold.
    """
    _agree_with_turbulence_model(spec)
    _agree_with_metrics(spec)
    _agree_with_form(spec)
    found, said = _planned(spec)
    if stated and found.aleatory.flights != spec.aleatory.flights:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('aleatory', 'flights'))}: [aleatory] flights = {spec.aleatory.flights}, but "
            f"[stop] {said} asks for {found.aleatory.flights}; leave [aleatory] flights out"
        )
    return found


def planned(spec: CampaignSpec) -> CampaignSpec:
    """The campaign with the number of flights its rule asks for, after something that bears on it has been changed."""
    return _planned(spec)[0]


def _agree_with_metrics(spec: CampaignSpec) -> None:
    stop, metrics = spec.stop, spec.metrics
    if stop.radius_m is not None and stop.radius_m not in metrics.excursion_radius_m:
        known = ", ".join(f"{radius:g}" for radius in metrics.excursion_radius_m)
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('stop', 'radius_m'))}: [stop] radius_m = {stop.radius_m:g}: must be among "
            f"[metrics] excursion_radius_m ({known})"
        )
    zone = stop.indifference_per_h
    if zone is not None and not zone[0] <= metrics.acceptable_per_h <= zone[1]:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('stop', 'indifference_per_h'))}: [stop] indifference_per_h = [{zone[0]:g}, "
            f"{zone[1]:g}]: must hold [metrics] acceptable_per_h = {metrics.acceptable_per_h:g}"
        )


def _agree_with_turbulence_model(spec: CampaignSpec) -> None:
    """Refuse a [start] above the turbulence model; the height of a script's start is found out by flying it."""
    air, start = spec.aleatory, spec.start
    turbulent = [name for name in air.turbulence if name != "none"]
    if start is None or not turbulent or air.turbulence_source != "spec":
        return
    if start.altitude_m > TURBULENCE_CEILING_M:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('start', 'altitude_m'))}: [start] altitude_m = {start.altitude_m:g}: "
            f"[aleatory] turbulence = {as_toml(turbulent)} is the low-altitude model of MIL-F-8785C, which "
            f"reaches to {TURBULENCE_CEILING_M:g} m (1000 ft); {BELOW_CEILING}"
        )


@contextlib.contextmanager
def naming_keys(spec: CampaignSpec) -> Iterator[None]:
    """Put file, line and section before a flight's refusal that begins with the name of a key of [aleatory]."""
    try:
        yield
    except BadInputError as error:
        key = str(error).partition(" = ")[0]
        if type(error) is not BadInputError or key not in AleatorySection.model_fields:
            raise
        # A campaign from a Python dictionary has no lines.
        place = f"{spec.path}:{line_of(spec.source, ('aleatory', key))}: " if spec.source else ""
        raise BadInputError(f"{place}[aleatory] {error}") from None


def _agree_with_form(spec: CampaignSpec) -> None:
    section, form = spec.epistemic, spec.inputs.model_form
    if section.transient and not spec.inputs.has_parts:
        lacks = "bounds are no model-form.json" if form is None else f"{form} has no transient part"
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('epistemic', 'transient'))}: [epistemic] transient = true: {lacks}; make a "
            "model-form.json with `uqharness bounds`, or leave transient out"
        )
    if section.set == "ellipsoid" and form is None:
        raise BadInputError(
            f'{spec.path}:{line_of(spec.source, ("epistemic", "set"))}: [epistemic] set = "ellipsoid": it needs intervals whose '
            'confidence is known, bounds = "model-form.json"; bounds given as numbers, or an aircraft\'s own, are a box'
        )


def _planned(spec: CampaignSpec) -> tuple[CampaignSpec, str]:
    """The campaign with the flights its rule asks for, and what asks for them."""
    stop = spec.stop
    if stop.rule == "hours" and stop.hours is not None:
        said = f"hours = {stop.hours:g} of flights of {spec.aleatory.duration_s:g} s"
        return spec.with_hours(stop.hours), said
    if stop.rule == "band-width":
        # Imported here: pandas and scipy are for this rule alone.
        from uqharness.campaign.conditions import CONFIDENCE
        from uqharness.campaign.spec.samples import epistemic_samples
        from uqharness.statistics import flights_for_band

        assert stop.band_width is not None
        samples = len(epistemic_samples(spec))
        wanted = flights_for_band(stop.band_width, samples, CONFIDENCE)
        said = f"band_width = {stop.band_width:g} over {samples} epistemic samples"
        return spec.with_flights(wanted), said
    return spec, ""


def with_samples(spec: CampaignSpec, samples: int) -> CampaignSpec:
    """The same campaign with another number of drawn epistemic samples. Raises BadInputError where none are drawn."""
    if spec.epistemic.samples is None:
        raise BadInputError(
            f'--samples {samples}: {spec.path} draws no epistemic samples (method = "{spec.epistemic.method}"), '
            "so their number cannot be changed"
        )
    if not 1 <= samples <= MOST_SAMPLES:
        raise BadInputError(f"--samples {samples}: must be from 1 to {MOST_SAMPLES}")
    return planned(
        dataclasses.replace(spec, epistemic=spec.epistemic.model_copy(update={"samples": samples}))
    )
