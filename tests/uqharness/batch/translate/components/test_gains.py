"""Components without memory against JSBSim, bit for bit, 3,000 frames each."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_systems import compared, judged, random_inputs, refusal

A = "<input>i/a</input>"
CLIP = "<clipto><min>-1</min><max>i/b</max></clipto>"

EXACT = {
    "gain": f'<pure_gain name="g">{A}<gain>@1.7</gain></pure_gain>',
    "gain clipped by a property": f'<pure_gain name="g">{A}<gain>@1.7</gain>{CLIP}</pure_gain>',
    "gain by a property, cyclic": (
        '<pure_gain name="G x"><input>-i/a</input><gain>-i/b</gain><clipto type="cyclic">'
        "<min>@-1.1</min><max>1.3</max></clipto><output>o/x</output></pure_gain>"
    ),
    "cyclic between equals": (
        f'<pure_gain name="g">{A}<gain>1</gain><clipto'
        ' type="cyclic"><min>@0.4</min><max>@0.4</max></clipto></pure_gain>'
    ),
    "sum": (
        "<summer"
        ' name="s/s"><input>i/a</input><input>-i/b</input><input>i/c</input><bias>@0.3</bias></summer>'
    ),
    "sum of nothing": '<summer name="s"><bias>@0.3</bias></summer>',
    "dead band": f'<deadband name="d">{A}<width>@1.1</width><gain>3</gain></deadband>',
    "dead band of a property": (
        f'<deadband name="d">{A}<width>i/b</width><gain>@1.3</gain></deadband>'
    ),
    "scale": (
        "<aerosurface_scale"
        f' name="d">{A}<range><min>-.35</min><max>@.3</max></range><gain>i/b</gain></aerosurface_scale>'
    ),
    "scale of a domain": (
        f'<aerosurface_scale name="d">{A}<domain><min>-2</min><max>@1.7</max></domain>'
        "<range><min>-20</min><max>10</max></range></aerosurface_scale>"
    ),
    "linear scale": (
        f'<aerosurface_scale name="d">{A}<domain><min>-2</min><max>1.7</max></domain>'
        "<range><min>@-20</min><max>10</max></range><zero_centered>false</zero_centered></aerosurface_scale>"
    ),
    "scheduled": (
        "<scheduled_gain"
        f' name="g">{A}<gain>@1.1</gain><table><independentVar>i/b</independentVar><tableData>-1'
        " 2\n0 3.5\n1.5 -1\n</tableData></table></scheduled_gain>"
    ),
    "function times input": (
        "<fcs_function"
        f' name="f"><function><sum><p>i/b</p><v>@2</v></sum></function>{A}</fcs_function>'
    ),
    "init is ignored": (
        f'<pure_gain name="g">{A}<gain>@1.7</gain><init>i/b</init><delay>0.1</delay></pure_gain>'
    ),
}


@pytest.mark.parametrize("name", EXACT)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    apart, control = judged(f"<channel>{EXACT[name]}</channel>", random_inputs())
    assert apart == {}
    assert control != {}


def test_an_angle_agrees_to_rounding() -> None:
    inputs = {name: series * 3.0 for name, series in random_inputs().items()}
    body = "".join(
        f'<angle name="{name}" unit="{out}"><source_angle'
        f' unit="{one}">i/a</source_angle><target_angle>i/b</target_angle></angle>'
        for name, one, out in (("x", "RAD", "RAD"), ("y", "DEG", "DEG"))
    )
    pair = compared(f"<channel>{body}</channel>", inputs)
    # The angle between nearly equal directions is the arc cosine of nearly 1: an ulp of the cosine
    # is 1e-8 of the angle.
    for name, scale in (("fcs/x", 1.0), ("fcs/y", 57.3)):
        apart = np.abs(pair.theirs[name] - pair.ours[name]) / scale
        assert np.max(apart * np.abs(np.sin(pair.theirs[name] / scale))) < 1e-15
        assert len(np.unique(np.sign(pair.theirs[name]))) > 1
    changed = compared(
        f"<channel>{body}</channel>", inputs, f"<channel>{body.replace('DEG', 'RAD')}</channel>"
    )
    assert np.max(np.abs(changed.theirs["fcs/y"] - changed.ours["fcs/y"])) > 1.0


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (f'<pure_gain name="g">{A}</pure_gain>', "a <pure_gain> has <gain>"),
        ('<pure_gain name="g"><gain>1</gain></pure_gain>', "has 1 <input>; received 0"),
        (f'<pure_gain name="g">{A}{A}<gain>1</gain></pure_gain>', "has 1 <input>; received 2"),
        (f'<pure_gain name="g" type="x">{A}<gain>1</gain></pure_gain>', "attribute 'type'"),
        (
            f'<pure_gain name="g">{A}<gain>1</gain><clipto><min>1</min></clipto></pure_gain>',
            "one <min> and one <max>",
        ),
        (
            (
                f'<pure_gain name="g">{A}<gain>1</gain><clipto'
                ' type="x"><min>1</min><max>2</max></clipto></pure_gain>'
            ),
            "allowed is cyclic",
        ),
        (
            f'<pure_gain name="g">{A}<gain unit="x">1</gain></pure_gain>',
            "attribute 'unit' of <gain>",
        ),
        (
            f'<pure_gain name="g">{A}<gain>nothing</gain></pure_gain>',
            "property nothing is not computed",
        ),
        (
            (
                "<pure_gain"
                f' name="g">{A}<gain>1</gain><output>fcs/mag-rudder-pos-rad</output></pure_gain>'
            ),
            "cannot be written",
        ),
        (
            f'<pure_gain name="a+b">{A}<gain>1</gain></pure_gain>',
            "must be the name of a property; received 'fcs/a+b'",
        ),
        (f'<aerosurface_scale name="g">{A}</aerosurface_scale>', "has <range>"),
        (
            (
                '<angle name="f"'
                ' unit="X"><source_angle>i/a</source_angle><target_angle>i/a</target_angle></angle>'
            ),
            "unit='X'",
        ),
    ],
)
def test_refusals_have_file_and_line(body: str, message: str) -> None:
    said = refusal(f"<channel>{body}</channel>")
    assert message in said
    assert said.startswith("system.xml:1: ")
