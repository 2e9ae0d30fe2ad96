"""Flip single bits of finished journals, tables and manifests, and see whether anybody could be
misled by it.

Each flip is made in a copy of a small campaign's folder; then verify, status, report (where it
reads the file) and the command that flew it are called, in this process. No effect: tables, report
and answers are the same bytes. Found: a command says so in a sentence, verify does too, what the
others give is the same, and a run that refuses has changed no file. SILENT: anything else.
Traceback: a command ends in one."""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
import signal
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.helpers import campaign_fakes as fakes

NO_EFFECT, FOUND, SILENT, TRACEBACK = "no effect", "found", "SILENT", "traceback"
OUTCOMES = (NO_EFFECT, FOUND, SILENT, TRACEBACK)
TABLES = (
    "cases.parquet",
    "pbox.parquet",
    "excursions.csv",
    "statements.csv",
    "decisions.csv",
    "sensitivity.csv",
)
JOURNAL, LEFTOVER, MANIFEST = "journal.sqlite", "journal.sqlite-journal", "manifest.json"
_MARGIN_BYTES = 128
_REPORTED = (MANIFEST, "cases.parquet", "decisions.csv", "sensitivity.csv")
"""What a report reads."""


@dataclass(frozen=True)
class Folder:
    """A campaign's folder, the file that it was flown from, and the files in it whose bits are
    flipped.
    """

    path: Path
    campaign: Path
    files: tuple[str, ...]


@dataclass(frozen=True)
class Seen:
    """What commands gave: their output, tables and report, who complained, and whether a run that
    did changed a file.
    """

    given: dict[str, str | bytes]
    complaints: tuple[str, ...]
    traceback: str = ""
    changed: bool = False


def make_folders(root: Path) -> list[Folder]:
    """A complete campaign, one that decided, one stopped before its tables, with free pages, and
    one killed in a batch.
    """
    from tests.uqharness.campaign.test_rounds import TOML

    if not (root / "killed").exists():
        _fly(root, TOML)
    plain, decide = root / "campaign.toml", root / "decide.toml"
    complete = (MANIFEST, JOURNAL, *TABLES)
    return [
        Folder(
            root / "plain",
            plain,
            tuple(name for name in complete if (root / "plain" / name).exists()),
        ),
        Folder(
            root / "decide",
            decide,
            tuple(name for name in complete if (root / "decide" / name).exists()),
        ),
        Folder(root / "unfinished", plain, (MANIFEST, JOURNAL)),
        Folder(root / "killed", plain, (JOURNAL, LEFTOVER)),
    ]


def _fly(root: Path, deciding: str) -> None:
    root.mkdir(parents=True, exist_ok=True)
    text = fakes.CAMPAIGN.replace("flights = 3", "flights = 24").partition("[epistemic]")[0]
    text += (
        '[epistemic]\nmethod = "corners"\ncoefficients = ["CX", "CY"]\nbounds = { CX = 0.008, CY ='
        " 0.010 }\n"
    )
    text += "interior = 0\nnominal = false\n"
    text += "[metrics]\nexcursion_radius_m = 15\n"
    plain, decide = fakes.campaign_file(root, text), root / "decide.toml"
    decide.write_text(
        deciding.replace("flights = 40", "flights = 8").replace(
            "[metrics]", "[metrics]\nexcursion_radius_m = 15"
        )
    )
    for name, campaign in (("plain", plain), ("decide", decide)):
        assert _call("campaign", "run", campaign, "--out", root / name, "--serial")[0] == 0
        assert _call("sensitivity", root / name)[0] in (0, 1)
    unfinished = root / "unfinished"
    shutil.copytree(root / "plain", unfinished)
    _stop_before_the_tables(unfinished)
    with closing(sqlite3.connect(unfinished / JOURNAL)) as database:
        _write_and_remove(database)
    killed = root / "killed"
    shutil.copytree(unfinished, killed)
    _kill_in_a_batch(killed)


def _stop_before_the_tables(folder: Path) -> None:
    from uqharness.campaign.manifest import read_manifest, write_manifest

    rest = {
        key: value
        for key, value in read_manifest(folder).items()
        if key not in ("journal", "tables")
    }
    write_manifest(folder, rest | {"state": "interrupted"})
    for name in TABLES:
        (folder / name).unlink(missing_ok=True)


def _write_and_remove(database: sqlite3.Connection) -> None:
    rows = [(f"x{number}", "ok", "", 1.0, "{}" * 900, "{}", "") for number in range(60)]
    with database:
        database.executemany("insert into outcome values (?,?,?,?,?,?,?)", rows)
    with database:
        database.execute("delete from outcome where case_id like 'x%'")


def _kill_in_a_batch(folder: Path) -> None:
    process = os.fork()
    if process == 0:
        database = sqlite3.connect(folder / JOURNAL)
        database.execute("pragma cache_size = 1")
        database.execute("update outcome set reason = 'half of a batch'")
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(process, 0)
    assert (folder / LEFTOVER).stat().st_size > 0


