"""JSBSim's words for what effects are made of: variables of coefficient terms, the terms, and subsystems' effects."""

from __future__ import annotations

from collections.abc import Mapping

from sysid.effects.catalogue import Effect
from sysid.effects.effect_terms import V_REFERENCE_MPS, Term
from uqharness.errors import BadInputError
from uqharness.plugin.model_form_xml import state_source
from uqharness.refinement.candidates import STALL
from uqharness.simulator.aircraft import Aircraft
from uqharness.xml.aerodynamics import AeroSection

FT = 0.3048
INFLOW_POWERS = 4
"""Numbers of the polynomial over CT that inflow is written as."""


def _has_function(section: AeroSection, name: str) -> bool:
    return any(
        n.tag == "function" and n.attributes.get("name", "").strip() == name for d in section.documents for n in d.root.walk()
    )


def _per_rate(length: str, section: AeroSection) -> str:
    """b/2V or c/2V [s] of this frame: JSBSim's own aero/bi2vel, aero/ci2vel are a frame old in an effect's function."""
    if _has_function(section, f"aero/{length}_2V"):
        return f"<property>aero/{length}_2V</property>"
    metric = {"b": "metrics/bw-ft", "c": "metrics/cbarw-ft"}[length]
    speed = "<max> <property>velocities/vt-fps</property> <value>0.1</value> </max>"
    return f"<quotient> <property>{metric}</property> <product> <value>2</value> {speed} </product> </quotient>"


def variable_xml(variable: str, section: AeroSection, aircraft: Aircraft) -> str:
    """XML expression of a term's variable in this aircraft. Raises BadInputError where nothing gives it."""
    if variable in ("alpha", "beta"):
        return f"<property>aero/{variable}-rad</property>"
    if variable in ("p_hat", "q_hat", "r_hat"):
        if _has_function(section, f"aero/{variable}"):
            return f"<property>aero/{variable}</property>"
        axis = variable[0]
        scale = _per_rate("c" if axis == "q" else "b", section)
        return f"<product> {scale} <property>velocities/{axis}-aero-rad_sec</property> </product>"
    if variable == "alphadot_hat":
        return f"<product> {_per_rate('c', section)} <property>aero/alphadot-rad_sec</property> </product>"
    if variable == "betadot_hat":
        return f"<product> {_per_rate('b', section)} <property>aero/betadot-rad_sec</property> </product>"
    if variable in ("de", "da", "dr", "dt"):
        control = {"de": "elevator", "da": "aileron", "dr": "rudder", "dt": "throttle"}[variable]
        source, factor = state_source("throttle_pct" if control == "throttle" else f"{control}_pos_deg", aircraft)
        factor *= 0.01 if control == "throttle" else 1.0
        name = f"<property>{source}</property>"
        return name if factor == 1.0 else f"<product> <value>{factor:.10g}</value> {name} </product>"
    if variable == "CT":
        thrust = aircraft.card.outputs.get("thrust_N")
        force = (
            f"<product> <value>0.2248089431</value> <property>{thrust}</property> </product>"
            if thrust
            else "<property>forces/fbx-prop-lbs</property>"
        )
        return (
            f"<quotient> {force} <product> <property>aero/qbar-psf</property> "
            "<property>metrics/Sw-sqft</property> </product> </quotient>"
        )
    if variable == "V_rel":
        return f"<product> <value>{FT / V_REFERENCE_MPS:.10g}</value> <property>velocities/vt-fps</property> </product>"
    if variable == "h_over_b":
        return (
            "<max> <value>0.1</value> <quotient> <property>position/h-agl-ft</property> "
            "<property>metrics/bw-ft</property> </quotient> </max>"
        )
    raise BadInputError(f"variable '{variable}' has no JSBSim form")


