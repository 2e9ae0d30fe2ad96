"""Figures for notebooks: they draw into the axes given, name their units and leave everything else
alone.
"""

from __future__ import annotations

from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from sysid.record import FlightRecord
from tests.helpers.model_forms import made_up_form
from uqharness.campaign.conditions import Condition
from uqharness.replay.histories import History
from uqharness.report.plots import (
    plot_history,
    plot_model_form,
    plot_overlay,
    plot_pbox,
    plot_sensitivity,
)
from uqharness.sensitivity import Index, PairRange
from uqharness.statistics.pbox import Sample, pbox

TIME = np.arange(0.0, 4.0, 0.02)
HISTORY = History(
    0, "flight1", "roll doublet", TIME, {"q_radps": np.sin(TIME), "q_radps_model": np.cos(TIME)}
)
BOX = pbox(
    [Sample("a", np.array([1.0, 2.0, 3.0])), Sample("b", np.array([2.0, 4.0, 6.0]), unknown=1)]
)
FORM = made_up_form()


def sensitivity():
    def share(low, high):
        return PairRange(Index(low, low - 0.1, low), Index(high, high, np.nan), "")

    indices = {"CX": share(0.2, 0.3), "CY": share(0.6, 0.8)}
    return SimpleNamespace(
        result=SimpleNamespace(indices=indices),
        metric="cross_track_median_m",
        condition=Condition(3.0, "light"),
    )


DRAW = {
    "pbox": lambda ax: plot_pbox(BOX, ax, "median error [m]"),
    "history": lambda ax: plot_history(
        FlightRecord({"time_s": TIME, "q_radps": np.sin(TIME)}), "q_radps", ax
    ),
    "overlay": lambda ax: plot_overlay(HISTORY, "q_radps", ax, noise=0.01),
    "sensitivity": lambda ax: plot_sensitivity(sensitivity(), ax),
    "model form": lambda ax: plot_model_form(FORM.coefficients["Cm"], "alpha_rad", ax, "Cm"),
}
LABELS = {
    "pbox": ("median error [m]", "cumulative probability [-]"),
    "history": ("time [s]", "q [deg/s]"),
    "overlay": ("time of the log [s]", "q [deg/s]"),
    "sensitivity": ("share of the p-box's width [-]", ""),
    "model form": ("alpha [deg]", "flight minus model, Cm [-]"),
}


@pytest.mark.parametrize("kind", DRAW)
def test_it_draws_into_the_axes_given_and_names_its_units(kind):
    before = dict(matplotlib.rcParams)
    ax, reference = Figure().subplots(1, 2)
    assert DRAW[kind](ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel()) == LABELS[kind]
    assert ax.has_data()
    assert not reference.has_data()
    assert dict(matplotlib.rcParams) == before


def test_a_p_box_is_drawn_where_it_lies():
    ax = plot_pbox(BOX, Figure().subplots())
    upper, lower = ax.lines[:2]
    for line, side in ((upper, BOX.upper), (lower, BOX.lower)):
        at = dict(zip(line.get_xdata(), line.get_ydata(), strict=True))
        assert [at[v] for v in BOX.value] == pytest.approx(side)


def test_bounds_are_those_of_the_slice_and_samples_those_near_it():
    bounds = FORM.coefficients["Cm"]
    k = bounds.states.index("alpha_rad")
    middle = bounds.hull.middle[:, 1]
    close, distant = middle.copy(), middle + 3.0 * bounds.scale
    distant[k] = middle[k]
    states = {s: np.array([close[j], distant[j]]) for j, s in enumerate(bounds.states)}
    residuals = SimpleNamespace(states=states, columns=lambda coefficient: [np.array([0.5, 0.5])])
    ax = plot_model_form(bounds, "alpha_rad", Figure().subplots(), "Cm", residuals)
    dots, lower = ax.lines[:2]
    assert dots.get_xdata() == pytest.approx([np.degrees(middle[k])])
    axial = {s: np.full(len(lower.get_xdata()), middle[j]) for j, s in enumerate(bounds.states)}
    axial["alpha_rad"] = np.radians(lower.get_xdata())
    assert lower.get_ydata() == pytest.approx(bounds.bounds(axial)[0])
