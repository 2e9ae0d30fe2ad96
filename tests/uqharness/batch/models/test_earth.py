"""The earth against geodesy in many digits, and JSBSim."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from uqharness.batch.ir import Builder, evaluate
from uqharness.batch.maths import lower
from uqharness.batch.models import motion

# NIMA TR8350.2, table 3.1: half axes of WGS-84 [m], and the foot.
A_M, B_M, FOOT = 6378137.0, 6356752.3142, 0.3048
LATITUDES = [-1.5706, -1.2, -0.7, -1e-9, 0.0, 1e-9, 0.3, np.pi / 4, 1.05, 1.5, 1.5707]


def placed(x, y, z):
    """Place and gravity of points."""
    b = Builder()
    ecef = tuple(b.input(name) for name in "xyz")
    at = motion.place(ecef)
    g = motion.gravity(at)
    named = {
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
    found, _ = evaluate(
        b.finish(named),
        {name: np.atleast_1d(value) for name, value in zip("xyz", (x, y, z), strict=True)},
    )
    return found


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


@pytest.mark.parametrize("height_ft", [-1000.0, 0.0, 300.0, 30000.0, 300000.0])
@pytest.mark.parametrize("latitude", LATITUDES)
def test_latitude_and_height_come_back(latitude, height_ft):
    longitude = 2.0 - latitude
    found = placed(*[float(c) for c in cartesian(latitude, longitude, height_ft)])
    assert found["height"][0] == pytest.approx(height_ft, abs=2e-8)  # the last places of a radius
    assert np.arctan2(found["sin"], found["cos"])[0] == pytest.approx(
        latitude, abs=2e-15 if height_ft <= 1e5 else 2e-14
    )
    assert np.arctan2(found["sinlon"], found["coslon"])[0] == pytest.approx(
        np.arctan2(np.sin(longitude), np.cos(longitude)), abs=1e-15
    )


def test_the_check_notices_a_shape_a_little_off(monkeypatch):
    point = [float(c) for c in cartesian(0.7, 0.1, 1000.0)]
    monkeypatch.setattr(motion, "_RATIO", motion._RATIO + 1e-14)
    assert abs(placed(*point)["height"][0] - 1000.0) > 2e-8


def test_axes_of_the_ellipsoid():
    """On the equator and at the poles height is a difference of lengths."""
    found = placed(
        [motion.A_FT + 100.0, 0.0, 0.0],
        [0.0, 0.0, -motion.A_FT - 7.0],
        [0.0, -motion.B_FT - 50.0, 0.0],
    )
    assert found["height"] == pytest.approx([100.0, 50.0, 7.0], abs=1e-8)
    assert found["sea"] == pytest.approx([motion.A_FT, motion.B_FT, motion.A_FT], abs=1e-8)
    assert (found["sin"][1], found["cos"][0]) == (-1.0, 1.0)


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
            wanted = [
                float(mpmath.diff(potential, point, tuple(int(k == axis) for k in range(3))))
                for axis in range(3)
            ]
            found = placed(*[float(c) for c in point])
            assert [found[f"g{k}"][0] for k in range(3)] == pytest.approx(wanted, abs=2e-14)


def test_local_axes_are_orthogonal_and_point_down():
    found = placed(*[float(c) for c in cartesian(0.6, -1.0, 5000.0)])
    local = np.array([[found[f"l{i}{j}"][0] for j in range(3)] for i in range(3)])
    assert local @ local.T == pytest.approx(np.eye(3), abs=1e-15)
    higher = np.array([float(c) for c in cartesian(0.6, -1.0, 6000.0)]) - [
        float(c) for c in cartesian(0.6, -1.0, 5000.0)
    ]
    assert local @ higher == pytest.approx([0.0, 0.0, -1000.0], abs=1e-7)


def test_turned_undoes_the_earths_rotation():
    b = Builder()
    angle = b.input("angle")
    out = motion.earth_fixed(b.op("sin", angle), b.op("cos", angle), (b.input("x"), 0.0, 2.0))
    found, _ = evaluate(
        lower(b.finish({str(k): b.value(value) for k, value in enumerate(out)})),
        {"angle": np.array([0.3]), "x": np.array([5.0])},
    )
    assert [found[k][0] for k in "012"] == pytest.approx(
        [5.0 * np.cos(0.3), -5.0 * np.sin(0.3), 2.0]
    )
