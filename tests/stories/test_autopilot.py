"""Sensors and autopilot in flight: truth and noise, capture, steady offset, wind and turbulence,
margins.
"""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.few import few
from uqharness.flight.margins import CALM_STRAIGHT, LOOPS, measure_loop
from uqharness.simulator.aircraft import PROJECT_ROOT

CALM = {"sensor/noise": 0.0, "air/wind-mps": 0.0, "air/turbulence-w20-kt": 0.0}
TRACK = ("nav/cross-track-m", "nav/altitude-error-m", "nav/speed-error-mps")
ATTITUDE = ("attitude/phi-deg", "aero/alpha-deg")


def fly(fdm, seconds, names, every=10):
    """Run, and return the named properties every so many steps as rows."""
    nodes = [fdm.get_property_manager().get_node(name).get_double_value for name in names]
    rows = []
    for step in range(round(seconds * 100)):
        fdm.run()
        if step % every == 0:
            rows.append([node() for node in nodes])
    return np.array(rows)


def start(fdm):
    fdm.run_ic()
    return fdm


@pytest.fixture
def mission(load_mission):
    return lambda properties=None, script="loiter": start(load_mission(properties, script))


# --- sensors

CURRENT = {  # what the control system sees of the frame it runs in
    "sensor/V-mps": ("nav/V-mps", 1.0, 0.5),
    "sensor/altitude-m": ("nav/altitude-m", 1.0, 1.33),
    "sensor/p-rad_sec": ("velocities/p-rad_sec", 1.0, math.radians(0.2)),
    "sensor/q-rad_sec": ("velocities/q-rad_sec", 1.0, math.radians(0.2)),
    "sensor/r-rad_sec": ("velocities/r-rad_sec", 1.0, math.radians(0.2)),
    "sensor/phi-rad": ("attitude/phi-rad", 1.0, math.radians(0.5)),
    "sensor/theta-rad": ("attitude/theta-rad", 1.0, math.radians(0.5)),
    "sensor/psi-rad": ("attitude/psi-rad", 1.0, math.radians(0.5)),
    "sensor/north-m": ("nav/north-m", 1.0, 0.5),
    "sensor/east-m": ("nav/east-m", 1.0, 0.5),
    "sensor/vn-mps": ("velocities/v-north-fps", 0.3048, 0.15),
    "sensor/ve-mps": ("velocities/v-east-fps", 0.3048, 0.15),
    "sensor/vd-mps": ("velocities/v-down-fps", 0.3048, 0.15),
}
STEP_OLD = {  # computed after the control system has run
    "sensor/ax-mps2": ("accelerations/a-pilot-x-ft_sec2", 0.3048, 0.16),
    "sensor/ay-mps2": ("accelerations/a-pilot-y-ft_sec2", 0.3048, 0.16),
    "sensor/az-mps2": ("accelerations/a-pilot-z-ft_sec2", 0.3048, 0.16),
    "sensor/alpha-rad": ("aero/alpha-rad", 1.0, math.radians(0.1)),
    "sensor/beta-rad": ("aero/beta-rad", 1.0, math.radians(0.1)),
}
SENSORS = {**CURRENT, **STEP_OLD}
SENSOR_NAMES = tuple(SENSORS)
TRUTH_NAMES = tuple(truth for truth, _, _ in SENSORS.values())


def sensor_record(fdm, seconds):
    """Sensors and scaled truth at the frames in which the sensors run (every second one)."""
    rows = fly(fdm, seconds, SENSOR_NAMES + TRUTH_NAMES, every=1)
    measured, truth = rows[:, : len(SENSORS)], rows[:, len(SENSORS) :].copy()
    truth *= [scale for _, scale, _ in SENSORS.values()]
    truth[1:, len(CURRENT) :] = truth[:-1, len(CURRENT) :]
    return measured[3::2], truth[3::2], measured[2::2]


def test_without_noise_the_sensors_are_the_truth_held_for_two_frames(mission):
    measured, truth, constant = sensor_record(mission({"sensor/noise": 0, "sensor/log": 1}), 20.0)
    assert np.array_equal(measured, truth)
    assert np.array_equal(constant[1:], measured[:-1][: len(constant) - 1])


