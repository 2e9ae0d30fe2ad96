"""What commands print with --json fits the schemas of docs/schemas, and the schemas refuse what is
wrong.
"""

from __future__ import annotations

import argparse
import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.places import ROOT
from uqharness.cli import main as cli

pytestmark = pytest.mark.usefixtures("flights_here")

jsonschema = pytest.importorskip("jsonschema")

FOLDER = ROOT / "docs" / "schemas"

SCHEMAS = {
    path.stem: json.loads(path.read_text(encoding="utf-8"))
    for path in sorted(FOLDER.glob("*.json"))
}
CAMPAIGN = """
[campaign]
aircraft = "espaaro"
mission = "loiter"
seed = 1
engine = "jsbsim"
[aleatory]
flights = 4
duration_s = 5
burn_in_s = 0
turbulence = "light"
[epistemic]
method = "corners"
interior = 0
nominal = false
coefficients = ["CX", "CZ"]
bounds = { CX = 0.008, CZ = 0.05 }
"""
# Command lines in the order they need each other, {} the working folder; the schema is named by the
# words of the command.
COMMANDS = {
    "fly": "fly espaaro_truth --script doublet-elevator --noise --seed 1 --out {}/f1.parquet",
    "modes": "modes espaaro --speed-mps 22.2",
    "modes, no trim": "modes espaaro --speed-mps 5",
    "log-info": "log info {}/f1.parquet --aircraft espaaro --no-cache",
    "log-map": "log map {}/f1.parquet --aircraft espaaro --out {}/map.toml",
    "log-import": "log import {}/f1.parquet --aircraft espaaro --out {}/again.csv --no-cache",
    "log-export": (
        "log export {}/f1.parquet --aircraft espaaro --lat-deg 37 --lon-deg -80 --out {}/shown"
    ),
    "identify": (
        "identify espaaro --flight {}/f1.parquet --params aero/Cm_q --no-figures --workers 1 --out"
        " {}/identified"
    ),
    "compare-models": (
        "compare espaaro espaaro_truth --flight {}/f1.parquet --workers 1 --out {}/models"
    ),
    "author": "author KITE/kite.st KITE/kite.mass --out {}/kite",
    "performance": "performance espaaro",
    "compare": "compare espaaro --flight {}/f1.parquet --no-figures --workers 1 --out {}/gap",
    "bounds": (
        "bounds espaaro --flight {}/f1.parquet --order 0 --no-check --no-figures --out {}/bounds"
    ),
    "validate-bounds": "validate-bounds espaaro {}/bounds/model-form.json --flight {}/f1.parquet",
    "instrument": "instrument c172p --out {}/c172 --constant CX=0.01 --no-check",
    "instrument, undo": "instrument c172p --out {}/c172 --undo",
    "margins": "margins espaaro --loop elevator --flight straight",
    "diff": "diff espaaro espaaro --speed-mps 22",
    "export": "export espaaro --to csv --speed-mps 22 --states 20 --out {}/exported",
    "campaign-check": "campaign check {}/campaign.toml --workers 1",
    "campaign-run": "campaign run {}/campaign.toml --out {}/results --serial",
    "campaign-status": "campaign status {}/results",
    "campaign-report": "campaign report {}/results",
    "campaign-rerun": "campaign rerun {}/results --case {case}",
    "campaign-surrogate-check": (
        "campaign surrogate-check {}/results --flights 4 --autopilot-port 0 --autopilot-process true"
    ),
    "campaign-verify": "campaign verify {}/results",
    "campaign-salvage": "campaign salvage {}/results --workers 1",
    "campaign-convergence": "campaign convergence {}/results --repeats 2",
    "campaign-area": "campaign area {}/results --value altitude_median_m=1.0",
    "campaign-merge": "campaign merge {}/shards",
    "sensitivity": "sensitivity {}/results",
    "sensitivity-modal": "sensitivity --modal as_corrected --repeats 2",
    "report": "report {}/results",
    "dossier": "dossier {}/results",
    "completion": "completion bash",
}
DEAR = {
    "refine": (
        "refine espaaro --train {}/a.parquet --test {}/b.parquet --no-pbox --no-figures --out"
        " {}/refined"
    ),
    "study": "study tests/golden_study.toml --out {}/study",
    "next-flight": "next-flight {}/results --out {}/next --minutes 1 --no-figures",
    "next-flight-redone": (
        "next-flight {}/results --out {}/next --redone {}/bounds/model-form.json"
    ),
}


def validator(name: str) -> Any:
    return jsonschema.Draft202012Validator(SCHEMAS[name.split(",")[0]])


