"""Real studies, no stage made up: a small one without refinement in the fast tests, the whole chain
in the slow ones.
"""

from __future__ import annotations

import json

import pytest

from sysid.model_form.model_form import read_model_form
from uqharness.cli import main as cli
from uqharness.commands.study import run_request
from uqharness.simulator.aircraft import PROJECT_ROOT, content_hash, find_aircraft
from uqharness.study.run import run_chain
from uqharness.study.spec import read_chain

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("flights_here")]

SMALL = """
[study]
name = "small"
question = "Does it hold 15 m of the circle?"
aircraft = "espaaro"

[[fly]]
name = "ident"
aircraft = "espaaro_truth"
script = "flight-ident"
duration_s = 26
seed = 1

[[fly]]
name = "bounds"
aircraft = "espaaro_truth"
script = "flight-bounds"
duration_s = 30
seed = 2

[identify]
flights = "ident"
params = ["aero/Cm_q", "aero/Cm_de"]
method = "output-error"

[bounds]
flights = "bounds"
order = 1
checks = false

[campaign]
mission = "loiter"
seed = 7

[aleatory]
flights = 2
duration_s = 20
burn_in_s = 20
wind_mps = 3
turbulence = "light"

[epistemic]
method = "corners"
nominal = false
coefficients = ["CX", "CY"]
"""


def test_a_small_study_from_logs_to_p_boxes(tmp_path, capsys):
    (tmp_path / "study.toml").write_text(SMALL)
    words = [
        "study",
        str(tmp_path / "study.toml"),
        "--out",
        str(tmp_path / "out"),
        "--workers",
        "1",
    ]
    assert cli.main(words) == 0
    output = capsys.readouterr()
    assert output.err == ""
    # 40 s a corner cannot decide: the answer says so, and how many hours would.
    assert output.out.startswith(
        "Does it hold 15 m of the circle? Inconclusive (too few flight hours) in 3 m/s wind with"
        " light turbulence"
    )
    assert "h per corner in 3 m/s light" in output.out
    assert output.out.endswith(f"Report: {tmp_path / 'out' / 'report.html'}\n")
    assert len(output.out.splitlines()) <= 5
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Does it hold 15 m of the circle?" in page
    assert "commanded path" in page
    out = tmp_path / "out"
    document = json.loads((out / "study.json").read_text())
    assert (
        "2 of 2 parameters were identified from ident by output error"
        in document["verdict"][-1]["text"]
    )
    assert {row["state"] for row in document["stages"]} == {"done"}
    assert all((out / row["folder"]).is_dir() for row in document["stages"])
    # The campaign flew the identified aircraft within that very aircraft's bounds.
    form = read_model_form(out / "bounds-before" / "model-form.json")
    assert form.aircraft.sha256 == content_hash(find_aircraft(out / "identify" / "aircraft"))
    flight = find_aircraft(out / "campaign-before" / "aircraft" / "aircraft")
    assert (flight.folder / "Systems" / "model-form.xml").read_bytes() == (
        out / "bounds-before" / "model-form.xml"
    ).read_bytes()
    assert (flight.folder / "espaaro.xml").read_bytes() == (
        out / "identify" / "aircraft" / "espaaro.xml"
    ).read_bytes()
    manifest = json.loads((out / "campaign-before" / "manifest.json").read_text())
    assert manifest["cases"] == 40  # two of each of 4 corners and 16 points between them
    # A stage's command, given to a shell, does what the stage did.
    row = next(row for row in document["stages"] if row["name"] == "fly-ident")
    before = (out / "flights" / "ident.bin").read_bytes()
    assert cli.main(row["command"].split()[1:]) == 0
    assert (out / "flights" / "ident.bin").read_bytes() == before


@pytest.mark.slow
def test_the_whole_chain_names_what_is_missing_and_the_refined_model_knows_more(tmp_path):
    text = (PROJECT_ROOT / "campaigns" / "chain" / "chain.toml").read_text()
    text = (
        text.replace("../../scripts/", "")
        .replace("flights = 40 ", "flights = 1 ")
        .replace("[3, 7, 12]", "3")
    )
    (tmp_path / "study.toml").write_text(text)
    document = run_chain(run_request, read_chain(tmp_path / "study.toml"), tmp_path / "out")
    assert {row.exit for row in document.stages} == {0}
    output = {sentence.text: sentence.level for sentence in document.verdict}
    listed = next(words for words in output if words.startswith("Refinement named"))
    assert "(aero/Cm_p2)" in listed
    assert "(aero/Cl_de)" in listed
    widths = next(words for words in output if words.startswith("Mean width of the bounds"))
    assert all(f"{c} -" in widths for c in ("Cl", "Cm"))
    refined = find_aircraft(tmp_path / "out" / "refine" / "aircraft" / "aircraft")
    form = read_model_form(tmp_path / "out" / "bounds-after" / "model-form.json")
    assert form.aircraft.sha256 == content_hash(refined)
    assert document.pair == {"before": "campaign-before", "after": "campaign-after"}
