"""JSBSim's words for what effects are made of: variables of coefficient terms, the terms, and subsystems' effects."""

from __future__ import annotations

from collections.abc import Mapping

from sysid.effects import V_REFERENCE_MPS, Effect, Term
from sysid.units import FT_M, LBF_N
from uqharness.errors import BadInputError
from uqharness.identification.linearised import STALL
from uqharness.plugin import state_source
from uqharness.simulator import Aircraft
from uqharness.xml import AeroSection, Expression, call, computes, prop, value

INFLOW_POWERS = 4
"""Numbers of the polynomial over CT that inflow is written as."""
_CONTROLS = {
    "de": "elevator_pos_deg",
    "da": "aileron_pos_deg",
    "dr": "rudder_pos_deg",
    "dt": "throttle_pct",
}
_QBAR_S = (prop("aero/qbar-psf"), prop("metrics/Sw-sqft"))


def _computes(section: AeroSection, name: str) -> bool:
    return any(computes(document, name) for document in section.documents)


def _per_rate(length: str, section: AeroSection) -> Expression:
    """b/2V or c/2V [s] of this frame: JSBSim's own aero/bi2vel, aero/ci2vel are a frame old in an effect's function."""
    if _computes(section, f"aero/{length}_2V"):
        return prop(f"aero/{length}_2V")
    metric = {"b": "metrics/bw-ft", "c": "metrics/cbarw-ft"}[length]
    speed = call("max", prop("velocities/vt-fps"), value(0.1))
    return call("quotient", prop(metric), call("product", value(2, "g"), speed))


def variable_xml(variable: str, section: AeroSection, aircraft: Aircraft) -> Expression:
    """A term's variable in this aircraft. Raises BadInputError where nothing gives it."""
    if variable in ("alpha", "beta"):
        return prop(f"aero/{variable}-rad")
    if variable.endswith("_hat"):
        rate = variable.removesuffix("_hat")
        of_body = rate in ("p", "q", "r")
        if of_body and _computes(section, f"aero/{variable}"):
            return prop(f"aero/{variable}")
        per_rate = _per_rate("c" if rate in ("q", "alphadot") else "b", section)
        return call(
            "product",
            per_rate,
            prop(f"velocities/{rate}-aero-rad_sec" if of_body else f"aero/{rate}-rad_sec"),
        )
    if variable in _CONTROLS:
        source, factor = state_source(_CONTROLS[variable], aircraft)
        factor *= 0.01 if variable == "dt" else 1.0
        return (
            prop(source) if factor == 1.0 else call("product", value(factor, ".10g"), prop(source))
        )
    if variable == "CT":
        thrust = aircraft.card.outputs.get("thrust_N")
        force = (
            call("product", value(1.0 / LBF_N, ".10g"), prop(thrust))
            if thrust
            else prop("forces/fbx-prop-lbs")
        )
        return call("quotient", force, call("product", *_QBAR_S))
    if variable == "V_rel":
        return call("product", value(FT_M / V_REFERENCE_MPS, ".10g"), prop("velocities/vt-fps"))
    if variable == "h_over_b":
        return call(
            "max", value(0.1), call("quotient", prop("position/h-agl-ft"), prop("metrics/bw-ft"))
        )
    raise BadInputError(f"variable '{variable}' has no JSBSim form")


def term_xml(term: Term, section: AeroSection, aircraft: Aircraft) -> list[Expression]:
    """Factors of a term."""
    out: list[Expression] = []
    for f in term.factors:
        one = variable_xml(f.variable, section, aircraft)
        one = call("abs", one) if f.absolute else one
        if f.power < 0:
            out.append(
                call(
                    "quotient",
                    value(1, "g"),
                    one if f.power == -1 else call("pow", one, value(-f.power, "g")),
                )
            )
        elif f.power <= 3:
            out += [one] * f.power
        else:
            out.append(call("pow", one, value(f.power, "g")))
    return out


def subsystem_terms(
    effect: Effect, slopes: Mapping[str, float], section: AeroSection, aircraft: Aircraft
) -> list[tuple[str, float, list[Expression]]]:
    """(coefficient, number, factors) that make up a subsystem's effect; slopes: of `writing.effects.Written`."""

    def x(name: str) -> Expression:
        return variable_xml(name, section, aircraft)

    match effect.subsystem, effect.term:
        case "propulsion", "thrust_scale":
            return [("CX", 1.0, [x("CT")])]
        case "propulsion", "airspeed":
            return [("CX", 1.0, [x("CT"), call("difference", x("V_rel"), value(1, "g"))])]
        case "propulsion", "inflow":
            # A propeller's thrust slope over qbar S is a function of the advance ratio, and so of CT: a cubic of it.
            CT, numbers = x("CT"), [slopes.get(f"inflow_{k}", 0.0) for k in range(INFLOW_POWERS)]
            curve = value(numbers[-1], ".8g")
            for number in reversed(numbers[:-1]):
                curve = call("sum", value(number, ".8g"), call("product", CT, curve))
            return [("CX", 1.0, [curve])]
        case "propulsion", "torque":
            return [("Cl", 1.0, [x("CT")])]
        case "propulsion", "p_factor":
            return [("Cn", -1.0, [x("CT"), x("alpha")]), ("Cm", -1.0, [x("CT"), x("beta")])]
        case "propulsion", "slipstream":
            rows = [(c, slopes.get(f"{c}_de", 0.0), [x("de"), x("CT")]) for c in ("CZ", "Cm")]
            rows += [
                (c, slopes.get(f"{c}_dr", 0.0), [x("dr"), x("CT")]) for c in ("CY", "Cl", "Cn")
            ]
            return [r for r in rows if r[1] != 0.0]
        case "stall", _:
            return [
                ("CZ", slopes.get("CZ_alpha", 0.0), [x("alpha"), _lift_lost(effect.term, section)])
            ]
        case "ground", _:
            near = call("exp", call("product", value(-2, "g"), x("h_over_b")))
            # The force of the frame before holds the effect already: divided by 1 + k exp(-2 h/b) it is the force without.
            with_effect = call(
                "sum", value(1, "g"), call("product", prop(effect.property_name), near)
            )
            force = call("product", *_QBAR_S, with_effect)
            return [("CZ", 1.0, [near, call("quotient", prop("forces/fbz-aero-lbs"), force)])]
    raise BadInputError(f"effect {effect.key}: no JSBSim form is known")


def _lift_lost(term: str, section: AeroSection) -> Expression:
    """Share of the lift that separation takes, 0 or less: ((1 + sqrt X)/2)^2 - 1."""
    lag = value(0, "g")
    if term == "dynamic":
        lag = call(
            "product",
            value(2, "g"),
            _per_rate("c", section),
            call("todegrees", prop("aero/alphadot-rad_sec")),
        )
    angle = call("difference", prop("aero/alpha-deg"), lag)
    a1 = 2.0 * STALL["a1_per_deg"]

    def side(sign: int, at: float) -> Expression:
        exponent = call("product", value(sign * a1, "g"), call("difference", angle, value(at, "g")))
        return call("sum", value(1, "g"), call("exp", exponent))

    both = call("product", side(1, STALL["alpha1_deg"]), side(-1, STALL["alpha2_deg"]))
    X = call("quotient", value(1, "g"), both)
    square = call("pow", call("sum", value(1, "g"), call("sqrt", X)), value(2, "g"))
    return call("difference", call("product", value(0.25), square), value(1, "g"))
