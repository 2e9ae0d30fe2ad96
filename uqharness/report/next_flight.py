"""What `next-flight` leaves and says: next-flight.json, the table of test points, words."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

from sysid.model_form.missing_terms import MissingTerm
from uqharness.campaign.sensitivity_winner import Winner
from uqharness.next_flight.mission_states import Occupancy
from uqharness.next_flight.plan import NextFlight
from uqharness.next_flight.prospects import Prospect
from uqharness.report.next_flight_words import words

FORMAT = "next-flight 1"
COLUMNS = (
    "number", "start_s", "end_s", "speed_mps", "bank_deg", "kind", "control", "size", "unit", "unit_s", "pattern", "begins_s",
    "gain",
)  # fmt: skip
_DEGREES = 57.29577951308232


def document(
    found: NextFlight, winner: Winner, mission: Occupancy, missing: Sequence[MissingTerm] | None,
    air: Mapping[str, Any], units: Mapping[str, str],
    warnings: Sequence[str],
) -> dict[str, Any]:  # fmt: skip
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
            "source": mission.source, "flights": mission.flights, "failed": mission.failed,
            "seconds": round(mission.seconds, 3), "outside_data": found.extrapolated,
        },
        "where": {
            w.state: {"data": w.data.tolist(), "mission": w.mission.tolist(), "variance": _clean(w.variance.tolist())}
            for w in found.where
        },
        "prospects": {c: prospect_row(p) for c, p in found.prospects.items()},
        "scatter": {"bounds": found.scatter, "simulated": _number(found.simulated_scatter)},
        "missing": None if missing is None else [{"term": m.name, "share": m.share} for m in missing],
        "flight_s": found.end_s,
        "points": [point_row(found, k, units) for k in range(len(found.plan))],
        "tried": found.tried,
        "refused": [{"point": r.point.name, "reason": r.reason} for r in found.refused],
        "warnings": list(warnings),
    }  # fmt: skip


def prospect_row(p: Prospect) -> dict[str, Any]:
    """Widths and narrowings of one coefficient."""
    return {
        "width": p.now.total, "width_after": p.then.total, "narrowing": p.narrowing, "narrowing_at_most": p.at_most,
        "narrowing_same_manoeuvres": 1.0 - p.naive.total / p.now.total,
        "width_redone": p.redone.total,
        "narrowing_redone": 1.0 - p.redone.total / p.now.total, "parameter_width": p.now.parameter,
        "parameter_width_after": p.then.parameter, "parameter_narrowing": p.parameter_narrowing,
        "parameter_narrowing_same_manoeuvres": 1.0 - p.naive.parameter / p.now.parameter,
    }  # fmt: skip


def point_row(found: NextFlight, k: int, units: Mapping[str, str]) -> dict[str, Any]:
    """One test point; its steps by control."""
    item = found.plan[k]
    return {
        "number": k + 1, "name": item.point.name, "start_s": item.start_s, "end_s": item.end_s,
        "speed_mps": item.point.condition.speed_mps, "bank_deg": item.point.condition.bank_deg,
        "steps": [
            {
                "control": s.control, "size": s.size, "unit": units[s.control], "unit_s": s.unit_s,
                "pattern": [[n, sign] for n, sign in s.pattern], "begins_s": s.start_s,
            }
            for s in item.point.steps
        ],
        "gain": item.gain,
    }  # fmt: skip


def points_csv(found: NextFlight, units: Mapping[str, str]) -> bytes:
    """test-points.csv: one row a control that a point moves, one row for steady flight."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for k, item in enumerate(found.plan):
        condition = item.point.condition
        speed = "" if condition.speed_mps is None else f"{condition.speed_mps:g}"
        head = [k + 1, f"{item.start_s:g}", f"{item.end_s:g}", speed, f"{condition.bank_deg:g}", item.point.kind]
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


def where_rows(found: NextFlight) -> list[dict[str, str]]:
    """Quartiles of each state: in the data, in the mission, of the uncertainty there; angles in degrees."""
    out = []
    for w in found.where:
        degrees = _DEGREES if w.state.endswith(("_rad", "_radps")) else 1.0
        unit = w.state.rsplit("_", 1)[1].replace("radps", "deg/s").replace("rad", "deg").replace("mps", "m/s")
        row = {"state": w.state.rsplit("_", 1)[0], "unit": unit}
        for name, values in (("data", w.data), ("mission", w.mission), ("uncertainty", w.variance)):
            row[name] = " / ".join(f"{degrees * v:.3g}" for v in values)
        out.append(row)
    return out


def point_rows(found: NextFlight) -> list[dict[str, str]]:
    """Test points for a terminal or a report."""
    return [
        {
            "": str(k), "from": f"{p.start_s:.0f} s", "point": p.point.name,
            "unit": ", ".join(f"{s.unit_s:g} s" for s in p.point.steps) or "-", "gain": f"{100 * p.gain:.2g} %",
        }
        for k, p in enumerate(found.plan, start=1)
    ]  # fmt: skip


def report(found: NextFlight, doc: Mapping[str, Any], table: str, where: str, command: str, figure: bool) -> str:
    """report.md."""
    lines = [
        f"# Next test flight for {found.coefficient} of {doc['aircraft']['name']}", "", f"    {command}", "",
        *(f"- {w}" for w in doc["words"]), "", "## Where", "", where,
        ("Quartiles (25, 50, 75 %): of the data behind the bounds, of the mission, and of the mission weighted by the prediction "
        "variance."),
        "", "## What to fly", "", table,
        (f"`uqharness fly {doc['aircraft']['name']} --script next-flight.xml --out FILE` flies it in simulation; test-points.csv "
        "is the same for an operator. *gain*: share of the mean width that the point takes, given those chosen before it."), "",
        *(["![next flight](figures/next-flight.svg)", ""] if figure else []),
    ]  # fmt: skip
    lines += [f"- warning: {w}" for w in doc["warnings"]]
    return "\n".join(lines) + "\n"


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _clean(values: Sequence[float]) -> list[float | None]:
    return [_number(v) for v in values]
