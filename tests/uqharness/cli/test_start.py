"""How a command begins and ends: signals while modules load, little address space, Python files in
the working folder.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.helpers.places import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")

_RUN = (
    f"import sys; sys.path.append({str(ROOT)!r})\nfrom uqharness.__main__ import"
    " main\nsys.exit(main(sys.argv[1:]))"
)


def _environment(**more: str) -> dict[str, str]:
    retained = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    return {**retained, "PYTHONPATH": str(ROOT), **more}


def _command(*arguments: str, module: bool) -> list[str]:
    return [sys.executable, *(("-m", "uqharness") if module else ("-c", _RUN)), *arguments]


def _interrupted(command: list[str], number: int, folder: Path) -> tuple[int, str]:
    """Exit code and standard error of a command that gets a signal at the moment it asks for a
    certain module.
    """
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=_environment(HOLD="1"),
    )
    deadline = time.monotonic() + 60.0
    while not (folder / "loading").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(number)
    return process.wait(), process.communicate()[1]


@pytest.mark.parametrize(
    ("number", "code", "output"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
@pytest.mark.parametrize("swallowed", [False, True])
def test_a_signal_while_modules_load_is_one_line(
    tmp_path: Path, number: int, code: int, output: str, swallowed: bool
) -> None:
    # Stands for any module that takes long to load; some turn an interruption into an error of
    # their own.
    hold = "import pathlib, time\npathlib.Path('loading').touch()\n"
    swallowing = (
        "try:\n    time.sleep(60)\nexcept KeyboardInterrupt:\n    raise ImportError('no')\n"
    )
    hold += swallowing if swallowed else "time.sleep(60)\n"
    code_run = f"import sys; sys.path.append({str(ROOT)!r})\nimport types\n"
    code_run += f"source = {hold!r}\n"
    code_run += (
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'uqharness.requests.simulation':\n"
        "            exec(source)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from uqharness.__main__ import main\nsys.exit(main(['fly', '--help']))"
    )
    ended, words = _interrupted([sys.executable, "-c", code_run], number, tmp_path)
    assert (ended, words) == (code, f"uqharness: {output}\n")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no limit of address space here")
@pytest.mark.parametrize("module", [True, False])
def test_too_little_address_space_is_one_sentence(tmp_path: Path, module: bool) -> None:
    done = subprocess.run(
        [
            "/bin/sh",
            "-c",
            'ulimit -v 60000; exec "$@"',
            "sh",
            *_command("modes", "espaaro", "--speed-mps", "22", module=module),
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=_environment(),
    )
    assert done.returncode == 2
    assert done.stderr.startswith(
        "uqharness: error: not enough memory to start: 61 MB of address space are allowed"
    )
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no limit of address space here")
def test_a_bug_keeps_its_traceback_in_little_and_in_much_space(tmp_path: Path) -> None:
    code = f"import sys; sys.path.append({str(ROOT)!r})\nimport uqharness.cli.main\n"
    code += "def main(argv): raise KeyError('a bug')\nuqharness.cli.main.main = main\n"
    code += "from uqharness.__main__ import main\nsys.exit(main([]))"
    for limit in ("unlimited", "1500000"):
        done = subprocess.run(
            ["/bin/sh", "-c", f'ulimit -v {limit}; exec "$@"', "sh", sys.executable, "-c", code],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=_environment(OPENBLAS_NUM_THREADS="1"),
        )
        assert done.returncode == 1
        assert "KeyError: 'a bug'" in done.stderr


def test_python_files_of_the_working_folder_do_not_run(tmp_path: Path) -> None:
    # Python's own `-m` reads contextlib and a few others from there before any of this program's
    # code runs.
    for name in ("signal", "threading", "socket", "json", "numpy", "jsbsim", "sysid"):
        (tmp_path / f"{name}.py").write_text(f"open('ran-{name}', 'w')\n")
    done = subprocess.run(
        _command("--version", module=True),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=_environment(),
    )
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.glob("ran-*"))


def _descendants(parent: int) -> list[int]:
    """Processes that a process started, and theirs, those that have ended but were not asked about
    left out.
    """
    result = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            state, ppid = (place / "stat").read_text().rpartition(")")[2].split()[:2]
        except OSError:
            continue
        if int(ppid) == parent and state not in "ZX":
            result += [int(place.name), *_descendants(int(place.name))]
    return result


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="processes are looked for in /proc"
)
@pytest.mark.parametrize(
    ("number", "code", "output"),
    [
        pytest.param(signal.SIGINT, 130, "interrupted", marks=pytest.mark.slow),
        (signal.SIGTERM, 143, "terminated"),
    ],
)
def test_workers_that_are_busy_for_minutes_end_with_the_command(
    tmp_path: Path, number: int, code: int, output: str
) -> None:
    source = (
        f"import sys, time; sys.path.append({str(ROOT)!r})\nimport uqharness.cli.main as commands\n"
    )
    source += "from uqharness.parallel import worker_map\n"
    source += (
        "def work():\n    with worker_map(2) as processes:\n        list(processes(time.sleep,"
        " [600.0] * 4))\n"
    )
    source += "commands.run_words = lambda argv: work()\n"
    source += (
        "from uqharness.__main__ import main\nif __name__ == '__main__':\n    sys.exit(main(['fly',"
        " '--help']))"
    )
    command = [sys.executable, "-c", source]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=_environment()
    )
    deadline = time.monotonic() + 60.0
    while (
        len(_descendants(process.pid)) < 3
    ):  # the workers, and what keeps count of their semaphores
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    start = _descendants(process.pid)
    process.send_signal(number)
    words = process.communicate(timeout=60.0)[1]
    assert (process.returncode, words.splitlines()[0]) == (code, f"uqharness: {output}")
    assert "uqharness fly --help" in words
    while any(Path(f"/proc/{pid}").exists() for pid in start):
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("reports", [(), ("-W", "error")])
def test_warnings_of_libraries_are_printed_for_those_who_ask_alone(
    tmp_path: Path, reports: tuple[str, ...]
) -> None:
    source = f"import sys; sys.path.append({str(ROOT)!r})\nimport uqharness.cli.main as commands\n"
    source += "from uqharness.child_process import run_module\nimport numpy as np\n"
    # In this process, and in a child of it.
    source += (
        "def work():\n    np.log(np.zeros(1))\n    print(run_module('warns',"
        " timeout_s=60).errors)\n    return 0\n"
    )
    source += "commands.run_words = lambda argv: work()\n"
    source += "from uqharness.__main__ import main\nsys.exit(main(['fly', '--help']))"
    (tmp_path / "warns.py").write_text(
        "import warnings\nwarnings.warn('divide by zero', RuntimeWarning)\n"
    )
    done = subprocess.run(
        [sys.executable, *reports, "-c", source],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**_environment(), "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"},
    )
    if reports:
        assert done.returncode == 1
        assert "RuntimeWarning: divide by zero" in done.stderr
    else:
        assert (done.returncode, done.stdout, done.stderr) == (0, "\n", "")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_campaign_that_is_killed_leaves_no_process_and_after_the_next_command_no_folder(
    tmp_path: Path, number: int
) -> None:
    place = tmp_path / "place"
    place.mkdir()
    run = [
        "campaign",
        "run",
        str(ROOT / "campaigns/demo/campaign.toml"),
        "--out",
        str(tmp_path / "out"),
        "--workers",
        "2",
    ]
    process = subprocess.Popen(
        _command(*run, module=True),
        cwd=ROOT,
        env=_environment(TMPDIR=str(place)),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120.0
    while len(list(place.glob("uqharness-*"))) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(number)
    process.communicate()  # ends when nobody holds its standard error any more
    assert process.returncode == (143 if number == signal.SIGTERM else -number)
    fly = [
        *shlex.split("fly espaaro --script loiter --duration-s 1 --out"),
        str(tmp_path / "a.csv"),
    ]
    subprocess.run(
        _command(*fly, module=True),
        cwd=ROOT,
        env=_environment(TMPDIR=str(place)),
        check=True,
        stdout=subprocess.DEVNULL,
    )
    assert list(place.glob("uqharness-*")) == []
