"""What `next-flight` leaves: next-flight.json and the table of test points."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from sysid.model_form import MissingTerm
from uqharness.campaign import Winner
from uqharness.files import finite
from uqharness.next_flight import NextFlight, Occupancy, Prospect
from uqharness.report.next_flight_words import words

FORMAT = "next-flight 1"
COLUMNS = (
    "number",
    "start_s",
    "end_s",
    "speed_mps",
    "bank_deg",
    "kind",
    "control",
    "size",
    "unit",
    "unit_s",
    "pattern",
    "begins_s",
    "gain",
)


def document(
    found: NextFlight,
    winner: Winner,
    mission: Occupancy,
    missing: Sequence[MissingTerm] | None,
    air: Mapping[str, Any],
    units: Mapping[str, str],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """next-flight.json. air: aircraft, bounds and conditions of the simulated flight, as they are to be written."""
    return {
        "format": FORMAT,
        **air,
        "metric": winner.metric,
        "coefficient": found.coefficient,
        "share": list(winner.share),
        "certain": winner.certain,
        "verdict": "fly" if found.worth_flying else "no",
        "words": words(found, winner, missing),
        "mission": {
            "source": mission.source,
            "flights": mission.flights,
            "failed": mission.failed,
            "seconds": round(mission.seconds, 3),
            "outside_data": found.extrapolated,
        },
        "where": {
            w.state: {
                "data": w.data.tolist(),
                "mission": w.mission.tolist(),
                "variance": finite(w.variance.tolist()),
            }
            for w in found.where
        },
        "prospects": {c: prospect_row(p) for c, p in found.prospects.items()},
        "scatter": {"bounds": found.scatter, "simulated": finite(found.simulated_scatter)},
        "missing": None
        if missing is None
        else [{"term": m.name, "share": m.share} for m in missing],
        "flight_s": found.end_s,
        "points": [point_row(found, k, units) for k in range(len(found.plan))],
        "tried": found.tried,
        "refused": [{"point": r.point.name, "reason": r.reason} for r in found.refused],
        "warnings": list(warnings),
    }


def prospect_row(p: Prospect) -> dict[str, Any]:
    """Widths and narrowings of one coefficient."""
    return {
        "width": p.now.total,
        "width_after": p.then.total,
        "narrowing": p.narrowing,
        "narrowing_at_most": p.at_most,
        "narrowing_same_manoeuvres": 1.0 - p.naive.total / p.now.total,
        "width_redone": p.redone.total,
        "narrowing_redone": 1.0 - p.redone.total / p.now.total,
        "parameter_width": p.now.parameter,
        "parameter_width_after": p.then.parameter,
        "parameter_narrowing": p.parameter_narrowing,
        "parameter_narrowing_same_manoeuvres": 1.0 - p.naive.parameter / p.now.parameter,
    }


def point_row(found: NextFlight, k: int, units: Mapping[str, str]) -> dict[str, Any]:
    """One test point; its steps by control."""
    item = found.plan[k]
    return {
        "number": k + 1,
        "name": item.point.name,
        "start_s": item.start_s,
        "end_s": item.end_s,
        "speed_mps": item.point.condition.speed_mps,
        "bank_deg": item.point.condition.bank_deg,
        "steps": [
            {
                "control": s.control,
                "size": s.size,
                "unit": units[s.control],
                "unit_s": s.unit_s,
                "pattern": [[n, sign] for n, sign in s.pattern],
                "begins_s": s.start_s,
            }
            for s in item.point.steps
        ],
        "gain": item.gain,
    }


def points_csv(found: NextFlight, units: Mapping[str, str]) -> bytes:
    """test-points.csv: one row a control that a point moves, one row for steady flight."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for k, item in enumerate(found.plan):
        condition = item.point.condition
        speed = "" if condition.speed_mps is None else f"{condition.speed_mps:g}"
        head = [
            k + 1,
            f"{item.start_s:g}",
            f"{item.end_s:g}",
            speed,
            f"{condition.bank_deg:g}",
            item.point.kind,
        ]
        if not item.point.steps:
            writer.writerow([*head, "", "", "", "", "", "", f"{item.gain:.4g}"])
        for s in item.point.steps:
            pattern = " ".join(f"{'+' if sign > 0 else '-'}{n}" for n, sign in s.pattern)
            writer.writerow(
                [
                    *head,
                    s.control,
                    f"{s.size:g}",
                    units[s.control],
                    f"{s.unit_s:g}",
                    pattern,
                    f"{s.start_s:g}",
                    f"{item.gain:.4g}",
                ]
            )
    return buffer.getvalue().encode()
