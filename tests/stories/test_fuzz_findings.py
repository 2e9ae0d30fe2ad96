"""What the fuzzer has found, each in its smallest form: refused in one sentence that names the
file.
"""

from __future__ import annotations

import io
import json
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sysid.errors import LogError
from sysid.logs.load import import_log
from tests.fuzz.formats import CORPUS
from tests.helpers import batch_systems
from uqharness.campaign.convergence import read_flights
from uqharness.campaign.dask import order_from
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.shards import read_status
from uqharness.campaign.store import JournalScan, Store
from uqharness.campaign.verify import scan_journal
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.parquet_files import parse_table, table_bytes
from uqharness.plugin.apply import undo
from uqharness.plugin.instrument import FILE_NAME
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mission import read_script
from uqharness.simulator.staging import model_files
from uqharness.text_tables import csv_text
from uqharness.toml import dotted, is_number

DIGITS = "9" * 5000
DEEP = "[" * 5000 + "]" * 5000


@pytest.fixture
def dart(tmp_path):
    """The corpus' aircraft, to be spoilt."""
    shutil.copytree(CORPUS / "aircraft" / "dart", tmp_path / "dart")
    return tmp_path / "dart"


def refusal(kind, function, *arguments):
    with pytest.raises(kind) as result:
        function(*arguments)
    assert "\n" not in str(result.value)
    return str(result.value)


@pytest.mark.parametrize("encoding", ["UTV-8", "base64", "idna"])
def test_an_encoding_that_nobody_knows(encoding, dart):
    path = dart / "Systems" / "gusts.xml"
    path.write_text(path.read_text().replace("UTF-8", encoding))
    assert str(path) in refusal(BadInputError, model_files, find_aircraft(dart))


def test_a_file_named_longer_than_names_may_be(dart):
    path = dart / "dart.xml"
    path.write_text(path.read_text().replace('file="prop"', f'file="{"a" * 300}"'))
    assert str(path) in refusal(BadInputError, model_files, find_aircraft(dart))


@pytest.mark.parametrize("text", [f"a = {DIGITS}", f"a = {DEEP}", f'["x\\ny"]\nb = {DIGITS}'])
def test_cards_in_both_readers(text, dart):
    card = dart / "airframe.toml"
    sound = card.read_text()
    card.write_text(f"{text}\n{sound}")
    assert str(card) in refusal(BadInputError, find_aircraft, dart)
    assert str(card) in refusal(LogError, import_log, CORPUS / "logs" / "flight.bin", None, card)


def test_a_key_with_a_line_break(dart):
    card = dart / "airframe.toml"
    card.write_text(card.read_text() + '\n["a\\nb"]\nc = 1\n')
    assert '"a\\nb"' in refusal(BadInputError, find_aircraft, dart)
    assert dotted(("a", "b c", 3)) == 'a."b c".3'
    order = json.loads((CORPUS / "results" / "order.json").read_text())
    order["group"]["cases"][0][1]["properties"] = {"a\nb": "x"}
    refusal(BadInputError, order_from, json.dumps(order))


@pytest.mark.parametrize(
    "entry", ['function = ["value"]', "function = {}", 'times = ["csv", "note"]']
)
def test_maps_with_other_things_than_text(entry, tmp_path):
    (tmp_path / "map.toml").write_text(f'[signals.V_mps]\nmessage = "csv"\nfield = "v"\n{entry}\n')
    (tmp_path / "table.csv").write_text(
        "time,v,note\n" + "".join(f"{k},{k},word\n" for k in range(50))
    )
    refusal(LogError, import_log, tmp_path / "table.csv", tmp_path / "map.toml")


def test_a_sentence_stays_one_whatever_a_file_puts_into_it(dart):
    script = CORPUS / "aircraft" / "script.xml"
    path = dart.parent / "script.xml"
    path.write_text(
        script.read_text().replace(
            'name="flight/manoeuvre" value="1"', 'name="flight/manoeuvre" value="a&#10;b"'
        )
    )
    assert str(path) in refusal(BadInputError, read_script, path)
    listed = BadInputError("a.toml:1: one\nand more", "a.toml:2: two")
    assert str(listed).splitlines() == ["a.toml:1: one and more", "a.toml:2: two"]
    assert str(pickle.loads(pickle.dumps(listed))) == str(listed)


@pytest.mark.parametrize(
    ("change", "output"),
    [
        (
            lambda t: t.append_column("more", pa.array([{"a": 1}] * len(t))),
            "column more is of type struct",
        ),
        (lambda t: t.append_column("status", t["status"]), "or there twice"),
        (lambda t: t.slice(0, 0), "no flights"),
    ],
)
def test_tables_of_flights(change, output, tmp_path):
    table = pq.read_table(CORPUS / "settings" / "flights.parquet")
    noted = table.replace_schema_metadata({b"pandas": b'\xff{"index_columns": {}}'})
    pq.write_table(noted, tmp_path / "sound.parquet")
    assert len(read_flights(tmp_path / "sound.parquet", {})) == len(table)
    pq.write_table(change(table), tmp_path / "flights.parquet")
    assert output in refusal(BadInputError, read_flights, tmp_path / "flights.parquet", {})


def test_rows_longer_than_the_header(tmp_path):
    """Cells without a name were taken for names of rows: columns moved over, and hundreds of them
    took ever longer.
    """
    (tmp_path / "table.csv").write_text(
        "time_s,V_mps\n" + "".join(f"{k / 10},{20 + k},7,7\n" for k in range(50))
    )
    assert "4 cells, the header 2" in refusal(LogError, import_log, tmp_path / "table.csv")
    (tmp_path / "table.csv").write_text(
        "time_s,V_mps\n\n" + "".join(f'{k / 10},"{20 + k}"\n' for k in range(50))
    )
    assert len(import_log(tmp_path / "table.csv")) == 50


