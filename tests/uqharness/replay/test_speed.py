"""Step sizes of replays for late sensors and for a fast roll."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.effects.catalogue import coefficient_effect
from sysid.record import FlightRecord, Metadata
from tests.helpers.flown import _columns, _trim
from tests.helpers.sixdof import Airframe, simulate
from tests.hidden_effects.cases import cards
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import NOISE, Flight, fly_and_tell
from uqharness.cli.main import main
from uqharness.commands.flights import carded_aircraft
from uqharness.identification.linearised import delay_by_rows
from uqharness.refinement.write_xml import EffectToWrite, write_effects
from uqharness.replay.flights import prepare, read_flights, segments
from uqharness.replay.model import ReplayFolder
from uqharness.replay.replay import CHANNELS, STATES, at_rows, fly_segment, late_rows
from uqharness.simulator.aircraft import find_aircraft

SURFACES = ("elevator", "aileron", "rudder")
VALUE = -7.5


@pytest.fixture(scope="module")
def aircraft(tmp_path_factory):
    """E-SPAARO with a normal force due to the rate of alpha."""
    target = tmp_path_factory.mktemp("rates") / "espaaro"
    effect = coefficient_effect("CZ", "alphadot_hat")
    write_effects(
        find_aircraft("espaaro"), [EffectToWrite(effect, VALUE, "a remark", {})], {}, target
    )
    return find_aircraft(target)


@pytest.fixture(scope="module")
def record():
    """The same flown without JSBSim and without noise."""
    effect = Effect("CZ", "alphadot_hat", VALUE)
    card = replace(cards("steps", "mixed", 0.0, 0.0, 50.0, positions=True)[0], seconds=18.0)
    return fly_and_tell([Flight(card, Airframe(), (effect,))])[0].record


@pytest.fixture(scope="module")
def rolled():
    """A record of aileron steps without servos, of the independent equations, and its roll rate
    every millisecond.
    """
    x0, u0 = _trim(tuple(sorted(Airframe().coefficients.items())), 22.0, 100.0)
    u = np.repeat(np.asarray(u0)[None, :], 120, axis=0)
    u[20:45, 1], u[45:70, 1] = 14.0, -14.0
    x = simulate(Airframe(), x0, np.repeat(u, 20, axis=0), 0.001)[:-1]
    columns = _columns(x[::20], np.zeros((120, 3)), u, u, 0.02, 0.0)
    return FlightRecord(columns, Metadata(source="", dialect="simulation")), x[:, 3]


def replayed(model, record, **request):
    (segment,) = segments(prepare("f", record, ()), ())
    segment = replace(
        segment, start=np.array([record[c][0] for c in STATES]), altitude_m=100.0, h_m=100.0
    )
    return fly_segment(model, segment, {}, **request)[:, CHANNELS.index("p_radps")]


def test_a_late_gyro_is_a_late_gyro_at_the_kinks_of_a_rate(rolled):
    record, p = rolled
    late, at = 0.0045 / 0.02, np.arange(len(p), dtype=float)
    observed = np.interp(at[::20] - 4.5, at, p)
    with ReplayFolder(find_aircraft("espaaro"), ideal=SURFACES) as model:
        between, rows = replayed(model, record, between=True), replayed(model, record)
    assert len(between) == 4 * (len(observed) - 1) + 1
    np.testing.assert_allclose(at_rows(between, len(observed)), rows, atol=0.5 * NOISE["p_radps"])
    assert np.abs(late_rows(between, len(observed), late) - observed).max() < 2.0 * NOISE["p_radps"]
    # A smooth curve through the rows rings at the steps, and one that is not moved is further off
    # than that.
    assert np.abs(delay_by_rows(rows, late) - observed).max() > 8.0 * NOISE["p_radps"]
    assert np.abs(rows - observed).max() > 16.0 * NOISE["p_radps"]


# A glider whose roll settles within a row: it meets its own flight, from start states that are
# within their noise.

FAST_ROLL_NOISE = np.radians(0.2)
ROLL_PER_S = 45.0
P = CHANNELS.index("p_radps")


def coefficient(name: str, axis: str, length: str, terms: str) -> str:
    return (
        f'<axis name="{axis}"><function'
        f' name="aero/{name}"><product><property>aero/qbar-psf</property>'
        f"<property>metrics/Sw-sqft</property>{length}<sum>{terms}</sum></product></function></axis>"
    )


def term(value: float, *names: str) -> str:
    factors = "".join(f"<property>{name}</property>" for name in names)
    return f"<product><value>{value}</value>{factors}</product>"


def surface(name: str, command: str, position: str) -> str:
    return (
        "<aerosurface_scale"
        f' name="{name}"><input>fcs/{command}-cmd-norm</input><range><min>-0.3</min>'
        f"<max>0.3</max></range><output>fcs/{position}-pos-rad</output></aerosurface_scale>"
    )


def glider_xml() -> str:
    span, chord = (f"<property>metrics/{n}-ft</property>" for n in ("bw", "cbarw"))
    alpha, beta, p, q, r = (
        "aero/alpha-rad",
        "aero/beta-rad",
        "velocities/p-aero-rad_sec",
        "velocities/q-aero-rad_sec",
        "velocities/r-aero-rad_sec",
    )
    elevator, aileron, rudder = (f"fcs/{n}-pos-rad" for n in ("elevator", "left-aileron", "rudder"))
    axes = [
        coefficient("lift", "LIFT", "", "<value>0.35</value>" + term(5.0, alpha)),
        coefficient("drag", "DRAG", "", "<value>0.03</value>" + term(0.5, alpha, alpha)),
        coefficient("side", "SIDE", "", term(-0.4, beta)),
        coefficient(
            "roll",
            "ROLL",
            span,
            term(-0.04, beta) + term(-0.45, "aero/bi2vel", p) + term(0.18, aileron),
        ),
        coefficient(
            "pitch",
            "PITCH",
            chord,
            term(-0.7, alpha) + term(-11.0, "aero/ci2vel", q) + term(-0.9, elevator),
        ),
        coefficient(
            "yaw",
            "YAW",
            span,
            term(0.07, beta) + term(-0.1, "aero/bi2vel", r) + term(-0.06, rudder),
        ),
    ]
    # Roll damping over inertia, at 16 m/s and 200 m, is ROLL_PER_S.
    inertia = 0.45 * 0.25 * 1.2017 * 16.0 * 0.4 * 1.8**2 / ROLL_PER_S
    return f"""<?xml version="1.0"?>
