"""Components of JSBSim's flight control against JSBSim, bit for bit, and refusals of each."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_systems import (
    by_jsbsim,
    compared,
    document_of,
    judged,
    random_inputs,
    refusal,
    run,
    traced,
    values_of,
)
from uqharness.batch.translate.channels import System
from uqharness.batch.translate.components import own_name

A = "<input>i/a</input>"


def table(text: str) -> dict[str, str]:
    """Sections of a text, each below a line that begins with ``# ``."""
    parts = (part.partition("\n") for part in text.strip().removeprefix("# ").split("\n# "))
    return {name: body for name, _, body in parts}


CASES = table("""
# gain
<pure_gain name="g"><input>i/a</input><gain>@1.7</gain></pure_gain>
# gain clipped by a property
<pure_gain name="g"><input>i/a</input><gain>@1.7</gain><clipto><min>-1</min><max>i/b</max>
</clipto></pure_gain>
# gain by a property, cyclic
<pure_gain name="G x"><input>-i/a</input><gain>-i/b</gain><clipto type="cyclic"><min>@-1.1</min>
<max>1.3</max></clipto><output>o/x</output></pure_gain>
# clipped at one end, which JSBSim ignores
<summer name="g"><input>i/a</input><bias>@.2</bias><clipto><max>.1</max></clipto></summer>
# clipped twice at one end, of which JSBSim takes the first
<summer name="g"><input>i/a</input><clipto><min>-1</min><max>@.1</max><max>.3</max></clipto></summer>
# cyclic between equals
<pure_gain name="g"><input>i/a</input><gain>1</gain><clipto type="cyclic"><min>@0.4</min><max>@0.4</max>
</clipto></pure_gain>
# sum
<summer name="s/s"><input>i/a</input><input>-i/b</input><input>i/c</input><bias>@0.3</bias>
</summer>
# sum of nothing
<summer name="s"><bias>@0.3</bias></summer>
# dead band
<deadband name="d"><input>i/a</input><width>@1.1</width><gain>3</gain></deadband>
# dead band of a property
<deadband name="d"><input>i/a</input><width>i/b</width><gain>@1.3</gain></deadband>
# scale
<aerosurface_scale name="d"><input>i/a</input><range><min>-.35</min><max>@.3</max></range>
<gain>i/b</gain></aerosurface_scale>
# scale of a domain
<aerosurface_scale name="d"><input>i/a</input><domain><min>-2</min><max>@1.7</max></domain><range>
<min>-20</min><max>10</max></range></aerosurface_scale>
# linear scale
<aerosurface_scale name="d"><input>i/a</input><domain><min>-2</min><max>1.7</max></domain><range>
<min>@-20</min><max>10</max></range><zero_centered>false</zero_centered></aerosurface_scale>
# scheduled
<scheduled_gain name="g"><input>i/a</input><gain>@1.1</gain><table><independentVar>i/b</independentVar>
<tableData>-1 2
0 3.5
1.5 -1
</tableData></table></scheduled_gain>
# function times input
<fcs_function name="f"><function><sum><p>i/b</p><v>@2</v></sum></function><input>i/a</input>
</fcs_function>
# init is ignored
<pure_gain name="g"><input>i/a</input><gain>@1.7</gain><init>i/b</init><delay>0.1</delay>
</pure_gain>
# lag
<lag_filter name="l"><input>i/a</input><c1>@7</c1></lag_filter>
# lag, every third frame | execrate="3"
<lag_filter name="l"><input>i/a</input><c1>@7</c1></lag_filter>
# lag, switched | execute="i/on"
<lag_filter name="l"><input>i/a</input><c1>@7</c1></lag_filter>
# lag, switched, every third frame | execute="i/on" execrate="3"
<lag_filter name="l"><input>i/a</input><c1>@7</c1></lag_filter>
# lag of a property, clipped
<lag_filter name="l"><input>i/a</input><c1>i/b</c1><clipto><min>-.1</min><max>@.11</max></clipto>
</lag_filter>
# lag, so fast that it rings
<lag_filter name="l"><input>i/a</input><c1>@900</c1></lag_filter>
# lead and lag
<lead_lag_filter name="l"><input>i/a</input><c1>7</c1><c2>@3</c2><c3>.2</c3><c4>11</c4>
</lead_lag_filter>
# lead and lag of properties | execrate="2"
<lead_lag_filter name="l"><input>i/a</input><c1>-i/b</c1><c2>@3</c2><c3>2</c3><c4>i/on</c4>
</lead_lag_filter>
# second order
<second_order_filter name="l"><input>i/a</input><c1>7</c1><c2>3</c2><c3>.2</c3><c4>1.1</c4><c5>@2</c5>
<c6>31</c6></second_order_filter>
# second order, switched | execute="i/on"
<second_order_filter name="l"><input>i/a</input><c1>i/b</c1><c2>3</c2><c3>.2</c3><c4>1</c4><c5>2</c5>
<c6>@31</c6></second_order_filter>
# wash-out
<washout_filter name="l"><input>i/a</input><c1>@3</c1></washout_filter>
# wash-out of a step
<washout_filter name="l"><input>-i/step</input><c1>@3</c1></washout_filter>
# no integral | execrate="3"
<pid name="l"><input>i/a</input><kp>@1.1</kp><kd>.01</kd></pid>
# slope from a property
<pid name="l"><input>i/a</input><kp>1.1</kp><ki>i/b</ki><kd>@.3</kd><pvdot>-i/c</pvdot></pid>
# standard of properties
<pid name="x/l" type="standard"><input>i/a</input><kp>i/b</kp><ki>@.2</ki></pid>
# integrator | execute="i/on" execrate="2"
<integrator name="l"><input>i/a</input><c1>@.7</c1></integrator>
# integrator, rectangular
<integrator name="l"><input>i/a</input><c1 type="rect">@.7</c1><clipto><min>-.1</min><max>i/b</max>
</clipto></integrator>
# integrator of a property
<integrator name="l"><input>i/a</input><c1>i/b</c1><trigger>i/c</trigger><kp>@.2</kp></integrator>
# tests in order
<switch name="s"><default value="i/b"/><test logic="AND" value="-i/c">i/a gt @0.1
 i/b LE i/c</test><test logic="OR" value="@-3.5">i/a == 0
 i/c &lt; 0 <test logic="AND">i/b ge 0
 i/on NE 0</test></test></switch>
# no default
<switch name="s"><test value="@1.5">-i/a > i/b</test></switch>
# its own value
<switch name="s"><default value="fcs/s"/><test value="@1.5">i/a > 2</test>
<test value="i/b">i/a lt -2</test></switch>
# every word and sign
<switch name="s"><default value="@0.1"/><test value="0.5">i/on EQ 0
 i/a GT i/b
 i/c ge 2.0</test><test value="1.5">i/on == 1
 i/a ge i/b
 i/c ge 1.8</test><test value="2.5">i/on NE 0
 i/a LT i/b
 i/c ge 1.6</test><test value="3.5">i/on != 1
 i/a &lt;= i/b
 i/c ge 1.4</test><test value="4.5">i/on eq 0
 i/a >= i/b
 i/c ge 1.2</test><test value="5.5">i/on ne 1
 i/a LE i/b
 i/c ge 1.0</test></switch>
# delay and clip
<switch name="s"><default value="@1.5"/><test value="i/c">i/a gt 0.1</test><delay type="frames">6</delay>
<clipto><min>-1</min><max>2</max></clipto></switch>
# delay in seconds
<switch name="s"><default value="@1.5"/><test value="i/c">i/a gt 0.1</test><delay type="time">.07</delay>
</switch>
# exclusive
<distributor name="d" type="exclusive"><case><test>i/a gt 1</test><property value="i/b">o/p</property>
<property value="@2">o/q</property></case><case><test>i/a gt 0</test><property value="-i/c">o/p</property>
</case><case><property value="i/a">o/r</property></case></distributor>
# inclusive
<distributor type="inclusive"><case><test>i/a gt 1</test><property value="i/b">o/p</property>
<property value="@2">o/q</property></case><case><test logic="OR">i/a gt 0
 i/b gt 0</test><property value="o/p">o/r</property><property value="-i/c">o/p</property></case>
</distributor>
# kinematic: two settings
<kinematic name="k"><input>i/a</input><traverse><setting><position>0</position><time>0</time>
</setting><setting><position>@1.3</position><time>1.1</time></setting></traverse></kinematic>
# kinematic: five settings, several a frame
<kinematic name="k"><input>i/a</input><traverse><setting><position>-2</position><time>0</time>
</setting><setting><position>-.1</position><time>@.05</time></setting><setting><position>1</position>
<time>.01</time></setting><setting><position>1.3</position><time>.0005</time></setting><setting>
<position>4</position><time>.004</time></setting></traverse><noscale/></kinematic>
# kinematic: a jump among them
<kinematic name="k"><input>-i/a</input><traverse><setting><position>-2</position><time>0</time>
</setting><setting><position>-.1</position><time>0</time></setting><setting><position>1</position>
<time>@.1</time></setting><setting><position>3</position><time>0</time></setting></traverse>
<noscale/></kinematic>
# kinematic: steps | execrate="3"
<kinematic name="k"><input>i/step</input><traverse><setting><position>-3</position><time>0</time>
</setting><setting><position>0</position><time>@1</time></setting><setting><position>3</position>
<time>2</time></setting></traverse><noscale/></kinematic>
# kinematic: switched, clipped | execute="i/on"
<kinematic name="k"><input>i/step</input><traverse><setting><position>0</position><time>0</time>
</setting><setting><position>1</position><time>@.5</time></setting></traverse><clipto><min>.2</min>
<max>.7</max></clipto></kinematic>
# kinematic: a tied output
<kinematic name="k"><input>i/step</input><traverse><setting><position>0</position><time>0</time>
</setting><setting><position>10</position><time>1</time></setting><setting><position>30</position>
<time>@2</time></setting></traverse><output>fcs/flap-pos-deg</output></kinematic>
# kinematic: a setting twice
<kinematic name="k"><input>-i/step</input><traverse><setting><position>0</position><time>0</time>
</setting><setting><position>0</position><time>1</time></setting><setting><position>5</position>
<time>@2</time></setting><setting><position>5</position><time>1</time></setting><setting>
<position>6</position><time>.3</time></setting></traverse><noscale/></kinematic>
# kinematic: from above
<kinematic name="k"><input>i/step</input><traverse><setting><position>0</position><time>0</time>
</setting><setting><position>1</position><time>@5</time></setting></traverse>
<output>gear/gear-pos-norm</output></kinematic>
# kinematic: from below
<kinematic name="k"><input>i/step</input><traverse><setting><position>1</position><time>0</time>
</setting><setting><position>2</position><time>@.3</time></setting></traverse><noscale/>
</kinematic>
# actuator: plain
<actuator name="a"><input>i/a</input><bias>@0.1</bias></actuator>
# actuator: all of it
<actuator name="a"><input>i/a</input><lag>20</lag><rate_limit>30</rate_limit><bias>@.1</bias>
<hysteresis_width>.2</hysteresis_width><deadband_width>.3</deadband_width><clipto><min>-.5</min>
<max>.4</max></clipto><delay>.05</delay></actuator>
# actuator: lag
<actuator name="a"><input>i/a</input><lag>@20</lag></actuator>
# actuator: lag of a property | execrate="2"
<actuator name="a"><input>i/a</input><lag>i/b</lag><bias>@.1</bias></actuator>
# actuator: rate limit
<actuator name="a"><input>-i/step</input><rate_limit>@1.5</rate_limit></actuator>
# actuator: rate limits of both senses
<actuator name="a"><input>-i/step</input><rate_limit sense="incr">@1.5</rate_limit>
<rate_limit sense="decr">i/c</rate_limit></actuator>
# actuator: one sense alone
<actuator name="a"><input>-i/step</input><rate_limit sense="decrement">@1.5</rate_limit>
</actuator>
# actuator: dead band
<actuator name="a"><input>i/a</input><deadband_width>@.7</deadband_width></actuator>
# actuator: hysteresis
<actuator name="a"><input>-i/step</input><lag>3</lag><hysteresis_width>@.7</hysteresis_width>
</actuator>
# actuator: saturated
<actuator name="a"><input>i/a</input><clipto><min>0</min><max>@1.1</max></clipto></actuator>
# actuator: saturated by properties
<actuator name="a"><input>i/a</input><bias>@.3</bias><clipto><min>-i/b</min><max>i/b</max>
</clipto></actuator>
# actuator: switched | execute="i/on"
<actuator name="a"><input>i/a</input><lag>@20</lag><rate_limit>30</rate_limit><hysteresis_width>.2</hysteresis_width>
<delay>.03</delay></actuator>
# actuator: switched, every third frame | execute="i/on" execrate="3"
<actuator name="a"><input>i/a</input><lag>@20</lag><rate_limit>30</rate_limit>
<delay type="frames">3</delay></actuator>
# linear actuator: all of it
<linear_actuator name="l"><input>i/a</input><module>@2</module><hysteresis>.3</hysteresis><rate>.4</rate>
<lag>12</lag><set>i/on</set><gain>2</gain><bias>i/b</bias></linear_actuator>
# linear actuator: versus a property
<linear_actuator name="l"><input>i/a</input><versus>i/c</versus><module>@3</module>
</linear_actuator>
# linear actuator: versus a number
<linear_actuator name="l"><input>i/a</input><versus>-1.7</versus><reset>i/b</reset><gain>@1.1</gain>
</linear_actuator>
# linear actuator: replaced numbers
<linear_actuator name="l"><input>i/a</input><module>-2</module><hysteresis>-1</hysteresis><lag>-1</lag>
<rate>2</rate><gain>@1.1</gain></linear_actuator>
# linear actuator: a slow ramp
<linear_actuator name="l"><input>i/ramp</input><module>@1</module><rate>.9</rate><hysteresis>.05</hysteresis>
<versus>1</versus></linear_actuator>
# sensor: plain
<sensor name="s"><input>i/a</input><gain>@1.3</gain></sensor>
# sensor: all but noise
<sensor name="s"><input>i/a</input><lag>9</lag><drift_rate>.1</drift_rate><gain>1.3</gain><bias>.2</bias>
<delay>.04</delay><quantization name="steps"><bits>5</bits><min>-2</min><max>@2.1</max>
</quantization></sensor>
# sensor: quantized and clipped
<sensor name="s"><input>i/a</input><quantization name="steps"><bits>5</bits><min>-2</min><max>@2.1</max>
</quantization><clipto><min>-1</min><max>1.1</max></clipto></sensor>
# sensor: drift | execrate="3"
<sensor name="s"><input>i/a</input><drift_rate>@.1</drift_rate></sensor>
# sensor: switched | execute="i/on"
<sensor name="s"><input>i/a</input><lag>@9</lag><drift_rate>.1</drift_rate><delay>.04</delay>
</sensor>
""")
"""Name, and attributes of the channel, to components; ``@`` stands before a number that is moved for
the negative control.
"""

