"""The modal example: its model, its published tables cell by cell, and the same through JSBSim."""

from __future__ import annotations

import json

import numpy as np
import pytest

from campaigns.library.study import published_table
from campaigns.modal.reproduce import compare, published, table_text
from campaigns.modal.through_jsbsim import linear_model, nominal_trim, outputs_of, successive_models
from uqharness.cli.main import run_words
from uqharness.errors import BadInputError
from uqharness.sensitivity import analyse
from uqharness.sensitivity.modal import (
    ALEATORY,
    NOMINAL,
    OUTPUTS,
    modal_model,
    modal_sensitivity,
    modes_of,
    run_modal_study,
    system_matrix,
)
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.linear import linearise, modes
from uqharness.simulator.trim import SteadyCondition, find_trim

MEANS = dict(NOMINAL) | {name: mean for name, (mean, _) in ALEATORY.items()}


def arrays(**changes):
    return {
        name: np.atleast_1d(np.asarray(value, dtype=float))
        for name, value in (MEANS | changes).items()
    }


@pytest.fixture(scope="module")
def as_published():
    return modal_sensitivity("as_published", 16, seed=0)


def test_corrected_reading_agrees_with_an_independent_linearisation_of_the_same_aeroplane():
    zeta_phugoid, wn_phugoid, zeta, wn = (
        float(value[0]) for value in modes_of(system_matrix("as_corrected", arrays()))
    )
    # Six-degree-of-freedom linearisation, thrust held: -4.728 +- 3.786i, -0.0449 +- 0.4418i; the
    # chapter's model drops small terms.
    assert (zeta, wn) == pytest.approx((0.781, 6.06), rel=0.005)
    assert wn_phugoid == pytest.approx(0.444, rel=0.01)
    assert 0.08 < zeta_phugoid < 0.11


def test_published_frequency_is_the_ratio_of_damping():
    zeta, ratio = (modal_model("as_published")(**arrays())[name] for name in OUTPUTS[1:])
    assert ratio == pytest.approx(zeta / np.sqrt(1 - zeta**2))


@pytest.mark.slow
def test_every_printed_cell_agrees_but_one_or_two(as_published):
    cells, factors = compare(as_published)
    assert len(cells) == 180
    missed = {(cell.output, cell.parameter, cell.column) for cell in cells if not cell.agrees}
    reference = {("short_period_frequency", name, "proposed_max") for name in ("CZ_alpha", "Cm_q")}
    assert missed <= reference
    assert ("short_period_frequency", "CZ_alpha", "proposed_max") in missed
    assert all(abs(factor - 1.0) < 0.08 for factor in factors.values())


def test_the_comparison_says_no_to_the_other_reading():
    cells, _ = compare(modal_sensitivity("as_corrected", 2, seed=0))
    assert sum(not cell.agrees for cell in cells) > 40
    text = table_text("phugoid_damping", cells, 1.0)
    assert "**" in text
    assert "`Cm_de`" in text


def test_the_correction_moves_the_share_of_cz_0():
    printed, corrected = (
        analyse(run_modal_study(reading, samples=16, draws=10), ("proposed",), intervals=False)[
            "phugoid_damping"
        ]["proposed"].indices["CZ_0"]
        for reading in ("as_published", "as_corrected")
    )
    assert 0.3 < printed.minimum.value < printed.maximum.value < 0.4
    assert 0.02 < corrected.minimum.value < corrected.maximum.value < 0.08


def test_printed_tables_are_all_there():
    for output in OUTPUTS:
        table = published(output)
        assert list(table.index) == list(NOMINAL)
        assert (table["proposed_min"].astype(float) <= table["proposed_max"].astype(float)).all()
    loiter = published_table("4.7", index_col=0)
    for quantity in ("cross_track", "altitude", "speed"):
        assert (loiter[f"{quantity}_min"] <= loiter[f"{quantity}_max"]).all()
    assert loiter["cross_track_max"].idxmax() == "Cn"


def call(*words):
    return run_words(["sensitivity", *map(str, words)])


def test_the_command_gives_the_contracted_json_and_a_text(capsys):
    assert call("--modal", "as_published", "--repeats", "2", "--json") == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert captured.err == ""
    assert tuple(result) == OUTPUTS
    for parameters in result.values():
        assert tuple(parameters) == tuple(NOMINAL)
        for cell in parameters.values():
            low, high = cell["proposed"]
            assert low <= high
            for method in ("local", "scatter", "anova", "pbox"):
                at, (lo, hi) = cell[method], cell["interval"][method]
                assert lo <= at <= hi
    assert result["phugoid_damping"]["CZ_0"]["proposed"] == pytest.approx([0.316, 0.361], abs=0.002)
    assert call("--modal", "as_corrected", "--repeats", "2") == 0
    text = capsys.readouterr().out
    assert "R^2 adds up to" in text
    assert "Cm_alpha" in text


@pytest.fixture(scope="module")
def espaaro():
    return find_aircraft("espaaro")


def test_jsbsim_modes_agree_with_the_full_linearisation(espaaro):
    properties = {"aero/Cm_q": -13.0, "aero/CX_0": -0.04}
    full = find_trim(espaaro, SteadyCondition(20.0, properties=properties))
    by_name = {mode.name: mode for mode in modes(linearise(espaaro, full))}
    result = outputs_of(nominal_trim(espaaro), {"Cm_q": -13.0, "CX_0": -0.04})
    expected = [
        by_name["phugoid"].zeta,
        by_name["short_period"].zeta,
        by_name["short_period"].wn_radps,
    ]
    assert result == pytest.approx(expected, rel=2e-4)


def test_a_model_without_level_flight_is_refused(espaaro):
    with pytest.raises(BadInputError, match="no level flight"):
        linear_model(nominal_trim(espaaro), {"aero/CZ_alpha": -0.01})


def test_what_the_linear_model_leaves_out_ends_at_jsbsim(espaaro):
    rows = successive_models(espaaro)
    assert rows[-2][1] == pytest.approx(rows[-1][1], rel=1e-3)
    # The thrust that falls with speed trebles the phugoid's damping; the short period hardly moves.
    first, thrust = rows[0][1], rows[1][1]
    assert thrust[0] > 2.5 * first[0]
    assert rows[-1][1][2:] == pytest.approx(first[2:], rel=0.005)
