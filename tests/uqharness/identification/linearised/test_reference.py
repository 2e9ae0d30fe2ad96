"""Slopes of forces by properties: as the model flies, loads settled, not as one frame after the
change has them.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.aerodynamics import rigid_slopes
from sysid.aerodynamics.rigid_body import STATES
from sysid.parallel import SERIAL
from uqharness.cli.main import main
from uqharness.identification.linearised.linearise import (
    SLOPE_ROWS,
    Probe,
    ProbeJob,
    analytic_terms,
    probe_all,
    with_mean_loads,
    with_property_slopes,
)
from uqharness.replay import (
    CONTROLS,
    ReplayFolder,
    Segment,
    SegmentStates,
    force_all,
    property_slopes,
)
from uqharness.simulator import find_aircraft

NAMES = ("uq/scale/CLalpha", "uq/scale/CDi", "uq/scale/Cmadot", "uq/scale/Cmq")


@pytest.fixture(scope="module")
def glider(tmp_path_factory):
    """The stock glider, whose pitching moment goes with the rate of alpha and whose drag goes with
    the lift.
    """
    out = tmp_path_factory.mktemp("stock") / "sgs126"
    assert main(["instrument", "sgs126", "--out", str(out), "--no-check"]) == 0
    return find_aircraft(out)


def test_a_slope_has_what_lift_does_to_the_rate_of_alpha_and_to_induced_drag(glider):
    x = np.array([[27.0, 0.05, 0.02, 0.1, 0.2, -0.05, 0.1, 0.0], [25.0, 0.1, 0, 0, 0.1, 0, 0, 0.1]])
    controls, height = np.zeros((2, len(CONTROLS))), np.full(2, 200.0)
    segment = Segment("test", "test", np.array([0.0, 0.02]), controls, np.zeros(9), 200.0, 200.0)
    values = dict.fromkeys(NAMES, 1.0)
    motion = dict(zip(STATES, x.T, strict=True))
    with ReplayFolder(glider, ideal=CONTROLS) as level:
        assert level.by_rates
        parts = [SegmentStates(segment, motion, controls, height)]
        (of_part,) = property_slopes(level, parts, values, NAMES)
        slopes = {name: of_part[:, k] for k, name in enumerate(NAMES)}

        def load(name: str, value: float) -> np.ndarray:
            # Forces at a state are read after rates of alpha and beta have settled there.
            request = [SegmentStates(segment, motion, controls, height)]
            forced = force_all(level, request, {**values, name: value})[0]
            return np.hstack([forced.aero_force, forced.aero_moment])

        for name in NAMES:
            expected = (load(name, 1.001) - load(name, 0.999)) / 0.002
            size = np.abs(expected).max(axis=0) + 1e-3 * np.abs(expected).max()
            assert np.all(np.abs(slopes[name] - expected) < 0.01 * size), name
    # The moment of the change of lift by way of the rate of alpha: none without Cmadot.
    assert abs(slopes["uq/scale/CLalpha"][0, 4]) > 100.0


def test_a_term_is_recognised_at_an_airspeed_that_is_not_the_reference_s():
    """Predicted states jump in gusts; a term that is taken for none is asked of JSBSim each time."""
    espaaro, n = find_aircraft("espaaro"), 40
    x = np.tile([22.0, 0.05, 0.01, 0.1, 0.2, -0.1, 0.0, 0.05], (n, 1))
    controls, height = np.full((n, len(CONTROLS)), 0.05), np.full(n, 200.0)
    segment = Segment("test", "test", 0.02 * np.arange(n), controls, np.zeros(9), 200.0, 200.0)
    names = [name for name in espaaro.card.parameters if name.startswith("aero/")]
    with ReplayFolder(espaaro, ideal=CONTROLS) as level:
        fdm = level.open(espaaro.dt_s)
        values = {name: float(fdm[name]) for name in names}
        (probe,) = probe_all([ProbeJob(level, segment, x, controls, values, False, height)])
        faster = replace(probe, x=x * [1.05, *[1.0] * 7])
        assert analytic_terms(level, segment, faster, names, values) == names
        # A scale of lift is no such term.
        assert not analytic_terms(level, segment, faster, ["uq/scale/CZ"], values)


def test_what_a_property_does_is_that_at_states_that_jump_from_row_to_row(glider):
    """As a filter predicts them; JSBSim is asked at every fourth row only."""
    rng, n = np.random.default_rng(2), 400
    at, scatter = [27.0, 0.05, 0.0, 0, 0, 0, 0, 0], [0.5, 0.02, 0.02, 0.1, 0.1, 0.1, 0, 0]
    x = at + rng.standard_normal((n, 8)) * scatter
    controls, height = np.zeros((n, len(CONTROLS))), np.full(n, 200.0)
    segment = Segment("test", "test", 0.02 * np.arange(n), controls, np.zeros(9), 200.0, 200.0)
    names = ("uq/scale/Clb", "uq/scale/Clp", "uq/scale/CYb", "uq/scale/CDi")
    values, none = dict.fromkeys(names, 1.0), np.zeros((n, 6))
    reference = SimpleNamespace(x=np.tile(at, (n, 1)), qbar=np.full(n, 400.0), by_flow=None)
    mass = SimpleNamespace(S=10.0, lengths=np.array([10.0, 1.0, 10.0]))
    one = none[:, 0]
    probe = Probe(reference, mass, none, none, none, none, controls, one, height, x, x, x, x[:, :2])  # type: ignore[arg-type]
    with ReplayFolder(glider, ideal=CONTROLS) as level:
        (probe,), _ = with_property_slopes(
            level, [segment], [probe], names, values, analytic=(), pool=SERIAL
        )
        rows = np.arange(2, n, 9 * SLOPE_ROWS)
        motion = {name: x[rows, k] for k, name in enumerate(STATES)}
        parts = [SegmentStates(segment, motion, controls[rows], height[rows])]
        (slopes,) = property_slopes(level, parts, values, names)
        exact = {name: slopes[:, k] for k, name in enumerate(names)}
    faster = (x[rows, :1] / 27.0) ** 2
    for name in names:
        expected = exact[name] / probe.scale[rows] / faster
        size = np.sqrt(np.mean(expected**2, axis=0)).max()
        assert np.abs(probe.by_property[name][rows] - expected).max() < 0.03 * size, name


def test_lift_and_rotating_air_change_a_moment_by_alphadot_once(glider):
    """A column moves the linear system as the model's own loads do, and air that rotates changes no
    rate of alpha.
    """
    n = 40
    body = np.tile([27.0, 0.05, 0.0, 0.0, 0.2, 0.0, 0.0, 0.05], (n, 1))
    relative = body - [*[0.0] * 4, 0.15, *[0.0] * 3]
    controls, height = np.zeros((n, len(CONTROLS))), np.full(n, 200.0)
    segment = Segment("test", "test", 0.02 * np.arange(n), controls, np.zeros(9), 200.0, 200.0)
    lift, names = "uq/scale/CLalpha", ("uq/scale/CLalpha", "uq/scale/Cmadot")
    values, states = dict.fromkeys(names, 1.0), SegmentStates
    with ReplayFolder(glider, ideal=CONTROLS) as level:
        (probe,) = probe_all([ProbeJob(level, segment, body, controls, values, False, height)])
        in_still_air, in_rotating_air = (
            with_property_slopes(
                level, [segment], [replace(probe, x=x)], names, values, analytic=(), pool=SERIAL
            )[0][0].by_property
            for x in (body, relative)
        )
        deflected = controls + np.eye(len(CONTROLS))[CONTROLS.index("elevator")]
        (moved,) = probe_all([ProbeJob(level, segment, body, deflected, values, False, height)])
        motion = dict(zip(STATES, body.T, strict=True))
        (loads,) = property_slopes(
            level, [states(segment, motion, controls, height)], values, names
        )
    by_input = rigid_slopes(probe.reference, probe.mass).slopes[:, 3:6, 14:]
    turned = np.einsum("nij,nj->ni", by_input, in_still_air[lift])
    expected = loads[:, 0, 3:] @ np.linalg.inv(probe.mass.inertia).T
    assert np.abs(expected[:, 1]).min() > 0.1
    np.testing.assert_allclose(turned[:, 1], expected[:, 1], rtol=0.01)
    by_elevator = probe.by_control[:, :, CONTROLS.index("elevator")]
    turned = np.einsum("nij,nj->ni", by_input, by_elevator)
    expected = (moved.reference.moment - probe.reference.moment) @ np.linalg.inv(probe.mass.inertia)
    np.testing.assert_allclose(turned[:, 1], expected[:, 1], rtol=0.01)
    moment, still = (c["uq/scale/Cmadot"][:, 4] for c in (in_rotating_air, in_still_air))
    np.testing.assert_allclose(moment, still, rtol=0.02)


def test_the_mean_load_contains_the_curvature_of_the_load():
    """CX is a parabola of alpha: its mean exceeds that at the mean by CX_alpha2 var alpha."""
    espaaro, n, std = find_aircraft("espaaro"), 9, 0.03
    x = np.tile([22.0, 0.05, 0.01, 0.1, 0.2, -0.1, 0.0, 0.05], (n, 1))
    controls, height = np.full((n, len(CONTROLS)), 0.05), np.full(n, 200.0)
    segment = Segment("test", "test", 0.02 * np.arange(n), controls, np.zeros(9), 200.0, 200.0)
    values = {"aero/CX_alpha2": 1.86}
    with ReplayFolder(espaaro, ideal=CONTROLS) as level:
        (probe,) = probe_all([ProbeJob(level, segment, x, controls, values, False, height)])
        data = SimpleNamespace(segments=[segment], properties=lambda point: values)
        along = SimpleNamespace(height=[height], point=None)
        variances = [np.tile([std**2, 0.0], (n, 1))]
        (mean,) = with_mean_loads(
            level,
            data,
            along,
            [probe],
            variances,
            SERIAL,
        )
    change = mean.reference.force - probe.reference.force
    expected = probe.scale[:, 0] * 1.86 * std**2
    np.testing.assert_allclose(change[:, 0], expected, rtol=1e-4)
    np.testing.assert_allclose(change[:, 1:], 0.0, atol=1e-4 * expected.max())
