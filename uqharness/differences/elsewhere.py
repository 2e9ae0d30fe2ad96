"""Flights of a comparison, frame by frame, in this environment or with another JSBSim.

`channels_of` lists the compared properties in the order of cause and effect, and `fly_frames`
records them in a worker process. `fly_elsewhere` does the same with the interpreter, and hence the
JSBSim version, of another environment; its child is ``python -m uqharness.differences.elsewhere
JOB.json OUT.npz``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import FT_M, IN_M, LBF_FT_NM, LBF_N, SLUG_FT2_KGM2, SLUG_KG
from uqharness.child_process import describe_exit, give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder, write_json
from uqharness.flight import FlightSpec, record_mission, seeded_spec
from uqharness.isolation import run_isolated
from uqharness.simulator import Aircraft, Source, StagedMission, engine, find_aircraft, read_script

# Compared channels.

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
"""Groups of channels in the order of cause and effect within a frame.

Forces precede moments: a force off the centre of gravity causes a moment, not the reverse.
"""


@dataclass(frozen=True)
class Channel:
    """A compared quantity.

    Attributes
    ----------
    name, unit : str
        Name and unit in tables.
    group : str
        One of `GROUPS`.
    source : Source
        JSBSim property and factor.
    floor : float
        Magnitude [unit] below which the quantity counts as zero.
    """

    name: str
    unit: str
    group: str
    source: Source
    floor: float

    @property
    def rank(self) -> int:
        """Return the place of its group in the order of cause and effect."""
        return GROUPS.index(self.group)


def channels_of(
    aircraft: Aircraft, fdm: Any, extra_properties: tuple[str, ...] = ()
) -> list[Channel]:
    """Return the channels that an aircraft's model has.

    Parameters
    ----------
    aircraft : Aircraft
        Its card names positions of surfaces.
    fdm : FGFDMExec
        The loaded model; its reference area and lengths make the coefficients.
    extra_properties : tuple of str
        Further properties to compare, in their own unit.
    """
    S, b, c = (float(fdm[f"metrics/{name}"]) for name in ("Sw-sqft", "bw-ft", "cbarw-ft"))
    property_manager = fdm.get_property_manager()
    channels = [
        *(_mass_channel(tag, source) for tag, source in _MASS),
        *_surface_channels(aircraft, property_manager),
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
        *(Channel(prop, "own unit", "surfaces", Source(prop), 1e-6) for prop in extra_properties),
    ]
    # Only properties that this model has.
    return [c for c in channels if property_manager.hasNode(c.source.property)]


def _mass_channel(name: str, source: tuple[str, str, float]) -> Channel:
    """Return a channel of mass properties from (property, unit, factor)."""
    prop, unit, factor = source
    group = "inertia" if name.startswith("I") else "mass and CG"
    return Channel(name, unit, group, Source(prop, factor), 1e-6)


def _surface_channels(aircraft: Aircraft, property_manager: Any) -> list[Channel]:
    """Return the positions of surfaces that exist: of the card first, else JSBSim's usual names."""
    names = {
        card.position: control for control, card in aircraft.card.inputs.items() if card.position
    }
    standard = {
        f"fcs/{s}-pos-{unit}": s
        for s in ("elevator", "left-aileron", "right-aileron", "rudder", "flap", "throttle")
        for unit in ("rad", "norm")
    }
    channels: dict[str, Channel] = {}
    for prop, control in {**standard, **names}.items():
        if property_manager.hasNode(prop):
            unit = next(
                (u for u in ("deg", "rad", "norm", "pct") if prop.endswith(f"-{u}")), "own unit"
            )
            channels[control] = Channel(
                f"{control.replace('-', ' ')} position", unit, "surfaces", Source(prop), 1e-4
            )
    return list(channels.values())


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


# Flights, recorded in every frame.


@dataclass(frozen=True)
class FlightSettings:
    """Settings of one flight.

    Attributes
    ----------
    max_s : float
        Longest duration [s]; a script may end earlier.
    dt_s : float
        Integration step [s].
    turbulence : str
        Intensity of turbulence.
    seed : int
        Seed of turbulence and noise.
    one_ulp_off : bool
        Whether the initial velocity is one unit in the last place larger.
    properties : mapping
        Properties set before the flight.
    """

    max_s: float
    dt_s: float
    turbulence: str = "none"
    seed: int = 1
    one_ulp_off: bool = False
    properties: Mapping[str, float] = field(default_factory=dict)


def fly_frames(
    aircraft: Aircraft, path: Path, channels: Sequence[Channel], settings: FlightSettings
) -> dict[str, FloatArray]:
    """Fly in a worker process; return ``time_s`` and the channels by name, each (frames,).

    Raises BadInputError if the aircraft or the script cannot be flown.
    """
    return run_isolated(_fly_in_worker, aircraft, path, channels, settings)


