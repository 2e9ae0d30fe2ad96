"""Equations of motion against JSBSim, its start state, the earth against geodesy in many digits, vectors against numpy."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from tests.helpers.batch_flights import MASS, METRICS, START, aircraft, compared, worst
from tests.helpers.batch_states import BODY, RECORDS, STATES, integrators, one_frame
from tests.helpers.few import few
from uqharness.batch import auxiliary, motion
from uqharness.batch.ir import Builder, evaluate
from uqharness.batch.motion import round_44_bits

AGREES, SEEN = 2e-11, 5e-10


CONTROL = {
    "ic/lat-geod-rad": 1.05,
    "ic/h-sl-ft": 3000.0,
    "ic/u-fps": 200.0,
    "ic/phi-rad": 1.2,
    **integrators(3, 3, 1, 4),
}


@pytest.mark.parametrize("number", few(range(6), 2))
@pytest.mark.parametrize("name", STATES)
def test_a_frame_from_a_copied_state(name, number):
    assert (
        worst(
            one_frame({**STATES[name], **integrators(number, number, number, number)}, seed=number)
        )
        < AGREES
    )


@pytest.mark.parametrize("numbers", few([[2, 4, 5, 1], [3, 3, 3, 3], [1, 3, 1, 4]], 1))
def test_integrators_of_the_four_parts_differ(numbers):
    assert (
        worst(one_frame({**STATES["rapid roll"], **integrators(*numbers)}, seed=sum(numbers)))
        < AGREES
    )


@pytest.mark.parametrize(
    ("module", "name", "factor"),
    [
        (motion, "J2", 1.0 + 1e-6),
        (motion, "RATE_RADPS", 1.0 + 1e-6),
        (motion, "A_FT", 1.0 + 1e-11),
        (auxiliary, "G_FPS2", 1.0 + 1e-9),
    ],
)
def test_a_constant_a_little_off_is_noticed(monkeypatch, module, name, factor):
    monkeypatch.setattr(module, name, getattr(module, name) * factor)
    assert worst(one_frame(CONTROL)) > SEEN


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


@pytest.mark.parametrize("numbers", few([[1, 3, 1, 4], [3, 3, 3, 3], [4, 5, 5, 5]], 1))
def test_frames_from_the_start(numbers):
    """Behind initialising the history is JSBSim's too."""
    rng = np.random.default_rng(1)
    inputs = {f"i/{name}": rng.normal(size=31) * 5.0 for name in "xyzlmn"}
    result = compared(aircraft(BODY), RECORDS, inputs, 30, {**START, **integrators(*numbers)})
    assert worst(result) < AGREES


def test_the_quaternion_is_brought_to_unit_length_beyond_a_limit(monkeypatch):
    fast = {"ic/p-rad_sec": 20.0, "ic/q-rad_sec": -20.0}
    assert worst(one_frame({**fast, **integrators(1, 3, 1, 4)})) < AGREES
    monkeypatch.setattr(motion, "_NORMAL", 1.0)
    assert worst(one_frame({**fast, **integrators(1, 3, 1, 4)})) > SEEN


START_RECORDS = (
    *(f"position/eci-{a}-ft" for a in "xyz"),
    *(f"velocities/eci-{a}-fps" for a in "xyz"),
    *(f"velocities/{a}i-rad_sec" for a in "pqr"),
    *(f"velocities/{a}-fps" for a in "uvw"),
    *(f"attitude/{a}-rad" for a in ("phi", "theta", "psi")),
    "position/geod-alt-ft",
    "position/lat-geod-rad",
    "position/long-gc-rad",
    "velocities/vt-fps",
    "aero/alpha-rad",
    "aero/beta-rad",
)


def random_start(seed):
    rng = np.random.default_rng(seed)
    return {
        "ic/lat-geod-deg": rng.uniform(-85.0, 85.0),
        "ic/long-gc-deg": rng.uniform(-180.0, 180.0),
        "ic/h-sl-ft": rng.uniform(0, 3e4),
        "ic/psi-true-deg": rng.uniform(0.0, 360.0),
        "ic/theta-deg": rng.uniform(-80.0, 80.0),
        "ic/phi-deg": rng.uniform(-180.0, 180.0),
        "ic/u-fps": rng.uniform(20.0, 500.0),
        "ic/v-fps": rng.normal() * 20.0,
        "ic/w-fps": rng.normal() * 20.0,
        "ic/p-rad_sec": rng.normal(),
        "ic/q-rad_sec": rng.normal(),
        "ic/r-rad_sec": rng.normal(),
    }


def by_airspeed(seed):
    rng = np.random.default_rng(seed)
    return {
        "ic/h-sl-ft": rng.uniform(0.0, 2e4),
        "ic/psi-true-deg": rng.uniform(0.0, 360.0),
        "ic/vt-fps": rng.uniform(50.0, 200.0),
        "ic/alpha-deg": rng.normal() * 4.0,
        "ic/beta-deg": rng.normal() * 4.0,
        "ic/vw-mag-fps": 20.0,
        "ic/vw-dir-deg": 70.0,
    }


@pytest.mark.parametrize("seed", few(range(6), 1))
@pytest.mark.parametrize("result", [random_start, by_airspeed])
def test_jsbsims_state_behind_its_initialisation(result, seed):
    """Conditions are taken to 44 bits, which is 3e-14 of each."""
    wind = result is by_airspeed
    names = [
        name
        for name in START_RECORDS
        if not (wind and name.startswith("aero/")) and not (wind and name == "velocities/vt-fps")
    ]
    assert (
        worst(compared(aircraft("<aerodynamics/>"), names, frames=0, start=result(seed), floor=1.0))
        < 3e-12
    )


