"""The two aircraft whose lift separates, flown by JSBSim and by independent equations; what belongs
to whom in their files.
"""

from __future__ import annotations

import difflib
import functools
import subprocess
import sys

import numpy as np
import pytest

from tests.helpers import against_equations as against
from tests.helpers import stall_model
from tests.helpers.few import few
from tests.helpers.stall_model import Separation, StallingAirframe
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.forced_state import BodyState, body_velocity, force_state
from uqharness.simulator.trim import SteadyCondition, find_trim

pytestmark = pytest.mark.slow

DT, HEIGHT = 0.001, 400.0
SPEED = {"synthetic_stall": 21.0, "espaaro_truth": 22.2}
MODELS = {"synthetic_stall": stall_model.synthetic, "espaaro_truth": stall_model.truth}
# control, then (time, deflection from trim) steps. The pull ends deep in the stall; the push
# reaches negative separation's flank.
MANOEUVRES = {
    "doublet": ("elevator", [(0.5, 4.0), (1.0, -4.0), (1.5, 0.0)]),
    "stall": ("elevator", [(0.5, -14.0), (1.6, 6.0), (2.2, 0.0)]),
    "roll": ("aileron", [(0.5, 8.0), (1.5, -8.0), (2.5, 0.0)]),
    "yaw": ("rudder", [(0.5, 8.0), (1.0, -8.0), (1.5, 0.0)]),
}
DURATION = 4.0
STEADY = ("synthetic_stall", "espaaro_truth")


@functools.cache
def trim_of(name: str):
    return find_trim(find_aircraft(name), SteadyCondition(SPEED[name], altitude_m=HEIGHT))


@functools.cache
def fly(name: str, manoeuvre: str, changes: tuple[tuple[str, float], ...] = ()):
    """States and surface positions of a manoeuvre from the nominal trim."""
    control, steps = MANOEUVRES[manoeuvre]
    return against.fly(
        name, trim_of(name), SPEED[name], HEIGHT, DURATION, DT, control, steps, changes
    )


@functools.cache
def reference(name: str, manoeuvre: str):
    return against.integrate(MODELS[name](), *fly(name, manoeuvre), DT, stall_model.derivative)


def excess(states, expected) -> float:
    """Of the state that is farthest off."""
    return float(np.max(list(against.excess(states, expected).values())))


@pytest.mark.parametrize("name", STEADY)
@pytest.mark.parametrize("manoeuvre", few(MANOEUVRES, 2))
def test_flight_agrees_to_one_percent(name, manoeuvre):
    assert excess(fly(name, manoeuvre)[0], reference(name, manoeuvre)) < 1.0


SEEN = [
    ("stall", {"aero/stall": 0.0}),
    ("stall", {"aero/stall_tau2": 0.0}),
    ("stall", {"aero/stall_a1_per_deg": 0.4}),
    ("stall", {"aero/stall_alpha1_deg": 11.5}),
]
SEEN_SYNTHETIC = [
    ("stall", {"aero/oswald_e": 0.7}),
    ("doublet", {"aero/CT_dt": 80.0}),
    ("doublet", {"aero/CL_de": 0.0004}),
    ("doublet", {"aero/Cm_q": 0.0}),
    ("doublet", {"aero/CD_0": 0.105}),
    ("doublet", {"aero/CL_0": 0.37}),
    ("doublet", {"aero/CL_alpha": 3.0}),
    ("roll", {"aero/Cn_da": 0.00006}),
    ("roll", {"aero/Cl_r": 0.04}),
    ("roll", {"aero/Cn_p": 0.023}),
    ("roll", {"aero/CY_p": 0.033}),
    ("yaw", {"aero/Cl_dr": -0.0002}),
    ("yaw", {"aero/CY_r": 0.1}),
]
SEEN_TRUTH = [
    ("stall", {"aero/CX_q": 0.0}),
    ("roll", {"aero/Cm_p2": 0.0}),
    ("doublet", {"aero/Cl_de": 0.0}),
]


