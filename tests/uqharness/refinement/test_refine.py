"""`refine` from flights of the independent equations, as a user calls it: effects named and valued,
one that the test flight contradicts withdrawn, the aircraft written, intervals, pages and words."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.parallel import SERIAL
from sysid.record import FlightRecord
from tests.helpers import flown
from tests.helpers.flown import fly
from tests.helpers.page_checks import problems
from tests.helpers.report_folders import refinement
from tests.helpers.sixdof import Airframe, derivative
from tests.hidden_effects.flights import Flight as HiddenFlight
from tests.hidden_effects.flights import fly as fly_hidden
from tests.hidden_effects.manoeuvres import card
from uqharness.cli.main import main
from uqharness.commands.refinement import write_results
from uqharness.errors import BadInputError
from uqharness.identification.compare import compare
from uqharness.identification.linearised import ModelState, make_flight_data, with_card_noise
from uqharness.refinement import run as refine_run
from uqharness.refinement.estimators import Dataset, ReplayEstimator
from uqharness.refinement.evaluation import Evaluation, residual_tables, with_replays
from uqharness.refinement.hold_out import leave_out, train_information
from uqharness.refinement.mission import (
    FlightSet,
    IntervalJob,
    campaign_for,
    fit_intervals,
    fly_missions,
    intervals_document,
    pbox_pair,
)
from uqharness.refinement.residual_location import Nearest
from uqharness.refinement.run import Job, Refinement, _place, refine
from uqharness.replay.flights import prepare, read_flights
from uqharness.report.pages.refinement import no_region_words, remaining_words
from uqharness.report.write import write_report
from uqharness.requests.refinement import RefineRequest
from uqharness.results.refinement import Refinement as Refined
from uqharness.simulator.aircraft import find_aircraft
from uqharness.statistics.pbox import Sample

pytestmark = pytest.mark.usefixtures("flights_here")

TRAIN = (("pitch-3211", 22.0), ("roll-yaw", 22.0), ("yaw-roll", 20.0), ("roll-yaw", 19.0))
TEST = (("yaw-roll", 22.0),)
MORE = (*TRAIN, ("yaw-roll", 21.5), ("yaw-roll", 19.0), ("roll-yaw", 20.5))
CM_P2, CX_BETA2 = 3.0, -1.5
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


def with_terms(*, axial: bool):
    """The equations with a pitching moment from roll rate squared, and perhaps an axial force from
    sideslip squared, which the E-SPAARO's model lacks.
    """

    def rhs(airframe: Airframe, x, u):
        out = derivative(airframe, x, u)
        V = float(np.linalg.norm(x[:3]))
        qS = 0.5 * 1.225 * (1.0 - 2.25577e-5 * -x[11]) ** 4.25588 * V**2 * airframe.S
        out[4] += qS * airframe.c * CM_P2 * (x[3] * airframe.b / (2.0 * V)) ** 2 / airframe.Iyy
        out[0] += axial * qS * CX_BETA2 * np.arcsin(x[1] / V) ** 2 / airframe.m
        return out

    return rhs


def document(out: Path) -> dict:
    return json.loads((out / "refinement.json").read_text(encoding="utf-8"))


def command(train: Path, test: Path, out: Path, *more: str) -> int:
    """Exit code of `refine`."""
    words = ["refine", "espaaro", "--train", str(train), "--test", str(test), "--out", str(out)]
    return main([*words, "--workers", "1", *more])


@pytest.fixture(scope="module")
def campaign(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("campaign") / "campaign.toml"
    path.write_text(CAMPAIGN, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def flights(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("flights")
    records = {
        "train": fly(TRAIN[:2], seed=1, seconds=6.0, rhs=with_terms(axial=False)),
        "test": fly(TEST, seed=2, seconds=6.0, rhs=with_terms(axial=False)),
        "plain": fly(TRAIN[:2], seed=3, seconds=6.0),
        "plain_test": fly(TEST, seed=4, seconds=6.0),
    }
    test = records["test"]
    invalid = test["q_radps"] + 0.2 * np.sin(7.0 * test["time_s"])
    records["spoilt"] = test.with_columns({"q_radps": invalid})
    for name, record in records.items():
        record.write(folder / f"{name}.parquet")
    return {name: folder / f"{name}.parquet" for name in records}


@pytest.fixture(scope="module")
def refined(flights, tmp_path_factory) -> Path:
    """Killed while it fits intervals, with a test flight of which every sample is wrong; then run
    to its end with the right one, without a search.
    """
    out = tmp_path_factory.mktemp("refined")
    killed, search = {"fit_intervals": KeyboardInterrupt}, {"find_effects": AssertionError}
    for test, changes, code in (("spoilt", killed, 130), ("test", search, 0)):
        with pytest.MonkeyPatch.context() as patch:
            for name, error in changes.items():
                patch.setattr(refine_run, name, lambda *_, e=error: (_ for _ in ()).throw(e))
            assert command(flights["train"], flights[test], out, "--no-pbox") == code
        if code:
            assert not (out / "refinement.json").exists()
            assert list((out / ".stages").glob("effects-*.data"))
    return out


def names(rows) -> list[tuple[str, str]]:
    return [(e["coefficient"], e["term"]) for e in rows]


def test_the_missing_effect_is_named_and_valued(refined):
    result = document(refined)
    assert result["verdict"] == "effects-found"
    (effect,) = result["effects"]
    assert (effect["coefficient"], effect["term"]) == ("Cm", "p_hat^2")
    assert effect["property"] == "aero/Cm_p2"
    assert effect["name"] == "pitching moment due to roll rate squared"
    assert abs(effect["value"] - CM_P2) < 3.0 * effect["std"] < 0.3 * CM_P2
    assert effect["test"]["gap"] == "shrank"
    assert not result["remaining"]["unexplained"]
    assert result["gap"]["test"]["predictions"] == result["gap"]["train"]["predictions"] == {}
    assert not (refined / ".stages").exists()


def test_regions_of_disagreement_begin_with_the_effect(refined):
    first = document(refined)["disagreement"][0]
    assert first["coefficient"] == "Cm"
    assert first["share_outside_95"] > 0.25
    assert "Cm" in first["words"]


def test_the_gap_shrinks_and_the_aircraft_carries_the_effect(refined):
    result = document(refined)
    gap = result["gap"]["test"]
    assert gap["channels"]["q_radps"]["rms_before"] > 1.3 * gap["channels"]["q_radps"]["noise_rms"]
    assert gap["channels"]["q_radps"]["rms_after"] < 1.15 * gap["channels"]["q_radps"]["noise_rms"]
    assert gap["coefficients"]["Cm"]["rms_after"] < gap["coefficients"]["Cm"]["rms_before"]
    assert "aero/Cm_p2" in (refined / result["model"]).read_text(encoding="utf-8")
    assert "+      " in (refined / "model.diff").read_text(encoding="utf-8")
    assert result["switch"] == [{"property": "aero/Cm_p2", "off": 0.0}]
    for name in ("gap", "candidates", "coefficients"):
        assert (refined / f"figures/{name}.svg").stat().st_size > 1000
    assert problems((refined / "report.html").read_text(encoding="utf-8")) == []


def test_nothing_is_found_where_nothing_is_missing(flights, tmp_path, capsys):
    out = tmp_path / "out"
    more = ("--no-figures", "--no-pbox", "--json")
    code = command(flights["plain"], flights["plain_test"], out, *more)
    result = json.loads(capsys.readouterr().out)
    assert (code, result["verdict"], result["effects"]) == (0, "no-missing-effect", [])
    q = result["gap"]["test"]["channels"]["q_radps"]
    assert q["rms_after"] < 1.15 * q["noise_rms"]


def test_bad_input_ends_with_a_reason(flights, tmp_path, capsys, campaign):
    with pytest.raises(SystemExit) as stopped:
        main(["refine", "--help"])
    assert stopped.value.code == 0
    copy, effects_file, invalid = (
        tmp_path / n for n in ("renamed.parquet", "own.toml", "bad.toml")
    )
    copy.write_bytes(flights["train"].read_bytes())
    effects_file.write_text('[[effect]]\ncoefficient = "Cm"\nterm = "x"\n', encoding="utf-8")
    invalid.write_text(CAMPAIGN.replace("flights = 2", "flights = 0"), encoding="utf-8")
    for test, more, words in (
        (copy, (), "must not be"),
        (flights["test"], ("--effects", str(effects_file)), "is no factor"),
        (flights["test"], ("--campaign", str(invalid)), "flights"),
        (flights["test"], ("--campaign", str(campaign), "--no-pbox"), "--no-pbox"),
    ):
        capsys.readouterr()
        assert command(flights["train"], test, tmp_path / "o", *more) == 2
        assert words in capsys.readouterr().err


@pytest.fixture(scope="module")
def judged_flights(tmp_path_factory) -> tuple[Path, Refinement]:
    """Two effects in the train flights, of which the test flight has the first alone."""
    folder = tmp_path_factory.mktemp("contradicted")
    train, test, out = folder / "train.parquet", folder / "test.parquet", folder / "out"
    fly(MORE, seed=11, seconds=6.0, rhs=with_terms(axial=True)).write(train)
    fly(TEST, seed=12, seconds=6.0, rhs=with_terms(axial=False)).write(test)
    out.mkdir()
    options = RefineRequest(
        aircraft="espaaro", train=(train,), test=(test,), out=out, workers=1, pbox=False
    )
    done = refine(Job(options, find_aircraft("espaaro"), (train,), (test,)))
    write_results(done, out)
    write_report(out, figures=True)
    return out, done


@pytest.mark.slow
def test_what_the_test_flights_contradict_is_withdrawn_alone(judged_flights):
    out, result = judged_flights[0], document(judged_flights[0])
    assert set(names(result["chosen"])) == {("Cm", "p_hat^2"), ("CX", "beta^2")}
    (effect,), (withdrawn,) = result["effects"], result["withdrawn"]
    assert (effect["term"], withdrawn["term"]) == ("p_hat^2", "beta^2")
    assert effect["value"] == pytest.approx(CM_P2, abs=0.5)
    assert (effect["test"]["gap"], withdrawn["test"]["gap"]) == ("shrank", "grew")
    # What was chosen has nothing of the test flights.
    assert all("test" not in e and abs(e["evidence"]["t"]) > 4.0 for e in result["chosen"])
    xml = (out / result["model"]).read_text(encoding="utf-8")
    assert "aero/Cm_p2" in xml
    assert "aero/CX_beta2" not in xml
    assert "Withdrawn:" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_leaving_nothing_out_is_what_was_chosen(judged_flights):
    """The linear estimate beside which one is left out is the choice itself; leaving all out is the
    model without effects.
    """
    chosen = judged_flights[1].chosen
    evidence = train_information(chosen)
    same = leave_out(chosen, evidence, [])
    for one, other in zip(chosen.selection.chosen, same.selection.chosen, strict=True):
        assert (one.key, one.value, one.std) == (
            other.key,
            pytest.approx(other.value),
            pytest.approx(other.std),
        )
    for name, (value, std) in chosen.parameters.items():
        assert abs(same.parameters[name][0] - value) < 0.1 * std
    none = leave_out(chosen, evidence, [c.key for c in chosen.selection.chosen])
    assert {n: v for n, (v, _) in none.parameters.items()} == {
        n: chosen.values_without_effects[n] for n in chosen.names
    }


@pytest.mark.slow
def test_without_an_effect_before_is_after(tmp_path, campaign, capsys):
    """Nothing is missing: one model, so intervals and p-box are the same before and after, number
    for number.
    """
    fly(TRAIN[:2], seed=3, seconds=6.0).write(tmp_path / "train.parquet")
    fly(TEST, seed=4, seconds=6.0).write(tmp_path / "test.parquet")
    # What an earlier refinement, with an effect, left there.
    for stale in (
        "before/aircraft/espaaro/espaaro.xml",
        "pbox/after/manifest.json",
        "intervals/after.json",
        "figures/history.svg",
    ):
        (tmp_path / "out" / stale).parent.mkdir(parents=True)
        (tmp_path / "out" / stale).touch()
    parts = (tmp_path / "train.parquet", tmp_path / "test.parquet", tmp_path / "out")
    code = command(*parts, "--no-figures", "--campaign", str(campaign))
    result = document(tmp_path / "out")
    assert (code, result["effects"], result["withdrawn"], result["chosen"]) == (0, [], [], [])
    remaining = {
        p.relative_to(tmp_path / "out").as_posix()
        for p in (tmp_path / "out").rglob("*")
        if p.is_file()
    }
    assert not [
        name
        for name in remaining
        if "after" in name or name.startswith("before/") or "history" in name
    ]
    gap = result["gap"]["test"]
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
    assert campaign_for(find_aircraft("espaaro"), None)["campaign"]["mission"].endswith(
        "loiter.xml"
    )
    with pytest.raises(BadInputError, match=r"has no loiter.*--campaign"):
        campaign_for(find_aircraft("c172x"), None)
    inputs = campaign_for(find_aircraft("c172x"), campaign)
    assert Path(inputs["campaign"]["mission"]).is_file()
    empty = tmp_path / "none.toml"
    empty.write_text(
        CAMPAIGN.replace('"corners"', '"none"').replace('coefficients = ["CX", "Cl"]', ""),
        encoding="utf-8",
    )
    with pytest.raises(BadInputError, match="ignores the intervals"):
        campaign_for(find_aircraft("espaaro"), empty)


@pytest.mark.slow
def test_intervals_shrink_where_the_effect_was_and_still_cover(judged_flights):
    refined = judged_flights[0]
    intervals = document(refined)["gap"]["test"]["intervals"]
    cm, cy = intervals["coefficients"]["Cm"], intervals["coefficients"]["CY"]
    assert cm["width_after"] < 0.9 * cm["width_before"]
    assert cm["coverage_after"] > 0.8
    assert cy["width_after"] == pytest.approx(cy["width_before"], rel=0.2)
    assert (
        json.loads((refined / "intervals" / "after.json").read_text())["format"] == "model-form 2"
    )
    assert document(refined)["gap"]["test"]["pbox"] == {
        "reason": "omitted (--no-pbox)",
        "metrics": [],
    }


def test_intervals_that_cannot_be_told_have_a_reason(tmp_path):
    """Without sideslip there is no residual coefficient: NaN, the reason, and no error."""
    record = fly(TEST, seed=4, seconds=6.0)
    record.write(tmp_path / "whole.parquet")
    type(record)({c: record[c] for c in record.columns if c != "beta_rad"}, record.metadata).write(
        tmp_path / "part.parquet"
    )
    aircraft = find_aircraft("espaaro")
    sets = []
    for name in ("whole", "part"):
        flights, measured = read_flights([tmp_path / f"{name}.parquet"], aircraft)
        sets.append(FlightSet(tuple(flights), tuple(measured), (name,)))
    result = fit_intervals(IntervalJob(aircraft, aircraft, {}, sets[1], sets[0], False))
    assert result.form is None
    assert "beta_rad" in str(result.reason)
    reports = intervals_document(result, result)
    assert {v for row in reports.coefficients.values() for v in row.as_json().values()} == {None}
    assert reports["reason"] == result.reason


def test_pbox_numbers_in_closed_form():
    """Two corners, one of them 1 to 4 and the other 3 to 6: envelopes two apart, area 2, medians
    [2, 4].
    """
    low, high = (
        Sample(str(k), np.arange(first, first + 4.0)) for k, first in enumerate((1.0, 3.0))
    )
    result = pbox_pair((low, high), (low,))
    assert result["width_before"] == pytest.approx(2.0)
    assert result["width_after"] == 0.0
    assert result["quantiles"]["0.5"] == {"before": [2.0, 4.0], "after": [2.0, 2.0]}
    failed = replace(low, values=low.values[:3], unknown=1)
    assert np.isnan(pbox_pair((low, high), (failed,))["quantiles"]["0.95"]["after"][1])


@pytest.mark.slow
def test_a_mission_goes_on_and_another_model_flies_anew(flights, tmp_path, campaign):
    reports: list[str] = []
    form = tmp_path / "intervals" / "before.json"
    form.parent.mkdir()
    aircraft = find_aircraft("espaaro")
    read, measured = read_flights([flights["plain"]], aircraft)
    inputs = FlightSet(tuple(read), tuple(measured), ("x",))
    output = fit_intervals(IntervalJob(aircraft, aircraft, {}, inputs, inputs, False)).form
    assert output is not None
    form.write_text(output.to_json(), encoding="utf-8")

    def trajectory(index):
        result = fly_missions(
            {"before": index}, {"before": form}, campaign, tmp_path, 1, reports.append
        )
        assert result["reason"] is None
        return result

    first = trajectory(aircraft)
    assert reports
    reports.clear()
    assert (trajectory(aircraft), reports) == (first, [])
    form.write_text(replace(output, confidence=0.9).to_json(), encoding="utf-8")
    trajectory(aircraft)
    assert reports


def test_words_agree_with_the_verdict():
    """Where no region stands out, an effect far above chance is not called noise."""
    remaining = refinement()["remaining"]
    effects = {"effects": [], "withdrawn": []}
    empty = Refined.model_validate(refinement(**effects))
    assert no_region_words(empty) == "no residual beyond the noise"
    assert remaining_words(empty.remaining) == []
    strong = refinement()["effects"][0] | {"evidence": {"t": -64.2}}
    remainder = remaining | {"unexplained": True, "where": [{"t": 64.2, "words": "x"}]}
    for one in (effects | {"effects": [strong]}, effects | {"remaining": remainder}):
        assert "|t| up to 64" in no_region_words(Refined.model_validate(refinement(**one)))
    unexplained = remaining | {"unexplained": True, "channels_above_noise": {"q_radps": 2.0}}
    complete = Refined.model_validate(refinement(**effects, remaining=unexplained))
    assert "see the remaining residuals" in no_region_words(complete)
    assert remaining_words(complete.remaining) == ["above their noise: q_radps (2.00 times)"]


def test_engines_beside_the_aircraft_go_with_it(tmp_path):
    """An aircraft whose engines lie beside it finds them beside its refined copy as well."""
    result = shutil.copytree(
        find_aircraft("espaaro").folder, tmp_path / "own" / "aircraft" / "espaaro"
    )
    (tmp_path / "own" / "engine").mkdir()
    for name in ("own", "unused"):
        (tmp_path / "own" / "engine" / f"{name}.xml").write_text("<propeller/>", encoding="utf-8")
    xml = result / "espaaro.xml"
    used = '<propulsion><engine file="own"/></propulsion></fdm_config>'
    xml.write_text(xml.read_text(encoding="utf-8").replace("</fdm_config>", used), encoding="utf-8")
    inputs = find_aircraft(result)
    write = _place(inputs, inputs, tmp_path / "out")
    assert write.folder == tmp_path / "out" / "aircraft" / "espaaro"
    assert write.engine_path == tmp_path / "out" / "engine"
    assert [path.name for path in write.engine_path.iterdir()] == ["own.xml"]


@pytest.mark.slow
def test_the_hidden_effect_is_among_the_nearest_and_leaves_the_noise(judged_flights):
    """The axial force that the train flights hold, withdrawn: its candidate brings the channel to
    the noise, others do not.
    """
    nearest = Nearest(judged_flights[1].hold_out.result)
    channel, hidden = "ax_mps2", "effect/CX/beta^2"
    candidates, current = nearest.leaving(channel, set())
    leaves = {key: remaining for key, _, remaining in candidates}
    t = {key: t for key, t, _ in candidates}
    assert abs(t[hidden]) > 10.0
    assert current > 1.1
    assert leaves[hidden] == pytest.approx(1.0, abs=0.08)
    assert all(remaining > 1.1 for key, remaining in leaves.items() if key != hidden)
    assert hidden not in [key for key, _, _ in nearest.leaving(channel, {hidden})[0]]


@pytest.mark.slow
def test_what_is_left_has_a_place_where_the_force_acts(judged_flights):
    place = judged_flights[1].document.remaining.place
    assert place.channel is not None
    assert place.would_tell
    assert len(place.candidates) == 3


@pytest.fixture(scope="module")
def gusty():
    """A manoeuvre of 11 s in turbulence, ready for replay."""
    (record,) = fly_hidden([HiddenFlight(card(3, 22.0, seconds=11.0, w20_kt=12.0), Airframe())])
    return prepare("f", record, ())


@pytest.mark.slow
def test_in_turbulence_the_table_is_that_of_compare(gusty):
    """The same replays from the same start states: far above the noise, and the same multiple of it
    in each channel.
    """
    aircraft = find_aircraft("espaaro")
    data = with_card_noise(aircraft, make_flight_data(aircraft, [gusty], ()))
    zeros = [np.zeros_like(z) for z in data.measured]
    predicted = Evaluation(
        None, zeros, data.noise, zeros, 0.0, (0.0,), [np.ones((9, 6))], np.ones(6)
    )  # type: ignore[arg-type]
    visible = with_replays(predicted, aircraft, Dataset(data), SERIAL, ModelState({}, {}, ()))
    result = residual_tables(data, visible, visible)
    other = compare(aircraft, gusty, (), workers=1)
    ratios = {c: row["rms_after"] / row["noise_rms"] for c, row in result["channels"].items()}
    assert max(ratios.values()) > 1.5
    for channel, ratio in ratios.items():
        assert ratio == pytest.approx(other.channels[channel].ratio, rel=0.02), channel
    assert result["predictions"].keys() == result["channels"].keys()
    assert all(row["rms_after"] == 0.0 for row in result["predictions"].values())
    assert visible.residual is predicted.residual


def test_tables_speak_of_the_noise_that_compare_knows_but_for_what_an_estimator_computed():
    rng = np.random.default_rng(2)
    card = SimpleNamespace(
        card=SimpleNamespace(
            sensors=SimpleNamespace(noise_std={"p_radps": 0.004, "alpha_rad": 0.002})
        )
    )
    flights = [
        SimpleNamespace(record=SimpleNamespace(metadata=SimpleNamespace(estimates=("alpha_rad",))))
    ]
    louder = np.array([0.01, 0.002]) * rng.standard_normal((4000, 2))
    # The fit found other noise in other flights.
    data = SimpleNamespace(
        measured=(louder,),
        outputs=("p_radps", "alpha_rad"),
        noise=np.array([0.013, 0.05]),
        flights=flights,
    )
    assert ReplayEstimator().evaluation_noise(card, data) == pytest.approx([0.01, 0.05], rel=0.05)
    calm = SimpleNamespace(
        measured=(0.1 * louder,),
        outputs=data.outputs,
        noise=np.array([0.001, 0.05]),
        flights=flights,
    )
    assert ReplayEstimator().evaluation_noise(card, calm)[0] == 0.004


def commands_alone(record: FlightRecord) -> FlightRecord:
    """The record without positions of surfaces: servos are the model's."""
    return FlightRecord(
        {c: record[c] for c in record.columns if not c.endswith("_pos_deg")}, record.metadata
    )


