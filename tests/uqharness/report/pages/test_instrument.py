"""The page of an instrumented aircraft: bounds as the model form has them, constants as they were
given.
"""

from __future__ import annotations

import numpy as np

from tests.helpers.model_forms import made_up_form
from tests.helpers.page_checks import problems, words_of
from uqharness.report.pages.instrument import Instrumentation, instrument_page
from uqharness.report.parts import render

DONE = Instrumentation(
    "toy",
    (("CX", "AXIAL", "toy.xml:12"),),
    ("a note",),
    (True, "Flown beside it."),
    "uqharness instrument toy",
)


def page(form=None, constant=None, done=DONE):
    return render(instrument_page(done, form, constant or {}))


def test_bounds_of_a_model_form_are_drawn_along_every_state():
    form = made_up_form({"CX": ("V_mps", "alpha_rad"), "Cm": ("alpha_rad",)})
    text = page(form)
    assert problems(text) == []
    for name in ("slice-CX-V_mps", "slice-CX-alpha_rad", "slice-Cm-alpha_rad"):
        assert f'<figure id="{name}">' in text
    words = words_of(text)
    assert "Bounds of 2 coefficients over the flight state" in words
    assert "No uncertainty in CY, CZ, Cl, Cn." in words
    b = form.coefficients["Cm"]
    low, high = b.bounds(
        {"alpha_rad": np.array([b.hull.middle[0, 1]])}, form.confidence, form.outside
    )
    assert f"Cm [-]{low[0]:.3g}{high[0]:.3g}" in words.replace(" ", "").replace("Cm[-]", "Cm [-]")


def test_constant_bounds():
    text = page(constant={"CX": (-0.01, 0.02), "Cm": (0.0, 0.0)})
    assert problems(text) == []
    words = words_of(text)
    assert "Constant bounds of 2 coefficients." in words
    assert "CX -0.01 to 0.02" in text
    assert "Slices" not in words
