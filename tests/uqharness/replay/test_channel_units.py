"""Channels as they are shown: quantity, unit, factor."""

from __future__ import annotations

import math

import pytest

from sysid.vocabulary import SIGNALS
from uqharness.replay.histories import axis_label, shown_channel, with_shown_names


@pytest.mark.parametrize(
    ("name", "quantity", "unit", "factor"),
    [
        ("q_radps", "q", "deg/s", 180.0 / math.pi),
        ("alpha_rad", "alpha", "deg", 180.0 / math.pi),
        ("V_mps", "V", "m/s", 1.0),
        ("elevator_pos_deg", "elevator pos", "deg", 1.0),
        ("throttle", "throttle", "%", 1.0),
        ("elevator", "elevator", "deg", 1.0),
        ("Cm", "Cm", "-", 1.0),
        ("uq_level", "uq_level", "-", 1.0),
        ("_rad", "_rad", "-", 1.0),
        ("az_mps2", "az", "m/s²", 1.0),
    ],
)
def test_what_is_shown(name, quantity, unit, factor):
    assert shown_channel(name) == (quantity, unit, pytest.approx(factor))
    assert axis_label(name) == f"{quantity} [{unit}]"


def test_every_channel_of_a_record_has_its_unit():
    """rpm is a name without one, N is not drawn."""
    unknown = {
        name
        for name, signal in SIGNALS.items()
        if signal.kind != "label" and shown_channel(name)[1] == "-"
    }
    assert unknown <= {"rpm", "thrust_N", "mode", "manoeuvre"}


def test_names_within_a_text():
    text = "psi_rad, h_m; p_radps is reversed; p_radps2 and my_psi_rad stay"
    assert (
        with_shown_names(text, ("psi_rad", "h_m", "p_radps"))
        == "psi, h; p is reversed; p_radps2 and my_psi_rad stay"
    )
    assert with_shown_names(text, ()) == text