def one_sample_late(record: FlightRecord) -> FlightRecord:
    """The record as it would be had the commands' clock been a sample ahead: every command acts a
    row later than it says.
    """
    names = ("elevator_deg", "aileron_deg", "rudder_deg", "throttle_pct")
    record = commands_alone(record)
    return record.with_columns({c: np.append(record[c][1:], record[c][-1]) for c in names})


@pytest.mark.slow
def test_a_record_one_sample_late_is_a_matter_of_its_clock(tmp_path):
    """It imitates a lag in every servo; the time is told, put right and no effect is added."""
    late = {"train": fly(TRAIN, seed=7, seconds=6.0), "test": fly(TEST, seed=8, seconds=6.0)}
    for name, record in late.items():
        one_sample_late(record).write(tmp_path / f"{name}.parquet")
    command(
        tmp_path / "train.parquet",
        tmp_path / "test.parquet",
        tmp_path / "out",
        "--no-figures",
        "--no-pbox",
    )
    result = document(tmp_path / "out")
    assert result["timing"]["controls_late_s"] == pytest.approx(0.02, abs=0.004)
    assert (result["verdict"], result["effects"]) == ("no-missing-effect", [])
    assert "clock, not a servo" in result["notes"][0]


@pytest.mark.slow
def test_a_slow_servo_is_no_matter_of_the_clock(tmp_path, monkeypatch):
    """A lag of the elevator alone is named as that."""

    monkeypatch.setattr(flown, "LAG", np.array([16.0, 25.0, 25.0, 6.0]))
    output = {
        "train": fly(TRAIN, seed=5, seconds=6.0),
        "test": fly((("pitch-3211", 20.0),), seed=6, seconds=6.0),
    }
    for name, record in output.items():
        commands_alone(record).write(tmp_path / f"{name}.parquet")
    command(
        tmp_path / "train.parquet",
        tmp_path / "test.parquet",
        tmp_path / "out",
        "--no-figures",
        "--no-pbox",
    )
    result = document(tmp_path / "out")
    assert result["timing"]["controls_late_s"] == 0.0
    assert [(e["subsystem"], e["term"]) for e in result["effects"]] == [
        ("actuator.elevator", "lag")
    ]
    assert abs(result["effects"][0]["value"] - 16.0) < 3.0 * result["effects"][0]["std"]
