"""[aleatory.variables."PROPERTY"] of campaign.toml: what differs from flight to flight besides air and noise, such as the load."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from uqharness.settings import Number, Section, tupled

Pair = tuple[Number, Number]


class VariableSection(Section):
    """One random property, drawn once a flight. normal: ``mean``, ``std``; uniform: ``low``, ``high``, or ``mean``, ``half_width``.

    ``mean`` may be an interval [low, high]: then where the mean lies is not known, which is an epistemic input of its own.
    Units are those of the JSBSim property (its name says them).
    """

    distribution: Literal["normal", "uniform"]
    mean: Annotated[Number | Pair | None, BeforeValidator(tupled)] = None
    std: Annotated[Number, Field(gt=0)] | None = None
    low: Number | None = None
    high: Number | None = None
    half_width: Annotated[Number, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> VariableSection:
        given = {
            name
            for name in ("mean", "std", "low", "high", "half_width")
            if getattr(self, name) is not None
        }
        allowed = (
            [{"mean", "std"}]
            if self.distribution == "normal"
            else [{"low", "high"}, {"mean", "half_width"}]
        )
        if given not in allowed:
            needs = " or ".join(" and ".join(sorted(names, key=_ORDER.index)) for names in allowed)
            got = ", ".join(sorted(given, key=_ORDER.index)) or "none"
            raise ValueError(
                f'distribution = "{self.distribution}" needs {needs}, and no more; received {got}'
            )
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"low = {self.low:g} must be less than high = {self.high:g}")
        if isinstance(self.mean, tuple) and not self.mean[0] < self.mean[1]:
            raise ValueError(
                f"mean = [{self.mean[0]:g}, {self.mean[1]:g}]: an interval is [low, high] with low < high"
            )
        return self

    @property
    def mean_interval(self) -> Pair | None:
        """Ends of an uncertain mean; None where the mean is known."""
        return self.mean if isinstance(self.mean, tuple) else None

    def value(self, unit_draw: float, mean_level: float) -> float:
        """The variable for a draw in its unit (standard normal, or uniform in -1..1) and a level 0..1 of an uncertain mean."""
        if self.mean is None:
            assert self.low is not None
            assert self.high is not None
            return 0.5 * (self.low + self.high) + 0.5 * (self.high - self.low) * unit_draw
        mean = self.mean
        centre = mean[0] + mean_level * (mean[1] - mean[0]) if isinstance(mean, tuple) else mean
        spread = self.std if self.std is not None else self.half_width
        assert spread is not None
        return centre + spread * unit_draw


_ORDER = ("mean", "std", "low", "high", "half_width")
