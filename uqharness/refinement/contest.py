"""Which of several causes a strong disagreement in turbulence has, where the linearised flight hardly tells: each is flown alone.

An airspeed sensor that reads a quarter too much looks at first like thrust that is off: |t| 36 and 37. Flown, the right one leaves
nothing; the wrong one asks for four more effects, and each of them fits a little.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from sysid.effects import ALIKE, COMPARABLE, OVERWHELMING, SEVERAL, Choice, Evidence, likeness, scores


def rivals(evidence: Evidence, free: Sequence[str], odds: Mapping[str, float], key: str) -> list[str]:
    """Other candidates that explain nearly as much as ``key`` in its place, the best first, no two of them alike: they trade places
    where none of them is linear in its number."""
    others = [k for k in odds if k != key]
    own, *gains = np.nan_to_num(scores(evidence, free, [key, *others]).gain, nan=-np.inf)
    gain = np.array(gains)
    found: list[str] = []
    for k in np.argsort(-gain):
        if len(found) == SEVERAL or not gain[k] >= COMPARABLE * own:
            break
        same = np.abs(np.nan_to_num(likeness(evidence, free, others[k], [key, *found])))
        if same.max() < ALIKE:
            found.append(others[k])
    return found


def many_asked(flown: Collection[str], again: Sequence[Choice]) -> Choice | None:
    """The strongest effect asked for beside those flown, where many are and it is by far too strong for chance; else None."""
    new = [c for c in again if c.key not in flown]
    strongest = max(new, key=lambda c: abs(c.t), default=None)
    return strongest if strongest is not None and len(new) >= SEVERAL and abs(strongest.t) > OVERWHELMING else None


def winner(
    names: Sequence[str], alone: Callable[[str], Choice], surprise: Callable[[Choice], float], to_beat: float, margin: float
) -> Choice | None:  # fmt: skip
    """The alternative that flies best, if its flight is likelier than what is to be beaten.

    ``surprise``: minus twice the log likelihood of the flights with one effect; margin: by how much it must be less.
    """
    found = [(surprise(choice), choice) for choice in map(alone, names)]
    least = min(found, key=lambda f: f[0], default=None)
    return least[1] if least is not None and least[0] < to_beat - margin else None
