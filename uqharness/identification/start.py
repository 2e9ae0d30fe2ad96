"""Where output error starts: equation error at the measured states, with the model forced to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sysid.aerodynamics import demanded, regressor, smooth, split_name, variables
from sysid.arrays import FloatArray
from sysid.estimation import assess
from sysid.model_form import with_noise
from uqharness.replay import (
    CONTROLS,
    Flight,
    ForcedModel,
    MeasuredSegment,
    ReplayModel,
    Segment,
    StatesOf,
    altitudes,
    force_all,
    sampling_errors,
    states,
    surface_positions,
)


def equation_error_start(
    model: ReplayModel,
    straight: ReplayModel,
    flights: Sequence[Flight],
    cut: Sequence[Segment],
    names: Sequence[str],
    initial: FloatArray,
    limits: Sequence[tuple[float, float]],
) -> tuple[FloatArray, list[str]]:
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
    every = [states(flight, piece) for flight in flights for piece in flight.pieces]
    found = forced_at(model, straight, cut, every, dict(zip(names, initial, strict=True)))
    for segment, channels, forced in zip(cut, every, found, strict=True):
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
    cut: Sequence[Segment],
    every: Sequence[Mapping[str, FloatArray]],
    properties: Mapping[str, float],
) -> list[tuple[ForcedModel, dict[str, FloatArray]]]:
    """Of each segment the model forced to its measured channels, and the variables of its coefficient terms there."""
    stood = surface_positions(model, cut, CONTROLS, properties)
    parts = [
        StatesOf(segment, channels, controls, altitudes(model, segment, channels["h_m"]))
        for segment, channels, controls in zip(cut, every, stood, strict=True)
    ]
    out = []
    for part, forced in zip(parts, force_all(straight, parts, properties), strict=True):
        de, da, dr = (
            part.controls[:, model.controls.index(c)] for c in ("elevator", "aileron", "rudder")
        )
        V, alpha, beta, p, q, r = (
            part.states[c]
            for c in ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
        )
        out.append(
            (forced, variables(V, alpha, beta, p, q, r, de, da, dr, forced.mass.b, forced.mass.c))
        )
    return out


def coefficient_gaps(
    model: ReplayModel,
    straight: ReplayModel,
    cut: Sequence[Segment],
    every: Sequence[Mapping[str, FloatArray]],
    noise_std: Mapping[str, float],
    rng: np.random.Generator,
    properties: Mapping[str, float] | None = None,
    late_s: float = 0.0,
    half_way: bool = False,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Of each segment, (n, 6) each: coefficients demanded, those said at the measured states with what sampling makes of them, and
    how noise added once more changes the first less the second. late_s: by how much the controls act late; half_way: commands
    stand half-way at the row of a jump, which makes up for sampling."""
    noisy = [with_noise(channels, noise_std, rng) for channels in every]
    given = [*zip(cut, every, strict=True), *zip(cut, noisy, strict=True)]
    forced = forced_at(
        model, straight, [s for s, _ in given], [c for _, c in given], properties or {}
    )
    found = [
        (demand_of(channels, said, segment), smooth(said.coefficients, segment.dt_s))
        for (segment, channels), (said, _) in zip(given, forced, strict=True)
    ]
    stood = surface_positions(model, cut, CONTROLS, properties or {})
    parts = [
        MeasuredSegment(
            segment, channels, controls, altitudes(model, segment, channels["h_m"]), late_s
        )
        for segment, channels, controls in zip(cut, every, stood, strict=True)
    ]
    if half_way:
        sampled = [np.zeros((len(part.positions), 6)) for part in parts]
    else:
        sampled = sampling_errors(model, straight, parts, properties or {})
    both = zip(found[: len(cut)], found[len(cut) :], sampled, strict=True)
    return [
        (demand, said + error, (demand_again - said_again) - (demand - said))
        for (demand, said), (demand_again, said_again), error in both
    ]


def demand_of(
    channels: Mapping[str, FloatArray], forced: ForcedModel, segment: Segment
) -> FloatArray:
    """(n, 6) coefficients that the flight demanded in a piece."""
    return demanded(
        np.column_stack([channels[f"a{a}_mps2"] for a in "xyz"]),
        np.column_stack([channels[f"{a}_radps"] for a in "pqr"]),
        forced.qbar,
        forced.mass,
        forced.other_force,
        forced.other_moment,
        segment.dt_s,
        np.array(segment.arm_m),
    )
