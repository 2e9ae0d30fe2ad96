"""The suite does not depend on the shell that starts it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.helpers.places import ROOT


@pytest.mark.skipif(sys.platform == "win32", reason="a shell's trap is POSIX")
def test_a_suite_started_with_ignored_interrupts_restores_them() -> None:
    query = "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    for first, restored in (
        ("", "False"),
        ("from tests.conftest import restore_signals; restore_signals(); ", "True"),
    ):
        words = [
            "/bin/sh",
            "-c",
            'trap "" INT; exec "$@"',
            "sh",
            sys.executable,
            "-c",
            first + query,
        ]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
        assert done.stdout.strip() == restored, done.stderr
