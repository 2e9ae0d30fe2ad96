"""``uqharness next-flight``: the test flight that would narrow the most important interval.

The sensitivity of a campaign selects the coefficient, the mission's flight states weight its
interval, and `uqharness.next_flight` searches for test points. Exit code 1 means that no flight of
the allowed length is worth flying.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path

from sysid.model_form import ModelForm
from uqharness.campaign import Winner, find_winner
from uqharness.cli.options import (
    add_no_figures,
    add_out,
    add_seed,
    command_as_given,
    describe,
    integer,
    number,
)
from uqharness.cli.progress import print_warnings, working
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, results_folder, write_bytes, write_json
from uqharness.flight import COEFFICIENTS, TURBULENCE_W20_KT
from uqharness.identification import load_form
from uqharness.next_flight import (
    MIN_NARROWING,
    CampaignMission,
    Occupancy,
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
from uqharness.simulator import Aircraft

Callback = Callable[[str], None]
DOCUMENT, SCRIPT, TABLE = "next-flight.json", "next-flight.xml", "test-points.csv"

_EXAMPLE = """
  uqharness next-flight results --bounds bounds/model-form.json --out next
  uqharness next-flight results --metric altitude_median_m --minutes 3 --out next
  uqharness fly espaaro --script next/next-flight.xml --noise --seed 1 --out rehearsal.parquet
  uqharness next-flight results --redone both/model-form.json --out next

Writes DIR/next-flight.json, DIR/next-flight.xml (a run script), DIR/test-points.csv,
DIR/report.html and DIR/figures/next-flight.svg. With --redone nothing is planned: the bounds before
and after a flight are compared."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``next-flight``."""
    text = (
        "Plan the test flight that most narrows the interval of the coefficient to which the"
        " mission is most sensitive, in the flight states of the mission (see docs/next-flight.md)."
    )
    no = (
        "no flight of that length narrows the interval by 5 % in the mission's flight states; the"
        " text says what would"
    )
    describe(parser, _run, text, _EXAMPLE, no=no)
    parser.add_argument(
        "folder", type=Path, metavar="CAMPAIGN", help="folder of a finished corner campaign"
    )
    parser.add_argument(
        "--bounds",
        type=Path,
        metavar="MODEL-FORM.json",
        help="model-form.json of `uqharness bounds` (default: the bounds that the campaign flew)",
    )
    parser.add_argument(
        "--metric",
        metavar="NAME",
        help="metric, a column of the campaign's table (default cross_track_median_m)",
    )
    parser.add_argument(
        "--coefficient",
        choices=COEFFICIENTS,
        help="coefficient (default: the one to which the metric is most sensitive)",
    )
    parser.add_argument(
        "--minutes",
        type=number("--minutes", "a time in minutes", above=0.0, maximum=120.0),
        default=5.0,
        metavar="N",
        help="length of the flight at most, min (default 5)",
    )
    parser.add_argument(
        "--speeds",
        type=_speeds,
        default=(),
        metavar="V,V",
        help="true airspeeds of the test points, m/s (default: those of the mission)",
    )
    parser.add_argument(
        "--turbulence",
        choices=tuple(TURBULENCE_W20_KT),
        default="none",
        help="turbulence of the simulated test flight (default %(default)s)",
    )
    parser.add_argument(
        "--cases",
        type=integer("--cases", 1),
        default=6,
        metavar="N",
        help=(
            "campaign flights that are repeated to record the mission's flight states (default"
            " %(default)s)"
        ),
    )
    parser.add_argument(
        "--occupancy",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="flight records or logs of the mission, in place of campaign flights",
    )
    parser.add_argument(
        "--flight",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help=(
            "flights from which the bounds were made; searched for terms that the polynomial lacks"
        ),
    )
    parser.add_argument(
        "--redone",
        type=Path,
        metavar="MODEL-FORM.json",
        help=(
            "bounds that include the new flight: compares them with the old ones and plans nothing"
        ),
    )
    add_seed(parser, "the simulated flights", default=1)
    add_no_figures(parser)
    add_out(parser)


def _speeds(text: str) -> tuple[float, ...]:
    """Parse true airspeeds. Raises BadInputError."""
    try:
        speeds = tuple(float(v) for v in text.split(","))
    except ValueError:
        speeds = ()
    if not speeds or not all(math.isfinite(v) and v > 0.0 for v in speeds):
        raise BadInputError(f"--speeds {text}: true airspeeds in m/s are needed, such as 19,22,25")
    return speeds


