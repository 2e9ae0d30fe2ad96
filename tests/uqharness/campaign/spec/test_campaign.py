"""campaign.toml: what is accepted, and that each kind of mistake is named with its line."""

from __future__ import annotations

import pytest

from tests.helpers.campaign_fakes import CAMPAIGN
from uqharness.campaign.read_spec import campaign_from, read_campaign, with_samples
from uqharness.errors import BadInputError
from uqharness.flight.spec import COEFFICIENTS
from uqharness.statistics.pbox import band_half_width


def read(tmp_path, text):
    path = tmp_path / "campaign.toml"
    path.write_text(text)
    return read_campaign(path)


def line_of(text, fragment):
    return next(number for number, line in enumerate(text.splitlines(), 1) if fragment in line)


def test_reads_a_campaign_and_fills_in_defaults(tmp_path):
    spec = read(tmp_path, CAMPAIGN)
    assert spec.campaign.seed == 7
    assert spec.aleatory.wind_mps == (3.0,)
    assert spec.aleatory.turbulence == ("moderate",)
    assert spec.aleatory.sensor_noise is None
    assert spec.epistemic.bounds["CZ"] == (-0.05, 0.05)
    assert spec.metrics.excursion_radius_m == (15.0, 25.0)
    assert spec.stop.rule == "flights"


def test_lists_and_asymmetric_bounds(tmp_path):
    text = CAMPAIGN.replace("wind_mps = 3", "wind_mps = [0, 1.5]").replace(
        '"moderate"', '["light", "severe"]'
    )
    spec = read(tmp_path, text.replace("CX = 0.008", "CX = [-0.001, 0.008]"))
    assert spec.aleatory.wind_mps == (0.0, 1.5)
    assert spec.aleatory.turbulence == ("light", "severe")
    assert spec.epistemic.bounds["CX"] == (-0.001, 0.008)


@pytest.mark.parametrize(
    ("old", "new", "fragments"),
    [
        (
            "seed = 7",
            "sede = 7",
            ["sede: unknown key", "did you mean seed?", "allowed: aircraft, mission, seed"],
        ),
        ("[aleatory]", "[aleotory]", ["[aleotory]: unknown section", "did you mean aleatory?"]),
        ("seed = 7", 'seed = "seven"', ['[campaign] seed = "seven": a whole number of at least 0']),
        ("seed = 7", "seed = -1", ["[campaign] seed = -1: a whole number of at least 0"]),
        ("seed = 7", "seed = true", ["[campaign] seed = true: a whole number"]),
        (
            "flights = 3",
            "flights = 0",
            ["[aleatory] flights = 0: a whole number of at least 1"],
        ),
        (
            "duration_s = 150",
            "duration_s = nan",
            ["[aleatory] duration_s = nan: a number above 0"],
        ),
        ("wind_mps = 3", "wind_mps = [3, 300]", ["[aleatory] wind_mps.1 = 300", "up to 60"]),
        ("wind_mps = 3", "wind_mps = [3, 3]", ["[aleatory] wind_mps", "none twice"]),
        ("wind_mps = 3", "wind_mps = []", ["[aleatory] wind_mps", "at least one"]),
        ('"moderate"', '"heavy"', ['[aleatory] turbulence = "heavy": allowed are none, light']),
        ('"jsbsim"', '"xplane"', ['turbulence_source = "xplane": allowed are jsbsim, spec']),
        ('method = "corners"', 'method = "lhs"', ['"lhs" needs samples', "samples = 2000"]),
        (
            'method = "corners"',
            'method = "corners"\nsamples = 9',
            ["samples belongs to", '"corners"'],
        ),
        (
            'method = "corners"',
            'method = "corners"\nwalk_rate_per_sqrt_s = 1',
            ['belongs to method = "walk"'],
        ),
        (
            'method = "corners"',
            'method = "walk"\nsamples = 0',
            ["samples = 0: a whole number of at least 1"],
        ),
        (
            'method = "corners"',
            'method = "sobol"',
            ['[epistemic] method = "sobol": allowed are none, corners'],
        ),
        ('method = "corners"', 'method = "levels"', ["levels", "[0, 0.5, 1]"]),
        ("CX = 0.008", "CX = -0.008", ["bounds", "CX = -0.008", "half-width"]),
        ("CX = 0.008", "CX = [0.001, 0.008]", ["bounds", "lower <= 0 <= upper"]),
        ("CX = 0.008", 'CX = "wide"', ["bounds", "number (±) or a pair"]),
        ("CX = 0.008", "Cx = 0.008", ["bounds.Cx: allowed are CX, CY"]),
        ("CX = 0.008, ", "", ["bounds lack CX"]),
    ],
)
def test_each_mistake_is_named_with_its_line(tmp_path, old, new, fragments):
    text = CAMPAIGN.replace(old, new)
    assert text != CAMPAIGN
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    for fragment in fragments:
        assert fragment in message, message
    if new and "method" not in new and "bounds lack" not in message:
        assert f"campaign.toml:{line_of(text, new)}: " in message, message


