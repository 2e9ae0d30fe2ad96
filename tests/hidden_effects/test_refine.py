"""Refine itself, asked a few of the examination's questions; the whole battery is a command
(docs/hidden-effects.md).
"""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from sysid.record import FlightRecord
from tests.helpers.sixdof import Airframe
from tests.hidden_effects import motion, sealed
from tests.hidden_effects.airframes import ROOT
from tests.hidden_effects.answers import canonical, contract_faults, judge
from tests.hidden_effects.cases import Case, battery, write
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card
from tests.hidden_effects.run import PLACEBO, ask
from uqharness.cli.main import main

KINDS = ("roll and yaw", "roll and pitch", "elevator 3-2-1-1")
CARDS = tuple(
    card(40 + i, V, seconds=33.0, kinds=KINDS, first=i) for i, V in enumerate((21.0, 24.0, 22.5))
)


def case(*effects: Effect) -> Case:
    return Case(
        " ".join(e.key for e in effects) or "nothing",
        "clear" if effects else "null",
        "calm",
        tuple(e.key for e in effects),
        effects,
        CARDS[:2],
        CARDS[2:],
    )


ROLL_RATE = case(Effect("Cm", "p_hat^2", 1.5))
NOTHING = case()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examination")
    (folder / "answers").mkdir()
    write([ROLL_RATE, NOTHING], folder / "flights")
    return sealed.seal(folder / "sealed", [folder / "answers"])


def refine(place, train, test, name, *more):
    out = place.parent / name
    arguments = [
        "refine",
        "espaaro",
        "--train",
        *map(str, train),
        "--test",
        *map(str, test),
        "--out",
        str(out),
        "--no-figures",
        "--no-pbox",
    ]
    done = sealed.run(place, ["-m", "uqharness.cli.main", *arguments, "--workers", "1", *more], 500)
    found = (
        json.loads((out / "refinement.json").read_text())
        if (out / "refinement.json").is_file()
        else {}
    )
    return done, found


@pytest.fixture(scope="module")
def answer(place):
    files = ROLL_RATE.files(place.parent / "flights")
    return refine(place, files["train"], files["test"], "answer")


@pytest.mark.slow
def test_the_dissertations_effect_is_named(answer):
    done, found = answer
    assert done.returncode == 0, done.stderr
    score = judge(ROLL_RATE, found, done.returncode)
    assert score.right, score
    assert score.spurious == 0
    assert score.faults == ()


@pytest.mark.slow
def test_what_is_the_same_on_the_data_stands_together(answer):
    done, found = answer
    assert judge(ROLL_RATE, found, done.returncode).together


@pytest.mark.slow
def test_a_placebo_is_left_alone(place, answer):
    files = ROLL_RATE.files(place.parent / "flights")
    done, found = refine(
        place,
        files["train"],
        files["test"],
        "placebo",
        "--effects",
        str(shutil.copy(PLACEBO, place)),
    )
    assert done.returncode == 0, done.stderr
    assert [canonical(e) for e in found["effects"]] == [canonical(e) for e in answer[1]["effects"]]


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is(place):
    files = NOTHING.files(place.parent / "flights")
    done, found = refine(place, files["train"], files["test"], "nothing")
    assert judge(NOTHING, found, done.returncode).right, (found, done.stderr)


@pytest.mark.slow
def test_sensors_noisier_than_stated_do_not_pass_for_gusts(place):
    """Twice Table 2.1's noise in light air: taken for gusts that do not turn, it left two effects
    of |t| above 10.
    """
    noisy = next(
        c for c in battery() if c.kind == "null" and c.air == "light" and c.train[0].noise == 2.0
    )
    write([noisy], place.parent / "flights")
    files = noisy.files(place.parent / "flights")
    done, found = refine(place, files["train"], files["test"], "noisy")
    assert judge(noisy, found, done.returncode).right, (found, done.stderr)
    assert [n for n in found["notes"] if "rotate the air and turn with the aircraft" in n]


