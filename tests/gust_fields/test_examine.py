"""The examination in other air runs, and finds standard air as it is."""

from __future__ import annotations

import pytest

from tests.gust_fields import examine
from tests.gust_fields.fields import FAMILIES


def test_each_kind_of_air_is_flown(tmp_path):
    for family in FAMILIES:
        (path, *_) = examine.write_flights(family, 0, 2.0, 15.0, tmp_path, ())
        assert path.stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize("family", ["heading", "body", "lags-0.5"])
def test_moments_are_explained_by_the_air(family, tmp_path):
    row = examine.measure(examine.write_flights(family, 0, 45.0, 15.0, tmp_path, ()))
    assert max(row.moments) < 100.0
    assert max(row.vane_t) < 4.0
