"""campaign.toml: accepted settings, and each kind of mistake named with its line."""

from __future__ import annotations

import tomllib

import pytest
from pydantic import ValidationError

from tests.helpers.campaign_fakes import CAMPAIGN
from tests.helpers.few import rows
from uqharness.campaign.read_spec import campaign_from, read_campaign, with_samples
from uqharness.campaign.spec import (
    EpistemicSection,
    VariableSection,
)
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


MISTAKES = """
seed = 7 | sede = 7 | sede: unknown key; did you mean seed?; allowed: aircraft, mission, seed
[aleatory] | [aleotory] | [aleotory]: unknown section; did you mean aleatory?
seed = 7 | seed = "seven" | [campaign] seed = "seven": a whole number of at least 0
seed = 7 | seed = -1 | [campaign] seed = -1: a whole number of at least 0
seed = 7 | seed = true | [campaign] seed = true: a whole number
flights = 3 | flights = 0 | [aleatory] flights = 0: a whole number of at least 1
duration_s = 150 | duration_s = nan | [aleatory] duration_s = nan: a number above 0
wind_mps = 3 | wind_mps = [3, 300] | [aleatory] wind_mps.1 = 300; up to 60
wind_mps = 3 | wind_mps = [3, 3] | [aleatory] wind_mps; none twice
wind_mps = 3 | wind_mps = [] | [aleatory] wind_mps; at least one
"moderate" | "heavy" | [aleatory] turbulence = "heavy": allowed are none, light
"jsbsim" | "xplane" | turbulence_source = "xplane": allowed are jsbsim, spec
method = "corners" | method = "lhs" | "lhs" needs samples; samples = 2000
method = "corners" | method = "corners"\\nsamples = 9 | samples belongs to; "corners"
method = "corners" | method = "corners"\\nwalk_rate_per_sqrt_s = 1 | belongs to method = "walk"
method = "corners" | method = "walk"\\nsamples = 0 | samples = 0: a whole number of at least 1
method = "corners" | method = "sobol" | [epistemic] method = "sobol": allowed are none, corners
method = "corners" | method = "levels" | levels; [0, 0.5, 1]
CX = 0.008 | CX = -0.008 | bounds; CX = -0.008; half-width
CX = 0.008 | CX = [0.001, 0.008] | bounds; lower <= 0 <= upper
CX = 0.008 | CX = "wide" | bounds; number (±) or a pair
CX = 0.008 | Cx = 0.008 | bounds.Cx: allowed are CX, CY
CX = 0.008, |  | bounds lack CX
"""


@pytest.mark.parametrize(("old", "new", "fragments"), rows(MISTAKES))
def test_each_mistake_is_named_with_its_line(tmp_path, old, new, fragments):
    text = CAMPAIGN.replace(old, new)
    assert text != CAMPAIGN
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    for fragment in fragments.split("; "):
        assert fragment in message, message
    if new and "method" not in new:
        assert f"campaign.toml:{line_of(text, new)}: " in message, message


def test_what_is_missing_points_at_its_section_and_all_mistakes_are_listed_at_once(tmp_path):
    text = CAMPAIGN.replace("seed = 7\n", "")
    message = rf":{line_of(text, '[campaign]')}: \[campaign\] seed: required"
    with pytest.raises(BadInputError, match=message):
        read(tmp_path, text)
    with pytest.raises(BadInputError, match=r":1: \[epistemic\]: required"):
        read(tmp_path, CAMPAIGN.partition("[epistemic]")[0])
    text = CAMPAIGN.replace("seed = 7", "seed = -1").replace("flights = 3", "flights = 0")
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, text)
    assert len(str(caught.value).splitlines()) == 2


