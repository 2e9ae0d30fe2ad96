"""Functions that tests run in the worker process of uqharness.isolation."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.requests.simulation import FlyRequest
from uqharness.results.base import Outcome


def call_twice(callback: Callable[[int], object]) -> int:
    """Call the function with 0 and 1."""
    return sum(callback(k) is None for k in range(2))


def chatter(text: str) -> None:
    """Log a note."""
    logging.getLogger("uqharness").info("%s of %d", text, 1)


def sleeping(callback: Callable[[int], object], mark: Path) -> None:
    """Call the function, then sleep until interrupted, and tidy up."""
    try:
        callback(0)
        time.sleep(60.0)
    except KeyboardInterrupt:
        mark.write_text("tidied")
        raise


def stage(request: FlyRequest, callback: Callable[[str], object]) -> Outcome[None]:
    """Run a made-up stage: wait until the other one has begun, then write the seed."""
    callback("at work")
    out = request.out
    mark, other = out.with_suffix(".begun"), Path(f"{request.script}.begun")
    mark.write_text("")
    deadline = time.monotonic() + 60.0
    while request.noise and not other.exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    if request.seed == 13:
        raise BadInputError("no luck")
    out.write_text(str(request.seed))
    return Outcome(None, {}, [out.name])
