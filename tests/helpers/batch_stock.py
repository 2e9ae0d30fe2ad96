"""The systems of a whole aircraft: flown by JSBSim with its other models, and by their translation
fed with what those models gave.

A system put before all others copies every property that the systems read and do not write, at the
place of the frame where they read it, and what it was one run before, which tells the first of the
two initialising frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.helpers.batch_flyers import flyer_of
from tests.helpers.batch_systems import Pair, flown_once, values_of
from uqharness.batch.ir import Value
from uqharness.batch.program import Feed, Stream, initial_state
from uqharness.batch.translate.channels import System, Systems
from uqharness.batch.translate.frame import CHANNEL_STEP, Frame, canonical
from uqharness.files import scratch_folder
from uqharness.simulator import Aircraft, Staging, engine, staged
from uqharness.simulator.staging import copy_staging
from uqharness.xml.document import parse_document

DT_S = 1.0 / 120.0
COMMANDS = tuple(
    f"fcs/{name}-cmd-norm"
    for name in ("aileron", "elevator", "rudder", "flap", "speedbrake", "throttle")
)
_START = {"ic/h-sl-ft": 5000.0, "ic/vc-kts": 120.0, "ic/gamma-deg": 0.0, "ic/phi-deg": 5.0}


class _Reading(Frame):
    """Remembers which properties are read."""

    def __init__(self, fdm: Any) -> None:
        super().__init__(DT_S, values_of(fdm), None)
        self.asked: set[str] = set()

    def read(self, name: str) -> Value | None:
        if canonical(name) not in self.live:
            self.asked.add(canonical(name))
        return super().read(name)


@dataclass(frozen=True)
class _Flown:
    """What JSBSim had: inputs (frames, inputs), in the first initialising frame ``first``; outputs
    (frames, outputs).
    """

    first: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


def flown_by_both(aircraft: Aircraft, parts: Sequence[System], frames: int, seed: int = 1) -> Pair:
    """Written properties from the last initialising frame on, with commands that change every 20
    frames.
    """
    fdm = _start_flight(staged(aircraft))
    manager = fdm.get_property_manager()
    systems = Systems(parts, DT_S, fdm.get_propulsion().get_num_engines())
    reading = _Reading(fdm)
    systems.trace(reading)
    inputs = sorted(
        n for n in reading.asked - reading.writes if n != CHANNEL_STEP and manager.hasNode(n)
    )
    result = sorted(n for n in reading.writes if manager.hasNode(n))
    values = values_of(fdm)
    traced = [Frame(step, values, reading.writes | set(inputs)) for step in (0.0, 0.0, DT_S)]
    for number, frame in enumerate(traced):
        systems.trace(frame, first=number == 0)
    for name in result:
        values.setdefault(name)
    theirs = _by_jsbsim(aircraft, inputs, result, frames, seed)
    ours = _by_translation(traced, inputs, result, theirs)
    return Pair(
        dict(zip(result, theirs.outputs.T.copy(), strict=True)),
        dict(zip(result, ours.T.copy(), strict=True)),
    )


def _start_flight(staging: Staging) -> Any:
    fdm = engine.open_fdm(staging, DT_S)
    for name, value in _START.items():
        fdm[name] = value
    return fdm


def _by_jsbsim(
    aircraft: Aircraft, arguments: list[str], result: list[str], frames: int, seed: int
) -> _Flown:
    copies = "".join(
        "<fcs_function"
        f' name="probe/now-{k}"><function><p>{name}</p></function></fcs_function><actuator'
        f' name="probe/before-{k}"><input>{name}</input><delay type="frames">2</delay></actuator>'
        for k, name in enumerate(arguments)
    )
    with scratch_folder("probe") as scratch:
        staging = copy_staging(staged(aircraft), Path(scratch.path) / "root")
        raw = staging.xml.read_bytes()
        begin = parse_document(staging.xml, raw).root.open_end
        probe = f'<system name="probe"><channel name="probe">{copies}</channel></system>'
        staging.xml.write_bytes(raw[:begin] + probe.encode() + raw[begin:])
        fdm = _start_flight(staging)
    engine.run_ic(fdm)
    manager = fdm.get_property_manager()
    commands = [name for name in COMMANDS if manager.hasNode(name) and name not in result]
    current, before = (
        [engine.handle(fdm, f"probe/{when}-{k}") for k in range(len(arguments))]
        for when in ("now", "before")
    )
    out = [engine.handle(fdm, name) for name in result]
    rng = np.random.default_rng(seed)
    inputs, outputs = np.empty((frames + 1, len(arguments))), np.empty((frames + 1, len(result)))
    first = np.array([node.get_double_value() for node in before])
    for frame in range(frames + 1):
        if frame % 20 == 1:
            for name in commands:
                fdm[name] = float(rng.random())
        if frame:
            fdm.run()
        inputs[frame] = [node.get_double_value() for node in current]
        outputs[frame] = [node.get_double_value() for node in out]
    return _Flown(first, inputs, outputs)


def _by_translation(
    traced: Sequence[Frame], inputs: list[str], result: list[str], theirs: _Flown
) -> np.ndarray:
    state: dict[str, float] = {}
    for frame, row in zip(traced[:2], (theirs.first, theirs.inputs[0]), strict=True):
        state.update(zip(inputs, row.tolist(), strict=True))
        state.update(flown_once(frame.program(()), state))
    flyer = flyer_of(
        traced[2].program(result, [Stream("given", tuple(inputs))]), len(theirs.inputs) - 1
    )
    constant = initial_state(
        flyer.program,
        1,
        {name: value for name, value in state.items() if name in flyer.program.slots},
    )
    table = np.ascontiguousarray(theirs.inputs[1:])
    records = flyer.fly(
        constant, 1, len(table), {"given": Feed(table, 0, np.zeros(1, dtype=np.int64))}
    )
    begin = [state.get(name, traced[2].values[name]) for name in result]
    return np.vstack([begin, records[:, 0].T])
