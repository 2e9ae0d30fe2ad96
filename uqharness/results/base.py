"""Results: what commands print with ``--json``, store in folders and give to report pages.

A result is a pydantic model with one field for each key, in the order of the file. The command
builds it, `Part.as_json` is what is written, `read_result` is the only reader, and
`model_json_schema` of the class is the schema in docs/schemas. Folders of results are passed on,
edited and damaged: a page is made only from a result that was validated here, so that a missing key
is an error of the file. Unknown keys of a file are kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Generic, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from sysid.foreign.regular_files import ParseError, parse_json, read_regular
from uqharness.errors import BadInputError
from uqharness.toml import dotted

_MAX_BYTES = 16_000_000
"""Largest document; as Python objects it takes up to thirty times as much memory."""
MAX_LINES = 25
"""Lines that a command prints at most; the rest is in its report."""


def _inside(name: str) -> str:
    """Return the name of an inner folder; ValueError if it leads out of the folder of results."""
    # Checked as a POSIX and as a Windows path: results move between systems.
    windows = PureWindowsPath(name)
    parts = {*PurePosixPath(name).parts, *windows.parts}
    if ".." in parts or name.startswith("/") or windows.drive or windows.root or "\0" in name:
        raise ValueError("must be a folder within the folder of results")
    return name


def _finite(value: Any) -> Any:
    """Return a number as float, None where it is not finite; other values unchanged."""
    if isinstance(value, Real) and not isinstance(value, bool | Integral):
        return float(value) if math.isfinite(value) else None
    # numpy's integers are no int, which strict validation needs.
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool) else value


def _as_list(value: Any) -> Any:
    """Return a tuple as the list that JSON has."""
    return list(value) if isinstance(value, tuple) else value


FolderName = Annotated[str, AfterValidator(_inside)]
Number = Annotated[float | None, BeforeValidator(_finite)]
"""Number; null is undefined or infinite."""
Numbers = dict[str, Number]
Texts = Annotated[list[str], BeforeValidator(_as_list)]
Ends = Annotated[list[Number], BeforeValidator(_as_list), Field(min_length=2, max_length=2)]
"""Lower and upper end of an interval."""


class Part(BaseModel, Mapping[str, Any]):
    """An object of a result: no type conversion, unknown keys kept, immutable.

    Besides its attributes it has the keys that were set, as a mapping.
    """

    model_config = ConfigDict(strict=True, extra="allow", populate_by_name=True, frozen=True)

    def as_json(self) -> dict[str, Any]:
        """Return the keys that were set, in the order of the fields, as JSON has them."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)

    def _names(self) -> dict[str, str]:
        """Return the attribute of each key that was set, in the order of the file."""
        fields = {n: f.alias or n for n, f in type(self).model_fields.items()}
        names = {key: name for name, key in fields.items() if name in self.model_fields_set}
        return names | {name: name for name in self.model_extra or ()}

    def __getitem__(self, key: str) -> Any:
        return getattr(self, self._names()[key])

    def __iter__(self) -> Iterator[str]:  # type: ignore[override]
        return iter(self._names())

    def __len__(self) -> int:
        return len(self._names())

    def __bool__(self) -> bool:
        """Return True: an object without keys is there all the same."""
        return True


Shape = TypeVar("Shape", bound=Part)
T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True)
class Outcome(Generic[T_co]):
    """What a command did.

    Attributes
    ----------
    value : Any
        What the Python function returns.
    document : Part or Mapping
        What ``--json`` prints.
    lines : sequence of str
        What the command prints, the answer first.
    code : int
        Exit code: 0 done, 1 ran but the answer is no.
    report : Path or None
        Page with everything that the lines leave out.
    warnings : sequence of str
        Sentences for standard error.
    cut : bool
        Whether `text` stops after `MAX_LINES` lines; False where the text is a file.
    """

    value: T_co
    document: Part | Mapping[str, Any]
    lines: Sequence[str] = ()
    code: int = 0
    report: Path | None = None
    warnings: Sequence[str] = field(default_factory=tuple)
    cut: bool = True

    def as_json(self) -> Mapping[str, Any]:
        """Return the document as JSON has it."""
        return self.document.as_json() if isinstance(self.document, Part) else self.document

    def text(self) -> str:
        """Return at most `MAX_LINES` lines for a terminal, the path of the report last."""
        lines = [line for text in self.lines for line in text.split("\n")]
        end = [] if self.report is None else [f"Report: {self.report}"]
        # The path of the report is printed once, by the last line.
        lines = [line for line in lines if not (end and str(self.report) in line)]
        room = MAX_LINES - len(end)
        if self.cut and len(lines) > room:
            place = "in the report" if end else "with --json"
            more = len(lines) - room + 1
            lines = [*lines[: room - 1], f"{more} more lines {place}"]
        return "\n".join([*lines, *end])


def read_result(path: Path, shape: type[Shape]) -> Shape:
    """Read and validate a JSON document.

    Parameters
    ----------
    path : Path
        The file.
    shape : type of Part
        Model that it must match.

    Raises
    ------
    BadInputError
        If the file cannot be read or does not match; the message names file and key.
    """
    try:
        document = parse_json(read_regular(path, _MAX_BYTES))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ParseError as error:
        place = "" if error.line is None else f", line {error.line}"
        raise BadInputError(f"{path}{place}: {error}; run its command again") from None
    if not isinstance(document, dict):
        raise BadInputError(f"{path}: is no JSON object; run its command again")
    try:
        return shape.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = dotted(first["loc"]) or "the document"
        problem = (
            "is missing"
            if first["type"] == "missing"
            else first["msg"].removeprefix("Value error, ")
        )
        raise BadInputError(f"{path}: {where}: {problem}; run its command again") from None
