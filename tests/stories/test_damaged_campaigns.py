"""Damage to a campaign's folder: found by every command, told by verify, made good by run and
salvage.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.torture import tear
from tests.uqharness.campaign.test_rounds import TOML as DECIDE
from uqharness.campaign.manifest import DamageError, read_manifest, row_digest, write_manifest
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.shards import Shard, merge
from uqharness.campaign.store import JOURNAL, Store
from uqharness.campaign.verify import RunOptions, salvage, verify
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.report.write import write_report

pytestmark = pytest.mark.usefixtures("flights_here")

SMALL = (
    fakes.CAMPAIGN.replace("flights = 3", "flights = 8").partition("[epistemic]")[0]
    + """
[epistemic]
method = "corners"
interior = 0
nominal = false
coefficients = ["CX", "CY"]
bounds = { CX = 0.008, CY = 0.010 }
"""
)
TABLES = ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv")
FLYING = RunOptions(SerialExecutor(), fly=fakes.steady)


@pytest.fixture(autouse=True)
def _no_check_flight(monkeypatch):
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A complete campaign, one that decided, one in two shards, merged."""
    root = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        spec = read_campaign(fakes.campaign_file(root, SMALL))
        run_campaign(
            spec,
            root / "plain",
            executor=SerialExecutor(),
            fly=fakes.steady,
            command="uqharness campaign run",
        )
        for number in (1, 2):
            run_campaign(
                spec,
                root / "parts",
                executor=SerialExecutor(),
                fly=fakes.steady,
                shard=Shard(number, 2),
            )
        merge(root / "parts")
        (root / "decide.toml").write_text(DECIDE)
        run_campaign(
            read_campaign(root / "decide.toml"),
            root / "decide",
            executor=SerialExecutor(),
            fly=fakes.by_corner,
        )
    return root


@pytest.fixture
def copy(results, tmp_path):
    """A copy of what ``made`` has under a name; where the campaign's files lie stays as it is."""

    def copied(name):
        shutil.copytree(results / name, tmp_path / name)
        return tmp_path / name

    return copied


def tables(folder, names=TABLES):
    return {name: (folder / name).read_bytes() for name in names}


def flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << (bit % 8)
    path.write_bytes(content)


