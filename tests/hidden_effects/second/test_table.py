"""The second examination's run: first-met lines apart from later ones, on after a stop, no draw for
code that is not committed.
"""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

import pytest

from tests.hidden_effects import sealed
from tests.hidden_effects.second import __main__ as run
from tests.hidden_effects.second import table
from tests.hidden_effects.second.drawn import DEVELOPMENT, drawn
from tests.hidden_effects.second.verdict import judge
from tests.hidden_effects.test_answers import effect, refinement

COST = {"cpu_s": 10.0, "peak_MB": 500.0, "exit": 0, "error": "", "apart": 0.001}


def test_lines_are_written_read_back_and_kept_apart(tmp_path):
    path = tmp_path / "met.csv"
    asked = drawn(DEVELOPMENT, 8)
    first = table.line_of(
        asked, judge(asked, refinement(effect("CX:de")), 0), COST, "aaa", table.FIRST
    )
    later = table.line_of(asked, judge(asked, refinement(), 0), COST, "bbb", table.LATER)
    assert tuple(first) == table.COLUMNS
    for line in (first, later):
        table.add(path, line)
    lines = table.read(path)
    assert [r["effects"] for r in table.of_draw(lines, DEVELOPMENT, table.FIRST)] == ["1"]
    assert [r["effects"] for r in table.of_draw(lines, DEVELOPMENT, table.LATER)] == ["0"]
    assert table.of_draw(lines, 1, table.FIRST) == []
    assert (lines[0]["commit"], lines[1]["commit"], lines[0]["generator"]) == (
        "aaa",
        "bbb",
        table.generator_digest(),
    )


def test_what_is_still_to_be_asked():
    met = ((1, 0, "first", "a"), (1, 1, "first", "a"), (1, 1, "later", "b"), (2, 2, "first", "a"))
    lines = [{"draw": str(d), "number": str(n), "met": m, "commit": c} for d, n, m, c in met]
    assert run.todo(lines, 1, range(4), "b", False) == [2, 3]
    assert run.todo(lines, 1, range(4), "b", True) == [0]
    assert run.todo(lines, 1, range(4), "a", True) == []


def test_a_stopped_run_goes_on_and_meets_each_case_once(tmp_path, monkeypatch, capsys):
    asked = []

    def ask(question, folder, place):
        asked.append(question.number)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return {**COST, "found": refinement()}

    monkeypatch.setattr(run, "ask", ask)
    monkeypatch.setattr(run, "write", lambda cases, folder: set())
    monkeypatch.setattr(run, "question", lambda draw, number, folder, seconds: drawn(draw, number))
    given = ["--development", "--out", str(tmp_path), "--numbers", "8", "12"]
    with pytest.raises(KeyboardInterrupt):
        run.main(given)
    assert run.main(given) == 1  # no parameters were told
    assert asked == [8, 12, 12]
    assert [r["number"] for r in table.read(tmp_path / "met.csv")] == ["8", "12"]
    assert "nulls without an effect: 2 of 2" in capsys.readouterr().out


def test_several_are_asked_side_by_side_and_a_stop_tells_none_of_them():
    at_once, seen = [0], []

    def ask(number):
        at_once[0] += 1
        seen.append(at_once[0])
        time.sleep(0.05)
        at_once[0] -= 1
        return {"number": number}

    found = dict(run.answers(range(7), lambda number: number, ask, 3))
    assert found == {n: {"number": n} for n in range(7)}
    assert max(seen) > 1
    assert dict(run.answers(range(4), lambda number: None if number == 2 else number, ask)) == {
        n: {"number": n} for n in (0, 1, 3)
    }

    def stopped(number):
        if number == 2:
            raise KeyboardInterrupt
        return sealed.run_measured(Path(), ["-c", "import time; time.sleep(60)"], 90.0)

    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        list(run.answers(range(5), lambda number: number, stopped, 3))
    assert time.monotonic() - begun < 30.0


def test_a_case_that_cannot_be_drawn_is_left_out_and_told_and_not_tried_again(
    tmp_path, monkeypatch, capsys
):
    tried = []

    def never(draw, number, *_):
        tried.append(number)
        raise RuntimeError(f"draw {draw}, case {number}: no flight in 200 attempts")

    monkeypatch.setattr(run, "question", never)
    for _ in range(2):
        run.main(["--development", "--numbers", "3", "--out", str(tmp_path)])
        assert "3: left out: draw 0, case 3: no flight in 200 attempts" in capsys.readouterr().err
    assert tried == [3]


def test_a_draw_is_not_met_by_code_that_is_not_committed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(table, "code_of", lambda: ("abc", True))
    monkeypatch.setattr(run, "ask", lambda *_: pytest.fail("asked"))
    assert run.main(["--draw", "1", "--out", str(tmp_path)]) == 2
    assert "commit them first" in capsys.readouterr().err
    for more in (["--numbers", "1"], ["--seconds", "20"]):
        with pytest.raises(SystemExit) as stopped:
            run.main(["--draw", "1", "--out", str(tmp_path), *more])
        assert stopped.value.code == 2


def test_two_tables_of_one_flight():
    found = refinement(effect("CX:de"), after=1.0)
    other = {
        "channels": {
            "q_radps": {"ratio": 1.0, "judged": True},
            "h_m": {"ratio": 9.0, "judged": False},
        }
    }
    assert run.apart_of(found, other) == pytest.approx(0.0, abs=1e-9)
    assert run.apart_of(refinement(after=1.27), other) == pytest.approx(0.27)
    assert run.apart_of({}, other) == math.inf
    # What a sensor has wrong is not in the model that was written.
    assert (
        run.compared(refinement(effect("sensor.alpha_rad:scale")), tmp := None, "", tmp, tmp)
        is None
    )
    assert (
        run.compared({**refinement(), "timing": {"controls_late_s": 0.02}}, tmp, "", tmp, tmp)
        is None
    )


def test_a_measured_process_tells_what_it_cost(tmp_path):
    busy = sealed.run_measured(
        tmp_path,
        ["-c", "x = bytearray(150_000_000)\nfor _ in range(10**7): pass\nprint('done')"],
        60.0,
    )
    idle = sealed.run_measured(tmp_path, ["-c", "import time; time.sleep(0.2)"], 60.0)
    assert (busy.returncode, busy.stdout.strip()) == (0, "done")
    assert busy.peak_MB > 140.0 > idle.peak_MB
    assert busy.cpu_s > 2.0 * idle.cpu_s
    child = (
        "import subprocess, sys; subprocess.run([sys.executable, '-c', 'x ="
        " bytearray(150_000_000)'])"
    )
    assert sealed.run_measured(tmp_path, ["-c", child], 60.0).peak_MB > 140.0
    assert (
        sealed.run_measured(tmp_path, ["-c", "import time; time.sleep(60)"], 0.5).returncode == -1
    )
    assert sealed.run_measured(tmp_path, ["-c", "raise SystemExit(2)"], 60.0).returncode == 2


def test_the_commit_and_the_generator_are_told():
    commit, changed = table.code_of()
    assert len(commit) >= 7
    assert isinstance(changed, bool)
    assert len(table.generator_digest()) == 10
    assert json.dumps(table.generator_digest())
