"""What a campaign's page says of the engine that flew it, and of the flights that JSBSim flew as its judge."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from uqharness.campaign import TOLERANCE, engine_words
from uqharness.campaign.folder import STATUS, WHOLE, CheckRow, as_number
from uqharness.report.parts import Block, Section, Table, Words

_NAMES: Mapping[str, str] = {"batch": "the batch engine", "jsbsim": "JSBSim"}


def engine_section(manifest: Mapping[str, Any], rows: Sequence[CheckRow]) -> Section:
    """Which engine flew, why, and how far it is from JSBSim."""
    engine = manifest["campaign"]["campaign"]["engine"]
    why = tuple(manifest.get("engine", {}).get("why", ()))
    said = engine_words(_NAMES[engine], why)
    blocks: list[Block] = [Words(f"Flown in {said}.")]
    whole = [row for row in rows if row.part == WHOLE]
    if engine == "batch":
        flights = len({row.case_id for row in whole})
        text = (
            f"{flights} whole flights, and the first seconds of some of each condition, were flown in JSBSim as well. A difference "
            f"is measured by the metric's spread over the condition's flights; at {TOLERANCE:g} of it the campaign would have "
            "stopped. engine-check.csv has every row."
        )
        blocks += [Words(text, note=True), *_tables(whole)]
    return Section("Engine", tuple(blocks))


def _tables(rows: Sequence[CheckRow]) -> list[Block]:
    by_metric: dict[str, list[CheckRow]] = {}
    for row in rows:
        if row.difference or row.metric == STATUS:
            by_metric.setdefault(row.metric, []).append(row)
    if not by_metric:
        return []
    head = ("Metric", "Flights", "Largest difference over spread", "Excused")
    return [
        Table(
            "The batch engine against JSBSim.",
            head,
            tuple(_row(name, found) for name, found in by_metric.items()),
        )
    ]


def _row(name: str, rows: Sequence[CheckRow]) -> tuple[str, ...]:
    excused = [row for row in rows if row.verdict == "excused"]
    why = "; ".join(dict.fromkeys(row.remark for row in excused))
    shares = [as_number(row.difference) for row in rows if row.verdict != "excused"]
    known = [share for share in shares if not math.isnan(share)]
    largest = "" if name == STATUS else f"{max(known):.2g}" if known else "undefined"
    return (name, str(len(rows)), largest, f"{len(excused)} ({why})" if excused else "0")
