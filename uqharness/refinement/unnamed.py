"""Where nothing of the catalogue explains what is left: a smooth term in one state, or times a second, offered for naming.

It is searched on the train flights' linearised likelihood beside everything that stands, written as a table into a copy of the
aircraft and flown on both sides as an effect is. It names nothing and changes no verdict.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import SmoothFit, forms_like, held_out_gain, known_forms
from sysid.estimation import rms
from sysid.parallel import Processes
from uqharness.refinement.curves import STATES, CurvesAbout, Estimated, Inputs
from uqharness.refinement.hold_out import linearised
from uqharness.refinement.judge import Judged, Write, gap_change, written_at
from uqharness.refinement.showing.show import Shown, gap_document, left_in, show, with_replays
from uqharness.refinement.types import Side
from uqharness.refinement.writing.tables import GRID, property_of_table, write_table
from uqharness.simulator import Aircraft

Z95 = 1.959963984540054
UNNAMED = "unnamed"
"""Folder of the aircraft with the term, beside the refined one."""
EXPLAINED = "the catalogue leaves nothing that asks for one"


def offered(judged: Judged, write: Write, map_: Processes) -> tuple[Aircraft, dict[str, Any]] | str:
    """The aircraft that flies the smooth term that explains most of what is left, and the term's part of refinement.json; or why
    there is none. write: a model as an aircraft in a folder of its own."""
    train, test = judged.sides
    about = CurvesAbout(judged.found, judged.found.after)
    fits = [f for c in COEFFICIENTS for f in about.fits(about.terms(c))]
    best = max(fits, key=lambda f: f.merit, default=None)
    if best is None:
        return "no state varies on the train flights"
    done = _settled(about, best, train, write, map_) if best.stands_out(len(fits)) else None
    if done is None or left_in(train.setup, done.shown, about.found.gusty):
        # One state is not enough: every state times every other, in the coefficient that the best of one points to.
        twos = [
            f for times in STATES for f in about.fits(about.terms(best.term.coefficient, times))
        ]
        fits += twos
        second = max(twos, key=lambda f: f.merit, default=best)
        if second.merit > best.merit and second.stands_out(len(fits)):
            other = _settled(about, second, train, write, map_)
            done = min(
                (d for d in (done, other) if d is not None),
                key=lambda d: d.shown.surprise,
                default=None,
            )
    if done is None:
        return f"no smooth term explains more than the best of the {len(fits)} tried does by chance"
    round_, aircraft, shown = done.round, done.aircraft, done.shown
    fit, term = round_.fit, round_.fit.term
    name = term.name
    if not shown.surprise < judged.train[2].surprise:
        return f"flown in the simulation, a {name} does not lower the error"
    there = show(aircraft, test, map_, written_at(round_.found, near=judged.test[2].flown.point))
    verdict = gap_change(judged.test[2], there, test.setup, shown)
    if verdict.says == "grew":
        return f"with a {name} the gap on the hold-out flights grew"
    gap = {}
    for key, (setup, _, before), side, after in (
        ("train", judged.train, train, shown),
        ("test", judged.test, test, there),
    ):
        if before.replays is not None:
            after = with_replays(after, aircraft, side, map_, written_at(round_.found))
        gap[key] = gap_document(setup, before, after)
    instead = [k for k in judged.found.selection.values if k in round_.instead]
    return aircraft, {
        "coefficient": term.coefficient,
        "state": term.state,
        "times": term.times,
        "name": name,
        "property": property_of_table(term),
        "unit": term.unit,
        "effective_degrees_of_freedom": fit.edf,
        "dispersion": fit.dispersion,
        "in_place_of": [judged.found.effects[k].name for k in instead],
        "tried": len(fits),
        "p": min(1.0, done.searched.p * len(fits)),
        "twice_log_likelihood": done.searched.ratio,
        **_left_of(done, gap["train"]),
        "test": {
            "gap": verdict.says,
            "change_of_twice_log_likelihood": verdict.change,
            "std": verdict.std,
            "rms_over_that_of_train": verdict.far,
        },
        "gap": gap,
    }


@dataclass(frozen=True)
class _Done:
    """A term as it flies: as it was found, about which flight it was estimated, the aircraft with it and with everything as it is
    beside it, and the train flights of that."""

    searched: SmoothFit
    about: CurvesAbout
    round: Estimated
    aircraft: Aircraft
    shown: Shown


def _settled(
    about: CurvesAbout, fit: SmoothFit, train: Side, write: Write, map_: Processes
) -> _Done | None:
    """A term flown, and estimated once more about the flight with it, which is nearer to what was measured; None as `_flown`."""
    done = _flown(about, fit, train, write, map_)
    if done is None or about.found.gusty or not np.isfinite(done.shown.cost):
        return done
    found = done.round.found
    setup, flown = linearised(found, done.aircraft, train, found.setup, done.shown.flown, map_)
    again = _flown(CurvesAbout(found, flown, setup, done.round), fit, train, write, map_)
    return again if again is not None and again.shown.cost < done.shown.cost else done


def _flown(
    about: CurvesAbout, fit: SmoothFit, train: Side, write: Write, map_: Processes
) -> _Done | None:
    """The term as it flies; None where the flight that it is estimated about is so far off that its estimates are no numbers."""
    round_ = about.estimated(fit.term)
    estimates = [
        *round_.fit.values,
        *(value for value, _ in round_.found.parameters.values()),
        *round_.found.selection.values.values(),
    ]
    if not np.isfinite(estimates).all():
        return None
    aircraft = write(round_.found)
    write_table(aircraft, round_.fit)
    shown = show(
        aircraft, train, map_, written_at(round_.found, near=round_.found.after.flown.point)
    )
    return _Done(fit, about, round_, aircraft, shown)


def _left_of(done: _Done, gap: Mapping[str, Any]) -> dict[str, Any]:
    """The channel of which the term explains most, what it and the forms like it leave there, and its curve over the data. gap: G
    of the train flights without and with it."""
    fit, term, about = done.round.fit, done.round.fit.term, done.about
    rows = gap["predictions"] or gap["channels"]
    ratio = {
        c: (r["rms_before"] / r["noise_rms"], r["rms_after"] / r["noise_rms"])
        for c, r in rows.items()
    }
    channel = max(ratio, key=lambda c: ratio[c][0] - ratio[c][1])
    x = about.every[term.state]
    near, shapes = (
        forms_like(fit, x, about.every[term.times] if term.times else np.ones_like(x)),
        known_forms(term.knots),
    )

    def columns(v: Mapping[str, FloatArray]) -> Inputs:
        k, by = COEFFICIENTS.index(term.coefficient), v[term.times] if term.times else 1.0
        return term.inputs(v) | {f"form/{n}": (k, shapes[n](v[term.state]) * by) for n, _ in near}

    evidence, free = about.evidence(columns)
    free = [n for n in free if n not in done.round.instead]

    def leaves(form: str) -> float:
        residual = evidence.residual(evidence.fitted(evidence.index([*free, form])))
        return rms(np.concatenate([r[:, list(ratio).index(channel)] for r in residual]))

    confirming = evidence.confirming
    held_out = (
        []
        if confirming is None
        else [held_out_gain(evidence, free, fit, part) for part in (~confirming, confirming)]
    )
    at = np.linspace(*term.ends, GRID)
    value, std = fit.curve(at)
    return {
        "confirmed_on_held_out_manoeuvres": min(held_out, default=None),
        "channel": channel,
        "channel_on_train": ratio[channel][0],
        "leaves": ratio[channel][1],
        "shapes": [{"form": n, "correlation": r, "leaves": leaves(f"form/{n}")} for n, r in near],
        "curve": {
            "at": at.tolist(),
            "value": value.tolist(),
            "low": (value - Z95 * std).tolist(),
            "high": (value + Z95 * std).tolist(),
            "samples": np.histogram(x, np.append(at - 0.5 * (at[1] - at[0]), np.inf))[0].tolist(),
        },
    }
