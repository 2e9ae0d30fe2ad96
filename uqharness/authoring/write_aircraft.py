"""Write an authored model as an aircraft folder: XML, card, systems, prior.

The XML is a template (`templates/aircraft.xml.j2`) that looks as a person would write it: unit,
source and prior beside each number. The card has the same numbers as parameters
that `identify` can free.
"""

from __future__ import annotations

import importlib.resources
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2

from sysid.aerodynamics import COEFFICIENTS
from sysid.units import G0_MPS2, SEA_LEVEL_KGPM3
from uqharness.authoring.line_hold import IDLE_XML, LINE_HOLD_SYSTEM, line_hold_xml
from uqharness.authoring.model import TERMS, AeroModel
from uqharness.authoring.prior import Prior, prior_document, prior_form, priors
from uqharness.errors import BadInputError
from uqharness.files import write_bytes, write_text
from uqharness.plugin import AIR_FILE, ERRORS_SYSTEM, ERRORS_XML, Bounds, bounds_xml
from uqharness.simulator import (
    MEMS_NOISE_STD,
    Aircraft,
    SteadyCondition,
    content_hash,
    find_aircraft,
    find_trim,
)
from uqharness.toml import as_toml
from uqharness.xml import in_comment

_TITLES = {
    "CX": "Axial force",
    "CY": "Side force",
    "CZ": "Normal force",
    "Cl": "Rolling moment",
    "Cm": "Pitching moment",
    "Cn": "Yawing moment",
}
_VARIABLES = {
    "0": "",
    "alpha": "aero/alpha-rad",
    "alpha2": "aero/alpha-rad",
    "beta": "aero/beta-rad",
    "p": "aero/p_hat",
    "q": "aero/q_hat",
    "r": "aero/r_hat",
    "de": "fcs/elevator-pos-deg",
    "da": "fcs/aileron-pos-deg",
    "dr": "fcs/rudder-pos-deg",
    "df": "fcs/flap-pos-deg",
    "gear": "fcs/gear-down-norm",
}
_POSITIVE = {"elevator": "nose down", "aileron": "right wing down", "rudder": "nose left"}


@dataclass(frozen=True)
class Contact:
    """A wheel or a point of the airframe that touches the ground: x aft, y right, z up [m]."""

    name: str
    x: float
    y: float
    z: float


@dataclass(frozen=True)
class Equipment:
    """What a source of derivatives does not hold.

    Attributes
    ----------
    throw_deg : float
        Deflection of each surface at full command.
    thrust_N : float or None
        Static thrust at full throttle; None for half the weight.
    pitch_speed_mps : float or None
        Speed at which thrust falls to zero; None for 2.5 times the speed of the source's lift.
    contacts : sequence of Contact
        Ground contacts.
    """

    throw_deg: float = 25.0
    thrust_N: float | None = None
    pitch_speed_mps: float | None = None
    contacts: Sequence[Contact] = ()


def design_speed(model: AeroModel) -> float:
    """Return the speed [m/s] at which the source's middle point carries the weight at sea level.

    At a lift coefficient below 0.25 or above 0.8 it is that of 0.4, which most aeroplanes cruise
    near.
    """
    alpha = model.alpha
    lift = -model.coefficient("CZ", alpha) * math.cos(alpha)
    lift += model.coefficient("CX", alpha) * math.sin(alpha)
    if not 0.25 <= lift <= 0.8:
        lift = 0.4
    weight = model.mass.mass_kg * G0_MPS2
    return math.sqrt(2.0 * weight / (SEA_LEVEL_KGPM3 * model.S * lift))


@dataclass(frozen=True)
class SteadyFlight:
    """Flight of the campaign.

    Attributes
    ----------
    speed_mps, altitude_m : float
        True airspeed and height.
    reason : str
        Why it is no trim; empty where it is one.
    no_hold : str
        Why the aircraft has no line hold; empty where it has one.
    is_glide : bool
        Whether it descends without thrust, so that it is to be short.
    """

    speed_mps: float
    altitude_m: float
    reason: str = ""
    no_hold: str = ""
    is_glide: bool = False


_TURBULENCE_TOP_M = 304.0
_OTHER_LIFTS = (0.5, 0.3, 0.7, 0.2, 0.9)
"""Lift coefficients tried in turn where the source's has no trim."""


