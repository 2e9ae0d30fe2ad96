"""Statements of a made-up campaign of known rates: limits, clusters of excursions, joint confidence."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from uqharness.campaign.statements import (
    bound_dispersion,
    joint_level,
    joint_words,
    statements,
    statements_csv,
)
from uqharness.flight.spec import COEFFICIENTS
from uqharness.statistics import observed_dispersion, upper_limits

HOURS = 0.5


def campaign(acceptable=4.0, rule="flights") -> dict:
    air = {"duration_s": 3600.0 * HOURS, "flights": 400, "wind_mps": [3.0], "turbulence": ["none"]}
    return {
        "stop": {"rule": rule},
        "aleatory": air,
        "epistemic": {"method": "corners", "interior": 0, "nominal": False},
        "metrics": {
            "excursion_radius_m": [15.0],
            "acceptable_per_h": acceptable,
            "dispersion": 1.0,
        },
    }


def fly(means=(0.5, 1.5), flights=400, failed=0, seed=0) -> pd.DataFrame:
    """Poisson counts per flight, of corners with these means."""
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame(
        {"epistemic_id": np.repeat([f"{k:02d}" for k in range(len(means))], flights)}
    )
    status = np.where(np.arange(flights) < failed, "crashed", "ok")
    return frame.assign(
        wind_mps=3.0,
        turbulence="none",
        status=np.tile(status, len(means)),
        duration_s=3600.0 * HOURS,
        excursions_15m=np.concatenate([rng.poisson(mean, flights) for mean in means]).astype(float),
        excursions_15m_3d=np.nan,
        extrapolated_share=0.25,
    )


def test_the_best_and_the_worst_corner_and_their_limits():
    frame = fly()
    (result,) = statements(frame, campaign())
    rates = frame.groupby("epistemic_id")["excursions_15m"].mean() / HOURS
    assert (result.best.epistemic_id, result.worst.epistemic_id) == ("00", "01")
    assert (result.best.rate, result.worst.rate) == pytest.approx((rates["00"], rates["01"]))
    for item, truth in ((result.best, 1.0), (result.worst, 3.0)):
        assert item.lower < truth < item.upper
    assert result.answer == "yes"
    assert result.extrapolated_share == 0.25
    assert result.corner_limits.shape == (2, 2)
    assert result.dispersion_observed == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize(("acceptable", "answer"), [(4.0, "yes"), (3.0, "open"), (2.0, "no")])
def test_the_answer_is_about_the_worst_corner_and_a_decision_that_was_taken_stands(
    acceptable, answer
):
    assert statements(fly(), campaign(acceptable))[0].answer == answer
    row = {"condition": "3 m/s none", "radius_m": "15", "epistemic_id": "all", "answer": "flying"}
    assert statements(fly(), campaign(acceptable), [row])[0].answer == "flying"
    other = [{**row, "radius_m": "25"}]
    assert statements(fly(), campaign(acceptable), other)[0].answer == answer


def test_a_flight_that_failed_may_have_had_one_more():
    complete, broken = (statements(fly(failed=k), campaign())[0] for k in (0, 160))
    assert broken.worst.rate == pytest.approx(complete.worst.rate + 0.4 / HOURS)
    assert broken.best.rate == complete.best.rate
    assert broken.answer != "yes"


def ended(frame: pd.DataFrame, share: float, flown: float = 0.1) -> pd.DataFrame:
    """The same where that share of each corner's flights diverged after so much of their time."""
    for _, group in frame.groupby("epistemic_id"):
        rows = group.index[: round(share * len(group))]
        frame.loc[rows, ["status", "duration_s"]] = ("diverged", 3600.0 * HOURS * flown)
    return frame


@pytest.mark.parametrize(("share", "answer"), [(0.0, "yes"), (1.0, "no"), (0.3, "no")])
def test_flights_that_all_end_early_are_not_acceptable(share, answer):
    """400 flights of half an hour without another excursion: as many as 0.6 are aborted per
    scheduled hour, and "at most 0.5?".
    """
    (result,) = statements(ended(fly((0.0, 0.0)), share), campaign(0.5))
    assert result.answer == answer
    assert result.aborted["diverged"] == 2 * 400 * share


