"""Folders of results, which people exchange too: manifest, journal, tables, documents that report
pages are written from.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sysid.foreign.typed_files import MAGIC
from tests.fuzz import damage_bytes
from tests.fuzz.damage_tables import npz_damage, parquet_damage, sqlite_damage
from tests.fuzz.damage_text import damaged_table
from tests.fuzz.damage_tree import json_damage
from tests.fuzz.formats import Files, Format, Mutator, folder
from tests.fuzz.outcome import Refused, call, command

Target = Callable[[Path, int], None]
_QUESTIONS = (
    ("campaign", "status"),
    ("campaign", "status", "--json"),
    ("campaign", "verify"),
    ("campaign", "verify", "--json"),
    ("campaign", "report", "--no-tracks"),
    ("report",),
    ("sensitivity",),
    ("campaign", "convergence", "--repeats", "2"),
    ("campaign", "area", "--value", "cross_track_median_m=9.4"),
)


def _ask(place: Path, seed: int) -> None:
    """One of the commands that read a campaign's folder; the cheap ones more often."""
    asked = _QUESTIONS[seed % 4] if seed % 3 else _QUESTIONS[4 + seed // 3 % (len(_QUESTIONS) - 4)]
    from tests.fuzz.outcome import known_verbs

    if asked[0] == "campaign" and asked[1] not in known_verbs():
        asked = ("campaign", "status")
    command(*asked, str(place))


def _journal(place: Path, seed: int) -> None:
    """What reads the journal row by row, besides the commands."""
    if seed % 4 > 1:
        _ask(place, seed)
        return

    def outcomes() -> None:
        from uqharness.campaign.store import JournalScan, Store

        if seed % 4:
            list(JournalScan(place, place / "recovered").rows(["4c4000eebc386034"]))
            return
        with Store(place, read_only=True) as store:
            list(store.outcomes())
            sorted(store.finished())
            store.outcome("4c4000eebc386034")

    call(outcomes)


def _report(place: Path, seed: int) -> None:
    command("report", str(place), *(["--json"] if seed % 2 else []))


def _area(kind: str) -> Target:
    """``campaign area`` with a table of flights."""
    return lambda place, _: command(
        "campaign", "area", str(place), "--flight", str(place / f"flights.{kind}")
    )


def _undo(place: Path, seed: int) -> None:
    command("instrument", "dart", "--undo", "--out", str(place / "dart"))


def _npz(place: Path, seed: int) -> None:
    from uqharness.sensitivity.study import read_study

    call(read_study, place / "study.npz")


def _stage(place: Path, seed: int) -> None:
    from sysid.foreign.typed_files import DataFileError, load

    try:
        load((place / "stage.data").read_bytes())
    except DataFileError as error:
        # Its caller names the file.
        raise Refused(f"{place / 'stage.data'}: {error}") from None


def _order(place: Path, seed: int) -> None:
    """What comes over Dask's wire: orders to a worker and its answers. Nothing is flown."""
    from uqharness.campaign.dask import answer_from, order_from

    text = (place / "order.json").read_text(encoding="utf-8", errors="replace")
    try:
        call(order_from, text) if seed % 2 else call(answer_from, text, "4c4000eebc386034")
    except Refused as error:
        # No file of the user's: the sentence is about what came over the wire.
        raise Refused(f"{place / 'order.json'}: {error}") from None


_CAMPAIGNS = (folder("results/campaign"), folder("../../format_1/results"))


def _signed_again(files: Files, name: str, rng: np.random.Generator) -> None:
    """Every other time the manifest's digests are made to fit, so that what lies behind them is
    reached.
    """
    from sysid.foreign.regular_files import sha256_hex
    from uqharness.campaign.manifest import digest_of_text

    try:
        manifest = json.loads(files["manifest.json"])
    except (ValueError, RecursionError):
        return
    if rng.random() < 0.5 or not isinstance(manifest, dict) or "digest" not in manifest:
        return
    if isinstance(tables := manifest.get("tables"), dict) and name in tables:
        tables[name] = sha256_hex(files[name])
    del manifest["digest"]
    manifest["digest"] = digest_of_text(manifest)
    files["manifest.json"] = json.dumps(manifest).encode("utf-8", "surrogatepass")


def _campaign_file(name: str, mutate: Mutator, run: Target = _ask, share: float = 1.0) -> Format:
    sources = tuple(source for source in _CAMPAIGNS if name in source)
    return Format(
        f"campaign-{name.split('.')[0]}", sources, (name,), mutate, run, share, _signed_again
    )


def _page(name: str, place: str) -> Format:
    """The document of a report page and the pieces of histories beside it."""
    files = folder(f"results/{place}")
    return Format(
        name, (files,), tuple(n for n in files if n.endswith(".json")), json_damage, _report
    )


def _pieces(name: str, place: str) -> Format:
    files = folder(f"results/{place}")
    return Format(
        name, (files,), tuple(n for n in files if n.endswith(".parquet")), parquet_damage, _report
    )


def _json_or_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    return json_damage(data, rng) if rng.random() < 0.7 else damage_bytes.damaged(data, rng)


def _stage_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A data file is a mark, a digest of the rest, the length of a header, the header in JSON, and
    arrays.
    """
    begin = len(MAGIC) + 32
    length = int.from_bytes(data[begin : begin + 8], "little")
    header, rest = data[begin + 8 : begin + 8 + length], data[begin + 8 + length :]
    kind = rng.random()
    if kind < 0.2:
        return damage_bytes.damaged(data, rng)
    if kind < 0.8:
        header = json_damage(header, rng)
    else:
        rest = damage_bytes.damaged(rest, rng)
    content = len(header).to_bytes(8, "little") + header + rest
    return data[: len(MAGIC)] + hashlib.sha256(content).digest() + content


FORMATS = (
    _campaign_file("manifest.json", json_damage, share=2.0),
    _campaign_file("journal.sqlite", sqlite_damage, _journal),
    _campaign_file("cases.parquet", parquet_damage),
    _campaign_file("pbox.parquet", parquet_damage),
    _campaign_file("excursions.csv", damaged_table),
    _campaign_file("statements.csv", damaged_table),
    _campaign_file("decisions.csv", damaged_table),
    Format(
        "area-csv",
        (_CAMPAIGNS[0] | {"flights.csv": "settings/flights.csv"},),
        ("flights.csv",),
        damaged_table,
        _area("csv"),
    ),
    Format(
        "area-parquet",
        (_CAMPAIGNS[0] | {"flights.parquet": "settings/flights.parquet"},),
        ("flights.parquet",),
        parquet_damage,
        _area("parquet"),
    ),
    _page("fit-json", "fit"),
    _page("compare-json", "compare"),
    _page("model-form-json", "bounds"),
    _page("coverage-json", "coverage"),
    _page("refinement-json", "refined"),
    _page("study-json", "study"),
    _pieces("histories-parquet", "fit"),
    _pieces("residuals-parquet", "coverage"),
    Format(
        "instrument-record",
        (folder("results/instrumented", "dart"),),
        ("dart/uq-instrument.json",),
        _json_or_bytes,
        _undo,
    ),
    Format("study-npz", ({"study.npz": "results/study.npz"},), ("study.npz",), npz_damage, _npz),
    Format(
        "stage-data",
        ({"stage.data": "results/stage.data"},),
        ("stage.data",),
        _stage_damage,
        _stage,
        0.3,
    ),
    Format(
        "dask-wire",
        ({"order.json": "results/order.json"}, {"order.json": "results/answer.json"}),
        ("order.json",),
        _json_or_bytes,
        _order,
        0.3,
    ),
)
"""A campaign's folder, documents and pieces of report pages, the record of an instrumentation,
studies, stages, orders.
"""
