"""From a stock JSBSim aircraft and its own flights, logged in knots, feet, degrees and g, to the
name of what the model lacks.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.record import FlightRecord
from sysid.units import FT_M, KT_MPS
from uqharness.cli.main import main

G = 9.80665
COLUMNS = {  # column -> signal, size of the unit, step of the logger in that unit
    "kt": ("V_mps", KT_MPS, 0.1),
    "aoa_deg": ("alpha_rad", np.pi / 180.0, 0.02),
    "slip_deg": ("beta_rad", np.pi / 180.0, 0.02),
    "roll_deg": ("phi_rad", np.pi / 180.0, 0.02),
    "pitch_deg": ("theta_rad", np.pi / 180.0, 0.02),
    "hdg_deg": ("psi_rad", np.pi / 180.0, 0.1),
    "p_dps": ("p_radps", np.pi / 180.0, 0.05),
    "q_dps": ("q_radps", np.pi / 180.0, 0.05),
    "r_dps": ("r_radps", np.pi / 180.0, 0.05),
    "nx_g": ("ax_mps2", G, 0.002),
    "ny_g": ("ay_mps2", G, 0.002),
    "nz_g": ("az_mps2", G, 0.002),
    "alt_ft": ("h_m", FT_M, 1.0),
    "elev_deg": ("elevator_deg", 1.0, 0.01),
    "ail_deg": ("aileron_deg", 1.0, 0.01),
    "rud_deg": ("rudder_deg", 1.0, 0.01),
}
POWER = {"throttle_pct": ("thr_pct", 0.1), "thrust_N": ("thrust_N", 1.0)}


def hide_the_effect(folder: Path, out: Path, size: float) -> Path:
    """A copy of an instrumented aircraft whose pitching moment goes with roll rate squared (of p b
    / 2V) as well: a term that no function of these aircraft has."""
    out.mkdir()
    for file in folder.rglob("*"):
        if file.is_file():
            target = out / file.relative_to(folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    (xml,) = [
        file
        for file in out.glob("*.xml")
        if "<aerodynamics" in file.read_text(encoding="utf-8", errors="replace")
    ]
    text = xml.read_text(encoding="utf-8", errors="replace")
    place = text.index(">", text.index('<axis name="PITCH"')) + 1
    hidden = (
        "<function"
        ' name="aero/hidden"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>'
        f"<property>metrics/cbarw-ft</property><value>{size}</value><pow><product><property>aero/bi2vel</property>"
        "<property>velocities/p-aero-rad_sec</property></product><value>2</value></pow></product></function>"
    )
    xml.write_text(text[:place] + hidden + text[place:], encoding="utf-8")
    return out


def foreign_log(record: FlightRecord, out: Path, power: str = "throttle_pct") -> Path:
    """A CSV in other units, every value on the steps of its logger."""
    table = {"t": record["time_s"]}
    for column, (signal, unit, step) in COLUMNS.items():
        table[column] = step * np.round(record[signal] / unit / step)
    column, step = POWER[power]
    table[column] = step * np.round(record[power] / step)
    pd.DataFrame(table).to_csv(out, index=False, float_format="%.6g")
    return out


def foreign_map(out: Path, power: str = "throttle_pct") -> Path:
    """The signal map of such a log."""
    lines = []
    for column, (signal, unit, _) in {**COLUMNS, POWER[power][0]: (power, 1.0, 0.0)}.items():
        lines.append(f'[signals.{signal}]\nmessage = "csv"\nfield = "{column}"\nscale = {unit!r}\n')
    out.write_text("\n".join(lines))
    return out


def ran(*words: object) -> int:
    """A command in this process."""
    return main([str(word) for word in words])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "speeds", "hidden"),
    # The T37 flies half of the others' p b / 2V and has more inertia: of an effect of 12 its gyros'
    # noise hides all.
    [("c172p", (50, 55), 3.0), ("J3Cub", (30, 34), 3.0), ("T37", (90, 100), 40.0)],
)
def test_a_stock_aircraft_and_its_logs_come_to_the_name_of_the_hidden_effect(
    name, speeds, hidden, tmp_path
):
    (tmp_path / "flown").mkdir()
    specific = tmp_path / name
    assert ran("instrument", name, "--out", specific, "--no-check") == 0
    truth = hide_the_effect(specific, tmp_path / "flown" / name, hidden)
    logs = []
    for k, (mission, speed) in enumerate(
        (("doublets", speeds[0]), ("3-2-1-1", speeds[1]), ("doublets", speeds[1]))
    ):
        flight = tmp_path / f"flown-{k}.parquet"
        request = (
            "--mission",
            mission,
            "--speed-mps",
            speed,
            "--rate-hz",
            100,
            "--noise",
            "--seed",
            k,
        )
        assert ran("fly", truth, *request, "--out", flight) == 0
        log = foreign_log(FlightRecord.read(flight), tmp_path / f"log-{k}.csv")
        mapped = foreign_map(tmp_path / "map.toml")
        logs.append(tmp_path / f"flight-{k}.parquet")
        read = ("--map", mapped, "--aircraft", specific, "--manoeuvres", "found", "--no-cache")
        assert ran("log", "import", log, *read, "--out", logs[-1]) == 0
    common = ("--workers", 1, "--no-figures")
    # A model that lacks a term may stop short of the last standard error; it says so.
    code = ran(
        "identify",
        specific,
        "--flight",
        logs[0],
        logs[1],
        "--out",
        tmp_path / "identified",
        *common,
    )
    fit = json.loads((tmp_path / "identified" / "fit.json").read_text())
    assert (code == 0) == (fit["converged"] and bool(fit["names"]))
    assert ran("compare", specific, "--flight", logs[2], "--out", tmp_path / "gap", *common) == 1
    gap = json.loads((tmp_path / "gap" / "compare.json").read_text())
    assert "q_radps" in gap["above"]
    assert not any(row["slip"] for row in gap["channels"].values())
    ran(
        "refine",
        specific,
        "--train",
        logs[0],
        logs[1],
        "--test",
        logs[2],
        "--out",
        tmp_path / "refined",
        "--no-pbox",
        *common,
    )
    result = json.loads((tmp_path / "refined" / "refinement.json").read_text())
    assert [(e["coefficient"], e["term"]) for e in result["effects"]] == [("Cm", "p_hat^2")]
    assert result["effects"][0]["value"] == pytest.approx(hidden, rel=0.1)


@pytest.mark.parametrize("sign", [-1.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_measured_thrust_in_a_foreign_log_drives_the_replay(sign, tmp_path, capsys):
    """Knots, feet, degrees and g, no throttle; the elevator reversed as the case in which compare
    says no.
    """
    flight, imported = tmp_path / "flown.parquet", tmp_path / "imported.parquet"
    words = "fly espaaro --script doublet-elevator --duration-s 8 --rate-hz 100 --noise --seed 3"
    ran(*words.split(), "--out", flight)
    record = FlightRecord.read(flight)
    turned = record.with_columns({"elevator_deg": sign * record["elevator_deg"]})
    log = foreign_log(turned, tmp_path / "log.csv", "thrust_N")
    mapped = foreign_map(tmp_path / "map.toml", "thrust_N")
    read = ("--map", mapped, "--aircraft", "espaaro", "--no-cache")
    assert ran("log", "import", log, *read, "--out", imported) == 0
    assert "throttle_pct" not in FlightRecord.read(imported)
    capsys.readouterr()
    # The servos that flew; tests/uqharness/identification/test_servos.py chooses among two.
    options = ("--servos", "card", "--workers", 1, "--no-figures", "--json")
    code = ran("compare", "espaaro", "--flight", imported, "--out", tmp_path / "gap", *options)
    gap = json.loads(capsys.readouterr().out)
    assert any("throttle_pct was made of thrust_N" in note for note in gap["notes"])
    if sign < 0.0:
        assert code == 1
        assert "the elevator is reversed" in gap["verdict"]
    else:
        assert all(row["ratio"] < 1.2 for row in gap["channels"].values() if row["judged"])