INCONSISTENT = r"""
stop | rule = "decide"\nradius_m = 20 | :23: [stop] radius_m = 20: must be among [metrics] excursion_radius_m
stop | rule = "decide"\nindifference_per_h = [0.2, 0.3] | must hold [metrics] acceptable_per_h = 0.1
stop | rule = "decide"\nindifference_per_h = [0.3, 0.05] | must be [lower, upper]
stop | rule = "decide"\nerror_rate = 0.5 | [stop] error_rate = 0.5: a number above 0 and below 0.5 is needed
stop | rule = "decide"\nhours = 500 | hours belongs to rule = "hours", not to "decide"
stop | rule = "band-width" | "band-width" needs band_width
stop | rule = "hours"\nhours = 500 | flights = 3, but [stop] hours = 500 of flights of 150 s needs 12000
stop | rule = "sprt" | [stop] rule = "sprt": allowed are flights, hours, band-width, decide
metrics | dispersion = 0.5 | [metrics] dispersion = 0.5: a number of at least 1
epistemic.parameters | fit = "fit.json" | [epistemic.parameters] needs samples
metrics | rearm_m = 15 | less than the smallest radius, 15 m
"""


@pytest.mark.parametrize(("section", "settings", "fragment"), rows(INCONSISTENT))
def test_inconsistent_sections(tmp_path, section, settings, fragment):
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, f"{CAMPAIGN}\n[{section}]\n{settings}\n")
    assert fragment in str(caught.value)


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


IN_A_VARIABLE = r"""
"normal" | "gamma" | distribution = "gamma": allowed are normal, uniform
"normal" | "uniform" | uniform; low and high or mean and half_width; received mean, std
std = 0.5 | std = 0 | std = 0: a number above 0 is needed
std = 0.5 | stddev = 0.5 | stddev: unknown key; allowed: distribution, mean, std
mean = [1, 2] | mean = [2, 1] | low < high
mean = [1, 2] | mean = "heavy" | mean = "heavy": a finite number is needed
mean = [1, 2] |  | needs mean and std; received std
std = 0.5 | std = 0.5\nlow = 0 | needs mean and std; received mean, std, low
"""


