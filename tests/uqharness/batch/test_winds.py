"""Wind, gusts and JSBSim's turbulence, frame by frame."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from tests.helpers.batch_flights import (
    METRICS,
    START,
    aircraft,
    by_batch,
    by_jsbsim,
    compared,
    craft,
    refused,
    worst,
)
from tests.helpers.few import few
from uqharness.batch import winds
from uqharness.batch.ir import Builder, evaluate

TYPE, SEVERITY = "atmosphere/turb-type", "atmosphere/turbulence/milspec/severity"


W20 = "atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"


WIND = tuple(f"atmosphere/wind-{axis}-fps" for axis in winds.AXES)


RECORDS = (
    *winds.OUTPUTS,
    *(f"atmosphere/total-wind-{axis}-fps" for axis in winds.AXES),
    "atmosphere/psiw-rad",
    "velocities/vt-fps",
    "velocities/p-aero-rad_sec",
    "aero/alpha-rad",
)


FRAMES = 120


def air(wind=(10.0, -5.0, 1.0), severity=4.0, w20=25.0):
    """Turbulence that is switched on in frame 5, off in 60 and on again in 80; severity 0 for a
    while; other winds at the end.

    There is no wind while JSBSim initialises: it takes that of its initial conditions.
    """
    frames = np.arange(FRAMES + 1)
    on = ((frames >= 5) & (frames < 60)) | (frames >= 80)
    out = {
        TYPE: np.where(on, 4.0, 0.0),
        SEVERITY: np.where((frames > 30) & (frames < 40), 0.0, severity),
        W20: np.full(FRAMES + 1, w20),
    }
    out |= {
        name: np.where(frames < 100, np.where(frames > 0, speed, 0.0), -2.0 * speed)
        for name, speed in zip(WIND, wind, strict=True)
    }
    out["atmosphere/gust-east-fps"] = np.where(frames > 50, 4.0, 0.0)
    return out


def start(height_ft=600.0, seed=5):
    return {**START, "ic/h-sl-ft": height_ft, "atmosphere/randomseed": float(seed), TYPE: 0.0}


def differences(height_ft=600.0, inputs=None, text=None, changed=None, seed=5):
    text = aircraft("<aerodynamics/>") if text is None else text
    return compared(
        text, RECORDS, inputs or air(), FRAMES, start(height_ft, seed), changed=changed, floor=0.01
    )


@pytest.mark.parametrize(
    "height_ft",
    [
        5.0,
        1500.0,
        *(
            pytest.param(h, marks=pytest.mark.slow)
            for h in (20000.0, 600.0, 999.9, 1000.1, 2000.1, 3000.0, 78000.0, 90000.0)
        ),
    ],
)
def test_turbulence_at_heights(height_ft):
    assert worst(differences(height_ft)) < 5e-10


@pytest.mark.parametrize(
    "severity", [7, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 7))]
)
def test_severities(severity):
    assert worst(differences(5000.0, air(severity=float(severity)))) < 5e-10


@pytest.mark.parametrize(
    "wind",
    [
        pytest.param((0.0, 0.0, 0.0), marks=pytest.mark.slow),
        pytest.param((0.0, 12.0, 0.0), marks=pytest.mark.slow),
        pytest.param((-8.0, 0.0, 0.0), marks=pytest.mark.slow),
        (-3.0, 4.0, -2.0),
    ],
)
def test_the_winds_azimuth_turns_the_turbulence(wind):
    """A wind without a northern part leaves JSBSim's azimuth as it was."""
    assert worst(differences(inputs=air(wind))) < 5e-10


RATES = """<aerodynamics><axis name='Z'><function name='f/z'><product><p>aero/alpha-rad</p><v>-30</v></product>
</function></axis><axis name='PITCH'><function name='f/m'><product><p>aero/alphadot-rad_sec</p><v>-4</v>
</product></function></axis><axis name='ROLL'><function name='f/l'><product>
<p>aero/betadot-rad_sec</p><v>-4</v></product></function></axis></aerodynamics>"""


def test_rates_of_alpha_and_beta_in_gusts_are_those_of_the_frame_before():
    """JSBSim's accelerations without the air's, with velocities relative to the air."""
    records = [*(f"velocities/{a}-aero-fps" for a in "uvw"), "velocities/q-aero-rad_sec"]
    records += [f"accelerations/{a}dot-ft_sec2" for a in "uvw"]
    records += ["aero/alphadot-rad_sec", "aero/betadot-rad_sec"]
    text = aircraft(RATES)
    assert worst(compared(text, records, air(), FRAMES, start(), floor=0.01)) < 5e-10
    changed = text.replace("<v>-4</v>", "<v>-4.00001</v>", 1)
    gaps = compared(text, records, air(), FRAMES, start(), changed=changed, floor=0.01)
    assert gaps["aero/alphadot-rad_sec"] > 1e-8
    with craft(text, start()) as output:
        fdm = output.open()
        series = by_jsbsim(fdm, air(), records, FRAMES)
    u, _, w = (series[f"velocities/{a}-aero-fps"][20:50] for a in "uvw")
    udot, wdot = (series[f"accelerations/{a}dot-ft_sec2"] for a in "uw")
    alphadot = series["aero/alphadot-rad_sec"][20:50]
    late, present = (
        (u * wdot[rows] - w * udot[rows]) / (u**2 + w**2) for rows in (slice(19, 49), slice(20, 50))
    )
    np.testing.assert_allclose(alphadot, late, rtol=1e-12, atol=1e-15)
    assert np.abs(alphadot - present).max() > 0.01 * np.abs(alphadot).max()


