"""Tables against JSBSim: random grids and keys, on breakpoints, between and beyond; and
refusals.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_against import compared, same_bits, translated
from uqharness.errors import BadInputError

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
        (f"<table>{ROW}<tableData>\n</tableData></table>", "no numbers"),
        (f"<table>{ROW}{ROW}<tableData>\n1 2\n</tableData></table>", "allowed once"),
        ("<table><tableData>\n1 2\n</tableData></table>", "no independentVar"),
        (f'<table type="internal">{ROW}<tableData>\n1 2\n</tableData></table>', "attribute 'type'"),
        (
            f"<table>{ROW.replace('i/x', '<p>i/x</p>')}<tableData>\n1 2\n</tableData></table>",
            "which JSBSim ignores",
        ),
        (
            f"<table>{ROW.replace('i/x', 'i/unknown')}<tableData>\n1 2\n</tableData></table>",
            "i/unknown is not computed",
        ),
    ],
)
def test_refusals_have_file_and_line(table: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message) as error:
        translated({"t": "\n\n" + table}, {"i/x": np.zeros(1)})
    assert str(error.value).startswith("functions.xml:3: ")
