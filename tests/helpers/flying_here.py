"""Campaigns flown in the test's own process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from uqharness.campaign.processes import ProcessExecutor, SerialExecutor


@contextmanager
def flying_here() -> Iterator[None]:
    """Inside, a campaign's flights start no process. For tests that ask something else than what
    processes do.

    Starting one and compiling the batch engine's program in it costs two seconds, three times a
    campaign."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            ProcessExecutor,
            "run_groups",
            lambda self, fly, groups: SerialExecutor().run_groups(fly, groups),
        )
        yield
