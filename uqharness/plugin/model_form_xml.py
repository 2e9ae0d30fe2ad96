"""model-form.xml: a JSBSim <system> that computes bounds from the flight state and applies deltas.

In flight it needs JSBSim alone. Its arithmetic is that of sysid.model_form.model_form (eqs 2.17,
2.18). The quadratic form x'(X'X)^-1 x is written as a polynomial of the normalised states in Horner
form, once for all coefficients that share it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import CoefficientBounds, ModelForm
from sysid.units import FT_M, RAD_DEG
from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, position_factor
from uqharness.xml import (
    Expression,
    Powers,
    call,
    declare,
    horner,
    in_comment,
    property_value,
    value,
)

RATE_HZ = 50.0
"""Lowest rate of computing bounds [Hz]; levels and deltas are computed in every frame."""

_ROUNDING = 1e-9  # as in sysid.model_form.model_form: a state on the hull's edge lies inside
_FLIGHT_STATES = {
    "V_mps": ("velocities/vt-fps", FT_M),
    "alpha_rad": ("aero/alpha-rad", 1.0),
    "beta_rad": ("aero/beta-rad", 1.0),
    "phi_rad": ("attitude/phi-rad", 1.0),
    "theta_rad": ("attitude/theta-rad", 1.0),
    "p_radps": ("velocities/p-rad_sec", 1.0),
    "q_radps": ("velocities/q-rad_sec", 1.0),
    "r_radps": ("velocities/r-rad_sec", 1.0),
}
_TO_DEGREES = {"deg": 1.0, "rad": RAD_DEG}
_TO_PERCENT = {"pct": 1.0, "norm": 100.0}


@dataclass(frozen=True)
class _Normalised:
    """z = (x - centre)/scale of one state, and the range of the data."""

    state: str
    centre: float
    scale: float
    low: float
    high: float


@dataclass(frozen=True)
class _Group:
    """Coefficients that share a quadratic form; ``names`` are properties of their states."""

    coefficients: tuple[str, ...]
    bounds: CoefficientBounds
    names: tuple[str, ...]

    @property
    def leverage(self) -> str:
        """Return the property of the leverage that the bounds use."""
        return f"uq/leverage/{'-'.join(self.coefficients)}"

    @property
    def free_leverage(self) -> str:
        """Return the property of the leverage without clamping to the data's range."""
        return f"uq/leverage-free/{'-'.join(self.coefficients)}"


def model_form_xml(form: ModelForm, aircraft: Aircraft, rate_hz: float = RATE_HZ) -> bytes:
    """Return the system of a model form.

    Parameters
    ----------
    form : ModelForm
        Bounds as functions of the flight state.
    aircraft : Aircraft
        Its card gives step and controls.
    rate_hz : float
        Lowest rate of computing bounds [Hz]; ``execrate`` is the largest number of frames that
        keeps it.

    Returns
    -------
    bytes
        XML; equal for equal arguments.

    Raises
    ------
    BadInputError
        If the bounds depend on a control that the card does not give in degrees or percent.
    """
    frames = max(1, math.floor(1.0 / (rate_hz * aircraft.dt_s) + 1e-9))
    # Outside the data, bounds either grow with the polynomial or stay as at the edge.
    clamped = form.outside == "clamp"
    states: dict[_Normalised, str] = {}
    groups = _groups(form, states)
    body = [*_declarations(form)]
    body += [f'<channel name="Bounds" execrate="{frames}">']
    # Normalised states first, clamped to the data if the form asks for it.
    for state, name in states.items():
        body += _indent(
            _component(f"{name}-free" if clamped else name, _normalise(state, aircraft))
        )
        if clamped:
            body += _indent(_clamp(name, state))
    # One leverage for all coefficients that share the quadratic form.
    for group in groups:
        form_of_group = quadratic_form(group.bounds)
        body += _indent(_component(group.leverage, horner(form_of_group, group.names)))
        if clamped:
            body += _indent(
                _component(
                    group.free_leverage,
                    horner(form_of_group, [f"{name}-free" for name in group.names]),
                )
            )
    body += _indent(_extrapolation(states, groups, clamped))
    # Bounds of each coefficient from its leverage.
    for name, bounds in form.coefficients.items():
        group = next(group for group in groups if name in group.coefficients)
        body += _indent(_coefficient(name, bounds, group))
    body += ["</channel>", *_deltas()]
    return _document(_remarks(form, aircraft, frames), body)