PID = (
    "<kp>1.1</kp>{ki}<kd>i/c</kd><trigger>{on}</trigger><clipto><min>-3</min><max>3</max></clipto>"
)
CASES |= {
    f"{kind}, {rule}, trigger {on}": (
        f'<pid name="l" type="{kind}">{A}'
        + PID.format(ki=f'<ki type="{rule}">@.7</ki>', on=on)
        + "</pid>"
    )
    for kind in ("standard", "ideal")
    for rule in ("rect", "trap", "ab2", "ab3")
    for on in ("i/on", "-i/on")
}
FRAMES = 1500


def check_bits(body: str, inputs: dict[str, np.ndarray]) -> None:
    """All bits are JSBSim's, and not after the number behind ``@`` has moved by 1e-12 of itself."""
    difference, control = judged(body, inputs)
    assert difference == {}
    assert control != {}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    outputs = "".join(f"<property>o/{name}</property>" for name in "pqr")
    attributes = name.partition(" | ")[2]
    inputs = random_inputs(FRAMES)
    inputs["i/ramp"] = np.mod(np.cumsum(np.random.default_rng(2).normal(0.01, 0.03, FRAMES)), 1.0)
    check_bits(f"{outputs}<channel {attributes}>{CASES[name]}</channel>", inputs)