def test_an_integer_beyond_all_floats_in_a_table(tmp_path):
    (tmp_path / "map.toml").write_text('[signals.V_mps]\nmessage = "csv"\nfield = "v"\n')
    rows = "".join(f"{k / 10},{20 + k}\n" for k in range(50))
    (tmp_path / "table.csv").write_text(f"time,v\n{rows}5.0,1{'0' * 400}\n5.1,words\n")
    record = import_log(tmp_path / "table.csv", tmp_path / "map.toml")
    assert record["V_mps"][:3].tolist() == [20.0, 21.0, 22.0]


@pytest.mark.parametrize("text", ["something else", ""])
def test_a_record_that_does_not_fit_its_file(text, tmp_path):
    folder = tmp_path / "dart"
    shutil.copytree(CORPUS / "results" / "instrumented", folder)
    record = json.loads((folder / FILE_NAME).read_text())
    if text:
        record["files"]["dart.xml"]["before"] = "0" * 64
    else:
        record["files"]["dart.xml"]["after"] = "0" * 64
        record["files"]["dart.xml"]["insertions"][0][1] = ""
    (folder / FILE_NAME).write_text(json.dumps(record))
    assert "dart.xml" in refusal(BadInputError, undo, folder, folder)


def test_a_journal_whose_damage_sqlite_cannot_spell(tmp_path):
    """SQLite quotes the damaged name in its message, and Python cannot decode the message."""
    folder = tmp_path / "results"
    shutil.copytree(CORPUS.parent.parent / "format_1" / "results", folder)
    journal = folder / "journal.sqlite"
    content = journal.read_bytes()
    assert content.count(b"on outcome (status)") == 1
    journal.write_bytes(content.replace(b"on outcome (status)", b"on outcome (st\xactus)"))

    def every_row():
        with Store(folder, read_only=True) as store:
            store.statuses()

    assert "journal.sqlite" in refusal(BadInputError, every_row)
    assert "journal.sqlite" in refusal(BadInputError, read_status, folder)
    list(JournalScan(folder, tmp_path / "scratch").rows())
    assert scan_journal(folder, None).problem


def test_numbers_larger_than_any_float_in_a_campaign(tmp_path):
    text = (CORPUS / "settings" / "campaign.toml").read_text()
    (tmp_path / "campaign.toml").write_text(text.replace("CX = 0.008", f"CX = 1{'0' * 400}"))
    assert "CX = 1" in refusal(BadInputError, read_campaign, tmp_path / "campaign.toml")
    assert [is_number(x) for x in (1, 1.5, True, 10**400, float("nan"), float("inf"), "1")] == [
        True,
        True,
    ] + [False] * 5


def test_a_script_that_names_manoeuvres_and_does_not_count_them(dart):
    script = (CORPUS / "aircraft" / "script.xml").read_text()
    path = dart.parent / "script.xml"
    path.write_text(script.replace('<property value="0">flight/manoeuvre</property>', ""))
    out = dart.parent / "out.csv"
    assert (
        main(["fly", str(dart), "--script", str(path), "--duration-s", "0.5", "--out", str(out)])
        == 0
    )
    assert set(pd.read_csv(out, comment="#")["manoeuvre"]) == {"script"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [["modes", "--speed-mps", "22", "--altitude-m", "100"], ["instrument", "--out", "out"]],
)
def test_a_propeller_that_spoils_jsbsims_memory(command, dart):
    """Once JSBSim has refused it, anything may happen in that process: it is a child, and the
    program does not follow.
    """
    path = dart / "Engines" / "prop.xml"
    path.write_text(
        path.read_text().replace("<propeller", "<nosuch").replace("</propeller", "</nosuch")
    )
    line = [sys.executable, "-m", "uqharness", command[0], str(dart), *command[1:]]
    done = subprocess.run(line, capture_output=True, text=True, cwd=dart.parent, check=False)
    assert done.returncode == 2
    assert str(dart) in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_texts_of_a_table_are_counted_before_they_are_written_out():
    """A kilobyte that stands for five gigabytes, and sound texts beside it."""
    texts = pa.DictionaryArray.from_arrays(
        pa.array([0] * 300, pa.int32()), pa.array(["x" * 16_000_000])
    )
    buffer = io.BytesIO()
    pq.write_table(pa.table({"reason": texts}), buffer, compression="zstd", store_schema=False)
    assert len(buffer.getvalue()) < 20_000
    with pytest.raises(BadInputError, match=r"4\.8\d? GB"):
        parse_table(buffer.getvalue(), Path("cases.parquet"))
    sound = pa.table({"reason": ["a", None, ""] * 1000, "x": [1.0, 2.0, 3.0] * 1000})
    assert parse_table(table_bytes(sound), Path("cases.parquet")).equals(sound)


def test_delays_that_would_keep_the_compiler_busy():
    delays = "".join(
        f'<actuator name="fcs/d{k}"><input>i/a</input><delay type="frames">1000</delay></actuator>'
        for k in range(20)
    )
    output = batch_systems.refusal(f'<channel name="c">{delays}</channel>')
    assert output.startswith("too large for the batch engine: more than 2500 numbers of state")
    assert 'engine = "jsbsim"' in output
    with pytest.raises(pytest.fail.Exception):
        batch_systems.refusal(f'<channel name="c">{delays.replace("1000", "20")}</channel>')


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("+1+1", "'+1+1"),
        ("-2+3", "'-2+3"),
        ("-0.5", "-0.5"),
        ("+1e3", "+1e3"),
        ("-", "-"),
        ("roll", "roll"),
    ],
)
def test_no_cell_is_a_formula(text, cell):
    assert csv_text([{"name": text}]).splitlines()[1].strip('"') == cell