def test_aborted_flights_have_an_acceptable_rate_of_their_own():
    frame = ended(fly((0.0, 0.0)), 0.02, flown=0.5)
    strict, lax = campaign(0.5), campaign(0.5)
    strict["metrics"]["acceptable_loss_per_h"] = 0.01
    assert statements(frame, lax)[0].answer == "yes"
    result = statements(frame, strict)[0]
    assert result.answer != "yes"
    assert result.acceptable_loss_per_h == 0.01
    assert 0.04 < result.loss_upper_per_h < 0.5


def test_control_lost_counts_as_one_excursion_and_a_silent_cell_bounds_the_share_of_flights():
    silent = fly((0.0, 0.0))
    (result,) = statements(silent.assign(loss_of_control=1), campaign(0.5))
    assert (result.worst.rate, result.best.rate) == pytest.approx((1.0 / HOURS, 0.0))
    assert result.aborted["loss_of_control"] == 800
    # Clopper and Pearson: nothing in 400 flights leaves 1 - 0.05^(1/400).
    share = statements(silent, campaign())[0].flight_share_upper
    assert share == pytest.approx(1.0 - 0.05 ** (1.0 / 400.0))


def with_nearer(frame: pd.DataFrame, cluster: int) -> tuple[pd.DataFrame, dict]:
    """The same with excursions beyond 10 m, .4 per hour in clusters, counted for their dispersion
    alone.
    """
    closer = cluster * np.random.default_rng(3).poisson(0.4 * HOURS / cluster, len(frame))
    result = campaign(0.02)
    result["metrics"] |= {"dispersion": 2.0, "dispersion_radius_m": [10.0]}
    return frame.assign(excursions_10m=closer.astype(float), excursions_10m_3d=np.nan), result


def test_clusters_that_a_smaller_radius_shows_forbid_a_yes():
    """Nothing in 200 h: at most 0.04 per hour where excursions come alone, and nothing of the kind
    where they come by eights.
    """
    answers = {}
    for cluster in (1, 8):
        frame, result = with_nearer(fly((0.0, 0.0)), cluster)
        result["metrics"]["acceptable_per_h"] = 0.04
        answers[cluster] = statements(frame, result)[0].answer
    assert answers == {1: "yes", 8: "open"}


def test_clusters_beyond_the_carried_limit_are_no_yes_and_say_so():
    frame, output = with_nearer(fly((0.0, 0.0)), 1)
    output["metrics"]["acceptable_per_h"] = 0.2
    assert statements(frame, output)[0].answer == "yes"
    frame["excursions_10m"] = 0.0
    for _, group in frame.groupby("epistemic_id"):
        frame.loc[group.index[:5], "excursions_10m"] = 5.0
    (result,) = statements(frame, output)
    assert (result.answer, result.reason) == ("open", "clusters beyond the carried limit")
    assert "clusters beyond the carried limit" in statements_csv([result]).decode()


FLIGHTS, ASSUMED, ERROR = 500, 2.0, 0.05


HOURS_CARRIED = np.array([float(FLIGHTS)])


def counts(per_h: float, cluster: int = 1, seed: int = 1) -> np.ndarray:
    """(1, flights of an hour) in clusters."""
    return (cluster * np.random.default_rng(seed).poisson(per_h / cluster, (1, FLIGHTS))).astype(
        float
    )


SILENT = np.zeros((1, FLIGHTS))


def few(cluster: float, number: int) -> np.ndarray:
    """So many clusters in the first flights."""
    result = np.zeros((1, FLIGHTS))
    result[0, :number] = cluster
    return result


@pytest.mark.parametrize(
    ("closer", "demanded", "measured", "limits", "contradicted"),
    [
        # Without a smaller radius it is assumed; a larger one tells nothing.
        ({}, SILENT, 0, (ASSUMED, ASSUMED), False),
        ({25.0: counts(0.5, 4)}, SILENT, 0, (ASSUMED, ASSUMED), False),
        # Single excursions nearer by are carried as such, clusters with a margin.
        ({8.0: counts(0.5), 12.0: counts(0.2)}, SILENT, 1, (1.0, 1.8), False),
        ({10.0: counts(0.5, 4)}, SILENT, 1, (4.0, 10.0), False),
        # Too few and too frequent ones measure nothing.
        ({10.0: counts(0.02)}, SILENT, 0, (ASSUMED, ASSUMED), False),
        ({10.0: counts(0.2)}, SILENT, 1, (1.0, 2.0), False),
        ({10.0: counts(3.0)}, SILENT, 0, (ASSUMED, ASSUMED), False),
        # 20 excursions in clusters of 4 are too few to measure by and enough to contradict 2;
        # single ones contradict nothing.
        ({10.0: few(4.0, 5)}, SILENT, 0, (ASSUMED, np.inf), True),
        ({}, few(4.0, 5), 0, (ASSUMED, np.inf), True),
        ({10.0: few(1.0, 20)}, SILENT, 0, (0.0, np.inf), False),
        ({}, few(1.0, 20), 0, (ASSUMED, ASSUMED), False),
    ],
)
def test_clusters_at_smaller_radii_bound_the_dispersion(
    closer, demanded, measured, limits, contradicted
):
    result = bound_dispersion({**closer, 15.0: demanded}, 15.0, HOURS_CARRIED, ASSUMED, ERROR)
    assert limits[0] <= result.dispersion[0] <= limits[1]
    assert (result.measured, result.is_contradicted) == (measured, contradicted)
    nearest = max((radius for radius in closer if radius < 15.0), default=0.0)
    if measured:
        assert result.radius_m == pytest.approx([nearest])
    if not closer:
        assert np.isnan(result.nearest_m)


