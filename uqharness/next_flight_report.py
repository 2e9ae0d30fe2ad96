"""What `next-flight` leaves and says: next-flight.json, the table of test points, words."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

from uqharness.flight_prospects import Prospect
from uqharness.mission_states import Occupancy
from uqharness.next_flight import SENSORS, WORTH, NextFlight
from uqharness.sensitivity_winner import Winner

FORMAT = "next-flight 1"
COLUMNS = (
    "number", "start_s", "end_s", "speed_mps", "bank_deg", "kind", "control", "size", "unit", "unit_s", "pattern", "begins_s",
    "gain",
)  # fmt: skip
MOST = 0.9
"""Share of a flight's gain that its few most telling points have together."""
_DEGREES = 57.29577951308232


def document(
    found: NextFlight, winner: Winner, mission: Occupancy, air: Mapping[str, Any], units: Mapping[str, str],
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
        "words": words(found, winner),
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


def words(found: NextFlight, winner: Winner) -> list[str]:
    """The answer in sentences."""
    c, p = found.coefficient, found.prospect
    low, high = (100.0 * s for s in winner.share)
    sure = "certain" if winner.certain else "not certain"
    out = [
        f"{c} has {low:.0f} to {high:.0f} % of the p-box of {winner.metric} ({winner.condition}; its lead is {sure})."
    ]
    out.append(
        f"Where the mission flies its interval is {p.now.total:.3g} wide on average. {_percent(found.extrapolated)} of the mission "
        f"lies outside the data. Not knowing the polynomial gives {p.now.parameter:.3g} by itself, the scatter about it the rest."
    )
    flight = f"The flight of {found.end_s / 60.0:.1f} min narrows the interval by {_percent(p.narrowing)} (its parameter part by "
    flight += (
        f"{_percent(p.parameter_narrowing)}); as long a repetition of what was flown before, by "
        f"{_percent(1.0 - p.naive.total / p.now.total)} ({_percent(1.0 - p.naive.parameter / p.now.parameter)}); endless data "
        f"of the same kind, by {_percent(p.at_most)}."
    )
    shown = 1.0 - p.redone.total / p.now.total
    if abs(shown - p.narrowing) > 0.01:
        flight += (
            f" Bounds made again will show {_percent(shown)}, because residuals scatter differently at the speeds of these points; "
            "that difference is no knowledge."
        )
    out.append(flight)
    out.append(_first_points(found))
    if not found.worth_flying:
        out.append(_why_not(found, p))
    others = [
        f"{name} {_percent(o.narrowing)}" for name, o in found.prospects.items() if name != c and o.narrowing >= WORTH
    ]
    if others:
        out.append(f"The same flight narrows {', '.join(others)}.")
    return out


def _first_points(found: NextFlight) -> str:
    """How few of the points bring most of it."""
    order = sorted(range(len(found.plan)), key=lambda k: -found.plan[k].gain)
    total, gained, few = sum(p.gain for p in found.plan), 0.0, list[int]()
    for k in order:
        few.append(k)
        gained += found.plan[k].gain
        if gained >= MOST * total:
            break
    numbers = ", ".join(str(k + 1) for k in sorted(few))
    what = f"point {numbers} brings" if len(few) == 1 else f"points {numbers} bring"
    return (
        f"Of what the flight takes off the mean width {what} {_percent(gained / total)}; a short flight would be those."
    )


def _why_not(found: NextFlight, p: Prospect) -> str:
    if p.at_most >= WORTH:
        return (
            f"Not worth flying for {found.coefficient} alone ({_percent(WORTH)} is asked for): more minutes would bring up to "
            f"{_percent(p.at_most)}."
        )
    text = (
        f"More data cannot narrow this interval: {_percent(1.0 - p.at_most)} of its width is scatter about the polynomial, which "
        "stays. "
    )
    ratio = found.scatter / found.simulated_scatter
    if not math.isfinite(ratio):
        return text + "Whether that is noise or form, a longer --minutes would tell."
    if ratio > SENSORS:
        return (
            text
            + f"It is {ratio:.1f} times what the model's own sensors and air give ({found.simulated_scatter:.2g}): a term is "
            "missing, or the air was rougher than simulated (--turbulence). Look for the term instead: uqharness refine on the "
            f"flights behind the bounds, or further states in the bounds of {found.coefficient} (uqharness bounds --states "
            f"{found.coefficient}=...)."
        )
    return (
        text
        + f"It is {ratio:.1f} times what the model's own sensors and air give ({found.simulated_scatter:.2g}): calmer air, "
        "better sensors or a lower --cutoff-hz of the bounds narrow it, no manoeuvre does."
    )


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


def report(found: NextFlight, doc: Mapping[str, Any], table: str, where: str, command: str) -> str:
    """report.md."""
    lines = [
        f"# Next test flight for {found.coefficient} of {doc['aircraft']['name']}", "", f"    {command}", "",
        *(f"- {w}" for w in doc["words"]), "", "## Where", "", where,
        ("Quartiles (25, 50, 75 %): of the data behind the bounds, of the mission, and of the mission weighted by the prediction "
        "variance."),
        "", "## What to fly", "", table,
        (f"`uqharness fly {doc['aircraft']['name']} --script next-flight.xml --out FILE` flies it in simulation; test-points.csv "
        "is the same for an operator. *gain*: share of the mean width that the point takes, given those chosen before it."), "",
        "![next flight](figures/next-flight.svg)", "",
    ]  # fmt: skip
    lines += [f"- warning: {w}" for w in doc["warnings"]]
    return "\n".join(lines) + "\n"


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _clean(values: Sequence[float]) -> list[float | None]:
    return [_number(v) for v in values]
