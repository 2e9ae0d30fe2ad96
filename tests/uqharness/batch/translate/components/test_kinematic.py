"""Kinematic components against JSBSim, bit for bit: slow and fast intervals, steps, several
settings in a frame.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_systems import compared, judged, random_inputs, refusal


def _settings(*pairs: tuple[str, str]) -> str:
    rows = "".join(f"<setting><position>{p}</position><time>{t}</time></setting>" for p, t in pairs)
    return f"<traverse>{rows}</traverse>"


CASES = {
    "two settings": ("", f"<input>i/a</input>{_settings(('0', '0'), ('@1.3', '1.1'))}"),
    "five settings, several a frame": (
        "",
        (
            f"<input>i/a</input>{_settings(('-2', '0'), ('-.1', '@.05'), ('1', '.01'), ('1.3', '.0005'), ('4', '.004'))}<noscale/>"
        ),
    ),
    "a jump among them": (
        "",
        (
            f"<input>-i/a</input>{_settings(('-2', '0'), ('-.1', '0'), ('1', '@.1'), ('3', '0'))}<noscale/>"
        ),
    ),
    "steps": (
        'execrate="3"',
        f"<input>i/step</input>{_settings(('-3', '0'), ('0', '@1'), ('3', '2'))}<noscale/>",
    ),
    "switched, clipped": (
        'execute="i/on"',
        (
            f"<input>i/step</input>{_settings(('0', '0'), ('1', '@.5'))}<clipto><min>.2</min><max>.7</max></clipto>"
        ),
    ),
    "a tied output": (
        "",
        (
            f"<input>i/step</input>{_settings(('0', '0'), ('10', '1'), ('30', '@2'))}<output>fcs/flap-pos-deg</output>"
        ),
    ),
    "a setting twice": (
        "",
        (
            f"<input>-i/step</input>{_settings(('0', '0'), ('0', '1'), ('5', '@2'), ('5', '1'), ('6', '.3'))}<noscale/>"
        ),
    ),
    "from above": (
        "",
        (
            f"<input>i/step</input>{_settings(('0', '0'), ('1', '@5'))}<output>gear/gear-pos-norm</output>"
        ),
    ),
    "from below": ("", f"<input>i/step</input>{_settings(('1', '0'), ('2', '@.3'))}<noscale/>"),
}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    attributes, body = CASES[name]
    apart, control = judged(
        f'<channel {attributes}><kinematic name="k">{body}</kinematic></channel>', random_inputs()
    )
    assert apart == {}
    assert control != {}


def test_a_position_above_the_last_setting_is_nan_on_the_way_down() -> None:
    inputs = {"i/a": np.zeros(3)}
    body = (
        '<property value="5">o/k</property><channel><kinematic'
        f' name="o/k"><input>i/a</input>{_settings(("0", "0"), ("1", "1"))}'
    )
    pair = compared(f"{body}</kinematic></channel>", inputs)
    assert np.isnan(pair.ours["o/k"]).all()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (_settings(("0", "0")), "positions of a <traverse> do not decrease, two or more"),
        (_settings(("0", "0"), ("-1", "1")), "do not decrease"),
        ("<traverse><position>0</position></traverse>", "<setting>s with <position> and <time>"),
        ("", "a <kinematic> has <traverse>"),
    ],
)
def test_refusals(body: str, message: str) -> None:
    assert message in refusal(
        f'<channel><kinematic name="k"><input>i/a</input>{body}</kinematic></channel>'
    )
