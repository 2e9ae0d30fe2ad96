"""Period and damping against the damped sinusoid that they were made from."""

import numpy as np
import pytest

from sysid.units import FT_M
from uqharness.dossier.match import fit_mode
from uqharness.simulator import (
    SECOND_ORDER,
    SteadyCondition,
    body_velocity,
    engine,
    find_aircraft,
    find_trim,
    linearise,
    modes,
    open_aircraft,
)
from uqharness.simulator.forced_state import apply_controls

T = np.arange(0.0, 12.0, 0.02)


def wave(period_s, damping, t=T, phase=0.4):
    """A damped sinusoid of that damped period, with an offset and a drift."""
    omega = 2.0 * np.pi / period_s
    decay = damping * omega / np.sqrt(1.0 - damping**2)
    return np.exp(-decay * t) * np.cos(omega * t + phase) + 0.3 + 0.02 * t


def test_standard_errors_are_the_scatter_over_seeds():
    clean = wave(2.0, 0.05)
    result = [
        fit_mode(T, clean + 0.05 * np.random.default_rng(k).standard_normal(T.size), 0.3, 20.0)
        for k in range(60)
    ]
    for value, std in (("period_s", "period_std_s"), ("damping", "damping_std")):
        scatter = np.std([getattr(f, value) for f in result])
        assert np.mean([getattr(f, std) for f in result]) == pytest.approx(scatter, rel=0.35)
    assert abs(np.mean([f.period_s for f in result]) - 2.0) < 4.0 * result[
        0
    ].period_std_s / np.sqrt(60.0)


def test_too_little_to_tell():
    assert fit_mode(T[:8], wave(2.0, 0.1)[:8], 0.3, 20.0) is None
    assert fit_mode(T, np.full(T.size, np.nan), 0.3, 20.0) is None
    assert fit_mode(T, wave(2.0, 0.1), 15.0, 20.0) is None


def test_dutch_roll_of_an_aircraft_is_that_of_its_eigenvalues():
    """JSBSim flies the E-SPAARO from a small sideslip; the linearised model has the period and the
    damping.
    """
    aircraft = find_aircraft("espaaro")
    trim = find_trim(aircraft, SteadyCondition(22.0, 100.0))
    mode = next(m for m in modes(linearise(aircraft, trim)) if m.name == "dutch_roll")
    fdm = open_aircraft(aircraft)
    apply_controls(fdm, aircraft, trim.controls)
    for name, value in zip(
        "uvw", body_velocity(22.0, trim.alpha_rad, trim.beta_rad + 0.005), strict=True
    ):
        fdm[f"ic/{name}-fps"] = value / FT_M
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/theta-rad"] = (
        45.0,
        100.0 / FT_M,
        trim.theta_rad,
    )
    for name, value in SECOND_ORDER.items():
        fdm[name] = value
    engine.run_ic(fdm)
    yaw = []
    for _ in range(800):
        fdm.run()
        yaw.append(fdm["velocities/r-rad_sec"])
    result = fit_mode(np.arange(800) * fdm.get_delta_t(), np.array(yaw), 0.3, 20.0)
    assert result.period_s == pytest.approx(2.0 * np.pi / abs(mode.imag), rel=0.03)
    assert result.damping == pytest.approx(mode.zeta, abs=0.015)
    assert result.period_s != pytest.approx(2.0 * np.pi / mode.wn_radps, rel=0.005)