def _run(args: argparse.Namespace) -> int:
    """Print the plan; return the exit code."""
    check_output_folder(args.out)
    with working("next-flight") as callback:
        text, code = _answer(args, callback)
    print(text)
    return code


def _answer(args: argparse.Namespace, callback: Callback) -> tuple[str, int]:
    """Return what is printed, and the exit code."""
    callback("sensitivity")
    winner = find_winner(args.folder, args.metric, args.coefficient)
    campaign = open_campaign(args.folder)
    path = args.bounds or bounds_of(campaign, args.folder, winner.coefficient)
    # The bounds must belong to the aircraft of the campaign and bound the coefficient.
    form = load_form(path)
    aircraft = aircraft_of(campaign)
    check_form(form, aircraft, winner.coefficient, str(path))
    callback("the mission's flight states")
    # Flight states of the mission weigh the interval.
    mission = (
        recorded_mission(args.occupancy, aircraft, form.filtering.cutoff_hz)
        if args.occupancy
        else fly_mission(campaign, args.cases)
    )
    if args.redone is not None:
        after = load_form(args.redone)
        check_form(after, aircraft, winner.coefficient, str(args.redone))
        return _compare_redone(args, form, after, mission, winner.coefficient)
    return _plan(args, form, path, aircraft, campaign, mission, winner=winner, callback=callback)


def _plan(
    args: argparse.Namespace,
    form: ModelForm,
    path: Path,
    aircraft: Aircraft,
    campaign: CampaignMission,
    mission: Occupancy,
    *,
    winner: Winner,
    callback: Callback,
) -> tuple[str, int]:
    """Plan a flight and write its files; return the text and the exit code."""
    flight = flight_of(campaign, aircraft, form, args.turbulence)
    plan = plan_flight(
        form,
        winner.coefficient,
        mission,
        flight,
        Options(args.minutes, args.speeds, args.seed),
        callback,
    )
    missing = None
    # Flights behind the bounds may show terms that the polynomial lacks.
    if args.flight:
        callback("missing terms")
        missing = missing_in(form, aircraft, winner.coefficient, args.flight)
    callback("report")
    units = {c: card.unit for c, card in aircraft.card.inputs.items()}
    air = {
        "aircraft": {"name": aircraft.name, "sha256": form.aircraft.sha256},
        "campaign": str(args.folder),
        "bounds": str(path),
        "simulated": {
            "turbulence": flight.turbulence,
            "sensor_noise": flight.noise,
            "autopilot": flight.has_autopilot,
        },
    }
    warnings = warnings_of(
        form, campaign, flight, args.bounds, args.flight, from_campaign=not args.occupancy
    )
    doc = document(plan, winner, mission, missing, air, units, warnings)
    out = results_folder(args.out)
    # The run script repeats the plan in simulation, as a rehearsal.
    points = [p.point for p in plan.plan]
    purpose = f"Flight for {plan.coefficient}"
    write_bytes(
        out / SCRIPT,
        script_text(
            flight.mission,
            aircraft,
            points,
            flight.begin_s,
            flight.has_autopilot,
            "next-flight",
            purpose,
        ),
    )
    write_bytes(out / TABLE, points_csv(plan, units))
    write_json(out / DOCUMENT, doc)
    figures = []
    if not args.no_figures:
        bounds = form.coefficients[plan.coefficient]
        mission_states = mission.of(bounds.states)
        figures = uncertainty_figures(
            bounds, plan.bounds_after, mission_states, plan.states, form.outside, plan.coefficient
        )
    page = next_flight_page(plan, doc, figures, command_as_given(args))
    report = write_page(out, page, page if figures else None)
    print_warnings(warnings)
    return json.dumps(doc) if args.json else report.text, 0 if plan.worth_flying else 1


def _compare_redone(
    args: argparse.Namespace,
    before: ModelForm,
    after: ModelForm,
    mission: Occupancy,
    coefficient: str,
) -> tuple[str, int]:
    """Compare the bounds before and after the new flight; return the text and the exit code."""
    rows = achieved(before, after, mission, args.out / DOCUMENT)
    text = (
        json.dumps({"coefficient": coefficient, "achieved": rows}) if args.json else as_text(rows)
    )
    narrowing = rows[coefficient]["narrowing"]
    return text, 0 if narrowing is not None and narrowing >= MIN_NARROWING else 1