def test_rounding_to_44_bits():
    assert round_44_bits(0.1) == round(0.1 * 2**47) / 2**47
    assert round_44_bits(1.0 + 2.0**-43) == 1.0 + 2.0**-43
    assert round_44_bits(1.0 + 2.0**-46) == 1.0
    assert round_44_bits(-3e7) == -3e7
    assert math.isnan(round_44_bits(math.nan))
    assert round_44_bits(math.inf) == math.inf
    # The last places of a sine, which differ between machines.
    assert round_44_bits(math.sin(0.7)) == round_44_bits(math.nextafter(math.sin(0.7), 1.0))


# NIMA TR8350.2, table 3.1: half axes of WGS-84 [m], and the foot.
A_M, B_M, FOOT = 6378137.0, 6356752.3142, 0.3048


def placed(x, y, z):
    """Place and gravity of points."""
    b = Builder()
    ecef = tuple(b.input(name) for name in "xyz")
    at = motion.place(ecef)
    g = motion.gravity(at)
    listed = {
        "height": at.height_ft,
        "radius": at.radius_ft,
        "sea": at.sea_level_radius_ft,
        "sin": at.sin_latitude,
        "cos": at.cos_latitude,
        "sinlon": at.sin_longitude,
        "coslon": at.cos_longitude,
        **{f"g{k}": b.value(g[k]) for k in range(3)},
        **{f"l{i}{j}": b.value(at.to_local[i][j]) for i in range(3) for j in range(3)},
    }
    result, _ = evaluate(
        b.finish(listed),
        {name: np.atleast_1d(value) for name, value in zip("xyz", (x, y, z), strict=True)},
    )
    return result


def cartesian(latitude, longitude, height_ft):
    """Earth-fixed coordinates [ft] in 40 digits: the closed form from latitude and height."""
    with mpmath.workdps(40):
        a, b = mpmath.mpf(motion.A_FT), mpmath.mpf(motion.B_FT)
        lat, lon, h = mpmath.mpf(latitude), mpmath.mpf(longitude), mpmath.mpf(height_ft)
        squeeze = (b / a) ** 2
        n = a / mpmath.sqrt(1 - (1 - squeeze) * mpmath.sin(lat) ** 2)
        across = (n + h) * mpmath.cos(lat)
        return (
            across * mpmath.cos(lon),
            across * mpmath.sin(lon),
            (n * squeeze + h) * mpmath.sin(lat),
        )


@pytest.mark.parametrize("height_ft", [-1000.0, 300.0, 300000.0])
@pytest.mark.parametrize("latitude", [-1.5706, -1e-9, 0.0, 0.3, 1.05, 1.5707])
def test_latitude_and_height_come_back(latitude, height_ft):
    longitude = 2.0 - latitude
    result = placed(*[float(c) for c in cartesian(latitude, longitude, height_ft)])
    assert result["height"][0] == pytest.approx(height_ft, abs=2e-8)  # the last places of a radius
    assert np.arctan2(result["sin"], result["cos"])[0] == pytest.approx(
        latitude, abs=2e-15 if height_ft <= 1e5 else 2e-14
    )
    assert np.arctan2(result["sinlon"], result["coslon"])[0] == pytest.approx(
        np.arctan2(np.sin(longitude), np.cos(longitude)), abs=1e-15
    )


def test_the_ellipsoid_is_that_of_wgs_84():
    assert pytest.approx([A_M, B_M], rel=2e-11) == [motion.A_FT * FOOT, motion.B_FT * FOOT]
    # TR8350.2, table 3.1: GM in m3/s2, angular velocity; J2 from the normalised second harmonic.
    assert pytest.approx(3.986004418e14, rel=1e-7) == motion.GM_FT3_S2 * FOOT**3
    assert pytest.approx(7.292115e-5, rel=1e-9) == motion.RATE_RADPS
    assert pytest.approx(0.484166774985e-3 * 5**0.5, rel=1e-5) == motion.J2


def test_gravity_is_the_gradient_of_its_potential():
    """J2's potential differentiated in 40 digits."""

    def potential(x, y, z):
        r2 = x * x + y * y + z * z
        ratio = mpmath.mpf(motion.A_FT) ** 2 / r2
        return (
            motion.GM_FT3_S2
            / mpmath.sqrt(r2)
            * (1 - mpmath.mpf(motion.J2) / 2 * ratio * (3 * z * z / r2 - 1))
        )

    with mpmath.workdps(40):
        for latitude in (-1.2, 0.0, 0.5, 1.0):
            point = tuple(mpmath.mpf(float(c)) for c in cartesian(latitude, 0.4, 20000.0))
            expected = [
                float(mpmath.diff(potential, point, tuple(int(k == axis) for k in range(3))))
                for axis in range(3)
            ]
            result = placed(*[float(c) for c in point])
            assert [result[f"g{k}"][0] for k in range(3)] == pytest.approx(expected, abs=2e-14)


def test_local_axes_are_orthogonal_and_point_down():
    result = placed(*[float(c) for c in cartesian(0.6, -1.0, 5000.0)])
    local = np.array([[result[f"l{i}{j}"][0] for j in range(3)] for i in range(3)])
    assert local @ local.T == pytest.approx(np.eye(3), abs=1e-15)
    higher = np.array([float(c) for c in cartesian(0.6, -1.0, 6000.0)]) - [
        float(c) for c in cartesian(0.6, -1.0, 5000.0)
    ]
    assert local @ higher == pytest.approx([0.0, 0.0, -1000.0], abs=1e-7)
