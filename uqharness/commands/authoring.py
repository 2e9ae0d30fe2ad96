"""Commands ``author`` and ``performance``."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from uqharness.authoring import (
    Entry,
    Equipment,
    MassProperties,
    Source,
    Sources,
    SteadyFlight,
    build,
    centre_slips,
    design_speed,
    find_slips,
    gyration,
    mass_slips,
    priors,
    read_contacts,
    read_sources,
    static_margin,
    write_aircraft,
)
from uqharness.authoring.performance import performance as compute_performance
from uqharness.commands.flights import carded_aircraft
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, results_folder
from uqharness.heartbeat import Callback, silent
from uqharness.requests.authoring import AuthorRequest, PerformanceRequest
from uqharness.results.authoring import (
    Authored,
    AuthoredTerm,
    Performance,
    PerformanceFigure,
    SlipFound,
    SpeedRow,
)
from uqharness.results.base import Outcome
from uqharness.text_tables import text_table


def author(request: AuthorRequest, callback: Callback = silent) -> Outcome[Authored]:
    """Read the sources, look for slips, and write the aircraft."""
    check_output_folder(request.out)
    callback("reading")
    options = {
        key: value
        for key, value in (
            ("S", request.area_m2),
            ("b", request.span_m),
            ("c", request.chord_m),
        )
        if value is not None
    }
    # Slips are looked for in the sources, before the model hides them.
    sources = read_sources(request.sources, request.length_unit_m, options)
    controls = _controls(request.controls)
    slips = find_slips(sources, controls)
    mass, notes = _mass_properties(request, sources)
    if request.mass_kg is not None:
        stated = Entry(request.mass_kg, Path("--mass-kg"))
        slips += mass_slips(sources.derivatives, stated, _stated_inertia(request))
    try:
        model = build(
            sources.derivatives,
            mass,
            name=request.name or "",
            profile_drag=request.cd0,
            controls=controls,
        )
    except BadInputError as error:
        # A geometry that nothing here can run may have slips too.
        slip_heading = "; usual slips in the files: " if slips else ""
        raise BadInputError(f"{error}{slip_heading}{'; '.join(map(str, slips))}") from None
    if request.cg_x_m is not None:
        slips += centre_slips(Entry(request.cg_x_m, Path("--cg-x-m")), model)
    model = replace(model, notes=(*model.notes, *notes))
    # An aircraft with a slip would fly, wrongly: it is written on request only.
    refused = bool(slips) and not request.accept_slips
    flight = SteadyFlight(design_speed(model), 200.0)
    by_term = priors(model)
    if not refused:
        callback("writing")
        equipment = Equipment(
            throw_deg=request.throw_deg,
            thrust_N=request.thrust_n,
            pitch_speed_mps=request.pitch_speed_mps,
            contacts=read_contacts(request.contacts),
        )
        _, flight = write_aircraft(
            results_folder(request.out), model, sources.derivatives.path, equipment
        )
    # The document lists each term with its prior, written or not.
    margin = static_margin(model)
    document = Authored(
        aircraft=None if refused else str(request.out),
        tool=model.tool,
        reference={
            "S_m2": model.S,
            "b_m": model.b,
            "c_m": model.c,
            "mass_kg": model.mass.mass_kg,
        },
        static_margin=model.static_margin,
        static_margin_mean=margin.mean,
        static_margin_std=margin.std,
        speed_mps=flight.speed_mps,
        terms={
            f"aero/{key}": AuthoredTerm(
                value=value.value,
                mean=by_term[key].mean,
                std=by_term[key].std,
                unit=value.unit,
                class_name=by_term[key].class_name,
            )
            for key, value in model.terms.items()
        },
        mixing=dict(model.mixing),
        slips=[
            SlipFound(kind=s.kind, place=s.place, message=s.message, effect=s.effect) for s in slips
        ],
        notes=list(model.notes),
    )
    lines = _lines(document, refused)
    if flight.reason:
        lines.insert(-1, f"No steady flight was found for campaign.toml: {flight.reason}")
    if flight.no_hold:
        lines.insert(-1, f"campaign.toml flies with fixed controls: {flight.no_hold}")
    return Outcome(document, document, lines, code=int(refused))


def _mass_properties(request: AuthorRequest, sources: Sources) -> tuple[MassProperties, list[str]]:
    """Return mass, centre of gravity and inertia of options, .mass file or assumptions."""
    notes = []
    source, masses = sources.derivatives, sources.masses
    # Mass: option, then source, then .mass file.
    mass_kg = request.mass_kg
    if mass_kg is None and "mass_kg" in source.facts:
        mass_kg = source.facts["mass_kg"].value
    if masses is None and mass_kg is None:
        raise BadInputError("no mass: give --mass-kg, or AVL's .mass file with the other files")
    cg = (request.cg_x_m, request.cg_y_m, request.cg_z_m)
    stated_centre = _xyz(source)
    # A .mass file has everything; another mass scales its inertia.
    if masses is not None:
        total = masses.mass_kg.value if mass_kg is None else mass_kg
        tensor = masses.inertia_kgm2 * (total / masses.mass_kg.value)
        properties = MassProperties(
            total,
            masses.centre_m,
            float(tensor[0, 0]),
            float(tensor[1, 1]),
            float(tensor[2, 2]),
            float(-tensor[0, 2]),
            masses.path.name,
        )
        # OpenVSP's mass file may count from another origin than its aerodynamics.
        x = masses.centre_m[0]
        if (
            source.tool == "VSPAERO"
            and cg[0] is None
            and abs(stated_centre[0] - x) > 0.1 * source.length("c")
        ):
            notes.append(
                f"centre of gravity from Xcg of {source.path.name}, {stated_centre[0]:.4g} m:"
                f" {masses.path.name} counts from another origin ({x:.4g} m)"
            )
            properties = replace(properties, centre_m=stated_centre)
    else:
        # Without one the centre is the source's and the inertia is assumed.
        assert mass_kg is not None
        if "x_cg" in source.facts:
            stated_centre = (source.facts["x_cg"].value, *stated_centre[1:])
        elif cg[0] is None:
            notes.append("the centre of gravity is at the moment centre (--cg-x-m moves it)")
        properties = gyration(mass_kg, source.length("b"), stated_centre)
        printed = [source.facts[key].value for key in ("Ixx", "Iyy", "Izz") if key in source.facts]
        if len(printed) == 3 and min(printed) > 0.0:
            xx, yy, zz = (value * mass_kg / source.facts["mass_kg"].value for value in printed)
            properties = replace(properties, Ixx=xx, Iyy=yy, Izz=zz, source=source.path.name)
        elif request.ixx_kgm2 is None:
            notes.append("inertia from radii of gyration of light aeroplanes (--ixx-kgm2 ...)")
    # Options replace single values, and the origin says so.
    options = (request.ixx_kgm2, request.iyy_kgm2, request.izz_kgm2, request.ixz_kgm2)
    count = sum(value is not None for value in options)
    x, y, z = (
        old if new is None else new for old, new in zip(properties.centre_m, cg, strict=True)
    )
    origin = properties.source
    properties = MassProperties(
        properties.mass_kg,
        (x, y, z),
        properties.Ixx if request.ixx_kgm2 is None else request.ixx_kgm2,
        properties.Iyy if request.iyy_kgm2 is None else request.iyy_kgm2,
        properties.Izz if request.izz_kgm2 is None else request.izz_kgm2,
        properties.Ixz if request.ixz_kgm2 is None else request.ixz_kgm2,
        origin if not count else "options" if count == 4 else f"options and {origin}",
    )
    if min(properties.Ixx, properties.Iyy, properties.Izz) <= 0.0:
        raise BadInputError(
            f"inertia Ixx {properties.Ixx:g}, Iyy {properties.Iyy:g}, Izz {properties.Izz:g} kg m2:"
            " above 0 is needed; give --ixx-kgm2, --iyy-kgm2, --izz-kgm2"
        )
    return properties, notes


def _stated_inertia(request: AuthorRequest) -> list[Entry]:
    """Return the moments of inertia of the options, none unless all three are given."""
    moments = (("x", request.ixx_kgm2), ("y", request.iyy_kgm2), ("z", request.izz_kgm2))
    entries = [
        Entry(value, Path(f"--i{axis}{axis}-kgm2")) for axis, value in moments if value is not None
    ]
    return entries if len(entries) == len(moments) else []


def _xyz(source: Source) -> tuple[float, float, float]:
    """Return the moment centre [m]; 0 where the file has none."""
    x, y, z = (source.reference[key].value if key in source.reference else 0.0 for key in "xyz")
    return x, y, z


def _controls(texts: tuple[str, ...]) -> dict[str, dict[str, float]] | None:
    """Return the weights of C=SURFACES texts, None without any."""
    out: dict[str, dict[str, float]] = {}
    for text in texts:
        control, _, terms = text.partition("=")
        weights = {
            name: (-1.0 if sign == "-" else 1.0) * (float(factor[:-1]) if factor else 1.0)
            for sign, factor, name in re.findall(r"([+-]?)(\d*\.?\d+\*)?([A-Za-z_]\w*)", terms)
        }
        if not weights:
            raise BadInputError(
                f"--control {text[:40]!r}: C=SURFACES is needed, such as elevator=LEFT+RIGHT or"
                " aileron=-RIGHT+LEFT"
            )
        out[control] = weights
    return out or None


def _lines(document: Authored, refused: bool) -> list[str]:
    """Return what the command prints."""
    lines = []
    if document.slips:
        lines.append(
            f"usual slips in the files: {len(document.slips)}"
            + ("; nothing is written (--accept-slips writes it all the same):" if refused else ":")
        )
        lines += [f"  {s.place}: {s.kind}: {s.message}. {s.effect}." for s in document.slips]
    if not refused:
        reference = document.reference
        lines += [
            (
                f"Written: {document.aircraft}, from {document.tool}; S {reference['S_m2']:.4g} m2,"
                f" b {reference['b_m']:.4g} m, c {reference['c_m']:.4g} m,"
                f" {reference['mass_kg']:.4g} kg"
            ),
            (
                f"static margin {100 * (document.static_margin or 0):.3g} % of the chord, prior"
                f" {100 * (document.static_margin_mean or 0):.3g} %, std"
                f" {100 * (document.static_margin_std or 0):.3g} %"
                + (
                    ": unstable in pitch, the centre of gravity is behind the neutral point"
                    " (--cg-x-m moves it)"
                    if (document.static_margin or 0) < 0
                    else ""
                )
            ),
            *(f"1 degree of {c} is {mix}" for c, mix in document.mixing.items()),
            *(f"Assumed: {note}" for note in document.notes),
            (
                f"next: uqharness modes {document.aircraft} --speed-mps {document.speed_mps:.3g},"
                f" uqharness campaign run {document.aircraft}/campaign.toml --out DIR"
            ),
        ]
    return lines


def performance(request: PerformanceRequest, callback: Callback = silent) -> Outcome[Performance]:
    """Compute the performance sheet of an aircraft."""
    aircraft = carded_aircraft(request.aircraft)
    callback("polar")
    result = compute_performance(
        aircraft, request.altitude_m, request.stall_alpha_deg, request.bounds
    )
    figures = {
        name: PerformanceFigure(
            value=value,
            interval=list(result.intervals[name]),
            unit=result.units[name],
            reason=result.nominal.reasons.get(name, ""),
        )
        for name, value in result.nominal.figures.items()
    }
    document = Performance(
        aircraft=aircraft.name,
        altitude_m=request.altitude_m,
        mass_kg=result.source.reference.mass_kg,
        figures=figures,
        speeds=[SpeedRow(**row) for row in result.nominal.rows],
        bounds=f"corners of CX, CZ and Cm of {aircraft.name}" if result.has_bounds else "",
        notes=list(result.notes),
    )
    rows = []
    for name, figure in figures.items():
        low, high = figure.interval
        rows.append(
            {
                "figure": name.replace("_", " "),
                "value": "" if figure.value is None else f"{figure.value:.4g}",
                "unit": figure.unit,
                "interval": "" if low is None or high is None else f"{low:.4g} to {high:.4g}",
                "reason": figure.reason,
            }
        )
    lines = [
        f"{aircraft.name}, {document.mass_kg:.4g} kg, {request.altitude_m:g} m above sea level",
        *text_table(rows),
        *(f"Assumed: {note}" for note in document.notes),
        *([] if document.bounds else ["No bounds: no intervals (uqharness instrument adds them)."]),
    ]
    return Outcome(document, document, lines)
