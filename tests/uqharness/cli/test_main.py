"""The command line as a whole: what loads, and errors as one line and an exit code."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.helpers.places import ROOT
from uqharness.cli import main as cli

HEAVY = ("numpy", "scipy", "pandas", "pyarrow", "jsbsim", "lxml", "pydantic", "rich", "matplotlib")


def loaded(*words: str) -> list[str]:
    """Heavy modules that a command line loads."""
    code = (
        "import json, sys\n"
        "from uqharness.__main__ import main\n"
        "try:\n"
        f"    main({list(words)!r})\n"
        "except SystemExit:\n"
        "    pass\n"
        f"sys.stderr.write(json.dumps([name for name in {HEAVY!r} if name in sys.modules]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return list(json.loads(done.stderr))


@pytest.mark.parametrize("words", [("--help",), ("--version",), ("campaign", "--help")])
def test_help_loads_no_numerical_library(words: tuple[str, ...]) -> None:
    assert loaded(*words) == []


def test_a_command_s_help_loads_its_request_alone() -> None:
    assert loaded("modes", "--help") == ["pydantic"]


def test_complete_parser_has_the_verbs_and_loading_names_them() -> None:
    campaign = cli.commands_of(cli.complete_parser())["campaign"]
    assert {"check", "run", "status", "report", "rerun"} <= set(cli.commands_of(campaign))
    cli.load_command(["campaign", "status", "folder"])
    assert "uqharness.requests.campaign" in sys.modules
    cli.load_command(["no-such-command"])
