"""Executors: every case comes back once, whatever it does to its worker; the engines by name."""

from __future__ import annotations

import multiprocessing
import os
import random
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign import processes
from uqharness.campaign.processes import (
    Group,
    OneByOne,
    ProcessExecutor,
    SerialExecutor,
    default_timeout_s,
)
from uqharness.errors import BadInputError
from uqharness.flight.fly import fly, fly_one_ulp_off
from uqharness.flight.spec import FlightResult, FlightSpec

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)


def flights(number):
    return [
        (
            f"{index:04d}",
            FlightSpec(Path("plane"), Path("loiter.xml"), 150.0, seed_turbulence=index),
        )
        for index in range(number)
    ]


def fly_all(executor, function, cases):
    outcomes = [outcome for batch in executor.run(function, cases) for outcome in batch]
    assert sorted(o.case_id for o in outcomes) == sorted(case_id for case_id, _ in cases)
    return {outcome.case_id: outcome for outcome in outcomes}


def test_serial_and_processes_agree():
    cases = flights(30)
    remaining = set(multiprocessing.active_children())
    serial = fly_all(SerialExecutor(), fakes.steady, cases)
    assert fly_all(ProcessExecutor(1, "fork"), fakes.steady, cases) == serial
    assert fly_all(ProcessExecutor(3, "fork"), fakes.steady, cases) == serial
    assert fly_all(ProcessExecutor(2, "spawn"), fakes.steady, cases) == serial
    assert not set(multiprocessing.active_children()) - remaining


def test_a_short_campaign_ends_in_the_process_of_the_check(monkeypatch):
    cases = flights(30)
    remaining = set(multiprocessing.active_children())
    check = ProcessExecutor(1, "fork", keep=True)
    fly_all(check, fakes.steady, cases[:1])
    executor = ProcessExecutor(3, "fork")
    executor.adopt(check)
    (child,) = set(multiprocessing.active_children()) - remaining
    monkeypatch.setattr(executor, "_start", None)
    assert fly_all(executor, fakes.steady, cases) == fly_all(SerialExecutor(), fakes.steady, cases)
    assert not child.is_alive()
    # Nothing is left to close.
    check.close()


def test_crashes_are_counted_with_their_reason():
    result = fly_all(ProcessExecutor(2, "fork"), fakes.hazardous, flights(10))
    kinds = {
        index: (result[f"{index:04d}"].status, result[f"{index:04d}"].reason) for index in range(10)
    }
    # level_sum is 3 for a flight without levels, and 3 * 7 + seed decides: see campaign_fakes.
    assert kinds[9] == ("crashed", "the worker process ended: signal 6 (SIGABRT) (tried 2 times)")
    assert kinds[0] == ("crashed", "the worker process ended: signal 11 (SIGSEGV) (tried 2 times)")
    assert kinds[1] == ("diverged", "the state was no longer finite at 90.0 s")
    assert kinds[2] == ("crashed", "RuntimeError: a flight that raises")
    assert kinds[3] == ("crashed", "the worker process ended: exit code 3 (tried 2 times)")
    assert [kinds[index][0] for index in range(4, 9)] == ["ok"] * 5


def test_workers_killed_from_outside_cost_no_case():
    done = threading.Event()
    kills = []

    def murder():
        chance = random.Random(3)
        while not done.wait(0.15) and len(kills) < 3:
            children = multiprocessing.active_children()
            if children:
                victim = chance.choice(children)
                if victim.pid:
                    os.kill(victim.pid, 9)
                    kills.append(victim.pid)

    cases = flights(60)
    reference = fly_all(SerialExecutor(), fakes.steady, cases)
    thread = threading.Thread(target=murder)
    thread.start()
    try:
        result = fly_all(ProcessExecutor(2, "fork"), fakes.slow, cases)
    finally:
        done.set()
        thread.join()
    assert kills
    assert result == reference


def groups(cases, size):
    return [
        Group("batch", tuple(cases[first : first + size])) for first in range(0, len(cases), size)
    ]


def fly_groups(executor, function, cases, size):
    outcomes = [
        outcome for batch in executor.run_groups(function, groups(cases, size)) for outcome in batch
    ]
    assert sorted(outcome.case_id for outcome in outcomes) == sorted(
        case_id for case_id, _ in cases
    )
    return {outcome.case_id: outcome for outcome in outcomes}


