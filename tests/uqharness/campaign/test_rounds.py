"""A campaign that stops when its question is answered: same bytes however it is run, killed or resumed; aborted flights."""

from __future__ import annotations

import csv
import json

import numpy as np
import pandas as pd
import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.page_checks import problems
from uqharness.campaign.manifest import read_manifest
from uqharness.campaign.processes import ProcessExecutor, SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.rounds import KINDS, count_aborted
from uqharness.campaign.run import run_campaign
from uqharness.campaign.shards import Shard
from uqharness.campaign.tables import CASES
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.report.write import write_report

pytestmark = pytest.mark.usefixtures("flights_here")

TABLES = (CASES, "pbox.parquet", "excursions.csv", "decisions.csv", "statements.csv")


TOML = """
[campaign]
aircraft = "plane"
mission = "loiter.xml"
seed = 7

[aleatory]
flights = 40
duration_s = 3600
wind_mps = [3, 7]
turbulence = "severe"

[epistemic]
method = "corners"
interior = 0
nominal = false
coefficients = ["CX", "CY"]
bounds = { CX = 0.008, CY = 0.010 }

[metrics]
acceptable_per_h = 1
dispersion = 2

[stop]
rule = "decide"
look_every = 4
"""


@pytest.fixture(autouse=True)
def _no_check_flight(monkeypatch):
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)


