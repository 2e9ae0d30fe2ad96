"""What the benchmark of replays measures and prints."""

from __future__ import annotations

import shlex

import pytest

from uqharness.cli.benchmark_batch import measure_replays
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.simulator import find_aircraft


def test_a_short_flight_is_refused(tmp_path):
    flight = tmp_path / "flight.parquet"
    main(
        [
            *shlex.split("fly espaaro --script doublet-elevator --duration-s 6 --out"),
            str(flight),
        ]
    )
    with pytest.raises(BadInputError, match=r"90 s of flight are needed, it has 301 rows of 4501"):
        measure_replays(find_aircraft("espaaro"), flight, 1, replays=1)
