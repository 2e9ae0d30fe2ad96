"""What refine shows of a refinement: effects that the test flights speak against are withdrawn one by one; intervals and a
mission's p-box before and after; words that agree with the verdict."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from flown import fly
from sixdof import Airframe
from test_refine import TEST, TRAIN, document, with_p2

from sysid.effect_choice import Choice, Selection
from sysid.effects import Effect
from uqharness import refine_judge
from uqharness.aircraft import find_aircraft
from uqharness.cli import main
from uqharness.errors import BadInputError
from uqharness.flights import read_flights
from uqharness.pbox import Sample
from uqharness.refine import Found
from uqharness.refine_intervals import FlightSet, IntervalJob, fit_intervals, intervals_document
from uqharness.refine_judge import BEYOND_CHANCE, gap_change
from uqharness.refine_pbox import MissionPBox, Model, campaign_for, fly_missions
from uqharness.refine_report import write_report
from uqharness.refine_run import Refinement, Request, _put, refine
from uqharness.refine_words import left_over, nowhere

CX_BETA2 = -1.5
MORE = (*TRAIN, ("yaw-roll", 21.5), ("yaw-roll", 19.0), ("roll-yaw", 20.5))
CAMPAIGN = """
[campaign]
aircraft = "espaaro"
mission = "loiter"
seed = 3
[aleatory]
flights = 2
duration_s = 6
burn_in_s = 2
turbulence = "light"
[epistemic]
method = "corners"
coefficients = ["CX", "Cl"]
"""


def with_two(airframe: Airframe, x, u):
    """An axial force from sideslip squared besides the pitching moment from roll rate squared."""
    out = with_p2(airframe, x, u)
    V = float(np.linalg.norm(x[:3]))
    qS = 0.5 * 1.225 * (1.0 - 2.25577e-5 * -x[11]) ** 4.25588 * V**2 * airframe.S
    out[0] += qS * CX_BETA2 * np.arcsin(x[1] / V) ** 2 / airframe.m
    return out


@pytest.fixture(scope="module")
def campaign(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("campaign") / "campaign.toml"
    path.write_text(CAMPAIGN, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def judged_flights(tmp_path_factory) -> tuple[Path, Refinement]:
    """Two effects in the train flights, of which the test flight has the first alone."""
    folder = tmp_path_factory.mktemp("contradicted")
    fly(MORE, seed=11, seconds=6.0, rhs=with_two).write(folder / "train.parquet")
    fly(TEST, seed=12, seconds=6.0, rhs=with_p2).write(folder / "test.parquet")
    out = folder / "out"
    out.mkdir()
    request = Request(
        find_aircraft("espaaro"), (folder / "train.parquet",), (folder / "test.parquet",), out, workers=1, pbox=False
    )
    done = refine(request)
    write_report(done, out)
    return out, done


@pytest.fixture(scope="module")
def contradicted(judged_flights) -> Path:
    return judged_flights[0]


def names(rows) -> list[tuple[str, str]]:
    return [(e["coefficient"], e["term"]) for e in rows]


def test_what_the_test_flights_speak_against_is_withdrawn_alone(contradicted):
    found = document(contradicted)
    assert set(names(found["chosen"])) == {("Cm", "p_hat^2"), ("CX", "beta^2")}
    assert names(found["effects"]) == [("Cm", "p_hat^2")]
    assert names(found["withdrawn"]) == [("CX", "beta^2")]
    assert found["effects"][0]["test"]["gap"] == "shrank"
    assert found["withdrawn"][0]["test"]["gap"] == "grew"
    assert found["effects"][0]["value"] == pytest.approx(3.0, abs=0.5)


def test_the_aircraft_carries_what_stands(contradicted):
    found = document(contradicted)
    xml = (contradicted / found["model"]).read_text(encoding="utf-8")
    assert "aero/Cm_p2" in xml
    assert "aero/CX_beta2" not in xml
    assert [s["property"] for s in found["switch"]] == ["aero/Cm_p2"]
    page = (contradicted / "report.html").read_text(encoding="utf-8")
    assert "Withdrawn:" in page
    gap = found["gap"]["test"]["channels"]["q_radps"]
    assert gap["rms_after"] < 0.8 * gap["rms_before"]


def test_choice_is_that_of_the_train_flights(contradicted):
    """What was chosen carries nothing of the test flights; each effect's own number stands there as chosen."""
    for e in document(contradicted)["chosen"]:
        assert "test" not in e
        assert abs(e["evidence"]["t"]) > 4.0


