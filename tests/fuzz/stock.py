"""Count the aircraft that come with JSBSim and that the batch engine understands.

``python -m tests.fuzz.stock [NAME or FOLDER ...]`` translates each in a process of its own, because
some end the interpreter, and prints ``understood`` or the first reason against it.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from uqharness.batch.mission import initial_values
from uqharness.batch.translate.channels import read_sources
from uqharness.batch.translate.flight import TraceRequest, trace_flight
from uqharness.batch.translate.frame import Values, is_constant
from uqharness.errors import BadInputError
from uqharness.simulator import engine, staged
from uqharness.simulator.aircraft import find_aircraft

DT_S = 1.0 / 120.0
UNDERSTOOD = "understood"
_START = {"ic/h-sl-ft": 5000.0, "ic/vc-kts": 120.0, "ic/gamma-deg": 0.0}


def names() -> list[str]:
    """List the aircraft of JSBSim's package."""
    return sorted(p.name for p in (engine.default_root() / "aircraft").iterdir() if p.is_dir())


def translate(folder: Path) -> str:
    """Return UNDERSTOOD, or the reason against an aircraft."""
    try:
        aircraft = find_aircraft(folder)
        staging = staged(aircraft)

        def opened():
            fdm = engine.open_fdm(staging, DT_S)
            for name, value in _START.items():
                fdm[name] = value
            return fdm

        values = Values(initial_values(opened), is_constant)
        trace_flight(read_sources(aircraft, None), DT_S, values, TraceRequest((), [], []))
    except BadInputError as error:
        return " | ".join(str(error).splitlines())
    return UNDERSTOOD


def survey(aircraft: list[str]) -> dict[str, str]:
    """Return what `translate` says of each aircraft, in a process each."""
    out = {}
    for name in aircraft:
        folder = Path(name) if "/" in name else engine.default_root() / "aircraft" / name
        code = "import sys, tests.fuzz.stock as s, pathlib\nprint(s.translate(pathlib.Path(sys.argv[1])))"
        result = subprocess.run(
            [sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=False
        )
        lines = result.stdout.strip().splitlines()
        out[name] = lines[-1] if lines else f"ended with {result.returncode}"
    return out


if __name__ == "__main__":
    verdicts = survey(sys.argv[1:] or names())
    for title, verdict in verdicts.items():
        print(f"{title}: {verdict}")
    print(f"{sum(v == UNDERSTOOD for v in verdicts.values())} of {len(verdicts)} understood")