def _fly_in_worker(
    aircraft: Aircraft, path: Path, channels: Sequence[Channel], settings: FlightSettings
) -> dict[str, FloatArray]:
    """Fly and record all frames; both models of a comparison use the same step."""
    script = read_script(path)
    if settings.dt_s != aircraft.dt_s:
        # Both models fly with the step of model A.
        section = aircraft.card.aircraft.model_copy(update={"dt_s": settings.dt_s})
        aircraft = replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": section}))
    spec = FlightSpec(
        aircraft=aircraft.folder,
        script=path,
        duration_s=min(script.end_s, settings.max_s),
        turbulence=settings.turbulence,
        record_rate_hz=1.0 / aircraft.dt_s,
        properties=dict(settings.properties),
    )
    with StagedMission(aircraft, path) as mission:
        optional = {c.name: c.source for c in channels}
        recorded = record_mission(
            mission,
            seeded_spec(spec, settings.seed),
            {},
            optional,
            keep_burn_in=True,
            one_ulp_off=settings.one_ulp_off,
        )
    return recorded.signals


TIMEOUT_S = 600.0
"""Longest flight in another environment, in wall-clock time [s]."""


class RefusedError(BadInputError):
    """The other JSBSim runs but does not fly the aircraft."""


def fly_elsewhere(
    python: Path,
    aircraft: Aircraft,
    script: Path,
    channels: Sequence[Channel],
    settings: FlightSettings,
) -> tuple[dict[str, FloatArray], str]:
    """Fly with the interpreter of another environment.

    Parameters
    ----------
    python : Path
        Interpreter of an environment with JSBSim and the dependencies of this package.
    aircraft : Aircraft
        The aircraft.
    script : Path
        Run script.
    channels : sequence of Channel
        What to record.
    settings : FlightSettings
        Duration, step, air and start.

    Returns
    -------
    signals : dict
        ``time_s`` and channels by name, each (frames,).
    version : str
        Version of the other JSBSim.

    Raises
    ------
    RefusedError
        If the other JSBSim does not fly the aircraft.
    BadInputError
        If the interpreter does not start or its environment lacks a library.
    """
    with scratch_folder("elsewhere") as scratch:
        job, out = scratch.path / "job.json", scratch.path / "out.npz"
        places = {
            "aircraft": aircraft.folder,
            "engine": aircraft.engine_path,
            "systems": aircraft.systems_path,
            "script": script,
        }
        # Engine files of this environment: otherwise a stock aircraft would fly other files there.
        document = {k: str(v) for k, v in places.items()} | {
            "channels": [asdict(c) for c in channels],
            "how": asdict(settings),
        }
        write_json(job, document)
        ended = run_module(__name__, job, out, timeout_s=TIMEOUT_S, python=python)
        if ended.answer.get("error"):
            # The child ran and reports an error of the aircraft.
            raise RefusedError(f"{python}: {ended.answer['error']}")
        if not out.is_file():
            message = ended.errors or ended.output or "no output"
            outcome = (
                "took too long" if ended.code is None else f"ended with {describe_exit(ended.code)}"
            )
            raise BadInputError(
                f"{python}: the flight {outcome}: {message}; an environment is needed that has"
                " JSBSim 1.3 and what uqharness needs (pip install uqharness, then pip install"
                " jsbsim==VERSION)"
            )
        with np.load(out) as archive:
            signals = dict(zip(archive["names"].tolist(), archive["columns"], strict=True))
            return signals, str(ended.answer.get("jsbsim", ""))


def _child(job: Path, out: Path) -> None:
    """Fly the job in this process and save the signals."""
    request = json.loads(job.read_text(encoding="utf-8"))
    channels = [
        Channel(**{**row, "source": Source(**row["source"])}) for row in request["channels"]
    ]
    try:
        aircraft = replace(
            find_aircraft(request["aircraft"]),
            engine_path=Path(request["engine"]),
            systems_path=Path(request["systems"]),
        )
        # The aircraft is found by folder; its engines and systems are those of the parent.
        signals = fly_frames(
            aircraft, Path(request["script"]), channels, FlightSettings(**request["how"])
        )
    except BadInputError as error:
        give_answer({"error": str(error)})
        return
    np.savez(out, names=np.array(list(signals)), columns=np.array(list(signals.values())))
    give_answer({"jsbsim": engine.JSBSIM_VERSION})


if __name__ == "__main__":
    # Imported again under its own name: a worker process cannot unpickle functions of __main__.
    from uqharness.differences import elsewhere

    elsewhere._child(Path(sys.argv[1]), Path(sys.argv[2]))