def test_leaving_nothing_out_is_what_was_chosen(judged_flights):
    """The linear estimate beside which one is left out is the choice itself; leaving all out is the model without effects."""
    chosen = judged_flights[1].chosen
    evidence = refine_judge.evidence_of(chosen, None)
    same = refine_judge.left_out(chosen, evidence, [])
    for one, other in zip(chosen.selection.chosen, same.selection.chosen, strict=True):
        assert (one.key, one.value, one.std) == (other.key, pytest.approx(other.value), pytest.approx(other.std))
    for name, (value, std) in chosen.parameters.items():
        assert abs(same.parameters[name][0] - value) < 0.1 * std
    none = refine_judge.left_out(chosen, evidence, [c.key for c in chosen.selection.chosen])
    assert {n: v for n, (v, _) in none.parameters.items()} == {n: chosen.plain[n] for n in chosen.names}


def shown(white: list[np.ndarray], deviation: float = 1.0) -> SimpleNamespace:
    """Predictions with the same deviation of every sample."""
    logdet = tuple(w.size * float(np.log(deviation)) for w in white)
    cost = float(sum(np.nansum(w**2) for w in white))
    return SimpleNamespace(white=white, cost=cost, logdet=logdet, surprise=cost + 2.0 * sum(logdet))


def change(rng: np.random.Generator, size: float, truth: bool, colour: float = 0.0):
    """gap_change of an effect of ``size`` standard deviations on one of three channels, in the flights or not."""
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    without, with_ = [], []
    for _ in range(4):
        noise = rng.standard_normal((300, 3))
        for k in range(1, 300 if colour else 0):
            noise[k] = colour * noise[k - 1] + np.sqrt(1.0 - colour**2) * noise[k]
        d = np.zeros((300, 3))
        d[:, 1] = size * np.sin(np.arange(300) / 20.0)
        without.append(noise + d if truth else noise)
        with_.append(noise if truth else noise - d)
    return gap_change("x", shown(without), shown(with_), setup, shown([rng.standard_normal((300, 3))]))


def test_standard_error_of_the_change_is_that_of_the_draws():
    """White noise has it in closed form: mean sum(d^2), variance 4 sum(d^2); coloured noise is judged by its spread."""
    rng = np.random.default_rng(0)
    square = 4.0 * float(np.sum((0.2 * np.sin(np.arange(300) / 20.0)) ** 2))
    for colour in (0.0, 0.8):
        found = [change(rng, 0.2, True, colour) for _ in range(200)]
        spread = np.std([f.change for f in found])
        assert np.mean([f.change for f in found]) == pytest.approx(square, abs=4.0 * spread / np.sqrt(200.0))
        assert np.sqrt(np.mean([f.std**2 for f in found])) == pytest.approx(spread, rel=0.3)
        if not colour:
            assert spread == pytest.approx(2.0 * np.sqrt(square), rel=0.2)


def test_chance_withdraws_seldom_and_a_contradiction_does():
    rng = np.random.default_rng(1)
    weak = [change(rng, 0.02, True) for _ in range(300)]
    assert np.mean([v.says == "grew" for v in weak]) < 0.1
    assert np.mean([v.says == "cannot tell" for v in weak]) > 0.7
    # Of an effect that the flights would show at |t| = 2.4, the sign decides: right eight times in nine, either way.
    for truth, says in ((True, "grew"), (False, "grew")):
        found = [change(rng, 0.1, truth) for _ in range(300)]
        assert np.mean([v.expected for v in found]) == pytest.approx(6.0, rel=0.1)
        assert np.mean([v.says == says for v in found]) == pytest.approx(0.11 if truth else 0.89, abs=0.08)
    assert all(change(rng, 0.5, True).says == "shrank" for _ in range(20))
    assert all(change(rng, 0.5, False).says == "grew" for _ in range(20))


def test_predictions_of_another_damping_are_judged_by_their_likelihood():
    """A model that damps too little takes the air's motion for larger, and its squares over that are smaller: no merit of it."""
    rng = np.random.default_rng(4)
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    found = []
    for _ in range(100):
        left = [rng.standard_normal((300, 3)) for _ in range(4)]
        wide = shown([e / 1.1 for e in left], 1.1)
        found.append(gap_change("x", wide, shown(left), setup, shown(left)))
        assert wide.cost < shown(left).cost
    # Kullback and Leibler's distance of the two normal distributions, twice, of 3600 samples.
    expected = 3600.0 * (2.0 * np.log(1.1) + 1.0 / 1.1**2 - 1.0)
    spread = np.std([v.change for v in found])
    assert np.mean([v.change for v in found]) == pytest.approx(expected, abs=0.4 * spread)
    assert 0.9 * spread < np.sqrt(np.mean([v.std**2 for v in found])) < 1.5 * spread
    assert np.mean([v.says == "shrank" for v in found]) > 0.9