@pytest.mark.parametrize(
    ("name", "manoeuvre", "changes"),
    [(name, *case) for name in STEADY for case in SEEN]
    + [("synthetic_stall", *case) for case in SEEN_SYNTHETIC]
    + [("espaaro_truth", *case) for case in SEEN_TRUTH],
)
def test_a_wrong_number_is_seen(name, manoeuvre, changes):
    assert excess(fly(name, manoeuvre, tuple(changes.items()))[0], reference(name, manoeuvre)) > 1.0


@pytest.mark.parametrize("second", [1.0, -1.0])
@pytest.mark.parametrize("alpha", [-24.0, -20.0, -5.0, 3.0, 11.0, 16.0])
def test_separation_point_at_a_forced_state(alpha, second):
    # Falling out of balance, the aircraft has an alphadot at once, which the lag must take with its
    # sign.
    u, _, w = body_velocity(21.0, np.radians(alpha), 0.0)
    names = (
        "aero/stall_X",
        "aero/stall_lift_factor",
        "aero/alpha_lag-deg",
        "aero/alphadot-rad_sec",
    )
    _, out = force_state(
        find_aircraft("synthetic_stall"),
        BodyState(u, 0.0, w, 0.0, np.radians(alpha), 0.0),
        {"elevator": 0.0, "aileron": 0.0, "rudder": 0.0, "throttle": 60.0},
        HEIGHT,
        {"aero/stall_second_lag": second, "aero/stall_tau2": 0.7},
        names,
    )
    X, share, lag, alphadot = (out[name] for name in names)
    assert abs(lag) > 0.01
    assert lag == pytest.approx(0.7 * 0.53 / 21.0 * np.degrees(alphadot), rel=1e-6)
    model = Separation(second=second)
    assert pytest.approx(model.attached(alpha, lag), rel=1e-6) == X
    assert share == pytest.approx(model.lift_share(alpha, lag), rel=1e-6)


def test_the_print_differs_from_our_reading_at_the_negative_stall_alone():
    ours, printed = Separation(), Separation(second=-1.0)
    assert ours.attached(8.0, 2.0) == pytest.approx(printed.attached(8.0, 2.0), abs=1e-9)
    assert abs(ours.attached(-19.0, -2.0) - printed.attached(-19.0, -2.0)) > 0.3


def test_simplified_models_by_property():
    # SL and the fully attached true model are the same thing.
    flight = fly("synthetic_stall", "doublet", (("aero/stall", 0.0),))
    model = StallingAirframe(coefficients=stall_model.TABLE_2_4, separation=Separation(on=False))
    single = against.integrate(model, *flight, DT, stall_model.derivative)
    assert excess(flight[0], single) < 1.0


def test_the_truth_is_the_espaaro_and_four_effects():
    folder = PROJECT_ROOT / "aircraft"
    ours = (folder / "espaaro/espaaro.xml").read_text().splitlines()
    truth = (folder / "espaaro_truth/espaaro_truth.xml").read_text().splitlines()
    absent = [line[2:].strip() for line in difflib.ndiff(ours, truth) if line.startswith("- ")]
    names = (
        "espaaro",
        "E-SPAARO",
        "CZ_alpha</property> <property>aero/alpha-rad",
        "aero/Cl_de</property>",
    )
    assert len(absent) == 5
    assert all(any(name in line for name in names) for line in absent), absent


@pytest.mark.parametrize("name", STEADY)
def test_flies_with_jsbsim_alone(name):
    program = (
        "import jsbsim, sys; f = jsbsim.FGFDMExec(sys.argv[1]); f.set_debug_level(0);"
        " f.set_dt(0.01);assert f.load_model(sys.argv[2]); f.load_ic('cruise', True); f.run_ic();"
        " [f.run() for _ in range(100)];assert 15 < f['velocities/vt-fps'] * 0.3048 < 30"
    )
    subprocess.run(
        [sys.executable, "-c", program, str(PROJECT_ROOT), name],
        check=True,
        capture_output=True,
        timeout=60,
    )
