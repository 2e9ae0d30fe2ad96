"""A proposed map restores the record from which a table with unknown columns was made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.logs.card import read_card
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.load import import_log
from sysid.logs.map_proposal import propose_map
from tests.helpers.places import TESTS
from tests.helpers.synthetic import flight

DEG = 180.0 / np.pi
STRANGE = {
    # column: signal, factor of what is written over the record
    "TAS_KT": ("V_mps", 3600.0 / 1852.0),
    "AoA (deg)": ("alpha_rad", DEG),
    "AoS": ("beta_rad", DEG),
    "Bank Angle": ("phi_rad", DEG),
    "Pitch [deg]": ("theta_rad", DEG),
    "Heading": ("psi_rad", DEG),
    "GyroX": ("p_radps", DEG),
    "GyroY": ("q_radps", -DEG),
    "GyroZ": ("r_radps", DEG),
    "AccX": ("ax_mps2", 1.0 / 9.80665),
    "AccY": ("ay_mps2", -1.0 / 9.80665),
    "AccZ": ("az_mps2", -1.0 / 9.80665),
    "Baro Alt [ft]": ("h_m", 1.0 / 0.3048),
    "VN": ("vn_mps", 1.0),
    "VE": ("ve_mps", 1.0),
    "Climb Rate (ft/min)": ("vd_mps", -60.0 / 0.3048),
    "Elevator Pos": ("elevator_deg", 1.0),
    "Thr": ("throttle_pct", 0.01),
}


def test_units_and_signs_of_a_strange_table_are_found(tmp_path: Path) -> None:
    record = flight(90.0, seed=4)
    columns = {name: record[signal] * factor for name, (signal, factor) in STRANGE.items()}
    columns["Heading"] = np.mod(columns["Heading"] + 180.0, 360.0) - 180.0
    frame = pd.DataFrame({"TIME_MS": np.round(1e3 * record["time_s"]), **columns, "Note": "x"})
    frame.to_csv(tmp_path / "strange.csv", sep=";", decimal=",", index=False)
    proposal = propose_map(tmp_path / "strange.csv")
    (tmp_path / "m.toml").write_text(proposal.to_toml())
    repeat = import_log(tmp_path / "strange.csv", tmp_path / "m.toml")
    for name, (signal, factor) in STRANGE.items():
        column = "elevator_pos_deg" if signal == "elevator_deg" else signal
        p = next(p for p in proposal.signals if p.signal == column)
        assert p.entry.fields == (name,)
        assert p.entry.scale * factor == pytest.approx(1.0, rel=1e-3), column
        assert p.evidence
    assert proposal.time is not None
    assert (proposal.time.field, proposal.time.unit) == ("TIME_MS", "ms")
    np.testing.assert_allclose(repeat["q_radps"], record["q_radps"], atol=1e-9)
    assert not [f for f in repeat.metadata.findings if f.code in ("unit", "sign", "out-of-range")]
    assert "Note" in proposal.unused
    assert "# unsure: " in proposal.to_toml()


def test_surfaces_of_both_sides_are_joined_by_how_they_move(tmp_path: Path) -> None:
    record = flight(60.0, seed=4)
    aileron, elevator = record["aileron_deg"], record["elevator_deg"]
    columns = {
        "time_s": record["time_s"],
        "da_l": np.radians(aileron),
        "da_r": -np.radians(aileron),
        "Elevator Left [deg]": elevator + 0.2,
        "Elevator Right [deg]": elevator - 0.2,
        "r": record["r_radps"],
        "tas": record["V_mps"],
        "az": record["az_mps2"],
    }
    pd.DataFrame(columns).to_csv(tmp_path / "both.csv", index=False)
    (tmp_path / "m.toml").write_text(propose_map(tmp_path / "both.csv").to_toml())
    repeat = import_log(tmp_path / "both.csv", tmp_path / "m.toml")
    np.testing.assert_allclose(repeat["aileron_deg"], aileron, atol=1e-6)
    np.testing.assert_allclose(repeat["elevator_deg"], elevator, atol=1e-6)
    np.testing.assert_allclose(repeat["r_radps"], record["r_radps"], atol=1e-9)


def test_a_dialects_own_fields_are_kept(tmp_path: Path) -> None:
    card = TESTS / "sysid" / "data" / "airframe.toml"
    write_dataflash(flight(duration_s=40.0, start_s=5.0), tmp_path / "a.bin", read_card(card))
    proposal = propose_map(tmp_path / "a.bin", card)
    labels = {p.signal: p.entry.label for p in proposal.signals}
    assert labels["q_radps"] == "IMU.GyrY"
    assert "elevator_deg" in {*labels, *proposal.from_servos}
    (tmp_path / "m.toml").write_text(proposal.to_toml())
    plain, mapped = (import_log(tmp_path / "a.bin", m, card) for m in (None, tmp_path / "m.toml"))
    for name, values in plain.columns.items():
        if values.dtype != object:
            np.testing.assert_allclose(mapped[name], values, atol=1e-9, err_msg=name)
