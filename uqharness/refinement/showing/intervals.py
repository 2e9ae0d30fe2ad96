"""Model-form intervals around the model before and after a refinement: fitted on the train flights, judged on the test flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import AircraftReference, Coverage, ModelForm
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.files import inner_folder, write_bytes
from uqharness.identification import BoundsOptions, make_bounds, validate
from uqharness.replay import Flight, recut
from uqharness.simulator import Aircraft, content_hash

FOLDER = "intervals"
LEVEL = 0.95
_NAN = float("nan")


@dataclass(frozen=True)
class FlightSet:
    """Flights with the surfaces whose positions they carry and the SHA-256 of their files."""

    flights: tuple[Flight, ...]
    measured: tuple[str, ...]
    hashes: tuple[str, ...]


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
        train, test = ([recut(f, given.measured) for f in given.flights] for given in (job.train, job.test))
        options = BoundsOptions(ideal_servos=job.ideal_servos, checks=False, values=job.values)
        made = make_bounds(job.flown, train, job.train.measured, job.train.hashes, options).form
        form = replace(made, aircraft=AircraftReference(job.aircraft.name, content_hash(job.aircraft)))
        found = validate(job.flown, made, test, job.test.measured, job.test.hashes, job.ideal_servos, job.values)
    except (BadInputError, ValueError) as error:
        return Intervals(form, {}, str(error))
    return Intervals(form, dict(found.coverage))


def before_and_after(jobs: Sequence[IntervalJob], map_: Processes) -> tuple[Intervals, Intervals]:
    """Intervals of one or two models; a single one is both before and after."""
    found = list(map_(fit_intervals, jobs))
    return found[0], found[-1]


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
    rows = {}
    for c in COEFFICIENTS:
        row: dict[str, float] = {}
        for when, found in (("before", before), ("after", after)):
            judged = found.coverage.get(c)
            row |= {
                f"coverage_{when}": _NAN if judged is None else judged.share[LEVEL],
                f"coverage_std_{when}": _NAN if judged is None else judged.error[LEVEL],
                f"width_{when}": _NAN if judged is None else judged.mean_width,
            }
        rows[c] = row
    reasons = list(dict.fromkeys(r for r in (before.reason, after.reason) if r is not None))
    return {"confidence": LEVEL, "coefficients": rows, "reason": "; ".join(reasons) or None}
