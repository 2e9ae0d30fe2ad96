"""Sign of life of a command or function that shows nothing else while it works.

After 4 s, `heartbeat` prints what is at work and for how long: on a terminal in a line that is
updated, in a pipe every 30 s, in a notebook in one line that is replaced. Progress bars
(`uqharness.cli.progress`) suppress it. UQHARNESS_QUIET=1 turns it off.
"""

from __future__ import annotations

import html
import math
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TextIO

from sysid.display import cursor_stream, visible

FIRST_S = 4.0
"""Time [s] before the first line; a command takes up to a second to start."""
EVERY_S = 30.0
"""Time [s] between two lines in a pipe."""
QUIET_VARIABLE = "UQHARNESS_QUIET"
_RECENT_S = 60.0
"""Time [s] of recent work that determines the time left."""


Callback = Callable[[str], object]
"""Receiver of the names of stages."""


def silent(stage: str) -> None:
    """Take the name of a stage and do nothing: the default of all callbacks."""


class Rate:
    """Rate of work over the last minute.

    The first seconds of a command compile and load; they say nothing about the remaining work.

    Parameters
    ----------
    time_source : callable
        Clock [s].
    """

    def __init__(self, time_source: Callable[[], float] = time.monotonic) -> None:
        self._now = time_source
        self._done: deque[tuple[float, float]] = deque([(time_source(), 0.0)])

    def seconds_left(self, done: float, total: float) -> float | None:
        """Return the time left [s]; None before anything is done and after everything is."""
        time_s, marks = self._now(), self._done
        # Work started anew: forget the old rate.
        if done < marks[-1][1]:
            marks.clear()
        if not marks or done > marks[-1][1]:
            marks.append((time_s, done))
            while len(marks) > 2 and marks[1][0] <= time_s - _RECENT_S:
                marks.popleft()
            # The first finished unit contains the start-up; omit it once there are others.
            if len(marks) > 2 and marks[0][1] == 0.0:
                marks.popleft()
        (start_s, start_done), (last_s, last_done) = marks[0], marks[-1]
        if not 0.0 < done < total or last_done <= start_done:
            return None
        per_unit = (last_s - start_s) / (last_done - start_done)
        return max(per_unit * (total - last_done) - (time_s - last_s), 0.0)


def counting(title: str, callback: Callback) -> Callable[[float, int], None]:
    """Return a function of the amount done and the total, which reports them with the time left."""
    rate = Rate()

    def update(done: float, total: int) -> None:
        remaining_s = rate.seconds_left(done, total)
        end = "" if remaining_s is None else f", {clock(remaining_s)} to go"
        callback(f"{title}: {math.floor(done)} of {total}{end}")

    return update


class Forecast:
    """Remaining time of a command whose stages have expected durations.

    Each finished stage corrects the durations of those that follow by the ratio of actual to
    expected time so far.

    Parameters
    ----------
    expected_s : mapping
        Stage -> expected duration [s], in order.
    time_source : callable
        Clock [s].
    """

    _PRIOR_S = 5.0
    """Expected time that counts as evidence for the durations as given."""

    def __init__(
        self, expected_s: Mapping[str, float], time_source: Callable[[], float] = time.monotonic
    ) -> None:
        self.expected_s = dict(expected_s)
        self._now = time_source
        self._stage, self._stage_start_s = "", time_source()
        self._actual_s: dict[str, float] = {}

    def expect(self, expected_s: Mapping[str, float]) -> None:
        """Replace the expected durations of stages that have not begun."""
        names = list(self.expected_s)
        reached = names.index(self._stage) + 1 if self._stage else 0
        self.expected_s |= {name: expected_s[name] for name in names[reached:]}

    def begin(self, stage: str) -> None:
        """Note that a stage begins; one that is repeated or unknown continues the current."""
        if stage == self._stage or stage not in self.expected_s:
            return
        time_s = self._now()
        if self._stage:
            self._actual_s[self._stage] = time_s - self._stage_start_s
        # Stages that were left out take no time.
        names = list(self.expected_s)
        for name in names[: names.index(stage)]:
            if name not in self._actual_s:
                self.expected_s[name] = 0.0
        self._stage, self._stage_start_s = stage, time_s

    def seconds_left(self) -> float:
        """Return the expected remaining time [s]."""
        finished = [n for n in self._actual_s if n != self._stage]
        actual_s = sum(self._actual_s[n] for n in finished)
        expected_s = sum(self.expected_s[n] for n in finished)
        ratio = (actual_s + self._PRIOR_S) / (expected_s + self._PRIOR_S)
        names = list(self.expected_s)
        following = names[names.index(self._stage) + 1 :] if self._stage else names
        elapsed_s = self._now() - self._stage_start_s if self._stage else 0.0
        current_s = ratio * self.expected_s.get(self._stage, 0.0)
        # A stage that takes longer than expected has a third of its time ahead.
        current_left_s = max(current_s - elapsed_s, min(elapsed_s, current_s) / 3.0)
        return current_left_s + ratio * sum(self.expected_s[n] for n in following)


