"""Start of the process: what happens before the commands are loaded, and how signals end it.

The command runs in a forked child, because an aircraft can end the process that flies it in JSBSim
(an integer division by zero raises SIGFPE). The parent forwards signals and reports how the child
ended. The module imports little, so that Ctrl-C or lack of memory during the start hardly ever ends
in a Python traceback.
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
_FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_PR_SET_PDEATHSIG = 1
_MIN_ADDRESS_BYTES = 4_000_000_000
"""Address space limit [bytes] below which a failure to load is attributed to it; about 1 GB is
needed."""


def run(argv: Sequence[str] | None = None) -> int:
    """Load the command line and run one command in a child process; return its exit code.

    Unknown exceptions propagate: they are bugs.
    """
    _quiet_libraries()
    _one_thread()
    if not hasattr(os, "fork") or threading.active_count() > 1:
        return _run_here(argv)
    # Block signals until both processes have installed their handlers.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {*_FORWARDED, signal.SIGTSTP})
    child = os.fork()
    if child:
        # Skip exit handlers here: the child has inherited all of them and runs them.
        os._exit(_Supervisor(child, blocked).wait())
    os.setpgid(0, 0)
    _end_with_parent()
    # The child is in a background group, from which it may still write to the terminal.
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    # Functions that would otherwise be isolated (uqharness.isolation.SUPERVISED) run here directly.
    os.environ["UQHARNESS_SUPERVISED"] = str(os.getpid())
    ends = _EndSignals()
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return _run_here(argv, ends)


def _run_here(argv: Sequence[str] | None, ends: _EndSignals | None = None) -> int:
    """Run one command in this process; return its exit code.

    After a signal the process ends here. Python would otherwise end it by SIGINT, whatever the exit
    code, if generated code such as a dataclass was interrupted.
    """
    ends = ends or _EndSignals()
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
    """Forwards signals to the child that runs the command, and converts its end to an exit code."""

    def __init__(self, child: int, blocked: set[int | signal.Signals]) -> None:
        self._child = child
        self._passed_on: set[int] = set()
        for number in _FORWARDED:
            # Under nohup and similar both processes keep ignoring the signal.
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._pass_on)
        if signal.getsignal(signal.SIGTSTP) != signal.SIG_IGN:
            signal.signal(signal.SIGTSTP, self._pause)
        with contextlib.suppress(OSError):
            os.setpgid(child, child)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Forward a signal to the child, and remember it."""
        self._passed_on.add(number)
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._child, number)

    def _pause(self, number: int, frame: FrameType | None) -> None:
        """Stop the command's processes and this one (Ctrl-Z); continue them when the shell
        continues this one.
        """
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._child, signal.SIGSTOP)
            os.kill(os.getpid(), signal.SIGSTOP)
            os.killpg(self._child, signal.SIGCONT)

    def wait(self) -> int:
        """Wait for the child; return the command's exit code."""
        code = os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])
        if code >= 0:
            return code
        if -code in self._passed_on:
            _print_error("interrupted" if -code == signal.SIGINT else "terminated")
            return 128 - code
        name = signal.Signals(-code).name
        if -code == signal.SIGKILL:
            _print_error(f"error: the command was killed ({name}), by a user or for lack of memory")
            return 128 - code
        _print_error(
            f"error: the command's process ended with signal {-code} ({name}): JSBSim ends the"
            " process at some errors in an aircraft or a run script, such as a <mod> by zero in"
            " flight; check what the model computes there"
        )
        return 2


def _end_with_parent() -> None:
    """End this process when its parent is killed, at once on Linux, within a second elsewhere."""
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
    """Suppress warnings of libraries, which are for developers, unless Python was told
    otherwise.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"


def _one_thread() -> None:
    """Run linear algebra in one thread unless the user says otherwise.

    The matrices are small; waiting threads take processor time and address space from other work.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _run(argv: Sequence[str] | None, ends: _EndSignals) -> int:
    """Load and run one command; report interruption and lack of memory."""
    limit = None
    try:
        limit = _address_limit()
        from sysid.display import clean_streams

        clean_streams()
        from uqharness.cli.main import load_command
        from uqharness.cli.main import main as command_line

        load_command(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        # OpenBLAS interrupts its own process where it cannot start a thread.
        return _no_memory(limit) if limit is not None and not ends.terminated else ends.report_end()
    except (MemoryError, ImportError, OSError, RuntimeError, SystemError) as error:
        if ends.received:
            # Some modules convert an interruption while they load to another exception.
            return ends.report_end()
        if (
            limit is not None
            or isinstance(error, MemoryError)
            or getattr(error, "errno", 0) == errno.ENOMEM
        ):
            return _no_memory(limit)
        raise
    try:
        return command_line(argv)
    except KeyboardInterrupt:  # while an error was printed
        return ends.report_end()
    except ImportError:
        if limit is None:
            raise
        return _no_memory(limit)


class _EndSignals:
    """Records which signals asked this process to end.

    SIGTERM acts as Ctrl-C does, so that workers end and files stay complete.
    """

    def __init__(self) -> None:
        self.received = self.terminated = False
        self._process = os.getpid()
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                # A process that ignores a signal (nohup, a shell's background job) keeps ignoring
                # it.
                if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL):
                    signal.signal(number, self._end)

    def _end(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt or TerminatedError in this process."""
        if os.getpid() != self._process:
            # A forked child has the default behaviour.
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        self.received = True
        if number == signal.SIGTERM:
            self.terminated = True
            raise TerminatedError
        raise KeyboardInterrupt

    def report_end(self) -> int:
        """Print how the process was ended; return its exit code."""
        _print_error("terminated" if self.terminated else "interrupted")
        return TERMINATED if self.terminated else INTERRUPTED


def _address_limit() -> int | None:
    """Return the limit on address space (``ulimit -v``) [bytes], None where it is large enough."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return soft if soft != resource.RLIM_INFINITY and soft < _MIN_ADDRESS_BYTES else None


def _no_memory(limit: int | None) -> int:
    """Report lack of memory; return the exit code."""
    allowed = (
        ""
        if limit is None
        else (
            f": {limit / 1e6:.0f} MB of address space are allowed (ulimit -v), about 1000 MB are"
            " needed"
        )
    )
    _print_error(f"error: not enough memory to start{allowed}")
    return 2


def _print_error(text: str) -> None:
    """Print to standard error, ignoring that it may be closed."""
    with contextlib.suppress(OSError, ValueError, AttributeError, MemoryError):
        print(f"uqharness: {text}", file=sys.stderr)
