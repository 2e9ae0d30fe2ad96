"""Forces at measured states: both engines say the same, and JSBSim answers where they do not."""

from __future__ import annotations

import logging
import shutil

import numpy as np
import pytest

from uqharness import batch
from uqharness.replay import CONTROLS, ReplayFolder, force
from uqharness.replay.force import ForcedModel, SegmentStates, force_all, force_states
from uqharness.replay.segments import Segment
from uqharness.simulator import find_aircraft

N = 40
MOTION = {
    "V_mps": np.linspace(17.0, 27.0, N),
    "alpha_rad": np.linspace(-0.05, 0.15, N),
    "beta_rad": np.linspace(0.1, -0.1, N),
    "phi_rad": np.linspace(-1.0, 1.0, N),
    "theta_rad": np.linspace(0.2, -0.2, N),
    "p_radps": np.linspace(-1.0, 1.0, N),
    "q_radps": np.linspace(0.5, -0.5, N),
    "r_radps": np.linspace(-0.3, 0.3, N),
}
U = np.column_stack(
    [
        np.linspace(-10.0, 10.0, N),
        np.linspace(8.0, -8.0, N),
        np.linspace(-5.0, 5.0, N),
        np.linspace(0.0, 100.0, N),
    ]
)
HEIGHT_M = np.linspace(100.0, 900.0, N)


@pytest.fixture(scope="module")
def straight():
    with ReplayFolder(find_aircraft("espaaro"), ideal=CONTROLS) as model:
        yield model


@pytest.fixture(autouse=True)
def nothing_known():
    force._cached_programs.clear()
    yield
    force._cached_programs.clear()


