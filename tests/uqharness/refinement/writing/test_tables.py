"""A smooth term in an aircraft's XML: its curve in JSBSim and in the batch engine, held beyond the
data, said to be no physics.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.effects.smooth import SmoothFit, smooth_term
from tests.helpers.batch_whole import beyond, copied, spec
from uqharness.refinement.write_xml import property_of_table, write_table
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

FOUND = {
    "alpha": np.linspace(-0.05, 0.15, 400),
    "q_hat": np.linspace(-0.004, 0.006, 400),
    "de": np.linspace(-5.0, 4.0, 400),
    "V_rel": np.linspace(0.8, 1.3, 400),
}


def smooth(state, times=None, size=0.02, coefficient="Cm"):
    """A term with a bend in the middle of its range."""
    term = smooth_term(coefficient, state, times, FOUND)
    k = term.turn.shape[1]
    at = np.linspace(*term.ends, 200)
    middle, wide = np.mean(term.ends), np.ptp(term.ends) / 6.0
    values = np.linalg.lstsq(
        term.at(at), size * np.exp(-(((at - middle) / wide) ** 2)), rcond=None
    )[0]
    return SmoothFit(
        term, values, np.zeros((k, k)), np.ones(k, dtype=bool), 5.0, 1.0, 1.0, 0.0, np.zeros(k), 1.0
    )


def write_files(tmp_path, fit):
    aircraft = find_aircraft(copied(tmp_path))
    write_table(aircraft, fit)
    return aircraft


def at_state(aircraft, alpha, q=0.0, elevator=0.0):
    """JSBSim at an angle of attack and pitch rate, controls moved, forces computed."""
    fdm = open_aircraft(aircraft)
    V = 72.0
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"], fdm["ic/w-fps"], fdm["ic/q-rad_sec"] = (
        400.0,
        V * np.cos(alpha),
        V * np.sin(alpha),
        q,
    )
    fdm["fcs/elevator-cmd-deg"] = elevator
    engine.run_ic(fdm)
    return fdm


@pytest.mark.parametrize("alpha", [-0.3, -0.05, -0.013, 0.05, 0.0801, 0.15, 0.3])
def test_jsbsim_has_the_curve_and_its_moment(tmp_path, alpha):
    fit = smooth("alpha")
    aircraft = write_files(tmp_path, fit)
    fdm, plain = at_state(aircraft, alpha), at_state(find_aircraft("espaaro"), alpha)
    # Held beyond the ends; a table's straight lines miss the curve by 1e-4 of its height.
    expected = float(fit.curve(np.array([alpha]))[0][0])
    assert fdm["uq/unnamed/Cm_of_alpha"] == pytest.approx(expected, abs=2e-5)
    per = fdm["aero/qbar-psf"] * fdm["metrics/Sw-sqft"] * fdm["metrics/cbarw-ft"]
    added = (fdm["moments/m-aero-lbsft"] - plain["moments/m-aero-lbsft"]) / per
    assert added == pytest.approx(fdm["uq/unnamed/Cm_of_alpha"], rel=1e-4, abs=1e-9)


def test_a_state_that_no_property_holds_and_a_second_that_multiplies(tmp_path):
    fit = smooth("V_rel", "de")
    fdm = at_state(write_files(tmp_path, fit), 0.02, elevator=3.0)
    assert property_of_table(fit.term) == "uq/unnamed/Cm_of_V_rel_times_de"
    V, de = fdm["velocities/vt-fps"] * 0.3048 / 22.2, fdm["fcs/elevator-pos-deg"]
    assert de == pytest.approx(3.0)
    assert fdm["uq/unnamed/Cm_of_V_rel_times_de"] == pytest.approx(
        de * float(fit.curve(np.array([V]))[0][0]), abs=6e-5
    )
    assert abs(fdm["uq/unnamed/Cm_of_V_rel_times_de"]) > 0.01


def test_nobody_takes_it_for_physics(tmp_path):
    aircraft = write_files(tmp_path, smooth("alpha"))
    text = aircraft.xml.read_text(encoding="utf-8")
    remark = "No physics: a smooth term of angle of attack in pitching moment"
    assert remark in text
    assert "Held constant outside -0.05 to 0.15" in text
    assert "aero/Cm_of" not in text


def test_the_batch_engine_flies_the_same_table(tmp_path):
    folder = write_files(tmp_path, smooth("alpha", size=0.01)).folder
    assert max(beyond(spec(folder, duration_s=2.0)).values()) < 1.0
    plain = spec(duration_s=2.0)
    assert max(beyond(spec(folder, duration_s=2.0), changed=plain).values()) > 1.0
