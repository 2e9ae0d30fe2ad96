"""Airspeed and flow angles from velocity components."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.logs.channels import (
    COMPONENTS,
    components_of,
    with_air_data,
)
from sysid.logs.load import import_log
from tests.helpers.synthetic import flight

AIR = ("V_mps", "alpha_rad", "beta_rad")


def test_a_tables_own_columns_win() -> None:
    columns = {
        "time_s": np.arange(2.0),
        **dict.fromkeys(COMPONENTS, np.full(2, 10.0)),
        "V_mps": np.full(2, 17.0),
    }
    result = with_air_data(columns)
    assert result["V_mps"].tolist() == [17.0, 17.0]
    assert result["alpha_rad"] == pytest.approx(np.pi / 4)
    assert not set(COMPONENTS) & set(result)


def table(path: Path, every: int, names: dict[str, str] | None = None) -> None:
    """A table of u, v, w in place of airspeed and angles, each value between every so many
    interpolated.
    """
    record, rng = flight(60.0, seed=3), np.random.default_rng(3)
    at = np.arange(len(record))
    columns = {n: v for n, v in record.columns.items() if n not in AIR and n != "manoeuvre"}
    for name, values in zip(COMPONENTS, components_of(*(record[n] for n in AIR)), strict=True):
        noisy = values + 0.2 * rng.standard_normal(at.size)
        columns[name] = np.interp(at, at[::every], noisy[::every])
    header = ",".join((names or {}).get(n, n) for n in columns)
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=header,
        comments="",
        fmt="%.17g",
    )


def test_u_v_w_of_a_csv_are_read_and_said_to_be_interpolated(tmp_path: Path) -> None:
    table(tmp_path / "fast.csv", 1)
    table(tmp_path / "slow.csv", 5)
    fast, slow = import_log(tmp_path / "fast.csv"), import_log(tmp_path / "slow.csv")
    truth = flight(60.0, seed=3)
    assert np.nanmax(np.abs(fast["V_mps"] - truth["V_mps"])) < 1.5
    assert np.nanmedian(np.abs(fast["alpha_rad"] - truth["alpha_rad"])) < 0.02
    reports = [
        {f.channel: f.numbers["native_hz"] for f in r.metadata.findings if f.code == "interpolated"}
        for r in (fast, slow)
    ]
    assert reports[0] == {}
    assert reports[1] == pytest.approx(dict.fromkeys(AIR, 10.0), rel=0.02)


def test_a_map_reads_them_under_any_name_and_unit(tmp_path: Path) -> None:
    table(tmp_path / "a.csv", 1, {"time_s": "t", "u_mps": "U", "v_mps": "V", "w_mps": "W"})
    (tmp_path / "map.toml").write_text(
        '[signals.V_mps]\nmessage = "csv"\nfields = ["U", "V", "W"]\nfunction = "air_speed"\nscale'
        ' = 0.3048\n[signals.alpha_rad]\nmessage = "csv"\nfields = ["U", "W"]\nfunction ='
        ' "air_alpha"\n[signals.beta_rad]\nmessage = "csv"\nfields = ["U", "V", "W"]\nfunction ='
        ' "air_beta"\n'
    )
    table(tmp_path / "b.csv", 1)
    mapped, plain = (
        import_log(tmp_path / "a.csv", tmp_path / "map.toml"),
        import_log(tmp_path / "b.csv"),
    )
    np.testing.assert_allclose(mapped["V_mps"], 0.3048 * plain["V_mps"], rtol=1e-9)
    np.testing.assert_allclose(mapped["alpha_rad"], plain["alpha_rad"], atol=1e-12)
    np.testing.assert_allclose(mapped["beta_rad"], plain["beta_rad"], atol=1e-12)
