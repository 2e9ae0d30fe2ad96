"""Published check cases of the equations of motion: NASA/TM-2015-218675 (NESC-RP-12-00770),
atmospheric cases 1, 2 and 3.

Figures are those of simulation 4 of the trajectories that NASA publishes with the memorandum
(Atmos_0?_sim_04.csv); its simulations agree with each other to some 1e-3 ft here."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_flights
from tests.helpers.batch_flights import aircraft, craft, started, translated
from tests.helpers.batch_whole import SECOND_ORDER
from uqharness.batch.llvm import choose_target
from uqharness.batch.llvm_flight import compile_program
from uqharness.batch.motion import CONDITIONS
from uqharness.batch.program import initial_state

DT_S = 0.002


SPIN_DPS = np.degrees(7.292115e-5)


METRICS = """<metrics><wingarea unit="FT2">.22222</wingarea><wingspan unit="FT">.333333333333</wingspan>
<chord unit="FT">.666666666667</chord><location name="AERORP" unit="IN"><x>0</x><y>0</y><z>0</z></location></metrics>"""


MASS = """<mass_balance><ixx unit="SLUG*FT2">0.001894220</ixx><iyy unit="SLUG*FT2">0.006211019</iyy>
<izz unit="SLUG*FT2">0.007194665</izz><emptywt unit="LBS">5</emptywt>
<location name="CG" unit="IN"><x>0</x><y>0</y><z>0</z></location></mass_balance>"""


DAMPED = "".join(
    f"<axis name='{axis}'><function"
    f" name='d/{axis}'><product><p>aero/qbar-area</p><p>metrics/{length}-ft</p><p>aero/{per}2vel</p>"
    f"<p>velocities/{rate}i-rad_sec</p><v>-1</v></product></function></axis>"
    for axis, rate, length, per in (
        ("ROLL", "p", "bw", "bi"),
        ("PITCH", "q", "cbarw", "ci"),
        ("YAW", "r", "bw", "bi"),
    )
)


RECORDS = (
    *(f"position/eci-{a}-ft" for a in "xyz"),
    *(f"velocities/eci-{a}-fps" for a in "xyz"),
    "position/geod-alt-ft",
    "accelerations/gravity-ft_sec2",
    "atmosphere/a-fps",
    "atmosphere/rho-slugs_ft3",
    "atmosphere/P-psf",
    "atmosphere/T-R",
    "velocities/mach",
    "aero/qbar-psf",
    *(f"attitude/{a}-deg" for a in ("psi", "theta", "phi")),
    *(f"velocities/{a}i-rad_sec" for a in "pqr"),
)


FALL = {
    4.0: """20955389.4721 6112.41434265 0 -128.427189457 1528.09109878 0 29744.0381225
    32.107321562166184 995.948229041 8.99093239555e-4 637.022387702 412.749064833
    .128502126358 7.3632389122""",
    30.0: """20941195.0742 45832.753467 0 -963.637539981 1527.05530171 0 15598.9043522
    32.15078136923117 1054.92920439 .00146718319468 1166.29230627 463.083387288
    .910293656577 676.494097515""",
}
"""Time [s] to the falling body's RECORDS, the same in all three cases."""
TUMBLE = {
    "sphere": {30.0: "0 0 -.125399679189 0 0 0"},
    "brick": {
        4.0: "150.274178232 18.2316762214 53.2136920977 -12.9910509864 16.9407267622 31.296258194",
        30.0: "-4.28935504226 -3.81965492189 -56.1513075938 12.6183907757 -17.3974747619 31.1195888866",
    },
    "damped brick": {
        3.8: "124.201490106 18.174782783 46.5499252816 -5.05357077698 8.45732206068 24.4009182585",
        30.0: "-111.383858577 -38.7889055337 -5.09406213522 0 0 1.75598203807e-05",
    },
}
"""Yaw, pitch and roll [deg], then inertial body rates [deg/s]."""


ALLOWED = (3e-4, 1e-5, 1e-9, 1e-6, 1e-6, 1e-9, 3e-4, 1e-8, 2e-3, 1e-8, 1e-2, 1e-6, 2e-6, 6e-3)


"""JSBSim's standard day has 2116.228 psf at sea level, the memorandum's 2116.217."""


def simulate(monkeypatch, case):
    """Records every 0.1 s (rows, RECORDS) of 30 s."""
    monkeypatch.setattr(batch_flights, "DT_S", DT_S)
    rates = (0.0, 0.0, 0.0) if case == "sphere" else (10.0, 20.0, 30.0)
    relative = np.radians([rates[0] - SPIN_DPS, *rates[1:]])
    body = f"<aerodynamics>{DAMPED if case == 'damped brick' else ''}</aerodynamics>"
    mass = (
        MASS.replace("0.006211019", "0.001894220").replace("0.007194665", "0.001894220")
        if case == "sphere"
        else MASS
    )
    start = {
        "ic/lat-geod-rad": 0.0,
        "ic/long-gc-rad": 0.0,
        "ic/h-sl-ft": 30000.0,
        **{f"ic/{a}-fps": 0.0 for a in "uvw"},
        **{f"ic/{a}-rad_sec": float(r) for a, r in zip("pqr", relative, strict=True)},
        **SECOND_ORDER,
    }
    with craft(aircraft(body, METRICS, mass), start) as result:
        fdm = result.open()
        flight = translated(result, RECORDS)
        values = started(flight, {name: float(fdm[name]) for name in CONDITIONS})
    flyer = compile_program(flight.frame, choose_target())
    state = initial_state(
        flyer.program,
        1,
        {name: value for name, value in values.items() if name in flyer.program.slots},
    )
    return flyer.fly(state, 1, round(30.0 / DT_S), None, round(0.1 / DT_S))[:, 0].T


def figures(text):
    return np.array(text.split(), dtype=float)


def misses(result, case):
    """By how much more than allowed a figure is missed, the worst."""
    out = []
    for time_s, expected in FALL.items():
        out += [
            abs(a - b) / c
            for a, b, c in zip(
                result[round(time_s * 10) - 1, :14], figures(expected), ALLOWED, strict=True
            )
        ]
    for time_s, text in TUMBLE[case].items():
        expected = figures(text)
        row = result[round(time_s * 10) - 1, 14:]
        angles = (row[:3] - expected[:3] + 180.0) % 360.0 - 180.0
        out += [*np.abs(angles) / 1.5e-3, *np.abs(np.degrees(row[3:]) - expected[3:]) / 1e-4]
    return max(out)


@pytest.mark.parametrize("case", TUMBLE)
def test_nasa_check_cases_have_the_published_figures(monkeypatch, case):
    assert misses(simulate(monkeypatch, case), case) < 1.0
