"""Sensors against JSBSim, bit for bit; noise with JSBSim's own draws; gyros and accelerometers of a
tumbling body.
"""

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

A = "<input>i/a</input>"
QUANTIZED = '<quantization name="steps"><bits>5</bits><min>-2</min><max>@2.1</max></quantization>'
CASES = {
    "plain": ("", A + "<gain>@1.3</gain>"),
    "all but noise": (
        "",
        f"{A}<lag>9</lag><drift_rate>.1</drift_rate><gain>1.3</gain><bias>.2</bias><delay>.04</delay>{QUANTIZED}",
    ),
    "quantized and clipped": ("", f"{A}{QUANTIZED}<clipto><min>-1</min><max>1.1</max></clipto>"),
    "drift": ('execrate="3"', A + "<drift_rate>@.1</drift_rate>"),
    "switched": (
        'execute="i/on"',
        A + "<lag>@9</lag><drift_rate>.1</drift_rate><delay>.04</delay>",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_bits_are_jsbsims_and_a_moved_number_is_noticed(name: str) -> None:
    attributes, body = CASES[name]
    apart, control = judged(
        f'<channel {attributes}><sensor name="s">{body}</sensor></channel>', random_inputs()
    )
    assert apart == {}
    assert control != {}


@pytest.mark.parametrize("failures", [("low",), ("high",), ("stuck",), ("low", "high", "stuck")])
def test_failures_come_and_go(failures: tuple[str, ...]) -> None:
    inputs = random_inputs(1500)
    rng = np.random.default_rng(3)
    for how in failures:
        inputs[f"fcs/s/malfunction/fail_{how}"] = np.repeat(
            (rng.random(300) > 0.7).astype(float), 5
        )
    apart, control = judged(
        f'<channel><sensor name="s">{CASES["all but noise"][1]}</sensor></channel>', inputs
    )
    assert apart == {}
    assert control != {}


def _noisy(inputs: tuple[str, str], noise: tuple[str, str], drawn: str) -> str:
    first, second = (
        f'<sensor name="{name}"><input>{x}</input><noise variation="{kind}"'
        f' distribution="GAUSSIAN">{size}</noise></sensor>'
        for name, x, kind, size in zip(
            "pq", inputs, noise, ("1", "1") if drawn else ("0.3", "2"), strict=True
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
    bare = _noisy(("i/zero", "i/zero"), ("ABSOLUTE", "ABSOLUTE"), "bare")
    raw = compared(bare, inputs, draws=np.zeros(9000)).theirs
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
    seen = {name: series[name] for name in NOW}
    seen |= {name: np.concatenate([series[name][:1], series[name][:-1]]) for name in BEFORE}
    worst = {}
    for bias in ("0.25", "0.250000000001"):
        document = document_of(body.replace("{bias}", bias))
        ours = run(traced([System(document, document.root)], values, list(seen)), seen, MADE)
        worst[bias] = max(
            np.max(np.abs(ours[n] - series[n])[2:]) / np.max(np.abs(series[n])) for n in MADE
        )
    assert np.min([np.ptp(series[name]) for name in MADE]) > 0.01
    assert worst["0.25"] < 4e-16
    assert worst["0.250000000001"] > 1e-14


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<quantization><bits>40</bits><min>0</min><max>1</max></quantization>", "1 to 30 bits"),
        ("<quantization><bits>4</bits><min>1</min><max>1</max></quantization>", "min below max"),
        ("<quantization><steps>4</steps></quantization>", "<steps> in <quantization>"),
    ],
)
def test_refusals(body: str, message: str) -> None:
    assert message in refusal(f'<channel><sensor name="s">{A}{body}</sensor></channel>')


@pytest.mark.parametrize("attributes", ['execute="i/a"', 'execute="i/a" execrate="2"'])
def test_noise_that_lanes_draw_at_different_times_is_refused(attributes: str) -> None:
    body = (
        f'<sensor name="s">{A}<noise variation="PERCENT" distribution="GAUSSIAN">1</noise></sensor>'
    )
    assert "has no stream" in refusal(f"<channel {attributes}>{body}</channel>")


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<gyro name='g'><axis>X</axis></gyro>", "velocities/pi-rad_sec is not computed"),
        ("<gyro name='g'><input>i/a</input><axis>X</axis></gyro>", "has 0 <input>"),
    ],
)
def test_what_a_gyro_needs(body: str, message: str) -> None:
    inputs = ("i/a",) if "not computed" in message else ("i/a", *NOW)
    assert message in refusal(f"<channel>{body}</channel>", inputs)
