"""A plain table of derivatives, TOML or CSV: textbook, DATCOM, wind tunnel.

Each row has a name, a value, a unit and a source. Names are ``S b c x_ref y_ref z_ref x_cg x_np
alpha mach axes rate_axes`` and coefficients with their variable: ``CL_alpha``, ``Cm_0``,
``Cn_rudder``, "CL_flap", and "CD_gear" for the extended gear. ``ground_lift`` is the factor of
the lift at ``h_over_b``, height over span. A CSV file has the columns name, value, unit and, where
wanted, source, alpha_deg and h_over_b; rows without an alpha hold at every alpha. A TOML file has
``[reference]``, ``[condition]``, ``[derivatives]`` with ``CL_alpha = { value = 4.6, unit = "1/rad",
source = "..." }``, or a number, which is in SI and per radian, and ``[ground_effect]``.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from sysid.foreign.regular_files import ParseError, parse_toml
from sysid.units import FT_M, IN_M
from uqharness.authoring.source import (
    BODY,
    LARGEST,
    STABILITY,
    STATES,
    TOTAL,
    Axes,
    Entry,
    Point,
    Source,
)
from uqharness.errors import BadInputError
from uqharness.toml import line_of

_UNITS = {
    "": 1.0,
    "1": 1.0,
    "-": 1.0,
    "1/rad": 1.0,
    "rad": 1.0,
    "1/deg": math.degrees(1.0),
    "deg": math.radians(1.0),
    "m": 1.0,
    "m2": 1.0,
    "ft": FT_M,
    "ft2": FT_M**2,
    "in": IN_M,
    "in2": IN_M**2,
    "mm": 1e-3,
    "cm": 1e-2,
}
_LENGTHS = {"S": "S", "b": "b", "c": "c", "x_ref": "x", "y_ref": "y", "z_ref": "z"}
_GROUND = "ground_lift"
"""Factor of the lift near the ground; its rows have a height over the span."""
_FACTS = ("x_np", "x_cg", "e")
_SURFACES = {
    "de": "elevator",
    "da": "aileron",
    "dr": "rudder",
    "df": "flap",
    "elevator": "elevator",
    "aileron": "aileron",
    "rudder": "rudder",
}
_VARIABLES = {"a": "alpha", "b": "beta"} | {name: name for name in (*STATES, TOTAL)}


@dataclass(frozen=True)
class _Row:
    """One row: alpha is NaN where the row holds at every alpha."""

    name: str
    value: float | str
    unit: str
    line: int
    alpha: float = math.nan
    height: float = math.nan


def read_table_file(path: Path, text: str) -> Source:
    """Read a table of derivatives; the suffix tells TOML from CSV.

    Raises
    ------
    BadInputError
        With file and line: an unknown name or unit, a value that is no number, a coefficient of
        the other axes, a missing reference.
    """
    # Texts first: they tell the axes in which the numbers are.
    rows = list(_toml_rows(path, text) if path.suffix.lower() == ".toml" else _csv_rows(path, text))
    texts = {row.name: row for row in rows if isinstance(row.value, str)}
    axes = _axes(path, texts.get("axes"), _guess_axes(rows))
    rate_axes = _axes(path, texts.get("rate_axes"), axes)
    names = STABILITY if axes == "stability" else BODY
    reference: dict[str, Entry] = {}
    facts: dict[str, Entry] = {}
    condition = {"alpha": Entry(0.0, path), "mach": Entry(0.0, path)}
    entries: dict[float, dict[tuple[str, str], Entry]] = {}
    ground: dict[float, float] = {}
    surfaces: list[str] = []
    for row in rows:
        if isinstance(row.value, str):
            continue
        # Every number is converted to SI and radians with its line kept.
        unit = _plain_unit(row.unit)
        if unit not in _UNITS:
            allowed = ", ".join(unit for unit in _UNITS if unit)
            raise BadInputError(
                f"{path}:{row.line}: {row.name}: unit {row.unit!r}; allowed are {allowed}"
            )
        entry = Entry(row.value * _UNITS[unit], path, row.line)
        coefficient, _, variable = row.name.partition("_")
        # The name tells what a row is: reference length, fact, condition, or coefficient.
        if row.name in _LENGTHS:
            reference[_LENGTHS[row.name]] = entry
        elif row.name in _FACTS:
            facts[row.name] = entry
        elif row.name in condition:
            condition[row.name] = entry
        elif row.name == _GROUND:
            ground[row.height] = row.value
        elif coefficient in (*BODY, *STABILITY):
            if coefficient not in names:
                raise BadInputError(
                    f"{path}:{row.line}: {row.name}: axes are {axes}, which have"
                    f" {', '.join(names)}; rotate it or change axes"
                )
            key = _VARIABLES.get(variable) or _SURFACES.get(variable, variable)
            if not re.fullmatch(r"\w+", key):
                raise BadInputError(
                    f"{path}:{row.line}: {row.name}: a variable is needed, such as CL_alpha, CL_0"
                )
            if key not in (TOTAL, *STATES) and key not in surfaces:
                surfaces.append(key)
            entries.setdefault(row.alpha, {})[coefficient, key] = entry
        else:
            raise BadInputError(
                f"{path}:{row.line}: unknown name {row.name!r}; allowed are"
                f" {', '.join((*_LENGTHS, *_FACTS, *condition, 'axes', 'rate_axes'))} and"
                " coefficients such as CL_alpha"
            )
    if not entries:
        raise BadInputError(f"{path}: holds no coefficient")
    return Source(
        path=path,
        tool="table",
        name=str(texts["name"].value) if "name" in texts else path.stem,
        reference={key: Entry(0.0, path) for key in "xyz"} | reference,
        points=_points(entries, condition, axes, rate_axes),
        surfaces=tuple(surfaces),
        facts=facts,
        ground=_checked_ground(path, ground),
    )


def _plain_unit(unit: str) -> str:
    """Return a unit as `_UNITS` spells it.

    >>> _plain_unit("rad^-1"), _plain_unit("per degree"), _plain_unit("m²"), _plain_unit("sq ft")
    ('1/rad', '1/deg', 'm2', 'ft2')
    """
    text = unit.strip().lower().replace("²", "2").replace("^", "").replace("°", "deg")
    text = re.sub(r"\bsq\.? ?(m|ft|in)\b", r"\g<1>2", text)
    text = re.sub(r"radians?", "rad", re.sub(r"degrees?", "deg", text))
    text = re.sub(r"^(?:per |1 ?/ ?|/)(rad|deg)$|^(rad|deg) ?-1$", r"1/\1\2", text)
    return {"inch": "in", "feet": "ft", "metre": "m", "meter": "m", "none": ""}.get(text, text)


def _checked_ground(
    path: Path, ground: dict[float, float]
) -> tuple[tuple[float, float], ...] | None:
    """Return the rows of the ground effect in order of height."""
    if not ground:
        return None
    if len(ground) < 2 or any(math.isnan(h) or h < 0.0 for h in ground):
        raise BadInputError(
            f"{path}: {_GROUND}: at least two rows with an h_over_b of 0 or more are needed"
        )
    return tuple(sorted(ground.items()))


def _points(
    entries: dict[float, dict[tuple[str, str], Entry]],
    condition: dict[str, Entry],
    axes: Axes,
    rate_axes: Axes,
) -> tuple[Point, ...]:
    """Return a point at each alpha; rows without an alpha stand in all.

    A total of a table with one alpha stands at alpha = 0, as textbooks define CL_0 and Cm_0; with
    several it is the total at each.
    """
    shared = next((rows for alpha, rows in entries.items() if math.isnan(alpha)), {})
    alphas = sorted(alpha for alpha in entries if not math.isnan(alpha))
    if alphas:
        return tuple(
            Point(Entry(alpha), condition["mach"], axes, rate_axes, shared | entries[alpha])
            for alpha in alphas
        )
    alpha = condition["alpha"]
    moved = dict(shared)
    for (name, variable), entry in shared.items():
        slope = shared.get((name, "alpha"))
        if variable == TOTAL and slope is not None:
            value = entry.value + slope.value * alpha.value
            moved[name, variable] = Entry(value, entry.path, entry.line)
    return (Point(alpha, condition["mach"], axes, rate_axes, moved),)


def _guess_axes(rows: list[_Row]) -> Axes:
    """Return body axes where the table has CX or CZ."""
    names = {row.name.partition("_")[0] for row in rows}
    return "body" if names & {"CX", "CZ"} else "stability"


def _axes(path: Path, row: _Row | None, default: Axes) -> Axes:
    """Return stated axes."""
    if row is None:
        return default
    if row.value == "body":
        return "body"
    if row.value == "stability":
        return "stability"
    raise BadInputError(
        f"{path}:{row.line}: {row.name} = {row.value!r}; allowed are stability and body"
    )


def _toml_rows(path: Path, text: str) -> Iterator[_Row]:
    """Yield the rows of a TOML file."""
    try:
        document = parse_toml(text)
    except ParseError as error:
        raise BadInputError(f"{path}:{error.line or 1}: {error}") from None
    allowed = ("aircraft", "reference", "condition", "derivatives", "ground_effect")
    for section, content in document.items():
        line = line_of(text, (section,))
        if section == "ground_effect" and isinstance(content, dict):
            yield from _toml_ground(path, line, content)
            continue
        if section not in allowed or not isinstance(content, dict):
            raise BadInputError(
                f"{path}:{line}: unknown section {section!r}; allowed are {', '.join(allowed)}"
            )
        for name, row in content.items():
            line = line_of(text, (section, name))
            has_unit = isinstance(row, dict)
            value: Any = row.get("value") if has_unit else row
            unit: Any = row.get("unit", "") if has_unit else ""
            for key, factor in (("_m2", ""), ("_m", ""), ("_deg", "deg"), ("_rad", "rad")):
                if section != "derivatives" and name.endswith(key) and unit == "":
                    name, unit = name.removesuffix(key), factor
            yield _row(path, line, str(name), value, str(unit))


def _toml_ground(path: Path, line: int, content: dict[str, Any]) -> Iterator[_Row]:
    """Yield the rows of [ground_effect]: lists h_over_b and lift of one length."""
    heights, factors = (content.get(key) for key in ("h_over_b", "lift"))
    if not (isinstance(heights, list) and isinstance(factors, list)) or (
        len(heights) != len(factors) or set(content) != {"h_over_b", "lift"}
    ):
        raise BadInputError(
            f"{path}:{line}: [ground_effect] needs the lists h_over_b and lift of one length"
        )
    for height, factor in zip(heights, factors, strict=True):
        over = _row(path, line, "h_over_b", height, "1")
        assert isinstance(over.value, float)
        yield replace(_row(path, line, _GROUND, factor, "1"), height=over.value)


def _csv_rows(path: Path, text: str) -> Iterator[_Row]:
    """Yield the rows of a CSV file; lines that begin with # are comments."""
    head: list[str] | None = None
    delimiter = ","
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if head is None:
            # Spreadsheets of countries with decimal commas separate by semicolons, others by tabs.
            delimiter = max(",;\t", key=line.count)
        words = [word.strip() for word in next(csv.reader(io.StringIO(line), delimiter=delimiter))]
        if head is None:
            head = words
            missing = [name for name in ("name", "value", "unit") if name not in head]
            if missing:
                raise BadInputError(
                    f"{path}:{number}: columns {', '.join(words)[:80]}; name, value and unit are"
                    " needed"
                )
            continue
        cells = dict(zip(head, words, strict=False))
        if delimiter != ",":
            cells |= {
                name: re.sub(r"(?<=\d),(?=\d)|^,(?=\d)", ".", cells[name])
                for name in ("value", "alpha_deg", "h_over_b")
                if name in cells
            }
        if "name" not in cells:
            raise BadInputError(
                f"{path}:{number}: received {line.strip()[:60]!r}, a name is needed"
            )
        row = _row(path, number, cells["name"], cells.get("value", ""), cells.get("unit", ""))
        alpha = cells.get("alpha_deg", "")
        if alpha:
            at = _row(path, number, "alpha", alpha, "deg")
            assert isinstance(at.value, float)
            row = _Row(row.name, row.value, row.unit, row.line, math.radians(at.value))
        height = cells.get("h_over_b", "")
        if height:
            over = _row(path, number, "h_over_b", height, "1")
            assert isinstance(over.value, float)
            row = replace(row, height=over.value)
        yield row


_TEXTS: tuple[Literal["axes", "rate_axes", "name"], ...] = ("axes", "rate_axes", "name")


def _row(path: Path, line: int, name: str, value: Any, unit: str) -> _Row:
    """Return a checked row."""
    if name in _TEXTS:
        return _Row(name, str(value), unit, line)
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not abs(number) < LARGEST:
        raise BadInputError(
            f"{path}:{line}: {name}: received {str(value)[:30]!r}, a finite number is needed"
        )
    return _Row(name, number, unit, line)
