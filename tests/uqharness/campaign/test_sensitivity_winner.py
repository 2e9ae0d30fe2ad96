"""The coefficient that drives a metric over all conditions, weighed by the widths of their
p-boxes.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from uqharness.campaign import sensitivity
from uqharness.campaign.sensitivity import find_winner
from uqharness.errors import BadInputError
from uqharness.sensitivity.result import Index, MethodResult, PairRange, Ranking


def item(label, area, certain=True, **shares):
    indices = {name: PairRange(Index(a, a, a), Index(b, b, b)) for name, (a, b) in shares.items()}
    first = max(shares, key=lambda name: sum(shares[name]))
    result = MethodResult("proposed", 1, indices, True, "s", {"area": area})
    return SimpleNamespace(
        result=result,
        condition=SimpleNamespace(label=label, words=label),
        ranking=Ranking(first, certain=certain),
        words="text",
    )


NARROW = item("calm", 1.0, CX=(0.8, 0.9), Cm=(0.1, 0.2))
WIDE = item("rough", 10.0, CX=(0.3, 0.4), Cm=(0.6, 0.7))


@pytest.fixture
def flown(monkeypatch):
    def of(*items, metrics=("cross_track_median_m", "speed_max_mps")):
        monkeypatch.setattr(sensitivity, "read_corner_campaign", lambda folder: None)
        monkeypatch.setattr(sensitivity, "metrics_of", lambda flown: metrics)
        monkeypatch.setattr(sensitivity, "analyse_campaign", lambda flown, **more: list(items))

    return of


def test_the_widest_condition_weighs_most(flown):
    flown(NARROW, WIDE)
    found = find_winner(Path("c"))
    assert (found.coefficient, found.metric, found.condition, found.share) == (
        "Cm",
        "cross_track_median_m",
        "rough",
        (0.6, 0.7),
    )
    assert not found.certain
    assert found.words == ("calm: text", "rough: text")
    flown(NARROW)
    assert (find_winner(Path("c")).coefficient, find_winner(Path("c")).certain) == ("CX", True)


def test_certain_everywhere_or_not_at_all(flown):
    flown(WIDE, item("calm", 1.0, certain=False, CX=(0.1, 0.2), Cm=(0.8, 0.9)))
    assert not find_winner(Path("c")).certain
    flown(WIDE, item("calm", 1.0, CX=(0.1, 0.2), Cm=(0.8, 0.9)))
    assert find_winner(Path("c")).certain
    # Asked for, another coefficient is told with its own part.
    assert find_winner(Path("c"), coefficient="CX").share == (0.3, 0.4)


def test_what_has_no_winner_is_refused(flown):
    flown(WIDE)
    with pytest.raises(BadInputError, match="--metric altitude: c has cross_track_median_m"):
        find_winner(Path("c"), "altitude")
    with pytest.raises(BadInputError, match="--coefficient Cn: not uncertain in c"):
        find_winner(Path("c"), coefficient="Cn")
    flown()
    with pytest.raises(BadInputError, match="no sensitivity of cross_track_median_m"):
        find_winner(Path("c"))
    flown(item("rough", 10.0, CX=(0.1, 0.2), **{"load/kg": (0.8, 0.9)}))
    with pytest.raises(
        BadInputError, match=r"load/kg drives .*not an aerodynamic coefficient: measure it"
    ):
        find_winner(Path("c"))
