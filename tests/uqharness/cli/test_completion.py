"""Completion scripts: what bash offers with them, and that completing loads nothing of this
program.
"""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from uqharness.cli import completion
from uqharness.cli import main as cli

bash = pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("completion") / "uqharness.bash"
    path.write_text(completion.script(cli.complete_parser(), "bash"))
    return path


def offered(script: Path, folder: Path, *words: str) -> set[str]:
    """What bash offers for the last word."""
    line = " ".join(shlex.quote(word) for word in words)
    code = (
        f"source {shlex.quote(str(script))}\nCOMP_WORDS=({line}); COMP_CWORD={len(words) - 1};"
        " _shtab_uqharness\n"
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", code + 'printf "%s\\n" "${COMPREPLY[@]}"'],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.split())


@bash
@pytest.mark.parametrize(
    ("words", "some"),
    [
        (("uqharness", ""), {"fly", "campaign", "log", "completion"}),
        (("uqharness", "cam"), {"campaign"}),
        (("uqharness", "campaign", "s"), {"status", "salvage"}),
        (("uqharness", "log", ""), {"info", "import", "export"}),
        (("uqharness", "modes", "espaaro", "--sp"), {"--speed-mps"}),
        (("uqharness", "fly", "esp"), {"espaaro", "espaaro_truth"}),
        (("uqharness", "report", "res"), {"results"}),
        (("uqharness", "log", "info", "fli"), {"flight.bin"}),
        (("uqharness", "fly", "espaaro", "--turbulence", "m"), {"moderate"}),
    ],
)
def test_bash_completes(script: Path, tmp_path: Path, words: tuple[str, ...], some: set[str]):
    (tmp_path / "results").mkdir()
    (tmp_path / "flight.bin").touch()
    result = offered(script, tmp_path, *words)
    assert some <= result
    assert "nonsense" not in result
    assert all(name.startswith(words[-1]) for name in result)


def test_zsh_has_every_command_and_the_aircraft(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["completion", "zsh", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["shell"] == "zsh"
    assert result["script"].startswith("#compdef uqharness")
    for name in (*cli.COMMANDS, *completion.known_aircraft(), "_uqharness_aircraft", "--speed-mps"):
        assert name in result["script"]
    assert "espaaro" in completion.known_aircraft()