<fdm_config name="lively" version="2.0" release="ALPHA">
 <metrics><wingarea unit="M2">0.4</wingarea><wingspan unit="M">1.8</wingspan><chord unit="M">0.22</chord>
  <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location></metrics>
 <mass_balance negated_crossproduct_inertia="false"><ixx unit="KG*M2">{inertia}</ixx>
  <iyy unit="KG*M2">0.08</iyy><izz unit="KG*M2">0.13</izz><emptywt unit="KG">2.1</emptywt>
  <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location></mass_balance>
 <ground_reactions/>
 <flight_control name="fcs"><channel name="surfaces">
  {surface("elevator", "elevator", "elevator")}{surface("aileron", "aileron", "left-aileron")}
  {surface("rudder", "rudder", "rudder")}</channel></flight_control>
 <aerodynamics>{"".join(axes)}</aerodynamics>
</fdm_config>
"""


@pytest.fixture(scope="module")
def lively(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fast") / "lively"
    folder.mkdir()
    (folder / "lively.xml").write_text(glider_xml(), encoding="utf-8")
    words = ["fly", str(folder), "--mission", "doublets", "--speed-mps", "16"]
    assert main([*words, "--out", str(folder.parent / "clean.csv")]) == 0
    assert main([*words, "--noise", "--out", str(folder.parent / "noisy.csv")]) == 0
    return folder


def test_a_step_is_flown_as_one_that_is_held_from_its_row_on(lively):
    """Replays give a step its own time; half a frame of it would be 20 sigma of p."""
    aircraft = carded_aircraft(str(lively))
    (flight,), measured = read_flights([lively.parent / "clean.csv"], aircraft)
    section = segments(flight, measured)
    number = next(k for k, s in enumerate(section) if s.kind == "roll doublet")
    observed = flight.record["p_radps"][flight.pieces[number].rows]
    with ReplayFolder(aircraft, measured=measured) as model:
        trajectory = fly_segment(model, section[number], {})[:, P]
    assert observed[0] == pytest.approx(0.0, abs=1e-3)
    assert observed[1] > 0.5
    assert np.abs(trajectory - observed)[:40].max() < FAST_ROLL_NOISE
