"""Translate ``<rocket_engine>`` (JSBSim 1.3.3): liquid rockets, whose thrust follows the flow of
propellant of the frame before, and solid ones, whose thrust is a table of the propellant burned.

JSBSim does not compute a rocket while it initialises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.engine_files import Part, grid, lookup, number, refuse_tags
from uqharness.batch.translate.frame import Frame, Scope
from uqharness.batch.translate.functions import Grid, function_value
from uqharness.batch.translate.propeller import Jet, Propeller
from uqharness.xml import Node

_LONG_AGO_S = 1e9


@dataclass(frozen=True)
class Rocket:
    """A rocket engine.

    Attributes
    ----------
    flow_pps : float
        Largest flow of propellant [lbs/s].
    min_throttle, buildup_s : float
        Throttle below which it does not burn, and the time in which a solid rocket builds up.
    isp : Node or None
        Function of the specific impulse; None: the engine's property.
    thrust : Grid or None
        Vacuum thrust over propellant burned [lbf, lbs]; None: a liquid rocket.
    variation : (float, float)
        Relative variation of a solid rocket's thrust and total impulse.
    """

    name: str
    index: str
    part: Part
    flow_pps: float
    min_throttle: float
    buildup_s: float
    isp: Node | None
    thrust: Grid | None
    variation: tuple[float, float]

    @property
    def key(self) -> str:
        """Prefix of the names of its memory."""
        return f"engine{self.index}"

    def trace(self, frame: Frame, _: Propeller | Jet) -> Value:
        """Return the thrust in vacuum [lbf]."""
        b, name, key = frame.builder, self.name, self.key
        throttle = frame.get(f"fcs/throttle-pos-norm{self.index}")
        starved = frame.memory(f"{key}/starved").ne(0.0)
        spent = frame.memory(f"{key}/fuel-spent") + frame.memory(f"{key}/oxidizer-spent")
        burned = frame.memory(f"{key}/burned") + spent
        frame.remember(f"{key}/burned", burned)
        isp = self._isp(frame)
        if self.thrust is None:
            off = b.op("or", throttle.lt(self.min_throttle), starved)
            frame.remember(f"{key}/power", off.choose(0.0, throttle))
            vacuum = off.choose(0.0, isp * (spent / frame.step))
        else:
            first = _LONG_AGO_S if frame.values.get(f"{name}vacuum-thrust_lbs") else 0.0
            time = frame.memory(f"{key}/burn-time", first)
            burns = b.op("and", b.op("or", throttle.eq(1.0), time.gt(0.0)), b.op("not", starved))
            vacuum = lookup(self.thrust, burned)
            vacuum = vacuum * (self.variation[0] + 1.0) * (self.variation[1] + 1.0)
            if self.buildup_s > 0.0:
                share = b.op("sin", time / self.buildup_s * math.pi / 2.0)
                vacuum = time.le(self.buildup_s).choose(vacuum * share, vacuum)
            vacuum = burns.choose(vacuum, 0.0)
            frame.remember(f"{key}/burn-time", burns.choose(time + frame.step, time), first)
        frame.store(f"{name}vacuum-thrust_lbs", vacuum)
        return vacuum

    def _isp(self, frame: Frame) -> Value:
        """Return the specific impulse [s] and publish a function's."""
        if self.isp is None:
            return frame.get(f"{self.name}isp")
        value = function_value(frame.scope(self.part[0]), self.isp)
        frame.store(f"{self.name}isp", value)
        return value

    def flows(self, frame: Frame) -> tuple[Value, Value]:
        """Return the flows of fuel and oxidizer [lbs/s]."""
        if self.thrust is not None:
            flow = frame.get(f"{self.name}vacuum-thrust_lbs") / frame.get(f"{self.name}isp")
            return flow / (1.0 + self.variation[1]), frame.builder.constant(0.0)
        ratio, power = frame.get(f"{self.name}mixture-ratio"), frame.memory(f"{self.key}/power")
        fuel = self.flow_pps / (1.0 + ratio) * power
        return fuel, self.flow_pps * ratio / (1.0 + ratio) * power

    def spend(self, frame: Frame, fuel: Value, oxidizer: Value, burns: Value) -> None:
        """Remember what was taken from the tanks in this frame [lbs]."""
        for slot, amount in (("fuel-spent", fuel), ("oxidizer-spent", oxidizer)):
            before = frame.memory(f"{self.key}/{slot}")
            frame.remember(f"{self.key}/{slot}", burns.choose(amount, before))


def read_rocket(scope: Scope, part: Part, name: str, index: str) -> Rocket:
    """Read a ``<rocket_engine>``; raises BadInputError with file and line."""
    node = part[1]
    refuse_tags(scope, node)
    isp = node.find("isp")
    if isp is None:
        scope.refuse(node, "<rocket_engine> has no <isp>")
    table, variation = node.find("thrust_table"), node.find("variation")

    def get(tag: str, default: float, unit: str = "") -> float:
        """Return a number of the file, or JSBSim's default."""
        return number(scope, node, tag, default, unit)

    flow = get("propflowmax", 0.0, "LBS/SEC")
    if node.find("slfuelflowmax") is not None:
        flow = get("slfuelflowmax", 0.0, "LBS/SEC") + get("sloxiflowmax", 0.0, "LBS/SEC")
    varies = (0.0, 0.0)
    if table is not None and variation is not None:
        varies = (
            number(scope, variation, "thrust", 0.0),
            number(scope, variation, "total_isp", 0.0),
        )
    return Rocket(
        name,
        index,
        part,
        flow,
        get("minthrottle", 0.0),
        get("builduptime", 0.0),
        isp.find("function"),
        None if table is None else grid(scope, table),
        varies,
    )
