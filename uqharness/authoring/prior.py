"""The prior: how far vortex-lattice derivatives are from wind tunnel and flight, by class.

`evidence.csv` lists errors of published models against measurements. Mean and variance of a class
combine them, one vote per aircraft, with a first guess of no bias that counts as `GUESS_DOF`
aircraft (a normal-inverse-gamma prior); predictions then follow Student's t about that mean.
Classes with little evidence keep the guess and few degrees of freedom, and so are wide. The mean
moves the prior's centre; the written aircraft keeps the source's values.

The static margin is the parameter of pitch stability: Cm_alpha = static margin times CZ_alpha, so
that the error of the neutral point does not scale with a small Cm_alpha.

References: A. Gelman and others, Bayesian Data Analysis, 3rd ed., section 3.3.
"""

from __future__ import annotations

import csv
import importlib.resources
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.distributions import student_quantile
from sysid.model_form import (
    AircraftReference,
    CoefficientBounds,
    Filtering,
    Hull,
    ModelForm,
)
from uqharness.authoring.model import TERMS, AeroModel

GUESS_DOF = 3.0
"""Aircraft that the first guess of a class counts as."""
_GAUSSIAN_DOF = 1e6
CONFIDENCE = 0.95


@dataclass(frozen=True)
class ErrorClass:
    """A class of coefficients whose errors are alike.

    Attributes
    ----------
    guess : float
        First guess of the standard deviation.
    relative : bool
        Whether errors are over the predicted value's size.
    terms : tuple of str
        Members, as `aero/...` names them; factors of absolute classes follow in ``scale``.
    scale : mapping of str to float
        Error of a member over the class's error, where it is not 1.
    """

    guess: float
    relative: bool
    terms: tuple[str, ...]
    scale: Mapping[str, float]

    @property
    def has_mean(self) -> bool:
        """Return whether errors of all members have one sense: not where their signs differ."""
        return self.relative or len(self.terms) == 1


def _class(guess: float, relative: bool, *terms: str, **scale: float) -> ErrorClass:
    """Return a class."""
    return ErrorClass(guess, relative, terms, scale)


CLASSES: Mapping[str, ErrorClass] = {
    "lift slope": _class(0.10, True, "CZ_alpha"),
    "lift at zero alpha": _class(0.06, False, "CZ_0"),
    "lift due to pitch rate": _class(0.30, True, "CZ_q"),
    "drag at zero lift": _class(0.40, True, "CX_0"),
    "drag due to lift": _class(0.25, True, "CX_alpha2", "CX_alpha"),
    "static margin": _class(0.10, False, "Cm_alpha"),
    "moment at zero alpha": _class(0.03, False, "Cm_0"),
    "pitch damping": _class(0.30, True, "Cm_q"),
    "elevator": _class(0.35, True, "Cm_de", "CZ_de"),
    "side force": _class(0.25, False, "CY_beta"),
    "dihedral effect": _class(0.05, False, "Cl_beta"),
    "weathercock": _class(0.35, True, "Cn_beta"),
    "roll damping": _class(0.15, True, "Cl_p"),
    "yaw damping": _class(0.50, True, "Cn_r"),
    "yaw due to roll rate": _class(0.06, False, "Cn_p"),
    "roll due to yaw rate": _class(0.06, False, "Cl_r"),
    "side force due to rates": _class(0.10, False, "CY_r", "CY_p"),
    "aileron": _class(0.25, True, "Cl_da"),
    "rudder": _class(0.40, True, "Cn_dr", "CY_dr"),
    "cross-coupling of controls": _class(0.01, False, "Cn_da", "Cl_dr", "CY_da", CY_da=4.0),
    "asymmetry": _class(0.002, False, "Cl_0", "Cn_0", "CY_0", CY_0=4.0),
}
"""Guesses are per radian. The static margin is in chords; Cm_alpha follows from it.

Drag at zero lift is positive: its errors are logarithms of measured over predicted.
"""

_CLASS_OF = {term: name for name, row in CLASSES.items() for term in row.terms}


@dataclass(frozen=True)
class ClassError:
    """Predictive error of a class: Student's t, and the aircraft behind it.

    Attributes
    ----------
    mean : float
        Expected error: measured less predicted, over the predicted size in relative classes.
    std, dof : float
        Scale and degrees of freedom.
    aircraft : tuple of str
        Each counts once.
    """

    mean: float
    std: float
    dof: float
    aircraft: tuple[str, ...]

    @property
    def gaussian_std(self) -> float:
        """Return the standard deviation of a Gaussian with the same 90 % interval."""
        return self.std * float(student_quantile(0.95, self.dof)) / 1.6448536269514722

    def half_width(self, confidence: float) -> float:
        """Return the half-width of the interval at a confidence."""
        return self.std * float(student_quantile(0.5 + 0.5 * confidence, self.dof))


@dataclass(frozen=True)
class Prior:
    """Prior of one term: mean and standard deviation in the units of the model, and its class.

    The mean is the source's value moved by the class's mean error.
    """

    mean: float
    std: float
    class_name: str


