"""Every example of README.md and docs/*.md does what the page says."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from tests.helpers import doc_examples as de
from tests.helpers.doc_outputs import check_outputs
from tests.helpers.flying_here import flying_here

PAGES = {page.name: page for page in de.pages()}

LONG_PAGES = (
    "autopilot.md",
    "bring-your-own-aircraft.md",
    "campaigns.md",
    "diff.md",
    "dossier.md",
    "estimators.md",
    "instrument.md",
    "json.md",
    "logs.md",
    "python.md",
    "report.md",
    "statements.md",
    "tutorial.md",
)
"""Pages whose examples take more than a second of a core; `make test-slow` runs them."""


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG_PAGES else n for n in PAGES]
)
def test_examples_run(name: str, tmp_path: Path):
    with flying_here():
        de.run_page(PAGES[name], tmp_path, slow=False)
    if name == "README.md":
        # What the examples have written is at hand: the reference is held against it.
        assert check_outputs(tmp_path) >= 6


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("name", [name for name, page in PAGES.items() if de.differs(page)])
def test_examples_run_at_full_size(name: str, tmp_path: Path):
    de.run_page(PAGES[name], tmp_path, slow=True)


def test_no_example_is_passed_over(capsys: pytest.CaptureFixture[str]):
    result = [example for page in PAGES.values() for example in de.examples(page)]
    kinds = Counter(example.kind for example in result)
    unknown = [example.where for example in result if example.kind == "unknown"]
    assert unknown == [], "say in a marker what these are: see tests/helpers/doc_examples.py"
    assert kinds["shell"] + kinds["python"] + kinds["file"] >= 25
    with capsys.disabled():
        print(
            "\nexamples:", ", ".join(f"{number} {kind}" for kind, number in sorted(kinds.items()))
        )
        for where, reason in excluded(result):
            print(f"  {where}: {reason}")
    for where, reason in excluded(result):
        assert len(reason.split()) >= 3, f"{where}: that is no reason: {reason!r}"
    # A page with more exclusions than examples would be a page without tests.
    assert kinds["excluded"] < 0.5 * sum(kinds.values())


def excluded(result: list[de.Example]) -> list[tuple[str, str]]:
    """Place and reason of everything that no set runs, and of what the slow set alone runs."""
    listed = []
    for example in result:
        for value in example.all("not run"):
            listed.append((example.where, f"not run: {value}"))
        for key, options in (("leave out", "is left out"), ("slow line", "in the slow set")):
            for value in example.all(key):
                line, reason = value.split(" -- ")
                listed.append((example.where, f"'{line}' {options}: {reason}"))
        for value in example.all("slow"):
            listed.append((example.where, f"slow set: {value}"))
        if example.kind == "shell":
            for target in re.findall(r"^make (\S+)", example.text, re.M):
                if target in de.MAKE_LEFT_OUT:
                    listed.append(
                        (example.where, f"make {target} is left out: it {de.MAKE_LEFT_OUT[target]}")
                    )
    return listed


@pytest.mark.parametrize("name", PAGES)
def test_commands_in_the_text_have_the_options_they_name(name: str):
    for text in re.findall(r"`(uqharness [^`\n]+)`", PAGES[name].read_text(encoding="utf-8")):
        de.check_options(text, text, name)


def one(text: str) -> de.Example:
    (result,) = de.examples_of(text, "page.md")
    return result


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("    uqharness modes espaaro --speed-mps 20\n", "shell"),
        ("    .venv/bin/uqharness modes espaaro\n    make demo   # all of it\n", "shell"),
        ("    uqharness modes AIRCRAFT [--json]\n", "synopsis"),
        ("    [campaign]\n    seed = 1\n", "toml"),
        ('    [stop]\n    rule = "a"\n\n    [stop]\n    rule = "b"\n', "toml"),
        ("    import numpy as np\n", "python"),
        ("```python\nx = 1\n```\n", "python"),
        ("    CX = CX_0 + CX_alpha alpha\n", "unknown"),
        ("- a list\n\n      effect: something\n", "unknown"),
        (
            "<!-- example:\nnot run: an equation\n-->\n\n    CX = CX_0 + CX_alpha alpha\n",
            "excluded",
        ),
        ("<!-- example:\nfile: a.toml\n-->\n    a = 1\n", "file"),
    ],
)
def test_kinds(text: str, kind: str):
    assert one(text).kind == kind


def test_a_wrong_example_is_seen(tmp_path: Path):
    scratch = de.Scratch(tmp_path)
    with pytest.raises(AssertionError, match=r"page.md:1: uqharness modes nowhere.*\nexit code 2"):
        scratch.run(one("    uqharness modes nowhere --speed-mps 20\n"), slow=False)
    with pytest.raises(AssertionError, match="exit code 3"):
        scratch.run(one("```sh\npython -c 'raise SystemExit(3)'\n```\n"), slow=False)
    with pytest.raises(NameError):
        scratch.run(one("```python\nundefined\n```\n"), slow=False)
    with pytest.raises(AssertionError, match="has no option"):
        scratch.run(one("    uqharness modes AIRCRAFT --speed V\n"), slow=False)
    with pytest.raises(AssertionError, match="no command"):
        scratch.run(one("    uqharness moods AIRCRAFT\n"), slow=False)
    with pytest.raises(KeyError, match="no target"):
        scratch.run(one("    make coffee\n"), slow=False)


def test_markers_reduce_and_refuse():
    example = one(
        "<!-- example:\nfast: --hours 10 => --hours 1\n-->\n    uqharness campaign run demo --hours"
        " 10 --out x\n"
    )
    assert example.commands(slow=False) == ["uqharness campaign run demo --hours 1 --out x"]
    assert example.commands(slow=True) == ["uqharness campaign run demo --hours 10 --out x"]
    with pytest.raises(ValueError, match="is no directive"):
        one("<!-- example:\nskip: it\n-->\n    uqharness modes espaaro\n")
    with pytest.raises(ValueError, match="right before its block"):
        one("<!-- example:\nslow: it\n-->\n\nwords\n\n    uqharness modes espaaro\n")
