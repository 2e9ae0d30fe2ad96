"""A frame in whole: order of the models, inputs, records, settings; external reactions."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import START, aircraft, compared, craft, refused, translated, worst
from tests.helpers.few import few
from uqharness.errors import BadInputError

LATE = (
    "aero/alpha-rad",
    "aero/qbar-psf",
    "velocities/vt-fps",
    "accelerations/Nz",
    "accelerations/udot-ft_sec2",
    "forces/fbz-total-lbs",
    "moments/m-total-lbsft",
    "velocities/vg-fps",
    "aero/h_b-mac-ft",
    "flight-path/gamma-rad",
    "external_reactions/push/magnitude",
)


NOW = (
    "velocities/u-fps",
    "attitude/theta-rad",
    "position/h-agl-ft",
    "velocities/q-rad_sec",
    "atmosphere/rho-slugs_ft3",
    "atmosphere/total-wind-north-fps",
    "simulation/sim-time-sec",
    "velocities/v-down-fps",
)


GAINS = "".join(
    f"<pure_gain name='seen/n{number}'><input>{name}</input><gain>1</gain></pure_gain>"
    for number, name in enumerate((*LATE, *NOW))
)


BODY = f"""<system name='s'><property value='3'>external_reactions/push/magnitude</property><property value='2'>i/size</property>
<channel name='c'>{GAINS}<summer name='s/size'><input>i/size</input><input>seen/n0</input></summer></channel></system>
<aerodynamics><axis name='Z'>
<function name='f/z'><product><p>aero/alpha-rad</p><p>aero/qbar-psf</p><v>-9</v></product></function></axis>
<axis name='PITCH'>
<function name='f/m'><product><p>external_reactions/push/magnitude</p><v>.1</v></product></function></axis></aerodynamics>
<external_reactions><force name='push' frame='BODY'><location unit='IN'><x>0</x><y>0</y><z>3</z></location>
<direction><x>1</x><y>0</y><z>0</z></direction></force></external_reactions>"""


RECORDS = (
    *(f"seen/n{number}" for number in range(len(LATE) + len(NOW))),
    "s/size",
    "velocities/u-fps",
)


INPUTS = {
    "atmosphere/wind-north-fps": np.linspace(0.0, 9.0, 21),
    "external_reactions/push/magnitude": np.sin(np.arange(21.0)) * 5.0,
}


def test_systems_see_what_jsbsims_see():
    """Motion and air of this frame, forces, incidence and accelerations of the frame before."""
    result = compared(aircraft(BODY), RECORDS, INPUTS, 20, START)
    assert worst(result) < 1e-10


def test_what_is_not_computed_cannot_be_recorded():
    with (
        craft(aircraft(BODY)) as result,
        pytest.raises(BadInputError, match="position/vrp-radius-ft is not computed"),
    ):
        translated(result, ["position/vrp-radius-ft"])


RECORDS_EXTERNAL = (
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
    arguments = f' frame="{frame}"' if frame is not None else ""
    return f'<force name="{name}"{arguments}>{function}{LOCATION}{DIRECTION}</force>'


def moment(frame, function="<function><product><p>i/a</p><v>.5</v></product></function>"):
    # JSBSim ignores the place of a moment.
    return f'<moment name="turn" frame="{frame}">{function}{LOCATION}{DIRECTION}</moment>'


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
        RECORDS_EXTERNAL,
        inputs(*fed),
        20,
        START,
        changed=None if changed is None else body(changed),
    )


FRAMES_OF_LOADS = ("BODY", "LOCAL", "WIND", "INERTIAL")


def test_frames_of_forces_and_moments():
    """A force and a moment in each frame, and a force that names none, in one flight."""

    def value(name):
        return f"<function name='f/{name}'><product><p>i/a</p><v>2</v></product></function>"

    loads = [force(frame, value(f"f-{frame}"), f"f-{frame}") for frame in (*FRAMES_OF_LOADS, None)]
    loads += [
        moment(frame, value(f"m-{frame}")).replace('name="turn"', f'name="m-{frame}"')
        for frame in FRAMES_OF_LOADS
    ]
    text = "".join(loads)
    assert worst(differences(text)) < 1e-11
    # One direction a little off is noticed.
    assert worst(differences(text, changed=text.replace("<y>2<", "<y>2.000001<", 1))) > 1e-9


@pytest.mark.parametrize(("frame", "other"), few([("BODY", "WIND"), ("INERTIAL", "LOCAL")], 1))
def test_another_frame_is_noticed(frame, other):
    assert worst(differences(force(frame), changed=force(other))) > 1e-3
    assert worst(differences(moment(frame), changed=moment(other))) > 1e-3


def test_a_magnitude_without_function():
    """The host or a system sets it."""
    name = "external_reactions/one/magnitude"
    assert worst(differences(force("BODY", ""), (name,))) < 1e-11
    assert (
        worst(differences(moment("WIND", ""), ("external_reactions/turn/magnitude-lbsft",))) < 1e-11
    )
    result = f"<function name='{name}'><product><p>i/a</p><p>i/a</p></product></function>"
    assert worst(differences(result + force("LOCAL", ""))) < 1e-11


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
    ("text", "output"),
    [
        (force("body"), "frame 'body'"),
        (
            force(
                "BODY",
                "<function name='a'><v>1</v></function><function name='b'><v>1</v></function>",
            ),
            "at most one",
        ),
        (
            force("BODY", "<function name='f'><p>position/vrp-radius-ft</p></function>"),
            "vrp-radius-ft",
        ),
    ],
)
def test_external_reaction_refusals_name_the_line(text, output):
    result = refused(body(text))
    assert output in result
    assert "point.xml:7: " in result


def test_buoyancy_is_refused():
    result = refused(aircraft("<buoyant_forces/><aerodynamics/>"))
    assert "<buoyant_forces> is not supported" in result
