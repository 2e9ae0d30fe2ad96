"""The exported FMU in FMPy, an importer that others wrote: valid, trimmed, and as the linear model
of the trim predicts.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np
import pytest
from scipy.signal import lsim

import uqharness as uq
from uqharness.simulator import SteadyCondition, find_aircraft, find_trim, linearise

pytest.importorskip("pythonfmu3")
fmpy = pytest.importorskip("fmpy")

SPEED_MPS = 22.2


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fmu")
    uq.export("espaaro", "fmu", out=out, speed_mps=SPEED_MPS, states=20)
    return out / "espaaro.fmu"


def fly(unit: Path, start: dict[str, float] | None = None, step_deg: float = 0.0) -> Any:
    """Return 3 s of flight with a step of the elevator at 1 s."""
    description = fmpy.read_model_description(str(unit))
    inputs = {v.name: float(v.start) for v in description.modelVariables if v.causality == "input"}
    signals = np.zeros(301, dtype=[("time", float), *((name, float) for name in inputs)])
    signals["time"] = 0.01 * np.arange(301)
    for name, value in inputs.items():
        signals[name] = value
    signals["elevator_deg"] += np.where(signals["time"] >= 0.995, step_deg, 0.0)
    return fmpy.simulate_fmu(
        str(unit),
        stop_time=3.0,
        output_interval=0.01,
        input=signals,
        start_values=start or {},
        output=["V_mps", "alpha_rad", "q_radps", "theta_rad", "h_m"],
    )


def test_it_is_valid_and_starts_in_its_trim(unit: Path) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(unit)) == []
    result = fly(unit)
    assert np.ptp(result["V_mps"]) < 1e-3
    assert abs(result["V_mps"] - SPEED_MPS).max() < 1e-3
    assert np.abs(result["q_radps"]).max() < 1e-5


def test_an_elevator_step_answers_as_the_linear_model(unit: Path) -> None:
    result = fly(unit, step_deg=0.2)
    aircraft = find_aircraft("espaaro")
    model = linearise(aircraft, find_trim(aircraft, SteadyCondition(SPEED_MPS, 200.0)))
    B = model.B[:, [model.controls.index("elevator")]]
    time = np.asarray(result["time"])
    command = np.where(time >= 0.995, 0.2, 0.0)
    # The servo's lag of 40 ms, which the linear model leaves out.
    lagged = lsim(([[-25.0]], [[25.0]], [[1.0]], [[0.0]]), command, time, interp=False)[1]
    # States u, v, w, p, q, r, phi, theta.
    pitch_rate = lsim((model.A, B, np.eye(8), np.zeros((8, 1))), lagged, time)[1][:, 4]
    assert np.abs(pitch_rate).max() > 0.003
    error = result["q_radps"] - pitch_rate
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.abs(pitch_rate).max()


def test_levels_of_the_model_form_are_parameters(unit: Path) -> None:
    nominal = fly(unit)
    lower = fly(unit, {"uq_active": 1.0, "uq_CZ_level": 0.0})
    # CZ less by .05: more lift, the aircraft climbs.
    assert lower["h_m"][-1] - nominal["h_m"][-1] > 0.5
    assert np.array_equal(fly(unit)["h_m"], nominal["h_m"])


@pytest.mark.parametrize(("name", "speed_mps"), [("c310", 60.0), ("c172p", 45.0)])
def test_engines_start_in_the_trim(name: str, speed_mps: float, tmp_path: Path) -> None:
    """An aeroplane with one of its two engines loses .8 m/s each second; with a propeller that
    JSBSim's own method leaves too fast it gains .9.
    """
    folder = tmp_path / name
    shutil.copytree(Path(jsbsim.get_default_root_dir()) / "aircraft" / name, folder)
    controls = {"elevator": "nose down", "aileron": "right wing down", "rudder": "nose left"}
    card = f'[aircraft]\nname = "{name}"\nxml = "{name}.xml"\ndt_s = 0.01\n'
    for surface, sense in controls.items():
        card += f'[inputs.{surface}]\nproperty = "fcs/{surface}-cmd-norm"\nunit = "norm"\n'
        card += f'positive = "{sense}"\nlimits = [-1, 1]\nthrow_deg = 15\n'
    card += '[inputs.throttle]\nproperty = "fcs/throttle-cmd-norm"\nunit = "norm"\n'
    (folder / "airframe.toml").write_text(card + 'positive = "more thrust"\nlimits = [0, 1]\n')
    uq.export(folder, "fmu", out=tmp_path / "out", speed_mps=speed_mps, states=20)
    unit = str(tmp_path / f"out/{name}.fmu")
    result = fmpy.simulate_fmu(unit, stop_time=1.0, output_interval=0.1, output=["V_mps"])
    assert abs(result["V_mps"] - speed_mps).max() < 0.03