@pytest.fixture(scope="module")
def decided(tmp_path_factory):
    """The campaign as it is, flown once for the tests that read it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        folder = tmp_path_factory.mktemp("rounds")
        summary = run(folder, "out")
    return summary, folder / "out"


def run(tmp_path, out, executor=None, text=TOML, fly=fakes.by_corner, **keys):
    spec = read_campaign(fakes.campaign_file(tmp_path, text))
    executor = executor or SerialExecutor()
    return run_campaign(spec, tmp_path / out, executor=executor, fly=fly, **keys)


def tables(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


def rows(folder, name, **where):
    with (folder / name).open(newline="") as handle:
        result = list(csv.DictReader(handle))
    return [row for row in result if where.items() <= row.items()]


SIGNED = {"radius_m": "15", "distance": "horizontal"}


def test_each_cell_stops_at_its_answer(decided):
    summary, out = decided
    cells = {row["condition"]: row for row in rows(out, "decisions.csv", epistemic_id="all")}
    assert cells["3 m/s severe"]["answer"] == "yes"
    assert cells["7 m/s severe"]["answer"] == "no"
    assert int(cells["7 m/s severe"]["flights"]) == 4 * 4
    assert 0 < summary.cases < 320 / 2
    frame = read_table(out / CASES).to_pandas()
    assert len(frame) == summary.cases == read_manifest(out)["cases"]
    # Common random numbers: every corner flew the same air, from the first flight on, without gaps.
    for (_, name), group in frame.groupby(["wind_mps", "epistemic_id"]):
        assert group["aleatory_id"].tolist() == list(range(len(group))), name
        assert len(group) % 4 == 0
    signed = {row["condition"]: row for row in rows(out, "statements.csv", **SIGNED)}
    calm, rough = signed["3 m/s severe"], signed["7 m/s severe"]
    assert (calm["answer"], calm["best_per_h"], calm["worst_lower_per_h"]) == ("yes", "0", "0")
    assert (rough["answer"], rough["worst"]) == ("no", "11----")
    assert float(rough["worst_lower_per_h"]) < 4.0 < float(rough["worst_upper_per_h"])


class InPieces(SerialExecutor):
    """Hands on every few flights, so that a run can be stopped in the middle of a round."""

    def run(self, fly, flights):
        batch = []
        for item in flights:
            batch += [outcome for part in super().run(fly, [item]) for outcome in part]
            if len(batch) == 7:
                yield batch
                batch = []
        yield batch


def stop_at(number):
    def check(progress):
        if progress.done >= number:
            raise KeyboardInterrupt

    return check


@pytest.mark.parametrize("answer_for", [pytest.param("cell", marks=pytest.mark.slow), "corner"])
def test_workers_and_interruptions_move_no_byte(tmp_path, answer_for):
    text = TOML + f'answer_for = "{answer_for}"\n'
    run(tmp_path, "whole", text=text)
    reference = tables(tmp_path / "whole")
    run(tmp_path, "two", ProcessExecutor(2, "fork"), text=text)
    assert tables(tmp_path / "two") == reference
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "killed", InPieces(), text=text, on_progress=stop_at(36))
    run(tmp_path, "killed", InPieces(), text=text)
    assert tables(tmp_path / "killed") == reference
    repeat = run(tmp_path, "killed", text=text, fly=fakes.aborts_always)
    assert (repeat.done_before, repeat.progress.flown_s) == (repeat.cases, 0.0)
    assert tables(tmp_path / "killed") == reference
    corners = rows(tmp_path / "whole", "decisions.csv", condition="7 m/s severe")
    answers = {row["epistemic_id"]: row["answer"] for row in corners}
    assert answers["11----"] == ("no" if answer_for == "corner" else "open")
    assert answers["all"] == "no"


def test_status_while_it_flies_and_after(tmp_path, capsys, decided):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, "out", on_progress=stop_at(32))
    # The serial executor hands on what it has at the end of a round: one has been decided by.
    assert main(["campaign", "status", str(tmp_path / "out"), "--json"]) == 1
    capsys.readouterr()
    assert main(["campaign", "status", str(decided[1]), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)["answers"]
    answers = {item["condition"]: item["answer"] for item in result}
    assert answers == {"3 m/s severe": "yes", "7 m/s severe": "no"}
    assert main(["campaign", "status", str(decided[1])]) == 0
    assert "at most 1 excursion per hour beyond 15 m? 1 yes, 1 no" in capsys.readouterr().out


def test_the_report_lists_supportable_claims(decided):
    report = write_report(decided[1])
    page = report.path.read_text(encoding="utf-8")
    assert problems(page) == []
    assert any("At most 1 per hour at every corner? No." in line for line in report.verdict)
    assert "Supportable claims" in page
    assert "variance of the excursions per flight of 2 times their mean" in page


def test_the_band_pays_for_having_looked(tmp_path, decided):
    """Same flights, decided or planned: the band of a campaign that could have stopped anywhere is
    wider.
    """
    flight = read_table(decided[1] / "pbox.parquet").to_pandas()
    planned = TOML.partition("[stop]")[0].replace("flights = 40", "flights = 4")
    run(tmp_path, "planned", text=planned.replace("[3, 7]", "7"))
    fixed = read_table(tmp_path / "planned" / "pbox.parquet").to_pandas()
    same = flight[flight["condition"] == "7 m/s severe"].reset_index(drop=True)
    pd.testing.assert_series_equal(same["lower"], fixed["lower"])
    assert (same["band_lower"] <= fixed["band_lower"]).all()
    assert same["band_lower"].sum() < fixed["band_lower"].sum()


def test_undecidable_campaigns_are_refused(tmp_path):
    with pytest.raises(BadInputError, match="needs all corners together"):
        run(tmp_path, "shard", shard=Shard(1, 2))

    with pytest.raises(BadInputError, match="has no excursions_15m"):
        run(tmp_path, "unscored", fly=fakes.undefined_excursions)


def test_failed_flights_keep_a_cell_from_yes(tmp_path):
    text = TOML.replace("flights = 40", "flights = 8").replace("[3, 7]", "3")
    run(tmp_path, "out", text=text, fly=fakes.diverges)
    (cell,) = rows(tmp_path / "out", "decisions.csv", epistemic_id="all")
    assert (cell["answer"], cell["reason"]) == ("open", "all flights flown")
    (signed,) = rows(tmp_path / "out", "statements.csv", **SIGNED)
    assert (signed["answer"], signed["failed"]) == ("open", "32")


@pytest.mark.parametrize(("hours", "calm", "rough"), [(12, "yes", "no"), (2, "open", "open")])
def test_a_campaign_of_fixed_hours_answers_too(tmp_path, hours, calm, rough):
    """With the number of flights chosen beforehand; a quarter of the hours leaves both
    cells open.
    """
    planned = TOML.partition("[stop]")[0].replace("flights = 40\n", "")
    run(tmp_path, "out", text=f'{planned}[stop]\nrule = "hours"\nhours = {hours}\n')
    out = tmp_path / "out"
    answers = {row["condition"]: row for row in rows(out, "statements.csv", **SIGNED)}
    assert answers["3 m/s severe"]["answer"] == calm
    assert answers["7 m/s severe"]["answer"] == rough
    assert float(answers["3 m/s severe"]["hours"]) == 4 * hours
    assert float(answers["3 m/s severe"]["extrapolated_share"]) == 0.0
    assert not (out / "decisions.csv").exists()
    for row in rows(out, "excursions.csv"):
        rate, upper = float(row["rate_per_h"]), float(row["flights_upper_per_h"])
        assert float(row["flights_lower_per_h"]) <= rate <= upper
        assert upper >= float(row["limit_upper_per_h"]) or int(row["excursions"]) > 0


def corner(*flights):
    """(status, share flown, loss of control) of each flight."""
    return pd.DataFrame(
        [{"status": s, "duration_s": 3600.0 * d, "loss_of_control": c} for s, d, c in flights]
    )


def test_each_aborted_flight_is_of_one_kind():
    first = corner(("ok", 1.0, 0), ("ok", 1.0, 1), ("diverged", 0.25, 1))
    second = corner(("ground-contact", 0.5, None), ("timeout", 0.0, None))
    result = count_aborted([first, second], 3600.0)
    assert result.kinds == dict.fromkeys(KINDS, 1)
    assert result.total == 4
    np.testing.assert_array_equal(result.is_aborted, [[0.0, 1.0, 1.0], [1.0, 1.0, np.nan]])
    np.testing.assert_allclose(result.missing_shares, [0.75, 1.5])


def test_limits_are_per_hour_flown():
    """Half of the flights end half way: 0.5 aborted flights in 0.75 flights' time. Nothing flown
    bounds nothing.
    """
    ended, flew_on, unflown = (
        float(count_aborted([corner(*flights)], 3600.0).upper(0.025, None)[0])
        for flights in (
            [("diverged", 0.5, 1), ("ok", 1.0, 0)] * 200,
            [("ok", 1.0, 1), ("ok", 1.0, 0)] * 200,
            [("diverged", 0.0, 1)] * 50,
        )
    )
    assert ended > 0.5 / 0.75
    assert 0.5 < flew_on < ended
    assert unflown == np.inf
