"""Estimates of a fit on linearised flights, with standard errors as they cover."""

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects import MOMENTS_IN_GUSTS
from uqharness.identification.linearised import fit as fits
from uqharness.identification.linearised.fit import in_one_step


def test_in_turbulence_parameters_of_moments_have_wider_errors_and_those_of_forces_have_not(monkeypatch):
    block = np.zeros((5, 6))
    force, moment = block.copy(), block.copy()
    force[:, 2], moment[:, 4] = 1.0, 1.0
    names = ("aero/lift", "aero/pitch", "aero/CZ_q", "aero/Cm_q")
    inputs = dict(zip(names, [(-1, force), (-1, moment), (2, block[:, 0]), (4, block[:, 0])], strict=True))
    fit = SimpleNamespace(
        columns=[SimpleNamespace(names=names, inputs=inputs)],
        flown=SimpleNamespace(point=SimpleNamespace(values=dict.fromkeys(names, 1.0))),
    )
    monkeypatch.setattr(fits, "corrected_each", lambda evidence, free, wanted: dict.fromkeys(wanted, (0.5, 0.1, 0.1)))

    def errors(gusty: bool) -> list[float]:
        found = in_one_step(None, names, fit, (), gusty)
        assert {v for v, _ in found.values()} == {1.5}
        return [std / 0.1 for _, std in found.values()]

    assert errors(True) == pytest.approx([1.0, MOMENTS_IN_GUSTS, 1.0, MOMENTS_IN_GUSTS])
    assert errors(False) == pytest.approx([1.0] * 4)