def judged(monkeypatch, harm: dict[str, float], together: float = 0.0) -> list[str]:
    """Effects that stand after `judge`, the order of withdrawal before them; an effect of ``harm`` raises the cost, and so does
    ``together`` where two or more are in."""
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((400, 2))
    wave = [np.sin(np.arange(400) / (9.0 + k)) for k in range(len(harm) + 1)]

    def flown(model, setup, *_) -> SimpleNamespace:
        white = noise.copy()
        for k, (key, size) in enumerate(harm.items()):
            white[:, 0] += (size if key in model and size > 0.0 else -size if key not in model and size < 0.0 else 0.0) * wave[k]
        white[:, 1] += (together if len(model) > 1 else 0.0) * wave[-1]
        return shown([white])

    def without(found, keys):
        return replace(found, selection=replace(found.selection, chosen=tuple(
            c for c in found.selection.chosen if c.key not in keys)))  # fmt: skip

    chosen = tuple(Choice(k, 1.0, 0.1, 10.0, 100.0, 1.0, 0.0) for k in harm)
    effects = {k: Effect("Cm", None, k, k, k) for k in harm}
    found = Found(None, (), None, None, Selection(chosen), effects, {}, ())  # type: ignore[arg-type]
    monkeypatch.setattr(refine_judge, "show", flown)
    monkeypatch.setattr(refine_judge, "evidence_of", lambda *_: None)
    monkeypatch.setattr(refine_judge, "left_out", lambda found, _, keys: without(found, keys))
    monkeypatch.setattr(refine_judge, "bare", lambda found: without(found, list(harm)))
    side = refine_judge.Side(SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)]), (), ())  # type: ignore[arg-type]
    done = refine_judge.judge(found, lambda f: [c.key for c in f.selection.chosen], side, side, map)  # type: ignore
    return [*(c.key for c in done.withdrawn), "|", *(c.key for c in done.found.selection.chosen)]


def test_the_worst_goes_first_and_what_helps_stays(monkeypatch):
    assert judged(monkeypatch, {"alpha": -0.6, "alpha^2": 0.4, "alpha^3": 0.8}) == ["alpha^3", "alpha^2", "|", "alpha"]
    assert judged(monkeypatch, {"alpha": -0.6, "beta": -0.5}) == ["|", "alpha", "beta"]


def test_nothing_stands_where_nothing_helps(monkeypatch):
    assert judged(monkeypatch, {"alpha": 0.6}) == ["alpha", "|"]
    assert judged(monkeypatch, {"alpha": 0.3, "beta": 0.9}) == ["beta", "alpha", "|"]


def test_effects_that_harm_together_alone_do_not_all_stand(monkeypatch):
    """With three, leaving any one out leaves two, which are in each other's way as much: none goes for itself."""
    assert judged(monkeypatch, {"alpha": 0.0, "beta": 0.0, "p_hat": 0.0}, 0.8).index("|") == 2


def test_what_changes_nothing_is_not_said_to_grow():
    white = [np.ones((50, 2))] * 4
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    verdict = gap_change("x", shown(white), shown(white), setup, shown(white))
    assert (verdict.change, verdict.std, verdict.says) == (0.0, 0.0, "cannot tell")
    assert BEYOND_CHANCE > 1.0


def test_flights_far_from_both_models_judge_neither():
    """Six times the noise in every sample: the same difference that grew the gap in sound flights tells nothing there."""
    rng = np.random.default_rng(2)
    noise, d = rng.standard_normal((400, 2)), np.full((400, 2), 0.8)
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)])
    sound = gap_change("x", shown([noise]), shown([noise + d]), setup, shown([noise]))
    broken = gap_change("x", shown([noise - 6.0 * d / 0.8]), shown([noise - 7.0 * d / 0.8]), setup, shown([noise]))
    assert (sound.says, broken.says) == ("grew", "too far")
    assert broken.far == pytest.approx(6.0, rel=0.1)
    assert broken.z < -BEYOND_CHANCE


