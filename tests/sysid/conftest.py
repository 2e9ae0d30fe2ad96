"""Fixtures of the log tests: the card and a synthetic flight as DataFlash."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.logs.card import AirframeCard, read_card
from sysid.logs.dataflash_writer import write_dataflash
from sysid.record import FlightRecord
from tests.helpers.synthetic import flight


@pytest.fixture(scope="session")
def card(card_path: Path) -> AirframeCard:
    return read_card(card_path)


@pytest.fixture(scope="session")
def flown() -> FlightRecord:
    return flight(duration_s=40.0, start_s=5.0)


@pytest.fixture(scope="session")
def bin_log(
    tmp_path_factory: pytest.TempPathFactory, flown: FlightRecord, card: AirframeCard
) -> Path:
    path = tmp_path_factory.mktemp("logs") / "flight.bin"
    write_dataflash(flown, path, card, vehicle="ArduPlane V4.6.0")
    return path
