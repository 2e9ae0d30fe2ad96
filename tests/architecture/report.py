"""Measure how readable the two packages are: ``python -m tests.architecture.report [FOLDER ...]``.

One table is printed, with the value of each measure beside its target: number and median length of
modules, names that say nothing (function words and bare participles), share of docstrings, comments
and import lines, and lines over 100 columns. Without arguments, `sysid` and `uqharness` are
measured. Exit code 1 if a target is missed.
"""

from __future__ import annotations

import ast
import io
import statistics
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

WIDTH = 100
"""Columns of a line."""

VAGUE_WORDS = (
    "acting again alive alone along already anything apart aside ask asked asks away bad bare "
    "begun believed bent beside better beyond both carried come cut doubted drawn earlier else "
    "even everybody everything far felt flown found further given goes gone good held here "
    "hoisted how instead joined judged kept know known lain later least leave left lies "
    "likelier likeliest likely lone look looked lost loud made meant met most named near nearer "
    "nobody nothing now once others own proper put quiet rather rest said say says see seen "
    "settled shown so something sooner spared spoilt spread standing stands started still stood "
    "straight such sunk surer taken tell then there thought together told tried trimmed twice "
    "unnamed want wanted wants what which who whole why within without worse worth worthy "
    "written wrong yet "
)
VAGUE_NAMES = frozenset(VAGUE_WORDS.split())
"""Names that a reader must look up to learn what they hold."""


@dataclass(frozen=True)
class Readability:
    """Measures of a set of modules.

    Attributes
    ----------
    modules : int
        Python files.
    median_lines : float
        Median of their lengths.
    vague_names : Counter
        How often each vague name is bound.
    bindings : int
        All bindings of functions, classes, arguments and variables.
    docstring_share, comment_share, import_share : float
        Shares of the lines.
    wide_lines : int
        Lines over 100 columns.
    """

    modules: int
    median_lines: float
    vague_names: Counter[str]
    bindings: int
    docstring_share: float
    comment_share: float
    import_share: float
    wide_lines: int

    @property
    def vague_per_1000(self) -> float:
        """Vague names in 1000 bindings."""
        return 1000.0 * sum(self.vague_names.values()) / max(self.bindings, 1)


def bindings(tree: ast.Module) -> Iterator[str]:
    """Yield every name that a module binds: functions, classes, arguments, variables, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Attribute):
            yield node.target.attr


def _docstring_lines(tree: ast.Module) -> int:
    """Count the lines of docstrings of modules, classes, functions and attributes."""
    return sum(
        node.end_lineno - node.lineno + 1
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        and node.end_lineno is not None
    )


def _import_lines(tree: ast.Module) -> int:
    """Count the lines of import statements at any depth."""
    return sum(
        node.end_lineno - node.lineno + 1
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom) and node.end_lineno is not None
    )


def _comment_lines(source: str) -> int:
    """Count the lines that hold a comment."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return sum(token.type == tokenize.COMMENT for token in tokens)


def measure(paths: list[Path]) -> Readability:
    """Measure the readability of Python files."""
    lengths: list[int] = []
    vague: Counter[str] = Counter()
    bound = docstrings = comments = imports = wide = 0
    for path in paths:
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        lines = source.splitlines()
        lengths.append(len(lines))
        wide += sum(len(line) > WIDTH for line in lines)
        docstrings += _docstring_lines(tree)
        comments += _comment_lines(source)
        imports += _import_lines(tree)
        for name in bindings(tree):
            bound += 1
            stem = name.strip("_").lower().rstrip("0123456789")
            if stem in VAGUE_NAMES:
                vague[stem] += 1
    total = max(sum(lengths), 1)
    return Readability(
        len(lengths),
        statistics.median(lengths) if lengths else 0.0,
        vague,
        bound,
        docstrings / total,
        comments / total,
        imports / total,
        wide,
    )


def table(result: Readability) -> list[tuple[str, str, str, bool]]:
    """Return rows of (measure, value, target, target met)."""
    return [
        ("modules", f"{result.modules}", "at most 260", result.modules <= 260),
        ("median lines", f"{result.median_lines:g}", "200 or more", result.median_lines >= 200),
        (
            "vague names per 1000",
            f"{result.vague_per_1000:.1f}",
            "at most 3",
            result.vague_per_1000 <= 3.0,
        ),
        (
            "docstrings, share of lines",
            f"{result.docstring_share:.1%}",
            "at least 18 %",
            result.docstring_share >= 0.18,
        ),
        (
            "comments, share of lines",
            f"{result.comment_share:.1%}",
            "at least 3 %",
            result.comment_share >= 0.03,
        ),
        (
            "import lines, share of lines",
            f"{result.import_share:.1%}",
            "at most 4 %",
            result.import_share <= 0.04,
        ),
        (f"lines over {WIDTH} columns", f"{result.wide_lines}", "0", result.wide_lines == 0),
    ]


def main(folders: list[str]) -> int:
    """Print the table for Python files below the folders; return the exit code."""
    paths = [path for folder in folders for path in sorted(Path(folder).rglob("*.py"))]
    if not paths:
        print(f"no Python file below {', '.join(folders)}", file=sys.stderr)
        return 2
    result = measure(paths)
    for name, value, target, met in table(result):
        print(f"{name:<30} {value:>8}   {target:<14} {'' if met else 'missed'}")
    common = ", ".join(f"{name} {count}" for name, count in result.vague_names.most_common(12))
    print(f"most frequent vague names: {common or 'none'}")
    return 0 if all(row[-1] for row in table(result)) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["sysid", "uqharness"]))
