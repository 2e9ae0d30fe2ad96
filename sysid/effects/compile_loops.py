"""Compile the loops of identification ahead of use: `python -m sysid.effects.compile_loops`.

The set-up runs it. Otherwise the first flight in turbulence compiles them, which takes some twenty
seconds. The machine code is kept beside the sources.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.aerodynamics import GustStates, Reference, linearise
from sysid.aerodynamics.rigid_body import OUTPUTS, MassProperties
from sysid.effects.prediction import Columns, filter_segments, whiten, whiten_filtered, with_air
from sysid.effects.turbulence import LIGHT_AIR, AirLikelihood, process_of
from sysid.estimation import Process

_ROWS, _DT_S, _SPEED_MPS = 4, 0.02, 20.0


def compile_loops() -> None:
    """Linearise and filter an artificial flight of a few samples, in calm air and in gusts."""
    x = np.zeros((_ROWS, 8))
    x[:, 0] = _SPEED_MPS
    zeros, slopes = np.zeros((_ROWS, 3)), np.zeros((_ROWS, 6, 6))
    reference = Reference(_DT_S, x, zeros, zeros, slopes, np.full(_ROWS, 200.0), np.zeros(3), False)
    by_flow = np.zeros((_ROWS, 6, 2))
    reference = replace(reference, by_flow=by_flow, frame_s=0.5 * _DT_S)
    mass, gusts = MassProperties(1.0, np.eye(3), 1.0, 1.0, 1.0), GustStates(1.0)
    outputs, noise = range(len(OUTPUTS)), np.ones(len(OUTPUTS))
    measured = np.zeros((_ROWS, len(OUTPUTS)))
    columns = [Columns(("c",), {"c": (0, np.zeros(_ROWS))}, {})]
    in_earth = gusts._replace(turning_with=False, in_earth=True)
    calm, gusty, _ = (linearise(reference, mass, gusts=air) for air in (None, gusts, in_earth))
    variances, begin = process_of(LIGHT_AIR, _SPEED_MPS, gusts)
    process = Process(variances[None], begin[None])
    whiten([calm], [measured], columns, outputs, noise)
    followed = filter_segments([gusty], [measured], outputs, noise, process)
    whiten_filtered(with_air(followed, process, noise), columns)
    AirLikelihood([gusty], [measured], outputs)(noise, process)


if __name__ == "__main__":
    compile_loops()
