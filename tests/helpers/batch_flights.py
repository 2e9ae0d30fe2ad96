"""Small aircraft flown by JSBSim and by their translation, frame by frame, with properties that the
host sets before each frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.batch_flyers import flyer_of
from tests.helpers.batch_systems import Series
from uqharness.batch.mission import initial_values
from uqharness.batch.motion import CONDITIONS, start_state
from uqharness.batch.program import Feed, Program, Stream, initial_state, slot
from uqharness.batch.streams import Turbulence
from uqharness.batch.translate.channels import Sources, read_sources
from uqharness.batch.translate.flight import Flight, TraceRequest, trace_flight
from uqharness.batch.translate.frame import Values, is_constant
from uqharness.batch.winds import NORMALS
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.staging import Staging

DT_S = 0.01
METRICS = """<metrics><wingarea unit="FT2">10</wingarea><wingspan unit="FT">10</wingspan><chord unit="FT">1</chord>
<location name="AERORP" unit="IN"><x>1</x><y>0</y><z>2</z></location>
<location name="EYEPOINT" unit="IN"><x>-10</x><y>3</y><z>5</z></location></metrics>"""
MASS = """<mass_balance><ixx unit="SLUG*FT2">4</ixx><iyy unit="SLUG*FT2">6</iyy><izz unit="SLUG*FT2">8</izz>
<ixz unit="SLUG*FT2">.3</ixz><emptywt unit="LBS">47</emptywt>
<location name="CG" unit="IN"><x>0</x><y>.1</y><z>0</z></location></mass_balance>"""
START: Mapping[str, float] = {
    "ic/lat-geod-rad": 0.875,
    "ic/long-gc-rad": 0.5,
    "ic/h-sl-ft": 1500.0,
    "ic/psi-true-rad": 1.25,
    "ic/theta-rad": 0.125,
    "ic/phi-rad": 0.375,
    "ic/u-fps": 70.0,
    "ic/v-fps": 3.0,
    "ic/w-fps": 2.0,
    "ic/p-rad_sec": 0.25,
    "ic/q-rad_sec": -0.125,
    "ic/r-rad_sec": 0.0625,
}
"""A start that 44 bits hold."""


def aircraft(
    body: str, metrics: str = METRICS, mass: str = MASS, ground: str = "<ground_reactions/>"
) -> str:
    """The XML of an aircraft; ``body`` has its systems, forces and aerodynamics."""
    head = '<?xml version="1.0"?>\n<fdm_config name="point" version="2.0" release="ALPHA">'
    return f"{head}{metrics}{mass}{ground}\n{body}\n</fdm_config>\n"


def script(events: str) -> str:
    """A run script with these events."""
    return (
        '<?xml version="1.0"?>\n<runscript name="s"><use aircraft="point" initialize="start"/>'
        f'<run start="0" end="1e9" dt="{DT_S}">\n{events}\n</run></runscript>\n'
    )


@dataclass(frozen=True)
class Craft:
    """An aircraft on disk, ready for both.

    ``start`` are JSBSim's initial conditions and other settings.
    """

    root: Path
    start: Mapping[str, float]

    @property
    def script(self) -> Path:
        return self.root / "script.xml"

    def open(self) -> Any:
        """Loaded and set, nothing run."""
        fdm = engine.open_script(Staging(self.root, "point"), self.script, DT_S)
        for name, value in self.start.items():
            engine.set_property(fdm, name, value)
        return fdm

    def sources(self) -> Sources:
        return read_sources(find_aircraft(self.root / "aircraft" / "point"), self.script)


@contextmanager
def craft(
    text: str,
    start: Mapping[str, float] = START,
    events: str = "",
    files: Mapping[str, str] | None = None,
) -> Iterator[Craft]:
    """The aircraft in a scratch folder; ``files`` are others of its folder."""
    with scratch_folder("craft") as scratch:
        folder = scratch.path / "aircraft" / "point"
        for place in (folder, scratch.path / "engine", scratch.path / "systems"):
            place.mkdir(parents=True)
        (folder / "point.xml").write_text(text)
        (folder / "start.xml").write_text(
            '<?xml version="1.0"?><initialize name="start"></initialize>'
        )
        for name, content in (files or {}).items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(content)
        (scratch.path / "script.xml").write_text(script(events))
        yield Craft(scratch.path, start)


def translated(
    result: Craft, records: Sequence[str], inputs: Sequence[str] = (), varying: Sequence[str] = ()
) -> Flight:
    """The programs; ``inputs`` are fed, ``varying`` differ between lanes. Raises BadInputError."""
    sources = result.sources()
    values = Values(initial_values(result.open), is_constant)
    fed = [Stream("inputs", tuple(inputs))] if inputs else []
    return trace_flight(sources, DT_S, values, TraceRequest(varying, fed, records))


def refused(text: str, events: str = "", files: Mapping[str, str] | None = None) -> str:
    """What is said of an aircraft that is not supported."""
    with craft(text, events=events, files=files) as result, pytest.raises(BadInputError) as error:
        translated(result, [])
    return str(error.value)


def by_jsbsim(
    fdm: Any, inputs: Series, records: Sequence[str], frames: int
) -> dict[str, np.ndarray]:
    """What JSBSim has behind its initialising frames and behind each frame; the host sets row k
    before frame k.
    """
    engine.run_ic(fdm)
    sets = [(engine.handle(fdm, name), values) for name, values in inputs.items()]
    gets = [engine.handle(fdm, name) for name in records]
    out = np.empty((len(records), frames + 1))
    for row in range(frames + 1):
        if row:
            for node, values in sets:
                node.set_double_value(float(values[row]))
            fdm.run()
        out[:, row] = [node.get_double_value() for node in gets]
    return dict(zip(records, out, strict=True))


def started(
    flight: Flight, conditions: Mapping[str, float], settings: Mapping[str, float] | None = None
) -> dict[str, np.ndarray]:
    """Slots of one lane behind the initialising frames."""
    values = start_state({name: np.array([conditions[name]]) for name in CONDITIONS})
    values |= {name: np.array([value]) for name, value in (settings or {}).items()}
    for program in (flight.first, flight.second):
        values |= flown(program, values, 1)[0]
    return values


def flown(
    program: Program,
    values: Mapping[str, np.ndarray],
    frames: int,
    feeds: Mapping[str, Feed] | None = None,
    first: int = 1,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The slots of one lane behind ``frames`` frames, and the records (records, frames)."""
    flyer = flyer_of(program, frames)
    state = initial_state(
        flyer.program,
        1,
        {name: value for name, value in values.items() if name in flyer.program.slots},
    )
    records = flyer.fly(state, first, frames, feeds)
    return {name: slot(flyer.program, state, name, 1) for name in flyer.program.slots}, records[
        :, 0
    ]


