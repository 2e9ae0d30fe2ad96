"""Instrumented copies, estimates and masses written into XML, and aircraft without a card."""

from __future__ import annotations

import math
import shlex
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.plugin import apply
from uqharness.plugin.apply import (
    Estimate,
    MassProperties,
    Verdict,
    carried_files,
    instrument_aircraft,
    mass_insertions,
    put_values,
    undo,
    with_card,
    write_estimates,
)
from uqharness.plugin.instrument import Bounds
from uqharness.simulator import engine
from uqharness.simulator import facts as aircraft_facts
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.staging import copy_folder, copy_shared_parts
from uqharness.xml import read_document

BOUNDS = Bounds(None, {"CX": (-0.01, 0.01)})


@pytest.fixture
def flight(monkeypatch: pytest.MonkeyPatch) -> list:
    """The folders that were flown beside each other."""
    pairs = []

    def check(untouched: Path, result: Path, seconds: float) -> Verdict:
        pairs.append((untouched, result))
        return Verdict("works")

    monkeypatch.setattr(apply, "check_in_child", check)
    return pairs


def test_an_aircraft_that_does_not_fly_is_refused_or_noted(
    flight: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def query(folder: Path) -> aircraft_facts.AircraftFacts:
        raise BadInputError("it dives")

    monkeypatch.setattr(aircraft_facts, "measure_facts_in_child", query)
    with pytest.raises(BadInputError, match="it dives; --no-check"):
        instrument_aircraft(find_aircraft("c172x"), BOUNDS, tmp_path / "c172x")
    assert not (tmp_path / "c172x").exists()
    done = instrument_aircraft(find_aircraft("c172x"), BOUNDS, tmp_path / "c172x", check=False)
    assert done.notes[-1] == "not simulated, so the card is a guess: it dives"


def test_a_control_that_cannot_be_measured_is_noted_and_the_command_answers_no(
    flight: list,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    hunting = aircraft_facts.ControlFacts(1, unmeasured="engine 1 does not settle")

    def facts(folder: Path) -> aircraft_facts.AircraftFacts:
        assumed = aircraft_facts.assumed_facts(16.2, 10.9, 1.5)
        return replace(assumed, controls={**assumed.controls, "throttle": hunting})

    monkeypatch.setattr(aircraft_facts, "measure_facts_in_child", facts)
    words = ["instrument", "c172x", "--no-check", "--out", str(tmp_path / "a")]
    assert main(words) == 1
    note = (
        "throttle could not be measured, so its sense and throw in airframe.toml are assumed:"
        " engine 1 does not settle"
    )
    assert note in capsys.readouterr().out
    hunting = replace(hunting, unmeasured="")
    assert main([*words[:-1], str(tmp_path / "b")]) == 0


# Parts from beside an aircraft's folder that a copy elsewhere has to carry.


def root_of(tmp_path):
    """A JSBSim root with one aircraft and its engines and systems."""
    folder = tmp_path / "root" / "aircraft" / "c172x"
    copy_folder(find_aircraft("c172x").folder, folder)
    copy_shared_parts(find_aircraft("c172x"), tmp_path / "root", stock=tmp_path / "elsewhere")
    return find_aircraft(folder)


def test_a_part_of_ones_own_is_carried_unless_it_is_found_there(tmp_path):
    aircraft = root_of(tmp_path)
    (part, *_) = sorted((tmp_path / "root" / "engine").iterdir())
    part.write_bytes(part.read_bytes() + b"<!-- tuned -->\n")
    result = carried_files(aircraft, tmp_path / "out" / "aircraft" / "c172x")
    assert list(result.values()) == [part.read_bytes()]
    (name,) = result
    assert name.rpartition("/")[2] == part.name
    # Beside the original it is found where it is.
    assert carried_files(aircraft, tmp_path / "root" / "aircraft" / "copy") == {}


# Estimates written into an aircraft's XML as a hand would.

TEXT = (
    "<a><!-- <property value=\"1\">a/b</property> -->\n  <property  value = '2'"
    ' >a/b</property>\t<!-- old -->\r\n<property value="3">a/bc</property></a>'
)


def edited(text: str, name: str, estimate: Estimate, encoding: str = "utf-8") -> str | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.xml")
        path.write_bytes(text.encode(encoding))
        undeclared = put_values(path.parent, {name: estimate})
        return None if undeclared else path.read_bytes().decode(encoding)


def test_a_value_is_edited_in_place_and_nowhere_else():
    done = edited(TEXT, "a/b", Estimate(-0.5, "x -- y"))
    assert done == TEXT.replace("'2'", "'-0.5'").replace(
        "<!-- old -->", "<!-- old -->  <!-- identified x - - y -->"
    )
    repeat = edited(done, "a/b", Estimate(7, "z"))
    assert repeat is not None
    assert repeat.count("identified") == 1
    assert edited(TEXT, "b/c", Estimate(1, "")) is None


def test_names_without_a_place_come_back_and_other_files_stay(tmp_path: Path):
    (tmp_path / "Systems").mkdir()
    broken = '<property value="1">a/b</property'
    (tmp_path / "broken.xml").write_text(broken)
    (tmp_path / "Systems" / "a.xml").write_bytes(TEXT.encode())
    remaining = put_values(
        tmp_path, {"a/b": Estimate(5, "x"), "a/bc": Estimate(6, "y"), "no/where": Estimate(7, "z")}
    )
    assert remaining == ["no/where"]
    assert (tmp_path / "broken.xml").read_text() == broken
    text = (tmp_path / "Systems" / "a.xml").read_bytes().decode()
    assert text.startswith(
        "<a><!-- <property value=\"1\">a/b</property> -->\n  <property  value = '5' >a/b</property>"
    )
    assert text.endswith('\r\n<property value="6">a/bc</property></a>  <!-- identified y -->')


def test_a_folder_that_is_no_aircraft_is_not_replaced(tmp_path: Path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(BadInputError, match="is no aircraft folder"):
        write_estimates(find_aircraft("espaaro"), {}, out)
    (out / "mine.txt").unlink()
    assert (
        write_estimates(
            find_aircraft("espaaro"), {"aero/Cm_q": Estimate(-9.5, "from one flight")}, out
        )
        == []
    )
    assert "identified from one flight" in "".join(path.read_text() for path in out.rglob("*.xml"))


# Mass properties from numbers: what JSBSim then computes, what stays, and the way back.

SLUG_FT2 = 1.3558179483314
WANTED = MassProperties(mass_kg=998.0, iyy_kgm2=1700.0, ixz_kgm2=25.0, cg_x_m=1.03)


def stands_at(aircraft, *names):
    fdm = open_aircraft(aircraft)
    engine.run_ic(fdm)
    return [float(fdm[f"inertia/{name}"]) for name in names]


def test_jsbsim_computes_what_was_asked_and_undo_gives_the_authors_bytes(tmp_path):
    stock = find_aircraft("c172x")
    done = instrument_aircraft(stock, Bounds(), tmp_path / "c172x", mass=WANTED)
    # Flown beside the stock aircraft with the same masses: the plugin itself changes nothing.
    assert done.verdict is not None
    assert done.verdict.status == "works"
    mine = find_aircraft(tmp_path / "c172x")
    names = ("mass-slugs", "iyy-slugs_ft2", "ixz-slugs_ft2", "cg-x-in")
    # Factors by hand: 14.5939 kg a slug, minus the product of inertia, 39.37 in a metre.
    expected = [998.0 / 14.59390, 1700.0 / SLUG_FT2, -25.0 / SLUG_FT2, 1.03 / 0.0254]
    assert stands_at(mine, *names) == pytest.approx(expected, rel=1e-6)
    assert stands_at(stock, *names)[0] != pytest.approx(998.0 / 14.59390, rel=0.01)
    undo(tmp_path / "c172x", tmp_path / "back")
    assert (tmp_path / "back" / "c172x.xml").read_bytes() == stock.xml.read_bytes()


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"mass_kg": -1.0}, "mass_kg = -1: a positive number"),
        ({"cg_x_m": math.nan}, "cg_x_m = nan: a finite number"),
        ({"ixx_kgm2": 1.0, "iyy_kgm2": 1.0, "izz_kgm2": 3.0}, "no body has"),
    ],
)
def test_what_no_body_has_is_refused(inputs, message):
    aircraft = find_aircraft("c172x")
    with pytest.raises(BadInputError, match=message):
        mass_insertions(aircraft, read_document(aircraft.xml), MassProperties(**inputs))