def test_missing_key_points_at_its_section(tmp_path):
    text = CAMPAIGN.replace("seed = 7\n", "")
    with pytest.raises(
        BadInputError, match=rf":{line_of(text, '[campaign]')}: \[campaign\] seed: required"
    ):
        read(tmp_path, text)


def test_missing_section_is_named(tmp_path):
    with pytest.raises(BadInputError, match=r":1: \[epistemic\]: required"):
        read(tmp_path, CAMPAIGN.partition("[epistemic]")[0])


def test_all_mistakes_are_listed_at_once(tmp_path):
    text = CAMPAIGN.replace("seed = 7", "seed = -1").replace("flights = 3", "flights = 0")
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, text)
    assert len(str(caught.value).splitlines()) == 2


def test_bad_toml_names_the_line(tmp_path):
    text = CAMPAIGN.replace("flights = 3", "flights = = 3")
    with pytest.raises(
        BadInputError, match=rf"campaign.toml:{line_of(text, 'flights')}: not valid TOML"
    ):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("addition", "fragment"),
    [
        (
            '[stop]\nrule = "decide"\nradius_m = 20\n',
            ":23: [stop] radius_m = 20: must be among [metrics] excursion_radius_m",
        ),
        (
            '[stop]\nrule = "decide"\nindifference_per_h = [0.2, 0.3]\n',
            "must hold [metrics] acceptable_per_h = 0.1",
        ),
        ('[stop]\nrule = "decide"\nindifference_per_h = [0.3, 0.05]\n', "must be [lower, upper]"),
        (
            '[stop]\nrule = "decide"\nerror_rate = 0.5\n',
            "[stop] error_rate = 0.5: a number above 0 and below 0.5 is needed",
        ),
        (
            '[stop]\nrule = "decide"\nhours = 500\n',
            'hours belongs to rule = "hours", not to "decide"',
        ),
        ('[stop]\nrule = "band-width"\n', '"band-width" needs band_width'),
        (
            '[stop]\nrule = "hours"\nhours = 500\n',
            "flights = 3, but [stop] hours = 500 of flights of 150 s asks for 12000",
        ),
        (
            '[stop]\nrule = "sprt"\n',
            '[stop] rule = "sprt": allowed are flights, hours, band-width, decide',
        ),
        (
            "[metrics]\ndispersion = 0.5\n",
            "[metrics] dispersion = 0.5: a number of at least 1",
        ),
        ('[epistemic.parameters]\nfit = "fit.json"\n', "[epistemic.parameters] needs samples"),
        ("[metrics]\nrearm_m = 15\n", "less than the smallest radius, 15 m"),
    ],
)
def test_what_is_planned_or_inconsistent(tmp_path, addition, fragment):
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, CAMPAIGN + "\n" + addition)
    assert fragment in str(caught.value)


@pytest.mark.parametrize(
    ("rate", "fragment"),
    [
        ("0", "CX = 0: a rate is a number above 0"),
        ('"fast"', "a rate is a number above 0"),
        ("{ CX = 0.01 }", "lacks CY, CZ"),
        ("{ CX = 0.01, CL = 0.01 }", "CL"),
    ],
)
def test_walk_rates(tmp_path, rate, fragment):
    head = CAMPAIGN.replace('"corners"', f'"walk"\nsamples = 4\nwalk_rate_per_sqrt_s = {rate}')
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, head)
    assert fragment in str(caught.value), str(caught.value)


def test_a_walk_with_one_rate_for_all_or_one_each(tmp_path):
    text = CAMPAIGN.replace('"corners"', '"walk"\nsamples = 4\nwalk_rate_per_sqrt_s = 0.012')
    assert read(tmp_path, text).inputs.walk_rates == dict.fromkeys(COEFFICIENTS, 0.012)
    # Without one it is the published rate, and the manifest says so.
    spec = read(tmp_path, text.replace("walk_rate_per_sqrt_s = 0.012", ""))
    assert spec.inputs.walk_rates == pytest.approx(dict.fromkeys(COEFFICIENTS, 0.01202), rel=1e-3)
    assert spec.as_dict()["epistemic"]["walk_rate_per_sqrt_s"] == spec.inputs.walk_rates
    rates = ", ".join(f"{name} = 0.0{number}" for number, name in enumerate(COEFFICIENTS, 1))
    assert (
        read(tmp_path, text.replace("sqrt_s = 0.012", f"sqrt_s = {{ {rates} }}")).inputs.walk_rates[
            "Cn"
        ]
        == 0.06
    )


