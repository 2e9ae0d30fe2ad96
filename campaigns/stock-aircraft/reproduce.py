"""Every aeroplane of JSBSim's own collection from nothing to a p-box: the table of
docs/aircraft.md.

python campaigns/stock-aircraft/reproduce.py [--aircraft NAME]...

Each aeroplane is trimmed in level flight at the speed at which 4 deg of incidence carry its weight.
A speed or a path that `modes` advises in its refusal is tried next, then other speeds.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sysid.units import FT_M
from uqharness.child_process import child_environment, give_answer
from uqharness.files import scratch_folder
from uqharness.simulator import engine

ALTITUDE_M = 200.0
SPEEDS = (1.0, 1.15, 1.35, 0.9)
"""Shares of the speed at which 4 deg of incidence carry the weight; the first at which the aircraft
trims is flown."""
_SPEED = re.compile(r"try V [<>]= ([\d.]+) m/s")
_PATH = re.compile(r"try a path of [<>]= (-?[\d.]+) deg")
BOUNDS = "CX=0.01,CY=0.01,CZ=0.05,Cl=0.001,Cm=0.01,Cn=0.001"
STATE = ("velocities/vt-fps", "position/h-agl-ft", "attitude/phi-rad", "attitude/theta-rad")
STEPS = ("instrument", "trim", "modes", "campaign", "p-box")
_CAMPAIGN = """[campaign]
aircraft = "mine"
mission = "steady"
seed = 1
[start]
V_mps = {V:.1f}
altitude_m = {h:g}
climb_deg = {climb:g}
[aleatory]
flights = 1
duration_s = 4
burn_in_s = 0
wind_mps = 0
turbulence = "none"
sensor_noise = false
[epistemic]
method = "corners"
"""
OTHERS = "ah1s ball ballx F450 J246 mk82 Submarine_Scout ZLT-NT weather-balloon"
"""Aircraft that are no aeroplanes: helicopter, balls, quadrotor, launcher, bomb, airships,
balloon."""


@dataclass
class Row:
    """One aeroplane: the speed [m/s] and path [deg] it was flown at, the STEPS that it reached, and
    why not more."""

    name: str
    V_mps: float = math.nan
    climb_deg: float = 0.0
    reached: list[str] = field(default_factory=list)
    reason: str = ""

    def line(self) -> str:
        """Return the row of the table."""
        cells = " | ".join("yes" if step in self.reached else "" for step in STEPS)
        speed = f"{self.V_mps:.1f}" if math.isfinite(self.V_mps) else ""
        return f"| {self.name} | {speed} | {self.climb_deg:g} | {cells} | {self.reason} |"


def untouched(name: str) -> None:
    """Answer, in a child process and by JSBSim alone, the speed at which 4 deg carry the weight,
    after five seconds flown there."""
    import jsbsim

    def opened(speed_fps: float, alpha: float) -> Any:
        fdm = jsbsim.FGFDMExec(None)
        fdm.set_debug_level(0)
        if not fdm.load_model(name):
            raise RuntimeError("JSBSim does not load it")
        start = {"lat-geod-deg": 45.0, "h-sl-ft": ALTITUDE_M / FT_M, "theta-deg": alpha}
        start["u-fps"] = speed_fps * math.cos(math.radians(alpha))
        start["w-fps"] = speed_fps * math.sin(math.radians(alpha))
        for key, value in start.items():
            fdm[f"ic/{key}"] = value
        fdm.run_ic()
        return fdm

    answer: dict[str, object] = {}
    try:
        fdm = opened(200.0, 4.0)
        lift, weight = fdm["forces/fwz-aero-lbs"], fdm["inertia/weight-lbs"]
        if not lift > 0.0:
            raise RuntimeError("no lift at 4 deg of incidence")
        speed = 200.0 * math.sqrt(weight / lift)
        fdm = opened(speed, 4.0)
        fdm["propulsion/set-running"] = -1
        for _ in range(600):
            fdm.run()
        if not all(math.isfinite(fdm[name]) for name in STATE):
            raise RuntimeError("the state is not finite after five seconds")
        answer["V_mps"] = speed * FT_M
    except Exception as error:
        answer["error"] = " ".join(str(error).split())[:200] or type(error).__name__
    give_answer(answer)


def _run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    options: dict[str, Any] = {"capture_output": True, "text": True, "errors": "replace"}
    environment = child_environment()
    words = [sys.executable, *command]
    return subprocess.run(words, cwd=folder, env=environment, check=False, **options)


def untouched_speed(name: str) -> tuple[float, str]:
    """Return the speed [m/s] at which an aircraft flies untouched, or NaN and the reason why it
    does not."""
    # Some aircraft write files into the working folder.
    with scratch_folder() as scratch:
        child = _run(scratch.path, str(Path(__file__).resolve()), "--untouched", name)
    for line in reversed(child.stdout.splitlines()):
        if line.startswith("uqharness-answer "):
            answer = json.loads(line.removeprefix("uqharness-answer "))
            return answer.get("V_mps", math.nan), answer.get("error", "")
    return math.nan, f"ends JSBSim's process (code {child.returncode})"


def study(name: str, V_mps: float) -> Row:
    """Run the three commands, and `modes` after the first, in a copy of the aircraft."""
    row = Row(name)
    with scratch_folder() as scratch:
        folder = scratch.path

        def command(*words: str) -> tuple[int, str]:
            child = _run(folder, "-m", "uqharness", *words)
            row.reason = "" if child.returncode == 0 else _last(child.stdout, child.stderr)
            return child.returncode, child.stdout

        if command("instrument", name, "--out", "mine", "--constant", BOUNDS)[0]:
            return row
        row.reached.append("instrument")
        if not _trims(row, V_mps, command):
            return row
        row.reached += ["trim", "modes"]
        text = _CAMPAIGN.format(V=row.V_mps, h=ALTITUDE_M, climb=row.climb_deg)
        (folder / "campaign.toml").write_text(text, encoding="utf-8")
        if command("campaign", "run", "campaign.toml", "--out", "results", "--serial", "--yes")[0]:
            return row
        row.reached.append("campaign")
        has_pbox = (folder / "results" / "pbox.parquet").is_file()
        if has_pbox and command("campaign", "report", "results")[0] == 0:
            row.reached.append("p-box")
    return row


def _trims(row: Row, V_mps: float, command: Callable[..., tuple[int, str]]) -> bool:
    """Return whether `modes` trims, at the speed and on the path then stored in ``row``."""
    pending = [(round(share * V_mps, 1), 0.0) for share in SPEEDS]
    trial = set()
    while pending:
        row.V_mps, row.climb_deg = pending.pop(0)
        if (row.V_mps, row.climb_deg) in trial:
            continue
        trial.add((row.V_mps, row.climb_deg))
        place = (f"--climb-deg={row.climb_deg:g}", "--altitude-m", f"{ALTITUDE_M:g}")
        code, output = command("modes", "mine", "--speed-mps", f"{row.V_mps:.1f}", *place)
        if code == 0:
            return True
        if "does not change the thrust" in output:
            return False
        # The refusal's advice comes first.
        if advice := _SPEED.search(output):
            pending.insert(0, (float(advice[1]), row.climb_deg))
        elif advice := _PATH.search(output):
            pending.insert(0, (row.V_mps, float(advice[1])))
    return False


def _last(output: str, errors: str) -> str:
    lines = [line.strip() for line in f"{output}\n{errors}".splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith(("note:", "uqharness: note:"))]
    return (lines[-1] if lines else "no message").replace("|", "/")[:400]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table and return the process's exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    option = parser.add_argument
    option("--aircraft", action="append", metavar="NAME", help="only this one; repeatable")
    option("--untouched", metavar="NAME", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.untouched:
        untouched(args.untouched)
        return 0
    root = engine.default_root() / "aircraft"
    names = args.aircraft or sorted(path.name for path in root.iterdir() if path.is_dir())
    print(f"| aircraft | m/s | path, deg | {' | '.join(STEPS)} | reason |")
    print(f"|---{'|---' * (len(STEPS) + 3)}|", flush=True)
    rows = []
    for name in (name for name in names if name not in OTHERS.split()):
        V_mps, reason = untouched_speed(name)
        if not math.isfinite(V_mps):
            cells = "  |" * len(STEPS)
            print(f"| {name} |  |  |{cells} does not fly untouched: {reason} |", flush=True)
            continue
        rows.append(study(name, V_mps))
        print(rows[-1].line(), flush=True)
    done = sum("p-box" in row.reached for row in rows)
    print(f"\n{len(rows)} aeroplanes fly untouched in JSBSim; {done} of them come to a p-box.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
