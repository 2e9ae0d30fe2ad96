"""Targets that do on purpose what the fuzzer is to find; a worker that serves them, for the
harness' own tests.
"""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.fuzz.formats import Format
from tests.fuzz.hostile import OUTSIDE
from tests.fuzz.outcome import Refused, call
from tests.fuzz.worker import main


def _raises(place: Path, seed: int) -> None:
    raise KeyError("state")


def _hangs(place: Path, seed: int) -> None:
    time.sleep(3600)


def _grows(place: Path, seed: int) -> None:
    np.ones(40_000_000)


def _grows_in_a_child(place: Path, seed: int) -> None:
    subprocess.run(
        [sys.executable, "-c", "import time; x = bytearray(b'x') * 300_000_000; time.sleep(0.1)"],
        check=True,
    )


def _writes(place: Path, seed: int) -> None:
    (place.parent / "canary.txt").write_text("x")


def _writes_far_away(place: Path, seed: int) -> None:
    Path(OUTSIDE, "written.csv").write_text("x")


def _writes_unseen(place: Path, seed: int) -> None:
    """By another program, as JSBSim does, of which the interpreter knows nothing."""
    subprocess.run(
        [sys.executable, "-c", f"open({str(place.parent / 'canary.txt')!r}, 'w')"], check=True
    )


def _removes(place: Path, seed: int) -> None:
    os.rmdir(place.parent.parent.parent / "home" / "kept")


def _leaves(place: Path, seed: int) -> None:
    (Path(os.environ["TMPDIR"]) / "left-behind").mkdir()


def _listens(place: Path, seed: int) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))


def _listens_in_a_child(place: Path, seed: int) -> None:
    code = (
        "import socket, time; s = socket.socket(); s.bind(('127.0.0.1', 0)); s.listen();"
        " time.sleep(1.5)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def _unpickles(place: Path, seed: int) -> None:
    pickle.loads(pickle.dumps(Path))


def _runs(place: Path, seed: int) -> None:
    subprocess.run(["true"], check=True)


def _aborts(place: Path, seed: int) -> None:
    os.abort()


def _leaves_the_process(place: Path, seed: int) -> None:
    os._exit(3)


def _refuses_with(text: str):
    def run(place: Path, seed: int) -> None:
        raise Refused(text.format(place=place))

    return run


def _refuses_a_layer_late(place: Path, seed: int) -> None:
    """The other layer's error where this one's is promised is no finding; a bare ValueError is."""
    call(int, "no number")


def _fine(place: Path, seed: int) -> None:
    (place / "out.txt").write_text("allowed")
    assert (place / "input.bin").is_file()


BAD = {
    "raises": _raises,
    "hangs": _hangs,
    "grows": _grows,
    "grows-in-a-child": _grows_in_a_child,
    "writes": _writes,
    "writes-far-away": _writes_far_away,
    "writes-unseen": _writes_unseen,
    "removes": _removes,
    "leaves": _leaves,
    "listens": _listens,
    "listens-in-a-child": _listens_in_a_child,
    "unpickles": _unpickles,
    "runs": _runs,
    "aborts": _aborts,
    "leaves-the-process": _leaves_the_process,
    "bare-error": _refuses_a_layer_late,
    "says-nothing": _refuses_with(""),
    "names-no-file": _refuses_with("something is wrong"),
    "prints-escapes": _refuses_with("{place}: \x1b[31mred"),
    "prints-bidi": _refuses_with("{place}: \u202egnp.exe"),
    "prints-a-traceback": _refuses_with("{place}: Traceback (most recent call last)"),
    "says-too-much": _refuses_with("{place}: first\nand more of it without a file"),
    "quotes-everything": _refuses_with("{place}: " + "x" * 9000),
}
GOOD = {
    "fine": _fine,
    "refuses": _refuses_with("{place}/input.bin: is damaged; copy it again"),
    "lists": _refuses_with("{place}/a.toml:1: one\n{place}/a.toml:2: two"),
}


def formats() -> dict[str, Format]:
    """Both kinds; every input is one file of the corpus."""
    source = ({"input.bin": "settings/effects.toml"},)
    return {
        name: Format(name, source, ("input.bin",), lambda data, _: data, run)
        for name, run in (BAD | GOOD).items()
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), formats())