def steady_flight(aircraft: Aircraft, model: AeroModel) -> SteadyFlight:
    """Return a level flight of the written aircraft, near the speed of the source's lift.

    A tailless or overloaded aircraft may have no trim at that speed but at another. The height
    leaves room below, within the 304.8 m (1000 ft) of the turbulence model, where glides begin.
    """
    first = design_speed(model)
    weight = model.mass.mass_kg * G0_MPS2
    speeds = [math.sqrt(2.0 * weight / (SEA_LEVEL_KGPM3 * model.S * k)) for k in _OTHER_LIFTS]
    flights = []
    for speed in (first, *speeds):
        rounded = float(f"{speed:.3g}")
        altitude = 200.0 if rounded < 25.0 else 300.0
        trim = find_trim(aircraft, SteadyCondition(rounded, altitude))
        glide = trim.converged and trim.condition.climb_rad < 0.0
        altitude = _TURBULENCE_TOP_M if glide else altitude
        reason = "" if trim.converged else trim.reason
        flights.append(SteadyFlight(rounded, altitude, reason, is_glide=glide))
        if trim.converged:
            return flights[-1]
    return flights[0]


def safe_name(text: str) -> str:
    """Return a name that a folder, an XML file and a property can have.

    >>> safe_name(" Ultra Stick / 25e ")
    'ultra-stick-25e'
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:60] or "aircraft"


def write_aircraft(
    folder: Path, model: AeroModel, source: Path, equipment: Equipment
) -> tuple[Aircraft, SteadyFlight]:
    """Write the folder of an aircraft.

    Parameters
    ----------
    folder : Path
        Exists.
    model : AeroModel
        What `build` returns.
    source : Path
        Named in the comments.
    equipment : Equipment
        Throws, thrust, contacts.

    Returns
    -------
    Aircraft
        Of the folder.
    SteadyFlight
        Of its campaign.
    """
    # Titles such as "****" make no name.
    has_letters = re.search("[A-Za-z0-9]", model.name) is not None
    model = replace(model, name=safe_name(model.name if has_letters else source.stem))
    by_term = priors(model)
    speed = design_speed(model)
    xml = _xml(model, by_term, source, equipment, speed)
    write_text(folder / f"{model.name}.xml", xml)
    card = folder / "airframe.toml"
    write_text(card, _card(model, by_term, source, equipment, hold=False))
    systems = folder / "Systems"
    systems.mkdir(exist_ok=True)
    write_bytes(systems / "air.xml", AIR_FILE.read_bytes())
    write_bytes(systems / f"{ERRORS_SYSTEM}.xml", ERRORS_XML)
    # The bounds depend on the aircraft's controls, so the aircraft is read before its bounds are.
    hold = systems / f"{LINE_HOLD_SYSTEM}.xml"
    write_bytes(hold, IDLE_XML)
    aircraft = _with_bounds(folder, model, by_term, speed)
    flight = steady_flight(aircraft, model)
    # The gains follow from the flight condition's linear model, so the aircraft is trimmed before.
    if not flight.reason:
        trim = find_trim(aircraft, SteadyCondition(flight.speed_mps, flight.altitude_m))
        try:
            write_bytes(hold, line_hold_xml(aircraft, trim))
        except BadInputError as error:
            flight = replace(flight, no_hold=str(error))
        else:
            write_text(card, _card(model, by_term, source, equipment, hold=True))
        aircraft = find_aircraft(folder)
    write_text(folder / "campaign.toml", _campaign(flight))
    form = prior_form(model, by_term, speed, content_hash(aircraft))
    write_text(folder / "model-form.json", prior_document(form, model, by_term))
    return aircraft, flight


def _campaign(flight: SteadyFlight) -> str:
    """Return a campaign of steady flight over the corners of the prior."""
    is_held = not (flight.reason or flight.no_hold)
    way = "on the line hold" if is_held else "with fixed controls"
    lines = [
        f"# Steady flight {way} over the bounds of the prior, before any flight.",
        "",
        "[campaign]",
        'aircraft = "."',
        'mission = "steady"',
        "seed = 1",
        "",
        "[start]",
        f"V_mps = {flight.speed_mps:.3g}",
        f"altitude_m = {flight.altitude_m:g}",
        *(["autopilot = true             # false: the trimmed controls stay fixed"] * is_held),
        "",
        "[aleatory]",
        "flights = 4                  # per corner",
        f"duration_s = {(20 if flight.is_glide else 60) if is_held else 5}",
        f"burn_in_s = {(10 if flight.is_glide else 20) if is_held else 0}",
        'turbulence = "light"',
        "",
        "[epistemic]",
        'method = "corners"',
        'set = "ellipsoid"            # joint 95 %; the corners of a "box" are beyond that',
        'bounds = "model-form.json"',
        'coefficients = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]',
        "interior = 0",
        "",
    ]
    return "\n".join(lines)


def _with_bounds(
    folder: Path, model: AeroModel, by_term: Mapping[str, Prior], speed: float
) -> Aircraft:
    """Write Systems/model-form.xml; return the aircraft."""
    path = folder / "Systems" / "model-form.xml"
    write_bytes(path, (AIR_FILE.parent / "model-form.xml").read_bytes())
    form = prior_form(model, by_term, speed, "")
    write_bytes(path, bounds_xml(find_aircraft(folder), Bounds(form=form)))
    return find_aircraft(folder)


def _xml(
    model: AeroModel,
    by_term: Mapping[str, Prior],
    source: Path,
    equipment: Equipment,
    speed: float,
) -> str:
    """Return the aircraft's XML."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read_template),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    # Terms with a prior, in the order of the build-up.
    coefficients = []
    for name in COEFFICIENTS:
        terms = []
        for term in TERMS[name]:
            key = f"{name}_{term}"
            value = model.terms[key]
            prior = by_term[key]
            remark = f"{value.unit:7s} {value.source}; prior {prior.mean:.4g}, std {prior.std:.3g}"
            terms.append(
                {
                    "name": key,
                    "value": f"{value.value:.8g}",
                    "variable": _VARIABLES[term],
                    "power": 2 if term == "alpha2" else 1,
                    "table": key in model.tables,
                    "remark": in_comment(remark),
                }
            )
        # Flaps, gear and the like, for which no prior is known.
        extra = [key for key in model.increments if key.startswith(f"{name}_")]
        for key in extra:
            value, short = model.increments[key], key.partition("_")[2]
            terms.append(
                {
                    "name": key,
                    "value": f"{value.value:.8g}",
                    "variable": _VARIABLES[short],
                    "power": 1,
                    "table": False,
                    "remark": in_comment(f"{value.unit:7s} {value.source}; no prior"),
                }
            )
        # The comment above each coefficient is the formula that the XML computes.
        products = " + ".join(
            f"{name}_{t}" if t == "0" else f"{name}_{t} {t.replace('alpha2', 'alpha^2')}"
            for t in (*TERMS[name], *(key.partition("_")[2] for key in extra))
        )
        title = f"{_TITLES[name]} {name} = {products}"
        coefficients.append({"name": name, "title": title, "terms": terms})
    # Tables hold differences from the linear term, so that the term keeps its value.
    tables = [
        {
            "name": key,
            "remark": f"{key}: the source over alpha [rad], less the value above",
            "rows": [(f"{a:.8g}", f"{v:.8g}") for a, v in zip(alphas, values, strict=True)],
        }
        for key, (alphas, values) in model.tables.items()
    ]
    weight = model.mass.mass_kg * G0_MPS2
    assumed = [
        *(["static thrust"] if equipment.thrust_N is None else []),
        *(["pitch speed"] if equipment.pitch_speed_mps is None else []),
    ]
    spring = weight / 3.0 / 0.02
    return environment.get_template("aircraft.xml.j2").render(
        name=model.name,
        source=in_comment(source.name),
        tool=in_comment(model.tool),
        mixing={key: in_comment(text) for key, text in model.mixing.items()},
        notes=[in_comment(note) for note in model.notes],
        flaps="CZ_df" in model.increments,
        gear="CX_gear" in model.increments,
        ground=[]
        if model.ground is None
        else [(f"{h:.8g}", f"{k:.8g}") for h, k in zip(*model.ground, strict=True)],
        alphas_deg=", ".join(f"{math.degrees(a):.3g}" for a in model.alphas),
        S=f"{model.S:.8g}",
        b=f"{model.b:.8g}",
        c=f"{model.c:.8g}",
        cg=[f"{v:.8g}" for v in model.mass.centre_m],
        mass={
            "mass_kg": f"{model.mass.mass_kg:.8g}",
            "source": in_comment(model.mass.source),
            **{key: f"{getattr(model.mass, key):.8g}" for key in ("Ixx", "Iyy", "Izz", "Ixz")},
        },
        contacts=[
            {
                "type": "BOGEY",
                "name": in_comment(contact.name),
                "x": f"{contact.x:.6g}",
                "y": f"{contact.y:.6g}",
                "z": f"{contact.z:.6g}",
                "spring": f"{spring:.4g}",
                "damping": f"{0.7 * math.sqrt(spring * model.mass.mass_kg / 3.0):.4g}",
                "steer": "0",
            }
            for contact in equipment.contacts
        ],
        thrust_N=f"{weight / 2.0 if equipment.thrust_N is None else equipment.thrust_N:.6g}",
        pitch_speed=f"{equipment.pitch_speed_mps or 2.5 * speed:.6g}",
        thrust_source=f"Assumed: {', '.join(assumed)}." if assumed else "From options.",
        throw_deg=f"{equipment.throw_deg:g}",
        coefficients=coefficients,
        tables=tables,
    )


