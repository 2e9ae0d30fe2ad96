"""Functions run in a worker process, because JSBSim may end the process in which an aircraft from
anywhere flies.

A <mod> whose divisor becomes 0 in flight is SIGFPE, a C++ exception that nobody catches is SIGABRT:
no Python code can survive either. `run_isolated` runs a function of a module in one worker that
stays for the next call, and turns the worker's death into ProcessEndedError. Log records of
"uqharness" and calls of functions among the arguments come back to this process; SIGINT is passed
on. The command line runs in a child process already (see uqharness.cli.start), so that `isolated`
functions run there directly."""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import logging
import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from sysid.errors import LogError
from uqharness.child_process import child_settings, ending, main_not_imported
from uqharness.errors import BadInputError
from uqharness.parallel import end_with_parent

P = ParamSpec("P")
R = TypeVar("R")

SUPERVISED = "UQHARNESS_SUPERVISED"
"""Environment variable: number of a process whose parent reports how it ends, as the command line's
does.
"""
_GOODBYE_S = 10.0
_NOT_FLYING = -1.0


class ProcessEndedError(BadInputError):
    """The process that loaded or flew an aircraft ended.

    ``reason`` is the sentence without advice, ``time_s`` how far the flight had come [s]; None: in
    no flight."""

    def __init__(self, code: int | None, time_s: float | None) -> None:
        flight_time = "" if time_s is None else f" after {time_s:.2f} s of the flight"
        self.time_s, self.reason = (
            time_s,
            f"JSBSim's process ended with {ending(code)}{flight_time}",
        )
        super().__init__(
            f"{self.reason}; look for what the aircraft or the run script computes there, such as a"
            " <mod> by zero"
        )


def isolated(function: Callable[P, R]) -> Callable[P, R]:
    """Run a module's function in the worker wherever it is called, as `run_unsupervised` does."""

    @functools.wraps(function)
    def in_worker(*args: P.args, **kwargs: P.kwargs) -> R:
        if _in_worker or _is_supervised():
            return function(*args, **kwargs)
        by_name: Callable[P, R] = _NamedFunction(function.__module__, function.__qualname__)
        return run_isolated(by_name, *args, **kwargs)

    return in_worker


@dataclass(frozen=True)
class _NamedFunction:
    """A module's function by its name, so that decorators around it do not matter to pickling."""

    module: str
    name: str

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        target: Any = importlib.import_module(self.module)
        for part in self.name.split("."):
            target = getattr(target, part)
        return target(*args, **kwargs)


