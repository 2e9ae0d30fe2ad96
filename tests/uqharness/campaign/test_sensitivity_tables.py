"""sensitivity.csv written, read back, and refused where it is not as it was written."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest

from sysid.foreign.regular_files import sha256_hex
from uqharness.campaign.conditions import Condition
from uqharness.campaign.manifest import DamageError
from uqharness.campaign.sensitivity import (
    COLUMNS,
    SENSITIVITY,
    MetricSensitivity,
    as_csv,
    read_sensitivity,
    shares_by_condition,
)
from uqharness.errors import BadInputError
from uqharness.sensitivity.result import Index, MethodResult, PairRange, Ranking, all_undefined

RANGES = {"CX": (0.2, 0.3), "Cm": (0.7, 0.8)}


def found() -> list[MetricSensitivity]:
    indices = {
        n: PairRange(Index(a, a - 0.1, a), Index(b, b, math.nan)) for n, (a, b) in RANGES.items()
    }
    shrink = {f"shrink_{end}": np.array([0.1, 0.6]) for end in ("min", "max", "low", "high")}
    details = {"area": 12.0, "area_low": 11.0, "area_high": 13.0, **shrink}
    result = MethodResult("proposed", 8, indices, True, "s", details)
    one = MetricSensitivity(
        Condition(3.0, "moderate"),
        "speed_max_mps",
        result,
        20,
        1,
        Ranking("Cm", ("CX",)),
        "reduce Cm first",
    )
    nothing = all_undefined("proposed", RANGES, "no width")
    return [
        one,
        MetricSensitivity(
            Condition(5.0, "none"), "altitude_max_m", nothing, 20, 0, Ranking(""), "undefined"
        ),
    ]


def manifest(content: bytes) -> dict:
    return {"format": 2, "state": "complete", "tables": {SENSITIVITY: sha256_hex(content)}}


def test_a_row_a_coefficient_and_nothing_where_it_is_undefined(tmp_path):
    content = as_csv(found())
    rows = list(csv.DictReader(io.StringIO(content.decode())))
    assert tuple(rows[0]) == COLUMNS
    assert [(r["condition"], r["coefficient"]) for r in rows] == [
        ("3 m/s moderate", "CX"),
        ("3 m/s moderate", "Cm"),
        ("5 m/s none", "CX"),
        ("5 m/s none", "Cm"),
    ]
    assert (rows[1]["share_min"], rows[1]["share_high"], rows[1]["unit"], rows[1]["width"]) == (
        "0.7",
        "",
        "m/s",
        "12",
    )
    assert (rows[2]["share_min"], rows[2]["reason"]) == ("", "no width")
    (tmp_path / SENSITIVITY).write_bytes(content)
    assert read_sensitivity(tmp_path, manifest(content)) == rows


def test_the_json_tells_who_comes_first():
    shares = shares_by_condition(found())
    speed = shares["3 m/s moderate"]["speed_max_mps"]
    assert (speed.first, speed.rivals_by_ranges, speed.certain) == ("Cm", ["CX"], False)
    assert shares["5 m/s none"]["altitude_max_m"].first is None
    # Undefined numbers are null in JSON.
    json.dumps([s.as_json() for c in shares.values() for s in c.values()], allow_nan=False)


def test_no_table_is_none_and_a_changed_one_is_refused(tmp_path):
    content = as_csv(found())
    assert read_sensitivity(tmp_path, {"format": 2, "state": "complete", "tables": {}}) is None
    (tmp_path / SENSITIVITY).write_bytes(content.replace(b"0.7", b"0.9"))
    with pytest.raises(DamageError, match="digest"):
        read_sensitivity(tmp_path, manifest(content))
    for old, new in ((b"moderate", b"mild"), (b"0.7,", b","), (b"0.7,", b"wide,")):
        changed = content.replace(old, new)
        (tmp_path / SENSITIVITY).write_bytes(changed)
        with pytest.raises(BadInputError, match=r"sensitivity\.csv"):
            read_sensitivity(tmp_path, manifest(changed))
