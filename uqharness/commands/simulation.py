"""Commands about simulated models: flights, trim and modes, margins, differences, the plugin.

Each function takes a request, writes what the request names, and returns an `Outcome`.
"""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sysid.errors import Finding
from sysid.logs import check_units
from sysid.model_form import ModelForm, read_model_form
from sysid.record import FlightRecord, Metadata
from sysid.vocabulary import SIGNALS
from uqharness.arguments import path as argument_path
from uqharness.campaign import read_bounds
from uqharness.commands.exchange import diff_models, is_model_file
from uqharness.commands.flights import Flight, aircraft_of, carded_aircraft, content_sha256
from uqharness.differences import (
    ROUNDING,
    Difference,
    MatchedFlight,
    MatchedRequest,
    Term,
    aircraft_at,
    by_channel,
    differences,
    differing_terms,
    fly_matched,
)
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, check_output_path, scratch_folder
from uqharness.flight import (
    CALM_LOITER,
    CALM_STRAIGHT,
    DIVERGENCE,
    LOOPS,
    MAX_SCATTER,
    Assessment,
    AutopilotGains,
    AutopilotSettings,
    FlightSpec,
    FlownItem,
    LoopMargins,
    WaypointMission,
    default_speeds,
    locus_point,
    measure_loop,
    read_gains,
    read_mission,
    recorded_flight,
    root_locus,
    seeded_spec,
    start_position,
    write_record,
)
from uqharness.heartbeat import Callback, counting, silent
from uqharness.identification import MadeBounds
from uqharness.isolation import run_unsupervised
from uqharness.plugin import (
    FILE_NAME,
    Instrumented,
    MassProperties,
    instrument_aircraft,
)
from uqharness.plugin import Bounds as PluginBounds
from uqharness.plugin import undo as undo_plugin
from uqharness.report import write_html
from uqharness.report.pages import (
    FlightFacts,
    Instrumentation,
    ModesFacts,
    difference_page,
    flight_page,
    instrument_page,
    margins_page,
    modes_page,
)
from uqharness.requests.base import command_line
from uqharness.requests.simulation import (
    DiffRequest,
    FlyRequest,
    InstrumentRequest,
    MarginsRequest,
    ModesRequest,
)
from uqharness.results.authoring import ModelDifference
from uqharness.results.base import Outcome
from uqharness.results.simulation import (
    AssessedLevel,
    ChannelDifference,
    ComparedFlight,
    Differences,
    DifferentElement,
    Eigenvalue,
    EigenvalueInterval,
    FlownFlight,
    GainsTaken,
    Margins,
    MarginsOfLoop,
    Modes,
    Plugin,
    PluginCheck,
    RemovedPlugin,
    UndoneFile,
)
from uqharness.simulator import (
    MODE_MEMBERS,
    SECOND_ORDER,
    Aircraft,
    Mode,
    ModeInterval,
    StagedMission,
    StartSection,
    SteadyCondition,
    Trim,
    content_hash,
    copy_folder,
    copy_shared_parts,
    engine,
    find_aircraft,
    find_folder,
    find_script,
    find_trim,
    linearise,
    mode_intervals,
    read_script,
    step_notes,
    with_fine_step,
    write_own_mission,
)
from uqharness.text_tables import text_table

_LOG = logging.getLogger("uqharness")
_MAX_ROWS = 12


# Flights.


