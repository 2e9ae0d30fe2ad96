"""Read any source of derivatives by its content: AVL, VSPAERO, XFLR5, tables, AVL's input."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sysid.foreign.regular_files import MAX_TEXT_BYTES, read_regular
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
from uqharness.authoring.source import Entry, Source, merge, scaled_lengths
from uqharness.authoring.vspaero import is_stab, read_polar, read_stab
from uqharness.authoring.xflr5 import is_xflr5, read_xflr5
from uqharness.errors import BadInputError

_STAB = "run VSPAERO's stability analysis and give its .stab or its results CSV"
_LOG = "save the log of a stability analysis, which ends with derivatives at a trim"
_WITHOUT_DERIVATIVES = {
    r"DEGEN GEOM|STICK_NODE": f"OpenVSP's DegenGeom is a geometry; {_STAB}",
    r"^\s*Results_Name,": f"OpenVSP's results hold no VSPAERO_Stab; {_STAB}",
    r"^\s*Beta\s+Mach\s+AoA\s": f"VSPAERO's polar has no derivatives by itself; {_STAB}",
    r"Parasite Drag|PARASITE DRAG": f"OpenVSP's drag build-up has no derivatives; {_STAB}",
    r"(?i)\A.{0,80}(xflr5|flow5)[^\n]*\n(.*\n){0,12}.*(polar|alpha\s+.*CL\s)": (
        f"a polar of XFLR5 or flow5 has no derivatives; {_LOG}"
    ),
    r"Surface and Strip Forces|Strip Forces referred|Element Strengths": (
        "AVL's strip or element forces have no derivatives; write ST from the OPER menu"
    ),
    r"(?m)^\s*Run case\s+\d+:": "AVL's run cases hold no results; write ST from the OPER menu",
    r"DIGITAL DATCOM": (
        "Digital DATCOM's output is not read; copy its derivatives with their unit, mostly 1/deg,"
        " into a .csv with the columns name, value, unit"
    ),
}
"""Files that users give for derivatives, and what to give instead."""
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
    parts : tuple of Source
        The files of derivatives one by one, as `derivatives` holds them.
    """

    derivatives: Source
    masses: Masses | None
    geometry: Geometry | None
    texts: dict[Path, str]
    parts: tuple[Source, ...] = ()


def read_text(path: Path) -> str:
    r"""Return the text of a file in UTF-8, UTF-16 or Windows-1252 with ``\n`` as the line end.

    Programs print on Windows consoles and editors save in the system's encoding: the text is ASCII
    but for units (kg.m², °), so that the encoding changes no number. Raises BadInputError.
    """
    try:
        content = read_regular(path, MAX_TEXT_BYTES)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    encodings = ["utf-8-sig", "cp1252"]
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    elif content[1:2] == b"\0" or content[:1] == b"\0":
        encodings = ["utf-16-le" if content[1:2] == b"\0" else "utf-16-be"]
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    raise BadInputError(f"{path}: not a text file in UTF-8, UTF-16 or Windows-1252")


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
            sources += _reader(path, text)(path, text)
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
    unit = unit_m if unit_m is not None else 1.0 if masses is None else masses.length_unit_m
    from_options = {
        key: Entry(value, Path(f"option of {key}")) for key, value in (given or {}).items()
    }
    parts = []
    for source in sources:
        scaled = scaled_lengths(source, unit) if source.tool in ("AVL", "VSPAERO") else source
        parts.append(replace(scaled, reference={**scaled.reference, **from_options}))
    source = merge(parts)
    return Sources(
        replace(source, notes=(*source.notes, *notes)), masses, geometry, texts, tuple(parts)
    )


def _reader(path: Path, text: str) -> Callable[[Path, str], list[Source]]:
    """Return the reader of a file, known by its content."""
    if is_stab(text):
        return lambda path, text: [read_stab(path, text)]
    for pattern, content in _WITHOUT_DERIVATIVES.items():
        if re.search(pattern, text):
            raise BadInputError(f"{path}: {content}")
    if path.suffix.lower() in (".toml", ".csv", ".tsv"):
        return lambda path, text: [read_table_file(path, text)]
    if is_avl_output(text):
        return read_avl_text
    if is_xflr5(text):
        return lambda path, text: [read_xflr5(path, text)]
    if not text.strip():
        raise BadInputError(f"{path}: the file is empty")
    raise BadInputError(
        f"{path}: not a known source; AVL's ST, SB or FT output, VSPAERO's .stab, an XFLR5"
        " stability log, a .toml or .csv table, an .avl geometry are read"
    )
