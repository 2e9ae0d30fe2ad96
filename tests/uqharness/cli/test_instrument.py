"""``uqharness instrument``: what its terminal text says of the copy."""

from __future__ import annotations

from uqharness.cli.main import main
from uqharness.commands.simulation import _check_sentence
from uqharness.results.simulation import PluginCheck


def test_every_table_has_its_headings(tmp_path, capsys):
    out = tmp_path / "mine"
    assert (
        main(["instrument", "c172p", "--out", str(out), "--no-check", "--constant", "CX=0.01"]) == 0
    )
    told = capsys.readouterr()
    lines = told.out.splitlines()
    assert told.err == ""
    assert lines[0] == f"c172p: the copy in {out} has bounded increments of 6 coefficients."
    assert lines[1] == "The aircraft's forces are in wind axes, its moments in body axes."
    heads = [line.split("  ") for line in lines]
    words = [[word.strip() for word in head if word.strip()] for head in heads]
    assert ["Coefficient", "Added to axes", "At"] in words
    assert ["Property", "Axis", "Function at"] in words
    assert ["File", "Change", "Lines of the change"] in words
    edited = next(row for row in words if row[:2] == ["c172p.xml", "edited"])
    assert int(edited[2]) > 0
    places = [row[2] for row in words if row and row[0] in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")]
    assert [place.partition(":")[0] for place in places] == ["c172p.xml"] * 6


def check(status: str, reason: str = "", properties: int = 0, worst: float | None = None) -> str:
    return _check_sentence(
        PluginCheck(
            status=status, reason=reason, properties=properties, unsteady=0, worst=worst, dt_s=None
        )
    )


def test_the_check_says_yes_no_or_why_not():
    works = check("works", properties=675, worst=9e-16)
    assert "675 properties are bit-identical" in works
    assert "9e-16" in works
    assert check("wrong", "CX: the increment is off") == "WRONG: CX: the increment is off."
    assert "the original fails: no fuel" in check("fails", "no fuel")
