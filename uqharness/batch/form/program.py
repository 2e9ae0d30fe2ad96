"""A flight as a program: sections that run in the order of a frame over slots of state, streams
that feed slots, slots recorded.

A section is a ``Function`` that loads and stores slots; between sections values pass through slots
alone. Frames are counted from 1. All lanes run in lockstep; a section may run in every n-th frame,
in one frame, or in lanes whose mask slot is not 0."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from uqharness.batch.form.ir import Function


@dataclass(frozen=True)
class When:
    """When a section runs: in frames k with k % ``every`` == 0, or in frame ``at`` alone; and only
    in lanes where slot ``mask`` is not 0: the others keep what they have."""

    every: int = 1
    at: int | None = None
    mask: str | None = None


@dataclass(frozen=True)
class Section:
    """A part of a frame. ``function`` has no inputs and no outputs: it loads slots and stores
    slots. ``name`` is for messages.
    """

    name: str
    function: Function
    when: When = field(default_factory=When)


@dataclass(frozen=True)
class Stream:
    """Numbers from outside: rows of ``columns``, which are put into the slots of those names at the
    begin of a frame.

    A row is taken in frames k with k % ``every`` == 0. Its number is k // every - 1, or, with
    ``counter``, what stands in that slot at the begin of the frame, for each lane its own (a whole
    number, 0 or more). Lanes share rows: each lane has its offset in the stream's array
    (``form.flying.Feed``)."""

    name: str
    columns: tuple[str, ...]
    every: int = 1
    counter: str | None = None


@dataclass(frozen=True)
class Program:
    """A frame of a flight.

    sections  in the order in which they run
    slots     names of the state to their value before the first frame (a lane's own values replace
    it) streams   what is fed records   slots that are recorded behind a frame prelude   computed
    once before the frames of a call, from slots that no frame changes, into slots that only it
    stores"""

    sections: tuple[Section, ...]
    slots: Mapping[str, float]
    streams: tuple[Stream, ...] = ()
    records: tuple[str, ...] = ()
    prelude: Function | None = None


# What flying a program needs whatever computes it: how lanes lie in memory, what streams are
# fed with, what is recorded.
#
# The state is an array of shape (blocks, slots, BLOCK), doubles: slot ``row`` of lane ``l`` is
# at ``[l // BLOCK, row, l % BLOCK]``. Records have the shape (channels, blocks * BLOCK, times):
# a lane's channel lies in one piece.

BLOCK = 8
"""Lanes that lie side by side in memory; the width of a vector divides it."""


class Feed(NamedTuple):
    """Numbers for a stream. Lane l's row r is ``array[offsets[l] + r - first_row]``.

    array      (rows, columns of the stream), doubles
    first_row  number of the row that stands at each lane's offset
    offsets    (lanes,), a row of ``array`` for each lane, int64; lanes may share
    rows       how many rows each lane has from its offset on; None: as many as every lane has to
    the end of ``array``

    A row that a lane does not have: an error before the call, or NaN where the row comes from a
    counter."""

    array: np.ndarray
    first_row: int
    offsets: np.ndarray
    rows: int | None = None


Feeds = Mapping[str, Feed | tuple[np.ndarray, int, np.ndarray]]


class Flyer(Protocol):
    """A program that can be flown: compiled, or by numpy."""

    @property
    def program(self) -> Program:
        """What is flown."""

    def fly(
        self,
        state: np.ndarray,
        first_frame: int,
        frames: int,
        streams: Feeds | None = None,
        stride: int = 1,
    ) -> np.ndarray:
        """Fly frames ``first_frame`` and on (from 1), ``state`` in place; the records of frames
        that ``stride`` divides.
        """


@dataclass(frozen=True)
class Call:
    """A call of ``fly``, checked: feeds in the order of the program's streams, and the array that
    takes the records.
    """

    feeds: tuple[Feed, ...]
    records: np.ndarray


def checked(
    program: Program,
    state: np.ndarray,
    first_frame: int,
    frames: int,
    streams: Feeds | None,
    stride: int,
) -> Call:
    """The call's feeds and an array for its records. Raises ValueError for arrays of other shapes,
    rows that are not there, streams without numbers."""
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
    streams = streams or {}
    wanted = {stream.name for stream in program.streams}
    if set(streams) != wanted:
        raise ValueError(
            f"streams {', '.join(sorted(wanted)) or 'none'} are needed; received"
            f" {', '.join(sorted(streams)) or 'none'}"
        )
    lanes, last = state.shape[0] * BLOCK, first_frame + frames - 1
    feeds = tuple(
        _checked_feed(s, Feed(*streams[s.name]), lanes, first_frame, last) for s in program.streams
    )
    times = last // stride - (first_frame - 1) // stride
    return Call(feeds, np.empty((len(program.records), lanes, times)))


def _checked_feed(stream: Stream, feed: Feed, lanes: int, first: int, last: int) -> Feed:
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
    given = np.asarray(feed.offsets)
    if given.ndim != 1 or not 0 < len(given) <= lanes or given.dtype.kind not in "iu":
        raise ValueError(
            f"stream {name}: a whole offset for each of up to {lanes} lanes is needed; received"
            f" {given.shape}"
        )
    offsets = np.ascontiguousarray(
        np.concatenate([given, np.full(lanes - len(given), given[-1])]).astype(np.int64)
    )
    rows = len(array) - int(offsets.max()) if feed.rows is None else feed.rows
    if offsets.min() < 0 or rows < 0 or int(offsets.max()) + rows > len(array):
        raise ValueError(
            f"stream {name}: offsets {offsets.min()} to {offsets.max()} with {rows} rows leave the"
            f" {len(array)} rows given"
        )
    if stream.counter is not None and rows == 0:
        raise ValueError(f"stream {name}: a stream with a counter needs a row")
    if stream.counter is None:
        least, most = -(-first // stream.every) - 1, last // stream.every - 1
        if least <= most and not (feed.first_row <= least and most < feed.first_row + rows):
            raise ValueError(
                f"stream {name}: frames {first} to {last} need rows {least} to {most}; "
                f"each lane has {feed.first_row} to {feed.first_row + rows - 1}"
            )
    return Feed(array, int(feed.first_row), offsets, rows)


def blocked(rows: Sequence[np.ndarray], lanes: int) -> np.ndarray:
    """Rows of lanes, or numbers, as (blocks, rows, BLOCK); the last block is filled up with copies
    of the last lane.
    """
    blocks = -(-lanes // BLOCK)
    flat = np.empty((len(rows), blocks * BLOCK))
    for k, row in enumerate(rows):
        flat[k, :lanes] = row
    flat[:, lanes:] = flat[:, lanes - 1 : lanes]
    return np.ascontiguousarray(flat.reshape(len(rows), blocks, BLOCK).transpose(1, 0, 2))


def unblocked(array: np.ndarray, lanes: int) -> list[np.ndarray]:
    """The rows back."""
    return list(array.transpose(1, 0, 2).reshape(array.shape[1], array.shape[0] * BLOCK)[:, :lanes])


def begun(
    program: Program, lanes: int, values: Mapping[str, np.ndarray | float] | None = None
) -> np.ndarray:
    """The state before the first frame: the program's values, those of ``values`` in their place,
    numbers or one for each lane. Raises ValueError for a slot that the program does not have."""
    values = values or {}
    strange = [name for name in values if name not in program.slots]
    if strange:
        raise ValueError(f"the program has no slot {', '.join(strange)}")
    return blocked(
        [
            np.asarray(values.get(name, first), dtype=np.float64)
            for name, first in program.slots.items()
        ],
        lanes,
    )


def shared(pieces: Mapping[Any, np.ndarray], keys: Sequence[Hashable], first_row: int) -> Feed:
    """One feed of equally long ``pieces``, each of which several lanes may share; ``keys`` name the
    piece of each lane.
    """
    rows = len(next(iter(pieces.values())))
    starts = {key: k * rows for k, key in enumerate(pieces)}
    array = np.ascontiguousarray(np.concatenate(list(pieces.values())))
    return Feed(array, first_row, np.array([starts[key] for key in keys], dtype=np.int64), rows)


def stepped(flyer: Flyer, values: Mapping[str, np.ndarray], lanes: int) -> dict[str, np.ndarray]:
    """Every slot of a program behind one frame that begins with ``values``; those that the program
    does not have are left out.
    """
    program = flyer.program
    state = begun(
        program, lanes, {name: value for name, value in values.items() if name in program.slots}
    )
    flyer.fly(state, 1, 1)
    return dict(zip(program.slots, unblocked(state, lanes), strict=True))


def slot(program: Program, state: np.ndarray, name: str, lanes: int) -> np.ndarray:
    """A slot's value in each lane, a copy."""
    row = list(program.slots).index(name)
    return np.ascontiguousarray(state[:, row, :]).reshape(-1)[:lanes]


def carried(state: np.ndarray, program: Program, other: Program) -> np.ndarray:
    """The state as the slots of another program, by name: how a program's start becomes that of the
    program behind a pass. Slots that ``program`` does not have begin with the other's values."""
    rows = {name: row for row, name in enumerate(program.slots)}
    out = np.empty((len(state), len(other.slots), BLOCK))
    for row, (name, first) in enumerate(other.slots.items()):
        out[:, row] = state[:, rows[name]] if name in rows else first
    return out


def chosen(state: np.ndarray, lanes: Sequence[int] | np.ndarray) -> np.ndarray:
    """The state of some lanes, in that order: how lanes that have ended are left out."""
    picked = np.asarray(lanes, dtype=np.int64)
    full = np.concatenate([picked, np.full(-len(picked) % BLOCK, picked[-1])])
    return np.ascontiguousarray(
        state[full // BLOCK, :, full % BLOCK].reshape(-1, BLOCK, state.shape[1]).transpose(0, 2, 1)
    )
