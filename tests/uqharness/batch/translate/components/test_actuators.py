"""Actuators against JSBSim, bit for bit: limits hit, failures, delays, switched channels."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_systems import judged, random_inputs, refusal

A, STEP = "<input>i/a</input>", "<input>-i/step</input>"
ALL = (
    f"{A}<lag>20</lag><rate_limit>30</rate_limit><bias>@.1</bias><hysteresis_width>.2</hysteresis_width>"
    "<deadband_width>.3</deadband_width><clipto><min>-.5</min><max>.4</max></clipto><delay>.05</delay>"
)
CASES = {
    "plain": ("", A + "<bias>@0.1</bias>"),
    "all of it": ("", ALL),
    "lag": ("", A + "<lag>@20</lag>"),
    "lag of a property": ('execrate="2"', A + "<lag>i/b</lag><bias>@.1</bias>"),
    "rate limit": ("", STEP + "<rate_limit>@1.5</rate_limit>"),
    "rate limits of both senses": (
        "",
        STEP
        + '<rate_limit sense="incr">@1.5</rate_limit><rate_limit sense="decr">i/c</rate_limit>',
    ),
    "one sense alone": ("", STEP + '<rate_limit sense="decrement">@1.5</rate_limit>'),
    "dead band": ("", A + "<deadband_width>@.7</deadband_width>"),
    "hysteresis": ("", STEP + "<lag>3</lag><hysteresis_width>@.7</hysteresis_width>"),
    "saturated": ("", A + "<clipto><min>0</min><max>@1.1</max></clipto>"),
    "saturated by properties": (
        "",
        A + "<bias>@.3</bias><clipto><min>-i/b</min><max>i/b</max></clipto>",
    ),
    "switched": (
        'execute="i/on"',
        A
        + "<lag>@20</lag><rate_limit>30</rate_limit><hysteresis_width>.2</hysteresis_width><delay>.03</delay>",
    ),
    "switched, every third frame": (
        'execute="i/on" execrate="3"',
        A + '<lag>@20</lag><rate_limit>30</rate_limit><delay type="frames">3</delay>',
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    attributes, body = CASES[name]
    apart, control = judged(
        f'<channel {attributes}><actuator name="a">{body}</actuator></channel>', random_inputs()
    )
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize("name", ["all of it", "switched", "saturated"])
@pytest.mark.parametrize(
    "failures", [("zero",), ("hardover",), ("stuck",), ("zero", "hardover", "stuck")]
)
def test_failures_come_and_go(name: str, failures: tuple[str, ...]) -> None:
    inputs = random_inputs(1500)
    rng = np.random.default_rng(3)
    for how in failures:
        inputs[f"fcs/a/malfunction/fail_{how}"] = np.repeat(
            (rng.random(300) > 0.7).astype(float), 5
        )
    attributes, body = CASES[name]
    apart, control = judged(
        f'<channel {attributes}><actuator name="a">{body}</actuator></channel>', inputs
    )
    assert apart == {}
    assert control != {}


LINEAR = {
    "all of it": (
        f"{A}<module>@2</module><hysteresis>.3</hysteresis><rate>.4</rate><lag>12</lag><set>i/on</set><gain>2</gain>"
        "<bias>i/b</bias>"
    ),
    "versus a property": f"{A}<versus>i/c</versus><module>@3</module>",
    "versus a number": f"{A}<versus>-1.7</versus><reset>i/b</reset><gain>@1.1</gain>",
    "replaced numbers": (
        f"{A}<module>-2</module><hysteresis>-1</hysteresis><lag>-1</lag><rate>2</rate><gain>@1.1</gain>"
    ),
    "a slow ramp": (
        "<input>i/ramp</input><module>@1</module><rate>.9</rate><hysteresis>.05</hysteresis><versus>1</versus>"
    ),
}


@pytest.mark.parametrize("name", LINEAR)
def test_linear_actuators_have_jsbsims_bits(name: str) -> None:
    inputs = random_inputs()
    inputs["i/ramp"] = np.mod(np.cumsum(np.random.default_rng(2).normal(0.01, 0.03, 3000)), 1.0)
    apart, control = judged(
        f'<channel><linear_actuator name="l">{LINEAR[name]}</linear_actuator></channel>', inputs
    )
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            '<actuator name="a"><input>i/a</input><rate_limit sense="up">1</rate_limit></actuator>',
            "allowed are incr and decr",
        ),
        (
            '<pure_gain name="fcs/a/saturated"><input>i/a</input><gain>1</gain></pure_gain>',
            "cannot be written by <pure_gain>",
        ),
        (
            (
                "<pure_gain"
                ' name="fcs/a/malfunction/fail_zero"><input>i/a</input><gain>1</gain></pure_gain>'
            ),
            "cannot be written",
        ),
    ],
)
def test_refusals(body: str, message: str) -> None:
    assert message in refusal(f"<channel>{body}</channel>")