def test_without_an_effect_before_is_after(tmp_path, campaign, capsys):
    """Nothing is missing: one model, so intervals and p-box are the same before and after, number for number."""
    fly(TRAIN[:2], seed=3, seconds=6.0).write(tmp_path / "train.parquet")
    fly(TEST, seed=4, seconds=6.0).write(tmp_path / "test.parquet")
    # What an earlier refinement, with an effect, left there.
    for stale in ("before/aircraft/espaaro/espaaro.xml", "pbox/after/manifest.json", "intervals/after.json", "figures/history.svg"):
        (tmp_path / "out" / stale).parent.mkdir(parents=True)
        (tmp_path / "out" / stale).touch()
    code = main([
        "refine", "espaaro", "--train", str(tmp_path / "train.parquet"), "--test", str(tmp_path / "test.parquet"),
        "--out", str(tmp_path / "out"), "--workers", "1", "--no-figures", "--campaign", str(campaign),
    ])  # fmt: skip
    found = document(tmp_path / "out")
    assert (code, found["effects"], found["withdrawn"], found["chosen"]) == (0, [], [], [])
    left = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert not [name for name in left if "after" in name or name.startswith("before/") or "history" in name]
    gap = found["gap"]["test"]
    assert gap["intervals"]["reason"] is None
    for row in gap["intervals"]["coefficients"].values():
        assert row["width_before"] == row["width_after"] > 0.0
        assert row["coverage_before"] == row["coverage_after"] > 0.5
    pbox = gap["pbox"]
    assert pbox["reason"] is None
    assert (pbox["corners"], pbox["before"]["flights"], pbox["before"]["failed"]) == (4, 8, 0)
    assert pbox["before"] == pbox["after"]
    assert {"cross_track_median_m", "altitude_median_m"} <= {r["metric"] for r in pbox["metrics"]}
    for row in pbox["metrics"]:
        assert row["width_before"] == row["width_after"] >= 0.0
        assert all(q["before"] == q["after"] for q in row["quantiles"].values())
    assert "p-box: none" not in capsys.readouterr().out


def test_a_mission_is_flown_by_aircraft_that_have_one(tmp_path, campaign):
    assert campaign_for(find_aircraft("espaaro"), None)["campaign"]["mission"].endswith("loiter.xml")
    with pytest.raises(BadInputError, match=r"no loiter of its own.*--campaign"):
        campaign_for(find_aircraft("c172x"), None)
    given = campaign_for(find_aircraft("c172x"), campaign)
    assert Path(given["campaign"]["mission"]).is_file()
    nothing = tmp_path / "none.toml"
    nothing.write_text(CAMPAIGN.replace('"corners"', '"none"').replace('coefficients = ["CX", "Cl"]', ""), encoding="utf-8")
    with pytest.raises(BadInputError, match="flies no intervals"):
        campaign_for(find_aircraft("espaaro"), nothing)


def test_intervals_shrink_where_the_effect_was_and_still_cover(contradicted):
    intervals = document(contradicted)["gap"]["test"]["intervals"]
    cm, cy = intervals["coefficients"]["Cm"], intervals["coefficients"]["CY"]
    assert cm["width_after"] < 0.9 * cm["width_before"]
    assert cm["coverage_after"] > 0.8
    assert cy["width_after"] == pytest.approx(cy["width_before"], rel=0.1)
    assert json.loads((contradicted / "intervals" / "after.json").read_text())["format"] == "model-form 1"
    assert document(contradicted)["gap"]["test"]["pbox"] == {"reason": "left out (--no-pbox)", "metrics": []}


def test_intervals_that_cannot_be_told_have_a_reason(tmp_path):
    """Without sideslip there is no residual coefficient: NaN, the reason, and no error."""
    record = fly(TEST, seed=4, seconds=6.0)
    record.write(tmp_path / "whole.parquet")
    type(record)({c: record[c] for c in record.columns if c != "beta_rad"}, record.metadata).write(tmp_path / "part.parquet")
    aircraft = find_aircraft("espaaro")
    sets = []
    for name in ("whole", "part"):
        flights, measured = read_flights([tmp_path / f"{name}.parquet"], aircraft)
        sets.append(FlightSet(tuple(flights), tuple(measured), (name,)))
    found = fit_intervals(IntervalJob(aircraft, sets[1], sets[0], False))
    assert found.form is None
    assert "beta_rad" in str(found.reason)
    told = intervals_document(found, found)
    assert np.isnan([v for row in told["coefficients"].values() for v in row.values()]).all()
    assert told["reason"] == found.reason


