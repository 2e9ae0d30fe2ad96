"""Effects that change numbers an author wrote: <mass_balance> and <actuator>.

A servo's lag and rate limit become properties, whose old values restore the servo as it was. JSBSim reads mass, and the width of a
dead zone, as numbers alone.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from sysid.effects import Effect
from uqharness.actuators import actuators
from uqharness.aircraft import Aircraft
from uqharness.card_edit import sensors_from_cg
from uqharness.errors import BadInputError

FT = 0.3048
FREE_RATE = 1e9
"""Rate limit that limits nothing."""
_TAGS = {"lag": "lag", "rate_limit": "rate_limit", "deadband": "deadband_width"}
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def servo_switch(effect: Effect, aircraft: Aircraft) -> tuple[str, float] | None:
    """Property that a servo's number is written as, and the number as given; None for a servo that had no lag, where no number is
    the same bit for bit, and for what is no servo's."""
    part, _, surface = (effect.subsystem or "").partition(".")
    if part != "actuator" or effect.term not in ("lag", "rate_limit"):
        return None
    servo = actuators(aircraft, [surface])[surface]
    if effect.term == "rate_limit":
        return effect.property_name, servo.rate if math.isfinite(servo.rate) else FREE_RATE
    return None if servo.lag is None else (effect.property_name, servo.lag)


def write_mass(folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str) -> None:
    """The number in <mass_balance> changed: Ixz [kg m2] with the author's unit and sign convention, or the CG along x [m], with
    the sensors' places from it. Raises BadInputError."""
    path = folder / aircraft.xml.name
    text = _text(path)
    block = re.search(r"<mass_balance\b([^>]*)>.*?</mass_balance>", text, re.DOTALL)
    if block is None:
        raise BadInputError(f"{path}: no <mass_balance> to put effect {effect.term} into")
    said = _said(remark)
    if effect.term == "Ixz":
        sign = 1.0 if re.search(r"negated_crossproduct_inertia\s*=\s*[\"']false", block.group(1)) else -1.0
        found = re.search(r"<ixz\b([^>]*)>([^<]*)</ixz>", block.group(0))
        unit = 1.0 if found and "KG" in found.group(1) else 1.0 / 1.3558179483314
        change = sign * value * unit
        if found is None:
            at = block.start() + block.group(0).index(">") + 1
            line = f'\n    <ixz unit="KG*M2">{sign * value:.8g}</ixz>{said}'
            text = text[:at] + line + text[at:]
        else:
            a, b = block.start() + found.start(2), block.start() + found.end(2)
            end = text.index("\n", b)
            text = f"{text[:a]}{float(found.group(2)) + change:.8g}{text[b:end]}{said}{text[end:]}"
    else:
        place = re.search(r"<location\b[^>]*name\s*=\s*[\"']CG[\"'][^>]*>.*?</location>", block.group(0), re.DOTALL)
        found = re.search(r"<x>([^<]*)</x>", place.group(0)) if place else None
        if place is None or found is None:
            raise BadInputError(f'{path}: no <location name="CG"> to move')
        unit = (
            1.0
            if re.search(r"unit\s*=\s*[\"']M[\"']", place.group(0))
            else 1.0 / 0.0254
            if "IN" in place.group(0)
            else 1.0 / FT
        )
        a, b = (block.start() + place.start() + edge for edge in found.span())
        # Structural x points aft.
        text = f"{text[:a]}<x>{float(found.group(1)) - value * unit:.8g}</x>{said}{text[b:]}"
        sensors_from_cg(folder / "airframe.toml", value, remark)
    _put(path, text)


def write_actuator(folder: Path, aircraft: Aircraft, effect: Effect, value: float, remark: str) -> None:
    """The actuator's own number changed: lag [1/s], rate_limit or deadband_width; the first two as a property before the channel.
    Raises BadInputError."""
    surface = (effect.subsystem or "").partition(".")[2]
    position = aircraft.card.inputs[surface].position
    # Its numbers may stand in the XML as properties: asked of JSBSim, they are what flies.
    servo = actuators(aircraft, [surface])[surface]
    tag, switch = _TAGS[effect.term], servo_switch(effect, aircraft)
    element = re.compile(
        r"<actuator\b[^>]*name\s*=\s*[\"']" + re.escape(position or "?") + r"[\"'][^>]*>.*?</actuator>", re.DOTALL
    )
    for path in sorted(folder.rglob("*.xml")):
        text = _text(path)
        bare = _COMMENT.sub(lambda m: " " * len(m.group()), text)
        block = element.search(bare)
        if block is None:
            continue
        a, b = block.span()
        found = re.search(rf"<{tag}>([^<]*)</{tag}>", bare[a:b])
        if tag == "lag":
            number = servo.lag_with(value)
        elif tag == "rate_limit":
            number = servo.slowed_to(value)
        else:
            number = _number(found) + value
        put = f"{number:.8g}" if switch is None else switch[0]
        said = _said(remark) if switch is None else ""
        mine = re.search(_declared(put), bare) if switch is not None else None
        if mine and found and found.group(1).strip() == put:
            # The aircraft carries this effect already.
            end = text.index("\n", mine.end())
            text = f"{text[: mine.start(1)]}{number:.8g}{text[mine.end(1) : end]}{_said(remark)}{text[end:]}"
            _put(path, text)
            return
        if found:
            end = text.find("\n", a + found.end(1), b)
            end = b if end < 0 else end
            text = (
                f"{text[: a + found.start(1)]}{put}{text[a + found.end(1) : end]}{said if end < b else ''}{text[end:]}"
            )
        else:
            at = a + bare[a:b].index("</input>") + len("</input>")
            text = f"{text[:at]}\n        <{tag}>{put}</{tag}>{said}{text[at:]}"
        if switch is not None:
            at = bare.rindex("<channel", 0, a)
            margin = text[text.rfind("\n", 0, at) + 1 : at]
            line = f'<property value="{number:.8g}">{put}</property>{_said(remark)}'
            text = f"{text[:at]}{line}\n{margin if not margin.strip() else ''}{text[at:]}"
        _put(path, text)
        return
    raise BadInputError(f"aircraft '{aircraft.name}': no <actuator name=\"{position}\"> for effect {effect.key}")


def _declared(name: str) -> str:
    return r"<property\b[^>]*?\bvalue\s*=\s*[\"']([^\"']*)[\"'][^>]*>\s*" + re.escape(name) + r"\s*</property>"


def _number(found: re.Match[str] | None) -> float:
    if found is None or not re.fullmatch(r"\s*[-+.\deE]+\s*", found.group(1)):
        return 0.0
    return float(found.group(1))


def _said(remark: str) -> str:
    return f"  <!-- {remark.replace('--', '- -')} -->"


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", errors="surrogateescape")


def _put(path: Path, text: str) -> None:
    path.write_bytes(text.encode("utf-8", errors="surrogateescape"))
