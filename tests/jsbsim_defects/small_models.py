"""The smallest JSBSim aircraft that shows a behaviour, and a way to let it die in a process of its
own.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import jsbsim

SKELETON = """<?xml version="1.0"?>
<fdm_config name="small" version="2.0">
  <fileheader/>
  <metrics>
    <wingarea unit="M2">2</wingarea> <wingspan unit="M">4</wingspan> <chord unit="M">0.5</chord>
    <location name="AERORP" unit="M"><x>{aerorp}</x><y>0</y><z>0</z></location>
  </metrics>
  <mass_balance {mass_attributes}>
    <ixx unit="KG*M2">6</ixx> <iyy unit="KG*M2">8</iyy> <izz unit="KG*M2">11</izz> {ixz}
    <emptywt unit="KG">20</emptywt>
    <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>
  </mass_balance>
  <ground_reactions/>
  <flight_control name="fcs">{fcs}</flight_control>
  <aerodynamics>{aero}</aerodynamics>
</fdm_config>
"""


def write_model(
    root: Path,
    fcs: str = "",
    aero: str = "",
    ixz: str = "",
    mass_attributes: str = "",
    aerorp: float = 0.0,
) -> Path:
    folder = root / "aircraft" / "small"
    folder.mkdir(parents=True, exist_ok=True)
    text = SKELETON.format(
        fcs=fcs, aero=aero, ixz=ixz, mass_attributes=mass_attributes, aerorp=aerorp
    )
    (folder / "small.xml").write_text(text)
    return root


def load(root: Path, dt: float = 0.01) -> Any:
    fdm = jsbsim.FGFDMExec(str(root))
    fdm.set_debug_level(0)
    fdm.set_dt(dt)
    assert fdm.load_model("small")
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = 3000.0, 70.0
    return fdm


def small(root: Path, **parts: Any) -> Any:
    """A loaded small model, not initialised."""
    dt = parts.pop("dt", 0.01)
    return load(write_model(root, **parts), dt)


def dies(code: str, root: Path) -> int:
    """Exit code of a process that runs ``code`` with ``root`` and ``jsbsim`` at hand; negative for
    a signal.
    """
    head = f"import jsbsim\nroot = {str(root)!r}\n"
    done = subprocess.run(
        [sys.executable, "-c", head + code], capture_output=True, timeout=60, check=False
    )
    return done.returncode
