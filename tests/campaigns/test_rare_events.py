"""Studies of rare excursions: rates of replicates and plain flights, paths in JSBSim, and what a
kill costs.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from campaigns.rare_events import closed_form, coverage, reproduce
from campaigns.rare_events.rates import rates
from campaigns.rare_events.reproduce import (
    JSBSIM,
    LEVELS,
    PLAIN,
    REPLICATES,
    read_hits,
    read_rows,
    read_tuning,
    write_tuning,
)
from campaigns.rare_events.study import NAMES, TOP, Size, Study, Tuning, chosen_hits
from uqharness.campaign.rare_events import DistancePredictor
from uqharness.errors import BadInputError
from uqharness.statistics import Levels, interval

SHORT = """
[campaign]
aircraft = "espaaro"
mission = "scripts/loiter.xml"
seed = 3

[aleatory]
flights = 1
duration_s = 40
burn_in_s = 20
wind_mps = 4
turbulence = "moderate"
sensor_noise = true

[epistemic]
method = "corners"
interior = 0
nominal = false
bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }

[metrics]
excursion_radius_m = [8, 10]
rearm_m = 1
"""

SIZE = Size(roots=3, plain=4, noted=2)
NOW = tuple(float(name == "distance") for name in NAMES)

TUNING = Tuning(
    Levels((-4.0, -2.0), 2), DistancePredictor(10.0, (1.0,), (NOW,), (0.0,), (1.0,)), 0.5, 1.0
)
"""Levels 4 and 2 m inside 10 m."""


def study_of(folder: Path, text: str = SHORT) -> Study:
    path = folder / "campaign.toml"
    path.write_text(text)
    return Study(path, "moderate-4", "100100", SIZE)


def simulate(study: Study, folder: Path) -> None:
    write_tuning(folder, TUNING)
    reproduce.fly(study, folder, 2)
    reproduce.fly_missing(folder / PLAIN, study, 1, study.plain)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path]:
    folder = tmp_path_factory.mktemp("rare")
    study = study_of(folder)
    retained = folder / study.name
    simulate(study, retained)
    return study, retained


def test_fly_resumes_after_a_kill(done, tmp_path, monkeypatch):
    study, retained = done
    other = tmp_path / "other"
    write_tuning(other, TUNING)
    complete, start = Study.replicate, []

    def killed(self, number, tuned):
        start.append(number)
        if start == [0, 1]:
            raise KeyboardInterrupt
        return complete(self, number, tuned)

    monkeypatch.setattr(Study, "replicate", killed)
    with pytest.raises(KeyboardInterrupt):
        reproduce.fly(study, other, 2)
    assert read_rows(other / REPLICATES, study)["number"].tolist() == [0]
    reproduce.fly(study, other, 2)
    assert start == [0, 1, 1]
    pd.testing.assert_frame_equal(
        *(read_rows(each / REPLICATES, study) for each in (retained, other)), check_exact=True
    )
    assert read_hits(retained, study) == read_hits(other, study) != []


def test_jsbsim_flies_the_paths_and_sees_another(done, monkeypatch):
    study, retained = done
    assert reproduce.jsbsim(study, retained, 2) == 0
    rows = (retained / JSBSIM).read_text().splitlines()
    assert len(rows) == 3
    assert all(row.endswith(",same") for row in rows[1:])
    monkeypatch.setattr(Study, "reflown", None)
    assert reproduce.jsbsim(study, retained, 2) == 0, "paths that are there are not flown again"
    (retained / JSBSIM).write_text("\n".join(rows).replace(",same", ",other", 1) + "\n")
    assert reproduce.jsbsim(study, retained, 2) == 1
    monkeypatch.undo()
    (hit,) = chosen_hits(read_hits(retained, study), 1)
    distance, _ = study.reflown(replace(hit, splits=()))
    assert abs(distance - hit.distance_m) > 1e-3


def test_tables_and_fly_tell_other_flights_apart(done, tmp_path, capsys):
    study, retained = done
    assert reproduce.tables(study, retained) == 0
    output = capsys.readouterr().out
    assert "8 m: " in output
    assert "note" not in output
    other = study_of(tmp_path, SHORT.replace("seed = 3", "seed = 4"))
    assert reproduce.tables(other, retained) == 0
    assert "note: aircraft, script or campaign file have changed" in capsys.readouterr().out
    with pytest.raises(BadInputError, match="flown with another aircraft"):
        reproduce.fly(other, retained, 3)
    levels = retained / LEVELS
    before = levels.read_bytes()
    levels.write_text(json.dumps({**json.loads(before), "scores": [-4.0, -1.5]}))
    with pytest.raises(BadInputError, match="other levels"):
        reproduce.jsbsim(study, retained, 2)
    levels.write_text("{}")
    with pytest.raises(BadInputError, match="no levels of a pilot"):
        read_tuning(retained)
    levels.write_bytes(before)


def test_rare_events_refuse_bad_input(tmp_path, capsys):
    with pytest.raises(BadInputError, match="--corner 1: not one of 000000 to 111111"):
        replace(study_of(tmp_path), corner="1")
    assert reproduce.main(["tables", "--cell", "calm-3"]) == 2
    assert reproduce.main(["tables", "--studies", str(tmp_path)]) == 2
    assert "run the command fly" in capsys.readouterr().err


def counted(share: float, mean: float, flights: int = 6, square: float = math.nan) -> dict:
    names = ("probability_15m", "events_15m", "squares_15m", "flights")
    return dict(zip(names, (share, mean, square, flights), strict=True))


def rate_of(split: list[dict], plain: list[dict]) -> dict:
    columns = ["probability_15m", "events_15m", "squares_15m", "flights"]
    return rates([15.0], 0.5, *(pd.DataFrame(rows, columns=columns) for rows in (split, plain)))[0]


def test_rates_agree_with_plain_flights_or_do_not():
    rng = np.random.default_rng(5)
    split = [counted(share, 1.2 * share) for share in 0.1 * np.exp(0.3 * rng.standard_normal(16))]
    plain = counted(0.11, 0.13, 1000, 0.18)
    alike = rate_of(split, [plain])
    assert alike["agree"] is True
    assert alike["cluster"] == pytest.approx(1.2)
    assert alike["split_per_h"] == pytest.approx(2.4 * alike["split"])
    assert (alike["plain_hit"], alike["plain_flights"]) == (110, 1000)
    assert alike["plain_lower"] == pytest.approx(0.0913, abs=1e-3)
    assert alike["plain_per_h"] == pytest.approx(0.26)
    assert alike["plain_per_h_upper"] / 0.26 == pytest.approx(
        math.exp(1.96 * math.sqrt((0.18 - 0.13**2) / 1000) / 0.13), rel=1e-4
    )
    assert alike["observations"] == 8
    reference = [one["probability_15m"] for one in split]
    assert alike["largest_share"] == pytest.approx(max(reference) / sum(reference))
    assert 0.05 < alike["p_value"] <= 1.0
    assert alike["split"] == pytest.approx(np.mean([one["probability_15m"] for one in split]))
    other = rate_of(split, [counted(0.3, 0.33, 1000, 0.4)])
    assert other["agree"] is False
    few = rate_of(split, [counted(0.0, 0.0, 1000, 0.0)])
    assert few["agree"] is False, "no excursion at all where a hundred are due"
    rare = rate_of(
        [counted(1e-4 * k, 1e-4 * k) for k in (1, 2, 3, 2, 1, 3, 2, 2)],
        [counted(0.003, 0.003, 1000, 0.003)],
    )
    assert rare["agree"] is False, "three where a fifth of one is due"
    single = rate_of(
        [counted(1e-4 * k, 1e-4 * k) for k in (1, 2, 3, 2, 1, 3, 2, 2)],
        [counted(0.001, 0.001, 1000, 0.001)],
    )
    assert single["agree"] is True
    reduced = rate_of(split, [])
    assert reduced["agree"] is None
    none = rate_of([counted(0.0, 0.0), *split[:3]], [])
    assert math.isnan(none["split_lower"])
    empty = rate_of([counted(0.0, 0.0)] * 4, [])
    assert math.isnan(empty["largest_share"])
    assert "1 of 4 replicates have no event" in none["reason"]


def test_the_pilot_fits_predictions_and_finds_levels(done, tmp_path):
    study, _ = done
    short = replace(study, size=replace(SIZE, pilot_roots=24, pilot_s=40.0, share=0.5, aim_m=8.0))
    tuned = short.tune()
    assert tuned.predicted.radius_m == 8.0
    assert tuned.plain_h == pytest.approx(24 * 40.0 / 3600.0)
    assert list(tuned.predicted.sigmas[:3]) == sorted(tuned.predicted.sigmas[:3]), (
        "the farther ahead the less is known"
    )
    assert tuned.predicted.sigmas[0] < 0.5
    assert list(tuned.levels.scores) == sorted(tuned.levels.scores)
    assert tuned.levels.scores[-1] <= TOP
    write_tuning(tmp_path, tuned)
    assert read_tuning(tmp_path) == tuned
    with pytest.raises(BadInputError, match="use more or longer paths than 1 in the pilot"):
        replace(short, size=replace(short.size, pilot_roots=1, pilot_s=12.0, aim_m=math.inf)).tune()


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def number(text: str) -> float:
    return float(text or "nan")


def wrong_in(row: Mapping[str, str]) -> list[str]:
    """Columns of a row of coverage.csv that are not what its means, and the plain flights, say."""
    one = interval([number(row[f"mean_{place}"]) for place in range(coverage.OBSERVATIONS)])
    retained = {name: number(row[name]) for name in ("estimate", "lower", "upper")}
    result = [
        name
        for name, value in retained.items()
        if value != pytest.approx(getattr(one, name), rel=1e-6, nan_ok=True)
    ]
    constant = (
        retained["lower"] <= int(row["plain_hit"]) / int(row["plain_flights"]) <= retained["upper"]
    )
    return result + (["held"] if row["held"] != ("yes" if constant else "no") else [])


def test_the_committed_intervals_hold_the_rate_of_plain_flights_nine_times_in_ten():
    result = rows_of(reproduce.HOME / coverage.TABLE)
    assert [row["repeat"] for row in result] == [str(number) for number in range(100)]
    assert [name for row in result for name in wrong_in(row)] == []
    assert len({(row["plain_hit"], row["plain_flights"]) for row in result}) == 1
    assert int(result[0]["plain_flights"]) >= 4000
    assert sum(row["held"] == "yes" for row in result) >= 90


def test_the_committed_intervals_hold_what_quadrature_gives():
    truth = closed_form.exact(closed_form.STEPS, closed_form.THRESHOLD, closed_form.REARM)
    result = rows_of(reproduce.HOME / closed_form.TABLE)
    constant = {
        (paths, name): 0
        for paths in {row["paths"] for row in result}
        for name in ("probability", "events")
    }
    for row in result:
        for name, true in zip(("probability", "events"), truth, strict=True):
            assert number(row[f"{name}_true"]) == pytest.approx(true, rel=1e-6)
            holds = number(row[f"{name}_lower"]) <= true <= number(row[f"{name}_upper"])
            assert row[f"{name}_held"] == ("yes" if holds else "no")
            constant[row["paths"], name] += holds
    assert len(result) == 200
    assert min(constant["splitting", "probability"], constant["splitting", "events"]) >= 90
    assert constant["copies that begin elsewhere", "probability"] <= 5
