"""What a replay's theta holds beside the parameters, and records whose commands stand in the wrong
row.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.replay.replay import CONTROL_DELAY, SENSOR_OF
from uqharness.replay.segments import Commands, Segment
from uqharness.replay.simulation import (
    delayed,
    late_limit_s,
    nuisance_layout,
    shifted_command_warnings,
)

TIME = np.arange(5) * 0.02
PIECE = Segment("s", "f", TIME, np.zeros((5, 4)), np.zeros(9), 100.0, 0.0)


def flight(native_hz):
    return SimpleNamespace(
        name="f", record=SimpleNamespace(metadata=SimpleNamespace(native_hz=native_hz))
    )


def test_half_a_row_is_allowed_and_a_row_is_not():
    record = flight({})
    assert shifted_command_warnings([record], [PIECE], {"delay/f/controls": (0.009, 0.001)}) == []
    (said,) = shifted_command_warnings([record], [PIECE], {"delay/f/controls": (-0.02, 0.001)})
    assert "20.0 ms early" in said
    assert "10.0 ms are allowed" in said


def test_a_row_of_commands_counts_where_rows_were_thinned():
    """A clock 10 ms late is one row of a record at 100 Hz, and half a row of those compared."""
    fine = replace(PIECE, commands=Commands(2, np.zeros((9, 4))))
    (said,) = shifted_command_warnings([flight({})], [fine], {"delay/f/controls": (0.01, 0.001)})
    assert "7.5 ms are allowed" in said
    assert (
        shifted_command_warnings([flight({})], [PIECE], {"delay/f/controls": (0.01, 0.001)}) == []
    )


def test_logs_are_stamped_when_written_and_may_be_late():
    assert late_limit_s(flight({"q_radps": 25.0}), 0.02) == float("inf")
    assert (
        shifted_command_warnings(
            [flight({"q_radps": 25.0})], [PIECE], {"delay/f/controls": (0.05, 0.001)}
        )
        == []
    )


def test_places_of_biases_delays_and_starts():
    cut = [replace(PIECE, flight=name) for name in ("f", "g", "f")]
    biases, outputs = ("V_mps", "q_radps"), ("V_mps", "q_radps", "az_mps2")
    found = nuisance_layout(
        ("Cm_q",), [(-20.0, 0.0)], cut, biases, outputs, late={"g": ["controls"]}
    )
    assert found.names == (
        "Cm_q",
        "bias/f/V_mps",
        "bias/f/q_radps",
        "bias/g/V_mps",
        "bias/g/q_radps",
        "delay/g/controls",
        "start/0/V_mps",
        "start/0/q_radps",
        "start/1/V_mps",
        "start/1/q_radps",
        "start/2/V_mps",
        "start/2/q_radps",
    )
    assert len(found.bounds) == len(found.names)
    assert found.bounds[0] == (-20.0, 0.0)
    assert all(low == -high for low, high in found.bounds[1:])
    assert dict(zip(found.names, found.bounds, strict=True))["bias/f/V_mps"] == (-5.0, 5.0)
    jumps = nuisance_layout((), (), cut, (), ("V_mps",), late={}, jumping=["g"])
    assert dict(zip(jumps.names, jumps.bounds, strict=True))["unseen/g"] == (0.0, 1.0)


def test_of_logs_every_sensor_but_the_gyros_may_be_late():
    outputs = ("q_radps", "V_mps", "az_mps2", "ax_mps2")
    logged, recorded = flight({"q_radps": 25.0}), flight({})
    found = delayed([logged], outputs, None)["f"]
    assert found == [CONTROL_DELAY, *dict.fromkeys(SENSOR_OF.get(c, c) for c in outputs[1:])]
    assert delayed([recorded], outputs, None)["f"] == [CONTROL_DELAY]
    assert delayed([recorded], outputs, ("V_mps",))["f"] == [SENSOR_OF.get("V_mps", "V_mps")]
    assert delayed([recorded], outputs, ())["f"] == []


@pytest.mark.parametrize(("dt_s", "limit"), [(0.02, 0.01), (0.01, 0.0075), (0.1, 0.05)])
def test_half_a_row_but_no_less_than_a_run(dt_s, limit):
    assert late_limit_s(flight({}), dt_s) == pytest.approx(limit)


def test_a_start_may_move_as_far_as_the_first_rows_do():
    reach = np.zeros(9)
    reach[6] = 1.4
    fast = replace(PIECE, reach=reach)
    slow, found = (nuisance_layout((), (), [s], (), ("p_radps",), late={}) for s in (PIECE, fast))
    assert found.bounds[0][1] == pytest.approx(slow.bounds[0][1] + 1.4)
