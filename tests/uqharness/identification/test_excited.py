"""Which parameters flights excite: those that they do not are held with the reason, the others are
not.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pytest

from sysid.linalg import Blocks
from uqharness.identification.excitation import MIN_T, Excitation, without_channels
from uqharness.identification.excitation import assess_excitation as of_blocks
from uqharness.identification.replay_fit import Observed

RNG = np.random.default_rng(1)
N, CHANNELS = 400, ("q_radps", "p_radps")


def slopes(**rows: tuple[float, float]) -> np.ndarray:
    """(K, N, 2) independent motion of q and p of given rms [sigma per unit of the parameter]."""
    return np.stack([np.array(sizes) * RNG.normal(size=(N, 2)) for sizes in rows.values()])


def judge(
    motion: np.ndarray, labels: Sequence[str], size: np.ndarray, outputs: Sequence[str]
) -> Excitation:
    """Of one array, in two segments."""
    return of_blocks(
        Blocks.from_segments(np.split(np.moveaxis(motion, 0, 2), [N // 4])), labels, size, outputs
    )


def test_a_parameter_with_little_information_is_held_and_its_neighbour_is_not() -> None:
    labels = ("strong", "weak", "bias/f/q")
    # Standard errors 1 / (rms sqrt(N)): 0.005 and 0.5 of a size of 1.
    result = judge(
        slopes(strong=(10.0, 0.0), weak=(0.1, 0.0), bias=(1.0, 0.0)), labels, np.ones(2), CHANNELS
    )
    assert list(result.fixed) == ["weak"]
    output = re.fullmatch(
        r"not excited: its standard error would be at least (\S+), at most 0\.25 is needed",
        result.fixed["weak"],
    )
    assert output is not None
    assert float(output[1]) == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize(("margin", "constant"), [(1.1, False), (0.9, True)])
def test_the_limit_is_the_smallest_standard_error(margin: float, constant: bool) -> None:
    one = slopes(a=(1.0, 0.0))
    one *= margin * MIN_T / np.sqrt(np.sum(one**2))
    assert ("a" in judge(one, ("a",), np.ones(1), CHANNELS).fixed) == constant


def test_of_two_that_act_alike_one_is_held_and_the_other_estimated() -> None:
    pair = slopes(a=(10.0, 0.0), b=(10.0, 0.0))
    pair[1] = 0.5 * pair[0]
    result = judge(pair, ("a", "b"), np.ones(2), CHANNELS)
    assert result.fixed == {"b": "collinear with a: only a combination can be estimated"}
    difference = slopes(a=(10.0, 0.0), b=(5.0, 0.0))
    assert judge(difference, ("a", "b"), np.ones(2), CHANNELS).fixed == {}


def test_what_is_estimated_beside_takes_information_away() -> None:
    """A parameter that acts as a constant moment cannot be told from that constant."""
    pair = slopes(a=(10.0, 0.0), constant=(10.0, 0.0))
    pair[1] = pair[0]
    assert "a" in judge(pair, ("a", "uq/bias/Clb"), np.ones(1), CHANNELS).fixed
    assert judge(pair[:1], ("a",), np.ones(1), CHANNELS).fixed == {}


def test_one_without_a_size_is_not_held() -> None:
    assert judge(slopes(a=(1e-6, 0.0)), ("a",), np.zeros(1), CHANNELS).fixed == {}


def test_channels_that_no_free_parameter_acts_on_are_left_out() -> None:
    result = judge(slopes(a=(10.0, 1e-3), b=(1e-3, 1e-3)), ("a", "b"), np.ones(2), CHANNELS)
    assert list(result.fixed) == ["b"]
    assert result.left_out == ("p_radps",)
    assert judge(slopes(a=(10.0, 5.0)), ("a",), np.ones(1), CHANNELS).left_out == ()


def test_without_takes_channel_data_and_bias_away() -> None:
    observed = Observed([], CHANNELS, [np.arange(6.0).reshape(3, 2)], ["q_radps", "p_radps"], {})
    less = without_channels(observed, ["q_radps"])
    assert less.outputs == ("p_radps",)
    assert less.biases == ["p_radps"]
    np.testing.assert_array_equal(less.data[0], [[1.0], [3.0], [5.0]])
