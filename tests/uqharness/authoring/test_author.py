"""`uqharness author`: the written aircraft flies as its source says, and enters campaigns."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.model_form import read_model_form
from uqharness.authoring import build, class_errors, design_speed, priors, read_sources
from uqharness.authoring.model import MassProperties
from uqharness.authoring.source import TOTAL, body_coefficients
from uqharness.cli.main import main
from uqharness.commands.authoring import author
from uqharness.errors import BadInputError
from uqharness.exchange import box, source_model
from uqharness.requests.authoring import AuthorRequest
from uqharness.simulator import (
    SteadyCondition,
    find_aircraft,
    find_trim,
    linearise,
    mode_intervals,
    modes,
)
from uqharness.simulator.aircraft import read_card

DATA = Path(__file__).parent / "data"
KITE = (DATA / "kite.st", DATA / "kite.mass")


def authored(folder, *sources, **options):
    return author(AuthorRequest(sources=sources or KITE, out=folder, **options)).value


@pytest.fixture(scope="module")
def kite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("authored") / "kite"
    return authored(folder), find_aircraft(folder)


def test_terms_are_about_the_centre_of_gravity(kite):
    document, _ = kite
    sources = read_sources(KITE)
    source, masses = sources.derivatives, sources.masses
    neutral, chord = source.facts["x_np"].value, source.length("c")
    expected = (neutral - masses.centre_m[0]) / chord
    # The rest is the height of the moment centre and the drag.
    assert document.static_margin == pytest.approx(expected, abs=0.015)
    assert document.terms["aero/Cm_de"].value < 0.0 < document.terms["aero/Cl_da"].value
    assert document.terms["aero/Cn_dr"].value < 0.0
    assert document.mixing == {
        "elevator": "+1*elevator",
        "aileron": "-1*aileron",
        "rudder": "-1*rudder",
    }


def test_written_aircraft_computes_the_model(kite):
    """JSBSim's coefficients of the written XML at random states are those of the model."""
    _, aircraft = kite
    sources = read_sources(KITE)
    masses = sources.masses
    tensor = masses.inertia_kgm2
    mass = MassProperties(
        masses.mass_kg.value,
        masses.centre_m,
        tensor[0, 0],
        tensor[1, 1],
        tensor[2, 2],
        -tensor[0, 2],
        "x",
    )
    model = build(sources.derivatives, mass)
    source = source_model(aircraft, design_speed(model))
    states = box(source, 40, 1)
    computed = source.coefficients(states)
    names = ("alpha", "beta", "p", "q", "r", "de", "da", "dr")
    for i in range(len(states)):
        values = {name: float(states.values[name][i]) for name in names}
        alpha = values.pop("alpha")
        expected = [
            model.coefficient(c, alpha, **values) for c in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
        ]
        np.testing.assert_allclose(computed[i], expected, atol=2e-4)


def test_written_aircraft_trims_near_the_source_alpha(kite):
    document, aircraft = kite
    trim = find_trim(aircraft, SteadyCondition(document.speed_mps, 100.0))
    assert trim.converged, trim.reason
    assert math.degrees(trim.alpha_rad) == pytest.approx(3.0, abs=1.5)


def test_tables_over_alpha_follow_the_source(tmp_path):
    """With several alphas the model passes through the source's points."""
    document = authored(tmp_path / "kite", *KITE, DATA / "kite-7deg.st")
    assert (
        "table" in (tmp_path / "kite" / f"{find_aircraft(tmp_path / 'kite').name}.xml").read_text()
    )
    sources = read_sources((*KITE, DATA / "kite-7deg.st"))
    masses = sources.masses
    model = build(
        sources.derivatives,
        MassProperties(1.47, masses.centre_m, 0.1, 0.1, 0.1, 0.0, "x"),
        profile_drag=0.0,
    )
    for point in sources.derivatives.points:
        values = body_coefficients(point, ())
        alpha = point.alpha.value
        assert model.coefficient("CZ", alpha) == pytest.approx(values["CZ", TOTAL], abs=1e-6)
        assert model.coefficient("CX", alpha) == pytest.approx(values["CX", TOTAL], abs=1e-6)
    assert document.static_margin == pytest.approx(0.2, abs=0.15)


