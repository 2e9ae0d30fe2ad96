"""Read any source of derivatives by its content: AVL, VSPAERO, XFLR5, tables, AVL's input."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sysid.foreign.regular_files import read_regular_text
from uqharness.authoring.avl_input import (
    Geometry,
    Masses,
    can_run_avl,
    read_geometry,
    read_masses,
    run_avl,
)
from uqharness.authoring.avl_text import is_avl_output, read_avl_text
from uqharness.authoring.derivative_table import read_table_file
from uqharness.authoring.source import Entry, Point, Source, scaled_lengths
from uqharness.authoring.vspaero import is_stab, read_polar, read_stab
from uqharness.authoring.xflr5 import is_xflr5, read_xflr5
from uqharness.errors import BadInputError

RUN_ALPHAS_DEG = (0.0, 3.0, 6.0, 9.0)
"""Angles of attack at which an AVL geometry is run."""


@dataclass(frozen=True)
class Sources:
    """Everything that was read.

    Attributes
    ----------
    derivatives : Source
        Lengths in metres. Without points where a geometry alone is given and AVL cannot be run.
    masses : Masses or None
        Of a ``.mass`` file.
    geometry : Geometry or None
        Of an ``.avl`` file, in its own unit of length.
    texts : mapping of Path to str
        Content of the files.
    """

    derivatives: Source
    masses: Masses | None
    geometry: Geometry | None
    texts: dict[Path, str]


def read_text(path: Path) -> str:
    """Return the text of a file. Raises BadInputError."""
    try:
        return read_regular_text(path)
    except UnicodeDecodeError:
        raise BadInputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_sources(
    paths: Sequence[Path], unit_m: float | None = None, given: dict[str, float] | None = None
) -> Sources:
    """Read the files of one aircraft.

    Parameters
    ----------
    paths : sequence of Path
        One source of derivatives, or several AVL outputs at different alphas; a ``.mass``, an
        ``.avl``, a ``.polar`` and a ``.vspaero`` beside it.
    unit_m : float, optional
        Length of the files' unit in m; by default Lunit of the ``.mass``, else 1.
    given : dict, optional
        Reference values S, b, c, x, y, z in metres, which replace the files'.

    Raises
    ------
    BadInputError
        For no source of derivatives, or several that do not belong together.
    """
    texts = {path: read_text(path) for path in paths}
    masses = geometry = None
    sources: list[Source] = []
    notes: list[str] = []
    for path, text in texts.items():
        suffix = path.suffix.lower()
        if suffix == ".mass":
            masses = read_masses(path, text)
        elif suffix == ".avl":
            geometry = read_geometry(path, text)
        elif suffix == ".polar":
            polar = read_polar(path, text)
            smallest = min(polar["CDtot"])
            notes.append(f"{path.name}: least drag of the polar {smallest:.4g}")
        elif suffix == ".vspaero":
            continue
        else:
            sources.append(_reader(path, text)(path, text))
    if not sources and geometry is not None:
        sources = [
            run_avl(geometry, [math.radians(a) for a in RUN_ALPHAS_DEG])
            if can_run_avl()
            else Source(geometry.path, "AVL", geometry.name, geometry.reference, ())
        ]
    if not sources:
        raise BadInputError(
            f"{', '.join(map(str, paths))}: no source of derivatives; AVL's ST or SB output, a"
            " .stab, an XFLR5 log, a table (.toml, .csv) or an .avl geometry is needed"
        )
    source = _merged(sources)
    unit = unit_m if unit_m is not None else 1.0 if masses is None else masses.length_unit_m
    if source.tool in ("AVL", "VSPAERO"):
        source = scaled_lengths(source, unit)
    if given:
        from_options = {key: Entry(value, Path(f"option of {key}")) for key, value in given.items()}
        source = replace(source, reference={**source.reference, **from_options})
    return Sources(replace(source, notes=(*source.notes, *notes)), masses, geometry, texts)


def _reader(path: Path, text: str) -> Callable[[Path, str], Source]:
    """Return the reader of a file, known by its content."""
    if path.suffix.lower() in (".toml", ".csv"):
        return read_table_file
    if is_stab(text):
        return read_stab
    if is_avl_output(text):
        return read_avl_text
    if is_xflr5(text):
        return read_xflr5
    raise BadInputError(
        f"{path}: not a known source; AVL's ST, SB or FT output, VSPAERO's .stab, an XFLR5"
        " stability log, a .toml or .csv table, an .avl geometry are read"
    )


def _merged(sources: Sequence[Source]) -> Source:
    """Return one source of several outputs of AVL at different alphas."""
    if not any(source.points for source in sources):
        return sources[0]
    with_derivatives = [s for s in sources if any(v != "0" for p in s.points for _, v in p.entries)]
    if not with_derivatives:
        raise BadInputError(
            f"{sources[0].path}: totals without derivatives; write ST or SB from AVL's OPER menu"
        )
    first = with_derivatives[0]
    points: dict[float, Point] = {}
    for source in with_derivatives:
        for key in "Sbc":
            if key in first.reference and not math.isclose(
                source.length(key), first.length(key), rel_tol=1e-3
            ):
                raise BadInputError(
                    f"{source.reference[key].place}: reference {key} {source.length(key):g}"
                    f" differs from {first.path}'s {first.length(key):g}; the files are not of one"
                    " aircraft"
                )
        for point in source.points:
            points.setdefault(round(point.alpha.value, 6), point)
    ordered = tuple(points[alpha] for alpha in sorted(points))
    return replace(first, points=ordered)
