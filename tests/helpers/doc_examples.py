"""Examples of README.md and docs/*.md: found, sorted into kinds, and run in a scratch copy of the
project.

What an example needs beside its text stands in an HTML comment right before it, one directive a
line:

    <!-- example:
    slow: REASON             run in the slow set alone
    fast: OLD => NEW         the fast set runs the text with OLD replaced by NEW; the slow set as it
    stands
    before: COMMAND          run first: what the page takes as given
    file: NAME               the block is the content of that file
    then: COMMAND            run afterwards, to see that the block is right
    exit: N                  the exit code of the last command (default 0)
    leave out: LINE -- REASON      lines that begin so are not run
    slow line: LINE -- REASON      lines that begin so are run in the slow set alone
    not run: REASON          the block is not run
    -->

``python -m tests.helpers.doc_examples [--slow] [PAGE...]`` runs them and prints how long each took.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt
from pydantic import ValidationError

from tests.helpers.places import ROOT
from uqharness.campaign.spec import (
    AleatorySection,
    CampaignSection,
    EpistemicSection,
    MetricsSection,
    StopSection,
)
from uqharness.cli import main as cli
from uqharness.simulator.own_mission import StartSection

PROGRAMS = {"uqharness", "make", "python", "jsbsim", "pip", "dask", "cd", "mkdir", "cp"}
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")
CAMPAIGN_SECTIONS = {
    "campaign": CampaignSection,
    "aleatory": AleatorySection,
    "epistemic": EpistemicSection,
    "metrics": MetricsSection,
    "start": StartSection,
    "stop": StopSection,
}
DIRECTIVES = {"slow", "fast", "before", "file", "then", "exit", "leave out", "slow line", "not run"}
# Lines that would run the test that runs them, install, or ask the network; every other make target
# is run.
MAKE_LEFT_OUT = {
    "setup": "installs the environment that the examples run in",
    "test": "is what runs the examples",
    "test-slow": "is what runs the examples",
    "test-browser": "opens pages in a browser, as CI does",
    "lint": "is part of make test",
    "bench": "measures for minutes and answers nothing; tests run its parts",
    "lock": "asks the package index",
    "clean": "removes the environment that the examples run in",
    "docs": "builds these pages, which a test of its own does",
}
MAKE_SLOW = {"demo"}
OURS = ("uqharness", "sysid", "tests", "campaigns")
"""Packages whose programs are asked for their help in this process."""
# The console program of JSBSim's wheel, by its entry point: it need not lie beside the interpreter.
JSBSIM = (
    "import sys; from importlib.metadata import entry_points as e;"
    " sys.exit(next(iter(e(name='jsbsim'))).load()())"
)
# Fences that are no example: equations and directives of the built site.
NO_EXAMPLE = re.compile(r"math$|\{[a-z-]+\}")


@dataclass(frozen=True)
class Example:
    """One block of a page. ``kind``: shell, python, toml, synopsis, file, excluded or unknown."""

    page: str
    line: int
    text: str
    kind: str
    directives: tuple[tuple[str, str], ...] = ()

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"

    def all(self, name: str) -> list[str]:
        return [value for key, value in self.directives if key == name]

    def one(self, name: str) -> str | None:
        return next(iter(self.all(name)), None)

    def commands(self, slow: bool) -> list[str]:
        """Lines of a shell block as they are run: joined at backslashes, the left-out ones gone,
        the fast ones reduced.
        """
        marks = self.all("leave out") + ([] if slow else self.all("slow line"))
        left_out = [value.split(" -- ")[0].strip() for value in marks]
        lines = [line.strip() for line in re.sub(r"\\\n\s*", " ", self.text).splitlines()]
        retained = [line for line in lines if line and not line.startswith("#")]
        retained = [line for line in retained if not any(line.startswith(out) for out in left_out)]
        retained = [line for line in retained if make_runs(line, slow)]
        return retained if slow else [self.reduced(line) for line in retained]

    def reduced(self, text: str) -> str:
        """The text at the fast set's size."""
        for value in self.all("fast"):
            old, new = (part.strip() for part in value.split("=>"))
            text = text.replace(old, new)
        return text