def test_groups_give_what_single_flights_give():
    cases = flights(50)
    reference = fly_all(SerialExecutor(), fakes.steady, cases)
    for executor, size in (
        (SerialExecutor(), 7),
        (ProcessExecutor(2, "fork"), 16),
        (ProcessExecutor(2, "spawn"), 50),
    ):
        assert fly_groups(executor, OneByOne(fakes.steady), cases, size) == reference


def test_a_group_that_crashes_is_split_down_to_the_case():
    # Of ten flights, five do something dreadful; all the others come back.
    cases = flights(10)
    single = fly_all(ProcessExecutor(2, "fork"), fakes.hazardous, cases)
    assert fly_groups(ProcessExecutor(2, "fork"), OneByOne(fakes.hazardous), cases, 5) == single
    assert {outcome.status for outcome in single.values()} == {"ok", "crashed", "diverged"}


def test_a_group_that_hangs_is_split_down_to_the_case():
    executor = ProcessExecutor(2, "fork", timeout_s=lambda flight: 0.5)
    result = fly_groups(executor, OneByOne(fakes.hangs_sometimes), flights(12), 12)
    assert {case_id for case_id, outcome in result.items() if outcome.status != "ok"} == {"0009"}
    assert result["0009"].reason == "no result after 0.5 s (tried 2 times)"


def too_few(engine, flights):
    return [fakes.steady(flight) for flight in flights[1:]]


def test_a_group_function_that_loses_a_flight_is_no_result():
    result = fly_groups(SerialExecutor(), too_few, flights(3), 3)
    assert {outcome.status for outcome in result.values()} == {"crashed"}


def test_executor_marks_bad_input():
    result = fly_all(ProcessExecutor(1, "fork"), fakes.refuses, flights(1))["0000"]
    assert result.bad_input
    assert "uq/active" in result.reason


def test_stopping_leaves_no_process():
    # Another test's processes may still be ending.
    remaining = set(multiprocessing.active_children())
    batches = ProcessExecutor(2, "fork").run(fakes.slow, flights(2000))
    for _ in range(4):
        next(batches)
    batches.close()
    assert not set(multiprocessing.active_children()) - remaining


def test_children_have_one_numerical_thread_each(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    result = fly_all(ProcessExecutor(1, "spawn"), fakes.reports_threads, flights(1))["0000"]
    assert result.metrics == {"omp": 1.0, "openblas": 1.0}
    assert os.environ["OMP_NUM_THREADS"] == "8"


def test_workers_that_cannot_start_are_an_error():
    with pytest.raises(BadInputError, match="before they start"):
        fly_all(ProcessExecutor(1, "spawn"), fakes.NotThere(), flights(1))


def test_executor_refuses_impossible_settings():
    with pytest.raises(BadInputError, match="workers = 0"):
        ProcessExecutor(0)
    with pytest.raises(BadInputError, match="start method 'thread'"):
        ProcessExecutor(1, "thread")
    assert default_timeout_s(FlightSpec(Path("a"), Path("b"), 3600.0)) == pytest.approx(420.0)


SPEC = FlightSpec(Path("espaaro"), Path("loiter"), duration_s=4.0, wind_mps=3.0, turbulence="light")


def signals(result: FlightResult) -> bytes:
    return result.signals["alpha_rad"].tobytes()


def test_engines_by_name():
    single, moved = fly(SPEC), fly_one_ulp_off(SPEC)
    assert signals(single) != signals(moved)
    for name, expected in (
        (processes.JSBSIM, single),
        (processes.JUDGE, single),
        (processes.ONE_ULP_OFF, moved),
    ):
        (result,) = processes.fly_group(name, [SPEC])
        assert signals(result) == signals(expected)
        assert expected.metrics.items() <= result.metrics.items()


def test_the_judge_reports_the_distance_to_each_radius():
    (result,) = processes.fly_group(
        processes.JUDGE, [replace(SPEC, excursion_radius_m=(1.0,), rearm_m=0.25)]
    )
    distance = np.abs(result.signals["cross_track"])
    expected = min(np.abs(distance - 1.0).min(), np.abs(distance - 0.75).min())
    assert result.metrics["nearest_excursions_1m"] == expected
    reduced = replace(fakes.steady(SPEC), signals={})
    assert np.isnan(processes.with_distances(reduced, SPEC).metrics["nearest_excursions_15m"])
