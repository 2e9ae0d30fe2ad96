"""Effects and estimates in the style of an author who has one function a coefficient."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from sysid.effects.catalogue import coefficient_effect
from uqharness.plugin import Bounds, bake_scales, instrument_aircraft, with_card
from uqharness.plugin.apply import Estimate, put_values
from uqharness.refinement.write_xml import EffectToWrite, write_effects
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

STATES = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec", "aero/alpha-rad")


def states_in_flight(aircraft, settings=None):
    """(100, 4) states of a second with pitch, roll and sideslip."""
    fdm = open_aircraft(aircraft)
    for name, value in (settings or {}).items():
        engine.set_property(fdm, name, value)
    for name, value in {"h-sl-ft": 3000.0, "u-fps": 90.0, "v-fps": 8.0, "w-fps": 4.0}.items():
        fdm[f"ic/{name}"] = value
    fdm["ic/q-rad_sec"] = fdm["ic/p-rad_sec"] = 0.2
    engine.run_ic(fdm)
    rows = []
    for _ in range(100):
        fdm.run()
        rows.append([fdm[name] for name in STATES])
    return np.array(rows)


@pytest.fixture(scope="module")
def glider(tmp_path_factory):
    """JSBSim's sgs126 with scales and biases."""
    out = tmp_path_factory.mktemp("glider") / "sgs126"
    instrument_aircraft(with_card(find_aircraft("sgs126")), Bounds(), out, check=False)
    return find_aircraft(out)


def test_an_effect_is_one_more_function_of_the_authors_axis(glider, tmp_path):
    out = tmp_path / "sgs126"
    effect = coefficient_effect("Cm", "beta^2")
    write_effects(glider, [EffectToWrite(effect, 1.0, "a remark", {})], {}, out)
    text = (out / "sgs126.xml").read_text(encoding="utf-8")
    start = text.index('<function name="aero/coefficient/Cmbeta2">')
    function = text[start : text.index("</function>", start)]
    assert text.rindex("<axis", 0, start) == text.index('<axis name="PITCH">')
    assert f"<description>{effect.name}</description>" in function
    assert "metrics/Sw-sqft" in function
    assert "metrics/cbarw-ft" in function
    assert function.count("aero/beta-rad") == 2
    assert "aero/effects" not in text
    changed = find_aircraft(out)
    states = states_in_flight(changed)
    original = states_in_flight(glider)
    assert np.array_equal(states_in_flight(changed, {"aero/Cm_beta2": 0.0}), original)
    # The pitching moment of the first frames by hand: q S c Cm beta^2 over Iyy.
    fdm = open_aircraft(glider)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"] = 3000.0, 90.0, 8.0, 4.0
    engine.run_ic(fdm)
    area = fdm["metrics/Sw-sqft"] * fdm["metrics/cbarw-ft"]
    moment = fdm["aero/qbar-psf"] * area * fdm["aero/beta-rad"] ** 2
    gained = moment / fdm["inertia/iyy-slugs_ft2"] * 0.01
    assert states[1, 1] - original[1, 1] == pytest.approx(2.0 * gained, rel=0.4)


def test_an_authors_axis_in_wind_keeps_the_turned_increment(glider, tmp_path):
    out = tmp_path / "sgs126"
    write_effects(
        glider, [EffectToWrite(coefficient_effect("CZ", "alpha^3"), 1.0, "", {})], {}, out
    )
    text = (out / "sgs126.xml").read_text(encoding="utf-8")
    # Lift and drag are in wind axes: the body-axis force has a part in both.
    assert 'name="aero/effects/force/LIFT"' in text
    assert 'name="aero/effects/force/DRAG"' in text


def test_scales_are_baked_into_the_authors_numbers(glider, tmp_path):
    folder = tmp_path / "sgs126"
    shutil.copytree(glider.folder, folder)
    scales = {"uq/scale/Cmq": 1.4, "uq/scale/Cmde": 0.9, "uq/scale/Cnb": 1.0}
    put_values(folder, {name: Estimate(value, "by a fit") for name, value in scales.items()})
    scaled = states_in_flight(find_aircraft(folder))
    assert np.abs(scaled - states_in_flight(glider)).max() > 1e-3
    result = bake_scales(folder)
    # Cmde is a table over Mach number: no number to change.
    assert result.changed == {"uq/scale/Cmq": (-9.0, pytest.approx(-12.6))}
    assert result.remaining == ("uq/scale/Cmde",)
    text = (folder / "sgs126.xml").read_text(encoding="utf-8")
    assert "<value>-12.6</value>" in text
    assert "was -9.0000, times uq/scale/Cmq = 1.4 (by a fit)" in text
    system = (folder / "Systems" / "scale-bias.xml").read_text(encoding="utf-8")
    assert '<property value="1">uq/scale/Cmq</property>' in system
    assert '<property value="0.9">uq/scale/Cmde</property>' in system
    assert np.allclose(states_in_flight(find_aircraft(folder)), scaled, atol=1e-9)
    assert bake_scales(folder).changed == {}
