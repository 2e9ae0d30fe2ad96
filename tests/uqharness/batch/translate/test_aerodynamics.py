"""``<aerodynamics>`` flown by JSBSim and by its translation: axes, order, what is published; and
what is refused.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import START, aircraft, compared, refused, worst
from tests.helpers.few import few

ROLL = (
    "<axis name='ROLL'><function"
    " name='f/roll'><product><p>i/l</p><v>.1</v></product></function></axis>"
)


RECORDS = (
    *(f"forces/f{k}{a}-aero-lbs" for k in "bws" for a in "xyz"),
    *(f"moments/{a}-aero-lbsft" for a in "lmn"),
    "forces/lod-norm",
    "aero/cl-squared",
    "aero/alpha-rad",
    "aero/beta-rad",
    "aero/qbar-area",
    "aero/alpha-wing-rad",
    "systems/stall-warn-norm",
    "aero/stall-hyst-norm",
    "aero/alpha-max-rad",
    "aero/alpha-min-rad",
    "aero/h_b-mac-ft",
    "accelerations/wdot-ft_sec2",
    "accelerations/qdot-rad_sec2",
)


HOST = "<system name='host'><property>i/a</property><property>i/l</property></system>"


def inputs(frames=30, seed=0):
    rng = np.random.default_rng(seed)
    return {
        "i/a": rng.normal(size=frames + 1) * 20.0,
        "i/l": np.sin(np.arange(frames + 1) / 20.0) * 10.0,
    }


def axis(name, factor, frame="", unit=""):
    attributes = (f' frame="{frame}"' if frame else "") + (f' unit="{unit}"' if unit else "")
    return (
        f'<axis name="{name}"{attributes}><function'
        f' name="f/{name}"><sum><product><p>i/a</p><v>{factor}</v></product>'
        f"<product><p>aero/qbar-psf</p><p>aero/alpha-rad</p><v>{factor}</v></product></sum></function></axis>"
    )


def axes(names, frame="", unit=""):
    return "".join(axis(name, 0.5 + k, frame, unit) for k, name in enumerate(names))


def body(text):
    return aircraft(f"{HOST}<aerodynamics>{text}</aerodynamics>")


def differences(text, changed=None, frames=30, start=START, records=RECORDS):
    return compared(
        body(text),
        records,
        inputs(frames),
        frames,
        start,
        changed=None if changed is None else body(changed),
    )


SYSTEMS = {
    "wind": axes(("DRAG", "SIDE", "LIFT")),
    "wind, another order": axes(("LIFT", "DRAG", "SIDE")),
    "wind, a frame that is ignored": axes(("DRAG", "SIDE", "LIFT"), "STABILITY"),
    "wind, a unit that is ignored": axes(("DRAG", "LIFT"), unit="N"),
    "side alone": axes(("SIDE",)),
    "axial and normal": axes(("AXIAL", "SIDE", "NORMAL")),
    "side before axial": axes(("SIDE", "AXIAL")),
    "body": axes("XYZ"),
    "named body": axes("XYZ", "BODY"),
    "stability": axes("XYZ", "STABILITY"),
    "named wind": axes("XYZ", "WIND"),
    "one of body": axes("Z"),
    "moments": axes(("ROLL", "PITCH", "YAW")),
    "moments, body": axes(("ROLL", "PITCH"), "BODY", "LBSFT"),
    "moments, stability": axes(("ROLL", "PITCH", "YAW"), "STABILITY") + axes("XZ"),
    "moments, wind": axes(("YAW", "ROLL"), "WIND") + axes(("DRAG", "LIFT")),
    "nothing": "",
}


@pytest.mark.parametrize("name", few(SYSTEMS, 3))
def test_aerodynamic_axes_are_jsbsims(name):
    result = differences(SYSTEMS[name])
    if name == "side alone":
        del result["forces/lod-norm"]  # a ratio of two roundings
    assert worst(result) < 1e-10


@pytest.mark.parametrize(
    ("text", "changed"),
    few(
        [
            (SYSTEMS["wind"], SYSTEMS["named body"]),
            (SYSTEMS["stability"], SYSTEMS["named wind"]),
            (SYSTEMS["named wind"], SYSTEMS["stability"]),
            (SYSTEMS["axial and normal"], SYSTEMS["body"]),
            (SYSTEMS["moments"], axes(("ROLL", "PITCH", "YAW"), "WIND")),
            (SYSTEMS["moments, stability"], axes(("ROLL", "PITCH", "YAW"), "WIND") + axes("XZ")),
            (axes("Z"), axes("Z").replace("<v>0.5</v>", "<v>0.500000001</v>")),
        ],
        2,
    ),
)
def test_other_aerodynamic_axes_differ(text, changed):
    assert worst(differences(text, changed)) > 1e-10


CG = axes("XZ").replace('name="f/Z"', 'name="f/Z" apply_at_cg="true"') + axes(("PITCH",))


def test_forces_at_the_cg():
    assert worst(differences(CG)) < 1e-10
    assert worst(differences(CG, axes("XZ") + axes(("PITCH",)))) > 1e-6


CROSSED = (
    "<function name='a/first'><sum><p>aero/bi2vel</p><p>aero/ci2vel</p></sum></function><axis"
    " name='PITCH'><function name='f/m'><sum><p>i/a</p><p>f/x</p></sum></function></axis><axis"
    " name='Z'><function name='f/at'"
    " apply_at_cg='true'><sum><p>f/z</p><p>i/l</p></sum></function><function"
    " name='f/z'><sum><p>i/a</p><p>aero/cl-squared</p></sum></function></axis><axis"
    " name='X'><function"
    " name='f/x'><difference><p>a/first</p><product><p>f/z</p><v>.5</v></product></difference></function></axis><function"
    " name='a/last'><product><p>f/z</p><v>2</v></product></function><function name='a/post'"
    " type='post'><product><p>f/z</p><v>3</v></product></function>"
)


CROSSED_RECORDS = (*RECORDS, "f/m", "f/x", "f/z", "f/at", "a/first", "a/last", "a/post")


def test_functions_that_read_each_other_run_in_jsbsims_order():
    assert worst(differences(CROSSED, records=CROSSED_RECORDS)) < 1e-10


STALL = (
    '<alphalimits unit="DEG"><min>-5.7</min><max>9</max></alphalimits>'
    '<hysteresis_limits unit="DEG"><min>3</min><max>7</max></hysteresis_limits>'
    "<axis name='PITCH'><function name='f/m'><sum><product><p>i/l</p><v>8</v></product>"
    "<product><p>aero/alpha-rad</p><v>-400</v></product><product><p>velocities/q-rad_sec</p><v>-80</v></product>"
    "<p>aero/stall-hyst-norm</p><p>systems/stall-warn-norm</p></sum></function></axis>"
)


def test_stall_warning_and_hysteresis():
    result = differences(STALL, frames=110)
    assert worst(result) < 1e-10
    assert (
        worst(differences(STALL, STALL.replace("<max>7</max>", "<max>6</max>"), frames=110)) > 1e-3
    )
    assert (
        worst(differences(STALL, STALL.replace("<min>3</min>", "<min>2</min>"), frames=110)) > 1e-3
    )
    radians = (
        STALL.replace(' unit="DEG"', "")
        .replace(">9<", ">.16<")
        .replace(">7<", ">.12<")
        .replace(">3<", ">.05<")
    )
    assert worst(differences(radians, frames=60)) < 1e-10


def test_the_reference_point_may_be_written():
    gain = (
        "<flight_control name='f'><channel name='c'><pure_gain"
        " name='metrics/aero-rp-{}'><input>i/l</input><gain>{}</gain>"
    )
    gain += "</pure_gain>"
    remainder = f"</channel></flight_control><aerodynamics>{axes('XZ')}</aerodynamics>"
    text = aircraft(HOST + gain.format("x-in", 1.5) + remainder)
    assert worst(compared(text, RECORDS, inputs(), 30)) < 1e-10
    assert (
        worst(compared(text, RECORDS, inputs(), 30, changed=text.replace("1.5", "1.50001"))) > 1e-6
    )
    # JSBSim keeps another area or span, and flies with the first.
    assert "metrics/Sw-sqft" in refused(text.replace("metrics/aero-rp-x-in", "metrics/Sw-sqft"))


@pytest.mark.parametrize(
    ("text", "output"),
    [
        (axes("X") + axes(("LIFT",)), "do not belong to one system"),
        (axes("X", "WIND") + axes("Z", "BODY"), "different frames"),
        (axes(("ROLL",), "WIND") + axes(("PITCH",)), "moments have one frame"),
        (axes("X") + axes("X").replace("f/X", "f/Y"), "occurs twice"),
        (
            "<axis name='ROLL'><function name='f' apply_at_cg='true'><v>1</v></function></axis>",
            "apply_at_cg",
        ),
        ("<function name='f' type='template'><v>1</v></function>", "allowed are pre and post"),
        (
            "<axis name='X'><function name='f'><p>position/vrp-radius-ft</p></function></axis>",
            "vrp-radius-ft",
        ),
    ],
)
def test_aerodynamics_refusals_name_the_line(text, output):
    result = refused(body(text))
    assert output in result
    assert "point.xml:7: " in result
