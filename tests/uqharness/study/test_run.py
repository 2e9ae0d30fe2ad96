"""Studies: what is skipped, what is done again, what a kill leaves, whose folder it is.

Most stages here are made up.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time

import pytest

from tests.helpers.model_forms import made_up_form
from tests.helpers.report_folders import refinement
from uqharness.campaign.store import Store, run_lock
from uqharness.cli import main as cli
from uqharness.commands.study import run_request
from uqharness.errors import BadInputError
from uqharness.report.parts import Page
from uqharness.report.write import Report
from uqharness.results.refinement import Refinement
from uqharness.simulator.aircraft import PROJECT_ROOT
from uqharness.study import run as chain_run
from uqharness.study.run import read_study, run_chain
from uqharness.study.spec import read_chain

pytestmark = pytest.mark.usefixtures("flights_here")

STUDY = """
[study]
name = "mine"
question = "Does it hold?"
aircraft = "plane"

[[logs]]
name = "one"
file = "one.bin"

[[logs]]
name = "two"
file = "two.bin"

[[logs]]
name = "three"
file = "three.bin"

[identify]
flights = "one"

[bounds]
flights = "two"
validate_on = "three"
checks = true

[refine]
train = "one"
test = "three"

[campaign]
mission = "loiter"
seed = 7

[aleatory]
flights = 3
duration_s = 150

[epistemic]
method = "corners"
nominal = false
"""


def words(text):
    return text.split()


ALL = words(
    "import-one import-two import-three identify bounds-before validate-before campaign-before"
    " sensitivity-before refine bounds-after validate-after campaign-after sensitivity-after"
)


TWO_ON = (
    "import-two bounds-before validate-before campaign-before sensitivity-before bounds-after"
    " validate-after campaign-after sensitivity-after"
)
THREE_ON = (
    "import-three validate-before refine bounds-after validate-after campaign-after"
    " sensitivity-after"
)


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study of three logs whose stages only note that they ran and hand their input on; returns
    (run, ran, fail).
    """
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", tmp_path / "plane")
    for name in ("one", "two", "three"):
        (tmp_path / f"{name}.bin").write_text(name)
    (tmp_path / "study.toml").write_text(STUDY)
    ran: list[str] = []
    fail: dict[str, BaseException | int] = {}

    def call(run, stage, out, workers, callback):
        ran.append(stage.name)
        kind = fail.get(stage.name, 0)
        if isinstance(kind, BaseException):
            raise kind
        reports = "".join(path.read_text() for path in stage.inputs.values() if path.is_file())
        for path in stage.outputs:
            if path.suffix:
                path.parent.mkdir(parents=True, exist_ok=True)
                words = stage.command.replace(str(tmp_path), "")
                path.write_text(reports + words + json.dumps(stage.settings))
            else:
                shutil.copytree(tmp_path / "plane", path)
                (path / "more.xml").write_text(f"<a>{reports}{stage.name}</a>")
        return kind

    monkeypatch.setattr(chain_run, "_run_request", call)
    monkeypatch.setattr(chain_run, "_refuse_other_model", lambda form, folder: None)
    monkeypatch.setattr(
        "uqharness.commands.study.write_report",
        lambda folder: Report(folder / "report.html", (), Page("", "", ())),
    )
    # The stages are made up, so that there is nothing to conclude from.
    monkeypatch.setattr(chain_run, "judge", lambda *_: [("It holds.", "good")])
    monkeypatch.setattr(chain_run, "read_campaigns", lambda out, refined: {})
    empty = refinement(effects=[], verdict="no-missing-effect")
    read = chain_run.read_result
    monkeypatch.setattr(
        chain_run,
        "read_result",
        lambda path, shape: shape(**empty) if shape is Refinement else read(path, shape),
    )

    def run(text=None, file="study.toml", out="out"):
        if text is not None:
            (tmp_path / file).write_text(text)
        ran.clear()
        return run_chain(run_request, read_chain(tmp_path / file), tmp_path / out)

    return run, ran, fail


FINISHED: dict[str, str] = {}


@pytest.fixture
def done(study, tmp_path, tmp_path_factory):
    """The same after a run, which is made once for all tests."""
    run, ran, _ = study
    if FINISHED:
        shutil.copytree(FINISHED["kept"], tmp_path / "out")
        document = tmp_path / "out" / "study.json"
        document.write_text(document.read_text().replace(FINISHED["root"], str(tmp_path)))
    else:
        run()
        retained = tmp_path_factory.mktemp("finished") / "out"
        shutil.copytree(tmp_path / "out", retained)
        FINISHED.update(root=str(tmp_path), kept=str(retained))
    ran.clear()
    return study


def states(document):
    return {row.name: row.state for row in document.stages}


