"""Numbers that effects of stall and propulsion are written with: slopes of the model they are written into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import Selection
from uqharness.identification.linearised import Fit, Probe
from uqharness.refinement.writing.terms import INFLOW_POWERS


def control_slopes(fit: Fit) -> dict[str, float]:
    """Mean change of the coefficients by a degree of elevator and rudder, of CZ by a radian of alpha, of CX by inflow."""
    by = np.concatenate([p.by_control for p in fit.probes])
    out = {
        f"{c}_{u}": float(by[:, k, j].mean())
        for u, j in (("de", 0), ("dr", 2))
        for k, c in enumerate(COEFFICIENTS)
    }
    slope = np.concatenate(
        [p.reference.slopes[:, 2, 1] / (p.reference.qbar * p.mass.S) for p in fit.probes]
    )
    return {**out, "CZ_alpha": float(slope.mean()), **inflow_numbers(fit.probes)}


def inflow_numbers(probes: Sequence[Probe]) -> dict[str, float]:
    """Polynomial over CT of what an inflow twice the model's does to CX."""
    known = [(p.variables()["CT"], p.by_inflow) for p in probes if p.by_inflow is not None]
    if not known:
        return {}
    CT, change = (np.concatenate(columns) for columns in zip(*known, strict=True))
    numbers, *_ = np.linalg.lstsq(np.vander(CT, INFLOW_POWERS, increasing=True), change, rcond=None)
    return {f"inflow_{k}": float(number) for k, number in enumerate(numbers)}


def of_lift_slope(
    selection: Selection, before: Fit, after: Fit
) -> tuple[Selection, dict[str, float]]:
    """Lift lost by separation as a share of the lift slope that is estimated beside it, and the numbers to write effects with.

    Flights that stall say of a model without stall that its lift slope is small: of that slope the share would be too large.
    """
    slopes = control_slopes(before)
    own = after.flown.point.values.get("aero/CZ_alpha", 0.0)
    if not own * slopes["CZ_alpha"] > 0.0:
        return selection, slopes
    ratio = slopes["CZ_alpha"] / own
    chosen = tuple(
        replace(c, value=ratio * c.value, std=ratio * c.std)
        if c.key.startswith("effect/stall/")
        else c
        for c in selection.chosen
    )
    return replace(selection, chosen=chosen), {**slopes, "CZ_alpha": own}