def of_step(dt_s: float) -> Segment:
    start = np.array(
        [MOTION[c][0] for c in ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad")]
        + [0.0] * 4
    )
    return Segment("f", "f", dt_s * np.arange(N), U, start, 300.0, 0.0)


def said(model, monkeypatch, worth: int, **properties: float) -> ForcedModel:
    monkeypatch.setattr(force, "MIN_BATCH_STATES", worth)
    return force_states(
        model, of_step(0.02), MOTION, U, {f"aero/{k}": v for k, v in properties.items()}, HEIGHT_M
    )


def apart(a: ForcedModel, b: ForcedModel) -> float:
    return float(
        np.abs(a.coefficients / b.coefficients - 1.0).max()
        + np.abs(a.other_force - b.other_force).max()
    )


def test_both_engines_say_the_same(straight, monkeypatch):
    theirs = said(straight, monkeypatch, 10**9, Cm_q=-11.0)
    ours = said(straight, monkeypatch, 1, Cm_q=-11.0)
    assert force._cached_programs[straight.identity].program is not None
    assert 0.0 < apart(ours, theirs) < 1e-8
    assert apart(said(straight, monkeypatch, 1, Cm_q=-11.1), theirs) > 1e-3


def test_segments_are_asked_for_at_their_own_step(straight, monkeypatch):
    steps: list[tuple[float, int]] = []
    real = force.by_batch
    monkeypatch.setattr(
        force,
        "by_batch",
        lambda model, asked, dt_s, *rest: (
            steps.append((dt_s, len(asked.controls))) or real(model, asked, dt_s, *rest)
        ),
    )
    backwards = {c: v[::-1] for c, v in MOTION.items()}
    # Segments of one record have steps that differ by rounding.
    parts = [
        (0.02, MOTION, U),
        (0.01, backwards, U[::-1]),
        (0.02 * (1.0 + 1e-13), backwards, U[::-1]),
    ]
    found = force_all(
        straight,
        [SegmentStates(of_step(dt_s), motion, u, HEIGHT_M) for dt_s, motion, u in parts],
        {},
    )
    assert steps == [(pytest.approx(0.02), 2 * N), (pytest.approx(0.01), N)]
    for one, (dt_s, motion, u) in zip(found, parts, strict=True):
        assert apart(one, force_states(straight, of_step(dt_s), motion, u, {}, HEIGHT_M)) == 0.0


def test_few_states_are_not_worth_a_translation_whatever_was_asked_before(straight, monkeypatch):
    first = said(straight, monkeypatch, N + 1, Cm_q=-11.0)
    assert force._cached_programs[straight.identity].program is None
    ours = said(straight, monkeypatch, N, Cm_q=-11.0)
    assert force._cached_programs[straight.identity].program is not None
    again = said(straight, monkeypatch, N + 1, Cm_q=-11.0)
    assert apart(again, first) == 0.0 < apart(again, ours)


def test_jsbsim_answers_where_the_engines_differ(straight, monkeypatch, caplog):
    theirs = said(straight, monkeypatch, 10**9)
    answer = batch.at_states
    monkeypatch.setattr(batch, "at_states", lambda *given: 1.00001 * answer(*given))
    with caplog.at_level(logging.WARNING, logger="uqharness"):
        ours = said(straight, monkeypatch, 1)
    assert "the batch engine differs" in caplog.text
    assert apart(ours, theirs) == 0.0


def test_jsbsim_answers_without_a_compiler(straight, monkeypatch):
    monkeypatch.setattr(batch, "available", lambda: "llvmlite is not installed")
    assert apart(said(straight, monkeypatch, 1), said(straight, monkeypatch, 10**9)) == 0.0
    assert force._cached_programs[straight.identity].refused


@pytest.fixture
def by_rates(request, tmp_path):
    """The E-SPAARO with forces and a moment by the rates of alpha and beta, so many times those
    that settle.
    """
    folder = tmp_path / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, folder)
    xml = folder / "espaaro.xml"
    text = xml.read_text()
    for axis, rate, size in (
        ("Z", "alphadot", -0.05),
        ("PITCH", "alphadot", -0.2),
        ("Y", "betadot", -0.03),
    ):
        term = (
            "<function"
            f' name="aero/by_rate/{axis}"><product><property>aero/qbar_S</property><value>{size * request.param}</value>'
            f"<property>aero/{rate}-rad_sec</property></product></function>"
        )
        text = text.replace(f'<axis name="{axis}">', f'<axis name="{axis}">{term}')
    xml.write_text(text)
    with ReplayFolder(find_aircraft(folder), ideal=CONTROLS) as model:
        yield model


def sizes_apart(a: ForcedModel, b: ForcedModel) -> float:
    """Largest difference of a coefficient in units of its largest size."""
    return float(
        (np.abs(a.coefficients - b.coefficients) / np.abs(b.coefficients).max(axis=0)).max()
    )


@pytest.mark.parametrize("by_rates", [1.0], indirect=True)
def test_rates_of_the_wind_angles_settle_alike_in_both_engines(by_rates, monkeypatch):
    assert by_rates.by_rates
    theirs = said(by_rates, monkeypatch, 10**9, Cm_q=-11.0)
    ours = said(by_rates, monkeypatch, 1, Cm_q=-11.0)
    assert force._cached_programs[by_rates.identity].program is not None
    # JSBSim begins with the rates of the state before, the batch engine anew: both end within a
    # millionth of a rad/s.
    assert 0.0 < sizes_apart(ours, theirs) < 1e-6
    monkeypatch.setattr("uqharness.batch.replay._settle", lambda *_: None)
    assert sizes_apart(said(by_rates, monkeypatch, 1, Cm_q=-11.0), theirs) > 1e-3


@pytest.mark.parametrize("by_rates", [200.0], indirect=True)
def test_a_force_that_outgrows_the_acceleration_is_left_to_jsbsim(by_rates, monkeypatch):
    theirs = said(by_rates, monkeypatch, 10**9)
    assert apart(said(by_rates, monkeypatch, 1), theirs) == 0.0
    assert force._cached_programs[by_rates.identity].refused