def run_unsupervised(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call the function in the worker, but directly in a process whose end its parent reports.

    See `run_isolated`.
    """
    if _is_supervised():
        return function(*args, **kwargs)
    return run_isolated(function, *args, **kwargs)


def _is_supervised() -> bool:
    return os.environ.get(SUPERVISED) == str(os.getpid())


def run_isolated(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a module's function in the worker; its result, or its exception.

    Arguments and result are pickled; functions among the arguments are called in this process. In
    the worker itself, and in a campaign's workers, whose end is met by their parent, the function
    is called directly. Raises ProcessEndedError where the worker dies."""
    if _in_worker or multiprocessing.current_process().daemon:
        return function(*args, **kwargs)
    with _one_call:
        if not (_workers and _workers[0].is_usable):
            _workers[:] = [_Worker()]
        succeeded, result = _workers[0].call(function, args, kwargs)
    if not succeeded:
        raise result
    return result


def report_time(time_s: float) -> None:
    """Note the time of a flight [s], for the sentence about its process's death.

    Costs a fraction of a microsecond.
    """
    if _clock is not None:
        _clock.value = time_s


class _Worker:
    """The process, its pipe, and the clock of its flight, which outlives it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._owner = os.getpid()
        self._clock = context.RawValue("d", _NOT_FLYING)
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._clock))
        with child_settings(), main_not_imported():
            self._process.start()
        # Held open here, the other end would hide the worker's death.
        theirs.close()
        atexit.register(self.close)

    @property
    def is_usable(self) -> bool:
        """Whether it lives and was started by this process, not by one that forked it."""
        return self._owner == os.getpid() and self._process.is_alive()

    def close(self) -> None:
        """End the process."""
        if self._owner == os.getpid():
            self._pipe.close()
            self._process.join(_GOODBYE_S)
            self._process.kill()

    def call(self, function: Callable[..., Any], args: Any, kwargs: Any) -> tuple[bool, Any]:
        """Whether the call succeeded, and its result or exception. Raises ProcessEndedError."""
        callbacks: list[Callable[..., Any]] = []

        def sendable(value: Any) -> Any:
            if not callable(value) or isinstance(value, type):
                return value
            callbacks.append(value)
            return _Callback(len(callbacks) - 1)

        request = (
            os.getcwd(),
            function,
            tuple(map(sendable, args)),
            {name: sendable(value) for name, value in kwargs.items()},
        )
        self._clock.value = _NOT_FLYING
        try:
            self._pipe.send(request)
            return self._answer(callbacks)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self._process.join()
            time_s = self._clock.value
            raise ProcessEndedError(
                self._process.exitcode, None if time_s == _NOT_FLYING else time_s
            ) from None
        except BaseException:
            # Ctrl-C, or a callback's exception: the function ends in the worker as it would have
            # done here.
            self._interrupt()
            raise

    def _answer(self, callbacks: list[Callable[..., Any]]) -> tuple[bool, Any]:
        while True:
            kind, content = self._pipe.recv()
            if kind == "log":
                logger = logging.getLogger(content.name)
                if logger.isEnabledFor(content.levelno):
                    logger.handle(content)
            elif kind == "callback":
                index, args, kwargs = content
                self._pipe.send(callbacks[index](*args, **kwargs))
            else:
                return kind == "result", content

    def _interrupt(self) -> None:
        with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
            os.kill(self._process.pid, signal.SIGINT)  # type: ignore[arg-type]
            while self._pipe.poll(_GOODBYE_S):
                if self._pipe.recv()[0] in ("result", "error"):
                    return
        self._process.kill()
        self._process.join()


_one_call = threading.RLock()
_workers: list[_Worker] = []

# In the worker.
_in_worker = False
_clock: Any = None
_to_parent: Connection | None = None
_is_busy = False


class _Callback:
    """A function of the parent's, called there."""

    def __init__(self, index: int) -> None:
        self._index = index

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call it and wait for what it returns."""
        assert _to_parent is not None
        _to_parent.send(("callback", (self._index, args, kwargs)))
        return _to_parent.recv()


class _ToParent(logging.Handler):
    """Sends log records to the parent, their arguments put in."""

    def emit(self, record: logging.LogRecord) -> None:
        """Send it."""
        assert _to_parent is not None
        record.msg, record.args, record.exc_info = record.getMessage(), None, None
        _to_parent.send(("log", record))


def _work(pipe: Connection, clock: Any) -> None:
    """Take calls and answer them until the parent closes the pipe."""
    global _in_worker, _clock, _to_parent, _is_busy
    _in_worker, _clock, _to_parent = True, clock, pipe
    # Ctrl-C reaches this process through its parent alone, once.
    with contextlib.suppress(OSError, AttributeError):
        os.setpgid(0, 0)
    signal.signal(signal.SIGINT, _interrupted)
    end_with_parent()
    logger = logging.getLogger("uqharness")
    logger.setLevel(logging.INFO)
    logger.addHandler(_ToParent())
    while True:
        try:
            folder, function, args, kwargs = pipe.recv()
        except (EOFError, OSError):
            return
        except Exception as error:
            pipe.send(("error", RuntimeError(f"the call cannot be read: {error!r}")))
            continue
        answer: tuple[str, Any]
        try:
            _is_busy = True
            os.chdir(folder)
            answer = "result", function(*args, **kwargs)
        except BaseException as error:
            if not isinstance(error, BadInputError | LogError | KeyboardInterrupt):
                error.add_note(traceback.format_exc())
            answer = "error", error
        finally:
            _is_busy = False
        try:
            pipe.send(answer)
        except OSError:
            return
        except Exception as error:
            # Not pickled, so nothing of it has been sent.
            text = f"{type(answer[1]).__name__} cannot be sent: {error}; {answer[1]!r:.500}"
            pipe.send(("error", RuntimeError(text)))


def _interrupted(number: int, frame: FrameType | None) -> None:
    if _is_busy:
        raise KeyboardInterrupt