def fly(request: FlyRequest, callback: Callback = silent) -> Outcome[Flight]:
    """Fly a run script once, and write the record and its page."""
    # Fail before the flight if nothing can be written.
    if request.out is not None:
        check_output_path(request.out)
    if request.page is not None:
        check_output_path(request.page, "--page")
    aircraft = (carded_aircraft if request.generated else aircraft_of)(request.aircraft)
    waypoints = None if request.waypoints is None else read_mission(request.waypoints)
    with _flown_script(request, aircraft) as (flight_aircraft, path):
        script = read_script(path)
        gains = _gains_of(request.autopilot, flight_aircraft, path)
        spec = FlightSpec(
            aircraft=flight_aircraft.source,
            script=script.path,
            duration_s=script.end_s if request.duration_s is None else request.duration_s,
            wind_mps=request.wind_mps,
            wind_from_deg=request.wind_from_deg,
            turbulence=request.turbulence,
            turbulence_source=request.turbulence_source,
            sensor_noise=request.noise,
            properties={**(gains.properties if gains else {}), **request.properties},
            record_rate_hz=request.rate_hz,
        )
        callback(f"flying {path.stem}")
        autopilot: AutopilotSettings | WaypointMission | None = None
        if waypoints is not None:
            autopilot = waypoints
        elif request.autopilot_process is not None:
            autopilot = AutopilotSettings(
                request.autopilot_process,
                request.autopilot_warmup_s,
                protocol=request.autopilot_protocol,
            )
        table, recorded = recorded_flight(
            flight_aircraft, script, seeded_spec(spec, request.seed), autopilot
        )
    columns = {str(name): table[name].to_numpy() for name in table.columns}
    start = start_position(recorded)
    left_out: tuple[str, ...] = ()
    if request.out is not None:
        # Without a card there are no units for the controls.
        if not aircraft.has_card:
            _LOG.info(
                "%s has no airframe.toml, so the record's commands are JSBSim's fcs/...-cmd-norm",
                aircraft.folder,
            )
        left_out = write_record(table, request.out, aircraft, start)
    if request.page is not None:
        facts = FlightFacts(
            aircraft.name,
            str(request.mission) if request.generated else path.stem,
            _conditions(request),
            "not written" if request.out is None else request.out.name,
            command_line(request),
        )
        write_html(request.page, flight_page(facts, columns, recorded.status, recorded.reason))
    document = FlownFlight.model_validate(
        {
            "status": recorded.status,
            "reason": recorded.reason,
            "flown_s": recorded.flown_s,
            "rows": len(table),
            "out": None if request.out is None else str(request.out),
            "left_out": left_out,
            "autopilot": _gains_document(gains),
            "mission_items": [asdict(item) for item in recorded.items],
        }
    )
    end = "" if recorded.status == "ok" else f", {recorded.status}: {recorded.reason}"
    unsupported = f"; DataFlash has no message for {', '.join(left_out)}" if left_out else ""
    place = "not written (no --out)" if request.out is None else request.out
    lines = [
        f"{place}: {len(table)} rows, {recorded.flown_s:.1f} s{end}{unsupported}",
        *_gains_lines(request.autopilot, gains),
        *_waypoint_lines(waypoints, recorded.items),
    ]
    # A flight in memory has the vocabulary's columns; the file has all.
    record = _checked_record({n: v for n, v in columns.items() if n in SIGNALS}, path.stem)
    flight = Flight(
        path.stem,
        record,
        content_sha256(record),
        recorded.status,
        recorded.reason,
        aircraft,
        start,
    )
    return Outcome(flight, document, lines, 0 if recorded.status == "ok" else 1, request.page)


@contextmanager
def _flown_script(request: FlyRequest, aircraft: Aircraft) -> Iterator[tuple[Aircraft, Path]]:
    """Context with the aircraft that flies and its run script.

    Initial conditions must lie in the aircraft's folder, so generated manoeuvres fly a copy.
    """
    if request.mission is None or request.speed_mps is None:
        mission_file = request.mission if request.waypoints is None else None
        yield aircraft, find_script(mission_file or request.script)
        return
    with scratch_folder("fly") as scratch:
        folder = scratch.path / "aircraft" / aircraft.copy_name
        copy_folder(aircraft.folder, folder)
        copy_shared_parts(aircraft, scratch.path, engine.default_root())
        copy = with_fine_step(find_aircraft(folder))
        start = StartSection(V_mps=request.speed_mps, altitude_m=request.altitude_m)
        # The mission restarts its second-order integrators at control steps, unless the user sets
        # others.
        restarting = not SECOND_ORDER.keys() & request.properties.keys()
        path, _ = run_unsupervised(
            write_own_mission, copy, start, str(request.mission), restarting=restarting
        )
        yield copy, path


def _checked_record(columns: Mapping[str, Any], source: str) -> FlightRecord:
    """Return a record with the findings about its units, which need a record."""

    def record(findings: Sequence[Finding] = ()) -> FlightRecord:
        metadata = Metadata(source=source, dialect="record", findings=tuple(findings))
        return FlightRecord(columns, metadata)

    return record(check_units(record()))