def test_noise_has_the_size_of_table_2_1_and_is_white(mission):
    measured, truth, _ = sensor_record(mission({"sensor/log": 1}), 120.0)
    error = measured - truth
    expected = np.array([sd for _, _, sd in SENSORS.values()])
    n = len(error)
    assert error.std(axis=0) / expected == pytest.approx(1.0, abs=4 / math.sqrt(2 * n))
    assert np.abs(error.mean(axis=0) / expected).max() < 4 / math.sqrt(n)
    unit = error / expected
    lagged = (unit[1:] * unit[:-1]).mean(axis=0)
    between = np.corrcoef(unit.T) - np.eye(len(expected))
    assert np.abs(lagged).max() < 4.5 / math.sqrt(n)
    assert np.abs(between).max() < 4.5 / math.sqrt(n)


def ecef(latitude, longitude, height):
    """WGS 84, independent of JSBSim."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    n = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    return np.stack(
        [
            (n + height) * np.cos(latitude) * np.cos(longitude),
            (n + height) * np.cos(latitude) * np.sin(longitude),
            (n * (1 - e2) + height) * np.sin(latitude),
        ],
        axis=-1,
    )


@pytest.mark.parametrize("heading_deg", [30.0, 235.0])
def test_position_agrees_with_geodesy_to_a_centimetre_at_one_kilometre(load_mission, heading_deg):
    fdm = start(load_mission({"ic/psi-true-deg": heading_deg}, "trim"))
    where = (
        "position/lat-geod-rad",
        "position/long-gc-rad",
        "position/geod-alt-ft",
        "nav/north-m",
        "nav/east-m",
    )
    rows = fly(fdm, 45.0, where)
    lat0, lon0 = math.radians(45.0), 0.0
    offset = ecef(rows[:, 0], rows[:, 1], rows[:, 2] * 0.3048) - ecef(
        np.array(lat0), np.array(lon0), 0.0
    )
    north = offset @ [
        -math.sin(lat0) * math.cos(lon0),
        -math.sin(lat0) * math.sin(lon0),
        math.cos(lat0),
    ]
    east = offset @ [-math.sin(lon0), math.cos(lon0), 0.0]
    # A flat plane keeps the horizontal distance, not the arc; 100 m of height add 1.6 cm per km to
    # both.
    assert math.hypot(rows[-1, 3], rows[-1, 4]) > 950
    assert rows[:, 3] == pytest.approx(north, abs=0.01)
    assert rows[:, 4] == pytest.approx(east, abs=0.01)


# --- steady loiter


def settle(fdm):
    fly(fdm, 90.0, TRACK)
    return fly(fdm, 60.0, (*TRACK, "attitude/phi-deg"))


def test_steady_offset_of_the_loiter_law(mission):
    """No integrator: it settles outside, by the widened radius (EAS2TAS) and the side force of the
    turn.
    """
    track = settle(mission(CALM))
    assert 1.7 < track[:, 0].mean() < 2.4
    assert np.ptp(track[:, 0]) < 0.2
    assert np.abs(track[:, 1]).max() < 0.1
    assert np.abs(track[:, 2]).max() < 0.05


def test_offset_grows_with_the_square_of_the_period(mission):
    widened = 120 * (mission(CALM)["ap/EAS2TAS"] ** 2 - 1)
    assert widened == pytest.approx(1.17, abs=0.02)
    of_the_law = [
        settle(mission({**CALM, "ap/NAVL1_PERIOD": period}))[:, 0].mean() - widened
        for period in (17.0, 30.0)
    ]
    assert of_the_law[1] / of_the_law[0] == pytest.approx((30 / 17) ** 2, rel=0.05)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("centre_m", [(0, 0), (-120, 0), (400, 0)], ids=str)
@pytest.mark.parametrize("heading_deg", few(range(0, 360, 45), 2))
def test_capture_from_any_heading(load_mission, heading_deg, centre_m, direction):
    """Inside, on and outside the circle, towards it, along it and away from it, in the right and in
    the wrong sense.
    """
    north, east = centre_m
    fdm = load_mission(
        {
            "air/wind-mps": 0,
            "air/turbulence-w20-kt": 0,
            "ic/psi-true-deg": heading_deg,
            "ap/loiter-direction": direction,
            "ap/loiter-center-north-m": north,
            "ap/loiter-center-east-m": east,
        }
    )
    start(fdm)
    capture = fly(fdm, 45.0, (*TRACK, *ATTITUDE))
    track = fly(fdm, 15.0, (*TRACK, "ap/L1-clockwise-mps"))
    assert np.abs(track[:, 0] - 2.3).max() < 2.0
    assert np.all(track[:, 3] * direction > 15)
    assert np.abs(capture[:, 1]).max() < 5.0
    assert np.abs(capture[:, 2]).max() < 2.0
    assert np.abs(capture[:, 3]).max() < 54
    assert np.abs(capture[:, 4]).max() < 5


def test_holds_the_loiter_in_7_mps_wind_and_severe_turbulence(mission):
    fdm = mission(
        {
            "air/wind-mps": 7,
            "air/turbulence-w20-kt": 45,
            "simulation/randomseed": 5,
            "atmosphere/randomseed": 6,
        }
    )
    fly(fdm, 120.0, TRACK)
    rows = np.abs(fly(fdm, 120.0, (*TRACK, *ATTITUDE)))
    assert np.isfinite(rows).all()
    # The definition of a lost aircraft is 80 deg of bank, 25 deg of incidence, 60 m of height: far
    # from all three.
    assert rows[:, 3].max() < 65
    assert rows[:, 4].max() < 15
    assert rows[:, 1].max() < 35
    assert rows[:, 0].max() < 35
    assert np.median(rows[:, 0]) < 5
    assert np.median(rows[:, 1]) < 5
    assert np.median(rows[:, 2]) < 1.5


# --- engagement, delay, limits


def test_engages_without_a_bump(load_mission):
    fdm = start(load_mission(CALM_STRAIGHT, "trim"))
    # On the circle that the controller flies, which is wider than the one commanded.
    fdm["ap/loiter-center-east-m"] = CALM_STRAIGHT["ap/WP_LOITER_RAD"] * fdm["ap/EAS2TAS"] ** 2
    names = (
        "fcs/elevator-pos-deg",
        "fcs/aileron-pos-deg",
        "fcs/rudder-pos-deg",
        "fcs/throttle-pos-pct",
        "attitude/theta-deg",
    )
    before = fly(fdm, 5.0, names, every=1)[-1]
    fdm["ap/engaged"] = 1
    after = fly(fdm, 1.0, names, every=1)
    assert np.abs(after - before).max(axis=0) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("engaged_first", [False, True])
def test_state_is_sensible_when_engaged_before_initialising(load_mission, engaged_first):
    fdm = load_mission({**CALM, "ap/engaged": float(engaged_first)})
    start(fdm)
    fdm["ap/engaged"] = 1
    rows = fly(
        fdm, 20.0, ("ap/V-est-mps", "ap/altitude-est-m", *TRACK, "fcs/throttle-pos-pct"), every=1
    )
    assert np.abs(rows[:, 0] - 22.2 - rows[:, 4]).max() < 0.1
    assert np.abs(rows[:, 1] - 100 - rows[:, 3]).max() < 0.1
    assert np.abs(rows[:, 3]).max() < 1.0
    assert np.abs(rows[20:, 5] - 60).max() < 10


def test_commands_are_one_controller_period_old_and_held(mission):
    names = ("ap/elevator-dem-deg", "ap/elevator-out-deg", "ap/elevator-cmd-deg")
    demanded, out, command = fly(mission(), 5.0, names, every=1).T
    assert np.array_equal(out[103::2], demanded[101:-2:2])
    assert np.array_equal(out[103:-1:2], out[104::2])
    assert np.array_equal(out, command)


def test_injection_is_added_behind_the_output(mission):
    fdm = mission(CALM)
    units = {"elevator": "deg", "aileron": "deg", "rudder": "deg", "throttle": "pct"}
    for index, (surface, unit) in enumerate(units.items()):
        fdm[f"ap/inject-{surface}-{unit}"] = 0.1 * (index + 1)
    fly(fdm, 1.0, TRACK)
    for index, (surface, unit) in enumerate(units.items()):
        added = fdm[f"ap/{surface}-cmd-{unit}"] - fdm[f"ap/{surface}-out-{unit}"]
        assert added == pytest.approx(0.1 * (index + 1), abs=1e-12)


@pytest.mark.parametrize("step_m", [60.0, -60.0])
def test_energy_integrators_do_not_wind_up(mission, step_m):
    """A climb and a descent at the rate limits, the latter with the motor idling; overshoot stays
    small.
    """
    fdm = mission({**CALM, "ap/altitude-cmd-m": 100 + step_m})
    rows = fly(fdm, 90.0, (*TRACK, "fcs/throttle-pos-pct"))
    overshoot = max(0.0, (rows[:, 1] * math.copysign(1, step_m)).max())
    assert overshoot < 1.5
    assert np.abs(rows[-100:, 1]).max() < 0.2
    assert np.abs(rows[:, 2]).max() < 2.5
    assert rows[:, 3].min() < 5 if step_m < 0 else rows[:, 3].max() > 80


# --- margins


@pytest.fixture(scope="module")
def margins(load_mission):
    return {name: measure_loop(load_mission, LOOPS[name]) for name in ("elevator", "aileron")}


def test_every_loop_has_margins(margins):
    for name, measured in margins.items():
        got = measured.margins
        assert got.gain_up_dB > 12, name
        assert got.gain_down_dB > 12, name
        assert got.phase_deg > 45, name
        assert got.delay_s > 0.1, name
        assert np.median(measured.scatter) < 0.03, name
    assert margins["elevator"].margins.gain_up_dB == pytest.approx(18.6, abs=0.5)
    assert margins["elevator"].margins.phase_deg == pytest.approx(53, abs=2)
    assert margins["aileron"].margins.gain_up_dB == pytest.approx(20.3, abs=0.1)


@pytest.mark.parametrize(
    ("loop", "gains"),
    [
        ("elevator", ("PTCH_RATE_P", "PTCH_RATE_I", "PTCH_RATE_FF")),
        ("aileron", ("RLL_RATE_P", "RLL_RATE_I", "RLL_RATE_FF")),
    ],
)
def test_the_aircraft_goes_unstable_at_the_measured_gain_margin(load_mission, margins, loop, gains):
    """Flown, not computed: all gains of one surface 8 % below the margin die out, 8 % above
    grow.
    """

    def growth(factor):
        fdm = load_mission(CALM_STRAIGHT)
        start(fdm)
        fly(fdm, 30.0, TRACK)
        for gain in gains:
            fdm[f"ap/{gain}"] = fdm[f"ap/{gain}"] * factor
        integral = f"ap/{'pitch' if loop == 'elevator' else 'roll'}-integral-rad"
        fdm[f"ap/inject-{loop}-deg"] = 0.02
        fly(fdm, 0.1, TRACK)
        fdm[f"ap/inject-{loop}-deg"] = 0.0
        rate = f"velocities/{'q' if loop == 'elevator' else 'p'}-rad_sec"
        early = np.ptp(fly(fdm, 1.0, (rate, integral), every=1)[:, 0])
        fly(fdm, 2.0, TRACK)
        return np.ptp(fly(fdm, 1.0, (rate,), every=1)) / early

    limit = 10 ** (margins[loop].margins.gain_up_dB / 20)
    assert growth(0.92 * limit) < 1.0
    assert growth(1.08 * limit) > 1.0


# --- scripts in plain JSBSim


@pytest.mark.parametrize(
    "script", few(sorted(path.name for path in (PROJECT_ROOT / "scripts").glob("*.xml")), 2)
)
def test_script_flies_in_the_jsbsim_console(script, tmp_path):
    console = Path(sys.executable).with_name("jsbsim")
    done = subprocess.run(
        [
            console,
            "--root=.",
            f"--script=scripts/{script}",
            "--simulation-rate=100",
            "--end=3",
            "--nohighlight",
            f"--outputpath={tmp_path}",
        ],
        cwd=PROJECT_ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "JSBSim Execution beginning" in done.stdout


@pytest.mark.parametrize(
    ("script", "name", "low", "high"),
    [
        ("doublet-elevator", "aero/alpha-deg", -0.45, 2.9),
        ("doublet-aileron", "attitude/phi-deg", -1.0, 20.2),
        ("3-2-1-1", "aero/alpha-deg", -0.3, 2.7),
    ],
)
def test_open_loop_manoeuvres_reach_their_size(mission, script, name, low, high):
    rows = fly(mission({"sensor/noise": 0}, script), 20.0, (name, *TRACK))
    assert rows[:, 0].min() == pytest.approx(low, abs=0.7)
    assert rows[:, 0].max() == pytest.approx(high, abs=0.7)
    assert np.abs(rows[:, 2]).max() < 6
    assert np.abs(rows[:, 3]).max() < 2
