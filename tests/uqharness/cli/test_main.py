"""The command line as a whole: what loads, and errors as one line and an exit code."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import pytest

from sysid.errors import LogError
from tests.helpers.places import ROOT
from uqharness.cli import main as cli
from uqharness.errors import BadInputError

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


def test_an_error_of_a_log_is_bad_input(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def handler(_: object) -> int:
        raise LogError("no log at all", Path("x.bin"))

    parser = cli.build_parser()
    monkeypatch.setattr(
        parser, "parse_known_args", lambda _: (argparse.Namespace(handler=handler), [])
    )
    monkeypatch.setattr(cli, "build_parser", lambda: parser)
    with pytest.raises(BadInputError, match="no log at all"):
        cli.run_words([])
    assert cli.main([]) == 2
    said = capsys.readouterr().err
    assert said.startswith("uqharness: error: ")
    assert "x.bin" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("modes", "espaaro", "--speed-mps", "0"), "--speed-mps 0: a number above 0 is needed"),
        (
            ("modes", "espaaro", "--speed-mps", "22", "--bank-deg", "85"),
            "--bank-deg 85: a number above -85 and below 85 is needed",
        ),
        (
            ("fly", "espaaro", "--seed", "-1", "--out", "x.csv"),
            "--seed -1: a whole number of at least 0",
        ),
        (
            ("fly", "espaaro", "--rate-hz", "0", "--out", "x.csv"),
            "--rate-hz 0: a number above 0 and up to 100000",
        ),
    ],
)
def test_an_option_beyond_its_limits_is_one_line_and_exit_code_2(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"uqharness: error: {said}")
    assert error.count("\n") == 1


def test_complete_parser_has_the_verbs_and_loading_names_them() -> None:
    campaign = cli.commands_of(cli.complete_parser())["campaign"]
    assert {
        "check",
        "run",
        "status",
        "report",
        "merge",
        "rerun",
        "verify",
        "salvage",
        "convergence",
        "area",
    } == set(cli.commands_of(campaign))
    cli.load_command(["campaign", "status", "folder"])
    assert "uqharness.requests.campaign" in sys.modules
    cli.load_command(["no-such-command"])
