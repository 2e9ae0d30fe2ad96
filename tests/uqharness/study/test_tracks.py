"""Ground tracks of a study, flown by JSBSim: the worst corner's is the campaign's own flight, the
nominal one is another.
"""

from __future__ import annotations

import pandas as pd
import pytest

from uqharness.campaign import read_cases, read_complete
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.statements import statements
from uqharness.study.answer import TRACKS, TrackRequest, fly_tracks, hardest

pytestmark = pytest.mark.usefixtures("flights_here")

CAMPAIGN = """
[campaign]
aircraft = "espaaro"
mission = "loiter"
seed = 5
engine = "jsbsim"

[aleatory]
flights = 2
duration_s = 12
burn_in_s = 8
wind_mps = [3, 9]
turbulence = "light"

[epistemic]
method = "corners"
interior = 0
nominal = false
coefficients = ["CY"]
bounds = { CY = 0.05 }

[metrics]
excursion_radius_m = [15, 4]
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracks")
    (folder / "campaign.toml").write_text(CAMPAIGN)
    run_campaign(read_campaign(folder / "campaign.toml"), folder / "flown", workers=1)
    return folder / "flown"


@pytest.fixture(scope="module")
def requests(campaign):
    manifest = read_complete(campaign)
    frame = read_cases(campaign, manifest)
    return TrackRequest(campaign, frame, hardest(statements(frame, manifest["campaign"])))


def test_the_hardest_condition_and_the_smallest_radius_are_drawn(requests):
    cell = requests.statement.cell
    assert (cell.condition.wind_mps, cell.radius_m, cell.distance) == (9.0, 4.0, "horizontal")
    assert hardest([]) is None


def test_the_worst_corner_is_flown_as_in_the_campaign_and_the_nominal_model_without_deltas(
    tmp_path, requests
):
    result = fly_tracks(tmp_path, {"before": requests}, workers=1)
    assert (result["wind_mps"], result["turbulence"], result["radius_m"]) == (9.0, "light", 4.0)
    table = pd.read_parquet(tmp_path / TRACKS)
    assert list(table) == [
        "when",
        "model",
        "epistemic_id",
        "time_s",
        "north_m",
        "east_m",
        "distance_m",
    ]
    largest = {model: rows["distance_m"].abs().max() for model, rows in table.groupby("model")}
    rows = requests.frame[
        (requests.frame["wind_mps"] == 9.0)
        & (requests.frame["aleatory_id"] == result["aleatory_id"])
    ]
    scored = rows.set_index("epistemic_id")["cross_track_max_m"]
    worst = requests.statement.worst.epistemic_id
    # The campaign scored the same flight at 10 Hz, the track has every other row.
    assert largest["worst corner"] == pytest.approx(scored[worst], rel=0.01)
    (other,) = set(scored.index) - {worst}
    assert abs(largest["worst corner"] - scored[other]) > 0.05 * scored[worst]
    assert abs(largest["nominal"] - largest["worst corner"]) > 0.05 * scored[worst]
