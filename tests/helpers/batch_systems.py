"""A ``<system>`` flown by JSBSim and by its translation, with inputs that the host sets before each
frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_flyers import flyer_of
from uqharness.batch.interpret import Interpreter
from uqharness.batch.program import Feed, Program, Stream, initial_state, slot
from uqharness.batch.translate.channels import System, Systems
from uqharness.batch.translate.frame import STEP, Frame, Values
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.xml.document import Document, parse_document

DT_S = 0.01
Series = Mapping[str, np.ndarray]


def declared(names: Sequence[str]) -> str:
    """Properties for inputs; those that a component makes are there."""
    return "".join(f"<property>{name}</property>" for name in names if name.startswith("i/"))


@dataclass(frozen=True)
class Pair:
    """Written property to its values behind the initialising frames and behind each frame, by
    JSBSim and by the translation.
    """

    theirs: Series
    ours: Series

    def apart(self) -> dict[str, int]:
        """How many values of each property do not have the same bits."""
        return {
            name: int(np.sum(~same_bits(self.theirs[name], self.ours[name])))
            for name in self.theirs
            if not same_bits(self.theirs[name], self.ours[name]).all()
        }

    def ulps(self) -> float:
        """The largest difference in units of the last place of JSBSim's value; 1e-300 and less
        counts as 0.
        """
        worst = 0.0
        for name, theirs in self.theirs.items():
            ours = self.ours[name]
            invalid = ~same_bits(theirs, ours) & ~(
                (np.abs(theirs) < 1e-300) & (np.abs(ours) < 1e-300)
            )
            if invalid.any():
                worst = max(
                    worst,
                    float(
                        np.max(np.abs(theirs - ours)[invalid] / np.spacing(np.abs(theirs[invalid])))
                    ),
                )
        return worst


def same_bits(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Where the bits are the same, or both are NaN."""
    return (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))


def document_of(body: str) -> Document:
    """The system as a file."""
    return parse_document(Path("system.xml"), f'<system name="probe">{body}</system>'.encode())


def values_of(fdm: Any) -> Values:
    """Values that properties have before the first frame."""
    manager = fdm.get_property_manager()
    return Values(lambda name: fdm[name] if manager.hasNode(name) else None)


def traced(
    parts: Sequence[System],
    values: Values,
    inputs: Sequence[str],
    dt_s: float = DT_S,
    engines: int = 0,
    any_step: bool = False,
) -> list[Frame]:
    """The two initialising frames and that of the flight.

    ``any_step``: the step is in slot STEP, not in the program.
    """
    systems = Systems(parts, dt_s, engines)
    every = Frame(dt_s, values, None, any_step=any_step)
    systems.trace(every)
    frames = [
        Frame(step, values, every.writes | set(inputs), (), any_step) for step in (0.0, 0.0, dt_s)
    ]
    for number, frame in enumerate(frames):
        systems.trace(frame, first=number == 0)
    return frames


