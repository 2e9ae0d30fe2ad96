"""Write numbers into an aircraft's XML as a hand would: the value changes, formatting and comments stay, a remark says why."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.aircraft_files import copy_folder
from uqharness.xml.document import comment

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_REMARK = re.compile(r"[ \t]*<!-- identified [^>]*?-->")


@dataclass(frozen=True)
class Estimate:
    """New value of a property and the remark that stands behind it in the XML (no double hyphen)."""

    value: float
    remark: str


def write_estimates(aircraft: Aircraft, estimates: Mapping[str, Estimate], out: Path) -> list[str]:
    """Copy the aircraft's folder to ``out`` with the estimates in its XML; names that no XML file declares are returned.

    The copy appears whole or not at all; an existing ``out`` is replaced only if it is an aircraft's folder. Raises BadInputError.
    """
    if out.exists() and not (out / "airframe.toml").is_file() and any(out.iterdir()):
        raise BadInputError(f"{out}: exists and is no aircraft folder of an earlier run; remove it or choose another --out")
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".aircraft-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(aircraft.folder, copy)
        left = put_values(copy, estimates)
        old = Path(temporary) / "old"
        if out.exists():
            out.rename(old)
        copy.rename(out)
    return left


def with_value(text: str, name: str, estimate: Estimate) -> str | None:
    """``text`` with the number in ``<property value="...">name</property>`` replaced; None when it is not declared there.

    An earlier remark of ours is replaced as well; the author's comments are not.
    """
    hidden = [m.span() for m in _COMMENT.finditer(text)]
    pattern = re.compile(r"(<property\b[^>]*?\bvalue\s*=\s*)([\"'])([^\"']*)\2([^>]*>\s*" + re.escape(name) + r"\s*</property>)")
    for found in pattern.finditer(text):
        if any(a <= found.start() < b for a, b in hidden):
            continue
        end_of_line = text.find("\n", found.end())
        end_of_line = len(text) if end_of_line < 0 else end_of_line
        rest = text[found.end() : end_of_line]
        carriage = "\r" if rest.endswith("\r") else ""
        rest = _REMARK.sub("", rest.removesuffix("\r")).rstrip(" \t")
        remark = f"  {comment(f'identified {estimate.remark}')}"
        # A remark inside a comment that runs over lines would end it early; such a line keeps its number alone.
        if "<!--" in _COMMENT.sub("", rest):
            remark = ""
        number = f"{estimate.value:.8g}"
        return (
            f"{text[: found.start()]}{found.group(1)}{found.group(2)}{number}{found.group(2)}{found.group(4)}"
            f"{rest}{remark}{carriage}{text[end_of_line:]}"
        )
    return None


def put_values(folder: Path, values: Mapping[str, Estimate]) -> list[str]:
    """Write values of properties into the XML files of a folder, in place; names that no file declares are returned."""
    left = dict(values)
    for path in sorted(folder.rglob("*.xml")):
        text = path.read_bytes().decode("utf-8", errors="surrogateescape")
        edited = text
        for name in list(left):
            done = with_value(edited, name, left[name])
            if done is not None:
                edited = done
                del left[name]
        if edited != text:
            path.write_bytes(edited.encode("utf-8", errors="surrogateescape"))
    return list(left)
