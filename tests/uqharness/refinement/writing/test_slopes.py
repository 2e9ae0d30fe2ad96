"""Effects that are written with numbers of the model: inflow by the thrust's slope with airspeed,
stall by the lift slope.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.catalogue import subsystem_effects
from sysid.effects.selection import SelectedEffect, Selection
from uqharness.identification.linearised import (
    ModelState,
    Probe,
    ProbeJob,
    effect_columns,
    probe_all,
)
from uqharness.refinement.write_xml import (
    EffectToWrite,
    control_slopes,
    inflow_numbers,
    of_lift_slope,
    write_effects,
)
from uqharness.replay import ReplayFolder
from uqharness.replay.model import CONTROLS
from uqharness.replay.segments import Segment
from uqharness.simulator.aircraft import Aircraft, find_aircraft

N = 40
V_MPS = np.linspace(17.0, 28.0, N)
THROTTLE_PCT = 60.0 + 25.0 * np.sin(0.15 * np.arange(N))
K = 0.2


def probed(
    aircraft: Aircraft,
    elevator_deg: float | np.ndarray = 0.0,
    consistent: bool = False,
    alpha_rad: float | np.ndarray = 0.05,
) -> Probe:
    x = np.zeros((N, 8))
    x[:, 0], x[:, 1], x[:, 7] = V_MPS, alpha_rad, 0.05
    controls = np.zeros((N, 4))
    controls[:, CONTROLS.index("throttle")] = THROTTLE_PCT
    controls[:, CONTROLS.index("elevator")] = elevator_deg
    segment = Segment("level", "f", 0.02 * np.arange(N), controls, np.zeros(9), 100.0, 100.0)
    with ReplayFolder(aircraft, ideal=CONTROLS) as level:
        return probe_all(
            [ProbeJob(level, segment, x, controls, {}, consistent, np.full(N, 100.0))]
        )[0]


@pytest.fixture(scope="module")
def nominal() -> Probe:
    return probed(find_aircraft("espaaro"))


def test_the_column_is_the_slope_of_the_thrust_map(nominal: Probe):
    """E-SPAARO's thrust is K rho jet (jet - V), jet = 0.00508 rpm."""
    rpm = (
        (-0.00522886 * THROTTLE_PCT + 1.04281575) * THROTTLE_PCT + 11.215278
    ) * THROTTLE_PCT + 2329.50786049
    jet = 0.00508 * rpm
    rho = 2.0 * nominal.reference.qbar / V_MPS**2
    expected = (
        -0.07806 * np.pi * 0.415 * rho * jet * V_MPS / (nominal.reference.qbar * nominal.mass.S)
    )
    # Slopes are read at every fourth sample and straight between.
    np.testing.assert_allclose(nominal.by_inflow[::4], expected[::4], rtol=1e-3)


def test_written_into_the_aircraft_it_does_what_the_column_says(nominal: Probe, tmp_path: Path):
    (effect,) = [e for e in subsystem_effects([], [], []) if e.key == "effect/propulsion/inflow"]
    slopes = inflow_numbers([nominal])
    write_effects(
        find_aircraft("espaaro"),
        [EffectToWrite(effect, K, "a remark", slopes)],
        {},
        tmp_path / "espaaro",
    )
    changed = probed(find_aircraft(tmp_path / "espaaro"))
    moved = (changed.coefficients - nominal.coefficients)[::4]
    np.testing.assert_allclose(moved[:, 0], K * nominal.by_inflow[::4], rtol=0.05)
    assert np.abs(moved[:, 1:]).max() < 1e-3 * np.abs(moved[:, 0]).min()
    # A factor on the thrust is something else: at these speeds and throttles it leaves a tenth of
    # it.
    CT = nominal.variables()["CT"][::4]
    single = np.column_stack([np.ones_like(CT), CT])
    remaining = moved[:, 0] - single @ np.linalg.lstsq(single, moved[:, 0], rcond=None)[0]
    assert np.std(remaining) > 0.05 * np.std(moved[:, 0])


def test_between_forced_samples_coefficients_jump_with_the_surfaces():
    """Along a replay every fourth sample is forced; a doublet's edges lie between them."""
    aircraft, doublet = find_aircraft("espaaro"), np.where(np.arange(N) % 13 < 6, 3.0, -3.0)
    every, fourth = probed(aircraft, doublet), probed(aircraft, doublet, consistent=True)
    slack = np.abs(np.diff(every.coefficients[::4], axis=0)).max()
    assert slack > 0.1
    np.testing.assert_allclose(fourth.coefficients, every.coefficients, atol=5e-4 * slack)


