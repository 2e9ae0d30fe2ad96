"""Values that readers trip over, shared by the mutators."""

from __future__ import annotations

import numpy as np

OUTSIDE = "/tmp/uq-fuzz-outside"
"""A folder that exists while the fuzzer runs and that no command has a reason to touch."""

STRINGS = (
    "",
    " ",
    "\n",
    "..",
    "../..",
    "../../canary.txt",
    "../../../../canary.xml",
    "/",
    "/etc/passwd",
    "/dev/zero",
    "/proc/self/mem",
    f"{OUTSIDE}/written.csv",
    f"{OUTSIDE}/model",
    "C:\\Windows\\win.ini",
    "~",
    "$HOME",
    "con",
    "a" * 300,
    "x" * 20000,
    "\x1b[31mred\x1b[0m",
    "\x1b]0;title\x07",
    "tab\there",
    "line\nbreak",
    "nul\x00byte",
    "\u202egnp.exe",
    "\u0085",
    "\ufeffbom",
    "\U0001f6e9",
    "e\u0301",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "0x10",
    "1_000",
    "١٢",
    "true",
    "null",
    "None",
    "{0.__class__}",
    "%s%s%n",
    "${x}",
    "{{7*7}}",
    "<script>alert(1)</script>",
    "'; drop table outcome; --",
    "__class__",
    "=1+1",
    "-",
    "--help",
    "aero/Cm_q",
    "CX",
    "Cm",
)

NUMBERS = (
    0,
    -0.0,
    1,
    -1,
    2,
    0.5,
    1e-300,
    5e-324,
    1e300,
    -1e300,
    1e18,
    2**31,
    -(2**31) - 1,
    2**53 + 1,
    2**63,
    -(2**63) - 1,
    2**64,
    10**30,
    10**400,
    float("nan"),
    float("inf"),
    float("-inf"),
    1e6,
    1e9,
    65536,
    255,
    1e-9,
    86400.0,
    3,
)


def string(rng: np.random.Generator) -> str:
    """One of ``STRINGS``, now and then two of them joined."""
    found = STRINGS[int(rng.integers(0, len(STRINGS)))]
    return found + STRINGS[int(rng.integers(0, len(STRINGS)))] if rng.random() < 0.1 else found


def number(rng: np.random.Generator) -> int | float:
    """One of ``NUMBERS``."""
    return NUMBERS[int(rng.integers(0, len(NUMBERS)))]
