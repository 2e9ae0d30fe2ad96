"""Which engine flies: option over file over auto, settled at the first run, and refused where it
cannot be had.
"""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.engine_fakes import Flown, Understanding, engines
from uqharness.campaign.cases import Mission, build_cases
from uqharness.campaign.engines import (
    Engines,
    PreviousEngine,
    choose_engine,
    engine_words,
    previous_engine,
    varying_properties,
)
from uqharness.campaign.manifest import read_manifest, write_manifest
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.shards import merge, parse_shard, read_status
from uqharness.campaign.verify import RunOptions, salvage
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table

pytestmark = pytest.mark.usefixtures("flights_here")

ALIKE = engines(Flown())
WITHOUT = engines(Flown(), Understanding("llvmlite is not installed"))
PUZZLED = engines(Flown(), Understanding(None, ("plane.xml:7: <rocket_engine> is not understood",)))


@pytest.fixture
def spec(tmp_path):
    return fakes.small_spec(tmp_path, 1)


def settled(spec, given, earlier=None):
    return choose_engine(spec, find_mission(spec), given, earlier)


def run(spec, out, given=ALIKE, **keys):
    return run_campaign(spec, out, executor=SerialExecutor(), fly=given, **keys)


def test_auto_takes_the_batch_engine_where_it_understands_everything(spec):
    assert (
        settled(spec, ALIKE).words == "batch, because it understands the whole aircraft and mission"
    )
    assert (
        settled(spec, PUZZLED).words
        == "jsbsim, because plane.xml:7: <rocket_engine> is not understood"
    )
    assert settled(spec, WITHOUT).words == "jsbsim, because llvmlite is not installed"
    assert (
        settled(spec, Engines.of(fakes.steady)).words
        == "jsbsim, because the flights are flown by a function of their own"
    )
    assert settled(spec.with_engine("jsbsim"), ALIKE).words == "jsbsim, because it was asked for"
    assert settled(spec, ALIKE).requested == "auto"


@pytest.mark.parametrize(
    ("given", "said"), [(PUZZLED, "plane.xml:7: <rocket"), (WITHOUT, "llvmlite is not installed")]
)
def test_what_was_asked_for_and_cannot_be_is_refused_with_the_reasons(spec, given, said):
    with pytest.raises(BadInputError, match="was asked for and cannot fly this campaign") as error:
        settled(spec.with_engine("batch"), given)
    assert said in str(error.value)


def test_auto_goes_on_in_the_engine_of_the_earlier_flights(spec):
    assert (
        settled(spec, ALIKE, PreviousEngine("jsbsim", ("plane.xml:7: no",))).words
        == "jsbsim, because plane.xml:7: no"
    )
    assert settled(spec, PUZZLED, PreviousEngine("batch")).words == "batch"
    assert (
        settled(spec.with_engine("jsbsim"), ALIKE, PreviousEngine("batch")).words
        == "jsbsim, because it was asked for"
    )
    with pytest.raises(
        BadInputError,
        match="this campaign flies in the batch engine, and llvmlite is not installed",
    ):
        settled(spec, WITHOUT, PreviousEngine("batch"))


def test_what_the_batch_engine_leaves_out_is_named_in_the_author_s_file(spec):
    class Ignoring(Understanding):
        def left_out(self, spec, varying):
            return (f"{spec.aircraft / 'plane.xml'}:5: <magnetometer> is not understood",)

    choice = settled(spec, replace(ALIKE, batch=Ignoring()))
    place = spec.path.parent / "plane" / "plane.xml"
    assert choice.engine == "batch"
    assert choice.words == (
        "batch, because it understands all that the flight reads; left out, since nothing reads"
        f" it: {place}:5: <magnetometer> is not understood"
    )


def test_a_defect_of_the_batch_engine_leaves_the_campaign_to_jsbsim(spec):
    class Broken(Understanding):
        def refusals(self, spec, varying):
            raise KeyError("slot")

    assert (
        settled(spec, replace(ALIKE, batch=Broken())).words
        == "jsbsim, because the batch engine failed at reading plane: KeyError: 'slot'"
    )


def test_many_reasons_are_counted():
    assert engine_words("jsbsim", tuple(f"reason {n}" for n in range(10))).endswith(
        "reason 7; and 2 more"
    )
    assert engine_words("jsbsim", ()) == "jsbsim"


def test_the_engine_is_part_of_every_case_id_and_old_ids_stay(spec):
    mission = Mission(spec.path, "a" * 64, spec.path, "b" * 64)
    old, named, batch = (
        build_cases(spec.with_engine(name), mission) for name in ("auto", "jsbsim", "batch")
    )
    assert [case.case_id for case in old] == [case.case_id for case in named]
    assert not {case.case_id for case in old} & {case.case_id for case in batch}
    assert {case.engine for case in batch} == {"batch"}


