"""Flights of a finished study in one Parquet file: what it keeps, and that damage is seen."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import (
    FLIGHTS,
    METRICS,
    RESOLUTION,
    case_tables,
    cases_of,
    coded,
    decoded,
    main,
    records,
    settings,
)
from campaigns.library.tables import smoothed, write_cost
from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.tables import CASES
from uqharness.errors import BadInputError

FINE = 0.0005


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A complete campaign folder, and the Parquet file made of it."""
    folder = tmp_path_factory.mktemp("study")
    text = fakes.CAMPAIGN.replace("wind_mps = 3", "wind_mps = [3, 7]")
    spec = read_campaign(fakes.campaign_file(folder, text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        run_campaign(spec, folder / "results", executor=SerialExecutor(), fly=fakes.by_corner)
    assert main([str(folder / "results"), str(folder / FLIGHTS)]) == 0
    return folder


def test_the_grid_keeps_order_zero_and_undefined_values():
    rising = coded(np.geomspace(1e-3, 1e3, 5000))
    assert np.all(np.diff(rising.astype(int)) >= 0)
    back = decoded(coded(np.array([0.0, np.nan, np.inf, 1.0])).astype(float).filled(np.nan))
    assert back[0] == 0.0
    assert np.isnan(back[1:3]).all()


@pytest.mark.parametrize("resolution", [RESOLUTION, FINE])
def test_curves_drawn_from_the_grid_are_exact_at_its_edges(resolution):
    values = np.random.default_rng(8).normal(3.0, 0.03, 400)
    retained = decoded(coded(values, resolution).astype(float).filled(np.nan), resolution)
    drawing = smoothed(retained, resolution)
    assert np.all(np.diff(drawing) > 0)
    np.testing.assert_allclose(np.sort(drawing), np.sort(values), rtol=2.0 * resolution)
    for edge in np.unique(retained) / (1.0 - resolution):
        assert np.mean(drawing <= edge) == np.mean(values <= edge)


def test_the_file_has_the_flights_of_the_campaign_folder(study):
    folder, file = (list(case_tables(study / name)) for name in ("results", FLIGHTS))
    assert len(folder) == len(file) == 2
    for one, other in zip(folder, file, strict=True):
        other.index = one.index
        for name in ("epistemic_id", "aleatory_id", "wind_mps", "status", "duration_s", "level_CX"):
            assert one[name].tolist() == other[name].tolist()
        assert one["excursions_15m"].tolist() == other["excursions_15m"].tolist()
        for name in METRICS:
            np.testing.assert_allclose(other[name], one[name].astype(float), rtol=RESOLUTION)
    assert sum(frame["excursions_15m"].sum() for frame in file) > 0
    (cell,) = case_tables(study / FLIGHTS, cell="moderate-7")
    pd.testing.assert_frame_equal(cell.reset_index(drop=True), file[1].reset_index(drop=True))
    assert settings(study / FLIGHTS)["metrics"] == settings(study / "results")["metrics"]
    write_cost(study / FLIGHTS, study)
    assert "all,2,384,16,0," in (study / "cost.csv").read_text()


def test_a_cell_without_flights_and_damage_are_bad_input(study, tmp_path):
    with pytest.raises(BadInputError, match="no flights of severe-3, but of moderate-3"):
        next(case_tables(study / FLIGHTS, cell="severe-3"))
    with pytest.raises(BadInputError, match="has no cell severe-9"):
        cases_of(EXCURSIONS / "campaign.toml", "severe-9", range(1))
    shutil.copy(study / "campaign.toml", tmp_path)
    content = bytearray((study / FLIGHTS).read_bytes())
    content[1000] ^= 255
    (tmp_path / FLIGHTS).write_bytes(content)
    with pytest.raises(BadInputError, match="damaged"):
        list(case_tables(tmp_path / FLIGHTS))
    with pytest.raises(BadInputError, match="not the flights of a study"):
        records(study / "results" / CASES)
    assert main([str(tmp_path), str(tmp_path / "x.parquet")]) == 2


def test_the_published_flights_are_all_there():
    cells = records(EXCURSIONS / FLIGHTS)
    assert len(cells) == 24
    assert sum(row["flights"] for rows in cells.values() for row in rows) == 768_000


@pytest.mark.slow
def test_a_flight_of_the_published_tables_comes_out_again():
    """The batch engine of today gives the counts and medians that the file has."""
    from uqharness.campaign.processes import BATCH, fly_group

    cases = cases_of(EXCURSIONS / "campaign.toml", "severe-7", range(1))[:8]
    frame = next(case_tables(EXCURSIONS / FLIGHTS, cell="severe-7"))[:8]
    results = fly_group(BATCH, [case.flight for case in cases])
    assert frame["epistemic_id"].tolist() == [case.epistemic_id for case in cases]
    for name in ("excursions_15m", "excursions_25m"):
        assert frame[name].tolist() == [result.metrics[name] for result in results]
    for name in METRICS:
        values = [result.metrics[name] for result in results]
        np.testing.assert_allclose(frame[name], values, rtol=RESOLUTION)
