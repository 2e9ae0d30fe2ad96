"""JSBSim's own properties: which there are, which keep their value, which XML and hosts may write, which must stand as they are.

Found by experiment with JSBSim 1.3.3. A property that is none of its own is made by the XML that declares it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

_LEVERS = (
    r"fcs/.*-(cmd|pos)-(norm|rad|deg)(\[\d+\])?|fcs/.*-brake-cmd-norm|gear/gear-(cmd|pos)-norm"
)
_AIR = (
    r"atmosphere/((gust|wind)-(north|east|down)-fps|wind-mag-fps|psiw-rad|turb-type|delta-T|P-sl-psf"
    r"|turbulence/milspec/(severity|windspeed_at_20ft_AGL-fps))"
)
_ENGINE_SET = (
    r"propulsion/engine(\[\d+\])?/([xyz]-position|(pitch|yaw|reverser)-angle-rad|blade-angle|constant-speed-mode|propeller-sense"
    r"|friction-hp|bsfc-lbs_hphr|volumetric-efficiency|air-intake-impedance-factor|ram-air-factor|cooling-factor|starter-norm"
    r"|bleed-factor)"
)
_ENGINE_MADE = (
    r"propulsion/engine(\[\d+\])?/(set-running|thrust-lbs|fuel-flow-rate-(pps|gph)|fuel-used-lbs|(engine|propeller)-rpm"
    r"|advance-ratio|thrust-coefficient|helical-tip-Mach|prop-induced-velocity_fps|propeller-(power-ftlbps|torque-ftlb)"
    r"|[xyz]-reference-position|power-hp|current-amperes|map-(pa|inhg)|boost-speed|boostloss-(factor|hp)|(cht|egt)-degF|AFR"
    r"|oil-(temperature-degF|pressure-psi)|n[12]|MaxN[12]|injection_cmd|seized|stalled|Inj(ectionTimer|WaterNorm|N[12]increment)"
    r"|a?tsfc|itt-c|engtrq-ftlb|ielu_intervent|combustion_efficiency|total-impulse|vacuum-thrust_lbs|rotor-.*|.*-angle-.*)"
)
_TANK_SET = r"propulsion/tank(\[\d+\])?/(contents-lbs|priority|external-flow-rate-pps|unusable-volume-gal|[xyz]-position)"
_TANK_MADE = r"propulsion/tank(\[\d+\])?/(pct-full|density-lbs_per_gal|local-i..-slug_ft2)"
_OWN = re.compile(
    r"(simulation|inertial|ic|orbital|velocities|position|attitude|accelerations|forces|moments|flight-path|inertia|metrics|ground"
    r"|atmosphere)/.*"
    r"|aero/(Re|alpha(-wing|-max|-min)?-rad|alpha-deg|(alpha|beta)dot-(rad|deg)_sec|(mag-)?beta-(rad|deg)|[bc]i2vel|cl-squared"
    r"|h_b-(cg|mac)-ft|qbar(UV|UW)?-psf|qbar-area|stall-hyst-norm)"
    r"|systems/stall-warn-norm|gear/(num-units|wow|unit(\[\d+\])?/.*)|contact/unit(\[\d+\])?/.*|fcs/mag-.*-pos-rad"
    r"|propulsion/(tat-[rc]|pt-lbs_sqft|active_engine|set-running|starter_cmd|cutoff_cmd|magneto_cmd|refuel|fuel_dump|fuel_freeze"
    rf"|total-.*-lbs)|{_ENGINE_SET}|{_ENGINE_MADE}|{_TANK_SET}|{_TANK_MADE}|buoyant_forces/.*"
)
_FIXED = re.compile(
    r"(metrics|inertia|external_reactions)/.*|simulation/(integrator/.*|gravity-model|gravitational-torque)"
    rf"|{_AIR}|atmosphere/(randomseed|turb-(north|east|down)-fps|[pqr]-turb-rad_sec)"
    r"|.*/malfunction/fail_(zero|hardover|stuck|low|high)"
    r"|gear/(unit(\[\d+\])?/)?(WOW|wow|compression-ft|compression-velocity-fps)"  # 0: contact ends a flight
    rf"|{_LEVERS}|position/terrain-elevation-asl-ft"
    rf"|{_ENGINE_SET}|propulsion/engine(\[\d+\])?/[xyz]-reference-position|{_TANK_SET}|propulsion/tank(\[\d+\])?/density-lbs_per_gal"
)
_WRITABLE = re.compile(rf"{_AIR}|metrics/aero-rp-[xyz]-in|{_ENGINE_SET}|{_TANK_SET}")
_BY_HOST = re.compile(
    r"metrics/(bw-ft|cbarw-ft)|inertia/(mass-slugs|weight-lbs|empty-weight-lbs|cg-[xyz]-in|i..-slugs_ft2)"
    r"|simulation/(integrator/.*|gravity-model)|ic/.*|position/terrain-elevation-asl-ft"
)
REQUIRED: Mapping[str, float] = MappingProxyType(
    {
        "simulation/gravity-model": 1.0,
        "simulation/gravitational-torque": 0.0,
        "simulation/terminate": 0.0,
        "forces/hold-down": 0.0,
        "atmosphere/SL-graded-delta-T": 0.0,
        "atmosphere/vapor-pressure-psf": 0.0,
        "atmosphere/updownburst/number-of-cells": 0.0,
        "atmosphere/cosine-gust/magnitude-ft_sec": 0.0,
        **{
            f"simulation/models/FG{model}/enabled": 1.0
            for model in (
                "Inertial",
                "Propagate",
                "Atmosphere",
                "Winds",
                "FCS",
                "MassBalance",
                "Auxiliary",
                "Propulsion",
                "Aerodynamics",
                "ExternalReactions",
                "Aircraft",
                "Accelerations",
            )
        },
    }
)
"""Settings of JSBSim to the only value that the batch engine has."""


def own(name: str) -> bool:
    """Whether JSBSim makes the property itself, so that it may change although no XML writes it."""
    return _OWN.fullmatch(name) is not None


def fixed(name: str) -> bool:
    """Whether one of JSBSim's own properties keeps its value as long as nobody writes it."""
    return _FIXED.fullmatch(name) is not None


def writable(name: str) -> bool:
    """Whether the batch engine does what JSBSim does when XML writes the property."""
    return not own(name) or _WRITABLE.fullmatch(name) is not None


def settable(name: str) -> bool:
    """Whether the batch engine does what JSBSim does when a host sets the property before the flight."""
    return writable(name) or _BY_HOST.fullmatch(name) is not None