def _read_template(name: str) -> str:
    """Return the text of a template."""
    folder = importlib.resources.files("uqharness.authoring") / "templates"
    return (folder / name).read_text("utf-8")


def _card(
    model: AeroModel,
    by_term: Mapping[str, Prior],
    source: Path,
    equipment: Equipment,
    *,
    hold: bool,
) -> str:
    """Return airframe.toml; ``hold`` says whether the aircraft has a line hold."""
    throw = equipment.throw_deg
    remark = as_toml(f"{model.name}, authored from {source.name}")[1:-1]
    lines = [
        f"# What XML cannot say of {remark}: controls, sensors, parameters.",
        "",
        "[aircraft]",
        f"name = {as_toml(model.name)}",
        f"xml = {as_toml(f'{model.name}.xml')}",
        "dt_s = 0.01",
        "",
        "[reference]                                   # the XML's metrics",
        f"S_m2 = {float(f'{model.S:.8g}')!r}",
        f"b_m = {float(f'{model.b:.8g}')!r}",
        f"c_m = {float(f'{model.c:.8g}')!r}",
    ]
    for control, positive in _POSITIVE.items():
        lines += [
            "",
            f"[inputs.{control}]",
            f'property = "fcs/{control}-cmd-deg"',
            f'selected = "fcs/{control}-selected-deg"',
            f'position = "fcs/{control}-pos-deg"',
            'unit = "deg"',
            f'positive = "{positive}"',
            f"limits = [{-throw:g}, {throw:g}]",
            (
                f"servo_pwm = [[1100, {-throw:g}], [1500, 0], [1900, {throw:g}]]"
                "     # assumed: your log's, if it has others"
            ),
        ]
    lines += [
        "",
        "[inputs.throttle]",
        'property = "fcs/throttle-cmd-pct"',
        'selected = "fcs/throttle-selected-pct"',
        'position = "fcs/throttle-pos-pct"',
        'unit = "pct"',
        'positive = "more thrust"',
        "limits = [0, 100]",
        "servo_pwm = [[1000, 0], [2000, 100]]",
        "",
        "[modes]",
        'open_loop = { "ap/engaged" = 0, "ap/input-norm" = 0 }',
        *(['autopilot = { "ap/engaged" = 1 }              # Systems/line-hold.xml'] * hold),
        "",
        "[replay]                                      # without effect in still air",
        f'without_systems = ["air", "{ERRORS_SYSTEM}", "{LINE_HOLD_SYSTEM}"]',
        "",
        "[outputs]",
        'thrust_N = "propulsion/thrust-N"',
        "",
        "[metrics]                                     # from the line the flight began on",
        'cross_track = { true = "nav/cross-track-m" }',
        'altitude = { true = "nav/altitude-error-m" }',
        'speed = { true = "nav/speed-error-mps" }',
        'distance_3d = { true = "nav/distance-3d-m" }',
        "",
        "[sensors]",
        "position_m = { accelerometer = [0, 0, 0] }",
        "",
        "[sensors.noise_std]                            # assumed: small MEMS units; SI",
        *(f"{name} = {std!r}" for name, std in MEMS_NOISE_STD.items()),
        "",
        (
            "# initial: the source's; bounds: 6 prior standard deviations, to catch a slip, not to"
            " steer an estimate."
        ),
        "[parameters]",
    ]
    for key, value in model.terms.items():
        prior = by_term[key]
        width = max(6.0 * prior.std, 1e-6)
        row: dict[str, Any] = {
            "initial": float(f"{value.value:.8g}"),
            "bounds": [float(f"{prior.mean + s * width:.4g}") for s in (-1.0, 1.0)],
            "unit": value.unit,
            "source": value.source,
        }
        text = ", ".join(f"{k} = {as_toml(v)}" for k, v in row.items())
        lines.append(f'"aero/{key}" = {{ {text} }}')
    return "\n".join(lines) + "\n"


def read_contacts(texts: Sequence[str]) -> list[Contact]:
    """Return contacts from NAME=X:Y:Z texts; BadInputError with the text that cannot be read."""
    out = []
    for text in texts:
        name, _, numbers = text.partition("=")
        try:
            x, y, z = (float(word) for word in numbers.split(":"))
        except ValueError:
            raise BadInputError(
                f"contact {text[:40]!r}: NAME=X:Y:Z with x aft, y right, z up in m is needed"
            ) from None
        out.append(Contact(name, x, y, z))
    return out
