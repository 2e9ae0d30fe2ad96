"""What a terminal is told while a command works, and a pipe is not."""

from __future__ import annotations

import io
import re
import sys

import pytest
from rich.console import Console

from uqharness.campaign.run import Progress
from uqharness.cli.progress import (
    ProgressView,
    clock,
    counting,
    describe,
    say_line,
    say_warnings,
    time_left,
    working,
)


def test_progress_on_a_terminal_and_silence_elsewhere():
    state = Progress(
        cases=100, done=60, done_before=0, failed=2, flown_s=36000.0, elapsed_s=30.0, workers=2
    )
    assert describe(state) == "0:20 to go, 600 flight h per core h, 2 failed"
    assert clock(3725.4) == "1:02:05"
    for terminal in (True, False):
        drawn = io.StringIO()
        console = Console(file=drawn, force_terminal=terminal, width=100, legacy_windows=False)
        with ProgressView(console) as view:
            view.update(state)
        assert ("60/100" in drawn.getvalue()) is terminal
        assert bool(drawn.getvalue()) is terminal


@pytest.mark.parametrize("terminal", [True, False])
def test_stages_lines_and_counters_are_for_terminals_alone(monkeypatch, terminal):
    told = io.StringIO()
    monkeypatch.setattr(told, "isatty", lambda: terminal)
    monkeypatch.setattr(sys, "stderr", told)
    say_line("round 1")
    with counting("repeats") as update:
        update(1, 2)
    said = told.getvalue()
    assert (said != "") is terminal
    if terminal:
        assert "round 1\n" in said
        assert "repeats: 1 of 2" in said


def test_the_time_to_go_is_in_proportion_to_what_is_left():
    assert time_left(30.0, 1.5, 4) == "0:50 to go"
    assert time_left(30.0, 0.0, 4) == time_left(30.0, 4.0, 4) == ""


@pytest.mark.parametrize("terminal", [True, False])
def test_a_working_command_shows_stage_time_and_count_on_a_terminal_alone(terminal):
    drawn, flown = io.StringIO(), [100]
    console = Console(file=drawn, force_terminal=terminal, width=100, legacy_windows=False)
    with working("identify", lambda: flown[0], console=console) as stage:
        stage("output [bold]error\x1b[2J")
        flown[0] += 1234
        stage("output [bold]error\x1b[2J")
    said = drawn.getvalue()
    assert bool(said) is terminal
    if terminal:
        # A log's own words neither steer the terminal nor become markup.
        assert "identify: output [bold]error\\x1b[2J" in said
        assert "0:00:00" in said
        assert "1,234 segments flown" in said


def test_finished_stages_stay_where_that_is_asked_for():
    drawn = io.StringIO()
    console = Console(file=drawn, force_terminal=True, width=100, legacy_windows=False)
    with working("refine", keep=True, console=console) as stage:
        for text in ("reading", "mission: 1 of 2 flights", "mission: 2 of 2 flights", "report"):
            stage(text)
    lines = re.findall(r"refine: ([^\n\r\x1b]*) \(0:00\)", drawn.getvalue())
    assert lines == ["reading", "mission: 2 of 2 flights", "report"]


def test_warnings_are_told_in_a_pipe_too(capsys):
    say_warnings(["too short", "too calm"])
    assert (
        capsys.readouterr().err == "uqharness: warning: too short\nuqharness: warning: too calm\n"
    )


def test_a_long_command_writes_a_line_now_and_then_where_there_is_no_terminal(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("uqharness.cli.progress.time.monotonic", lambda: now[0])

    def written(lines_s):
        drawn = io.StringIO()
        with working(
            "identify", lines_s=lines_s, console=Console(file=drawn, force_terminal=False)
        ) as stage:
            for seconds, text in (
                (4.0, "reading"),
                (11.0, "iteration 3, about 20 s left"),
                (15.0, "iteration 4"),
                (75.0, "\x1b[2Jreport"),
            ):
                now[0] = 100.0 + seconds
                stage(text)
        return drawn.getvalue().splitlines()

    lines = written(10.0)
    assert lines[0] == "identify: 0:11, iteration 3, about 20 s left"
    assert len(lines) == 2
    assert lines[1].startswith("identify: 1:15, ")
    assert "\x1b" not in lines[1]
    assert written(1000.0) == []
    assert written(float("inf")) == []