def another_servo(folder, **lags):
    """The aircraft with other lags [1/s] of its actuators, None for none, no rate limit then."""
    out = shutil.copytree(ROOT / "aircraft" / "espaaro", folder / "espaaro")
    text = (out / "espaaro.xml").read_text(encoding="utf-8")
    for control, lag in lags.items():
        block = re.search(
            rf'<actuator name="fcs/{control}-pos-\w+">.*?</actuator>', text, re.DOTALL
        )[0]
        changed = re.sub(r"<lag>.*?</lag>", "" if lag is None else f"<lag>{lag:g}</lag>", block)
        if lag is None:
            changed = re.sub(r"<rate_limit>.*?</rate_limit>", "", changed)
        assert changed != block
        text = text.replace(block, changed)
    (out / "espaaro.xml").write_text(text, encoding="utf-8")
    return out


def refined(aircraft, cards_of, folder, w20_kt=0.0):
    """refinement.json of an aircraft and flights of the equations of motion, as a process in the
    project's folder.
    """
    flights = fly([Flight(replace(c, w20_kt=w20_kt), Airframe()) for c in cards_of])
    paths = [folder / f"{k}.parquet" for k in range(len(flights))]
    for record, path in zip(flights, paths, strict=True):
        record.write(path)
    out, (*train, test) = folder / "out", map(str, paths)
    arguments = [
        "refine",
        str(aircraft),
        "--train",
        *train,
        "--test",
        test,
        "--out",
        str(out),
        "--no-figures",
        "--no-pbox",
    ]
    assert main([*arguments, "--workers", "1"]) in (0, 1)
    return json.loads((out / "refinement.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_servos_that_act_at_once_leave_no_fault_in_turbulence(tmp_path, monkeypatch):
    """Rows are read before their commands go out.

    On one such flight an elevator's rate limit had |t| 42.
    """
    monkeypatch.setattr(motion, "LAG", (1e6,) * 4)
    monkeypatch.setattr(motion, "RATE", (1e9,) * 4)
    at_once = another_servo(tmp_path, elevator=None, aileron=None, rudder=None, throttle=None)
    found = refined(at_once, CARDS[:2], tmp_path, 14.0)
    assert (found["verdict"], found["effects"]) == ("no-missing-effect", [])
    assert any("one sample ahead" in note for note in found["notes"])
    assert max(abs(c["t"]) for c in found["candidates"]["scores"]) < found["candidates"]["limit"]


@pytest.mark.slow
@pytest.mark.parametrize("lag", [12.0, 60.0])
def test_a_servos_lag_in_the_xml_may_be_wrong_either_way(tmp_path, lag):
    found = refined(another_servo(tmp_path, elevator=lag), CARDS, tmp_path)
    (effect,) = found["effects"]
    assert (effect["subsystem"], effect["term"], found["verdict"]) == (
        "actuator.elevator",
        "lag",
        "effects-found",
    )
    assert effect["value"] == pytest.approx(25.0, abs=4.0 * effect["std"])
    assert effect["std"] < 2.0


@pytest.mark.slow
def test_a_rate_limit_in_the_xml_may_be_too_low(tmp_path):
    """The servo is never asked for as much as the 240 deg/s it has: what is told is that the limit
    in the XML is not there.
    """
    aircraft = another_servo(tmp_path, elevator=25.5)
    path = aircraft / "espaaro.xml"
    text = path.read_text(encoding="utf-8").replace("<lag>25.5</lag>", "<lag>25</lag>")
    block = re.search(r'<actuator name="fcs/elevator-pos-deg">.*?</actuator>', text, re.DOTALL)[0]
    path.write_text(
        text.replace(block, re.sub(r"<rate_limit>.*?</", "<rate_limit>40</", block)),
        encoding="utf-8",
    )
    found = refined(aircraft, CARDS, tmp_path)
    (effect,) = found["effects"]
    assert (effect["subsystem"], effect["term"], found["verdict"]) == (
        "actuator.elevator",
        "rate_limit",
        "effects-found",
    )
    assert effect["value"] > 90.0


@pytest.mark.slow
def test_accelerometers_elsewhere_than_the_card_says_are_found(tmp_path):
    aircraft = shutil.copytree(ROOT / "aircraft" / "espaaro", tmp_path / "espaaro")
    card_file = aircraft / "airframe.toml"
    text = card_file.read_text(encoding="utf-8")
    card_file.write_text(
        text.replace("accelerometer = [0, 0, 0]", "accelerometer = [0.15, 0, -0.08]"),
        encoding="utf-8",
    )
    found = refined(aircraft, CARDS, tmp_path)
    effects = {(e["subsystem"], e["term"]): e for e in found["effects"]}
    assert set(effects) == {
        ("sensor.accelerometer", "place_x"),
        ("sensor.accelerometer", "place_z"),
    }
    for axis, truth in (("x", -0.15), ("z", 0.08)):
        effect = effects["sensor.accelerometer", f"place_{axis}"]
        assert effect["value"] == pytest.approx(truth, abs=3.0 * effect["std"])
    assert found["verdict"] == "effects-found"


@pytest.mark.slow
def test_flights_to_test_on_never_choose(place, answer):
    """The test flight is spoilt in every channel; what was chosen, and every number of it,
    stays.
    """
    files = ROLL_RATE.files(place.parent / "flights")
    record = FlightRecord.read(files["test"][0])
    rng = np.random.default_rng(0)
    spoilt = {
        c: record[c] * rng.uniform(0.8, 1.2)
        + 0.2 * np.std(record[c]) * rng.standard_normal(len(record))
        for c in record.columns
        if c not in ("time_s", "manoeuvre", "rho_kgpm3")
    }
    path = place.parent / "spoilt.parquet"
    record.with_columns(spoilt).write(path)
    _, found = refine(place, files["train"], [path], "spoilt")
    chosen = answer[1]["effects"]
    assert chosen
    strip = ("coefficient", "subsystem", "term", "value", "std", "property")
    assert [{k: e.get(k) for k in strip} for e in found["effects"]] == [
        {k: e.get(k) for k in strip} for e in chosen
    ]
    assert found["gap"]["train"] == answer[1]["gap"]["train"]
    assert found["gap"]["test"] != answer[1]["gap"]["test"]


@pytest.mark.slow
def test_a_flight_may_not_be_both(place, tmp_path):
    files = ROLL_RATE.files(place.parent / "flights")
    done, found = refine(place, files["train"], [files["train"][0]], "both")
    assert (done.returncode, found) == (2, {})
    assert done.stderr.count("\n") == 1
    copy = place.parent / "renamed.parquet"
    copy.write_bytes(files["train"][1].read_bytes())
    done, found = refine(place, files["train"], [copy], "renamed")
    assert (done.returncode, found) == (2, {})


def test_what_is_asked_here_is_in_the_catalogue():
    assert {k for c in (ROLL_RATE, NOTHING) for k in c.entries} <= set(ENTRIES)
    assert contract_faults({}, 0)


@pytest.mark.slow
def test_the_way_from_a_case_to_its_mark(tmp_path):
    """Short flights with a strong effect: flown, asked in the seal, judged; the file keeps its
    contract.
    """
    short = (
        card(51, 22.0, seconds=14.0, kinds=("roll and yaw",)),
        card(52, 22.0, seconds=14.0, kinds=("roll and yaw",)),
    )
    strong = Case(
        "strong",
        "clear",
        "calm",
        ("Cm:p_hat^2",),
        (Effect("Cm", "p_hat^2", 6.0),),
        short[:1],
        short[1:],
    )
    write([strong], tmp_path / "flights")
    (tmp_path / "answers").mkdir()
    place = sealed.seal(tmp_path / "sealed", [tmp_path / "answers"])
    got = ask(strong, tmp_path, place, ["--workers", "1", "--no-figures"])
    assert got["error"] == ""
    score = judge(strong, got["found"], got["exit"])
    assert (score.right, score.spurious, score.faults) == (True, 0, ()), score
