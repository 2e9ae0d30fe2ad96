"""P-box of a mission before and after a refinement.

A small campaign flies each model within its own intervals, in the same air.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import AircraftReference, Coverage, ModelForm
from uqharness.campaign import (
    ERROR_METRICS,
    MANIFEST,
    OPTIONAL_METRICS,
    CampaignSpec,
    ProcessExecutor,
    Progress,
    campaign_from,
    describe,
    find_mission,
    has_digests,
    in_condition,
    read_campaign,
    read_cases,
    read_complete,
    read_manifest,
    refuse_if_different,
    run_campaign,
    samples,
)
from uqharness.campaign.conditions import conditions
from uqharness.errors import BadInputError
from uqharness.files import inner_folder, write_bytes
from uqharness.heartbeat import Callback, silent
from uqharness.identification import BoundsOptions, make_bounds, validate
from uqharness.parallel import usable_cores
from uqharness.replay import Flight, cut_for_residuals
from uqharness.results.refinement import Interval, Mission, MissionFlights, MissionMetric
from uqharness.results.refinement import Intervals as IntervalsDocument
from uqharness.simulator import (
    STEADY,
    Aircraft,
    content_hash,
    engine,
    find_script,
    open_aircraft,
    read_script,
)
from uqharness.statistics import Sample, envelope
from uqharness.toml import read_toml

# What a mission came to with the model before and after a refinement: two p-boxes of every
# metric.

PBOX_FOLDER = "pbox"
PROBABILITIES = (0.05, 0.5, 0.95)


def pbox_pair(before: Sequence[Sample], after: Sequence[Sample]) -> dict[str, Any]:
    """Return quantiles and widths of one metric's p-boxes before and after.

    The p-boxes come from the samples of every corner. A quantile is an interval, with NaN at an end
    that failed flights leave open. A width is the area between the envelopes over the range that
    both models reach, in the metric's unit.
    """
    value = np.unique(np.concatenate([s.values for s in (*before, *after)]))
    boxes = {
        when: envelope(samples, value) for when, samples in (("before", before), ("after", after))
    }

    def reached(side: np.ndarray[Any, np.dtype[np.float64]], probability: float) -> float:
        """Return the value at which a side reaches a probability; NaN if it does not."""
        at = np.flatnonzero(side >= probability - 1e-12)
        return float(value[at[0]]) if at.size else float("nan")

    return {
        "quantiles": {
            f"{p:g}": {
                when: [reached(upper, p), reached(lower, p)]
                for when, (lower, upper) in boxes.items()
            }
            for p in PROBABILITIES
        },
        **{
            f"width_{when}": float(np.sum((upper - lower)[:-1] * np.diff(value)))
            for when, (lower, upper) in boxes.items()
        },
    }


def no_pbox(reason: str) -> Mission:
    """Return the document of a mission that was not flown."""
    return Mission(reason=reason, metrics=[])


LOITER = "scripts/loiter.xml"
_DEFAULT: dict[str, Any] = {
    "campaign": {"aircraft": "", "mission": LOITER, "seed": 20161201},
    "aleatory": {
        "flights": 3,
        "duration_s": 30.0,
        "burn_in_s": 30.0,
        "wind_mps": 3.0,
        "wind_from_deg": 270.0,
        "turbulence": "light",
        "sensor_noise": True,
    },
    "epistemic": {"method": "corners"},
    "metrics": {"excursion_radius_m": [15.0, 25.0], "rearm_m": 2.0},
}
"""A lap of the loiter to settle and one that is scored, three times at each of the 64 corners: half
a minute of one core.
"""


def campaign_for(aircraft: Aircraft, campaign: Path | None) -> dict[str, Any]:
    """Return the campaign as a campaign file holds it.

    Raises BadInputError if the aircraft has no mission of its own.
    """
    if campaign is not None:
        read_campaign(campaign)
        data, _ = read_toml(campaign)
        if data["campaign"]["mission"] != STEADY:
            data["campaign"]["mission"] = str(
                find_script(data["campaign"]["mission"], campaign.resolve().parent)
            )
        if data["epistemic"]["method"] == "none":
            raise BadInputError(
                f'{campaign}: [epistemic] method = "none" ignores the intervals; use "corners",'
                " all combinations of their ends"
            )
        if isinstance(fit := data["epistemic"].get("parameters", {}).get("fit"), str):
            data["epistemic"]["parameters"]["fit"] = str(
                (campaign.resolve().parent / fit).resolve()
            )
        return data
    script = read_script(find_script(LOITER))
    start = aircraft.folder / f"{script.initialize}.xml"
    if "cross_track" not in aircraft.card.metrics or not start.is_file():
        raise BadInputError(
            f"aircraft '{aircraft.name}' has no loiter: {LOITER} needs the initial conditions"
            f" {script.initialize}.xml, an autopilot and a card whose [metrics] name cross_track;"
            " give a mission by --campaign"
        )
    fdm = open_aircraft(aircraft)
    engine.require(fdm, [n for n in script.run_properties if n.startswith("ap/")])
    return {**_DEFAULT, "campaign": _DEFAULT["campaign"] | {"mission": str(find_script(LOITER))}}


def specification(data: Mapping[str, Any], aircraft: Aircraft, form: Path) -> CampaignSpec:
    """Return the campaign with an aircraft and its intervals' file.

    Relative names are resolved beside that file. Raises BadInputError.
    """
    campaign = {**data["campaign"], "aircraft": str(aircraft.folder)}
    # Corners alone unless the campaign says otherwise: what is compared is the same set of samples
    # before and after.
    epistemic = {"interior": 0, "nominal": False, **data["epistemic"], "bounds": form.name}
    return campaign_from(
        {**data, "campaign": campaign, "epistemic": epistemic}, form.with_suffix(".toml")
    )


def fly_missions(
    models: Mapping[str, Aircraft],
    forms: Mapping[str, Path],
    campaign: Path | None,
    out: Path,
    workers: int | None,
    callback: Callback = silent,
) -> Mission:
    """Fly the campaign with each model within its intervals, and return gap.test.pbox.

    ``models`` are (before, after), or one for both; ``forms`` are their intervals. The campaigns
    are kept in ``out``/pbox/<name>. An interrupted run continues; a folder of another campaign is
    made anew. If a mission cannot be flown, the document says why.
    """
    executor = ProcessExecutor(workers or usable_cores(), keep=True)
    frames: dict[str, pd.DataFrame] = {}
    with contextlib.closing(executor):
        try:
            data = campaign_for(next(iter(models.values())), campaign)
            for name, aircraft in models.items():
                spec = specification(data, aircraft, forms[name])
                folder = inner_folder(out, PBOX_FOLDER, name)
                _clear_if_other(folder, spec)
                run_campaign(
                    spec,
                    folder,
                    executor=executor,
                    on_progress=_stage_of(callback, name),
                    command="uqharness refine",
                )
                frames[name] = read_cases(folder, read_complete(folder))
        except BadInputError as error:
            return no_pbox(str(error))
    every = list(frames.values())
    return _document(spec, [f"{PBOX_FOLDER}/{name}" for name in models], every[0], every[-1])


def _clear_if_other(folder: Path, spec: CampaignSpec) -> None:
    """Remove the campaign of an earlier refinement with another model or other intervals.

    Raises BadInputError for a damaged one, and for a mission that cannot be flown.
    """
    if not (folder / MANIFEST).is_file():
        return
    manifest, requested = read_manifest(folder), describe(spec, find_mission(spec, folder), 0, "")
    with contextlib.suppress(BadInputError):
        refuse_if_different(folder, manifest, requested)
        if has_digests(manifest):
            return
    shutil.rmtree(folder)


def _stage_of(callback: Callback, name: str) -> Callable[[Progress], None]:
    """Return a callback that reports a campaign's progress by name."""
    quarters = set[int]()

    def update(progress: Progress) -> None:
        """Report the progress."""
        quarter = 4 * progress.done // max(progress.cases, 1)
        if quarter and quarter not in quarters:
            quarters.add(quarter)
            callback(f"mission {name}: {progress.done} of {progress.cases} flights")

    return update


