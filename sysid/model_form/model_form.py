"""ModelForm: bounds of the model error per coefficient, and their file.

It connects flights with everything that samples model error (campaigns, corners). Each coefficient
has an interval for the residual dC = flight minus model at flight states x (dissertation eqs 2.17,
2.18):

    y(x) +/- t sqrt(s2 (1 + f x' (X'X)^-1 x)),        upper := max(upper, 0), lower := min(lower, 0)

with x the polynomial terms of normalised states (`sysid.aerodynamics.coefficients`). The interval
is stretched to include zero, so that the identified model always lies inside. dC adds to the
model's coefficient, body axes, SI (CZ down). f is 1 as published, and above 1 when the samples'
autocorrelation is allowed for.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS, Term, parse_term, regressors, stack, term_name
from sysid.aerodynamics.coefficients import STATES
from sysid.arrays import FloatArray
from sysid.display import rows_table, view
from sysid.distributions import student_quantile
from sysid.errors import LogError
from sysid.foreign.regular_files import ParseError, parse_json, read_regular

BoolArray = NDArray[np.bool_]
FORMAT = "model-form 2"
WITHOUT_PARTS = "model-form 1"
"""Format of files whose intervals are not separated into parts; they can be read as well."""
Outside = Literal["grow", "clamp"]
_ROUNDING = 1e-9
"""Part of a hull's edge within which a sample counts as inside."""


@dataclass(frozen=True)
class Hull:
    """Region of the data.

    The box limits single states, the leverage their combinations: leverages up to the data's
    largest are the region that a regression's regressors cover (Cook 1979; Montgomery, Peck and
    Vining, "Linear Regression Analysis", 3.8).

    Attributes
    ----------
    low, high : array (k,)
        Smallest and largest value of each state.
    leverage : float
        Largest leverage x'(X'X)^-1 x of a sample.
    middle : array (k, 3)
        Quartiles of each state.
    """

    low: FloatArray
    high: FloatArray
    leverage: float
    middle: FloatArray


@dataclass(frozen=True)
class Parts:
    """Components of the difference between flight and model besides the polynomial.

    Standard deviations are dimensionless like the coefficients.

    Attributes
    ----------
    persistent : float
        Standard deviation of what is constant through a manoeuvre, over all flights.
    transient : float
        Standard deviation of what changes within a manoeuvre.
    flight : float
        Part of ``persistent`` that is common to a flight; NaN with a single flight.
    transient_time_s : float
        Correlation time of the transient part [s]; NaN without one.
    noise : float
        Sensor noise in the data's samples (rms).
    noise_scale : float
        Size of the noise over the presumed one.
    total_dof, total_t : float
        Degrees of freedom and two-sided quantile of persistent and transient part together.
    not_above : float
        Upper 95 % limit of the root of persistent plus transient variance.
    found : bool
        Whether the data show any model error: polynomial, persistent or transient.
    """

    persistent: float
    transient: float
    flight: float
    transient_time_s: float
    noise: float
    noise_scale: float
    total_dof: float
    total_t: float
    not_above: float
    found: bool

    @property
    def transient_half_width(self) -> float:
        """Half-width of a uniform distribution with the transient part's standard deviation [-]."""
        return math.sqrt(3.0) * self.transient

    @property
    def transient_rate_per_sqrt_s(self) -> float:
        """Rate [1/sqrt(s)] of a reflected walk on 0 to 1 with the transient part's correlation
        time.

        The slowest mode of such a walk decays with rate**2 pi**2 / 2. 0 without a transient part.
        """
        if not self.transient_time_s > 0.0:
            return 0.0
        return math.sqrt(2.0) / (math.pi * math.sqrt(self.transient_time_s))


