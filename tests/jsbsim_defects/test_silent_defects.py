"""More behaviours of JSBSim 1.3.3 that say nothing; see test_defects.py and
docs/jsbsim-traps.md.
"""

from __future__ import annotations

import math

import jsbsim
import numpy as np
import pytest

from tests.jsbsim_defects.small_models import small

STILL = "<axis name='X'><function name='aero/f'>{}</function></axis>"


def test_an_unknown_operation_inside_a_sum_is_dropped_and_the_rest_flies_on(tmp_path):
    invalid = (
        "<sum> <value>1</value> <prodct> <value>2</value> <value>3</value> </prodct>"
        " <value>10</value> </sum>"
    )
    right = invalid.replace("prodct", "product")
    for text, value in ((invalid, 11.0), (right, 17.0)):
        fdm = small(tmp_path, aero=STILL.format(text))
        fdm.run_ic()
        fdm.run()
        assert fdm["aero/f"] == value


def running(throttle: float) -> jsbsim.FGFDMExec:
    """JSBSim's C172 with its engine started, initialised."""
    fdm = jsbsim.FGFDMExec(jsbsim.get_default_root_dir())
    fdm.set_debug_level(0)
    fdm.set_dt(0.01)
    assert fdm.load_model("c172p")
    fdm["ic/h-sl-ft"], fdm["ic/vt-fps"] = 2000.0, 180.0
    fdm["propulsion/set-running"] = -1
    fdm["fcs/throttle-cmd-norm"], fdm["fcs/mixture-cmd-norm"] = throttle, 0.9
    fdm.run_ic()
    return fdm


def test_the_first_frames_of_an_engine_do_not_know_the_throttle():
    thrust = {}
    for steady in (False, True):
        for throttle in (0.2, 0.9):
            fdm = running(throttle)
            if steady:
                fdm.get_propulsion().get_steady_state()
            fdm.run()
            thrust[steady, throttle] = fdm["propulsion/engine/thrust-lbs"]
    assert abs(thrust[False, 0.9] - thrust[False, 0.2]) < 1.0
    assert thrust[True, 0.9] > thrust[True, 0.2] + 400.0


def test_starting_an_engine_opens_its_mixture_and_gives_its_thrust_at_full_throttle():
    fdm = running(0.2)
    fdm.get_propulsion().get_steady_state()
    fdm.run()
    idle = fdm["propulsion/engine/thrust-lbs"]
    fdm["propulsion/set-running"] = -1
    assert fdm["fcs/mixture-cmd-norm"] == 1.0
    fdm.run()
    assert fdm["fcs/throttle-pos-norm"] == fdm["fcs/throttle-cmd-norm"] == 0.2
    assert fdm["propulsion/engine/thrust-lbs"] > idle + 400.0


@pytest.mark.parametrize(
    ("integrator", "gain", "tolerance"), [(None, 1.042, 0.002), (3.0, 1.0, 0.004)]
)
def test_the_default_integrator_adds_roll_damping(tmp_path, integrator, gain, tolerance):
    # L = -8 Ixx p: p falls as exp(-8 t). Euler's rule takes 1 - 0.08 a step, which is exp(-8.34 t).
    slug_ft2 = 6.0 / 1.3558179483314
    roll = f"<axis name='ROLL'><function name='aero/L'><product><value>{-8.0 * slug_ft2}</value>"
    roll += "<property>velocities/p-rad_sec</property></product></function></axis>"
    fdm = small(tmp_path, aero=roll)
    fdm["ic/p-rad_sec"] = 0.5
    if integrator is not None:
        for kind in ("rate/rotational", "position/rotational"):
            fdm[f"simulation/integrator/{kind}"] = integrator
    fdm.run_ic()
    for _ in range(5):
        fdm.run()
    begin = fdm["velocities/p-rad_sec"]
    for _ in range(20):
        fdm.run()
    rate = math.log(begin / fdm["velocities/p-rad_sec"]) / 0.2
    assert abs(rate / 8.0 - gain) < tolerance


