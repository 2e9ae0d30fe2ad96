"""What a command may not do with an input: write outside its folders, open the network, unpickle,
start foreign programs.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = frozenset(
    {
        "os.remove",
        "os.rename",
        "os.rmdir",
        "os.mkdir",
        "os.link",
        "os.symlink",
        "os.chmod",
        "os.truncate",
        "shutil.rmtree",
    }
)
# Their last argument is the open folder that a relative path begins at, or -1.
_FROM_A_FOLDER = frozenset({"os.remove", "os.rmdir", "os.mkdir"})
_NETWORK = (
    "socket.bind",
    "socket.connect",
    "socket.sendto",
    "socket.getaddrinfo",
    "socket.gethostbyname",
)
# Matplotlib asks it for fonts, once.
_HARMLESS = frozenset({"fc-list"})
_PROGRAMS = ("os.system", "os.exec", "os.posix_spawn", "os.startfile", "os.fork")


class Guard:
    """Told of by the interpreter whatever is done while ``watching``; ``allowed`` are the folders
    that may be written to.
    """

    def __init__(self, allowed: tuple[Path, ...]) -> None:
        self._allowed = tuple(str(path) for path in allowed)
        self._on = False
        self.seen: list[str] = []
        sys.addaudithook(self._hook)

    @contextlib.contextmanager
    def watching(self) -> Iterator[list[str]]:
        """Collects deeds into the list that is given, as sentences."""
        self.seen, self._on = [], True
        try:
            yield self.seen
        finally:
            self._on = False

    def _hook(self, event: str, args: tuple[Any, ...]) -> None:
        if not self._on:
            return
        if event == "open":
            path, mode, flags = args
            writes = (
                flags & _WRITES
                if isinstance(flags, int)
                else isinstance(mode, str) and not set(mode) <= set("rbtU")
            )
            if writes and isinstance(path, (str, bytes)):
                self._changed("writes", path)
        elif event in _CHANGES:
            for path in (
                args[:2]
                if event in ("os.rename", "os.link")
                else args[1:2]
                if event == "os.symlink"
                else args[:1]
            ):
                if isinstance(path, (str, bytes, os.PathLike)):
                    self._changed(event, _from(args[-1], path) if event in _FROM_A_FOLDER else path)
        elif event in _NETWORK:
            address = (
                args[1] if event in ("socket.bind", "socket.connect", "socket.sendto") else args[:2]
            )
            if not isinstance(address, (str, bytes)):  # a name in the file system is no network
                self.seen.append(f"{event} {address!r}")
        elif event in _PROGRAMS and event != "os.fork":
            self.seen.append(f"{event} {args[:2]!r}")
        elif event == "subprocess.Popen":
            program = str(args[0] or args[1][0])
            if program != sys.executable and program not in _HARMLESS:
                self.seen.append(f"starts {args[1]!r}")
        elif event == "pickle.find_class" and not _in_isolation():
            self.seen.append(f"unpickles {args[0]}.{args[1]}")

    def _changed(self, deed: str, path: Any) -> None:
        full = os.path.abspath(os.fsdecode(path))
        if (
            not any(full == root or full.startswith(root + os.sep) for root in self._allowed)
            and full != os.devnull
            and not (full.startswith("/dev/shm/pym-") and _in_isolation())
        ):
            self.seen.append(f"{deed} {full}")


def _in_isolation() -> bool:
    """Return whether `uqharness.isolation` speaks with its own worker, over a pipe and a clock."""
    frame = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_filename.endswith(os.path.join("uqharness", "isolation.py")):
            return True
        frame = frame.f_back
    return False


def _from(folder: Any, path: Any) -> str:
    with contextlib.suppress(OSError, TypeError):
        return os.path.join(os.readlink(f"/proc/self/fd/{folder:d}"), os.fsdecode(path))
    return os.fsdecode(path)


def tree(*folders: Path) -> dict[str, tuple[int, int]]:
    """Every file below ``folders`` with its size and time: what a program leaves behind that Python
    does not see.
    """
    result = {}
    for folder in folders:
        for root, _, names in os.walk(folder):
            result[root] = (0, 0)
            for name in names:
                path = os.path.join(root, name)
                with contextlib.suppress(OSError):
                    status = os.lstat(path)
                    result[path] = (status.st_size, status.st_mtime_ns)
    return result


def internet_sockets(pids: list[int]) -> list[str]:
    """Internet sockets of these processes (Linux; none elsewhere)."""
    mine = set()
    for pid in pids:
        with contextlib.suppress(OSError):
            for name in os.listdir(f"/proc/{pid}/fd"):
                with contextlib.suppress(OSError):
                    target = os.readlink(f"/proc/{pid}/fd/{name}")
                    if target.startswith("socket:["):
                        mine.add(target[8:-1])
    if not mine:
        return []
    result = []
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        with contextlib.suppress(OSError):
            rows = Path(f"/proc/{pids[0]}/net/{kind}").read_text().splitlines()[1:]
            result += [
                f"{kind} {row.split()[1]} -> {row.split()[2]}"
                for row in rows
                if row.split()[9] in mine
            ]
    return result


def session_of(pid: int) -> list[int]:
    """Processes of the session that ``pid`` leads, itself included (Linux; itself alone
    elsewhere).
    """
    result = [pid]
    with contextlib.suppress(OSError):
        for name in os.listdir("/proc"):
            if name.isdigit() and int(name) != pid:
                with contextlib.suppress(OSError, IndexError, ValueError):
                    # The name in brackets may hold anything; what follows it is numbers.
                    fields = Path(f"/proc/{name}/stat").read_text().rpartition(")")[2].split()
                    if int(fields[3]) == pid:
                        result.append(int(name))
    return result


def peak_mb(pid: int | str = "self") -> float:
    """Largest resident memory of the process since it was last forgotten, MB; NaN where the system
    does not tell.
    """
    return _status(pid, "VmHWM:")


def resident_mb(pid: int | str = "self") -> float:
    """Resident memory of the process now, MB; NaN where the system does not tell."""
    return _status(pid, "VmRSS:")


def _status(pid: int | str, key: str) -> float:
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith(key):
                return int(line.split()[1]) / 1024.0
    return float("nan")


def forget_peak() -> None:
    """Begin a new measurement of this process' peak."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
