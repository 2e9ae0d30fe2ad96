"""The commands bounds and validate-bounds, on flights of the reference truth and on flights that
must be refused.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from sysid.foreign.regular_files import file_sha256
from sysid.model_form.model_form import read_model_form
from sysid.record import FlightRecord
from tests.helpers.page_checks import problems
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.identification.bounds import parse_designs
from uqharness.simulator.aircraft import PROJECT_ROOT

TRUTH, MODEL = "espaaro_truth", "espaaro"


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The second and the third flight of the reference truth, one seed, and a short flight of the
    model without noise.
    """
    folder = tmp_path_factory.mktemp("flights")
    out = {}
    for name, aircraft, script, more in (
        ("bounds", TRUTH, "flight-bounds", ["--noise", "--turbulence", "light", "--seed", "31"]),
        (
            "validation",
            TRUTH,
            "flight-validation",
            ["--noise", "--turbulence", "light", "--seed", "32"],
        ),
        ("clean", MODEL, "doublet-elevator", []),
    ):
        out[name] = folder / f"{name}.parquet"
        assert main(["fly", aircraft, "--script", script, "--out", str(out[name]), *more]) == 0
    return out


@pytest.fixture(scope="module")
def results(flights: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the bounds from the second flight."""
    out = tmp_path_factory.mktemp("made") / "bounds"
    assert (
        main(["bounds", MODEL, "--flight", str(flights["bounds"]), "--out", str(out), "--no-check"])
        == 0
    )
    return out


def test_bounds_leaves_a_form_a_system_a_report_and_figures(results):
    form = read_model_form(results / "model-form.json")
    assert set(form.coefficients) == {"CX", "CY", "CZ", "Cl", "Cm", "Cn"}
    assert form.coefficients["CX"].states == ("V_mps", "alpha_rad", "q_radps", "theta_rad")
    assert form.coefficients["Cl"].states == ("V_mps", "beta_rad", "p_radps", "r_radps")
    assert all(
        len(b.terms) == 15 and b.n > 2000 and 15 < b.n_effective < b.n
        for b in form.coefficients.values()
    )
    assert all(
        b.walk_rate == b.parts.transient_rate_per_sqrt_s > 0.0 for b in form.coefficients.values()
    )
    assert form.flights[0].name == "bounds"
    assert len(form.flights[0].sha256) == 64
    assert b"<system" in (results / "model-form.xml").read_bytes()
    report = (results / "report.html").read_text(encoding="utf-8")
    assert problems(report) == []
    assert "Where the data are" in report
    for figure in ("slices-CX", "slices-Cn", "variation", "data"):
        assert (results / "figures" / f"{figure}.svg").stat().st_size < 3_000_000


def test_the_missing_pitch_rate_term_of_the_truth_is_seen(results):
    """The truth has CX_q = 1.5: at 0.3 rad/s of pitch rate dCX is 1.5 x 0.3 x c/2V = 0.0057, up and
    down.
    """
    b = read_model_form(results / "model-form.json").coefficients["CX"]
    middle = dict(zip(b.states, b.hull.middle[:, 1], strict=True))
    at = {s: np.full(2, v) for s, v in middle.items()} | {"q_radps": np.array([-0.3, 0.3])}
    low, high = b.interval(at)
    slope = np.diff(0.5 * (low + high))[0] / 0.6
    assert slope == pytest.approx(1.5 * 0.53 / (2 * middle["V_mps"]), rel=0.35)


@pytest.mark.slow
def test_the_same_flight_gives_the_same_bytes(results, flights, tmp_path):
    arguments = [
        "bounds",
        MODEL,
        "--flight",
        str(flights["bounds"]),
        "--out",
        str(tmp_path / "again"),
        "--no-check",
    ]
    assert main([*arguments, "--no-figures"]) == 0
    for name in ("model-form.json", "model-form.xml"):
        assert (tmp_path / "again" / name).read_bytes() == (results / name).read_bytes()


def test_the_third_flight_lies_within(results, flights, tmp_path, capsys):
    out = tmp_path / "check"
    arguments = [
        "validate-bounds",
        MODEL,
        str(results / "model-form.json"),
        "--flight",
        str(flights["validation"]),
        "--json",
    ]
    code = main([*arguments, "--out", str(out)])
    document = json.loads(capsys.readouterr().out)
    assert code == (0 if set(document["verdicts"].values()) == {"holds"} else 1)
    assert document["failed"] == [
        c for c, output in document["verdicts"].items() if output == "fails"
    ]
    assert document["flight_variance"] == dict.fromkeys(
        document["coverage"]
    )  # one flight behind the bounds
    assert [row["state"] for row in document["by_speed"]] == ["V_mps"] * 3
    assert [row["state"] for row in document["by_incidence"]] == ["alpha_rad"] * 3
    assert all(
        row["level"] == pytest.approx(0.9) and row["manoeuvres"] == 9
        for row in document["conformal"].values()
    )
    assert set(document["coverage"]) == {"CX", "CY", "CZ", "Cl", "Cm", "Cn"}
    for row in document["coverage"].values():
        assert set(row) == {"0.95", "0.68", "n_effective", "mean_width"}
        assert 0.85 < row["0.95"] <= 1.0
        assert row["0.68"] < row["0.95"]
        assert 10 < row["n_effective"] < 2600
    assert np.mean([row["0.95"] for row in document["coverage"].values()]) == pytest.approx(
        0.95, abs=0.03
    )
    assert len(document["manoeuvres"]) == 9
    assert document["warnings"] == []
    assert (out / "figures" / "coverage.svg").exists()
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "Table 2.3" not in report  # of one aeroplane, the E-SPAARO
    assert problems(report) == []


def test_bounds_that_do_not_hold_are_an_answer(results, flights, tmp_path, capsys):
    """The same bounds, ten times too narrow."""
    document = json.loads((results / "model-form.json").read_text())
    for row in document["coefficients"].values():
        row["s2"] /= 100.0
        for part in ("persistent", "transient"):
            row["parts"][part] = 0.0
    narrow = tmp_path / "narrow.json"
    narrow.write_text(json.dumps(document))
    assert (
        main(["validate-bounds", MODEL, str(narrow), "--flight", str(flights["validation"])]) == 1
    )
    assert "do not hold" in capsys.readouterr().out


def test_validating_with_the_flight_behind_the_bounds_is_warned_of(results, flights, capsys):
    main(
        [
            "validate-bounds",
            MODEL,
            str(results / "model-form.json"),
            "--flight",
            str(flights["bounds"]),
        ]
    )
    assert "made from this flight" in capsys.readouterr().err


def test_a_model_without_errors_leaves_nothing_in_a_flight_without_noise(flights, tmp_path, capsys):
    """JSBSim on both sides: what is left is the filter's own error.

    States that stood still are left out and said.
    """
    out = tmp_path / "clean"
    assert (
        main(
            [
                "bounds",
                MODEL,
                "--flight",
                str(flights["clean"]),
                "--out",
                str(out),
                "--json",
                "--no-figures",
                "--no-check",
            ]
        )
        == 0
    )
    document = json.loads(capsys.readouterr().out)
    for c, limit in {
        "CX": 2e-4,
        "CY": 1e-6,
        "CZ": 1e-3,
        "Cl": 1e-6,
        "Cm": 2e-3,
        "Cn": 1e-6,
    }.items():
        assert document["coefficients"][c]["mean_width"] < limit
    assert any("beta_rad" in n and "hardly varied" in n for n in document["notes"])
    # Coefficients whose note is the same share one.
    texts = [n.partition(": ")[2] for n in document["notes"] if "hardly varied" in n]
    assert len(texts) == len(set(texts)) < 6


@pytest.mark.slow
def test_checks_name_the_noise_and_the_other_filters(flights, tmp_path, capsys):
    out = tmp_path / "checked"
    arguments = [
        "bounds",
        MODEL,
        "--flight",
        str(flights["bounds"]),
        "--out",
        str(out),
        "--json",
        "--no-figures",
    ]
    assert main([*arguments, "--roll-terms", "--outside", "clamp", "--confidence", "0.9"]) == 0
    document = json.loads(capsys.readouterr().out)
    rows = document["coefficients"]
    # The truth has a right sideforce: its bounds are a fraction of what noise alone would make
    # them.
    assert rows["CY"]["mean_width"] / rows["CY"]["noise_width"] < 0.4
    assert rows["CY"]["found"] is False
    assert rows["Cl"]["transient"] > 3.0 * rows["Cl"]["noise_std"]  # turbulence rolls the aircraft
    assert "p_radps^2" in rows["Cm"]["terms"]
    assert len(document["left_out"]) == 9
    widths = {
        (r["cutoff_hz"], r["airspeed_cutoff_hz"]): r["mean_width"] for r in document["cutoffs"]
    }
    assert set(widths) == {(3.0, 2.0), (12.0, 2.0), (6.0, 1.0), (6.0, None)}
    # Noise is in no bounds: a filter that lets twice as much of it through hardly moves them.
    assert all(0.5 < w["CY"] / rows["CY"]["mean_width"] < 2.0 for w in widths.values())
    assert read_model_form(out / "model-form.json").outside == "clamp"


def leave_out(path: Path, channel: str, folder: Path) -> Path:
    record = FlightRecord.read(path)
    out = folder / f"no-{channel}.parquet"
    FlightRecord({k: v for k, v in record.columns.items() if k != channel}, record.metadata).write(
        out
    )
    return out


@pytest.mark.parametrize(
    "channel", ["beta_rad", "alpha_rad", "V_mps", "q_radps", "az_mps2", "elevator_deg"]
)
def test_a_flight_without_a_needed_channel_is_refused_by_name(flights, tmp_path, capsys, channel):
    flight = leave_out(flights["clean"], channel, tmp_path)
    if channel == "elevator_deg":  # the measured position stands in for it
        flight = leave_out(flight, "elevator_pos_deg", tmp_path)
    assert main(["bounds", MODEL, "--flight", str(flight), "--out", str(tmp_path / "x")]) == 2
    assert channel in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_another_aircrafts_bounds_and_bad_files_are_refused(results, flights, tmp_path, capsys):
    form, flight = str(results / "model-form.json"), str(flights["clean"])
    assert main(["validate-bounds", "synthetic_stall", form, "--flight", flight]) == 2
    assert "belong to aircraft 'espaaro'" in capsys.readouterr().err
    assert main(["validate-bounds", MODEL, str(tmp_path / "none.json"), "--flight", flight]) == 2
    assert "none.json" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main(["bounds", MODEL, "--flight", flight, "--out", str(tmp_path / "file" / "b")]) == 2
    assert "is no folder" in capsys.readouterr().err


@pytest.mark.slow
def test_an_identified_model_is_not_bounded_by_its_own_flight(flights, tmp_path, capsys):
    (tmp_path / "fit.json").write_text(
        json.dumps({"flights": ["x.bin"], "flights_sha256": [file_sha256(flights["clean"])]})
    )
    shutil.copytree(PROJECT_ROOT / "aircraft" / MODEL, tmp_path / "aircraft")
    arguments = [
        "bounds",
        str(tmp_path / "aircraft"),
        "--flight",
        str(flights["clean"]),
        "--out",
        str(tmp_path / "b"),
    ]
    assert main([*arguments, "--no-check", "--no-figures"]) == 0
    assert "was identified from this flight" in capsys.readouterr().err


def test_designs_by_option():
    designs = parse_designs(["CX=V,alpha,de"], ["Cm=1,alpha,p^2,alpha*q"], 1, True)
    assert designs["CX"].states == ("V_mps", "alpha_rad", "elevator_pos_deg")
    assert designs["CX"].order == 1
    assert designs["Cm"].states == ("alpha_rad", "p_radps", "q_radps")
    assert designs["Cm"].terms == ((0, 0, 0), (1, 0, 0), (0, 2, 0), (1, 0, 1))
    for states, terms, output in (
        (["CX"], [], "C=name"),
        (["CL=V"], [], "one of CX"),
        (["CX=V,speed"], [], "unknown state speed"),
        (["CX=V,V"], [], "named twice"),
        ([], ["Cm=1"], "no term depends"),
        ([], ["Cm=alpha**2"], "is no state with a power"),
        ([], ["Cm=alpha,alpha"], "named twice"),
    ):
        with pytest.raises(BadInputError, match=output.replace("*", r"\*")):
            parse_designs(states, terms, 2, False)


@pytest.mark.parametrize(
    "option", [["--confidence", "95"], ["--cutoff-hz", "0"], ["--walk-cutoff-hz", "nan"]]
)
def test_numbers_out_of_range_are_refused(flights, tmp_path, capsys, option):
    assert (
        main(
            [
                "bounds",
                MODEL,
                "--flight",
                str(flights["clean"]),
                "--out",
                str(tmp_path / "x"),
                *option,
            ]
        )
        == 2
    )
    assert option[0] in capsys.readouterr().err


@pytest.mark.slow
def test_genuine_logs_of_three_flights(tmp_path, capsys):
    """The second flight bounds Table 2.6's model, the third lies within: no vanes, servo commands
    at 25 Hz, airspeed at 10.
    """
    folder = Path(os.environ.get("UQ_FLIGHT_DATA", "nowhere")) / "espaaro-ardupilot"
    if not folder.is_dir():
        pytest.skip(
            "set UQ_FLIGHT_DATA to the folder with espaaro-ardupilot/ to run on genuine logs"
        )
    more = ["--manoeuvres", str(folder / "manoeuvres.csv"), "--servos", "ideal"]
    flight = str(folder / "flight2_uncertainty.BIN")
    assert (
        main(
            [
                "bounds",
                MODEL,
                "--flight",
                flight,
                *more,
                "--out",
                str(tmp_path / "b"),
                "--no-check",
                "--no-figures",
            ]
        )
        == 0
    )
    assert "come from an estimator" in capsys.readouterr().err
    form = str(tmp_path / "b" / "model-form.json")
    flight = str(folder / "flight3_validation.BIN")
    assert main(["validate-bounds", MODEL, form, "--flight", flight, *more, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["coverage"]
    assert all(0.92 < row["0.95"] < 0.99 for row in rows.values())


@pytest.mark.slow
def test_the_published_interval_is_made_on_request(flights, tmp_path, capsys):
    """Noise and all, every sample counted: wider than the model's error by far where the model is
    right.
    """
    arguments = [
        "bounds",
        MODEL,
        "--flight",
        str(flights["bounds"]),
        "--no-check",
        "--no-figures",
        "--json",
    ]
    result = {}
    for name, more in (
        ("published", ["--as-published"]),
        ("apart", []),
        ("counted", ["--as-published", "--sample-size", "effective"]),
    ):
        assert main([*arguments, *more, "--out", str(tmp_path / name)]) == 0
        result[name] = json.loads(capsys.readouterr().out)["coefficients"]
    assert (
        json.loads((tmp_path / "published" / "model-form.json").read_text())["format"]
        == "model-form 1"
    )
    assert (
        json.loads((tmp_path / "apart" / "model-form.json").read_text())["format"] == "model-form 2"
    )
    assert (
        result["published"]["CY"]["n_effective"]
        == result["published"]["CY"]["n"]
        > 3.0 * result["counted"]["CY"]["n_effective"]
    )
    assert result["published"]["CY"]["mean_width"] > 3.0 * result["apart"]["CY"]["mean_width"]
    assert main([*arguments, "--sample-size", "all", "--out", str(tmp_path / "x")]) == 2
    assert "--sample-size requires --as-published" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
