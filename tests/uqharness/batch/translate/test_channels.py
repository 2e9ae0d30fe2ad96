"""Channels and functions of systems against JSBSim: order, rates, switches, the first frames; and
the project's aircraft.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_stock import flown_by_both
from tests.helpers.batch_systems import (
    by_jsbsim,
    compared,
    document_of,
    judged,
    random_inputs,
    refusal,
    run,
    same_bits,
    traced,
    values_of,
)
from uqharness.batch.translate.channels import System, read_sources
from uqharness.errors import BadInputError
from uqharness.simulator import engine, find_aircraft, find_script, staged
from uqharness.xml.document import parse_document

GAIN = '<pure_gain name="g"><input>i/a</input><gain>@2</gain></pure_gain>'
CASES = {
    "functions before and behind channels": (
        '<function name="o/before"><sum><p>fcs/g</p><p>o/behind</p></sum></function><function'
        ' type="post"'
        ' name="o/behind"><sum><p>fcs/g</p><p>i/a</p></sum></function><channel><pure_gain'
        ' name="g"><input>o/behind</input><gain>@0.3</gain></pure_gain></channel>'
    ),
    "a function that is read before it has been run": (
        '<function name="o/a"><sum><p>o/b</p><p>o/a-before</p></sum></function>'
        '<function name="o/b"><product><p>i/a</p><v>@1.1</v></product></function>'
        '<channel><integrator name="o/a-before"><input>o/c</input><c1>1</c1></integrator></channel>'
        '<function type="post" name="o/c"><sum><p>i/b</p><v>5</v></sum></function>'
    ),
    "copyto": (
        '<property>o/copy</property><function name="o/f"'
        ' copyto="o/copy"><sum><p>i/a</p><v>@3</v></sum></function><channel><pure_gain'
        ' name="g"><input>o/copy</input><gain>2</gain></pure_gain></channel>'
    ),
    "channels in order": (
        '<channel><pure_gain name="h"><input>fcs/g</input><gain>3</gain></pure_gain></channel>'
        f"<channel>{GAIN}</channel>"
        '<channel><pure_gain name="k"><input>fcs/g</input><gain>3</gain></pure_gain></channel>'
    ),
    "the last of one name counts": (
        f'<channel>{GAIN}<summer name="g"><input>fcs/g</input><input>i/b</input></summer></channel>'
    ),
    "the step of the channel": (
        '<function name="o/f"><p>simulation/channel-dt</p></function><channel'
        ' execrate="4"><fcs_function'
        ' name="g"><function><sum><p>simulation/channel-dt</p><v>@1</v></sum></function></fcs_function></channel><function'
        ' type="post" name="o/h"><p>simulation/channel-dt</p></function>'
    ),
    "rate 0": (
        '<channel execrate="0"><pid'
        ' name="g"><input>i/a</input><kp>@1</kp><ki>2</ki><pvdot>i/b</pvdot></pid></channel>'
    ),
    "never run": (
        f'<property value="0">o/off</property><channel execute="o/off">{GAIN}</channel>'
        '<channel><pure_gain name="k"><input>i/a</input><gain>@3</gain></pure_gain></channel>'
    ),
    "always run": (
        '<property value="-0.2">o/off</property><channel execute="o/off"'
        f' execrate="3">{GAIN}</channel>'
    ),
    "switched by itself": (
        '<property value="1">fcs/c</property><channel execute="fcs/c"><switch name="c"><default'
        ' value="1"/><test value="@1e-9">i/a gt 1</test></switch></channel><channel><switch'
        ' name="c"><default value="fcs/c"/><test value="0">i/b gt 1</test><test value="2">i/b lt'
        " -1</test></switch></channel>"
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    apart, control = judged(CASES[name], random_inputs())
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize("rate", [1, 2, 3, 7])
def test_a_switched_channel_counts_the_frames_in_which_it_is_on(rate: int) -> None:
    inputs = random_inputs()
    # Neither is it rounded nor does its sign count.
    inputs["i/on"] = inputs["i/on"] * np.random.default_rng(5).choice(
        [0.4, 0.6, -1.0, 1e-300], len(inputs["i/on"])
    )
    apart, control = judged(f'<channel execute="i/on" execrate="{rate}">{GAIN}</channel>', inputs)
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_channel_may_begin_in_flight(start: float) -> None:
    inputs = random_inputs(200)
    inputs["i/on"][:50] = start
    inputs["i/on"][50:] = 1.0
    lag = '<lag_filter name="l"><input>i/a</input><c1>@3</c1></lag_filter>'
    actuator = '<actuator name="a"><input>i/a</input><rate_limit>3</rate_limit></actuator>'
    apart, control = judged(
        f'<channel execute="i/on" execrate="3">{lag}{actuator}</channel>', inputs
    )
    assert apart == {}
    assert control != {}


def test_another_rate_is_noticed() -> None:
    inputs = random_inputs(200)
    body = (
        '<channel execrate="3"><pure_gain'
        ' name="g"><input>i/a</input><gain>2</gain></pure_gain></channel>'
    )
    assert compared(body, inputs, body.replace('"3"', '"4"')).apart() != {}


def test_functions_of_all_systems_come_before_any_channel() -> None:
    first = '<channel><pure_gain name="g"><input>o/f</input><gain>2</gain></pure_gain></channel>'
    second = (
        '<property>i/a</property><function name="o/f"><sum><p>i/a</p><p>fcs/g</p></sum></function>'
    )
    text = oracle.model(first).replace(
        "<aerodynamics/>", f'<flight_control name="x">{second}</flight_control><aerodynamics/>'
    )
    inputs = {"i/a": random_inputs(300)["i/a"]}
    fdm = oracle.loaded(text, 0.01)
    fdm["i/a"] = float(inputs["i/a"][0])
    parts = [
        System(document, document.root) for document in (document_of(first), document_of(second))
    ]
    values = values_of(fdm)
    names = ["fcs/g", "o/f"]
    frames = {order: traced(parts[::order], values, ["i/a"]) for order in (1, -1)}
    for name in names:
        values.setdefault(name)
    theirs = by_jsbsim(fdm, inputs, names)
    ours = run(frames[1], inputs, names)
    assert all(same_bits(theirs[name], ours[name]).all() for name in names)


def _outer(text: str) -> System:
    outer = parse_document(document_of("").path, text.encode())
    inner = document_of(f"<channel>{GAIN}</channel>".replace("@", ""))
    return System(inner, inner.root, (outer, outer.root))


def test_properties_beside_a_file_are_allowed_and_nothing_else() -> None:
    values = values_of(oracle.loaded(oracle.model("<property>i/a</property>"), 0.01))
    traced(
        [_outer('<system file="x"><property value="2">i/a</property></system>')], values, ["i/a"]
    )
    with pytest.raises(
        BadInputError, match=r"system.xml:2: <channel> beside a file is not understood"
    ):
        traced([_outer('<system file="x">\n<channel/></system>')], values, ["i/a"])
    with pytest.raises(BadInputError, match="<autopilot> names a file of <system>"):
        traced([_outer('<autopilot file="x"/>')], values, ["i/a"])


EARLY = """<property>i/x</property><function name="o/f"><p>o/g</p></function>
<function name="o/g" copyto="i/a"><p>i/b</p></function>"""


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<function type="template"><v>1</v></function>', "type='template' of <function>"),
        ('<channel rate="2"/>', "attribute 'rate' of <channel>"),
        ('<channel execrate="1.5"/>', "whole number"),
        ('<channel execrate="-2"/>', "whole number"),
        ('<channel execute="none"/>', "property none is not computed"),
        (
            '<function name="o/f" copyto="o/none"><v>1</v></function>',
            "o/none cannot be written by copyto",
        ),
        ('<function name="o/f"><p>o/f</p></function>', "reads itself"),
        (EARLY, "this function is read before it is run, and copies"),
    ],
)
def test_refusals(body: str, message: str) -> None:
    assert message in refusal(body)


@pytest.mark.parametrize("name", ["espaaro", "espaaro_truth", "synthetic_stall"])
def test_the_systems_of_the_projects_aircraft_are_understood(name: str) -> None:
    aircraft = find_aircraft(name)
    parts = read_sources(aircraft, find_script("loiter")).systems
    fdm = engine.open_fdm(staged(aircraft), 0.01)
    channels = [node for part in parts for node in part.node.all("channel")]
    # The log channel, which draws too, is not there where it is switched off and nothing switches
    # it.
    for log, draws in ((1.0, 18), (0.0, 13)):
        fdm["sensor/log"] = log
        frames = traced(parts, values_of(fdm), [])
        assert len(frames[2].sections) >= len(channels) - 1 > 5
        # Each initialising frame draws at every place, whatever its rate.
        assert [len(frame.draws) for frame in frames] == [draws] * 3
        assert {every for _, every in frames[2].draws} == {2}


TIMED = (
    '<lag_filter name="l"><input>i/a</input><c1>7</c1></lag_filter><washout_filter'
    ' name="w"><input>i/a</input><c1>2</c1></washout_filter><lead_lag_filter'
    ' name="m"><input>i/a</input><c1>1</c1><c2>2</c2><c3>3</c3><c4>4</c4></lead_lag_filter><second_order_filter'
    ' name="o"><input>i/a</input><c1>1</c1><c2>2</c2><c3>3</c3><c4>4</c4><c5>5</c5><c6>6</c6></second_order_filter><pid'
    ' name="p"><input>i/a</input><kp>1</kp><ki>2</ki><kd>3</kd></pid><actuator'
    ' name="a"><input>i/step</input><lag>9</lag><rate_limit>3</rate_limit></actuator><sensor'
    ' name="s"><input>i/a</input><lag>9</lag><drift_rate>3</drift_rate></sensor><linear_actuator'
    ' name="n"><input>i/a</input><lag>9</lag></linear_actuator><kinematic'
    ' name="k"><input>i/step</input><traverse><setting><position>-3</position><time>0</time></setting><setting><position>3</position><time>4</time></setting></traverse><noscale/></kinematic><fcs_function'
    ' name="t"><function><p>simulation/channel-dt</p></function></fcs_function>'
)


@pytest.mark.parametrize("attributes", ["", 'execrate="3"', 'execrate="2" execute="i/on"'])
def test_the_step_may_be_a_number_of_the_lane(attributes: str) -> None:
    inputs = random_inputs(400)
    body = f"<channel {attributes}>{TIMED}</channel>"
    pair = compared(body, inputs)
    assert pair.apart() == {}
    text = "".join(f"<property>{name}</property>" for name in inputs) + body
    document = document_of(text)
    for load_dt_s in (0.01, 0.02):
        # The step in the program does not count, that of the lane does.
        values = values_of(oracle.loaded(oracle.model(text), 0.01))
        frames = traced(
            [System(document, document.root)], values, list(inputs), load_dt_s, any_step=True
        )
        ours = run(frames, inputs, list(pair.theirs))
        assert all(same_bits(pair.theirs[name], ours[name]).all() for name in ours)
    late = document_of(
        '<channel><sensor name="s"><input>i/a</input><delay>.1</delay></sensor></channel>'
    )
    with pytest.raises(BadInputError, match="no fixed number of frames"):
        traced([System(late, late.root)], values, list(inputs), any_step=True)


@pytest.mark.parametrize("name", ["c172p", "737", "A320", "f16"])
def test_systems_of_stock_aircraft_have_jsbsims_bits(name: str) -> None:
    aircraft = find_aircraft(name)
    parts = read_sources(aircraft, find_script("loiter")).systems
    pair = flown_by_both(aircraft, parts, 300)
    # The F-16 takes a cosine, which the C library rounds otherwise.
    allowed = (
        {"fcs/n-pilot-z-correction", "fcs/g-load-corrected", "fcs/g-load-norm"}
        if name == "f16"
        else set()
    )
    assert set(pair.apart()) <= allowed
    for changed in pair.apart():
        assert np.max(np.abs(pair.theirs[changed] - pair.ours[changed])) < 1e-15 * np.max(
            np.abs(pair.theirs[changed])
        )
    assert sum(len(np.unique(series)) > 10 for series in pair.theirs.values()) >= 10