@pytest.mark.parametrize(
    ("name", "prefix", "failures"),
    [
        *(
            (name, "a", options)
            for name in ("all of it", "switched", "saturated")
            for options in ("zero", "hardover", "zero hardover stuck")
        ),
        *(("all but noise", "s", options) for options in ("low", "high", "low high stuck")),
    ],
)
def test_failures_come_and_go(name: str, prefix: str, failures: str) -> None:
    kind = {"a": "actuator", "s": "sensor"}[prefix]
    key = next(key for key in CASES if key.split(" | ")[0] == f"{kind}: {name}")
    inputs = random_inputs(FRAMES)
    rng = np.random.default_rng(3)
    for options in failures.split():
        failed = np.repeat((rng.random(FRAMES // 5) > 0.7).astype(float), 5)
        inputs[f"fcs/{prefix}/malfunction/fail_{options}"] = failed
    check_bits(f"<channel {key.partition(' | ')[2]}>{CASES[key]}</channel>", inputs)


@pytest.mark.parametrize(
    "attributes", ['execute="i/on"', 'execrate="3" execute="i/on"', 'execrate="2"']
)
def test_a_delay_line_moves_when_its_channel_runs(attributes: str) -> None:
    body = CASES["delay and clip"]
    check_bits(f"<channel {attributes}>{body}</channel>", random_inputs(FRAMES))


REFUSALS = table("""
# a <pure_gain> has <gain>
<pure_gain name="g"><input>i/a</input></pure_gain>
# has 1 <input>; received 0
<pure_gain name="g"><gain>1</gain></pure_gain>
# attribute 'type'
<pure_gain name="g" type="x"><input>i/a</input><gain>1</gain></pure_gain>
# allowed is cyclic
<pure_gain name="g"><input>i/a</input><gain>1</gain><clipto type="x"><min>1</min><max>2</max>
</clipto></pure_gain>
# property nothing is not computed
<pure_gain name="g"><input>i/a</input><gain>nothing</gain></pure_gain>
# cannot be written
<pure_gain name="g"><input>i/a</input><gain>1</gain><output>fcs/mag-rudder-pos-rad</output>
</pure_gain>
# must be the name of a property; received 'fcs/a+b'
<pure_gain name="a+b"><input>i/a</input><gain>1</gain></pure_gain>
# unit='X'
<angle name="f" unit="X"><source_angle>i/a</source_angle><target_angle>i/a</target_angle></angle>
# allowed are ideal, parallel and standard
<pid name="l" type="x"><input>i/a</input><kp>1</kp></pid>
# allowed are rect, trap, ab2, ab3
<pid name="l"><input>i/a</input><ki type="x">1</ki></pid>
# cannot be written by <pid>
<pid name="l"><input>i/a</input><kp>1</kp><output>fcs/l/initial-integrator-value</output></pid>
# allowed are inclusive and exclusive
<distributor name="d"><case/></distributor>
# o/none does not exist
<distributor type="exclusive"><case><property value="1">o/none</property></case></distributor>
# allowed are time and frames
<switch name="s"><default value="1"/><delay type="x">1</delay></switch>
# 0 to 1000 frames
<switch name="s"><default value="1"/><delay>99</delay></switch>
# positions of a <traverse> do not decrease, two or more
<kinematic name="k"><input>i/a</input><traverse><setting><position>0</position><time>0</time>
</setting></traverse></kinematic>
# cannot be written by <pure_gain>
<pure_gain name="fcs/a/saturated"><input>i/a</input><gain>1</gain></pure_gain>
# cannot be written
<pure_gain name="fcs/a/malfunction/fail_zero"><input>i/a</input><gain>1</gain></pure_gain>
# 1 to 30 bits
<sensor name="s"><input>i/a</input><quantization><bits>40</bits><min>0</min><max>1</max>
</quantization></sensor>
# allowed are AND and OR
<switch name="s"><test value="1" logic="and">i/a gt 1</test></switch>
# a comparison is 'property sign value'
<switch name="s"><test value="1">i/a =&gt; 1</test></switch>
# must be the name of a property; received '1'
<switch name="s"><test value="1">1 gt i/a</test></switch>
# must be a finite decimal number; received '1e400'
<switch name="s"><test value="1">i/a gt 1e400</test></switch>
# a <lead_lag_filter> has <c4>; it has none
<lead_lag_filter name="l"><input>i/a</input><c1>7</c1><c2>3</c2><c3>2</c3></lead_lag_filter>
""")
"""Part of the message to the component that is refused."""


@pytest.mark.parametrize("message", REFUSALS)
def test_refusals_have_file_and_line(message: str) -> None:
    output = refusal(f"<channel>{REFUSALS[message]}</channel>")
    assert message in output
    assert output.startswith("system.xml:")


@pytest.mark.parametrize("name", ["Gain", "A Gain", "o/A-Gain", "x.y", "two  blanks", "Trailing_"])
def test_the_property_of_a_name_is_jsbsims(name: str) -> None:
    gain = f'<pure_gain name="{name}"><input>i/a</input><gain>2</gain></pure_gain>'
    fdm = oracle.load(f'<property value="3">i/a</property><channel>{gain}</channel>')
    assert fdm[own_name(name)] == 6.0


def test_a_component_without_a_name_has_its_outputs() -> None:
    body = "<summer><input>i/a</input><bias>@2</bias><output>o/one</output><output>o/two</output><description/></summer>"
    ends = "<range><documentation>x</documentation><min>-2</min><max>@3</max></range>"
    scale = f"<aerosurface_scale><description>x</description><input>i/b</input>{ends}"
    difference, control = judged(
        f"<channel>{body}{scale}<output>o/three</output></aerosurface_scale></channel>",
        random_inputs(200),
    )
    assert difference == {}
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
    difference, control = judged(body, random_inputs(300))
    assert difference == {}
    assert set(control) == {"/host/x", "/host/y", "fcs/s"}


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
        difference = np.abs(pair.theirs[name] - pair.ours[name]) / scale
        assert np.max(difference * np.abs(np.sin(pair.theirs[name] / scale))) < 1e-15
        assert len(np.unique(np.sign(pair.theirs[name]))) > 1
    changed = compared(
        f"<channel>{body}</channel>", inputs, f"<channel>{body.replace('DEG', 'RAD')}</channel>"
    )
    assert np.max(np.abs(changed.theirs["fcs/y"] - changed.ours["fcs/y"])) > 1.0


def _settings(*pairs: tuple[str, str]) -> str:
    rows = "".join(f"<setting><position>{p}</position><time>{t}</time></setting>" for p, t in pairs)
    return f"<traverse>{rows}</traverse>"


def test_a_position_above_the_last_setting_is_nan_on_the_way_down() -> None:
    inputs = {"i/a": np.zeros(3)}
    body = (
        '<property value="5">o/k</property><channel><kinematic'
        f' name="o/k"><input>i/a</input>{_settings(("0", "0"), ("1", "1"))}'
    )
    pair = compared(f"{body}</kinematic></channel>", inputs)
    assert np.isnan(pair.ours["o/k"]).all()


def _noisy(inputs: tuple[str, str], noise: tuple[str, str], drawing: str) -> str:
    first, second = (
        f'<sensor name="{name}"><input>{x}</input><noise variation="{kind}"'
        f' distribution="GAUSSIAN">{size}</noise></sensor>'
        for name, x, kind, size in zip(
            "pq", inputs, noise, ("1", "1") if drawing else ("0.3", "2"), strict=True
        )
    )
    return (
        f'<function name="o/r"><random/></function><channel>{first}</channel><channel'
        f' execrate="2">{second}</channel>'
    )


def test_noise_is_jsbsims_for_jsbsims_draws() -> None:
    inputs = random_inputs(1200)
    inputs["i/zero"] = np.zeros(1200)
    # The bare draws: sensors of nothing with a noise of 1.
    plain = _noisy(("i/zero", "i/zero"), ("ABSOLUTE", "ABSOLUTE"), "bare")
    raw = compared(plain, inputs, draws=np.zeros(9000)).theirs
    draws = [0.0, 0.0, 0.0]
    for k in range(1200):
        draws += [raw["o/r"][k], raw["fcs/p"][k]] + ([raw["fcs/q"][k]] if k % 2 == 0 else [])
    body = _noisy(("i/a", "-i/b"), ("PERCENT", "ABSOLUTE"), "")
    pair = compared(body, inputs, draws=np.array(draws))
    assert pair.apart() == {}
    assert (
        compared(body, inputs, body.replace("0.3<", "0.3000000000003<"), np.array(draws)).apart()
        != {}
    )


FORCE = """<ground_reactions/>
<external_reactions><force name="push" frame="BODY"><location unit="IN"><x>3</x><y>-2</y><z>5</z></location>
<direction><x>1</x><y>0.3</y><z>-0.2</z></direction></force></external_reactions>"""


SENSED = """<channel><gyro name="g"><axis>{axis}</axis>
<orientation unit="DEG"><roll>10</roll><pitch>-30</pitch><yaw>70</yaw></orientation>
<bias>{bias}</bias></gyro><gyro name="h"><axis>{axis}</axis></gyro>
<accelerometer name="a"><axis>{axis}</axis><location unit="IN"><x>12</x><y>7</y><z>-4</z></location>
<orientation unit="RAD"><x>.1</x><z>.7</z></orientation></accelerometer>
<accelerometer name="b"><axis>{axis}</axis><location unit="FT"><x>1</x><z>{bias}</z></location></accelerometer></channel>"""


NOW = [f"velocities/{axis}i-rad_sec" for axis in "pqr"]


BEFORE = [f"forces/fb{axis}-total-lbs" for axis in "xyz"] + [
    f"accelerations/{axis}idot-rad_sec2" for axis in "pqr"
]


HELD = ["inertia/mass-slugs", *(f"inertia/cg-{axis}-in" for axis in "xyz")]


MADE = ["fcs/g", "fcs/h", "fcs/a", "fcs/b"]


@pytest.mark.parametrize("axis", "XyZ")
def test_gyros_and_accelerometers_of_a_tumbling_body(axis: str) -> None:
    body = SENSED.replace("{axis}", axis)
    text = oracle.model(body.replace("{bias}", "0.25")).replace("<ground_reactions/>", FORCE)
    fdm = oracle.loaded(
        text.replace(
            "<x>0</x><y>0</y><z>0</z></location></mass", "<x>2</x><y>1</y><z>0</z></location></mass"
        ),
        0.01,
    )
    for name, value in zip("pqr", (0.3, -0.7, 1.1), strict=True):
        fdm[f"ic/{name}-rad_sec"] = value
    values = values_of(fdm)
    push = {"external_reactions/push/magnitude": 5.0 * np.random.default_rng(1).normal(size=1000)}
    for name in (*NOW, *BEFORE, *MADE):
        values.setdefault(name)
    series = by_jsbsim(fdm, push, [*NOW, *BEFORE, *MADE, *HELD])
    # JSBSim computes the centre of gravity in its first frame.
    values.update({name: float(series[name][-1]) for name in HELD})
    # What a system sees: rates of this frame, forces and accelerations of the frame before.
    observed = {name: series[name] for name in NOW}
    observed |= {name: np.concatenate([series[name][:1], series[name][:-1]]) for name in BEFORE}
    worst = {}
    for bias in ("0.25", "0.250000000001"):
        document = document_of(body.replace("{bias}", bias))
        ours = run(
            traced([System(document, document.root)], values, list(observed)), observed, MADE
        )
        worst[bias] = max(
            np.max(np.abs(ours[n] - series[n])[2:]) / np.max(np.abs(series[n])) for n in MADE
        )
    assert np.min([np.ptp(series[name]) for name in MADE]) > 0.01
    assert worst["0.25"] < 4e-16
    assert worst["0.250000000001"] > 1e-14


@pytest.mark.parametrize("attributes", ['execute="i/a"', 'execute="i/a" execrate="2"'])
def test_noise_that_lanes_draw_at_different_times_is_refused(attributes: str) -> None:
    body = (
        f'<sensor name="s">{A}<noise variation="PERCENT" distribution="GAUSSIAN">1</noise></sensor>'
    )
    assert "has no stream" in refusal(f"<channel {attributes}>{body}</channel>")


def _body(kind: str, unit: str, degrees: bool = False) -> str:
    angle = ' unit="DEG"' if degrees else ""
    places = "".join(
        f"<{tag}{angle}>i/{name}</{tag}>"
        for tag, name in (
            ("target_latitude", "a"),
            ("target_longitude", "b"),
            ("source_latitude", "c"),
            ("source_longitude", "d"),
        )
    )
    return f'<waypoint_{kind} name="o/{kind}-{unit}" unit="{unit}">{places}</waypoint_{kind}>'


def _places(scale: float) -> dict[str, np.ndarray]:
    """Near and far targets in all quadrants, in units of ``scale`` per radian."""
    rng = np.random.default_rng(0)
    lat, lon = rng.uniform(-1.5, 1.5, 1500), rng.uniform(-3.1, 3.1, 1500)
    close = rng.random(1500) < 0.6
    to_lat = np.where(close, lat + rng.normal(0.0, 1e-3, 1500), rng.uniform(-1.4, 1.4, 1500))
    to_lon = lon + np.where(close, rng.normal(0.0, 1e-3, 1500), rng.uniform(-2.4, 2.4, 1500))
    places = {"i/a": to_lat, "i/b": to_lon, "i/c": lat, "i/d": lon}
    return {name: values * scale for name, values in places.items()}


def _gap(body: str, places: dict[str, np.ndarray], changed: str | None = None) -> float:
    pair = compared(
        f"<channel>{body}</channel>", places, changed and f"<channel>{changed}</channel>"
    )
    return max(
        float(np.max(np.abs(pair.ours[name] - present) / np.maximum(np.abs(present), 1e-3)))
        for name, present in pair.theirs.items()
    )


@pytest.mark.parametrize(("degrees", "scale"), [(False, 1.0), (True, 180.0 / np.pi)])
def test_headings_and_distances_are_jsbsims(degrees: bool, scale: float) -> None:
    body = "".join(
        _body(kind, unit, degrees)
        for kind, unit in (
            ("heading", "RAD"),
            ("heading", "DEG"),
            ("distance", "FT"),
            ("distance", "M"),
        )
    )
    assert _gap(body, _places(scale)) < 1e-8