def test_the_rates_scale_is_of_the_frame_before_in_a_function_outside_an_axis(tmp_path):
    scale = (
        "<product><property>aero/bi2vel</property><property>velocities/vt-fps</property></product>"
    )
    outside, inside = (
        f"<function name='aero/{name}'>{scale}</function>" for name in ("outside", "inside")
    )
    force = f"<axis name='X'><function name='aero/f'><value>20</value></function>{inside}</axis>"
    fdm = small(tmp_path, aero=outside + force)
    fdm.run_ic()
    fdm.run()
    half_span = 0.5 * fdm["metrics/bw-ft"]
    for _ in range(5):
        before = fdm["velocities/vt-fps"]
        fdm.run()
        ratio = fdm["velocities/vt-fps"] / before
        assert ratio > 1.0 + 1e-5
        assert fdm["aero/inside"] == pytest.approx(half_span, rel=1e-12)
        assert fdm["aero/outside"] == pytest.approx(half_span * ratio, rel=1e-9)


def test_flight_control_reads_the_airspeed_of_the_frame_before_and_the_attitude_of_this(tmp_path):
    copy = "".join(
        f"<pure_gain name='copy/{name}'><input>{source}</input><gain>1</gain></pure_gain>"
        for name, source in (
            ("V", "velocities/vt-fps"),
            ("phi", "attitude/phi-rad"),
            ("p", "velocities/p-rad_sec"),
        )
    )
    force = "<axis name='X'><function name='aero/f'><value>20</value></function></axis>"
    turn = "<axis name='ROLL'><function name='aero/L'><value>3</value></function></axis>"
    fdm = small(tmp_path, fcs=f"<channel name='c'>{copy}</channel>", aero=force + turn)
    fdm["ic/p-rad_sec"] = 0.3
    fdm.run_ic()
    fdm.run()
    for _ in range(5):
        before = fdm["velocities/vt-fps"]
        fdm.run()
        assert fdm["copy/V"] == before != fdm["velocities/vt-fps"]
        assert fdm["copy/phi"] == fdm["attitude/phi-rad"]
        assert fdm["copy/p"] == fdm["velocities/p-rad_sec"]


def flown_through(tmp_path, component):
    """What a component makes of a command of 0.5 in its first frame, and of 1.0 two seconds
    later.
    """
    fcs = f"<channel name='c'>{component}</channel>"
    fdm = small(tmp_path, fcs="<property value='0.5'>s/in</property>" + fcs)
    fdm["s/in"] = 0.5
    fdm.run_ic()
    first = fdm["fcs/out"]
    fdm["s/in"] = 1.0
    for _ in range(200):
        fdm.run()
    return first, fdm["fcs/out"]


def test_an_actuator_with_a_lag_of_zero_stands_still(tmp_path):
    actuator = "<actuator name='fcs/out'><input>s/in</input>{}</actuator>"
    assert flown_through(tmp_path, actuator.format("<lag>0.0</lag>")) == (0.5, 0.5)
    assert flown_through(tmp_path, actuator.format("")) == (0.5, 1.0)


def test_a_filter_begins_at_zero_and_not_at_its_input(tmp_path):
    first, delayed = flown_through(
        tmp_path, "<lag_filter name='fcs/out'><input>s/in</input><c1>10</c1></lag_filter>"
    )
    assert first < 0.1
    assert delayed == pytest.approx(1.0, abs=1e-6)


def test_the_rate_of_alpha_contains_the_mean_wind():
    """With a tail wind u, aero/alphadot-rad_sec exceeds the rate of alpha by q u/V."""
    for wind_fps in (0.0, 40.0):
        fdm = running(0.5)
        fdm["atmosphere/wind-north-fps"] = wind_fps
        alpha, alphadot, q = [], [], []
        for k in range(400):
            fdm["fcs/elevator-cmd-norm"] = 0.2 * math.sin(0.06 * k)
            fdm.run()
            alpha.append(fdm["aero/alpha-rad"])
            alphadot.append(fdm["aero/alphadot-rad_sec"])
            q.append(fdm["velocities/q-rad_sec"])
        excess = (np.array(alphadot) - np.gradient(alpha, 0.01))[10:-10]
        pitch_rate = np.array(q)[10:-10]
        slope = excess @ pitch_rate / (pitch_rate @ pitch_rate)
        assert slope == pytest.approx(wind_fps / fdm["velocities/vt-fps"], abs=0.05)
