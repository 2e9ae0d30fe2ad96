"""Which engine flies, and JSBSim as its judge: a difference of 1e-5 of the spread stops a campaign, one of 1e-8 does not."""

from __future__ import annotations

import dataclasses
import math
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.engine_fakes import Deadly, Flown, Understanding, engines
from tests.helpers.few import few
from uqharness.campaign.cases import Mission, build_cases
from uqharness.campaign.engines import (
    CASES_EACH,
    MIN_SCALE,
    Engines,
    PreviousEngine,
    choose_engine,
    compare_outcomes,
    compare_start,
    difference_scale,
    previous_engine,
)
from uqharness.campaign.manifest import read_manifest
from uqharness.campaign.processes import NEAREST, CaseOutcome, ProcessExecutor, SerialExecutor
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.shards import merge, parse_shard, read_status
from uqharness.campaign.tables import ENGINE_CHECK, FULL_FLIGHT, read_check
from uqharness.campaign.verify import RunOptions, salvage
from uqharness.errors import BadInputError, EnginesDifferError
from uqharness.flight import flight_seed
from uqharness.parquet_files import read_table

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)

ALIKE = engines(Flown())


WITHOUT = engines(Flown(), Understanding("llvmlite is not installed"))


PUZZLED = engines(Flown(), Understanding(None, ("plane.xml:7: <rocket_engine> is not supported",)))


@pytest.fixture
def spec(tmp_path):
    return fakes.small_spec(tmp_path, 1)


def settle(spec, inputs, previous=None):
    return choose_engine(spec, find_mission(spec), inputs, previous)


def run(spec, out, inputs=ALIKE, **keys):
    return run_campaign(spec, out, executor=SerialExecutor(), fly=inputs, **keys)


@pytest.mark.parametrize(
    ("requested", "flies", "words"),
    [
        ("auto", ALIKE, "batch, because it supports the complete aircraft and mission"),
        ("auto", PUZZLED, "jsbsim, because plane.xml:7: <rocket_engine> is not supported"),
        ("auto", WITHOUT, "jsbsim, because llvmlite is not installed"),
        ("auto", Engines.of(fakes.steady), "jsbsim, because a function"),
        ("jsbsim", ALIKE, "jsbsim, because it was requested"),
    ],
)
def test_auto_prefers_the_batch_engine(spec, requested, flies, words):
    assert settle(spec.with_engine(requested), flies).words.startswith(words)


@pytest.mark.parametrize(
    ("inputs", "output"),
    [(PUZZLED, "plane.xml:7: <rocket"), (WITHOUT, "llvmlite is not installed")],
)
def test_a_requested_engine_that_cannot_fly_is_refused(spec, inputs, output):
    with pytest.raises(
        BadInputError, match="was requested and does not support this campaign"
    ) as error:
        settle(spec.with_engine("batch"), inputs)
    assert output in str(error.value)


def test_auto_keeps_the_engine_of_earlier_flights(spec):
    jsbsim, batch = PreviousEngine("jsbsim", ("plane.xml:7: no",)), PreviousEngine("batch")
    assert settle(spec, ALIKE, jsbsim).words == "jsbsim, because plane.xml:7: no"
    assert settle(spec, PUZZLED, batch).words == "batch"
    requested = settle(spec.with_engine("jsbsim"), ALIKE, batch)
    assert requested.words == "jsbsim, because it was requested"
    with pytest.raises(BadInputError, match="uses the batch engine, and llvmlite is not installed"):
        settle(spec, WITHOUT, batch)


def test_a_defect_of_the_batch_engine_leaves_the_campaign_to_jsbsim(spec):
    class Broken(Understanding):
        def refusals(self, spec, varying):
            raise KeyError("slot")

    words = settle(spec, replace(ALIKE, batch=Broken())).words
    assert words == "jsbsim, because the batch engine failed at reading plane: KeyError: 'slot'"


def test_the_engine_is_part_of_every_case_id_and_old_ids_stay(spec):
    mission = Mission(spec.path, "a" * 64, spec.path, "b" * 64)
    old, listed, batch = (
        build_cases(spec.with_engine(name), mission) for name in ("auto", "jsbsim", "batch")
    )
    assert [case.case_id for case in old] == [case.case_id for case in listed]
    assert not {case.case_id for case in old} & {case.case_id for case in batch}
    assert {case.engine for case in batch} == {"batch"}