def run(
    frames: Sequence[Frame], inputs: Series, records: Sequence[str], draws: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """What the translation makes of the inputs.

    The first row is there while initialising, each later one in its frame.
    """
    rows = len(next(iter(inputs.values())))
    table = np.ascontiguousarray(np.stack([inputs[name] for name in inputs], axis=1))
    streams = [Stream("inputs", tuple(inputs))]
    state: dict[str, float] = {name: float(table[0, k]) for k, name in enumerate(inputs)} | {
        STEP: DT_S
    }
    selected = 0
    for frame in frames[:2]:
        for name, _ in frame.draws:
            assert draws is not None
            state[name] = float(draws[selected])
            selected += 1
        state.update(flown_once(frame.program(()), state))
    flight = frames[2]
    feeds = {"inputs": Feed(table, 0, np.zeros(1, dtype=np.int64))}
    if flight.draws:
        assert draws is not None
        columns, series = _draw_rows(flight, draws[selected:], rows - 1)
        streams.append(Stream("draws", columns))
        feeds["draws"] = Feed(series, 0, np.zeros(1, dtype=np.int64))
    begin = {name: state.get(name, flight.values[name]) for name in records}
    feeds["inputs"] = Feed(np.ascontiguousarray(table[1:]), 0, np.zeros(1, dtype=np.int64))
    flyer = flyer_of(flight.program(records, streams), rows - 1)
    constant = initial_state(
        flyer.program, 1, {k: v for k, v in state.items() if k in flyer.program.slots}
    )
    result = flyer.fly(constant, 1, rows - 1, feeds)
    return {
        name: np.concatenate([[begin[name]], result[k, 0]])
        for k, name in enumerate(flyer.program.records)
    }


def flown_once(program: Program, state: Mapping[str, float]) -> dict[str, float]:
    """The state of one lane after one frame."""
    flyer = Interpreter(program)
    constant = initial_state(
        flyer.program, 1, {k: v for k, v in state.items() if k in flyer.program.slots}
    )
    flyer.fly(constant, 1, 1)
    return {name: float(slot(flyer.program, constant, name, 1)[0]) for name in flyer.program.slots}


def _draw_rows(frame: Frame, draws: np.ndarray, frames: int) -> tuple[tuple[str, ...], np.ndarray]:
    """Draws in the order of frames and, in a frame, of their places."""
    series = np.zeros((frames, len(frame.draws)))
    selected = 0
    for k in range(1, frames + 1):
        for column, (_, every) in enumerate(frame.draws):
            if k % every == 0:
                series[k - 1, column] = draws[selected]
                selected += 1
    return tuple(name for name, _ in frame.draws), series


def compared(
    body: str, inputs: Series, changed: str | None = None, draws: np.ndarray | None = None
) -> Pair:
    """The system flown by both. ``changed``: what is translated instead, for a negative control."""
    return _pairs(body, inputs, [body if changed is None else changed], draws)[0]


def judged(body: str, inputs: Series, engines: int = 0) -> tuple[dict[str, int], dict[str, int]]:
    """How many values differ, by property; and how many when the numbers behind ``@`` are moved by
    1e-12 of themselves.
    """
    plain = body.replace("@", "")
    moved = re.sub(
        r"@([-+.\d]+)", lambda result: repr(float(result.group(1)) * (1.0 + 1e-12)), body
    )
    assert moved != plain
    same, control = _pairs(plain, inputs, [plain, moved], None, engines)
    return same.apart(), control.apart()


def refusal(body: str, inputs: Sequence[str] = ("i/a", "i/b")) -> str:
    """What is said of a system that is not supported; the system begins in line 1."""
    document = document_of(body)
    values = Values(lambda name: 0.0 if name in inputs or name.startswith("fcs/") else None)
    with pytest.raises(BadInputError) as error:
        traced([System(document, document.root)], values, inputs)
    return str(error.value)


def random_inputs(frames: int = 3000, seed: int = 1) -> dict[str, np.ndarray]:
    """Noise in i/a, i/b, i/c with 0 among it; a switch i/on that changes now and then; steps in
    i/step.
    """
    rng = np.random.default_rng(seed)
    out = {
        name: rng.normal(size=frames) * size
        for name, size in (("i/a", 2.0), ("i/b", 1.0), ("i/c", 1.0))
    }
    for name in out:
        out[name][rng.integers(0, frames, frames // 50)] = 0.0
    out["i/on"] = np.repeat((rng.random(frames // 4 + 1) > 0.4).astype(float), 4)[:frames]
    out["i/step"] = np.repeat(rng.normal(size=frames // 60 + 1) * 2.0, 60)[:frames]
    return out


def _pairs(
    body: str, inputs: Series, ours: Sequence[str], draws: np.ndarray | None, engines: int = 0
) -> list[Pair]:
    text = declared(list(inputs))
    fdm = oracle.loaded(oracle.model(text + body, engines), DT_S, oracle.ENGINE_FILES)
    for name, series in inputs.items():
        fdm[name] = float(series[0])
    values = values_of(fdm)
    documents = [document_of(text + part) for part in ours]
    frames = [
        traced([System(document, document.root)], values, list(inputs), engines=engines)
        for document in documents
    ]
    records = sorted(set(frames[0][2].writes) - set(inputs))
    # A property is asked for once, before it has moved.
    for name in records:
        values.setdefault(name)
    theirs = by_jsbsim(fdm, inputs, records)
    return [Pair(theirs, run(result, inputs, records, draws)) for result in frames]


def by_jsbsim(fdm: Any, inputs: Series, records: Sequence[str]) -> dict[str, np.ndarray]:
    """What JSBSim has behind its initialising frames and behind each frame."""
    engine.run_ic(fdm)
    gets = [engine.handle(fdm, name) for name in records]
    sets = [(engine.handle(fdm, name), series.tolist()) for name, series in inputs.items()]
    rows = len(next(iter(inputs.values())))
    out = np.empty((len(records), rows))
    for row in range(rows):
        if row:
            for node, series in sets:
                node.set_double_value(series[row])
            fdm.run()
        out[:, row] = [node.get_double_value() for node in gets]
    return dict(zip(records, out, strict=True))