VARIABLE = (
    '\n[aleatory.variables."inertia/pointmass-weight-lbs[1]"]\ndistribution = "normal"\nmean = [1,'
    " 2]\nstd = 0.5\n"
)


def test_variables_with_known_and_unknown_means(tmp_path):
    extra = (
        '[aleatory.variables."metrics/Sw-sqft"]\ndistribution = "uniform"\nlow = 20\nhigh = 22\n'
    )
    variables = read(tmp_path, CAMPAIGN + VARIABLE + extra).aleatory.variables
    load, area = variables["inertia/pointmass-weight-lbs[1]"], variables["metrics/Sw-sqft"]
    assert load.mean_interval == (1.0, 2.0)
    assert area.mean_interval is None
    assert [load.value(2.0, level) for level in (0.0, 1.0)] == [2.0, 3.0]
    assert [area.value(draw, 0.5) for draw in (-1.0, 0.0, 1.0)] == [20.0, 21.0, 22.0]


@pytest.mark.parametrize(
    ("old", "new", "fragments"),
    [
        ('"normal"', '"gamma"', ['distribution = "gamma": allowed are normal, uniform']),
        (
            '"normal"',
            '"uniform"',
            ["uniform", "low and high or mean and half_width", "received mean, std"],
        ),
        ("std = 0.5", "std = 0", ["std = 0: a number above 0 is needed"]),
        ("std = 0.5", "stddev = 0.5", ["stddev: unknown key", "allowed: distribution, mean, std"]),
        ("mean = [1, 2]", "mean = [2, 1]", ["low < high"]),
        ("mean = [1, 2]", 'mean = "heavy"', ['mean = "heavy": a finite number is needed']),
        ("mean = [1, 2]\n", "", ["needs mean and std", "received std"]),
        ("std = 0.5", "std = 0.5\nlow = 0", ["needs mean and std", "received mean, std, low"]),
    ],
)
def test_each_mistake_in_a_variable_is_named_with_its_line(tmp_path, old, new, fragments):
    text = CAMPAIGN + VARIABLE.replace(old, new)
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    for fragment in ('[aleatory.variables."inertia/pointmass-weight-lbs[1]"]', *fragments):
        assert fragment in message, message
    # A mistake in one key points at it, one between keys at the variable's header.
    at_key = (
        line_of(text, new) if new and "\n" not in new and "low < high" not in fragments[0] else 0
    )
    assert any(
        f"campaign.toml:{line}: " in message
        for line in (at_key, line_of(text, "[aleatory.variables"))
    ), message


def test_unreadable_files(tmp_path):
    with pytest.raises(BadInputError, match="cannot be read"):
        read_campaign(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInputError, match="UTF-8"):
        read_campaign(tmp_path / "binary.toml")


def test_hours_set_the_number_of_flights(tmp_path):
    spec = read(tmp_path, CAMPAIGN)
    assert spec.with_hours(1.0).aleatory.flights == 24
    assert spec.with_hours(0.001).aleatory.flights == 1


def test_the_demo_campaign_is_valid():
    from uqharness.simulator.aircraft import PROJECT_ROOT

    spec = read_campaign(PROJECT_ROOT / "campaigns" / "demo" / "campaign.toml")
    assert spec.epistemic.method == "corners"
    assert set(spec.epistemic.bounds) == set(spec.epistemic.coefficients)


def test_rules_that_say_how_many_flights_there_are(tmp_path):
    text = CAMPAIGN.replace("flights = 3\n", "")
    hours = read(tmp_path, text + '\n[stop]\nrule = "hours"\nhours = 500\n')
    assert hours.aleatory.flights == 12_000
    assert hours.with_hours(1.0).aleatory.flights == 24
    assert read(tmp_path, CAMPAIGN + '\n[stop]\nrule = "hours"\n').aleatory.flights == 3
    band = read(tmp_path, text + '\n[stop]\nrule = "band-width"\nband_width = 0.1\n')
    flights = band.aleatory.flights
    assert band_half_width(flights, 64, 0.95) <= 0.1 < band_half_width(flights - 1, 64, 0.95)
    walks = text.replace('"corners"', '"walk"\nsamples = 8\nwalk_rate_per_sqrt_s = 0.01')
    few = read(tmp_path, walks + '\n[stop]\nrule = "band-width"\nband_width = 0.1\n')
    assert few.aleatory.flights < with_samples(few, 64).aleatory.flights == flights
    with pytest.raises(BadInputError, match="says how much is flown"):
        band.with_hours(3.0)
    # As a manifest holds them they mean the same.
    for spec in (hours, hours.with_hours(1.0), band):
        assert campaign_from(spec.as_dict(), spec.path).aleatory.flights == spec.aleatory.flights
    with pytest.raises(BadInputError, match=r"\[aleatory\] flights: required"):
        read(tmp_path, text + '\n[stop]\nrule = "decide"\n')
