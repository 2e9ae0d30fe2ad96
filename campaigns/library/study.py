"""What the programs of all studies share: exit codes, options, rows of tables, commands of
uqharness, one file a seed."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from uqharness.errors import BadInputError, EnginesDifferError
from uqharness.files import PROJECT_ROOT, write_bytes, write_text
from uqharness.text_tables import csv_text


def exit_code(action: Callable[[], int | None]) -> int:
    """Run ``action`` and return its exit code; 2 for bad input, 1 where the engines differ, 130
    when interrupted."""
    try:
        return action() or 0
    except BadInputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except EnginesDifferError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def study_parser(doc: str, out: str | Path = "", seeds: int = 0) -> argparse.ArgumentParser:
    """Make a parser whose help is the module's docstring.

    ``out``: a default folder for --out, or the words that describe a required one; ``seeds``: the
    default number of --seeds.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if isinstance(out, Path):
        parser.add_argument("--out", type=Path, default=out, metavar="DIR")
    elif out:
        parser.add_argument(
            "--out", type=Path, required=True, metavar="DIR", help=f"folder for {out}"
        )
    if seeds:
        words = f"how many from 1 on, or which (default {seeds})"
        parser.add_argument(
            "--seeds", type=seed_range, default=str(seeds), metavar="N|A-B", help=words
        )
    return parser


def seed_range(text: str) -> range:
    """Read ``40`` as 1 to 40 and ``11-20`` as it stands. Raises ValueError."""
    first, _, last = text.partition("-")
    seeds = range(int(first), int(last) + 1) if last else range(1, int(first) + 1)
    if not seeds or seeds.start < 0:
        raise ValueError(f"{text}: a number of seeds or a range A-B is needed")
    return seeds


def log_progress(text: str) -> None:
    """Print a line of progress."""
    print(text, file=sys.stderr, flush=True)


def cells(item: object, columns: str) -> dict[str, str]:
    """Format keys of a mapping, or attributes of an object, as a table's row.

    ``columns``: names with format specs, ``"metric airs slope:.4g"``; a bool becomes yes or no.
    """
    row = {}
    for column in columns.split():
        name, _, spec = column.partition(":")
        value = item[name] if isinstance(item, Mapping) else getattr(item, name)
        row[name] = ("no", "yes")[value] if isinstance(value, bool) else format(value, spec)
    return row


def published_table(number: str, **options: Any) -> pd.DataFrame:
    """Read a printed table, ``"4.7"``; ``options`` of pandas.read_csv. Raises BadInputError where
    it is not there."""
    path = PROJECT_ROOT / "tests" / "reference" / f"table_{number.replace('.', '_')}.csv"
    if not path.is_file():
        raise BadInputError(
            f"{path}: not there; the printed tables come with the project's source, not with the "
            "package"
        )
    return pd.read_csv(path, comment="#", **options)


def write_csv(path: Path, rows: Iterable[Mapping[str, str]]) -> None:
    """Write rows of equal keys, and the folder where it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, csv_text(list(rows)).encode())


def uqharness_command(*words: object, codes: Sequence[int] = (0, 1)) -> str:
    """Run a command of uqharness in this process and return its output. Raises BadInputError at
    other exit codes."""
    from uqharness.cli.main import main

    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = main([str(word) for word in words])
    if code not in codes:
        raise BadInputError(f"{words[0]}: {output.getvalue().strip()}")
    return output.getvalue()


def run_seeds(
    folder: Path, names: Iterable[str], run: Callable[[str], Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Run every name that has no result yet, and return all results in the order of their names.

    A result is a file NAME.json in ``folder``, so that several processes may share it, or an entry
    of ``folder``.json beside it, which holds the results of a finished study.
    """
    packed = folder.with_suffix(".json")
    results = json.loads(packed.read_text(encoding="utf-8")) if packed.exists() else {}
    for name in names:
        path = folder / f"{name}.json"
        if name not in results and not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(run(name)) + "\n")
            log_progress(f"{name} done")
    files = {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*.json")
    }
    return [value for _, value in sorted((results | files).items())]


def failure_lines(failures: Sequence[str], success: str) -> str:
    """List failures, or state success."""
    return "\n" + ("\n".join(f"- fails: {f}" for f in failures) or success) + "\n"