def test_manifest_table_and_status_give_the_engine_and_its_reason(spec, tmp_path):
    summary = run(spec, tmp_path / "out")
    assert (summary.engine, summary.statuses) == ("batch", {"ok": 64})
    manifest, reasons = read_manifest(tmp_path / "out"), list(settle(spec, ALIKE).reasons)
    assert manifest["campaign"]["campaign"]["engine"] == "batch"
    assert manifest["engine"] == {"asked": "auto", "why": reasons}
    assert set(read_table(tmp_path / "out" / "cases.parquet")["engine"].to_pylist()) == {"batch"}
    status = read_status(tmp_path / "out")
    assert (status.engine, status.engine_why) == ("batch", reasons)


def test_another_engine_is_refused_in_the_same_folder_and_auto_is_not(spec, tmp_path):
    out = tmp_path / "out"
    run(spec.with_engine("jsbsim"), out)
    with pytest.raises(BadInputError, match='engine was "jsbsim", is "batch"'):
        run(spec.with_engine("batch"), out)
    assert run(spec, out).done_before == 64


def test_shards_fly_in_one_engine(spec, tmp_path):
    out, valid = tmp_path / "out", tmp_path / "good"
    run(spec, out, shard=parse_shard("1/2"))
    assert previous_engine(out / "shards" / "2-of-2").engine == "batch"
    with pytest.raises(BadInputError, match="llvmlite is not installed"):
        run(spec, out, WITHOUT, shard=parse_shard("2/2"))
    shutil.copytree(out, valid)
    run(spec.with_engine("jsbsim"), out, shard=parse_shard("2/2"))
    with pytest.raises(BadInputError, match="engine was"):
        merge(out)
    run(spec, valid, shard=parse_shard("2/2"))
    assert merge(valid).missing == 0
    run(spec, tmp_path / "whole")
    name = "cases.parquet"
    assert (valid / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert (valid / "engine-check.csv").exists()


def test_a_lost_manifest_is_rebuilt_in_the_engine_whose_flights_are_there(spec, tmp_path):
    out = tmp_path / "out"
    run(spec.with_engine("batch"), out)
    before = (out / "cases.parquet").read_bytes()
    (out / "manifest.json").unlink()
    result = salvage(out, RunOptions(SerialExecutor(), fly=ALIKE), spec, "command")
    assert (result.kept, result.flown) == (64, 0)
    assert (out / "cases.parquet").read_bytes() == before
    assert read_status(out).engine == "batch"


METRIC = "cross_track_median_m"


@pytest.fixture(autouse=True)
def _start_quickly(monkeypatch):
    import uqharness.campaign.engines as module

    def forked(workers, **settings):
        return ProcessExecutor(workers, "fork", **settings)

    monkeypatch.setattr(module, "ProcessExecutor", forked)


@pytest.fixture
def spec_engine_check(tmp_path):
    return fakes.small_spec(tmp_path, 1, wind_mps=(0.0, 3.0))


def run_engine_check(spec_engine_check, out, flight=None, executor=None):
    return run_campaign(
        spec_engine_check,
        out,
        executor=executor or SerialExecutor(),
        fly=engines(flight or Flown()),
    )


def width(spec_engine_check, out):
    """Interquartile range of the metric in the calm condition, by numpy from the table."""
    run_engine_check(spec_engine_check, out)
    frame = read_table(out / "cases.parquet").to_pandas()
    low, high = np.percentile(frame.loc[frame["wind_mps"] == 0.0, METRIC], (25, 75))
    return float(high - low)


@pytest.mark.parametrize("late", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_difference_of_1e_5_of_the_spread_stops_the_campaign(spec_engine_check, tmp_path, late):
    iqr = width(spec_engine_check, tmp_path / "alike")
    # Asked for by name: an engine that nobody asked for would give way to JSBSim at the first look.
    spec_engine_check = spec_engine_check.with_engine("batch")
    with pytest.raises(EnginesDifferError, match=f"has {METRIC} .* of its spread apart") as error:
        run_engine_check(spec_engine_check, tmp_path / "wrong", Flown(offset=1e-5 * iqr, late=late))
    assert ("in its first seconds" in str(error.value)) is not late
    assert read_manifest(tmp_path / "wrong")["state"] == "interrupted"
    assert not (tmp_path / "wrong" / "cases.parquet").exists()
    assert (
        run_engine_check(
            spec_engine_check, tmp_path / "right", Flown(offset=1e-8 * iqr, late=late)
        ).failed
        == 0
    )
    rows = [
        row
        for row in read_check(tmp_path / "right")
        if row.metric == METRIC and row.part == FULL_FLIGHT
    ]
    assert {row.verdict for row in rows} == {"alike"}
    assert max(float(row.difference) for row in rows) == pytest.approx(1e-8, rel=0.2)


def test_a_stopped_campaign_stops_again(spec_engine_check, tmp_path):
    # The wrong flights are counted already.
    for flight in (Flown(offset=1.0, late=True), Flown(offset=1.0, late=True), Flown()):
        with pytest.raises(EnginesDifferError):
            run_engine_check(spec_engine_check, tmp_path / "out", flight)


def test_the_first_case_of_each_condition_is_checked_once(spec_engine_check, tmp_path):
    run_engine_check(spec_engine_check, tmp_path / "out")
    rows = [row for row in read_check(tmp_path / "out") if row.part == FULL_FLIGHT]
    result = {row.case_id for row in rows}
    every = build_cases(spec_engine_check.with_engine("batch"), find_mission(spec_engine_check))
    first = {next(case.case_id for case in every if case.wind_mps == wind) for wind in (0.0, 3.0)}
    by_hash = {case.case_id for case in every if int(case.case_id, 16) % 1000 == 0}
    assert result == first | by_hash
    content = (tmp_path / "out" / ENGINE_CHECK).read_bytes()
    run_engine_check(spec_engine_check, tmp_path / "out")
    assert (tmp_path / "out" / ENGINE_CHECK).read_bytes() == content


def test_only_the_guilty_case_of_a_group_is_crashed(tmp_path):
    spec_engine_check = fakes.small_spec(tmp_path, 2)
    flight = Deadly(seed=flight_seed(spec_engine_check.campaign.seed, 1, "turbulence"))
    summary = run_engine_check(
        spec_engine_check, tmp_path / "out", flight, ProcessExecutor(2, "fork")
    )
    assert summary.statuses == {"crashed": 1, "ok": 127}
    frame = read_table(tmp_path / "out" / "cases.parquet").to_pandas()
    (guilty,) = frame[frame["status"] == "crashed"].to_dict("records")
    assert (guilty["epistemic_id"], guilty["aleatory_id"]) == ("111111", 1)
    assert "signal 11 (SIGSEGV) (tried 2 times)" in guilty["reason"]


def test_workers_and_groups_move_no_byte(spec, tmp_path, monkeypatch):
    import uqharness.campaign.cases as grouping

    run_engine_check(spec, tmp_path / "serial")
    monkeypatch.setattr(grouping, "MIN_LANES", 7)
    monkeypatch.setattr(grouping, "MAX_LANES", 7)
    run_engine_check(spec, tmp_path / "seven", executor=ProcessExecutor(2, "fork"))
    for name in ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv"):
        tables = {(tmp_path / out / name).read_bytes() for out in ("serial", "seven")}
        assert len(tables) == 1, name


def test_a_spread_is_the_interquartile_range_bounded_from_below():
    values = np.random.default_rng(1).normal(5.0, 2.0, 1001)
    assert difference_scale(values) == pytest.approx(np.subtract(*np.percentile(values, (75, 25))))
    assert difference_scale([2000.0] * 5) == 2.0
    for values in ([0.0] * 5, [], [math.nan]):
        assert difference_scale(values) == MIN_SCALE


def outcome(status="ok", **metrics):
    return CaseOutcome("0001", status, "", 100.0, {"loss_of_control": 0.0, **metrics})


def verdicts(tmp_path, batch, jsbsim, moved=None):
    case = dataclasses.replace(
        build_cases(fakes.small_spec(tmp_path, 1), find_mission(fakes.small_spec(tmp_path, 1)))[0]
    )
    rows = compare_outcomes(FULL_FLIGHT, case, (batch, jsbsim), {METRIC: 1.0}, lambda _: moved)
    return {row.metric: (row.verdict, row.remark) for row in rows}


def test_a_count_may_differ_only_where_the_flight_came_near_the_radius(tmp_path):
    name = "excursions_15m"
    for nearest, expected in ((9e-7, "excused"), (2e-6, "differs"), (math.nan, "differs")):
        jsbsim = outcome(**{name: 1.0, NEAREST + name: nearest})
        assert verdicts(tmp_path, outcome(**{name: 2.0}), jsbsim)[name][0] == expected
    assert verdicts(tmp_path, outcome(**{name: 1.0}), jsbsim)[name][0] == "alike"


def test_a_status_may_differ_only_where_jsbsims_own_differs_after_one_ulp(tmp_path):
    batch, jsbsim = (
        outcome("diverged", loss_of_control=1.0),
        outcome("ground-contact", loss_of_control=1.0),
    )
    assert verdicts(tmp_path, batch, jsbsim, jsbsim)["status"][0] == "differs"
    assert verdicts(tmp_path, batch, jsbsim, batch)["status"] == (
        "excused",
        "JSBSim's own differs after one ulp",
    )


def test_a_flight_without_a_result_in_time_is_compared_with_nothing(tmp_path):
    """A busy machine's limit on time is no difference of the engines, and one ulp is not
    asked for.
    """
    late = CaseOutcome("a", "timeout", "no result after 420 s", 0.0)
    result = verdicts(tmp_path, outcome(**{METRIC: 2.0}), late, None)
    assert {verdict for verdict, _ in result.values()} == {"excused"}
    assert "time limit" in result["status"][1]
    crashed = CaseOutcome("a", "crashed", "the worker process ended", 0.0)
    assert verdicts(tmp_path, outcome(**{METRIC: 2.0}), crashed, crashed)["status"][0] == "differs"


def test_metrics_beyond_lost_control_are_judged_by_jsbsims_own_rounding(tmp_path):
    def value(number, is_lost):
        return outcome(**{METRIC: number, "loss_of_control": is_lost})

    for is_lost, moved, expected in (
        (1.0, 5.0001, "excused"),
        (1.0, 5.0 + 1e-9, "differs"),
        (0.0, 6.0, "differs"),
    ):
        result = verdicts(
            tmp_path, value(5.0005, is_lost), value(5.0, is_lost), value(moved, is_lost)
        )
        assert result[METRIC][0] == expected
    assert verdicts(tmp_path, value(math.nan, 0.0), value(math.nan, 0.0))[METRIC][0] == "alike"
    assert verdicts(tmp_path, value(math.nan, 0.0), value(5.0, 0.0))[METRIC][0] == "differs"


@pytest.fixture
def cases(tmp_path):
    spec = fakes.small_spec(tmp_path, 2, wind_mps=(0.0, 3.0))
    return build_cases(spec.with_engine("batch"), find_mission(spec))


def test_the_first_ten_seconds_of_each_condition_are_compared(cases):
    trajectory = []

    def group(engine, flights):
        trajectory.extend((engine, flight.duration_s, flight.burn_in_s) for flight in flights)
        return Flown()(engine, flights)

    rows = compare_start(replace(engines(Flown()), fly_group=group), cases, SerialExecutor())
    assert {(row.condition, row.part, row.verdict) for row in rows} == {
        (f"{wind} m/s moderate", "start", "alike") for wind in (0, 3)
    }
    assert len({row.case_id for row in rows}) == 2 * CASES_EACH
    assert set(trajectory) == {("batch", 10.0, 0.0), ("jsbsim as judge", 10.0, 0.0)}
    moved = compare_start(engines(Flown(offset=0.1)), cases, SerialExecutor())
    assert {row.metric for row in moved if row.verdict == "differs"} == {"cross_track_median_m"}


@dataclass(frozen=True)
class Unstable(Flown):
    """A model in which an error of each frame grows: one ulp in JSBSim, ``error`` in the batch
    engine.
    """

    rate_per_s: float = 3.0
    error: float = 0.0

    def flight(self, engine, flight):
        error = {"batch": self.error, "jsbsim one ulp off": 1e-16}.get(engine, 0.0)
        grown = min(error * np.exp(self.rate_per_s * flight.duration_s), 30.0)
        return replace(self, offset=grown, rounding=grown, error=0.0, rate_per_s=0.0).moved(
            engine, flight
        )

    def moved(self, engine, flight):
        return Flown.flight(self, engine, flight)


@pytest.mark.parametrize("rate_per_s", few([2.5, 3.0, 5.0, 12.0], 2))
def test_rounding_in_an_unstable_model_is_told_from_a_wrong_translation(cases, rate_per_s):
    def verdicts(error):
        flies = engines(Unstable(rate_per_s=rate_per_s, error=error))
        return {row.verdict for row in compare_start(flies, cases[:1], SerialExecutor())}

    assert verdicts(1e-13) == {"alike", "excused"}
    for invalid in (1e-3, 1e-6, 1e-9):
        assert "differs" in verdicts(invalid)
