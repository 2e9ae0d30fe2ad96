"""``uqharness margins``: the loops asked for, in figures that a machine can read."""

from __future__ import annotations

import json

import pytest

from tests.helpers.page_checks import problems, words_of
from uqharness.cli.main import main


@pytest.mark.slow
def test_gains_of_a_file_twice_as_large_move_both_gain_margins_by_6_dB(tmp_path, capsys):
    # The rate controller is linear in its three gains together, so L doubles at every frequency: 20
    # log10(2) dB.
    specific = {"RLL_RATE_P": 0.22, "RLL_RATE_I": 0.20, "RLL_RATE_FF": 0.40}
    result = []
    for factor in (1.0, 2.0):
        path = tmp_path / f"{factor:g}.param"
        path.write_text(
            "".join(f"{name} {factor * value}\n" for name, value in specific.items())
            + "RLL_RATE_SMAX 150\n"
        )
        assert (
            main(["margins", "espaaro", "--loop", "aileron", "--autopilot", str(path), "--json"])
            == 0
        )
        document = json.loads(capsys.readouterr().out)
        result.append(document["loops"]["aileron"])
        assert document["autopilot"]["taken"]["ap/RLL_RATE_P"] == factor * 0.22
        assert document["autopilot"]["ignored"] == {
            "RLL_RATE_SMAX": "the autopilot has no such term"
        }
    assert result[0]["gain_up_dB"] - result[1]["gain_up_dB"] == pytest.approx(6.0206, abs=0.01)
    assert result[1]["gain_down_dB"] - result[0]["gain_down_dB"] == pytest.approx(6.0206, abs=0.01)


def test_a_page_is_written_when_asked(tmp_path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "margins.html"
    assert main(["margins", "espaaro", "--loop", "aileron", "--out", str(path)]) == 0
    page = path.read_text(encoding="utf-8")
    assert problems(page) == []
    words = words_of(page)
    assert "uqharness margins espaaro --loop aileron" in words
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].startswith("  aileron: 3 of 55 frequencies, 0.19 to 0.31 rad/s, are not used")
    reports = lines[2].split()
    assert (
        f"gain margin up {reports[1]} dB, down {reports[2]} dB; phase margin {reports[3]} deg"
        in words
    )
