"""From the start of the process to the command line: what may happen before the commands are loaded, and how signals end it.

The command itself runs in a forked child process, because an aircraft from anywhere may end the process that flies it in JSBSim
(a division of whole numbers by zero is SIGFPE). The parent passes signals on and reports how the child ended. The module imports
little, so that hardly any time passes in which Ctrl-C or want of memory would be a page of Python's own words.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from types import FrameType

from uqharness.errors import TerminatedError

INTERRUPTED = 130
TERMINATED = 143
_PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_PR_SET_PDEATHSIG = 1
_LITTLE_BYTES = 4_000_000_000
"""Address space below which a failure to load is put down to want of it; about a gigabyte is needed."""


def run(argv: Sequence[str] | None = None) -> int:
    """Load the command line and run one command in a child process; its exit code. Unknown exceptions pass: they are bugs."""
    _quiet_libraries()
    _one_thread()
    if not hasattr(os, "fork") or threading.active_count() > 1:
        return _run_here(argv)
    # No signal may arrive between the fork and the handlers.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {*_PASSED_ON, signal.SIGTSTP})
    child = os.fork()
    if child:
        # What is to be done at the end of a process, the child does: it has all that this one had.
        os._exit(_Supervisor(child, blocked).wait())
    os.setpgid(0, 0)
    _end_with_parent()
    # Out of the terminal's foreground group it may write all the same.
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    # Functions that are isolated elsewhere (uqharness.isolation.SUPERVISED) run here directly.
    os.environ["UQHARNESS_SUPERVISED"] = str(os.getpid())
    ends = _Ends()
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return _run_here(argv, ends)


def _run_here(argv: Sequence[str] | None, ends: _Ends | None = None) -> int:
    """Run one command in this process; its exit code.

    After a signal the process ends here: Python would end it by SIGINT, whatever code it was given, where code that is made at
    run time, such as a dataclass's, was interrupted once.
    """
    ends = ends or _Ends()
    code = _run(argv, ends)
    scratch = sys.modules.get("uqharness.files")
    if scratch is not None:
        scratch.remove_abandoned_folders()  # workers that were killed on the way left their folders
    if ends.received:
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(TERMINATED if ends.terminated else INTERRUPTED)
    return code


class _Supervisor:
    """Passes signals on to the child that runs the command, and turns its end into an exit code."""

    def __init__(self, child: int, blocked: set[int | signal.Signals]) -> None:
        self._child = child
        self._passed_on: set[int] = set()
        for number in _PASSED_ON:
            # Under nohup and the like both processes go on ignoring the signal.
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._pass_on)
        if signal.getsignal(signal.SIGTSTP) != signal.SIG_IGN:
            signal.signal(signal.SIGTSTP, self._pause)
        with contextlib.suppress(OSError):
            os.setpgid(child, child)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        self._passed_on.add(number)
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._child, number)

    def _pause(self, number: int, frame: FrameType | None) -> None:
        """Stop the command's processes and this one (Ctrl-Z); continue them when the shell continues this one."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._child, signal.SIGSTOP)
            os.kill(os.getpid(), signal.SIGSTOP)
            os.killpg(self._child, signal.SIGCONT)

    def wait(self) -> int:
        """Wait for the child's end; the command's exit code."""
        code = os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])
        if code >= 0:
            return code
        if -code in self._passed_on:
            _say("interrupted" if -code == signal.SIGINT else "terminated")
            return 128 - code
        name = signal.Signals(-code).name
        if -code == signal.SIGKILL:
            _say(f"error: the command was killed ({name}), by somebody or for want of memory")
            return 128 - code
        _say(
            f"error: the command's process ended with signal {-code} ({name}): JSBSim ends the process at some errors in an aircraft "
            "or a run script, such as a <mod> by zero in flight; look for what the model computes there"
        )
        return 2


def _end_with_parent() -> None:
    """End this process at once when its parent is killed, as one process would (Linux; elsewhere within a second)."""
    parent = os.getppid()
    with contextlib.suppress(ImportError, OSError, AttributeError):
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if sys.platform != "linux":

        def follow() -> None:
            while os.getppid() == parent:
                time.sleep(1.0)
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def _quiet_libraries() -> None:
    """Keep warnings of numpy and others, which are for developers, from users, unless Python was told what to do with them."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"


def _one_thread() -> None:
    """Linear algebra in one thread, unless the user says otherwise: its matrices are small, and threads that wait for each other
    take the time of processor cores that other work wants, and address space."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _run(argv: Sequence[str] | None, ends: _Ends) -> int:
    limit = None
    try:
        limit = _address_limit()
        from sysid.display import clean_streams

        clean_streams()
        from uqharness.cli.main import load_command
        from uqharness.cli.main import main as command_line

        load_command(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        # OpenBLAS interrupts its own process where it gets no thread.
        return _no_memory(limit) if limit is not None and not ends.terminated else ends.said()
    except (MemoryError, ImportError, OSError, RuntimeError, SystemError) as error:
        if ends.received:
            return (
                ends.said()
            )  # some modules turn an interruption while they load into an error of their own
        if (
            limit is not None
            or isinstance(error, MemoryError)
            or getattr(error, "errno", 0) == errno.ENOMEM
        ):
            return _no_memory(limit)
        raise
    try:
        return command_line(argv)
    except KeyboardInterrupt:  # while an error was being told
        return ends.said()
    except ImportError:
        if limit is None:
            raise
        return _no_memory(limit)


class _Ends:
    """Which signals asked this process to end. SIGTERM does it as Ctrl-C does, so that workers end and files are left whole."""

    def __init__(self) -> None:
        self.received = self.terminated = False
        self._process = os.getpid()
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                # A process that was told to ignore a signal (nohup, a shell's background job) goes on ignoring it.
                if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL):
                    signal.signal(number, self._end)

    def _end(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._process:
            # A forked child ends as it would have without this.
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        self.received = True
        if number == signal.SIGTERM:
            self.terminated = True
            raise TerminatedError
        raise KeyboardInterrupt

    def said(self) -> int:
        """Say how the process was ended; its exit code."""
        _say("terminated" if self.terminated else "interrupted")
        return TERMINATED if self.terminated else INTERRUPTED


def _address_limit() -> int | None:
    """Bytes of address space that this process may take, if they are few (``ulimit -v``)."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return soft if soft != resource.RLIM_INFINITY and soft < _LITTLE_BYTES else None


def _no_memory(limit: int | None) -> int:
    allowed = (
        ""
        if limit is None
        else f": {limit / 1e6:.0f} MB of address space are allowed (ulimit -v), about 1000 MB are needed"
    )
    _say(f"error: not enough memory to start{allowed}")
    return 2


def _say(text: str) -> None:
    with contextlib.suppress(OSError, ValueError, AttributeError, MemoryError):
        print(f"uqharness: {text}", file=sys.stderr)