def flip_text(path, text, bit=0):
    """Flip a bit within a text of the file."""
    place = path.read_bytes().index(text)
    flip(path, 8 * (place + len(text) // 2) + bit)


def states(result):
    return {item.name: item.state for item in result.files}


def unseal(folder, state):
    """Make it a campaign that was stopped after its last flight."""
    remainder = {
        key: value
        for key, value in read_manifest(folder).items()
        if key not in ("journal", "tables")
    }
    write_manifest(folder, remainder | {"state": state})


def run_command(capsys, *words):
    """Exit code and what a command says on standard error."""
    capsys.readouterr()
    code = main(["campaign", *map(str, words)])
    return code, capsys.readouterr()


def test_verify_finds_a_written_folder_whole(copy, capsys):
    for name in ("plain", "decide", "parts"):
        folder = copy(name)
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        result = verify(folder)
        assert result.whole
        assert result.complete
        decided = ["decisions.csv"] if name == "decide" else []
        assert states(result) == dict.fromkeys(
            ("manifest.json", JOURNAL, *TABLES, *decided, "SHA256SUMS"), "whole"
        )
        assert [part.whole for part in result.shards] == [True] * (2 * (name == "parts"))
        code, output = run_command(capsys, "verify", folder, "--json")
        assert (code, json.loads(output.out)["whole"]) == (0, True)
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_salvage_of_a_flipped_row(copy, results, capsys):
    folder = copy("plain")
    flip_text(folder / JOURNAL, b'"cross_track_max_m": ')
    before = (folder / JOURNAL).read_bytes()
    code, output = run_command(
        capsys, "run", results / "campaign.toml", "--out", folder, "--serial"
    )
    assert code == 2
    assert f"{JOURNAL}: damaged: the row of flight" in output.err
    assert "nothing was changed" in output.err
    assert f"uqharness campaign salvage {folder}" in output.err
    assert tables(folder) == tables(results / "plain")
    code, output = run_command(capsys, "verify", folder)
    assert code == 1
    assert "flights: 31 sound, 1 damaged, 0 missing" in output.out
    result = salvage(folder, FLYING)
    assert (result.kept, result.flown, result.aside) == (31, 1, ["journal.damaged-1.sqlite"])
    assert (folder / "journal.damaged-1.sqlite").read_bytes() == before
    assert tables(folder) == tables(results / "plain")
    assert verify(folder).whole
    assert not list(folder.glob(".salvage*"))


@pytest.mark.parametrize("name", ["cases.parquet", "statements.csv"])
def test_a_damaged_table_is_not_read_and_written_again_from_the_journal(
    copy, results, monkeypatch, capsys, name
):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.aborts_always)
    folder = copy("plain")
    for spoil in (lambda path: flip(path, 8 * 400), lambda path: path.unlink()):
        spoil(folder / name)
        commands = [
            ("report",),
            ("convergence", "--repeats", "2"),
            ("area", "--value", "altitude_median_m=3"),
        ]
        if name == "statements.csv":
            commands = [("status",)]
        for verb, *words in commands if name in ("cases.parquet", "statements.csv") else []:
            code, output = run_command(capsys, verb, folder, *words)
            assert code == 2
            assert name in output.err
        assert states(verify(folder))[name] == (
            "damaged" if (folder / name).exists() else "missing"
        )
        code, output = run_command(
            capsys, "run", results / "campaign.toml", "--out", folder, "--serial"
        )
        assert code == 0
        assert f"{name} was not as it had been written" in output.err
        assert tables(folder) == tables(results / "plain")
        assert verify(folder).whole
    spoil = folder / name
    flip(spoil, 100)
    assert salvage(folder, FLYING).rewritten == [name]
    assert verify(folder).whole


def test_the_tables_of_a_decided_campaign_are_written_again(copy, results):
    folder = copy("decide")
    names = (*TABLES, "decisions.csv")
    flip(folder / "decisions.csv", 3000)
    with pytest.raises(BadInputError, match=r"decisions\.csv: damaged"):
        write_report(folder)
    spec = read_campaign(results / "decide.toml")
    summary = run_campaign(spec, folder, executor=SerialExecutor(), fly=fakes.aborts_always)
    assert summary.rewritten == ("decisions.csv",)
    assert tables(folder, names) == tables(results / "decide", names)
    flip_text(folder / JOURNAL, b'"excursions_15m": ')
    assert salvage(folder, RunOptions(SerialExecutor(), fly=fakes.by_corner)).flown == 1
    assert tables(folder, names) == tables(results / "decide", names)


def test_verify_holds_a_consistent_journal_against_the_manifest(copy):
    # The row, its digest and the tally fit each other: only the manifest knows another flight.
    folder = copy("plain")
    with Store(folder) as store:
        first = next(iter(store.outcomes()))
        store.add([replace(first, flown_s=first.flown_s + 1.0)])
    result = verify(folder)
    journal = next(item for item in result.files if item.name == JOURNAL)
    assert (journal.state, result.whole) == ("damaged", False)
    assert "manifest" in journal.remark


def test_verify_holds_a_consistent_table_against_the_manifest(copy):
    # SHA256SUMS are made anew after the change: only the manifest knows another table.
    folder = copy("plain")
    table = folder / "excursions.csv"
    table.write_bytes(table.read_bytes() + b"\n")
    sums = folder / "SHA256SUMS"
    lines = [line for line in sums.read_text().splitlines() if "excursions.csv" not in line]
    sums.write_text(
        "\n".join([*lines, f"{hashlib.sha256(table.read_bytes()).hexdigest()}  excursions.csv"])
        + "\n"
    )
    result = verify(folder)
    item = next(item for item in result.files if item.name == "excursions.csv")
    assert (item.state, result.whole) == ("damaged", False)
    assert "manifest" in item.remark


def test_verify_tells_a_row_with_a_digest_of_its_own(copy):
    folder = copy("plain")
    with closing(sqlite3.connect(folder / JOURNAL)) as database, database:
        rows = database.execute("select * from outcome limit 1")
        (case, status, reason, _, *remainder, _), column = rows.fetchone(), rows.description[-1][0]
        digest = row_digest([case, status, reason, 1.0, *remainder])
        change = f"update outcome set flown_s = 1.0, {column} = ? where case_id = ?"
        database.execute(change, (digest, case))
    assert states(verify(folder))[JOURNAL] == "damaged"


def test_a_run_that_was_not_complete_is_held_against_its_rows(copy, results, tmp_path):
    """Without a seal: a row lost, changed or added, and a tally that was, each by itself."""
    folder = copy("plain")
    unseal(folder, "interrupted")
    spoils = {
        "delete from outcome where case_id = (select min(case_id) from outcome)": (
            "31 flights are in it, 32 were stored"
        ),
        "update outcome set flown_s = 1.0 where case_id = (select min(case_id) from outcome)": (
            "does not fit its digest"
        ),
        "update tally set statuses = '{\"ok\": 31}'": "tally of flights does not fit",
        "drop table tally": "its tables are not those",
    }
    for statement, output in spoils.items():
        place = tmp_path / "spoilt"
        shutil.copytree(folder, place)
        with closing(sqlite3.connect(place / JOURNAL)) as database, database:
            database.execute(statement)
        with pytest.raises(BadInputError, match=output):
            run_campaign(
                read_campaign(results / "campaign.toml"),
                place,
                executor=SerialExecutor(),
                fly=fakes.steady,
            )
        assert not verify(place).whole
        salvage(place, FLYING)
        assert tables(place) == tables(results / "plain")
        shutil.rmtree(place)
    assert verify(folder).whole
    assert verify(folder).complete is False


@pytest.mark.parametrize("offset", [0, 100, 8192])
def test_salvage_of_a_torn_journal(copy, results, offset):
    folder = copy("plain")
    content = bytearray((folder / JOURNAL).read_bytes())
    content[offset : offset + 40] = bytes(40)
    (folder / JOURNAL).write_bytes(content)
    assert states(verify(folder))[JOURNAL] == "damaged"
    result = salvage(folder, FLYING)
    assert result.kept + result.flown == 32
    assert tables(folder) == tables(results / "plain")
    if offset < 8192:
        assert result.kept == 32  # the first page is the same in all journals
    assert verify(folder).whole


@pytest.mark.parametrize("absent", ["text", "cut", "deleted"])
def test_salvage_of_a_journal_that_is_none(copy, results, absent):
    folder = copy("plain")
    path = folder / JOURNAL
    if absent == "deleted":
        path.unlink()
    else:
        path.write_bytes({"text": b"no database" * 900, "cut": path.read_bytes()[:9000]}[absent])
    with pytest.raises(BadInputError, match="damaged"):
        run_campaign(
            read_campaign(results / "campaign.toml"),
            folder,
            executor=SerialExecutor(),
            fly=fakes.steady,
        )
    assert not verify(folder).whole
    salvage(folder, FLYING)
    assert tables(folder) == tables(results / "plain")
    assert verify(folder).whole


def test_a_damaged_manifest_is_rebuilt_from_the_campaign_file(copy, results, capsys):
    spec = read_campaign(results / "campaign.toml")
    for spoil in (
        lambda path: flip(path, 800),
        lambda path: path.write_text("{"),
    ):
        folder = copy("plain")
        spoil(folder / "manifest.json")
        for verb in ("status", "report"):
            assert run_command(capsys, verb, folder)[0] == 2
        assert run_command(capsys, "verify", folder)[0] == 1
        with pytest.raises(BadInputError, match=r"--campaign CAMPAIGN\.toml"):
            salvage(folder, FLYING)
        other = read_campaign(results / "decide.toml")
        with pytest.raises(BadInputError, match="32 of its 32 undamaged flights do not belong to"):
            salvage(folder, FLYING, other)
        with pytest.raises(BadInputError, match="4 of its 32 undamaged flights do not belong to"):
            salvage(folder, FLYING, spec.with_flights(7))
        result = salvage(folder, FLYING, spec, "uqharness campaign run x")
        assert (result.kept, result.flown) == (32, 0)
        assert tables(folder) == tables(results / "plain")
        assert read_manifest(folder)["command"] == "uqharness campaign run x"
        assert verify(folder).whole
        shutil.rmtree(folder)


def test_shards_are_salvaged_each_and_merged_again(copy, results, capsys):
    folder = copy("parts")
    flip_text(folder / "shards" / "1-of-2" / JOURNAL, b'"speed_mean_mps": ')
    assert merge(folder).missing == 0  # the merged folder has what it needs
    result = verify(folder)
    assert [part.whole for part in result.shards] == [False, True]
    assert not result.whole
    done = salvage(folder, FLYING)
    assert [(Path(part.folder).name, part.flown) for part in done.shards] == [("1-of-2", 1)]
    assert verify(folder).whole
    flip_text(folder / JOURNAL, b'"speed_mean_mps": ')
    with pytest.raises(BadInputError, match="damaged"):
        merge(folder)
    done = salvage(folder, FLYING)
    assert (done.kept, done.flown, done.missing, done.aside) == (
        32,
        0,
        0,
        ["journal.damaged-1.sqlite"],
    )
    (folder / "manifest.json").write_text("{")
    salvage(folder, FLYING)
    flip(folder / "shards" / "2-of-2" / "manifest.json", 900)
    salvage(folder, FLYING, read_campaign(results / "campaign.toml"))
    assert verify(folder).whole
    assert tables(folder) == tables(results / "plain")
    flip_text(folder / "shards" / "2-of-2" / JOURNAL, b'"speed_mean_mps": ')
    assert salvage(folder / "shards" / "2-of-2", FLYING).flown == 1
    assert verify(folder).whole


def test_verify_after_a_writer_was_killed(copy, results):
    folder = copy("plain")
    unseal(folder, "running")
    script = (
        "import os, sqlite3, sys\n"
        "database = sqlite3.connect(sys.argv[1])\n"
        "database.execute('pragma cache_size = 1')\n"
        "database.execute('delete from outcome')\n"
        "rows = [(f'x{i}', 'ok', '', 1.0, '{}' * 900, '{}', '') for i in range(500)]\n"
        "database.executemany('insert into outcome values (?,?,?,?,?,?,?)', rows)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", script, str(folder / JOURNAL)], check=False)
    leftover = folder / f"{JOURNAL}-journal"
    before = (folder / JOURNAL).read_bytes(), leftover.read_bytes()
    assert verify(folder).whole
    assert ((folder / JOURNAL).read_bytes(), leftover.read_bytes()) == before
    # With what was to be taken back gone, the file is half written, and that is found.
    torn = folder.parent / "torn"
    shutil.copytree(folder, torn)
    (torn / leftover.name).unlink()
    assert not verify(torn).whole
    salvage(torn, FLYING)
    assert tables(torn) == tables(results / "plain")
    result = salvage(folder, FLYING)
    assert (result.kept, result.flown, result.aside) == (32, 0, [])
    assert tables(folder) == tables(results / "plain")