def test_varying_properties_are_levels_variables_and_parameters(tmp_path):
    text = (
        fakes.CAMPAIGN
        + '\n[aleatory.variables."inertia/mass-slugs"]\ndistribution = "normal"\nmean = 1.4\nstd ='
        " 0.02\n"
    )
    found = varying_properties(read_campaign(fakes.campaign_file(tmp_path, text)))
    assert found == (
        *(f"uq/{name}/level" for name in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")),
        "inertia/mass-slugs",
    )


def test_manifest_table_and_status_say_which_engine_and_why(spec, tmp_path):
    summary = run(spec, tmp_path / "out")
    assert (summary.engine, summary.statuses) == ("batch", {"ok": 64})
    manifest = read_manifest(tmp_path / "out")
    assert manifest["campaign"]["campaign"]["engine"] == "batch"
    assert manifest["engine"] == {
        "asked": "auto",
        "why": ["it understands the whole aircraft and mission"],
    }
    assert set(read_table(tmp_path / "out" / "cases.parquet")["engine"].to_pylist()) == {"batch"}
    found = read_status(tmp_path / "out")
    assert (found.engine, found.engine_why) == (
        "batch",
        ["it understands the whole aircraft and mission"],
    )


def test_another_engine_is_refused_in_the_same_folder_and_auto_is_not(spec, tmp_path):
    out = tmp_path / "out"
    run(spec, out)
    with pytest.raises(BadInputError, match='engine was "batch", is "jsbsim"'):
        run(spec.with_engine("jsbsim"), out)
    with pytest.raises(BadInputError, match="llvmlite is not installed"):
        run(spec, out, WITHOUT)
    assert run(spec, out).done_before == 64
    assert run(spec.with_engine("batch"), out).done_before == 64
    run(spec.with_engine("jsbsim"), tmp_path / "other")
    with pytest.raises(BadInputError, match='engine was "jsbsim", is "batch"'):
        run(spec.with_engine("batch"), tmp_path / "other")


def test_a_folder_from_before_the_batch_engine_is_jsbsims(spec, tmp_path):
    out = tmp_path / "out"
    run(spec.with_engine("jsbsim"), out)
    manifest = dict(read_manifest(out))
    manifest["campaign"]["campaign"].pop("engine")
    manifest.pop("engine")
    write_manifest(out, manifest)
    assert "engine" not in json.loads((out / "manifest.json").read_text())["campaign"]["campaign"]
    assert previous_engine(out) == PreviousEngine("jsbsim")
    assert run(spec, out).done_before == 64
    assert read_status(out).engine == "jsbsim"


def test_shards_fly_in_one_engine(spec, tmp_path):
    out = tmp_path / "out"
    run(spec, out, shard=parse_shard("1/2"))
    assert previous_engine(out / "shards" / "2-of-2").engine == "batch"
    with pytest.raises(BadInputError, match="llvmlite is not installed"):
        run(spec, out, WITHOUT, shard=parse_shard("2/2"))
    run(spec.with_engine("jsbsim"), out, shard=parse_shard("2/2"))
    with pytest.raises(BadInputError, match="engine was"):
        merge(out)
    run(spec, tmp_path / "good", shard=parse_shard("1/2"))
    run(spec, tmp_path / "good", shard=parse_shard("2/2"))
    assert merge(tmp_path / "good").missing == 0
    run(spec, tmp_path / "whole")
    name = "cases.parquet"
    assert (tmp_path / "good" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert (tmp_path / "good" / "engine-check.csv").exists()
    assert read_manifest(tmp_path / "good")["engine"]["asked"] == "auto"


@pytest.mark.parametrize("engine", ["batch", "jsbsim"])
def test_a_lost_manifest_is_rebuilt_in_the_engine_whose_flights_are_there(spec, tmp_path, engine):
    out = tmp_path / "out"
    run(spec.with_engine(engine), out)
    before = (out / "cases.parquet").read_bytes()
    (out / "manifest.json").unlink()
    found = salvage(out, RunOptions(SerialExecutor(), fly=ALIKE), spec, "command")
    assert (found.kept, found.flown) == (64, 0)
    assert (out / "cases.parquet").read_bytes() == before
    assert read_status(out).engine == engine


def test_the_command_line(tmp_path, capsys, monkeypatch):
    import uqharness.campaign.engines as module

    path = fakes.campaign_file(tmp_path)
    monkeypatch.setattr(module, "LocalBatch", lambda: PUZZLED.batch)
    assert (
        main(["campaign", "run", str(path), "--out", str(tmp_path / "out"), "--engine", "batch"])
        == 2
    )
    assert "plane.xml:7: <rocket_engine>" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_aircraft_is_looked_at_where_it_is_and_not_in_a_copy(spec):
    class Asking(Understanding):
        def refusals(self, spec, varying):
            return (f"{spec.aircraft / 'plane.xml'}:3: no",)

    found = settled(spec, replace(ALIKE, batch=Asking()))
    assert found.reasons == (f"{spec.path.parent / 'plane' / 'plane.xml'}:3: no",)
