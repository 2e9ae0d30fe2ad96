"""Tables as people have them: separators, decimal signs, units, times, angles, missing columns."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from sysid.logs.tables import sniff
from sysid.record import FlightRecord

NAMES = ("TAS", "roll", "pitch", "heading", "p", "q", "r", "STAB_POS", "RUDDER_POS")
SIGNALS = (
    "V_mps",
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "elevator_pos_deg",
    "rudder_pos_deg",
)
MAP = "".join(
    f'[signals.{s}]\nmessage = "csv"\nfield = "{n}"\n' for s, n in zip(SIGNALS, NAMES, strict=True)
)


def rows(count: int = 500) -> list[tuple[float, list[float]]]:
    out = []
    for k in range(count):
        t = 0.02 * k
        psi = math.remainder(2.9 + 0.05 * t, 2.0 * math.pi)
        wave = [math.sin(t), math.cos(t), math.sin(2.0 * t), 0.05 + 0.01 * math.sin(t)]
        out.append(
            (
                t,
                [
                    20.0 + wave[0],
                    0.2 * wave[0],
                    0.03 * wave[0],
                    psi,
                    0.2 * wave[1],
                    0.03 * wave[1],
                    wave[3],
                    5.0 * wave[0],
                    3.0 * wave[2],
                ],
            )
        )
    return out


def table(
    path: Path,
    time_name: str,
    time: object,
    separator: str = ",",
    decimal: str = ".",
    top: str = "",
) -> Path:
    lines = [separator.join([time_name, *NAMES])]
    for t, values in rows():
        cells = [time(t), *(f"{v:.9f}" for v in values)]  # type: ignore[operator]
        lines.append(separator.join(cell.replace(".", decimal) for cell in cells))
    path.write_text(top + "\n".join(lines) + "\n", encoding="cp1252")
    return path


def clock(t: float) -> str:
    return f"2024-05-01T23:59:{55 + t:09.6f}" if t < 5.0 else f"2024-05-02T00:00:{t - 5.0:09.6f}"


@pytest.mark.parametrize(
    ("name", "time", "line"),
    [
        ("time", "{:.2f}", ""),
        ("TIME", "{:.2f}", ""),
        ("Delta", "{:.2f}", 'field = "Delta"\nunit = "s"'),
        ("Zeit [ms]", "ms", 'column = "Zeit [ms]"\nunit = "ms"'),
        ("time_us", "us", ""),
        ("TimeUS", "us", ""),
        ("timestamp", "us", ""),
        ("timestamp", "ms", ""),
        ("odd", "us", 'message = "csv"\nfield = "odd"\nscale = 1e-6'),
        ("stamp", "iso", 'field = "stamp"\nunit = "iso"'),
        ("UTC time", "iso", ""),
        ("Zeitstempel", "iso", ""),
        ("Lcl Time", "day", ""),
    ],
)
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
def test_any_time_column_and_any_separator(
    tmp_path: Path, name: str, time: str, line: str, separator: str, decimal: str
) -> None:
    write = {
        "ms": lambda t: f"{5e5 + 1e3 * t:.0f}",
        "us": lambda t: f"{5e8 + 1e6 * t:.0f}",
        "iso": clock,
        "day": lambda t: clock(t).split("T")[1],
    }.get(time, lambda t: f"{t:.2f}")
    path = table(tmp_path / "a.csv", name, write, separator, decimal)
    (tmp_path / "m.toml").write_text(MAP + (f"[signals.time_s]\n{line}\n" if line else ""))
    record = import_log(path, tmp_path / "m.toml")
    np.testing.assert_allclose(np.diff(record["time_s"]), 0.02, atol=1e-6)
    np.testing.assert_allclose(record["V_mps"], [v[0] for _, v in rows()], atol=1e-8)
    guessed = [f for f in record.metadata.findings if f.code == "time-unit"]
    assert len(guessed) == (name == "timestamp")
    if guessed:
        words = {"us": "steps of 20000 s: .* microseconds", "ms": "steps of 20 s: .* milliseconds"}
        assert guessed[0].mend.endswith(f'unit = "{time}"')
        with pytest.raises(AssertionError, match=words[time]):
            raise AssertionError(guessed[0].message)


def test_seconds_that_cannot_be_are_an_error_with_the_line_to_write(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", "x", lambda t: f"{1e6 * t:.0f}")
    (tmp_path / "m.toml").write_text(MAP + '[signals.time_s]\nfield = "x"\nunit = "s"\n')
    with pytest.raises(LogError, match=r'steps of 20000 s: .* microseconds.* unit = "us"'):
        import_log(path, tmp_path / "m.toml")


def test_a_clock_that_does_not_get_on_and_words_leave_the_table_readable(tmp_path: Path) -> None:
    path = table(
        tmp_path / "a.csv", "IRIG_TIME,Delta", lambda t: f"234:15:35:{50 + t % 3:09.6f},{t:.2f}"
    )
    (tmp_path / "m.toml").write_text(MAP)
    record = import_log(path, tmp_path / "m.toml")
    assert len(record) == 500
    assert "Delta" in next(f.message for f in record.metadata.findings if f.code == "time-column")


def test_headings_of_both_turns_and_two_surfaces_of_three(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", "time", lambda t: f"{t:.2f}")
    (tmp_path / "m.toml").write_text(MAP)
    record = import_log(path, tmp_path / "m.toml")
    assert not [f for f in record.metadata.findings if f.code == "out-of-range"]
    np.testing.assert_allclose(
        record["psi_rad"], [v[3] % (2.0 * math.pi) for _, v in rows()], atol=1e-8
    )
    reason = next(p.reason for p in log_info(record).purposes if p.name == "replay")
    assert "no aileron_pos_deg" in reason
    assert "no surfaces" not in reason
    # Negative control: degrees are not wrapped as if they were radians.
    text = MAP.replace('field = "heading"\n', 'field = "heading"\nscale = 57.29578\n')
    (tmp_path / "m.toml").write_text(text)
    (finding,) = [
        f
        for f in import_log(path, tmp_path / "m.toml").metadata.findings
        if f.code == "out-of-range"
    ]
    assert (finding.channel, finding.severity) == ("psi_rad", "error")
    assert "scale = 0.0174533" in finding.mend or "multiply its scale" in finding.mend


def test_what_a_map_names_and_the_table_lacks_is_said_with_the_columns(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", "time", lambda t: f"{t:.2f}")
    (tmp_path / "m.toml").write_text('[signals.V_mps]\nmessage = "csv"\nfield = "TSA"\n')
    with pytest.raises(LogError, match=r"its columns are time, TAS, roll.*log map FILE --out"):
        import_log(path, tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text(MAP.replace('"TAS"', '"TSA"'))
    codes = {f.code: f for f in import_log(path, tmp_path / "m.toml").metadata.findings}
    assert codes["not-in-log"].channel == "V_mps"
    with pytest.raises(LogError, match=r"unknown column 'time'.*log map FILE --out"):
        import_log(path)


@pytest.mark.parametrize(
    ("text", "separator", "decimal", "names"),
    [
        ("a,b\n1.5,2\n3,4\n", ",", ".", ("a", "b")),
        ("a;b\n1,5;2\n3;4,5\n", ";", ",", ("a", "b")),
        ("a;b\n12,50;13,20\n13,50;14,20\n", ";", ",", ("a", "b")),
        ("a\tb\n1,5\t2\n3\t4,5\n", "\t", ",", ("a", "b")),
        ('a,b\n"1,5","2,5"\n"3,5","4"\n', ",", ",", ("a", "b")),
        ("a  b\n 1.5   2\n 3  4\n", " ", ".", ("a", "b")),
        ("Logger 7\nstarted 12 May\ntime,b\n1.5,2\n3,4\n", ",", ".", ("time", "b")),
        ("# made by hand\na,b\n1,2\n", ",", ".", ("a", "b")),
    ],
)
def test_how_a_table_is_written(
    text: str, separator: str, decimal: str, names: tuple[str, ...]
) -> None:
    written = sniff(text.encode())
    assert written is not None
    assert (written.separator, written.decimal, written.names) == (separator, decimal, names)


def test_a_line_of_units_and_a_number_sign_in_a_name(tmp_path: Path) -> None:
    lines = ["time;speed #1;note", "s;kt;-", *(f"{0.02 * k:.2f};{20 + k};#{k}" for k in range(50))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    (tmp_path / "m.toml").write_text('[signals.V_mps]\nmessage = "csv"\nfield = "speed #1"\n')
    record = import_log(tmp_path / "a.csv", tmp_path / "m.toml")
    np.testing.assert_allclose(record["V_mps"], 20.0 + np.arange(50))


def test_prose_is_no_table() -> None:
    assert sniff(b"Dear all,\nthe flight went well, thank you.\nRegards,\nA.\n") is None


def test_a_record_whose_times_are_no_seconds_says_so(tmp_path: Path) -> None:
    time = 20000.0 * np.arange(200)
    FlightRecord({"time_s": time, "q_radps": np.sin(time * 1e-6)}).write(tmp_path / "r.csv")
    (finding,) = [
        f for f in import_log(tmp_path / "r.csv").metadata.findings if f.code == "time-unit"
    ]
    assert finding.severity == "error"
    assert "microseconds" in finding.message


def test_the_headings_of_jsbsims_output(tmp_path: Path) -> None:
    headings = (
        "Time, P (deg/s), Q (deg/s), R (deg/s), V_{Total} (ft/s), BodyAccel_Z, V_{Down} (ft/s),"
        " Altitude ASL (ft), Phi (deg), Theta (deg), Psi (deg), Alpha (deg), Beta (deg), Elevator"
        " Position (deg), Left Aileron Position (deg), Rudder Position (deg), Rho (slugs/ft^3)"
    )
    lines = [headings]
    for t, v in rows():
        lines.append(
            ", ".join(
                f"{x:.9f}"
                for x in (
                    t,
                    10,
                    20 * v[1],
                    30,
                    v[0] / 0.3048,
                    -32.174,
                    3 / 0.3048,
                    1000 - t,
                    5,
                    6,
                    350,
                    4,
                    1,
                    v[7],
                    1,
                    v[8],
                    0.0023769,
                )
            )
        )
    (tmp_path / "jsb.csv").write_text("\n".join(lines) + "\n")
    record = import_log(tmp_path / "jsb.csv")
    expected = {
        "p_radps": math.radians(10.0),
        "V_mps": 20.0,
        "az_mps2": -32.174 * 0.3048,
        "vd_mps": 3.0,
        "psi_rad": math.radians(350.0),
        "alpha_rad": math.radians(4.0),
        "aileron_pos_deg": 1.0,
        "rho_kgpm3": 1.225,
    }
    for name, value in expected.items():
        assert record[name][0] == pytest.approx(value, rel=1e-4), name
    assert record["h_m"][-1] - record["h_m"][0] == pytest.approx(-0.3048 * 9.98, rel=1e-3)
