"""Mass properties set by name: they stand where asked, fly as a hand-edited XML does, and what
cannot be is refused.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uqharness.errors import BadInputError
from uqharness.flight.fly import fly
from uqharness.flight.spec import FlightSpec
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.mission import StagedMission, find_script

SPEC = FlightSpec(Path("espaaro"), Path("doublet-elevator"), duration_s=4.0)
KG_PER_SLUG, KG_M2 = 0.45359237 * 32.174049, 1.3558179483314004


@pytest.fixture(scope="module")
def missions(tmp_path_factory):
    """The E-SPAARO (metric, nothing but an empty mass) and a Cessna (imperial, point masses and
    fuel).
    """
    script = tmp_path_factory.mktemp("script") / "glide.xml"
    script.write_text(
        '<runscript name="g"><use aircraft="c172p" initialize="reset01"/><run start="0" end="9"'
        ' dt="0.01"/></runscript>'
    )
    with (
        StagedMission(find_aircraft("espaaro"), find_script("trim")) as metric,
        StagedMission(find_aircraft("c172p"), script) as imperial,
    ):
        yield {"metric": metric, "imperial": imperial}


@pytest.mark.parametrize(
    ("which", "wanted"),
    [
        ("metric", {"inertia/mass-slugs": 1.6}),
        (
            "metric",
            {"inertia/iyy-slugs_ft2": 7.0, "inertia/ixz-slugs_ft2": 0.5, "metrics/cbarw-ft": 2.0},
        ),
        ("metric", {"inertia/cg-x-in": 1.5, "inertia/ixy-slugs_ft2": 0.1}),
        ("imperial", {"inertia/weight-lbs": 2400.0, "inertia/cg-x-in": 42.0}),
        (
            "imperial",
            {"inertia/mass-slugs": 75.0, "inertia/iyy-slugs_ft2": 1500.0, "metrics/bw-ft": 35.0},
        ),
    ],
)
def test_properties_stand_at_what_was_asked_and_the_rest_stays(missions, which, wanted):
    mission = missions[which]
    nominal, changed = mission.open(), mission.open(changed=wanted)
    for fdm in (nominal, changed):
        engine.run_ic(fdm)
    for name, value in wanted.items():
        assert changed[name] == pytest.approx(value, rel=1e-8)
        assert nominal[name] != pytest.approx(value, rel=1e-3)
    if which == "metric":
        for name in (
            "inertia/mass-slugs",
            "inertia/ixx-slugs_ft2",
            "inertia/izz-slugs_ft2",
            "metrics/bw-ft",
        ):
            assert name in wanted or changed[name] == nominal[name]
    # The next flight of the same mission is the nominal one again.
    again = mission.open()
    engine.run_ic(again)
    assert all(again[name] == nominal[name] for name in wanted)


def test_it_flies_as_a_hand_edited_file_does(tmp_path):
    # Ixz as a physicist writes it, 0.5 kg m2, is -0.5 in JSBSim's matrix.
    edited = tmp_path / "aircraft" / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", edited)
    xml = edited / "espaaro.xml"
    text = xml.read_text()
    for old, new in (("21.34<", "24<"), ("8.26<", "9.5<"), (">0.25<", ">0.5<")):
        assert text.count(old) == 1
        text = text.replace(old, new)
    xml.write_text(text)
    by_name = {
        "inertia/mass-slugs": 24.0 / KG_PER_SLUG,
        "inertia/iyy-slugs_ft2": 9.5 / KG_M2,
        "inertia/ixz-slugs_ft2": -0.5 / KG_M2,
    }
    # JSBSim's own unit factors are rounded (0.7376 slug ft2 a kg m2), so its figures are taken,
    # once they are seen to mean these.
    with StagedMission(find_aircraft(edited), find_script("trim")) as mission:
        fdm = mission.open()
        engine.run_ic(fdm)
        assert {name: fdm[name] for name in by_name} == pytest.approx(by_name, rel=1e-4)
        by_name = {name: fdm[name] for name in by_name}
    mine, theirs, nominal = (
        fly(replace(SPEC, properties=by_name)),
        fly(replace(SPEC, aircraft=edited)),
        fly(SPEC),
    )
    for name in ("alpha_rad", "altitude", "speed"):
        assert mine.signals[name] == pytest.approx(theirs.signals[name], rel=1e-6, abs=1e-8)
    assert np.abs(mine.signals["alpha_rad"] - nominal.signals["alpha_rad"]).max() > 1e-3


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"inertia/mass-slugs": 0.0}, "must be a positive number"),
        ({"inertia/iyy-slugs_ft2": float("nan")}, "must be a positive number"),
        (
            {"inertia/mass-slugs": 1.5, "inertia/weight-lbs": 50.0},
            r"espaaro.xml:\d+: two of the properties",
        ),
        ({"inertia/weight-lbs": 50.0, "aero/CX": 1.0}, "the model computes it"),
    ],
)
def test_what_cannot_be_is_refused(wanted, message):
    with pytest.raises(BadInputError, match=message):
        fly(replace(SPEC, properties=wanted))


def test_an_unknown_unit_or_a_missing_element_is_named_with_its_line(tmp_path):
    folder = tmp_path / "aircraft" / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", folder)
    xml = folder / "espaaro.xml"
    xml.write_text(xml.read_text().replace('<chord unit="M">0.53</chord>', ""))
    with pytest.raises(
        BadInputError, match=r"espaaro.xml:\d+: property metrics/cbarw-ft comes from <chord>"
    ):
        fly(replace(SPEC, aircraft=folder, properties={"metrics/cbarw-ft": 2.0}))
