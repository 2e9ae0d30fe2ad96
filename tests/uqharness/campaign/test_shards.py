"""Shards that merge into the bytes of one run, status and answers of a folder, cases flown again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from lxml import etree

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.manifest import MANIFEST, DamageError, read_manifest, write_manifest
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.rerun import rerun_case
from uqharness.campaign.run import run_campaign
from uqharness.campaign.shards import (
    Shard,
    merge,
    parse_shard,
    read_answers,
    read_status,
    shard_folders,
)
from uqharness.campaign.store import JOURNAL, Store, run_lock
from uqharness.campaign.tables import CASES
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.report.write import write_report
from uqharness.simulator.aircraft import PROJECT_ROOT
from uqharness.study.spec import read_chain

pytestmark = pytest.mark.usefixtures("flights_here")

TABLES = (CASES, "pbox.parquet", "excursions.csv")


@pytest.fixture(autouse=True)
def _no_check_flight(monkeypatch):
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)


def run(tmp_path, out, shard=None, fly=fakes.hazardous_but_alive, flights=2):
    spec = fakes.small_spec(tmp_path, flights)
    return run_campaign(spec, tmp_path / out, executor=SerialExecutor(), fly=fly, shard=shard)


def tables(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_merged_shards_are_the_bytes_of_one_run(tmp_path, count):
    run(tmp_path, "whole", flights=1)
    for number in reversed(range(1, count + 1)):
        summary = run(tmp_path, "parts", Shard(number, count), flights=1)
        assert abs(summary.cases - 64 / count) < 1
    assert not (tmp_path / "parts" / CASES).exists()
    merged = merge(tmp_path / "parts")
    assert (merged.cases, merged.missing) == (64, 0)
    assert tables(tmp_path / "parts") == tables(tmp_path / "whole")
    assert read_manifest(tmp_path / "parts")["state"] == "complete"
    write_report(tmp_path / "parts")
    # Merging again changes nothing, and the folder is now a campaign that is done.
    assert merge(tmp_path / "parts").missing == 0
    assert tables(tmp_path / "parts") == tables(tmp_path / "whole")
    assert run(tmp_path, "parts", fly=fakes.aborts_always, flights=1).done_before == 64


@pytest.fixture
def requests(tmp_path, capsys):
    """Exit code and document of a command about the folder "out"."""

    def call(verb):
        code = main(["campaign", verb, str(tmp_path / "out"), "--json"])
        return code, json.loads(capsys.readouterr().out)

    return call


def test_status_adds_the_shards_up(tmp_path, requests):
    run(tmp_path, "out", Shard(1, 2), fakes.steady, 1)
    assert requests("status")[1]["done"] == 32
    run(tmp_path, "out", Shard(2, 2), fakes.steady, 1)
    part = shard_folders(tmp_path / "out")[0]
    write_manifest(part, read_manifest(part) | {"state": "running"})
    code, result = requests("status")
    assert (code, result["state"], result["cases"], result["done"]) == (1, "interrupted", 64, 64)


def test_a_missing_shard_is_missing_flights_until_it_is_there(tmp_path, requests):
    fakes.campaign_file(tmp_path)
    run(tmp_path, "out", Shard(1, 3), fakes.steady, 1)
    run(tmp_path, "out", Shard(3, 3), fakes.steady, 1)
    code, result = requests("merge")
    assert (code, result["cases"], result["missing"]) == (1, 64, 21)
    assert result["shards"] == ["1-of-3", "3-of-3"]
    assert not (tmp_path / "out" / CASES).exists()
    with pytest.raises(BadInputError, match="not complete"):
        write_report(tmp_path / "out")
    run(tmp_path, "out", Shard(2, 3), fakes.steady, 1)
    assert requests("merge")[0] == 0
    run(tmp_path, "whole", fly=fakes.steady, flights=1)
    assert tables(tmp_path / "out") == tables(tmp_path / "whole")


def test_shards_of_different_campaigns_or_in_use_or_spoilt_are_not_merged(tmp_path):
    run(tmp_path, "out", Shard(1, 2), flights=1)
    part = shard_folders(tmp_path / "out")[0]
    with run_lock(part), pytest.raises(BadInputError, match="another run is using"):
        merge(tmp_path / "out")
    run(tmp_path, "out", Shard(2, 2), flights=2)
    with pytest.raises(BadInputError, match=r"\[aleatory\] flights was 2, is 1"):
        merge(tmp_path / "out")
    write_manifest(part, read_manifest(part) | {"state": "spoilt"})
    with pytest.raises(BadInputError, match="run this shard again"):
        merge(tmp_path / "out")
    with pytest.raises(BadInputError, match="has no shards"):
        merge(tmp_path)


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2"])
def test_bad_shard_numbers(text):
    with pytest.raises(BadInputError, match="1 <= i <= n"):
        parse_shard(text)


CAMPAIGN = """
[campaign]
aircraft = "espaaro"
mission = "scripts/loiter.xml"
seed = 5

[aleatory]
flights = 1
duration_s = 6
burn_in_s = 2
wind_mps = 3
turbulence = "moderate"

[epistemic]
method = "walk"
samples = 2
walk_rate_per_sqrt_s = 0.2
coefficients = ["CX", "Cm"]

