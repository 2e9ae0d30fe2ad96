"""`uqharness log export`, and the CSV layout that PlotJuggler reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from uqharness.cli import main as cli


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    words = ["fly", "espaaro", "--script", "doublet-elevator", "--duration-s", "4", "--out"]
    assert cli.main([*words, str(folder / "a.csv")]) == 0
    assert cli.main([*words, str(folder / "a.bin")]) == 0
    return folder


def test_a_log_with_a_position_needs_no_more(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = [
        "log",
        "export",
        str(flight / "a.bin"),
        "--aircraft",
        "espaaro",
        "--out",
        str(tmp_path / "shown"),
        "--json",
    ]
    assert cli.main(words) == 0
    result = json.loads(capsys.readouterr().out)
    rows = np.loadtxt(result["files"][0], delimiter=",")
    assert rows.shape == (result["rows"], len(result["columns"]))
    assert np.isfinite(rows).all()
    assert Path(result["files"][1]).read_text().startswith('<?xml version="1.0"?>')


def test_a_record_needs_a_start(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = [
        "log",
        "export",
        str(flight / "a.csv"),
        "--aircraft",
        "espaaro",
        "--out",
        str(tmp_path / "shown"),
    ]
    assert cli.main(words) == 2
    assert "give --lat-deg and --lon-deg" in capsys.readouterr().err
    assert not (tmp_path / "shown").exists()
    assert cli.main([*words, "--lat-deg", "91"]) == 2
    assert (
        "--lat-deg 91: a number of at least -90 and up to 90 is needed" in capsys.readouterr().err
    )
    assert cli.main([*words, "--lat-deg", "37.2", "--lon-deg", "-80.4", "--alt-m", "630"]) == 0
    output = capsys.readouterr().out
    assert "--generic=file,in,30," in output
    first = np.loadtxt(tmp_path / "shown" / "playback.csv", delimiter=",")[0]
    assert first[:2] == pytest.approx([37.2, -80.4], abs=1e-6)
