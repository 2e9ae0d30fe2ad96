"""Systems and channels against JSBSim: order, rates, switches, files, ignored elements, unsupported elements."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_flights as flights
from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_stock import flown_by_both
from tests.helpers.batch_systems import (
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
from uqharness.simulator import find_aircraft, find_script

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
    difference, control = judged(CASES[name], random_inputs())
    assert difference == {}
    assert control != {}


@pytest.mark.parametrize("rate", [1, 2, 3, 7])
def test_a_switched_channel_counts_the_frames_in_which_it_is_on(rate: int) -> None:
    inputs = random_inputs()
    # Neither is it rounded nor does its sign count.
    inputs["i/on"] = inputs["i/on"] * np.random.default_rng(5).choice(
        [0.4, 0.6, -1.0, 1e-300], len(inputs["i/on"])
    )
    difference, control = judged(
        f'<channel execute="i/on" execrate="{rate}">{GAIN}</channel>', inputs
    )
    assert difference == {}
    assert control != {}


@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_channel_may_begin_in_flight(start: float) -> None:
    inputs = random_inputs(200)
    inputs["i/on"][:50] = start
    inputs["i/on"][50:] = 1.0
    lag = '<lag_filter name="l"><input>i/a</input><c1>@3</c1></lag_filter>'
    actuator = '<actuator name="a"><input>i/a</input><rate_limit>3</rate_limit></actuator>'
    difference, control = judged(
        f'<channel execute="i/on" execrate="3">{lag}{actuator}</channel>', inputs
    )
    assert difference == {}
    assert control != {}


EARLY = """<property>i/x</property><function name="o/f"><p>o/g</p></function>
<function name="o/g" copyto="i/a"><p>i/b</p></function>"""


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<function type="template"><v>1</v></function>', "type='template' of <function>"),
        ('<channel rate="2"/>', "attribute 'rate' of <channel>"),
        ('<channel execrate="1.5"/>', "whole number"),
        ('<channel execute="none"/>', "property none is not computed"),
        (
            '<function name="o/f" copyto="o/none"><v>1</v></function>',
            "o/none cannot be written by copyto",
        ),
        (EARLY, "this function is read before it is run, and copies"),
    ],
)
def test_channel_refusals(body: str, message: str) -> None:
    assert message in refusal(body)


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


ADD = "<pure_gain name='o/{}'><input>o/{}</input><gain>{}</gain></pure_gain>"


def part(tag, name, of, gain, extra=""):
    return (
        f"<{tag} name='{name}'{extra}><channel"
        f" name='c'>{ADD.format(name, of, gain)}</channel></{tag}>"
    )


DECLARED = "<system name='d'><property value='1'>o/start</property></system>"


def test_systems_run_before_the_autopilot_and_that_before_the_flight_control():
    """Whatever their order in the file: each reads what the one before has made in the same
    frame.
    """
    body = (
        part("flight_control", "last", "middle", 3)
        + part("autopilot", "middle", "first", 2)
        + DECLARED
    )
    body += (
        part("system", "first", "second", 1.5)
        + part("system", "second", "start", 1.25)
        + "<aerodynamics/>"
    )
    with flights.craft(flights.aircraft(body)) as result:
        tags = [system.node.attributes["name"] for system in result.sources().systems]
    assert tags == ["d", "first", "second", "middle", "last"]
    assert (
        flights.worst(
            flights.compared(
                flights.aircraft(body),
                [f"o/{n}" for n in ("first", "second", "middle", "last")],
                frames=5,
            )
        )
        < 1e-15
    )


@pytest.mark.parametrize("place", ["x.xml", "Systems/x.xml", "systems/x.xml"])
def test_a_system_in_a_file(place):
    body = "<system file='x'><property value='4'>o/start</property></system><aerodynamics/>"
    with flights.craft(
        flights.aircraft(body), files={place: part("system", "inside", "start", 2)}
    ) as result:
        systems = result.sources().systems
    assert systems[0].document.path.name == "x.xml"
    assert systems[0].outer is not None


def test_a_file_that_is_not_there_is_refused():
    with flights.craft(flights.aircraft("<aerodynamics/>")) as result:
        xml = result.root / "aircraft" / "point" / "point.xml"
        xml.write_text(flights.aircraft("<system file='nowhere'/><aerodynamics/>"))
        with pytest.raises(BadInputError, match="nowhere"):
            result.sources()


A = "<input>i/a</input>"


SYSTEMS = {
    "elements of a component": f"""<pure_gain name="g" colour="red">{A}<gain>@2</gain><gain>3</gain>
<bias>4</bias><wheels/></pure_gain><actuator name="a">{A}<lag>@3</lag><lag>9</lag><gain>7</gain>
</actuator><sensor name="s">{A}<gain>@1.5</gain><axis>Z</axis></sensor>""",
    "a property and an unknown component in a channel": f"""<property value="5">i/unread</property>
<wobbler name="w">{A}</wobbler><summer name="g">{A}<bias>@2</bias></summer>""",
    "a second default and a misspelt attribute": """<switch name="s"><default value="@2"/>
<default value="3"/><test value="4" login="OR">i/a gt 1</test></switch>""",
    "operations": f"""<fcs_function name="f">{A}<function name="f/x"><sum>text<v>@1.5</v>
