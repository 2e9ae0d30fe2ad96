"""Conditions that are not understood; those that are, against JSBSim, are in
components/test_switches.py.
"""

from __future__ import annotations

import pytest

from tests.helpers.batch_systems import refusal


@pytest.mark.parametrize(
    ("test", "message"),
    [
        ('<test value="1" logic="and">i/a gt 1</test>', "allowed are AND and OR"),
        ('<test value="1"/>', "<test> has no comparison"),
        ('<test value="1">i/a gt</test>', "received 'i/a gt'"),
        ('<test value="1">i/a\tgt\t1</test>', "received 'i/a\\\\tgt\\\\t1'"),
        ('<test value="1">i/a =&gt; 1</test>', "a comparison is 'property sign value'"),
        ('<test value="1">1 gt i/a</test>', "must be the name of a property; received '1'"),
        ('<test value="1">i/a gt 1e400</test>', "finite decimal number"),
        ('<test value="1">i/a gt 1 <value/></test>', "<value> in <test>"),
        (
            '<test value="1">i/a gt 1 <test value="2">i/a lt 1</test></test>',
            "attribute 'value' of <test>",
        ),
    ],
)
def test_refusals(test: str, message: str) -> None:
    said = refusal(f'<channel>\n<switch name="s">{test}</switch></channel>')
    assert message.replace("\\\\", "\\") in said
    assert said.startswith("system.xml:2: ")
