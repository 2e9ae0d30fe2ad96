"""Inflow at the propeller: its column is the thrust's own slope with airspeed, and its XML does what the column says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.subsystem_effects import subsystem_effects
from uqharness.aircraft import Aircraft, find_aircraft
from uqharness.refine_reference import Probe, ProbeJob, probe
from uqharness.refine_rounds import _inflow
from uqharness.refine_setup import Bench
from uqharness.refine_xml import Written, write_effects
from uqharness.replay import Segment
from uqharness.replay_model import CONTROLS

N = 40
V_MPS = np.linspace(17.0, 28.0, N)
THROTTLE_PCT = 60.0 + 25.0 * np.sin(0.15 * np.arange(N))
K = 0.2


def probed(aircraft: Aircraft) -> Probe:
    x = np.zeros((N, 8))
    x[:, 0], x[:, 1], x[:, 7] = V_MPS, 0.05, 0.05
    controls = np.zeros((N, 4))
    controls[:, CONTROLS.index("throttle")] = THROTTLE_PCT
    segment = Segment("level", "f", 0.02 * np.arange(N), controls, np.zeros(9), 100.0, 100.0)
    with Bench(aircraft, (), ()) as bench:
        return probe(ProbeJob(bench.straight, segment, x, controls, {}, (), False, np.full(N, 100.0)))


@pytest.fixture(scope="module")
def nominal() -> Probe:
    return probed(find_aircraft("espaaro"))


def test_the_column_is_the_slope_of_the_thrust_map(nominal: Probe):
    """E-SPAARO's thrust is K rho jet (jet - V), jet = 0.00508 rpm."""
    rpm = ((-0.00522886 * THROTTLE_PCT + 1.04281575) * THROTTLE_PCT + 11.215278) * THROTTLE_PCT + 2329.50786049
    jet = 0.00508 * rpm
    rho = 2.0 * nominal.reference.qbar / V_MPS**2
    expected = -0.07806 * np.pi * 0.415 * rho * jet * V_MPS / (nominal.reference.qbar * nominal.mass.S)
    assert nominal.by_inflow is not None
    # Slopes are read at every fourth sample and straight between.
    np.testing.assert_allclose(nominal.by_inflow[::4], expected[::4], rtol=1e-3)


def test_written_into_the_aircraft_it_does_what_the_column_says(nominal: Probe, tmp_path: Path):
    (effect,) = [e for e in subsystem_effects([], [], []) if e.key == "effect/propulsion/inflow"]
    slopes = _inflow([nominal])
    write_effects(find_aircraft("espaaro"), [Written(effect, K, "a remark", slopes)], {}, tmp_path / "espaaro")
    changed = probed(find_aircraft(tmp_path / "espaaro"))
    assert nominal.by_inflow is not None
    moved = (changed.coefficients - nominal.coefficients)[::4]
    np.testing.assert_allclose(moved[:, 0], K * nominal.by_inflow[::4], rtol=0.05)
    assert np.abs(moved[:, 1:]).max() < 1e-3 * np.abs(moved[:, 0]).min()
    # A factor on the thrust is something else: at these speeds and throttles it leaves a tenth of it.
    CT = nominal.variables()["CT"][::4]
    alone = np.column_stack([np.ones_like(CT), CT])
    left = moved[:, 0] - alone @ np.linalg.lstsq(alone, moved[:, 0], rcond=None)[0]
    assert np.std(left) > 0.05 * np.std(moved[:, 0])


def test_without_a_propeller_there_is_no_inflow():
    assert _inflow([]) == {}
