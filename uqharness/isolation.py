"""Functions run in a worker process, which JSBSim may crash without harm to the caller.

A <mod> by zero in flight is SIGFPE, and an uncaught C++ exception is SIGABRT: no Python code
survives either. `run_isolated` runs a module's function in one worker that stays for the next call,
and turns its death into ProcessEndedError. Log records of "uqharness" and callbacks come back to
the calling process, and SIGINT is passed on. The command line runs in a supervised child already
(`uqharness.cli.start`), so that `isolated` functions run there directly.
"""

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
from uqharness.child_process import child_settings, describe_exit, main_not_imported
from uqharness.errors import BadInputError
from uqharness.parallel import end_with_parent

P = ParamSpec("P")
R = TypeVar("R")

SUPERVISED = "UQHARNESS_SUPERVISED"
"""Environment variable with the number of a process whose parent reports how it ends."""
_GOODBYE_S = 10.0
_NOT_FLYING = -1.0


class ProcessEndedError(BadInputError):
    """The process that loaded or flew an aircraft ended.

    Parameters
    ----------
    code : int or None
        Exit code, negative for a signal.
    time_s : float or None
        Time of the flight [s]; None if none was in progress.
    """

    def __init__(self, code: int | None, time_s: float | None) -> None:
        flight_time = "" if time_s is None else f" after {time_s:.2f} s of the flight"
        self.time_s, self.reason = (
            time_s,
            f"JSBSim's process ended with {describe_exit(code)}{flight_time}",
        )
        super().__init__(
            f"{self.reason}; look for what the aircraft or the run script computes there, such as a"
            " <mod> by zero"
        )


def isolated(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a module's function to run in the worker, unless its process is supervised."""

    @functools.wraps(function)
    def in_worker(*args: P.args, **kwargs: P.kwargs) -> R:
        if _in_worker or _is_supervised():
            return function(*args, **kwargs)
        by_name: Callable[P, R] = _NamedFunction(function.__module__, function.__qualname__)
        return run_isolated(by_name, *args, **kwargs)

    return in_worker


@dataclass(frozen=True)
class _NamedFunction:
    """A module's function by name: pickling does not depend on its decorators."""

    module: str
    name: str

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        target: Any = importlib.import_module(self.module)
        for part in self.name.split("."):
            target = getattr(target, part)
        return target(*args, **kwargs)


def run_unsupervised(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a function in the worker, or directly in a supervised process."""
    if _is_supervised():
        return function(*args, **kwargs)
    return run_isolated(function, *args, **kwargs)


def _is_supervised() -> bool:
    """Return whether the parent of this process reports how it ends."""
    return os.environ.get(SUPERVISED) == str(os.getpid())


def run_isolated(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a module's function in the worker; return its result or raise its exception.

    Arguments and result are pickled, and functions among the arguments are called in this process.
    In the worker itself, and in daemon processes such as a campaign's, the call is direct. Raises
    ProcessEndedError if the worker dies.
    """
    if _in_worker or multiprocessing.current_process().daemon:
        return function(*args, **kwargs)
    return run_in_worker(function, *args, **kwargs)


def run_in_worker(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a module's function as `run_isolated` does, in a worker's own worker if need be."""
    # One worker serves one call at a time; recursion from a callback is allowed.
    with _one_call:
        if not (_workers and _workers[0].is_usable):
            _workers[:] = [_Worker()]
        succeeded, result = _workers[0].call(function, args, kwargs)
    if not succeeded:
        raise result
    return result


def report_time(time_s: float) -> None:
    """Record the time of the running flight [s] for `ProcessEndedError`; takes less than 1 us."""
    if _clock is not None:
        _clock.value = time_s


class _Worker:
    """Worker process, its pipe, and the time of its flight, which survives it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._owner = os.getpid()
        self._clock = context.RawValue("d", _NOT_FLYING)
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._clock))
        with child_settings(), main_not_imported():
            self._process.start()
        # An open copy of the other end would hide the worker's death.
        theirs.close()
        atexit.register(self.close)

    @property
    def is_usable(self) -> bool:
        """Return whether the worker lives and was started by this process, not before a fork."""
        return self._owner == os.getpid() and self._process.is_alive()

    def close(self) -> None:
        """End the worker."""
        if self._owner == os.getpid():
            self._pipe.close()
            self._process.join(_GOODBYE_S)
            self._process.kill()

    def call(self, function: Callable[..., Any], args: Any, kwargs: Any) -> tuple[bool, Any]:
        """Call a function; return whether it succeeded, and its result or exception.

        Raises ProcessEndedError if the worker dies.
        """
        callbacks: list[Callable[..., Any]] = []

        def sendable(value: Any) -> Any:
            if not callable(value) or isinstance(value, type):
                return value
            callbacks.append(value)
            return _Callback(len(callbacks) - 1)

        # Callbacks are sent as numbers and called in this process.
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
            # Ctrl-C, or an exception in a callback: end the function in the worker as well.
            self._interrupt()
            raise

    def _answer(self, callbacks: list[Callable[..., Any]]) -> tuple[bool, Any]:
        """Handle log records and callbacks until the result arrives."""
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
        """Interrupt the running function; kill the worker if it does not answer."""
        with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
            os.kill(self._process.pid, signal.SIGINT)  # type: ignore[arg-type]
            while self._pipe.poll(_GOODBYE_S):
                if self._pipe.recv()[0] in ("result", "error"):
                    return
        self._process.kill()
        self._process.join()


_one_call = threading.RLock()
_workers: list[_Worker] = []

# State of the worker process.
_in_worker = False
_clock: Any = None
_to_parent: Connection | None = None
_is_busy = False


class _Callback:
    """A function of the parent, called there."""

    def __init__(self, index: int) -> None:
        self._index = index

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call it and wait for its result."""
        assert _to_parent is not None
        _to_parent.send(("callback", (self._index, args, kwargs)))
        return _to_parent.recv()


class _ToParent(logging.Handler):
    """Log handler that sends formatted records to the parent."""

    def emit(self, record: logging.LogRecord) -> None:
        """Send one record."""
        assert _to_parent is not None
        record.msg, record.args, record.exc_info = record.getMessage(), None, None
        _to_parent.send(("log", record))


def _work(pipe: Connection, clock: Any) -> None:
    """Answer calls until the parent closes the pipe."""
    global _in_worker, _clock, _to_parent, _is_busy
    _in_worker, _clock, _to_parent = True, clock, pipe
    # A process group of its own: Ctrl-C arrives only through the parent, once.
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
            # Pickling failed before anything was sent.
            text = f"{type(answer[1]).__name__} cannot be sent: {error}; {answer[1]!r:.500}"
            pipe.send(("error", RuntimeError(text)))


def _interrupted(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt only while a call is running."""
    if _is_busy:
        raise KeyboardInterrupt