def make_runs(line: str, slow: bool) -> bool:
    """Whether a line is to be run, as far as make is concerned.

    Raises KeyError for a target that the Makefile lacks.
    """
    words = shlex.split(line, comments=True)
    if words[:1] != ["make"]:
        return True
    for target in words[1:]:
        if not re.search(
            rf"^{re.escape(target)}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M
        ):
            raise KeyError(f"the Makefile has no target '{target}'")
    return not any(word in MAKE_LEFT_OUT or (word in MAKE_SLOW and not slow) for word in words[1:])


def pages() -> list[Path]:
    """The pages whose examples are run."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def examples(page: Path) -> list[Example]:
    """Every block of code of a page, in order.

    Raises ValueError for a marker that means nothing.
    """
    return examples_of(page.read_text(encoding="utf-8"), page.name)


def examples_of(text: str, name: str) -> list[Example]:
    result = []
    marker: tuple[tuple[str, str], ...] = ()
    for token in MarkdownIt("commonmark").enable("table").parse(text):
        line = token.map[0] + 1 if token.map else 0
        if token.type == "html_block" and token.content.startswith("<!-- example:"):
            marker = directives(token.content, f"{name}:{line}")
        elif token.type in {"fence", "code_block"}:
            info = token.info.strip()
            if not NO_EXAMPLE.match(info):
                kind = kind_of(token.content, info, marker)
                result.append(Example(name, line, token.content, kind, marker))
            marker = ()
        elif marker and token.type.endswith("_open"):
            raise ValueError(
                f"{name}:{line}: a marker of examples must stand right before its block"
            )
    return result


def directives(comment: str, where: str) -> tuple[tuple[str, str], ...]:
    body = comment.strip().removeprefix("<!-- example:").removesuffix("-->")
    result = []
    for line in filter(None, map(str.strip, body.splitlines())):
        key, colon, value = line.partition(":")
        if key not in DIRECTIVES or not colon or not value.strip():
            raise ValueError(
                f"{where}: '{line}' is no directive; there are: {', '.join(sorted(DIRECTIVES))},"
                " each with ': ...'"
            )
        if key == "fast" and "=>" not in value:
            raise ValueError(f"{where}: '{line}': fast: OLD => NEW")
        if key in {"leave out", "slow line"} and " -- " not in value:
            raise ValueError(f"{where}: '{line}': {key}: LINE -- REASON")
        result.append((key, value.strip()))
    return tuple(result)


def kind_of(text: str, info: str, marker: tuple[tuple[str, str], ...]) -> str:
    """What sort of example a block is, by its fence, its marker or its look."""
    keys = {key for key, _ in marker}
    if "not run" in keys:
        return "excluded"
    if "file" in keys:
        return "file"
    if info in {"python", "toml"}:
        return info
    out = [value.split(" -- ")[0].strip() for key, value in marker if key == "leave out"]
    lines = [
        line for line in text.splitlines() if line.strip() and not line.strip().startswith("#")
    ]
    lines = [line for line in lines if not any(line.strip().startswith(word) for word in out)]
    first = [program(line) for line in lines if line[0] != " "]
    if info in {"bash", "sh", "shell"} or (first and all(word in PROGRAMS for word in first)):
        complete = "\n".join(re.sub(r"\s#.*", "", line) for line in lines)
        placeholder = re.search(r"\[-|\.\.\.|\b(AIRCRAFT|DIR|FILE|LOG)\b", complete)
        return "synopsis" if placeholder else "shell"
    if any(paragraphs_are(tomllib.loads, text, tomllib.TOMLDecodeError)):
        return "toml"
    if "import " in text and any(paragraphs_are(ast.parse, text, SyntaxError)):
        return "python"
    return "unknown"


def paragraphs_are(parse: object, text: str, error: type[Exception]) -> Iterator[bool]:
    """True once if the text, or else every paragraph of it, can be parsed (a page may show
    alternatives in one block).
    """
    for parts in ([text], re.split(r"\n\s*\n", text)):
        try:
            for part in parts:
                parse(part)  # type: ignore[operator]
        except error:
            continue
        yield True
        return


def program(line: str) -> str:
    return line.split()[0].removeprefix(".venv/bin/")


@dataclass
class Scratch:
    """A copy of what a checkout holds, with the interpreter under test as its .venv."""

    folder: Path
    namespace: dict[str, object] = field(default_factory=lambda: {"__name__": "__main__"})
    slow: bool = False

    def __post_init__(self) -> None:
        ignore = shutil.ignore_patterns("results*", "__pycache__")
        for name in ("aircraft", "scripts", "campaigns"):
            shutil.copytree(ROOT / name, self.folder / name, ignore=ignore)
        for name in (
            "sysid",
            "uqharness",
            "tests",
            "docs",
            "Makefile",
            "README.md",
            "pyproject.toml",
            "requirements.lock",
        ):
            (self.folder / name).symlink_to(ROOT / name)
        programs = self.folder / ".venv" / "bin"
        programs.mkdir(parents=True)
        for name, command in {
            "uqharness": f'"{sys.executable}" -m uqharness.cli.main "$@"',
            "python": f'"{sys.executable}" "$@"',
            "jsbsim": f'"{sys.executable}" -c "{JSBSIM}" "$@"',
        }.items():
            (programs / name).write_text(f"#!/bin/sh\nexec {command}\n")
            (programs / name).chmod(0o755)
        # What make looks at before it sets up: nothing is to be installed here.
        (programs.parent / ".installed").touch()

    def run(self, example: Example, slow: bool) -> None:
        """Run one example as the set wants it; AssertionError with its place when it does not do
        what the page says.
        """
        self.slow = slow
        with contextlib.chdir(self.folder):
            for command in example.all("before"):
                self.command(command if slow else example.reduced(command), example, 0)
            if example.kind == "file":
                path = Path(example.one("file") or "")
                path.write_text(
                    example.text if slow else example.reduced(example.text), encoding="utf-8"
                )
            elif example.kind == "shell":
                commands = example.commands(slow)
                for number, command in enumerate(commands):
                    last = number == len(commands) - 1
                    self.command(command, example, int(example.one("exit") or 0) if last else 0)
            elif example.kind == "python":
                code = example.text if slow else example.reduced(example.text)
                with contextlib.redirect_stdout(io.StringIO()):
                    exec(compile(code, example.where, "exec", dont_inherit=True), self.namespace)
            elif example.kind == "synopsis":
                check_synopsis(example)
            elif example.kind == "toml":
                check_toml(example)
            for command in example.all("then"):
                self.command(command, example, 0)

    def command(self, command: str, example: Example, expected: int) -> None:
        words = shlex.split(command, comments=True)
        if words[0].removeprefix(".venv/bin/") == "uqharness" and not re.search(
            r"[|<>;&$`]", command
        ):
            code, output = in_process(words[1:])
        elif not self.slow and re.fullmatch(r"python \w+\.py", command):
            code, output = script_in_process(words[1])
        else:
            path = os.pathsep.join([str(self.folder / ".venv" / "bin"), os.environ.get("PATH", "")])
            environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
            done = subprocess.run(
                ["bash", "-euc", command],
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=3600,
            )
            code, output = done.returncode, done.stdout + done.stderr
        assert code == expected, (
            f"{example.where}: {command}\nexit code {code}, expected {expected}\n{output[-2000:]}"
        )


def in_process(words: list[str]) -> tuple[int, str]:
    """Exit code and output of one ``uqharness`` command, without the two seconds that starting
    Python takes.
    """
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            code = cli.main(words)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 2
    return code, output.getvalue()


def script_in_process(file: str) -> tuple[int, str]:
    """The same of a script of a page; the slow set runs it in a process of its own."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        runpy.run_path(file, run_name="__main__")
    return 0, output.getvalue()


