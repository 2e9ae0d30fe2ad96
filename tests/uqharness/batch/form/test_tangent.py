"""Tangents against central differences and against mpmath's derivatives, one direction and several,
with state.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uqharness.batch.interpret import run_program
from uqharness.batch.ir import TRANSCENDENTAL, Builder, evaluate
from uqharness.batch.maths import lower
from uqharness.batch.program import Feed, Program, Section, Stream, When, initial_state
from uqharness.batch.tangent import rate_name, tangent, tangent_program

UNARY = [
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "exp",
    "log",
    "log2",
    "log10",
    "sqrt",
    "abs",
    "neg",
]
BINARY = ["add", "sub", "mul", "div", "atan2", "pow", "fmod", "min", "max"]


@pytest.mark.parametrize("operation", UNARY + BINARY)
def test_derivatives_are_those_of_central_differences(operation: str) -> None:
    b = Builder()
    names = ["x", "y"][: 2 if operation in BINARY else 1]
    function = b.finish({"r": b.op(operation, *(b.input(n) for n in names))})
    rng = np.random.default_rng(4)
    at = {"x": rng.uniform(0.1, 0.9, 400), "y": rng.uniform(1.1, 3.0, 400)}
    plain, with_rates = lower(function), lower(tangent(function, ["d", "e"], names))
    directions = {d: {n: rng.normal(size=400) for n in names} for d in "de"}
    given = {rate_name(n, d): v for d, row in directions.items() for n, v in row.items()}
    got, _ = evaluate(with_rates, {**at, **given})
    h = 1e-6
    for d, row in directions.items():
        up, _ = evaluate(plain, {n: at[n] + h * row.get(n, 0.0) for n in names})
        down, _ = evaluate(plain, {n: at[n] - h * row.get(n, 0.0) for n in names})
        np.testing.assert_allclose(
            got[rate_name("r", d)], (up["r"] - down["r"]) / (2 * h), rtol=2e-8, atol=2e-8
        )


def test_the_state_carries_derivatives_from_frame_to_frame() -> None:
    b = Builder()
    k = b.input("k")
    b.store("s", b.load("s") * k + b.op("sin", b.load("s")))
    function = lower(tangent(b.finish({}), ["k"], ["k"]))
    state = {"s": np.array([0.3]), rate_name("s", "k"): np.zeros(1)}
    for _ in range(20):
        _, state = evaluate(
            function, {"k": np.array([0.5]), rate_name("k", "k"): np.ones(1)}, state
        )

    def run(k: float) -> float:
        s = 0.3
        for _ in range(20):
            s = s * k + np.sin(s)
        return float(s)

    difference = (run(0.5 + 1e-6) - run(0.5 - 1e-6)) / 2e-6
    assert state[rate_name("s", "k")][0] == pytest.approx(difference, rel=1e-7)


def test_what_does_not_depend_on_the_input_costs_nothing() -> None:
    b = Builder()
    x, y = b.input("x"), b.input("y")
    function = tangent(b.finish({"a": x * 3.0, "b": b.op("pow", y, 2.5)}), ["x"], ["x"])
    assert "log" not in function.counts()
    assert function.counts()["pow"] == 1


def test_selected_branches_and_bits() -> None:
    b = Builder()
    x = b.input("x")
    function = b.finish({"r": x.lt(0.0).choose(x * x, x * 5.0), "n": b.op("floor", x)})
    got, _ = evaluate(
        tangent(function, ["d"], ["x"]),
        {"x": np.array([-2.0, 3.0]), rate_name("x", "d"): np.ones(2)},
    )
    assert got[rate_name("r", "d")].tolist() == [-4.0, 5.0]
    assert got[rate_name("n", "d")].tolist() == [0.0, 0.0]
    with pytest.raises(ValueError, match=r"before form\.maths\.lower"):
        tangent(lower(b.finish({"r": b.op("sin", x)})), ["d"], ["x"])


def test_every_transcendental_has_a_derivative() -> None:
    assert set(TRANSCENDENTAL) <= set(UNARY + BINARY)


def test_numbers_of_a_table_do_not_change_with_the_index() -> None:
    b = Builder()
    x = b.input("x")
    picked = b.op("lookup", b.table([2.0, 5.0]), b.op("floor", x))
    got, _ = evaluate(
        tangent(b.finish({"r": picked * x}), ["d"], ["x"]),
        {"x": np.array([0.5, 1.5]), rate_name("x", "d"): np.ones(2)},
    )
    assert got[rate_name("r", "d")].tolist() == [2.0, 5.0]


def _swinging() -> Program:
    """A forced pendulum with a parameter, a part at half the rate, one in lanes that swing far, and
    slots that do not depend.
    """
    motion, slow, far = Builder(), Builder(), Builder()
    angle, rate = motion.load("angle"), motion.load("rate")
    faster = (
        rate
        + (
            -motion.op("sin", angle) * motion.load("stiffness")
            - 0.1 * rate
            + motion.load("wind")
            + motion.load("held")
        )
        * 0.05
    )
    motion.store("rate", faster)
    motion.store("angle", angle + faster * 0.05)
    motion.store("is far", angle.gt(0.4).choose(1.0, 0.0))
    motion.store("clock", motion.load("clock") + 0.05)
    slow.store("held", slow.load("angle") * slow.load("stiffness") * 0.1)
    far.store("rate", far.load("rate") * far.load("drag"))
    sections = (
        Section("motion", motion.finish({})),
        Section("slow", slow.finish({}), When(every=2)),
        Section("far", far.finish({}), When(mask="is far")),
    )
    slots = {
        "angle": 0.5,
        "rate": 0.0,
        "stiffness": 2.0,
        "wind": 0.0,
        "held": 0.0,
        "is far": 0.0,
        "clock": 0.0,
        "drag": 0.98,
    }
    return Program(sections, slots, (Stream("air", ("wind",)),), ("angle", "clock"))


def test_a_flights_derivatives_are_those_of_central_differences() -> None:
    program = _swinging()
    directions = {"k": {"stiffness": 1.0}, "drag": {"drag": 1.0}, "start": {"angle": 1.0}}
    changed = tangent_program(program, directions)
    air = {
        "air": Feed(np.random.default_rng(1).normal(size=(80, 1)), 0, np.zeros(4, dtype=np.int64))
    }
    start = {"angle": np.array([0.5, 0.1, -0.7, 1.2])}
    made = run_program(changed, initial_state(changed, 4, start), 1, 80, air)[:, :4]
    plain = run_program(program, initial_state(program, 4, start), 1, 80, air)[:, :4]
    assert np.array_equal(made[:2], plain)
    for k, (direction, begins) in enumerate(directions.items()):
        assert changed.records[2 + 2 * k] == rate_name("angle", direction)
        name = next(iter(begins))
        ends = []
        for h in (1e-6, -1e-6):
            values = {**start, name: start.get(name, np.full(4, program.slots[name])) + h}
            ends.append(run_program(program, initial_state(program, 4, values), 1, 80, air)[0, :4])
        np.testing.assert_allclose(
            made[2 + 2 * k], (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-7
        )
        assert np.abs(made[2 + 2 * k]).max() > 0.01
        assert not made[3 + 2 * k].any()


def test_slots_that_a_direction_does_not_reach_have_no_derivative() -> None:
    changed = tangent_program(_swinging(), {"d": {"drag": 1.0}})
    assert set(changed.slots) - set(_swinging().slots) == {
        rate_name(s, "d") for s in ("angle", "rate", "held", "is far", "drag", "clock")
    }
    assert rate_name("clock", "d") not in changed.sections[0].function.slots
    with pytest.raises(ValueError, match="direction d: the program has no slot nothing"):
        tangent_program(_swinging(), {"d": {"nothing": 1.0}})
    with pytest.raises(ValueError, match="before what never changes"):
        tangent_program(replace(_swinging(), prelude=Builder().finish({})), {"d": {"drag": 1.0}})
