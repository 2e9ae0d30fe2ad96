"""One p-box within another: by hand, and over two campaigns."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS, records
from campaigns.library.tables import common_airs
from tests.helpers import campaign_fakes as fakes
from tests.helpers.campaign_scripts import campaign_script
from tests.helpers.study_flights import fly_study, with_medians
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS, FlightResult
from uqharness.simulator.aircraft import PROJECT_ROOT
from uqharness.statistics.pbox import Sample, containment, envelope, pbox

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)

_SCRIPT = campaign_script("time-varying")
main, HOME = _SCRIPT.main, _SCRIPT.HOME


@pytest.fixture(autouse=True, scope="module")
def _no_check_flight():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        yield


def uniform(name, low, high, flights=200):
    return Sample(name, np.linspace(low, high, flights))


def test_a_pbox_inside_beside_and_across_another():
    corners = [uniform("0", 0.0, 1.0), uniform("1", 1.0, 2.0)]
    inside = containment([uniform("a", 0.2, 1.2), uniform("b", 0.8, 1.8)], corners)
    assert inside.verdict == "inside"
    assert (inside.excess_lower, inside.excess_upper) == (0.0, 0.0)
    # Areas between uniform distributions are distances of their means: 0.6 within 1.0.
    assert inside.area_ratio == pytest.approx(0.6, abs=0.01)
    outside = containment([uniform("a", 0.5, 1.5), uniform("b", 1.5, 2.5)], corners)
    assert outside.verdict == "outside"
    assert outside.excess_lower == pytest.approx(0.5, abs=0.01)
    assert 1.49 <= outside.at_lower <= 2.0
    assert outside.excess_upper == 0.0
    assert np.isnan(outside.at_upper)
    slightly = containment([uniform("a", 0.05, 1.05), uniform("b", 1.05, 2.05)], corners)
    assert slightly.verdict == "outside-by-chance"
    assert 0.0 < slightly.excess_lower < slightly.chance


def test_the_envelope_is_the_pbox_and_counts_failures_on_both_sides():
    rng = np.random.default_rng(3)
    result = [Sample("0", rng.normal(size=40), 2), Sample("1", rng.normal(0.5, 1.0, 30), 0)]
    box = pbox(result)
    lower, upper = envelope(result, box.value)
    assert np.array_equal(lower, box.lower)
    assert np.array_equal(upper, box.upper)
    with pytest.raises(ValueError, match="at least one flight"):
        envelope([Sample("0", np.zeros(0))], box.value)
    with pytest.raises(ValueError, match="known value"):
        containment([Sample("0", np.zeros(0), 1)], [Sample("0", np.zeros(0), 1)])


def test_twins_are_called_outside_by_chance_no_more_often_than_stated():
    rng = np.random.default_rng(11)
    invalid = 0
    for _ in range(60):
        inner = [Sample(str(k), rng.normal(size=25)) for k in range(8)]
        outer = [Sample(str(k), rng.normal(size=25)) for k in range(8)]
        invalid += containment(inner, outer).verdict == "outside"
    assert invalid <= 0.05 * 60


def gentle(spec):
    """Errors grow with the level; those of a walk lie between the ends."""
    draw = np.random.default_rng([spec.seed_turbulence, spec.seed_noise])
    level = spec.properties.get("uq/CX/level", 0.5)
    metrics = {name: (1.0 + 9.0 * level) * float(draw.gamma(4.0)) for name in fakes.ERROR_METRICS}
    return FlightResult(
        "ok", "", spec.burn_in_s + spec.duration_s, metrics | {"loss_of_control": 0.0}, {}, {}
    )


CX_ALONE = fakes.CAMPAIGN.partition("bounds =")[0].replace("flights = 3", "flights = 60") + (
    'coefficients = ["CX"]\nbounds = { CX = 0.008 }\ninterior = 0\nnominal = false\n'
)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("study")
    texts = {
        "corners": CX_ALONE,
        "walks": CX_ALONE.replace("interior = 0\nnominal = false\n", "").replace(
            '"corners"', '"walk"\nsamples = 3\nwalk_rate_per_sqrt_s = 0.012'
        ),
    }
    for name, text in texts.items():
        spec = read_campaign(fakes.campaign_file(tmp_path, text))
        run_campaign(spec, tmp_path / name, executor=SerialExecutor(), fly=gentle)
    return tmp_path


def test_unlike_campaigns_are_not_compared(folders, capsys):
    other = CX_ALONE.replace("duration_s = 150", "duration_s = 90").replace("seed = 7", "seed = 8")
    spec = read_campaign(fakes.campaign_file(folders, other))
    run_campaign(spec, folders / "other", executor=SerialExecutor(), fly=gentle)
    assert (
        main([str(folders / "corners"), str(folders / "other"), "--out", str(folders / "study")])
        == 2
    )
    message = capsys.readouterr().err
    assert "[aleatory] duration_s (150.0 and 90.0)" in message
    assert "[campaign] seed (7 and 8)" in message
    assert main([str(folders), str(folders / "other"), "--out", str(folders / "study")]) == 2


def test_the_committed_campaigns_fly_the_same_air():
    read = [
        read_campaign(PROJECT_ROOT / "campaigns" / "time-varying" / f"{name}.toml")
        for name in ("walks", "corners")
    ]
    assert read[0].aleatory == read[1].aleatory
    assert read[0].campaign == read[1].campaign
    assert read[0].epistemic.bounds == read[1].epistemic.bounds
    grid = read_campaign(PROJECT_ROOT / "campaigns" / "excursions" / "campaign.toml").aleatory
    assert (len(grid.wind_mps), grid.turbulence) == (8, ("light", "moderate", "severe"))


def between(scatter):
    """Corners lie from 10 to 16; walks about the middle, ``spread`` times as far from it as
    corners.
    """

    def change(flight) -> float:
        air = 0.1 * float(np.random.default_rng(flight.seed_turbulence).normal())
        if flight.levels is None:
            return 10.0 + air + sum(flight.properties[f"uq/{name}/level"] for name in COEFFICIENTS)
        return 13.0 + air + scatter * 3.0 * (int(flight.levels.epistemic_id[-1]) / 3.5 - 1.0)

    return change


@pytest.fixture(scope="module")
def corners(tmp_path_factory):
    path = tmp_path_factory.mktemp("corners") / FLIGHTS
    return fly_study(EXCURSIONS / "campaign.toml", "severe-3", path, with_medians(between(1.0)))


@pytest.mark.parametrize(
    ("scatter", "verdict", "area"), [(0.5, "inside", 0.5), (1.5, "outside", 1.5)]
)
def test_walks_within_the_corners_and_beyond(corners, tmp_path, capsys, scatter, verdict, area):
    fly, path = with_medians(between(scatter)), tmp_path / FLIGHTS
    walks = fly_study(HOME / "walks.toml", "severe-3", path, fly, samples=range(8))
    code = main([str(corners), str(walks), "--out", str(tmp_path)])
    assert code == (verdict == "outside")
    frame = pd.read_csv(tmp_path / "containment.csv").set_index("metric")
    row = frame.loc["speed_median_mps"]
    assert row["verdict"] == verdict
    assert row["area_ratio"] == pytest.approx(area, abs=0.05)
    assert (row["corners"], row["walks"], row["hours_per_walk"]) == (64, 8, 25)
    grown = pd.read_csv(tmp_path / "walks-enough.csv")
    areas = grown[grown["metric"] == "speed_median_mps"].set_index("samples")["area"]
    assert areas.index.tolist() == [2, 4, 8]
    assert areas.is_monotonic_increasing
    assert set(pd.read_csv(tmp_path / "rates.csv")["kind"]) == {"corners", "walks"}
    assert "100 % with 8" in capsys.readouterr().out


def test_the_published_flights_are_all_there():
    (rows,) = records(HOME / FLIGHTS).values()
    assert sum(row["flights"] for row in rows) == 2000 * 50


def test_a_round_that_is_not_complete_is_left_out():
    walks = pd.DataFrame(
        {"epistemic_id": ["a", "b", "a", "b", "a"], "aleatory_id": [0, 0, 1, 1, 2]}
    )
    corner = pd.DataFrame({"epistemic_id": ["x"] * 3, "aleatory_id": [1, 2, 3]})
    outer, inner = common_airs(corner, walks)
    assert outer["aleatory_id"].tolist() == [1]
    assert inner["aleatory_id"].tolist() == [1, 1]
    with pytest.raises(BadInputError, match="no air in common"):
        common_airs(corner[corner["aleatory_id"] == 3], walks)
