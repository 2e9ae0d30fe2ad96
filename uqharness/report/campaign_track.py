"""Ground tracks of a campaign's page: of the flights whose records stand in the folder, as `campaign rerun` leaves them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from uqharness.campaign import hardest_of, in_condition
from uqharness.campaign.conditions import conditions
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.report.ground_track import flown_track
from uqharness.report.parts import Block, Facts, Figure, Figures, Section, Words

MOST_TRACKS = 4
"""Tracks in the page: of the flights farthest from their path."""
_WORST = "cross_track_median_m"
_COLUMNS = ("time_s", "north_m", "east_m", "error_cross_track")


def track_section(folder: Path, frame: pd.DataFrame, prefix: str = "") -> tuple[Section, ...]:
    """The tracks of flights flown again, or the command that flies the worst one again; none for a mission without a path.

    frame: cases.parquet, one row a flight. A record that cannot be read is told.
    """
    if _WORST not in frame or not frame[_WORST].notna().any():
        return ()
    rows = frame.assign(far=frame[_WORST].fillna(np.inf)).sort_values(
        ["far", "case_id"], ascending=[False, True]
    )
    found: list[Figure] = []
    said: list[Block] = []
    kept = {
        path.parent.name: path
        for path in (folder / "rerun").glob("*/record.parquet")
        if path.is_file()
    }
    rows = rows[rows["case_id"].astype(str).isin(list(kept))]
    for case_id, epistemic_id, wind, air in rows[
        ["case_id", "epistemic_id", "wind_mps", "turbulence"]
    ].itertuples(index=False):
        if len(found) == MOST_TRACKS:
            break
        path = kept[str(case_id)]
        try:
            figure = _track(
                path,
                f"{prefix}track-{case_id}",
                f"Case {case_id}: {epistemic_id}, {float(wind):g} m/s {air}.",
            )
        except BadInputError as error:
            said.append(Words(str(error)))
            continue
        if figure is not None:
            found.append(figure)
    if found:
        text = "Flights of the campaign that were flown again, the largest median cross-track error first."
        return (
            Section(
                "Ground track", (Words(text, note=True), *said, Figures(tuple(found), file=""))
            ),
        )
    worst = worst_case(frame)
    text = "No record of a flight stands in this folder. The worst flight of the hardest condition is flown again, and drawn here, by:"
    commands = (
        ("Fly", f"uqharness campaign rerun DIR --case {worst}"),
        ("Report", "uqharness campaign report DIR"),
    )
    return (Section("Ground track", (*said, Words(text, note=True), Facts(commands))),)


def shown_cases(frame: pd.DataFrame) -> tuple[str, ...]:
    """Cases whose tracks a page should show: of the flights of the hardest condition with a known median cross-track error the one
    with the largest and the one in the middle; fewer where there are fewer, none for a mission without a path."""
    if _WORST not in frame or not frame[_WORST].notna().any():
        return ()
    rows = in_condition(frame, hardest_of(conditions(frame)))
    known = rows[rows[_WORST].notna()].sort_values([_WORST, "case_id"], ascending=[False, True])
    return (
        tuple(str(case) for case in dict.fromkeys(known["case_id"].iloc[[0, len(known) // 2]]))
        if len(known)
        else ()
    )


def worst_case(frame: pd.DataFrame) -> str:
    """Case with the largest median cross-track error that is known in the hardest condition, the first by its id among equals."""
    rows = in_condition(frame, hardest_of(conditions(frame)))
    known = rows[rows[_WORST].notna()]
    rows = rows if known.empty else known.sort_values([_WORST, "case_id"], ascending=[False, True])
    return str(rows["case_id"].iloc[0])


def _track(path: Path, name: str, words: str) -> Figure | None:
    table = read_table(path).to_pandas()
    columns = {n: table[n].to_numpy(dtype=float) for n in _COLUMNS if n in table}
    if "error_cross_track" in columns:
        columns["cross_track_m"] = columns.pop("error_cross_track")
    return flown_track(name, columns, words)