def test_prior_form_is_read_and_has_the_stated_width(kite):
    document, aircraft = kite
    path = aircraft.folder / "model-form.json"
    form = read_model_form(path)
    stored = json.loads(path.read_text())
    assert stored["kind"] == "prior"
    # The centre is moved by the bias of the class; the aircraft keeps the source's value.
    roll = document.terms["aero/Cl_da"]
    assert stored["parameters"]["aero/Cl_da"]["mean"] == pytest.approx(roll.mean)
    assert roll.mean == pytest.approx(roll.value * (1.0 + class_errors()["aileron"].mean))
    assert roll.mean < 0.9 * roll.value
    card = read_card(aircraft.folder / "airframe.toml")
    assert card.parameters["aero/Cl_da"].initial == pytest.approx(roll.value)
    # At the trim alpha and no other deviation the half-width is the constant's, 1.96 std.
    zero = {name: np.zeros(1) for name in form.states} | {
        "alpha_rad": form.coefficients["CZ"].centre[:1]
    }
    lower, upper = form.bounds(zero)["Cm"]
    terms = document.terms
    constant = terms["aero/Cm_0"]
    assert upper[0] - lower[0] == pytest.approx(2.0 * 1.96 * constant.std, rel=1e-3)
    assert upper[0] + lower[0] == pytest.approx(2.0 * (constant.mean - constant.value), abs=1e-6)
    # A deviation adds its own variance and bias: beta of 0.1 rad in Cn.
    low, high = (ends[0] for ends in form.bounds(zero | {"beta_rad": np.array([0.1])})["Cn"])
    fin = terms["aero/Cn_beta"]
    expected = 1.96 * math.hypot(terms["aero/Cn_0"].std, 0.1 * fin.std)
    assert 0.5 * (high - low) == pytest.approx(expected, rel=1e-3)
    assert 0.5 * (high + low) == pytest.approx(0.1 * (fin.mean - fin.value), rel=1e-3)


def test_the_prior_takes_no_energy_from_the_air(kite):
    """Trimmed at the same lift with CZ at either end, drag is at least D/f; sideslip drags."""
    document, aircraft = kite
    form = read_model_form(aircraft.folder / "model-form.json")
    value = {name.removeprefix("aero/"): term.value for name, term in document.terms.items()}
    alpha = float(form.coefficients["CX"].centre[0])
    zero = {name: np.zeros(1) for name in form.states}

    def drag(alpha, **levels):
        ends = form.bounds(zero | {"alpha_rad": np.array([alpha])})
        cx = value["CX_0"] + value["CX_alpha"] * alpha + value["CX_alpha2"] * alpha**2
        cz = value["CZ_0"] + value["CZ_alpha"] * alpha
        cx, cz = (
            nominal + (float(ends[name][levels[name]][0]) if levels else 0.0)
            for name, nominal in (("CX", cx), ("CZ", cz))
        )
        return -cx * math.cos(alpha) - cz * math.sin(alpha)

    profile = -value["CX_0"]
    factor = math.exp(1.96 * document.terms["aero/CX_0"].std / profile)
    minimum = drag(alpha) - profile * (1.0 - 1.0 / factor)
    shift = 1.96 * document.terms["aero/CZ_0"].std / value["CZ_alpha"]
    corners = [drag(alpha - shift, CX=1, CZ=1), drag(alpha + shift, CX=1, CZ=0)]
    assert min(corners) == pytest.approx(minimum, abs=0.1 * profile)
    for beta in (-0.15, 0.15):
        states = zero | {"beta_rad": np.array([beta]), "alpha_rad": np.array([alpha])}
        # Apart from the constant's error, which has no sign.
        constant = 1.96 * document.terms["aero/CY_0"].std
        for end in form.bounds(states)["CY"]:
            assert (value["CY_beta"] * beta + float(end[0])) * np.sign(beta) < constant


