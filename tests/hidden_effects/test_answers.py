"""The examination of refine: its questions, its marks, which can say no, and its seal."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sysid.record import FlightRecord
from tests.hidden_effects import sealed
from tests.hidden_effects.airframes import ROOT
from tests.hidden_effects.answers import accepted, contract_faults, judge, property_name
from tests.hidden_effects.cases import battery
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.fresh import fresh, question
from tests.hidden_effects.manoeuvres import card
from tests.hidden_effects.marks import marks

CASES = {(c.truth, c.kind, c.air): c for c in battery()}


# The battery and its answers


def test_the_battery_is_what_was_asked_for():
    cases = battery()
    assert len({c.id for c in cases}) == len(cases)
    sized = {}
    for c in cases:
        if c.kind in ("clear", "marginal") and c.air == "calm" and c.aircraft == "espaaro":
            sized.setdefault(c.entries[0], set()).add(c.kind)
    assert sum(v == {"clear", "marginal"} for v in sized.values()) >= 15
    assert sum(c.kind == "null" for c in cases) >= 60
    assert {c.air for c in cases if c.kind == "null"} == {"calm", "light"}
    assert sum(c.kind == "pair" for c in cases) >= 10
    assert [c.id for c in cases] == [c.id for c in battery()]
    assert {ENTRIES[k].off_form for c in cases if c.kind == "off-form" for k in c.entries} == {True}
    assert len({c.train[0].rate_hz for c in cases}) == 3
    assert {c.train[0].positions for c in cases} == {True, False}


def test_a_draw_is_what_chance_said_and_no_part_of_the_battery():
    cases, t = fresh(1)
    assert len(cases) == len({c.id for c in cases}) > 40
    assert not {c.id for c in cases} & {c.id for c in battery()}
    assert {c.kind for c in cases} == {"null", "clear", "pair"}
    assert {c.air for c in cases} == {"calm", "light"}
    assert {c.aircraft for c in cases} == {"espaaro", "second"}
    assert {c.train[0].rate_hz for c in cases} == {25.0, 50.0, 100.0}
    for c in cases:
        asked = question(1, int(c.truth.rpartition("/")[2]))
        assert asked.case.id == c.id
        assert asked.case.entries == c.entries == tuple(e.key for e in c.effects)
        assert set(t[c.id]) == set(c.entries)
        for key, sign, effect in zip(asked.case.entries, asked.signs, c.effects, strict=True):
            assert key.startswith("actuator") or sign * effect.size * ENTRIES[key].guess > 0.0
    assert fresh(0)[0] == []


def gap(after=1.0):
    channels = {
        "q_radps": {"rms_before": 0.005, "rms_after": 0.00349 * after, "noise_rms": 0.00349}
    }
    return {"channels": channels, "coefficients": {}, "theil": {"before": 0.1, "after": 0.05}}


def effect(key, value=0.0, std=1.0, alternatives=()):
    subject, term = key.split(":")
    coefficient = subject[0] == "C"
    return {
        "coefficient" if coefficient else "subsystem": subject,
        "term": term,
        "name": "n",
        "why": "w",
        "value": value,
        "std": std,
        "property": property_name(subject, term) if coefficient else "x",
        "evidence": {},
        "alternatives": [
            {
                "coefficient" if k[0] == "C" else "subsystem": k.split(":")[0],
                "term": k.split(":")[1],
                "evidence": {},
                "separable": s,
            }
            for k, s in alternatives
        ],
    }


def refinement(*effects, verdict="", after=1.0):
    return {
        "verdict": verdict or ("effects-found" if effects else "no-missing-effect"),
        "disagreement": [],
        "effects": list(effects),
        "remaining": {"unexplained": False, "where": []},
        "gap": {"train": gap(), "test": gap(after)},
        "model": "aircraft/x/x.xml",
    }


def test_the_right_name_counts_and_a_wrong_one_does_not():
    case = CASES["CX:q_hat", "clear", "calm"]
    truth = case.effects[0].size
    found = judge(case, refinement(effect("CX:q_hat", 1.1 * truth, 0.08 * abs(truth))), 0)
    assert (found.right, found.spurious, found.faults) == (True, 0, ())
    assert abs(found.z[0]) == pytest.approx(0.1 / 0.08)
    wrong = judge(case, refinement(effect("CX:beta^2")), 0)
    assert (wrong.right, wrong.spurious, wrong.z) == (False, 1, ())
    assert not judge(case, refinement(), 0).right
    assert not judge(case, refinement(verdict="unexplained"), 1).right
    second = judge(case, refinement(effect("Cm:beta^2"), effect("CX:q_hat")), 0)
    assert (second.right, second.spurious) == (False, 1)
    both = judge(case, refinement(effect("CX:q_hat"), effect("Cm:beta^2")), 0)
    assert (both.right, both.spurious) == (True, 1)


def test_an_inseparable_set_counts_if_it_is_small_and_said_to_be_one():
    case = CASES["CX:q_hat", "clear", "calm"]
    others = (("CX:q_hat", False), ("CX:alphadot_hat", False))
    assert judge(case, refinement(effect("CX:de", alternatives=others)), 0).right
    assert not judge(case, refinement(effect("CX:de", alternatives=(("CX:q_hat", True),))), 0).right
    many = (*others, ("CX:alpha*de", False))
    large = judge(case, refinement(effect("CX:de", alternatives=many)), 0)
    assert not large.right
    assert "4 inseparable effects" in large.faults


def test_causes_that_are_the_same_on_the_data():
    case = CASES["Cm:p_hat^2", "clear", "calm"]
    assert accepted("Cm:p_hat^2") == {"Cm:p_hat^2", "mass:Ixz"}
    together = judge(case, refinement(effect("Cm:p_hat^2", alternatives=(("mass:Ixz", False),))), 0)
    assert (together.right, together.together) == (True, True)
    alone = judge(case, refinement(effect("mass:Ixz")), 0)
    assert (alone.right, alone.together, alone.spurious) == (True, False, 0)
    # The same moment in turbulence, fifty times as large, is Ixz of 9.8 kg m^2: above sqrt(Ixx
    # Izz), 8.3.
    strong = CASES["Cm:p_hat^2", "clear", "light"]
    assert judge(strong, refinement(effect("Cm:p_hat^2")), 0).together is None
    weaker = replace(
        strong, effects=(replace(strong.effects[0], size=0.8 * strong.effects[0].size),)
    )
    assert judge(weaker, refinement(effect("Cm:p_hat^2")), 0).together is False
    assert judge(
        CASES["sensor.alpha_rad:scale", "clear", "calm"],
        refinement(effect("sensor.alpha:scale")),
        0,
    ).right


def test_nulls_pairs_and_what_has_no_name():
    null = next(c for c in battery() if c.kind == "null")
    assert judge(null, refinement(), 0).right
    assert not judge(null, refinement(effect("CX:q_hat")), 0).right
    assert not judge(null, refinement(verdict="unexplained"), 1).right
    pair = next(c for c in battery() if c.entries == ("Cm:p_hat^2", "Cl:de"))
    assert judge(pair, refinement(effect("Cl:de"), effect("mass:Ixz")), 0).right
    assert not judge(pair, refinement(effect("Cl:de")), 0).right
    off = CASES["Cm:table(alpha)", "off-form", "calm"]
    assert judge(off, refinement(verdict="unexplained"), 1).right
    assert judge(off, refinement(effect("Cm:alpha^3")), 0).right
    assert not judge(off, refinement(effect("Cm:alpha^3"), after=1.3), 0).right
    assert not judge(off, refinement(effect("Cm:alpha^3"), effect("CX:de")), 0).right
    assert not judge(off, refinement(), 0).right


def test_a_file_that_breaks_its_contract_is_told_so():
    good = refinement(effect("Cm:p_hat^2", 0.1, 0.01))
    assert contract_faults(good, 0) == []
    assert contract_faults(good, 1) == ["exit code 1 with effects-found"]
    assert contract_faults({**good, "verdict": "perhaps"}, 0) == ["verdict 'perhaps'"]
    bad = refinement({**effect("Cm:p_hat^2"), "property": "aero/Cm_p_hat^2"})
    assert contract_faults(bad, 0) == ["property 'aero/Cm_p_hat^2' for Cm:p_hat^2"]
    assert "no gap" in contract_faults({k: v for k, v in good.items() if k != "gap"}, 0)
    assert property_name("CY", "abs(beta)*beta") == "aero/CY_absbeta_beta"


def table(**change):
    one = {
        "kind": "clear",
        "air": "calm",
        "verdict": "effects-found",
        "t": 20.0,
        "right": 1,
        "together": "",
        "spurious": 0,
        "z": "0.5",
        "gap": 1.0,
        "oracle": 1.0,
        "seconds": 60.0,
        "faults": "",
    }
    return {**one, **change}


def test_marks_are_reached_and_missed():
    rows = [table()] * 19 + [table(right=0)]
    assert marks(rows)[0]
    for spoil in (
        {"right": 0},
        {"spurious": 1},
        {"z": "3.0"},
        {"gap": 1.2},
        {"faults": "no gap"},
        {"together": 0},
    ):
        reached, text = marks(rows + [table(**spoil)] * 6)
        assert not reached, (spoil, text)
        assert "MISSED" in text
    # What is weaker than |t| = 3 counts for nothing; below 10 it is marginal.
    assert marks([*rows, table(right=0, t=2.0), table(right=0, t=1.0)])[0]
    assert marks([*rows, *[table(t=5.0)] * 2, *[table(t=5.0, right=0)] * 2])[0]
    assert not marks([*rows, table(kind="null", spurious=1, right=0, z="")])[0]


def test_answers_are_kept_and_an_interrupted_run_goes_on(tmp_path, monkeypatch, capsys):
    from tests.hidden_effects import run

    case = CASES["CX:q_hat", "clear", "calm"]
    asked = []

    def ask(case, folder, place, extra=()):
        asked.append(case.id)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return {
            "exit": 0,
            "seconds": 1.0,
            "found": refinement(effect("CX:q_hat", case.effects[0].size, 0.1)),
            "error": "",
        }

    monkeypatch.setattr(run, "ask", ask)
    monkeypatch.setattr(run, "write", lambda cases, folder: set())
    other = CASES["Cl:de", "clear", "calm"]
    given = ["--out", str(tmp_path), "--cases", case.id, other.id]
    with pytest.raises(KeyboardInterrupt):
        run.main(given)
    assert run.main(given) == 1
    assert sorted(asked) == sorted(
        [case.id, other.id, other.id if asked[0] == case.id else case.id]
    )
    lines = (tmp_path / "table.csv").read_text().splitlines()
    assert len(lines) == 3
    assert "MISSED" in capsys.readouterr().out


# The seal


def test_refine_can_neither_import_nor_read_the_examination(tmp_path):
    secret = tmp_path / "answers"
    secret.mkdir()
    (secret / "a.json").write_text("{}")
    place = sealed.seal(tmp_path / "sealed", [secret])
    assert sealed.run(
        place, ["-c", "import uqharness, sysid; print(uqharness.__file__)"]
    ).stdout.startswith(str(place))
    for text in (
        "import tests.hidden_effects.answers",
        f"open({str(ROOT / 'tests' / 'hidden_effects' / 'catalogue.py')!r})",
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); import tests.hidden_effects.answers",
        f"import sys; sys.path.insert(0, {str(ROOT / 'tests')!r}); import hidden_effects.answers",
        f"open({str(secret / 'a.json')!r})",
        f"import os; os.listdir({str(secret)!r})",
        (
            "import subprocess, sys; sys.exit(subprocess.run([sys.executable, '-c',"
            f" {f'open({str(secret)!r})'!r}]).returncode)"
        ),
    ):
        done = sealed.run(place, ["-c", text])
        assert done.returncode != 0, text
    (tmp_path / "open.json").write_text("{}")
    assert sealed.run(place, ["-c", f"open({str(tmp_path / 'open.json')!r})"]).returncode == 0


def test_the_product_does_not_know_the_examination():
    for package in ("sysid", "uqharness"):
        for path in (ROOT / package).rglob("*.py"):
            assert "hidden_effects" not in path.read_text(encoding="utf-8"), path


def test_written_flights_are_read_back(tmp_path):
    from tests.hidden_effects.cases import write

    case = replace(
        CASES["CX:q_hat", "clear", "calm"],
        train=(card(1, 22.0, seconds=12.0),),
        test=(card(2, 22.0, seconds=12.0),),
    )
    write([case], tmp_path)
    files = case.files(tmp_path)
    record = FlightRecord.read(files["train"][0])
    before = files["train"][0].stat().st_mtime_ns
    write([case], tmp_path)
    assert files["train"][0].stat().st_mtime_ns == before
    assert record.dt_s == pytest.approx(0.02)
    assert set(record["manoeuvre"]) == {"", "elevator doublet"}


def test_a_flight_that_comes_to_grief_is_named_and_leaves_no_file(tmp_path):
    from tests.hidden_effects.cases import write

    good = replace(
        CASES["CX:q_hat", "clear", "calm"],
        train=(card(1, 22.0, seconds=12.0),),
        test=(card(2, 22.0, seconds=12.0),),
    )
    wild = replace(good, truth="too much", effects=(Effect("Cm", "p_hat^2", 1e9),))
    assert write([good, wild], tmp_path) == {wild.id}
    assert all(p.is_file() for paths in good.files(tmp_path).values() for p in paths)
    assert not any(p.exists() for paths in wild.files(tmp_path).values() for p in paths)
