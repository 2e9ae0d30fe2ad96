"""The suite does not depend on the shell that starts it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.places import ROOT

TEST = """
import signal

def test_children_can_be_interrupted():
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a shell's trap is POSIX")
def test_a_suite_started_with_ignored_interrupts_restores_them(tmp_path: Path) -> None:
    (tmp_path / "test_signals.py").write_text(TEST)
    arguments = ["-p", "tests.conftest", "-p", "no:cacheprovider", "--rootdir", str(tmp_path)]
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", *arguments]
    for plugins, code in ((arguments, 0), ([], 1)):
        process = subprocess.run(
            [
                "/bin/sh",
                "-c",
                'trap "" INT; exec "$@"',
                "sh",
                *command[:6],
                *plugins,
                str(tmp_path),
            ],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
        assert process.returncode == code, process.stdout
