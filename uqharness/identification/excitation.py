"""Constants of side force, roll and yaw that an aircraft's XML can have: read from its bias
properties.
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
    """One bias property for each of side force, roll and yaw, of an aircraft whose functions have
    scales and biases.

    Every aircraft is a little asymmetric and no symmetric model is: a constant moment is no
    evidence of a control's effect."""
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


# Which parameters flights can determine, and which channels they act on, before anything is
# estimated.
#
# The information matrix at the start values (Maine and Iliff, NASA RP-1138, 1985, section 5)
# gives the smallest standard error that each parameter could have, start states and biases
# estimated beside it. It comes from the model's motion under the flights' own controls, so it
# says what the manoeuvres excite.

MIN_T = 4.0
"""Size over smallest standard error that a parameter must have: below, its 95 % interval would be
as wide as it is large.
"""
WIDTH_SHARE = 0.1
"""A parameter's size is its value, or this share of its bounds' width: one of about 0 is known no
better by being small.
"""
MIN_CHANNEL_SHARE = 0.01
"""Share of the information on some parameter that a channel must hold; without it, it says nothing
of any.
"""
_STEP = 1e-4
"""Of a parameter's value, of its bounds' width or of one: replays are smooth, and a double resolves
1e-8 of their change.
"""


@dataclass(frozen=True)
class Excitation:
    """held: parameter -> why it stays at its value. left_out: channels that say nothing of the
    others.
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
    pool: Callable[..., Any],
) -> Excitation:
    """Judge parameters ``names`` (k,) of a replay whose theta begins with them, at ``initial``
    (k,).

    noise: standard deviation by channel; map_: as `replay_pool` gives it. NOTHING where the model
    cannot fly from there."""
    count = len(replay.names)
    theta = np.zeros(count)
    theta[: len(names)] = initial
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
        slopes = sensitivities.each(
            lambda part, _, rows: np.where(logged[rows, :, None], part / sigma[:, None], 0.0)
        )
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
    """The same from slopes (N, m, K) of the outputs in sigma; the first of the K ``labels`` are
    parameters, of ``size`` (k,), the others are estimated beside them. A parameter of size 0 is not
    held."""
    count = len(size)
    information = total_information(slopes)
    fixed: dict[str, str] = {}
    while True:
        free_columns = [k for k, name in enumerate(labels) if name not in fixed]
        gate = assess(
            information[np.ix_(free_columns, free_columns)], tuple(labels[k] for k in free_columns)
        )
        smallest = np.full(len(labels), np.inf)
        smallest[free_columns] = np.sqrt(
            np.where(gate.identified, np.maximum(np.diagonal(gate.inverse), 0.0), np.inf)
        )
        t = size / smallest[:count]
        # One at a time: what is held leaves the others its share of the information.
        weak = [k for k in free_columns if k < count and size[k] > 0.0 and t[k] < MIN_T]
        if not weak:
            break
        worst = min(weak, key=lambda k: (t[k], information[k, k]))
        reason = gate.reason[free_columns.index(worst)] or (
            f"not excited: its standard error would be {smallest[worst]:.2g} at least, "
            f"{size[worst] / MIN_T:.2g} at most is needed"
        )
        fixed[labels[worst]] = reason
    free = [
        k for k, name in enumerate(labels[:count]) if name not in fixed and np.isfinite(smallest[k])
    ]
    if not free:
        return Excitation(fixed, ())
    # (free, m): information of each channel alone on each parameter, in units of what is left of
    # all when the rest is estimated.
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
    """The same without some channels."""
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
    pool: Callable[..., Any],
    choose: bool,
) -> tuple[Observed, list[str]]:
    """What is fitted of what was observed, parameters that it does not excite held; notes. choose:
    channels may be left out.
    """
    constants = [n for n in lateral_constants(model) if n not in names]
    layout = nuisance_layout(
        (*names, *constants),
        (*limits, *[(-np.inf, np.inf)] * len(constants)),
        observed.segments,
        observed.biases,
        observed.outputs,
        observed.late,
    )
    replay = Replay(model, observed.segments, layout.names, observed.outputs, uuid.uuid4().hex)
    excitation = find_excited(replay, observed, names, initial, limits, noise, pool)
    replay.forget()
    left_out = excitation.left_out if choose else ()
    notes = (
        [f"not fitted, because no parameter that is estimated acts on them: {', '.join(left_out)}"]
        if left_out
        else []
    )
    return replace(without_channels(observed, left_out), fixed=excitation.fixed), notes
