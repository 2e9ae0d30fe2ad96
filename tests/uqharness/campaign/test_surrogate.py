"""A real autopilot against the built-in one: paired flights, and p-boxes corrected by them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import uqharness as uq
from tests.uqharness.flight.test_autopilot_process import PEER
from uqharness.campaign import control_variate
from uqharness.cli.main import main


def test_the_corrected_pbox_covers_the_real_one():
    """Real metric .5 + .8 x + scatter: coverage of quantiles over 200 campaigns."""
    rng = np.random.default_rng(1)
    hits = {0.05: 0, 0.5: 0, 0.95: 0}
    widths = []
    for _ in range(200):
        members = {"a": rng.normal(5.0, 1.0, 400), "b": rng.normal(6.0, 1.0, 400)}
        x = np.concatenate([members["a"][:6], members["b"][:6]])
        real = 0.5 + 0.8 * x + rng.normal(0.0, 0.3, len(x))
        result = control_variate(x, real, members)
        # The members' true quantiles: normal, 4.5 or 5.3, of the line's and the scatter's variance.
        for probability, z in ((0.05, -1.645), (0.5, 0.0), (0.95, 1.645)):
            low, high = result.quantiles[probability][1]
            reach = z * np.hypot(0.8, 0.3)
            hits[probability] += low <= 4.5 + reach and 5.3 + reach <= high
        widths.append(result.mean[2] - result.mean[1])
        assert result.slope == pytest.approx(0.8, abs=0.6)
    # Nominal 95 %; the scatter itself is estimated from twelve pairs.
    assert all(count > 0.91 * 200 for count in hits.values()), hits
    # The control variate pays: twelve flights alone give a mean within +-.57 (t 2.2, std .9).
    assert np.median(widths) < 0.5


def test_equal_autopilots_leave_the_pbox():
    members = {"a": np.random.default_rng(2).normal(5.0, 1.0, 300)}
    same = control_variate(members["a"][:5], members["a"][:5], members)
    assert same.difference == (0.0, 0.0, 0.0)
    assert not same.differs
    for before, after in same.quantiles.values():
        assert after == pytest.approx(before, abs=0.05)
    # A surrogate without any spread tells no slope: the mean difference alone corrects.
    flat = control_variate(np.full(4, 2.0), np.array([3.0, 3.2, 2.8, 3.0]), {"a": np.full(9, 2.0)})
    assert (flat.slope, flat.mean[0]) == (1.0, pytest.approx(3.0))
    assert flat.differs


@pytest.mark.slow
def test_flights_of_a_stand_in_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    campaign = {
        "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1, "engine": "jsbsim"},
        "aleatory": {
            "flights": 4,
            "duration_s": 3,
            "burn_in_s": 1,
            "wind_mps": [3],
            "turbulence": ["light"],
        },
        "epistemic": {"method": "none"},
    }
    out = tmp_path / "results"
    flight = uq.run_campaign(campaign, out, workers=1)
    peer = tmp_path / "peer.py"
    peer.write_text(PEER)
    words = ["campaign", "surrogate-check", str(out), "--autopilot-port", "0", "--flights", "4"]
    words += ["--metric", "speed_median_mps", "--metric", "cross_track_median_m", "--json"]

    def check(mode: str) -> tuple[int, dict]:
        command = f"{sys.executable} {peer} {{port}} {mode}"
        code = main([*words, "--autopilot-process", command])
        return code, json.loads(capsys.readouterr().out)

    code, first = check("hold")
    rows = flight.cases.set_index("case_id")
    assert code == 1  # the stand-in flies straight on
    row = first["metrics"]["cross_track_median_m"]
    assert row["differs"]
    pairs = [
        f["metrics"]["cross_track_median_m"] - rows.loc[f["case_id"], "cross_track_median_m"]
        for f in first["flights"]
    ]
    assert row["difference"] == pytest.approx(np.mean(pairs))
    assert len({f["aleatory_id"] for f in first["flights"]}) == 4
    code, dead = check("dies")
    assert (code, dead["failed"], dead["metrics"]) == (1, 4, {})
    assert "ended with exit code 1" in dead["flights"][0]["reason"]
    assert main([*words[:-1], "--autopilot-process", "x", "--autopilot-warmup-s", "2"]) == 2
    assert "scores from 1 s on" in capsys.readouterr().err
    # A column that is no metric is refused before the first flight.
    assert main([*words[:7], "--metric", "case_id", "--autopilot-process", "x"]) == 2
    assert "--metric case_id: not in" in capsys.readouterr().err