<wobble><v>3</v></wobble><function><v>7</v></function><p>i/b</p></sum></function></fcs_function>""",
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_systems_have_jsbsims_bits(name: str) -> None:
    body = f"<thing/><channel>{SYSTEMS[name]}</channel>"
    differences, control = judged(body, random_inputs(300))
    assert differences == {}
    assert control != {}


def test_named_tables_and_operations_are_properties() -> None:
    body = """<function name="o/f"><sum><product name="o/p"><v>@2.5</v><p>i/a</p></product>
<table name="o/t"><independentVar>i/b</independentVar><tableData>
-1 0
 2 @3</tableData></table></sum></function>
<channel><summer name="o/s"><input>o/p</input><input>o/t</input></summer></channel>"""
    differences, control = judged(body, random_inputs(300))
    assert differences == {}
    assert control != {}


MAGNETOMETER = """<magnetometer name="i/compass"><axis>X</axis><location unit="M"><x>0</x><y>0</y>
<z>0</z></location>{noise}</magnetometer>"""


LIGHTS = """<system name="lights"><property value="1">i/switch</property><channel name="lights">
{magnetometer}<summer name="i/needle"><input>i/compass</input><bias>1</bias></summer>
<switch name="i/lamp"><default value="0"/><test value="1">i/needle gt 0</test></switch>
<sensor name="i/other"><input>i/switch</input><noise variation="ABSOLUTE"
 distribution="GAUSSIAN">.1</noise></sensor></channel></system>"""


FORCE = """<aerodynamics><function name="aero/shown"><p>i/lamp</p></function><axis name="X">
<function name="aero/x"><product><p>{reads}</p><v>9</v></product></function></axis></aerodynamics>"""


NOISE = '<noise variation="PERCENT" distribution="{kind}">.1</noise>'


def aircraft(reads: str, noise: str = "") -> str:
    lights = LIGHTS.replace("{magnetometer}", MAGNETOMETER.replace("{noise}", noise))
    return flights.aircraft(lights + FORCE.replace("{reads}", reads))


def test_a_chain_of_instruments_is_left_out_with_its_reasons() -> None:
    with flights.craft(aircraft("i/switch")) as result:
        flight = flights.translated(result, ["velocities/u-fps"])
    assert len(flight.left_out) == 4
    assert all("point.xml:" in reason for reason in flight.left_out)
    assert all("<magnetometer> takes the field of the day" in why for why in flight.left_out)


@pytest.mark.parametrize("reads", ["i/compass", "i/needle", "i/lamp", "aero/shown"])
def test_what_the_flight_reads_is_refused_with_the_reason_at_its_root(reads: str) -> None:
    output = flights.refused(aircraft(reads))
    assert "point.xml:" in output
    assert "<magnetometer> takes the field of the day" in output


@pytest.mark.parametrize("kind", ["GAUSSIAN", "UNIFORM"])
def test_noise_of_what_was_left_out_is_drawn_all_the_same(kind: str) -> None:
    with flights.craft(aircraft("i/other", NOISE.replace("{kind}", kind))) as result:
        flight = flights.translated(result, ["i/other"])
    assert [name.endswith("/uniform") for name, _ in flight.draws] == [kind == "UNIFORM", False]


def test_ground_functions_are_not_taken_for_constants() -> None:
    ground = """<ground_reactions><function name="gear/load"><p>position/h-agl-ft</p></function>
</ground_reactions>"""
    text = flights.aircraft(
        FORCE.replace("{reads}", "gear/load").replace("i/lamp", "aero/qbar-psf")
    )
    output = flights.refused(text.replace("<ground_reactions/>", ground))
    assert "<function> of <ground_reactions> is not supported" in output


def test_a_flight_with_instruments_is_jsbsims() -> None:
    text = aircraft("i/switch")
    records = ["velocities/u-fps", "attitude/theta-rad", "forces/fbx-aero-lbs"]
    assert flights.worst(flights.compared(text, records, frames=50)) < 1e-9
    changed = text.replace("<v>9</v>", "<v>9.001</v>")
    assert flights.worst(flights.compared(text, records, frames=50, changed=changed)) > 1e-8


def test_host_properties_are_constants_and_inputs() -> None:
    """A property outside JSBSim's tree that the XML declares, or that the host feeds."""
    text = flights.aircraft(
        "<system name='s'><property value='.3'>/mine/flaps</property>"
        "<property value='0'>/mine/elevator</property><channel><summer name='fcs/e'>"
        "<input>/mine/elevator</input><input>/mine/flaps</input>"
        "<output>/mine/flap-position</output></summer></channel></system>"
        + FORCE.replace("{reads}", "/mine/flap-position").replace("i/lamp", "fcs/e")
    )
    elevator = {"/mine/elevator": np.sin(np.arange(61) / 7.0)}
    records = ["fcs/e", "/mine/flap-position", "velocities/u-fps"]
    assert flights.worst(flights.compared(text, records, elevator, frames=60)) < 1e-9
    changed = text.replace("value='.3'", "value='.301'").replace("<v>9</v>", "<v>9.01</v>")
    gap = flights.compared(text, records, elevator, frames=60, changed=changed)
    assert flights.worst(gap) > 1e-6