def test_all_stages_run_once_and_study_json_tells(study, tmp_path):
    run, ran, _ = study
    document = run()
    assert ran == ALL
    stored = json.loads((tmp_path / "out" / "study.json").read_text())
    assert stored == document.as_json()
    assert (stored["study"], stored["state"], stored["file"]) == ("mine", "done", "study.toml")
    assert set(states(document).values()) == {"done"}
    assert stored["verdict"] == [{"text": "It holds.", "level": "good"}]
    assert stored["before_after"] == {"before": "campaign-before", "after": "campaign-after"}
    row = next(row for row in stored["stages"] if row["name"] == "bounds-before")
    assert (row["kind"], row["folder"], row["exit"]) == ("bounds", "bounds-before", 0)
    assert set(row["inputs"]) == {"identify/aircraft", "flights/two.parquet"}
    run()
    assert ran == []


@pytest.mark.parametrize(
    ("change", "repeat"),
    [
        (lambda folder: (folder / "two.bin").write_text("other"), TWO_ON),
        (lambda folder: (folder / "three.bin").write_text("other"), THREE_ON),
        (
            lambda folder: (folder / "out" / "bounds-before" / "model-form.json").unlink(),
            "bounds-before",
        ),
    ],
)
def test_what_depends_on_a_change_is_done_again_and_nothing_else(done, tmp_path, change, repeat):
    run, ran, _ = done
    change(tmp_path)
    run()
    assert ran == repeat.split()


@pytest.mark.parametrize(
    ("old", "new", "repeat"),
    [
        (
            "flights = 3",
            "flights = 4",
            "campaign-before sensitivity-before campaign-after sensitivity-after",
        ),
        ("checks = true", "order = 1", TWO_ON.removeprefix("import-two ")),
        ('question = "Does it hold?"', 'question = "Will it?"', ""),
    ],
)
def test_an_edited_file_runs_what_its_settings_bear_on(done, old, new, repeat):
    run, ran, _ = done
    document = run(STUDY.replace(old, new))
    assert ran == repeat.split()
    assert document.question == ("Will it?" if "Will" in new else "Does it hold?")


def test_flights_of_a_superseded_campaign_are_put_aside_not_lost(done, tmp_path):
    run, _, _ = done
    (tmp_path / "out" / "campaign-before" / "journal.sqlite").write_text("hours of flying")
    run(STUDY.replace("flights = 3", "flights = 4"))
    (retained,) = (tmp_path / "out" / "superseded").glob("campaign-before-*")
    assert (retained / "journal.sqlite").read_text() == "hours of flying"
    assert not (tmp_path / "out" / "campaign-before" / "journal.sqlite").exists()


def test_a_section_left_out_and_put_back_costs_nothing(done):
    run, ran, _ = done
    text = STUDY[: STUDY.index("[refine]")] + STUDY[STUDY.index("[campaign]") :]
    document = run(text)
    assert ran == []
    assert document.before_after is None
    assert {row.name for row in document.former} == set(ALL[ALL.index("refine") :])
    document = run(STUDY)
    assert ran == []
    assert document.former == []


