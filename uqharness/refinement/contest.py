"""Which of several causes a strong disagreement in turbulence has, where the linearised flight hardly tells: each is flown alone.

An airspeed sensor that reads a quarter too much looks at first like thrust that is off: |t| 36 and 37. Flown, the right one leaves
nothing; the wrong one asks for four more effects, and each of them fits a little.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from sysid.effects import Choice, Evidence, likeness, scores

NEAR = 0.8
"""Share of the winner's gain that an alternative must reach on the linearised flight."""
ALIKE = 0.99
"""Correlation from which two candidates are one and the same for this purpose."""
OF_A_SERVO = 0.5
"""The same for another fault of the same servo: none of them is linear in its number, and lags and rate limits trade places."""
MOST_RIVALS = 3
MANY, BY_FAR = 3, 30.0
"""Effects asked for beside what flew, and |t| of the strongest, from which that one's alternatives fly beside it: where many are
asked for, the strongest may be what several share."""
BESIDE, MOST_BESIDE = 0.3, 6
"""Share of the strongest's gain that an alternative must then reach, and how many fly."""


def rivals(
    evidence: Evidence, free: Sequence[str], odds: Mapping[str, float], key: str, near: float = NEAR, most: int = MOST_RIVALS
) -> list[str]:  # fmt: skip
    """Other candidates that explain ``near`` as much as ``key`` in its place, the best first, no two of them alike."""
    others = [k for k in odds if k != key]
    own, *gains = np.nan_to_num(scores(evidence, free, [key, *others]).gain, nan=-np.inf)
    gain = np.array(gains)
    found: list[str] = []
    for k in np.argsort(-gain):
        if len(found) == most:
            break
        if not gain[k] >= (OF_A_SERVO if _one_servo(key, others[k]) else near) * own:
            continue
        same = np.abs(np.nan_to_num(likeness(evidence, free, others[k], [key, *found])))
        if same.max() < ALIKE:
            found.append(others[k])
    return found


def many_asked(flown: Collection[str], again: Sequence[Choice]) -> Choice | None:
    """The strongest effect asked for beside those flown, where many are and it is by far too strong for chance; else None."""
    new = [c for c in again if c.key not in flown]
    strongest = max(new, key=lambda c: abs(c.t), default=None)
    return strongest if strongest is not None and len(new) >= MANY and abs(strongest.t) > BY_FAR else None


def _one_servo(one: str, other: str) -> bool:
    part = one.split("/")[1:2]
    return part == other.split("/")[1:2] and "".join(part).startswith("actuator.")


def winner(
    names: Sequence[str], alone: Callable[[str], Choice], surprise: Callable[[Choice], float], to_beat: float, margin: float
) -> Choice | None:  # fmt: skip
    """The alternative that flies best, if its flight is likelier than what is to be beaten.

    ``surprise``: minus twice the log likelihood of the flights with one effect; margin: by how much it must be less.
    """
    found = [(surprise(choice), choice) for choice in map(alone, names)]
    least = min(found, key=lambda f: f[0], default=None)
    return least[1] if least is not None and least[0] < to_beat - margin else None