@dataclass(frozen=True)
class CoefficientBounds:
    """The interval of one coefficient.

    With ``parts`` it is that of the persistent model error:
    y(x) +/- t sqrt(persistent**2 + s2 f x' (X'X)^-1 x). Without, it includes the sensors' noise, as
    published.

    Attributes
    ----------
    states : tuple of str
        k record columns, units as named.
    centre, scale : array (k,)
        z = (x - centre)/scale.
    terms : tuple of m Terms
        Powers of z.
    beta_hat, XtX_inv : array (m,), (m, m)
        Estimate [-] and (X'X)^-1 over the terms.
    s2, dof, t : float
        Residual variance, its degrees of freedom, two-sided quantile of Student's t at
        ``confidence``.
    confidence : float
        Level of the interval.
    leverage_factor : float
        f above.
    n, n_effective : int, float
        Samples and effective sample size.
    walk_rate : float
        Rate of variation in widths of the interval [1/sqrt(s)]; NaN (null in the file) where the
        flight is too short.
    hull : Hull
        Region of the data.
    parts : Parts or None
        Model error separated from noise.
    """

    states: tuple[str, ...]
    centre: FloatArray
    scale: FloatArray
    terms: tuple[Term, ...]
    beta_hat: FloatArray
    XtX_inv: FloatArray
    s2: float
    dof: float
    t: float
    confidence: float
    leverage_factor: float
    n: int
    n_effective: float
    walk_rate: float
    hull: Hull
    parts: Parts | None = None

    @property
    def constant_variance(self) -> float:
        """Variance of the interval where the polynomial is known exactly."""
        return self.s2 if self.parts is None else self.parts.persistent**2

    def half_width(self, leverage: FloatArray, t: float) -> FloatArray:
        """Compute the half-width (n,) at leverages (n,)."""
        return np.asarray(
            t * np.sqrt(self.constant_variance + self.s2 * self.leverage_factor * leverage)
        )  # (2.18)

    def normalised(self, states: Mapping[str, FloatArray], outside: Outside = "grow") -> FloatArray:
        """Normalise states to z (n, k); "clamp" limits each state to the data's box first."""
        x = stack(states, self.states)
        if outside == "clamp":
            x = np.clip(x, self.hull.low, self.hull.high)
        return np.asarray((x - self.centre) / self.scale)

    def leverage(self, z: FloatArray) -> FloatArray:
        """Compute x'(X'X)^-1 x (n,) at normalised states (n, k)."""
        x = regressors(z, self.terms)
        return np.asarray(np.einsum("nj,nj->n", x @ self.XtX_inv, x))

    def t_at(self, confidence: float) -> float:
        """Return the two-sided quantile ``t`` at another confidence."""
        return self._quantile(confidence, self.t, self.dof)

    def _quantile(self, confidence: float, t: float, dof: float) -> float:
        """Convert the quantile ``t`` to another confidence.

        Student's t replaces it, or scales it where parts are separated.
        """
        if confidence == self.confidence:
            return t
        t_requested, t_of_form = (
            float(student_quantile(0.5 + 0.5 * level, dof))
            for level in (confidence, self.confidence)
        )
        return t_requested if self.parts is None else t * t_requested / t_of_form

    def interval(
        self,
        states: Mapping[str, FloatArray],
        confidence: float | None = None,
        outside: Outside = "grow",
    ) -> tuple[FloatArray, FloatArray]:
        """Compute lower and upper end (n,) of the prediction interval, before it is stretched to
        zero.

        Parameters
        ----------
        states : mapping of str to array (n,)
            Flight states.
        confidence : float, optional
            By default the form's.
        outside : {"grow", "clamp"}
            Extrapolate the polynomial outside the data, or hold the states at the box.

        Returns
        -------
        tuple of two arrays (n,)
            Lower and upper end [-].
        """
        z = self.normalised(states, outside)
        t = self.t if confidence is None else self.t_at(confidence)
        y = regressors(z, self.terms) @ self.beta_hat  # (2.17)
        half = self.half_width(self.leverage(z), t)
        return y - half, y + half

    def sample_interval(
        self,
        states: Mapping[str, FloatArray],
        noise_variance: FloatArray,
        confidence: float | None = None,
        outside: Outside = "grow",
    ) -> tuple[FloatArray, FloatArray]:
        """Compute lower <= 0 <= upper (n,) for a measured sample.

        The interval covers model error, persistent and transient, and the sensors' noise.
        ``noise_variance`` (n,) counts only where the interval has parts; other intervals include
        noise.
        """
        y, half = self.sample_middle(states, noise_variance, confidence, outside)
        return np.minimum(y - half, 0.0), np.maximum(y + half, 0.0)

    def sample_middle(
        self,
        states: Mapping[str, FloatArray],
        noise_variance: FloatArray,
        confidence: float | None = None,
        outside: Outside = "grow",
    ) -> tuple[FloatArray, FloatArray]:
        """Compute middle and half-width (n,) of `sample_interval` before stretching it to zero."""
        z = self.normalised(states, outside)
        y = regressors(z, self.terms) @ self.beta_hat
        if self.parts is None:
            return y, self.half_width(
                self.leverage(z), self.t if confidence is None else self.t_at(confidence)
            )
        p = self.parts
        t = p.total_t if confidence is None else self._quantile(confidence, p.total_t, p.total_dof)
        polynomial_variance = self.s2 * self.leverage_factor * self.leverage(z)
        return y, np.asarray(
            t * np.sqrt(polynomial_variance + p.persistent**2 + p.transient**2 + noise_variance)
        )

    def bounds(
        self,
        states: Mapping[str, FloatArray],
        confidence: float | None = None,
        outside: Outside = "grow",
    ) -> tuple[FloatArray, FloatArray]:
        """Compute lower and upper bound (n,) with lower <= 0 <= upper; arguments as `interval`."""
        lower, upper = self.interval(states, confidence, outside)
        return np.minimum(lower, 0.0), np.maximum(upper, 0.0)

    def distance(self, states: Mapping[str, FloatArray]) -> FloatArray:
        """Compute the distance (n,) of states from the data.

        It is 0 inside, else the larger of the box excess in widths and sqrt(h/h_max) - 1.
        """
        x = stack(states, self.states)
        width = np.where(self.hull.high > self.hull.low, self.hull.high - self.hull.low, 1.0)
        box = np.max(np.maximum(self.hull.low - x, x - self.hull.high) / width, axis=1)
        ellipse = np.sqrt(self.leverage(self.normalised(states)) / self.hull.leverage) - 1.0
        excess = np.maximum(box, ellipse)
        return np.where(excess > _ROUNDING, excess, 0.0)


