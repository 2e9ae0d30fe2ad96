"""``uqharness margins``: gain, phase and delay margins of the autopilot's loops, measured in
flight.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

from uqharness.cli.options import (
    add_aircraft,
    add_autopilot,
    add_page,
    command_as_given,
    describe,
    gains_document,
    gains_of,
    print_gains,
)
from uqharness.cli.progress import counting
from uqharness.errors import BadInputError
from uqharness.files import check_page_path
from uqharness.flight import (
    CALM_LOITER,
    CALM_STRAIGHT,
    LOOPS,
    MAX_SCATTER,
    LoopMargins,
    measure_loop,
)
from uqharness.report import write_html
from uqharness.report.pages import margins_page
from uqharness.simulator import StagedMission, engine, find_aircraft, find_script

_EXAMPLE = """
  uqharness margins espaaro
  uqharness margins espaaro --loop elevator --flight straight --json
  uqharness margins espaaro --autopilot my-plane.param --loop aileron
  uqharness margins espaaro --out margins.html"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``margins``."""
    text = (
        "Measure the autopilot's stability margins in flight, loop by loop, by injecting a"
        " multisine at each controller's output."
    )
    describe(parser, _run, text, _EXAMPLE)
    add_aircraft(parser)
    parser.add_argument(
        "--script",
        default="loiter",
        metavar="S",
        help="run script that engages the autopilot (default %(default)s)",
    )
    parser.add_argument(
        "--loop",
        action="append",
        choices=tuple(LOOPS),
        help="only this actuator; repeatable (default all)",
    )
    parser.add_argument(
        "--flight",
        choices=("loiter", "straight"),
        default="loiter",
        help="on the circle or straight (default %(default)s)",
    )
    add_autopilot(parser)
    add_page(parser, "Bode and Nichols charts of every loop, margins marked")


def _run(args: argparse.Namespace) -> int:
    """Measure the loops and print their margins; return the exit code."""
    if args.out is not None:
        check_page_path(args.out)
    aircraft = find_aircraft(args.aircraft)
    condition = CALM_LOITER if args.flight == "loiter" else CALM_STRAIGHT
    names = args.loop or list(LOOPS)
    script = find_script(args.script)
    gains = gains_of(args.autopilot, aircraft, script)
    # Gains of a parameter file replace those of the aircraft.
    condition = {**condition, **(gains.properties if gains else {})}
    with StagedMission(aircraft, script) as mission:
        # Each measurement needs instances of its own, at the same condition.
        def make_fdm() -> Any:
            fdm = mission.open()
            needed = [name for loop in LOOPS.values() for name in loop.properties]
            engine.require(fdm, [*condition, *needed])
            return fdm

        try:
            measured: list[LoopMargins] = []
            with counting("loops measured") as callback:

                def update(share: float) -> None:
                    callback(len(measured) + share, len(names))

                for name in names:
                    measured.append(
                        measure_loop(make_fdm, LOOPS[name], condition=condition, on_progress=update)
                    )
        except ValueError as error:
            raise BadInputError(f"margins of {aircraft.name}: {error}") from None
    if args.out is not None:
        write_html(
            args.out, margins_page(aircraft.name, args.flight, measured, command_as_given(args))
        )
    if args.json:
        print(
            json.dumps(
                {
                    "flight": args.flight,
                    "loops": {item.loop: _as_json(item) for item in measured},
                    "autopilot": gains_document(gains),
                }
            )
        )
    else:
        print_gains(args.autopilot, gains)
        print(_as_text(aircraft.name, args.flight, measured))
    return 0


def _number(value: float) -> float | None:
    """Return a finite value, None otherwise."""
    return value if math.isfinite(value) else None


def _as_json(item: LoopMargins) -> dict[str, object]:
    """Return one loop's margins for --json."""
    m = item.margins
    return {
        "gain_up_dB": _number(m.gain_up_dB),
        "gain_down_dB": _number(m.gain_down_dB),
        "phase_deg": _number(m.phase_deg),
        "delay_s": _number(m.delay_s),
        "modulus": m.modulus,
        "gain_crossovers_radps": list(m.gain_crossovers_radps),
        "phase_crossovers_radps": list(m.phase_crossovers_radps),
        "not_read_radps": [float(w) for w in item.frequency_radps[~item.reliable]],
    }


def _as_text(name: str, flight: str, measured: list[LoopMargins]) -> str:
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
    for item in measured:
        m = item.margins
        crossover = ", ".join(f"{w:.2f}" for w in m.gain_crossovers_radps) or "none"
        lines.append(
            f"  {item.loop:<10}{show(m.gain_up_dB):>12}{show(m.gain_down_dB):>15}"
            f"{show(m.phase_deg):>12}{show(1000 * m.delay_s, 0):>11}{m.modulus:>11.2f}"
            f"   {crossover}"
        )
    lines += [text for item in measured if (text := _unread_note(item))]
    return "\n".join(lines)


def _unread_note(item: LoopMargins) -> str:
    """Describe the frequencies that were discarded; empty where all were used."""
    dropped = item.frequency_radps[~item.reliable]
    if not dropped.size:
        return ""
    share = f"{100 * MAX_SCATTER:.0f} %"
    return (
        f"  {item.loop}: {dropped.size} of {item.reliable.size} frequencies, {dropped.min():.2g} to"
        f" {dropped.max():.2g} rad/s, are not used: the loop's response there differs by more than"
        f" {share} between the two signs of the injection"
    )