def term_xml(term: Term, section: AeroSection, aircraft: Aircraft) -> list[str]:
    """Factors of a term as XML elements."""
    out = []
    for f in term.factors:
        one = variable_xml(f.variable, section, aircraft)
        one = f"<abs> {one} </abs>" if f.absolute else one
        if f.power < 0:
            whole = one if f.power == -1 else f"<pow> {one} <value>{-f.power}</value> </pow>"
            out.append(f"<quotient> <value>1</value> {whole} </quotient>")
        elif f.power <= 3:
            out += [one] * f.power
        else:
            out.append(f"<pow> {one} <value>{f.power}</value> </pow>")
    return out


def subsystem_terms(
    effect: Effect, slopes: Mapping[str, float], section: AeroSection, aircraft: Aircraft
) -> list[tuple[str, float, list[str]]]:
    """(coefficient, number, factors) that make up a subsystem's effect; slopes: of `refine_xml.Written`."""

    def x(name: str) -> str:
        return variable_xml(name, section, aircraft)

    part, term = effect.subsystem, effect.term
    if part == "propulsion":
        if term == "thrust_scale":
            return [("CX", 1.0, [x("CT")])]
        if term == "airspeed":
            return [("CX", 1.0, [x("CT"), f"<difference> {x('V_rel')} <value>1</value> </difference>"])]
        if term == "inflow":
            # A propeller's thrust slope over qbar S is a function of the advance ratio, and so of CT: a cubic of it.
            CT, numbers = x("CT"), [slopes.get(f"inflow_{k}", 0.0) for k in range(INFLOW_POWERS)]
            curve = f"<value>{numbers[-1]:.8g}</value>"
            for number in reversed(numbers[:-1]):
                curve = f"<sum> <value>{number:.8g}</value> <product> {CT} {curve} </product> </sum>"
            return [("CX", 1.0, [curve])]
        if term == "torque":
            return [("Cl", 1.0, [x("CT")])]
        if term == "p_factor":
            return [("Cn", -1.0, [x("CT"), x("alpha")]), ("Cm", -1.0, [x("CT"), x("beta")])]
        rows = [(c, slopes.get(f"{c}_de", 0.0), [x("de"), x("CT")]) for c in ("CZ", "Cm")]
        rows += [(c, slopes.get(f"{c}_dr", 0.0), [x("dr"), x("CT")]) for c in ("CY", "Cl", "Cn")]
        return [r for r in rows if r[1] != 0.0]
    if part == "stall":
        lag = (
            f"<product> <value>2</value> {_per_rate('c', section)} "
            "<todegrees> <property>aero/alphadot-rad_sec</property> </todegrees> </product>"
            if term == "dynamic"
            else "<value>0</value>"
        )
        angle = f"<difference> <property>aero/alpha-deg</property> {lag} </difference>"
        a1 = 2.0 * STALL["a1_per_deg"]

        def side(sign: int, at: float) -> str:
            return (
                f"<sum> <value>1</value> <exp> <product> <value>{sign * a1:g}</value> "
                f"<difference> {angle} <value>{at:g}</value> </difference> </product> </exp> </sum>"
            )

        both = f"{side(1, STALL['alpha1_deg'])} {side(-1, STALL['alpha2_deg'])}"
        X = f"<quotient> <value>1</value> <product> {both} </product> </quotient>"
        lost = (
            f"<difference> <product> <value>0.25</value> <pow> <sum> <value>1</value> <sqrt> {X} </sqrt> </sum> "
            "<value>2</value> </pow> "
            "</product> <value>1</value> </difference>"
        )
        return [("CZ", slopes.get("CZ_alpha", 0.0), [x("alpha"), lost])]
    if part == "ground":
        near = f"<exp> <product> <value>-2</value> {x('h_over_b')} </product> </exp>"
        # The force of the frame before holds the effect already: divided by 1 + k exp(-2 h/b) it is the force without.
        own = (
            f"<quotient> <property>forces/fbz-aero-lbs</property> <product> <property>aero/qbar-psf</property> "
            f"<property>metrics/Sw-sqft</property> <sum> <value>1</value> <product> "
            f"<property>{effect.property_name}</property> {near} </product> </sum> </product> </quotient>"
        )
        return [("CZ", 1.0, [near, own])]
    raise BadInputError(f"effect {effect.key}: no JSBSim form is known")
