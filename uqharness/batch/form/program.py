"""A flight as a program: sections that run in the order of a frame over slots of state, streams that feed slots, slots recorded.

A section is a ``Function`` that loads and stores slots; between sections values pass through slots alone. Frames are counted from
1. All lanes run in lockstep; a section may run in every n-th frame, in one frame, or in lanes whose mask slot is not 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from uqharness.batch.form.ir import Function


@dataclass(frozen=True)
class When:
    """When a section runs: in frames k with k % ``every`` == 0, or in frame ``at`` alone; and only in lanes where slot ``mask`` is
    not 0: the others keep what they have."""

    every: int = 1
    at: int | None = None
    mask: str | None = None


@dataclass(frozen=True)
class Section:
    """A part of a frame. ``function`` has no inputs and no outputs: it loads slots and stores slots. ``name`` is for messages."""

    name: str
    function: Function
    when: When = field(default_factory=When)


@dataclass(frozen=True)
class Stream:
    """Numbers from outside: rows of ``columns``, which are put into the slots of those names at the begin of a frame.

    A row is taken in frames k with k % ``every`` == 0. Its number is k // every - 1, or, with ``counter``, what stands in that
    slot at the begin of the frame, for each lane its own (a whole number, 0 or more). Lanes share rows: each lane has its offset in
    the stream's array (``form.flying.Feed``).
    """

    name: str
    columns: tuple[str, ...]
    every: int = 1
    counter: str | None = None


@dataclass(frozen=True)
class Program:
    """A frame of a flight.

    sections  in the order in which they run
    slots     names of the state to their value before the first frame (a lane's own values replace it)
    streams   what is fed
    records   slots that are recorded behind a frame
    prelude   computed once before the frames of a call, from slots that no frame changes, into slots that only it stores
    """

    sections: tuple[Section, ...]
    slots: Mapping[str, float]
    streams: tuple[Stream, ...] = ()
    records: tuple[str, ...] = ()
    prelude: Function | None = None