def test_a_folder_that_is_not_the_studys_is_not_removed(study, tmp_path):
    run, _, fail = study
    fail["identify"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        run()
    (tmp_path / "out" / "refine").mkdir()
    (tmp_path / "out" / "refine" / "thesis.tex").write_text("years")
    fail.clear()
    with pytest.raises(
        BadInputError, match="refine: is there, and not from this study; move it away"
    ):
        run()
    assert (tmp_path / "out" / "refine" / "thesis.tex").exists()


def test_a_stage_that_answers_no_is_done_and_the_study_goes_on(study):
    run, ran, fail = study
    fail["validate-before"] = 1
    document = run()
    assert ran == ALL
    assert document.state == "done"
    assert {row.name: row.exit for row in document.stages}["validate-before"] == 1
    run()
    assert ran == []


def test_a_stage_that_cannot_use_its_input_stops_the_study_and_is_tried_again(study, tmp_path):
    run, ran, fail = study
    fail["bounds-before"] = BadInputError("two.parquet: too short")
    with pytest.raises(
        BadInputError,
        match=r"stage bounds-before: two.parquet: too short\n  the stage alone: uqharness bounds",
    ):
        run()
    document = read_study(tmp_path / "out")
    assert document.state == "failed"
    assert states(document)["bounds-before"] == "failed"
    assert states(document)["campaign-before"] == "waiting"
    fail.clear()
    run()
    assert ran == ALL[ALL.index("bounds-before") :]


def test_an_interruption_passes_and_the_same_call_goes_on(study, tmp_path):
    run, ran, fail = study
    fail["campaign-before"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        run()
    assert states(read_study(tmp_path / "out"))["campaign-before"] == "running"
    (tmp_path / "out" / "campaign-before").mkdir()
    (tmp_path / "out" / "campaign-before" / "journal.sqlite").write_text("so far")
    fail.clear()
    run()
    assert ran == ALL[ALL.index("campaign-before") :]
    assert (tmp_path / "out" / "campaign-before" / "journal.sqlite").read_text() == "so far"


def test_what_a_half_done_stage_left_is_taken_away(study, tmp_path):
    run, _, fail = study
    fail["bounds-before"] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        run()
    (tmp_path / "out" / "bounds-before").mkdir()
    (tmp_path / "out" / "bounds-before" / "half.svg").write_text("")
    fail.clear()
    run()
    assert not (tmp_path / "out" / "bounds-before" / "half.svg").exists()


def test_a_folder_of_something_else_is_refused(done, tmp_path):
    run, ran, _ = done
    other = STUDY.replace("flights = 3", "flights = 5")
    with pytest.raises(
        BadInputError,
        match=r'holds the study "mine" of .*study.toml, not "mine" of .*other.toml; choose',
    ):
        run(other, file="other.toml")
    with pytest.raises(BadInputError, match='not "another" of'):
        run(STUDY.replace('"mine"', '"another"'))
    assert ran == []
    run(STUDY, file="moved.toml")  # the same content under another name
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("")
    with pytest.raises(
        BadInputError, match=r"not empty and no study's folder \(it has thesis.tex\)"
    ):
        run(STUDY, out="full")
    (tmp_path / "out" / "study.json").write_text("{}")
    with pytest.raises(BadInputError, match="written by another version"):
        run(STUDY)


def test_two_runs_in_one_folder_are_refused(done, tmp_path):
    run, _, _ = done
    with run_lock(tmp_path / "out"), pytest.raises(BadInputError, match="another run is using"):
        run()


def test_bounds_of_another_model_are_not_flown(tmp_path):
    form = tmp_path / "bounds" / "model-form.json"
    form.parent.mkdir()
    form.write_text(made_up_form().to_json())
    with pytest.raises(BadInputError, match="these bounds are of another model"):
        chain_run._refuse_other_model(form, PROJECT_ROOT / "aircraft" / "espaaro")


def command(tmp_path):
    return ["study", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]


def counted(folder):
    if not (folder / "journal.sqlite").exists():
        return 0
    with Store(folder, read_only=True) as store:
        return store.statuses().total()


def kill_in_flight(tmp_path):
    """Start the study in a process of its own, kill -9 it once flights are counted, and return how
    many are.
    """
    words = [sys.executable, "-m", "uqharness.cli.main", *command(tmp_path)]
    process = subprocess.Popen(
        words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, cwd=PROJECT_ROOT
    )
    try:
        deadline = time.monotonic() + 120
        while counted(tmp_path / "out" / "campaign-before") < 5:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        process.kill()
        process.communicate(timeout=60)
    return counted(tmp_path / "out" / "campaign-before")


REAL = """
[study]
name = "small"
question = "Does it hold for twenty seconds?"
aircraft = "espaaro"

[campaign]
mission = "loiter"
seed = 7

[aleatory]
flights = 1
duration_s = 20
burn_in_s = 5
wind_mps = 3
turbulence = "light"

[epistemic]
method = "lhs"
samples = 64
bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }
"""


@pytest.mark.slow
def test_a_study_killed_in_mid_campaign_goes_on_and_ends_as_if_undisturbed(tmp_path, capsys):
    (tmp_path / "study.toml").write_text(REAL)
    killed_at = kill_in_flight(tmp_path)
    assert states(read_study(tmp_path / "out"))["campaign-before"] == "running"
    assert cli.main([*command(tmp_path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["state"] == "done"
    assert {row["state"] for row in document["stages"]} == {"done"}
    output = (tmp_path / "out" / "log" / "campaign-before.txt").read_text()
    assert f"64 flights done, {killed_at} of them before this run" in output
    single = tmp_path / "alone"
    file = tmp_path / "out" / "campaign-before.toml"
    assert cli.main(["campaign", "run", str(file), "--out", str(single), "--serial"]) == 0
    for name in ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv"):
        assert (single / name).read_bytes() == (
            tmp_path / "out" / "campaign-before" / name
        ).read_bytes()
    text = " ".join(sentence["text"] for sentence in document["verdict"])
    assert "at every corner? Inconclusive" in text
    assert "Median cross-track error" in text
    assert "Flights: 64 (0 failed, control lost in 0)" in text


def test_ctrl_c_ends_with_130_and_says_how_to_go_on(study, tmp_path, capsys):
    _, _, fail = study
    fail["identify"] = KeyboardInterrupt()
    assert cli.main(command(tmp_path)) == 130
    assert "this command resumes: uqharness study" in capsys.readouterr().err
    fail.clear()
    assert cli.main(command(tmp_path)) == 0
    assert "It holds." in capsys.readouterr().out


def test_bad_input_is_told_without_a_traceback(study, tmp_path, capsys):
    (tmp_path / "study.toml").write_text(STUDY.replace("[bounds]", "[bonds]"))
    assert cli.main(command(tmp_path)) == 2
    output = capsys.readouterr().err
    assert "study.toml:" in output
    assert "did you mean bounds?" in output
    assert cli.main([*command(tmp_path)[:-1], "0"]) == 2
    with pytest.raises(SystemExit) as remaining:
        cli.main(["study", "--help"])
    assert remaining.value.code == 0
    assert "uqharness study campaigns/chain/chain.toml" in capsys.readouterr().out