def _conditions(request: FlyRequest) -> str:
    """Describe air, noise and settings for the page."""
    wind = (
        f"Wind {request.wind_mps:g} m/s from {request.wind_from_deg:g} deg"
        if request.wind_mps
        else "No steady wind"
    )
    air = (
        f"turbulence {request.turbulence} ({request.turbulence_source})"
        if request.turbulence != "none"
        else "no turbulence"
    )
    noise = "with sensor noise" if request.noise else "without sensor noise"
    changed = f" Autopilot's gains: {request.autopilot.name}." if request.autopilot else ""
    settings = ", ".join(f"{name}={value:g}" for name, value in request.properties.items())
    changed += f" Set: {settings}." if settings else ""
    return f"{wind}, {air}, {noise}, seed {request.seed}.{changed}"


def _gains_of(path: Path | None, aircraft: Aircraft, script: Path) -> AutopilotGains | None:
    """Read the gains of a file for this aircraft; None without a file.

    Raises BadInputError with file and line.
    """
    return None if path is None else run_unsupervised(_read_gains, path, aircraft, script)


def _read_gains(path: Path, aircraft: Aircraft, script: Path) -> AutopilotGains:
    """Read the gains of a file for an aircraft, which is loaded."""
    with StagedMission(aircraft, script) as mission:
        return read_gains(path, set(engine.catalog(mission.open())))


def _gains_lines(path: Path | None, gains: AutopilotGains | None) -> list[str]:
    """Describe which gains were used, which were not, and why."""
    return [] if gains is None else [f"{path}:", *(f"  {line}" for line in gains.lines())]


def _waypoint_lines(mission: WaypointMission | None, items: Sequence[FlownItem]) -> list[str]:
    """Describe how the items of a mission were flown, and what is left out."""
    if mission is None:
        return []
    complete = sum(item.complete for item in items)
    lines = [f"{mission.path}: {complete} of {len(mission.items)} items complete"]
    for item in items:
        end = f"to {item.to_s:.1f} s" if item.complete else "not complete"
        lines.append(
            f"  item {item.number}, {item.kind}: from {item.from_s:.1f} s {end}, off the path"
            f" {item.cross_track_median_m:.1f} m (median), {item.cross_track_max_m:.1f} m (most)"
        )
    return [*lines, *(f"  note: {note}" for note in mission.notes)]


def _gains_document(gains: AutopilotGains | None) -> GainsTaken | None:
    """Return the gains of a parameter file."""
    if gains is None:
        return None
    return GainsTaken(taken=gains.properties, ignored=dict(gains.ignored), others=gains.n_others)


# Trim and modes.


def modes(request: ModesRequest, callback: Callback = silent) -> Outcome[Modes]:
    """Trim an aircraft, linearise it, name its modes, and write the page of the root locus."""
    if request.out is not None:
        check_output_path(request.out)
    # The wind blows towards the opposite of the direction it comes from.
    toward = math.radians(request.wind_from_deg + 180.0)
    aircraft = aircraft_of(request.aircraft)
    condition = SteadyCondition(
        request.speed_mps,
        request.altitude_m,
        math.radians(request.climb_deg),
        math.radians(request.bank_deg),
        math.radians(request.heading_deg),
        (request.wind_mps * math.cos(toward), request.wind_mps * math.sin(toward), 0.0),
    )
    trim = find_trim(aircraft, condition)
    # No trim is an answer, not an error.
    if not trim.converged:
        refused = Modes(trim=None, reason=trim.reason, modes=[])
        return Outcome(refused, refused, [f"no trim: {trim.reason}"], 1)
    linear = linearise(aircraft, trim)
    point = locus_point(linear, request.category, request.aircraft_class)
    form_path = request.model_form or aircraft.folder / "model-form.json"
    intervals: list[ModeInterval] = []
    form_note = ""
    if request.bounds and (request.model_form is not None or form_path.is_file()):
        form = read_bounds(form_path)
        intervals = mode_intervals(aircraft, linear, form)
        if form.aircraft.sha256 != content_hash(aircraft):
            form_note = ", made for another state of this aircraft"
    if request.out is not None:
        locus = root_locus(
            aircraft,
            condition,
            default_speeds(request.speed_mps, *(request.speeds or ())),
            request.category,
            request.aircraft_class,
            first=point,
            callback=counting("speeds trimmed", callback),
        )
        _, *trim_lines = [line.strip() for line in _trim_lines(aircraft.name, trim)]
        altitude = f"{condition.altitude_m:g} m above sea level"
        facts = [("Altitude", altitude), ("Attitude", trim_lines[0]), ("Controls", trim_lines[1])]
        facts += [("Velocity" if "ground" in line else "Path", line) for line in trim_lines[2:]]
        page_facts = ModesFacts(
            aircraft.name,
            request.category,
            request.aircraft_class,
            tuple(facts),
            command_line(request),
        )
        write_html(request.out, modes_page(page_facts, point, locus))
    document = Modes(
        trim=_trim_numbers(aircraft, trim),
        modes=[
            Eigenvalue(
                name=m.name,
                real=m.real,
                imag=m.imag,
                wn_radps=m.wn_radps,
                zeta=m.zeta,
                interval=None
                if interval is None
                else EigenvalueInterval.model_validate(asdict(interval)),
            )
            for m, interval in itertools.zip_longest(point.modes, intervals)
        ],
        levels=[AssessedLevel(**asdict(level)) for level in point.levels],
        bounds=str(form_path) if intervals else "",
        notes=step_notes(point.modes, aircraft.dt_s),
    )
    lines = _modes_lines(aircraft.name, trim, point.modes, point.levels)
    if intervals:
        lines += ["", *_interval_lines(point.modes, intervals, f"{form_path}{form_note}")]
    lines += [f"  note: {note}" for note in document.notes]
    return Outcome(document, document, lines, report=request.out)


