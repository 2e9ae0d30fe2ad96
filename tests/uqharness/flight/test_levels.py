"""Moving levels against theory: increments, reflection, occupancy, memory, independence; and that a
flight flies exactly them.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from sysid.model_form.model_form import Parts
from uqharness.errors import BadInputError
from uqharness.flight.fly import record_mission
from uqharness.flight.spec import COEFFICIENTS, FlightSpec, LevelDriver, TransientDriver
from uqharness.flight.stepping import level_blocks, reflect
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


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
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


def test_the_variance_of_a_second_is_the_same_at_any_step():
    found = {}
    for rate_hz in (50, 100, 200):
        path = walks(12, 40 * rate_hz, 1.0 / rate_hz, RATE)[:, ::rate_hz]
        inner = (path[:, :-1] > 0.06) & (path[:, :-1] < 0.94)
        found[rate_hz] = np.diff(path, axis=1)[inner].var()
        assert found[rate_hz] == pytest.approx(RATE**2, rel=4.0 * np.sqrt(2.0 / inner.sum()))
    # Scaled the wrong way round (eq 3.38 with periods read as rates) they would differ by factors
    # of 4.
    assert max(found.values()) / min(found.values()) < 1.15


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
def test_occupancy_is_uniform_from_the_first_step_to_the_last(rate_hz):
    # Fast enough to hit the mirrors many times: stationary all along, because the first level is
    # uniform.
    path = walks(100, 4 * rate_hz, 1.0 / rate_hz, 0.5)
    assert path.min() >= 0.0
    assert path.max() <= 1.0
    for column in (0, rate_hz, 4 * rate_hz - 1):
        assert stats.kstest(path[:, column], "uniform").pvalue > 1e-3, column
    # An end that absorbs or repels would show here: the outermost hundredths hold a hundredth each.
    outer = np.mean((path < 0.01) | (path > 0.99))
    assert outer == pytest.approx(0.02, abs=0.006)


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
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


def test_reflection_by_hand():
    free = np.array([0.3, 1.2, -0.2, 2.3, -1.4, 1.0, 0.0])
    assert reflect(free) == pytest.approx([0.3, 0.8, 0.2, 0.3, 0.6, 1.0, 0.0])


def test_white_levels_are_uniform_and_without_memory():
    path = levels(LevelDriver("white", 3, "white-000000", COEFFICIENTS), 30_000, 0.01)
    for column in path.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
        assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 4.0 / np.sqrt(column.size)


def test_the_six_are_independent_and_belong_to_sample_and_coefficient():
    steps = np.diff(levels(WALK, 20_000, 0.01), axis=0)
    correlation = np.corrcoef(steps.T) - np.eye(6)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(20_000)
    again = levels(WALK, 500, 0.01)
    assert np.array_equal(again, levels(WALK, 20_000, 0.01)[:500])
    for other in (replace(WALK, epistemic_id="walk-000001"), replace(WALK, root_seed=8)):
        assert not np.any(levels(other, 500, 0.01) == again)
    # A coefficient's walk does not depend on which others move.
    alone = levels(replace(WALK, coefficients=("Cm",), rates_per_sqrt_s=(RATE,)), 500, 0.01)
    assert np.array_equal(alone[:, 4], again[:, 4])
    assert np.all(alone[:, [0, 1, 2, 3, 5]] == 0.5)


@pytest.mark.parametrize("driver", [WALK, LevelDriver("white", 7, "white-000000", COEFFICIENTS)])
def test_blocks_move_no_bit(driver):
    whole = levels(driver, 1000, 0.01, block_steps=1000)
    for size in (1, 7, 999):
        assert np.array_equal(levels(driver, 1000, 0.01, block_steps=size), whole)


def test_impossible_drivers_are_refused():
    with pytest.raises(ValueError, match="white or walk"):
        levels(replace(WALK, kind="sine"), 1, 0.01)
    with pytest.raises(ValueError, match="walk rate -1"):
        levels(replace(WALK, rates_per_sqrt_s=(-1.0,) * 6), 1, 0.01)
    with pytest.raises(ValueError, match="positive"):
        levels(WALK, 1, 0.0)


@pytest.fixture(scope="module", params=[50, 100, 200])
def recorded(request, tmp_path_factory):
    """A flight under a fast walk, recorded every step, at a step other than the card's
    where asked.
    """
    rate_hz = request.param
    folder = tmp_path_factory.mktemp("aircraft") / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", folder)
    card = folder / "airframe.toml"
    card.write_text(card.read_text().replace("dt_s = 0.01", f"dt_s = {1 / rate_hz}"))
    driver = LevelDriver("walk", 7, "walk-000003", ("CX", "CZ", "Cm"), (0.2, 0.2, 0.2))
    spec = FlightSpec(
        folder,
        Path("loiter"),
        duration_s=4.0,
        turbulence="light",
        levels=driver,
        record_rate_hz=float(rate_hz),
        properties={
            "uq/active": 1.0,
            "uq/CY/active": 0.0,
            "uq/Cl/active": 0.0,
            "uq/Cn/active": 0.0,
        },
    )
    signals = {name: Source(f"uq/{name}/level") for name in COEFFICIENTS}
    signals |= {f"{name}_delta": Source(f"uq/{name}/delta") for name in COEFFICIENTS}
    with StagedMission(find_aircraft(folder), find_script("loiter")) as mission:
        return rate_hz, driver, record_mission(mission, spec, signals).signals


def test_a_flight_flies_the_walk_at_its_own_step(recorded):
    rate_hz, driver, signals = recorded
    wanted = levels(driver, 4 * rate_hz, 1.0 / rate_hz)
    width = {"CX": 0.016, "CZ": 0.1, "Cm": 0.024}
    for column, name in enumerate(COEFFICIENTS):
        if name not in driver.coefficients:
            assert np.all(signals[f"{name}_delta"] == 0.0)
            continue
        # Row 0 is the start, which has seen the first level; row k what step k flew.
        assert signals[name][0] == wanted[0, column]
        assert np.array_equal(signals[name][1:], wanted[:, column])
        # What the aerodynamics add follows in the same step.
        assert signals[f"{name}_delta"] == pytest.approx(
            (signals[name] - 0.5) * width[name], abs=1e-15
        )


def test_a_walk_moves_the_flight_and_air_stays_common():
    spec = FlightSpec(
        Path("espaaro"),
        Path("loiter"),
        duration_s=5.0,
        turbulence="light",
        seed_turbulence=3,
        properties={"uq/active": 1.0},
        levels=replace(WALK, rates_per_sqrt_s=(0.3,) * 6),
    )
    from uqharness.flight.fly import fly

    one, again = fly(spec), fly(spec)
    other = fly(replace(spec, levels=replace(spec.levels, epistemic_id="walk-000001")))
    white = fly(replace(spec, levels=LevelDriver("white", 7, "white-000000", COEFFICIENTS)))
    still = fly(replace(spec, levels=None))
    tracks = [run.signals["cross_track"] for run in (one, other, white, still)]
    assert np.array_equal(tracks[0], again.signals["cross_track"])
    assert all(not np.array_equal(a, b) for a, b in pairwise(tracks))


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
    flown = PARTS.transient_half_width * path[:, ::rate_hz]
    assert flown.std() == pytest.approx(PARTS.transient, rel=4.0 * np.sqrt(0.2 / flown.size))

    def memory(path, lag_s):
        """Correlation of the slowest mode, sin(pi level/2), after that time, with its standard
        error.
        """
        mode = np.sin(0.5 * np.pi * path)
        product = 2.0 * mode[:, 0] * mode[:, round(lag_s * rate_hz)]
        return product.mean(), product.std() / np.sqrt(product.size)

    for lag_s in (0.5 * tau, tau, 2.0 * tau):
        found, error = memory(path, lag_s)
        assert found == pytest.approx(np.exp(-lag_s / tau), abs=4.0 * error)
    # A walk of half the rate remembers four times as long, and that is seen.
    found, error = memory(transient(200, 0.5 * PARTS.transient_rate_per_sqrt_s, 3, rate_hz), tau)
    assert abs(found - np.exp(-1.0)) > 8.0 * error
    assert found == pytest.approx(np.exp(-0.25), abs=4.0 * error)


def test_a_transient_walk_belongs_to_air_and_coefficient_and_to_no_other_stream():
    driver = TransientDriver(7, 3, COEFFICIENTS, (RATE,) * 6)
    path = levels(driver, 500, 0.01)
    for other in (replace(driver, aleatory_id=4), replace(driver, root_seed=8)):
        assert not np.any(levels(other, 500, 0.01) == path)
    assert not np.any(2.0 * levels(WALK, 500, 0.01) - 1.0 == path)
    alone = levels(replace(driver, coefficients=("Cm",), rates_per_sqrt_s=(RATE,)), 500, 0.01)
    assert np.array_equal(alone[:, 4], path[:, 4])
    assert not alone[:, [0, 1, 2, 3, 5]].any()
    for size in (1, 7, 499):
        assert np.array_equal(levels(driver, 500, 0.01, block_steps=size), path)


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
    wanted = levels(TRANSIENT, 200, 0.01)
    still = levels(moved, 200, 0.01) if moved is not None else np.full((200, 6), 0.5)
    for column, name in enumerate(COEFFICIENTS):
        assert np.array_equal(signals[f"{name}_transient-level"][1:], wanted[:, column])
        assert signals[f"{name}_transient-level"][0] == wanted[0, column]
        assert np.array_equal(signals[f"{name}_level"][1:], still[:, column])
    assert signals["CX_delta"][1:] == pytest.approx(
        (still[:, 0] - 0.5) * 0.016 + 0.003 * wanted[:, 0], abs=1e-15
    )
    assert signals["Cm_delta"][1:] == pytest.approx((still[:, 4] - 0.5) * 0.024, abs=1e-15)


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
