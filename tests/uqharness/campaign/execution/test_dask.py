"""A campaign on a Dask cluster: the bytes of a local run, every failure counted, and words where it
cannot be.
"""

from __future__ import annotations

import socket
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign import dask as dask_executor
from uqharness.campaign.dask import OWN_FLIGHT, DaskExecutor, Order, order_text
from uqharness.campaign.processes import ProcessExecutor, SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.tables import CASES
from uqharness.campaign.worker import Group, OneByOne
from uqharness.cli.main import run_words
from uqharness.errors import BadInputError
from uqharness.flight.spec import FlightSpec
from uqharness.parquet_files import read_table

TABLES = (CASES, "pbox.parquet", "excursions.csv")
REAL = """
[campaign]
aircraft = "espaaro"
mission = "loiter"
seed = 7

[aleatory]
flights = 3
duration_s = 2
wind_mps = 3
turbulence = "moderate"
sensor_noise = true

[epistemic]
method = "walk"
samples = 2
bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }
"""


@pytest.fixture(scope="module")
def cluster():
    with fakes.dask_cluster(processes=False) as found:
        yield found


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


pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
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


def test_dask_moves_no_byte(tmp_path, dask):
    spec = fakes.small_spec(tmp_path, 2)
    run_campaign(spec, tmp_path / "local", executor=SerialExecutor(), fly=fakes.hazardous_but_alive)
    summary = run_campaign(spec, tmp_path / "dask", executor=dask, fly=fakes.hazardous_but_alive)
    assert tables(tmp_path / "dask") == tables(tmp_path / "local")
    assert summary.progress.workers == 2
    assert summary.failed > 0
    run_campaign(spec, tmp_path / "other", executor=dask, fly=fakes.trivial)
    assert tables(tmp_path / "other") != tables(tmp_path / "local")


@pytest.mark.slow
def test_real_flights_on_dask_move_no_byte(tmp_path, dask):
    (tmp_path / "campaign.toml").write_text(REAL)
    spec = read_campaign(tmp_path / "campaign.toml")
    run_campaign(spec, tmp_path / "dask", executor=dask)
    run_campaign(spec, tmp_path / "local", executor=SerialExecutor())
    assert tables(tmp_path / "dask") == tables(tmp_path / "local")
    table = read_table(tmp_path / "dask" / CASES)
    assert table["status"].to_pylist() == ["ok"] * 6
    assert len(set(table["cross_track_max_m"].to_pylist())) == 6


def test_a_case_that_ends_its_interpreter_is_counted_as_at_home(tmp_path, dask):
    cases = flights(tmp_path, [9, 1, 2, 4])
    found = fly(dask, fakes.hazardous, cases)
    assert found["0009"].reason == "the worker process ended: signal 6 (SIGABRT) (tried 2 times)"
    assert [found[f"{index:04d}"].status for index in (9, 1, 2, 4)] == [
        "crashed",
        "diverged",
        "crashed",
        "ok",
    ]
    assert found == fly(ProcessExecutor(1, "fork"), fakes.hazardous, cases)


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
        found = fly(executor, fakes.kills_its_parent, cases)
    guilty = found.pop("0009")
    assert (guilty.status, guilty.reason) == ("crashed", "every Dask worker that flew it was lost")
    assert found == fly(
        SerialExecutor(), fakes.steady, [case for case in cases if case[0] != "0009"]
    )


@pytest.mark.slow
def test_a_lost_scheduler_is_a_sentence_and_keeps_what_was_done(tmp_path, monkeypatch):
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
    versions = dask_executor.binding_versions()

    def answer(content, versions):
        order = Order(OWN_FLIGHT, False, Group("jsbsim", (case,)), content, versions)
        return dask_executor.fly_order(order_text(order))

    (tmp_path / "plane" / "more.xml").write_text("<a/>")
    said = answer(content, versions)
    assert "Dask worker on " in said
    assert "plane has other content here" in said
    (tmp_path / "loiter.xml").unlink()
    assert "loiter.xml is not here" in answer(content, versions)
    assert "jsbsim 0.9 there, 1.3.3 here" in answer(content, (("jsbsim", "0.9"),))


