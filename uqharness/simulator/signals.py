"""Signals of a flight record and the JSBSim properties they come from: one table, with the factor to SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from sysid.units import FT_M, RAD_DEG, SLUG_FT3_KGPM3
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.card import InputCard

LBF_PER_SLUG_TO_MPS2 = FT_M
"""Force in lbf over mass in slugs is ft/s2."""


@dataclass(frozen=True)
class Source:
    """signal = factor * property (divided by ``over``, if given)."""

    property: str
    factor: float = 1.0
    over: str | None = None


# Specific force is total force without gravity over mass, at the CG: JSBSim's own a-pilot properties are one frame old, and a
# record promises that the acceleration of a sample has already seen the command of that sample.
STANDARD: Mapping[str, Source] = MappingProxyType(
    {
        "time_s": Source("simulation/sim-time-sec"),
        "V_mps": Source("velocities/vt-fps", FT_M),
        "alpha_rad": Source("aero/alpha-rad"),
        "beta_rad": Source("aero/beta-rad"),
        "phi_rad": Source("attitude/phi-rad"),
        "theta_rad": Source("attitude/theta-rad"),
        "psi_rad": Source("attitude/psi-rad"),
        "p_radps": Source("velocities/p-rad_sec"),
        "q_radps": Source("velocities/q-rad_sec"),
        "r_radps": Source("velocities/r-rad_sec"),
        "ax_mps2": Source("forces/fbx-total-lbs", LBF_PER_SLUG_TO_MPS2, "inertia/mass-slugs"),
        "ay_mps2": Source("forces/fby-total-lbs", LBF_PER_SLUG_TO_MPS2, "inertia/mass-slugs"),
        "az_mps2": Source("forces/fbz-total-lbs", LBF_PER_SLUG_TO_MPS2, "inertia/mass-slugs"),
        "h_m": Source("position/h-sl-ft", FT_M),
        "vn_mps": Source("velocities/v-north-fps", FT_M),
        "ve_mps": Source("velocities/v-east-fps", FT_M),
        "vd_mps": Source("velocities/v-down-fps", FT_M),
        "rho_kgpm3": Source("atmosphere/rho-slugs_ft3", SLUG_FT3_KGPM3),
    }
)

SECOND_ORDER: Mapping[str, float] = MappingProxyType(
    {
        "simulation/integrator/rate/rotational": 3.0,
        "simulation/integrator/rate/translational": 3.0,
        "simulation/integrator/position/rotational": 3.0,
    }
)
"""Adams-Bashforth integrators of second order for a flight that is to be compared with others.

JSBSim's default for body rates and attitude is Euler's rule, which at 100 Hz makes roll damping 4 % too strong and moves everything
by half a step; an identification would put the difference into the coefficients.
"""

_UNIT_TO_RECORD = {"deg": 1.0, "pct": 1.0, "rad": RAD_DEG, "norm": 1.0}
_COLUMN = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}


def sources(aircraft: Aircraft) -> dict[str, Source]:
    """The record's signals for this aircraft: the standard table, the card's outputs, commands and measured surfaces.

    A normalised command (unit "norm") becomes percent of a throttle, and degrees of a surface through the card's throw_deg; without
    a throw it is left as it stands and named ``<surface>_norm``.
    """
    table = dict(STANDARD)
    for signal, name in aircraft.card.outputs.items():
        table[signal] = Source(name)
    for control, card in aircraft.card.inputs.items():
        column = _COLUMN.get(control, f"{control}_{card.unit}")
        factor = _UNIT_TO_RECORD.get(card.unit, 1.0)
        if card.unit == "norm":
            if control == "throttle":
                factor = 100.0
            elif card.throw_deg is not None:
                factor = card.throw_deg
            else:
                column = f"{control}_norm"
        selected = card.selected or card.property
        table[column] = Source(selected, factor)
        if card.position is not None and column.endswith("_deg"):
            table[column.replace("_deg", "_pos_deg")] = Source(card.position, position_factor(card))
    return table


def position_factor(card: InputCard) -> float:
    """Unit of a card's position property to degrees, + as a record counts.

    A card in deg or rad has its position in the same unit. Of a normalised command the property's ending tells (JSBSim's own
    names end in -deg, -rad or -norm), and the throw its sign.
    """
    if card.unit != "norm" or card.position is None:
        return _UNIT_TO_RECORD.get(card.unit, 1.0)
    throw = 1.0 if card.throw_deg is None else card.throw_deg
    if card.position.endswith("-rad"):
        return math.copysign(_UNIT_TO_RECORD["rad"], throw)
    return throw if card.position.endswith("-norm") else math.copysign(1.0, throw)


def standard_positions() -> dict[str, Source]:
    """Surface positions by JSBSim's own properties, for an aircraft without a card; they may or may not be there."""
    return {
        f"{surface}_pos_deg": Source(f"fcs/{surface}-pos-deg")
        for surface in ("elevator", "aileron", "rudder")
    }
