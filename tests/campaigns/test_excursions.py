"""Excursions beside the published tables: by hand, and over a campaign."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.excursions.reproduce import PUBLISHED, main
from campaigns.library.flights import FLIGHTS, case_tables, records, settings
from campaigns.library.study import published_table
from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.spec import read_bounds
from uqharness.flight.spec import FlightResult
from uqharness.simulator.aircraft import PROJECT_ROOT

pytestmark = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)

SEVERE = fakes.CAMPAIGN.partition("bounds =")[0].replace("flights = 3", "flights = 20").replace(
    "150", "3600"
) + (
    'coefficients = ["CX"]\nbounds = { CX = 0.008 }\ninterior = 0\nnominal = false\n'
    "\n[metrics]\nexcursion_radius_m = [15, 20, 25]\n"
)


@pytest.fixture(autouse=True, scope="module")
def _no_check_flight():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        yield


def counting(within_15m, within_25m):
    """Flights with so many excursions an hour at either corner."""

    def fly(spec):
        draw = np.random.default_rng([spec.seed_turbulence, spec.seed_noise])
        counts = {
            f"excursions_{r}m{d}": int(draw.poisson(rate))
            for r, rate in ((15, within_15m), (20, 0.0), (25, within_25m))
            for d in ("", "_3d")
        }
        metrics = {name: float(draw.gamma(4.0)) for name in fakes.ERROR_METRICS}
        return FlightResult(
            "ok",
            "",
            spec.burn_in_s + spec.duration_s,
            metrics | counts | {"loss_of_control": 0.0},
            {},
            {},
        )

    return fly


def simulate(tmp_path, name, fly, wind=7, turbulence="severe"):
    text = SEVERE.replace("wind_mps = 3", f"wind_mps = {wind}").replace(
        '"moderate"', f'"{turbulence}"'
    )
    run_campaign(
        read_campaign(fakes.campaign_file(tmp_path, text)),
        tmp_path / name,
        executor=SerialExecutor(),
        fly=fly,
    )
    return str(tmp_path / name)


def test_the_published_tables_are_as_printed():
    close, distant = (published_table(PUBLISHED[r]).set_index("wind_mps") for r in (15.0, 25.0))
    assert (close.shape, distant.shape) == ((8, 6), (8, 6))
    assert close["severe_worst"].tolist() == [0.068, 0.092, 0.136, 0.31, 0.868, 2.44, 7.762, 25.342]
    assert close["moderate_worst"].sum() == pytest.approx(4.248)
    assert distant.to_numpy().sum() == pytest.approx(0.002)


def test_a_campaign_beside_the_print(tmp_path, capsys):
    like = simulate(tmp_path, "like", counting(25.0, 0.0))
    assert (
        main([like, "--out", str(tmp_path / "out")]) == 1
    )  # the best corner of the print has 0.002, not 25
    output = capsys.readouterr().out
    assert "worst: 2 cells as published\n" in output
    assert "1 cells more" in output
    frame = pd.read_csv(tmp_path / "out" / "beside-published.csv")
    assert frame["radius_m"].tolist() == [15.0, 25.0]  # nothing was published for 20 m
    assert (frame["hours"] == 40.0).all()
    assert frame["published_worst_per_h"].tolist() == [25.342, 0.002]
    assert (
        frame["published_worst_lower_per_h"][0] < 25.342 < frame["published_worst_upper_per_h"][0]
    )
    many = simulate(tmp_path, "many", counting(60.0, 2.0))
    assert main([many, "--out", str(tmp_path / "out")]) == 1
    assert "worst: 2 cells more" in capsys.readouterr().out


def test_quiet_air_agrees(tmp_path, capsys):
    calm = simulate(tmp_path, "quiet", counting(0.0, 0.0), wind=1, turbulence="light")
    assert main([calm, "--out", str(tmp_path / "out")]) == 0
    assert "published [0, 0]: as published" in capsys.readouterr().out


def test_what_is_not_in_print_is_refused(tmp_path, capsys):
    gale = simulate(tmp_path, "gale", counting(0.0, 0.0), wind=12)
    assert main([gale, "--out", str(tmp_path / "out")]) == 2
    assert "no wind" in capsys.readouterr().err
    assert main([str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 2


HOME = PROJECT_ROOT / "campaigns" / "excursions-from-flights"
MODELS = ("identified", "refined")


def test_refinement_leaves_narrower_bounds_of_what_it_named():
    """Cl_de, Cm_p2 and CX_q are in the refined model, and what they did is no longer in its
    bounds.
    """
    lasting = {}
    for model in MODELS:
        form = read_bounds(HOME / model / "model-form.json")
        lasting[model] = {name: c.parts.persistent for name, c in form.coefficients.items()}
    ratio = {
        name: lasting["refined"][name] / lasting["identified"][name] for name in lasting["refined"]
    }
    assert max(ratio[c] for c in ("CX", "Cl", "Cm")) < 0.5
    assert min(ratio[c] for c in ("CZ", "Cn")) > 0.8


@pytest.mark.parametrize("model", MODELS)
def test_the_flights_are_those_of_the_file_in_the_air_of_the_stand_ins(model):
    ours, theirs = (settings(folder / FLIGHTS) for folder in (HOME / model, EXCURSIONS))
    assert {**ours["aleatory"], "flights": 0} == {**theirs["aleatory"], "flights": 0}
    assert ours["campaign"]["seed"] == theirs["campaign"]["seed"]
    assert len(records(HOME / model / FLIGHTS)) == 24
    frame = next(case_tables(HOME / model / FLIGHTS, cell="severe-7"))
    assert frame.groupby("epistemic_id").size().tolist() == [50] * 64
    assert (frame["status"] == "ok").mean() > 0.9
