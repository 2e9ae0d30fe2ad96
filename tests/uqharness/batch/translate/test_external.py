"""``<external_reactions>`` flown by JSBSim and by its translation."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import START, aircraft, compared, refused, worst
from tests.helpers.few import few

RECORDS = (
    *(f"forces/fb{a}-{k}-lbs" for k in ("external", "total") for a in "xyz"),
    *(f"moments/{a}-{k}-lbsft" for k in ("external", "total") for a in "lmn"),
    "accelerations/udot-ft_sec2",
    "aero/alpha-rad",
)
LOCATION = "<location unit='FT'><x>.5</x><y>-.25</y><z>1</z></location>"
DIRECTION = "<direction><x>1</x><y>2</y><z>-3</z></direction>"


def force(
    frame,
    function="<function name='f/one'><product><p>i/a</p><v>2</v></product></function>",
    name="one",
):
    given = f' frame="{frame}"' if frame is not None else ""
    return f'<force name="{name}"{given}>{function}{LOCATION}{DIRECTION}</force>'


def moment(frame, function="<function><product><p>i/a</p><v>.5</v></product></function>"):
    return f'<moment name="turn" frame="{frame}">{function}{DIRECTION}</moment>'


def body(text):
    declared = "<property value='3'>i/a</property><property>i/b</property>"
    return aircraft(
        "<system"
        f" name='s'>{declared}</system><external_reactions>{text}</external_reactions><aerodynamics/>"
    )


def inputs(*names, frames=20):
    rng = np.random.default_rng(1)
    return {name: rng.normal(size=frames + 1) * 5.0 for name in names}


def differences(text, fed=("i/a",), changed=None):
    return compared(
        body(text),
        RECORDS,
        inputs(*fed),
        20,
        START,
        changed=None if changed is None else body(changed),
    )


@pytest.mark.parametrize("frame", ["BODY", "LOCAL", "WIND", "INERTIAL", None])
def test_frames_of_a_force(frame):
    assert worst(differences(force(frame))) < 1e-11


@pytest.mark.parametrize("frame", ["BODY", "LOCAL", "WIND", "INERTIAL"])
def test_frames_of_a_moment(frame):
    assert worst(differences(moment(frame) + force("BODY"))) < 1e-11


@pytest.mark.parametrize(
    ("frame", "other"),
    few([("BODY", "WIND"), ("LOCAL", "INERTIAL"), ("WIND", "LOCAL"), ("INERTIAL", "BODY")], 2),
)
def test_another_frame_is_noticed(frame, other):
    assert worst(differences(force(frame), changed=force(other))) > 1e-3
    assert worst(differences(moment(frame), changed=moment(other))) > 1e-3


def test_place_and_direction_a_little_off_are_noticed():
    assert (
        worst(differences(force("BODY"), changed=force("BODY").replace("<z>1<", "<z>1.000001<")))
        > 1e-9
    )
    assert (
        worst(differences(force("BODY"), changed=force("BODY").replace("<y>2<", "<y>2.000001<")))
        > 1e-9
    )


def test_a_magnitude_without_function():
    """The host or a system sets it."""
    name = "external_reactions/one/magnitude"
    assert worst(differences(force("BODY", ""), (name,))) < 1e-11
    assert (
        worst(differences(moment("WIND", ""), ("external_reactions/turn/magnitude-lbsft",))) < 1e-11
    )
    made = f"<function name='{name}'><product><p>i/a</p><p>i/a</p></product></function>"
    assert worst(differences(made + force("LOCAL", ""))) < 1e-11


def test_direction_and_place_may_change_in_flight():
    """The direction is taken as it stands, of whatever length."""
    names = [
        f"external_reactions/one/{n}" for n in ("x", "y", "z", "location-x-in", "location-z-in")
    ]
    assert worst(differences(force("LOCAL"), ("i/a", *names))) < 1e-11
    turned = "".join(
        f"<function name='external_reactions/turn/{n}'><p>i/{i}</p></function>"
        for n, i in (("l", "a"), ("n", "b"))
    )
    assert worst(differences(turned + moment("BODY"), ("i/a", "i/b"))) < 1e-11


def test_several_and_functions_before_them():
    function = (
        "<function name='e/size'><product><p>aero/qbar-psf</p><p>i/a</p></product></function>"
    )
    text = (
        force("WIND", "<function name='f/two'><p>e/size</p></function>", "two")
        + function
        + force("BODY")
        + moment("LOCAL")
    )
    assert worst(differences(text)) < 1e-11


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (force("body"), "frame 'body'"),
        (force(" WIND"), "frame ' WIND'"),
        (
            force(
                "BODY",
                "<function name='a'><v>1</v></function><function name='b'><v>1</v></function>",
            ),
            "at most one",
        ),
        (force("BODY").replace("<direction>", "<heading/><direction>"), "at most one"),
        (
            moment("BODY").replace(
                "<direction>", "<location><x>0</x><y>0</y><z>0</z></location><direction>"
            ),
            "at most one",
        ),
        (
            force("BODY", "<function name='f'><p>position/vrp-radius-ft</p></function>"),
            "vrp-radius-ft",
        ),
    ],
)
def test_refused_with_line(text, said):
    found = refused(body(text))
    assert said in found
    assert "point.xml:7: " in found


def test_buoyancy_is_refused():
    found = refused(aircraft("<buoyant_forces/><aerodynamics/>"))
    assert "<buoyant_forces> is not understood" in found
