"""What a refinement is made of before anything is chosen: flights cut and judged, aircraft staged, candidates listed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.digests import file_sha256
from sysid.effects import Columns, Effect, Evidence, Gusts, follow, gather, whiten_each
from sysid.effects.catalogue import catalogue
from sysid.effects.subsystem_effects import subsystem_effects
from uqharness.errors import BadInputError
from uqharness.identification.linearised import PRIOR, Fit, Setup, in_step, merged
from uqharness.replay import SENSOR_OF


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content. Raises BadInputError."""
    try:
        return file_sha256(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None


def refuse_shared(train: Sequence[Path], test: Sequence[Path]) -> None:
    """BadInputError when a test file has the content of a train file: a flight that chose cannot prove."""
    seen = {file_hash(path): path for path in train}
    for path in test:
        other = seen.get(file_hash(path))
        if other is not None:
            raise BadInputError(
                f"--test {path}: the same flight as --train {other}; a flight that helped to choose proves "
                f"nothing: give another one"
            )


def candidates_for(setup: Setup, names: Sequence[str], extra: Sequence[Effect]) -> list[Effect]:
    """The catalogue less what the model estimates already, and the user's own effects."""
    surfaces = list(setup.servos)
    timed = setup.outputs if not setup.late else ()
    sensors, parts = (
        list(dict.fromkeys(SENSOR_OF.get(c, c) for c in timed)),
        [c for c in timed if c in SENSOR_OF],
    )
    every = [*extra, *catalogue(), *subsystem_effects(surfaces, setup.outputs, sensors, parts)]
    out: dict[str, Effect] = {}
    for e in every:
        if e.coefficient is None or e.property_name not in names:
            out.setdefault(e.key, e)
    return list(out.values())


def confirming_segments(setup: Setup) -> NDArray[np.bool_]:
    """(S,) every third manoeuvre of each kind confirms what the others found; the kind is its label without speeds and numbers."""
    kinds = [s.kind for s in setup.segments]
    found = np.array([kinds[:k].count(kind) % 3 == 1 for k, kind in enumerate(kinds)])
    if not found.any() and len(found) > 2:
        found[1::3] = True
    return found


def column_evidence(
    setup: Setup, fit: Fit, extra: Sequence[Columns], gusts: Gusts | None
) -> Evidence:
    """Evidence of a fit's own columns beside others; gusts: the air, where one-step predictions judge."""
    columns = merged(fit.columns, extra)
    measured, process = (
        (setup.measured, None)
        if gusts is None
        else (in_step(setup, fit.flown.point), gusts.process)
    )
    white = whiten_each(follow(fit.steps, measured, setup.which, setup.noise, process), columns)
    return gather(white, columns.names, confirming_segments(setup), PRIOR, fit.columns[0].names)