def read_evidence() -> list[dict[str, str]]:
    """Return the rows of evidence.csv."""
    text = (importlib.resources.files("uqharness.authoring") / "evidence.csv").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def class_errors(without: Iterable[str] = ()) -> dict[str, ClassError]:
    """Return the error statistics of every class.

    Parameters
    ----------
    without : iterable of str
        Aircraft whose rows are left out.

    Examples
    --------
    >>> errors = class_errors()
    >>> errors["side force"].std > errors["side force"].half_width(0.3)
    True
    """
    excluded = set(without)
    errors: dict[str, dict[str, list[float]]] = {}
    for row in read_evidence():
        if row["aircraft"] not in excluded:
            by_aircraft = errors.setdefault(row["class"], {})
            by_aircraft.setdefault(row["aircraft"], []).append(float(row["error"]))
    out = {}
    for name, error_class in CLASSES.items():
        votes = errors.get(name, {})
        weight = GUESS_DOF + len(votes)
        squares = sum(float(np.mean(np.square(values))) for values in votes.values())
        guess = GUESS_DOF * error_class.guess**2
        if error_class.has_mean:
            mean = sum(float(np.mean(values)) for values in votes.values()) / weight
            # The mean is uncertain by the scatter over the root of its weight; a guess is of both.
            guess /= 1.0 + 1.0 / GUESS_DOF
            scale = ((guess + squares) / weight - mean**2) * (1.0 + 1.0 / weight)
        else:
            mean, scale = 0.0, (guess + squares) / weight
        out[name] = ClassError(mean, math.sqrt(scale), weight, tuple(votes))
    return out


def priors(model: AeroModel, without: Iterable[str] = ()) -> dict[str, Prior]:
    """Return the prior of each term of a model, surfaces per degree.

    Parameters
    ----------
    model : AeroModel
        About its centre of gravity.
    without : iterable of str
        Aircraft left out of the statistics.
    """
    errors = class_errors(without)
    out = {}
    for term, value in model.terms.items():
        name = _CLASS_OF[term]
        row = CLASSES[name]
        per_unit = math.radians(1.0) if value.unit == "1/deg" else 1.0
        size = abs(value.value) if row.relative else per_unit * row.scale.get(term, 1.0)
        sense = math.copysign(1.0, value.value) if row.relative else 1.0
        mean = value.value + sense * errors[name].mean * size
        std = errors[name].gaussian_std * size
        if term == "CX_0":  # errors of drag are factors
            factor = math.exp(errors[name].mean)
            mean, std = value.value * factor, std * factor
        out[term] = Prior(mean, std, name)
    lift = out["CZ_alpha"]
    margin = static_margin(model, errors)
    out["Cm_alpha"] = Prior(
        lift.mean * margin.mean,
        math.hypot(lift.mean * margin.std, margin.mean * lift.std),
        "static margin",
    )
    out["CX_alpha"] = Prior(
        out["CX_alpha"].mean, math.hypot(out["CX_alpha"].std, 0.05), "drag due to lift"
    )
    return out


def static_margin(model: AeroModel, errors: Mapping[str, ClassError] | None = None) -> Prior:
    """Return the prior of the static margin [chords]; ``errors`` are those of `class_errors`."""
    error = (errors or class_errors())["static margin"]
    return Prior(model.static_margin + error.mean, error.gaussian_std, "static margin")


_STATE_OF = {
    "alpha": "alpha_rad",
    "beta": "beta_rad",
    "p": "p_radps",
    "q": "q_radps",
    "r": "r_radps",
    "de": "elevator_pos_deg",
    "da": "aileron_pos_deg",
    "dr": "rudder_pos_deg",
}
_NEGATIVE = ("CZ_alpha", "CY_beta", "Cl_p", "Cm_q", "Cn_r")
"""Terms that take energy from the motion: their intervals end at zero."""
_RANGE = {"alpha": 0.2, "beta": 0.2, "de": 15.0, "da": 15.0, "dr": 15.0}


