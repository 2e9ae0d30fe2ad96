"""The study of the next flight over seeds: its verdict on made-up rows always, one seed and eight
in the slow set.
"""

from __future__ import annotations

import pandas as pd
import pytest

from tests.helpers.campaign_scripts import campaign_script
from uqharness.next_flight.plan import Options

_SCRIPT = campaign_script("next-flight")
CASES = _SCRIPT.CASES
Study = _SCRIPT.Study
mission_of = _SCRIPT.mission_of
narrowings = _SCRIPT.narrowings
tables = _SCRIPT.tables
verdict = _SCRIPT.verdict


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """One seed of the case with most to learn, from fewer points and a flight of a minute and a
    quarter.
    """
    folder = tmp_path_factory.mktemp("flights")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.next_flight.points.AMPLITUDES", (0.2,))
        study = Study(folder, mission_of(folder), Options(1.25, (22.0,)), {})
        return pd.DataFrame(study.run(CASES[0], 2))


@pytest.mark.slow
def test_one_seed_comes_out_as_predicted(rows):
    specific = narrowings(rows).query("coefficient == `for`").iloc[0]
    assert specific["achieved_parameter"] > 80.0
    assert specific["ratio_parameter"] == pytest.approx(1.0, abs=0.1)
    assert specific["achieved"] > 30.0
    assert specific["ratio"] == pytest.approx(1.0, abs=0.35)
    assert set(rows["coefficient"]) == {"CX", "CY", "CZ", "Cl", "Cm", "Cn"}


def made_up() -> pd.DataFrame:
    """Rows of a seed whose predictions all come out."""
    widths = {
        "now": 1.0,
        "known": 0.5,
        "predicted": 0.5,
        "achieved": 0.5,
        "old_predicted": 0.8,
        "old_achieved": 0.8,
        "at_most": 0.4,
    }
    parts = {
        f"{kind}_parameter": 0.4 * widths[kind]
        for kind in ("now", "predicted", "achieved", "old_predicted", "old_achieved")
    }
    coefficients = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
    return pd.DataFrame(
        {
            "case": "made up",
            "seed": 2,
            "for": "CY",
            "coefficient": coefficients,
            "seconds": 75.0,
            **widths,
            **parts,
        }
    )


def test_the_verdict_says_no_where_a_prediction_is_off():
    rows = made_up()
    seeds = pd.concat(
        [rows.assign(seed=k, achieved=rows["predicted"] * (1.0 + 0.01 * k)) for k in range(3)]
    )
    seeds["achieved_parameter"] = seeds["predicted_parameter"]
    assert verdict(narrowings(seeds)) == []
    assert "| CY |" in tables(seeds)
    off = seeds.assign(
        achieved_parameter=0.5 * (seeds["now_parameter"] + seeds["predicted_parameter"])
    )
    assert any("parameter part is 2.00" in line for line in verdict(narrowings(off)))
    wide = seeds.assign(achieved=0.5 * (seeds["now"] + seeds["achieved"]))
    assert any("of the width" in line for line in verdict(narrowings(wide)))
