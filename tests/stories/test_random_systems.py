"""Random systems in the batch engine and in JSBSim: alike, or refused with a reason; the faults
that this search met, in small.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.fuzz.systems import AGREED, DEAD, DIFFERS, FRAMES, REFUSED, attempt, judge

SERIES = {
    "i/a": np.tile([0.3, -5.0, 5.0, 1.0], FRAMES // 4),
    "i/b": np.tile([2.0, 1.0, -1.0, 0.5], FRAMES // 4),
    "i/c": np.tile([1.0, 1e15, -3.0, 0.0], FRAMES // 4),
}
ONE_COLUMN = """<table><independentVar lookup="row">i/a</independentVar>
<independentVar lookup="column">f/nan</independentVar><tableData>
 2.5
-1 0.5
 1 0.9
</tableData></table>"""


def function(body: str) -> str:
    return f'<function name="f/x">{body}</function>'


@pytest.mark.parametrize(
    "seeds", [range(12), pytest.param(range(1000, 2300), marks=pytest.mark.slow)]
)
def test_no_random_system_differs(seeds):
    outcomes = {seed: attempt(seed) for seed in seeds}
    assert [(seed, *result) for seed, result in outcomes.items() if result[0] == DIFFERS] == []
    agreed = [seed for seed, result in outcomes.items() if result[0] == AGREED]
    assert len(agreed) > 0.5 * len(outcomes)
    assert all(result[1] for result in outcomes.values() if result[0] in (REFUSED, DEAD))


@pytest.mark.parametrize(
    ("body", "outcome"),
    [
        # Breakpoints that are properties, in any order.
        (
            "<interpolate1d><p>i/a</p><p>i/b</p><v>1</v><v>0</v><p>i/b</p><v>-2</v><v>4</v></interpolate1d>",
            AGREED,
        ),
        # A NaN key of a grid with one column.
        (ONE_COLUMN, AGREED),
        # The engine's limits, hidden by an operation that passes NaN over.
        ("<min><v>2</v><tan><p>i/c</p></tan></min>", REFUSED),
        ("<max><v>2</v><fmod><p>i/c</p><v>1e-9</v></fmod></max>", REFUSED),
        ("<min><v>2</v><mod><p>i/c</p><v>3</v></mod></min>", REFUSED),
        # What JSBSim does not compute is not held against a flight.
        (
            "<ifthen><lt><abs><p>i/c</p></abs><v>100</v></lt><tan><p>i/c</p></tan><v>1</v></ifthen>",
            AGREED,
        ),
        ("<switch><gt><p>i/c</p><v>10</v></gt><sin><p>i/c</p></sin><v>1</v></switch>", AGREED),
        # JSBSim ends the process: counted, in a child.
        ("<mod><v>1</v><v>0.5</v></mod>", DEAD),
        ("<switch><v>-3</v><v>0.5</v></switch>", DEAD),
    ],
)
def test_what_was_met(body, outcome):
    nan = '<function name="f/nan"><asin><v>2</v></asin></function>'
    assert judge(nan + function(body), SERIES)[0] == outcome


def test_another_system_is_seen_to_differ(monkeypatch):
    """The search can say no: the translation of another gain."""
    from tests.helpers import batch_systems

    before = batch_systems.document_of
    monkeypatch.setattr(
        batch_systems, "document_of", lambda text: before(text.replace("<v>7</v>", "<v>7.001</v>"))
    )
    assert judge(function("<product><p>i/a</p><v>7</v></product>"), SERIES)[0] == DIFFERS