[aleatory.variables."inertia/mass-slugs"]
distribution = "normal"
mean = [1.4, 1.5]
std = 0.02
"""


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rerun")
    (folder / "campaign.toml").write_text(CAMPAIGN)
    run_campaign(read_campaign(folder / "campaign.toml"), folder / "out", executor=SerialExecutor())
    return folder / "out"


def test_a_case_comes_out_as_stored_with_full_output_and_a_plot(flight, capsys):
    row = read_table(flight / CASES).to_pandas().iloc[1]
    before = tables(flight)
    assert main(["campaign", "rerun", str(flight), "--case", row["case_id"][:10], "--json"]) == 0
    outcome = json.loads(capsys.readouterr().out)
    assert outcome["case_id"] == row["case_id"]
    assert (outcome["status"], outcome["same_as_stored"]) == ("ok", True)
    target = flight / "rerun" / row["case_id"]
    record = pd.read_parquet(target / "record.parquet")
    # Burn-in included, 50 Hz, everything that moves: the scored part gives the stored score.
    assert len(record) == 8 * 50 + 1
    columns = "V_mps elevator_deg error_cross_track level_CX delta_Cm upper_CX wind_down_mps"
    assert set(columns.split()) <= set(record)
    assert record["level_Cm"].nunique() > 300
    scored = record[record["scored"]]["error_cross_track"].abs()
    # The record is JSBSim's, whichever engine flew the case.
    assert scored.max() + 1e-6 >= row["cross_track_max_m"] > 0.99 * scored.max()
    result = json.loads((target / "result.json").read_text())
    assert result["metrics"]["altitude_median_m"] == row["altitude_median_m"]
    assert result["levels"]["epistemic_id"] == row["epistemic_id"]
    assert result["properties"]["inertia/mass-slugs"] == row["variable_inertia/mass-slugs"]
    assert etree.parse(str(target / "flight.svg")).getroot().tag.endswith("}svg")
    assert tables(flight) == before


def test_a_rerun_that_differs_is_reported(flight, capsys):
    row = read_table(flight / CASES).to_pandas().iloc[0]
    with Store(flight) as store:
        stored = store.outcome(row["case_id"])
        store.add([replace(stored, metrics=dict(stored.metrics) | {"altitude_max_m": 0.125})])
    assert main(["campaign", "rerun", str(flight), "--case", row["case_id"]]) == 1
    assert "NOT as stored" in (text := capsys.readouterr().out)
    assert "altitude_max_m 0.125 then" in text
    with Store(flight) as store:
        store.add([stored])


def test_unknown_and_foreign_cases_are_refused(flight, tmp_path):
    for folder, case, message in (
        (flight, "ffffffffffffffff", "no such case"),
        (flight, "", "no such case"),
        (tmp_path, "00", "not a campaign folder"),
    ):
        with pytest.raises(BadInputError, match=message):
            rerun_case(folder, case)
    manifest = read_manifest(flight)
    write_manifest(flight, manifest | {"hashes": manifest["hashes"] | {"aircraft": "0" * 64}})
    try:
        with pytest.raises(BadInputError, match="content of the aircraft"):
            rerun_case(flight, "00")
    finally:
        write_manifest(flight, manifest)


def test_the_committed_campaigns_are_valid_and_explained():
    paths = sorted((PROJECT_ROOT / "campaigns").glob("*/*.toml"))
    assert len(paths) >= 4
    for path in paths:
        if path.parent.name == "chain":
            assert read_chain(path).campaign_data["campaign"]
        else:
            assert read_campaign(path).aleatory.flights >= 1
        assert path.name in (path.parent / "README.md").read_text()


COMPLETE = {"format": 1, "state": "complete"}


HEAD = "condition,epistemic_id,radius_m,acceptable_per_h,answer,reason,hours,distance\n"


def test_answers_are_of_whole_cells_at_the_smallest_radius(tmp_path: Path):
    assert read_answers(tmp_path, COMPLETE) == []
    rows = "a,,25,2,yes,,1,horizontal\na,,15,2,no,,1,horizontal\na,,15,2,open,,1,3d\n"
    (tmp_path / "statements.csv").write_text(HEAD + rows)
    assert [(x.radius_m, x.answer) for x in read_answers(tmp_path, COMPLETE)] == [(15.0, "no")]
    (tmp_path / "statements.csv").write_text(HEAD + "a,,wide,2,yes,,1,horizontal\n")
    with pytest.raises(BadInputError, match=r"statements\.csv:2: radius_m is 'wide'"):
        read_answers(tmp_path, COMPLETE)
    rows = "3 m/s none,all,15,2,yes,,12.5,horizontal\n3 m/s none,000000,15,2,no,x,1,horizontal\n"
    (tmp_path / "decisions.csv").write_text(HEAD + rows)
    (answer,) = read_answers(tmp_path, COMPLETE)
    assert (answer.condition, answer.answer, answer.hours) == ("3 m/s none", "yes", 12.5)


def test_a_journal_with_missing_flights_is_damaged_and_that_of_an_old_folder_must_be_there(
    tmp_path,
):
    text = fakes.CAMPAIGN.replace('"corners"', '"walk"\nsamples = 2\nwalk_rate_per_sqrt_s = 0.01')
    spec, out = read_campaign(fakes.campaign_file(tmp_path, text)), tmp_path / "out"
    run_campaign(spec, out, executor=SerialExecutor(), fly=fakes.steady)
    manifest = {key: value for key, value in read_manifest(out).items() if key != "digest"}
    write_manifest(out, manifest | {"journal": manifest["journal"] | {"rows": 7}})
    with pytest.raises(DamageError, match="6 flights are in it, the manifest lists 7"):
        read_status(out)
    (out / MANIFEST).write_text(json.dumps(manifest | {"format": 1}))
    (out / JOURNAL).unlink()
    with pytest.raises(BadInputError, match=r"made by uqharness 0\.1"):
        read_status(out)
