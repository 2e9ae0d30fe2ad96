"""Whether what a replay leaves is turbulence's: coloured, no function of the motion, there in quiet flight too."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from sysid.estimation.gaps import process_noise_shown

NOISE = np.full(4, 0.1)


def flights(gusty, formed, waits=False, seed=0):
    """Residuals and motion, (500, 4) twice: ``gusty`` channels have coloured noise, ``formed`` ones a function of the motion.

    waits: the coloured noise comes with the motion alone.
    """
    rng = np.random.default_rng(seed)
    residual, motion = [], []
    for _ in range(2):
        busy = np.repeat([0.0, 1.0, 0.0, 1.0], 125)[:, None]
        y = lfilter([0.2], [1.0, -0.8], rng.normal(size=(500, 4)), axis=0) * (0.02 + busy)
        e = NOISE * rng.normal(size=(500, 4))
        gusts = lfilter([0.3], [1.0, -0.9], rng.normal(size=(500, 4)), axis=0) * (busy if waits else 1.0)
        e[:, gusty] += gusts[:, gusty]
        e[:, formed] += (y**2 + y)[:, formed]
        residual.append(e)
        motion.append(y)
    return residual, motion, NOISE


def test_turbulence_is_seen():
    assert process_noise_shown(*flights([0, 1, 2, 3], []))


def test_a_wrong_sensor_in_turbulence_does_not_hide_it():
    assert process_noise_shown(*flights([0, 1, 2], [3]))


def test_calm_air_is_calm():
    assert not process_noise_shown(*flights([], []))


def test_beside_a_wrong_force_half_of_the_channels_must_be_gusty():
    assert process_noise_shown(*flights([0, 1], [3]))
    assert not process_noise_shown(*flights([0], [3]))
    assert process_noise_shown(*flights([0], []))


def test_what_is_wrong_in_most_channels_is_the_models_form():
    assert not process_noise_shown(*flights([0], [1, 2, 3]))
    assert not process_noise_shown(*flights([], [0]))


def test_what_waits_for_manoeuvres_is_not_the_air():
    assert not process_noise_shown(*flights([0, 1, 2, 3], [], waits=True))
