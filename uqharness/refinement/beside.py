"""Effects too weak to be named beside something that nothing explains.

What is unexplained goes with many candidates a little, so that limits for chance no longer hold: an effect is then named where it
is strong, or nearly as strong as the strongest. Train flights alone decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sysid.effects import COMPARABLE, DIFFERENT, OVERWHELMING, Choice
from sysid.parallel import Processes
from uqharness.refinement.curves import bent
from uqharness.refinement.find import Found
from uqharness.refinement.judge import evidence_of, left_out, property_values, written_at
from uqharness.refinement.showing.show import left_in, show
from uqharness.refinement.types import Side
from uqharness.simulator import Aircraft


def too_weak(chosen: Sequence[Choice], limit: float) -> tuple[Choice, ...]:
    """Those that would not be named beside something unexplained; limit: |t| asked of any. |t| is by the standard error that is
    told, which may be wider than what chose them."""
    t = [abs(c.value / c.std) for c in chosen]
    asked = max(min(COMPARABLE * max(t, default=0.0), OVERWHELMING), limit + DIFFERENT)
    return tuple(c for c, own in zip(chosen, t, strict=True) if not own >= asked)


def named_beside(found: Found, train: Side, whole: Aircraft, map_: Processes) -> Found:
    """The same, everything estimated again without what is too weak, if the model with all of it leaves the train flights
    unexplained: by what is left of them, or by a curve that the forms chosen are not (`curves.bent`), beside which the others are
    judged. whole: the aircraft with all of it."""
    chosen, curve = found.selection.chosen, bent(found)
    if curve is None:
        weak = too_weak(chosen, found.limit)
        at = written_at(found, property_values(found, found), found.after.flown.point)
        if weak and not left_in(train.setup, show(whole, train, map_, at), found.gusty):
            return found
    else:
        form, others = curve
        found = replace(found, bent=form)
        part = [c for c in chosen if c.key in form.instead]
        asked = {c.key for c in too_weak([*part, *others], found.limit)}
        weak = tuple(c for c in chosen if c.key in asked)
    if not weak:
        return found
    rest = left_out(found, evidence_of(found), [c.key for c in weak])
    lines = [f"too weak beside what is unexplained: - {c.key} t {c.t:.1f}" for c in weak]
    return replace(rest, unnamed=weak, trail=(*found.trail, *lines))