def constant_xml(bounds: Mapping[str, tuple[float, float]], remark: str) -> bytes:
    """Return the system with constant bounds, lower <= 0 <= upper.

    Parameters
    ----------
    bounds : mapping
        Coefficient to (lower, upper); others have none.
    remark : str
        Source of the bounds, for the comment.

    Raises
    ------
    BadInputError
        For bounds that do not enclose 0.
    """
    lines = [
        declare("uq/active", "0"),
        declare("uq/extrapolated", "0", "constant bounds: there is no outside"),
        declare("uq/extrapolation", "0"),
    ]
    for name in COEFFICIENTS:
        # The model itself must lie within its bounds.
        lower, upper = bounds.get(name, (0.0, 0.0))
        if not lower <= 0.0 <= upper:
            raise BadInputError(
                f"bounds of {name}: lower must be <= 0 and upper >= 0; received {lower:g},"
                f" {upper:g}"
            )
        lines += [
            declare(f"uq/{name}/lower", repr(lower)),
            declare(f"uq/{name}/upper", repr(upper)),
            *_levels(name),
        ]
    return _document(remark.splitlines(), [*lines, *_deltas()])


def quadratic_form(bounds: CoefficientBounds) -> dict[Powers, float]:
    """Return x' (X'X)^-1 x as powers of the normalised states to coefficient."""
    out: dict[Powers, list[float]] = {}
    for i, a in enumerate(bounds.terms):
        for j, b in enumerate(bounds.terms):
            out.setdefault(tuple(m + n for m, n in zip(a, b, strict=True)), []).append(
                float(bounds.XtX_inv[i, j])
            )
    return {powers: math.fsum(parts) for powers, parts in out.items()}


def _groups(form: ModelForm, states: dict[_Normalised, str]) -> list[_Group]:
    """Return coefficients by equal quadratic form; ``states`` gains the states they need."""
    shared: dict[tuple[object, ...], list[str]] = {}
    for name, bounds in form.coefficients.items():
        arrays = (bounds.centre, bounds.scale, bounds.XtX_inv, bounds.hull.low, bounds.hull.high)
        # Equal arrays give equal quadratic forms.
        key = (
            bounds.states,
            bounds.terms,
            bounds.hull.leverage,
            *(array.tobytes() for array in arrays),
        )
        shared.setdefault(key, []).append(name)
    groups = []
    for members in shared.values():
        bounds = form.coefficients[members[0]]
        names = []
        for k, state in enumerate(bounds.states):
            hull = bounds.hull
            low, high = float(hull.low[k]), float(hull.high[k])
            z = _Normalised(state, float(bounds.centre[k]), float(bounds.scale[k]), low, high)
            if z not in states:
                # The same state with another normalisation gets a number.
                same = sum(other.state == state for other in states)
                states[z] = f"uq/z/{state}" + (f"-{same + 1}" if same else "")
            names.append(states[z])
        groups.append(_Group(tuple(members), bounds, tuple(names)))
    return groups


def _normalise(state: _Normalised, aircraft: Aircraft) -> Expression:
    """Return the expression of a normalised state."""
    name, factor = state_source(state.state, aircraft)
    scaled = call("product", property_value(name), value(factor / state.scale))
    return call("difference", scaled, value(state.centre / state.scale))


def state_source(state: str, aircraft: Aircraft) -> tuple[str, float]:
    """Return the JSBSim property of a state and its factor to the record's unit.

    Raises BadInputError for a control that the card does not give.
    """
    if state in _FLIGHT_STATES:
        return _FLIGHT_STATES[state]
    control = state.split("_")[0]
    card = aircraft.card.inputs.get(control)
    if card is not None and control == "throttle" and card.unit in _TO_PERCENT:
        return card.position or card.selected or card.property, _TO_PERCENT[card.unit]
    if card is not None and control != "throttle":
        # The surface's position, else its command.
        if card.position is not None:
            return card.position, position_factor(card)
        if card.unit in _TO_DEGREES or card.throw_deg is not None:
            throw = card.throw_deg if card.unit == "norm" and card.throw_deg is not None else 1.0
            return card.selected or card.property, _TO_DEGREES.get(card.unit, throw)
    problem = (
        "is not there" if card is None else f'has unit "{card.unit}" and no position or throw_deg'
    )
    raise BadInputError(
        f"the bounds depend on {state}, but [inputs.{control}] of aircraft {aircraft.name}"
        f" {problem};"
        " say in airframe.toml how to read it, or make the bounds from other states"
    )


