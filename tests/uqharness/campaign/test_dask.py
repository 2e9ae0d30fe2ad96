"""A campaign on a Dask cluster: the bytes of a local run, orders and answers as plain text, refusals."""

from __future__ import annotations

import json
import math
import socket
import struct
import sys
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign import dask as dask_executor
from uqharness.campaign.dask import (
    MODULES_VARIABLE,
    OWN_FLIGHT,
    Answer,
    DaskExecutor,
    Order,
    answer_from,
    answer_text,
    flight_function,
    fly_order,
    order_from,
    order_text,
)
from uqharness.campaign.processes import (
    CaseOutcome,
    Group,
    ProcessExecutor,
    SerialExecutor,
)
from uqharness.campaign.run import run_campaign
from uqharness.campaign.tables import CASES
from uqharness.cli.main import run_words
from uqharness.errors import BadInputError
from uqharness.flight.spec import FlightSpec, LevelDriver, TransientDriver

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)

TABLES = (CASES, "pbox.parquet", "excursions.csv")


@pytest.fixture(scope="module")
def cluster():
    with fakes.dask_cluster(processes=False) as result:
        yield result


@pytest.fixture
def dask(cluster):
    with DaskExecutor(cluster.scheduler_address) as executor:
        yield executor


@pytest.fixture(autouse=True)
def _validate_quickly(monkeypatch):
    import uqharness.campaign.run as campaign

    monkeypatch.setattr(
        campaign,
        "ProcessExecutor",
        lambda workers, **keys: ProcessExecutor(workers, "fork", **keys),
    )


def tables(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


def flights(folder, numbers):
    fakes.campaign_file(folder)
    return [
        (
            f"{index:04d}",
            FlightSpec(folder / "plane", folder / "loiter.xml", 150.0, seed_turbulence=index),
        )
        for index in numbers
    ]


def fly(executor, function, cases):
    outcomes = [outcome for batch in executor.run(function, cases) for outcome in batch]
    assert len(outcomes) == len(cases)
    return {outcome.case_id: outcome for outcome in outcomes}


def test_tables_equal_those_of_a_local_run(tmp_path, dask):
    spec = fakes.small_spec(tmp_path, 1)
    run_campaign(spec, tmp_path / "local", executor=SerialExecutor(), fly=fakes.hazardous_but_alive)
    summary = run_campaign(spec, tmp_path / "dask", executor=dask, fly=fakes.hazardous_but_alive)
    assert tables(tmp_path / "dask") == tables(tmp_path / "local")
    assert summary.progress.workers == 2
    assert summary.failed > 0


def test_a_case_that_ends_its_interpreter_is_counted(tmp_path, dask):
    cases = flights(tmp_path, [9, 1, 2, 4])
    result = fly(dask, fakes.hazardous, cases)
    assert result["0009"].reason == "the worker process ended: signal 6 (SIGABRT) (tried 2 times)"
    assert [result[f"{index:04d}"].status for index in (9, 1, 2, 4)] == [
        "crashed",
        "diverged",
        "crashed",
        "ok",
    ]
    assert result == fly(ProcessExecutor(1, "fork"), fakes.hazardous, cases)


@pytest.mark.slow
def test_a_case_that_takes_dask_workers_with_it_is_counted_and_no_other(tmp_path):
    import dask

    cases = flights(tmp_path, range(5, 13))
    # Dask would bring the case to four workers each time; one will do.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        fakes.dask_cluster(1) as cluster,
        DaskExecutor(cluster.scheduler_address) as executor,
    ):
        result = fly(executor, fakes.kills_its_parent, cases)
    guilty = result.pop("0009")
    assert (guilty.status, guilty.reason) == ("crashed", "every Dask worker that flew it was lost")
    assert result == fly(
        SerialExecutor(), fakes.steady, [case for case in cases if case[0] != "0009"]
    )


@pytest.mark.slow
def test_a_lost_scheduler_keeps_the_finished_flights(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_executor, "_LOST_S", 1.0)
    with fakes.dask_cluster(1) as cluster:
        executor = DaskExecutor(cluster.scheduler_address)
        batches = executor.run(fakes.slow, flights(tmp_path, range(2000)))
        assert next(batch for batch in batches if batch)
        cluster.close()
        with pytest.raises(
            BadInputError,
            match=r"scheduler at tcp://.* was lost; everything counted so far is kept",
        ):
            list(batches)
        executor.close()


