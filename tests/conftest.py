"""Fixtures shared by the tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.flying_here import flying_here
from tests.helpers.places import TESTS
from uqharness.isolation import SUPERVISED
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.staging import staged


def pytest_configure() -> None:
    """Give signals that the shell ignored their default handlers again.

    `nohup`, background jobs of a shell and some CI runners start a process with SIGINT or SIGHUP
    ignored. Children inherit that, and tests that interrupt a child would wait for ever.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            default = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
            signal.signal(number, default)
    # The suite is its own supervisor: functions that run in a worker elsewhere run in the test's
    # process, where stand-ins reach them. tests/uqharness/test_isolation.py uses the worker.
    os.environ[SUPERVISED] = str(os.getpid())


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
