"""An aircraft as it stood in a revision of a git repository."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from tests.helpers.places import ROOT
from uqharness.differences import aircraft_at, revisions
from uqharness.errors import BadInputError

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Two revisions of an aircraft, the working copy being a third."""
    shutil.copytree(ROOT / "aircraft" / "espaaro", tmp_path / "models" / "espaaro")
    card = tmp_path / "models" / "espaaro" / "airframe.toml"

    def git(*words):
        specific = [
            "-c",
            "user.name=x",
            "-c",
            "user.email=x@example.org",
            "-c",
            "commit.gpgsign=false",
        ]
        subprocess.run(["git", *specific, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init", "-q")
    for number in (1, 2, 3):
        card.write_text(
            f"# revision {number}\n" + card.read_text(encoding="utf-8"), encoding="utf-8"
        )
        if number < 3:
            git("add", "-A")
            git("commit", "-q", "-m", str(number))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def first_line(aircraft) -> str:
    return (aircraft.folder / "airframe.toml").read_text(encoding="utf-8").splitlines()[0]


def test_revisions_and_the_working_copy(repository, tmp_path, monkeypatch):
    assert first_line(aircraft_at("HEAD~1:models/espaaro", tmp_path / "one")) == "# revision 1"
    assert first_line(aircraft_at("HEAD:models/espaaro", tmp_path / "two")) == "# revision 2"
    assert first_line(aircraft_at("models/espaaro", tmp_path / "three")) == "# revision 3"
    monkeypatch.chdir(repository / "models")
    assert first_line(aircraft_at("HEAD:espaaro", tmp_path / "four")) == "# revision 2"


def test_what_is_not_there_is_told(repository, tmp_path):
    for text in ("nowhere:models/espaaro", "HEAD:models/none"):
        with pytest.raises(BadInputError, match="REVISION:FOLDER"):
            aircraft_at(text, tmp_path / "x")


def run_git(folder, *words, **options):
    specific = ["-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false"]
    return subprocess.run(
        ["git", *specific, *words], cwd=folder, check=True, capture_output=True, **options
    ).stdout


@pytest.fixture
def hostile(repository, tmp_path_factory):
    """The same with a configuration that names a program wherever git knows of one; the file that
    the program makes.
    """
    ran = tmp_path_factory.mktemp("ran") / "ran"
    command = f"sh -c 'echo $0 >> {ran}; cat'"
    settings = {
        "filter.x.smudge": command,
        "filter.x.clean": command,
        "filter.x.process": command,
        "filter.x.required": "true",
        "core.fsmonitor": command,
        "core.sshCommand": command,
        "core.gitProxy": command,
        "core.alternateRefsCommand": command,
        "core.pager": command,
        "core.hooksPath": str(repository / "hooks"),
        "diff.x.textconv": command,
        "tar.tar.command": command,
        "pager.cat-file": command,
        "remote.origin.url": f"ext::sh -c 'touch {ran}'",
        "remote.origin.promisor": "true",
        "remote.origin.partialclonefilter": "blob:none",
        "remote.origin.uploadpack": command,
        "extensions.partialClone": "origin",
        "protocol.ext.allow": "always",
        "protocol.file.allow": "always",
    }
    for name, value in settings.items():
        run_git(repository, "config", name, value)
    (repository / ".git" / "info").mkdir(exist_ok=True)
    (repository / ".git" / "info" / "attributes").write_text("* filter=x diff=x export-subst\n")
    hooks = repository / "hooks"
    hooks.mkdir()
    for name in ("post-checkout", "reference-transaction", "pre-auto-gc", "post-index-change"):
        (hooks / name).write_text(f"#!/bin/sh\necho {name} >> {ran}\n")
        (hooks / name).chmod(0o755)
    return ran


@pytest.mark.parametrize("url", ["ext", "local"])
def test_nothing_of_the_repository_runs(hostile, repository, tmp_path, url):
    if url == "local":
        run_git(repository, "config", "remote.origin.url", str(repository))
    assert first_line(aircraft_at("HEAD:models/espaaro", tmp_path / "one")) == "# revision 2"
    assert not hostile.exists()
    # An object that only the remote has: git itself would fetch it there.
    blob = run_git(repository, "rev-parse", "HEAD:models/espaaro/airframe.toml").decode().strip()
    (repository / ".git" / "objects" / blob[:2] / blob[2:]).unlink()
    with pytest.raises(BadInputError, match="HEAD:models/espaaro"):
        aircraft_at("HEAD:models/espaaro", tmp_path / "two")
    assert not hostile.exists()


def test_the_configuration_would_run_something(hostile, repository):
    """The hostile repository is one: git's own archive runs its filter."""
    subprocess.run(["git", "archive", "HEAD"], cwd=repository, capture_output=True, check=False)
    assert hostile.exists()


ODD = {
    "HEAD:--output=FILE": "no folder --output=FILE",
    "--exec=x;:--remote=y": "no revision",
    "--output=x:models/espaaro": "no revision",
    "--all:models/espaaro": "no revision",
    "HEAD:/etc": "outside the repository",
    "HEAD:../..": "outside the repository",
    "HEAD:.": "outside the repository",
    "HEAD:models/*": "no folder models",
    "HEAD::(glob)**": "no folder",
    "HEAD:models/espaaro/airframe.toml": "no folder",
    "HEAD:" + "a" * 5000: "no folder",
    "HEAD..HEAD~1:models/espaaro": "no revision",
    "HEAD:a\0b": "HEAD",
}


def test_odd_revisions_and_paths(repository, tmp_path):
    for text, words in ODD.items():
        with pytest.raises(BadInputError, match=words) as reports:
            aircraft_at(text, tmp_path / "x")
        assert "\n" not in str(reports.value)
        assert len(str(reports.value)) < 700
        assert not (repository / "FILE").exists()


def test_what_is_too_large_is_not_read(repository, tmp_path, monkeypatch):
    with (repository / "models" / "espaaro" / "zeros").open("wb") as handle:
        handle.truncate(70_000_000)
    run_git(repository, "add", "-A")
    run_git(repository, "commit", "-q", "-m", "zeros")
    read = []
    before = revisions._Reader._run
    monkeypatch.setattr(
        revisions._Reader, "_run", lambda *inputs: read.append(inputs[1][0]) or before(*inputs)
    )
    with pytest.raises(BadInputError, match=r"70\.\d MB"):
        aircraft_at("HEAD:models/espaaro", tmp_path / "x")
    assert "cat-file" not in read


def test_names_that_lead_out_are_refused(repository, tmp_path):
    blob = run_git(repository, "hash-object", "-w", "--stdin", input=b"x").decode().strip()
    words = ("hash-object", "-t", "tree", "-w", "--literally", "--stdin")
    for name in ("..", "../../b", "a\\b"):
        entry = b"100644 " + name.encode() + b"\0" + bytes.fromhex(blob)
        tree = run_git(repository, *words, input=entry).decode().strip()
        top = b"40000 models\0" + bytes.fromhex(tree)
        tree = run_git(repository, *words, input=top).decode().strip()
        commit = run_git(repository, "commit-tree", tree, "-m", "x").decode().strip()
        with pytest.raises(BadInputError):
            aircraft_at(f"{commit}:models", tmp_path / "x" / "y")
        assert not list((tmp_path / "x").rglob("b"))


def test_objects_elsewhere_are_refused(repository, tmp_path):
    (repository / ".git" / "objects" / "info" / "alternates").write_text(
        "/home/somebody/.git/objects\n"
    )
    with pytest.raises(BadInputError, match="alternates"):
        aircraft_at("HEAD:models/espaaro", tmp_path / "x")


def test_worktrees_tags_and_packed_references(repository, tmp_path, monkeypatch):
    run_git(repository, "tag", "-a", "v1", "-m", "v1", "HEAD~1")
    run_git(repository, "worktree", "add", "-q", str(tmp_path / "tree"), "HEAD~1")
    run_git(repository, "gc", "-q")
    assert first_line(aircraft_at("v1:models/espaaro", tmp_path / "one")) == "# revision 1"
    monkeypatch.chdir(tmp_path / "tree")
    assert first_line(aircraft_at("HEAD:models/espaaro", tmp_path / "two")) == "# revision 1"
