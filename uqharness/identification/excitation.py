"""Which parameters flights can determine, and which channels those act on, before anything is
estimated.

The information matrix at the start values (Maine and Iliff, NASA RP-1138, 1985, section 5) bounds
the standard error of each parameter, with start states and biases estimated at the same time. It
follows from the model's motion under the recorded controls. Parameters that could not reach a
useful standard error stay at their values, and channels on which no remaining parameter acts are
not fitted.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation import assess, forward_differences
from sysid.linalg import Blocks
from sysid.linalg import information as total_information
from uqharness.identification.replay_fit import Observed
from uqharness.replay import Replay, ReplayModel, nuisance_layout
from uqharness.xml import SLOT, read_section

_BIAS = "uq/bias/"
_LATERAL = tuple(SLOT[axis] for axis in ("SIDE", "ROLL", "YAW"))


def lateral_constants(model: ReplayModel) -> tuple[str, ...]:
    """Return one bias property for each of side force, roll and yaw that the aircraft's functions
    have.

    Every aircraft is slightly asymmetric and no symmetric model is, so a constant moment is no
    evidence of a control's effect: these constants are estimated with the parameters.
    """
    axes = read_section(model.staging.folder, model.staging.xml.name).axes
    out = []
    for slot in _LATERAL:
        nodes = axes[slot].node.walk() if slot in axes else ()
        biases = [
            node.text.strip()
            for node in nodes
            if node.tag == "property" and node.text.strip().startswith(_BIAS)
        ]
        out += biases[:1]
    return tuple(out)


MIN_T = 4.0
"""Smallest ratio of a parameter's size to its standard error: below, the 95 % interval would be as
wide as the parameter is large."""
WIDTH_SHARE = 0.1
"""A parameter's size is its value, at least this share of the width of its bounds: values near 0
are not determined better for being small."""
MIN_CHANNEL_SHARE = 0.01
"""Smallest share of the information on some parameter that a fitted channel must contribute."""
_STEP = 1e-4
"""Difference step relative to a parameter's value, its bounds' width or one: replays are smooth,
and a double resolves 1e-8 of their change."""


@dataclass(frozen=True)
class Excitation:
    """Result of the assessment: fixed parameters with reasons, and channels on which no free one
    acts.
    """

    fixed: Mapping[str, str]
    left_out: tuple[str, ...]


NONE_FIXED = Excitation({}, ())


def find_excited(
    replay: Replay,
    observed: Observed,
    names: Sequence[str],
    initial: FloatArray,
    limits: Sequence[tuple[float, float]],
    noise: Mapping[str, float],
    *,
    pool: Callable[..., Any],
) -> Excitation:
    """Assess the parameters of a replay at their start values.

    Parameters
    ----------
    replay : Replay
        Its theta begins with the parameters.
    observed : Observed
        Segments and channels.
    names, initial, limits
        (k,) parameters, start values and bounds.
    noise : Mapping
        Standard deviation by channel.
    pool : callable
        A `map` as `replay_pool` yields it.

    Returns
    -------
    Excitation
        NONE_FIXED where the model cannot fly from the start values.
    """
    count = len(replay.names)
    theta = np.zeros(count)
    theta[: len(names)] = initial
    # Steps are relative to the value, the width of the bounds, or one.
    steps = np.full(count, _STEP)
    for k, (value, (low, high)) in enumerate(zip(initial, limits, strict=True)):
        width = high - low if np.isfinite(high - low) else 1.0
        steps[k] *= abs(value) or width
        # A forward step must not leave the bounds.
        steps[k] *= -1.0 if value + steps[k] > high else 1.0
    sigma = np.array([noise[c] for c in observed.outputs])
    logged = np.isfinite(np.concatenate(list(observed.data))) & (sigma > 0.0)
    sensitivities = forward_differences(
        replay, theta, steps, ([len(z) for z in observed.data], len(sigma)), pool
    )
    if sensitivities is None:
        return NONE_FIXED
    with np.errstate(divide="ignore", invalid="ignore"):
        # Sensitivities in units of the noise; samples that were not logged carry no information.
        slopes = sensitivities.map_parts(
            lambda part, _, rows: np.where(logged[rows, :, None], part / sigma[:, None], 0.0)
        )
    # The size against which a standard error is judged.
    widths = np.array([high - low if np.isfinite(high - low) else 0.0 for low, high in limits])
    size = np.maximum(np.abs(initial), WIDTH_SHARE * widths)
    excitation = assess_excitation(slopes, replay.names, size, observed.outputs)
    return replace(
        excitation,
        fixed={
            n: f"held at {initial[list(names).index(n)]:.4g}: {reason}"
            for n, reason in excitation.fixed.items()
        },
    )


def assess_excitation(
    slopes: Blocks, labels: Sequence[str], size: FloatArray, outputs: Sequence[str]
) -> Excitation:
    """Assess parameters by the sensitivities (N, m, K) of the outputs in units of the noise.

    The first of the K ``labels`` are parameters of ``size`` (k,); the others are nuisance
    parameters. A parameter of size 0 is never fixed.
    """
    count = len(size)
    information = total_information(slopes)
    fixed: dict[str, str] = {}
    while True:
        free_columns = [k for k, name in enumerate(labels) if name not in fixed]
        # Collinear parameters have infinite standard errors here and are fixed first.
        gate = assess(
            information[np.ix_(free_columns, free_columns)], tuple(labels[k] for k in free_columns)
        )
        smallest = np.full(len(labels), np.inf)
        smallest[free_columns] = np.sqrt(
            np.where(gate.identified, np.maximum(np.diagonal(gate.inverse), 0.0), np.inf)
        )
        t = size / smallest[:count]
        # Fix one at a time: the others gain the information that it took.
        weak = [k for k in free_columns if k < count and size[k] > 0.0 and t[k] < MIN_T]
        if not weak:
            break
        worst = min(weak, key=lambda k: (t[k], information[k, k]))
        reason = gate.reason[free_columns.index(worst)] or (
            f"not excited: its standard error would be at least {smallest[worst]:.2g}, "
            f"at most {size[worst] / MIN_T:.2g} is needed"
        )
        fixed[labels[worst]] = reason
    free = [
        k for k, name in enumerate(labels[:count]) if name not in fixed and np.isfinite(smallest[k])
    ]
    # Without free parameters no channel can be judged.
    if not free:
        return Excitation(fixed, ())
    # (free, m): information of each channel alone on each parameter, relative to that of all
    # channels after the other parameters are estimated.
    squares = np.zeros((len(outputs), len(labels)))
    for part, columns in slopes:
        squares[:, columns] += np.sum(part**2, axis=0)
    share = squares.T[free] * smallest[free, None] ** 2
    return Excitation(
        fixed,
        tuple(
            c
            for c, largest in zip(outputs, share.max(axis=0), strict=True)
            if largest < MIN_CHANNEL_SHARE
        ),
    )


def without_channels(observed: Observed, left_out: Sequence[str]) -> Observed:
    """Return the observations without some channels."""
    retained = [k for k, c in enumerate(observed.outputs) if c not in left_out]
    outputs = tuple(observed.outputs[k] for k in retained)
    return replace(
        observed,
        outputs=outputs,
        data=[z[:, retained] for z in observed.data],
        biases=[b for b in observed.biases if b in outputs],
    )


def restrict_to_excited(
    model: ReplayModel,
    observed: Observed,
    names: Sequence[str],
    initial: FloatArray,
    limits: Sequence[tuple[float, float]],
    noise: Mapping[str, float],
    *,
    pool: Callable[..., Any],
    choose: bool,
) -> tuple[Observed, list[str]]:
    """Fix the parameters that the flights do not excite, and leave out channels on which none acts.

    Returns the reduced observations and notes; ``choose`` allows channels to be left out.
    """
    # The constants compete with lateral parameters, so their information is accounted for.
    constants = [n for n in lateral_constants(model) if n not in names]
    layout = nuisance_layout(
        (*names, *constants),
        (*limits, *[(-np.inf, np.inf)] * len(constants)),
        observed.segments,
        observed.biases,
        observed.outputs,
        late=observed.late,
    )
    replay = Replay(model, observed.segments, layout.names, observed.outputs, uuid.uuid4().hex)
    excitation = find_excited(replay, observed, names, initial, limits, noise, pool=pool)
    # The perturbed simulations are not needed by the fit.
    replay.forget()
    left_out = excitation.left_out if choose else ()
    notes = (
        [f"channels left out, because no estimated parameter acts on them: {', '.join(left_out)}"]
        if left_out
        else []
    )
    return replace(without_channels(observed, left_out), fixed=excitation.fixed), notes
