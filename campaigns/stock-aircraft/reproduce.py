"""Every aeroplane of JSBSim's own collection from nothing to a p-box: the table of docs/aircraft.md.

python campaigns/stock-aircraft/reproduce.py [--aircraft NAME]...

Each aeroplane is asked for level flight at the speed at which 4 deg of incidence carry its weight. A speed or a path that `modes`
advises in its refusal is tried next, then other speeds.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from sysid.units import FT_M
from uqharness.child_process import child_environment, give_answer
from uqharness.files import scratch_folder
from uqharness.simulator import engine

ALTITUDE_M = 200.0
SPEEDS = (1.0, 1.15, 1.35, 0.9)
"""Shares of the speed at which 4 deg of incidence carry the weight; the first at which the aircraft trims is flown."""
_SPEED = re.compile(r"try V [<>]= ([\d.]+) m/s")
_PATH = re.compile(r"try a path of [<>]= (-?[\d.]+) deg")
BOUNDS = "CX=0.01,CY=0.01,CZ=0.05,Cl=0.001,Cm=0.01,Cn=0.001"
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
# What flies, and is no aeroplane.
OTHERS = {
    "ah1s": "helicopter",
    "ball": "ball",
    "ballx": "ball",
    "F450": "quadrotor",
    "J246": "launcher",
    "mk82": "bomb",
    "Submarine_Scout": "airship",
    "ZLT-NT": "airship",
    "weather-balloon": "balloon",
}


@dataclass
class Row:
    """One aeroplane: the speed [m/s] and path [deg] it was flown at, what was reached of STEPS, and why not more."""

    name: str
    V_mps: float = math.nan
    climb_deg: float = 0.0
    reached: list[str] = field(default_factory=list)
    reason: str = ""

    def line(self) -> str:
        """As a row of the table."""
        cells = " | ".join("yes" if step in self.reached else "" for step in STEPS)
        speed = f"{self.V_mps:.1f}" if math.isfinite(self.V_mps) else ""
        return f"| {self.name} | {speed} | {self.climb_deg:g} | {cells} | {self.reason} |"


def untouched(name: str) -> None:
    """In a process of its own, by JSBSim alone: the speed at which 4 deg carry the weight, and five seconds flown there."""
    import jsbsim

    def opened(speed_fps: float, alpha: float) -> object:
        fdm = jsbsim.FGFDMExec(None)
        fdm.set_debug_level(0)
        if not fdm.load_model(name):
            raise RuntimeError("JSBSim does not load it")
        fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/theta-deg"] = (
            45.0,
            ALTITUDE_M / FT_M,
            alpha,
        )
        fdm["ic/u-fps"] = speed_fps * math.cos(math.radians(alpha))
        fdm["ic/w-fps"] = speed_fps * math.sin(math.radians(alpha))
        fdm.run_ic()
        return fdm

    answer: dict[str, object] = {}
    try:
        fdm = opened(200.0, 4.0)
        lift, weight = fdm["forces/fwz-aero-lbs"], fdm["inertia/weight-lbs"]  # type: ignore[index]
        if not lift > 0.0:
            raise RuntimeError("no lift at 4 deg of incidence")
        speed = 200.0 * math.sqrt(weight / lift)
        fdm = opened(speed, 4.0)
        fdm["propulsion/set-running"] = -1  # type: ignore[index]
        for _ in range(600):
            fdm.run()  # type: ignore[attr-defined]
        state = [
            fdm[n]
            for n in (
                "velocities/vt-fps",
                "position/h-agl-ft",
                "attitude/phi-rad",
                "attitude/theta-rad",
            )
        ]  # type: ignore[index]
        if not all(map(math.isfinite, state)):
            raise RuntimeError("the state is not finite after five seconds")
        answer["V_mps"] = speed * FT_M
    except Exception as error:
        answer["error"] = " ".join(str(error).split())[:200] or type(error).__name__
    give_answer(answer)


def alone(name: str) -> tuple[float, str]:
    """The speed [m/s] at which an aircraft flies untouched, or NaN and why it does not."""
    command = [sys.executable, str(Path(__file__).resolve()), "--untouched", name]
    # Some aircraft write files where they are flown.
    with scratch_folder() as scratch:
        ended = subprocess.run(
            command,
            cwd=scratch.path,
            capture_output=True,
            text=True,
            errors="replace",
            env=child_environment(),
            check=False,
        )
    for line in reversed(ended.stdout.splitlines()):
        if line.startswith("uqharness-answer "):
            said = json.loads(line.removeprefix("uqharness-answer "))
            return said.get("V_mps", math.nan), said.get("error", "")
    return math.nan, f"ends JSBSim's process (code {ended.returncode})"


def study(name: str, V_mps: float) -> Row:
    """The three commands, and `modes` behind the first: what FlightGear would write is passed on in the copy alone."""
    row = Row(name)
    with scratch_folder() as scratch:
        folder = scratch.path

        def command(*words: str) -> tuple[int, str]:
            done = subprocess.run(
                [sys.executable, "-m", "uqharness", *words],
                cwd=folder,
                capture_output=True,
                text=True,
                env=child_environment(),
                check=False,
            )
            row.reason = "" if done.returncode == 0 else _last(done.stdout, done.stderr)
            return done.returncode, done.stdout

        if command("instrument", name, "--out", "mine", "--constant", BOUNDS)[0]:
            return row
        row.reached.append("instrument")
        if not _trims(row, V_mps, command):
            return row
        row.reached += ["trim", "modes"]
        (folder / "campaign.toml").write_text(
            _CAMPAIGN.format(V=row.V_mps, h=ALTITUDE_M, climb=row.climb_deg), encoding="utf-8"
        )
        if command("campaign", "run", "campaign.toml", "--out", "results", "--serial", "--yes")[0]:
            return row
        row.reached.append("campaign")
        if (folder / "results" / "pbox.parquet").is_file() and not command(
            "campaign", "report", "results"
        )[0]:
            row.reached.append("p-box")
    return row


def _trims(row: Row, V_mps: float, command: Callable[..., tuple[int, str]]) -> bool:
    """Whether `modes` finds a trim, at the speed and on the path then left in ``row``."""
    asked = [(round(share * V_mps, 1), 0.0) for share in SPEEDS]
    tried = set()
    while asked:
        row.V_mps, row.climb_deg = asked.pop(0)
        if (row.V_mps, row.climb_deg) in tried:
            continue
        tried.add((row.V_mps, row.climb_deg))
        speed, climb = f"{row.V_mps:.1f}", f"{row.climb_deg:g}"
        code, said = command(
            "modes",
            "mine",
            "--speed-mps",
            speed,
            f"--climb-deg={climb}",
            "--altitude-m",
            f"{ALTITUDE_M:g}",
        )
        if code == 0:
            return True
        if "does not change the thrust" in said:
            return False
        # What the refusal advises comes first.
        if found := _SPEED.search(said):
            asked.insert(0, (float(found[1]), row.climb_deg))
        elif found := _PATH.search(said):
            asked.insert(0, (row.V_mps, float(found[1])))
    return False


def _last(said: str, errors: str) -> str:
    found = [line.strip() for line in (said + "\n" + errors).splitlines() if line.strip()]
    lines = [line for line in found if not line.startswith(("note:", "uqharness: note:"))]
    return (lines[-1] if lines else "no message").replace("|", "/")[:400]


def main(argv: list[str] | None = None) -> int:
    """Print the table; the process's exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--aircraft", action="append", metavar="NAME", help="only this one; repeatable"
    )
    parser.add_argument("--untouched", metavar="NAME", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.untouched:
        untouched(arguments.untouched)
        return 0
    root = engine.default_root() / "aircraft"
    names = arguments.aircraft or sorted(path.name for path in root.iterdir() if path.is_dir())
    print(
        f"| aircraft | m/s | path, deg | {' | '.join(STEPS)} | reason |\n|---{'|---' * (len(STEPS) + 3)}|",
        flush=True,
    )
    rows = []
    for name in names:
        if name in OTHERS:
            continue
        V_mps, why = alone(name)
        if not math.isfinite(V_mps):
            print(
                f"| {name} |  |  |{'  |' * len(STEPS)} does not fly untouched: {why} |", flush=True
            )
            continue
        rows.append(study(name, V_mps))
        print(rows[-1].line(), flush=True)
    done = sum("p-box" in row.reached for row in rows)
    print(f"\n{len(rows)} aeroplanes fly untouched in JSBSim; {done} of them come to a p-box.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