def test_pbox_numbers_in_closed_form():
    """Two corners, one of them 1 to 4 and the other 3 to 6: envelopes two apart, area 2, medians [2, 4]."""
    low, high = (Sample(str(k), np.arange(first, first + 4.0)) for k, first in enumerate((1.0, 3.0)))
    box = MissionPBox("cross_track_median_m", "calm", (low, high), (low,))
    assert box.width(box.before) == pytest.approx(2.0)
    assert box.width(box.after) == 0.0
    assert box.quantile(box.before, 0.5) == [2.0, 4.0]
    assert box.quantile(box.after, 0.5) == [2.0, 2.0]
    failed = replace(low, values=low.values[:3], unknown=1)
    assert np.isnan(box.quantile((failed,), 0.95)[1])


def test_a_mission_goes_on_and_another_model_flies_anew(tmp_path, campaign):
    told: list[str] = []
    form = tmp_path / "intervals" / "before.json"
    form.parent.mkdir()
    aircraft = find_aircraft("espaaro")
    flights, measured = read_flights([write(tmp_path, 5)], aircraft)
    given = FlightSet(tuple(flights), tuple(measured), ("x",))
    made = fit_intervals(IntervalJob(aircraft, given, given, False)).form
    assert made is not None
    form.write_text(made.to_json(), encoding="utf-8")

    def flown(which):
        result = fly_missions({"before": Model(which, form)}, campaign, tmp_path, 1, told.append)
        assert result.document["reason"] is None
        return result.document

    first = flown(aircraft)
    assert told
    told.clear()
    assert (flown(aircraft), told) == (first, [])
    form.write_text(replace(made, confidence=0.9).to_json(), encoding="utf-8")
    flown(aircraft)
    assert told


def write(folder: Path, seed: int) -> Path:
    path = folder / f"flight{seed}.parquet"
    fly(TRAIN[:2], seed=seed, seconds=6.0).write(path)
    return path


def test_words_agree_with_the_verdict():
    """Where no region stands out, an effect far above chance is not called noise."""
    remaining = {"unexplained": False, "where": [], "channels_above_noise": {}, "coloured_channels": []}
    nothing = {"effects": [], "withdrawn": [], "remaining": remaining}
    assert nowhere(nothing) == "nowhere beyond what noise allows"
    assert left_over(remaining) == []
    for one in (
        nothing | {"effects": [{"evidence": {"t": -64.2}}]},
        nothing | {"remaining": remaining | {"unexplained": True, "where": [{"t": 64.2, "words": "x"}]}},
    ):
        assert "|t| up to 64" in nowhere(one)
    unexplained = remaining | {"unexplained": True, "channels_above_noise": {"q_radps": 2.0}}
    assert "see what is left" in nowhere(nothing | {"remaining": unexplained})
    assert left_over(unexplained) == ["above their noise: q_radps (2.00 times)"]


def test_a_campaign_that_is_none_ends_before_a_flight_is_read(tmp_path, campaign, capsys):
    bad = tmp_path / "bad.toml"
    bad.write_text(CAMPAIGN.replace("flights = 2", "flights = 0"), encoding="utf-8")
    flight, other = write(tmp_path, 6), write(tmp_path, 7)
    arguments = ["refine", "espaaro", "--train", str(flight), "--test", str(other), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--campaign", str(bad)]) == 2
    assert "flights" in capsys.readouterr().err
    assert main([*arguments, "--campaign", str(campaign), "--no-pbox"]) == 2
    assert "--no-pbox" in capsys.readouterr().err


def test_engines_beside_the_aircraft_go_with_it(tmp_path):
    """An aircraft whose engines lie beside it finds them beside its refined copy as well."""
    made = shutil.copytree(find_aircraft("espaaro").folder, tmp_path / "own" / "aircraft" / "espaaro")
    (tmp_path / "own" / "engine").mkdir()
    (tmp_path / "own" / "engine" / "own.xml").write_text("<propeller/>", encoding="utf-8")
    given = find_aircraft(made)
    put = _put(given, given, tmp_path / "out")
    assert put.folder == tmp_path / "out" / "aircraft" / "espaaro"
    assert put.engine_path == tmp_path / "out" / "engine"
    assert (put.engine_path / "own.xml").is_file()
