"""What components share: names of properties."""

from __future__ import annotations

import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_systems import judged, random_inputs, refusal
from uqharness.batch.translate.components import own_name


@pytest.mark.parametrize("name", ["Gain", "A Gain", "o/A-Gain", "x.y", "two  blanks", "Trailing_"])
def test_the_property_of_a_name_is_jsbsims(name: str) -> None:
    gain = f'<pure_gain name="{name}"><input>i/a</input><gain>2</gain></pure_gain>'
    fdm = oracle.load(f'<property value="3">i/a</property><channel>{gain}</channel>')
    assert fdm[own_name(name)] == 6.0


def test_two_components_of_one_name_keep_memories_of_their_own() -> None:
    one = '<lag_filter name="l"><input>i/a</input><c1>@3</c1></lag_filter>'
    two = '<lag_filter name="l"><input>i/b</input><c1>@9</c1></lag_filter>'
    for order in (one + two, two + one):
        apart, control = judged(f"<channel>{order}</channel>", random_inputs(500))
        assert apart == {}
        assert control != {}


def test_a_component_without_a_name_has_its_outputs() -> None:
    body = "<summer><input>i/a</input><bias>@2</bias><output>o/one</output><output>o/two</output><description/></summer>"
    ends = "<range><documentation>x</documentation><min>-2</min><max>@3</max></range>"
    scale = f"<aerosurface_scale><description>x</description><input>i/b</input>{ends}"
    apart, control = judged(
        f"<channel>{body}{scale}<output>o/three</output></aerosurface_scale></channel>",
        random_inputs(200),
    )
    assert apart == {}
    assert set(control) == {"o/one", "o/two", "o/three"}
    assert "a <summer> has a name or <output>" in refusal(
        "<channel><summer><input>i/a</input></summer></channel>"
    )
    assert "must be the name of a property; received 'fcs/'" in refusal(
        "<channel><actuator><input>i/a</input><output>o/x</output></actuator></channel>"
    )


def test_properties_of_the_host_begin_with_a_slash() -> None:
    body = (
        '<property value="2">/host/x</property><property'
        ' value="3">host/x</property><channel><summer'
        ' name="s"><input>-/host/x</input><input>i/a</input><input>host/x</input><output>/host/y</output></summer><lag_filter'
        ' name="/host/x"><input>/fdm/jsbsim/fcs/s</input><c1>@3</c1></lag_filter></channel>'
    )
    apart, control = judged(body, random_inputs(300))
    assert apart == {}
    assert set(control) == {"/host/x", "/host/y", "fcs/s"}
