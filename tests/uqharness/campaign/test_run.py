"""A campaign as a whole: same bytes however it is run, killed or resumed; refusals; failures
counted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.conditions import ERROR_METRICS, excursion_columns
from uqharness.campaign.manifest import read_manifest
from uqharness.campaign.processes import ProcessExecutor, SerialExecutor
from uqharness.campaign.run import Progress, run_campaign
from uqharness.campaign.store import Store, run_lock
from uqharness.campaign.tables import CASES
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)

TABLES = (CASES, "pbox.parquet", "excursions.csv")


@pytest.fixture(autouse=True)
def _validate_quickly(monkeypatch):
    """The check flight in a forked process: what it checks is the same, and it starts in a
    hundredth of the time.
    """
    import uqharness.campaign.run as campaign

    def forked(workers, **settings):
        return ProcessExecutor(workers, "fork", **settings)

    monkeypatch.setattr(campaign, "ProcessExecutor", forked)


def tables(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


def run(tmp_path, out, executor=None, fly=fakes.steady, flights=2, **keys):
    spec = fakes.small_spec(tmp_path, flights)
    return run_campaign(
        spec, tmp_path / out, executor=executor or SerialExecutor(), fly=fly, **keys
    )


COLUMNS = """case_id epistemic_id level_CX level_CY level_CZ level_Cl level_Cm level_Cn aleatory_id
wind_mps turbulence seed engine duration_s status reason
cross_track_median_m cross_track_mean_m cross_track_max_m altitude_median_m altitude_mean_m
altitude_max_m speed_median_mps speed_mean_mps speed_max_mps
cross_track_median_m_measured cross_track_mean_m_measured cross_track_max_m_measured
altitude_median_m_measured altitude_mean_m_measured altitude_max_m_measured
speed_median_mps_measured speed_mean_mps_measured speed_max_mps_measured
excursions_15m excursions_25m excursions_15m_3d excursions_25m_3d loss_of_control
extrapolated_share"""


def test_the_table_has_one_row_per_flight_and_the_agreed_columns(tmp_path):
    summary = run(tmp_path, "out")
    assert (summary.cases, summary.failed, summary.statuses) == (128, 0, {"ok": 128})
    table = read_table(tmp_path / "out" / CASES)
    assert table.num_rows == 128
    assert table.column_names == COLUMNS.split()
    assert set(ERROR_METRICS) | set(excursion_columns((15.0, 25.0))) <= set(table.column_names)
    assert table["duration_s"].to_pylist() == [150.0] * 128
    assert read_manifest(tmp_path / "out")["state"] == "complete"


EXECUTORS = {
    "fork1": lambda: ProcessExecutor(1, "fork"),
    "fork3": lambda: ProcessExecutor(3, "fork"),
    "spawn2": lambda: ProcessExecutor(2, "spawn"),
    "forkserver2": lambda: ProcessExecutor(2, "forkserver"),
    "reversed": lambda: ReversedExecutor(),
}


@pytest.mark.parametrize(
    "names",
    [
        ("fork3", "reversed"),
        pytest.param(("fork1", "spawn2", "forkserver2"), marks=pytest.mark.slow),
    ],
)
def test_workers_order_and_start_method_move_no_byte(tmp_path, names):
    run(tmp_path, "serial", fly=fakes.hazardous_but_alive, flights=1)
    reference = tables(tmp_path / "serial")
    for name in names:
        run(tmp_path, name, EXECUTORS[name](), fakes.hazardous_but_alive, flights=1)
        assert tables(tmp_path / name) == reference, name
    other = fakes.small_spec(tmp_path, 1)
    other = replace(other, campaign=other.campaign.model_copy(update={"seed": 8}))
    run_campaign(other, tmp_path / "seed", executor=SerialExecutor(), fly=fakes.steady)
    assert tables(tmp_path / "seed") != reference


class ReversedExecutor(SerialExecutor):
    def run(self, fly, flights):
        yield from super().run(fly, reversed(list(flights)))


def test_failures_are_rows_with_reasons(tmp_path):
    summary = run(tmp_path, "out", ProcessExecutor(2, "fork"), fakes.hazardous, flights=1)
    frame = read_table(tmp_path / "out" / CASES).to_pandas()
    assert len(frame) == 64
    assert summary.failed == (frame["status"] != "ok").sum() > 0
    # Each kind of crash has its reason: test_processes.
    for word in ("SIGABRT", "RuntimeError"):
        assert frame["reason"].str.contains(word).any(), word
    diverged = frame[frame["status"] == "diverged"].iloc[0]
    assert (diverged["duration_s"], diverged["excursions_15m"]) == (30.0, 2)
    assert np.isnan(diverged["cross_track_median_m"])
    # Once recorded, a failure is done: the same command flies nothing more and changes nothing.
    before = tables(tmp_path / "out")
    repeat = run(tmp_path, "out", fly=fakes.aborts_always, flights=1)
    assert (repeat.done_before, repeat.progress.flown_s) == (64, 0.0)
    assert tables(tmp_path / "out") == before


def test_an_undefined_metric_has_its_reason(tmp_path):
    run(tmp_path, "out", fly=fakes.undefined_speed, flights=1)
    frame = read_table(tmp_path / "out" / CASES).to_pandas()
    assert frame["speed_median_mps"].isna().all()
    assert set(frame["reason"]) == {"speed_median_mps: no speed was commanded"}
    metrics = set(read_table(tmp_path / "out" / "pbox.parquet").to_pandas()["metric"])
    assert "speed_mean_mps" in metrics
    assert "speed_median_mps" not in metrics


def test_an_interrupted_run_keeps_what_was_finished_and_resumes(tmp_path):
    """Progress counts only what is on the disk."""
    observed: list[Progress] = []

    def stop_after_some(progress):
        assert finished(tmp_path / "out") == progress.done
        observed.append(progress)
        if progress.done >= 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(
            tmp_path,
            "out",
            ProcessExecutor(2, "fork"),
            fakes.slow,
            flights=1,
            on_progress=stop_after_some,
        )
    assert read_manifest(tmp_path / "out")["state"] == "interrupted"
    retained = finished(tmp_path / "out")
    assert retained == observed[-1].done >= 20
    assert not (tmp_path / "out" / CASES).exists()
    summary = run(tmp_path, "out", ProcessExecutor(1, "fork"), flights=1)
    assert summary.done_before == retained
    run(tmp_path, "undisturbed", flights=1)
    assert tables(tmp_path / "out") == tables(tmp_path / "undisturbed")


def finished(out):
    if not (out / "journal.sqlite").exists():
        return 0
    with Store(out, read_only=True) as store:
        return len(store.finished())


def test_folders_in_use_or_of_something_else_are_refused(tmp_path):
    (tmp_path / "out").mkdir()
    with run_lock(tmp_path / "out"), pytest.raises(BadInputError, match="another run is using"):
        run(tmp_path, "out")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("mine")
    with pytest.raises(BadInputError, match="not empty and not a campaign folder"):
        run(tmp_path, "other")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["thesis.tex"]
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="cannot be made"):
        run(tmp_path, "file/out")


def test_changed_files_are_refused_by_name(tmp_path):
    run(tmp_path, "out", flights=1)
    spec = fakes.small_spec(tmp_path, 1)
    for name, content, part in (
        ("plane/plane.xml", "<fdm_config><!-- heavier --></fdm_config>", "aircraft"),
        ("loiter.xml", "<runscript> </runscript>", "script"),
    ):
        before = (tmp_path / name).read_text()
        (tmp_path / name).write_text(content)
        with pytest.raises(BadInputError, match=f"content of the {part}"):
            run_campaign(spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.steady)
        (tmp_path / name).write_text(before)
    with pytest.raises(BadInputError, match=r"\[aleatory\] flights was 1, is 5"):
        run(tmp_path, "out", flights=5)


def test_an_edit_during_the_run_spoils_the_folder(tmp_path):
    def edit(progress):
        (tmp_path / "loiter.xml").write_text("<runscript> </runscript>")

    with pytest.raises(BadInputError, match="edited while this campaign flew"):
        run(tmp_path, "out", on_progress=edit)
    assert not (tmp_path / "out" / CASES).exists()
    # campaign_file restores the script; the flights of the other one are still in the folder.
    with pytest.raises(BadInputError, match="remove the folder"):
        run(tmp_path, "out")


def test_a_model_that_ends_the_interpreter_is_an_error_before_any_case(tmp_path):
    with pytest.raises(BadInputError, match=r"check flight before the campaign failed.*SIGABRT"):
        run(tmp_path, "out", ProcessExecutor(2, "fork"), fakes.aborts_always)
    with pytest.raises(BadInputError, match="'uq/active' does not exist"):
        run(tmp_path, "out2", ProcessExecutor(2, "fork"), fakes.refuses)
    # Nothing was recorded, so that the mended model flies.
    with Store(tmp_path / "out", read_only=True) as store:
        assert store.finished() == set()
