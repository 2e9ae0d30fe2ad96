"""One channel of a sensor that is late by itself: believed only where nothing else is late."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from sysid.effects import Choice, Effect
from uqharness.refinement.find import Found
from uqharness.replay import SENSOR_OF

NOT_BELIEVED = (
    "one channel of a sensor late by itself was not believed beside other delays and servos ({}): the effects were sought "
    "without such delays"
)


def believed(find: Callable[[bool], Found]) -> Found:
    """What is found with delays of single channels, ``find(True)``, or where one of them needs another time beside it, without.

    A servo whose command comes late looks like a gyro and an attitude that are, and a lag: three times for one.
    """
    found = find(True)
    doubtful = lone_among_times(found.selection.chosen, found.effects)
    if not doubtful:
        return found
    names = ", ".join(f"{e.subsystem} {e.term}" for e in doubtful)
    instead = find(False)
    return replace(instead, notes=(*instead.notes, NOT_BELIEVED.format(names)))


def lone_among_times(chosen: Sequence[Choice], effects: Mapping[str, Effect]) -> list[Effect]:
    """Delays of single channels and everything else that is a time or a servo's, where both were chosen; else none."""
    of = [effects[c.key] for c in chosen]
    timed = [e for e in of if e.unit in ("s", "s/deg") or (e.subsystem or "").startswith("actuator.")]
    lone = [e for e in timed if (e.subsystem or "").partition(".")[2] in SENSOR_OF]
    return timed if lone and len(timed) > 1 else []
