"""The examples in the docstrings of the public face give what they say."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

from tests.helpers.docstrings import example_of, public_functions

pytestmark = pytest.mark.usefixtures("flights_here")

SLOW = {
    "campaign_area",
    "campaign_convergence",
    "campaign_report",
    "campaign_status",
    "check_campaign",
    "diff",
    "dossier",
    "export_log",
    "margins",
    "next_flight",
    "performance",
    "refine",
    "report",
    "rerun_case",
    "salvage_campaign",
    "study",
    "validate_bounds",
    "verify",
}
"""Examples that take minutes, or start processes of their own."""

FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def run(name: str, text: str) -> list[str]:
    """What an example gave other than it says, none if it is right."""
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    assert test.examples, f"{name} has no example"
    output: list[str] = []
    doctest.DocTestRunner(verbose=False, optionflags=FLAGS).run(test, out=output.append)
    return output


@pytest.mark.parametrize(
    ("face", "name"),
    [
        pytest.param(face, name, marks=pytest.mark.slow if name in SLOW else ())
        for face, name in public_functions()
    ],
)
def test_docstring_example_gives_its_output(
    face: str,
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture,
):
    monkeypatch.chdir(tmp_path)
    assert run(name, example_of(getattr(importlib.import_module(face), name))) == []
    # The functions print nothing of their own.
    assert capfd.readouterr() == ("", "")


def test_a_wrong_example_is_seen():
    assert run("wrong", ">>> 1 + 1\n3\n") != []
    assert run("failing", ">>> undefined\n1\n") != []
    assert run("right", ">>> 1 + 1\n2\n") == []
