"""Engines of others' aircraft at the start of a steady flight, in both engines."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from tests.helpers import foreign_aircraft
from uqharness.batch import course
from uqharness.flight.fly import fly
from uqharness.flight.spec import FlightSpec
from uqharness.plugin.apply import instrument_aircraft
from uqharness.plugin.instrument import Bounds
from uqharness.simulator import find_aircraft, write_steady_start
from uqharness.simulator.own_mission import StartSection

ALIKE = 1e-7
"""JSBSim settles engines to 1e-9."""
SIGNALS = ("V_mps", "height_m", "phi_rad", "alpha_rad", "load_factor")


@pytest.fixture(scope="module")
def fly_both(tmp_path_factory):
    parent = tmp_path_factory.mktemp("starts")
    copies = {}

    def differences(style, edits=(), duration_s=1.5):
        """Return the largest difference of each signal over its largest size."""
        if style not in copies:
            folder = foreign_aircraft.write(style, parent)
            copies[style] = parent / "aircraft" / style
            instrument_aircraft(find_aircraft(folder), Bounds(), copies[style], check=False)
            start = StartSection(V_mps=foreign_aircraft.SPEEDS_MPS[style], altitude_m=200.0)
            write_steady_start(
                find_aircraft(copies[style]), start, parent / f"{style}.xml", "campaign.toml"
            )
        folder = copies[style]
        for k, (name, old, new) in enumerate(edits):
            if k == 0:
                folder = parent / f"edited-{len(list(parent.iterdir()))}" / style
                shutil.copytree(copies[style], folder)
            text = (folder / name).read_text()
            assert old in text
            (folder / name).unlink()
            (folder / name).write_text(text.replace(old, new))
        # Without an air system the wind comes after the engines are started.
        spec = FlightSpec(folder, parent / f"{style}.xml", duration_s, wind_mps=3.0)
        theirs, (ours,) = fly(spec), course.fly_many([spec])
        assert theirs.status == "ok"
        if ours.status != "ok":
            return {"status": np.inf}, theirs
        return {
            name: float(np.abs(ours.signals[name] - theirs.signals[name]).max())
            / max(float(np.abs(theirs.signals[name]).max()), 1e-3)
            for name in SIGNALS
        }, theirs

    return differences


@pytest.mark.parametrize(
    "style", ["single", *(pytest.param(s, marks=pytest.mark.slow) for s in ("wing", "twin"))]
)
def test_a_propeller_out_of_balance_is_brought_there_by_frames(fly_both, style, monkeypatch):
    gaps, _ = fly_both(style)
    assert max(gaps.values()) < ALIKE, gaps
    if style == "single":
        monkeypatch.setattr(course, "power_is_balanced", lambda *_: np.array([True]))
        gaps, _ = fly_both(style)
        assert gaps["V_mps"] > 1e-5


SWITCHBOARD = "Systems/switchboard.xml"
LATE = "<test value='{}'> simulation/sim-time-sec gt 0.5 </test>"


def test_magnetos_are_what_a_system_commands(fly_both):
    on = '<test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>'
    one = (SWITCHBOARD, on, LATE.format(1) + "<test value='3'> electrics/live == 1 </test>")
    spark = ("Engines/flat_four.xml", "<maxhp>", "<sparkfaildrop>0.2</sparkfaildrop><maxhp>")
    both_on, _ = fly_both("single", [spark])
    gaps, one_on = fly_both("single", [one, spark])
    assert max(gaps.values()) < ALIKE, gaps
    gaps, off = fly_both("single", [(SWITCHBOARD, on, on + LATE.format(0).replace("gt", "ge"))])
    # A switch takes the first test that holds, so that the second one does nothing.
    assert max(both_on.values()) < ALIKE
    assert max(gaps.values()) < ALIKE
    assert one_on.signals["V_mps"][-1] < off.signals["V_mps"][-1] - 1e-3


def test_a_starter_acts_on_an_engine_that_does_not_run(fly_both):
    starter = (SWITCHBOARD, "/controls/engines/engine[0]/starter == 1", "electrics/live == 1")
    gaps, _ = fly_both("single", [starter])
    assert max(gaps.values()) < ALIKE, gaps
    on = '<test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>'
    stopped = (SWITCHBOARD, on, LATE.format(0) + "<test value='3'> electrics/live == 1 </test>")
    assert fly_both("single", [starter, stopped])[0]["status"] == np.inf
    assert max(fly_both("single", [stopped])[0].values()) < ALIKE


@pytest.mark.slow
def test_turbines_are_cut_off_as_a_system_commands(fly_both):
    gaps, running = fly_both("jet")
    assert max(gaps.values()) < ALIKE, gaps
    open_ = '<test value="1"> /controls/engines/engine[0]/cutoff eq 1 </test>'
    cut = ("Systems/hydraulics.xml", open_, LATE.format(1))
    # The elevator keeps its hydraulics: the electric pump is on.
    gaps, off = fly_both("jet", [cut])
    assert max(gaps.values()) < ALIKE, gaps
    assert off.signals["V_mps"][-1] < running.signals["V_mps"][-1] - 0.1