def _edges(state: _Normalised) -> tuple[float, float]:
    """Return the data's range in z."""
    return (state.low - state.centre) / state.scale, (state.high - state.centre) / state.scale


def _clamp(name: str, state: _Normalised) -> list[str]:
    """Return the component that clamps a state to the data's range."""
    low, high = _edges(state)
    return [
        f'<pure_gain name="{name}">',
        f"  <input>{name}-free</input>",
        "  <gain>1</gain>",
        f"  <clipto> <min>{low!r}</min> <max>{high!r}</max> </clipto>",
        "</pure_gain>",
    ]


def _extrapolation(
    states: Mapping[_Normalised, str], groups: list[_Group], clamped: bool
) -> list[str]:
    """Return components for uq/extrapolation (distance from the data) and uq/extrapolated.

    The distance is that of CoefficientBounds.distance, the largest over all coefficients.
    """
    excesses = []
    for state, name in states.items():
        low, high = _edges(state)
        z = property_value(f"{name}-free" if clamped else name)
        excess = call(
            "difference",
            call("abs", call("difference", z, value(0.5 * (low + high)))),
            value(0.5 * (high - low)),
        )
        # In widths of the range; a constant state has none and counts in its own unit.
        width = high - low if high > low else 1.0 / state.scale
        excesses.append(call("product", excess, value(1.0 / width)))
    for group in groups:
        share = call(
            "quotient",
            property_value(group.free_leverage if clamped else group.leverage),
            value(group.bounds.hull.leverage),
        )
        excesses.append(call("difference", call("sqrt", share), value(1.0)))
    largest_excess = property_value("uq/beyond-edge")
    return [
        *_component("uq/beyond-edge", call("max", *excesses, value(0.0))),
        *_component("uq/extrapolated", call("gt", largest_excess, value(_ROUNDING))),
        *_component(
            "uq/extrapolation", call("product", property_value("uq/extrapolated"), largest_excess)
        ),
    ]


def _coefficient(name: str, bounds: CoefficientBounds, group: _Group) -> list[str]:
    """Return the components of centre, half width, lower and upper of one coefficient."""
    beta = dict(zip(bounds.terms, (float(b) for b in bounds.beta_hat), strict=True))
    # (2.18): t sqrt(constant + s2 f h) with t inside the root.
    variance_per_leverage = bounds.t * bounds.t * bounds.s2 * bounds.leverage_factor
    constant = bounds.t * bounds.t * bounds.constant_variance
    if not math.isfinite(variance_per_leverage + constant):
        raise BadInputError(
            f"coefficient {name}: its half width would not be finite (t = {bounds.t:g}, s2 ="
            f" {bounds.s2:g}); make the bounds again with: uqharness bounds"
        )
    root = call(
        "sum",
        value(constant),
        call("product", value(variance_per_leverage), property_value(group.leverage)),
    )
    y, half = f"uq/{name}/centre", f"uq/{name}/half-width"
    return [
        *_component(y, horner(beta, group.names)),  # (2.17)
        *_component(half, call("sqrt", root)),
        *_component(
            f"uq/{name}/lower",
            call("min", call("difference", property_value(y), property_value(half)), value(0.0)),
        ),
        *_component(
            f"uq/{name}/upper",
            call("max", call("sum", property_value(y), property_value(half)), value(0.0)),
        ),
    ]


def _declarations(form: ModelForm) -> list[str]:
    """Return the declarations of properties that no component computes."""
    lines = [declare("uq/active", "0")]
    for name in COEFFICIENTS:
        if name not in form.coefficients:
            lines += [
                declare(f"uq/{name}/lower", "0", f"no bounds were made for {name}"),
                declare(f"uq/{name}/upper", "0"),
            ]
        parts = form.coefficients[name].parts if name in form.coefficients else None
        lines += _levels(name, 0.0 if parts is None else parts.transient_half_width)
    return lines