def check_toml(example: Example) -> None:
    """Keys and values of a piece of a campaign file are ones that a campaign may have; what the
    piece leaves out may be missing.
    """
    try:
        pieces = [tomllib.loads(example.text)]
    except tomllib.TOMLDecodeError:
        pieces = [tomllib.loads(part) for part in re.split(r"\n\s*\n", example.text)]
    for piece in pieces:
        for name, section in piece.items():
            assert name in CAMPAIGN_SECTIONS, (
                f"{example.where}: [{name}] is no section of a campaign file; mark it 'file: NAME'"
            )
            try:
                CAMPAIGN_SECTIONS[name].model_validate(section)
            except ValidationError as error:
                invalid = [
                    result
                    for result in error.errors()
                    if result["type"] != "missing" and result["loc"]
                ]
                assert not invalid, f"{example.where}: {invalid}"


def check_synopsis(example: Example) -> None:
    """Every command and option that a synopsis names is one that the command line has."""
    command = ""
    for line in example.text.splitlines():
        if line.strip() and not line.startswith(" "):
            command = line
        check_options(command, line, example.where)


def check_options(command: str, text: str, where: str) -> None:
    parser = cli.complete_parser()
    words = command.replace(".venv/bin/", "").split()
    if words[:2] == ["python", "-m"]:
        verb = words[3] if words[3:4] and re.match("[a-z]", words[3]) else None
        reports = help_of(words[2], verb)
        lacking = {
            option for option in OPTION.findall(text.split(" #")[0]) if option not in reports
        }
        assert not lacking, f"{where}: '{words[2]}' has no option {sorted(lacking)}"
        return
    if words[:1] != ["uqharness"]:
        return
    for word in words[1:]:
        verbs = next(
            (a for a in parser._actions if isinstance(a, argparse._SubParsersAction)), None
        )
        if verbs is None or not word.islower():
            break
        assert word in verbs.choices, f"{where}: there is no command 'uqharness {word}'"
        parser = verbs.choices[word]
    reference = {option for action in parser._actions for option in action.option_strings}
    listed = set(OPTION.findall(text.split(" #")[0]))
    assert listed <= reference, (
        f"{where}: '{parser.prog}' has no option {sorted(listed - reference)}"
    )


