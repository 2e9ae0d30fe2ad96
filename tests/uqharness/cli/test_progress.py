"""What a terminal is told while a command works, and a pipe is not."""

from __future__ import annotations

import io
import sys
import threading

import pytest
from rich.console import Console

from uqharness.campaign.run import Progress
from uqharness.cli.progress import ProgressView, clock, describe, working
from uqharness.heartbeat import Forecast, Rate, heartbeat
from uqharness.requests.refinement import RefineRequest


def test_progress_on_a_terminal_and_silence_elsewhere():
    state = Progress(
        cases=100, done=60, done_before=0, failed=2, flown_s=36000.0, elapsed_s=30.0, workers=2
    )
    assert describe(state) == "0:20 to go, 600 flight h per core h, 2 failed"
    assert clock(3725.4) == "1:02:05"
    for terminal in (True, False):
        drawing = io.StringIO()
        console = Console(file=drawing, force_terminal=terminal, width=100, legacy_windows=False)
        with ProgressView(console) as view:
            view.update(state)
        assert ("60/100" in drawing.getvalue()) is terminal
        assert bool(drawing.getvalue()) is terminal


def test_the_time_to_go_follows_recent_work_and_counts_down():
    """Ten units at one a second after a start of 100 s, in which one unit was done: 10 s to go, not
    100.
    """
    clock_s = [0.0]
    rate = Rate(lambda: clock_s[0])
    assert rate.seconds_left(0, 21) is None
    for done in range(1, 12):
        clock_s[0] = 100.0 + done
        remaining = rate.seconds_left(done, 21)
    assert remaining == pytest.approx(10.0)
    clock_s[0] += 3.0
    assert rate.seconds_left(11, 21) == pytest.approx(7.0)
    assert rate.seconds_left(21, 21) is None


@pytest.mark.parametrize("calm", [False, True])
def test_a_command_in_a_pipe_says_that_it_is_at_work(monkeypatch, calm):
    monkeypatch.setenv("UQHARNESS_QUIET", "1" if calm else "")
    content = threading.Event()

    class Pipe(io.StringIO):
        def write(self, text):
            content.set()
            return super().write(text)

    pipe = Pipe()
    monkeypatch.setattr(sys, "stderr", pipe)
    with heartbeat("uqharness refine", first_s=0.01, every_s=0.01), working("refine") as stage:
        stage("round 1")
        if not calm:
            content.clear()
            assert content.wait(60.0)
    assert ("uqharness refine: 0:0" in pipe.getvalue()) is not calm
    assert ("round 1" in pipe.getvalue()) is not calm


@pytest.mark.parametrize("terminal", [True, False])
def test_a_working_command_shows_stage_time_and_count_on_a_terminal_alone(terminal):
    drawing, flight = io.StringIO(), [100]
    console = Console(file=drawing, force_terminal=terminal, width=100, legacy_windows=False)
    with working("identify", lambda: flight[0], console=console) as stage:
        stage("output [bold]error\x1b[2J")
        flight[0] += 1234
        stage("output [bold]error\x1b[2J")
    output = drawing.getvalue()
    assert bool(output) is terminal
    if terminal:
        # A log's own words neither steer the terminal nor become markup.
        assert "identify: output [bold]error\\x1b[2J" in output
        assert "0:00:00" in output
        assert "1,234 segments simulated" in output


def test_a_forecast_is_corrected_by_the_stages_that_have_ended():
    clock_s = [0.0]
    forecast = Forecast({"read": 5.0, "servos": 7.0, "fit": 40.0, "write": 5.0}, lambda: clock_s[0])
    assert forecast.seconds_left() == pytest.approx(57.0)
    forecast.begin("read")
    clock_s[0] = 2.0
    assert forecast.seconds_left() == pytest.approx(55.0)
    # Read in twice the time; the servos were left out. Five seconds count as expected.
    clock_s[0] = 10.0
    forecast.begin("fit")
    assert forecast.seconds_left() == pytest.approx(1.5 * 45.0)
    clock_s[0] = 40.0
    forecast.begin("something unknown")
    assert forecast.seconds_left() == pytest.approx(1.5 * 45.0 - 30.0)
    # A stage that takes longer than expected never has a negative time ahead.
    clock_s[0] = 300.0
    assert forecast.seconds_left() > 1.5 * 5.0
    forecast.expect({"read": 1.0, "servos": 1.0, "fit": 1.0, "write": 50.0})
    assert forecast.seconds_left() > 1.5 * 50.0
    assert forecast.expected_s["fit"] == 40.0


def test_refine_has_a_forecast_before_its_flights_are_read(tmp_path):
    flights = {"train": ["a.csv", "b.csv"], "test": ["c.csv"], "out": tmp_path, "workers": 1}
    request = RefineRequest.of(aircraft="espaaro", **flights)
    plain = RefineRequest.of(aircraft="espaaro", **flights, pbox=False)
    assert sum(plain.expected_s(180.0).values()) == pytest.approx(
        2.0 / 3.0 * sum(plain.expected_s().values())
    )
    assert Forecast(request.expected_s()).seconds_left() > 60.0
