"""The aircraft folder that refine is given for a question: the aeroplane's numbers, and what its
card has wrong.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from tests.hidden_effects.airframes import write_aircraft
from tests.hidden_effects.questions import AIRFRAMES, Question, Stated


def folder_of(request: Question, folder: Path) -> Path:
    """folder/id/name, written anew: the aeroplane before its coefficients were drawn, with what the
    question's folder states.
    """
    case_folder = folder / request.id
    shutil.rmtree(case_folder, ignore_errors=True)
    out = write_aircraft(request.aircraft, AIRFRAMES[request.aircraft], case_folder)
    state(out, request.stated)
    return out


def state(aircraft: Path, stated: Stated) -> None:
    """Change an aircraft folder's servos, thrust map and place of accelerometers.

    Raises ValueError where a line is not there.
    """
    xml = aircraft / f"{aircraft.name}.xml"
    text = xml.read_text(encoding="utf-8")
    for tag, values in (("lag", stated.lag), ("rate_limit", stated.rate)):
        for surface, value in values.items():
            text = _servo(text, surface, tag, value)
    if stated.thrust != 1.0:
        text = _run_once(
            text,
            r'(<property value=")[^"]*(">propulsion/thrust-scale<)',
            rf"\g<1>{stated.thrust!r}\g<2>",
        )
    xml.write_text(text, encoding="utf-8")
    if any(stated.accelerometer):
        card = aircraft / "airframe.toml"
        text = card.read_text(encoding="utf-8")
        text = _run_once(
            text, r"accelerometer = \[[^\]]*\]", f"accelerometer = {list(stated.accelerometer)!r}"
        )
        card.write_text(text, encoding="utf-8")


def _servo(text: str, surface: str, tag: str, value: float | None) -> str:
    result = re.search(rf'<actuator name="fcs/{surface}-pos-\w+">.*?</actuator>', text, re.DOTALL)
    if result is None:
        raise ValueError(f"no actuator of {surface}")
    block = result[0]
    return text.replace(
        block,
        _run_once(
            block, rf"<{tag}>.*?</{tag}>", "" if value is None else f"<{tag}>{value!r}</{tag}>"
        ),
    )


def _run_once(text: str, pattern: str, new: str) -> str:
    changed, count = re.subn(pattern, new, text)
    if count != 1:
        raise ValueError(f"{pattern} stands {count} times")
    return changed