def _call(*words: object) -> tuple[int, str, str]:
    from uqharness.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def look(folder: Folder, place: Path, with_report: bool = True) -> Seen:
    """Call the commands on a copy of ``folder`` in ``place``."""
    given: dict[str, str | bytes] = {}
    complaints: list[str] = []
    changed = False
    words: dict[str, Callable[[], list[object]]] = {
        "verify": lambda: ["campaign", "verify", place],
        "status": lambda: ["campaign", "status", place, "--json"],
        "report": lambda: ["campaign", "report", place, "--no-tracks"],
        "run": lambda: ["campaign", "run", folder.campaign, "--out", place, "--serial"],
        "status after": lambda: ["campaign", "status", place, "--json"],
        "report after": lambda: ["campaign", "report", place, "--no-tracks"],
    }
    for name, command in words.items():
        if name.startswith("report") and not (
            with_report and (folder.path / "cases.parquet").exists()
        ):
            continue
        before = _content(place) if name == "run" else {}
        try:
            code, out, err = _call(*command())
        except BaseException as error:
            return Seen(given, tuple(complaints), f"{name}: {type(error).__name__}: {error}")
        if code == 2 or "was not as it had been written" in err or (name == "verify" and code != 0):
            complaints.append(name)
        if code == 2 and name == "run":
            changed = any(
                before.get(key) != value for key, value in _content(place).items() if key in before
            )
            break
        if code != 2:
            given |= {name: out} if name.startswith("status") else {}
            if name.startswith("report"):
                given[name] = (place / "report.html").read_bytes()
            if name == "run":
                given |= {
                    table: (place / table).read_bytes()
                    for table in TABLES[:5]
                    if (place / table).exists()
                }
    return Seen(given, tuple(complaints), changed=changed)


def _content(place: Path) -> dict[str, bytes]:
    # What a killed writer left is taken back by whoever opens the journal next.
    but_for = ["run.lock", *((JOURNAL, LEFTOVER) if (place / LEFTOVER).exists() else ())]
    return {
        path.name: path.read_bytes()
        for path in place.iterdir()
        if path.is_file() and path.name not in but_for
    }


def flips(
    folders: list[Folder], count: int, chance: random.Random
) -> Iterator[tuple[Folder, str, int]]:
    """Folder, file and bit: half of the bits anywhere in a file, the others near its ends or those
    of a page.
    """
    every = [(folder, name) for folder in folders for name in folder.files]
    # The journal is by far the largest, and the one that is read in parts.
    weights = [6 if name == JOURNAL else 2 if name == LEFTOVER else 1 for _, name in every]
    for folder, name in chance.choices(every, weights, k=count):
        size = (folder.path / name).stat().st_size
        place = chance.randrange(size)
        if chance.random() < 0.5:
            begin = chance.choice([0, *range(0, size, 8192), max(size - _MARGIN_BYTES, 0)])
            place = min(begin + chance.randrange(_MARGIN_BYTES), size - 1)
        yield folder, name, 8 * place + chance.randrange(8)


def judge(seen: Seen, reference: Seen) -> str:
    """Outcome of one flip."""
    if seen.traceback:
        return TRACEBACK
    if seen.changed or any(
        value != reference.given.get(name) for name, value in seen.given.items()
    ):
        return SILENT
    if seen.complaints:
        return FOUND if "verify" in seen.complaints else SILENT
    return NO_EFFECT


def run(
    count: int, seed: int, root: Path, say: Callable[[str], None] = lambda _: None
) -> dict[str, Counter[str]]:
    """Outcomes by folder and file; the folders are made in ``root`` unless they are there."""
    with harmless():
        folders = make_folders(root / "made")
        references = {}
        for folder in folders:
            references[folder.path] = look(folder, copied(folder, root / "copy"))
            assert not references[folder.path].complaints, references[folder.path].complaints
        found: dict[str, Counter[str]] = {}
        for number, (folder, name, bit) in enumerate(flips(folders, count, random.Random(seed))):
            place = copied(folder, root / "copy")
            flip(place / name, bit)
            seen = look(folder, place, name in _REPORTED)
            outcome = judge(seen, references[folder.path])
            found.setdefault(f"{folder.path.name}/{name}", Counter())[outcome] += 1
            if outcome in (SILENT, TRACEBACK):
                say(
                    f"flip {number}: {folder.path.name}/{name} bit {bit}: {outcome}"
                    f" {seen.traceback} {seen.complaints}"
                )
    return found


def flip(path: Path, bit: int) -> None:
    """Flip one bit of a file."""
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << (bit % 8)
    path.write_bytes(content)


def copied(folder: Folder, place: Path) -> Path:
    """A copy of a folder in place of what is there."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder.path, place)
    return place


@contextlib.contextmanager
def harmless() -> Iterator[None]:
    """Flights and check flights that cost nothing, and tables that are made once from the same
    flights.
    """
    import uqharness.campaign.run as campaign
    import uqharness.campaign.shards as seal
    import uqharness.flight.fly as flight

    made: dict[str, dict[str, bytes]] = {}

    def make_tables(
        spec: Any, cases: Any, outcomes: Any, decisions: bytes | None = None
    ) -> dict[str, bytes]:
        flown = list(outcomes)
        key = repr((spec.as_dict(), [case.case_id for case in cases], flown, decisions))
        if key not in made:
            made[key] = before[2](spec, cases, flown, decisions)
        return made[key]

    before = campaign.validate_model, flight.fly, campaign.make_tables
    campaign.validate_model, flight.fly = (lambda fly, case: None), fakes.steady
    campaign.make_tables = seal.make_tables = make_tables
    try:
        yield
    finally:
        campaign.validate_model, flight.fly, campaign.make_tables = before
        seal.make_tables = before[2]
