"""Transcendental functions: errors against mpmath, special values, and the same bits at every
width.

``BATCH_POINTS=150000 pytest tests/uqharness/batch/form/test_maths.py`` measures at more points (13
functions, some two minutes)."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from tests.helpers.batch_accuracy import POINTS, errors, lowered, values
from tests.helpers.batch_against import same_bits
from tests.helpers.batch_digest import digest, function, points
from tests.helpers.few import few
from uqharness.batch.ir import TRANSCENDENTAL, Builder, evaluate
from uqharness.batch.llvm import compile_function, targets
from uqharness.batch.maths import fold, lower

COUNT = int(os.environ.get("BATCH_POINTS", "8000"))
INF, NAN = math.inf, math.nan
SPECIAL = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    INF,
    -INF,
    NAN,
    5e-324,
    -5e-324,
    2.0**-1022,
    1.7976931348623157e308,
    -1.7976931348623157e308,
]
SPECIAL += [
    0.5,
    -0.5,
    2.0,
    -2.0,
    3.0,
    -3.0,
    1e-300,
    1e300,
    2.0**53,
    2.0**53 + 2,
    1 - 2.0**-53,
    1 + 2.0**-52,
    709.782712893384,
    -745.14,
    -708.5,
]
ALLOWED = 1.5
"""Units in the last place; the largest measured at 40,000 points is 1.37, of atan2."""


@pytest.mark.parametrize("operation", few(POINTS, 7))
def test_errors_are_below_two_ulp(operation: str) -> None:
    points = POINTS[operation](np.random.default_rng(11), COUNT)
    found = errors(operation, points, values(operation, points))
    assert found.max() <= (0.0 if operation == "fmod" else ALLOWED)


@pytest.mark.parametrize("exponent", [2.0, 0.5, 3.0, 4.0, -1.0, 1.0, 0.0])
def test_short_powers(exponent: float) -> None:
    x = np.random.default_rng(3).uniform(0.01, 30, 20_000)
    points = (x, np.full(len(x), exponent))
    assert errors("pow", points, values("pow", (x,), exponent)).max() <= {3.0: 1.5, 4.0: 2.0}.get(
        exponent, 0.5
    )


def test_the_measure_says_no_to_an_error() -> None:
    points = POINTS["sin"](np.random.default_rng(1), 400)
    off = np.nextafter(np.nextafter(values("sin", points), 2), 2)
    assert np.mean(errors("sin", points, off) > ALLOWED) > 0.5


def _python(operation: str, *a: float) -> float:
    """C99's answer by Python's math, which raises where C returns infinity or NaN."""
    if operation in ("log", "log2", "log10") and a[0] == 0:
        return -INF
    if operation == "pow" and a[0] == 0 and a[1] < 0:
        odd = math.isfinite(a[1]) and a[1] % 2 == 1
        return math.copysign(INF, a[0]) if odd else INF
    try:
        return float(getattr(math, operation)(*a))
    except ValueError:
        return NAN
    except OverflowError:
        return -INF if operation == "pow" and a[0] < 0 and a[1] % 2 == 1 else INF


@pytest.mark.parametrize("operation", TRANSCENDENTAL)
def test_special_values_are_those_of_c99(operation: str) -> None:
    pairs = (
        [(x, y) for x in SPECIAL for y in SPECIAL]
        if TRANSCENDENTAL[operation] == 2
        else [(x,) for x in SPECIAL]
    )
    if operation in ("sin", "cos", "tan"):
        pairs = [p for p in pairs if not abs(p[0]) > 1.6e6 or math.isinf(p[0])]
    if operation == "fmod":
        pairs = [
            p for p in pairs if not (p[1] and math.isfinite(p[0]) and abs(p[0] / p[1]) >= 2.0**50)
        ]
    points = tuple(np.array(column) for column in zip(*pairs, strict=True))
    got = values(operation, points)
    wanted = np.array([_python(operation, *p) for p in pairs])
    rough = np.isfinite(wanted) & (wanted != 0) & np.isfinite(got)
    with np.errstate(all="ignore"):
        fine = np.where(
            rough, np.abs(got - wanted) <= 2 * np.spacing(np.abs(wanted)), same_bits(got, wanted)
        )
    assert [
        (p, g, w)
        for p, g, w, f in zip(pairs, got.tolist(), wanted.tolist(), fine, strict=True)
        if not f
    ] == []


def test_beyond_the_limits_there_is_no_number() -> None:
    assert np.isnan(values("sin", (np.array([1.7e6, -1e300]),))).all()
    assert np.isnan(values("fmod", (np.array([1e300]), np.array([3.0])))).all()


@pytest.mark.parametrize("operation", TRANSCENDENTAL)
def test_every_width_has_the_bits_of_numpy(operation: str) -> None:
    points = POINTS[operation](np.random.default_rng(5), 20_000)
    special = [(x, y) for x in SPECIAL for y in SPECIAL]
    points = tuple(
        np.concatenate([p, column])
        for p, column in zip(points, zip(*special, strict=True), strict=False)
    )
    function = lowered(operation)
    inputs = dict(zip("xy", points, strict=False))
    reference = evaluate(function, inputs)[0]["r"]
    for name, target in targets().items():
        kernel = compile_function(function, target)
        assert "vfm" not in kernel.assembly, name
        assert same_bits(kernel(inputs)[0]["r"], reference).all(), name


def test_constants_are_folded_to_the_same_bits() -> None:
    rng = np.random.default_rng(2)
    for operation, count in TRANSCENDENTAL.items():
        numbers = rng.uniform(0.1, 0.9, (30, count))
        b = Builder()
        outputs = {str(k): b.op(operation, *row.tolist()) for k, row in enumerate(numbers)}
        function = lower(b.finish(outputs))
        assert set(function.counts()) == {"const"}
        got = np.array([function.nodes[i].value for i in function.outputs.values()])
        # The exponent is constant here: those of 0.5 and 2 are short, the others go the general
        # way.
        assert same_bits(
            got, values(operation, tuple(np.ascontiguousarray(c) for c in numbers.T))
        ).all()


DIGEST = "5195305f7f94ecf2b7df077e4bd23eb2fe19e7e812f4000a10d87d455a51eabc"
"""Of tests.helpers.batch_digest, made on an AMD EPYC with AVX-512."""


def test_the_digest_is_that_of_another_machine() -> None:
    assert digest(evaluate(function(), points())[0]) == DIGEST
    for name, target in targets().items():
        assert digest(compile_function(function(), target)(points())[0]) == DIGEST, name


def test_numpys_processor_features_do_not_matter() -> None:
    environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": _present_features()}
    child = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "tests.helpers.batch_digest"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert child.stdout.strip() == DIGEST


def _present_features() -> str:
    """What numpy can be told to leave out on this processor."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    return " ".join(f for f in __cpu_dispatch__ if __cpu_features__.get(f))


def test_constant_arguments_fold_to_the_bits_of_the_expansion():
    for name, arguments in (("sin", [0.3]), ("atan2", [0.0, -1.0]), ("pow", [2.0, 0.5])):
        b = Builder()
        inputs = [b.input(str(k)) for k in range(len(arguments))]
        function = lower(b.finish({"r": b.op(name, *inputs)}))
        given = {str(k): np.array([x]) for k, x in enumerate(arguments)}
        assert fold(name, arguments) == evaluate(function, given)[0]["r"][0]
    # Zeros of either sign are told apart.
    assert (fold("atan2", [0.0, -1.0]), fold("atan2", [-0.0, -1.0])) == (math.pi, -math.pi)
    assert fold("sin", [None]) is None
    assert fold("atan2", [None, 1.0]) is None
    # One known argument may decide.
    assert fold("pow", [None, 0.0]) == 1.0