@pytest.mark.parametrize(
    ("term", "mode"), [("Cl_p", "roll"), ("Cn_beta", "dutch_roll"), ("Cm_q", "short_period")]
)
def test_intervals_of_modes_are_those_of_the_model_itself(term, mode, kite):
    """One uncertain slope: the interval's ends are the modes of JSBSim's model at +/- 1.96 std."""
    document, aircraft = kite
    form = read_model_form(aircraft.folder / "model-form.json")
    coefficient, _, variable = term.partition("_")
    certain = {
        name: replace(bounds, XtX_inv=np.zeros_like(bounds.XtX_inv), beta_hat=0.0 * bounds.beta_hat)
        for name, bounds in form.coefficients.items()
    }
    old = form.coefficients[coefficient]
    index = 1 + [s.partition("_")[0] for s in old.states].index(variable)
    XtX_inv = np.zeros_like(old.XtX_inv)
    XtX_inv[index, index] = old.XtX_inv[index, index]
    certain[coefficient] = replace(certain[coefficient], XtX_inv=XtX_inv)
    condition = SteadyCondition(document.speed_mps, 200.0)
    linear = linearise(aircraft, find_trim(aircraft, condition))
    intervals = mode_intervals(aircraft, linear, replace(form, coefficients=certain))
    names = [m.name for m in modes(linear)]
    expected = []
    entry = document.terms[f"aero/{term}"]
    for sign in (-1.0, 1.0):
        value = {f"aero/{term}": entry.value + sign * 1.96 * entry.std}
        other = linearise(aircraft, find_trim(aircraft, replace(condition, properties=value)))
        expected.append(next(m.wn_radps for m in modes(other) if m.name == mode))
    interval = intervals[names.index(mode)]
    assert interval.wn_radps == pytest.approx(sorted(expected), rel=0.08)
    # The other group of modes does not move.
    steady = "short_period" if mode != "short_period" else "dutch_roll"
    low, high = intervals[names.index(steady)].wn_radps
    assert high - low < 1e-3 * high


def test_diff_names_what_an_identification_changed(kite, tmp_path, capsys):
    _, aircraft = kite
    other = tmp_path / "identified"
    shutil.copytree(aircraft.folder, other)
    path = next(other.glob("*.xml"))
    text = path.read_text()
    line = next(row for row in text.splitlines() if ">aero/Cm_q<" in row)
    path.write_text(text.replace(line, re.sub(r'value="[^"]+"', 'value="-12.2"', line)))
    words = ["diff", str(aircraft.folder), str(other), "--speed-mps", "14", "--json"]
    assert main(words) == 1
    document = json.loads(capsys.readouterr().out)
    assert [term["path"].rpartition("/")[2].strip() for term in document["terms"]] == ["Cm_q"]
    assert any("Cm" in row["channel"] for row in document["differences"])


def test_slips_of_a_geometry_that_cannot_be_run_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr("uqharness.authoring.read.can_run_avl", lambda: False)
    text = (DATA / "kite.avl").read_text()
    path = tmp_path / "kite.avl"
    path.write_text(text.replace("aileron 1.0 0.75 0 0 0 -1.0", "aileron 1.0 0.75 0 0 0 1.0", 1))
    with pytest.raises(BadInputError, match=r"optvl.*kite\.avl:21: control sign"):
        authored(tmp_path / "kite", path, DATA / "kite.mass")


def test_static_margin_is_the_parameter():
    """The std of Cm_alpha does not vanish with Cm_alpha."""
    sources = read_sources(KITE)
    widths = []
    for x in (0.12, 0.177):  # a margin of 27 % of the chord, and none
        mass = MassProperties(1.47, (x, 0.0, 0.0), 0.1, 0.1, 0.1, 0.0, "x")
        widths.append(priors(build(sources.derivatives, mass))["Cm_alpha"].std)
    assert widths[1] > 0.8 * widths[0] > 0.3


def test_no_mass_is_bad_input(tmp_path):
    with pytest.raises(BadInputError, match="--mass-kg"):
        authored(tmp_path / "a", DATA / "kite.st")


