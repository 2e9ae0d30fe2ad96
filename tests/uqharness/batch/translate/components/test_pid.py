"""PID controllers and integrators against JSBSim, bit for bit, from the initialising frames on."""

from __future__ import annotations

import pytest

from tests.helpers.batch_systems import judged, random_inputs, refusal

A = "<input>i/a</input>"
TERMS = "<kp>1.1</kp>{ki}<kd>i/c</kd><trigger>{trigger}</trigger><clipto><min>-3</min><max>3</max></clipto>"
CASES = {
    f"{kind}, {rule}, trigger {trigger}": (
        f'<pid name="l" type="{kind}">{A}'
        + TERMS.format(ki=f'<ki type="{rule}">@.7</ki>', trigger=trigger)
        + "</pid>"
    )
    for kind in ("standard", "ideal")
    for rule in ("rect", "trap", "ab2", "ab3")
    for trigger in ("i/on", "-i/on")
}
CASES |= {
    "no integral": f'<pid name="l">{A}<kp>@1.1</kp><kd>.01</kd></pid>',
    "slope from a property": (
        f'<pid name="l">{A}<kp>1.1</kp><ki>i/b</ki><kd>@.3</kd><pvdot>-i/c</pvdot></pid>'
    ),
    "standard of properties": f'<pid name="x/l" type="standard">{A}<kp>i/b</kp><ki>@.2</ki></pid>',
    "integrator": f'<integrator name="l">{A}<c1>@.7</c1></integrator>',
    "integrator, rectangular": (
        f'<integrator name="l">{A}<c1'
        ' type="rect">@.7</c1><clipto><min>-.1</min><max>i/b</max></clipto></integrator>'
    ),
    "integrator of a property": (
        f'<integrator name="l">{A}<c1>i/b</c1><trigger>i/c</trigger><kp>@.2</kp></integrator>'
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    attributes = {"no integral": 'execrate="3"', "integrator": 'execute="i/on" execrate="2"'}.get(
        name, ""
    )
    apart, control = judged(f"<channel {attributes}>{CASES[name]}</channel>", random_inputs())
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (f'<pid name="l" type="x">{A}<kp>1</kp></pid>', "allowed are ideal, parallel and standard"),
        (f'<pid name="l">{A}<ki type="x">1</ki></pid>', "allowed are rect, trap, ab2, ab3"),
        (f'<integrator name="l">{A}</integrator>', "a <integrator> has <c1>"),
        (
            f'<pid name="l">{A}<kp>1</kp><output>fcs/l/initial-integrator-value</output></pid>',
            "cannot be written by <pid>",
        ),
    ],
)
def test_refusals(body: str, message: str) -> None:
    assert message in refusal(f"<channel>{body}</channel>")
