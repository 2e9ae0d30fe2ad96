"""What is wrong in an aircraft's XML that JSBSim refused: all at once, with file, line and mend.

JSBSim stops at its first error. `findings` reads the same files again and names every wrong number,
table, double name, missing file, unknown unit and unknown operation. It is asked only about models
that JSBSim refused, so that no working model is judged by these rules.
"""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import PurePosixPath
from typing import Any

from lxml import etree

from uqharness.errors import BadInputError
from uqharness.simulator.staging import INSIDE, ModelFiles

_MAX_FINDINGS = 30
# A text of digits, signs and points that is meant as a number.
_NUMBER_LIKE = re.compile(r"[-+]?[.,]?\d[\d.,eE+\-]*")
_UNITS_TEXT = """
M FT IN KM M2 FT2 M3 FT3 IN3 CC LTR LBS LB KG SLUG N NEWTONS DEG RAD DEG/SEC RAD/SEC FT/SEC M/S KTS
KPH MPH SLUG*FT2 KG*M2 LBS/FT N/M LBS/FT/SEC N/M/SEC LBS/FT2/SEC2 N/M2/SEC2 WATTS HP KW INHG PSF PA
ATM PSI PASCAL FT-LBS LBFT FT*LBS LBS*FT NM N*M LBS/SEC KG/MIN LBS/MIN KG/SEC GAL GAL/MIN CFM VOLTS
OHMS AMPERES RPM RPM/VOLT N*M/AMPERE SEC FAHRENHEIT CELSIUS RANKINE KELVIN K F R C M/SEC FT/MIN KT
N*M*SEC LBS/GAL M4*SEC/KG LBS/HR/HP FT*LB LBS/HP*HR SLUG*FT KM/SEC LBS/FT2 LB*FT FT4*SEC/SLUG
"""
_UNITS = frozenset(_UNITS_TEXT.split())
_LENGTHS_OF_TABLES = {"row": 1, "column": 2, "table": 3}
_PROSE_TEXT = """
author copyright description documentation email filecreationdate fileheader license limitation note
reference references version
"""
_PROSE = frozenset(_PROSE_TEXT.split())


def findings(
    files: ModelFiles,
    names: dict[str, str],
    operations: frozenset[str],
    *,
    stems: Collection[str] = (),
    refused: bool = True,
) -> list[str]:
    """Return what is wrong, as "file:line: what; what to do", in the order of the files.

    Parameters
    ----------
    files : ModelFiles
        The files that JSBSim loads.
    names : dict
        Name of each local or shared file to the name that messages give.
    operations : frozenset of str
        Operations of a function that JSBSim knows.
    stems : collection of str
        Names of the XML files of the folder, without suffix, for hints.
    refused : bool
        Whether JSBSim refused the model; else only operations are judged, which it ignores.
    """
    found: list[str] = []
    for name, file in [*files.local.items(), *files.shared.items()]:
        where = names.get(name, name)
        parser = etree.XMLParser(remove_comments=True, resolve_entities=False)
        try:
            root = etree.parse(BytesIO(file.content), parser).getroot()
        except etree.XMLSyntaxError as error:
            words = " ".join(error.msg.split())
            raise BadInputError(f"{where}:{error.lineno}: not well-formed XML: {words}") from None
        if root.tag in ("initialize", "runscript"):
            continue
        rows = [*_operations(root, operations)]
        if refused:
            rows += [*_files(root, files, stems), *_numbers(root), *_tables(root)]
            rows += [*_doubles(root), *_units(root)]
        found += [f"{where}:{line}: {text}" for line, text in sorted(set(rows))]
    return found[:_MAX_FINDINGS]


def _line(element: Any) -> int:
    """Return the line of an element."""
    return int(element.sourceline or 0)


def _elements(root: Any) -> Iterator[Any]:
    """Yield the elements outside of headers and descriptions."""
    for element in root.iterchildren("*"):
        if element.tag not in _PROSE:
            yield element
            yield from _elements(element)


def _files(root: Any, files: ModelFiles, stems: Collection[str]) -> Iterator[tuple[int, str]]:
    """Yield references to files that are nowhere."""
    for element in root.iter("*"):
        name = (element.get("file") or "").strip()
        if not name or element.tag in ("output", "input"):
            continue
        name = name if name.endswith(".xml") else f"{name}.xml"
        folders = dict.fromkeys(folder for group in INSIDE.values() for folder in group)
        places = [f"{folder}/{name}".lstrip("/") for folder in folders]
        shared = [f"{kind}/{name}" for kind in INSIDE]
        if any(place in files.local for place in places) or any(s in files.shared for s in shared):
            continue
        matches = difflib.get_close_matches(PurePosixPath(name).stem, stems, n=1)
        hint = f" or correct the name (did you mean {matches[0]}?)" if matches else ""
        folder = "Engines" if element.tag in ("engine", "thruster") else "Systems"
        yield (
            _line(element),
            (
                f'<{element.tag} file="{element.get("file")}">: there is no such file; put {name}'
                f" into the aircraft's folder {folder}{hint}"
            ),
        )


