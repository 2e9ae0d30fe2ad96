"""Progress of a command: a bar on a terminal, an occasional line in a pipe.

`working` and `ProgressView` draw on a terminal and set the stage of
`uqharness.heartbeat`, which prints it elsewhere.
"""

from __future__ import annotations

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

from sysid.display import cursor_stream, visible
from uqharness.heartbeat import STATE, Rate, bar_drawn, clock

if TYPE_CHECKING:
    from uqharness.campaign import Progress


class _Counted(ProgressColumn):
    """Column with the count since the line began; empty before the first."""

    def __init__(self, count: Callable[[], int], unit: str) -> None:
        super().__init__()
        self._count, self._unit, self._before = count, unit, count()

    def render(self, task: Task) -> Text:
        """Return the number and its unit."""
        done = self._count() - self._before
        return Text(f"{done:,} {self._unit}" if done else "")


class _TimeToGo(ProgressColumn):
    """Column with the remaining time where the command forecasts it."""

    def render(self, task: Task) -> Text:
        """Return the time."""
        return Text(STATE.time_to_go())


@contextmanager
def working(
    command: str,
    count: Callable[[], int] | None = None,
    unit: str = "segments simulated",
    *,
    keep: bool = False,
    console: Console | None = None,
) -> Iterator[Callable[[str], None]]:
    """Context that shows the stage, the elapsed time and a count while a command works.

    Parameters
    ----------
    command : str
        Prefix of the line.
    count, unit : callable and str
        A number that grows with the work; None shows none.
    keep : bool
        Whether each finished stage leaves a line with its duration.
    console : Console, optional
        Where to draw; by default standard error.

    Yields
    ------
    callable
        Called with the name of each stage.
    """
    console_used = console or Console(stderr=True, file=cursor_stream(sys.stderr))
    # In a pipe the heartbeat prints the stage now and then.
    if not console_used.is_terminal:

        def set_stage(text: str) -> None:
            number = 0 if count is None else count()
            STATE.stage = f"{text}, {number:,} {unit}" if number and text else text

        yield set_stage
        STATE.stage = ""
        return
    columns = [SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()]
    columns += [] if count is None else [_Counted(count, unit)]
    columns.append(_TimeToGo())
    # Other output is not redirected through the bar: it may contain text of a log, which must pass
    # the terminal's filter.
    with (
        bar_drawn(),
        Bar(
            *columns,
            console=console_used,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as bar,
    ):
        task = bar.add_task(command, total=None)
        current, stage_start_s = "", time.monotonic()

        def stage(text: str) -> None:
            nonlocal current, stage_start_s
            # A new stage, not a new count.
            if _without_numbers(text) != _without_numbers(current):
                if keep and current:
                    line = (
                        f"{command}: {visible(current)} ({clock(time.monotonic() - stage_start_s)})"
                    )
                    bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
                stage_start_s = time.monotonic()
            current = text
            bar.update(
                task, description=f"{command}: {visible(text)}" if text else command, refresh=True
            )

        yield stage
        stage("")


def _without_numbers(text: str) -> str:
    """Remove numbers: a stage that only counts on is the same stage."""
    return re.sub(r"\d+", "", text)


def print_warnings(warnings: Iterable[str]) -> None:
    """Print warnings to standard error, one per line, overwriting a progress line."""
    for text in warnings:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=cursor_stream(sys.stderr))
        print(f"uqharness: warning: {text}", file=sys.stderr)


class ProgressView:
    """Context whose ``update`` is the progress callback of a campaign.

    It shows finished cases, remaining time, speed and failures.
    """

    def __init__(self, console: Console | None = None) -> None:
        # The bar moves the cursor itself; its texts contain no foreign input.
        self._console = console or Console(stderr=True, file=cursor_stream(sys.stderr))
        self._bar: Bar | None = None
        self._task: TaskID | None = None
        self._rate = Rate()

    def __enter__(self) -> ProgressView:
        STATE.stage = "checking the model"
        if self._console.is_terminal:
            self._bar = Bar(
                TextColumn("flights"),
                BarColumn(bar_width=None),
                MofNCompleteColumn(),
                TextColumn("{task.fields[note]}"),
                console=self._console,
            )
            self._bar.start()
            STATE.bars += 1
            self._task = self._bar.add_task("flights", total=None, note="checking the model")
        return self

    def update(self, progress: Progress) -> None:
        """Show the progress; only stored flights count."""
        remaining_s = self._rate.seconds_left(
            progress.done - progress.done_before, progress.cases - progress.done_before
        )
        note = describe(progress, remaining_s)
        # The tables of a large campaign take a while after the last flight.
        ready = "; writing the tables" if progress.done == progress.cases else ""
        STATE.stage = f"{progress.done} of {progress.cases} flights, {note}{ready}"
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, total=progress.cases, completed=progress.done, note=note)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        STATE.stage = ""
        if self._bar is not None:
            STATE.bars -= 1
            self._bar.stop()


def describe(progress: Progress, eta: float | None = None) -> str:
    """Describe the progress; ``eta`` is the remaining time [s], by default at the mean rate of the
    run.
    """
    eta = progress.eta_s if eta is None else eta
    parts = ["" if eta is None or progress.done == progress.cases else f"{clock(eta)} to go"]
    if progress.flown_s > 0:
        parts.append(f"{progress.hours_per_core_hour:.0f} flight h per core h")
    parts.append(f"{progress.failed} failed" if progress.failed else "none failed")
    return ", ".join(part for part in parts if part)