def killed_at(step, folder):
    """Whether a salvage in another process was killed before its n-th change of the folder, or came
    to its end.
    """
    process = os.fork()
    if process == 0:
        with contextlib.suppress(BaseException):
            tear(f"step:{step}")
            salvage(folder, FLYING)
            os._exit(0)
        os._exit(9)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    assert code in (0, -signal.SIGKILL)
    return code != 0


def kill_and_go_on(step, folder, results):
    """False where the salvage came to its end before that step."""
    flip_text(folder / JOURNAL, b'"speed_mean_mps": ')
    killed = killed_at(step, folder)
    if step % 2 and killed:
        salvage(folder, FLYING)
    else:
        try:
            run_campaign(
                read_campaign(results / "campaign.toml"),
                folder,
                executor=SerialExecutor(),
                fly=fakes.steady,
            )
        except DamageError:
            salvage(folder, FLYING)
    assert tables(folder) == tables(results / "plain"), step
    assert verify(folder).whole, step
    return killed


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_killed_salvage_goes_on(copy, results):
    for step in (3, 6, 12):
        folder = copy("plain")
        assert kill_and_go_on(step, folder, results)
        shutil.rmtree(folder)


@pytest.mark.parametrize("damages", [4, pytest.param(300, marks=pytest.mark.slow)])
def test_random_damage_has_no_effect_or_is_reported(
    results, tmp_path, capsys, monkeypatch, damages
):
    """One flipped bit or some random bytes anywhere in a file of the folder."""
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    folder = tmp_path / "copy"
    shutil.copytree(results / "plain", folder)
    sound = run_command(capsys, "status", folder, "--json")[1].out
    chance = random.Random(7)
    reported = 0
    for _ in range(damages):
        shutil.rmtree(folder)
        shutil.copytree(results / "plain", folder)
        path = folder / chance.choice(["manifest.json", JOURNAL, JOURNAL, *TABLES])
        content = bytearray(path.read_bytes())
        place = chance.randrange(len(content))
        if chance.random() < 0.5:
            content[place : place + 30] = chance.randbytes(30)
        else:
            content[place] ^= 1 << chance.randrange(8)
        path.write_bytes(content)
        damaged = not verify(folder).whole
        reported += damaged
        code, output = run_command(capsys, "status", folder, "--json")
        assert (code, output.out) == (0, sound) or (code == 2 and damaged), path
        before = {name: (folder / name).read_bytes() for name in ("manifest.json", JOURNAL)}
        code, _ = run_command(capsys, "run", results / "campaign.toml", "--out", folder, "--serial")
        if code == 0:
            assert tables(folder) == tables(results / "plain"), path
        else:
            assert damaged, path
            assert {name: (folder / name).read_bytes() for name in before} == before
        salvage(folder, FLYING, read_campaign(results / "campaign.toml"))
        assert tables(folder) == tables(results / "plain"), path
    assert reported > 0.4 * damages
