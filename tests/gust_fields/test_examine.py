"""The examination in other air runs, and finds standard air as it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import uqharness as uq
from sysid.effects import TURBULENCE_CRITICAL_T
from tests.gust_fields import examine
from tests.gust_fields.fields import FAMILIES, Setting, dryden, spectral
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.gusts import KNOT, NODE_S


def test_each_kind_of_air_is_flown(tmp_path):
    for family in FAMILIES:
        (path, *_) = examine.write_flights(family, 0, 2.0, 15.0, tmp_path, ())
        assert path.stat().st_size > 1000


@pytest.mark.parametrize("family", ["heading", "first-order", "karman", "roll-1797"])
def test_gusts_have_the_intensities_of_their_standard(family):
    """sigma_u, sigma_v, sigma_w of MIL-F-8785C, sigma_p of MIL-HDBK-1797, and the lags' rotation."""
    at = Setting(22.0, 80.0, 15.0, 3.66, 1.6, 2000.0, 3)
    nodes = (spectral if family in ("first-order", "karman") else dryden)(family, at)
    sigma_w = 0.1 * 15.0 * KNOT
    sigma_u = sigma_w / (0.177 + 0.000823 * 80.0 / 0.3048) ** 0.4
    np.testing.assert_allclose(nodes[:, :3].std(axis=0), [sigma_u, sigma_u, sigma_w], rtol=0.1)
    if family == "roll-1797":
        assert nodes[:, 3].std() == pytest.approx(1.9 * sigma_w / np.sqrt(80.0 * 3.66), rel=0.1)
    # q is minus the slope of w along the path, through the wing's lag.
    slope = -np.gradient(nodes[:, 2], NODE_S) / at.V
    keep = np.exp(-NODE_S * np.pi * at.V / (4.0 * at.b))
    expected = lfilter([1.0 - keep], [1.0, -keep], slope)
    assert np.corrcoef(nodes[:, 4], expected)[0, 1] > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("family", ["heading", "body", "tail-delay", "field-wing"])
def test_flights_that_lack_nothing_show_nothing_in_any_air(family, tmp_path):
    row = examine.measure(examine.write_flights(family, 1, 45.0, 15.0, tmp_path))
    assert row.largest[1] < TURBULENCE_CRITICAL_T + 1.0
    assert max(row.vane_t) < 4.0
    assert row.covered > 0.75


@pytest.mark.slow
def test_gusts_of_the_bodys_axes_turn_with_it(tmp_path):
    """The gust ahead, 5 % of V, is 5 % of q in alpha's rate: without it Cm_q was seven standard
    errors off."""
    paths = examine.write_flights("body", 50, 30.0, 15.0, tmp_path)
    result = uq.identify("espaaro", paths, workers=1)
    truth = Airframe().coefficients
    for name in ("Cm_q", "Cm_alpha"):
        k = list(result.names).index(f"aero/{name}")
        assert abs(result.theta[k] - truth[name]) < 3.0 * result.std[k]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "height_m", "name"),
    [("karman", 10.0, "CX_0"), ("passage-airspeed", 80.0, "Cm_alpha")],
)
def test_strong_air_biases_nothing(family, height_m, name, tmp_path):
    """At 30 kt CX_0 was six standard errors off by the curvature of CX, Cm_alpha four because gusts
    were taken to pass at the vane's speed."""
    paths = examine.write_flights(family, 1, 45.0, 30.0, tmp_path, h_m=height_m)
    result = uq.identify("espaaro", paths, workers=1)
    k = list(result.names).index(f"aero/{name}")
    error = result.theta[k] - Airframe().coefficients[name]
    assert abs(error) < 3.0 * result.std[k]


@pytest.mark.slow
def test_the_colour_of_gusts_is_estimated_with_damping(tmp_path):
    """In a frozen field at 30 kt rolling gusts have another spectrum than the filter's. Cl_p was
    six standard errors off and 70 % too large."""
    paths = examine.write_flights("field-wing", 6, 45.0, 30.0, tmp_path, count=1)
    result = uq.identify("espaaro", paths, workers=1)
    truth = Airframe().coefficients
    z = {
        name: (theta - truth[name.removeprefix("aero/")]) / std
        for name, theta, std in zip(result.names, result.theta, result.std, strict=True)
        if np.isfinite(std)
    }
    assert abs(z["aero/Cl_p"]) < 3.0
    assert np.mean(np.abs([*z.values()]) < examine.COVERED) > 0.88


@pytest.mark.slow
def test_intervals_hold_in_the_turbulence_of_jsbsim(tmp_path):
    """A stock glider that turns through the azimuth of JSBSim's gusts; every scale is 1."""
    aircraft, paths = examine.jsbsim_flights("sgs126", "null", 1, 45.0, 15.0, tmp_path)
    result = uq.identify(aircraft, paths[:2], workers=1)
    assert any("axes at an azimuth" in note for note in result.notes)
    identified = np.array([result.status[n] == "identified" for n in result.names])
    z = ((result.theta - 1.0) / result.std)[identified]
    assert identified.sum() == 20
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.mean(np.abs(z) < examine.COVERED) > 0.75