@pytest.mark.parametrize(("old", "new", "fragments"), rows(IN_A_VARIABLE))
def test_each_mistake_in_a_variable_is_named_with_its_line(tmp_path, old, new, fragments):
    text = CAMPAIGN + VARIABLE.replace(old, new)
    with pytest.raises(BadInputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    for fragment in (
        '[aleatory.variables."inertia/pointmass-weight-lbs[1]"]',
        *fragments.split("; "),
    ):
        assert fragment in message, message
    # A mistake in one key points at it, one between keys at the variable's header.
    at_key = line_of(text, new) if new and "\n" not in new and fragments != "low < high" else 0
    lines = (at_key, line_of(text, "[aleatory.variables"))
    assert any(f"campaign.toml:{line}: " in message for line in lines), message


def test_unreadable_files(tmp_path):
    with pytest.raises(BadInputError, match="cannot be read"):
        read_campaign(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInputError, match="UTF-8"):
        read_campaign(tmp_path / "binary.toml")


def test_rules_that_say_how_many_flights_there_are(tmp_path):
    text = CAMPAIGN.replace("flights = 3\n", "")
    hours = read(tmp_path, text + '\n[stop]\nrule = "hours"\nhours = 500\n')
    assert hours.aleatory.flights == 12_000
    assert [hours.with_hours(time).aleatory.flights for time in (1.0, 0.001)] == [24, 1]
    assert read(tmp_path, CAMPAIGN + '\n[stop]\nrule = "hours"\n').aleatory.flights == 3
    band = read(tmp_path, text + '\n[stop]\nrule = "band-width"\nband_width = 0.1\n')
    flights = band.aleatory.flights
    assert band_half_width(flights, 64, 0.95) <= 0.1 < band_half_width(flights - 1, 64, 0.95)
    walks = text.replace('"corners"', '"walk"\nsamples = 8\nwalk_rate_per_sqrt_s = 0.01')
    few = read(tmp_path, walks + '\n[stop]\nrule = "band-width"\nband_width = 0.1\n')
    assert few.aleatory.flights < with_samples(few, 64).aleatory.flights == flights
    with pytest.raises(BadInputError, match="determines the number of flights"):
        band.with_hours(3.0)
    # As a manifest holds them they mean the same.
    for spec in (hours, hours.with_hours(1.0), band):
        assert campaign_from(spec.as_dict(), spec.path).aleatory.flights == spec.aleatory.flights
    with pytest.raises(BadInputError, match=r"\[aleatory\] flights: required"):
        read(tmp_path, text + '\n[stop]\nrule = "decide"\n')


REST = "CY = 0.01, CZ = 0.01, Cl = 0.01, Cm = 0.01, Cn = 0.01"
BOUNDS = f"{{ CX = 0.01, {REST} }}"


def build(settings: str) -> EpistemicSection:
    text = settings.replace("BOUNDS", BOUNDS).replace("REST", REST).replace("; ", "\n")
    return EpistemicSection.model_validate(tomllib.loads(text))


CONTRADICTIONS = """
method = "corners"; coefficients = ["CX"]; bounds = { CX = 0.01, Cm = 0.01 } | given for Cm, which is not among
method = "corners"; bounds = "wide" | must be numbers
method = "corners"; bounds = { CX = [1, 2, 3], REST } | a number .±. or a pair
method = "levels"; bounds = BOUNDS | levels belongs to method
method = "levels"; bounds = BOUNDS; levels = [0.0, 1.5] | from 0 .lower bound. to 1
method = "levels"; bounds = BOUNDS; levels = [0.5, 0.5] | none twice
method = "corners"; bounds = BOUNDS; samples = 5 | flies every combination
method = "walk"; samples = 5; bounds = BOUNDS; walk_rate_per_sqrt_s = 0.0 | a rate is a number above 0
method = "walk"; samples = 5; bounds = BOUNDS; walk_rate_per_sqrt_s = { CX = 0.1 } | lacks CY
method = "white"; samples = 5; bounds = BOUNDS; walk_rate_per_sqrt_s = 0.1 | not to "white"
method = "none"; parameters = { fit = "fit.json" } | .epistemic.parameters. needs samples
method = "corners"; coefficients = ["CX", "CX"] | none twice
method = "corners"; coefficients = ["CQ"] | coefficients
method = "walk"; samples = 5; bounds = "model-form.json"; set = "ellipsoid" | belongs to the methods corners and lhs
method = "lhs"; samples = 5; bounds = BOUNDS; interior = 4 | flown with corners
method = "lhs"; samples = 5; bounds = BOUNDS; nominal = true | flies it alone
method = "corners"; bounds = BOUNDS; interior = -1 | interior
method = "corners"; bounds = BOUNDS; set = "ball" | set
method = "none"; transient = true | method = "none" flies no model error
"""


@pytest.mark.parametrize(("settings", "output"), rows(CONTRADICTIONS))
def test_sections_that_contradict_themselves(settings, output):
    with pytest.raises(ValidationError, match=output):
        build(settings)


def made_variables(**section) -> VariableSection:
    return VariableSection.model_validate(section)


@pytest.mark.parametrize(
    ("section", "draw", "level", "value"),
    [
        ({"distribution": "normal", "mean": 20.0, "std": 0.5}, 2.0, 0.3, 21.0),
        ({"distribution": "normal", "mean": [19.0, 22.0], "std": 0.5}, -2.0, 0.0, 18.0),
        ({"distribution": "normal", "mean": [19.0, 22.0], "std": 0.5}, 0.0, 1.0, 22.0),
        ({"distribution": "uniform", "low": 1.0, "high": 5.0}, -1.0, 0.5, 1.0),
        ({"distribution": "uniform", "low": 1.0, "high": 5.0}, 0.5, 0.5, 4.0),
        ({"distribution": "uniform", "mean": [0.0, 10.0], "half_width": 2.0}, 1.0, 0.25, 4.5),
    ],
)
def test_values_of_draws(section, draw, level, value):
    result = made_variables(**section)
    assert result.value(draw, level) == pytest.approx(value)
    assert (result.mean_interval is None) is not isinstance(section.get("mean"), list)
