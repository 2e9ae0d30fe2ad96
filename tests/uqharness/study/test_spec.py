"""Study files: what is accepted, and that each kind of mistake is named with its line."""

from __future__ import annotations

import shlex
import tomllib

import pytest
import tomlkit

from uqharness.cli.main import build_parser
from uqharness.cli.request_command import request_of
from uqharness.errors import BadInputError
from uqharness.requests.base import command_words
from uqharness.study.spec import read_chain
from uqharness.study.stages import plan

STUDY = """
[study]
name = "mine"
question = "Does it hold?"
aircraft = "espaaro"

[[fly]]
name = "one"
aircraft = "espaaro_truth"
script = "doublet-elevator"
seed = 1

[[fly]]
name = "two"
aircraft = "espaaro_truth"
script = "doublet-elevator"
seed = 2

[[logs]]
name = "three"
file = "three.bin"

[identify]
flights = "one"

[bounds]
flights = ["two"]
validate_on = ["three"]

[refine]
train = ["one"]
test = ["three"]

[campaign]
mission = "loiter"
seed = 7

[aleatory]
flights = 3
duration_s = 150
wind_mps = 3
turbulence = "moderate"

[epistemic]
method = "corners"
nominal = false
"""


def read(tmp_path, text):
    path = tmp_path / "study.toml"
    path.write_text(text)
    (tmp_path / "three.bin").write_bytes(b"")
    return read_chain(path)


def refusal(tmp_path, text):
    with pytest.raises(BadInputError) as caught:
        plan(read(tmp_path, text), tmp_path / "out")
    return str(caught.value)


def line_of(text, fragment):
    return max(number for number, line in enumerate(text.splitlines(), 1) if fragment in line)


def test_the_stages_of_a_whole_study_in_order(tmp_path):
    stages = plan(read(tmp_path, STUDY), tmp_path / "out")
    names = (
        "fly-one fly-two import-one import-two import-three identify bounds-before validate-before"
        " campaign-before sensitivity-before refine bounds-after validate-after campaign-after"
        " sensitivity-after"
    )
    assert [stage.name for stage in stages] == names.split()
    for stage in stages:
        assert stage.command.startswith("uqharness ")
        # What would be told to a shell is the stage's request.
        args = build_parser().parse_args(shlex.split(stage.command)[1:])
        words = command_words(request_of(args.model, args), full=True)
        assert words == command_words(stage.request, full=True)


def test_each_model_flies_with_bounds_of_its_own(tmp_path):
    stages = {stage.name: stage for stage in plan(read(tmp_path, STUDY), tmp_path / "out")}
    out = tmp_path / "out"
    for when, model in (
        ("before", out / "identify" / "aircraft"),
        ("after", out / "refine" / "aircraft" / "aircraft"),
    ):
        campaign = stages[f"campaign-{when}"]
        assert campaign.belongs == (out / f"bounds-{when}" / "model-form.json", model)
        assert stages[f"bounds-{when}"].request.aircraft == str(model)
        path, data = campaign.writes
        assert path.parent / data["campaign"]["aircraft"] == model
        assert path.parent / data["epistemic"]["bounds"] == campaign.belongs[0]
        assert data["aleatory"]["flights"] == 3


def test_a_study_of_parts(tmp_path):
    def stages(text):
        return [stage.name for stage in plan(read(tmp_path, text), tmp_path / "out")]

    complete = tomllib.loads(STUDY)
    sections = ("campaign", "aleatory", "epistemic")
    only = {key: complete[key] for key in ("study", *sections)}
    assert stages(tomlkit.dumps(only)) == ["campaign-before", "sensitivity-before"]
    walks = only | {"epistemic": {"method": "walk", "samples": 3}}
    assert stages(tomlkit.dumps(walks)) == ["campaign-before"]
    compared = STUDY.replace("[bounds]", '[compare]\nflights = ["three"]\n\n[bounds]')
    assert [n for n in stages(compared) if n.startswith("compare")] == [
        "compare-three-before",
        "compare-three-after",
    ]


def test_an_aircraft_without_the_plugin_gets_it_first(tmp_path):
    sections = {"study": {"name": "c", "question": "?", "aircraft": "c172x"}} | {
        "campaign": {"mission": "steady", "seed": 1},
        "start": {"V_mps": 55, "altitude_m": 200},
        "aleatory": {"flights": 1, "duration_s": 10},
        "epistemic": {"method": "corners", "coefficients": ["CX"], "bounds": {"CX": 0.01}},
    }
    stages = plan(read(tmp_path, tomlkit.dumps(sections)), tmp_path / "out")
    assert [stage.name for stage in stages] == [
        "instrument",
        "campaign-before",
        "sensitivity-before",
    ]
    assert stages[1].writes[1]["campaign"]["aircraft"] == "instrument/c172x"


