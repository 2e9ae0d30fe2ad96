"""`refine` on flights of the independent equations; `python -m tests.hidden_effects` runs 40 cases
(docs/hidden-effects.md).
"""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import pytest

from tests.helpers.sixdof import Airframe
from tests.hidden_effects import motion
from tests.hidden_effects.airframes import ROOT
from tests.hidden_effects.answers import canonical, contract_faults, stands_for
from tests.hidden_effects.cases import Case, write
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card
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
def folder(tmp_path_factory):
    result = tmp_path_factory.mktemp("examination")
    write([ROLL_RATE, NOTHING], result / "flights")
    return result


def refine(folder, train, test, name, *more):
    """Exit code and refinement.json."""
    out = folder / name
    words = ["refine", "espaaro", "--train", *map(str, train), "--test", *map(str, test)]
    words += ["--out", str(out), "--no-figures", "--no-pbox", "--workers", "1", *more]
    code, path = main(words), out / "refinement.json"
    return code, json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


@pytest.fixture(scope="module")
def answer(folder):
    files = ROLL_RATE.files(folder / "flights")
    return refine(folder, files["train"], files["test"], "answer")


@pytest.mark.slow
def test_the_dissertations_effect_is_named_with_what_is_the_same_on_the_data(answer):
    code, result = answer
    assert (code, result["verdict"], contract_faults(result, code)) == (0, "effects-found", [])
    (effect,) = result["effects"]
    assert {"Cm:p_hat^2", "mass:Ixz"} <= stands_for(effect)


@pytest.mark.slow
def test_a_placebo_is_left_alone(folder, answer, tmp_path):
    files = ROLL_RATE.files(folder / "flights")
    settings = tmp_path / "placebo.toml"
    text = '[[effect]]\ncoefficient = "CY"\nterm = "alpha^3*dt"\nphysics = "none"\n'
    settings.write_text(text, encoding="utf-8")
    _, result = refine(folder, files["train"], files["test"], "placebo", "--effects", str(settings))
    assert [canonical(e) for e in result["effects"]] == [canonical(e) for e in answer[1]["effects"]]


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is(folder):
    files = NOTHING.files(folder / "flights")
    _, result = refine(folder, files["train"], files["test"], "nothing")
    assert (result["verdict"], result["effects"]) == ("no-missing-effect", [])


@pytest.mark.slow
def test_sensors_noisier_than_stated_do_not_pass_for_gusts(tmp_path):
    """Twice Table 2.1's noise in light air: taken for gusts that do not turn, it left two effects
    of |t| above 10.
    """
    noisy = [replace(c, noise=2.0) for c in CARDS]
    result = refined(ROOT / "aircraft" / "espaaro", noisy, tmp_path, 15.0)
    assert (result["verdict"], result["effects"]) == ("no-missing-effect", [])


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
    words = ["refine", str(aircraft), "--train", *train, "--test", test, "--out", str(out)]
    assert main([*words, "--no-figures", "--no-pbox", "--workers", "1"]) in (0, 1)
    return json.loads((out / "refinement.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_servos_that_act_at_once_leave_no_fault_in_turbulence(tmp_path, monkeypatch):
    """Rows are read before their commands go out.

    On one such flight an elevator's rate limit had |t| 42.
    """
    monkeypatch.setattr(motion, "LAG", (1e6,) * 4)
    monkeypatch.setattr(motion, "RATE", (1e9,) * 4)
    at_once = another_servo(tmp_path, elevator=None, aileron=None, rudder=None, throttle=None)
    result = refined(at_once, CARDS[:2], tmp_path, 14.0)
    assert (result["verdict"], result["effects"]) == ("no-missing-effect", [])
    assert any("one sample ahead" in note for note in result["notes"])
    assert max(abs(c["t"]) for c in result["candidates"]["scores"]) < result["candidates"]["limit"]


@pytest.mark.slow
@pytest.mark.parametrize("lag", [12.0, 60.0])
def test_a_servos_lag_in_the_xml_may_be_wrong_either_way(tmp_path, lag):
    result = refined(another_servo(tmp_path, elevator=lag), CARDS, tmp_path)
    (effect,) = result["effects"]
    assert (effect["subsystem"], effect["term"], result["verdict"]) == (
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
    result = refined(aircraft, CARDS, tmp_path)
    (effect,) = result["effects"]
    assert (effect["subsystem"], effect["term"], result["verdict"]) == (
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
    result = refined(aircraft, CARDS, tmp_path)
    effects = {(e["subsystem"], e["term"]): e for e in result["effects"]}
    assert set(effects) == {
        ("sensor.accelerometer", "place_x"),
        ("sensor.accelerometer", "place_z"),
    }
    for axis, truth in (("x", -0.15), ("z", 0.08)):
        effect = effects["sensor.accelerometer", f"place_{axis}"]
        assert effect["value"] == pytest.approx(truth, abs=3.0 * effect["std"])
    assert result["verdict"] == "effects-found"
