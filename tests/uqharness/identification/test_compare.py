"""compare: gaps that are there are found, sized and timed; those that are not are not."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from sysid.record import FlightRecord
from tests.helpers.flown import fly
from tests.helpers.page_checks import problems
from tests.helpers.sixdof import Airframe
from uqharness.cli.main import main


@pytest.fixture(scope="module")
def record():
    return fly((("pitch-3211", 22.0), ("roll-yaw", 23.0)), seed=5, seconds=8.0)


def run(record, folder, *more):
    record.write(folder / "flight.parquet")
    out = folder / "gap"
    code = main(
        [
            "compare",
            "espaaro",
            "--flight",
            str(folder / "flight.parquet"),
            "--out",
            str(out),
            "--workers",
            "1",
            *more,
        ]
    )
    assert problems((out / "report.html").read_text(encoding="utf-8")) == []
    return code, json.loads((out / "compare.json").read_text()), out


def test_the_true_model_is_at_the_noise_floor_in_everything(record, tmp_path):
    code, result, out = run(record, tmp_path)
    assert code == 0
    assert result["above"] == []
    for name, row in result["channels"].items():
        if row["judged"]:
            assert 0.9 < row["ratio"] < 1.1, name
            if row["delay_s"] is None:
                assert row["delay_undefined"].startswith("the model moves"), name
            else:
                assert abs(row["delay_s"]) < 4 * row["delay_std_s"] + 1e-3, name
    assert [
        c for c, row in result["channels"].items() if row["judged"] and row["delay_s"] is None
    ] == ["V_mps", "ax_mps2"]
    for name, row in result["coefficients"].items():
        assert row["rms"] < 1.3 * row["noise"], name
    assert set(result["manoeuvres"]) == {"pitch-3211", "roll-yaw"}
    assert 1 <= len(result["moments"]) <= 20
    assert max(m["noises"] for m in result["moments"]) < 6.0
    for table in ("channels", "coefficients", "manoeuvres", "moments"):
        with (out / f"{table}.csv").open() as handle:
            assert len(list(csv.DictReader(handle))) >= 1
    figures = sorted(p.name for p in (out / "figures").iterdir())
    assert figures == ["00-pitch-3211.svg", "01-roll-yaw.svg", "coefficients.svg", "gaps.svg"]
    first = (out / "figures" / "gaps.svg").read_bytes()
    run(record, tmp_path)
    assert (out / "figures" / "gaps.svg").read_bytes() == first


def test_without_vanes_a_replay_begins_at_angles_that_its_motion_shows(tmp_path):
    """Slow flight, whose angle of attack is far from 0."""
    flight = fly((("pitch-3211", 17.0), ("roll-yaw", 17.0)), seed=5, seconds=8.0)
    columns = {n: v for n, v in flight.columns.items() if n not in ("alpha_rad", "beta_rad")}
    code, result, _ = run(FlightRecord(columns, flight.metadata), tmp_path, "--no-figures")
    assert flight["alpha_rad"][0] > 0.05
    assert max(row["ratio"] for row in result["channels"].values() if row["judged"]) < 1.1
    assert (code, result["above"]) == (0, [])


def test_a_late_channel_is_found_late(record, tmp_path):
    time = record["time_s"]
    late = record.with_columns({"beta_rad": np.interp(time - 0.06, time, record["beta_rad"])})
    code, result, _ = run(late, tmp_path, "--no-figures")
    row = result["channels"]["beta_rad"]
    assert code == 1
    assert row["delay_s"] == pytest.approx(0.06, abs=0.012)
    assert result["above"][0] == "beta_rad"


def test_a_record_that_the_log_s_findings_call_late_is_compared_as_refine_reads_it(tmp_path):
    """Moved by the finding, alpha would be at the noise here and late in what refine tells of the
    same flight.
    """
    record = fly((("pitch-3211", 22.0),), seed=5, seconds=30.0)
    late = record.with_columns(
        {"alpha_rad": np.interp(record["time_s"] - 0.1, record["time_s"], record["alpha_rad"])}
    )
    code, result, _ = run(late, tmp_path, "--no-figures")
    assert code == 1
    assert result["above"] == ["alpha_rad"]
    assert result["channels"]["alpha_rad"]["delay_s"] == pytest.approx(0.1, abs=0.015)
    assert [
        note
        for note in result["notes"]
        if "alpha_rad comes" in note and note.endswith("it stands as recorded")
    ]
    assert not [note for note in result["notes"] if "was moved" in note]


def test_an_elevator_doublet_says_nothing_of_roll_and_yaw(tmp_path):
    """Where roll is not excited p is noise: neither a scale of hundreds nor a delay, whatever its
    sign.
    """
    flight = fly((("pitch-doublet", 22.0),), seed=7, seconds=8.0)
    reversed_ = flight.with_columns(
        {"p_radps": -625.0 * flight["p_radps"], "q_radps": -flight["q_radps"]}
    )
    result = {}
    for record, name in ((flight, "right"), (reversed_, "wrong")):
        (tmp_path / name).mkdir()
        result[name] = run(record, tmp_path / name, "--no-figures")[1]["channels"]
    for channels in result.values():
        assert channels["p_radps"]["slip"] == ""
        assert channels["p_radps"]["delay_s"] is None
        assert channels["p_radps"]["delay_undefined"].startswith("the model moves 0.")
    assert result["right"]["q_radps"]["slip"] == ""
    assert result["wrong"]["q_radps"]["slip"].startswith("reversed")


def test_a_missing_term_shows_in_its_coefficient_and_manoeuvre(tmp_path):
    truth = Airframe().with_coefficient("Cl_p", -0.40)
    flight = fly((("pitch-3211", 22.0), ("roll-yaw", 23.0)), airframe=truth, seed=6, seconds=8.0)
    code, result, _ = run(flight, tmp_path, "--no-figures")
    assert code == 1
    assert result["above"][0] == "p_radps"
    ratios = {c: row["rms"] / row["noise"] for c, row in result["coefficients"].items()}
    assert max(ratios, key=ratios.get) == "Cl"
    assert ratios["Cm"] < 1.3
    assert result["manoeuvres"]["roll-yaw"]["channels"]["p_radps"] > 3.0
    assert result["manoeuvres"]["pitch-3211"]["channels"]["p_radps"] < 1.2
    assert result["moments"][0]["manoeuvre"] == "roll-yaw"
    row = result["channels"]["p_radps"]
    assert row["theil_u"] > 3 * result["channels"]["q_radps"]["theil_u"] * 0.3
    assert row["theil_bias"] + row["theil_variance"] + row["theil_covariance"] == pytest.approx(
        1.0, abs=1e-6
    )


def test_bad_input_is_one_line(tmp_path, capsys):
    assert (
        main(
            [
                "compare",
                "espaaro",
                "--flight",
                str(tmp_path / "no.csv"),
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 2
    )
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_logs_are_read_under_the_same_errors(tmp_path, capsys):
    (tmp_path / "x.bin").write_bytes(b"\x00" * 50)
    assert main(["log", "info", str(tmp_path / "x.bin")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("uqharness: error: ")
    assert error.count("\n") == 1
    fly((("pitch-doublet", 22.0),), seconds=3.0).write(tmp_path / "r.csv")
    assert (
        main(
            [
                "log",
                "import",
                str(tmp_path / "r.csv"),
                "--aircraft",
                "espaaro",
                "--out",
                str(tmp_path / "r.parquet"),
                "--no-cache",
            ]
        )
        == 0
    )
    assert (tmp_path / "r.parquet").is_file()
