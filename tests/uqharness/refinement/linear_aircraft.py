"""A linear aircraft of three states with known answers, for the search for effects without JSBSim.

States alpha, q and the integral of q in deviations from trim; the elevator is the only control.
Parameters enter q' linearly; effects are further terms of q'. Measured are alpha and q, with white
noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.effects import Effect, normal_equations
from sysid.effects.catalogue import coefficient_effect
from sysid.effects.information import Information
from sysid.effects.selection import Selection
from tests.helpers.whitened import whitened
from uqharness.identification.linearised import (
    FlightData,
    Linearisation,
    ModelFit,
    ModelState,
    Trajectory,
)
from uqharness.refinement.candidate_model import (
    CandidateModel,
    SearchContext,
    with_selection,
)
from uqharness.refinement.estimators import ReplayEstimator

DT = 0.02
NOISE = np.array([0.002, 0.005])
PARAMETERS = {"aero/Cm_alpha": -20.0, "aero/Cm_q": -3.0, "aero/Cm_de": -0.5}
TERMS = {
    "Cm/alpha^2": lambda a, q, de: a**2,
    "Cm/alpha^3": lambda a, q, de: a**3,
    "Cm/q_hat^2": lambda a, q, de: q**2,
    "Cm/de^2": lambda a, q, de: de**2,
    "Cm/de^3": lambda a, q, de: de**3,
    "Cm/alpha*de": lambda a, q, de: a * de,
}
EFFECTS = {e.key: e for e in (coefficient_effect("Cm", k.partition("/")[2]) for k in TERMS)}


def elevator(seed: int, seconds: float = 16.0) -> np.ndarray:
    """Doublets of two sizes and several lengths [deg]."""
    rng = np.random.default_rng(seed)
    out = np.zeros(round(seconds / DT))
    k = 50
    while k < len(out) - 200:
        n, size = int(rng.integers(15, 60)), float(rng.choice([-4.0, -2.0, 2.0, 4.0]))
        out[k : k + n], out[k + n : k + 2 * n] = size, -size
        k += 2 * n + 60
    return out


def simulate(values: Mapping[str, np.ndarray], de: np.ndarray) -> np.ndarray:
    """(n, 2, L) alpha and q from trim, by Euler steps, of L models side by side."""
    lanes = np.broadcast_shapes(*(np.shape(v) for v in values.values()))
    out = np.zeros((len(de), 2, *lanes))
    a, q = np.zeros(lanes), np.zeros(lanes)
    for k, deflection in enumerate(de.tolist()):
        out[k] = a, q
        moment = values["aero/Cm_alpha"] * a + values["aero/Cm_q"] * q
        moment = moment + values["aero/Cm_de"] * (0.25 * deflection)
        for name, term in TERMS.items():
            if f"effect/{name}" in values:
                moment = moment + values[f"effect/{name}"] * term(a, q, deflection)
        # Beyond the stall the formulas end.
        a, q = np.clip(a + DT * (q - 2.0 * a), -0.5, 0.5), np.clip(q + DT * moment, -5.0, 5.0)
    return out


@dataclass
class LinearFlights:
    """Flights of a truth, and output error of models without JSBSim: the search's `ModelFitter`.

    fitted : keys of each model fitted, in order
    """

    truth: Mapping[str, float]
    seeds: Sequence[int] = (1, 2, 3)
    fitted: list[tuple[str, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(7)
        self.commands = [elevator(seed) for seed in self.seeds]
        self.measured = [
            y + NOISE * rng.standard_normal(y.shape)
            for y in (simulate(self.truth, de) for de in self.commands)
        ]

    def linearise(self, values: Mapping[str, float], names: Sequence[str]) -> Information:
        """Information of columns by finite differences, about a model's own flights."""
        start_values = np.array([values.get(n, 0.0) for n in names])
        steps = 1e-4 * np.maximum(np.abs(start_values), 1.0)
        lanes = {
            n: np.where(np.arange(len(names) + 1) == c + 1, v + h, v)
            for c, (n, v, h) in enumerate(zip(names, start_values, steps, strict=True))
        }
        white = []
        for de, z in zip(self.commands, self.measured, strict=True):
            y = simulate(lanes, de)
            columns = (y[:, :, 1:] - y[:, :, :1]) / steps / NOISE[:, None]
            white.append(whitened((z - y[:, :, 0]) / NOISE, columns))
        return normal_equations(white, names, [0, 1, 0], {}, None)

    def estimate(self, keys: Sequence[str]) -> tuple[dict[str, float], float]:
        """Values of parameters and effects by Gauss-Newton, and the sum of squares over noise."""
        names = [*PARAMETERS, *keys]
        values = {**PARAMETERS, **dict.fromkeys(keys, 0.0)}
        information = self.linearise(values, names)
        cost = _cost(information)
        for _ in range(8):
            step, length = information.step()
            if length < 0.05:
                break
            for share in (1.0, 0.5, 0.2):
                changes = zip(values.items(), step, strict=True)
                trial = {n: v + share * float(d) for (n, v), d in changes}
                information = self.linearise(trial, names)
                if _cost(information) < cost:
                    break
            values, cost = trial, _cost(information)
        return values, cost

    def model_fit(self, keys: Sequence[str]) -> tuple[ModelFit, Information]:
        """A model's fit, and its information with the columns of all candidates."""
        values, cost = self.estimate(keys)
        information = self.linearise(values, [*PARAMETERS, *EFFECTS])
        free = (*PARAMETERS, *keys)
        trajectory = Trajectory(ModelState(values, {}, ()), [], [], [], cost)
        columns = [_Named(free)]
        fit = Linearisation(trajectory, [], [], columns, information, ())  # type: ignore[arg-type]
        data = FlightData((), (), (), ("alpha_rad", "q_radps"), (), NOISE, (), {})
        return ModelFit(data, fit, cost, None), information

    def context(self, critical_t: float | None = None) -> tuple[SearchContext, Information]:
        """The search's context, and the information of the model without effects."""
        model, information = self.model_fit(())
        estimator = ReplayEstimator()
        candidates: dict[str, Effect] = EFFECTS
        if critical_t is None:
            critical_t = estimator.critical_t(information, [*PARAMETERS], [*candidates])
        cost = model.neg2_log_likelihood
        context = SearchContext(
            model.data, model.fit, tuple(PARAMETERS), candidates, {}, critical_t, cost, estimator
        )
        return context, information

    def fit(
        self, context: SearchContext, proposal: Selection, reference: CandidateModel, label: str
    ) -> CandidateModel | None:
        """Fit the proposed effects to the flights."""
        keys = list(proposal.values)
        self.fitted.append(tuple(keys))
        model, information = self.model_fit(keys)
        values = {k: model.fit.trajectory.point.values[k] for k in keys}
        information = information.without_values(values)
        return with_selection(context, model, information, keys, values, {})

    def final_fit(
        self, context: SearchContext, model: CandidateModel, label: str
    ) -> CandidateModel:
        """The model as it is: it is output error already."""
        return model


def _cost(information: Information) -> float:
    return float(sum(np.sum(w.residual**2) for w in information.white))


@dataclass(frozen=True)
class _Named:
    """The names of a fit's columns."""

    names: tuple[str, ...]
