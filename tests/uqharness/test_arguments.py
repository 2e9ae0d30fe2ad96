"""Arguments are refused by name, with what was given and what is needed."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uqharness import arguments
from uqharness.errors import BadInputError


@pytest.mark.parametrize(
    ("read", "given", "found"),
    [
        (lambda v: arguments.integer("seed", v), 0, 0),
        (lambda v: arguments.number("hours", v), np.float32(0.5), 0.5),
        (lambda v: arguments.flag("air", v), np.True_, True),
        (lambda v: arguments.path("out", v), "a", Path("a")),
    ],
)
def test_what_fits_is_taken_as_a_plain_value(read: Callable, given: object, found: object):
    assert read(given) == found
    assert type(read(given)) is type(found)


@pytest.mark.parametrize(
    ("read", "given", "said"),
    [
        (
            lambda v: arguments.integer("seed", v),
            1.5,
            "seed = 1.5: a whole number of at least 0 is needed",
        ),
        (lambda v: arguments.number("hours", v), True, "hours = True: a finite number is needed"),
        (
            lambda v: arguments.number("hours", v),
            math.nan,
            "hours = nan: a finite number is needed",
        ),
        (lambda v: arguments.flag("noise", v), 3, "noise = 3: True or False is needed"),
        (lambda v: arguments.path("out", v), 5, "out = 5: a path, as a str or a Path, is needed"),
        (lambda v: arguments.path("out", v), "", "out = '': a path, as a str or a Path, is needed"),
        (
            lambda v: arguments.instance("box", v, dict, "a dict"),
            None,
            "box = None: a dict is needed",
        ),
    ],
)
def test_what_does_not_fit_is_said_in_one_sentence(read: Callable, given: object, said: str):
    with pytest.raises(BadInputError) as caught:
        read(given)
    assert str(caught.value) == said


def test_a_long_value_is_shown_short():
    with pytest.raises(BadInputError) as caught:
        arguments.path("out", np.zeros((100, 100)))
    assert len(str(caught.value)) < 160
    assert "\n" not in str(caught.value)
