"""Delays of one channel of a sensor stand alone or not at all."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from sysid.effects.catalogue import Effect, coefficient_effect
from sysid.effects.selection import Choice, Selection
from sysid.effects.subsystem_effects import subsystem_effects
from uqharness.refinement.lone import believed

KNOWN = {
    e.key: e
    for e in (
        *subsystem_effects(["aileron"], ["p_radps", "alpha_rad"], ["rates", "alpha_rad"], ["p_radps", "phi_rad"]),
        coefficient_effect("Cm", "p_hat^2"),
    )
}


@dataclass(frozen=True)
class Said:
    selection: Selection
    lone: bool
    effects: dict[str, Effect] = field(default_factory=lambda: KNOWN)
    notes: tuple[str, ...] = ("first",)


def asked(keys: list[str]) -> tuple[Said, list[bool]]:
    calls: list[bool] = []

    def find(lone: bool) -> Said:
        calls.append(lone)
        chosen = keys if lone else ["effect/actuator.aileron/lag"]
        return Said(Selection(tuple(Choice(k, 1.0, 0.1, 10.0, 100.0, 30.0, 0.0, ()) for k in chosen)), lone)

    return believed(find), calls  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "keys",
    [
        ["effect/sensor.p_radps/delay", "effect/actuator.aileron/lag"],
        ["effect/sensor.p_radps/delay", "effect/sensor.phi_rad/delay"],
        ["effect/sensor.p_radps/delay", "effect/sensor.alpha_rad/delay"],
        ["effect/actuator.aileron/deadband", "effect/sensor.phi_rad/delay"],
    ],
)
def test_beside_another_time_it_is_sought_without(keys):
    found, calls = asked(keys)
    assert calls == [True, False]
    assert not found.lone
    assert found.notes[0] == "first"
    assert "late by itself was not believed" in found.notes[1]
    assert "p_radps" in found.notes[1] or "phi_rad" in found.notes[1]


@pytest.mark.parametrize(
    "keys",
    [
        [], ["effect/sensor.p_radps/delay"], ["effect/sensor.p_radps/delay", "effect/Cm/p_hat^2"],
        ["effect/sensor.rates/delay", "effect/actuator.aileron/lag"],
        ["effect/sensor.p_radps/scale", "effect/actuator.aileron/lag"],
    ],
)  # fmt: skip
def test_alone_it_is_believed(keys):
    found, calls = asked(keys)
    assert (calls, found.lone, found.notes) == ([True], True, ("first",))
