"""Functions and tables against JSBSim: every operation, random trees and grids, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_against import (
    EXACT,
    ROTATIONS,
    TRANSCENDENTAL,
    arguments,
    compared,
    same_bits,
    translated,
    ulps,
)
from uqharness.batch.ir import Builder, evaluate
from uqharness.batch.llvm import compile_function, targets
from uqharness.batch.translate.frame import Scope
from uqharness.batch.translate.functions import function_value
from uqharness.errors import BadInputError
from uqharness.xml.document import parse_document

ROWS = 5000


def test_ieee_operations_have_jsbsims_bits() -> None:
    theirs, ours = compared(EXACT, arguments(ROWS))
    assert {
        name: float(np.mean(same_bits(theirs[name], ours[name]))) for name in EXACT
    } == dict.fromkeys(EXACT, 1.0)


def test_transcendental_operations_are_within_two_ulp() -> None:
    theirs, ours = compared(TRANSCENDENTAL, arguments(ROWS))
    worst = {name: float(ulps(theirs[name], ours[name]).max()) for name in TRANSCENDENTAL}
    assert {name: w for name, w in worst.items() if w > 2.0} == {}


def test_rotations_agree_to_rounding() -> None:
    theirs, ours = compared(ROTATIONS, arguments(ROWS))
    for name in ROTATIONS:
        # gamma is the angle of two numbers that may both be small.
        allowed = 1e-12 if "gamma" in name else 1e-15
        assert np.abs(theirs[name] - ours[name]).max() <= allowed * np.abs(theirs[name]).max(), name


def test_a_changed_constant_is_noticed() -> None:
    inputs = arguments(1000)
    theirs, _ = compared({"f": "<sum><p>i/a</p><v>0.1</v></sum>"}, inputs)
    _, ours = compared({"f": "<sum><p>i/a</p><v>0.100000000000001</v></sum>"}, inputs)
    assert np.mean(~same_bits(theirs["f"], ours["f"])) > 0.5


def _tree(rng: np.random.Generator, depth: int) -> str:
    """A random tree of operations that JSBSim computes exactly."""
    if depth == 0 or rng.random() < 0.15:
        leaf = rng.integers(0, 4)
        return (
            f"<v>{rng.normal():.6g}</v>"
            if leaf == 3
            else f"<p>{'-' if rng.random() < 0.2 else ''}i/{'abc'[leaf]}</p>"
        )
    tag = rng.choice(
        [
            "sum",
            "product",
            "difference",
            "quotient",
            "min",
            "max",
            "avg",
            "abs",
            "floor",
            "ifthen",
            "fraction",
            "toradians",
            "sqrt",
        ]
    )
    count = {
        "quotient": 2,
        "abs": 1,
        "floor": 1,
        "fraction": 1,
        "toradians": 1,
        "sqrt": 1,
        "ifthen": 2,
    }.get(tag, int(rng.integers(2, 5)))
    parts = "".join(_tree(rng, depth - 1) for _ in range(count))
    if tag == "ifthen":
        test = rng.choice(["lt", "le", "gt", "ge", "eq", "nq"])
        parts = f"<{test}>{_tree(rng, depth - 1)}{_tree(rng, depth - 1)}</{test}>" + parts
    return f"<{tag}>{parts}</{tag}>"


def test_random_trees_have_jsbsims_bits_in_compiled_code() -> None:
    rng = np.random.default_rng(7)
    functions = {f"t{k}": _tree(rng, 5) for k in range(30)}
    inputs = arguments(800)
    theirs, ours = compared(functions, inputs)
    assert {n: float(np.mean(same_bits(theirs[n], ours[n]))) for n in functions} == dict.fromkeys(
        functions, 1.0
    )
    function = translated(functions, inputs)
    for target in targets().values():
        result, _ = compile_function(function, target)(inputs)
        assert all(same_bits(result[n], ours[n]).all() for n in functions), target


def test_draws_are_standard_draws_scaled() -> None:
    tags = {
        "plain": "random",
        "scaled": 'random mean="1.7" stddev="0.3"',
        "mean": 'random mean="0.4"',
        "sd": 'random stddev="0.6"',
    }
    uniform = {
        "unit": 'urandom lower="0" upper="1"',
        "none": "urandom",
        "wide": 'urandom lower="-0.3" upper="7.1"',
        "low": 'urandom lower="0.2"',
    }
    functions = {name: f'<{tag} seed="5"/>' for name, tag in (tags | uniform).items()}
    rows = {"i/a": np.zeros(300)}
    theirs = oracle.evaluate({f"o/{name}": body for name, body in functions.items()}, rows)
    builder = Builder()
    outputs = {}
    for name, body in functions.items():
        document = parse_document(Path("f.xml"), f"<function>{body}</function>".encode())
        scope = Scope(builder, document, lambda _: None, lambda node: builder.input(node.tag))
        outputs[name] = function_value(scope, document.root)
    ours, _ = evaluate(
        builder.finish(outputs), {"random": theirs["o/plain"], "urandom": theirs["o/none"]}
    )
    for name in functions:
        assert same_bits(ours[name], theirs[f"o/{name}"]).all(), name


def test_what_ends_jsbsims_flight_is_nan() -> None:
    inputs = {"i/a": np.array([0.0, 1.0, 2.0, -1.0, np.nan, 0.5, 1.0000000015])}
    functions = {
        "not": "<not><p>i/a</p></not>",
        "ifthen": "<ifthen><p>i/a</p><v>5</v><v>6</v></ifthen>",
        "and": "<and><p>i/a</p><v>0</v></and>",
        "and after": "<and><v>0</v><p>i/a</p></and>",
        "switch": "<switch><p>i/a</p><v>5</v><v>6</v></switch>",
        "mod": "<mod><v>5</v><p>i/a</p></mod>",
    }
    function = translated(functions, inputs)
    result, _ = compile_function(function, targets()["sse2"])(inputs)
    nan = np.nan
    expected = {
        "not": [1, 0, nan, 0, nan, 0, nan],
        "ifthen": [6, 5, nan, 5, nan, 5, nan],
        "and": [0, 0, nan, 0, nan, 0, nan],
        "and after": [0, 0, 0, 0, 0, 0, 0],
        "switch": [5, 6, nan, nan, nan, 6, 6],
        "mod": [nan, 0, 1, 0, nan, nan, 0],
    }
    for name, row in expected.items():
        np.testing.assert_array_equal(result[name], np.array(row, dtype=float), err_msg=name)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<random/>", "<random> draws"),
        ("<v>0x10</v>", "finite decimal number"),
        ("<v>1e400</v>", "finite decimal number"),
        ("<p>i/nothing</p>", "property i/nothing is not computed"),
        ('<sum unit="FT"><v>1</v><v>2</v></sum>', "attribute 'unit'"),
        ("<quotient><v>1</v></quotient>", "takes 2 arguments; received 1"),
    ],
)
def test_refusals_have_file_and_line(body: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message) as error:
        translated({"f": body}, {"i/a": np.zeros(1)})
    assert str(error.value).startswith("functions.xml:1: ")


KEYS = ("i/x", "i/y", "i/z")


def _points(rng: np.random.Generator, count: int) -> list[float]:
    return np.sort(rng.normal(size=count)).tolist()


def _lines(rng: np.random.Generator, rows: list[float], columns: list[float]) -> str:
    head = " ".join(map(repr, columns)) + "\n" if columns else ""
    return (
        head
        + "\n".join(
            " ".join(map(repr, [x, *rng.normal(size=max(1, len(columns))).tolist()])) for x in rows
        )
        + "\n"
    )


def _table(rng: np.random.Generator, points: list[list[float]]) -> str:
    axes = zip(("row", "column", "table"), KEYS, strict=False)
    heads = "".join(
        f'<independentVar lookup="{a}">{k}</independentVar>'
        for (a, k), _ in zip(axes, points, strict=False)
    )
    columns = points[1] if len(points) > 1 else []
    if len(points) < 3:
        return f"<table>{heads}<tableData>\n{_lines(rng, points[0], columns)}</tableData></table>"
    parts = [
        f'<tableData breakPoint="{b!r}">\n{_lines(rng, points[0], columns)}</tableData>'
        for b in points[2]
    ]
    return f"<table>{heads}{''.join(parts)}</table>"


def _keys(rng: np.random.Generator, points: list[list[float]], rows: int) -> np.ndarray:
    out = rng.normal(size=rows) * 1.5
    chosen = rng.choice(np.concatenate(points), rows // 3)
    out[rng.permutation(rows)[: len(chosen)]] = chosen
    return out


SIZES = [
    (1,),
    (2,),
    (3,),
    (12,),
    (1, 3),
    (3, 1),
    (2, 2),
    (7, 5),
    (4, 9),
    (2, 2, 2),
    (4, 3, 5),
    (1, 2, 3),
    (3, 1, 2),
]


SIZES += [(24,), (25,), (26,), (33,), (90,), (40, 3), (30, 30), (2, 26), (27, 2, 2)]


@pytest.mark.parametrize("seed", range(2))
def test_tables_have_jsbsims_bits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grids = [[_points(rng, n) for n in size] for size in SIZES]
    functions = {str(size): _table(rng, points) for size, points in zip(SIZES, grids, strict=True)}
    keys = {
        name: _keys(rng, [p[axis] for p in grids if len(p) > axis], 4000)
        for axis, name in enumerate(KEYS)
    }
    keys["i/x"][:5] = np.nan
    theirs, ours = compared(functions, keys)
    shares = {name: float(np.mean(same_bits(theirs[name], ours[name]))) for name in functions}
    assert shares == dict.fromkeys(functions, 1.0)


def test_a_changed_number_is_noticed() -> None:
    rng = np.random.default_rng(5)
    points = [_points(rng, 4), _points(rng, 3)]
    body = _table(rng, points)
    keys = {name: _keys(rng, points, 1000) for name in KEYS}
    word = body.split("<tableData>")[1].split()[5]
    changed = body.replace(word, repr(float(word) * (1 + 1e-12)))
    theirs, _ = compared({"t": body}, keys)
    _, ours = compared({"t": changed}, keys)
    assert 0.05 < np.mean(~same_bits(theirs["t"], ours["t"])) < 0.95


def test_a_nan_key_is_nan() -> None:
    body = _table(np.random.default_rng(1), [[0.0, 1.0], [0.0, 1.0]])
    keys = {"i/x": np.array([0.5, np.nan]), "i/y": np.array([np.nan, 0.5]), "i/z": np.zeros(2)}
    theirs, ours = compared({"t": body}, keys)
    assert np.isnan(theirs["t"]).all()
    assert np.isnan(ours["t"]).all()


ROW = '<independentVar lookup="row">i/x</independentVar>'


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (f"<table>{ROW}<tableData>\n1 2\n1 3\n</tableData></table>", "must increase"),
        (f"<table>{ROW}<tableData>\n1 2\n2\n</tableData></table>", "has 2 numbers; received 1"),
        (
            f"<table>{ROW}<tableData>\n1 x\n</tableData></table>",
            "finite decimal number; received 'x'",
        ),
        (f'<table type="internal">{ROW}<tableData>\n1 2\n</tableData></table>', "attribute 'type'"),
        (
            f"<table>{ROW.replace('i/x', '<p>i/x</p>')}<tableData>\n1 2\n</tableData></table>",
            "which JSBSim ignores",
        ),
    ],
)
def test_refusals_have_file_and_line_of_tables(table: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message) as error:
        translated({"t": "\n\n" + table}, {"i/x": np.zeros(1)})
    assert str(error.value).startswith("functions.xml:3: ")
