"""Worker processes: jobs in order, large values read once by each process, nothing left behind."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import numpy as np
import pytest

from sysid.parallel import SERIAL, Shared
from uqharness.parallel import process_count, usable_cores, worker_map


def _squared(x: int) -> tuple[int, int]:
    return x * x, os.getpid()


def _read_twice(job: tuple[Shared, int]) -> tuple[int, float, bool]:
    shared, k = job
    return os.getpid(), float(shared.value[k]), shared.value is shared.value


def _fails(_: int) -> None:
    raise np.linalg.LinAlgError("no covariance")


def test_as_many_workers_as_there_are_cores_and_at_most_8():
    assert process_count(None) == min(8, usable_cores())
    assert process_count(11) == 11


def test_one_worker_is_this_process():
    with worker_map(1) as by:
        assert by is SERIAL
        assert {pid for _, pid in by(_squared, range(3))} == {os.getpid()}
        big = np.arange(3.0)
        assert by.share(big).value is big


def test_two_workers_answer_in_order_and_read_what_is_shared_once():
    with worker_map(2) as by:
        assert by.count == 2
        result = list(by(_squared, range(20)))
        assert [x for x, _ in result] == [k * k for k in range(20)]
        assert os.getpid() not in {pid for _, pid in result}
        shared = by.share(np.arange(5.0))
        read = list(by(_read_twice, [(shared, k) for k in range(5)]))
        assert [value for _, value, _ in read] == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert all(same for *_, same in read)
        path = Path(shared._path)  # type: ignore[attr-defined]
        assert path.is_file()
        del shared, read
        gc.collect()
        assert not path.exists()
        with pytest.raises(np.linalg.LinAlgError):
            list(by(_fails, [1]))
        folder = path.parent
        assert folder.is_dir()
    assert not folder.exists()


def test_a_short_command_runs_its_jobs_in_this_process():
    with worker_map(2, patience_s=1e9) as pool:
        assert {pid for _, pid in pool(_squared, range(3))} == {os.getpid()}
    with worker_map(2) as pool:
        assert [*pool(_squared, [3])] == [(9, os.getpid())]
