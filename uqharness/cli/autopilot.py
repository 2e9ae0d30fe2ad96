"""``--autopilot FILE``: an autopilot's gains from ArduPilot's parameter file, and what was taken of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uqharness.flight import AutopilotGains
    from uqharness.simulator import Aircraft


def add_autopilot(parser: argparse.ArgumentParser) -> None:
    """``--autopilot``."""
    parser.add_argument(
        "--autopilot",
        type=Path,
        metavar="FILE",
        help="ArduPlane parameter file (.parm, .param): gains of the autopilot (default: the aircraft's own)",
    )


def gains_of(path: Path | None, aircraft: Aircraft, script: Path) -> AutopilotGains | None:
    """Gains in the file for this aircraft; None without a file. Raises BadInputError with file and line."""
    if path is None:
        return None
    from uqharness.flight import read_gains
    from uqharness.simulator import StagedMission, engine

    with StagedMission(aircraft, script) as mission:
        return read_gains(path, set(engine.catalog(mission.open())))


def tell_gains(path: Path | None, gains: AutopilotGains | None) -> None:
    """Print which gains were taken, which not, and why."""
    if gains is not None:
        print("\n  ".join([f"{path}:", *gains.lines()]))


def as_data(gains: AutopilotGains | None) -> dict[str, Any] | None:
    """The same for --json."""
    return (
        None
        if gains is None
        else {"taken": gains.properties, "ignored": dict(gains.ignored), "others": gains.others}
    )