@dataclass(frozen=True)
class AircraftReference:
    """Name and SHA-256 (of XML and card) of the aircraft to which the bounds belong."""

    name: str
    sha256: str


@dataclass(frozen=True)
class FlightUsed:
    """A flight behind the bounds.

    ``estimates`` are channels from an estimator and not from a sensor (alpha without a vane).
    ``parts_s`` are first and last time of the stretches that were used; empty for all.
    """

    name: str
    sha256: str
    seconds: float
    samples: int
    estimates: tuple[str, ...] = ()
    parts_s: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Filtering:
    """Filters on which the intervals' widths depend; cut-offs (half power) in Hz.

    Attributes
    ----------
    cutoff_hz : float
        Differentiator and smoother of everything that is compared.
    airspeed_cutoff_hz : float
        Low-pass of the airspeed before that; inf (null in the file) for none.
    walk_cutoff_hz : float
        Low-pass of the residual before its rate of variation is taken.
    rate_hz : float
        Samples a second.
    """

    cutoff_hz: float
    airspeed_cutoff_hz: float
    walk_cutoff_hz: float
    rate_hz: float


@dataclass(frozen=True)
class ModelForm:
    """Bounds of the coefficients and their origin.

    Attributes
    ----------
    aircraft : AircraftReference
        The model that the bounds refer to.
    flights : tuple of FlightUsed
        Data.
    filtering : Filtering
        Filters of the residuals.
    confidence : float
        Level of the intervals.
    outside : {"grow", "clamp"}
        Outside the data the polynomial is extrapolated (published), or states are held at the box.
    coefficients : mapping of str to CoefficientBounds
        Keys among COEFFICIENTS.
    """

    aircraft: AircraftReference
    flights: tuple[FlightUsed, ...]
    filtering: Filtering
    confidence: float
    outside: Outside
    coefficients: Mapping[str, CoefficientBounds]

    def __repr__(self) -> str:
        return (
            f"ModelForm({', '.join(self.coefficients)}; {len(self.flights)} flights, confidence"
            f" {self.confidence:g})"
        )

    def _repr_html_(self) -> str:
        rows: list[dict[str, object]] = [
            {
                "coefficient": name,
                "n": b.n,
                "n effective": b.n_effective,
                "half width in the data's middle [-]": b.t * math.sqrt(b.constant_variance),
                "terms": ", ".join(term_name(t, b.states) for t in b.terms),
            }
            for name, b in self.coefficients.items()
        ]
        facts = {
            "aircraft": self.aircraft.name,
            "confidence [-]": self.confidence,
            "outside the data": self.outside,
        }
        return view(repr(self), rows_table(rows), facts=facts)

    def bounds(
        self, states: Mapping[str, FloatArray], confidence: float | None = None
    ) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return lower and upper (n,) of every coefficient at states (n,) each, lower <= 0 <=
        upper.

        Raises KeyError for a missing state.
        """
        return {c: b.bounds(states, confidence, self.outside) for c, b in self.coefficients.items()}

    def extrapolated(self, states: Mapping[str, FloatArray]) -> BoolArray:
        """Return whether the states (n,) lie outside any coefficient's data."""
        return np.any([b.distance(states) > 0.0 for b in self.coefficients.values()], axis=0)

    @property
    def states(self) -> tuple[str, ...]:
        """All states on which the bounds depend, in the vocabulary's order."""
        used = {s for b in self.coefficients.values() for s in b.states}
        return tuple(s for s in STATES if s in used)

    def to_json(self) -> str:
        """Return the file's text; equal forms give identical bytes."""
        parted = any(bounds.parts is not None for bounds in self.coefficients.values())
        document: dict[str, Any] = {"format": FORMAT if parted else WITHOUT_PARTS, **asdict(self)}
        if not np.isfinite(self.filtering.airspeed_cutoff_hz):
            document["filtering"]["airspeed_cutoff_hz"] = None
        for row in document["flights"]:
            if not row["parts_s"]:
                del row["parts_s"]
        for name, bounds in self.coefficients.items():
            row = document["coefficients"][name]
            row["terms"] = [term_name(t, bounds.states) for t in bounds.terms]
            row["walk_rate"] = bounds.walk_rate if np.isfinite(bounds.walk_rate) else None
            if bounds.parts is None:
                del row["parts"]
                continue
            for key in ("flight", "transient_time_s"):
                row["parts"][key] = row["parts"][key] if np.isfinite(row["parts"][key]) else None
        return json.dumps(document, indent=1, default=_plain, allow_nan=False) + "\n"

    def write(self, path: Path) -> None:
        """Write the model form to a file."""
        path.write_text(self.to_json(), encoding="utf-8")