def _trim_numbers(aircraft: Aircraft, trim: Trim) -> dict[str, float | None]:
    """Return the numbers of a trim by their keys in the document."""
    controls: dict[str, float | None] = {
        f"{name}_{aircraft.card.inputs[name].unit}": value for name, value in trim.controls.items()
    }
    # A normalised command has no angle; the surface position may have one.
    controls.setdefault("elevator_deg", trim.positions_deg.get("elevator"))
    if "throttle_norm" in controls:
        controls["throttle_pct"] = 100.0 * trim.controls["throttle"]
    controls.setdefault("throttle_pct", None)
    north, east, down = trim.velocity_ned_mps
    return {
        "V_mps": trim.condition.V_mps,
        "alpha_deg": math.degrees(trim.alpha_rad),
        "beta_deg": math.degrees(trim.beta_rad),
        "theta_deg": math.degrees(trim.theta_rad),
        "climb_deg": math.degrees(trim.condition.climb_rad),
        "turn_rate_degps": math.degrees(trim.turn_rate_radps),
        **controls,
        "v_north_mps": north,
        "v_east_mps": east,
        "v_down_mps": down,
        "thrust_N": trim.thrust_N,
        "rpm": trim.rpm,
    }


def measured_text(assessment: Assessment) -> str:
    """Describe a criterion's value; a mode without time to double amplitude is stable."""
    if math.isinf(assessment.value):
        return "stable"
    if math.isnan(assessment.value):
        return f"{assessment.criterion} undefined"
    unit = "" if assessment.unit == "1" else assessment.unit
    return f"{assessment.criterion} {assessment.value:.3g} {unit}".rstrip()


def _trim_lines(name: str, trim: Trim) -> list[str]:
    """Return the lines that describe a trim."""
    north, east, down = trim.velocity_ned_mps
    attitude = (
        f"  alpha {math.degrees(trim.alpha_rad):8.3f} deg   beta {math.degrees(trim.beta_rad):8.3f}"
        f" deg   pitch {math.degrees(trim.theta_rad):8.3f} deg   turn"
        f" {math.degrees(trim.turn_rate_radps):.3f} deg/s"
    )
    climb = math.degrees(trim.condition.climb_rad)
    return [
        (
            f"{name}, {trim.condition.V_mps:g} m/s true airspeed, {trim.condition.altitude_m:g} m"
            " above sea level"
        ),
        attitude,
        "  "
        + "   ".join(f"{key} {value:.3f}" for key, value in trim.controls.items())
        + (f"   thrust {trim.thrust_N:.3f} N" if math.isfinite(trim.thrust_N) else "")
        + (f"   {trim.rpm:.0f} rpm" if math.isfinite(trim.rpm) else ""),
        *([f"  flight-path angle {climb:.3f} deg"] if climb else []),
        f"  ground velocity: north {north:.3f}, east {east:.3f}, down {down:.3f} m/s",
    ]


