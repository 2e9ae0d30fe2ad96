"""Fixtures of the log tests: the card, a synthetic flight as DataFlash, and the genuine logs where they are present."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sysid.logs.card import AirframeCard, read_card
from sysid.logs.dataflash_writer import write_dataflash
from sysid.record import FlightRecord
from tests.helpers.places import TESTS
from tests.helpers.synthetic import flight

DATA = TESTS / "sysid" / "data"


@pytest.fixture(scope="session")
def card_path() -> Path:
    return DATA / "airframe.toml"


@pytest.fixture(scope="session")
def card(card_path: Path) -> AirframeCard:
    return read_card(card_path)


@pytest.fixture(scope="session")
def flown() -> FlightRecord:
    return flight(duration_s=40.0, start_s=5.0)


@pytest.fixture(scope="session")
def bin_log(tmp_path_factory: pytest.TempPathFactory, flown: FlightRecord, card: AirframeCard) -> Path:
    path = tmp_path_factory.mktemp("logs") / "flight.bin"
    write_dataflash(flown, path, card, vehicle="ArduPlane V4.6.0")
    return path


@pytest.fixture(scope="session")
def flight_data() -> Path:
    """Folder with genuine logs, named by the environment."""
    folder = os.environ.get("UQ_FLIGHT_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("set UQ_FLIGHT_DATA to the folder with espaaro-ardupilot/ and pyulog/ to run on genuine logs")
    return Path(folder)
