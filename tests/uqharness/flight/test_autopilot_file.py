"""A parameter file read for gains: the formats of two ground stations, and errors with file and
line.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.flight.autopilot_gains import read_gains

PROPERTIES = {"ap/RLL_RATE_P", "ap/RLL2SRV_TCONST"}


@pytest.mark.parametrize(
    "text", ["RLL_RATE_P 0.3\n", "\ufeffRLL_RATE_P,0.3\r\n", "# plane\n1\t1\tRLL_RATE_P\t0.3\t9\n"]
)
def test_formats_of_ground_stations(tmp_path: Path, text: str):
    path = tmp_path / "plane.param"
    path.write_text(text, encoding="utf-8")
    assert read_gains(path, PROPERTIES).properties == {"ap/RLL_RATE_P": 0.3}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            b"RLL_RATE_P 0.3\nRLL2SRV_TCONST 0\n",
            "line 2: RLL2SRV_TCONST 0: allowed is a number above 0",
        ),
        (b"RLL2SRV_TCONST 1\nRLL_RATE_P 0.3\nRLL2SRV_TCONST,-1\n", "line 3: RLL2SRV_TCONST -1"),
        (b"RLL_RATE_P 0.3\nhello\n", "line 2: 'hello' is no parameter"),
        (b"\0\1\2", "is no parameter file"),
        (b"RLL_RATE_P nan\n", "line 1: 'RLL_RATE_P nan' is no parameter"),
        (b"RLL_RATE_P 1e999\n", "line 1: 'RLL_RATE_P 1e999' is no parameter"),
        (b"RLL_RATE_P 1_8\n", "line 1: 'RLL_RATE_P 1_8' is no parameter"),
        ("RLL_RATE_P \u0661\u0668\n".encode(), "line 1: 'RLL_RATE_P \u0661\u0668' is no"),
        (b"RLL_RATE_P\x1b[31m 1\n", "line 1: 'RLL_RATE_P\x1b[31m 1' is no parameter"),
        (b"RLL_RATE_P " + b"9" * 99_999 + b"\n", "line 1: 'RLL_RATE_P 9999"),
        (b"", "holds no parameter"),
        (b"FW_RR_P 0.05\n", "these are PX4's parameters"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, content: bytes, words: str):
    path = tmp_path / "plane.param"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=re.escape(f"{path}: {words}")):
        read_gains(path, PROPERTIES)


def test_a_file_that_is_not_there(tmp_path: Path):
    with pytest.raises(
        BadInputError, match=r"none\.param: No such file.*give an ArduPilot parameter file"
    ):
        read_gains(tmp_path / "none.param", PROPERTIES)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_and_a_device_are_not_waited_for(tmp_path: Path):
    pipe = tmp_path / "pipe.param"
    os.mkfifo(pipe)
    with pytest.raises(BadInputError, match="is a pipe, not a regular file"):
        read_gains(pipe, PROPERTIES)
    with pytest.raises(BadInputError, match="is a device, not a regular file"):
        read_gains(Path("/dev/zero"), PROPERTIES)