def test_a_worker_with_other_files_or_versions_is_refused_by_name(tmp_path):
    (case,) = flights(tmp_path, [4])
    content = dask_executor.content_of(case[1].aircraft, case[1].script)
    reference = dask_executor.binding_versions()

    def answer(versions=reference):
        order = Order(OWN_FLIGHT, False, Group("jsbsim", (case,)), content, versions)
        return fly_order(order_text(order))

    (tmp_path / "plane" / "more.xml").write_text("<a/>")
    assert "Dask worker on " in answer()
    assert "plane has other content here" in answer()
    (tmp_path / "loiter.xml").unlink()
    assert "loiter.xml is not here" in answer()
    assert "jsbsim 0.9 there, 1.3.3 here" in answer((("jsbsim", "0.9"),))


def test_missing_dask_or_scheduler_is_refused(tmp_path, monkeypatch):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{unused.getsockname()[1]}"
    for place in (address, "nonsense"):
        with pytest.raises(BadInputError, match=f"--dask {place}: no Dask scheduler answers there"):
            DaskExecutor(place, connect_s=0.5)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInputError, match=r"pip install 'uqharness\[dask\]'"):
        DaskExecutor(address)


@pytest.mark.slow
def test_the_command_flies_on_the_cluster(tmp_path, cluster, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    words = ["campaign", "run", str(fakes.campaign_file(tmp_path)), "--out", str(tmp_path / "out")]
    assert run_words([*words, "--dask", cluster.scheduler_address]) == 0
    assert "192 flights done, none failed" in capsys.readouterr().out
    with pytest.raises(BadInputError, match="omit --workers"):
        run_words([*words, "--dask", cluster.scheduler_address, "--workers", "3"])


FLIGHT = FlightSpec(
    Path("/a/plane é"),
    Path("/b/loiter.xml"),
    0.1 + 0.2,
    burn_in_s=5e-324,
    turbulence="moderate",
    sensor_noise=True,
    seed_turbulence=2**70,
    properties={"uq/CX/level": 1 / 3, "x": -0.0, "low": -math.inf},
    excursion_radius_m=(15.0, 1e300),
    levels=LevelDriver("walk", 7, "e1", ("CX", "Cn"), (0.1, 2.5)),
    transient=TransientDriver(7, 3, ("CX", "Cm"), (0.9, 1 / 3)),
)


ORDER = Order(
    OWN_FLIGHT,
    False,
    Group("jsbsim", (("0001", FLIGHT),)),
    ("a" * 64, "b" * 64),
    (("jsbsim", "1.3.3"),),
)


OUTCOME = CaseOutcome("0001", "ok", "", 3.5, {"a": 1 / 3, "b": math.inf}, {"c": "why"})


def order_of(flight, **changes):
    return replace(ORDER, group=Group("batch", (("0001", flight),)), **changes)


def test_orders_survive_a_round_trip():
    back = order_from(order_text(ORDER))
    assert back == ORDER
    assert str(back.group.cases[0][1].properties["x"]) == "-0.0"
    cases = (("0001", FLIGHT), ("0002", replace(FLIGHT, seed_noise=5)))
    several = replace(ORDER, group=Group("batch", cases), together=True)
    assert order_from(order_text(several)) == several != ORDER
    steady = replace(FLIGHT, levels=None)
    numpy_values = MappingProxyType({"x": np.float64(1 / 3)})
    odd = order_of(replace(steady, properties=numpy_values, seed_noise=np.int64(3)))
    plain = order_of(replace(steady, properties={"x": 1 / 3}, seed_noise=3))
    assert order_from(order_text(odd)) == plain
    with pytest.raises(BadInputError, match="no UTF-8 cannot be sent"):
        order_text(order_of(replace(FLIGHT, aircraft=Path("/a\udc80"))))


def bits(value):
    return struct.pack("<d", value)


@settings(max_examples=100, deadline=None)
@given(st.floats(allow_nan=False))
def test_every_number_comes_back_bit_for_bit(value):
    back = order_from(order_text(order_of(replace(FLIGHT, properties={"x": value}))))
    assert bits(back.group.cases[0][1].properties["x"]) == bits(value)
    answer = answer_text(Answer((replace(OUTCOME, metrics={"x": value}),)))
    (outcome,) = answer_from(answer, ("0001",))
    assert bits(outcome.metrics["x"]) == bits(value)


TEXT = order_text(ORDER)


MALFORMED = [
    *("", "null", "[]", "{}", "{", "[" * 100_000, '{"case_id": "1"}', TEXT[:-1]),
    TEXT.replace('"/b/loiter.xml"', "5"),
    TEXT.replace('"walk"', '"jump"'),
    TEXT.replace("5e-324", "null"),
    TEXT.replace("true", '"yes"'),
    TEXT.replace('"1.3.3"]', '"1.3.3", "x"]'),
    *(b"\x80\x05.", None, 5, ORDER),
]


@pytest.mark.parametrize("text", MALFORMED, ids=range(len(MALFORMED)))
def test_a_malformed_order_is_refused(text):
    message = "malformed order on the Dask cluster"
    with pytest.raises(BadInputError, match=message) as error:
        order_from(text)
    assert "\n" not in str(error.value)
    with pytest.raises(BadInputError, match=rf"Dask worker on .*: {message}"):
        answer_from(fly_order(text), ("0001",))


OTHER_CONTENT = answer_text(Answer(None, "other content here"))
ANSWER = answer_text(Answer((OUTCOME,)))


@pytest.mark.parametrize(
    ("text", "cases", "message"),
    [
        (ANSWER, ("0002",), "returned case '0001'"),
        (ANSWER, ("0001", "0002"), "returned 1 flights; requested were 2"),
        (ANSWER[:-1], ("0001",), "malformed answer"),
        (ANSWER.replace('"ok"', "3"), ("0001",), "malformed answer"),
        ('{"outcomes": [[]]}', ("0001",), "malformed answer"),
        ('{"outcomes": {}}', ("0001",), "malformed answer"),
        (b"\x80\x05K\x01.", ("0001",), "malformed answer"),
        (ANSWER.replace('"ok"', '"fine"'), ("0001",), "status 'fine'"),
        (OTHER_CONTENT, ("0001",), "other content here"),
    ],
)
def test_an_answer_must_be_that_of_its_order(text, cases, message):
    assert answer_from(ANSWER, ("0001",)) == [OUTCOME]
    with pytest.raises(BadInputError, match=message):
        answer_from(text, cases)


def test_a_worker_imports_listed_modules_only(tmp_path, monkeypatch):
    (tmp_path / "harm.py").write_text("open('ran', 'w').close()\ndef fly(spec): pass\nnumber = 1\n")
    (tmp_path / "broken.py").write_text("raise ImportError('no such library')\n")
    monkeypatch.delenv(MODULES_VARIABLE, raising=False)  # the cluster of other tests sets it
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    fakes_steady, local = "tests.helpers.campaign_fakes:steady", "uqharness.flight.fly:Path"
    for name in ("harm:fly", "os:system", fakes_steady, ":", "", local):
        with pytest.raises(BadInputError, match=r"accepts uqharness\.flight\.fly:fly only"):
            flight_function(name)
        answer = fly_order(order_text(replace(ORDER, fly=name)))
        assert "accepts uqharness.flight.fly:fly only" in json.loads(answer)["refused"]
    assert not (tmp_path / "ran").exists()
    monkeypatch.setenv(MODULES_VARIABLE, "tests.helpers.campaign_fakes, harm,broken,absent")
    assert flight_function(fakes_steady) is fakes.steady
    assert flight_function("harm:fly") is sys.modules["harm"].fly
    assert (tmp_path / "ran").exists()
    for name in ("harm:number", "harm:nothing", "harm:fly.__globals__", "harm"):
        with pytest.raises(BadInputError, match="there is no flight function"):
            flight_function(name)
    with pytest.raises(BadInputError, match="cannot be imported: no such library"):
        flight_function("broken:fly")
    with pytest.raises(BadInputError, match="cannot be imported: No module"):
        flight_function("absent:fly")
    del sys.modules["harm"]


def test_an_order_outside_a_campaigns_limits_is_refused(monkeypatch):
    ((case_id, item),) = ORDER.group.cases
    case = (case_id, item)

    def one(**changes):
        return replace(ORDER.group, cases=((case_id, replace(item, **changes)),))

    def with_second(**changes):
        return replace(ORDER.group, cases=(case, ("2", replace(item, **changes))))

    for group, reason in (
        (replace(ORDER.group, cases=(case, case)), "one case twice"),
        (replace(ORDER.group, cases=()), "no case in it"),
        (with_second(script=Path("/etc/passwd")), "several aircraft"),
        (with_second(aircraft=Path("/etc")), "several aircraft"),
        (one(duration_s=1e300), "duration_s 1e+300; allowed"),
        (one(duration_s=math.inf), "duration_s inf; allowed"),
        (one(burn_in_s=math.nan), "burn_in_s nan; allowed"),
        (one(record_rate_hz=1e12), "record_rate_hz 1e+12; allowed"),
        (replace(ORDER.group, engine="warp"), "engine 'warp'; allowed are batch and jsbsim"),
        # What a campaign sends comes as far as its files, which are not on this machine.
        (ORDER.group, "is not here"),
    ):
        answer = json.loads(fly_order(order_text(replace(ORDER, group=group))))
        assert answer["outcomes"] is None
        assert reason in answer["refused"]
    assert "jsbsim unknown there" in fly_order(order_text(replace(ORDER, versions=())))
