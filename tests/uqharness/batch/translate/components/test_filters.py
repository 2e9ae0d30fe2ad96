"""Filters against JSBSim, bit for bit, from the initialising frames on."""

from __future__ import annotations

import pytest

from tests.helpers.batch_systems import judged, random_inputs, refusal

A = "<input>i/a</input>"
LAG = f'<lag_filter name="l">{A}<c1>@7</c1></lag_filter>'
CASES = {
    "lag": ("", LAG),
    "lag, every third frame": ('execrate="3"', LAG),
    "lag, switched": ('execute="i/on"', LAG),
    "lag, switched, every third frame": ('execute="i/on" execrate="3"', LAG),
    "lag of a property, clipped": (
        "",
        (
            "<lag_filter"
            f' name="l">{A}<c1>i/b</c1><clipto><min>-.1</min><max>@.11</max></clipto></lag_filter>'
        ),
    ),
    "lag, so fast that it rings": ("", f'<lag_filter name="l">{A}<c1>@900</c1></lag_filter>'),
    "lead and lag": (
        "",
        (
            "<lead_lag_filter"
            f' name="l">{A}<c1>7</c1><c2>@3</c2><c3>.2</c3><c4>11</c4></lead_lag_filter>'
        ),
    ),
    "lead and lag of properties": (
        'execrate="2"',
        (
            "<lead_lag_filter"
            f' name="l">{A}<c1>-i/b</c1><c2>@3</c2><c3>2</c3><c4>i/on</c4></lead_lag_filter>'
        ),
    ),
    "second order": (
        "",
        (
            "<second_order_filter"
            f' name="l">{A}<c1>7</c1><c2>3</c2><c3>.2</c3><c4>1.1</c4><c5>@2</c5><c6>31</c6></second_order_filter>'
        ),
    ),
    "second order, switched": (
        'execute="i/on"',
        (
            "<second_order_filter"
            f' name="l">{A}<c1>i/b</c1><c2>3</c2><c3>.2</c3><c4>1</c4><c5>2</c5><c6>@31</c6></second_order_filter>'
        ),
    ),
    "wash-out": ("", f'<washout_filter name="l">{A}<c1>@3</c1></washout_filter>'),
    "wash-out of a step": (
        "",
        '<washout_filter name="l"><input>-i/step</input><c1>@3</c1></washout_filter>',
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    attributes, body = CASES[name]
    apart, control = judged(f"<channel {attributes}>{body}</channel>", random_inputs())
    assert apart == {}
    assert control != {}


def test_a_missing_coefficient_is_refused() -> None:
    said = refusal(
        "<channel>\n<lead_lag_filter"
        f' name="l">{A}<c1>7</c1><c2>3</c2><c3>2</c3></lead_lag_filter></channel>'
    )
    assert said == "system.xml:2: a <lead_lag_filter> has <c4>; it has none"