def _rows(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[MissionMetric]:
    """Yield the rows of metrics."""
    for metric in (*ERROR_METRICS, *OPTIONAL_METRICS):
        if metric.endswith("_measured") or metric not in before or metric not in after:
            continue
        for condition in conditions(before):
            pair = [samples(in_condition(frame, condition), metric) for frame in (before, after)]
            if all(any(s.values.size for s in condition_samples) for condition_samples in pair):
                yield MissionMetric(metric=metric, condition=condition.label, **pbox_pair(*pair))


def _document(
    spec: CampaignSpec, folders: list[str], before: pd.DataFrame, after: pd.DataFrame
) -> Mission:
    """Return the document of the campaigns."""

    def count(frame: pd.DataFrame) -> MissionFlights:
        """Return the numbers of flights."""
        return MissionFlights(
            flights=len(frame),
            failed=int((frame["status"] != "ok").sum()),
            loss_of_control=int(frame["loss_of_control"].fillna(0).sum()),
            extrapolated_share=float(frame["extrapolated_share"].mean()),
        )

    air = spec.aleatory
    return Mission(
        reason=None,
        mission=Path(spec.campaign.mission).name,
        corners=int(before["epistemic_id"].nunique()),
        flights_per_corner=air.flights,
        duration_s=air.duration_s,
        before=count(before),
        after=count(after),
        folders=folders,
        metrics=list(_rows(before, after)),
    )


# Model-form intervals around the model before and after a refinement: fitted on the train
# flights, judged on the hold-out flights.

INTERVALS_FOLDER = "intervals"
LEVEL = 0.95


@dataclass(frozen=True)
class FlightSet:
    """Flights, the surfaces whose positions they hold, SHA-256 of their files, and ideal
    controls.
    """

    flights: tuple[Flight, ...]
    measured: tuple[str, ...]
    hashes: tuple[str, ...]
    ideal: tuple[str, ...] = ()


@dataclass(frozen=True)
class IntervalJob:
    """A model whose intervals are made from ``train`` and validated on ``test``.

    ``simulated`` is the aircraft that flies as the model if its properties have ``values``.
    """

    aircraft: Aircraft
    simulated: Aircraft
    values: Mapping[str, float]
    train: FlightSet
    test: FlightSet
    ideal_servos: bool


@dataclass(frozen=True)
class Intervals:
    """A model's intervals and their coverage of the hold-out flights, or the reason why there
    are none.
    """

    form: ModelForm | None
    coverage: dict[str, Coverage]
    reason: str | None = None


def fit_intervals(job: IntervalJob) -> Intervals:
    """Make intervals as `uqharness bounds` and validate them as `validate-bounds`."""
    form: ModelForm | None = None
    try:
        train, test = (
            [cut_for_residuals(f, flight_set.measured) for f in flight_set.flights]
            for flight_set in (job.train, job.test)
        )
        options = BoundsOptions(ideal_servos=job.ideal_servos, checks=False, values=job.values)
        fitted = make_bounds(
            job.simulated, train, job.train.measured, job.train.hashes, options
        ).form
        form = replace(
            fitted, aircraft=AircraftReference(job.aircraft.name, content_hash(job.aircraft))
        )
        validation = validate(
            job.simulated,
            fitted,
            test,
            job.test.measured,
            job.test.hashes,
            ideal_servos=job.ideal_servos,
            values=job.values,
        )
    except (BadInputError, ValueError) as error:
        return Intervals(form, {}, str(error))
    return Intervals(form, dict(validation.coverage))


def write_forms(intervals_by_model: Mapping[str, Intervals], out: Path) -> dict[str, Path]:
    """Write ``out``/intervals/<name>.json for every model with intervals; return the paths by
    name.
    """
    paths = {}
    for name, intervals in intervals_by_model.items():
        if intervals.form is not None:
            paths[name] = inner_folder(out, INTERVALS_FOLDER) / f"{name}.json"
            write_bytes(paths[name], intervals.form.to_json().encode())
    return paths


def intervals_document(before: Intervals, after: Intervals) -> IntervalsDocument:
    """Return gap.test.intervals of refinement.json: NaN, with the reason, for undefined values."""
    rows: dict[str, dict[str, float]] = {c: {} for c in COEFFICIENTS}
    for c, row in rows.items():
        for when, intervals in (("before", before), ("after", after)):
            coverage = intervals.coverage.get(c)
            numbers = (
                (np.nan,) * 3
                if coverage is None
                else (coverage.share[LEVEL], coverage.error[LEVEL], coverage.mean_width)
            )
            row |= zip(
                (f"coverage_{when}", f"coverage_std_{when}", f"width_{when}"), numbers, strict=True
            )
    reasons = list(dict.fromkeys(r for r in (before.reason, after.reason) if r is not None))
    return IntervalsDocument(
        confidence=LEVEL,
        coefficients={c: Interval(**row) for c, row in rows.items()},
        reason="; ".join(reasons) or None,
    )
