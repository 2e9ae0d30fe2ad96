"""Epistemic samples, and the files they come from: model form, fit, uncertain means."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil

import numpy as np
import pytest
from scipy import stats

from sysid.model_form.model_form import AircraftReference, read_model_form
from tests.helpers import campaign_fakes as fakes
from tests.helpers.campaign_fakes import CAMPAIGN, campaign_file
from tests.helpers.few import rows
from tests.helpers.model_forms import PUBLISHED, made_up_form, with_parts
from uqharness.campaign import sampling
from uqharness.campaign.cases import Mission, build_cases
from uqharness.campaign.engines import bounds_notes, with_noise_of
from uqharness.campaign.manifest import describe, spec_of
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.sampling import epistemic_samples
from uqharness.campaign.tables import CASES
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.flight.fly import fly, record_mission
from uqharness.flight.random_numbers import walk_stream
from uqharness.flight.spec import COEFFICIENTS, FlightResult, LevelDriver, TransientDriver
from uqharness.parquet_files import read_table
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.simulator.aircraft import PROJECT_ROOT, Source, content_hash, find_aircraft
from uqharness.simulator.mission import StagedMission

pytestmark = pytest.mark.usefixtures("flights_here")

HEAD = CAMPAIGN.partition("[epistemic]")[0]


BOUNDS = "bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }\n"


FIT = {
    "parameters": {
        "aero/Cm_q": {"value": -13.8, "std": 0.6, "status": "identified"},
        "aero/Cm_alpha": {"value": -0.487, "std": 0.02, "status": "identified"},
        "aero/CZ_q": {"value": 0.0, "std": None, "status": "not-identified"},
    },
    "names": ["aero/Cm_q", "aero/Cm_alpha"],
    "cov": [[0.36, 0.0084], [0.0084, 0.0004]],  # correlation 0.7
}


def model_form(
    path, rates=(0.02, 0.012, float("nan")), names=("CX", "CZ", "Cm"), transient=None, **changes
):
    """A model form with bounds of CX, CZ and Cm; told apart into parts where ``transient`` is
    given.
    """
    form = made_up_form({name: PUBLISHED[name] for name in names})
    form = form if transient is None else with_parts(form, transient=transient)
    bounds = {
        name: dataclasses.replace(item, walk_rate=rate)
        for (name, item), rate in zip(form.coefficients.items(), rates, strict=False)
    }
    dataclasses.replace(form, coefficients=bounds, **changes).write(path)


def campaign(tmp_path, epistemic, head=HEAD):
    return read_campaign(campaign_file(tmp_path, head + "[epistemic]\n" + epistemic))


def write(path, document):
    path.write_text(json.dumps(document))


def mission(tmp_path):
    return Mission(tmp_path / "plane", "a" * 64, tmp_path / "loiter.xml", "b" * 64)


def test_a_latin_hypercube_fills_every_cell_of_every_dimension(tmp_path):
    samples = epistemic_samples(campaign(tmp_path, f'method = "lhs"\nsamples = 200\n{BOUNDS}'))
    assert [samples[0].epistemic_id, samples[-1].epistemic_id] == ["lhs-000000", "lhs-000199"]
    points = np.array([[sample.levels[name] for name in COEFFICIENTS] for sample in samples])
    for column in points.T:
        assert sorted(np.floor(200 * column)) == list(range(200))
    assert np.abs(np.corrcoef(points.T) - np.eye(6)).max() < 4.5 / np.sqrt(200)
    # A dimension is a stream of its own: fewer coefficients move none of the others' levels.
    fewer = 'method = "lhs"\nsamples = 200\ncoefficients = ["Cm"]\nbounds = { Cm = 0.012 }\n'
    assert [item.levels["Cm"] for item in epistemic_samples(campaign(tmp_path, fewer))] == list(
        points[:, 4]
    )


def test_walks_are_numbered_drivers_in_their_own_streams(tmp_path):
    text = f'method = "walk"\nsamples = 3\nwalk_rate_per_sqrt_s = 0.012\n{BOUNDS}'
    samples = epistemic_samples(campaign(tmp_path, text))
    assert samples[2].driver == LevelDriver("walk", 7, "walk-000002", COEFFICIENTS, (0.012,) * 6)
    assert not samples[2].levels
    assert walk_stream(7, "walk-000002", "CX").generate_state(1) != walk_stream(
        7, "walk-000001", "CX"
    ).generate_state(1)
    cases = build_cases(campaign(tmp_path, text), mission(tmp_path))
    # One walk over all flights, and the air common to all walks.
    assert {case.flight.levels for case in cases if case.epistemic_id == "walk-000001"} == {
        samples[1].driver
    }
    assert len({case.case_id for case in cases}) == 9
    assert len({case.seed for case in cases}) == 3
    more = epistemic_samples(campaign(tmp_path, text.replace("samples = 3", "samples = 5")))
    assert more[:3] == samples
    faster = build_cases(campaign(tmp_path, text.replace("0.012\nb", "0.02\nb")), mission(tmp_path))
    assert {case.case_id for case in faster}.isdisjoint(case.case_id for case in cases)


def test_rates_and_coefficients_come_from_the_model_form(tmp_path):
    model_form(tmp_path / "model-form.json")
    text = 'method = "walk"\nsamples = 2\nbounds = "model-form.json"\ncoefficients = ["CZ", "CX"]\n'
    sample = epistemic_samples(campaign(tmp_path, text))[0]
    assert (sample.driver.coefficients, sample.driver.rates_per_sqrt_s) == (
        ("CX", "CZ"),
        (0.02, 0.012),
    )
    corners = epistemic_samples(
        campaign(tmp_path, 'method = "corners"\nbounds = "model-form.json"\n')
    )
    assert [item.epistemic_id for item in corners][:2] == ["0-0-0-", "0-0-1-"]
    inputs = text.replace("samples", "walk_rate_per_sqrt_s = { CX = 0.5 }\nsamples")
    assert epistemic_samples(campaign(tmp_path, inputs))[0].driver.rates_per_sqrt_s == (0.5, 0.012)
    with pytest.raises(BadInputError, match="no walk_rate for Cm"):
        campaign(tmp_path, 'method = "walk"\nsamples = 2\nbounds = "model-form.json"\n')
    with pytest.raises(BadInputError, match="has no bounds for Cn"):
        campaign(
            tmp_path,
            'method = "corners"\nbounds = "model-form.json"\ncoefficients = ["CX", "Cn"]\n',
        )


CORNERS = 'method = "corners"\nbounds = "model-form.json"\ncoefficients = ["CX", "Cm"]\n'


def test_transient_error_of_the_form_flies_at_every_corner(tmp_path):
    model_form(tmp_path / "model-form.json", transient={"Cm": 0.001, "CZ": 0.002})
    spec = campaign(tmp_path, CORNERS)
    rate = pytest.approx(np.sqrt(2.0) / (np.pi * np.sqrt(0.5)))
    cases = build_cases(spec, mission(tmp_path))
    assert len(cases) == 3 * (4 + 16 + 1)
    for case in cases:
        # CZ has such a part, and is certain in this campaign; the nominal model has no error.
        driver = TransientDriver(7, case.aleatory_id, ("Cm",), (rate,))
        assert case.flight.transient == (None if case.epistemic_id == "nominal" else driver)
    steady = build_cases(campaign(tmp_path, CORNERS + "transient = false\n"), mission(tmp_path))
    assert all(case.flight.transient is None for case in steady)
    nominal = {case.case_id for case in cases if case.epistemic_id == "nominal"}
    assert {case.case_id for case in steady} & {case.case_id for case in cases} == nominal
    description = describe(spec, mission(tmp_path), 60, "")
    description["campaign_file"] = str(tmp_path / "campaign.toml")
    assert spec_of(description).inputs == spec.inputs


REFUSED = r"""
bounds = "model-form.json"\ntransient = true |  | campaign.toml:\d+: .epistemic. transient = true: .*has no transient part
bounds = CONSTANT\ntransient = true |  | campaign.toml:\d+: .epistemic. transient = true: bounds are no model-form.json
bounds = CONSTANT\nset = "ellipsoid" |  | campaign.toml:\d+: .epistemic. set = .ellipsoid.: this needs intervals
bounds = "absent.json" |  | named as bounds and not there
bounds = "bad.json" | { | bad.json.*uqharness bounds AIRCRAFT
bounds = "bad.json" | {"coefficients": {"CL": {}}} | bad.json.*uqharness bounds AIRCRAFT
"""


@pytest.mark.parametrize(("settings", "content", "message"), rows(REFUSED))
def test_bounds_that_are_bad_or_lack_what_is_set_are_refused(tmp_path, settings, content, message):
    model_form(tmp_path / "model-form.json")
    (tmp_path / "bad.json").write_text(content)
    text = settings.replace("CONSTANT", BOUNDS[9:].strip())
    with pytest.raises(BadInputError, match=message):
        campaign(tmp_path, f'method = "corners"\n{text}\n')
    constant = campaign(tmp_path, f'method = "corners"\n{BOUNDS}transient = false\n')
    assert constant.inputs.transient_rates == {}


PARAMETERS = '[epistemic.parameters]\nfit = "fit.json"\n'


def test_parameters_are_drawn_from_the_covariance(tmp_path):
    write(tmp_path / "fit.json", FIT)

    def samples(number):
        text = f'method = "none"\nsamples = {number}\n{PARAMETERS}'
        return epistemic_samples(campaign(tmp_path, text))

    many = samples(4000)
    assert many[3].epistemic_id == "nominal+p000003"
    drawing = np.array([[sample.parameters[name] for name in FIT["names"]] for sample in many])
    for column, name in zip(drawing.T, FIT["names"], strict=True):
        value, std = (FIT["parameters"][name][key] for key in ("value", "std"))
        assert stats.kstest(column, "norm", args=(value, std)).pvalue > 1e-3
        assert stats.kstest(column, "norm", args=(value, 1.2 * std)).pvalue < 1e-3
    assert np.corrcoef(drawing.T)[0, 1] == pytest.approx(0.7, abs=4 * (1 - 0.49) / np.sqrt(4000))
    assert [item.parameters for item in samples(5)] == [item.parameters for item in many[:5]]


def test_a_box_is_filled_to_its_edges_and_no_further(tmp_path):
    write(tmp_path / "fit.json", FIT)
    box = PARAMETERS + 'distribution = "box"\nconfidence = 0.9\nparameters = ["aero/Cm_alpha"]\n'
    samples = epistemic_samples(campaign(tmp_path, f'method = "none"\nsamples = 1000\n{box}'))
    drawing = np.array([sample.parameters["aero/Cm_alpha"] for sample in samples])
    reach = stats.norm.ppf(0.95) * 0.02
    assert np.abs(drawing + 0.487).max() <= reach
    assert np.abs(drawing + 0.487).max() > 0.998 * reach
    assert stats.kstest(drawing, "uniform", args=(-0.487 - reach, 2 * reach)).pvalue > 1e-3


def test_parameters_multiply_corners_and_join_walks(tmp_path):
    write(tmp_path / "fit.json", FIT)
    corners = campaign(tmp_path, f'method = "corners"\nsamples = 3\n{BOUNDS}{PARAMETERS}')
    samples = epistemic_samples(corners)
    assert len(samples) == (64 + 16 + 1) * 3
    names = ["000000+p000000", "000000+p000001", "000000+p000002", "000001+p000000"]
    assert [item.epistemic_id for item in samples[:4]] == names
    assert samples[0].parameters == samples[3].parameters != samples[1].parameters
    case = build_cases(corners, mission(tmp_path))[0]
    assert case.flight.properties["aero/Cm_q"] == samples[0].parameters["aero/Cm_q"]
    assert case.inputs["parameter_aero/Cm_q"] == samples[0].parameters["aero/Cm_q"]
    text = f'method = "walk"\nwalk_rate_per_sqrt_s = 0.01\nsamples = 3\n{BOUNDS}{PARAMETERS}'
    walks = epistemic_samples(campaign(tmp_path, text))
    assert len({item.parameters["aero/Cm_q"] for item in walks}) == len(walks) == 3


@pytest.mark.parametrize(
    ("change", "line", "message"),
    [
        ({"names": []}, "", "no parameter was identified"),
        ({"cov": [[1.0]]}, "", "2 x 2"),
        ({"cov": [[1.0, 2.0], [2.0, 1.0]]}, "", "not positive definite"),
        ({"cov": [[1.0, 0.1], [0.2, 1.0]]}, "", "not symmetric"),
        ({"cov": [[1.0, None], [0.2, 1.0]]}, "", "finite"),
        ({"names": ["aero/Cm_q", "aero/none"]}, "", "not a fit"),
        ({}, 'parameters = ["aero/CZ_q"]', "aero/CZ_q is not among the identified"),
        ({}, "confidence = 0.9", r"\[epistemic.parameters\].*confidence belongs to .* = .box"),
    ],
)
def test_a_bad_fit_and_bad_choices_of_its_parameters_are_refused(tmp_path, change, line, message):
    write(tmp_path / "fit.json", FIT | change)
    with pytest.raises(BadInputError, match=message):
        campaign(tmp_path, f'method = "none"\nsamples = 2\n{PARAMETERS}{line}\n')


def variables(mean):
    return (
        HEAD
        + f'[aleatory.variables."load/kg"]\ndistribution = "normal"\nmean = {mean}\nstd = 0.5\n'
    )


def test_a_variable_is_drawn_per_flight_and_common_to_corners(tmp_path):
    def result(text, head):
        return build_cases(campaign(tmp_path, text, head), mission(tmp_path))

    corners = f'method = "corners"\n{BOUNDS}'
    cases = result(corners, variables("20"))
    drawing = {case.aleatory_id: case.flight.properties["load/kg"] for case in cases}
    assert len(set(drawing.values())) == 3
    assert all(case.flight.properties["load/kg"] == drawing[case.aleatory_id] for case in cases)
    assert cases[0].inputs == {"variable_load/kg": drawing[0]}
    many = variables("20").replace("flights = 3", "flights = 3000")
    values = [case.flight.properties["load/kg"] for case in result('method = "none"\n', many)]
    assert stats.kstest(values, "norm", args=(20.0, 0.5)).pvalue > 1e-3
    # A variable's stream bears its name: another variable beside it moves nothing.
    other = '[aleatory.variables."a/b"]\ndistribution = "uniform"\nlow = 0\nhigh = 1\n'
    for case in result(corners, variables("20") + other):
        assert case.flight.properties["load/kg"] == drawing[case.aleatory_id]


def test_an_unknown_mean_is_an_epistemic_input_with_corners(tmp_path):
    def result(text):
        return campaign(tmp_path, text, variables("[19, 22]"))

    cases = build_cases(result(f'method = "corners"\n{BOUNDS}'), mission(tmp_path))
    assert len(cases) == 3 * (128 + 16 + 1)
    low, high = cases[0], cases[1]
    assert (low.epistemic_id, high.epistemic_id) == ("000000+0", "000000+1")
    moved = high.flight.properties["load/kg"] - low.flight.properties["load/kg"]
    assert moved == pytest.approx(3.0)
    assert (low.inputs["level_load/kg"], high.inputs["level_load/kg"]) == (0.0, 1.0)
    nominal = build_cases(result('method = "none"\n'), mission(tmp_path))
    assert [case.epistemic_id for case in nominal[:2]] == ["nominal+0", "nominal+1"]
    lhs = epistemic_samples(result(f'method = "lhs"\nsamples = 8\n{BOUNDS}'))
    assert sorted(np.floor([8 * item.means["load/kg"] for item in lhs])) == list(range(8))


def heavy(spec):
    """Errors that follow the load, and CX a little."""
    draw = np.random.default_rng([spec.seed_turbulence])
    size = spec.properties["load/kg"] + 0.1 * spec.properties["uq/CX/level"]
    metrics = {name: size * float(draw.gamma(40.0)) for name in fakes.ERROR_METRICS}
    metrics |= dict.fromkeys([*fakes.EXCURSIONS, "loss_of_control"], 0.0)
    return FlightResult("ok", "", spec.burn_in_s + spec.duration_s, metrics, {}, {})


def test_an_unknown_mean_takes_its_place_among_the_sensitivities(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
    head = variables("[19, 22]").replace("std = 0.5", "std = 0.01")
    epistemic = 'method = "corners"\ncoefficients = ["CX"]\nbounds = { CX = 0.008 }\n'
    spec = campaign(tmp_path, epistemic, head.replace("flights = 3", "flights = 20"))
    run_campaign(
        spec, tmp_path / "out", executor=SerialExecutor(), fly=heavy, mission=mission(tmp_path)
    )
    assert main(["sensitivity", str(tmp_path / "out"), "--json"]) == 0
    (result,) = json.loads(capsys.readouterr().out)["sensitivity"].values()
    indices = result["altitude_median_m"]["indices"]
    assert set(indices) == {"CX", "load/kg"}
    # The error is proportional to load + 0.1 level, and the load's mean moves by 3: shares of the
    # p-box's width 3/3.1 and 0.1/3.1.
    assert indices["load/kg"]["value"] == pytest.approx([3.0 / 3.1] * 2)
    assert indices["CX"]["value"] == pytest.approx([0.1 / 3.1] * 2)


def test_one_property_cannot_be_random_and_unknown_at_once(tmp_path):
    write(tmp_path / "fit.json", FIT)
    head = variables("20").replace("load/kg", "aero/Cm_q")
    with pytest.raises(BadInputError, match="either aleatory or epistemic"):
        build_cases(
            campaign(tmp_path, f'method = "none"\nsamples = 2\n{PARAMETERS}', head),
            mission(tmp_path),
        )


@pytest.mark.parametrize("method", ["corners", "walk"])
def test_drawn_values_are_in_the_table(tmp_path, method):
    text = {"corners": "", "walk": "samples = 2\nwalk_rate_per_sqrt_s = 0.01\n"}[method]
    spec = campaign(tmp_path, f'method = "{method}"\n{text}{BOUNDS}', variables("[19, 22]"))
    out, executor = tmp_path / "out", SerialExecutor()
    run_campaign(spec, out, executor=executor, fly=fakes.steady, mission=mission(tmp_path))
    frame = read_table(out / CASES).to_pandas()
    assert list(frame.columns[-2:]) == ["level_load/kg", "variable_load/kg"]
    if method == "corners":
        low, high = (frame[frame["level_load/kg"] == k]["variable_load/kg"] for k in (0, 1))
        assert high.to_numpy() - 3.0 == pytest.approx(low.to_numpy())
    else:
        # A level that moves is no number of a flight.
        assert frame["level_CX"].isna().all()


@pytest.fixture
def bounded(tmp_path):
    """A campaign of the E-SPAARO with state-dependent bounds from a file."""
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", tmp_path / "plane")
    shutil.copy(PROJECT_ROOT / "scripts" / "trim.xml", tmp_path / "loiter.xml")
    model_form(tmp_path / "model-form.json")
    epistemic = (
        '[epistemic]\nmethod = "corners"\nbounds = "model-form.json"\ncoefficients ='
        ' ["CX"]\ninterior = 0\n'
    )
    head = HEAD.replace("150", "2").replace("60", "0").replace("flights = 3", "flights = 1")
    (tmp_path / "campaign.toml").write_text(head.replace('"moderate"', '"light"') + epistemic)
    return read_campaign(tmp_path / "campaign.toml")


def test_bounds_of_other_files_are_noted(tmp_path, bounded):
    (note,) = bounds_notes(bounded)
    assert "made for aircraft 'espaaro' as it was then" in note
    current = content_hash(find_aircraft(tmp_path / "plane"))
    for name, digest, words in (
        ("glider", "0" * 64, "made for aircraft 'glider', not 'espaaro'"),
        ("espaaro", "0" * 64, "made for aircraft 'espaaro' as it was then"),
        ("espaaro", current, None),
    ):
        model_form(tmp_path / "model-form.json", aircraft=AircraftReference(name, digest))
        notes = bounds_notes(read_campaign(tmp_path / "campaign.toml"))
        assert [words in note for note in notes] == ([True] if words else [])
    assert bounds_notes(campaign(tmp_path, 'method = "corners"\n' + BOUNDS)) == []


def test_the_bounds_of_a_file_fly_in_a_copy_of_the_aircraft(tmp_path, bounded, monkeypatch):
    # A process of its own could not import the function below.
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
    out, trajectory = tmp_path / "out", []

    def run(spec):
        def record(flight):
            trajectory.append(flight)
            return fly(flight)

        return run_campaign(spec, out, executor=SerialExecutor(), fly=record)

    run(bounded)
    copy = out / "aircraft" / "plane"
    assert {spec.aircraft for spec in trajectory} == {copy}
    text = (copy / "Systems" / "model-form.xml").read_bytes()
    form = read_model_form(tmp_path / "model-form.json")
    assert text == model_form_xml(form, find_aircraft(tmp_path / "plane"))
    frame = read_table(out / CASES).to_pandas().set_index("epistemic_id")
    assert list(frame.index) == ["0-----", "1-----", "nominal"]
    assert frame["extrapolated_share"].between(0.0, 1.0).all()
    # The bounds act, CX alone moves, and the source was not touched.
    signals = {name: Source(f"uq/{name}/delta") for name in COEFFICIENTS}
    with StagedMission(find_aircraft(copy), tmp_path / "loiter.xml") as staged:
        low, high, _ = (record_mission(staged, spec, signals).signals for spec in trajectory)
    assert low["CX"][1:].max() < 0.0 < high["CX"][1:].min()
    assert not any(np.any(high[name]) for name in COEFFICIENTS[1:])
    source = PROJECT_ROOT / "aircraft" / "espaaro" / "Systems" / "model-form.xml"
    assert (tmp_path / "plane" / "Systems" / "model-form.xml").read_bytes() == source.read_bytes()
    # Half a copy is mended; a changed model form is another campaign.
    (copy / "Systems" / "model-form.xml").unlink()
    assert run(bounded).done_before == 3
    assert (copy / "Systems" / "model-form.xml").read_bytes() == text
    model_form(tmp_path / "model-form.json", confidence=0.68)
    with pytest.raises(BadInputError, match="content of the file named as bounds"):
        run(read_campaign(tmp_path / "campaign.toml"))


STOCK = """[campaign]
aircraft = "c172p"
mission = "steady"
seed = 1
[start]
V_mps = 55
altitude_m = 500
[aleatory]
flights = 2
duration_s = 20
[epistemic]
"""


def test_bounds_need_the_plugin(tmp_path, bounded):
    xml = tmp_path / "plane" / "espaaro.xml"
    xml.write_text(xml.read_text().replace('<system file="model-form"/>', ""))
    message = r'no <system file="model-form"/>.*uqharness instrument'
    with pytest.raises(BadInputError, match=message):
        run_campaign(bounded, tmp_path / "out", executor=SerialExecutor(), fly=fakes.steady)
    path = tmp_path / "campaign.toml"
    constant = 'method = "corners"\ncoefficients = ["Cm"]\nbounds = { Cm = 0.002 }\n'
    path.write_text(STOCK + constant)
    with pytest.raises(BadInputError, match="add the plugin first: uqharness instrument c172p"):
        find_mission(read_campaign(path), tmp_path)
    path.write_text(f'{STOCK}method = "none"\n')
    assert find_mission(read_campaign(path), tmp_path).source is not None


def test_noise_defaults_to_what_the_aircraft_has(tmp_path):
    plain = tmp_path / "bare" / "bare.xml"
    plain.parent.mkdir()
    plain.write_text("<fdm_config><flight_control/></fdm_config>")
    spec = read_campaign(campaign_file(tmp_path))
    assert spec.aleatory.sensor_noise is None
    assert with_noise_of(spec, find_aircraft("espaaro")).aleatory.sensor_noise is True
    assert with_noise_of(spec, find_aircraft(plain.parent)).aleatory.sensor_noise is False
    # What the file says stays, right or wrong for the aircraft.
    stated = spec.with_sensor_noise(True)
    assert with_noise_of(stated, find_aircraft(plain.parent)).aleatory.sensor_noise is True


def radii(result, names):
    """Distance from the intervals' middles in standard deviations."""
    sigma = stats.norm.ppf(0.975)
    return [sigma * np.linalg.norm([2.0 * s.levels[name] - 1.0 for name in names]) for s in result]


def test_points_of_an_ellipsoid(tmp_path):
    """Directions and axis ends lie on it, the others inside; the corners of the box lie outside."""
    names = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
    made_up_form().write(tmp_path / "model-form.json")
    text = 'method = "corners"\nbounds = "model-form.json"\n'

    def samples(more):
        return epistemic_samples(campaign(tmp_path, text + more))

    points = samples('set = "ellipsoid"\nnominal = false\n')
    directions, ends, inside = points[:64], points[64:76], points[76:]
    assert [s.epistemic_id for s in directions[:2]] == ["e000000", "e000001"]
    assert [s.epistemic_id for s in ends[:3]] == ["a0.....", "a1.....", "a.0...."]
    assert len(inside) == 16
    assert radii(directions, names) == pytest.approx([3.5485] * 64, abs=1e-4)
    assert radii(ends, names) == pytest.approx([3.5485] * 12, abs=1e-4)
    end = pytest.approx(0.5 + 0.5 * 3.54846 / 1.95996, abs=1e-5)
    assert ends[1].levels == {"CX": end} | dict.fromkeys(names[1:], 0.5)
    assert max(radii(inside, names)) < 3.5485
    corners = samples("interior = 0\nnominal = false\n")
    assert radii(corners, names) == pytest.approx([np.sqrt(6.0) * stats.norm.ppf(0.975)] * 64)
    # One coefficient: its directions are its axis, and the joint set is the interval.
    one = samples('coefficients = ["CX"]\nset = "ellipsoid"\ninterior = 0\nnominal = false\n')
    assert [(s.epistemic_id, s.levels["CX"]) for s in one] == [("e0-----", 0.0), ("e1-----", 1.0)]


@pytest.mark.parametrize(("dof", "confidence"), [(1, 0.5), (2, 0.68), (6, 0.95), (12, 0.999)])
def test_the_joint_radius_is_that_of_chi_square(dof, confidence):
    exact = math.sqrt(stats.chi2.ppf(confidence, dof))
    assert sampling.joint_radius(dof, confidence) == pytest.approx(exact, rel=1e-12)
    assert sampling.joint_radius(dof + 1, confidence) > 1.02 * exact
    with pytest.raises(ValueError, match="at least 1"):
        sampling.joint_radius(0, confidence)


def test_the_box_becomes_the_ball():
    corner = sampling.box_to_ball([1.0] * 6)
    assert corner == pytest.approx([1.0 / math.sqrt(6.0)] * 6)
    assert sampling.box_to_ball([0.5, 0.0]) == (0.0, -1.0)
    assert sampling.box_to_ball([0.5] * 3) == (0.0, 0.0, 0.0)
    points = np.random.default_rng(1).random((500, 4))
    lengths = np.linalg.norm([sampling.box_to_ball(p) for p in points], axis=1)
    assert lengths == pytest.approx(np.abs(2.0 * points - 1.0).max(axis=1))
    assert sampling.levels_at([1.0, 0.0], 1.8) == (1.4, 0.5)
