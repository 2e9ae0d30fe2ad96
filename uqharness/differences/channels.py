"""What two models are compared by: JSBSim's own numbers along a flight, in the order in which one causes the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sysid.units import FT_M, IN_M, LBF_FT_NM, LBF_N, SLUG_FT2_KGM2, SLUG_KG
from uqharness.simulator import Aircraft, Source

GROUPS = (
    "mass and CG",
    "inertia",
    "surfaces",
    "propulsion",
    "force coefficients",
    "moment coefficients",
    "external forces",
    "accelerations",
    "rates",
    "airspeed and angles",
    "path",
)
"""In the order of cause and effect within a frame: a force off the centre of gravity makes a moment, a moment makes no force."""


@dataclass(frozen=True)
class Channel:
    """One compared number: name, unit, group of GROUPS, where JSBSim has it, and the size below which it is called zero."""

    name: str
    unit: str
    group: str
    source: Source
    floor: float

    @property
    def rank(self) -> int:
        """Place of its group in the order of cause and effect."""
        return GROUPS.index(self.group)


def channels_of(aircraft: Aircraft, fdm: Any, others: tuple[str, ...] = ()) -> list[Channel]:
    """Channels of an aircraft's model ``fdm``; coefficients by its own reference area and lengths. others: properties besides."""
    S, b, c = (float(fdm[f"metrics/{name}"]) for name in ("Sw-sqft", "bw-ft", "cbarw-ft"))
    known = fdm.get_property_manager()
    out = [
        *(_mass(tag, what) for tag, what in _MASS),
        *_surfaces(aircraft, known),
        *(
            Channel(f"{name} of thrust", unit, "propulsion", Source(prop, factor), floor)
            for name, unit, prop, factor, floor in _THRUST
        ),
        *(
            Channel(
                name,
                "-",
                f"{kind} coefficients",
                Source(prop, 1.0 / (S * length), "aero/qbar-psf"),
                1e-4,
            )
            for kind, name, prop, length in (
                ("force", "CX", "forces/fbx-aero-lbs", 1.0),
                ("force", "CY", "forces/fby-aero-lbs", 1.0),
                ("force", "CZ", "forces/fbz-aero-lbs", 1.0),
                ("moment", "Cl", "moments/l-aero-lbsft", b),
                ("moment", "Cm", "moments/m-aero-lbsft", c),
                ("moment", "Cn", "moments/n-aero-lbsft", b),
            )
        ),
        *(
            Channel(f"external {name}", unit, "external forces", Source(prop, factor), 1e-3)
            for name, unit, prop, factor in _EXTERNAL
        ),
        *(
            Channel(name, unit, group, Source(prop, factor), floor)
            for name, unit, group, prop, factor, floor in _MOTION
        ),
        *(Channel(prop, "own unit", "surfaces", Source(prop), 1e-6) for prop in others),
    ]
    return [c for c in out if known.hasNode(c.source.property)]


def _mass(name: str, what: tuple[str, str, float]) -> Channel:
    prop, unit, factor = what
    group = "inertia" if name.startswith("I") else "mass and CG"
    return Channel(name, unit, group, Source(prop, factor), 1e-6)


def _surfaces(aircraft: Aircraft, known: Any) -> list[Channel]:
    names = {
        card.position: control for control, card in aircraft.card.inputs.items() if card.position
    }
    standard = {
        f"fcs/{s}-pos-{unit}": s
        for s in ("elevator", "left-aileron", "right-aileron", "rudder", "flap", "throttle")
        for unit in ("rad", "norm")
    }
    out: dict[str, Channel] = {}
    for prop, control in {**standard, **names}.items():
        if known.hasNode(prop):
            unit = next(
                (u for u in ("deg", "rad", "norm", "pct") if prop.endswith(f"-{u}")), "own unit"
            )
            out[control] = Channel(
                f"{control.replace('-', ' ')} position", unit, "surfaces", Source(prop), 1e-4
            )
    return list(out.values())


_MASS = (
    ("mass", ("inertia/mass-slugs", "kg", SLUG_KG)),
    ("Ixx", ("inertia/ixx-slugs_ft2", "kg m2", SLUG_FT2_KGM2)),
    ("Iyy", ("inertia/iyy-slugs_ft2", "kg m2", SLUG_FT2_KGM2)),
    ("Izz", ("inertia/izz-slugs_ft2", "kg m2", SLUG_FT2_KGM2)),
    ("Ixy", ("inertia/ixy-slugs_ft2", "kg m2", SLUG_FT2_KGM2)),
    ("Ixz", ("inertia/ixz-slugs_ft2", "kg m2", SLUG_FT2_KGM2)),
    ("Iyz", ("inertia/iyz-slugs_ft2", "kg m2", SLUG_FT2_KGM2)),
    ("CG x", ("inertia/cg-x-in", "m", IN_M)),
    ("CG y", ("inertia/cg-y-in", "m", IN_M)),
    ("CG z", ("inertia/cg-z-in", "m", IN_M)),
)
_THRUST = (
    ("X force", "N", "forces/fbx-prop-lbs", LBF_N, 1e-2),
    ("Y force", "N", "forces/fby-prop-lbs", LBF_N, 1e-2),
    ("Z force", "N", "forces/fbz-prop-lbs", LBF_N, 1e-2),
    ("roll moment", "N m", "moments/l-prop-lbsft", LBF_FT_NM, 1e-2),
    ("pitch moment", "N m", "moments/m-prop-lbsft", LBF_FT_NM, 1e-2),
    ("yaw moment", "N m", "moments/n-prop-lbsft", LBF_FT_NM, 1e-2),
)
_EXTERNAL = (
    ("X force", "N", "forces/fbx-external-lbs", LBF_N),
    ("Y force", "N", "forces/fby-external-lbs", LBF_N),
    ("Z force", "N", "forces/fbz-external-lbs", LBF_N),
)
_MOTION = (
    ("u_dot", "m/s2", "accelerations", "accelerations/udot-ft_sec2", FT_M, 1e-2),
    ("v_dot", "m/s2", "accelerations", "accelerations/vdot-ft_sec2", FT_M, 1e-2),
    ("w_dot", "m/s2", "accelerations", "accelerations/wdot-ft_sec2", FT_M, 1e-2),
    ("p_dot", "rad/s2", "accelerations", "accelerations/pdot-rad_sec2", 1.0, 1e-2),
    ("q_dot", "rad/s2", "accelerations", "accelerations/qdot-rad_sec2", 1.0, 1e-2),
    ("r_dot", "rad/s2", "accelerations", "accelerations/rdot-rad_sec2", 1.0, 1e-2),
    ("p", "rad/s", "rates", "velocities/p-rad_sec", 1.0, 1e-3),
    ("q", "rad/s", "rates", "velocities/q-rad_sec", 1.0, 1e-3),
    ("r", "rad/s", "rates", "velocities/r-rad_sec", 1.0, 1e-3),
    ("V", "m/s", "airspeed and angles", "velocities/vt-fps", FT_M, 1e-1),
    ("alpha", "rad", "airspeed and angles", "aero/alpha-rad", 1.0, 1e-3),
    ("beta", "rad", "airspeed and angles", "aero/beta-rad", 1.0, 1e-3),
    ("phi", "rad", "airspeed and angles", "attitude/phi-rad", 1.0, 1e-3),
    ("theta", "rad", "airspeed and angles", "attitude/theta-rad", 1.0, 1e-3),
    ("height", "m", "path", "position/h-sl-ft", FT_M, 1.0),
)
