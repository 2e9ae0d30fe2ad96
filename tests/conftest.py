"""Fixtures shared by the tests."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.flying_here import flying_here
from tests.helpers.forked_children import USERS, run_forked
from tests.helpers.places import TESTS
from uqharness.isolation import SUPERVISED
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.staging import staged


def restore_signals() -> None:
    """Give signals that the shell ignored their default handlers again.

    `nohup`, background jobs of a shell and some CI runners start a process with SIGINT or SIGHUP
    ignored. Children inherit that, and tests that interrupt a child would wait for ever.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            default = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
            signal.signal(number, default)


def pytest_configure(config: pytest.Config) -> None:
    """Prepare signals, workers and the collection."""
    restore_signals()
    # The suite is its own supervisor: functions that run in a worker elsewhere run in the test's
    # process, where stand-ins reach them. tests/uqharness/test_isolation.py uses the worker.
    os.environ[SUPERVISED] = str(os.getpid())
    if "fork" in multiprocessing.get_all_start_methods():
        for user in USERS:
            importlib.import_module(user).run_module = run_forked
    stay_on_one_core()
    collect_from_both_ends(config)


def stay_on_one_core() -> None:
    """Let each worker and what it starts use one core.

    The workers use all cores already: pools that a command opens by default would only start more
    processes.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        # Some containers do not allow it.
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})


def collect_from_both_ends(config: pytest.Config) -> None:
    """Let every second worker collect the files in reverse order.

    Each worker imports all files, and pytest rewrites the assertions of each file that has no
    bytecode yet. Workers that run in step would all rewrite every file.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    folders = config.getini("testpaths")
    if worker and int(worker.removeprefix("gw")) % 2 and config.args == folders:
        files = (path for name in folders for path in (config.rootpath / name).rglob("test_*.py"))
        config.args = sorted(map(str, files), reverse=True)


LONGEST_FILES = (
    "tests/stories/test_doc_examples.py",
    "tests/uqharness/batch/test_fly_many.py",
    "tests/sysid/effects/test_turbulence.py",
    "tests/uqharness/refinement/test_refine.py",
    "tests/uqharness/simulator/test_trim.py",
    "tests/uqharness/test_isolation.py",
    "tests/uqharness/identification/test_model_form.py",
    "tests/uqharness/identification/test_turbulence.py",
    "tests/uqharness/api/test_examples.py",
    "tests/sysid/estimation/test_filter_error.py",
    "tests/stories/test_autopilot.py",
    "tests/stories/test_any_aircraft.py",
    "tests/stories/test_fuzz.py",
    "tests/uqharness/campaign/test_dask.py",
)
"""Files that take longest, which start first: a worker would otherwise end with one of them while
the others idle. The order changes no result.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first, the others in the order of their names."""
    rank = {name: number for number, name in enumerate(LONGEST_FILES)}

    def place(item: pytest.Item) -> tuple[int, str]:
        file = item.nodeid.partition("::")[0]
        return rank.get(file, len(rank)), file

    items.sort(key=place)


@pytest.fixture(scope="session")
def load_mission() -> Callable[..., Any]:
    """A function that loads scripts/<name>.xml at 100 Hz and sets properties; nothing has been run
    yet.
    """

    def load(properties: Mapping[str, float] | None = None, script: str = "loiter") -> Any:
        fdm = engine.open_script(
            staged(find_aircraft("espaaro")), PROJECT_ROOT / "scripts" / f"{script}.xml", 0.01
        )
        for name, value in (properties or {}).items():
            fdm[name] = value
        return fdm

    return load


# Lines of progress come after seconds: what a command writes must not depend on the machine's
# speed.
os.environ["UQHARNESS_QUIET"] = "1"
# All targets give the same bits (tests/uqharness/batch/test_llvm_flight.py), and LLVM compiles two
# lanes in half the time of eight. tests/uqharness/batch/test_fly_many.py flies the widest.
os.environ.setdefault("UQHARNESS_VECTORS", "sse2")


@pytest.fixture(scope="session")
def card_path() -> Path:
    return TESTS / "sysid" / "data" / "airframe.toml"


@pytest.fixture(scope="session")
def flight_data() -> Path:
    """Folder with genuine logs, named by the environment."""
    folder = os.environ.get("UQ_FLIGHT_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip(
            "set UQ_FLIGHT_DATA to the folder with espaaro-ardupilot/ and pyulog/ to run on genuine"
            " logs"
        )
    return Path(folder)


@pytest.fixture(scope="module")
def flights_here() -> Iterator[None]:
    """A module's campaigns fly in the test's own process."""
    with flying_here():
        yield
