"""The three flights of chapter 2 as DataFlash logs: one to identify from, one for bounds, one for validation."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

from uqharness.errors import BadInputError

FLIGHTS = ("flight-ident", "flight-bounds", "flight-validation")


def fly_flights(
    aircraft: str,
    folder: Path,
    seed: int,
    turbulence: str = "light",
    duration_s: float | None = None,
    suffix: str = ".bin",
) -> list[Path]:
    """Fly the three scripts (their first ``duration_s``) and write logs, DataFlash by default; the seed of flight k is seed + k."""
    from uqharness.cli import main as command

    paths = []
    for k, script in enumerate(FLIGHTS):
        path = folder / f"{aircraft}-{script}{suffix}"
        arguments = ["fly", aircraft, "--script", script, "--noise", "--seed", str(seed + k), "--out", str(path)]
        arguments += [] if duration_s is None else ["--duration-s", str(duration_s)]
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            code = command([*arguments, "--turbulence", turbulence])
        if code:
            raise BadInputError(
                f"{aircraft}, {script}, seed {seed + k}: the flight did not end well: {said.getvalue().strip()}"
            )
        paths.append(path)
    return paths