def _modes_lines(
    name: str, trim: Trim, all_modes: Sequence[Mode], levels: Sequence[Assessment]
) -> list[str]:
    """Return trim, modes and levels as a table."""
    lines = [
        *_trim_lines(name, trim),
        "",
        (
            f"  {'mode':<14}{'real, 1/s':>11}{'imag, 1/s':>11}{'wn, rad/s':>11}{'zeta':>9}  "
            " MIL-F-8785C"
        ),
    ]
    listed: set[str] = set()
    for mode in all_modes:
        remarks = [
            f"Level {a.level}{' (worse than 3)' if a.level == 4 else ''} {measured_text(a)}"
            for a in levels
            if a.mode == mode.name and _belongs(a, mode, first=mode.name not in listed)
        ]
        listed.add(mode.name)
        lines.append(
            f"  {mode.name:<14}{mode.real:>11.4f}{mode.imag:>11.4f}{mode.wn_radps:>11.4f}"
            f"{mode.zeta:>9.3f}   {'; '.join(remarks)}".rstrip()
        )
    return lines


def _interval_lines(
    all_modes: Sequence[Mode], intervals: Sequence[ModeInterval], form: str
) -> list[str]:
    """Return the intervals of the modes as a table."""
    lines = [
        f"  over {MODE_MEMBERS} members of {form}:",
        (
            f"  {'mode':<14}{'real, 1/s':>20}{'wn, rad/s':>18}{'zeta':>18}"
            f"{'like this':>11}{'unstable':>10}"
        ),
    ]
    for mode, one in zip(all_modes, intervals, strict=True):
        real, wn, zeta = (
            f"{low:.3g} to {high:.3g}" if math.isfinite(low) else "-"
            for low, high in (one.real, one.wn_radps, one.zeta)
        )
        lines.append(
            f"  {mode.name:<14}{real:>20}{wn:>18}{zeta:>18}{one.share:>11.0%}{one.unstable:>10.0%}"
        )
    return lines


def _belongs(assessment: Assessment, mode: Mode, first: bool) -> bool:
    """Check whether a criterion is printed in a mode's row: a divergence at its root,
    others once.
    """
    if assessment.paragraph != DIVERGENCE:
        return first
    return mode.real > 0.0 and math.isclose(assessment.value, math.log(2.0) / mode.real)


# Margins.


def margins(request: MarginsRequest, callback: Callback = silent) -> Outcome[Margins]:
    """Measure the margins of the autopilot's loops, and write their charts."""
    if request.out is not None:
        check_output_path(request.out)
    aircraft, script = aircraft_of(request.aircraft), find_script(request.script)
    gains = _gains_of(request.autopilot, aircraft, script)
    # Gains of a parameter file replace those of the aircraft.
    condition = {
        **(CALM_LOITER if request.flight == "loiter" else CALM_STRAIGHT),
        **(gains.properties if gains else {}),
    }
    names: Sequence[str] = request.loop or tuple(LOOPS)
    update = counting("loops measured", callback)
    measured: list[LoopMargins] = []
    with StagedMission(aircraft, script) as mission:
        # Each measurement needs separate instances, at the same condition.
        def make_fdm() -> Any:
            fdm = mission.open()
            needed = [name for loop in LOOPS.values() for name in loop.properties]
            engine.require(fdm, [*condition, *needed])
            return fdm

        def on_progress(share: float) -> None:
            update(len(measured) + share, len(names))

        try:
            for name in names:
                measured.append(
                    measure_loop(
                        make_fdm, LOOPS[name], condition=condition, on_progress=on_progress
                    )
                )
        except ValueError as error:
            raise BadInputError(f"margins of {aircraft.name}: {error}") from None
    if request.out is not None:
        page = margins_page(aircraft.name, request.flight, measured, command_line(request))
        write_html(request.out, page)
    document = Margins(
        flight=request.flight,
        loops={item.loop: _loop_document(item) for item in measured},
        autopilot=_gains_document(gains),
    )
    lines = [
        *_margins_lines(aircraft.name, request.flight, measured),
        *_gains_lines(request.autopilot, gains),
    ]
    return Outcome(document, document, lines, report=request.out)


def _loop_document(item: LoopMargins) -> MarginsOfLoop:
    """Return the margins of one loop."""
    m = item.margins
    return MarginsOfLoop(
        gain_up_dB=m.gain_up_dB,
        gain_down_dB=m.gain_down_dB,
        phase_deg=m.phase_deg,
        delay_s=m.delay_s,
        modulus=m.modulus,
        gain_crossovers_radps=list(m.gain_crossovers_radps),
        phase_crossovers_radps=list(m.phase_crossovers_radps),
        not_read_radps=[float(w) for w in item.frequency_radps[~item.reliable]],
    )