def _numbers(root: Any) -> Iterator[tuple[int, str]]:
    """Yield texts and values that are almost numbers."""
    for element in _elements(root):
        if element.tag == "tableData":
            continue
        texts = [(element.text or "").strip(), (element.get("value") or "").strip()]
        for text in texts:
            if _NUMBER_LIKE.fullmatch(text) and not _is_number(text):
                yield (
                    _line(element),
                    (
                        f"<{element.tag}> is {text!r}, no number; write one with a single decimal"
                        f" point{_suggested(text)}"
                    ),
                )


def _is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _suggested(text: str) -> str:
    """Return a number that a text may mean, for a message."""
    comma = text.replace(",", ".")
    if _is_number(comma):
        return f", such as {comma}"
    head, _, rest = comma.partition(".")
    joined = f"{head}.{rest.replace('.', '')}"
    return f", such as {joined}" if _is_number(joined) else ""


def _tables(root: Any) -> Iterator[tuple[int, str]]:
    """Yield tables whose data do not fit their axes."""
    for table in root.iter("table", "t"):
        data = table.findall("tableData")
        if not data:
            continue
        axes = max(
            (
                _LENGTHS_OF_TABLES.get(variable.get("lookup", "row"), 1)
                for variable in table.findall("independentVar")
            ),
            default=0,
        )
        for block in data:
            yield from _block(block, axes)
        nested = any(block.get("breakPoint") is not None for block in data)
        if axes == 3 and not nested:
            yield (
                _line(table),
                (
                    "three axes are named by <independentVar>, but <tableData> has no breakPoint:"
                    ' remove the axis with lookup="table", or give one'
                    ' <tableData breakPoint="..."> for each of its values'
                ),
            )


def _block(block: Any, axes: int) -> Iterator[tuple[int, str]]:
    """Yield what is wrong with one <tableData>."""
    # Rows of the data with their lines in the file.
    start = _line(block)
    lines = [
        (start + k, text.split())
        for k, text in enumerate((block.text or "").split("\n"))
        if text.split()
    ]
    # Words that are no number make every further check meaningless.
    wrong = [(line, token) for line, row in lines for token in row if not _is_number(token)]
    for line, token in wrong:
        yield line, f"{token!r} in <tableData> is no number{_suggested(token)}"
    if wrong or not lines:
        return
    # A table of two axes has a first row without a key.
    widths = [len(row) for _, row in lines]
    two = len(widths) > 1 and all(width == widths[0] + 1 for width in widths[1:])
    one = all(width == 2 for width in widths)
    # The number of declared axes must fit the shape of the data.
    if axes == 2 and not two and one:
        yield (
            start,
            (
                "two axes are named by <independentVar>, but <tableData> has one: remove the axis"
                ' with lookup="column", or begin the data with a row of its values'
            ),
        )
    elif axes == 1 and two and not one:
        yield (
            start,
            (
                "one axis is named by <independentVar>, but <tableData> has two: add an"
                ' <independentVar lookup="column">, or leave two columns'
            ),
        )
    elif axes:
        width = 2 if axes == 1 else widths[0] + 1
        first = 0 if axes == 1 else 1
        for line, row in lines[first:]:
            if len(row) != width:
                yield line, f"this row of <tableData> has {len(row)} numbers; {width} are needed"
    # Keys must increase from row to row.
    first = 1 if two and axes != 1 else 0
    keys = [(line, float(row[0])) for line, row in lines[first:]]
    for (_, before), (line, after) in itertools.pairwise(keys):
        if after <= before:
            yield (
                line,
                f"the row of {after:g} follows that of {before:g}; sort the rows, each value once",
            )


def _doubles(root: Any) -> Iterator[tuple[int, str]]:
    """Yield functions whose name is taken."""
    first: dict[str, int] = {}
    for element in root.iter("function"):
        name = re.sub(r"\s", "-", (element.get("name") or "").strip())
        # Names with a number are one for each engine.
        if not name or "#" in name or element.get("type") == "template":
            continue
        if name in first:
            yield (
                _line(element),
                (
                    f'<function name="{name}"> is there already (line {first[name]}); rename or'
                    " remove one of them"
                ),
            )
        first.setdefault(name, _line(element))


def _units(root: Any) -> Iterator[tuple[int, str]]:
    """Yield units that JSBSim does not know."""
    for element in _elements(root):
        unit = (element.get("unit") or "").strip()
        if unit and unit.upper() not in _UNITS:
            matches = difflib.get_close_matches(unit.upper(), sorted(_UNITS), n=1)
            hint = f"; did you mean {matches[0]}?" if matches else ""
            yield _line(element), f'<{element.tag} unit="{unit}">: no unit of JSBSim{hint}'


def _operations(root: Any, operations: frozenset[str]) -> Iterator[tuple[int, str]]:
    """Yield elements of functions that are no operation."""
    for function in root.iter("function"):
        for element in function.iterdescendants("*"):
            tables = {"table", "t"} & {parent.tag for parent in element.iterancestors()}
            if element.tag not in operations and not tables:
                matches = difflib.get_close_matches(str(element.tag), sorted(operations), n=1)
                hint = f"; did you mean <{matches[0]}>?" if matches else ""
                yield (
                    _line(element),
                    (
                        f"<{element.tag}> is no operation of a JSBSim function; JSBSim would ignore"
                        f" it{hint}"
                    ),
                )
