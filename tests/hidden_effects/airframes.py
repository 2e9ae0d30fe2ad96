"""The aircraft that refine is given: the project's own, or a second one written from it with other
numbers.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from tests.helpers.sixdof import Airframe

ROOT = Path(__file__).resolve().parents[2]
_MASS = {
    "ixx": "Ixx",
    "iyy": "Iyy",
    "izz": "Izz",
    "ixz": "Ixz",
    "emptywt": "m",
    "wingarea": "S",
    "wingspan": "b",
    "chord": "c",
}


def write_aircraft(name: str, airframe: Airframe, folder: Path) -> Path:
    """folder/name: a copy of aircraft/espaaro whose coefficients, masses and lengths are the
    airframe's. Returns its folder.
    """
    out = folder / name
    shutil.copytree(ROOT / "aircraft" / "espaaro", out, dirs_exist_ok=True)
    xml = out / "espaaro.xml"
    text = xml.read_text(encoding="utf-8").replace(
        '<fdm_config name="espaaro"', f'<fdm_config name="{name}"'
    )
    for key, value in airframe.coefficients.items():
        text, result = re.subn(
            rf'<property value="[^"]*">(aero/{key})</property>',
            rf'<property value="{value!r}">\1</property>',
            text,
        )
        if result != 1:
            raise ValueError(f"aero/{key} stands {result} times in {xml}")
    for tag, attribute in _MASS.items():
        text, result = re.subn(
            rf"(<{tag} unit=[^>]*>)[^<]*(</{tag}>)",
            rf"\g<1>{getattr(airframe, attribute)!r}\g<2>",
            text,
        )
        if result != 1:
            raise ValueError(f"<{tag}> stands {result} times in {xml}")
    xml.unlink()
    (out / f"{name}.xml").write_text(text, encoding="utf-8")
    card = (out / "airframe.toml").read_text(encoding="utf-8")
    card = card.replace('name = "espaaro"', f'name = "{name}"').replace(
        'xml = "espaaro.xml"', f'xml = "{name}.xml"'
    )
    for key, value in (("S_m2", airframe.S), ("b_m", airframe.b), ("c_m", airframe.c)):
        card = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value!r}", card)
    # The first guesses are the other aeroplane's; its own numbers are in the XML.
    card = re.sub(r"(?m)^(\"aero/[^\"]*\" = \{ )initial = [^,]*, ", r"\1", card)
    (out / "airframe.toml").write_text(card, encoding="utf-8")
    for script in out.glob("*.xml"):
        if script.name != f"{name}.xml":
            script.write_text(
                script.read_text(encoding="utf-8").replace("espaaro", name), encoding="utf-8"
            )
    return out