def _margins_lines(name: str, flight: str, measured: Sequence[LoopMargins]) -> list[str]:
    """Return the table of margins."""

    def show(value: float, digits: int = 1) -> str:
        return f"{value:.{digits}f}" if math.isfinite(value) else "none"

    head = (
        f"  {'loop':<10}{'gain up, dB':>12}{'gain down, dB':>15}{'phase, deg':>12}"
        f"{'delay, ms':>11}{'min |1+L|':>11}"
    )
    lines = [
        (
            f"Stability margins of {name}'s autopilot ({flight}, calm air). Each loop is opened at"
            " its controller's output."
        ),
        f"{head}   gain crossover, rad/s",
    ]
    # One row a loop: margins, and where the gain crosses 1.
    for item in measured:
        m = item.margins
        crossover = ", ".join(f"{w:.2f}" for w in m.gain_crossovers_radps) or "none"
        lines.append(
            f"  {item.loop:<10}{show(m.gain_up_dB):>12}{show(m.gain_down_dB):>15}"
            f"{show(m.phase_deg):>12}{show(1000 * m.delay_s, 0):>11}{m.modulus:>11.2f}"
            f"   {crossover}"
        )
    for item in measured:
        # Frequencies at which the loop is not linear enough to be read.
        unread = item.frequency_radps[~item.reliable]
        if unread.size:
            lines.append(
                f"  {item.loop}: {unread.size} of {item.reliable.size} frequencies,"
                f" {unread.min():.2g} to {unread.max():.2g} rad/s, are not used: the loop's"
                f" response there differs by more than {100 * MAX_SCATTER:.0f} % between the two"
                " signs of the injection"
            )
    return lines


# Differences.


def diff(
    request: DiffRequest, callback: Callback = silent
) -> Outcome[Differences] | Outcome[ModelDifference]:
    """Fly two models in the same conditions, list their differences, and write their page.

    Model files of other programs are compared by their coefficients.
    """
    # Models of other programs have no flights; their coefficients are compared.
    if is_model_file(request.a) or is_model_file(request.b):
        callback("coefficients of both models")
        return diff_models(request.a, request.b, next(iter(request.speed_mps), None))
    if request.out is not None:
        check_output_path(request.out)
    texts = [
        str(model.folder if isinstance(model, Aircraft) else model)
        for model in (request.a, request.b)
    ]
    # Both models fly the same manoeuvres, scripts and air.
    matched = MatchedRequest(
        speeds_mps=request.speed_mps,
        altitude_m=request.altitude_m,
        scripts=tuple(find_script(script) for script in request.script),
        turbulence=request.turbulence,
        seed=request.seed,
        properties=request.properties,
        python_b=request.python_b,
        repeats=request.repeats,
        bounds=request.bounds,
    )
    with scratch_folder("revisions") as scratch:
        a, b = (
            aircraft_at(text, scratch.path / side) for side, text in zip("ab", texts, strict=True)
        )
        # XML that differs ranks the likely causes.
        terms = differing_terms(a.folder, b.folder)
        channels, flights = fly_matched(a, b, matched, counting("flights compared", callback))
    # Differences within rounding are none.
    tolerance = ROUNDING if request.tolerance is None else request.tolerance
    all_differences = differences(channels, flights, terms, tolerance)
    first = by_channel(all_differences)
    if request.out is not None:
        page = difference_page(
            (texts[0], texts[1]), channels, flights, first, terms, command_line(request)
        )
        write_html(request.out, page)
    # A flight that only one model can fly is a difference too.
    differ = bool(first) or any(f.reason or f.only_a or f.only_b for f in flights)
    document = Differences(
        a=texts[0],
        b=texts[1],
        differ=differ,
        tolerance=tolerance,
        flights=[
            ComparedFlight(
                name=f.name,
                frames=len(f.time_s),
                reason=f.reason or None,
                only_a=list(f.only_a),
                only_b=list(f.only_b),
                jsbsim_b=f.jsbsim_b or None,
            )
            for f in flights
        ],
        differences=[
            ChannelDifference(
                channel=d.channel,
                unit=d.unit,
                group=d.group,
                flight=d.flight,
                from_s=d.from_s,
                largest=d.size,
                at_s=d.at_s,
                share_of_range=d.share,
                times_benign=d.times,
                a=d.a,
                b=d.b,
                likeliest=[_where(t) for t in d.terms[:3]],
            )
            for d in all_differences
        ],
        terms=[
            DifferentElement(
                path=t.path,
                a=t.a or None,
                b=t.b or None,
                a_where=t.a_where or None,
                b_where=t.b_where or None,
            )
            for t in terms
        ],
    )
    lines = _difference_lines(flights, first, terms, differ)
    return Outcome(document, document, lines, 1 if differ else 0, request.out)


