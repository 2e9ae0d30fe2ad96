"""Model-form intervals around the model before and after a refinement: fitted on the train flights, judged on the test flights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import AircraftReference, Coverage, ModelForm
from uqharness.errors import BadInputError
from uqharness.files import inner_folder, write_bytes
from uqharness.identification import BoundsOptions, make_bounds, validate
from uqharness.replay import Flight, recut
from uqharness.simulator import Aircraft, content_hash

FOLDER = "intervals"
LEVEL = 0.95


@dataclass(frozen=True)
class FlightSet:
    """Flights, surfaces whose positions they carry, SHA-256 of their files, and controls that are passed straight through."""

    flights: tuple[Flight, ...]
    measured: tuple[str, ...]
    hashes: tuple[str, ...]
    ideal: tuple[str, ...] = ()


@dataclass(frozen=True)
class IntervalJob:
    """A model whose intervals come from ``train`` and are held against ``test``.

    flown: the aircraft that flies as the model does where its properties have ``values``
    """

    aircraft: Aircraft
    flown: Aircraft
    values: Mapping[str, float]
    train: FlightSet
    test: FlightSet
    ideal_servos: bool


@dataclass(frozen=True)
class Intervals:
    """A model's intervals and their coverage of the test flights; none of either, with the reason, where that cannot be told."""

    form: ModelForm | None
    coverage: dict[str, Coverage]
    reason: str | None = None


def fit_intervals(job: IntervalJob) -> Intervals:
    """Intervals as `uqharness bounds` makes them and `validate-bounds` judges them."""
    form: ModelForm | None = None
    try:
        train, test = (
            [recut(f, given.measured) for f in given.flights] for given in (job.train, job.test)
        )
        options = BoundsOptions(ideal_servos=job.ideal_servos, checks=False, values=job.values)
        made = make_bounds(job.flown, train, job.train.measured, job.train.hashes, options).form
        form = replace(
            made, aircraft=AircraftReference(job.aircraft.name, content_hash(job.aircraft))
        )
        found = validate(
            job.flown, made, test, job.test.measured, job.test.hashes, job.ideal_servos, job.values
        )
    except (BadInputError, ValueError) as error:
        return Intervals(form, {}, str(error))
    return Intervals(form, dict(found.coverage))


def write_forms(found: Mapping[str, Intervals], out: Path) -> dict[str, Path]:
    """``out``/intervals/<name>.json of every model that has intervals, by name."""
    paths = {}
    for name, intervals in found.items():
        if intervals.form is not None:
            paths[name] = inner_folder(out, FOLDER) / f"{name}.json"
            write_bytes(paths[name], intervals.form.to_json().encode())
    return paths


def intervals_document(before: Intervals, after: Intervals) -> dict[str, Any]:
    """gap.test.intervals of refinement.json: NaN, with the reason, for what cannot be told."""
    rows: dict[str, dict[str, float]] = {c: {} for c in COEFFICIENTS}
    for c, row in rows.items():
        for when, found in (("before", before), ("after", after)):
            judged = found.coverage.get(c)
            told = (
                (np.nan,) * 3
                if judged is None
                else (judged.share[LEVEL], judged.error[LEVEL], judged.mean_width)
            )
            row |= zip(
                (f"coverage_{when}", f"coverage_std_{when}", f"width_{when}"), told, strict=True
            )
    reasons = list(dict.fromkeys(r for r in (before.reason, after.reason) if r is not None))
    return {"confidence": LEVEL, "coefficients": rows, "reason": "; ".join(reasons) or None}
