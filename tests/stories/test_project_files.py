"""Files for people who work on the project: hooks, workflow, forms, changelog,
contributor's page.
"""

from __future__ import annotations

import re
import runpy
import tomllib
from typing import Any

import pytest
import yaml

from tests.conftest import LONGEST_FILES
from tests.helpers.doc_names import check_commands, wrong_folders, wrong_places
from tests.helpers.places import ROOT

CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def loaded(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def lint_commands(makefile: str) -> list[str]:
    """Programs of the lint target, without their folder and what they are given."""
    recipe = re.search(r"^lint:.*\n((?:\t.*\n)+)", makefile, re.M)
    assert recipe
    words = [line.strip().removeprefix("$(BIN)/").split() for line in recipe[1].splitlines()]
    return [" ".join(w for w in line if w not in (".", "--check")) for line in words]


def test_the_hooks_are_what_lint_checks():
    hooks = [hook for repo in loaded(".pre-commit-config.yaml")["repos"] for hook in repo["hooks"]]
    assert [hook["entry"].removeprefix(".venv/bin/") for hook in hooks] == lint_commands(MAKEFILE)
    assert lint_commands("lint: setup\n\t$(BIN)/other .\n") == ["other"]


def test_the_files_that_start_first_are_there():
    assert [name for name in LONGEST_FILES if not (ROOT / name).is_file()] == []


def test_the_workflow_runs_the_readmes_command_on_every_system():
    job = loaded(".github/workflows/ci.yml")["jobs"]["test"]
    matrix = job["strategy"]["matrix"]
    assert {name.split("-")[0] for name in matrix["system"]} == {"ubuntu", "macos", "windows"}
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert job["steps"][-1]["run"].startswith("make test ")
    assert "    make test " in (ROOT / "README.md").read_text(encoding="utf-8")


def test_a_release_is_built_and_published_without_a_stored_secret():
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    assert [jobs[name].get("needs") for name in ("build", "publish", "notes")] == [
        None,
        "build",
        "publish",
    ]
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    assert "secrets." not in text
    used = {
        step["uses"].partition("@")[0]
        for job in jobs.values()
        for step in job["steps"]
        if "uses" in step
    }
    assert "pypa/gh-action-pypi-publish" in used
    for step in (step["run"] for step in jobs["build"]["steps"] if "run" in step):
        for place in re.findall(r"(?:\.ci|tests)/[\w./]+", step):
            assert (ROOT / place).is_file()


def test_release_notes_are_the_changelogs_section(capsys: pytest.CaptureFixture[str]):
    notes = runpy.run_path(str(ROOT / ".ci" / "release_notes.py"))
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    assert notes["main"]([version]) == 0
    output = capsys.readouterr().out
    assert output.startswith("### ")
    assert "\n## " not in output
    assert output.strip() in CHANGELOG
    assert notes["main"](["0.0.1"]) == 1
    assert "pyproject.toml has" in capsys.readouterr().err
    assert (
        notes["section"]("## 1.0.0 (2026-01-01)\n\nnew\n\n## 0.9.0 (2025-01-01)\n\nold\n", "0.9.0")
        == "old"
    )
    assert notes["section"]("## Unreleased\n\nnew\n", "1.0.0") == ""


def test_the_conda_recipe_asks_for_what_the_wheel_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = loaded("recipe/recipe.yaml")
    request = {re.sub(r"\s|-base", "", line) for line in recipe["requirements"]["run"]}
    assert request == {f"python{project['requires-python']}", *project["dependencies"]}
    assert recipe["context"]["version"] == project["version"]
    (entry,) = recipe["build"]["python"]["entry_points"]
    assert entry == f"uqharness = {project['scripts']['uqharness']}"


def test_the_changelog_begins_with_this_release():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    releases = re.findall(r"^## (.+)$", CHANGELOG, re.M)
    coming = re.fullmatch(r"\d+\.\d+\.\d+ \(not yet released\)", releases[0]) is not None
    released = releases[1:] if coming else releases
    assert all(
        re.fullmatch(
            r"[\d.]+( to [\d.]+)? \(\d{4}-\d\d-\d\d( to \d{4}-\d\d-\d\d)?\)|Unreleased", name
        )
        for name in released
    )
    assert version.removesuffix(".dev0") in (
        releases[0] if version not in released[0] else released[0]
    )
    assert set(re.findall(r"^### (.+)$", CHANGELOG, re.M)) <= {
        "Added",
        "Changed",
        "Removed",
        "Fixed",
    }


def test_the_contributors_page_names_what_there_is():
    assert wrong_places(CONTRIBUTING) == []
    assert wrong_folders(CONTRIBUTING) == []
    check_commands(CONTRIBUTING, "CONTRIBUTING.md")
    listed = set(re.findall(r"`make ([a-z-]+)`", CONTRIBUTING))
    targets = set(re.findall(r"^([a-z-]+):", MAKEFILE, re.M))
    assert len(listed) >= 8
    assert listed <= targets
