"""identify: known truth recovered from flights JSBSim did not make; the round trip log - identify -
XML - re-flown flight.
"""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest

from tests.helpers.flown import fly
from tests.helpers.page_checks import problems
from tests.helpers.sixdof import TABLE_2_6
from uqharness.cli.main import main
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft, open_aircraft

KINDS = (
    ("pitch-3211", 20.0),
    ("roll-yaw", 20.0),
    ("pitch-doublet", 24.0),
    ("yaw-roll", 24.0),
    ("throttle", 22.0),
    ("roll-yaw", 23.0),
)
LONGITUDINAL = ["CZ_0", "CZ_alpha", "CZ_de", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de"]


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flights")
    for name, kinds, seed in (
        ("train", KINDS, 11),
        ("test", (("pitch-doublet", 21.0), ("yaw-roll", 22.0), ("pitch-3211", 23.0)), 12),
        ("pitch", (("pitch-3211", 20.0), ("pitch-doublet", 24.0)), 13),
    ):
        fly(kinds, seed=seed, seconds=6.5).write(folder / f"{name}.parquet")
    return folder


@pytest.fixture(scope="module")
def identified(flights, tmp_path_factory):
    out = tmp_path_factory.mktemp("identified") / "out"
    arguments = [
        "identify",
        "espaaro",
        "--flight",
        str(flights / "train.parquet"),
        "--start",
        "initial",
        "--out",
        str(out),
    ]
    assert main([*arguments, "--workers", "1", "--no-figures"]) == 0
    return out, json.loads((out / "fit.json").read_text())


def test_truth_lies_within_the_stated_errors(identified):
    _, fit = identified
    assert fit["converged"]
    assert fit["method"] == "output error"
    misses = np.array(
        [(p["value"] - TABLE_2_6[n[5:]]) / p["std"] for n, p in fit["parameters"].items()]
    )
    assert len(misses) == 27
    assert 0.5 < np.sqrt(np.mean(misses**2)) < 1.5
    assert np.abs(misses).max() < 4.0


def test_fit_json_keeps_its_contract(identified):
    _, fit = identified
    assert {"parameters", "names", "cov", "warnings", "fit"} <= set(fit)
    assert [len(sha256) for sha256 in fit["flights_sha256"]] == [64]
    for name, p in fit["parameters"].items():
        assert name.startswith("aero/")
        assert {"value", "std", "std_crb", "status", "reason"} <= set(p)
        assert p["status"] in ("identified", "not-identified")
    assert fit["names"] == [n for n, p in fit["parameters"].items() if p["status"] == "identified"]
    cov = np.array(fit["cov"])
    assert cov.shape == (len(fit["names"]),) * 2
    np.testing.assert_allclose(
        np.sqrt(np.diag(cov)), [fit["parameters"][n]["std"] for n in fit["names"]]
    )
    assert all({"rms", "noise"} <= set(row) for row in fit["fit"].values())
    assert all(0.9 < row["rms"] / row["noise"] < 1.1 for row in fit["fit"].values())


def test_the_aircraft_with_the_estimates_differs_in_numbers_and_our_remarks_alone(identified):
    out, fit = identified
    for path in sorted((PROJECT_ROOT / "aircraft/espaaro").rglob("*")):
        if not path.is_file():
            continue
        copy = out / "aircraft" / path.relative_to(PROJECT_ROOT / "aircraft/espaaro")
        if path.name != "espaaro.xml":
            assert copy.read_bytes() == path.read_bytes()
            continue
        before, after = path.read_text().splitlines(), copy.read_text().splitlines()
        assert len(before) == len(after)
        changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
        assert len(changed) == 27
        for a, b in changed:
            plain = re.sub(r"  <!-- identified [^>]*-->$", "", b)
            assert re.sub(r'value="[^"]*"', "", plain) == re.sub(r'value="[^"]*"', "", a).rstrip()
            assert "+/-" in b
            assert "train.parquet" in b
    fdm = open_aircraft(find_aircraft(out / "aircraft"))
    for name, p in fit["parameters"].items():
        assert fdm[name] == pytest.approx(p["value"], rel=1e-6)


def test_the_round_trip_closes_on_a_flight_not_used(identified, flights, tmp_path, capsys):
    out, _ = identified
    code = main(
        [
            "compare",
            str(out / "aircraft"),
            "--flight",
            str(flights / "test.parquet"),
            "--out",
            str(tmp_path / "gap"),
            "--workers",
            "1",
            "--no-figures",
        ]
    )
    assert code == 0
    assert "reaches the noise floor" in capsys.readouterr().out
    document = json.loads((tmp_path / "gap" / "compare.json").read_text())
    assert document["reached_noise_floor"] is True
    assert max(c["ratio"] for c in document["channels"].values() if c["judged"]) < 1.1


@pytest.mark.slow
def test_a_model_without_pitch_damping_does_not_reach_the_floor_and_the_report_says_so(
    flights, tmp_path, capsys
):
    folder = tmp_path / "aircraft" / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft/espaaro", folder)
    xml = folder / "espaaro.xml"
    xml.write_text(
        xml.read_text().replace(
            '<property value="-13.8">aero/Cm_q', '<property value="0">aero/Cm_q'
        )
    )
    request = ",".join(n for n in LONGITUDINAL if n != "Cm_q")
    main(
        [
            "identify",
            str(folder),
            "--flight",
            str(flights / "pitch.parquet"),
            "--params",
            request,
            "--out",
            str(tmp_path / "id"),
            "--workers",
            "1",
            "--no-figures",
            "--method",
            "output-error",
        ]
    )
    fit = json.loads((tmp_path / "id" / "fit.json").read_text())
    assert any("coloured residuals" in w and "model's form" in w for w in fit["warnings"])
    capsys.readouterr()
    code = main(
        [
            "compare",
            str(tmp_path / "id" / "aircraft"),
            "--flight",
            str(flights / "test.parquet"),
            "--out",
            str(tmp_path / "gap"),
            "--workers",
            "1",
            "--no-figures",
        ]
    )
    assert code == 1
    output = capsys.readouterr().out
    assert "does not reach the noise floor" in output.splitlines()[0]
    assert re.search(r"\bq \d", output.splitlines()[0])
    assert "q_radps" not in output


def test_what_a_flight_does_not_tell_is_said_and_left_alone(flights, tmp_path):
    request = "aero/Cm_q,Cm_alpha,aero/Cn_0,aero/Cn_da"
    code = main(
        [
            "identify",
            "espaaro",
            "--flight",
            str(flights / "pitch.parquet"),
            "--params",
            request,
            "--out",
            str(tmp_path / "id"),
            "--workers",
            "1",
            "--no-figures",
        ]
    )
    assert code == 0
    fit = json.loads((tmp_path / "id" / "fit.json").read_text())
    is_lost = fit["parameters"]["aero/Cn_da"]
    assert is_lost["status"] == "not-identified"
    assert is_lost["reason"]
    assert is_lost["std"] is None
    assert is_lost["value"] == -7e-6
    assert fit["parameters"]["aero/Cm_q"]["status"] == "identified"
    assert "aero/Cn_da" not in fit["names"]
    assert any("aero/Cn_da" in w for w in fit["warnings"])
    assert (
        '<property value="-0.000007">aero/Cn_da</property>'
        in (tmp_path / "id/aircraft/espaaro.xml").read_text()
    )


def test_a_prior_does_not_hide_what_manoeuvres_show(flights, tmp_path):
    """Manoeuvres outweigh a wide prior; what they do not excite keeps it."""
    (tmp_path / "prior.toml").write_text(
        '[parameters."aero/Cm_q"]\nmean = -6.0\nstd = 5.0\nsource = "t"\n'
        '[parameters."aero/Cn_da"]\nmean = -0.0001\nstd = 0.0002\nsource = "t"\n'
    )
    words = ["identify", "espaaro", "--flight", str(flights / "pitch.parquet"), "--workers", "1"]
    words += ["--params", "aero/Cm_q,Cm_alpha,aero/Cn_0,aero/Cn_da", "--no-figures"]
    words += ["--prior", str(tmp_path / "prior.toml"), "--out", str(tmp_path / "id")]
    assert main(words) == 0
    fit = json.loads((tmp_path / "id" / "fit.json").read_text())
    damping, adverse = (fit["parameters"][f"aero/{n}"] for n in ("Cm_q", "Cn_da"))
    assert fit["method"] == "output error"
    assert abs(damping["value"] - TABLE_2_6["Cm_q"]) < 4.0 * damping["std"]
    assert (damping["basis"], adverse["basis"]) == ("data", "prior only")
    assert (adverse["value"], adverse["std"]) == (-0.0001, 0.0002)
    assert "aero/Cn_da" in fit["names"]
    assert np.linalg.eigvalsh(np.array(fit["cov"])).min() > 0.0


def test_parameters_follow_from_what_the_manoeuvres_excite(flights, tmp_path):
    """Pitch manoeuvres alone: what acts in roll and yaw is held with the reason, but for the
    constants, which act at all times.
    """
    code = main(
        [
            "identify",
            "espaaro",
            "--flight",
            str(flights / "pitch.parquet"),
            "--out",
            str(tmp_path / "id"),
            "--workers",
            "1",
            "--no-figures",
        ]
    )
    assert code == 0
    fit = json.loads((tmp_path / "id" / "fit.json").read_text())
    assert {f"aero/{n}" for n in LONGITUDINAL} <= set(fit["names"])
    for name in ("aero/CY_p", "aero/Cl_da", "aero/Cl_p", "aero/Cn_da", "aero/Cn_dr"):
        assert fit["parameters"][name]["status"] == "not-identified", name
        assert fit["parameters"][name]["reason"].startswith("held at "), name
        assert fit["parameters"][name]["value"] == fit["parameters"][name]["initial"], name
    assert {"aero/Cl_0", "aero/Cn_0"} <= set(fit["names"])


def test_where_all_is_excited_nothing_is_held(identified):
    _, fit = identified
    assert not any(p["reason"].startswith("held") for p in fit["parameters"].values())
    assert len(fit["fit"]) == 11


def test_outputs_are_those_asked_for(flights, tmp_path, capsys):
    arguments = [
        "identify",
        "espaaro",
        "--flight",
        str(flights / "pitch.parquet"),
        "--params",
        "Cm_q,Cm_de",
        "--workers",
        "1",
    ]
    assert (
        main(
            [
                *arguments,
                "--outputs",
                "V,alpha,theta,q,az",
                "--no-figures",
                "--out",
                str(tmp_path / "id"),
            ]
        )
        == 0
    )
    fit = json.loads((tmp_path / "id" / "fit.json").read_text())
    assert set(fit["fit"]) == {"V_mps", "alpha_rad", "theta_rad", "q_radps", "az_mps2"}
    assert fit["names"] == ["aero/Cm_q", "aero/Cm_de"]
    for inputs, words in (("x", "unknown channel x"), ("none", "no outputs are selected")):
        capsys.readouterr()
        assert main([*arguments, "--outputs", inputs, "--out", str(tmp_path / "no")]) == 2
        assert words in capsys.readouterr().err


def test_figures_and_tables_are_there(flights, tmp_path):
    out = tmp_path / "id"
    assert (
        main(
            [
                "identify",
                "espaaro",
                "--flight",
                str(flights / "pitch.parquet"),
                "--params",
                "Cm_q",
                "--out",
                str(out),
                "--workers",
                "2",
            ]
        )
        == 0
    )
    assert sorted(p.name for p in (out / "figures").iterdir()) == [
        "pitch-00-pitch-3211.svg",
        "pitch-01-pitch-doublet.svg",
    ]
    assert (out / "figures" / "pitch-00-pitch-3211.svg").read_text().startswith("<svg")
    assert (out / "parameters.csv").read_text().splitlines()[
        0
    ] == "parameter,initial,estimate,std,crb,status,reason,basis"
    assert problems((out / "report.html").read_text(encoding="utf-8")) == []
    # Again over the same folder: replaced, and an earlier remark does not pile up.
    assert (
        main(
            [
                "identify",
                str(out / "aircraft"),
                "--flight",
                str(flights / "pitch.parquet"),
                "--params",
                "Cm_q",
                "--out",
                str(tmp_path / "second"),
                "--workers",
                "1",
                "--no-figures",
            ]
        )
        == 0
    )
    text = (tmp_path / "second/aircraft/espaaro.xml").read_text()
    assert text.count("<!-- identified") == 1


def test_bad_input_is_one_line_and_exit_code_2(flights, tmp_path, capsys):
    train = str(flights / "train.parquet")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "text.csv").write_text("hello\nworld\n")
    complete = fly((("pitch-doublet", 22.0),), seconds=3.0)
    type(complete)(
        {k: v for k, v in complete.columns.items() if not k.startswith(("aileron", "rudder"))}
    ).write(tmp_path / "bare.csv")
    from dataclasses import replace

    foreign = complete.with_columns({}, replace(complete.metadata, aircraft="c172"))
    foreign.write(tmp_path / "foreign.parquet")
    for arguments, words in (
        (["espaaro", "--flight", str(tmp_path / "none.bin")], "none.bin"),
        (["espaaro", "--flight", str(tmp_path / "empty.csv")], "empty.csv"),
        (["espaaro", "--flight", str(tmp_path / "text.csv")], "text.csv"),
        (["espaaro", "--flight", str(tmp_path / "bare.csv")], "no aileron_deg, rudder_deg"),
        (["espaaro", "--flight", str(tmp_path / "foreign.parquet")], "c172"),
        (["nowhere", "--flight", train], "nowhere"),
        (["espaaro", "--flight", train, "--params", "aero/Cm_qq"], "did you mean aero/Cm_q"),
        (["espaaro", "--flight", train, "--params", "Cm_q,aero/Cm_q"], "twice"),
        (["espaaro", "--flight", train, "--params", ","], "--params ,: a property or several"),
        (["espaaro", "--flight", train, "--biases", "x"], "unknown channel x"),
        (["espaaro", "--flight", train, "--workers", "0"], "at least 1"),
    ):
        assert main(["identify", *arguments, "--out", str(tmp_path / "out")]) == 2, arguments
        error = capsys.readouterr().err
        assert error.startswith("uqharness: error: ")
        assert error.count("\n") == 1
        assert words in error
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    for out in ("file", "file/b"):
        for command in ("identify", "compare", "bounds"):
            assert main([command, "espaaro", "--flight", train, "--out", str(tmp_path / out)]) == 2
            assert "is no folder" in capsys.readouterr().err


def test_jsbsim_reads_a_missing_property_as_such():
    fdm = open_aircraft(find_aircraft("espaaro"))
    assert engine.undefined_properties(fdm) == []
