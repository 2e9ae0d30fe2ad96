"""What a command or a function says while it works and nothing else does.

After 5 s `heartbeat` says what is done and how long it has taken: on a terminal by a line that moves, in a pipe by a line every 30 s,
in a notebook by one line that is replaced. `uqharness.cli.progress` draws bars and names the stage. UQHARNESS_QUIET=1 silences it.
"""

from __future__ import annotations

import html
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from sysid.display import cursor_stream, visible

FIRST_S = 5.0
"""Until the first line of a command that shows nothing by itself."""
EVERY_S = 30.0
"""Between two lines in a pipe."""
QUIET = "UQHARNESS_QUIET"
_RECENT_S = 60.0
"""Work of so long decides the time to go."""


class Rate:
    """Rate of work from what was done recently: the first seconds of a command compile and load, and tell nothing of the rest."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._done: deque[tuple[float, float]] = deque([(now(), 0.0)])

    def seconds_left(self, done: float, total: float) -> float | None:
        """Return the time to go [s]; None before anything and after everything is done."""
        now, marks = self._now(), self._done
        if done < marks[-1][1]:
            marks.clear()
        if not marks or done > marks[-1][1]:
            marks.append((now, done))
            while len(marks) > 2 and marks[1][0] <= now - _RECENT_S:
                marks.popleft()
            # What ended first carried the start of everything; from the third mark on it is left out.
            if len(marks) > 2 and marks[0][1] == 0.0:
                marks.popleft()
        (begun, before), (last, latest) = marks[0], marks[-1]
        if not 0.0 < done < total or latest <= before:
            return None
        per_unit = (last - begun) / (latest - before)
        return max(per_unit * (total - latest) - (now - last), 0.0)


class _State:
    """What the command at work says of itself, and how many bars are drawn."""

    stage = ""
    bars = 0


STATE = _State()


@contextmanager
def bar_drawn() -> Iterator[None]:
    """While it lasts a bar is drawn, and the heartbeat is still."""
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
    """In a Jupyter notebook, show one line that is replaced while a function works; nothing in a script."""
    display = _notebook_display()
    if display is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    with heartbeat(name, first_s=2.0, every_s=1.0, show=display):
        yield


def _notebook_display() -> Callable[[str], None] | None:
    """Return what replaces a line of the notebook's cell; None outside a notebook."""
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
    """Say on standard error that a command is at work, its stage and the time that it has taken, wherever no bar says so.

    ``show`` takes the line, in place of standard error, and an empty one at the end.
    """
    if os.environ.get(QUIET):
        yield
        return
    ended, drawn = threading.Event(), threading.Event()
    stream, begun = sys.stderr, time.monotonic()
    moves = show is None and stream.isatty()

    def beat() -> None:
        wait = first_s
        while not ended.wait(wait):
            wait = 1.0 if moves else every_s
            if STATE.bars:
                continue
            stage = f", {visible(STATE.stage)}" if STATE.stage else ""
            line = f"{command}: {clock(time.monotonic() - begun)}{stage}"
            try:
                if show is not None:
                    drawn.set()
                    show(line)
                elif moves:
                    drawn.set()
                    _write(cursor_stream(stream), f"\r\x1b[K{line}")
                else:
                    _write(stream, f"{line}\n")
            except (OSError, ValueError):  # nobody reads it
                return

    STATE.stage = ""
    thread = threading.Thread(target=beat, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(1.0)
        STATE.stage = ""
        if show is not None and drawn.is_set():
            show("")
        elif drawn.is_set():
            _write(cursor_stream(stream), "\r\x1b[K")


def clock(seconds: float) -> str:
    """``h:mm:ss`` or ``m:ss``."""
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, second = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{second:02d}" if hours else f"{minutes}:{second:02d}"