def prior_form(
    model: AeroModel, by_term: Mapping[str, Prior], speed_mps: float, sha256: str
) -> ModelForm:
    """Return the prior as a model form: intervals of the coefficients over flight states.

    The variance of a coefficient is the sum over its terms of (std times variable)^2, written as
    s2 (1 + x' (X'X)^-1 x) with the constant's variance as s2. Alpha counts from the trim's, where
    lift and pitching moment are balanced: an error of the zero-lift angle is in the constant.
    CX counts drag by factors, so that its interval leaves drag above zero; intervals of damping end
    at zero. Means of the priors that differ from the model's values shift the intervals.

    Parameters
    ----------
    model : AeroModel
        What the prior belongs to.
    by_term : mapping of str to Prior
        From `priors`.
    speed_mps : float
        True airspeed that makes rates dimensionless [m/s].
    sha256 : str
        Content hash of the written aircraft.
    """
    lengths = {"p": model.b, "q": model.c, "r": model.b}
    coefficients = {}
    for name in COEFFICIENTS:
        # Range of each variable in flight: it scales the regressors.
        variables = [term for term in TERMS[name] if term in _STATE_OF]
        ranges = [
            _RANGE[v] if v in _RANGE else 0.3 * 2.0 * speed_mps / lengths[v] for v in variables
        ]
        # Priors are of dimensionless rates, states of rates in rad/s.
        z = float(student_quantile(0.5 + 0.5 * CONFIDENCE, _GAUSSIAN_DOF))
        stds, slopes = [], []
        for variable in variables:
            per_state = lengths[variable] / (2.0 * speed_mps) if variable in lengths else 1.0
            prior = by_term[f"{name}_{variable}"]
            nominal = model.terms[f"{name}_{variable}"].value
            low, high = (prior.mean - nominal + s * z * prior.std for s in (-1.0, 1.0))
            if f"{name}_{variable}" in _NEGATIVE:
                high = max(min(high, -nominal), low)
            stds.append(0.5 * (high - low) / z * per_state)
            slopes.append(0.5 * (high + low) * per_state)
        centre = np.array([model.alpha if v == "alpha" else 0.0 for v in variables])
        scale = np.array(ranges)
        prior, nominal = by_term[f"{name}_0"], model.terms[f"{name}_0"].value
        constant, shift = prior.std, prior.mean - nominal
        if name == "CX":
            # Drag between D k/f and D k f: an interval whose middle has more drag than D k.
            drag, factor = abs(nominal), prior.mean / nominal if nominal else 1.0
            spread_factor = math.exp(z * constant / max(abs(prior.mean), 1e-9))
            turned = _turned_drag(model, z * by_term["CZ_0"].std)
            upper, lower = (
                drag * (1.0 - factor / spread_factor),
                drag * (factor * spread_factor - 1.0),
            )
            shift = 0.5 * (upper - lower)
            constant = (0.5 * (upper + lower) - min(turned, 0.7 * upper)) / z
        # Independent terms make X'X diagonal, in units of the constant's variance.
        quadratic = (np.array(stds) * scale / constant) ** 2
        count = len(variables)
        terms = tuple(tuple(1 if i == j else 0 for j in range(count)) for i in range(-1, count))
        matrix: FloatArray = np.diag([0.0, *quadratic])
        coefficients[name] = CoefficientBounds(
            states=tuple(_STATE_OF[v] for v in variables),
            centre=centre,
            scale=scale,
            terms=terms,
            beta_hat=np.array([shift, *(np.array(slopes) * scale)]),
            XtX_inv=matrix,
            s2=constant**2,
            dof=_GAUSSIAN_DOF,
            t=z,
            confidence=CONFIDENCE,
            leverage_factor=1.0,
            n=1,
            n_effective=1.0,
            walk_rate=math.nan,
            hull=Hull(
                low=centre - scale,
                high=centre + scale,
                leverage=float(np.sum(quadratic)),
                middle=np.stack([centre - scale / 2, centre, centre + scale / 2], axis=1),
            ),
        )
    return ModelForm(
        aircraft=AircraftReference(model.name, sha256),
        flights=(),
        filtering=Filtering(1.0, math.inf, 1.0, 50.0),
        confidence=CONFIDENCE,
        outside="clamp",
        coefficients=coefficients,
    )


def _turned_drag(model: AeroModel, error: float) -> float:
    """Return the drag that an error of CZ of either sign takes away at the same lift.

    The aircraft flies at another alpha then, and the normal force turns with alpha into drag.
    """

    def drag(alpha: float, delta: float) -> float:
        cx, cz = model.coefficient("CX", alpha), model.coefficient("CZ", alpha) + delta
        return -cx * math.cos(alpha) - cz * math.sin(alpha)

    slope = -max(abs(model.terms["CZ_alpha"].value), 1.0)
    nominal = drag(model.alpha, 0.0)
    return max(nominal - drag(model.alpha - d / slope, d) for d in (-error, 0.0, error))


def prior_document(form: ModelForm, model: AeroModel, by_term: Mapping[str, Prior]) -> str:
    """Return model-form.json of kind "prior": the form, and mean and std of each parameter.

    ``names`` and ``cov`` hold the covariance of CZ_alpha and Cm_alpha, which share the lift slope.
    """
    document: dict[str, Any] = json.loads(form.to_json())
    parameters: dict[str, Any] = {}
    for term, prior in by_term.items():
        if not prior.std > 0.0:  # a surface that the source does not have
            continue
        parameters[f"aero/{term}"] = {
            "mean": prior.mean,
            "std": prior.std,
            "unit": model.terms[term].unit,
            "source": f"{model.terms[term].source}; class {prior.class_name}",
        }
    margin = static_margin(model)
    lift, pitch = by_term["CZ_alpha"], by_term["Cm_alpha"]
    shared = margin.mean * lift.std**2
    document |= {
        "kind": "prior",
        "parameters": parameters,
        "names": ["aero/CZ_alpha", "aero/Cm_alpha"],
        "cov": [[lift.std**2, shared], [shared, pitch.std**2]],
        "static_margin": {
            "mean": margin.mean,
            "std": margin.std,
            "unit": "chords",
        },
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
