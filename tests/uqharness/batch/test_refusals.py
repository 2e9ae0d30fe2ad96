"""Refusals of the batch engine, and mutations of the project's aircraft: none is passed over."""

from __future__ import annotations

import re

import pytest

from tests.helpers.batch_whole import copied, spec
from uqharness.batch.course import refusals


@pytest.mark.parametrize("name", ["espaaro", "espaaro_truth", "synthetic_stall"])
@pytest.mark.parametrize(
    "script",
    [
        "loiter",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("doublet-elevator", "flight-ident", "flight-bounds")
        ),
    ],
)
def test_the_projects_aircraft_are_understood(name, script):
    varying = (
        "uq/CZ/level",
        "uq/Cm/upper",
        "ap/WP_LOITER_RAD",
        "inertia/iyy-slugs_ft2",
        "metrics/bw-ft",
        "ic/psi-true-deg",
    )
    assert refusals(spec(name, script, 10.0), varying) == ()


@pytest.mark.parametrize(
    ("file", "old", "new", "output"),
    [
        ("espaaro.xml", "</fdm_config>", "<buoyant_forces/></fdm_config>", "<buoyant_forces>"),
        (
            "Systems/autopilot.xml",
            "</channel>",
            (
                "<pure_gain name='w'><input>position/vrp-radius-ft</input><gain>1</gain>"
                "<output>fcs/elevator-cmd-norm</output></pure_gain></channel>"
            ),
            "vrp-radius-ft",
        ),
        (
            "Systems/sensors.xml",
            "</channel>",
            (
                "<pure_gain"
                " name='velocities/u-fps'><input>uq/active</input><gain>1</gain></pure_gain></channel>"
            ),
            "velocities/u-fps cannot be written",
        ),
    ],
)
def test_a_broken_aircraft_is_refused_with_file_and_line(tmp_path, file, old, new, output):
    plane = copied(tmp_path, edits={file: {old: new}})
    text = (plane / file).read_text()
    line = text[: text.index(new) + len(new)].count("\n") + 1
    (result,) = refusals(spec(plane, duration_s=5.0))
    assert output in result
    assert f"{plane / file}:" in result
    assert abs(int(re.search(r":(\d+): ", result).group(1)) - line) <= 1


def test_an_instrument_that_is_not_supported_is_left_out(tmp_path):
    needle = "<pure_gain name='w'><input>position/vrp-radius-ft</input><gain>1</gain></pure_gain>"
    edits = {"Systems/autopilot.xml": {"</channel>": f"{needle}<property>w</property></channel>"}}
    plane = copied(tmp_path, edits=edits)
    assert refusals(spec(plane, duration_s=5.0)) == ()


@pytest.mark.parametrize(
    ("properties", "output"),
    [
        ({"simulation/gravitational-torque": 1.0}, "simulation/gravitational-torque"),
        ({"simulation/gravity-model": 0.0}, "simulation/gravity-model"),
        ({"simulation/integrator/rate/rotational": 7.0}, "integrator"),
        ({"forces/hold-down": 1.0}, "forces/hold-down"),
        ({"atmosphere/SL-graded-delta-T": 5.0}, "atmosphere/SL-graded-delta-T"),
        ({"metrics/Sw-sqft": 12.0}, "metrics/Sw-sqft"),
        ({"atmosphere/vapor-pressure-psf": 10.0}, "atmosphere/vapor-pressure-psf"),
    ],
)
def test_unsupported_settings_are_refused(properties, output):
    (result,) = refusals(spec(duration_s=5.0, properties=properties))
    assert output in result


def test_varying_properties_are_checked():
    assert refusals(spec(duration_s=5.0)) == ()
    assert "forces/hold-down" in refusals(spec(duration_s=5.0), ["forces/hold-down"])[0]
