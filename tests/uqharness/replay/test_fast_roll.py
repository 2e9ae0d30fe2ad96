"""A glider whose roll settles within a row: it meets its own flight, from start states that are
within their noise.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.aerodynamics import Cutoffs
from uqharness.cli.main import main
from uqharness.commands.flights import carded_aircraft
from uqharness.replay.flights import read_flights, segments
from uqharness.replay.model import ReplayFolder
from uqharness.replay.replay import CHANNELS, fly_segment
from uqharness.replay.residuals import flight_residuals, prediction_of

NOISE = np.radians(0.2)
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


def test_its_own_flight_is_at_the_noise_floor(lively, tmp_path, capsys):
    noisy = str(lively.parent / "noisy.csv")
    words = ["compare", str(lively), "--flight", noisy, "--out", str(tmp_path / "c"), "--json"]
    assert main([*words, "--no-figures", "--workers", "1"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["channels"]["p_radps"]["ratio"] < 1.1
    rolling = found["coefficients"]["Cl"]
    assert rolling["rms"] < 1.2 * rolling["noise"]


def test_a_step_is_flown_as_one_that_is_held_from_its_row_on(lively):
    """Replays give a step its own time; half a frame of it would be 20 sigma of p."""
    aircraft = carded_aircraft(str(lively))
    (flight,), measured = read_flights([lively.parent / "clean.csv"], aircraft)
    cut = segments(flight, measured)
    number = next(k for k, s in enumerate(cut) if s.kind == "roll doublet")
    seen = flight.record["p_radps"][flight.pieces[number].rows]
    with ReplayFolder(aircraft, measured=measured) as model:
        flown = fly_segment(model, cut[number], {})[:, P]
    assert seen[0] == pytest.approx(0.0, abs=1e-3)
    assert seen[1] > 0.5
    assert np.abs(flown - seen)[:40].max() < NOISE


def test_a_late_step_at_a_start_waits_as_it_does_within_a_segment(lively):
    aircraft = carded_aircraft(str(lively))
    (flight,), measured = read_flights([lively.parent / "clean.csv"], aircraft)
    piece = next(p for p in flight.pieces if p.label == "roll doublet")
    first = piece.rows.start

    def cut(start: int):
        rows = slice(start, first + 30)
        return segments(replace(flight, pieces=(replace(piece, rows=rows),)), measured)[0]

    longer, shorter = cut(first - 20), cut(first)
    late_s = 0.004
    with ReplayFolder(aircraft, measured=measured) as model:
        through = fly_segment(model, longer, {}, late_s=late_s)[20:]
        begun = fly_segment(model, shorter, {}, through[0, :9], late_s=late_s)
        forgotten = fly_segment(
            model, replace(shorter, before=None), {}, through[0, :9], late_s=late_s
        )
    assert np.abs(begun - through)[:, P].max() < 0.5 * NOISE
    assert np.abs(forgotten - through)[:, P].max() > 10.0 * NOISE


def test_residuals_of_its_own_flight_have_no_trace_of_the_steps(lively):
    aircraft = carded_aircraft(str(lively))
    (flight,), measured = read_flights([lively.parent / "clean.csv"], aircraft)
    with prediction_of(aircraft, measured) as pair:
        plain, mended = (
            flight_residuals(pair, f, (0.0, 0.0, 0.0), Cutoffs()).columns("Cl")
            for f in (replace(flight, half_way=True), flight)
        )
    left, traces = (np.abs(np.concatenate(part)).max() for part in (mended, plain))
    assert left < 0.05 * traces
