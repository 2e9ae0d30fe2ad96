"""MATLAB files, second clocks, derived signals and selected rows of a map."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from sysid.errors import LogError
from sysid.logs import import_log
from sysid.logs.signal_map import parse_map

STEP_S = 0.02
N = 3000
OFFSET_S = 7.9


def _flight() -> dict[str, object]:
    """Return a struct with two loggers; the motor's clock reads OFFSET_S less."""
    rng = np.random.default_rng(3)
    t = 100.0 + STEP_S * np.arange(N)
    motor_t = np.arange(0.0, 45.0, 0.5)
    throttle = np.repeat(rng.uniform(0.3, 0.9, N // 100), 100)
    # The motor's own clock begins 20 s after the log's.
    at = motor_t + OFFSET_S + 100.0
    return {
        "time": t,
        "p": 0.1 * np.sin(t),
        "q": 0.1 * np.cos(t),
        "r": 0.01 * np.sin(2 * t),
        "ias": 15.0 + np.sin(0.1 * t),
        "acc": np.stack([0.2 * np.cos(t), 0.1 * np.sin(t), -9.8 + 0.1 * np.sin(t)], axis=1),
        "da_l": 0.10 * np.sin(t),
        "da_r": -0.06 * np.sin(t),
        "thr": throttle,
        "h": 20.0 + 0.0 * t,
        "mode": np.where(t < 130.0, 1, 2).astype(np.uint8),
        "motor_time": motor_t,
        "motor_rpm": 3000.0 + 1000.0 * np.interp(at, t, throttle),
    }


MAP = """
[signals.time_s]
field = "time"
[signals.p_radps]
message = "log"
field = "p"
sign = -1
[signals.q_radps]
message = "log"
field = "q"
[signals.r_radps]
message = "log"
field = "r"
[signals.ax_mps2]
message = "log"
field = "acc(1)"
[signals.az_mps2]
message = "log"
field = "acc(3)"
[signals.V_mps]
message = "log"
field = "ias"
[signals.h_m]
message = "log"
field = "h"
[signals.aileron_deg]
message = "log"
function = "sum"
fields = ["da_l", "da_r"]
weights = [0.5, -0.5]
unit = "rad"
[signals.rpm]
message = "log/motor_time"
field = "motor_rpm"
[clocks."log/motor_time"]
align = ["motor_rpm", "log", "thr"]
[derived.rho_kgpm3]
function = "density_of_height"
altitude_m = 980.0
[derived.V_mps]
function = "true_airspeed"
[derived.thrust_N]
function = "propeller_thrust"
diameter_m = 0.3
ct = [0.1, -0.1]
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Return a .mat file and its map."""
    savemat(tmp_path / "flight.mat", {"log": _flight(), "note": "first flight"})
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    return tmp_path / "flight.mat", tmp_path / "map.toml"


def _with_line(file: Path, text: str) -> Path:
    """Return a copy of a map with more lines."""
    out = file.with_name("more.toml")
    out.write_text(file.read_text(encoding="utf-8") + text, encoding="utf-8")
    return out


def test_structs_units_signs_and_matrices_become_signals(files: tuple[Path, Path]) -> None:
    record = import_log(*files)
    t = record["time_s"]
    assert len(record) == N
    assert np.allclose(record["p_radps"], -0.1 * np.sin(t), atol=1e-6)
    assert np.allclose(record["az_mps2"], -9.8 + 0.1 * np.sin(t), atol=1e-6)
    assert np.allclose(record["aileron_deg"], np.degrees(0.08 * np.sin(t)), atol=1e-6)
    texts = {f.code: f.message for f in record.metadata.findings}
    assert "p_radps = p times -1" in texts["assumed-map"]
    assert "+0.5 da_l -0.5 da_r in rad" in texts["assumed-map"]


def test_second_clock_is_aligned_by_correlation(files: tuple[Path, Path]) -> None:
    record = import_log(*files)
    finding = next(f for f in record.metadata.findings if f.code == "assumed-clock")
    assert finding.numbers["offset_s"] == pytest.approx(
        100.0 + OFFSET_S, abs=0.25
    )  # half a sample of 2 Hz
    assert finding.numbers["correlation"] > 0.95
    # At 125 s the speed follows the throttle of the log's own clock.
    row = np.searchsorted(record["time_s"], 125.0)
    throttle = _flight()["thr"]
    assert isinstance(throttle, np.ndarray)
    assert record["rpm"][row] == pytest.approx(3000.0 + 1000.0 * throttle[row], abs=40.0)


def test_derived_signals_follow_their_formulas(files: tuple[Path, Path]) -> None:
    record = import_log(*files)
    # Standard atmosphere at 1000 m: 89874.6 Pa; the day has 15 C at the start, 20 m below.
    rho = 89874.6 / (287.053 * (288.15 - 0.0065 * 20.0))
    assert np.allclose(record["rho_kgpm3"], rho, rtol=1e-5)
    speed = (15.0 + np.sin(0.1 * record["time_s"])) * np.sqrt(1.225 / rho)
    assert np.allclose(record["V_mps"], speed, rtol=1e-5)
    rows = np.isfinite(record["thrust_N"])
    n = record["rpm"][rows] / 60.0
    thrust = (0.1 - 0.1 * speed[rows] / (n * 0.3)) * rho * n**2 * 0.3**4
    assert np.allclose(record["thrust_N"][rows], thrust, rtol=1e-4, atol=1e-4)
    assert sum(f.code == "assumed-derived" for f in record.metadata.findings) == 3


def test_mode_and_times_select_rows(files: tuple[Path, Path]) -> None:
    more = _with_line(files[1], '[rows]\nmessage = "log"\nfield = "mode"\nvalues = [2]\n')
    record = import_log(files[0], more, from_s=120.0, to_s=150.0)
    assert record["time_s"][0] == pytest.approx(130.0)
    assert record["time_s"][-1] == pytest.approx(150.0)
    texts = [f.message for f in record.metadata.findings if f.code == "selected-rows"]
    assert any("log.mode = 2" in text for text in texts)
    with pytest.raises(LogError, match=r"no rows.*values are 1, 2"):
        import_log(
            files[0], _with_line(files[1], '[rows]\nmessage="log"\nfield="mode"\nvalues=[3]\n')
        )


def test_derived_signal_names_the_field_that_the_log_lacks(files: tuple[Path, Path]) -> None:
    text = files[1].read_text(encoding="utf-8").replace('"log/motor_time"\nfield', '"log"\nfield')
    files[1].write_text(text, encoding="utf-8")
    with pytest.raises(LogError, match=r"needs rpm, which the map reads from log\.motor_rpm: this"):
        import_log(*files)


def test_selected_rows_are_flight_whatever_the_height_says(tmp_path: Path) -> None:
    # The barometer settles after the first second, so that the log seems to stay on the ground.
    flight = _flight()
    flight["ias"] = np.where(np.arange(N) < 100, 0.0, np.asarray(flight["ias"]))
    flight["h"] = np.where(np.arange(N) < 100, 240.0, 20.0)
    savemat(tmp_path / "flight.mat", {"log": flight})
    text = MAP.replace('field = "h"', 'field = "h"\nfunction = "above_start"')
    text += '[rows]\nmessage = "log"\nfield = "mode"\nvalues = [2]\n'
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    record = import_log(tmp_path / "flight.mat", tmp_path / "map.toml")
    texts = [f.message for f in record.metadata.findings]
    assert any("they count as free flight" in t for t in texts)
    assert not any("never left the ground" in t for t in texts)


def test_odd_and_even_blocks_share_a_flight(files: tuple[Path, Path]) -> None:
    rows = '[rows]\nfrom_s = 101.0\nblock_s = 5.0\npart = "{}"\n'
    parts = [
        import_log(files[0], _with_line(files[1], rows.format(part))) for part in ("odd", "even")
    ]
    times = [set(part["time_s"].round(3).tolist()) for part in parts]
    assert not times[0] & times[1]
    assert len(times[0] | times[1]) == N - 50
    assert abs(len(times[0]) - len(times[1])) <= 250
    assert min(times[0]) == pytest.approx(101.0)
    offsets = [
        next(f.numbers["offset_s"] for f in p.metadata.findings if f.code == "assumed-clock")
        for p in parts
    ]
    assert offsets[0] == offsets[1]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"x": "only text"}, "no vector of numbers"),
        ({"log": {"p": np.arange(9.0) ** 2, "q": np.arange(9.0)[::-1] ** 2}}, "no time column"),
    ],
)
def test_files_without_a_flight_say_so(
    tmp_path: Path, content: dict[str, object], message: str
) -> None:
    savemat(tmp_path / "flight.mat", content)
    with pytest.raises(LogError, match=message):
        import_log(tmp_path / "flight.mat")


