"""A mission's p-box before and after a refinement: a small campaign with each model inside its own intervals, in the same air."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from uqharness.campaign import (
    ERROR_METRICS,
    UNCOMMANDED_METRICS,
    Progress,
    find_mission,
    in_condition,
    run_campaign,
    samples,
)
from uqharness.campaign.conditions import conditions
from uqharness.campaign.execution import ProcessExecutor
from uqharness.campaign.folder import (
    MANIFEST,
    describe,
    has_digests,
    read_cases,
    read_complete,
    read_manifest,
    refuse_if_different,
)
from uqharness.campaign.spec import CampaignSpec, campaign_from, read_campaign
from uqharness.errors import BadInputError
from uqharness.files import inner_folder
from uqharness.parallel import usable_cores
from uqharness.refinement.showing.pboxes import FOLDER, both_boxes, no_pbox
from uqharness.simulator import STEADY, Aircraft, engine, find_script, open_aircraft, read_script
from uqharness.toml import read_toml

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
"""A lap of the loiter to settle and one that is scored, three times at each of the 64 corners: half a minute of one core."""
Say = Callable[[str], None]


def campaign_for(aircraft: Aircraft, given: Path | None) -> dict[str, Any]:
    """What is flown, as a campaign file holds it. Raises BadInputError where the aircraft has no mission of its own."""
    if given is not None:
        read_campaign(given)
        data, _ = read_toml(given)
        if data["campaign"]["mission"] != STEADY:
            data["campaign"]["mission"] = str(
                find_script(data["campaign"]["mission"], given.resolve().parent)
            )
        if data["epistemic"]["method"] == "none":
            raise BadInputError(
                f'{given}: [epistemic] method = "none" flies no intervals; "corners" flies every combination of their ends'
            )
        if isinstance(fit := data["epistemic"].get("parameters", {}).get("fit"), str):
            data["epistemic"]["parameters"]["fit"] = str((given.resolve().parent / fit).resolve())
        return data
    script = read_script(find_script(LOITER))
    start = aircraft.folder / f"{script.initialize}.xml"
    if "cross_track" not in aircraft.card.metrics or not start.is_file():
        raise BadInputError(
            f"aircraft '{aircraft.name}' has no loiter of its own: {LOITER} needs the initial conditions "
            f"{script.initialize}.xml, an autopilot and a card whose [metrics] name cross_track; give a mission by --campaign"
        )
    fdm = open_aircraft(aircraft)
    engine.require(fdm, [n for n in script.run_properties if n.startswith("ap/")])
    return {**_DEFAULT, "campaign": _DEFAULT["campaign"] | {"mission": str(find_script(LOITER))}}


def specification(data: Mapping[str, Any], aircraft: Aircraft, form: Path) -> CampaignSpec:
    """The campaign with an aircraft and its intervals' file, beside which relative names are looked for. Raises BadInputError."""
    campaign = {**data["campaign"], "aircraft": str(aircraft.folder)}
    # Corners alone unless the campaign says otherwise: what is compared is the same set of samples before and after.
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
    say: Say = lambda _: None,
) -> dict[str, Any]:
    """gap.test.pbox of refinement.json: the campaign flown with each of ``models`` (before, after; a single one is both) within
    its intervals, those of ``forms``, in ``out``/pbox/<name>.

    A run that was killed goes on; a folder with another campaign in it is made anew. What stands in the way of a mission is
    its reason.
    """
    executor = ProcessExecutor(workers or usable_cores(), keep=True)
    frames: dict[str, pd.DataFrame] = {}
    with contextlib.closing(executor):
        try:
            data = campaign_for(next(iter(models.values())), campaign)
            for name, aircraft in models.items():
                spec = specification(data, aircraft, forms[name])
                folder = inner_folder(out, FOLDER, name)
                _clear_if_other(folder, spec)
                run_campaign(
                    spec,
                    folder,
                    executor=executor,
                    on_progress=_told(say, name),
                    command="uqharness refine",
                )
                frames[name] = read_cases(folder, read_complete(folder))
        except BadInputError as error:
            return no_pbox(str(error))
    every = list(frames.values())
    return _document(spec, [f"{FOLDER}/{name}" for name in models], every[0], every[-1])


def _clear_if_other(folder: Path, spec: CampaignSpec) -> None:
    """Remove an earlier refinement's campaign, whose model or intervals were others. Raises BadInputError for a damaged one, and
    for a mission that cannot be flown."""
    if not (folder / MANIFEST).is_file():
        return
    manifest, wanted = read_manifest(folder), describe(spec, find_mission(spec, folder), 0, "")
    with contextlib.suppress(BadInputError):
        refuse_if_different(folder, manifest, wanted)
        if has_digests(manifest):
            return
    shutil.rmtree(folder)


def _told(say: Say, name: str) -> Callable[[Progress], None]:
    quarters = set[int]()

    def tell(progress: Progress) -> None:
        quarter = 4 * progress.done // max(progress.cases, 1)
        if quarter and quarter not in quarters:
            quarters.add(quarter)
            say(f"mission {name}: {progress.done} of {progress.cases} flights")

    return tell


def _rows(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[dict[str, Any]]:
    for metric in (*ERROR_METRICS, *UNCOMMANDED_METRICS):
        if metric.endswith("_measured") or metric not in before or metric not in after:
            continue
        for condition in conditions(before):
            pair = [samples(in_condition(frame, condition), metric) for frame in (before, after)]
            if all(any(s.values.size for s in found) for found in pair):
                yield {"metric": metric, "condition": condition.label, **both_boxes(*pair)}


def _document(
    spec: CampaignSpec, folders: list[str], before: pd.DataFrame, after: pd.DataFrame
) -> dict[str, Any]:
    def count(frame: pd.DataFrame) -> dict[str, float]:
        return {
            "flights": len(frame),
            "failed": int((frame["status"] != "ok").sum()),
            "loss_of_control": int(frame["loss_of_control"].fillna(0).sum()),
            "extrapolated_share": float(frame["extrapolated_share"].mean()),
        }

    air = spec.aleatory
    return {
        "reason": None,
        "mission": Path(spec.campaign.mission).name,
        "corners": int(before["epistemic_id"].nunique()),
        "flights_per_corner": air.flights,
        "duration_s": air.duration_s,
        "before": count(before),
        "after": count(after),
        "folders": folders,
        "metrics": list(_rows(before, after)),
    }