def test_slopes_along_a_prediction_know_nothing_of_samples_to_come():
    """An angle of attack that leaps after row 9, between two forced samples: slopes before it are
    those without, of lines not.
    """
    aircraft, leap = find_aircraft("espaaro"), np.where(np.arange(N) > 9, 0.2, 0.05)
    for consistent in (False, True):
        plain, leaping = (
            probed(aircraft, consistent=consistent, alpha_rad=a).reference for a in (0.05, leap)
        )
        change = np.abs(leaping.slopes - plain.slopes).max(axis=(1, 2))
        assert change[8] < 1e-5
        assert change[16:].min() > 10.0
        assert (change[9] > 1.0) == consistent
    # Held, they go with the dynamic pressure of their own row.
    np.testing.assert_allclose(
        plain.slopes[9, 2, 1] / plain.qbar[9], plain.slopes[8, 2, 1] / plain.qbar[8], rtol=1e-3
    )


def test_without_a_propeller_there_is_no_inflow():
    assert inflow_numbers([]) == {}


def fit_of(nominal: Probe, **values: float) -> SimpleNamespace:
    return SimpleNamespace(
        probes=[nominal], trajectory=SimpleNamespace(point=SimpleNamespace(values=values))
    )


def test_stall_is_a_share_of_the_lift_slope_beside_it(nominal: Probe):
    """Flights that stall make CZ_alpha of a model without stall -2.6 for -3.3: 1.3 of that is 1 of
    the slope that is there.
    """
    choices = tuple(
        SelectedEffect(f"effect/{k}", 1.3, 0.01, 90.0, 8e3, 1.0, 0.0)
        for k in ("stall/separation", "Cm/p_hat^2")
    )
    before = fit_of(nominal)
    result = control_slopes(before)["CZ_alpha"]  # type: ignore[arg-type]
    assert result == pytest.approx(-3.34, abs=0.01)
    after = fit_of(nominal, **{"aero/CZ_alpha": 1.3 * result})
    (stall, other), slopes = (lambda s, n: (s.chosen, n))(
        *of_lift_slope(Selection(choices), before, after)
    )  # type: ignore
    assert (stall.value, stall.std) == (pytest.approx(1.0), pytest.approx(0.01 / 1.3))
    assert other == choices[1]
    assert slopes["CZ_alpha"] == pytest.approx(1.3 * result)
    assert stall.value * slopes["CZ_alpha"] == pytest.approx(1.3 * result)
    same, slopes = of_lift_slope(Selection(choices), before, before)  # type: ignore[arg-type]
    assert same.chosen == choices
    assert slopes["CZ_alpha"] == result


def test_columns_of_what_flies_are_those_of_the_numbers_written(nominal: Probe):
    by_term = {e.term: e for e in subsystem_effects([], [], [])}
    slopes = {"CZ_alpha": -3.0, "Cm_de": -0.02, "CX_de": 9.0, "Cn_dr": -0.001}
    data = SimpleNamespace(
        segments=[SimpleNamespace(dt_s=0.02, flight="f")], slopes=slopes, outputs=()
    )
    trajectory = SimpleNamespace(outputs=[np.zeros((N, 0))], point=ModelState({}, {}, ()))
    moved = replace(nominal, controls=nominal.controls + 2.0)
    moved.reference.x[:, 1] = 0.25
    expected = [by_term["separation"], by_term["slipstream"]]
    (columns,) = effect_columns(data, [moved], trajectory, expected)  # type: ignore[arg-type]
    _, stall = columns.inputs[expected[0].key]
    _, stream = columns.inputs[expected[1].key]
    data.slopes = {**slopes, "CZ_alpha": -1.5}
    (half,) = effect_columns(data, [moved], trajectory, expected[:1])  # type: ignore[arg-type]
    assert np.abs(stall[:, 2]).min() > 0.1
    np.testing.assert_allclose(half.inputs[expected[0].key][1], 0.5 * stall)
    CT = moved.variables()["CT"]
    np.testing.assert_allclose(stream[:, 4], -0.02 * 2.0 * CT)
    np.testing.assert_allclose(stream[:, 5], -0.001 * 2.0 * CT)
    assert not stream[:, :4].any()
