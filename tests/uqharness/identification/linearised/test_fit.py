"""Estimates of a fit on linearised flights."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.identification.linearised import replay_fit as fits
from uqharness.identification.linearised.replay_fit import one_step_estimates


def test_the_last_step_is_taken_unless_what_was_flown_stands(monkeypatch):
    names = ("aero/CZ_q", "aero/Cm_q", "delay/f/alpha_rad")
    fit = SimpleNamespace(
        columns=[SimpleNamespace(names=(*names, "effect/Cm/de^2"))],
        trajectory=SimpleNamespace(
            point=SimpleNamespace(values={"aero/CZ_q": 1.0, "aero/Cm_q": -3.0})
        ),
    )
    request = []

    def corrected_each(information, free, expected):
        request.append(tuple(free))
        return dict.fromkeys(expected, (0.5, 0.2, 0.1))

    monkeypatch.setattr(fits, "corrected_estimates", corrected_each)
    assert one_step_estimates(None, names[:2], fit) == {
        "aero/CZ_q": (1.5, 0.2),
        "aero/Cm_q": (-2.5, 0.2),
    }
    assert one_step_estimates(None, names[:1], fit, ["effect/Cm/de"], moved=False) == {
        "aero/CZ_q": (1.0, 0.2)
    }
    assert request == [names, (*names, "effect/Cm/de")]


@pytest.mark.parametrize("cost", [math.inf, math.nan])
def test_where_the_first_replays_leave_the_finite_there_is_no_fit(monkeypatch, cost):
    monkeypatch.setattr(fits, "replay_at", lambda *_: SimpleNamespace(cost=cost))
    with pytest.raises(np.linalg.LinAlgError, match="no numbers"):
        fits.refit(SimpleNamespace(model=None), None, None, (), {}, None)  # type: ignore[arg-type]