def _difference_lines(
    flights: Sequence[MatchedFlight],
    first: Sequence[Difference],
    terms: Sequence[Term],
    differ: bool,
) -> list[str]:
    """Return the differences as text, the likeliest cause first."""
    flown_s = sum(float(f.time_s[-1]) for f in flights if len(f.time_s))
    flight_summary = f"{len(flights)} flights, {flown_s:.0f} s"
    beyond_benign = " beyond what A varies by itself" if any(f.varied for f in flights) else ""
    # Nothing differs, in flight or in the XML.
    if not differ and not terms:
        return [
            f"The models do not differ{beyond_benign} ({flight_summary}; the XML says the same)."
        ]
    # The XML differs in what these flights do not show.
    if not differ:
        return [
            (
                f"No output differs{beyond_benign} ({flight_summary}), but {len(terms)} elements of"
                " the XML do: these flights do not show them."
            ),
            *_term_lines(terms),
        ]
    lines = []
    # The earliest difference is closest to the cause.
    if first:
        d = first[0]
        cause = f"; likeliest cause {_where(d.terms[0])}" if d.terms else ""
        lines.append(
            f"The models differ in {len(first)} channels, first in {d.channel} at {d.from_s:g} s of"
            f" {d.flight}{cause}."
        )
    # Flights that ended early or have properties of one model alone.
    for f in flights:
        if f.reason:
            lines.append(f"{f.name}: {f.reason}")
        for side, names in (("A", f.only_a), ("B", f.only_b)):
            if names:
                lines.append(f"{f.name}: only {side} has {', '.join(names)}")
    # Largest differences, in the order in which they begin.
    rows = [
        {
            "Channel": x.channel,
            "Flight": x.flight,
            "From [s]": f"{x.from_s:g}",
            "Largest difference": f"{x.size:.3g} {x.unit}".removesuffix(" -"),
            "Share of range [%]": f"{100 * x.share:.2g}",
        }
        for x in first[:_MAX_ROWS]
    ]
    lines += text_table(rows) if rows else []
    if len(first) > _MAX_ROWS:
        lines.append(f"and {len(first) - _MAX_ROWS} more (--json lists all)")
    # Elements that may explain the first difference; all without one.
    if terms:
        lines.append(f"XML that differs ({len(terms)}):")
        lines += _term_lines(first[0].terms if first else terms)
    return lines


def _term_lines(terms: Sequence[Term]) -> list[str]:
    """Return the lines of differing XML elements."""
    lines = [
        f"  {_where(t)}: {t.path}: {t.a or 'nothing'} -> {t.b or 'nothing'}"
        for t in terms[:_MAX_ROWS]
    ]
    more = len(terms) - _MAX_ROWS
    return [*lines, f"  and {more} more"] if more > 0 else lines


def _where(term: Term) -> str:
    """Return file and line of a differing element."""
    return f"B {term.b_where}" if term.b_where else f"A {term.a_where}"


# The plugin.


def instrument(
    request: InstrumentRequest, callback: Callback = silent
) -> Outcome[Instrumented | None]:
    """Add the plugin to a copy of an aircraft and write the page of its bounds, or undo it."""
    if request.undo:
        return _undo(request)
    if request.page is not None:
        check_output_path(request.page, "--page")
    aircraft = aircraft_of(request.aircraft)
    check_output_folder(request.out)
    form = request.form
    if isinstance(form, MadeBounds):
        form = form.form
    elif form is not None and not isinstance(form, ModelForm):
        form = read_model_form(argument_path("form", form))
    constant = {str(name): ends for name, ends in (request.constant or {}).items()}
    bounds = PluginBounds(form, constant)
    # A dry run writes nothing that could be flown.
    flies_check = request.check and not request.dry_run
    callback("comparing short flights with the original" if flies_check else "writing")
    done = instrument_aircraft(
        aircraft,
        bounds,
        request.out,
        air=request.air,
        check=request.check,
        dry_run=request.dry_run,
        mass=MassProperties(**request.mass_properties()),
    )
    document = _plugin_document(aircraft, done, request)
    if request.page is not None:
        check = None
        if document.check is not None:
            check = (document.check.status == "works", _check_sentence(document.check))
        facts = Instrumentation(
            aircraft.name, done.planned.rows, tuple(done.notes), check, command_line(request)
        )
        write_html(request.page, instrument_page(facts, bounds.form, bounds.constant))
    is_wrong = done.verdict is not None and done.verdict.status == "wrong"
    code = 1 if is_wrong or done.unmeasured else 0
    return Outcome(done, document, _plugin_lines(document), code, request.page)


