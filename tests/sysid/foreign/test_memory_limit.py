"""A limit on memory: it holds while it is meant to, and is gone afterwards."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.helpers.places import ROOT

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="no limit of address space here"
)

# In a process of its own: under a limit anything else of the tests' process would fail too.
SCRIPT = """
import resource
from sysid.foreign.limited import MemoryLimit
before = resource.getrlimit(resource.RLIMIT_AS)
with MemoryLimit(100_000_000):
    small = bytearray(20_000_000)
    try:
        bytearray(200_000_000)
        print("no limit")
    except MemoryError:
        print("held")
big = bytearray(200_000_000)
print(resource.getrlimit(resource.RLIMIT_AS) == before)
resource.setrlimit(resource.RLIMIT_AS, (10**12, 10**12))
with MemoryLimit(10**13):
    print(resource.getrlimit(resource.RLIMIT_AS)[0])
"""


def test_more_than_allowed_is_refused_and_the_old_limit_comes_back():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.split() == ["held", "True", str(10**12)]
