"""Moving levels against theory, flights that fly them, and branched streams."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from sysid.model_form.model_form import Parts
from tests.helpers.few import few
from uqharness.errors import BadInputError
from uqharness.flight.dryden import PAGE_STEPS, DrydenGusts, dryden_parameters
from uqharness.flight.fly import record_mission
from uqharness.flight.random_numbers import Split
from uqharness.flight.spec import COEFFICIENTS, FlightSpec, LevelDriver, TransientDriver
from uqharness.flight.stepping import level_blocks
from uqharness.simulator.aircraft import PROJECT_ROOT, Source, find_aircraft
from uqharness.simulator.mission import StagedMission, find_script

RATE = 0.012  # 1/sqrt(s): 0.17 % per sample at 50 Hz, as published for CZ
WALK = LevelDriver("walk", 7, "walk-000000", COEFFICIENTS, (RATE,) * 6)


def levels(driver, steps, dt_s, **keys):
    return np.concatenate(list(level_blocks(driver, steps, dt_s, **keys)))


def walks(number, steps, dt_s, rate):
    """(number * 6, steps): one row a walk."""
    drivers = [
        LevelDriver("walk", 11, f"walk-{k:06d}", COEFFICIENTS, (rate,) * 6) for k in range(number)
    ]
    return np.concatenate([levels(driver, steps, dt_s).T for driver in drivers])


@pytest.mark.parametrize("rate_hz", few([50, 100, 200], 1))
def test_increments_are_gaussian_with_the_variance_of_the_rate(rate_hz):
    path = levels(WALK, 200 * rate_hz, 1.0 / rate_hz)
    inner = (path[:-1] > 0.05) & (
        path[:-1] < 0.95
    )  # at 4 standard deviations from a mirror none is met
    steps = np.diff(path, axis=0)[inner]
    sigma = RATE / np.sqrt(rate_hz)
    # Standard error of a standard deviation is sigma/sqrt(2 n).
    assert steps.std() == pytest.approx(sigma, rel=4.0 / np.sqrt(2.0 * steps.size))
    assert abs(steps.mean()) < 4.0 * sigma / np.sqrt(steps.size)
    assert (
        stats.kstest(steps[:: max(1, steps.size // 20000)], "norm", args=(0.0, sigma)).pvalue > 1e-3
    )
    # A rate 5 % off is seen.
    assert stats.kstest(steps, "norm", args=(0.0, 1.05 * sigma)).pvalue < 1e-3


@pytest.mark.parametrize("rate_hz", few([100, 50, 200], 1))
def test_memory_is_that_of_brownian_motion_between_mirrors(rate_hz):
    # cos(pi f) is an eigenfunction: E[2 cos(pi f(0)) cos(pi f(t))] = exp(-pi^2 rate^2 t / 2), for a
    # uniform start.
    rate, time_s = 0.3, 2
    path = walks(250, time_s * rate_hz + 1, 1.0 / rate_hz, rate)
    product = 2.0 * np.cos(np.pi * path[:, 0]) * np.cos(np.pi * path[:, -1])
    error = product.std() / np.sqrt(product.size)
    assert product.mean() == pytest.approx(
        np.exp(-0.5 * np.pi**2 * rate**2 * time_s), abs=4.0 * error
    )
    # Clipped at the ends, as a careless walk is, it remembers otherwise.
    rng = np.random.default_rng(1)
    clipped = np.array(path[:, 0])
    for _ in range(time_s * rate_hz):
        clipped = np.clip(
            clipped + rate / np.sqrt(rate_hz) * rng.standard_normal(clipped.size), 0.0, 1.0
        )
    assert np.mean((clipped == 0.0) | (clipped == 1.0)) > 0.02


PARTS = Parts(0.003, 0.001, float("nan"), 0.5, 0.01, 1.0, 40.0, 2.02, 0.02, True)


def transient(number, rate, seconds, rate_hz=100):
    """(number * 6, steps): one row a walk of the transient part."""
    drivers = [TransientDriver(11, k, COEFFICIENTS, (rate,) * 6) for k in range(number)]
    return np.concatenate(
        [levels(driver, seconds * rate_hz, 1.0 / rate_hz).T for driver in drivers]
    )


def test_a_transient_part_is_uniform_with_its_own_standard_deviation_and_correlation_time():
    tau, rate_hz = PARTS.transient_time_s, 100
    path = transient(200, PARTS.transient_rate_per_sqrt_s, 3, rate_hz)
    assert (np.abs(path) <= 1.0).all()
    for column in (0, rate_hz, 3 * rate_hz - 1):
        assert stats.kstest(path[:, column], "uniform", args=(-1.0, 2.0)).pvalue > 1e-3, column
    flight = PARTS.transient_half_width * path[:, ::rate_hz]
    assert flight.std() == pytest.approx(PARTS.transient, rel=4.0 * np.sqrt(0.2 / flight.size))

    def memory(path, lag_s):
        """Correlation of the slowest mode, sin(pi level/2), after that time, with its standard
        error.
        """
        mode = np.sin(0.5 * np.pi * path)
        product = 2.0 * mode[:, 0] * mode[:, round(lag_s * rate_hz)]
        return product.mean(), product.std() / np.sqrt(product.size)

    for lag_s in (0.5 * tau, tau, 2.0 * tau):
        result, error = memory(path, lag_s)
        assert result == pytest.approx(np.exp(-lag_s / tau), abs=4.0 * error)
    # A walk of half the rate remembers four times as long, and that is seen.
    result, error = memory(transient(200, 0.5 * PARTS.transient_rate_per_sqrt_s, 3, rate_hz), tau)
    assert abs(result - np.exp(-1.0)) > 8.0 * error
    assert result == pytest.approx(np.exp(-0.25), abs=4.0 * error)


TRANSIENT = TransientDriver(7, 3, ("CX", "Cm"), (0.9, 0.9))
TRANSIENT_SIGNALS = {
    f"{name}_{what}": Source(f"uq/{name}/{what}")
    for name in COEFFICIENTS
    for what in ("level", "transient-level", "delta")
}


@pytest.mark.parametrize(
    ("turbulence", "source", "moved"),
    [
        ("none", "spec", None),
        ("light", "spec", None),
        ("light", "spec", WALK),
        ("none", "spec", WALK),
        ("light", "jsbsim", WALK),
    ],
)
def test_a_flight_flies_the_transient_part_beside_everything_else(
    transient_aircraft, turbulence, source, moved
):
    spec = FlightSpec(
        transient_aircraft,
        Path("loiter"),
        duration_s=2.0,
        turbulence=turbulence,
        turbulence_source=source,
        levels=moved,
        transient=TRANSIENT,
        record_rate_hz=100.0,
        properties={"uq/active": 1.0, "uq/CX/transient": 0.003},
    )
    with StagedMission(find_aircraft(transient_aircraft), find_script("loiter")) as mission:
        signals = record_mission(mission, spec, TRANSIENT_SIGNALS).signals
    expected = levels(TRANSIENT, 200, 0.01)
    steady = levels(moved, 200, 0.01) if moved is not None else np.full((200, 6), 0.5)
    for column, name in enumerate(COEFFICIENTS):
        assert np.array_equal(signals[f"{name}_transient-level"][1:], expected[:, column])
        assert signals[f"{name}_transient-level"][0] == expected[0, column]
        assert np.array_equal(signals[f"{name}_level"][1:], steady[:, column])
    assert signals["CX_delta"][1:] == pytest.approx(
        (steady[:, 0] - 0.5) * 0.016 + 0.003 * expected[:, 0], abs=1e-15
    )
    assert signals["Cm_delta"][1:] == pytest.approx((steady[:, 4] - 0.5) * 0.024, abs=1e-15)


@pytest.fixture(scope="module")
def transient_aircraft(tmp_path_factory):
    """The E-SPAARO with a plugin that has a transient part."""
    from uqharness.plugin.model_form_xml import constant_xml

    folder = tmp_path_factory.mktemp("transient") / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", folder)
    bounds = {"CX": 0.008, "CY": 0.01, "CZ": 0.05, "Cl": 0.0015, "Cm": 0.012, "Cn": 0.0015}
    text = constant_xml({name: (-size, size) for name, size in bounds.items()}, "made up")
    (folder / "Systems" / "model-form.xml").write_bytes(text)
    return folder


def test_a_plugin_without_a_transient_part_is_refused(tmp_path, transient_aircraft):
    folder = tmp_path / "espaaro"
    shutil.copytree(transient_aircraft, folder)
    system = folder / "Systems" / "model-form.xml"
    system.write_text(system.read_text().replace("transient-level", "wave"))
    spec = FlightSpec(
        folder, Path("loiter"), duration_s=1.0, transient=TRANSIENT, properties={"uq/active": 1.0}
    )
    with (
        StagedMission(find_aircraft(folder), find_script("loiter")) as mission,
        pytest.raises(BadInputError, match=r"no property uq/CX/transient-level.*transient = false"),
    ):
        record_mission(mission, spec, TRANSIENT_SIGNALS)


# Streams of a branch: what they drive goes on, the normals behind the split are others.

SPLIT = Split(700, 3, 4, 1, 2)


def test_gusts_keep_their_filters_and_get_other_noise():
    """At the split no component jumps further than a step of its own; ten seconds later nothing is
    left of the old air.
    """
    parameters = dryden_parameters(22.0, 100.0, 15.4, 3.66)
    step = min(SPLIT.frame, PAGE_STEPS - 100)
    specific = DrydenGusts(parameters, 0.01, 5).page()
    other = DrydenGusts(parameters, 0.01, 5, splits=[Split(step, 3, 4, 1, 2)]).page()
    np.testing.assert_array_equal(other[:, :step], specific[:, :step])
    assert (other[:, step + 1 :] != specific[:, step + 1 :]).all()
    for k in range(4):
        steps = np.abs(np.diff(specific[k]))
        assert abs(other[k, step] - other[k, step - 1]) < 1.5 * steps.max()
        assert abs(other[k, step] - specific[k, step]) < 3.0 * steps.max()