def differs(page: Path) -> bool:
    """Whether the slow set runs more of a page, or at another size."""
    return any(
        example.one("slow")
        or example.one("fast")
        or (example.kind == "shell" and example.commands(True) != example.commands(False))
        for example in examples(page)
    )


@cache
def help_of(module: str, verb: str | None) -> str:
    """What `python -m module [verb] --help` prints.

    AssertionError where there is no such program.
    """
    words = [module, *([verb] if verb else []), "--help"]
    if module.split(".")[0] not in OURS:
        done = subprocess.run(
            [sys.executable, "-m", *words], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{shlex.join(words)}: {done.stderr}"
        return done.stdout
    output, before = io.StringIO(), sys.argv
    sys.argv = list(words)
    # What runs here is imported already, of which runpy warns; starting Python takes two seconds.
    with (
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(output),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        try:
            runpy.run_module(module, run_name="__main__")
            code: object = 0
        except SystemExit as end:
            code = end.code or 0
        except ImportError as error:
            code = error
        finally:
            sys.argv = before
    assert code == 0, f"{shlex.join(words)}: {code} {output.getvalue()}"
    return output.getvalue()


def run_page(page: Path, folder: Path, slow: bool) -> list[tuple[Example, float]]:
    """Run the examples of a page in order; how long each took [s]."""
    scratch = Scratch(folder)
    times = []
    for example in examples(page):
        if example.kind == "excluded" or (example.one("slow") is not None and not slow):
            continue
        start = time.perf_counter()
        scratch.run(example, slow)
        times.append((example, time.perf_counter() - start))
    return times


def _main() -> None:
    import tempfile

    slow = "--slow" in sys.argv
    chosen = [word for word in sys.argv[1:] if not word.startswith("--")]
    for page in pages():
        if chosen and page.name not in chosen:
            continue
        with tempfile.TemporaryDirectory() as name:
            start = sum(os.times()[:4])
            try:
                for example, seconds in run_page(page, Path(name), slow):
                    print(f"{seconds:7.1f} s  {example.kind:9s} {example.where}", flush=True)
            except Exception as error:  # every page is tried
                print(f"WRONG    {page.name}: {type(error).__name__}: {error}", flush=True)
            print(f"{sum(os.times()[:4]) - start:7.1f} s of processor  {page.name}", flush=True)


if __name__ == "__main__":
    _main()
