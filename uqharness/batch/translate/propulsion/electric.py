"""``<electric_engine>`` and ``<brushless_dc_motor>``: power to the shaft by the throttle (JSBSim 1.3.3).

The brushless motor is Drela's (First-Order DC Electric Motor Model, 2007, eqs 2 and 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.frame import Frame, Scope
from uqharness.batch.translate.propulsion.engine_files import Part, known, needed, number
from uqharness.batch.translate.propulsion.propeller import Jet, Propeller

_HP_WATTS = 745.7
_HP_FTLBPS = 550.0
_NM_FTLB = 1.3558
_ALWAYS = ("function",)


@dataclass(frozen=True)
class Electric:
    """Power in proportion to the throttle."""

    name: str
    index: str
    watts: float

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """What the thruster gets [ft lbf/s]."""
        hp = self.watts * frame.get(f"fcs/throttle-pos-norm{self.index}") / _HP_WATTS
        frame.store(f"{self.name}power-hp", hp)
        power = hp * _HP_FTLBPS
        b = frame.builder
        at_rest = (
            thruster.engine_rpm(frame).le(0.1) if isinstance(thruster, Propeller) else b.truth(True)
        )
        return b.op("and", at_rest, power.lt(0.0)).choose(0.0, power)


@dataclass(frozen=True)
class Brushless:
    """A motor whose voltage follows the throttle."""

    name: str
    index: str
    volts: float
    rpm_per_volt: float
    ohms: float
    no_load_amperes: float

    def trace(self, frame: Frame, thruster: Propeller | Jet) -> Value:
        """What the thruster gets [ft lbf/s]."""
        b, kv, idle = frame.builder, self.rpm_per_volt, self.no_load_amperes
        rpm = (
            frame.get(f"{self.name}propeller-rpm")
            if isinstance(thruster, Propeller)
            else b.constant(0.0)
        )
        volts = self.volts * frame.get(f"fcs/throttle-pos-norm{self.index}")
        current = (volts - rpm / kv) / self.ohms
        held = current.gt(idle).choose(idle, current.lt(-idle).choose(-idle, current))
        friction = rpm.gt(0.0).choose(idle, held)
        torque = (current - friction) / kv * (60.0 / (2.0 * math.pi * _NM_FTLB))
        power = 2.0 * math.pi * b.op("max", rpm, 0.0001) * torque / 60.0
        frame.store(f"{self.name}current-amperes", current)
        frame.store(f"{self.name}power-hp", power / _HP_WATTS * _NM_FTLB)
        return power


def read_electric(scope: Scope, part: Part, name: str, index: str) -> Electric | Brushless:
    """An engine of either kind. Raises BadInputError with file and line."""
    node = part[1]
    if node.tag == "electric_engine":
        known(scope, node, ("power", *_ALWAYS))
        return Electric(name, index, number(scope, node, "power", _HP_WATTS, "WATTS"))
    known(
        scope, node, ("maxvolts", "velocityconstant", "coilresistance", "noloadcurrent", *_ALWAYS)
    )
    return Brushless(
        name,
        index,
        needed(scope, node, "maxvolts", "VOLTS"),
        needed(scope, node, "velocityconstant"),
        needed(scope, node, "coilresistance", "OHMS"),
        needed(scope, node, "noloadcurrent", "AMPERES"),
    )
