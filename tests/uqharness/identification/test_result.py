"""The table of what an identification found."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from uqharness.identification.replay_fit import Identification

FOUND = SimpleNamespace(
    names=("a", "b"),
    initial=np.array([1.0, 2.0]),
    theta=np.array([1.5, 2.0]),
    std=np.array([0.1, np.nan]),
    std_crb=np.array([0.05, np.nan]),
    status={"a": "identified", "b": "not-identified"},
    reason={"a": "", "b": "no effect"},
)


def test_only_what_the_data_determined_is_identified():
    assert Identification.identified.fget(FOUND) == ("a",)
    FOUND_BOTH = SimpleNamespace(
        **{**vars(FOUND), "status": {"a": "identified", "b": "identified"}}
    )
    assert Identification.identified.fget(FOUND_BOTH) == ("a", "b")


def test_one_row_a_parameter():
    frame = Identification.to_dataframe(FOUND)
    assert list(frame.index) == ["a", "b"]
    assert frame.loc["a", ["initial", "estimate", "std", "std_crb"]].tolist() == [
        1.0,
        1.5,
        0.1,
        0.05,
    ]
    assert math.isnan(frame.loc["b", "std"])
    assert frame.loc["b", "reason"] == "no effect"
