"""``--autopilot FILE``: the gains of a parameter file fly, and the command says which."""

from __future__ import annotations

import math

from uqharness.cli.main import main


def test_gains_of_a_parameter_file_are_flown_and_told(tmp_path, capsys):
    file, out = tmp_path / "plane.param", tmp_path / "flight.csv"
    file.write_text("ROLL_LIMIT_DEG 5\nRLL_RATE_SMAX 150\nBATT_CAPACITY 5000\n")
    words = ["fly", "espaaro", "--duration-s", "10", "--out", str(out)]
    assert main(words) == 0
    specific = max(abs(float(line.split(",")[4])) for line in out.read_text().splitlines()[1:])
    capsys.readouterr()
    assert main([*words, "--autopilot", str(file)]) == 0
    reports = capsys.readouterr().out
    assert f"{file}:\n  1 gains taken: ROLL_LIMIT_DEG 5" in reports
    assert "RLL_RATE_SMAX (the autopilot has no such term)" in reports
    assert "1 parameters of other functions" in reports
    assert out.read_text().splitlines()[0].split(",")[4] == "phi_rad"
    limited = max(abs(float(line.split(",")[4])) for line in out.read_text().splitlines()[1:])
    assert limited < math.radians(8.0) < specific
    file.write_text("RLL2SRV_TCONST 0\n")
    assert main([*words, "--autopilot", str(file)]) == 2
    assert f"{file}: line 1: RLL2SRV_TCONST 0" in capsys.readouterr().err
