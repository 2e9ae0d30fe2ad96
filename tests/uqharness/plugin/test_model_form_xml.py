"""Bounds computed inside JSBSim against sysid's numpy, and the system around them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from sysid.aerodynamics.coefficients import COEFFICIENTS
from sysid.model_form.model_form import ModelForm
from tests.helpers.model_forms import made_up_form, with_parts
from uqharness.errors import BadInputError
from uqharness.plugin.model_form_xml import constant_xml, model_form_xml
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, Aircraft, find_aircraft, open_aircraft

WIDE = {
    "V_mps": (12.0, 35.0),
    "alpha_rad": (-0.25, 0.25),
    "beta_rad": (-0.3, 0.3),
    "phi_rad": (-1.0, 1.0),
    "theta_rad": (-0.6, 0.6),
    "p_radps": (-3.0, 3.0),
    "q_radps": (-1.5, 1.5),
    "r_radps": (-1.5, 1.5),
}


@pytest.fixture
def aircraft(tmp_path) -> Aircraft:
    folder = tmp_path / "aircraft" / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", folder)
    return find_aircraft(folder)


def system_of(aircraft: Aircraft) -> Path:
    return aircraft.folder / "Systems" / "model-form.xml"


def states_forced_upon(aircraft: Aircraft, count: int, fresh: bool):
    """Bounds and extrapolation flag of the XML over a Latin hypercube of states, and those states
    as the record names them.
    """
    fdm = open_aircraft(aircraft)
    lows, highs = zip(*WIDE.values(), (-15.0, 15.0), (20.0, 100.0), strict=True)
    points = qmc.scale(
        qmc.LatinHypercube(len(lows), rng=np.random.default_rng(4)).random(count), lows, highs
    )
    bounds, flags, observed, distant = [], [], [], []
    for row in points:
        # The system runs before the actuators and sees them a frame old; only in a fresh instance
        # do they stand still.
        fdm = open_aircraft(aircraft) if fresh else fdm
        speed, alpha, beta, phi, theta, p, q, r, elevator, throttle = row
        body = (
            speed
            / 0.3048
            * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
        )
        fdm["ic/h-sl-ft"], fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = (
            1000.0,
            phi,
            theta,
            0.3,
        )
        for name, value in zip(
            ("u-fps", "v-fps", "w-fps", "p-rad_sec", "q-rad_sec", "r-rad_sec"),
            [*body, p, q, r],
            strict=True,
        ):
            fdm[f"ic/{name}"] = value
        fdm["fcs/elevator-cmd-deg"], fdm["fcs/throttle-cmd-pct"] = elevator, throttle
        engine.run_ic(fdm)
        bounds.append([[fdm[f"uq/{c}/lower"], fdm[f"uq/{c}/upper"]] for c in COEFFICIENTS])
        flags.append(fdm["uq/extrapolated"])
        distant.append(fdm["uq/extrapolation"])
        observed.append([*row[:8], fdm["fcs/elevator-pos-deg"], fdm["fcs/throttle-pos-pct"]])
    names = [*WIDE, "elevator_pos_deg", "throttle_pct"]
    return (
        np.array(bounds),
        np.array(flags),
        dict(zip(names, np.array(observed).T, strict=True)),
        np.array(distant),
    )


def compare(form: ModelForm, aircraft: Aircraft, count: int, fresh: bool = False):
    system_of(aircraft).write_bytes(model_form_xml(form, aircraft))
    bounds, flags, states, distant = states_forced_upon(aircraft, count, fresh)
    expected = form.bounds(states)
    for k, name in enumerate(COEFFICIENTS):
        lower, upper = expected.get(name, (np.zeros(count), np.zeros(count)))
        assert bounds[:, k, 0] == pytest.approx(lower, rel=1e-9, abs=1e-12)
        assert bounds[:, k, 1] == pytest.approx(upper, rel=1e-9, abs=1e-12)
    assert np.array_equal(flags, form.extrapolated(states).astype(float))
    distance = np.max([b.distance(states) for b in form.coefficients.values()], axis=0)
    assert distant == pytest.approx(distance, rel=1e-9, abs=1e-9)
    assert np.array_equal(distant > 0.0, flags > 0.0)
    # It is no other coefficient's distance, nor that of the box alone.
    if len(form.coefficients) > 1:
        single = next(iter(form.coefficients.values())).distance(states)
        assert distant != pytest.approx(single, rel=1e-9, abs=1e-9)
    return bounds, flags


@pytest.mark.parametrize("outside", ["grow", "clamp"])
def test_bounds_equal_numpys_well_outside_the_data_clip_included(aircraft, outside):
    # Wide data, so that the hypercube meets both sides of the hull.
    form = made_up_form(outside=outside)
    wide = {
        c: replace(
            b,
            scale=3 * b.scale,
            hull=replace(
                b.hull, low=b.centre - 12 * b.scale, high=b.centre + 12 * b.scale, leverage=0.3
            ),
        )
        for c, b in form.coefficients.items()
    }
    form = replace(form, coefficients=wide)
    bounds, flags = compare(form, aircraft, 250)
    assert 0.05 < flags.mean() < 0.95
    clipped = bounds == 0.0
    assert 0.01 < clipped.mean() < 0.5
    assert system_of(aircraft).read_text().count('name="uq/leverage/') == 2


def test_the_comparison_sees_a_wrong_digit(aircraft):
    form = made_up_form()
    system_of(aircraft).write_bytes(model_form_xml(form, aircraft))
    poorer = form.coefficients["Cn"]
    changed = replace(
        form, coefficients={**form.coefficients, "Cn": replace(poorer, s2=poorer.s2 * (1 + 1e-6))}
    )
    text = model_form_xml(changed, aircraft)
    bounds, _, states, distant = states_forced_upon(aircraft, 20, False)
    slack = {
        c: replace(b, hull=replace(b.hull, leverage=1.001 * b.hull.leverage))
        for c, b in form.coefficients.items()
    }
    assert distant != pytest.approx(
        np.max([b.distance(states) for b in slack.values()], axis=0), rel=1e-9, abs=1e-9
    )
    upper = changed.bounds(states)["Cn"][1]
    assert text != system_of(aircraft).read_bytes()
    assert bounds[:, 5, 1] != pytest.approx(upper, rel=1e-9, abs=1e-12)


def test_a_delta_follows_its_level_in_every_frame_and_can_be_taken_out(aircraft):
    system_of(aircraft).write_bytes(model_form_xml(made_up_form(size=0.002), aircraft))
    fdm = open_aircraft(aircraft)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = 1000.0, 72.0
    engine.run_ic(fdm)
    assert [fdm[f"uq/{c}/delta"] for c in COEFFICIENTS] == [0.0] * 6
    fdm["uq/active"], fdm["uq/CZ/active"] = 1.0, 0.0
    constant = []
    for level in (0.0, 0.3, 1.0, 0.8):
        for c in COEFFICIENTS:
            fdm[f"uq/{c}/level"] = level
        fdm.run()
        for c in COEFFICIENTS:
            lower, upper = fdm[f"uq/{c}/lower"], fdm[f"uq/{c}/upper"]
            expected = 0.0 if c == "CZ" else lower + level * (upper - lower)
            assert fdm[f"uq/{c}/delta"] == pytest.approx(expected, rel=1e-12)
            assert upper > lower
        constant.append(fdm["uq/CX/upper"])
    # 50 Hz bounds in a 100 Hz flight: computed in every second frame, held in between.
    assert constant[1] != constant[0]
    assert constant[2] == constant[1]
    assert constant[3] != constant[2]


def test_a_transient_part_adds_its_half_width_times_its_level(aircraft):
    form = with_parts(made_up_form(size=0.002), transient={"CX": 0.004, "Cm": 0.002})
    system_of(aircraft).write_bytes(model_form_xml(form, aircraft))
    fdm = open_aircraft(aircraft)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = 1000.0, 72.0
    fdm["uq/active"] = 1.0
    engine.run_ic(fdm)
    assert (
        fdm["uq/CX/transient"]
        == form.coefficients["CX"].parts.transient_half_width
        == pytest.approx(np.sqrt(3) * 0.004)
    )
    assert [fdm[f"uq/{c}/transient-level"] for c in COEFFICIENTS] == [0.0] * 6
    for level, wave in ((0.3, 0.0), (0.3, 1.0), (0.9, -0.7)):
        for c in COEFFICIENTS:
            fdm[f"uq/{c}/level"], fdm[f"uq/{c}/transient-level"] = level, wave
        fdm.run()
        for c, bounds in form.coefficients.items():
            lower, upper = fdm[f"uq/{c}/lower"], fdm[f"uq/{c}/upper"]
            steady = lower + level * (upper - lower)
            assert fdm[f"uq/{c}/delta"] == pytest.approx(
                steady + wave * bounds.parts.transient_half_width, rel=1e-12
            )
    # A part that is not there moves nothing.
    assert fdm["uq/CY/delta"] == pytest.approx(
        fdm["uq/CY/lower"] + 0.9 * (fdm["uq/CY/upper"] - fdm["uq/CY/lower"]), rel=1e-12
    )
    assert fdm["uq/CX/delta"] != pytest.approx(
        fdm["uq/CX/lower"] + 0.9 * (fdm["uq/CX/upper"] - fdm["uq/CX/lower"]), rel=1e-3
    )


def test_constant_bounds_have_to_enclose_the_model():
    text = constant_xml({"CX": (-0.01, 0.02)}, "made up").decode()
    assert '<property value="-0.01">uq/CX/lower</property>' in text
    assert '<property value="0.0">uq/Cn/upper</property>' in text
    with pytest.raises(BadInputError, match=r"bounds of Cm: lower must be <= 0"):
        constant_xml({"Cm": (0.001, 0.02)}, "made up")
