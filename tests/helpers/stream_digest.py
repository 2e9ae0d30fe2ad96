"""A digest of all random streams of a flight; ``python -m tests.helpers.stream_digest`` prints it.

It needs no compiler.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np

from uqharness.batch.streams import JsbsimNormals
from uqharness.flight.dryden import DrydenGusts, dryden_parameters
from uqharness.flight.fly import RecordedFlight, score_from_start
from uqharness.flight.random_numbers import Normals
from uqharness.flight.spec import COEFFICIENTS, FlightSpec, LevelDriver
from uqharness.flight.stepping import Levels


def digest() -> str:
    """SHA-256 of gusts, levels, normals, JSBSim's normals, and the scores of flights made
    of them.
    """
    sha = hashlib.sha256()
    for seed, air in enumerate(
        [(22.2, 100.0, 30.0, 3.66), (61.7, 17.3, 15.0, 11.1), (9.1, 304.0, 45.0, 0.7)]
    ):
        gusts = DrydenGusts(dryden_parameters(*air), 0.01 * (seed + 1), (seed, 5))
        sha.update(np.concatenate([gusts.page(), gusts.page()], axis=1).tobytes())
    for kind, rates in (("walk", (0.02,) * 6), ("white", ())):
        sha.update(
            Levels(LevelDriver(kind, 3, "sample-000001", COEFFICIENTS, rates), 0.01)
            .take(20_000)
            .tobytes()
        )
    sha.update(Normals(np.random.PCG64(12)).take(200_000).tobytes())
    sha.update(JsbsimNormals(2024).take(200_000).tobytes())
    flight = np.cumsum(Normals(np.random.PCG64(5)).take(9 * 9001).reshape(-1, 9), axis=0)
    for rows in (flight, flight[:7], flight[:600]):
        sha.update(scored(rows))
    return sha.hexdigest()


def scored(columns: np.ndarray) -> bytes:
    """Metrics of a flight straight on, whose signals are those columns (n, 9) of no meaning."""
    names = (
        "height_m",
        "V_mps",
        "psi_rad",
        "load_factor",
        "north_m",
        "east_m",
        "vn_mps",
        "ve_mps",
        "phi_rad",
    )
    recorded = RecordedFlight(
        [*names, "alpha_rad"], np.column_stack([columns, columns[:, 0]]), "ok", "", 1.0
    )
    metrics = score_from_start(FlightSpec(Path("a"), Path("s"), 1.0), recorded).metrics
    return repr(sorted(metrics.items())).encode()


def librarys() -> str:
    """The same of the C library's and numpy's own functions: what the streams must not
    depend on.
    """
    x = np.random.Generator(np.random.PCG64(1)).random(50_000)
    theirs = np.array([[math.exp(v), math.log(v), math.sin(v)] for v in x.tolist()])
    return hashlib.sha256(theirs.tobytes() + np.exp(x).tobytes() + np.log(x).tobytes()).hexdigest()


if __name__ == "__main__":
    print(digest(), librarys())
