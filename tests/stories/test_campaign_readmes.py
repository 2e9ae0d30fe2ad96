"""The commands that stand in the campaigns' READMEs: each is one that exists, and every campaign
file flies at small size.
"""

from __future__ import annotations

import argparse
import json
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
import tomlkit

from uqharness.campaign.tables import CASES
from uqharness.cli.main import build_parser, main
from uqharness.simulator.aircraft import PROJECT_ROOT

pytestmark = pytest.mark.usefixtures("flights_here")

FOLDER = PROJECT_ROOT / "campaigns"
READMES = sorted(FOLDER.glob("*/README.md"))
# The study has tests of its own (test_chain_*); the c172's aircraft is made by the command before
# it (the examples of docs/bring-your-own-aircraft.md).
FLOWN = sorted(p for p in FOLDER.glob("*/*.toml") if p.parent.name not in ("chain", "c172"))


def commands(path: Path) -> list[list[str]]:
    """Indented command lines of a page, without their comments."""
    lines = [
        x[4:]
        for x in path.read_text(encoding="utf-8").splitlines()
        if re.match(r" {4}(uqharness|python -m) ", x)
    ]
    return [shlex.split(x, comments=True) for x in lines]


class Parsed(Exception):
    """A program's options were read."""


def parse(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Read the options of ``python -m MODULE WORDS`` by the program itself, which is ended
    there.
    """
    original = argparse.ArgumentParser.parse_args

    def parse_args(self, args=None, namespace=None):
        original(self, args, namespace)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_args)
    monkeypatch.setattr(sys, "argv", words)
    monkeypatch.delitem(sys.modules, words[0], raising=False)
    with pytest.raises(Parsed):
        runpy.run_module(words[0], run_name="__main__")
    monkeypatch.undo()


@pytest.mark.parametrize("path", READMES, ids=lambda p: p.parent.name)
def test_every_command_of_a_readme_is_one_that_exists(path, monkeypatch):
    lines = commands(path)
    assert lines
    for words in lines:
        if words[0] == "uqharness":
            assert isinstance(build_parser().parse_args(words[1:]), argparse.Namespace)
        else:
            parse(words[2:], monkeypatch)


def test_an_option_that_does_not_exist_is_seen(monkeypatch, capsys):
    with pytest.raises(SystemExit):
        parse(["campaigns.levels.bands", "--out", "x", "--repeat-s", "3"], monkeypatch)
    assert "--repeat-s" in capsys.readouterr().err


def small(path: Path) -> dict[str, object]:
    """The campaign with one short flight in one condition for two coefficients; method, metrics and
    all the rest as they stand.
    """
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    air, samples = data["aleatory"], data["epistemic"]
    air |= {"flights": 1, "duration_s": 6, "burn_in_s": 2}
    for name in ("wind_mps", "turbulence"):
        if isinstance(air.get(name), list):
            air[name] = air[name][-1]
    if "bounds" in samples:
        samples["coefficients"] = samples["coefficients"][:2]
        samples["bounds"] = {c: samples["bounds"][c] for c in samples["coefficients"]}
    if "samples" in samples:
        samples["samples"] = 3
    data.pop("stop", None)
    return data


@pytest.mark.parametrize("path", FLOWN, ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_every_campaign_file_flies_at_small_size(path, tmp_path):
    data = small(path)
    (tmp_path / "small.toml").write_text(tomlkit.dumps(data))
    out = tmp_path / "out"
    # JSBSim has flown them before the batch engine is compiled; the demo's own campaign keeps the
    # engine that its file asks for.
    engine = [] if path.parent.name == "demo" else ["--engine", "jsbsim"]
    assert (
        main(
            [
                "campaign",
                "run",
                str(tmp_path / "small.toml"),
                "--out",
                str(out),
                "--serial",
                *engine,
            ]
        )
        == 0
    )
    frame = pd.read_parquet(out / CASES)
    samples = data["epistemic"].get("samples")  # type: ignore[attr-defined]
    expected = {"corners": 4, "none": 1}.get(data["epistemic"]["method"], samples)  # type: ignore[index]
    assert len(frame) == expected
    assert (frame["status"] == "ok").all()
    assert frame["cross_track_median_m"].notna().all()
    assert json.loads((out / "manifest.json").read_text())["state"]