def test_every_option_of_a_command_is_a_key_of_its_section(tmp_path):
    """An option needs no line of the study: `sample_size` and `bake` are fields of requests."""
    text = STUDY.replace(
        "validate_on", 'as_published = true\nsample_size = "effective"\nvalidate_on'
    ).replace('train = ["one"]', 'train = ["one"]\nbake = true')
    stages = {stage.name: stage for stage in plan(read(tmp_path, text), tmp_path / "out")}
    assert "--as-published --sample-size effective" in stages["bounds-before"].command
    assert "--bake" in stages["refine"].command
    # Options that the study sets itself are no keys, and rules of several options hold.
    for invalid, fragment in (
        ('out = "x"', "[bounds] out: unknown"),
        ('sample_size = "all"', "sample_size requires"),
    ):
        message = refusal(tmp_path, STUDY.replace("validate_on", f"{invalid}\nvalidate_on"))
        assert fragment in message


# What stands in the file => what is put there => words of the refusal.
MISTAKES = r"""
name = "mine" => nmae = "mine" => [study] nmae: unknown key | did you mean name?
name = "mine" => name = "my study" => [study] name = "my study": a text of the form
question = "Does it hold?" => question = 3 => [study] question = 3: a text
aircraft = "espaaro"\n => aircraft = "espaaroo"\n => [study] aircraft | 'espaaroo' not found | espaaro_truth
[identify] => [identfy] => [identfy]: unknown section | did you mean identify?
seed = 2 => seed = 2\nturbulence = "heavy" => [[fly]] number 2 turbulence = "heavy": allowed are none, light
seed = 2 => seed = -2 => [[fly]] number 2 seed = -2: a whole number of at least 0
seed = 2 => script = "x.xml"\nseed = 2 => not valid TOML
file = "three.bin" => file = "gone.bin" => [[logs]] file | "gone.bin" is no file beside study.toml
name = "two" => name = "one" => [[fly]] name = "one": another flight has this name
flights = "one" => flights = [] => [identify] flights
flights = "one" => flights = "four" => [identify] flights: no flight is named "four" | have: one, two, three
flights = "one" => flights = "one"\nmethod = "guess" => [identify] method = "guess": allowed are auto
validate_on = ["three"] => validate_on = ["one"] => "one" is also in [identify] flights
flights = ["two"] => flights = ["one"] => "one" is also in [identify] flights | too small for bounds
test = ["three"] => test = ["one"] => "one" is also in [refine] train | must not choose
test = ["three"] => test = ["three"]\neffects = "own.toml" => [refine] effects | "own.toml" is no file
validate_on => confidence = 95\nvalidate_on => [bounds] confidence = 95: a number above 0 and below 1
validate_on => states = { CW = ["V"] }\nvalidate_on => [bounds] states
validate_on => states = { CX = ["speed"] }\nvalidate_on => [bounds] states | unknown state speed | alpha
mission = "loiter" => mission = "loyter" => [campaign] mission | 'loyter' not found | loiter
mission = "loiter" => mission = "loiter"\naircraft = "espaaro" => [campaign] aircraft | leave it out
method = "corners" => method = "corners"\nbounds = { CX = 1 } => [epistemic] bounds | leave out one
method = "corners" => method = "corners"\n[epistemic.parameters]\nfit = "f" => parameters | flies two
"""


@pytest.mark.parametrize("row", MISTAKES.strip().splitlines())
def test_mistakes_are_named_with_line_and_remedy(tmp_path, row):
    old, new, words = row.replace(r"\n", "\n").split(" => ")
    assert old in STUDY
    text = STUDY.replace(old, new, 1)
    message = refusal(tmp_path, text)
    for fragment in words.split(" | "):
        assert fragment in message
    assert "study.toml:" in message
    if new.count("\n") == 0:
        assert f"study.toml:{line_of(text, new)}: " in message
    assert "Traceback" not in message


def test_the_line_is_that_of_the_right_table(tmp_path):
    text = STUDY.replace("seed = 2", 'seed = "two"')
    line = line_of(text, 'seed = "two"')
    assert f"study.toml:{line}: [[fly]] number 2 seed" in refusal(tmp_path, text)
    text = STUDY.replace("[identify]", '[[logs]]\nname = "spare"\nfile = "three.bin"\n\n[identify]')
    line = line_of(text, 'name = "spare"')
    assert f'study.toml:{line}: [[logs]] name = "spare": no section uses this flight' in refusal(
        tmp_path, text
    )


def test_a_file_that_asks_for_nothing_or_is_not_there(tmp_path):
    empty = STUDY[: STUDY.index("[[fly]]")]
    assert "give at least one of" in refusal(tmp_path, empty)
    with pytest.raises(BadInputError, match="cannot be read"):
        read_chain(tmp_path / "no.toml")
    headless = STUDY.replace('[campaign]\nmission = "loiter"\nseed = 7\n', "")
    assert "[campaign]: required; a section is needed" in refusal(tmp_path, headless)
