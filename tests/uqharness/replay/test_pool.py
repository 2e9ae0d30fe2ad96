"""The map that output error flies its replays with."""

from __future__ import annotations

import os

import numpy as np

from uqharness.replay.pool import replay_pool


def process_of(point):
    return os.getpid(), float(point[0])


def test_one_worker_is_this_process():
    with replay_pool(1) as spread:
        assert spread is map


def test_what_is_no_replay_is_done_here_in_order():
    with replay_pool(2) as spread:
        found = list(spread(process_of, [np.array([3.0]), np.array([1.0])]))
    assert found == [(os.getpid(), 3.0), (os.getpid(), 1.0)]
