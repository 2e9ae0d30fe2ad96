"""Refusals of the batch engine, and mutations of the project's aircraft: none is passed over."""

from __future__ import annotations

import random
import re

import numpy as np
import pytest

from tests.helpers.batch_whole import EXPENSIVE, copied, same_end, spec
from uqharness.batch.course import fly_many, refusals
from uqharness.errors import BadInputError
from uqharness.flight.fly import fly

FILES = (
    "espaaro.xml",
    "Systems/air.xml",
    "Systems/autopilot.xml",
    "Systems/sensors.xml",
    "Systems/model-form.xml",
)


@pytest.mark.parametrize("name", ["espaaro", "espaaro_truth", "synthetic_stall"])
@pytest.mark.parametrize(
    "script",
    [
        "loiter",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("doublet-elevator", "flight-ident", "flight-bounds")
        ),
    ],
)
def test_the_projects_aircraft_are_understood(name, script):
    varying = (
        "uq/CZ/level",
        "uq/Cm/upper",
        "ap/WP_LOITER_RAD",
        "inertia/iyy-slugs_ft2",
        "metrics/bw-ft",
        "ic/psi-true-deg",
    )
    assert refusals(spec(name, script, 10.0), varying) == ()


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("espaaro.xml", "</fdm_config>", "<buoyant_forces/></fdm_config>", "<buoyant_forces>"),
        (
            "Systems/autopilot.xml",
            "</channel>",
            (
                "<pure_gain name='w'><input>position/vrp-radius-ft</input><gain>1</gain>"
                "<output>fcs/elevator-cmd-norm</output></pure_gain></channel>"
            ),
            "vrp-radius-ft",
        ),
        (
            "Systems/sensors.xml",
            "</channel>",
            (
                "<pure_gain"
                " name='velocities/u-fps'><input>uq/active</input><gain>1</gain></pure_gain></channel>"
            ),
            "velocities/u-fps cannot be written",
        ),
    ],
)
def test_a_broken_aircraft_is_refused_with_file_and_line(tmp_path, file, old, new, said):
    plane = copied(tmp_path, edits={file: {old: new}})
    text = (plane / file).read_text()
    line = text[: text.index(new) + len(new)].count("\n") + 1
    (found,) = refusals(spec(plane, duration_s=5.0))
    assert said in found
    assert f"{plane / file}:" in found
    assert abs(int(re.search(r":(\d+): ", found).group(1)) - line) <= 1


def test_an_instrument_that_is_not_supported_is_left_out(tmp_path):
    needle = "<pure_gain name='w'><input>position/vrp-radius-ft</input><gain>1</gain></pure_gain>"
    edits = {"Systems/autopilot.xml": {"</channel>": f"{needle}<property>w</property></channel>"}}
    plane = copied(tmp_path, edits=edits)
    assert refusals(spec(plane, duration_s=5.0)) == ()


@pytest.mark.parametrize(
    ("properties", "said"),
    [
        ({"simulation/gravitational-torque": 1.0}, "simulation/gravitational-torque"),
        ({"simulation/gravity-model": 0.0}, "simulation/gravity-model"),
        ({"simulation/integrator/rate/rotational": 7.0}, "integrator"),
        ({"forces/hold-down": 1.0}, "forces/hold-down"),
        ({"atmosphere/SL-graded-delta-T": 5.0}, "atmosphere/SL-graded-delta-T"),
        ({"metrics/Sw-sqft": 12.0}, "metrics/Sw-sqft"),
        ({"atmosphere/vapor-pressure-psf": 10.0}, "atmosphere/vapor-pressure-psf"),
    ],
)
def test_unsupported_settings_are_refused(properties, said):
    (found,) = refusals(spec(duration_s=5.0, properties=properties))
    assert said in found


def test_varying_properties_are_checked():
    assert refusals(spec(duration_s=5.0)) == ()
    assert "forces/hold-down" in refusals(spec(duration_s=5.0), ["forces/hold-down"])[0]


READ = (
    "position/vrp-radius-ft",
    "forces/load-factor",
    "orbital/eccentricity",
    "position/distance-from-start-mag-mt",
    "simulation/frame",
    "velocities/ecef-x-fps",
    "gear/num-units",
    "velocities/vc-kts",
    "aero/cl-squared",
    "propulsion/tat-r",
)


ATTRIBUTES = (
    'colour="red"',
    'unit="DEG"',
    'type="x"',
    'frame="WIND"',
    'noscale="1"',
    'copyto="fcs/x"',
    'logic="OR"',
)


