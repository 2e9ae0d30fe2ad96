"""Result of the search for effects, which the hold-out test, the document and the XML use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.effects import Effect, SelectedEffect, Selection, TurbulenceModel, conditional_interval
from uqharness.identification.linearised import FlightData, Linearisation
from uqharness.plugin import Estimate
from uqharness.refinement.estimators import Estimator, estimator_for


@dataclass(frozen=True)
class FormMismatch:
    """A curve in the states of selected effects that none of their forms describes.

    Attributes
    ----------
    coefficient, states, name : str, tuple of str, str
        The curve.
    gain : float
        Its gain in 2 ln L beside all effects.
    p : float
        Probability of such a gain by chance.
    replaced : tuple of str
        Keys of the effects that the curve may replace.
    """

    coefficient: str
    states: tuple[str, ...]
    name: str
    gain: float
    p: float
    replaced: tuple[str, ...]


@dataclass(frozen=True)
class SearchResult:
    """Result of a search on the training flights.

    Attributes
    ----------
    data : FlightData
    names : tuple of str
        Estimated parameters.
    before, after : Linearisation
        Fits without and with the effects; the same without effects.
    selection : Selection
    effects : mapping
        All candidates by key.
    parameters : mapping
        Property to its value and standard error for coloured residuals.
    values_without_effects : mapping
        Property to its value without effects.
    turbulence : TurbulenceModel or None
        The air; None if calm.
    scoreboard : tuple
        (name, t) of the candidates that explain most, each alone beside the parameters.
    critical_t : float
        |t| required of an effect.
    late_s : float
        Shift of all controls before the search [s].
    slopes : mapping
        Numbers with which effects of stall and propulsion are written.
    flown_values : mapping
        Value of each effect in ``after``, by key.
    unclear : tuple of SelectedEffect
        Effects that are too weak to be named beside unexplained residuals.
    mismatch : FormMismatch or None
        A curve that selected effects should have.
    strong_candidates : tuple
        (key, t) of other candidates with |t| above CERTAIN_T, the strongest first.
    """

    data: FlightData
    names: tuple[str, ...]
    before: Linearisation
    after: Linearisation
    selection: Selection
    effects: Mapping[str, Effect]
    parameters: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]
    values_without_effects: Mapping[str, float] = field(default_factory=dict)
    turbulence: TurbulenceModel | None = None
    scoreboard: tuple[tuple[str, float], ...] = ()
    critical_t: float = float("nan")
    late_s: float = 0.0
    trail: tuple[str, ...] = ()
    slopes: Mapping[str, float] = field(default_factory=dict)
    flown_values: Mapping[str, float] = field(default_factory=dict)
    unclear: tuple[SelectedEffect, ...] = ()
    mismatch: FormMismatch | None = None
    strong_candidates: tuple[tuple[str, float], ...] = ()

    @property
    def estimator(self) -> Estimator:
        """The estimator of the flights."""
        return estimator_for(self.turbulence)

    @property
    def controls_late_s(self) -> float:
        """By how much the controls act late in records whose clock is off: the shift, and the mean
        of what is estimated after it; 0 without a shift.
        """
        if not self.late_s:
            return 0.0
        nuisance = self.after.trajectory.point.nuisance
        estimates = [v for n, v in nuisance.items() if n.startswith("lateness/")]
        return self.late_s + float(np.mean(estimates or [0.0]))


def chosen_interval(effect: SelectedEffect, critical_t: float) -> tuple[float, float]:
    """Return the 95 % interval of an effect, conditional on its selection at |t| above
    ``critical_t``.

    The selection's |t| may be by a smaller standard error than the stated one.
    """
    selection_value = effect.t * effect.std
    ratio = abs(effect.value / selection_value) if selection_value else 1.0
    return conditional_interval(effect.value, effect.std, critical_t * ratio)


def remark(
    choice: SelectedEffect, effect: Effect, flights: Sequence[str], command: str, critical_t: float
) -> str:
    """Return the remark beside an effect's number in the XML."""
    low, high = chosen_interval(choice, critical_t)
    text = (
        f"{effect.name}: {choice.value:.5g} +/- {choice.std:.2g}, 95 % [{low:.5g}, {high:.5g}];"
        f" from {', '.join(flights)}"
    )
    return f"{text}; {command}" if command else text


def parameter_estimates(
    result: SearchResult, flights: Sequence[str], initial: Mapping[str, float]
) -> dict[str, Estimate]:
    """Return new values of the estimated parameters with their remarks."""
    return {
        n: Estimate(
            value, f"{value:.5g} +/- {std:.2g}, was {initial[n]:.5g}; refine; {', '.join(flights)}"
        )
        for n, (value, std) in result.parameters.items()
    }
