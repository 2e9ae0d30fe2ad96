"""Command next-flight: the test flight that would narrow the most important interval.

The sensitivity of a campaign selects the coefficient, the mission's flight states weight its
interval, and `uqharness.next_flight` searches for test points.
"""

from __future__ import annotations

from uqharness.campaign import find_winner
from uqharness.files import check_output_folder, results_folder, write_bytes, write_json
from uqharness.heartbeat import Callback, silent
from uqharness.identification import load_form
from uqharness.next_flight import (
    MIN_NARROWING,
    Options,
    achieved,
    aircraft_of,
    as_text,
    bounds_of,
    check_form,
    flight_of,
    fly_mission,
    missing_in,
    open_campaign,
    plan_flight,
    recorded_mission,
    script_text,
    warnings_of,
)
from uqharness.report import document, points_csv, write_page
from uqharness.report.pages import next_flight_page, uncertainty_figures
from uqharness.requests.base import command_line
from uqharness.requests.next_flight import NextFlightRequest
from uqharness.results.base import Outcome
from uqharness.results.next_flight import (
    AchievedNarrowing,
    NextFlightPlan,
    PlannedAircraft,
    SimulatedFlight,
)

DOCUMENT, SCRIPT, TABLE = "next-flight.json", "next-flight.xml", "test-points.csv"


def next_flight(
    request: NextFlightRequest, callback: Callback = silent
) -> Outcome[NextFlightPlan | AchievedNarrowing]:
    """Plan a test flight and write its files, or compare the bounds before and after it."""
    check_output_folder(request.out)
    callback("sensitivity")
    winner = find_winner(request.folder, request.metric, request.coefficient)
    coefficient = winner.coefficient
    campaign = open_campaign(request.folder)
    path = request.bounds or bounds_of(campaign, request.folder, coefficient)
    # The bounds must belong to the aircraft of the campaign and bound the coefficient.
    form = load_form(path)
    aircraft = aircraft_of(campaign)
    check_form(form, aircraft, coefficient, str(path))
    callback("the mission's flight states")
    # Flight states of the mission weigh the interval.
    mission = (
        recorded_mission(request.occupancy, aircraft, form.filtering.cutoff_hz)
        if request.occupancy
        else fly_mission(campaign, request.cases)
    )
    if request.redone is not None:
        after = load_form(request.redone)
        check_form(after, aircraft, coefficient, str(request.redone))
        rows = achieved(form, after, mission, request.out / DOCUMENT)
        narrowing = rows[coefficient].narrowing
        code = 0 if narrowing is not None and narrowing >= MIN_NARROWING else 1
        comparison = AchievedNarrowing(coefficient=coefficient, achieved=rows)
        return Outcome(comparison, comparison, [as_text(rows)], code)
    flight = flight_of(campaign, aircraft, form, request.turbulence)
    options = Options(request.minutes, request.speeds, request.seed)
    plan = plan_flight(form, coefficient, mission, flight, options, callback)
    missing = None
    # Flights behind the bounds may show terms that the polynomial lacks.
    if request.flights:
        callback("missing terms")
        missing = missing_in(form, aircraft, coefficient, request.flights)
    callback("report")
    units = {c: card.unit for c, card in aircraft.card.inputs.items()}
    origin = {
        "aircraft": PlannedAircraft(name=aircraft.name, sha256=form.aircraft.sha256),
        "campaign": str(request.folder),
        "bounds": str(path),
        "simulated": SimulatedFlight(
            turbulence=flight.turbulence,
            sensor_noise=flight.noise,
            autopilot=flight.has_autopilot,
        ),
    }
    warnings = warnings_of(
        form,
        campaign,
        flight,
        request.bounds,
        request.flights,
        from_campaign=not request.occupancy,
    )
    doc = document(plan, winner, mission, missing, origin, units, warnings=warnings)
    out = results_folder(request.out)
    # The run script repeats the plan in simulation, as a rehearsal.
    script = script_text(
        flight.mission,
        aircraft,
        [p.point for p in plan.plan],
        flight.begin_s,
        flight.has_autopilot,
        "next-flight",
        purpose=f"Flight for {plan.coefficient}",
    )
    write_bytes(out / SCRIPT, script)
    write_bytes(out / TABLE, points_csv(plan, units))
    write_json(out / DOCUMENT, doc.as_json())
    figures = []
    if request.figures:
        bounds = form.coefficients[plan.coefficient]
        mission_states = mission.of(bounds.states)
        figures = uncertainty_figures(
            bounds, plan.bounds_after, mission_states, plan.states, form.outside, plan.coefficient
        )
    page = next_flight_page(plan, doc, figures, command_line(request))
    report = write_page(out, page, page if figures else None)
    code = 0 if plan.worth_flying else 1
    return Outcome(doc, doc, [report.text], code, report.path, warnings)
