"""Equations of motion: one frame from copied states of JSBSim, integrator history included."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.batch_flights import MASS, METRICS, START, aircraft, compared, worst
from tests.helpers.batch_states import BODY, RECORDS, STATES, integrators, one_frame
from tests.helpers.few import few
from uqharness.batch.models import atmosphere, auxiliary, motion

AGREES, SEEN = 2e-11, 5e-10
CONTROL = {
    "ic/lat-geod-rad": 1.05,
    "ic/h-sl-ft": 3000.0,
    "ic/u-fps": 200.0,
    "ic/phi-rad": 1.2,
    **integrators(3, 3, 1, 4),
}


@pytest.mark.parametrize("number", few(range(6), 3))
@pytest.mark.parametrize("name", STATES)
def test_a_frame_from_a_copied_state(name, number):
    assert (
        worst(
            one_frame({**STATES[name], **integrators(number, number, number, number)}, seed=number)
        )
        < AGREES
    )


@pytest.mark.parametrize("numbers", [(1, 3, 1, 4), (3, 3, 3, 3), (2, 4, 5, 1)])
def test_integrators_of_the_four_parts_differ(numbers):
    assert (
        worst(one_frame({**STATES["rapid roll"], **integrators(*numbers)}, seed=sum(numbers)))
        < AGREES
    )


def test_the_controls_state_agrees():
    assert worst(one_frame(CONTROL)) < AGREES


@pytest.mark.parametrize(
    ("module", "name", "factor"),
    [
        (motion, "J2", 0.0),
        (motion, "J2", 1.0 + 1e-6),
        (motion, "RATE_RADPS", 1.0 + 1e-6),
        (motion, "GM_FT3_S2", 1.0 + 1e-9),
        (motion, "A_FT", 1.0 + 1e-11),
        (atmosphere, "_R_DRY", 1.0 + 1e-9),
        (auxiliary, "G_FPS2", 1.0 + 1e-9),
    ],
)
def test_a_constant_a_little_off_is_noticed(monkeypatch, module, name, factor):
    monkeypatch.setattr(module, name, getattr(module, name) * factor)
    assert worst(one_frame(CONTROL)) > SEEN


@pytest.mark.parametrize("number", range(1, 6))
def test_another_integrator_is_noticed(monkeypatch, number):
    monkeypatch.setitem(motion.WEIGHTS, number, motion.WEIGHTS[number % 5 + 1])
    assert worst(one_frame({**CONTROL, **integrators(number, number, number, number)})) > SEEN


@pytest.mark.parametrize(
    "changed",
    [
        aircraft(BODY, mass=MASS.replace(".3</ixz>", "-.3</ixz>")),
        aircraft(BODY, mass=MASS.replace(".3</ixz>", ".3000001</ixz>")),
        aircraft(BODY, metrics=METRICS.replace("<z>2</z>", "<z>2.000001</z>")),
        aircraft(BODY, metrics=METRICS.replace("<z>5</z>", "<z>5.000001</z>")),
        aircraft(BODY.replace(' apply_at_cg="true"', "")),
    ],
    ids=["sign of ixz", "ixz", "arm of AERORP", "eyepoint", "apply_at_cg"],
)
def test_another_aircraft_is_noticed(changed):
    assert worst(one_frame(CONTROL, changed=changed)) > SEEN


def test_wind_a_frame_late_is_noticed():
    assert worst(one_frame(CONTROL, late_wind=True)) > SEEN


def test_geodetic_height_for_geocentric_is_noticed(monkeypatch):
    place = motion.place
    monkeypatch.setattr(
        motion,
        "place",
        lambda ecef: replace(
            place(ecef), height_ft=place(ecef).radius_ft - place(ecef).sea_level_radius_ft
        ),
    )
    assert worst(one_frame(CONTROL)) > SEEN


def test_derivatives_of_another_frame_are_noticed(monkeypatch):
    """The history as it would be if the accelerations of a frame moved that frame."""
    names = motion.slots
    monkeypatch.setattr(
        motion, "slots", lambda part, back=-1: names(part, back + 1 if back >= 1 else back)
    )
    assert worst(one_frame(CONTROL)) > SEEN


@pytest.mark.parametrize("numbers", [(1, 3, 1, 4), (3, 3, 3, 3), (4, 5, 5, 5)])
def test_frames_from_the_start(numbers):
    """Behind initialising the history is JSBSim's too."""
    rng = np.random.default_rng(1)
    inputs = {f"i/{name}": rng.normal(size=31) * 5.0 for name in "xyzlmn"}
    found = compared(aircraft(BODY), RECORDS, inputs, 30, {**START, **integrators(*numbers)})
    assert worst(found) < AGREES


def test_the_quaternion_is_brought_to_unit_length_beyond_a_limit(monkeypatch):
    fast = {"ic/p-rad_sec": 20.0, "ic/q-rad_sec": -20.0}
    assert worst(one_frame({**fast, **integrators(1, 3, 1, 4)})) < AGREES
    monkeypatch.setattr(motion, "_NORMAL", 1.0)
    assert worst(one_frame({**fast, **integrators(1, 3, 1, 4)})) > SEEN


def test_slots_are_named_by_part_and_age():
    assert motion.slots("rates") == ["rates/0", "rates/1", "rates/2"]
    assert motion.slots("rates", 2) == ["rates/0/rate2", "rates/1/rate2", "rates/2/rate2"]
    assert all(
        math.isclose(sum(weights), 1.0) for number, weights in motion.WEIGHTS.items() if number
    )
