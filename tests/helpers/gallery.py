"""The gallery of docs: small aircraft in others' styles, each by three commands to a p-box.

``python -m tests.helpers.gallery [STYLE]...`` takes them (all: ten minutes of one core) and writes
their rows of docs/gallery.md.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import textwrap
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from tests.helpers.foreign_aircraft import SPEEDS_MPS, write
from uqharness.simulator import SteadyCondition, find_aircraft, find_trim

PAGE = Path(__file__).resolve().parents[2] / "docs" / "gallery.md"
ALTITUDE_M = 200.0
DESCRIPTIONS = {
    "single": "piston single; electrics, magnetos, starter and mixture in a system",
    "glider": "glider with its tow as external force; no throttle",
    "wing": "electric foam wing with elevons; throttle under another name",
    "twin": "piston twin; FlightGear's levers compute JSBSim's commands",
    "vtail": "electric V-tail; armed speed controller",
    "jet": "business jet; hydraulics, control law, fuel cutoff",
    "turboprop": "turboprop; condition lever, ground effect table, two tanks",
    "retractable": "supercharged single; governor, fuel selector, gear, flaps, wing leveller",
    "pusher": "electric flying wing, pusher; mixer and servos in a system at half rate",
    "ducted": "ducted fan; exponential stick, gains by airspeed",
    "contra": "racer with contra-rotating propellers on one lever",
    "biplane": "biplane; pushback force, canopy, pedal mix, tail wheel",
}
BOUNDS = "CX=0.01,CY=0.01,CZ=0.05,Cl=0.001,Cm=0.01,Cn=0.001"
CAMPAIGN = """[campaign]
aircraft = "mine"
mission = "steady"
seed = 1
[start]
V_mps = {V}
altitude_m = {h}
[aleatory]
flights = 1
duration_s = {duration}
burn_in_s = 0
wind_mps = 3
turbulence = "none"
sensor_noise = false
[epistemic]
method = "corners"
interior = 0
"""


@dataclass(frozen=True)
class Row:
    """What became of one aircraft: trim, engine of the campaign, and the spread of a metric."""

    style: str
    alpha_deg: float
    throttle_pct: float
    engine: str
    reason: str
    flights: int
    altitude_m: tuple[float, float]

    def line(self) -> str:
        """Return the row of the table."""
        low, high = self.altitude_m
        throttle = "" if self.style == "glider" else f"{self.throttle_pct:.0f} %"
        engine = self.engine + (f": {self.reason}" if self.engine == "jsbsim" else "")
        return (
            f"| {self.style} | {DESCRIPTIONS[self.style]} | {SPEEDS_MPS[self.style]:.0f} m/s |"
            f" {self.alpha_deg:.1f} deg | {throttle} | {low:.2f} to {high:.2f} m | {engine} |"
        )


def uqharness(folder: Path, *words: str) -> str:
    """Run a command and return its output. Raises RuntimeError if it fails."""
    command = [sys.executable, "-m", "uqharness.cli.main", *words]
    out = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if out.returncode:
        raise RuntimeError(f"{words}: {out.returncode}: {out.stderr[-600:]}")
    return out.stdout


def take(style: str, folder: Path, duration_s: float = 4.0) -> Row:
    """Take an aircraft from its files to a p-box by three commands."""
    write(style, folder)
    V = SPEEDS_MPS[style]
    text = CAMPAIGN.format(V=V, h=ALTITUDE_M, duration=duration_s)
    (folder / "campaign.toml").write_text(text)
    uqharness(folder, "instrument", style, "--out", "mine", "--constant", BOUNDS)
    uqharness(folder, "campaign", "run", "campaign.toml", "--out", "results", "--serial", "--yes")
    uqharness(folder, "campaign", "report", "results")
    return row_of(style, folder)


def row_of(style: str, folder: Path) -> Row:
    """Return the row of an aircraft from a folder with its copy and its results."""
    V = SPEEDS_MPS[style]
    trim = find_trim(find_aircraft(folder / "mine"), SteadyCondition(V, ALTITUDE_M))
    manifest = json.loads((folder / "results" / "manifest.json").read_text())
    cases = pd.read_parquet(folder / "results" / "cases.parquet")
    if not (cases["status"] == "ok").all():
        raise RuntimeError(f"{style}: {cases['status'].value_counts().to_dict()}")
    errors = cases["altitude_median_m"]
    (engine,) = cases["engine"].unique()
    choice = manifest.get("engine")
    why = choice.get("why", [""]) if isinstance(choice, dict) else [""]
    reason = textwrap.shorten(str(why[0] if why else "").rpartition("/")[2], 80)
    return Row(
        style,
        math.degrees(trim.alpha_rad),
        100.0 * trim.controls.get("throttle", 0.0),
        engine,
        reason,
        len(cases),
        (float(errors.min()), float(errors.max())),
    )


def main() -> None:
    """Take the aircraft and write their rows into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("style", nargs="*", choices=[*SPEEDS_MPS, []])
    styles = parser.parse_args().style or list(SPEEDS_MPS)
    for style in styles:
        with tempfile.TemporaryDirectory() as name:
            try:
                line = take(style, Path(name)).line()
            except RuntimeError as error:
                print(style, error, flush=True)
                continue
        print(line, flush=True)
        if not PAGE.is_file():
            continue
        lines = PAGE.read_text().splitlines()
        for k, old in enumerate(lines):
            if old.startswith(f"| {style} |"):
                lines[k] = line
        PAGE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
