"""Identification in Python gives the numbers of the commands."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

import uqharness as uq
from uqharness.cli.main import main
from uqharness.commands.flights import Flight

PARAMETERS = ["aero/Cm_q", "aero/Cm_de"]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flights") / "flight-ident.parquet"
    simulate(1).write(path)
    return path


def simulate(seed: int) -> Flight:
    return uq.fly("espaaro", "flight-ident", duration_s=30, noise=True, seed=seed)


def command(words: list[str], capsys: pytest.CaptureFixture) -> dict:
    main([*words, "--json"])
    return json.loads(capsys.readouterr().out)


def test_identify_gives_what_the_command_gives(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    words = [
        *shlex.split("identify espaaro --flight"),
        str(flight),
        "--params",
        ",".join(PARAMETERS),
        *shlex.split("--workers 1 --no-figures"),
    ]
    expected = command([*words, "--out", str(tmp_path / "out")], capsys)
    for inputs in (flight, simulate(1)):
        result = uq.identify("espaaro", inputs, parameters=PARAMETERS, workers=1)
        assert result.cov.tolist() == expected["cov"]
        for key in ("method", "converged", "simulations"):
            assert getattr(result, key) == expected[key], key
        assert list(result.to_dataframe()["estimate"]) == [
            expected["parameters"][n]["value"] for n in PARAMETERS
        ]
    assert capsys.readouterr() == ("", "")


def test_compare_gives_what_the_command_gives(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture
):
    words = [
        *shlex.split("compare espaaro --flight"),
        str(flight),
        *shlex.split("--workers 1 --no-figures --out"),
        str(tmp_path / "out"),
    ]
    expected = command(words, capsys)
    result = uq.compare("espaaro", flight, workers=1)
    assert list(result.above) == expected["above"]
    assert {c: g.rms for c, g in result.coefficients.items()} == {
        c: row["rms"] for c, row in expected["coefficients"].items()
    }
    table = result.to_dataframe()
    assert table["ratio"].to_dict() == {c: row["ratio"] for c, row in expected["channels"].items()}
    assert table.loc["q_radps", "rms"] == expected["channels"]["q_radps"]["rms"]
    assert not table.loc["h_m", "judged"]
    assert capsys.readouterr() == ("", "")


@pytest.mark.slow
def test_fit_model_form_gives_the_file_of_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    path = tmp_path / "bounds.parquet"
    uq.fly("espaaro_truth", "flight-bounds", duration_s=24, noise=True, seed=2).write(path)
    more = [
        *shlex.split(
            "--states CX=V,alpha,q --terms Cm=1,alpha,p^2 --outside clamp --confidence 0.9"
        ),
    ]
    for words, options in (
        ([], {}),
        (
            more,
            {
                "states": {"CX": ["V", "alpha", "q"]},
                "terms": {"Cm": ["1", "alpha", "p^2"]},
                "outside": "clamp",
                "confidence": 0.9,
            },
        ),
    ):
        out = tmp_path / f"out{len(words)}"
        assert (
            main(
                [
                    "bounds",
                    "espaaro",
                    "--flight",
                    str(path),
                    "--no-check",
                    "--no-figures",
                    *words,
                    "--out",
                    str(out),
                ]
            )
            == 0
        )
        capsys.readouterr()
        result = uq.fit_model_form("espaaro", path, checks=False, **options)
        assert result.form.to_json() == (out / "model-form.json").read_text()
    table = result.to_dataframe()
    assert table.loc["CX", "n"] == result.form.coefficients["CX"].n
    assert (table["noise"] > 0.0).all()
    assert (table["persistent"] > 0.0).all()
    assert table["found"].isin([True, False]).all()
    assert capsys.readouterr() == ("", "")