TAGS = ("note", "pure_gain", "sum", "gradient", "lag_filter", "product", "wobbler")


def mutated(text, rng):
    """One tag renamed, one attribute added, one property exchanged, one number changed, one line
    twice or gone.
    """
    kind = rng.choice(("tag", "attribute", "property", "number", "gone", "twice"))
    tag = rng.choice(list(re.finditer(r"<([a-z_]+)([^<>]*?)(/?)>", text)))
    lines = list(re.finditer(r"\n[^\n]*<(\w+)[^>\n]*>[^<\n]*</\1>[^\n]*", text))
    if kind == "tag":
        new = rng.choice(TAGS)
        text = text[: tag.start(1)] + new + text[tag.end(1) :]
        end = text.find(f"</{tag.group(1)}>", tag.start())
        return (
            text
            if tag.group(3) or end < 0
            else text[: end + 2] + new + text[end + 2 + len(tag.group(1)) :]
        )
    if kind == "attribute":
        return f"{text[: tag.end(1)]} {rng.choice(ATTRIBUTES)}{text[tag.end(1) :]}"
    if kind in ("property", "number"):
        pattern = (
            r"<(?:property|p|input)>([^<]+)<" if kind == "property" else r">\s*(-?\d+\.?\d*)\s*<"
        )
        found = list(re.finditer(pattern, text))
        if not found:
            return text
        place, new = (
            rng.choice(found),
            rng.choice(
                READ if kind == "property" else ("1e-3", "-2", "0", "5", "0x10", "nan", ".5e0")
            ),
        )
        return text[: place.start(1)] + new + text[place.end(1) :]
    if not lines:
        return text
    line = rng.choice(lines)
    return (
        text[: line.start()] + text[line.end() :]
        if kind == "gone"
        else text[: line.end()] + line.group(0) + text[line.end() :]
    )


def outcome(plane):
    """How a mutant flies: refused by either, or the same flight.

    AssertionError for another flight.
    """
    given = spec(
        plane,
        duration_s=3.0,
        turbulence_source="jsbsim",
        properties={"uq/active": 1.0},
        **EXPENSIVE,
    )
    try:
        theirs = fly(given)
    except BadInputError:
        return "jsbsim"
    try:
        (ours,) = fly_many([given])
    except BadInputError as error:
        return "batch" if re.search(r"\.xml:\d+: ", str(error)) else "no line"
    assert same_end(theirs, ours)
    if theirs.status == "ok":
        # In the first row places are roundings of 0, of which a mutant may take the sign.
        for name, values in ((name, values[1:]) for name, values in theirs.signals.items()):
            there, other = np.isfinite(values), ours.signals[name][1:]
            assert (there == np.isfinite(other)).all(), name
            gap = np.abs(values[there] - other[there])
            assert gap.max(initial=0.0) <= 1e-7 * np.abs(values[there]).max(initial=1e-2), name
    return "same"


def survey(folder, seed, count):
    rng = random.Random(seed)
    out = []
    for number in range(count):
        plane = copied(folder / str(number))
        file = plane / rng.choice(FILES)
        file.write_text(mutated(file.read_text(), rng))
        out.append(outcome(plane))
    assert "no line" not in out
    return out


@pytest.mark.slow
def test_mutants_are_refused_or_fly_the_same(tmp_path):
    assert {"batch", "same"} <= set(survey(tmp_path, 3, 6))


def test_a_mutant_that_only_one_engine_flies_is_noticed(tmp_path, monkeypatch):
    plane = copied(tmp_path, edits={"Systems/model-form.xml": {">uq/CZ/upper<": ">uq/CZ/upper<"}})
    plain = fly_many(
        [
            spec(
                duration_s=3.0,
                turbulence_source="jsbsim",
                properties={"uq/active": 1.0},
                **EXPENSIVE,
            )
        ]
    )
    monkeypatch.setattr(f"{__name__}.fly_many", lambda _: plain)
    assert outcome(plane) == "same"
    file = plane / "Systems/model-form.xml"
    file.write_text(
        file.read_text().replace('value="0.05">uq/CZ/upper', 'value="0.050001">uq/CZ/upper')
    )
    with pytest.raises(AssertionError):
        outcome(plane)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_many_mutants(tmp_path, seed):
    found = survey(tmp_path, 100 + seed, 60)
    assert found.count("same") > 5
    assert found.count("batch") > 5
