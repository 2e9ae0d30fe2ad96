"""manifest.json and tables with wrong content: one sentence and exit code 2 in every command; folders of version 0.1."""

from __future__ import annotations

import copy
import io
import json
import random
import shutil
import tomllib

import pandas as pd
import pytest

from sysid.foreign.regular_files import sha256_hex
from tests.helpers import campaign_fakes as fakes
from tests.helpers.campaign_fakes import CAMPAIGN
from tests.helpers.places import TESTS
from uqharness.campaign.manifest import (
    checked_content,
    digest_of_text,
    read_manifest,
    write_manifest,
)
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.cli.main import main
from uqharness.next_flight.points import open_campaign

pytestmark = pytest.mark.usefixtures("flights_here")

OLD = TESTS / "format_1"


READING = (
    ["campaign", "status"],
    ["campaign", "report", "--no-tracks"],
    ["sensitivity"],
    ["campaign", "convergence", "--repeats", "2"],
    ["campaign", "area", "--value", "altitude_median_m=3"],
)


FLYING = (["campaign", "rerun", "--case", "0"], ["campaign", "merge"], ["campaign", "salvage"])


@pytest.fixture(autouse=True)
def _no_check_flight(monkeypatch):
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    root = tmp_path_factory.mktemp("manifest")
    text = fakes.CAMPAIGN.replace("flights = 3", "flights = 4").partition("[epistemic]")[0]
    text += '[epistemic]\nmethod = "corners"\ncoefficients = ["CX", "CY"]\n'
    text += "bounds = { CX = 0.008, CY = 0.010 }\n"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        spec = read_campaign(fakes.campaign_file(root, text))
        run_campaign(spec, root / "out", executor=SerialExecutor(), fly=fakes.steady)
    return root / "out"


def call(capsys, words, folder):
    """Exit code and output of a command on a folder; a traceback would pass through."""
    capsys.readouterr()
    number = 2 if words[0] == "campaign" else 1
    code = main([*words[:number], str(folder), *words[number:]])
    return code, capsys.readouterr()


def sealed(folder, document):
    """Write a manifest as somebody would who knows how its digest is made."""
    content = {key: value for key, value in document.items() if key != "digest"}
    (folder / "manifest.json").write_text(json.dumps(content | {"digest": digest_of_text(content)}))


def places(tree, prefix=()):
    for key, value in tree.items():
        yield (*prefix, key)
        if isinstance(value, dict):
            yield from places(value, (*prefix, key))


@pytest.mark.parametrize("every", [12, pytest.param(1, marks=pytest.mark.slow)])
def test_a_missing_or_retyped_part_is_one_sentence(results, tmp_path, capsys, every):
    """Also with a digest that fits, in every command."""
    folder = tmp_path / "out"
    shutil.copytree(results, folder)
    document = json.loads((results / "manifest.json").read_text())
    chance = random.Random(1)
    strange = [None, True, -1, 1.5, "x", [], {}, [1], {"a": 1}, "\x00", 1e400, 2**70]
    refused = 0
    for place in list(places(document))[::every]:
        for kind in ("gone", "retyped"):
            changed = copy.deepcopy(document)
            node = changed
            for key in place[:-1]:
                node = node[key]
            if kind == "gone":
                del node[place[-1]]
            else:
                node[place[-1]] = chance.choice(strange)
            sealed(folder, changed)
            for words in chance.sample([*READING[:3], *FLYING, ["campaign", "verify"]], 2):
                code, output = call(capsys, words, folder)
                assert code in (0, 1, 2), (place, kind, words)
                if code == 2:
                    refused += 1
                    assert output.err.startswith("uqharness: error: ")
                    assert "Traceback" not in output.err
                assert "\x00" not in output.err
    assert refused > 30 / every


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[" * 99_999,
        "1" * 5000,
        *(f'{{"format": {kind}}}' for kind in ("2", "true")),
    ],
    ids=range(5),
)
def test_files_that_are_no_manifest(tmp_path, capsys, text):
    (tmp_path / "manifest.json").write_text(text)
    for words in (*READING, *FLYING[:1], FLYING[2]):
        code, output = call(capsys, words, tmp_path)
        assert code == 2
        assert "manifest.json" in output.err
    assert call(capsys, ["campaign", "verify"], tmp_path)[0] == 1


