"""`compare A B`: a truth against a spoilt copy of it, and against an exact copy."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import uqharness as uq
from uqharness.cli.main import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a flight of the espaaro and a copy with a third less pitch stiffness."""
    out = tmp_path_factory.mktemp("forecasts")
    uq.fly("espaaro", "loiter", duration_s=70.0, noise=True, seed=4).write(out / "flight.parquet")
    shutil.copytree(Path(__file__).parents[3] / "aircraft" / "espaaro", out / "spoilt")
    xml = out / "spoilt" / "espaaro.xml"
    text = xml.read_text(encoding="utf-8")
    assert '"-0.487">aero/Cm_alpha' in text
    xml.write_text(text.replace('"-0.487">aero/Cm_alpha', '"-0.65">aero/Cm_alpha'))
    return out


def test_truth_predicts_better_than_a_spoilt_copy(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(folder / "spoilt"), "--flight", str(folder / "flight.parquet")]
    assert main(["compare", "espaaro", *words, "--json", "--out", str(folder / "out")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["better"] == "A"
    assert document["horizon_s"] <= 1.0
    assert document["score"]["low"] > 0.0
    assert {h["horizon_s"] for h in document["horizons"]} == {0.2, 0.5, 1.0, 2.0, 5.0, 10.0}
    assert json.loads((folder / "out" / "compare.json").read_text()) == document


def test_a_copy_is_no_different(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = shutil.copytree(Path(__file__).parents[3] / "aircraft" / "espaaro", folder / "copy")
    flight = str(folder / "flight.parquet")
    assert main(["compare", "espaaro", str(copy), "--flight", flight]) == 0
    # Models of one name differ by their places.
    first, score, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("no difference: espaaro (A) and ")
    assert f"{copy} (B)" in first
    assert score.startswith("score +0.0 %")


def test_a_flight_of_a_second_is_refused(folder: Path) -> None:
    flight = uq.read_flights(folder / "flight.parquet", "espaaro")[0]
    with pytest.raises(uq.BadInputError, match="no stretch of 2 s"):
        uq.compare("espaaro", flight.record.rows(slice(0, 60)), other="espaaro")