def test_a_worker_flies_with_no_function_that_its_operator_did_not_name(tmp_path, dask):
    from tests.helpers import torture

    with pytest.raises(
        BadInputError,
        match=(
            r"Dask worker on .*flies with uqharness.flight.fly:fly"
            r" alone.*MODULES=tests.helpers.torture"
        ),
    ):
        fly(dask, torture.tear, flights(tmp_path, [4]))
    with pytest.raises(BadInputError, match="flies with a function that its module holds by name"):
        fly(dask, fakes.NotThere(), flights(tmp_path, [4]))


@dataclass(frozen=True)
class Said:
    """A worker that gives this answer."""

    answer: object

    def __call__(self, order: str) -> object:
        return self.answer


@pytest.mark.slow
def test_groups_fly_together_and_a_guilty_case_is_left_alone(tmp_path, dask):
    cases = flights(tmp_path, list(range(4, 24)))
    alone = fly(dask, fakes.hazardous, cases)
    together = [Group("jsbsim", tuple(cases[first : first + 10])) for first in (0, 10)]
    found = {
        o.case_id: o
        for batch in dask.run_groups(OneByOne(fakes.hazardous), together)
        for o in batch
    }
    assert found == alone


def test_a_worker_without_the_batch_engine_refuses_its_cases(monkeypatch):
    monkeypatch.setattr(
        dask_executor,
        "unavailable_reason",
        lambda engine: f"llvmlite is not installed for {engine}",
    )
    group = Group("batch", (("0001", FlightSpec(Path("nowhere"), Path("nothing"), 1.0)),))
    content = (dask_executor.ABSENT, dask_executor.ABSENT)
    monkeypatch.setattr(dask_executor, "_refuse_other_versions", lambda *given: None)
    said = dask_executor.fly_order(order_text(Order(OWN_FLIGHT, False, group, content, ())))
    assert "the campaign flies in the batch engine, and llvmlite is not installed for batch" in said


def test_an_answer_that_is_none_is_a_sentence(tmp_path, dask, monkeypatch):
    other = '{"outcomes": [{"case_id": "0005", "status": "ok", "reason": "", "flown_s": 1.0}]}'
    for answer, said in (
        ("no json", "malformed answer on the Dask cluster"),
        (b"\x80\x05K\x01.", "malformed answer on the Dask cluster"),
        (17, "malformed answer on the Dask cluster"),
        ('{"outcomes": null}', "neither an outcome nor a reason"),
        ('{"outcomes": []}', "answered with 0 flights; asked for were 1"),
        (other, "answered for case '0005'"),
        (other.replace("0005", "0004").replace('"ok"', '"fine"'), "with the status 'fine'"),
    ):
        monkeypatch.setattr(dask_executor, "fly_order", Said(answer))
        with pytest.raises(BadInputError, match=said):
            fly(dask, fakes.steady, flights(tmp_path, [4]))
    monkeypatch.setattr(dask_executor, "fly_order", Said(other.replace("0005", "0004")))
    assert fly(dask, fakes.steady, flights(tmp_path, [4]))["0004"].status == "ok"


def test_no_dask_and_no_scheduler_are_sentences(tmp_path, monkeypatch):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{unused.getsockname()[1]}"
    with pytest.raises(BadInputError, match=f"--dask {address}: no Dask scheduler answers there"):
        DaskExecutor(address, connect_s=0.5)
    with pytest.raises(BadInputError, match="--dask nonsense: no Dask scheduler answers there"):
        DaskExecutor("nonsense", connect_s=0.5)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInputError, match=r"pip install 'uqharness\[dask\]'"):
        DaskExecutor(address)


@pytest.mark.slow
def test_the_command_flies_on_the_cluster(tmp_path, cluster, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    words = ["campaign", "run", str(fakes.campaign_file(tmp_path)), "--out", str(tmp_path / "out")]
    assert run_words([*words, "--dask", cluster.scheduler_address]) == 0
    assert "192 flights done, none failed" in capsys.readouterr().out
    with pytest.raises(BadInputError, match="leave out --workers"):
        run_words([*words, "--dask", cluster.scheduler_address, "--workers", "3"])


def test_relative_paths_are_found_from_another_folder(tmp_path, dask, monkeypatch):
    ((case_id, flight),) = flights(tmp_path, [4])
    monkeypatch.chdir(tmp_path)
    here = replace(flight, aircraft=Path("plane"), script=Path("loiter.xml"))
    assert fly(dask, fakes.steady, [(case_id, here)])[case_id].status == "ok"
