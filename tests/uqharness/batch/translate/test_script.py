"""Events of run scripts flown by JSBSim and by their translation."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.helpers.batch_flights import START, aircraft, compared, refused, worst
from tests.helpers.few import few

BODY = """<system name='s'><property value='1'>i/a</property><property value='2'>i/b</property><property value='.5'>i/c</property>
<property>i/on</property><channel name='c'><pure_gain name='s/a'><input>i/a</input><gain>2</gain></pure_gain>
<summer name='s/b'><input>i/b</input><input>s/a</input></summer></channel></system>
<aerodynamics><axis name='X'><function name='f/x'><sum><p>i/a</p><p>i/b</p></sum></function></axis></aerodynamics>"""


RECORDS = ("i/a", "i/b", "i/c", "s/a", "s/b", "f/x", "simulation/sim-time-sec", "velocities/u-fps")


def inputs(frames=60):
    """A switch that goes on and off."""
    return {"i/on": np.repeat([0.0, 1.0, 0.0, 1.0, 1.0, 0.0], 11)[: frames + 1]}


def differences(events, changed=None, frames=60, start=START):
    return compared(
        aircraft(BODY), RECORDS, inputs(frames), frames, start, events, changed_events=changed
    )


def event(text, condition="i/on eq 1", attributes=""):
    return f"<event name='e' {attributes}><condition>{condition}</condition>{text}</event>"


FUNCTION = "<function><product><p>i/c</p><p>simulation/sim-time-sec</p></product></function>"


EVENTS = {
    "value": event("<set name='i/a' value='7'/>"),
    "at a time": event("<set name='i/a' value='7'/>", "simulation/sim-time-sec ge 0.2"),
    "at the first frame": event("<set name='i/a' value='7'/>", "simulation/sim-time-sec ge 0"),
    "delta": event("<set name='i/a' value='-.5' type='FG_DELTA'/>"),
    "bool as it stands": event("<set name='i/a' value='0.3' type='FG_BOOL'/>"),
    "function": event(f"<set name='i/a'>{FUNCTION}</set>"),
    "function, delta": event(f"<set name='i/a' type='FG_DELTA'>{FUNCTION}</set>"),
    "both from before": event(
        "<set name='i/a'><function><p>i/b</p></function></set><set"
        " name='i/b'><function><p>i/a</p></function></set>"
    ),
    "two conditions": event(
        "<set name='i/a' value='7'/>", "i/on eq 1\nsimulation/sim-time-sec ge .3"
    ),
    "or": (
        "<event><condition logic='OR'>i/on eq 1\nsimulation/sim-time-sec ge .05</condition><set"
        " name='i/a' value='3'/></event>"
    ),
    "nested": (
        "<event><condition logic='AND'>i/on eq 1<condition logic='OR'>i/b gt"
        " 5\nsimulation/sim-time-sec gt .3</condition></condition><set name='i/a'"
        " value='3'/></event>"
    ),
    "property against property": event(
        "<set name='i/a' value='7'/>", "s/b lt simulation/sim-time-sec\ni/on ge i/on"
    ),
    "delay": event("<set name='i/a' value='7'/><delay>.055</delay>"),
    "delay, of the value at the trigger": event(
        f"<set name='i/a'>{FUNCTION}</set><delay>.1</delay>"
    ),
    "ramp": event("<set name='i/a' value='7' action='FG_RAMP' tc='.17'/>"),
    "ramp of the default length": event("<set name='i/a' value='7' action='FG_RAMP'/>"),
    "ramp, delta, delay": event(
        "<set name='i/a' value='2' type='FG_DELTA' action='FG_RAMP' tc='.1'/><delay>.05</delay>"
    ),
    "exponential": event(
        "<set name='i/a' value='7' action='FG_EXP' tc='.1'/><set name='i/b' value='1'/>"
    ),
    "exponential that stops": event(
        "<set name='i/a' value='7' action='FG_EXP' tc='.1'/>", attributes="persistent='true'"
    ),
    "persistent": event(
        "<set name='i/a' value='1' type='FG_DELTA'/>", attributes="persistent='true'"
    ),
    "persistent with a delay that is cut short": event(
        "<set name='i/a' value='1' type='FG_DELTA'/><delay>.15</delay>",
        attributes="persistent='true'",
    ),
    "persistent ramp": event(
        "<set name='i/a' value='3' action='FG_RAMP' tc='.05'/>", attributes="persistent='true'"
    ),
    "continuous": event(
        "<set name='i/a' value='1' type='FG_DELTA'/>", attributes="continuous='true'"
    ),
    "continuous function": event(
        f"<set name='i/a'>{FUNCTION}</set>", attributes="continuous='true'"
    ),
    "continuous function, delta": event(
        f"<set name='i/a' type='FG_DELTA'>{FUNCTION}</set>", attributes="continuous='true'"
    ),
    "continuous ramp": event(
        "<set name='i/a' value='3' action='FG_RAMP' tc='.05'/>", attributes="continuous='true'"
    ),
    "continuous, one after the other": event(
        "<set name='i/a'><function><sum><p>i/a</p><v>1</v></sum></function></set>"
        "<set name='i/b'><function><p>i/a</p></function></set>",
        attributes="continuous='true'",
    ),
    "two events, the second sees the first": (
        event("<set name='i/a' value='7'/>") + event("<set name='i/b' value='9'/>", "i/a gt 6")
    ),
    "the second before the first": (
        event("<set name='i/b' value='9'/>", "i/a gt 6") + event("<set name='i/a' value='7'/>")
    ),
    "a component's own property": event("<set name='s/a' value='50'/>"),
    "notify": event(
        "<set name='i/a'"
        " value='7'/><notify><property>i/a</property></notify><description>x</description>"
    ),
    "nothing set": event(""),
    "a surface": event(
        "<set name='fcs/elevator-pos-deg' value='5'/><set"
        " name='i/a'><function><p>fcs/elevator-pos-rad</p></function></set>"
    ),
    "a property of run": (
        "<property value='4'>i/b</property><property value='2'>run/own</property>"
        + event(
            "<set name='run/own' value='3'/><set"
            " name='i/a'><function><p>run/own</p></function></set>"
        )
    ),
}


def specific(text, number):
    """The text with properties of its own."""
    return re.sub(r"\b(i/[abc]|s/[ab]|f/x|run/own)\b", lambda result: f"{result[0]}{number}", text)


def test_all_events_in_one_flight():
    """Each on properties of its own; the one that sets a surface is flown alone."""
    events = [text for name, text in EVENTS.items() if name != "a surface"]
    bodies = "".join(
        specific(BODY, number).replace("'s'", f"'s{number}'").replace("'c'", f"'c{number}'")
        for number in range(len(events))
    )
    declared = "<property>i/on</property>"
    bodies = bodies.replace(declared, "").replace("<channel", f"{declared}<channel", 1)
    bodies = bodies.replace("</axis></aerodynamics>", "").replace(
        "<aerodynamics><axis name='X'>", ""
    )
    systems = "".join(re.findall(r"<system.*?</system>", bodies, re.DOTALL))
    functions = "".join(re.findall(r"<function name='f/.*?</function>", bodies, re.DOTALL))
    text = aircraft(f"{systems}<aerodynamics><axis name='X'>{functions}</axis></aerodynamics>")
    # Properties of the run, declared in a script, come first.
    texts = [specific(text, number) for number, text in enumerate(events)]
    first = "".join(
        part for text in texts for part in re.findall(r"<property value=.*?</property>", text)
    )
    remainder = "".join(re.sub(r"<property value=.*?</property>", "", text) for text in texts)
    records = [
        f"{name}{number}"
        for number in range(len(events))
        for name in ("i/a", "i/b", "s/a", "s/b", "f/x")
    ]
    result = compared(text, [*records, "velocities/u-fps"], inputs(), 60, START, first + remainder)
    assert len(result) == 5 * len(events) + 1
    assert worst(result) < 1e-12
    changed = (first + remainder).replace("tc='.17'", "tc='.1700001'")
    assert (
        worst(
            compared(text, records, inputs(), 60, START, first + remainder, changed_events=changed)
        )
        > 1e-9
    )


@pytest.mark.parametrize(
    "name", ["a surface", *(pytest.param(name, marks=pytest.mark.slow) for name in EVENTS)]
)
def test_events(name):
    assert worst(differences(EVENTS[name])) < 1e-12


@pytest.mark.parametrize(
    ("name", "old", "new"),
    few(
        [
            ("value", "'7'", "'7.0000001'"),
            ("at a time", "0.2", "0.185"),
            ("delta", "FG_DELTA", "FG_VALUE"),
            ("delay", ".055", ".065"),
            ("ramp", ".17", ".1700001"),
            ("exponential", "tc='.1'", "tc='.1000001'"),
            ("persistent", "persistent='true'", ""),
            ("continuous function", "continuous", "persistent"),
            ("two conditions", "i/on eq 1", "i/on ge 0"),
            ("or", "OR", "AND"),
        ],
        2,
    ),
)
def test_another_event_is_noticed(name, old, new):
    assert old in EVENTS[name]
    assert worst(differences(EVENTS[name], EVENTS[name].replace(old, new))) > 1e-9


@pytest.mark.parametrize(
    ("text", "output"),
    [
        (event("<set name='i/a' value='1'/><then/>"), "<then> of an event"),
        (
            event("<set name='i/a' value='1' action='FG_SPLINE'/>"),
            "action FG_STEP, FG_RAMP or FG_EXP",
        ),
        (event("<set name='i/a' value='1' type='FG_TEXT'/>"), "type FG_VALUE"),
        (event("<set name='i/a' value='1' unit='M'/>"), "attribute 'unit'"),
        (
            event("<set name='i/a' value='1'><function><v>1</v></function></set>"),
            "either a value or a function",
        ),
        (event("<set name='velocities/u-fps' value='1'/>"), "velocities/u-fps cannot be set"),
        (event("<set name='position/h-sl-ft' value='1'/>"), "position/h-sl-ft cannot be set"),
        (
            event("<set name='simulation/terminate' value='1'/>"),
            "simulation/terminate cannot be set",
        ),
        (event("<set name='inertia/mass-slugs' value='3'/>"), "inertia/mass-slugs cannot be set"),
        (event("<set name='i/typo' value='1'/>"), "property i/typo is not computed"),
        (
            event("<set name='i/a'><function><p>position/vrp-radius-ft</p></function></set>"),
            "vrp-radius-ft",
        ),
        (event("<set name='i/a' value='1'/>", "position/vrp-radius-ft gt 3"), "vrp-radius-ft"),
        (event("<set name='i/a' value='1'/>", attributes="persistent='yes'"), "persistent='yes'"),
        (event("<set name='i/a'><function><random/></function></set>"), "random"),
    ],
)
def test_event_refusals_name_the_line(text, output):
    result = refused(aircraft(BODY), text)
    assert output in result
    assert "script.xml:3: " in result
