"""uqharness refine from flights of the independent equations: the missing effect is named, valued,
added and shown; nothing is found where nothing is missing; test flights choose nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sysid.record import FlightRecord
from tests.helpers import flown
from tests.helpers.flown import fly
from tests.helpers.page_checks import problems
from tests.helpers.sixdof import Airframe, derivative
from uqharness.cli.main import main
from uqharness.refinement.mission import no_pbox

TRAIN = (("pitch-3211", 22.0), ("roll-yaw", 22.0), ("yaw-roll", 20.0), ("roll-yaw", 19.0))
TEST = (("yaw-roll", 22.0),)
HIDDEN = 3.0


def with_p2(airframe: Airframe, x, u):
    """The equations with a pitching moment from roll rate squared that the model of the E-SPAARO
    has not.
    """
    out = derivative(airframe, x, u)
    V = float(np.linalg.norm(x[:3]))
    qS = 0.5 * 1.225 * (1.0 - 2.25577e-5 * -x[11]) ** 4.25588 * V**2 * airframe.S
    out[4] += qS * airframe.c * HIDDEN * (x[3] * airframe.b / (2.0 * V)) ** 2 / airframe.Iyy
    return out


@pytest.fixture(scope="module")
def flights(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("flights")
    made = {
        "train": fly(TRAIN[:2], seed=1, seconds=6.0, rhs=with_p2),
        "test": fly(TEST, seed=2, seconds=6.0, rhs=with_p2),
        "plain": fly(TRAIN[:2], seed=3, seconds=6.0),
        "plain_test": fly(TEST, seed=4, seconds=6.0),
    }
    for name, record in made.items():
        record.write(folder / f"{name}.parquet")
    return {name: folder / f"{name}.parquet" for name in made}


@pytest.fixture(scope="module")
def refined(flights, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("refined")
    assert (
        main(
            [
                "refine",
                "espaaro",
                "--train",
                str(flights["train"]),
                "--test",
                str(flights["test"]),
                "--out",
                str(out),
                "--workers",
                "1",
                "--no-pbox",
            ]
        )
        == 0
    )
    return out


def document(out: Path) -> dict:
    return json.loads((out / "refinement.json").read_text(encoding="utf-8"))


def test_the_missing_effect_is_named_and_valued(refined):
    found = document(refined)
    assert found["verdict"] == "effects-found"
    (effect,) = found["effects"]
    assert (effect["coefficient"], effect["term"], effect["property"]) == (
        "Cm",
        "p_hat^2",
        "aero/Cm_p2",
    )
    assert effect["name"] == "pitching moment due to roll rate squared"
    assert abs(effect["value"] - HIDDEN) < 3.0 * effect["std"]
    assert 0.0 < effect["std"] < 0.1 * HIDDEN
    assert not effect["withdrawn"]
    assert not found["remaining"]["unexplained"]


def test_disagreement_is_told_in_regions(refined):
    first = document(refined)["disagreement"][0]
    assert first["coefficient"] == "Cm"
    assert first["share_outside_95"] > 0.25
    assert "Cm" in first["words"]


def test_the_gap_shrinks_on_flights_that_were_not_used(refined):
    q = document(refined)["gap"]["test"]["channels"]["q_radps"]
    assert q["rms_before"] > 1.3 * q["noise_rms"]
    assert q["rms_after"] < 1.15 * q["noise_rms"]
    cm = document(refined)["gap"]["test"]["coefficients"]["Cm"]
    assert cm["rms_after"] < cm["rms_before"]


def test_the_model_carries_the_effect(refined):
    found = document(refined)
    xml = refined / found["model"]
    assert "aero/Cm_p2" in xml.read_text(encoding="utf-8")
    assert "+      " in (refined / "model.diff").read_text(encoding="utf-8")
    assert found["switch"] == [{"property": "aero/Cm_p2", "off": 0.0}]
    for name in (
        "report.html",
        "figures/gap.svg",
        "figures/candidates.svg",
        "figures/coefficients.svg",
    ):
        assert (refined / name).stat().st_size > 1000
    assert problems((refined / "report.html").read_text(encoding="utf-8")) == []


def test_test_flights_choose_nothing(flights, refined, tmp_path):
    """The same training with a test flight of which every sample is wrong gives the same effects,
    value for value.
    """
    record = FlightRecord.read(flights["test"])
    spoilt = {n: np.asarray(record[n]) for n in record.columns}
    spoilt["q_radps"] = spoilt["q_radps"] + 0.2 * np.sin(7.0 * spoilt["time_s"])
    path = tmp_path / "spoilt.parquet"
    FlightRecord(spoilt, record.metadata).write(path)
    out = tmp_path / "out"
    main(
        [
            "refine",
            "espaaro",
            "--train",
            str(flights["train"]),
            "--test",
            str(path),
            "--out",
            str(out),
            "--workers",
            "1",
            "--no-figures",
            "--no-pbox",
        ]
    )
    keys = ("coefficient", "term", "value", "std", "evidence")
    assert [[e[k] for k in keys] for e in document(out)["effects"]] == [
        [e[k] for k in keys] for e in document(refined)["effects"]
    ]


def test_nothing_is_found_where_nothing_is_missing(flights, tmp_path, capsys):
    out = tmp_path / "out"
    code = main(
        [
            "refine",
            "espaaro",
            "--train",
            str(flights["plain"]),
            "--test",
            str(flights["plain_test"]),
            "--out",
            str(out),
            "--workers",
            "1",
            "--no-figures",
            "--no-pbox",
            "--json",
        ]
    )
    found = json.loads(capsys.readouterr().out)
    assert (code, found["verdict"], found["effects"]) == (0, "no-missing-effect", [])
    assert (
        found["gap"]["test"]["channels"]["q_radps"]["rms_after"]
        < 1.15 * found["gap"]["test"]["channels"]["q_radps"]["noise_rms"]
    )


def test_a_train_flight_given_as_test_is_refused_by_its_content(flights, tmp_path, capsys):
    copy = tmp_path / "renamed.parquet"
    copy.write_bytes(flights["train"].read_bytes())
    assert (
        main(
            [
                "refine",
                "espaaro",
                "--train",
                str(flights["train"]),
                "--test",
                str(copy),
                "--out",
                str(tmp_path / "o"),
            ]
        )
        == 2
    )
    assert "proves nothing" in capsys.readouterr().err


def test_help_and_wrong_input(tmp_path, capsys, flights):
    with pytest.raises(SystemExit) as stopped:
        main(["refine", "--help"])
    assert stopped.value.code == 0
    assert "--train" in capsys.readouterr().out
    own = tmp_path / "own.toml"
    own.write_text('[[effect]]\ncoefficient = "Cm"\nterm = "x"\n', encoding="utf-8")
    code = main(
        [
            "refine",
            "espaaro",
            "--train",
            str(flights["train"]),
            "--test",
            str(flights["test"]),
            "--effects",
            str(own),
            "--out",
            str(tmp_path / "o"),
        ]
    )
    assert code == 2
    assert "is no factor" in capsys.readouterr().err


def test_a_killed_refinement_goes_on_where_it_was(flights, refined, tmp_path, monkeypatch, caplog):
    """Killed while it fits intervals, it does not choose again, ends with the same effects, and
    leaves no stages behind. A stage that was damaged meanwhile is told and computed again."""
    from uqharness.refinement import run as refine_run

    out = tmp_path / "out"
    arguments = [
        "refine",
        "espaaro",
        "--train",
        str(flights["train"]),
        "--test",
        str(flights["test"]),
        "--out",
        str(out),
        "--workers",
        "1",
        "--no-figures",
    ]
    # What was judged is kept where a mission follows.
    monkeypatch.setattr(refine_run, "_mission", lambda *_: no_pbox("not flown here"))
    with monkeypatch.context() as patch:
        patch.setattr(
            refine_run, "fit_intervals", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
        )
        assert main(arguments) == 130
    assert list((out / ".stages").glob("effects-*.data"))
    assert not (out / "refinement.json").exists()
    (judged,) = (out / ".stages").glob("judged-*.data")
    content = bytearray(judged.read_bytes())
    content[-100] ^= 1
    judged.write_bytes(content)
    with monkeypatch.context() as patch:
        patch.setattr(refine_run, "find_effects", None)
        assert main(arguments) == 0
    assert document(out)["effects"] == document(refined)["effects"]
    assert not (out / ".stages").exists()
    (told,) = [text for text in caplog.messages if "computed again" in text]
    assert f"{judged.name}: damaged" in told


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


def timing_of(train: Path, test: Path, out: Path) -> dict:
    main(
        [
            "refine",
            "espaaro",
            "--train",
            str(train),
            "--test",
            str(test),
            "--out",
            str(out),
            "--workers",
            "1",
            "--no-figures",
            "--no-pbox",
        ]
    )
    return document(out)


@pytest.mark.slow
def test_a_record_one_sample_late_is_a_matter_of_its_clock(tmp_path):
    """It imitates a lag in every servo; the time is told, put right and no effect is added."""
    late = {"train": fly(TRAIN, seed=7, seconds=6.0), "test": fly(TEST, seed=8, seconds=6.0)}
    for name, record in late.items():
        one_sample_late(record).write(tmp_path / f"{name}.parquet")
    found = timing_of(tmp_path / "train.parquet", tmp_path / "test.parquet", tmp_path / "out")
    assert found["timing"]["controls_late_s"] == pytest.approx(0.02, abs=0.004)
    assert (found["verdict"], found["effects"]) == ("no-missing-effect", [])
    assert "of the record's clock" in found["notes"][0]


@pytest.mark.slow
def test_a_slow_servo_is_no_matter_of_the_clock(tmp_path, monkeypatch):
    """A lag of the elevator alone is named as that."""

    monkeypatch.setattr(flown, "LAG", np.array([16.0, 25.0, 25.0, 6.0]))
    made = {
        "train": fly(TRAIN, seed=5, seconds=6.0),
        "test": fly((("pitch-3211", 20.0),), seed=6, seconds=6.0),
    }
    for name, record in made.items():
        commands_alone(record).write(tmp_path / f"{name}.parquet")
    found = timing_of(tmp_path / "train.parquet", tmp_path / "test.parquet", tmp_path / "out")
    assert found["timing"]["controls_late_s"] == 0.0
    assert [(e["subsystem"], e["term"]) for e in found["effects"]] == [("actuator.elevator", "lag")]
    assert abs(found["effects"][0]["value"] - 16.0) < 3.0 * found["effects"][0]["std"]
