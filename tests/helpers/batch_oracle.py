"""JSBSim itself as the judge: a point mass with one ``<system>`` whose inputs are plain
properties.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from uqharness.files import scratch_folder
from uqharness.simulator import engine
from uqharness.simulator.staging import Staging

_MODEL = """<?xml version="1.0"?>
<fdm_config name="point" version="2.0" release="ALPHA">
 <metrics><wingarea unit="FT2">10</wingarea><wingspan unit="FT">10</wingspan><chord unit="FT">1</chord>
  <location name="AERORP" unit="IN"><x>0</x><y>0</y><z>0</z></location></metrics>
 <mass_balance><ixx unit="SLUG*FT2">1</ixx><iyy unit="SLUG*FT2">1</iyy><izz unit="SLUG*FT2">1</izz>
  <emptywt unit="LBS">10</emptywt><location name="CG" unit="IN"><x>0</x><y>0</y><z>0</z></location></mass_balance>
 <ground_reactions/>
 <system name="probe">
{body}
 </system>
 <aerodynamics/>
</fdm_config>
"""

ENGINE_FILES = {
    "Engines/motor.xml": (
        '<?xml version="1.0"?><electric_engine name="motor"><power'
        ' unit="WATTS">100</power></electric_engine>'
    ),
    "Engines/jet.xml": '<?xml version="1.0"?><direct name="jet"/>',
}
"""What the engines of ``model`` are made of."""
_ENGINE = '<engine file="motor"><thruster file="jet"/></engine>'


def model(body: str, engines: int = 0) -> str:
    """The XML of the model whose system holds ``body``, with so many electric engines."""
    text = _MODEL.replace("{body}", body)
    return (
        text.replace(" <system", f" <propulsion>{_ENGINE * engines}</propulsion>\n <system", 1)
        if engines
        else text
    )


def loaded(text: str, dt_s: float, files: Mapping[str, str] | None = None) -> Any:
    """An aircraft of that XML, loaded and not initialised; ``files`` are others of its folder."""
    with scratch_folder("oracle") as scratch:
        staging = Staging(scratch.path, "point")
        for folder in (staging.folder, scratch.path / "engine", scratch.path / "systems"):
            folder.mkdir(parents=True)
        staging.xml.write_text(text)
        for name, content in (files or {}).items():
            (staging.folder / name).parent.mkdir(exist_ok=True)
            (staging.folder / name).write_text(content)
        fdm = engine.open_fdm(staging, dt_s)
    fdm["ic/h-sl-ft"] = 10000.0
    return fdm


def load(body: str) -> Any:
    """A running model whose system holds ``body``."""
    fdm = loaded(model(body), 1e-4)
    engine.run_ic(fdm)
    return fdm


def evaluate(
    functions: Mapping[str, str],
    inputs: Mapping[str, np.ndarray],
    extra: str = "",
    outputs: Sequence[str] | None = None,
) -> dict[str, np.ndarray]:
    """What JSBSim makes of named ``<function>`` bodies, a frame a row of ``inputs`` (property to
    values).
    """
    declared = "\n".join(f'<property value="1">{name}</property>' for name in inputs)
    text = "\n".join(
        f'<function name="{name}">{body}</function>' for name, body in functions.items()
    )
    fdm = load(declared + "\n" + text + "\n" + extra)
    manager = fdm.get_property_manager()
    sets = [(manager.get_node(name), values.tolist()) for name, values in inputs.items()]
    names = list(outputs if outputs is not None else functions)
    gets = [manager.get_node(name) for name in names]
    rows = len(next(iter(inputs.values())))
    out = np.empty((len(names), rows))
    for row in range(rows):
        for node, values in sets:
            node.set_double_value(values[row])
        fdm.run()
        for k, node in enumerate(gets):
            out[k, row] = node.get_double_value()
    return dict(zip(names, out, strict=True))
