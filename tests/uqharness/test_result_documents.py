"""Documents of results that were damaged or made up: one sentence that names file and key, never a
page from half of it.
"""

from __future__ import annotations

import copy
import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.helpers import report_folders as folders
from uqharness.errors import BadInputError
from uqharness.report.write import write_report

MAKE = {
    "fit.json": folders.identified,
    "compare.json": folders.compared,
    "coverage.json": folders.covered,
    "refinement.json": folders.refined,
}
STUDY = folders.study([folders.stage("fly", "fly", "fly", state="waiting")])
DROPPED = {
    "fit.json": [
        "parameters",
        "parameters.aero/Cm_q.std",
        "parameters.aero/Cm_q.value",
        "fit",
        "aircraft",
    ],
    "compare.json": [
        "channels.q_radps.ratio",
        "coefficients",
        "manoeuvres.roll doublet.channels",
        "moments.0.noises",
    ],
    "coverage.json": ["coverage.CX.0\\.95", "coverage"],
    "refinement.json": [
        "effects.0.value",
        "effects.0.alternatives.0.would_separate",
        "withdrawn.0.test",
        "withdrawn.0.test.std",
        "gap.test",
        "gap.test.channels.q_radps.noise_rms",
        "gap.test.intervals.coefficients.Cm.coverage_before",
        "remaining.unexplained",
        "switch.0.property",
        "parameters.aero/Cm_q.std",
        "disagreement.0.size",
        "gap.test.coefficients",
    ],
}
CASES = [(name, key) for name, keys in DROPPED.items() for key in keys]


def place_of(document, key):
    """The container of a node, and its key there."""
    parts = [p.replace("\0", ".") for p in key.replace("\\.", "\0").split(".")]
    for part in parts[:-1]:
        document = document[int(part) if isinstance(document, list) else part]
    return document, parts[-1]


@pytest.mark.parametrize("name", MAKE)
def test_the_documents_are_sound_to_begin_with(name, tmp_path):
    assert write_report(MAKE[name](tmp_path / "results")).path.is_file()


@pytest.mark.parametrize(("name", "key"), CASES)
@pytest.mark.parametrize("new", [None, {"a": []}, ["x"]], ids=["missing", "table", "list"])
def test_a_page_is_refused_with_file_and_key(name, key, new, tmp_path):
    folder = MAKE[name](tmp_path / "results")
    document = json.loads((folder / name).read_text())
    holder, last = place_of(document, key)
    if new is None:
        del holder[last]
    elif type(holder[last]) is type(new):
        pytest.skip("the same type")
    else:
        holder[last] = copy.deepcopy(new)
    (folder / name).write_text(json.dumps(document))
    with pytest.raises(BadInputError) as refused:
        write_report(folder)
    assert str(refused.value).startswith(f"{folder / name}: ")
    assert "\n" not in str(refused.value)
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"parameters": ' + "[" * 50_000 + "]" * 50_000 + "}", "9" * 5000]
)
def test_what_is_no_json_object(text, tmp_path):
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(BadInputError, match=r"fit\.json"):
        write_report(tmp_path)


@pytest.mark.parametrize("place", ["../../etc", "/etc", "a/../../b", "C:\\Windows"])
def test_a_study_shows_nothing_from_outside_its_folder(place, tmp_path):
    folder = folders.write_document(
        tmp_path, "study.json", STUDY | {"before_after": {"before": place, "after": "after"}}
    )
    with pytest.raises(BadInputError, match="within the folder"):
        write_report(folder)
    stages = [folders.stage("bounds", "bounds", place)]
    folders.write_document(tmp_path, "study.json", STUDY | {"stages": stages})
    with pytest.raises(BadInputError, match="within the folder"):
        write_report(folder)


def changed(folder, change):
    path = folder / "histories.parquet"
    pq.write_table(change(pq.read_table(path)), path)


@pytest.mark.parametrize(
    ("change", "output"),
    [
        (lambda t: t.drop_columns(["time_s"]), "time_s is there 0 times"),
        (
            lambda t: t.set_column(0, "segment", t["segment"].cast(pa.float64())),
            "segment is double",
        ),
        (lambda t: t.append_column("q_radps", t["q_radps"]), "q_radps is there 2 times"),
        (
            lambda t: t.set_column(1, "flight", pa.array([None] * len(t), pa.string())),
            "flight has gaps",
        ),
        (lambda t: t.append_column("nested", pa.array([[1.0]] * len(t))), "nested is list"),
    ],
)
def test_histories_that_no_command_writes(change, output, tmp_path):
    folder = folders.identified(tmp_path / "results")
    changed(folder, change)
    with pytest.raises(BadInputError, match=output):
        write_report(folder)


def test_histories_with_text_that_is_none(tmp_path):
    folder = folders.identified(tmp_path / "results")
    odd = pa.Array.from_buffers(
        pa.string(), 1, [None, pa.py_buffer(b"\0\0\0\0\1\0\0\0"), pa.py_buffer(b"\xff")]
    )
    changed(folder, lambda t: t.set_column(2, "manoeuvre", pa.chunked_array([odd] * len(t))))
    with pytest.raises(BadInputError, match=r"histories\.parquet: not a readable parquet file"):
        write_report(folder)


def test_residuals_without_a_state_of_the_form(tmp_path):
    folder = folders.bounded(tmp_path / "results")
    folders.pieces(folder, "residuals.parquet", {"CX": folders.wave()})
    with pytest.raises(BadInputError, match="must have the columns"):
        write_report(folder)
