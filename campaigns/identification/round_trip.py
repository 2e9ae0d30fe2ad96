"""The round trip of chapter 2: log, identify, XML, and the identified aircraft beside a flight that
was not used.

    python -m campaigns.identification.round_trip --out campaigns/identification/round-trip

The synthetic aircraft with dynamic stall flies scripts/flight-ident.xml and flight-validation.xml
in calm air with Table 2.1's noise, logged as DataFlash. Three forms of it are identified from the
first log through JSBSim (`uqharness identify`, output error), written into their XML, and replayed
beside the second (`uqharness compare`):

    right  the form that was flown: lift lost by separation, its constants known
    SL     without the loss of lift
    SLM    without the loss of lift and without Cm_q

Exit codes: 0 the right form reaches the noise floor and SLM does not, 1 otherwise, 2 bad input.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from campaigns.identification.flights import fly_flights
from campaigns.library.study import exit_code, log_progress, study_parser
from uqharness.errors import BadInputError
from uqharness.files import write_text
from uqharness.identification.compare import LIMIT, Comparison, compare
from uqharness.identification.identify import identify
from uqharness.identification.replay_fit import Identification
from uqharness.plugin.apply import Estimate, write_estimates
from uqharness.replay.flights import read_flights
from uqharness.report.pages.compare import gap_verdict
from uqharness.simulator.aircraft import Aircraft, find_aircraft

FLOWN = "synthetic_stall"


@dataclass(frozen=True)
class Form:
    """A model's form: what of the flown aircraft it switches off, by property; what is not free
    follows from that."""

    name: str
    off: tuple[str, ...]
    about: str


FORMS = (
    Form("right", (), "the form that was flown, separation's constants known"),
    Form("SL", ("aero/stall",), "without the loss of lift by separation"),
    Form("SLM", ("aero/stall", "aero/Cm_q"), "without the loss of lift and without pitch damping"),
)


@dataclass(frozen=True)
class RoundTrip:
    """A form, its identification from the first flight, and the gap to the one not used."""

    form: Form
    fit: Identification
    gap: Comparison


def aircraft_of(form: Form, folder: Path) -> Aircraft:
    """Write the flown aircraft with the form's effects switched off. Raises BadInputError where the
    XML lacks one."""
    if folder.exists() and not folder.is_dir():
        raise BadInputError(f"{folder}: exists and is no folder")
    zero = Estimate(0.0, f"identified model {form.name}: {form.about}")
    missing = write_estimates(find_aircraft(FLOWN), dict.fromkeys(form.off, zero), folder)
    if missing:
        raise BadInputError(
            f"aircraft '{FLOWN}' declares no property {missing[0]}, which form {form.name} "
            "switches off"
        )
    return find_aircraft(folder)


def round_trip(
    form: Form,
    identified: Path,
    validation: Path,
    folder: Path,
    free: Sequence[str] | None = None,
    workers: int | None = None,
) -> RoundTrip:
    """Identify ``form`` from the log ``identified``, write it to ``folder``/FORM and compare that
    with the log ``validation``.

    free: the properties estimated; default all of the card's that the form has.
    """
    before = aircraft_of(form, folder / f"{form.name}-before")
    names = [n for n in (free or before.card.parameters) if n not in form.off]
    flights, measured = read_flights([identified], before, None, None)
    fit = identify(
        before, flights, measured, names, start="initial", method="output-error", workers=workers
    )
    estimates = {
        n: Estimate(float(v), f"identified from {identified.name}")
        for n, v in zip(fit.names, fit.theta, strict=True)
        if fit.status[n] == "identified"
    }
    write_estimates(before, estimates, folder / form.name)
    after = find_aircraft(folder / form.name)
    unused, measured = read_flights([validation], after, None, None)
    return RoundTrip(form, fit, compare(after, unused[0], measured, workers=workers))


def says_which(trips: Sequence[RoundTrip]) -> bool:
    """Return whether the right form reaches the floor and SLM, if it was tried, does not."""
    return all(
        trip.gap.reached == (trip.form.name == "right") for trip in trips if trip.form.name != "SL"
    )


def document(trips: Sequence[RoundTrip]) -> Mapping[str, object]:
    """Return round-trip.json: verdict, rms over noise by channel and by manoeuvre, the identified
    parameters."""
    return {
        "limit": LIMIT,
        "forms": {
            t.form.name: {
                "reached": t.gap.reached,
                "above": list(t.gap.above),
                "ratio": {c: g.ratio for c, g in t.gap.channels.items() if g.judged},
                "manoeuvres": {m: dict(row) for m, row in t.gap.manoeuvres.items()},
                "coefficients": {c: g.rms / g.noise for c, g in t.gap.coefficients.items()},
                "converged": t.fit.converged,
                "identified": [n for n in t.fit.names if t.fit.status[n] == "identified"],
                "warnings": list(t.fit.warnings),
            }
            for t in trips
        },
    }


def markdown(trips: Sequence[RoundTrip]) -> str:
    """Return the verdict by channel, as text."""
    channels = [c for c, g in trips[0].gap.channels.items() if g.judged]
    lines = [
        f"Rms of measured minus re-flown over noise, flight not used; the floor is {LIMIT}.",
        "",
        "| form | " + " | ".join(f"`{c}`" for c in channels) + " | noise floor |",
        "|---" * (len(channels) + 2) + "|",
    ]
    for t in trips:
        ratios = " | ".join(f"{t.gap.channels[c].ratio:.2f}" for c in channels)
        lines.append(
            f"| {t.form.name} | {ratios} | {'reached' if t.gap.reached else 'NOT reached'} |"
        )
    lines += ["", *(f"{t.form.name} ({t.form.about}): {gap_verdict(t.gap)}" for t in trips), ""]
    return "\n".join(lines)


def run(
    folder: Path,
    seed: int = 1,
    forms: Sequence[Form] = FORMS,
    free: Sequence[str] | None = None,
    workers: int | None = None,
    duration_s: float | None = None,
    suffix: str = ".bin",
) -> list[RoundTrip]:
    """Fly (the first ``duration_s``), identify and compare; write round-trip.json and
    round-trip.md.

    suffix: of the logs, .bin (DataFlash, with the commands as they were) or .parquet (a flight
    record).
    """
    folder.mkdir(parents=True, exist_ok=True)
    logs = fly_flights(FLOWN, folder, seed, "none", duration_s, suffix)
    trips = []
    for form in forms:
        trips.append(round_trip(form, logs[0], logs[2], folder, free, workers))
        log_progress(f"{form.name}: {gap_verdict(trips[-1].gap)}")
        write_text(folder / "round-trip.json", json.dumps(document(trips), indent=1) + "\n")
        write_text(folder / "round-trip.md", markdown(trips))
    return trips


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out="logs, aircraft, round-trip.md and round-trip.json")
    option, names = parser.add_argument, [form.name for form in FORMS]
    option("--seed", type=int, default=1, help="of the noise in the first flight (1)")
    option("--forms", nargs="+", default=names, choices=names)
    option("--workers", type=int, metavar="N", help="processes (one a core, 8 at most)")
    option("--json", action="store_true", help="print round-trip.json")
    args = parser.parse_args(arguments)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    forms = [form for form in FORMS if form.name in args.forms]
    trips = run(args.out, args.seed, forms, workers=args.workers)
    print(json.dumps(document(trips)) if args.json else markdown(trips))
    return 0 if says_which(trips) else 1


if __name__ == "__main__":
    raise SystemExit(main())
