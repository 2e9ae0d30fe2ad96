"""Trim, linear model and plugin in Python."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest

import uqharness as uq
from uqharness.cli.main import main
from uqharness.simulator.linear import modes


def test_trim_and_modes_are_those_of_the_command(capsys: pytest.CaptureFixture):
    assert (
        main(
            [
                *shlex.split(
                    "modes espaaro --speed-mps 22.2 --bank-deg 20 --altitude-m 100 --json"
                ),
            ]
        )
        == 0
    )
    expected = json.loads(capsys.readouterr().out)
    steady = uq.find_trim("espaaro", 22.2, bank_rad=math.radians(20.0), altitude_m=100.0)
    assert math.degrees(steady.alpha_rad) == expected["trim"]["alpha_deg"]
    assert steady.thrust_N == expected["trim"]["thrust_N"]
    model = uq.linearise(uq.find_aircraft("espaaro"), steady)
    assert [(m.name, m.real, m.imag) for m in modes(model)] == [
        (m["name"], m["real"], m["imag"]) for m in expected["modes"]
    ]
    assert np.isfinite(model.A).all()
    assert model.B.shape == (8, len(model.controls))
    assert capsys.readouterr() == ("", "")


def tree(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.slow
def test_instrument_writes_what_the_command_writes(tmp_path: Path, capsys: pytest.CaptureFixture):
    words = ["--constant", "CX=0.008,Cm=-0.01:0.02", "--json"]
    assert main(["instrument", "c172x", "--out", str(tmp_path / "command" / "c172x"), *words]) == 0
    expected = json.loads(capsys.readouterr().out)
    done = uq.instrument(
        "c172x", constant={"CX": 0.008, "Cm": (-0.01, 0.02)}, out=tmp_path / "python" / "c172x"
    )
    assert tree(done.folder) == tree(tmp_path / "command" / "c172x")
    assert done.verdict is not None
    assert done.verdict.status == expected["check"]["status"] == "works"
    assert list(done.notes) == expected["notes"]


def test_a_model_form_goes_in_as_it_came_out(tmp_path: Path):
    flight = uq.fly("espaaro_truth", "flight-bounds", duration_s=40, noise=True, seed=2)
    result = uq.fit_model_form("espaaro", flight, checks=False)
    path = tmp_path / "model-form.json"
    path.write_text(result.form.to_json())
    folders = [
        uq.instrument("espaaro", form, out=tmp_path / str(k)).folder
        for k, form in enumerate((result, result.form, path))
    ]
    assert tree(folders[0]) == tree(folders[1]) == tree(folders[2])
    assert tree(folders[0]) != tree(uq.find_aircraft("espaaro").folder)


def test_bounds_that_cannot_be_are_refused(tmp_path: Path):
    for invalid in ({"CQ": 0.1}, {"CX": (0.1, 0.2)}, {"CX": math.nan}):
        with pytest.raises(uq.BadInputError, match=r"constant = .*C"):
            uq.instrument("espaaro", constant=invalid, out=tmp_path / "out")
    with pytest.raises(uq.BadInputError, match="two sources"):
        uq.instrument(
            "espaaro", tmp_path / "model-form.json", constant={"CX": 0.1}, out=tmp_path / "out"
        )
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(uq.LogError):
        uq.instrument("espaaro", tmp_path / "broken.json", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
