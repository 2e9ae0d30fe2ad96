"""A centre of gravity further forward: the moments are about another point, and the accelerometers
stay where they were.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.effects.catalogue import subsystem_effects
from sysid.parallel import SERIAL
from sysid.units import IN_M
from tests.helpers.flown import fly
from uqharness.errors import BadInputError
from uqharness.identification.linearised import (
    FlightData,
    ModelState,
    Trajectory,
    effect_columns,
    make_flight_data,
    positions,
    probe_trajectory,
    stage_models,
    with_sensors_of,
)
from uqharness.identification.linearised import replay_at as replayed
from uqharness.plugin import with_card
from uqharness.refinement.write_xml import EffectToWrite, write_effects
from uqharness.replay.flights import read_flights
from uqharness.simulator.aircraft import Aircraft, find_aircraft, open_aircraft

FORWARD_M = 0.06
ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")


@pytest.fixture(scope="module")
def aircraft() -> Aircraft:
    return find_aircraft("espaaro")


@pytest.fixture(scope="module")
def data(aircraft: Aircraft, tmp_path_factory: pytest.TempPathFactory) -> FlightData:
    path = tmp_path_factory.mktemp("cg") / "flight.parquet"
    fly((("pitch-3211", 22.0), ("roll-yaw", 22.0)), seed=1, seconds=6.0).write(path)
    flights, measured = read_flights([path], aircraft, None, None)
    return make_flight_data(aircraft, flights, measured)


@pytest.fixture(scope="module")
def moved(aircraft: Aircraft, tmp_path_factory: pytest.TempPathFactory) -> Aircraft:
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    out = tmp_path_factory.mktemp("moved") / "espaaro"
    write_effects(aircraft, [EffectToWrite(effect, FORWARD_M, "a remark", {})], {}, out)
    return find_aircraft(out)


def along_axis(
    aircraft: Aircraft, data: FlightData, values: dict[str, float]
) -> tuple[Trajectory, list[np.ndarray]]:
    """Replays, and the columns of a centre of gravity further forward along them."""
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    with stage_models(aircraft, replace(data, positions=())) as models:
        point = ModelState(
            values, dict.fromkeys(data.nuisance, 0.0), tuple(s.start for s in data.segments)
        )
        trajectory = replayed(models.model, data, point, SERIAL)
        result = probe_trajectory(
            models.direct_model, data, trajectory, positions(models.model, data), SERIAL
        )
        return trajectory, [
            c.outputs[effect.key] for c in effect_columns(data, result, trajectory, [effect])
        ]


def about_another_point(aircraft: Aircraft) -> dict[str, float]:
    """Coefficients that have the moments of CZ and CY about a point ``FORWARD_M`` behind in Cm and
    Cn: M += Z x, N -= Y x.
    """
    fdm, reference = open_aircraft(aircraft), aircraft.card.reference
    values = {n: float(fdm[n]) for n in aircraft.card.parameters}
    for term in ("0", "alpha", "q", "de"):
        values[f"aero/Cm_{term}"] += FORWARD_M / reference.c_m * float(fdm[f"aero/CZ_{term}"])
    for term in ("0", "beta", "p", "r", "dr"):
        values[f"aero/Cn_{term}"] -= FORWARD_M / reference.b_m * float(fdm[f"aero/CY_{term}"])
    return values


def test_it_flies_as_with_the_moments_of_the_forces_and_is_felt_as_its_column_says(
    aircraft, moved, data
):
    plain, columns = along_axis(aircraft, data, about_another_point(aircraft))
    forward, _ = along_axis(moved, with_sensors_of(data, moved), {})
    clip_to_active_range = [data.outputs.index(c) for c in ACCELERATIONS]
    remainder = [k for k in range(len(data.outputs)) if k not in clip_to_active_range]
    for before, after, column in zip(plain.outputs, forward.outputs, columns, strict=True):
        change = after - before
        assert np.abs(change[:, remainder]).max() < 1e-9
        remaining = change[:, clip_to_active_range] - FORWARD_M * column[:, clip_to_active_range]
        assert np.sqrt(np.mean(remaining**2)) < 0.03 * np.sqrt(
            np.mean(change[:, clip_to_active_range] ** 2)
        )
        assert np.abs(change[:, clip_to_active_range]).max() > 0.02


def test_it_moves_by_as_much_with_fuel_and_loads_on_board(tmp_path: Path) -> None:
    """A Cessna whose fuel, pilots and luggage weigh a fifth of the whole, and stay where
    they are.
    """
    loaded = with_card(find_aircraft("c172p"))
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    write_effects(
        loaded, [EffectToWrite(effect, FORWARD_M, "a remark", {})], {}, tmp_path / "c172p"
    )
    other = replace(
        find_aircraft(tmp_path / "c172p"),
        engine_path=loaded.engine_path,
        systems_path=loaded.systems_path,
    )
    aft_m = []
    for one in (loaded, other):
        fdm = open_aircraft(one)
        fdm.run_ic()
        assert fdm["inertia/empty-weight-lbs"] < 0.85 * fdm["inertia/weight-lbs"]
        aft_m.append(IN_M * fdm["inertia/cg-x-in"])
    assert aft_m[0] - aft_m[1] == pytest.approx(FORWARD_M, rel=1e-6)


def test_without_an_empty_weight_nothing_is_written(tmp_path: Path) -> None:
    weightless = tmp_path / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, weightless)
    xml = weightless / "espaaro.xml"
    text, count = re.subn(r"(<emptywt[^>]*>)[^<]*", r"\g<1>0", xml.read_text(encoding="utf-8"))
    assert count == 1
    load = (
        '<pointmass name="all"><weight unit="LBS">46</weight><location'
        ' unit="M"><x>0</x><y>0</y><z>0</z></location></pointmass>'
    )
    xml.write_text(text.replace("</mass_balance>", f"{load}</mass_balance>"), encoding="utf-8")
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    with pytest.raises(BadInputError, match="<emptywt> is 0"):
        write_effects(
            find_aircraft(weightless),
            [EffectToWrite(effect, FORWARD_M, "a remark", {})],
            {},
            tmp_path / "out" / "espaaro",
        )