class _State:
    """Stage of the running command, its forecast, and number of progress bars shown."""

    stage = ""
    bars = 0
    forecast: Forecast | None = None

    def time_to_go(self) -> str:
        """Return the remaining time in words; empty without a forecast."""
        forecast = self.forecast
        return "" if forecast is None else f"about {clock(forecast.seconds_left())} to go"


STATE = _State()


@contextmanager
def forecast_shown(forecast: Forecast | None) -> Iterator[None]:
    """Show the remaining time of a forecast, if any, while the work that it is about goes on."""
    previous, STATE.forecast = STATE.forecast, forecast
    try:
        yield
    finally:
        STATE.forecast = previous


@contextmanager
def bar_drawn() -> Iterator[None]:
    """Suppress the heartbeat while a progress bar is shown."""
    STATE.bars += 1
    try:
        yield
    finally:
        STATE.bars -= 1


def _write(stream: TextIO, text: str) -> None:
    stream.write(text)
    stream.flush()


@contextmanager
def notebook_line(name: str) -> Iterator[None]:
    """Show one line in a Jupyter notebook while a function works; nothing elsewhere."""
    display = _notebook_display()
    if display is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    with heartbeat(name, first_s=2.0, every_s=1.0, show=display):
        yield


def _notebook_display() -> Callable[[str], None] | None:
    """Return a function that replaces a line in the notebook's cell; None outside a notebook."""
    shell = sys.modules.get("IPython")
    running: Any = None if shell is None else shell.get_ipython()
    if running is None or not hasattr(running, "kernel"):
        return None
    from IPython.display import HTML, display

    handles: list[Any] = []

    def show(text: str) -> None:
        content = HTML(f"<pre>{html.escape(text)}</pre>" if text else "")
        if handles:
            handles[0].update(content)
        elif text:
            handles.append(display(content, display_id=True))

    return show


@contextmanager
def heartbeat(
    command: str,
    first_s: float = FIRST_S,
    every_s: float = EVERY_S,
    show: Callable[[str], None] | None = None,
) -> Iterator[None]:
    """Report on standard error that a command is at work, its stage and its time.

    Parameters
    ----------
    command : str
        Name shown.
    first_s, every_s : float
        Time [s] before the first line, and between lines in a pipe.
    show : callable, optional
        Called with each line in place of standard error, and with an empty one at the end.
    """
    if os.environ.get(QUIET_VARIABLE):
        yield
        return
    ended, line_shown = threading.Event(), threading.Event()
    stream, start_s = sys.stderr, time.monotonic()
    redraws = show is None and stream.isatty()

    def beat() -> None:
        wait = first_s
        while not ended.wait(wait):
            wait = 1.0 if redraws else every_s
            if STATE.bars:
                continue
            parts = [clock(time.monotonic() - start_s), visible(STATE.stage), STATE.time_to_go()]
            line = f"{command}: {', '.join(part for part in parts if part)}"
            try:
                if show is not None:
                    line_shown.set()
                    show(line)
                elif redraws:
                    line_shown.set()
                    _write(cursor_stream(stream), f"\r\x1b[K{line}")
                else:
                    _write(stream, f"{line}\n")
            except (OSError, ValueError):  # nobody reads it
                return

    STATE.stage, STATE.forecast = "", None
    # A daemon thread does not keep the process alive.
    thread = threading.Thread(target=beat, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(1.0)
        STATE.stage, STATE.forecast = "", None
        if show is not None and line_shown.is_set():
            show("")
        elif line_shown.is_set():
            _write(cursor_stream(stream), "\r\x1b[K")


def clock(seconds: float) -> str:
    """Return a duration as ``h:mm:ss`` or ``m:ss``.

    Examples
    --------
    >>> clock(75.0), clock(3675.0)
    ('1:15', '1:01:15')
    """
    total = round(seconds)
    hours, remainder = divmod(total, 3600)
    minutes, second = divmod(remainder, 60)
    return f"{hours}:{minutes:02d}:{second:02d}" if hours else f"{minutes}:{second:02d}"