# An aircraft that comes without a card gets an instrumented copy.


def test_a_stock_aircraft_gets_a_card_once_and_its_own_folder_stays():
    stock = find_aircraft("c172p")
    mine = with_card(stock)
    assert mine.has_card
    assert not stock.has_card
    assert mine.name == "c172p"
    assert mine.card.inputs["elevator"].throw_deg == pytest.approx(25.5, abs=0.1)
    assert mine.card.parameters
    assert mine.card.replay.without_systems == ("path-errors",)
    assert with_card(stock) is mine


def fly(out):
    assert (
        main(
            [
                *shlex.split("fly c172p --mission doublets --speed-mps 50 --noise --seed 1 --out"),
                str(out),
            ]
        )
        == 0
    )


def test_a_stock_aircraft_flies_to_dataflash_and_its_log_has_no_fault(tmp_path, capsys):
    log = tmp_path / "flight.bin"
    fly(log)
    assert "uqharness instrument c172p" in capsys.readouterr().err
    assert main(["log", "info", str(log), "--aircraft", "c172p", "--no-cache"]) == 0
    assert "error" not in capsys.readouterr().out


# An aircraft made for FlightGear flies in JSBSim alone with what FlightGear would write.


@pytest.fixture(scope="module")
def p51d():
    return with_card(find_aircraft("p51d"))


def test_what_an_aircraft_reads_of_flightgear_is_found_and_nothing_that_it_writes_itself():
    facts = aircraft_facts.measure_facts_in_child(find_aircraft("p51d").folder)
    assert facts.controls["throttle"].thrust_N[1] > facts.controls["throttle"].thrust_N[0]
    result = {row.name: row.source for row in facts.host}
    assert result["/controls/engines/engine/throttle"] == "fcs/throttle-cmd-norm"
    assert result["/engines/engine/mp-inhg"] == "propulsion/engine/map-inhg"
    assert "/controls/engines/engine/feed_tank" not in result
