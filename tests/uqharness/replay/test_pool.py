"""The map that output error flies its replays with."""

from __future__ import annotations

import os

import numpy as np
import pytest

from uqharness.replay.simulation import replay_pool


def process_of(point):
    return os.getpid(), float(point[0])


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_no_replay_is_done_here_in_order(workers):
    with replay_pool(workers) as spread:
        found = list(spread(process_of, [np.array([3.0]), np.array([1.0])]))
    assert found == [(os.getpid(), 3.0), (os.getpid(), 1.0)]
