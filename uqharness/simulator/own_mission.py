"""Manoeuvres for any aircraft without a script: it is trimmed, and steps are added to the controls that trim it.

The steps are sized by the linear model about the trim, so that the greatest excursion of each is a few degrees. Their lengths
follow the mode that each control excites: 2.3/wn for a doublet, 1.6/wn for 3-2-1-1 (R. V. Jategaonkar, Flight Vehicle System
Identification, chapter 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.linear import STATES, LinearModel, linearise, modes
from uqharness.simulator.manoeuvre_script import DOUBLET, THREE_TWO_ONE_ONE
from uqharness.simulator.mission import MANOEUVRE_PROPERTY
from uqharness.simulator.signals import SECOND_ORDER
from uqharness.simulator.start import StartSection
from uqharness.simulator.steady_start import SCRIPT, write_steady_start

MISSIONS = ("steady", "doublets", "3-2-1-1")
EXCURSION_DEG = 4.0
"""Greatest angle of incidence, sideslip, pitch or bank [deg] that a manoeuvre is to reach by the linear model; bank three times."""
FLOWN_S = 0.0025
"""Longest step [s] that these missions are flown with, which is that of the replays that they will be compared with."""
SETTLE_S, REST_S = 2.0, 4.0
STEADY_S = 20.0
_MODE = {"elevator": "short_period", "aileron": "roll", "rudder": "dutch_roll"}
_AXIS = {"elevator": "pitch", "aileron": "roll", "rudder": "yaw"}
_UNITS_S = (
    0.2,
    1.5,
)  # a step that a servo can follow, and one that the aircraft does not leave its trim by
_GRID_S = 0.04  # steps fall on rows of a record at 25, 50 or 100 Hz: between two rows they would be dated too late
_BANK = 3.0
_MOST_TRAVEL = 0.5  # of what is left of a control's travel
_DT_S = 0.01
_RATES = ("simulation/integrator/rate/rotational", "simulation/integrator/rate/translational")
_EULER = 1.0


@dataclass(frozen=True)
class Step:
    """A manoeuvre of one control: (units, sign) pairs of ``unit_s`` seconds, ``size`` in the control's own unit."""

    name: str
    control: str
    size: float
    unit_s: float
    pattern: tuple[tuple[int, float], ...]

    @property
    def length_s(self) -> float:
        """From the first step to the return [s]."""
        return self.unit_s * sum(units for units, _ in self.pattern)


def write_own_mission(
    aircraft: Aircraft, start: StartSection, kind: str, *, restarting: bool = False
) -> tuple[Path, list[Step]]:
    """Trim the aircraft and write initial conditions and a run script into its folder: the script, and its manoeuvres.

    ``kind`` one of MISSIONS; ``restarting``: the flight is integrated by SECOND_ORDER, and begins anew at every step of a
    control (`_restart`). Raises BadInputError where there is no trim, and for an aircraft whose controls move nothing or
    command body rates.
    """
    if kind not in MISSIONS:
        raise BadInputError(f"mission '{kind}': allowed are {', '.join(MISSIONS)}")
    path = aircraft.folder / SCRIPT
    trim = write_steady_start(aircraft, start, path, f"mission {kind}")
    if kind != "steady" and trim.rest is not None and trim.rest.free:
        raise BadInputError(
            f"aircraft '{aircraft.name}': its control laws answer a command with a body rate, so steps cannot be sized by a "
            "surface's moment; fly mission steady, or --script with commands of your own"
        )
    steps = [] if kind == "steady" else manoeuvres(aircraft, linearise(aircraft, trim), kind)
    if kind != "steady" and not steps:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no surface turns it at {start.V_mps:g} m/s, so there is nothing to fly"
        )
    text = path.read_text(encoding="utf-8")
    end = STEADY_S if kind == "steady" else SETTLE_S + sum(step.length_s + REST_S for step in steps)
    text = text.replace('end="60"', f'end="{end:.2f}"')
    properties = (
        "" if kind == "steady" else f'    <property value="0">{MANOEUVRE_PROPERTY}</property>\n'
    )
    write_bytes(
        path,
        text.replace(
            "  </run>", f"{properties}{_events(aircraft, steps, restarting)}  </run>"
        ).encode(),
    )
    return path, steps


def finely(aircraft: Aircraft) -> Aircraft:
    """The aircraft with a step of at most FLOWN_S: at 10 ms JSBSim answers a command half a step late."""
    section = aircraft.card.aircraft
    fine = section.model_copy(update={"dt_s": min(section.dt_s, FLOWN_S)})
    return replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": fine}))