def _plain(value: Any) -> Any:
    """Convert arrays for `json`."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a model form")


def read_model_form(path: Path) -> ModelForm:
    """Read a model form, such as the model-form.json that ``uqharness bounds`` writes.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    ModelForm
        Per coefficient the polynomial of its bounds [-] in the flight states; ``bounds(states)``
        gives lower and upper (n,).

    Raises
    ------
    LogError
        Naming file and key, for anything else.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, eq. 2.17 and 2.18.

    Examples
    --------
    >>> from pathlib import Path
    >>> import sysid
    >>> sysid.read_model_form(Path("nowhere.json"))
    Traceback (most recent call last):
    sysid.errors.LogError: nowhere.json: cannot be read: No such file or directory
    """
    try:
        document = parse_json(read_regular(path))
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror or error}", path) from None
    except ParseError as error:
        raise LogError(
            str(error), path, None if error.line is None else f"line {error.line}"
        ) from None
    # Formats of other programs and versions are named, not guessed.
    if not isinstance(document, dict) or document.get("format") not in (FORMAT, WITHOUT_PARTS):
        file_format = (
            document.get("format") if isinstance(document, dict) else type(document).__name__
        )
        read = f"'{FORMAT}' and '{WITHOUT_PARTS}' are read"
        raise LogError(
            f"is no model form: format is {file_format!r}, {read}; make one with `uqharness"
            " bounds`",
            path,
        )
    where = ""
    try:
        coefficients = {}
        # ``where`` names the coefficient in the message of an error.
        for where, row in document["coefficients"].items():
            coefficients[where] = _coefficient(where, row)
        where = ""
        form = ModelForm(
            aircraft=AircraftReference(
                *(_text(document["aircraft"], key) for key in ("name", "sha256"))
            ),
            flights=tuple(_flight(row) for row in document["flights"]),
            filtering=_filtering(document["filtering"]),
            confidence=float(document["confidence"]),
            outside=_outside(document["outside"]),
            coefficients=coefficients,
        )
    except KeyError as error:
        raise LogError(
            f"lacks the key {error}; write it again with `uqharness bounds`", path, where or None
        ) from None
    # Values of a wrong type or out of their range.
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise LogError(
            f"{error}; write it again with `uqharness bounds`", path, where or None
        ) from None
    if not coefficients:
        raise LogError("holds no coefficient", path)
    return form


def _flight(row: Mapping[str, Any]) -> FlightUsed:
    """Parse a flight."""
    estimates = tuple(row["estimates"])
    if not all(isinstance(name, str) for name in estimates):
        raise ValueError("estimates must be names of channels")
    return FlightUsed(
        _text(row, "name"),
        _text(row, "sha256"),
        float(row["seconds"]),
        int(row["samples"]),
        estimates,
        tuple((float(a), float(b)) for a, b in row.get("parts_s", [])),
    )


def _text(row: Mapping[str, Any], key: str) -> str:
    """Return a text entry."""
    if not isinstance(row[key], str):
        raise ValueError(f"{key} must be text; received {str(row[key])[:80]}")
    return str(row[key])


def _filtering(row: Mapping[str, Any]) -> Filtering:
    """Parse the filters; null is no low-pass."""
    values = dict(row)
    if values["airspeed_cutoff_hz"] is None:
        values["airspeed_cutoff_hz"] = float("inf")
    return Filtering(**{key: float(value) for key, value in values.items()})


def _outside(value: Any) -> Outside:
    """Parse the behaviour outside the data."""
    if value == "grow":
        return "grow"
    if value == "clamp":
        return "clamp"
    raise ValueError(f"outside is {value!r}; allowed are grow and clamp")


def _coefficient(name: str, row: Mapping[str, Any]) -> CoefficientBounds:
    """Parse and check the interval of one coefficient; raises ValueError or KeyError."""
    if name not in COEFFICIENTS:
        raise ValueError(f"'{name}' is no coefficient; allowed are {', '.join(COEFFICIENTS)}")
    # Regressors: flight states, and terms that are products of them.
    states = tuple(row["states"])
    unknown = [s for s in states if s not in STATES]
    if unknown or not states:
        raise ValueError(f"states holds {unknown or 'nothing'}; allowed are {', '.join(STATES)}")
    terms = tuple(parse_term(text, states) for text in row["terms"])
    # Shapes of the arrays follow from the numbers of states and terms.
    k, m = len(states), len(terms)
    hull = row["hull"]
    out = CoefficientBounds(
        states=states,
        terms=terms,
        centre=_array(row, "centre", k),
        scale=_array(row, "scale", k),
        beta_hat=_array(row, "beta_hat", m),
        XtX_inv=_array(row, "XtX_inv", m, m),
        hull=Hull(
            _array(hull, "low", k),
            _array(hull, "high", k),
            float(hull["leverage"]),
            _array(hull, "middle", k, 3),
        ),
        n=int(row["n"]),
        walk_rate=float("nan") if row["walk_rate"] is None else float(row["walk_rate"]),
        **{
            key: float(row[key])
            for key in ("s2", "dof", "t", "confidence", "leverage_factor", "n_effective")
        },
        parts=None if row.get("parts") is None else _parts(row["parts"]),
    )
    # JSON readers accept NaN and infinity; bounds of them would be no bounds.
    numbers = {
        key: getattr(out, key)
        for key in ("s2", "dof", "t", "confidence", "leverage_factor", "n_effective")
    }
    infinite = [
        key
        for key, value in {**numbers, "leverage": out.hull.leverage}.items()
        if not np.isfinite(value)
    ]
    if infinite:
        raise ValueError(f"{', '.join(infinite)} must be a finite number")
    # Values with which the interval of eq. 2.18 is undefined.
    if not (
        out.s2 >= 0.0 and out.t > 0.0 and 0.0 < out.confidence < 1.0 and np.all(out.scale > 0.0)
    ):
        raise ValueError(
            "s2 must not be negative; t, confidence and scale must be above 0, confidence below 1"
        )
    return out


def _parts(row: Mapping[str, Any]) -> Parts:
    """Parse and check the parts of an interval; raises ValueError or KeyError."""
    if not isinstance(row["found"], bool):
        raise ValueError("parts: found must be true or false")
    values = {
        f.name: float("nan") if row[f.name] is None else float(row[f.name])
        for f in fields(Parts)
        if f.name != "found"
    }
    parts = Parts(found=row["found"], **values)
    unknown = [
        key
        for key, value in values.items()
        if key not in ("flight", "transient_time_s") and not np.isfinite(value)
    ]
    if unknown:
        raise ValueError(f"parts: {', '.join(unknown)} must be a finite number")
    if (
        min(parts.persistent, parts.transient, parts.noise, parts.noise_scale, parts.not_above)
        < 0.0
    ):
        raise ValueError("parts: no standard deviation may be negative")
    if not (parts.total_dof > 2.0 and parts.total_t > 0.0):
        raise ValueError("parts: total_dof must be above 2 and total_t above 0")
    if parts.transient > 0.0 and not parts.transient_time_s > 0.0:
        raise ValueError("parts: a transient part needs a transient_time_s above 0")
    return parts


def _array(row: Mapping[str, Any], key: str, *shape: int) -> FloatArray:
    """Return an entry as finite numbers of a given shape."""
    values = np.asarray(row[key], dtype=float)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(
            f"{key} must be {' x '.join(map(str, shape))} finite numbers; received shape"
            f" {values.shape}"
        )
    return values
