"""Histories on a page: the worst segments first, a band where the noise is known, a gap where
pieces join.
"""

from __future__ import annotations

import numpy as np

from uqharness.replay.histories import History
from uqharness.report.history import Model, history_section

TIME = np.arange(0.0, 2.0, 0.02)
MODEL = Model("_model", "first", "model")


def segment(number, gap):
    return History(
        number,
        "f",
        f"m{number}",
        TIME,
        {"q_radps": np.sin(TIME), "q_radps_model": np.sin(TIME) + gap},
    )


def test_the_worst_segments_come_first_and_all_when_asked():
    found = [segment(k, gap) for k, gap in enumerate((0.01, 0.05, 0.03))]
    names = {}
    for most in (2, None):
        (section,) = history_section(
            found,
            {"q_radps": 0.01},
            [MODEL],
            "T",
            max_segments=most,
            file=lambda rank, h: f"{rank}-{h.number}",
        )
        names[most] = [part.blocks[-1].file for part in section.parts]
    assert names == {2: ["0-1", "1-2"], None: ["0-1", "1-2", "2-0"]}
    assert "5.00 times the noise" in section.parts[0].blocks[0].text
    assert history_section([], {}, [MODEL], "T") == ()
