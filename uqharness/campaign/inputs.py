"""Files that a campaign.toml names as inputs: a model form (bounds and walk rates) and a fit (parameters with covariance)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sysid.digests import sha256_hex
from sysid.errors import LogError
from sysid.foreign.parsed_text import ParseError, parse_json
from sysid.foreign.regular_files import read_regular
from uqharness.campaign.spec.epistemic import PUBLISHED_WALK_RATE_PER_SQRT_S, EpistemicSection
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS, exact

if TYPE_CHECKING:
    from sysid.model_form import ModelForm


@dataclass(frozen=True)
class Estimates:
    """Identified parameters: ``names`` (JSBSim properties), ``values`` (n,) and ``covariance`` (n, n), positive definite."""

    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def factor(self) -> NDArray[np.float64]:
        """Lower triangle L (n, n) with L L' = covariance."""
        std = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(std, std)
        factor: NDArray[np.float64] = std[:, None] * np.array(exact.cholesky(correlation.tolist()))
        return factor


@dataclass(frozen=True)
class CampaignInputs:
    """What the named files hold: the path of the model form, the coefficients it bounds, walk rates in 1/sqrt(s), the fit.

    ``confidence`` is that of the model form's intervals; ``has_parts``: it separates transient from persistent model
    error; ``transient_rates``, in 1/sqrt(s), are of the coefficients whose transient part is flown. ``hashes`` are SHA-256 of
    the files by what they are named as: bounds, fit.
    """

    model_form: Path | None = None
    coefficients: tuple[str, ...] = COEFFICIENTS
    walk_rates: Mapping[str, float] = field(default_factory=dict)
    estimates: Estimates | None = None
    confidence: float | None = None
    has_parts: bool = False
    transient_rates: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)


def read_inputs(section: EpistemicSection, beside: Path) -> CampaignInputs:
    """Read the files that ``section`` names, relative to the folder ``beside`` first. Raises BadInputError."""
    hashes: dict[str, str] = {}
    model_form: Path | None = None
    coefficients: tuple[str, ...] = section.coefficients
    rates: dict[str, float] = {
        str(name): rate for name, rate in (section.walk_rate_per_sqrt_s or {}).items()
    }
    if section.method == "walk" and not rates and not isinstance(section.bounds, str):
        rates = dict.fromkeys(coefficients, PUBLISHED_WALK_RATE_PER_SQRT_S)
    form: ModelForm | None = None
    if isinstance(section.bounds, str):
        model_form = _find(section.bounds, beside, "bounds", hashes)
        form = read_bounds(model_form)
        coefficients = _coefficients(section, model_form, form)
        if section.method == "walk":
            rates = {
                name: rates.get(name, form.coefficients[name].walk_rate) for name in coefficients
            }
            lacking = [name for name in coefficients if not rates[name] > 0]
            if lacking:
                raise BadInputError(
                    f"{model_form}: no walk_rate for {', '.join(lacking)}; give walk_rate_per_sqrt_s in [epistemic], "
                    "or take the bounds from a longer flight"
                )
    estimates = None
    if section.parameters is not None:
        path = _find(section.parameters.fit, beside, "fit", hashes)
        estimates = _estimates(path, section.parameters.parameters)
    found = CampaignInputs(model_form, coefficients, rates, estimates, hashes=hashes)
    return found if form is None else replace(found, **_of_form(section, form, coefficients))


def _of_form(
    section: EpistemicSection, form: ModelForm, coefficients: tuple[str, ...]
) -> dict[str, Any]:
    """What a model form says beside its bounds."""
    parts = {name: form.coefficients[name].parts for name in coefficients}
    flown = section.transient is not False and section.method != "none"
    rates = {
        name: part.transient_rate_per_sqrt_s
        for name, part in parts.items()
        if flown and part is not None and part.transient_half_width > 0.0
    }
    return {
        "confidence": form.confidence,
        "has_parts": any(part is not None for part in parts.values()),
        "transient_rates": rates,
    }


def read_bounds(path: Path) -> ModelForm:
    """A model form from its file. Raises BadInputError."""
    # Imported here: most campaigns do without.
    from sysid.model_form import read_model_form

    try:
        return read_model_form(path)
    except LogError as error:
        raise BadInputError(
            f"{error} (uqharness bounds AIRCRAFT --flight FILE --out DIR makes one)"
        ) from None


def _find(name: str, beside: Path, role: str, hashes: dict[str, str]) -> Path:
    given = Path(name)
    path = next((p for p in (beside / given, given) if p.is_file()), None)
    if path is None:
        raise BadInputError(
            f"{beside / given}: named as {role} and not there, nor is {given} in this folder"
        )
    try:
        hashes[role] = sha256_hex(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    return path.resolve()


def _coefficients(section: EpistemicSection, path: Path, form: ModelForm) -> tuple[str, ...]:
    asked = section.coefficients
    if "coefficients" not in section.model_fields_set:
        return tuple(name for name in asked if name in form.coefficients)
    missing = [name for name in asked if name not in form.coefficients]
    if missing:
        raise BadInputError(
            f"{path}: has no bounds for {', '.join(missing)}, which [epistemic] coefficients names"
        )
    return asked


def _estimates(path: Path, asked: tuple[str, ...] | None) -> Estimates:
    try:
        document = parse_json(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ParseError as error:
        raise BadInputError(f"{path}: {error}") from None
    try:
        names = [str(name) for name in document["names"]]
        covariance = np.array(document["cov"], dtype=np.float64)
        values = np.array(
            [document["parameters"][name]["value"] for name in names], dtype=np.float64
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInputError(
            f"{path}: not a fit with parameters, names and cov ({error}); make one with: uqharness identify"
        ) from None
    if not names:
        raise BadInputError(
            f"{path}: nothing was identified in this fit, so there is no parameter uncertainty to draw from"
        )
    if covariance.shape != (len(names), len(names)) or not (
        np.isfinite(covariance).all() and np.isfinite(values).all()
    ):
        raise BadInputError(
            f"{path}: cov must be a finite {len(names)} x {len(names)} matrix, as many as there are names"
        )
    if not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        raise BadInputError(f"{path}: cov is not symmetric")
    found = Estimates(tuple(names), values, 0.5 * (covariance + covariance.T))
    if asked is not None:
        unknown = [name for name in asked if name not in names]
        if unknown:
            raise BadInputError(
                f"{path}: {', '.join(unknown)} is not among the identified parameters ({', '.join(names)})"
            )
        rows = [names.index(name) for name in asked]
        found = Estimates(asked, values[rows], found.covariance[np.ix_(rows, rows)])
    try:
        if not (np.diag(found.covariance) > 0).all():
            raise ValueError("a variance is not positive")
        found.factor()
    except ValueError:
        raise BadInputError(
            f"{path}: cov is not positive definite, so nothing can be drawn from it"
        ) from None
    return found
