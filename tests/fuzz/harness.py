"""Sends inputs to a worker, watches over it, and replaces it when it dies, hangs or grows."""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.guard import internet_sockets, resident_mb, session_of
from tests.fuzz.hostile import OUTSIDE

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 20.0
LIMIT_MB = 2000.0
_LOOK_S = 0.25
_START_S = 120.0
_MAX_INPUTS = 3000


@dataclass(frozen=True)
class Outcome:
    """How one input ended. ``outcome``: result, refusal, finding."""

    name: str
    seed: int
    outcome: str
    what: str
    seconds: float
    megabytes: float


@dataclass
class Counts:
    """Of one format. ``seeds``: first and last."""

    inputs: int = 0
    results: int = 0
    refusals: int = 0
    findings: int = 0
    slowest_s: float = 0.0
    largest_MB: float = 0.0
    spent_s: float = 0.0
    seeds: list[int] = field(default_factory=list)

    def add(self, result: Outcome) -> None:
        """Count one."""
        self.inputs += 1
        self.results += result.outcome == "result"
        self.refusals += result.outcome == "refusal"
        self.findings += result.outcome == "finding"
        self.slowest_s = max(self.slowest_s, result.seconds)
        self.largest_MB = max(self.largest_MB, result.megabytes)
        # The first input of a format pays for loading what the format needs.
        self.spent_s += result.seconds if self.inputs > 1 else 0.0
        self.seeds = [min([*self.seeds, result.seed]), max([*self.seeds, result.seed])]


class Worker:
    """A child that tries inputs, with a folder of its own.

    ``module``: what it runs (another one in the harness' own tests).
    """

    def __init__(
        self,
        module: str = "tests.fuzz.worker",
        limit_s: float = LIMIT_S,
        limit_mb: float = LIMIT_MB,
    ) -> None:
        self._module, self._limit_s, self._limit_mb = module, limit_s, limit_mb
        self._child: subprocess.Popen[bytes] | None = None
        self._answers: Any = None
        self._served = 0
        self.base = Path()

    def attempt(self, name: str, seed: int) -> Outcome:
        """Try one input; a child that dies or does not answer in time is a finding too."""
        if self._child is None or self._child.poll() is not None or self._served >= _MAX_INPUTS:
            self._start()
        assert self._child is not None
        assert self._child.stdin is not None
        start, first = time.monotonic(), self._served == 0
        self._served += 1
        self._child.stdin.write(f"{name} {seed}\n".encode())
        self._child.stdin.flush()
        sockets: list[str] = []
        largest = 0.0
        # The modules that a format needs are loaded by its first input.
        limit_s = self._limit_s + (_START_S if first else 0.0)
        while True:
            ready = select.select([self._answers], [], [], _LOOK_S)[0]
            if ready:
                break
            pids = session_of(self._child.pid)
            sockets += internet_sockets(pids)
            largest = max([largest, *(resident_mb(pid) for pid in pids)])
            waited = time.monotonic() - start
            if waited > limit_s or largest > 2 * self._limit_mb:
                kind = (
                    f"no answer after {waited:.0f} s"
                    if waited > limit_s
                    else f"{largest:.0f} MB and growing"
                )
                self.close()
                return Outcome(name, seed, "finding", kind, waited, largest)
        line = self._answers.readline()
        seconds = time.monotonic() - start
        if not line:
            code = self._child.wait()
            words = self._last_words()
            self.close()
            died = f"the process ends ({_ending(code)}): {words}"
            return Outcome(name, seed, "finding", died, seconds, largest)
        row = json.loads(line)
        result = Outcome(name, seed, row["outcome"], row["what"], row["s"], max(row["MB"], largest))
        if row["resident"] > self._limit_mb / 2 or result.megabytes > self._limit_mb:
            self.close()
        complaints = [f"opens the network: {text}" for text in dict.fromkeys(sockets)]
        if result.megabytes > self._limit_mb:
            complaints.append(f"takes {result.megabytes:.0f} MB ({result.outcome})")
        if result.seconds > self._limit_s:
            complaints.append(f"takes {result.seconds:.1f} s ({result.outcome})")
        if complaints:
            kind = "; ".join([*complaints, *([result.what] if result.outcome == "finding" else [])])
            return Outcome(name, seed, "finding", kind, result.seconds, result.megabytes)
        return result

    def _start(self) -> None:
        self.close()
        self.base = Path(tempfile.mkdtemp(prefix="uq-fuzz-"))
        for name in ("cwd", "tmp", "home/.cache", "home/kept", "a/b"):
            (self.base / name).mkdir(parents=True)
        with contextlib.suppress(OSError):
            os.mkdir(OUTSIDE)
        read, write = os.pipe()
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "UQ_"))}
        environment |= {
            "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
            "TMPDIR": str(self.base / "tmp"),
            "HOME": str(self.base / "home"),
            "MPLCONFIGDIR": str(self.base / "home" / ".cache" / "mpl"),
            "PYTHONSAFEPATH": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "PYTHONFAULTHANDLER": "1",
        }
        self._child = subprocess.Popen(
            [sys.executable, "-m", self._module, str(self.base), str(write)],
            stdin=subprocess.PIPE,
            pass_fds=[write],
            cwd=self.base / "cwd",
            env=environment,
            start_new_session=True,
        )
        os.close(write)
        self._answers = os.fdopen(read, "rb")
        self._served = 0

    def _last_words(self) -> str:
        with contextlib.suppress(OSError):
            return " ".join(
                (self.base / "printed.txt").read_bytes()[-500:].decode("utf-8", "replace").split()
            )
        return ""

    def close(self) -> None:
        """End the child and what it started, and remove its folder."""
        if self._child is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()
        if self._child.stdin is not None:
            with contextlib.suppress(OSError):
                self._child.stdin.close()
        self._answers.close()
        self._child = None
        shutil.rmtree(self.base, ignore_errors=True)

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _ending(code: int) -> str:
    with contextlib.suppress(ValueError):
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return f"exit code {code}"


def by_number(names: Iterable[str], seed: int, inputs: int) -> Iterator[tuple[str, int]]:
    """``inputs`` seeds of each format, from ``seed``, format by format."""
    for name in names:
        for k in range(seed, seed + inputs):
            yield name, k


def by_time(
    shares: dict[str, float], counts: dict[str, Counts], seed: int, seconds: float
) -> Iterator[tuple[str, int]]:
    """Seeds of each format from ``seed`` on, the next of the one that has had least of its share,
    for so long.
    """
    end = time.monotonic() + seconds
    following = dict.fromkeys(shares, seed)
    while time.monotonic() < end:
        # Every input counts a millisecond: what costs nothing does not crowd out the rest.
        name = min(shares, key=lambda n: (counts[n].spent_s + 1e-3 * counts[n].inputs) / shares[n])
        yield name, following[name]
        following[name] += 1


def run(
    inputs: Iterable[tuple[str, int]],
    counts: dict[str, Counts],
    on_finding: Callable[[Outcome], None],
    module: str = "tests.fuzz.worker",
    limit_s: float = LIMIT_S,
    limit_mb: float = LIMIT_MB,
) -> None:
    """Try ``inputs`` one after another in one worker, and count them."""
    with Worker(module, limit_s, limit_mb) as worker:
        for name, seed in inputs:
            result = worker.attempt(name, seed)
            counts[name].add(result)
            if result.outcome == "finding":
                on_finding(result)
