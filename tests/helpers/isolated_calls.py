"""Functions that tests run in the worker process of uqharness.isolation."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from pathlib import Path

from uqharness.isolation import ProcessEndedError, run_in_worker


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


def survived_crash() -> str:
    """Return what this process learns of a function that ends the process of its own worker."""
    try:
        run_in_worker(os.abort)
    except ProcessEndedError as error:
        return error.reason
    return ""