def manoeuvres(aircraft: Aircraft, model: LinearModel, kind: str) -> list[Step]:
    """Steps of every surface that turns the aircraft, sized for EXCURSION_DEG."""
    frequency = {mode.name: mode.wn_radps for mode in modes(model)}
    coupled = frequency.get("other", 0.0)  # ailerons excite it where roll and spiral have joined
    steps = []
    for control, mode in _MODE.items():
        if control not in model.controls:
            continue
        pattern, cycles = (
            (THREE_TWO_ONE_ONE, 1.6)
            if kind == "3-2-1-1" and control == "elevator"
            else (DOUBLET, 2.3)
        )
        unit_s = _GRID_S * round(
            min(max(cycles / max(frequency.get(mode, coupled), 1e-3), _UNITS_S[0]), _UNITS_S[1])
            / _GRID_S
        )
        greatest = _excursion_rad(model, control, unit_s, pattern)
        if not greatest > 1e-9:
            continue
        low, high = aircraft.card.inputs[control].limits
        at = model.trim.controls[control]
        size = min(math.radians(EXCURSION_DEG) / greatest, _MOST_TRAVEL * min(high - at, at - low))
        if size > 0.0:
            name = "3-2-1-1" if pattern is THREE_TWO_ONE_ONE else f"{_AXIS[control]} doublet"
            steps.append(Step(name, control, size, unit_s, pattern))
    return steps


def _excursion_rad(
    model: LinearModel, control: str, unit_s: float, pattern: tuple[tuple[int, float], ...]
) -> float:
    """Greatest angle [rad] that a unit of the control reaches during the steps, bank counted a third."""
    n = len(STATES)
    column = model.B[:, [model.controls.index(control)]]
    both = np.zeros((n + 1, n + 1))
    both[:n, :n], both[:n, n:] = model.A, column
    step: NDArray[np.float64] = expm(both * _DT_S)
    x, greatest = np.zeros(n), 0.0
    V = model.trim.condition.V_mps
    weight = {"v": 1.0 / V, "w": 1.0 / V, "phi": 1.0 / _BANK, "theta": 1.0}
    weights = np.array([weight.get(name, 0.0) for name in STATES])
    for units, sign in pattern:
        for _ in range(round(units * unit_s / _DT_S)):
            x = step[:n, :n] @ x + step[:n, n] * sign
            greatest = max(greatest, float(np.max(np.abs(weights * x))))
    return greatest


def _events(aircraft: Aircraft, steps: list[Step], restarting: bool) -> str:
    out, time = [], SETTLE_S
    half = aircraft.dt_s / 2.0  # early, so that rounding of the clock cannot shift it by a frame
    for number, step in enumerate(steps, start=1):
        out.append(
            _event(time - half, step.name, f'<set name="{MANOEUVRE_PROPERTY}" value="{number}"/>')
        )
        before, name = 0.0, aircraft.card.inputs[step.control].property
        for units, sign in (*step.pattern, (0, 0.0)):
            change = (
                f'<set name="{name}" type="FG_DELTA" value="{step.size * (sign - before):.9g}"/>'
            )
            out.append(_event(time - half, f"{time:.2f} s, {step.control}", change))
            if restarting:
                out.append(_restart(time, aircraft.dt_s))
            before, time = sign, time + units * step.unit_s
        time += REST_S
    return "".join(out)


def _restart(time_s: float, dt_s: float) -> str:
    """Begin Adams and Bashforth's rule anew at a step of a control, by one frame of Euler's.

    The rule extrapolates accelerations from the frame before. Across a jump of a surface that is half a frame of a motion that
    no aircraft makes: the rates of all later rows answer half a frame early, the row of the step itself does not.
    """
    out = []
    for frames, rule, name in ((0.5, _EULER, "begin anew"), (1.5, None, "go on")):
        changes = "\n      ".join(
            f'<set name="{rate}" value="{SECOND_ORDER[rate] if rule is None else rule:g}"/>'
            for rate in _RATES
        )
        out.append(_event(time_s + frames * dt_s, f"{time_s:.2f} s, {name}", changes))
    return "".join(out)


def _event(time_s: float, name: str, change: str) -> str:
    return (
        f'    <event name="{name}">\n      <condition>simulation/sim-time-sec ge {time_s:.5f}</condition>\n'
        f"      {change}\n    </event>\n"
    )
