"""Random streams have the same bytes whatever instructions the libraries use."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.helpers.places import ROOT
from tests.helpers.stream_digest import digest, librarys

DIGEST = "3a1e9d72ed3122bc0ae6b7a59d9dccdbff8d329a7afe549747cb96357d3a9ee7"
"""Of a machine with AVX-512."""


def _numpys_features() -> str:
    """What numpy can be told to leave out on this processor."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    return " ".join(f for f in __cpu_dispatch__ if __cpu_features__.get(f))


RESTRICTED = {
    "NPY_DISABLE_CPU_FEATURES": _numpys_features(),
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
    "OPENBLAS_CORETYPE": "Prescott",
}


def digests_under_restriction() -> tuple[str, str]:
    """Digests of the streams and of the libraries' own functions in a process whose numpy, C
    library and matrix library are restricted.
    """
    child = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.helpers.stream_digest"],
        env={**os.environ, **RESTRICTED},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    streams, library = child.stdout.split()
    return streams, library


def test_the_digest_is_that_of_another_machine() -> None:
    assert digest() == DIGEST


def test_restricted_libraries_change_no_byte_of_streams_but_of_their_own_functions() -> None:
    streams, library = digests_under_restriction()
    assert streams == DIGEST
    # The restriction acts: without it the libraries' own functions round otherwise.
    assert library != librarys()
