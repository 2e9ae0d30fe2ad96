"""[stop] of campaign.toml: when the flying ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from uqharness.settings import Number, Section, tupled

_OF_RULE: Mapping[str, tuple[str, ...]] = {
    "flights": (),
    "hours": ("hours",),
    "band-width": ("band_width",),
    "decide": (
        "radius_m",
        "indifference_per_h",
        "error_rate",
        "simultaneous_over",
        "answer_for",
        "look_every",
    ),
}
_SETS_FLIGHTS = {"hours": "hours", "band-width": "band_width"}


class StopSection(Section):
    """When it ends.

    ``flights``: [aleatory] flights everywhere. ``hours``: that many flight hours per corner and condition. ``band-width``: as many
    flights as bring the p-box's band within ``band_width`` (probability) of its envelope. All three are known beforehand.
    ``decide``: a cell ends once "at most [metrics] acceptable_per_h excursions beyond radius_m?" is answered, [aleatory] flights at
    the latest.
    """

    rule: Literal["flights", "hours", "band-width", "decide"] = "flights"
    hours: Annotated[Number, Field(gt=0)] | None = None
    band_width: Annotated[Number, Field(gt=0.001, le=1)] | None = None
    radius_m: Annotated[Number, Field(gt=0)] | None = None
    indifference_per_h: (
        Annotated[
            tuple[Annotated[Number, Field(gt=0)], Annotated[Number, Field(gt=0)]],
            BeforeValidator(tupled),
        ]
        | None
    ) = None
    error_rate: Annotated[Number, Field(gt=0, lt=0.5)] | None = None
    simultaneous_over: Literal["cell", "campaign"] | None = None
    answer_for: Literal["cell", "corner"] | None = None
    look_every: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _of_its_rule(self) -> StopSection:
        for rule, keys in _OF_RULE.items():
            strange = [key for key in keys if getattr(self, key) is not None and rule != self.rule]
            if strange:
                raise ValueError(f'{strange[0]} belongs to rule = "{rule}", not to "{self.rule}"')
        if self.rule == "band-width" and self.band_width is None:
            raise ValueError('rule = "band-width" needs band_width, a probability such as 0.1')
        if (
            self.indifference_per_h is not None
            and self.indifference_per_h[0] > self.indifference_per_h[1]
        ):
            raise ValueError("indifference_per_h must be [lower, upper]")
        return self


def without_flights(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The content of a file whose rule says how many flights there are, with a place for the number; any other as it is."""
    stop, air = data.get("stop"), data.get("aleatory")
    if not isinstance(stop, dict) or not isinstance(air, dict) or "flights" in air:
        return data
    key = _SETS_FLIGHTS.get(str(stop.get("rule")))
    return {**data, "aleatory": {**air, "flights": 1}} if key is not None and key in stop else data
