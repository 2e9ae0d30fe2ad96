"""Represent a flight as a program over slots of state, and lay out lanes in memory.

A program has sections, which run in order in every frame; streams, which feed slots from arrays;
and records, slots whose values are kept. A section is a `Function` that loads and stores slots;
values pass between sections through slots only. Frames count from 1. All lanes run in lockstep; a
section may run in every n-th frame, in one frame, or only in lanes where its mask is set.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, NamedTuple, Protocol

import numpy as np

from uqharness.batch.ir import Function


@dataclass(frozen=True)
class When:
    """When a section runs.

    Attributes
    ----------
    every : int
        In frames k with k % every == 0.
    at : int or None
        In this frame only.
    mask : str or None
        Slot that must not be 0; lanes where it is 0 keep their state.
    """

    every: int = 1
    at: int | None = None
    mask: str | None = None


@dataclass(frozen=True)
class Section:
    """Part of a frame.

    ``function`` has no inputs and no outputs: it loads and stores slots. ``name`` is for messages.
    """

    name: str
    function: Function
    when: When = field(default_factory=When)


@dataclass(frozen=True)
class Stream:
    """Numbers from an array that are put into slots at the start of a frame.

    Attributes
    ----------
    name : str
        Name of the stream.
    columns : tuple of str
        Slot of each column.
    every : int
        A row is read in frames k with k % every == 0.
    counter : str or None
        Slot with the number of the row, an integer >= 0 for each lane. None: row k // every - 1.

    Lanes share rows: each lane has its offset into the array (`Feed`).
    """

    name: str
    columns: tuple[str, ...]
    every: int = 1
    counter: str | None = None


@dataclass(frozen=True)
class Program:
    """One frame of a flight.

    Attributes
    ----------
    sections : tuple of Section
        In the order in which they run.
    slots : mapping
        Name of each slot -> its value before the first frame; lanes may have other values.
    streams : tuple of Stream
        Sources of numbers.
    records : tuple of str
        Slots that are recorded after a frame.
    prelude : Function or None
        Computed once before the frames of a call, from slots that no frame changes, into slots that
        no section stores.
    """

    sections: tuple[Section, ...]
    slots: Mapping[str, float]
    streams: tuple[Stream, ...] = ()
    records: tuple[str, ...] = ()
    prelude: Function | None = None


# Calls of a program. The state has shape (blocks, slots, BLOCK): slot ``row`` of lane ``l`` is at
# ``[l // BLOCK, row, l % BLOCK]``. Records have shape (channels, blocks * BLOCK, times), so a
# lane's channel is contiguous.

BLOCK = 8
"""Lanes that are adjacent in memory; a multiple of every vector width."""


class Feed(NamedTuple):
    """Numbers of a stream. Row r of lane l is ``array[offsets[l] + r - first_row]``.

    Attributes
    ----------
    array : array (rows, columns)
        Doubles.
    first_row : int
        Number of the row at each lane's offset.
    offsets : array (lanes,)
        Row of ``array``, int64; lanes may share rows.
    rows : int or None
        Rows of each lane from its offset on; None: as many as every lane has to the end of
        ``array``.

    A row outside these is an error before the call; with a counter it is NaN.
    """

    array: np.ndarray
    first_row: int
    offsets: np.ndarray
    rows: int | None = None


Feeds = Mapping[str, Feed | tuple[np.ndarray, int, np.ndarray]]


class Flyer(Protocol):
    """A program that can be flown, compiled or interpreted."""

    @property
    def program(self) -> Program:
        """The program."""

    def fly(
        self,
        state: np.ndarray,
        first_frame: int,
        frames: int,
        streams: Feeds | None = None,
        stride: int = 1,
    ) -> np.ndarray:
        """Fly frames and return the records.

        Parameters
        ----------
        state : array (blocks, slots, BLOCK)
            Changed in place.
        first_frame, frames : int
            First frame (from 1) and number of frames.
        streams : mapping, optional
            Name of each stream -> Feed.
        stride : int
            Frames that it divides are recorded.

        Returns
        -------
        array (records, lanes, times)
        """


@dataclass(frozen=True)
class Call:
    """A checked call: feeds in the order of the program's streams, and an empty array for the
    records.
    """

    feeds: tuple[Feed, ...]
    records: np.ndarray


def check_call(
    program: Program,
    state: np.ndarray,
    first_frame: int,
    frames: int,
    streams: Feeds | None,
    stride: int,
) -> Call:
    """Check the arguments of ``fly``; see `Flyer.fly`.

    Raises ValueError for arrays of wrong shapes, missing rows, and streams without numbers.
    """
    if state.ndim != 3 or state.shape[1:] != (len(program.slots), BLOCK):
        raise ValueError(
            f"the state has shape (blocks, {len(program.slots)}, {BLOCK}); received {state.shape}"
        )
    if state.dtype != np.float64 or not state.flags.c_contiguous or not state.flags.writeable:
        raise ValueError("the state is an array of doubles in one piece that can be written")
    if first_frame < 1 or frames < 0 or stride < 1:
        raise ValueError(
            f"frames count from 1 and a stride is at least 1; received {first_frame}, {frames}"
            f" frames, stride {stride}"
        )
    # Exactly the program's streams must be fed.
    streams = streams or {}
    required = {stream.name for stream in program.streams}
    if set(streams) != required:
        raise ValueError(
            f"streams {', '.join(sorted(required)) or 'none'} are needed; received"
            f" {', '.join(sorted(streams)) or 'none'}"
        )
    lanes, last = state.shape[0] * BLOCK, first_frame + frames - 1
    feeds = tuple(
        _check_feed(s, Feed(*streams[s.name]), lanes, first_frame, last) for s in program.streams
    )
    # Number of frames that the stride divides.
    times = last // stride - (first_frame - 1) // stride
    return Call(feeds, np.empty((len(program.records), lanes, times)))


def _check_feed(stream: Stream, feed: Feed, lanes: int, first: int, last: int) -> Feed:
    """Check the feed of one stream and pad its offsets to whole blocks."""
    name, columns = stream.name, len(stream.columns)
    array = feed.array
    if (
        array.ndim != 2
        or array.shape[1] != columns
        or array.dtype != np.float64
        or not array.flags.c_contiguous
    ):
        raise ValueError(
            f"stream {name}: doubles of shape (rows, {columns}) in one piece are needed; received"
            f" {array.shape}"
        )
    # Fewer offsets than lanes: the lanes that fill the last block share the last offset.
    lane_offsets = np.asarray(feed.offsets)
    if (
        lane_offsets.ndim != 1
        or not 0 < len(lane_offsets) <= lanes
        or lane_offsets.dtype.kind not in "iu"
    ):
        raise ValueError(
            f"stream {name}: a whole offset for each of up to {lanes} lanes is needed; received"
            f" {lane_offsets.shape}"
        )
    offsets = np.ascontiguousarray(
        np.concatenate([lane_offsets, np.full(lanes - len(lane_offsets), lane_offsets[-1])]).astype(
            np.int64
        )
    )
    # Every row of every lane must be inside the array, so that compiled code needs no checks.
    rows = len(array) - int(offsets.max()) if feed.rows is None else feed.rows
    if offsets.min() < 0 or rows < 0 or int(offsets.max()) + rows > len(array):
        raise ValueError(
            f"stream {name}: offsets {offsets.min()} to {offsets.max()} with {rows} rows leave the"
            f" {len(array)} rows given"
        )
    if stream.counter is not None and rows == 0:
        raise ValueError(f"stream {name}: a stream with a counter needs a row")
    # Without a counter the rows are known before the call.
    if stream.counter is None:
        lowest_row, highest_row = -(-first // stream.every) - 1, last // stream.every - 1
        if lowest_row <= highest_row and not (
            feed.first_row <= lowest_row and highest_row < feed.first_row + rows
        ):
            raise ValueError(
                f"stream {name}: frames {first} to {last} need rows {lowest_row} to {highest_row}; "
                f"each lane has {feed.first_row} to {feed.first_row + rows - 1}"
            )
    return Feed(array, int(feed.first_row), offsets, rows)


def to_blocks(rows: Sequence[np.ndarray], lanes: int) -> np.ndarray:
    """Arrange rows of lanes (or numbers) as (blocks, rows, BLOCK); the last block is padded with
    copies of the last lane.
    """
    blocks = -(-lanes // BLOCK)
    flat = np.empty((len(rows), blocks * BLOCK))
    for k, row in enumerate(rows):
        flat[k, :lanes] = row
    flat[:, lanes:] = flat[:, lanes - 1 : lanes]
    return np.ascontiguousarray(flat.reshape(len(rows), blocks, BLOCK).transpose(1, 0, 2))


def from_blocks(array: np.ndarray, lanes: int) -> list[np.ndarray]:
    """Return the rows (lanes,) of a blocked array."""
    return list(array.transpose(1, 0, 2).reshape(array.shape[1], array.shape[0] * BLOCK)[:, :lanes])


def initial_state(
    program: Program, lanes: int, values: Mapping[str, np.ndarray | float] | None = None
) -> np.ndarray:
    """Return the state before the first frame.

    Parameters
    ----------
    program : Program
        Its slots have default values.
    lanes : int
        Number of lanes.
    values : mapping, optional
        Slot -> number or array (lanes,) in place of the default.

    Returns
    -------
    array (blocks, slots, BLOCK)

    Raises
    ------
    ValueError
        For a slot that the program does not have.
    """
    values = values or {}
    unknown = [name for name in values if name not in program.slots]
    if unknown:
        raise ValueError(f"the program has no slot {', '.join(unknown)}")
    return to_blocks(
        [
            np.asarray(values.get(name, first), dtype=np.float64)
            for name, first in program.slots.items()
        ],
        lanes,
    )


def share_feed(pieces: Mapping[Any, np.ndarray], keys: Sequence[Hashable], first_row: int) -> Feed:
    """Join equally long ``pieces`` into one feed; ``keys`` name the piece of each lane."""
    rows = len(next(iter(pieces.values())))
    starts = {key: k * rows for k, key in enumerate(pieces)}
    array = np.ascontiguousarray(np.concatenate(list(pieces.values())))
    return Feed(array, first_row, np.array([starts[key] for key in keys], dtype=np.int64), rows)


def step_once(flyer: Flyer, values: Mapping[str, np.ndarray], lanes: int) -> dict[str, np.ndarray]:
    """Return every slot after one frame that starts with ``values``; slots that the program lacks
    are ignored.
    """
    program = flyer.program
    state = initial_state(
        program, lanes, {name: value for name, value in values.items() if name in program.slots}
    )
    flyer.fly(state, 1, 1)
    return dict(zip(program.slots, from_blocks(state, lanes), strict=True))


def slot(program: Program, state: np.ndarray, name: str, lanes: int) -> np.ndarray:
    """Return a copy of a slot's value in each lane."""
    row = list(program.slots).index(name)
    return np.ascontiguousarray(state[:, row, :]).reshape(-1)[:lanes]


def select_lanes(state: np.ndarray, lanes: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return the state of some lanes in the given order, padded to whole blocks."""
    picked = np.asarray(lanes, dtype=np.int64)
    full = np.concatenate([picked, np.full(-len(picked) % BLOCK, picked[-1])])
    return np.ascontiguousarray(
        state[full // BLOCK, :, full % BLOCK].reshape(-1, BLOCK, state.shape[1]).transpose(0, 2, 1)
    )


# Whether this installation can compile.


def available() -> str | None:
    """Return None if the batch engine can be used, else a sentence that says why not."""
    if find_spec("llvmlite") is None:
        return (
            "llvmlite is not installed, so JSBSim simulates the flights; pip install llvmlite for"
            " the batch engine"
        )
    return None
