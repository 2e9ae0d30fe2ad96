"""Blocks: what is constant, what is coloured, and the noise, by frequency."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft

from sysid.model_form.components import BLOCK_S, make_blocks, split_long_pieces
from tests.helpers.residual_pieces import DT, first_order, residuals_of


def test_long_pieces_are_cut_and_short_ones_left():
    made = residuals_of([np.arange(n, dtype=float) for n in (120, 1530, 700)])
    cut = split_long_pieces(made)
    assert [len(p) for p in cut.pieces] == [120, 510, 510, 510, 700]
    assert np.concatenate([p.delta[:, 0] for p in cut.pieces]).tolist() == made.delta[:, 0].tolist()
    assert [p.noise.n for p in cut.pieces] == [len(p) for p in cut.pieces]
    assert all(len(p) * DT < 1.6 * BLOCK_S for p in cut.pieces)


def test_a_constant_is_in_the_first_wave_alone():
    made = residuals_of([np.full(100, 3.0), np.full(150, -1.0)])
    blocks = make_blocks(made, "CX", [np.ones((100, 1)), np.ones((150, 1))])
    assert blocks.y[blocks.wave == 0] == pytest.approx([30.0, -np.sqrt(150.0)])
    assert np.abs(blocks.y[blocks.wave > 0]).max() < 1e-12
    assert blocks.constant[blocks.wave == 0].tolist() == [100.0, 150.0]
    assert blocks.constant.sum() == 250.0
    # A third of 6 Hz, of 25 Hz: a twelfth of the waves.
    assert np.sum(blocks.block == 0) == 9


def test_coloured_variances_are_those_of_the_process():
    rng = np.random.default_rng(3)
    n, time = 200, 0.4
    waves = np.array(
        [fft.dct(first_order(n, time, rng), norm="ortho") ** 2 for _ in range(3000)]
    ).mean(axis=0)
    blocks = make_blocks(residuals_of([np.zeros(n)]), "CX", [np.ones((n, 1))])
    found = blocks.coloured(time)
    np.testing.assert_allclose(found, waves[: len(found)], rtol=0.2)
    assert np.abs(blocks.coloured(3 * time) / waves[: len(found)] - 1.0).max() > 0.5


def test_flights_have_columns_where_there_are_several():
    one = make_blocks(residuals_of([np.zeros(60)] * 3), "CX", [np.ones((60, 1))] * 3)
    assert one.flights.shape == (len(one.y), 0)
    two = make_blocks(
        residuals_of([np.zeros(60)] * 3, flights=[0, 0, 1]), "CX", [np.ones((60, 1))] * 3
    )
    assert two.flights.shape == (len(two.y), 2)
    np.testing.assert_allclose(two.flights.sum(axis=1) ** 2, two.constant)
    assert (two.flights**2).sum(axis=0).tolist() == pytest.approx([120.0, 60.0])
