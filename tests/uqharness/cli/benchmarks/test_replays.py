"""What the benchmark of replays measures and prints."""

from __future__ import annotations

import shlex

import pytest

from uqharness.cli.benchmark_batch import measure_replays, replay_lines
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.replay import in_lanes
from uqharness.simulator import find_aircraft


@pytest.mark.slow
def test_replays_are_measured_and_said(tmp_path, monkeypatch):
    compiled = []
    made = in_lanes._compile
    monkeypatch.setattr(
        in_lanes, "_compile", lambda job, names: compiled.append(job) or made(job, names)
    )
    flight = tmp_path / "flight.parquet"
    main(["fly", "espaaro", "--script", "flight-ident", "--noise", "--out", str(flight)])
    found = measure_replays(find_aircraft("espaaro"), flight, 1, replays=1)
    assert (
        len(compiled) == 2
    )  # in a round once for the replays and once for identify: nothing is remembered
    assert set(found) == {"f_replays_per_s", "g_compile_s", "h_identify_s"}
    assert all(value > 0.0 for value in found.values())
    assert len(replay_lines(found)) == len(found)


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