def false_yes(
    cluster: int, nearer_per_h: float | None, repeats: int = 1500, hours: int = 80
) -> float:
    """Share of campaigns of flights of an hour that call .1 per hour acceptable where a little more
    than that is true.

    Enough hours for a yes at a dispersion of 2 where nothing is seen.
    """
    rng = np.random.default_rng([cluster, repeats])
    flight, shape = np.array([float(hours)]), (repeats, 1, hours)
    request, closer = (
        (cluster * rng.poisson(rate / cluster, shape)).astype(float)
        for rate in (0.1001, nearer_per_h or 1.0)
    )
    result = []
    for row, close in zip(request, closer, strict=True):
        radii = {15.0: row} if nearer_per_h is None else {10.0: close, 15.0: row}
        result.append(bound_dispersion(radii, 15.0, flight, ASSUMED, ERROR))
    allowed = np.maximum(
        observed_dispersion(request[:, 0]), [item.dispersion[0] for item in result]
    )
    limits = upper_limits(
        np.full(repeats, float(hours)), request.sum(axis=(1, 2)), allowed, ERROR / 2
    )
    return float(np.mean((limits <= 0.1) & ~np.array([item.is_contradicted for item in result])))


@pytest.mark.parametrize(
    ("cluster", "nearer_per_h", "repeats"),
    [
        (4, 0.8, 60),
        *(
            pytest.param(*case, 500, marks=pytest.mark.slow)
            for case in ((2, 0.5), (2, 0.8), (4, 0.5), (4, 0.8), (8, 0.5), (8, 0.8))
        ),
    ],
)
def test_a_yes_is_rarely_false_where_a_smaller_radius_shows_the_clusters(
    cluster, nearer_per_h, repeats
):
    assert false_yes(cluster, nearer_per_h, repeats) <= 0.05


def manifest(confidence=0.95, transient=(), **epistemic):
    section = {"method": "corners", "set": "box", "coefficients": list(COEFFICIENTS)}
    section |= {"interior": 16, "nominal": True, **epistemic}
    bounds = {"confidence": confidence, "transient": list(transient)}
    return {"campaign": {"epistemic": section}} | ({"bounds": bounds} if confidence else {})


def test_joint_levels_and_their_words():
    """Six intervals of 95 % hold together at 74 %; an ellipsoid has the level of one interval."""
    assert joint_level(manifest()) == pytest.approx(0.95**6)
    assert joint_level(manifest(coefficients=["CX"])) == 0.95
    assert joint_level(manifest(set="ellipsoid")) == 0.95
    (output,) = joint_words(manifest())
    begin = "box of 6 intervals of 95 % each: together they hold at 73.5 % if independent"
    assert output.startswith(begin)
    assert "4.80 standard deviations" in output
    (output,) = joint_words(manifest(set="ellipsoid"))
    assert output.startswith("joint 95 % ellipsoid of 6 intervals, 3.55 standard deviations")
    walks = "transient model error of CX, Cm walks in every flight"
    assert joint_words(manifest(transient=["CX", "Cm"]))[1] == walks
    left_out = manifest()
    left_out["campaign"]["epistemic"]["transient"] = False
    assert joint_words(left_out)[1] == "no transient model error is flown"
    # Nothing is said where no interval has a confidence.
    for unknown in (manifest(None), manifest(method="none")):
        assert (joint_level(unknown), joint_words(unknown)) == (None, [])