def test_terms_a_little_off_are_noticed(monkeypatch):
    changed = aircraft(
        "<aerodynamics/>", METRICS.replace(">10</wingspan>", ">10.000001</wingspan>")
    )
    assert worst(differences(changed=changed)) > 1e-9
    sigma = tuple(tuple(s * (1.0 + 1e-8) for s in row) for row in winds._SIGMA)
    monkeypatch.setattr(winds, "_SIGMA", sigma)
    assert worst(differences(5000.0)) > 1e-9


def test_unknown_types_of_turbulence():
    """They are refused where they stand from the start; set in flight they are not a number, which
    ends the flight.
    """
    inputs = air()
    inputs[TYPE] = np.where(inputs[TYPE] == 4.0, 3.0, 0.0)
    with craft(aircraft("<aerodynamics/>"), start()) as output:
        result = by_batch(output, inputs, RECORDS, FRAMES)
        assert np.isfinite(result["velocities/vt-fps"][4])
        assert np.isnan(result["velocities/vt-fps"][6])
    for events in (
        f"<property value='3'>{TYPE}</property>",
        f"<property value='4'>{TYPE}</property>",
    ):
        assert TYPE in refused(
            aircraft("<aerodynamics/>"), f"{events}<property value='3'>{SEVERITY}</property>"
        )


@pytest.mark.parametrize("psi", few([0.7, 3.0, 6.0], 1))
def test_azimuth_and_size_may_be_written(psi):
    """JSBSim turns or stretches the steady wind."""
    events = "".join(
        f"<event><condition>simulation/sim-time-sec ge {at}</condition><set name='{name}'"
        f" value='{value}'/></event>"
        for at, name, value in (
            (0.02, "atmosphere/wind-mag-fps", 20.0),
            (0.05, "atmosphere/psiw-rad", psi),
            (0.08, "atmosphere/wind-mag-fps", 7.0),
            (0.1, "atmosphere/wind-north-fps", -4.0),
            (0.12, "atmosphere/psiw-rad", 1.0),
        )
    )
    names = (*WIND, "atmosphere/psiw-rad", "velocities/vt-fps")
    assert (
        worst(compared(aircraft("<aerodynamics/>"), names, frames=20, start=start(), events=events))
        < 1e-11
    )


def test_the_filters_cotangent():
    """Against mpmath, beyond a turn too; relative to 1 where it goes through 0."""
    angles = np.concatenate([np.geomspace(1e-9, 1.5, 60), np.linspace(1.5, 30.0, 200)])
    b = Builder()
    above, below = winds._cotangent(b.input("x"))
    function = b.finish({"r": above / below})
    result = evaluate(function, {"x": angles})[0]["r"]
    exact = np.array([float(mp.cot(mp.mpf(x))) for x in angles.tolist()])
    # A change of the angle by its rounding is the smallest that can be asked for.
    allowed = 2e-15 * np.maximum(1.0, np.abs(exact)) + np.spacing(angles) * (1.0 + exact**2) * (
        angles > 1.0
    )
    assert (np.abs(result - exact) <= allowed).all()
    steady = (angles < 1.0) & (angles > 1e-8)
    assert (np.abs(result * (1.0 + 1e-13) - exact) > allowed)[steady].all()


def test_type_and_severity_are_cut_to_whole_numbers():
    gains = "".join(
        f"<pure_gain name='{name}'><input>i/{source}</input><gain>1</gain></pure_gain>"
        for name, source in ((TYPE, "t"), (SEVERITY, "s"))
    )
    text = aircraft(
        "<system name='s'><property>i/t</property><property>i/s</property>"
        f"<channel name='c'>{gains}</channel></system><aerodynamics/>"
    )
    inputs = {name: values for name, values in air().items() if name not in (TYPE, SEVERITY)}
    inputs |= {
        "i/t": np.repeat([0.0, 4.9, 0.5, -0.5], 40)[: FRAMES + 1],
        "i/s": np.repeat([0.0, 3.7, 0.9, 2.0], 33)[: FRAMES + 1],
    }
    result = compared(text, (*RECORDS, TYPE, SEVERITY), inputs, FRAMES, start(5000.0), floor=0.01)
    assert worst(result) < 5e-10
