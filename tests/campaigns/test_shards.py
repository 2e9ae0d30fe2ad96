"""Campaigns cut into shards: what is kept, what an interruption costs, and that damage and other
flights are seen.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from campaigns.library.command import Study, main
from campaigns.library.flying import fly
from campaigns.library.grid import FINE, METRICS, RESOLUTION, coded, decoded
from campaigns.library.plan import Plan
from campaigns.library.store import FLIGHTS, cell_table, is_intact, pack, records
from campaigns.library.tables import smoothed, write_cost
from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission
from uqharness.campaign.worker import JUDGE
from uqharness.errors import BadInputError, EnginesDifferError
from uqharness.flight.spec import FlightResult


@dataclass
class Engine:
    """Flights by their numbers; ``dies_at`` counts groups, ``jsbsim_off`` is added to JSBSim's
    cross-track median.
    """

    dies_at: int = -1
    jsbsim_off: float = 0.0
    flown: list[str] = field(default_factory=list)

    def __call__(self, engine, flights):
        if len(self.flown) == self.dies_at:
            raise KeyboardInterrupt
        self.flown.append(engine)
        results = [fakes.by_corner(flight) for flight in flights]
        if engine == JUDGE:
            name = "cross_track_median_m"
            results = [
                replace(r, metrics={**r.metrics, name: r.metrics[name] + self.jsbsim_off})
                for r in results
            ]
        return results


@pytest.fixture
def plan(tmp_path) -> Plan:
    text = fakes.CAMPAIGN.replace("flights = 3", "flights = 5").replace(
        "wind_mps = 3", "wind_mps = [3, 7]"
    )
    spec = read_campaign(fakes.campaign_file(tmp_path, text)).with_engine("batch")
    return Plan(spec, find_mission(spec), airs=2, lanes=128)


def flown(plan, folder, engine=None, shards=None):
    return fly(plan, folder, shards or plan.shards(), SerialExecutor(), engine or Engine())


@pytest.mark.parametrize("value", [1e-9, 0.1234, 1.0, 2.0, 17.3, 4e5])
def test_the_grid_keeps_a_value_within_its_resolution(value):
    (back,) = decoded(coded([value]).astype(float).filled(np.nan))
    assert abs(back / value - 1.0) <= RESOLUTION * (1.0 + 1e-12)


def test_the_grid_keeps_order_zero_and_what_is_not_defined():
    rising = coded(np.geomspace(1e-3, 1e3, 5000))
    assert np.all(np.diff(rising.astype(int)) >= 0)
    back = decoded(coded([0.0, np.nan, np.inf, 1.0]).astype(float).filled(np.nan))
    assert back[0] == 0.0
    assert np.isnan(back[1:3]).all()


@pytest.mark.parametrize("resolution", [RESOLUTION, FINE])
def test_curves_drawn_from_the_grid_are_exact_at_its_edges(resolution):
    values = np.random.default_rng(8).normal(3.0, 0.03, 400)
    kept = decoded(coded(values, resolution).astype(float).filled(np.nan), resolution)
    drawn = smoothed(kept, resolution)
    assert np.all(np.diff(drawn) > 0)
    np.testing.assert_allclose(np.sort(drawn), np.sort(values), rtol=2.0 * resolution)
    for edge in np.unique(kept) / (1.0 - resolution):
        assert np.mean(drawn <= edge) == np.mean(values <= edge)
    # Between the edges the steps of the grid are farther off.
    inside = np.unique(kept)
    off = [
        np.mean([abs(np.mean(found <= at) - np.mean(values <= at)) for at in inside])
        for found in (drawn, kept)
    ]
    assert off[0] < 0.5 * off[1]


def test_every_condition_has_hours_before_any_has_a_second_shard(plan):
    shards = list(plan.shards())
    assert [shard.file for shard in shards[:3]] == [
        "moderate-7/000.parquet",
        "moderate-3/000.parquet",
        "moderate-7/001.parquet",
    ]
    ids = [case.case_id for shard in shards for case in plan.cases(shard)]
    assert len(ids) == len(set(ids)) == 2 * 5 * 64


def test_tables_come_from_the_shards_alone_and_are_what_was_flown(plan, tmp_path):
    assert flown(plan, tmp_path / "shards") == 6
    condition = plan.condition("moderate-7")
    frame, used = cell_table(plan, tmp_path / "shards", condition)
    direct = [
        fakes.by_corner(case.flight)
        for shard in plan.only(["moderate-7"])
        for case in plan.cases(shard)
    ]
    assert frame["excursions_15m"].tolist() == [r.metrics["excursions_15m"] for r in direct]
    assert frame["excursions_15m"].sum() > 0
    for name in METRICS:
        np.testing.assert_allclose(frame[name], [r.metrics[name] for r in direct], rtol=RESOLUTION)
    assert [record.first_air for record in used] == [0, 2, 4]
    assert sum(record.hours for record in used) == pytest.approx(5 * 64 * 150 / 3600, abs=1e-4)
    write_cost(plan, tmp_path / "shards", tmp_path)
    assert "all,6,640," in (tmp_path / "cost.csv").read_text()


def test_an_interruption_costs_the_shard_in_the_air(plan, tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    flown(plan, whole)
    with pytest.raises(KeyboardInterrupt):
        flown(plan, cut, Engine(dies_at=8))
    left = sum(len(records(cut, condition)) for condition in plan.conditions)
    assert 0 < left < 6
    again = Engine()
    assert flown(plan, cut, again) == 6 - left
    for shard in plan.shards():
        assert (cut / shard.file).read_bytes() == (whole / shard.file).read_bytes()
        assert (
            records(cut, shard.condition)[shard.number].results
            == records(whole, shard.condition)[shard.number].results
        )
    assert flown(plan, cut) == 0


def test_a_damaged_shard_is_seen_and_flown_again(plan, tmp_path):
    flown(plan, tmp_path / "s")
    shard = next(plan.shards())
    path = tmp_path / "s" / shard.file
    good = path.read_bytes()
    path.write_bytes(good[:-7] + b"spoiled")
    assert not is_intact(tmp_path / "s", shard)
    with pytest.raises(BadInputError, match="fly it again"):
        cell_table(plan, tmp_path / "s", shard.condition)
    assert flown(plan, tmp_path / "s") == 1
    assert path.read_bytes() == good


def test_shards_of_other_flights_are_refused(plan, tmp_path):
    flown(plan, tmp_path / "s")
    section = plan.spec.campaign.model_copy(update={"seed": 8})
    other = replace(plan, spec=replace(plan.spec, campaign=section))
    with pytest.raises(BadInputError, match="another aircraft, script or campaign"):
        cell_table(other, tmp_path / "s", plan.conditions[0])


def test_a_shard_in_which_jsbsim_says_otherwise_is_not_kept(plan, tmp_path):
    with pytest.raises(EnginesDifferError, match="differs from JSBSim"):
        flown(plan, tmp_path / "s", Engine(jsbsim_off=1e-3))
    assert not any(records(tmp_path / "s", condition) for condition in plan.conditions)


def test_a_rerun_says_whether_a_cell_came_out_as_it_did(plan, tmp_path, monkeypatch, capsys):
    flown(plan, tmp_path / "shards")
    study = Study("study", "what?", lambda: plan, tmp_path, lambda plan, shards, out: ["made"])
    monkeypatch.setattr("campaigns.library.command.ProcessExecutor", lambda *a, **k: Serial())
    monkeypatch.setattr("campaigns.library.command.fly_group", Engine())
    assert main(study, ["rerun", "--cell", "moderate-7"]) == 0
    assert capsys.readouterr().out.count("same digest") == 3

    def other(engine, flights):
        return [
            FlightResult(
                r.status, r.reason, r.flown_s, {**r.metrics, "excursions_25m": 9.0}, {}, {}
            )
            for r in Engine()(engine, flights)
        ]

    monkeypatch.setattr("campaigns.library.command.fly_group", other)
    assert main(study, ["rerun", "--cell", "moderate-7", "--shard", "1"]) == 1
    assert "excursions_25m in 128" in capsys.readouterr().out
    assert main(study, ["rerun", "--cell", "severe-9"]) == 2


def test_so_many_shards_are_flown_at_most(plan, tmp_path, monkeypatch):
    study = Study("study", "what?", lambda: plan, tmp_path, lambda plan, shards, out: ["made"])
    monkeypatch.setattr("campaigns.library.command.ProcessExecutor", lambda *a, **k: Serial())
    monkeypatch.setattr("campaigns.library.command.fly_group", Engine())
    assert main(study, ["fly", "--most", "2"]) == 0
    assert sum(len(records(tmp_path / "shards", condition)) for condition in plan.conditions) == 2
    assert main(study, ["fly"]) == 0
    assert sum(len(records(tmp_path / "shards", condition)) for condition in plan.conditions) == 6
    assert main(study, ["fly", "--most", "0"]) == 2


class Serial(SerialExecutor):
    def close(self) -> None:
        """Nothing to end."""


def test_the_published_size_is_planned():
    from campaigns.excursions.full_size import plan as published

    found = published()
    shards = list(found.shards())
    assert len(shards) == 24 * 20
    assert sum(len(s.part.aleatory_ids) for s in shards) * 64 == 768_000
    assert Path(found.mission.aircraft).name == "espaaro"


def test_packed_flights_are_those_of_the_shards(plan, tmp_path, capsys):
    """One file in the place of the folder; a shard that is flown after it takes precedence, and
    damage is seen.
    """
    shards = tmp_path / "shards"
    flown(plan, shards, shards=list(plan.shards())[:4])
    before = [cell_table(plan, shards, condition) for condition in plan.conditions]
    path = pack(plan, shards)
    shutil.rmtree(shards)
    assert path == tmp_path / FLIGHTS
    for condition, (frame, used) in zip(plan.conditions, before, strict=True):
        again, index = cell_table(plan, shards, condition)
        pd.testing.assert_frame_equal(again, frame)
        assert index == used
    table = pd.read_parquet(path)
    assert table["epistemic_id"].tolist()[:64] == plan.epistemic_ids
    assert flown(plan, shards) == 2
    after = cell_table(plan, shards, plan.conditions[0])[0]
    study = Study("study", "what?", lambda: plan, tmp_path, lambda plan, shards, out: ["made"])
    assert main(study, ["pack"]) == 0
    assert capsys.readouterr().out == f"{path}\n"
    shutil.rmtree(shards)
    few = plan.with_flights(2)
    assert [record.shard for record in cell_table(few, shards, plan.conditions[0])[1]] == [0]
    pd.testing.assert_frame_equal(cell_table(plan, shards, plan.conditions[0])[0], after)
    content = bytearray(path.read_bytes())
    content[1000] ^= 255
    path.write_bytes(content)
    with pytest.raises(BadInputError, match="damaged"):
        [cell_table(plan, shards, condition) for condition in plan.conditions]