@pytest.mark.parametrize(
    ("options", "place"),
    [
        ({"mass_kg": 1470.0}, "--mass-kg"),
        ({"cg_x_m": 15.0}, "--cg-x-m"),
        ({"iyy_kgm2": 80.0, "ixx_kgm2": 60.0, "izz_kgm2": 130.0, "mass_kg": 1.47}, "--ixx-kgm2"),
    ],
)
def test_options_in_other_units_stop_the_command(options, place, tmp_path):
    request = AuthorRequest(
        sources=(DATA / "kite.st",), out=tmp_path, **{"mass_kg": 1.47} | options
    )
    outcome = author(request)
    assert outcome.code == 1
    assert [slip.place for slip in outcome.value.slips] == [place]


def test_slip_stops_the_command(tmp_path):
    path = tmp_path / "kite.st"
    path.write_text((DATA / "kite.st").read_text().replace("Cnb =   0.073998", "Cnb =  -0.073998"))
    outcome = author(AuthorRequest(sources=(path, KITE[1]), out=tmp_path / "out"))
    assert outcome.code == 1
    assert outcome.value.aircraft is None
    assert not (tmp_path / "out").exists()
    (slip,) = outcome.value.slips
    assert slip.kind == "sign"
    assert slip.place.endswith("kite.st:44")
    assert (
        author(AuthorRequest(sources=(path, KITE[1]), out=tmp_path / "out", accept_slips=True)).code
        == 0
    )


@pytest.mark.slow
def test_from_avl_text_to_a_p_box_with_three_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["author", *map(str, KITE), "--out", "kite", "--json"]
    assert main(words) == 0
    assert main(["campaign", "run", "kite/campaign.toml", "--out", "results", "--serial"]) == 0
    assert main(["campaign", "report", "results"]) == 0
    boxes = pd.read_parquet(tmp_path / "results" / "pbox.parquet")
    box = boxes[boxes.metric == "altitude_median_m"]
    # The prior makes the p-box wide: bounds differ by more than a metre in five seconds.
    assert (box.upper - box.lower).max() > 0.5
    assert "Campaign of kite<" in (tmp_path / "results" / "report.html").read_text()


def test_flaps_gear_and_ground_of_a_table_fly(tmp_path):
    """Lift of 20 degrees of flap lowers the trim's alpha, drag of the gear needs thrust."""
    rows = (DATA / "kite.csv").read_text().rstrip().splitlines()
    head = [row for row in rows if row.startswith(("#", "name"))][-1]
    more = ["CL_flap,0.6,1/rad,t", "CD_flap,0.08,1/rad,t", "CD_gear,0.02,1,t"]
    more += ["ground_lift,1.2,1,t,0", "ground_lift,1,1,t,1"]
    table = tmp_path / "kite.csv"
    table.write_text("\n".join([*rows, *more]).replace(head, f"{head},h_over_b") + "\n")
    document = authored(tmp_path / "kite", table, mass_kg=1.47, cg_x_m=0.15)
    assert any("no prior" in note for note in document.notes)
    aircraft = find_aircraft(tmp_path / "kite")

    def trim(**properties):
        return find_trim(aircraft, SteadyCondition(14.0, 200.0, properties=properties))

    clean = trim(**{"fcs/gear-down-norm": 0.0})
    flaps = trim(**{"fcs/gear-down-norm": 0.0, "fcs/flap-cmd-deg": 20.0})
    lift, slope = 0.6 * math.radians(20.0), 5.147
    assert clean.alpha_rad - flaps.alpha_rad == pytest.approx(lift / slope, rel=0.15)
    gear = trim()
    density = 1.225 * 0.981
    drag = 0.5 * density * 14.0**2 * 0.3438 * 0.02
    assert gear.thrust_N - clean.thrust_N == pytest.approx(drag, rel=0.05)
    # Trims are far above the ground; the table is JSBSim's, over its own height in spans.
    text = aircraft.xml.read_text()
    assert re.search(r"aero/h_b-mac-ft.*?<tableData>\s+0\s+1\.2\s+1\s+1\s+</tableData>", text, re.S)
    assert re.search(r'name="aero/CZ">\s+<product>\s+<property>aero/ground-lift', text)
    table.write_text(table.read_text().replace("ground_lift,1,1,t,1\n", ""))
    with pytest.raises(BadInputError, match="at least two rows"):
        authored(tmp_path / "again", table, mass_kg=1.47)
