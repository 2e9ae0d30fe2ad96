"""The prior: closed forms of its statistics, and NASA's wind-tunnel derivatives lie inside."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy import stats

from tests.helpers.places import ROOT
from uqharness.authoring import build, class_errors, gyration, priors, read_sources
from uqharness.authoring.prior import CLASSES, GUESS_DOF, read_evidence

ULTRASTICK = ROOT.parent / "shared" / "data" / "ultrastick"


def errors_of(class_name: str) -> list[float]:
    """Return the errors of a class with one row an aircraft."""
    return [float(r["error"]) for r in read_evidence() if r["class"] == class_name]


def test_statistics_of_a_class():
    """Normal-inverse-gamma posterior predictive, here as that of n errors and three of the guess,
    whose own prediction has its standard deviation.
    """
    rows, half = errors_of("side force"), CLASSES["side force"].guess * 3.0 / math.sqrt(8.0)
    sample = [*rows, 0.0, half, -half]
    n = len(sample)
    assert GUESS_DOF == 3.0
    errors = class_errors()["side force"]
    assert errors.mean == pytest.approx(np.mean(sample))
    assert errors.mean < -0.1
    assert errors.std == pytest.approx(np.std(sample) * math.sqrt(1.0 + 1.0 / n))
    assert errors.half_width(0.9) == pytest.approx(stats.t.ppf(0.95, n) * errors.std)
    assert errors.gaussian_std * stats.norm.ppf(0.95) == pytest.approx(errors.half_width(0.9))


def test_classes_whose_members_differ_in_sign_have_no_mean():
    errors = class_errors()["side force due to rates"]
    assert errors.mean == 0.0
    assert len(errors.aircraft) == 2


def left_out(shift: bool) -> tuple[float, float]:
    """Return share inside 90 % intervals and mean log density of errors left out by aircraft."""
    inside, density = [], []
    for row in read_evidence():
        error = class_errors([row["aircraft"]])[row["class"]]
        mean, std = error.mean, error.std
        if not shift and mean:  # the same squares about no mean
            guess = CLASSES[row["class"]].guess ** 2 * GUESS_DOF / (GUESS_DOF + 1.0)
            std = math.sqrt(std**2 / (1.0 + 1.0 / error.dof) + mean**2 + guess / error.dof)
            mean = 0.0
        deviation = float(row["error"]) - mean
        inside.append(abs(deviation) <= stats.t.ppf(0.95, error.dof) * std)
        density.append(float(stats.t.logpdf(deviation / std, error.dof)) - math.log(std))
    return float(np.mean(inside)), float(np.mean(density))


def test_a_mean_predicts_aircraft_left_out_better_than_width_alone():
    (inside, density), (inside_wide, density_wide) = left_out(True), left_out(False)
    assert inside >= inside_wide > 0.9
    assert density > density_wide + 0.04


def test_an_aircraft_counts_once_and_can_be_left_out():
    all_items, reduced = class_errors(), class_errors(["UltraStick120"])
    assert all_items["static margin"].aircraft == ("UltraStick120", "Babyshark VTOL", "Navion")
    # Two tools of one aircraft are one vote.
    assert all_items["static margin"].dof == GUESS_DOF + 3
    assert reduced["moment at zero alpha"].dof == GUESS_DOF
    assert reduced["moment at zero alpha"].std == pytest.approx(
        CLASSES["moment at zero alpha"].guess
    )


def test_evidence_belongs_to_classes():
    assert {row["class"] for row in read_evidence()} <= set(CLASSES)
    assert all(row["remark"] for row in read_evidence())


def wind_tunnel(path: Path) -> list[tuple[str, float, float]]:
    """Return NASA's derivatives from 0 to 10 degrees: term, alpha [deg], value (SI, per degree of
    surface).
    """
    tables = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    base = tables["C6_bas"]
    alphas, data = base.alpha, base.data
    zero = list(base.beta).index(0)
    out = []
    inside = [i for i, a in enumerate(alphas) if 0.0 <= a <= 10.0]
    a = np.radians(alphas[inside])
    lift, moment = (np.polyfit(a, data[inside, zero, j], 1) for j in (2, 4))
    drag = np.polyfit(data[inside, zero, 2] ** 2, data[inside, zero, 0], 1)
    out += [
        ("CZ_alpha", 4.5, -lift[0] - drag[1]),
        ("CZ_0", 0.0, -lift[1]),
        ("Cm_alpha", 4.5, moment[0]),
        ("Cm_0", 0.0, moment[1]),
        ("CX_0", 0.0, -drag[1]),
    ]
    per_rad = np.radians(base.beta[zero + 1] - base.beta[zero - 1])
    for i in inside:
        slopes = (data[i, zero + 1] - data[i, zero - 1]) / per_rad
        out += [(f"{c}_beta", alphas[i], slopes[j]) for c, j in (("CY", 1), ("Cl", 3), ("Cn", 5))]
        # The aileron's positive deflection rolls to the left in the tables.
        out.append(("Cl_da", alphas[i], -tables["dC1_ail"].data[i, zero, 1] / 5.0))
        for k in (0, 2):
            change = tables["dC3_ele"].data[i, k, 2] / tables["dC3_ele"].ele[k]
            out += [("CZ_de", alphas[i], -change[1]), ("Cm_de", alphas[i], change[2])]
        side, yaw = tables["dC2_rud"].data[i, zero, 0, 2] / tables["dC2_rud"].rud[0]
        out += [("CY_dr", alphas[i], side), ("Cn_dr", alphas[i], yaw)]
    for name, rate, rates in (("dC3_p", "p", "phat"), ("dC3_r", "r", "rhat")):
        table = tables[name]
        for i, alpha in enumerate(table.alpha):
            if 0.0 <= alpha <= 10.0:
                slopes = table.data[i, 2] / getattr(table, rates)[2]
                out += [
                    (f"{c}_{rate}", float(alpha), slopes[j])
                    for j, c in enumerate(("CY", "Cl", "Cn"))
                ]
    damping = tables["dampder"]
    return [*out, ("CZ_q", 4.0, -damping.CLq), ("Cm_q", 4.0, damping.Cmq)]


@pytest.mark.skipif(not ULTRASTICK.is_dir(), reason="needs the shared data")
def test_wind_tunnel_derivatives_lie_in_prior_intervals():
    source = read_sources([ULTRASTICK / "UltraStick120_DegenGeom.stab"]).derivatives
    centre = tuple(source.reference[key].value for key in "xyz")
    model = build(source, gyration(6.4, source.length("b"), centre))
    prior = priors(model, without=["UltraStick120"])
    derivatives = wind_tunnel(ULTRASTICK / "UltraStick120_Aero.mat")
    assert len(derivatives) > 35
    outside = []
    for term, alpha, value in derivatives:
        mean = prior[term].mean
        if term in model.tables and not term.endswith("_0"):
            mean += float(np.interp(math.radians(alpha), *model.tables[term]))
        if abs(value - mean) > stats.norm.ppf(0.95) * prior[term].std:
            outside.append((term, alpha, value, mean, prior[term].std))
    share = 1.0 - len(outside) / len(derivatives)
    print(share, len(derivatives), outside)
    assert share >= 0.85, outside
    # Negative control: intervals of a third of the width would hold far fewer.
    narrow = sum(
        abs(value - prior[term].mean) <= stats.norm.ppf(0.95) * prior[term].std / 3.0
        for term, _, value in derivatives
    )
    assert narrow < 0.75 * len(derivatives)
