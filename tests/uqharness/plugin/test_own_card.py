"""An aircraft that comes without a card gets an instrumented copy."""

from __future__ import annotations

import shutil

import pytest

from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.plugin import with_card
from uqharness.simulator import find_aircraft


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


def test_an_aircraft_with_a_card_is_itself():
    own = find_aircraft("espaaro")
    assert with_card(own) is own


def test_an_aircraft_that_does_not_load_is_refused_in_jsbsim_s_words(tmp_path):
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "broken.xml").write_text(
        "<fdm_config name='broken' version='2.0'><metrics></metrics></fdm_config>"
    )
    with pytest.raises(BadInputError):
        with_card(find_aircraft(folder))


def test_a_misspelt_property_is_named_in_the_user_s_file(tmp_path):
    folder = tmp_path / "plane"
    shutil.copytree(find_aircraft("c172p").folder, folder)
    text = (folder / "c172p.xml").read_text()
    (folder / "c172p.xml").unlink()
    text = text.replace("aero/alpha-rad<", "aero/alpha-radd<", 1)
    (folder / "plane.xml").write_text(text)
    line = next(k for k, x in enumerate(text.splitlines(), 1) if "aero/alpha-radd" in x)
    message = rf"^{folder}: .* nothing defines: aero/alpha-radd \(plane.xml:{line}\)"
    with pytest.raises(BadInputError, match=message):
        with_card(find_aircraft(folder))


def fly(out):
    assert (
        main(
            [
                "fly",
                "c172p",
                "--mission",
                "doublets",
                "--speed-mps",
                "50",
                "--noise",
                "--seed",
                "1",
                "--out",
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


@pytest.mark.slow
def test_a_stock_aircraft_meets_its_own_model(tmp_path):
    record = tmp_path / "flight.parquet"
    fly(record)
    words = [
        "compare",
        "c172p",
        "--flight",
        str(record),
        "--out",
        str(tmp_path / "gap"),
        "--workers",
        "1",
        "--no-figures",
    ]
    assert main(words) == 0


@pytest.mark.slow
def test_bounds_of_a_stock_aircraft_are_made_and_validated_without_a_card_of_one_s_own(
    tmp_path, capsys
):
    records = [tmp_path / f"{name}.parquet" for name in ("one", "two")]
    for record in records:
        fly(record)
    made = tmp_path / "bounds"
    assert (
        main(
            [
                "bounds",
                "c172p",
                "--flight",
                str(records[0]),
                "--out",
                str(made),
                "--no-check",
                "--no-figures",
            ]
        )
        == 0
    )
    assert "c172p has no airframe.toml" in capsys.readouterr().err
    form = made / "model-form.json"
    assert main(["validate-bounds", "c172p", str(form), "--flight", str(records[1]), "--json"]) in (
        0,
        1,
    )
    assert '"coverage"' in capsys.readouterr().out
