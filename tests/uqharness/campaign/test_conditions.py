"""From a table of flights to samples, p-boxes and rates by condition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uqharness.campaign.conditions import (
    ERROR_METRICS,
    Condition,
    excursion_cells,
    in_condition,
    requested_metrics,
    samples,
)
from uqharness.errors import BadInputError

METRIC = ERROR_METRICS[0]


def frame(**columns) -> pd.DataFrame:
    """Two winds, two corners, four flights each; the last flight of the first corner crashed."""
    rng = np.random.default_rng(0)
    rows = [(wind, corner, k) for wind in (5.0, 3.0) for corner in ("00", "01") for k in range(4)]
    n = len(rows)
    status = ["crashed" if corner == "00" and k == 3 else "ok" for _, corner, k in rows]
    return pd.DataFrame(
        {
            "wind_mps": [r[0] for r in rows],
            "turbulence": ["none"] * n,
            "epistemic_id": [r[1] for r in rows],
            "status": status,
            "duration_s": [1800.0] * n,
            "excursions_15m": np.arange(n) % 3,
            "excursions_15m_3d": np.nan,
            **dict.fromkeys(ERROR_METRICS, np.nan),
            METRIC: rng.gamma(2.0, 1.0, n),
            **columns,
        }
    )


def test_what_is_not_known_of_a_flight_is_counted():
    table = frame()
    rows = in_condition(table, Condition(3.0, "none"))
    first, second = samples(rows, METRIC)
    assert (first.values.size, first.unknown) == (3, 1)
    assert (second.values.size, second.unknown) == (4, 0)
    assert sorted(second.values) == sorted(rows[rows["epistemic_id"] == "01"][METRIC])
    # A value that is not finite is not known either.
    assert samples(rows.assign(**{METRIC: np.inf}), METRIC)[1].unknown == 4


def test_rates_are_counts_over_hours():
    cells = excursion_cells(frame(), [15.0])
    assert [(c.condition.wind_mps, c.distance, c.radius_m) for c in cells] == [
        (w, "horizontal", 15.0) for w in (5.0, 3.0)
    ]
    rates = cells[0].rates
    assert [r.epistemic_id for r in rates] == ["00", "01"]
    assert [r.flights for r in rates] == [4, 4]
    assert [r.failed for r in rates] == [1, 0]
    assert rates[0].hours == pytest.approx(2.0)


def test_a_requested_metric_is_one_that_the_table_has():
    table = pd.DataFrame({"case_id": ["a"], "speed_max_mps": [1.0], "altitude_max_m": [np.nan]})
    some = ("speed_max_mps", "altitude_max_m")
    assert requested_metrics(table, (), some, Path("cases.parquet")) == ("speed_max_mps",)
    for name in ("case_id", "altitude_max_m", "nothing"):
        with pytest.raises(BadInputError, match=f"{name}: not in .*; it has speed_max_mps"):
            requested_metrics(table, [name], some, Path("cases.parquet"))
