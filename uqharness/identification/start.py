"""Where output error starts: equation error at the measured states, with the model forced to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import demanded, regressor, smooth, split_name, variables
from sysid.estimation import assess
from sysid.model_form import with_noise
from uqharness.replay import CONTROLS, Flight, ForcedModel, ReplayModel, Segment, altitudes, force_states, states, surface_positions

Array = NDArray[np.float64]


def equation_error_start(
    model: ReplayModel, straight: ReplayModel, flights: Sequence[Flight], cut: Sequence[Segment],
    names: Sequence[str], initial: Array, limits: Sequence[tuple[float, float]],
) -> tuple[Array, list[str]]:  # fmt: skip
    """Parameters (k,) at which the model's forces at the measured states come nearest to those the flight demanded.

    Only parameters that are coefficient terms by name move; the others, and those that the flights do not tell apart, stay.
    """
    theta = initial.copy()
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        parsed = split_name(name)
        if parsed is not None:
            groups.setdefault(parsed[0], []).append(i)
    if not groups:
        return theta, ["equation error was left out: no parameter is a coefficient term by name"]
    notes: list[str] = []
    demand, said, base = [], [], []
    for segment, (flight, piece) in zip(cut, [(f, p) for f in flights for p in f.pieces], strict=True):
        channels = states(flight, piece)
        forced = forced_at(model, straight, segment, channels, dict(zip(names, initial, strict=True)))
        demand.append(demand_of(channels, forced[0], segment))
        said.append(smooth(forced[0].coefficients, segment.dt_s))
        base.append({k: smooth(v, segment.dt_s) for k, v in forced[1].items()})
    order = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
    for coefficient, members in groups.items():
        column = order.index(coefficient)
        y = np.concatenate([d[:, column] - s[:, column] for d, s in zip(demand, said, strict=True)])
        x = np.column_stack(
            [np.concatenate([regressor(split_name(names[i])[1], b) for b in base]) for i in members]  # type: ignore[index]
        )
        gate = assess(x.T @ x, tuple(names[i] for i in members))
        moved = [i for i, ok in zip(members, gate.identified, strict=True) if ok]
        delta = np.linalg.lstsq(x[:, gate.identified], y, rcond=None)[0]
        for i, d in zip(moved, delta, strict=True):
            low, high = limits[i]
            # A hair inside, so that output error does not start on a bound.
            margin = 1e-6 * (high - low) if np.isfinite(high - low) else 0.0
            theta[i] = float(np.clip(initial[i] + d, low + margin, high - margin))
    return theta, notes


def forced_at(
    model: ReplayModel,
    straight: ReplayModel,
    segment: Segment,
    channels: Mapping[str, Array],
    properties: Mapping[str, float],
) -> tuple[ForcedModel, dict[str, Array]]:
    """The model forced to a piece's measured states, and the variables of its coefficient terms there."""
    controls = surface_positions(model, segment, CONTROLS)
    altitude = altitudes(model, segment, channels["h_m"])
    forced = force_states(straight, segment, channels, controls, properties, altitude)
    de, da, dr = (controls[:, model.controls.index(c)] for c in ("elevator", "aileron", "rudder"))
    found = variables(
        channels["V_mps"], channels["alpha_rad"], channels["beta_rad"], channels["p_radps"], channels["q_radps"],
        channels["r_radps"], de, da, dr, forced.mass.b, forced.mass.c,
    )  # fmt: skip
    return forced, found


def coefficient_gap(
    model: ReplayModel, straight: ReplayModel, segment: Segment, channels: Mapping[str, Array], noise_std: Mapping[str, float],
    rng: np.random.Generator, properties: Mapping[str, float] | None = None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """(n, 6) each: coefficients demanded, those said at the measured states, and how noise added once more changes the first
    less the second."""

    def asked(given: Mapping[str, Array]) -> tuple[Array, Array]:
        forced, _ = forced_at(model, straight, segment, given, properties or {})
        return demand_of(given, forced, segment), smooth(forced.coefficients, segment.dt_s)

    demand, said = asked(channels)
    noisy_demand, noisy_said = asked(with_noise(channels, noise_std, rng))
    return demand, said, (noisy_demand - noisy_said) - (demand - said)


def demand_of(channels: Mapping[str, Array], forced: ForcedModel, segment: Segment) -> Array:
    """(n, 6) coefficients that the flight demanded in a piece."""
    return demanded(
        np.column_stack([channels[f"a{a}_mps2"] for a in "xyz"]),
        np.column_stack([channels[f"{a}_radps"] for a in "pqr"]),
        forced.qbar, forced.mass, forced.other_force, forced.other_moment, segment.dt_s, np.array(segment.arm_m),
    )  # fmt: skip
