"""``uqharness next-flight``: where more flight data would narrow the interval that matters most, and what to fly for it."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqharness.cli.reporting import command_as_given, show_stage
from uqharness.errors import BadInputError
from uqharness.files import check_folder, inner_folder
from uqharness.flight.spec import COEFFICIENTS, TURBULENCE_W20_KT

if TYPE_CHECKING:
    from sysid.model_form.missing_terms import MissingTerm
    from sysid.model_form.model_form import ModelForm
    from uqharness.next_flight.mission_states import CampaignMission, Occupancy
    from uqharness.next_flight.trials import TestFlight
    from uqharness.simulator.aircraft import Aircraft

DOCUMENT, SCRIPT, TABLE = "next-flight.json", "next-flight.xml", "test-points.csv"
_EXAMPLE = """examples:
  uqharness next-flight results --bounds bounds/model-form.json --out next
  uqharness next-flight results --bounds bounds/model-form.json --metric altitude_median_m --minutes 3 --turbulence light --out next
  uqharness fly espaaro --script next/next-flight.xml --noise --seed 1 --out rehearsal.parquet
  uqharness next-flight results --bounds bounds/model-form.json --redone both/model-form.json --out next

DIR/next-flight.json, DIR/next-flight.xml (a run script), DIR/test-points.csv, DIR/report.md and DIR/figures/next-flight.svg.
With --redone nothing is planned: it tells what a flight has brought, from the bounds before and after it.
Exit code 1: no flight of that length narrows the interval by 5 % where the mission flies; the words say what would."""
_BURN_IN_S = 120.0
_ON_AUTOPILOT_S = 4.0


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``next-flight`` to a parser."""
    parser = commands.add_parser(
        "next-flight",
        help="what to fly to reduce the uncertainty that matters",
        description="From a campaign's sensitivity to the test flight that narrows the winning coefficient's interval most "
        "where the mission flies (see docs/next-flight.md).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="CAMPAIGN", help="folder of a finished corner campaign")
    parser.add_argument(
        "--bounds",
        type=Path,
        metavar="MODEL-FORM.json",
        help="what `uqharness bounds` wrote (default: what the campaign flew)",
    )
    parser.add_argument("--metric", metavar="NAME", help="of the campaign's table (default cross_track_median_m)")
    parser.add_argument("--coefficient", choices=COEFFICIENTS, help="instead of the one that the metric depends on most")
    parser.add_argument("--minutes", type=float, default=5.0, metavar="N", help="length of the flight at most (default 5)")
    parser.add_argument("--speeds", metavar="V,V", help="true airspeeds of the test points, m/s (default: where the mission flies)")
    parser.add_argument(
        "--turbulence",
        choices=tuple(TURBULENCE_W20_KT),
        default="none",
        help="air in which the flight is simulated (default none)",
    )
    parser.add_argument(
        "--cases", type=int, default=6, metavar="N", help="flights of the campaign that tell where it flies (default 6)"
    )
    parser.add_argument(
        "--occupancy",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="flight records or logs of the mission instead of the campaign's flights",
    )
    parser.add_argument(
        "--flight",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="the flights behind the bounds: is what scatters a term that their polynomial lacks?",
    )
    parser.add_argument(
        "--redone",
        type=Path,
        metavar="MODEL-FORM.json",
        help="bounds made again with the flight's data: what it brought",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the simulated flights (default 1)")
    parser.add_argument("--no-figures", action="store_true", help="leave out the figure")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results, made if need be")
    parser.add_argument("--json", action="store_true", help="print next-flight.json")
    parser.set_defaults(handler=_run, parser=parser)


def _run(args: argparse.Namespace) -> int:
    speeds = _check(args)
    from uqharness.campaign.sensitivity_winner import find_winner
    from uqharness.identification.validation import load_form
    from uqharness.next_flight.mission_states import fly_mission, open_campaign, recorded_mission
    from uqharness.next_flight.plan import check_form

    show_stage("sensitivity")
    winner = find_winner(args.folder, args.metric, args.coefficient)
    campaign = open_campaign(args.folder)
    path = _bounds_of(args, campaign, winner.coefficient)
    form = load_form(path)
    aircraft = _aircraft_of(campaign)
    check_form(form, aircraft, winner.coefficient, str(path))
    show_stage("where the mission flies")
    mission = (
        recorded_mission(args.occupancy, aircraft, form.filtering.cutoff_hz)
        if args.occupancy
        else fly_mission(campaign, args.cases)
    )
    if args.redone is not None:
        after = load_form(args.redone)
        check_form(after, aircraft, winner.coefficient, str(args.redone))
        return _redone(args, form, after, mission, winner.coefficient)
    return _plan(args, form, path, aircraft, campaign, mission, winner, speeds)


def _check(args: argparse.Namespace) -> tuple[float, ...]:
    """The speeds. Raises BadInputError for what no flight could follow from."""
    if not (math.isfinite(args.minutes) and 0.0 < args.minutes <= 120.0):
        raise BadInputError(f"--minutes {args.minutes:g}: above 0 and up to 120")
    if args.cases < 1:
        raise BadInputError(f"--cases {args.cases}: at least 1")
    if args.seed < 0:
        raise BadInputError(f"--seed {args.seed}: must not be negative")
    check_folder(args.out)
    if args.speeds is None:
        return ()
    try:
        speeds = tuple(float(v) for v in args.speeds.split(","))
    except ValueError:
        speeds = ()
    if not speeds or not all(math.isfinite(v) and v > 0.0 for v in speeds):
        raise BadInputError(f"--speeds {args.speeds}: true airspeeds in m/s are needed, such as 19,22,25")
    return speeds


def _bounds_of(args: argparse.Namespace, campaign: CampaignMission, coefficient: str) -> Path:
    """--bounds, else the campaign's own model form. Raises BadInputError for constant bounds, saying what to do."""
    if args.bounds is not None:
        return Path(args.bounds)
    if campaign.spec.inputs.model_form is not None:
        return campaign.spec.inputs.model_form
    if not _constant(campaign):
        raise BadInputError(
            f"{args.folder}: flew the bounds that the aircraft carries; give the model-form.json that they were made from with "
            "--bounds (constant ones tell nothing of where data are lacking)"
        )
    raise BadInputError(
        f"{args.folder}: flew constant bounds of {coefficient}, which depend on no flight state: nothing says where data are "
        "lacking. Make bounds from flights (uqharness bounds AIRCRAFT --flight FILE --out DIR) and give them with "
        "--bounds DIR/model-form.json"
    )


def _constant(campaign: CampaignMission) -> bool:
    """Whether the campaign file gave its bounds as numbers."""
    return isinstance(campaign.spec.epistemic.bounds, dict)


def _aircraft_of(campaign: CampaignMission) -> Aircraft:
    """What is flown: the author's aircraft, but for a trimmed start, whose initial conditions lie in the campaign's copy."""
    from uqharness.simulator.aircraft import find_aircraft

    own = campaign.spec.start is not None or campaign.mission.source == Path()
    return find_aircraft(campaign.mission.aircraft if own else campaign.mission.source)


def _plan(
    args: argparse.Namespace, form: ModelForm, path: Path, aircraft: Aircraft, campaign: CampaignMission, mission: Occupancy,
    winner: Any, speeds: tuple[float, ...],
) -> int:  # fmt: skip
    from uqharness.cli.identify import results_folder
    from uqharness.files import write_bytes
    from uqharness.next_flight.plan import Options, plan_flight
    from uqharness.next_flight.script import script_text
    from uqharness.report.identify import markdown_table, write_text
    from uqharness.report.next_flight import document, point_rows, points_csv, report, where_rows

    flight = _test_flight(args, aircraft, campaign, form)
    found = plan_flight(form, winner.coefficient, mission, flight, Options(args.minutes, speeds, args.seed), show_stage)
    missing = _missing(args, form, aircraft, winner.coefficient)
    show_stage("")
    units = {c: card.unit for c, card in aircraft.card.inputs.items()}
    air = {
        "aircraft": {"name": aircraft.name, "sha256": form.aircraft.sha256},
        "campaign": str(args.folder), "bounds": str(path),
        "simulated": {"turbulence": flight.turbulence, "sensor_noise": flight.noise, "autopilot": flight.has_autopilot},
    }  # fmt: skip
    doc = document(found, winner, mission, missing, air, units, _warnings(form, aircraft, campaign, mission, flight, args))
    out = results_folder(args.out)
    points = [p.point for p in found.plan]
    purpose = f"Flight for {found.coefficient}"
    write_bytes(
        out / SCRIPT,
        script_text(flight.mission, aircraft, points, flight.begin_s, flight.has_autopilot, "next-flight", purpose),
    )
    write_bytes(out / TABLE, points_csv(found, units))
    write_bytes(out / DOCUMENT, (json.dumps(doc, indent=1) + "\n").encode())
    write_text(
        out / "report.md",
        report(
            found,
            doc,
            markdown_table(point_rows(found)),
            markdown_table(where_rows(found)),
            command_as_given(args),
            not args.no_figures,
        ),
    )
    if not args.no_figures:
        from uqharness.report.plots.next_flight import next_flight_figure

        bounds = form.coefficients[found.coefficient]
        title = f"{found.coefficient} of {aircraft.name}: what not knowing it costs where the mission flies"
        next_flight_figure(
            found.coefficient, bounds, found.bounds_then, mission.of(bounds.states), found.states, form.outside,
            inner_folder(out, "figures") / "next-flight.svg", title,
        )  # fmt: skip
    for text in doc["warnings"]:
        print(f"uqharness: warning: {text}", file=sys.stderr)
    print(json.dumps(doc) if args.json else _text(found, doc, out))
    return 0 if found.worth_flying else 1


def _test_flight(args: argparse.Namespace, aircraft: Aircraft, campaign: CampaignMission, form: ModelForm) -> TestFlight:
    from uqharness.next_flight.trials import TestFlight, has_autopilot, has_noise

    held = campaign.spec.start is None and has_autopilot(aircraft)
    begin_s = _ON_AUTOPILOT_S if held else min(float(campaign.spec.aleatory.burn_in_s), _BURN_IN_S)
    steps = max(1, round(1.0 / (min(form.filtering.rate_hz, 60.0) * aircraft.dt_s)))
    return TestFlight(
        aircraft,
        campaign.mission.script,
        held,
        begin_s,
        args.turbulence,
        has_noise(aircraft),
        1.0 / (steps * aircraft.dt_s),
        campaign.spec.aleatory.turbulence_source,
    )


def _missing(args: argparse.Namespace, form: ModelForm, aircraft: Aircraft, coefficient: str) -> list[MissingTerm] | None:
    """Terms that the flights of --flight show to be missing; None where none were given. Raises BadInputError."""
    if not args.flight:
        return None
    from sysid.aerodynamics.residuals import Cutoffs, together
    from sysid.model_form.missing_terms import missing_terms
    from uqharness.next_flight.trials import residuals_of

    show_stage("missing terms")
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    residuals = together(residuals_of(aircraft, args.flight, cutoffs))
    try:
        return missing_terms(residuals, coefficient, form.coefficients[coefficient])
    except ValueError as error:
        raise BadInputError(f"--flight: {error}") from None


def _warnings(
    form: ModelForm,
    aircraft: Aircraft,
    campaign: CampaignMission,
    mission: Occupancy,
    flight: TestFlight,
    args: argparse.Namespace,
) -> list[str]:
    from uqharness.replay.flights import file_hash
    from uqharness.simulator.aircraft import content_hash

    out = []
    if form.aircraft.sha256 != content_hash(aircraft) and campaign.spec.start is None:
        out.append(f"aircraft '{aircraft.name}' has changed since the bounds were made: they belong to the model as it was")
    if not campaign.same_aircraft:
        out.append(
            "the campaign was made by uqharness 0.1: whether its aircraft is as it was cannot be told, nor whether its table is"
        )
    if campaign.spec.inputs.model_form is None:
        kind = "constant ones" if _constant(campaign) else "perhaps: those that the aircraft carries"
        out.append(f"the campaign flew other bounds than these ({kind}): which coefficient wins may differ with these")
    elif args.bounds is not None and args.bounds.read_bytes() != campaign.spec.inputs.model_form.read_bytes():
        out.append("the campaign flew other bounds than these: which coefficient wins may differ with these")
    known = {f.sha256 for f in form.flights}
    others = [p.name for p in args.flight or () if file_hash(p) not in known]
    if others:
        out.append(
            f"--flight {', '.join(others)}: not among the flights behind the bounds; what scatters there may be another thing"
        )
    if campaign.failed and not args.occupancy:
        out.append(f"{campaign.failed} flights of the campaign did not end well and say nothing of where the mission flies")
    if not flight.noise:
        out.append(f"aircraft '{aircraft.name}' has no sensors system: the flight was simulated without sensor noise")
    if not flight.has_autopilot:
        out.append(
            f"aircraft '{aircraft.name}' has none of this project's autopilot: test points are steps added to the commands while "
            "the mission is flown, at its speed and bank alone"
        )
    return out


def _redone(args: argparse.Namespace, before: ModelForm, after: ModelForm, mission: Occupancy, coefficient: str) -> int:
    from uqharness.next_flight.plan import WORTH
    from uqharness.next_flight.redone import achieved, as_text

    rows = achieved(before, after, mission, args.out / DOCUMENT)
    show_stage("")
    print(json.dumps({"coefficient": coefficient, "achieved": rows}) if args.json else as_text(rows))
    narrowing = rows[coefficient]["narrowing"]
    return 0 if narrowing is not None and narrowing >= WORTH else 1


def _text(found: Any, doc: dict[str, Any], out: Path) -> str:
    from uqharness.report.next_flight import point_rows, where_rows
    from uqharness.text_tables import text_table

    lines = [*doc["words"], "", *text_table(where_rows(found)), "", *text_table(point_rows(found)), ""]
    return "\n".join([*lines, f"{len(found.refused)} of {found.tried} test points were refused; results in {out}"])