def test_damaged_files_end_in_a_message(files: tuple[Path, Path], tmp_path: Path) -> None:
    data = files[0].read_bytes()
    rng = np.random.default_rng(0)
    for section in (200, len(data) // 2, len(data) - 300):
        (tmp_path / "cut.mat").write_bytes(data[:section])
        with pytest.raises(LogError, match=r"cut\.mat"):
            import_log(tmp_path / "cut.mat", files[1])
    for _ in range(12):
        damaged = bytearray(data)
        for at in rng.integers(128, len(data), 8):
            damaged[at] = rng.integers(256)
        (tmp_path / "cut.mat").write_bytes(bytes(damaged))
        # Damage in the numbers alone leaves a flight; anything else is a LogError.
        with contextlib.suppress(LogError):
            assert len(import_log(tmp_path / "cut.mat", files[1]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[clocks.m]\nalign = ["a"]', "align must be"),
        ("[clocks.m]", "either offset_s"),
        ('[derived.V_mps]\nfunction = "magic"', "allowed are"),
        ('[derived.thrust_N]\nfunction = "propeller_thrust"', "diameter_m is missing"),
        ('[rows]\nfield = "mode"', "belong together"),
        ("[rows]\nfrom_s = 5\nto_s = 4", "must be less"),
        ('[rows]\npart = "third"', "odd"),
        ('[signals.V_mps]\nmessage = "m"\nfield = "v"\nunit = "deg"', "allowed for V_mps"),
        ('[signals.V_mps]\nmessage = "m"\nfield = "v"\nsign = 2', "1 and -1"),
        ('[signals.V_mps]\nmessage = "m"\nfields = ["v"]\nfunction = "sum"', "weights"),
    ],
)
def test_faults_of_a_map_are_named(text: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        parse_map(text, "map.toml")


def test_version_7_3_is_read_like_version_5(files: tuple[Path, Path], tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "new.mat"
    with h5py.File(file, "w", userblock_size=512) as handle:
        group = handle.create_group("log")
        for name, values in _flight().items():
            # MATLAB stores a column vector of n rows as (1, n).
            group.create_dataset(name, data=np.atleast_2d(np.asarray(values).T))
        handle["elsewhere"] = h5py.ExternalLink("other.mat", "/log")
    with file.open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(128, b" "))
    old, new = import_log(*files), import_log(file, files[1])
    for name in old.columns:
        assert np.array_equal(old[name], new[name], equal_nan=True), name
