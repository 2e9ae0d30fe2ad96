"""Switches and distributors against JSBSim, bit for bit."""

from __future__ import annotations

import pytest

from tests.helpers.batch_systems import judged, random_inputs, refusal

CASES = {
    "tests in order": (
        '<switch name="s"><default value="i/b"/><test logic="AND" value="-i/c">i/a gt @0.1\n i/b LE'
        ' i/c</test><test logic="OR" value="@-3.5">i/a == 0\n i/c &lt; 0 <test logic="AND">i/b ge'
        " 0\n i/on NE 0</test></test></switch>"
    ),
    "no default": '<switch name="s"><test value="@1.5">-i/a > i/b</test></switch>',
    "its own value": (
        '<switch name="s"><default value="fcs/s"/><test value="@1.5">i/a > 2</test>'
        '<test value="i/b">i/a lt -2</test></switch>'
    ),
    "every word and sign": (
        '<switch name="s"><default value="@0.1"/>'
        + "".join(
            f'<test value="{k}.5">i/on {word} {k % 2}\n i/a {other} i/b\n i/c ge'
            f" {2 - 0.2 * k}</test>"
            for k, (word, other) in enumerate(
                (
                    ("EQ", "GT"),
                    ("==", "ge"),
                    ("NE", "LT"),
                    ("!=", "&lt;="),
                    ("eq", ">="),
                    ("ne", "LE"),
                )
            )
        )
        + "</switch>"
    ),
    "delay and clip": (
        '<switch name="s"><default value="@1.5"/><test value="i/c">i/a gt 0.1</test><delay'
        ' type="frames">6</delay><clipto><min>-1</min><max>2</max></clipto></switch>'
    ),
    "delay in seconds": (
        '<switch name="s"><default value="@1.5"/><test value="i/c">i/a gt 0.1</test><delay'
        ' type="time">.07</delay></switch>'
    ),
    "exclusive": (
        '<distributor name="d" type="exclusive"><case><test>i/a gt 1</test><property'
        ' value="i/b">o/p</property><property value="@2">o/q</property></case><case><test>i/a gt'
        ' 0</test><property value="-i/c">o/p</property></case><case><property'
        ' value="i/a">o/r</property></case></distributor>'
    ),
    "inclusive": (
        '<distributor type="inclusive"><case><test>i/a gt 1</test><property'
        ' value="i/b">o/p</property><property value="@2">o/q</property></case><case><test'
        ' logic="OR">i/a gt 0\n i/b gt 0</test><property value="o/p">o/r</property><property'
        ' value="-i/c">o/p</property></case></distributor>'
    ),
}
PLACES = "".join(f"<property>o/{name}</property>" for name in "pqr")


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    apart, control = judged(f"{PLACES}<channel>{CASES[name]}</channel>", random_inputs())
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize(
    "attributes", ['execute="i/on"', 'execrate="3" execute="i/on"', 'execrate="2"']
)
def test_a_delay_line_moves_when_its_channel_runs(attributes: str) -> None:
    apart, control = judged(
        f"<channel {attributes}>{CASES['delay and clip']}</channel>", random_inputs()
    )
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<switch name="s"><default/></switch>', "<default> has attribute value"),
        ('<distributor name="d"><case/></distributor>', "allowed are inclusive and exclusive"),
        (
            (
                '<distributor type="exclusive"><case><test>i/a gt 1</test><test>i/a gt'
                " 1</test></case></distributor>"
            ),
            "has one <test>",
        ),
        (
            (
                '<distributor type="exclusive"><case><property'
                ' value="1">o/none</property></case></distributor>'
            ),
            "o/none does not exist",
        ),
        ('<distributor type="exclusive"><case><foo/></case></distributor>', "<foo> in <case>"),
        (
            '<switch name="s"><default value="1"/><delay type="x">1</delay></switch>',
            "allowed are time and frames",
        ),
        (
            '<switch name="s"><default value="1"/><delay>i/a</delay></switch>',
            "finite decimal number",
        ),
        ('<switch name="s"><default value="1"/><delay>99</delay></switch>', "0 to 1000 frames"),
    ],
)
def test_refusals(body: str, message: str) -> None:
    assert message in refusal(f"<channel>{body}</channel>")
