"""Equations of docs/method.md stand beside functions that exist, and the ones that can be are held
against them.
"""

from __future__ import annotations

import re

import numpy as np

from tests.helpers.doc_names import wrong_places
from tests.helpers.places import ROOT
from uqharness.sensitivity.measures import box_area, pair_areas
from uqharness.statistics.pbox import Sample, band_half_width, pbox

PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")


def test_functions_of_the_page_exist():
    assert wrong_places(PAGE) == []


def test_each_equation_has_its_function_near():
    parts = re.split(r"\n## ", PAGE)[1:]
    for part in parts:
        equations = part.count("$$") // 2
        places = len(re.findall(r"`[\w/]+\.(?:py:[\w.]+|xml)`", part))
        assert equations == 0 or places >= 1, part.splitlines()[0]
    assert PAGE.count("$$") // 2 >= 20
    assert PAGE.count("$$") % 2 == 0


def test_the_bands_formula_is_a_little_wider_than_the_band():
    for flights, corners in ((8, 64), (500, 64), (50, 1)):
        printed = np.sqrt(np.log(2 * corners / 0.05) / (2 * flights))
        assert 0.9 * printed < band_half_width(flights, corners, 0.95) <= min(1.0, printed)


def test_areas_of_the_page_are_those_of_the_code():
    rng = np.random.default_rng(0)
    y = np.sort(rng.normal(size=(4, 50)) + np.arange(4)[:, None], axis=-1)
    grid = np.linspace(y.min(), y.max(), 200_001)
    F = np.array([np.searchsorted(row, grid, side="right") / row.size for row in y])
    envelope = np.trapezoid(F.max(axis=0) - F.min(axis=0), grid)
    assert abs(box_area(y) / envelope - 1.0) < 1e-3
    between = np.trapezoid(
        np.abs(F[0] - F[2]), grid
    )  # the pair that differs in the first parameter, the second at its lower end
    assert abs(pair_areas(y, 2)[0, 0] / between - 1.0) < 1e-3
    box = pbox([Sample(str(k), row) for k, row in enumerate(y)])
    assert np.allclose(box.lower, [min(np.mean(row <= v) for row in y) for v in box.value])