def _undo(request: InstrumentRequest) -> Outcome[Instrumented | None]:
    """Remove the plugin."""
    is_copy = (request.out / FILE_NAME).is_file()
    folder = request.out if is_copy else find_folder(request.aircraft)
    undone = [
        UndoneFile(file=name, result=result) for name, result in undo_plugin(folder, request.out)
    ]
    return Outcome(None, RemovedPlugin(undone=undone), [f"{u.file}: {u.result}" for u in undone])


def _plugin_document(aircraft: Aircraft, done: Instrumented, request: InstrumentRequest) -> Plugin:
    """Return what was done."""
    planned, files = done.planned, []
    for name, change in sorted(planned.changes.items()):
        # Edited files keep their own text but for the insertions.
        n_lines = (
            sum(i.text.count(b"\n") for i in change.insertions)
            if change.edited
            else planned.files[name].count(b"\n")
        )
        kind = "edited" if change.edited else "replaced" if change.before else "added"
        files.append({"file": name, "change": kind, "lines": n_lines})
    document = {
        "aircraft": aircraft.name,
        "out": str(request.out),
        "written": not request.dry_run,
        "axes": {"force": planned.section.force, "moment": planned.section.moment},
        "coefficients": [
            dict(zip(("coefficient", "axis", "where"), row, strict=True)) for row in planned.rows
        ],
        "scaled": [asdict(row) for row in planned.scaled],
        "files": files,
        "unmeasured": dict(done.unmeasured),
        "notes": list(done.notes),
    }
    # Without check flights there is no such key.
    if done.verdict is not None:
        document["check"] = asdict(done.verdict)
    return Plugin.model_validate(document)


def _plugin_lines(done: Plugin) -> list[str]:
    """Return what was done as text, the check first."""
    # What was made, and whether its check passed.
    state = "has" if done.written else "would have"
    lines = [
        (
            f"{done.aircraft}: the copy in {done.out} {state} bounded increments of"
            f" {len(done.coefficients)} coefficients."
        )
    ]
    lines += [] if done.written else ["Nothing was written (--dry-run)."]
    if done.check is not None:
        lines.append(f"Check: {_check_sentence(done.check)}")
    lines.append(
        f"The aircraft's forces are in {done.axes.force} axes, its moments in {done.axes.moment}"
        " axes."
    )
    lines += [f"note: {note}" for note in done.notes]
    # Details, of which a terminal shows the first lines.
    tables = (
        (
            "Increments, and where the XML adds them.",
            [
                {"Coefficient": c.coefficient, "Added to axes": c.axis, "At": Path(c.where).name}
                for c in done.coefficients
            ],
        ),
        (
            "Files of the copy that differ from the original.",
            [
                {"File": f.file, "Change": f.change, "Lines of the change": str(f.lines)}
                for f in done.files
            ],
        ),
        (
            "Scale factors that identify can estimate, one per function of the aircraft's XML.",
            [
                {"Property": s.scale, "Axis": s.axis, "Function at": f"{s.file}:{s.line}"}
                for s in done.scaled
            ],
        ),
    )
    for title, rows in tables:
        lines += [title, *text_table(rows)] if rows else []
    return lines


def _check_sentence(check: PluginCheck) -> str:
    """Describe the result of the check flights."""
    if check.status == "works":
        worst = math.nan if check.worst is None else check.worst
        return (
            f"{check.properties} properties are bit-identical to the original with uq/active 0;"
            f" relative errors of force and moment increments: at most {worst:.0e}."
        )
    outcome = "WRONG" if check.status == "wrong" else "not made, because the original fails"
    return f"{outcome}: {check.reason}."