def test_a_changed_manifest_is_refused(results, tmp_path, capsys):
    document = json.loads((results / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps(document))
    assert read_manifest(tmp_path) == read_manifest(results)
    for changed in (document | {"cases": 17}, document | {"note": "x"}, document | {"format": 1}):
        (tmp_path / "manifest.json").write_text(json.dumps(changed))
        code, output = call(capsys, ["campaign", "status"], tmp_path)
        assert (code, "does not fit its digest" in output.err) == (2, True)


def write_value(folder, name, content):
    """A table with a digest that fits, as damage cannot make it and another program could."""
    (folder / name).write_bytes(content)
    manifest = read_manifest(folder)
    write_manifest(folder, manifest | {"tables": manifest["tables"] | {name: sha256_hex(content)}})


def test_tables_with_a_column_less_or_of_another_type_are_one_sentence(results, tmp_path, capsys):
    frame = pd.read_parquet(results / "cases.parquet")
    absent = ("extrapolated_share", "level_CX", "status", "excursions_15m_3d")
    invalid = {name: frame.drop(columns=name) for name in absent}
    invalid |= {
        f"{name} retyped": frame.assign(**{name: "x"}) for name in ("wind_mps", "aleatory_id")
    }
    for column, value in (("status", "fine"), ("turbulence", "wild"), ("case_id", None)):
        invalid[f"{column} strange"] = frame.assign(**{column: value})
    invalid |= {"flights": frame.iloc[:3], "none": frame.iloc[:0]}
    for name, changed in invalid.items():
        folder = tmp_path / name.replace(" ", "-")
        shutil.copytree(results, folder)
        changed.to_parquet(folder / "new.parquet")
        write_value(folder, "cases.parquet", (folder / "new.parquet").read_bytes())
        for words in READING[1:]:
            code, output = call(capsys, words, folder)
            assert (code, "cases.parquet: " in output.err) == (2, True), name
            assert name.split()[0] in output.err or name == "none"


@pytest.mark.parametrize(
    ("name", "number", "words"),
    [
        ("statements.csv", "hours", ["campaign", "status"]),
        ("sensitivity.csv", "share_min", ["campaign", "report"]),
    ],
)
def test_csv_tables_with_a_column_less_or_no_number_are_one_sentence(
    results, tmp_path, capsys, name, number, words
):
    folder = tmp_path / "out"
    shutil.copytree(results, folder)
    assert main(["sensitivity", str(folder)]) in (0, 1)
    text = (folder / name).read_text()
    frame = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
    last = len(text.splitlines()[-1]) // 2 + 1
    for changed in (
        frame.drop(columns=number).to_csv(index=False).encode(),
        text[:-last].encode(),
        b"\xff\xfe",
    ):
        write_value(folder, name, changed)
        code, output = call(capsys, words, folder)
        assert (code, name in output.err) == (2, True)
    assert "not a text file in UTF-8" in output.err


def test_results_of_0_1_can_be_read(tmp_path, capsys):
    folder, repeat = tmp_path / "results", tmp_path / "again" / "out"
    shutil.copytree(OLD / "results", folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    output = {}
    for words in READING:
        code, output[words[-1]] = call(capsys, words, folder)
        assert code in (0, 1), words
    assert "complete, 16 of 16 flights done, none failed" in output["status"].out
    assert {name: (folder / name).read_bytes() for name in before} == before
    # The same flights by this version: the tables are the same bytes, but for bands, which are
    # rounded up to 1e-9 since 0.3.
    spec = read_campaign(fakes.campaign_file(repeat.parent, (OLD / "campaign.toml").read_text()))
    run_campaign(spec, repeat, executor=SerialExecutor(), fly=fakes.steady)
    assert (repeat / "excursions.csv").read_bytes() == before["excursions.csv"]
    # Statements have more columns since 0.6 (aborted flights, measured clusters).
    statements, reports = (pd.read_csv(place / "statements.csv") for place in (repeat, folder))
    pd.testing.assert_frame_equal(statements[list(reports)], reports, check_exact=True)
    current, previous = (pd.read_parquet(place / "pbox.parquet") for place in (repeat, folder))
    pd.testing.assert_frame_equal(current, previous, check_exact=False, rtol=0.0, atol=2e-9)
    same = [name for name in current if not name.startswith("band_")]
    pd.testing.assert_frame_equal(current[same], previous[same], check_exact=True)


def test_results_of_0_1_are_not_flown_on_but_their_mission_is(tmp_path, capsys):
    """The latter for next-flight: the same aircraft may have another hash now, and the table's ids
    are of the old one.
    """
    campaign = fakes.campaign_file(tmp_path, (OLD / "campaign.toml").read_text())
    folder, merged = tmp_path / "results", tmp_path / "merged"
    shutil.copytree(OLD / "results", folder)
    shutil.copytree(folder, merged / "shards" / "1-of-1")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    words = f"run {campaign} --out {folder} --serial\nrerun {folder} --case 0\nsalvage {folder}"
    for line in f"{words}\nmerge {merged}\nsalvage {merged}".splitlines():
        capsys.readouterr()
        assert main(["campaign", *line.split()]) == 2
        output = "made by uqharness 0.1, whose flights have no digests: finish it"
        assert output in capsys.readouterr().err
    code, output = call(capsys, ["campaign", "verify"], folder)
    assert (code, output.out.count("no digests")) == (1, 6)
    assert all((folder / name).read_bytes() == content for name, content in before.items())
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["campaign_file"] = str(tmp_path / "campaign.toml")
    (folder / "manifest.json").write_text(json.dumps(manifest))
    result = open_campaign(folder)
    assert (len(result.cases), result.failed, result.same_aircraft) == (16, 0, False)


GOOD = {
    "format": 2,
    "state": "running",
    "command": "uqharness campaign run",
    "seed": 7,
    "cases": 192,
    "versions": {"numpy": "2"},
    "campaign": tomllib.loads(CAMPAIGN),
    "hashes": {"aircraft": "a" * 64, "script": "b" * 64},
}


STRANGE_SEED = {**GOOD["campaign"], "campaign": {**GOOD["campaign"]["campaign"], "seed": "x"}}


@pytest.mark.parametrize(
    ("change", "output"),
    [
        ({"format": 3}, "format: must be 1 or 2"),
        ({"state": "asleep"}, "state: must be"),
        ({"seed": 8}, "seed is 8, that of the campaign in it 7"),
        ({"seed": True}, "seed: must be"),
        ({"cases": -1}, "cases: must be greater than or equal to 0"),
        ({"hashes": {"aircraft": "a" * 64}}, "hashes lack script"),
        ({"hashes": {"aircraft": "xyz", "script": "b" * 64}}, "hashes.aircraft"),
        ({"state": "complete"}, "it is complete and has no digest of the journal"),
        ({"tables": {"../a.csv": "a" * 64}}, "tables"),
        ({"shard": "1/2/3"}, "shard"),
        ({"campaign": {}}, "campaign.*is missing"),
        ({"campaign": STRANGE_SEED}, "campaign.campaign.seed"),
        ({"bounds": {"confidence": 1.5, "transient": []}}, r"bounds\.confidence"),
    ],
)
def test_bad_content_is_named(change, output):
    with pytest.raises(ValueError, match=output):
        checked_content(GOOD | change)


def test_defaults_are_filled_in_and_old_campaigns_of_corners_have_no_interior_points():
    result = checked_content(GOOD | {"of_a_later_version": 1})
    assert (result["of_a_later_version"], result["campaign"]["stop"]["rule"]) == (1, "flights")
    assert "stop" not in GOOD["campaign"]

    def epistemic(**more):
        section = {"method": "corners", "bounds": "model-form.json", **more}
        changed = GOOD | {"campaign": GOOD["campaign"] | {"epistemic": section}}
        return checked_content(changed)["campaign"]["epistemic"]

    old = epistemic()
    assert (old["interior"], old["nominal"], old["set"]) == (0, False, "box")
    assert epistemic(interior=16)["interior"] == 16
