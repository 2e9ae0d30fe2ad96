"""Mass properties set by name in the XML."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.flight.fly import fly
from uqharness.flight.spec import FlightSpec
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mission import StagedMission, find_script

SPEC = FlightSpec(Path("espaaro"), Path("doublet-elevator"), duration_s=4.0)


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
    ("index", "expected"),
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
def test_properties_stand_at_what_was_asked_and_the_rest_stays(missions, index, expected):
    mission = missions[index]
    nominal, changed = mission.open(), mission.open(changed=expected)
    for fdm in (nominal, changed):
        engine.run_ic(fdm)
    for name, value in expected.items():
        assert changed[name] == pytest.approx(value, rel=1e-8)
        assert nominal[name] != pytest.approx(value, rel=1e-3)
    if index == "metric":
        for name in (
            "inertia/mass-slugs",
            "inertia/ixx-slugs_ft2",
            "inertia/izz-slugs_ft2",
            "metrics/bw-ft",
        ):
            assert name in expected or changed[name] == nominal[name]
    # The next flight of the same mission is the nominal one again.
    repeat = mission.open()
    engine.run_ic(repeat)
    assert all(repeat[name] == nominal[name] for name in expected)


@pytest.mark.parametrize(
    ("expected", "message"),
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
def test_impossible_masses_are_refused(expected, message):
    with pytest.raises(BadInputError, match=message):
        fly(replace(SPEC, properties=expected))