def printed(capsys: pytest.CaptureFixture[str], line: str, folder: Path) -> Any:
    case = ""
    if "{case}" in line:
        import pandas as pd

        case = str(pd.read_parquet(folder / "results" / "cases.parquet")["case_id"][0])
    words = line.replace("{case}", case).replace("{}", str(folder))
    words = words.replace("KITE", str(ROOT / "tests/uqharness/authoring/data")).split()
    code = cli.main([*words, "--json"])
    output = capsys.readouterr()
    assert code in (0, 1), output.err
    return json.loads(output.out, parse_constant=lambda text: f"{text} is no JSON")


SEARCHING = (
    "modes, no trim",
    "compare",
    "compare-models",
    "performance",
    "diff",
    "author",
    "bounds",
    "validate-bounds",
    "margins",
    "sensitivity-modal",
    "campaign-merge",
    "campaign-salvage",
    "campaign-convergence",
    "campaign-surrogate-check",
)
"""Commands that take seconds and that no other waits for."""


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    "left_out", [SEARCHING, pytest.param((), marks=pytest.mark.slow)], ids=["quick", "all"]
)
def test_commands_print_what_their_schemas_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], left_out: tuple[str, ...]
):
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    invalid = []
    for name, line in COMMANDS.items():
        if name in left_out:
            continue
        if name == "campaign-merge":
            for part in ("1/2", "2/2"):
                words = [
                    "campaign",
                    "run",
                    str(tmp_path / "campaign.toml"),
                    "--out",
                    str(tmp_path / "shards"),
                    "--serial",
                ]
                assert cli.main([*words, "--shard", part]) == 0
            capsys.readouterr()
        result, check = printed(capsys, line, tmp_path), validator(name)
        invalid += [
            f"{name} {error.json_path}: {error.message}" for error in check.iter_errors(result)
        ]
        invalid += [f"{name} prints NaN or Infinity"] if "is no JSON" in json.dumps(result) else []
        # The type of each value that the schema promises counts.
        for key in promised(name) & set(result):
            damaged = copy.deepcopy(result)
            damaged[key] = object()
            invalid += [f"{name} {key}: anything passes"] if check.is_valid(damaged) else []
    assert invalid == []


def promised(name: str) -> set[str]:
    """Keys of a document that its schema names."""
    schema = SCHEMAS[name.split(",")[0]]
    if "$ref" in schema:
        schema = schema["$defs"][schema["$ref"].rpartition("/")[2]]
    parts = schema.get("oneOf", [schema])
    return {key for part in parts for key in part.get("required", ())}


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("name", DEAR)
def test_a_dear_command_prints_what_its_schema_says(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for seed, flight in enumerate(("a", "b"), start=1):
        words = ["fly", "espaaro_truth", "--script", "flight-ident", "--noise", "--seed", str(seed)]
        assert cli.main([*words, "--out", str(tmp_path / f"{flight}.parquet")]) == 0
    if name.startswith("next-flight"):
        bounds = f'"{tmp_path / "bounds" / "model-form.json"}"'
        campaign = CAMPAIGN.replace("{ CX = 0.008, CZ = 0.05 }", bounds).replace(
            "duration_s = 5", "duration_s = 60"
        )
        (tmp_path / "campaign.toml").write_text(campaign)
        words = [
            "bounds",
            "espaaro",
            "--flight",
            str(tmp_path / "a.parquet"),
            "--no-check",
            "--no-figures",
        ]
        assert cli.main([*words, "--out", str(tmp_path / "bounds")]) == 0
        assert (
            cli.main(
                [
                    "campaign",
                    "run",
                    str(tmp_path / "campaign.toml"),
                    "--out",
                    str(tmp_path / "results"),
                ]
            )
            == 0
        )
    capsys.readouterr()
    result = printed(capsys, DEAR[name], tmp_path)
    assert [
        f"{error.json_path}: {error.message}" for error in validator(name).iter_errors(result)
    ] == []


def leaves(parser: argparse.ArgumentParser, path: tuple[str, ...] = ()) -> Iterator[str]:
    commands = cli.commands_of(parser)
    if not commands:
        yield "-".join(path)
    for name, command in commands.items():
        yield from leaves(command, (*path, name))


def test_every_command_has_a_schema():
    reference = set(leaves(cli.complete_parser()))
    assert reference | {"compare-models", "next-flight-redone", "sensitivity-modal"} == set(SCHEMAS)
    assert {name.split(",")[0] for name in (*COMMANDS, *DEAR)} == set(SCHEMAS)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_is_one_and_refuses_an_empty_answer(name: str):
    jsonschema.Draft202012Validator.check_schema(SCHEMAS[name])
    # Older bounds.json lack every key that could be required.
    assert not validator(name).is_valid({}) or name == "bounds"
    assert not validator(name).is_valid([])
