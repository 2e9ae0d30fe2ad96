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
        (arguments.workers, None, None),
        (arguments.workers, np.int64(2), 2),
        (lambda v: arguments.integer("seed", v), 0, 0),
        (lambda v: arguments.number("hours", v), np.float32(0.5), 0.5),
        (lambda v: arguments.share("confidence", v), 0.9, 0.9),
        (lambda v: arguments.flag("air", v), np.True_, True),
        (lambda v: arguments.path("out", v), "a", Path("a")),
        (lambda v: arguments.one_of("order", v, (0, 1)), 1, 1),
        (arguments.properties, None, {}),
        (arguments.properties, {"aero/Cm_q": np.float64(-10)}, {"aero/Cm_q": -10.0}),
    ],
)
def test_what_fits_is_taken_as_a_plain_value(read: Callable, given: object, found: object):
    assert read(given) == found
    assert type(read(given)) is type(found)


@pytest.mark.parametrize(
    ("read", "given", "said"),
    [
        (arguments.workers, "2", "workers = '2': a whole number of at least 1 is needed"),
        (arguments.workers, 0, "workers = 0: a whole number of at least 1 is needed"),
        (arguments.workers, True, "workers = True: a whole number of at least 1 is needed"),
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
        (
            lambda v: arguments.share("confidence", v),
            "x",
            "confidence = 'x': a number between 0 and 1, such as 0.95, is needed",
        ),
        (lambda v: arguments.flag("noise", v), 3, "noise = 3: True or False is needed"),
        (lambda v: arguments.path("out", v), 5, "out = 5: a path, as a str or a Path, is needed"),
        (lambda v: arguments.path("out", v), "", "out = '': a path, as a str or a Path, is needed"),
        (
            lambda v: arguments.one_of("servos", v, ("card", "ideal")),
            ["card"],
            "servos = ['card']: allowed are card, ideal",
        ),
        (
            lambda v: arguments.instance("box", v, dict, "a dict"),
            None,
            "box = None: a dict is needed",
        ),
        (
            arguments.properties,
            [1],
            'properties = [1]: a mapping such as {"aero/Cm_q": -10.0} is needed',
        ),
        (arguments.properties, {"a": math.inf}, "properties: a = inf: a finite number is needed"),
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