def by_batch(
    result: Craft, inputs: Series, records: Sequence[str], frames: int
) -> dict[str, np.ndarray]:
    """The same by the translation."""
    fdm = result.open()
    flight = translated(result, records, list(inputs))
    begin = {name: float(values[0]) for name, values in inputs.items()}
    # JSBSim takes the wind of its initial conditions, which may be a rounding of nothing.
    begin |= {
        f"atmosphere/wind-{axis}-fps": float(fdm[f"ic/vw-{axis}-fps"])
        for axis in ("north", "east", "down")
    }
    values = started(flight, {name: float(fdm[name]) for name in CONDITIONS}, begin)
    feeds = {}
    if inputs:
        table = np.ascontiguousarray(
            np.stack([values[1:] for values in inputs.values()], axis=1), dtype=np.float64
        )
        feeds["inputs"] = Feed(table, 0, np.zeros(1, dtype=np.int64))
    if NORMALS in flight.frame.streams:
        rows = Turbulence(int(result.start.get("atmosphere/randomseed", 0))).rows(max(frames, 1))
        feeds[NORMALS.name] = Feed(rows.array, 0, np.zeros(1, dtype=np.int64))
    before = {
        name: values[name][0] if name in values else flight.frame.slots[name]
        for name in flight.frame.records
    }
    _, rows = flown(flight.frame, values, frames, feeds)
    return {
        name: np.concatenate([[before[c]], rows[k]])
        for k, (name, c) in enumerate(zip(records, flight.frame.records, strict=True))
    }


def apart(theirs: Series, ours: Series, floor: float = 1e-3) -> dict[str, float]:
    """The largest difference of each property over its largest size (at least ``floor``); NaN on
    one side is infinite.
    """
    out = {}
    for name, present in theirs.items():
        local = ours[name]
        same = (present == local) | (np.isnan(present) & np.isnan(local))
        with np.errstate(invalid="ignore"):
            gap = np.where(same, 0.0, np.abs(present - local))
        finite = np.abs(present[np.isfinite(present)])
        out[name] = float(
            np.max(np.where(np.isnan(gap), np.inf, gap))
            / max(floor, finite.max() if finite.size else 0.0)
        )
    return out


def compared(
    text: str,
    records: Sequence[str],
    inputs: Series | None = None,
    frames: int = 20,
    start: Mapping[str, float] = START,
    events: str = "",
    changed: str | None = None,
    changed_events: str | None = None,
    floor: float = 1e-3,
) -> dict[str, float]:
    """Differences of an aircraft flown by both.

    ``changed``: what is translated instead, for a negative control.
    """
    inputs = inputs or {}
    with craft(text, start, events) as result:
        fdm = result.open()
        for name, values in inputs.items():
            fdm[name] = float(values[0])
        theirs = by_jsbsim(fdm, inputs, records, frames)
        if changed is None and changed_events is None:
            return apart(theirs, by_batch(result, inputs, records, frames), floor)
    with craft(
        changed or text, start, events if changed_events is None else changed_events
    ) as result:
        return apart(theirs, by_batch(result, inputs, records, frames), floor)


def worst(result: Mapping[str, float]) -> float:
    """The largest of the differences."""
    return max(result.values())
