"""What the program does with each format: logs and tables of samples, settings that a user writes
by hand, folders of results (which people exchange too), aircraft and what flies them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sysid.foreign.typed_files import MAGIC
from tests.fuzz.damage_bytes import damaged, damaged_table, damaged_text
from tests.fuzz.damage_tables import npz_damage, parquet_damage, sqlite_damage
from tests.fuzz.damage_tree import json_damage, toml_damage, xml_damage
from tests.fuzz.formats import CORPUS, Files, Format, Mutator, folder
from tests.fuzz.outcome import Refused, call, command, known_verbs

Target = Callable[[Path, int], None]

# Logs


def _read(name: str, option: str, file: str) -> Target:
    """``log info`` or ``log import`` of one file, with the card or a map."""

    def run(place: Path, seed: int) -> None:
        more = (str(place / name), "--no-cache", option, str(place / file))
        if seed % 3:
            command("log info", *more, *(["--json"] if seed % 2 else []))
        else:
            out = place / ("out.csv" if seed % 2 else "out.parquet")
            command("log import", *more, "--out", str(out))

    return run


def _log(kind: str, mutate: Mutator) -> Format:
    # Renamed: the content tells what it is.
    source = {"flight.dat": f"logs/flight.{kind}", "airframe.toml": "aircraft/dart/airframe.toml"}
    bomb = source | {"flight.dat": "logs/bomb.parquet"}
    sources = (*(source,) * 9, bomb) if kind == "parquet" else (source,)
    run = _read("flight.dat", "--aircraft", "airframe.toml")
    return Format(f"log-{kind}", sources, ("flight.dat",), mutate, run)


def _text_log(data: bytes, rng: np.random.Generator) -> bytes:
    return damaged_text(data, rng) if rng.random() < 0.7 else damaged(data, rng)


def _manoeuvres(place: Path, seed: int) -> None:
    out = ("--out", str(place / "out.parquet"), "--manoeuvres", str(place / "manoeuvres.csv"))
    command("log import --no-cache", str(place / "flight.parquet"), *out)


def _mapped(kind: str, mutate: Mutator) -> Format:
    file = f"table.{kind}"
    source = {file: f"logs/table.{kind}", "map.toml": "settings/map.toml"}
    bomb = source | {file: "logs/bomb-of-table.parquet"}
    sources = (*(source,) * 9, bomb) if kind == "parquet" else (source,)
    return Format(f"mapped-{kind}", sources, (file,), mutate, _read(file, "--map", "map.toml"))


_TIMES = {"manoeuvres.csv": "settings/manoeuvres.csv", "flight.parquet": "logs/flight.parquet"}
_LOGS = (
    _log("bin", damaged),
    _log("log", _text_log),
    _log("tlog", damaged),
    _log("ulg", damaged),
    _log("csv", damaged_table),
    _log("jsbsim", damaged_table),
    _log("parquet", parquet_damage),
    _mapped("csv", damaged_table),
    _mapped("parquet", parquet_damage),
    Format("manoeuvres", (_TIMES,), ("manoeuvres.csv",), damaged_table, _manoeuvres),
)

# Settings


def _map(place: Path, seed: int) -> None:
    command("log info --no-cache", str(place / "table.csv"), "--map", str(place / "map.toml"))


def _card(place: Path, seed: int) -> None:
    """The two readers of a card: that of logs and that of aircraft."""
    if seed % 2:
        card = str(place / "dart" / "airframe.toml")
        command("log info --no-cache", str(place / "flight.bin"), "--aircraft", card)
    else:
        from uqharness.simulator.aircraft import find_aircraft

        call(find_aircraft, place / "dart")


def _effects(place: Path, seed: int) -> None:
    from sysid.effects.catalogue import read_effects

    call(read_effects, place / "effects.toml")


def _campaign(place: Path, seed: int) -> None:
    """Reading, and what is worked out from the settings before anything flies."""

    def plan() -> None:
        from uqharness.campaign.cost import epistemic_count, size_of
        from uqharness.campaign.read_spec import read_campaign
        from uqharness.campaign.rounds import rule_of
        from uqharness.campaign.sampling import epistemic_samples

        spec = read_campaign(place / "campaign.toml")
        rule_of(spec.as_dict(), 4)
        size_of(spec)
        # More are refused or asked about before any is made.
        if epistemic_count(spec) <= 10_000:
            epistemic_samples(spec)

    call(plan)


def _study(place: Path, seed: int) -> None:
    from uqharness.study.spec import read_chain

    call(read_chain, place / "study.toml")


_DART = folder("aircraft/dart", "dart")
_FORM = {"model-form.json": "results/bounds/model-form.json"}
_INPUTS = {
    **_DART,
    "script.xml": "aircraft/script.xml",
    **_FORM,
    "fit.json": "results/fit/fit.json",
}


def _settings(name: str, run: Target, more: Files | dict[str, str], share: float = 1.0) -> Format:
    """A file of settings that is damaged as TOML, and what it names."""
    source = {**more, f"{name}.toml": f"settings/{name}.toml"}
    return Format(name, (source,), (f"{name}.toml",), toml_damage, run, share)


_FLOWN = tuple(
    {**_INPUTS, "campaign.toml": f"settings/{name}.toml"}
    for name in ("campaign", "sampled", "steady")
)
_SETTINGS = (
    Format(
        "signal-map",
        ({"map.toml": "settings/map.toml", "table.csv": "logs/table.csv"},),
        ("map.toml",),
        toml_damage,
        _map,
    ),
    Format(
        "card",
        ({**_DART, "flight.bin": "logs/flight.bin"},),
        ("dart/airframe.toml",),
        toml_damage,
        _card,
    ),
    _settings("effects", _effects, {}, 0.3),
    Format("campaign", _FLOWN, ("campaign.toml",), toml_damage, _campaign),
    Format("campaign-inputs", _FLOWN[1:2], ("model-form.json", "fit.json"), json_damage, _campaign),
    _settings("study", _study, _INPUTS),
)

# Results

_QUESTIONS = (
    "campaign status",
    "campaign status --json",
    "campaign verify",
    "campaign verify --json",
    "campaign report --no-tracks",
    "report",
    "sensitivity",
    "campaign convergence --repeats 2",
    "campaign area --value cross_track_median_m=9.4",
)


def _query(place: Path, seed: int) -> None:
    """One of the commands that read a campaign's folder; the cheap ones more often."""
    request = (
        _QUESTIONS[seed % 4] if seed % 3 else _QUESTIONS[4 + seed // 3 % (len(_QUESTIONS) - 4)]
    )
    words = request.split()
    if words[0] == "campaign" and words[1] not in known_verbs():
        request = "campaign status"
    command(request, str(place))


def _journal(place: Path, seed: int) -> None:
    """What reads the journal row by row, besides the commands."""
    if seed % 4 > 1:
        _query(place, seed)
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


def _undo(place: Path, seed: int) -> None:
    command("instrument dart --undo", "--out", str(place / "dart"))


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


def _campaign_file(name: str, mutate: Mutator, run: Target = _query, share: float = 1.0) -> Format:
    sources = tuple(source for source in _CAMPAIGNS if name in source)
    title = f"campaign-{name.split('.')[0]}"
    return Format(title, sources, (name,), mutate, run, share, _signed_again)


def _area(kind: str, mutate: Mutator) -> Format:
    """``campaign area`` with a table of flights."""
    name = f"flights.{kind}"
    source = _CAMPAIGNS[0] | {name: f"settings/{name}"}

    def run(place: Path, seed: int) -> None:
        command("campaign area", str(place), "--flight", str(place / name))

    return Format(f"area-{kind}", (source,), (name,), mutate, run)


def _page(name: str, place: str, ending: str = ".json", mutate: Mutator = json_damage) -> Format:
    """The document of a report page, or the pieces of histories beside it."""
    files = folder(f"results/{place}")
    return Format(name, (files,), tuple(n for n in files if n.endswith(ending)), mutate, _report)


def _json_or_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    return json_damage(data, rng) if rng.random() < 0.7 else damaged(data, rng)


def _stage_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A data file is a mark, a digest of the rest, the length of a header, the header in JSON, and
    arrays.
    """
    begin = len(MAGIC) + 32
    length = int.from_bytes(data[begin : begin + 8], "little")
    header, remainder = data[begin + 8 : begin + 8 + length], data[begin + 8 + length :]
    kind = rng.random()
    if kind < 0.2:
        return damaged(data, rng)
    if kind < 0.8:
        header = json_damage(header, rng)
    else:
        remainder = damaged(remainder, rng)
    content = len(header).to_bytes(8, "little") + header + remainder
    return data[: len(MAGIC)] + hashlib.sha256(content).digest() + content


_WIRE = tuple({"order.json": f"results/{name}.json"} for name in ("order", "answer"))
_RECORD = ("dart/uq-instrument.json",)
_PIECES = (".parquet", parquet_damage)
_RESULTS = (
    _campaign_file("manifest.json", json_damage, share=2.0),
    _campaign_file("journal.sqlite", sqlite_damage, _journal),
    _campaign_file("cases.parquet", parquet_damage),
    _campaign_file("pbox.parquet", parquet_damage),
    _campaign_file("excursions.csv", damaged_table),
    _campaign_file("statements.csv", damaged_table),
    _campaign_file("decisions.csv", damaged_table),
    _area("csv", damaged_table),
    _area("parquet", parquet_damage),
    _page("fit-json", "fit"),
    _page("compare-json", "compare"),
    _page("model-form-json", "bounds"),
    _page("coverage-json", "coverage"),
    _page("refinement-json", "refined"),
    _page("study-json", "study"),
    _page("histories-parquet", "fit", *_PIECES),
    _page("residuals-parquet", "coverage", *_PIECES),
    Format(
        "instrument-record",
        (folder("results/instrumented", "dart"),),
        _RECORD,
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
    Format("dask-wire", _WIRE, ("order.json",), _json_or_bytes, _order, 0.3),
)

# Aircraft

_XML = {
    "aircraft-xml": "dart/dart.xml",
    "system-xml": "dart/Systems/gusts.xml",
    "engine-xml": "dart/Engines/motor.xml",
    "propeller-xml": "dart/Engines/prop.xml",
    "start-xml": "dart/cruise.xml",
    "script-xml": "script.xml",
}
_SOURCE = {**_DART, "script.xml": "aircraft/script.xml"}
_BARE = {name: place for name, place in _SOURCE.items() if not name.endswith(".toml")}


def _mutate(data: bytes, rng: np.random.Generator) -> bytes:
    remaining = [path.read_bytes() for path in sorted((CORPUS / "aircraft").rglob("*.xml"))]
    return xml_damage(data, rng, remaining)


def _before_jsbsim(place: Path, seed: int) -> None:
    """All that reads the XML before JSBSim does; JSBSim itself is left out."""

    def readers() -> None:
        from uqharness.plugin.instrument import Bounds, plan
        from uqharness.simulator import aircraft
        from uqharness.simulator.mission import read_script
        from uqharness.simulator.staging import model_files

        dart = aircraft.find_aircraft(place / "dart")
        aircraft.content_hash(dart)
        model_files(dart)
        aircraft.refuse_unknown_operations(dart)
        read_script(place / "script.xml")
        plan(dart, Bounds(), air=bool(seed % 2))

    call(readers)


def _fly(place: Path, seed: int) -> None:
    """Commands that end in JSBSim: its own child process judges the aircraft first."""
    aircraft = str(place / "dart")
    if seed % 3 == 0:
        script, out = str(place / "script.xml"), str(place / "out.csv")
        command("fly", aircraft, "--script", script, "--duration-s", "1", "--out", out)
    elif seed % 3 == 1:
        command("modes", aircraft, "--speed-mps", "22", "--altitude-m", "100")
    else:
        command("instrument --no-check", aircraft, "--out", str(place / "out"))


def _bounded(place: Path, seed: int) -> None:
    options = ("--out", str(place / "out"), "--bounds", str(place / "model-form.json"))
    command("instrument --dry-run", str(place / "dart"), *options)


_INSTRUMENTED = folder("results/instrumented", "dart") | {"script.xml": "aircraft/script.xml"}
_PLUGIN = ("dart/Systems/model-form.xml",)
_AIRCRAFT = (
    *(
        Format(name, (_SOURCE, _BARE), (file,), _mutate, _before_jsbsim)
        for name, file in _XML.items()
    ),
    *(
        Format(f"{name}-flown", (_SOURCE, _BARE), (file,), _mutate, _fly)
        for name, file in _XML.items()
    ),
    Format("plugin-xml", (_INSTRUMENTED,), _PLUGIN, _mutate, _before_jsbsim),
    Format("instrument-bounds", (_SOURCE | _FORM,), ("model-form.json",), json_damage, _bounded),
)

FORMATS = (*_LOGS, *_SETTINGS, *_RESULTS, *_AIRCRAFT)
"""Every format, in the order that a run takes them."""