def _levels(name: str, transient: float = 0.0) -> list[str]:
    """Return the declarations of a coefficient's levels and switch."""
    return [
        declare(f"uq/{name}/level", "0.5"),
        declare(f"uq/{name}/transient", repr(float(transient)) if transient else "0"),
        declare(f"uq/{name}/transient-level", "0"),
        declare(f"uq/{name}/active", "1"),
    ]


def _deltas() -> list[str]:
    """Return the channel that computes the deltas in every frame."""
    lines = ['<channel name="Deltas">']
    for name in COEFFICIENTS:
        lower, upper = property_value(f"uq/{name}/lower"), property_value(f"uq/{name}/upper")
        # delta = active (lower + level (upper - lower) + transient transient-level).
        persistent = call(
            "product", property_value(f"uq/{name}/level"), call("difference", upper, lower)
        )
        transient = call(
            "product",
            property_value(f"uq/{name}/transient"),
            property_value(f"uq/{name}/transient-level"),
        )
        total = call("sum", lower, persistent, transient)
        lines += _indent(
            _component(
                f"uq/{name}/delta",
                call(
                    "product",
                    property_value("uq/active"),
                    property_value(f"uq/{name}/active"),
                    total,
                ),
            )
        )
    return [*lines, "</channel>"]


def _component(name: str, expression: Expression) -> list[str]:
    """Return a component that computes an expression."""
    return [
        f'<fcs_function name="{name}">',
        "  <function>",
        *(f"    {line}" for line in expression.lines()),
        "  </function>",
        "</fcs_function>",
    ]


def _indent(lines: list[str]) -> list[str]:
    """Return lines indented by two blanks."""
    return [f"  {line}" for line in lines]


_GENERAL = """Model-form uncertainty: delta coefficients in body axes, between bounds.

  uq/active                 0: nominal, bit-identical to the aircraft without this system;   \
1: deltas applied
  uq/<C>/lower, upper       bounds at the present flight state, lower <= 0 <= upper; \
<C> is CX CY CZ Cl Cm Cn
  uq/<C>/level              0..1, driven by the host or a script
  uq/<C>/transient          half-width of the transient model error; 0: no such part
  uq/<C>/transient-level    -1..1, driven by the host or a script
  uq/<C>/active             1; 0 takes this coefficient out, whatever its bounds
  uq/<C>/delta              what the aerodynamics add: uq/active uq/<C>/active
                            (lower + level (upper - lower) + transient transient-level)
  uq/extrapolated           1 while the state lies outside the data the bounds came from
  uq/extrapolation          by how much: the largest of a state's excess over its box, \
in widths of the box, and
                            sqrt(leverage/largest of the data) - 1; 0 inside
"""


def _remarks(form: ModelForm, aircraft: Aircraft, every: int) -> list[str]:
    """Return the comment about source and rate of the bounds."""
    flights = ", ".join(f"{f.name} ({f.seconds:.0f} s)" for f in form.flights) or "none named"
    growth = (
        "grow with the polynomial (published form)"
        if form.outside == "grow"
        else "stay as at the edge"
    )
    rate = 1.0 / (every * aircraft.dt_s)
    parted = any(bounds.parts is not None for bounds in form.coefficients.values())
    half = "t sqrt(persistent^2 + s2 f leverage)" if parted else "t sqrt(s2 (1 + f leverage))"
    return [
        (
            f"{form.confidence:.0%} intervals of aircraft {form.aircraft.name} (SHA-256"
            f" {form.aircraft.sha256[:16]}...),"
        ),
        f"from flights: {flights}.",
        (
            "Bounds are centre -/+ half-width, clipped at 0 so that the model itself always lies"
            " inside;"
        ),
        (
            f"  centre = polynomial of z,   half-width = {half},   z = (state - centre)/scale,"
            " uq/z/..."
        ),
        f"Outside the data's box they {growth}.",
        (
            f"Bounds every {every} frame(s), {rate:.4g} Hz at a step of {aircraft.dt_s:g} s; deltas"
            " every frame."
        ),
    ]


def _document(remarks: list[str], body: list[str]) -> bytes:
    """Return the system's XML."""
    comment = [*_GENERAL.splitlines(), "", *remarks]
    text = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!--",
        *(f"  {in_comment(line)}".rstrip() for line in comment),
        "-->",
        '<system name="model-form">',
        *(f"  {line}" for line in body),
        "</system>",
    ]
    return ("\n".join(text) + "\n").encode("utf-8")
