"""Messages become a record: grid, held commands, angles on the circle, modes and manoeuvres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import assemble
from sysid.logs.load import import_log
from sysid.logs.signal_map import Entry, SignalMap

FAST, SLOW = 0.02 * np.arange(250), 0.1 * np.arange(50) + 0.008
ENTRIES = {
    "q_radps": (Entry("IMU", 0, ("q",)),),
    "theta_rad": (Entry("ATT", 0, ("theta",)),),
    "psi_rad": (Entry("ATT", 0, ("psi",), function="heading"),),
    "elevator_deg": (Entry("OUT", 0, ("elevator",)),),
    "mode": (Entry("MODE", 0, ("number",)),),
}


def raw_log(dialect: str = "dataflash", **more) -> RawLog:
    messages = {
        ("IMU", 0): MessageTable(FAST, {"q": np.sin(FAST)}),
        ("ATT", 0): MessageTable(
            SLOW, {"theta": 0.1 * SLOW, "psi": 2.0 * np.pi - 0.5 + 0.3 * SLOW}
        ),
        ("OUT", 0): MessageTable(SLOW, {"elevator": np.round(4.0 * np.sin(3.0 * SLOW))}),
        ("MODE", 0): MessageTable(np.array([0.0, 2.01]), {"number": np.array([0.0, 12.0])}),
    }
    return RawLog(dialect, messages, **more)


def made(raw: RawLog):
    return assemble(raw, SignalMap("test", ENTRIES), None)


def test_the_fastest_rate_is_the_grid_and_the_rest_lies_on_it() -> None:
    record = made(raw_log())
    inside = slice(5, 240)
    assert record["time_s"] == pytest.approx(FAST)
    np.testing.assert_array_equal(record["q_radps"], np.sin(FAST))
    assert record["theta_rad"][inside] == pytest.approx(0.1 * FAST[inside])
    # Across north and round again, with no value in between.
    expected = np.mod(2.0 * np.pi - 0.5 + 0.3 * FAST, 2.0 * np.pi)
    assert record["psi_rad"][inside] == pytest.approx(expected[inside])
    assert record.metadata.grid_hz == pytest.approx(50.0)
    assert record.metadata.native_hz["theta_rad"] == pytest.approx(10.0)


def test_commands_are_held() -> None:
    record = made(raw_log())
    k = np.searchsorted(SLOW, FAST + 1e-9, side="right") - 1
    expected = np.round(4.0 * np.sin(3.0 * SLOW))[np.maximum(k, 0)]
    np.testing.assert_array_equal(record["elevator_deg"][5:240], expected[5:240])
    assert set(np.unique(record["elevator_deg"][5:240] % 1.0)) == {0.0}


def test_modes_have_the_names_of_aeroplanes_where_it_is_one() -> None:
    record = made(raw_log())
    assert set(record["mode"][FAST < 2.0]) == {"MANUAL"}
    assert set(record["mode"][FAST > 2.02]) == {"LOITER"}
    assert set(made(raw_log("tlog", facts={"mav_type": 2.0}))["mode"]) == {"mode 0", "mode 12"}
    assert "LOITER" in made(raw_log("tlog", facts={"mav_type": 1.0}))["mode"]


def test_texts_name_manoeuvres() -> None:
    texts = ((1.0, "manoeuvre pull-up"), (1.5, "hello"), (2.0, "manoeuvre end"))
    labels = made(raw_log(texts=texts))["manoeuvre"]
    np.testing.assert_array_equal(labels == "pull-up", (FAST >= 0.99) & (FAST < 1.99))
    assert "manoeuvre" not in made(raw_log(texts=((1.5, "hello"),)))


def test_where_the_flight_began() -> None:
    raw = raw_log()
    fix = MessageTable(
        SLOW,
        {"Lat": np.r_[0.0, np.full(49, 37.5)], "Lng": np.full(50, -76.0), "Alt": np.full(50, 12.0)},
    )
    log = RawLog("dataflash", {**raw.messages, ("GPS", 0): fix})
    assert made(log).metadata.start == {"lat_deg": 37.5, "lon_deg": -76.0, "alt_m": 12.0}
    assert made(raw).metadata.start == {}
    scaled = MessageTable(
        SLOW, {"lat": np.full(50, 375e6), "lon": np.full(50, -760e6), "alt": np.full(50, 12_000.0)}
    )
    log = RawLog("tlog", {**raw.messages, ("GLOBAL_POSITION_INT", 0): scaled})
    assert made(log).metadata.start == pytest.approx(
        {"lat_deg": 37.5, "lon_deg": -76.0, "alt_m": 12.0}
    )


def test_a_log_without_a_signal_of_the_map_is_refused() -> None:
    with pytest.raises(LogError, match="no signal of the map 'test' is in this log; it has BAT"):
        made(RawLog("dataflash", {("BAT", 0): MessageTable(FAST, {"V": FAST})}))


@pytest.mark.parametrize("absurd", [1e300, 2.0**63, 1e10])
def test_absurd_times_ask_for_no_memory(tmp_path: Path, absurd: float) -> None:
    lines = ["FMT, 130, 20, IMU, Qfff, TimeUS,GyrX,GyrY,GyrZ"]
    # Ten stamps a microsecond apart, an hour less a second, ten more, and so on.
    times = [3.599e9 * block + k for block in range(40) for k in range(10)] + [absurd]
    lines += [f"IMU, {t:.0f}, 0.1, 0.2, 0.3" for t in times]
    (tmp_path / "a.log").write_text("\n".join(lines))
    with pytest.raises(LogError, match=r"would be more than .* rows"):
        import_log(tmp_path / "a.log")
