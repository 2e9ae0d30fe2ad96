"""What a terminal is told while a command works; a pipe is told warnings, and of long commands a line now and then."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Progress as Bar
from rich.text import Text

from sysid.terminal import drawing, visible

if TYPE_CHECKING:
    from uqharness.campaign import Progress


class _Counted(ProgressColumn):
    """How many of something are done since the line began, asked for at each drawing; empty before the first."""

    def __init__(self, count: Callable[[], int], unit: str) -> None:
        super().__init__()
        self._count, self._unit, self._before = count, unit, count()

    def render(self, task: Task) -> Text:
        """The number and its unit."""
        done = self._count() - self._before
        return Text(f"{done:,} {self._unit}" if done else "")


@contextmanager
def working(
    command: str,
    count: Callable[[], int] | None = None,
    unit: str = "segments flown",
    *,
    keep: bool = False,
    lines_s: float = math.inf,
    console: Console | None = None,
) -> Iterator[Callable[[str], None]]:
    """A line that moves while a command works: its stage, the time since the command began, and a count.

    Parameters
    ----------
    command
        What the line begins with.
    count, unit
        Gives a number that grows with the work; None shows none.
    keep
        Whether each finished stage leaves a line with the time that it took.
    lines_s
        Seconds between two lines of their own where that is no terminal; by default there are none.
    console
        Where to draw; by default standard error.

    Yields a function that is told each stage.
    """
    shown = console or Console(stderr=True, file=drawing(sys.stderr))
    if not shown.is_terminal:
        yield _Lines(command, lines_s, shown)
        return
    columns = [SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()]
    columns += [] if count is None else [_Counted(count, unit)]
    # Other output is not drawn through the bar: it may hold a log's own words, and those pass the terminal's filter alone.
    with Bar(
        *columns, console=shown, transient=True, redirect_stdout=False, redirect_stderr=False
    ) as bar:
        task = bar.add_task(command, total=None)
        current, begun = "", time.monotonic()

        def stage(text: str) -> None:
            nonlocal current, begun
            if _without_numbers(text) != _without_numbers(current):
                if keep and current:
                    line = f"{command}: {visible(current)} ({clock(time.monotonic() - begun)})"
                    bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
                begun = time.monotonic()
            current = text
            bar.update(
                task, description=f"{command}: {visible(text)}" if text else command, refresh=True
            )

        yield stage
        stage("")


class _Lines:
    """Told each stage, writes a line when the last is ``seconds`` old: the time since the command began, and the stage."""

    def __init__(self, command: str, seconds: float, console: Console) -> None:
        self._command, self._seconds, self._console = command, seconds, console
        self._begun = self._last = time.monotonic()

    def __call__(self, text: str) -> None:
        now = time.monotonic()
        if now - self._last >= self._seconds:
            self._last = now
            line = f"{self._command}: {clock(now - self._begun)}, {visible(text)}"
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)


def _without_numbers(text: str) -> str:
    """A stage that only counts on is the same stage."""
    return re.sub(r"\d+", "", text)


def say_line(text: object) -> None:
    """A line of its own."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)


def say_warnings(warnings: Iterable[str]) -> None:
    """A line each on standard error, in a pipe too; on a terminal in place of a line that moves."""
    for text in warnings:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=drawing(sys.stderr))
        print(f"uqharness: warning: {text}", file=sys.stderr)


@contextmanager
def counting(what: str) -> Iterator[Callable[[float, int], None]]:
    """A counter with an estimate of the time to go: call it with how many are done, parts included, and how many there are."""
    terminal = sys.stderr.isatty()
    begun = time.monotonic()

    def update(done: float, total: int) -> None:
        if terminal:
            left = time_left(time.monotonic() - begun, done, total)
            text = f"\r\x1b[K{visible(what)}: {math.floor(done)} of {total}" + (
                f", {left}" if left else ""
            )
            print(text, end="", file=drawing(sys.stderr), flush=True)

    yield update
    if terminal:
        print(file=sys.stderr)


def time_left(elapsed_s: float, done: float, total: int) -> str:
    """``0:12 to go`` if the rest goes as fast as what is done; empty before anything and after everything is done."""
    return f"{clock(elapsed_s * (total - done) / done)} to go" if 0.0 < done < total else ""


class ProgressView:
    """Context whose ``update`` is a campaign's ``on_progress``: finished cases, time to go, speed, failures so far."""

    def __init__(self, console: Console | None = None) -> None:
        # The bar moves the cursor itself; what it writes beside it holds no text of anybody's.
        self._console = console or Console(stderr=True, file=drawing(sys.stderr))
        self._bar: Bar | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> ProgressView:
        if self._console.is_terminal:
            self._bar = Bar(
                TextColumn("flights"),
                BarColumn(bar_width=None),
                MofNCompleteColumn(),
                TextColumn("{task.fields[note]}"),
                console=self._console,
            )
            self._bar.start()
            self._task = self._bar.add_task("flights", total=None, note="checking the model")
        return self

    def update(self, progress: Progress) -> None:
        """Show a state; counts only what is on the disk."""
        if self._bar is not None and self._task is not None:
            self._bar.update(
                self._task, total=progress.cases, completed=progress.done, note=describe(progress)
            )

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def describe(progress: Progress) -> str:
    """What stands beside the bar."""
    eta = progress.eta_s
    parts = ["" if eta is None else f"{clock(eta)} to go"]
    if progress.flown_s > 0:
        parts.append(f"{progress.hours_per_core_hour:.0f} flight h per core h")
    parts.append(f"{progress.failed} failed" if progress.failed else "none failed")
    return ", ".join(part for part in parts if part)


def clock(seconds: float) -> str:
    """``h:mm:ss`` or ``m:ss``."""
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, second = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{second:02d}" if hours else f"{minutes}:{second:02d}"
