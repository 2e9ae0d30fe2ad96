"""What every worker process of this program is started with: one thread for linear algebra, nothing from the working folder."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

# BLAS would start a thread per core in each of many workers, and they would fight. And Python puts the working folder before
# everything else where code is handed to it on the command line, as multiprocessing does: a `socket.py` there would be imported.
CHILD_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "PYTHONSAFEPATH": "1",
}


@contextlib.contextmanager
def child_settings() -> Iterator[None]:
    """Children started inside inherit CHILD_ENVIRONMENT; this process's own environment is as before afterwards."""
    before = {name: os.environ.get(name) for name in CHILD_ENVIRONMENT}
    os.environ.update(CHILD_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
