"""Executors: every case comes back once, whatever it does to its worker."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import random
import threading
import time
from pathlib import Path

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import ProcessExecutor, SerialExecutor, default_timeout_s
from uqharness.campaign.worker import Group, OneByOne
from uqharness.errors import BadInputError
from uqharness.flight.spec import FlightSpec

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


def fly(executor, function, cases):
    outcomes = [outcome for batch in executor.run(function, cases) for outcome in batch]
    assert sorted(outcome.case_id for outcome in outcomes) == sorted(
        case_id for case_id, _ in cases
    )
    return {outcome.case_id: outcome for outcome in outcomes}


def test_serial_and_processes_agree():
    cases = flights(30)
    before = multiprocessing.active_children()
    serial = fly(SerialExecutor(), fakes.steady, cases)
    assert fly(ProcessExecutor(1, "fork"), fakes.steady, cases) == serial
    assert fly(ProcessExecutor(3, "fork"), fakes.steady, cases) == serial
    assert fly(ProcessExecutor(2, "spawn"), fakes.steady, cases) == serial
    assert multiprocessing.active_children() == before


def test_crashes_are_counted_with_their_reason():
    found = fly(ProcessExecutor(2, "fork"), fakes.hazardous, flights(20))
    kinds = {
        index: (found[f"{index:04d}"].status, found[f"{index:04d}"].reason) for index in range(10)
    }
    # level_sum is 3 for a flight without levels, and 3 * 7 + seed decides: see campaign_fakes.
    assert kinds[9] == ("crashed", "the worker process ended: signal 6 (SIGABRT) (tried 2 times)")
    assert kinds[0] == ("crashed", "the worker process ended: signal 11 (SIGSEGV) (tried 2 times)")
    assert kinds[1] == ("diverged", "the state was no longer finite at 90.0 s")
    assert kinds[2] == ("crashed", "RuntimeError: a flight that raises")
    assert kinds[3] == ("crashed", "the worker process ended: exit code 3 (tried 2 times)")
    assert [kinds[index][0] for index in range(4, 9)] == ["ok"] * 5


def test_a_hang_is_a_timeout_and_holds_nobody_up():
    executor = ProcessExecutor(2, "fork", timeout_s=lambda flight: 0.5)
    started = time.monotonic()
    found = fly(executor, fakes.hangs_sometimes, flights(20))
    assert {case_id for case_id, outcome in found.items() if outcome.status == "timeout"} == {
        "0009",
        "0019",
    }
    assert found["0009"].reason == "no result after 0.5 s (tried 2 times)"
    assert time.monotonic() - started < 20


def test_workers_killed_from_outside_cost_no_case():
    done = threading.Event()
    kills = []

    def murder():
        chance = random.Random(3)
        while not done.wait(0.15) and len(kills) < 8:
            children = multiprocessing.active_children()
            if children:
                victim = chance.choice(children)
                if victim.pid:
                    os.kill(victim.pid, 9)
                    kills.append(victim.pid)

    cases = flights(150)
    reference = fly(SerialExecutor(), fakes.steady, cases)
    thread = threading.Thread(target=murder)
    thread.start()
    try:
        found = fly(ProcessExecutor(2, "fork"), fakes.slow, cases)
    finally:
        done.set()
        thread.join()
    assert len(kills) >= 3
    assert found == reference


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
    reference = fly(SerialExecutor(), fakes.steady, cases)
    for executor, size in (
        (SerialExecutor(), 7),
        (ProcessExecutor(2, "fork"), 16),
        (ProcessExecutor(2, "spawn"), 50),
    ):
        assert fly_groups(executor, OneByOne(fakes.steady), cases, size) == reference


def test_a_group_that_ends_its_process_is_flown_in_parts_until_the_guilty_are_alone():
    # Of twenty flights, eight do something dreadful; all the others come back.
    cases = flights(20)
    alone = fly(ProcessExecutor(2, "fork"), fakes.hazardous, cases)
    assert fly_groups(ProcessExecutor(2, "fork"), OneByOne(fakes.hazardous), cases, 10) == alone
    assert {outcome.status for outcome in alone.values()} == {"ok", "crashed", "diverged"}


def test_a_group_that_hangs_is_flown_in_parts_too():
    executor = ProcessExecutor(2, "fork", timeout_s=lambda flight: 0.5)
    found = fly_groups(executor, OneByOne(fakes.hangs_sometimes), flights(12), 12)
    assert {case_id for case_id, outcome in found.items() if outcome.status != "ok"} == {"0009"}
    assert found["0009"].reason == "no result after 0.5 s (tried 2 times)"


def too_few(engine, flights):
    return [fakes.steady(flight) for flight in flights[1:]]


def test_a_group_function_that_loses_a_flight_is_no_result():
    found = fly_groups(SerialExecutor(), too_few, flights(3), 3)
    assert {outcome.status for outcome in found.values()} == {"crashed"}


def test_parts_are_even_and_in_order():
    (group,) = groups(flights(10), 10)
    assert [len(part.cases) for part in group.parts(4)] == [3, 3, 3, 1]
    assert [case for part in group.parts(4) for case in part.cases] == list(group.cases)
    assert [len(part.cases) for part in Group("batch", group.cases[:3]).parts(4)] == [1, 1, 1]


def test_bad_input_is_marked():
    found = fly(ProcessExecutor(1, "fork"), fakes.refuses, flights(1))["0000"]
    assert found.bad_input
    assert "uq/active" in found.reason


def test_batches_come_often_and_stopping_leaves_no_process():
    batches = ProcessExecutor(2, "fork").run(fakes.slow, flights(2000))
    times = []
    for _ in batches:
        times.append(time.monotonic())
        if len(times) == 4:
            break
    batches.close()
    assert max(later - before for before, later in itertools.pairwise(times)) < 1.0
    assert not multiprocessing.active_children()


def test_children_have_one_numerical_thread_each(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    found = fly(ProcessExecutor(1, "spawn"), fakes.reports_threads, flights(1))["0000"]
    assert found.metrics == {"omp": 1.0, "openblas": 1.0}
    assert os.environ["OMP_NUM_THREADS"] == "8"


def test_workers_that_cannot_start_are_an_error():
    with pytest.raises(BadInputError, match="before they start"):
        fly(ProcessExecutor(1, "spawn"), fakes.NotThere(), flights(1))


def test_impossible_settings():
    with pytest.raises(BadInputError, match="workers = 0"):
        ProcessExecutor(0)
    with pytest.raises(BadInputError, match="start method 'thread'"):
        ProcessExecutor(1, "thread")
    assert default_timeout_s(FlightSpec(Path("a"), Path("b"), 3600.0)) == pytest.approx(420.0)
