"""JSBSim as the judge: a difference of a hundred-thousandth of the spread stops a campaign, one of
a hundred-millionth does not.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.engine_fakes import Deadly, Flown, Raising, engines
from uqharness.campaign.cases import build_cases
from uqharness.campaign.engines import (
    MIN_SCALE,
    EngineComparison,
    compare_outcomes,
    difference_scale,
    refuse_difference,
)
from uqharness.campaign.manifest import read_manifest
from uqharness.campaign.processes import ProcessExecutor, SerialExecutor
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.tables import ENGINE_CHECK, FULL_FLIGHT, read_check, write_check
from uqharness.campaign.worker import NEAREST, CaseOutcome
from uqharness.cli.main import main
from uqharness.errors import EnginesDifferError
from uqharness.flight import flight_seed
from uqharness.parquet_files import read_table

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)
TABLES = ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv")
METRIC = "cross_track_median_m"


@pytest.fixture(autouse=True)
def _start_quickly(monkeypatch):
    import uqharness.campaign.engines as module

    def forked(workers, **settings):
        return ProcessExecutor(workers, "fork", **settings)

    monkeypatch.setattr(module, "ProcessExecutor", forked)


@pytest.fixture
def spec(tmp_path):
    return fakes.small_spec(tmp_path, 3, wind_mps=(0.0, 3.0))


def run(spec, out, flown=None, executor=None):
    return run_campaign(
        spec, out, executor=executor or SerialExecutor(), fly=engines(flown or Flown())
    )


def tables(out):
    return {name: (out / name).read_bytes() for name in TABLES}


def width(spec, out):
    """Interquartile range of the metric in the calm condition, by numpy from the table."""
    run(spec, out)
    frame = read_table(out / "cases.parquet").to_pandas()
    low, high = np.percentile(frame.loc[frame["wind_mps"] == 0.0, METRIC], (25, 75))
    return float(high - low)


@pytest.mark.parametrize("late", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_hundred_thousandth_of_the_spread_stops_the_campaign_and_a_hundred_millionth_does_not(
    spec, tmp_path, late
):
    iqr = width(spec, tmp_path / "alike")
    # Asked for by name: an engine that nobody asked for would give way to JSBSim at the first look.
    spec = spec.with_engine("batch")
    with pytest.raises(EnginesDifferError, match=f"has {METRIC} .* of its spread apart") as error:
        run(spec, tmp_path / "wrong", Flown(offset=1e-5 * iqr, late=late))
    assert ("in its first seconds" in str(error.value)) is not late
    assert read_manifest(tmp_path / "wrong")["state"] == "interrupted"
    assert not (tmp_path / "wrong" / "cases.parquet").exists()
    assert run(spec, tmp_path / "right", Flown(offset=1e-8 * iqr, late=late)).failed == 0
    rows = [
        row
        for row in read_check(tmp_path / "right")
        if row.metric == METRIC and row.part == FULL_FLIGHT
    ]
    assert {row.verdict for row in rows} == {"alike"}
    assert max(float(row.difference) for row in rows) == pytest.approx(1e-8, rel=0.2)


def test_a_campaign_that_was_stopped_stops_again_also_with_an_engine_that_is_right_by_now(
    spec, tmp_path
):
    # The wrong flights are counted already.
    for flown in (Flown(offset=1.0, late=True), Flown(offset=1.0, late=True), Flown()):
        with pytest.raises(EnginesDifferError):
            run(spec, tmp_path / "out", flown)


def test_the_first_case_of_each_condition_is_flown_in_both_and_again_by_nobody(spec, tmp_path):
    run(spec, tmp_path / "out")
    rows = [row for row in read_check(tmp_path / "out") if row.part == FULL_FLIGHT]
    found = {row.case_id for row in rows}
    every = build_cases(spec.with_engine("batch"), find_mission(spec))
    first = {next(case.case_id for case in every if case.wind_mps == wind) for wind in (0.0, 3.0)}
    by_hash = {case.case_id for case in every if int(case.case_id, 16) % 1000 == 0}
    assert found == first | by_hash
    content = (tmp_path / "out" / ENGINE_CHECK).read_bytes()
    run(spec, tmp_path / "out")
    assert (tmp_path / "out" / ENGINE_CHECK).read_bytes() == content


def test_flights_left_to_the_judge_are_flown_by_the_next_run(spec, tmp_path):
    class Stopped(Exception):
        pass

    def stop(progress):
        raise Stopped

    out = tmp_path / "out"
    with pytest.raises(Stopped):
        run_campaign(spec, out, executor=SerialExecutor(), fly=engines(Flown()), on_progress=stop)
    write_check(out, [])
    run(spec, out)
    run(spec, tmp_path / "undisturbed")
    assert tables(out) == tables(tmp_path / "undisturbed")
    # The first seconds are those of flights that were still missing, which depends on when the run
    # was stopped.
    judged = [
        {row.case_id for row in read_check(folder) if row.part == FULL_FLIGHT}
        for folder in (out, tmp_path / "undisturbed")
    ]
    assert judged[0] == judged[1] != set()


@pytest.mark.parametrize("kind", [Deadly, Raising])
def test_only_the_guilty_case_of_a_group_is_crashed(tmp_path, kind):
    spec = fakes.small_spec(tmp_path, 4)
    flown = kind(seed=flight_seed(spec.campaign.seed, 2, "turbulence"))
    summary = run(spec, tmp_path / "out", flown, ProcessExecutor(2, "fork"))
    assert summary.statuses == {"crashed": 1, "ok": 255}
    frame = read_table(tmp_path / "out" / "cases.parquet").to_pandas()
    (guilty,) = frame[frame["status"] == "crashed"].to_dict("records")
    assert (guilty["epistemic_id"], guilty["aleatory_id"]) == ("111111", 2)
    expected = {
        Deadly: "signal 11 (SIGSEGV) (tried 2 times)",
        Raising: "RuntimeError: a flight that raises",
    }[kind]
    assert expected in guilty["reason"]


def test_workers_and_groups_move_no_byte(spec, tmp_path, monkeypatch):
    import uqharness.campaign.cases as grouping

    run(spec, tmp_path / "serial")
    run(spec, tmp_path / "two", executor=ProcessExecutor(2, "fork"))
    monkeypatch.setattr(grouping, "MIN_LANES", 7)
    monkeypatch.setattr(grouping, "MAX_LANES", 7)
    run(spec, tmp_path / "seven", executor=ProcessExecutor(3, "fork"))
    assert tables(tmp_path / "two") == tables(tmp_path / "serial") == tables(tmp_path / "seven")


def test_the_command_ends_with_one_and_a_sentence(tmp_path, capsys, monkeypatch):
    import uqharness.commands.campaign as command

    def stopped(*given, **named):
        raise EnginesDifferError("out: the batch engine differs from JSBSim")

    monkeypatch.setattr(command.running, "run_campaign", stopped)
    assert (
        main(
            ["campaign", "run", str(fakes.campaign_file(tmp_path)), "--out", str(tmp_path / "out")]
        )
        == 1
    )
    assert capsys.readouterr().err.strip().endswith("the batch engine differs from JSBSim")


def test_a_spread_is_the_interquartile_range_bounded_from_below():
    values = np.random.default_rng(1).normal(5.0, 2.0, 1001)
    assert difference_scale(values) == pytest.approx(
        np.percentile(values, 75) - np.percentile(values, 25)
    )
    assert difference_scale([2000.0] * 5) == 2.0
    assert (
        difference_scale([0.0] * 5)
        == difference_scale([])
        == difference_scale([math.nan])
        == MIN_SCALE
    )


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
    found = verdicts(tmp_path, outcome(**{METRIC: 2.0}), late, None)
    assert {verdict for verdict, _ in found.values()} == {"excused"}
    assert "time limit" in found["status"][1]
    crashed = CaseOutcome("a", "crashed", "the worker process ended", 0.0)
    assert verdicts(tmp_path, outcome(**{METRIC: 2.0}), crashed, crashed)["status"][0] == "differs"


def test_metrics_beyond_lost_control_are_judged_by_jsbsims_own_rounding(tmp_path):
    def value(number, lost):
        return outcome(**{METRIC: number, "loss_of_control": lost})

    for lost, moved, expected in (
        (1.0, 5.0001, "excused"),
        (1.0, 5.0 + 1e-9, "differs"),
        (0.0, 6.0, "differs"),
    ):
        found = verdicts(tmp_path, value(5.0005, lost), value(5.0, lost), value(moved, lost))
        assert found[METRIC][0] == expected
    assert verdicts(tmp_path, value(math.nan, 0.0), value(math.nan, 0.0))[METRIC][0] == "alike"
    assert verdicts(tmp_path, value(math.nan, 0.0), value(5.0, 0.0))[METRIC][0] == "differs"


def test_rows_stand_in_the_campaign_s_order_whichever_flight_ended_first(tmp_path):
    spec = fakes.small_spec(tmp_path, 1)
    case = build_cases(spec, find_mission(spec))[0]
    cases = [dataclasses.replace(case, case_id=f"{k:016x}", wind_mps=float(k)) for k in (3, 1, 2)]
    written = []
    for reverse in (False, True):
        comparison = EngineComparison(tmp_path, cases, lambda case: outcome())
        for case in reversed(cases) if reverse else cases:
            pair = [
                dataclasses.replace(outcome(**{METRIC: 1.0}), case_id=prefix + case.case_id)
                for prefix in ("", comparison.groups([case])[0].cases[0][0][: -len(case.case_id)])
            ]
            comparison.take(pair)
            comparison.compare(final=False)
        comparison.compare(final=True)
        written.append((tmp_path / "engine-check.csv").read_bytes())
        (tmp_path / "engine-check.csv").unlink()
    assert written[0] == written[1]


def test_what_differs_is_named_with_the_worst_first(tmp_path):
    case = build_cases(fakes.small_spec(tmp_path, 1), find_mission(fakes.small_spec(tmp_path, 1)))[
        0
    ]
    pair = (outcome(**{METRIC: 2.0, "other": 1.1}), outcome(**{METRIC: 1.0, "other": 1.0}))
    rows = compare_outcomes(FULL_FLIGHT, case, pair, {METRIC: 1.0, "other": 1.0}, lambda _: pair[1])
    with pytest.raises(
        EnginesDifferError,
        match=f"has {METRIC} 2.0 in the batch engine and 1.0 in JSBSim, 1 of its spread apart",
    ):
        refuse_difference(tmp_path, rows)
    refuse_difference(tmp_path, [row for row in rows if row.verdict == "alike"])
