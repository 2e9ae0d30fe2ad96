"""Translate a run script's events.

As experiments with JSBSim 1.3.3 show: events are evaluated in the order of the script after the
clock has advanced, before anything else of the frame, and not while JSBSim initialises. All new
values of an event are computed before the first is set. An event triggers once; a ``persistent`` or
``continuous`` one triggers again whenever its condition has been false. It acts ``delay`` seconds
later if it is still triggered: at once, along a ramp of ``tc`` seconds, or on an exponential that
never ends. While it stays triggered, a continuous event sets its values in every frame and
evaluates functions anew. FG_BOOL sets the number as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from uqharness.batch.ir import Value
from uqharness.batch.program import When
from uqharness.batch.translate.frame import TIME, Frame, Scope, canonical, writable
from uqharness.batch.translate.functions import function_value
from uqharness.xml import Document, Node

# Tests of switches, distributors and events: lines of a property, a comparison and a value,
# joined by AND or OR.

COMPARISONS = {
    word: word.lower()
    for word in ("EQ", "NE", "GT", "GE", "LT", "LE", "eq", "ne", "gt", "ge", "lt", "le")
}
COMPARISONS |= {"==": "eq", "!=": "ne", ">": "gt", ">=": "ge", "<": "lt", "<=": "le"}
"""Words and signs of comparisons."""


def condition(scope: Scope, node: Node) -> Value:
    """Return whether a ``<test>`` or ``<condition>`` holds.

    Its lines and nested elements of the same name are joined by AND or, with ``logic="OR"``, by OR;
    all are evaluated. The caller handles the attributes of ``node`` except ``logic``. Raises
    BadInputError with file and line for what JSBSim drops or the engine does not support.
    """
    b = scope.builder
    logic = node.attributes.get("logic", "AND") or "AND"
    if logic not in ("AND", "OR"):
        scope.refuse(node, f"logic='{logic}' of <{node.tag}>: allowed are AND and OR")
    # Lines and nested elements are joined by the same operator.
    parts = [_comparison(scope, node, line) for line in node.text.split("\n") if line.strip()]
    for child in node.children:
        if child.tag != node.tag:
            scope.refuse(
                child,
                f"<{child.tag}> in <{node.tag}> is not supported; allowed are lines and"
                f" <{node.tag}>",
            )
        scope.only(child, ("logic",))
        parts.append(condition(scope, child))
    if not parts:
        scope.refuse(
            node,
            f"<{node.tag}> has no comparison; a line is a property, a comparison, and a property or"
            " number",
        )
    result = parts[0]
    for part in parts[1:]:
        result = b.op("and" if logic == "AND" else "or", result, part)
    return result


def _comparison(scope: Scope, node: Node, line: str) -> Value:
    """Return the truth of one line. JSBSim splits at blanks only, not at tabs."""
    words = [word.strip() for word in line.strip().split(" ") if word.strip()]
    if (
        len(words) != 3
        or words[1] not in COMPARISONS
        or any(len(word.split()) != 1 for word in words)
    ):
        allowed = ", ".join(COMPARISONS)
        scope.refuse(
            node,
            f"a comparison is 'property sign value', blanks between, sign one of {allowed};"
            f" received {line.strip()!r}",
        )
    return scope.builder.op(
        COMPARISONS[words[1]], scope.named_property(node, words[0]), scope.parameter(node, words[2])
    )


_PARTS = ("description", "documentation", "notify", "property", "condition", "set", "delay")
_TYPES = {"": "value", "value": "value", "delta": "delta", "bool": "value"}
_ACTIONS = {"": "step", "step": "step", "ramp": "ramp", "exp": "exp"}
_TRUTHS = ("true", "false", "")


def trace_events(frame: Frame, document: Document) -> None:
    """Trace every event: a section that finds the lanes in which it acts in this frame, and
    sections that act there.
    """
    run = document.root.find("run")
    if run is None or frame.initialising:
        return
    for number, event in enumerate(run.all("event")):
        _Event(frame, document, event, f"event/{number}").trace()


@dataclass(frozen=True)
class SetAction:
    """A ``<set>``: property, number or function, and kind of action.

    ``tc_s`` is the time constant of a ramp or exponential.
    """

    node: Node
    name: str
    delta: bool
    action: str
    tc_s: float
    function: Node | None


@dataclass(frozen=True)
class _Event:
    """An event in the frame that is traced; ``key`` is the prefix of its memory."""

    frame: Frame
    document: Document
    node: Node
    key: str

    def trace(self) -> None:
        """Add the sections of the event."""
        scope = self.frame.scope(self.document)
        scope.only(self.node, ("name", "persistent", "continuous"))
        # Refuse what JSBSim would treat differently.
        for child in self.node.children:
            if child.tag not in _PARTS:
                scope.refuse(
                    child,
                    f"<{child.tag}> of an event is not supported; condition, set, delay and"
                    " notify are",
                )
        for word in ("persistent", "continuous"):
            if self.node.attributes.get(word, "") not in _TRUTHS:
                scope.refuse(
                    self.node,
                    f"{word}='{self.node.attributes[word]}' of an event: allowed are true and"
                    " false",
                )
        continuous = self.node.attributes.get("continuous") == "true"
        repeats = continuous or self.node.attributes.get("persistent") == "true"
        delays = self.node.all("delay")
        if len(delays) > 1:
            scope.refuse(delays[1], "an event has at most one <delay>")
        sets = [self._set(scope, item) for item in self.node.all("set")]
        delay_s = scope.number(delays[0]) if delays else 0.0
        with self.frame.section(f"{self.key}: whether"):
            starts = self._triggered(repeats)
            self.frame.remember(f"{self.key}/starts", starts.choose(1.0, 0.0))
        # A single immediate step needs no memory of its progress.
        if not delays and not repeats and all(item.action == "step" for item in sets):
            with self.frame.section(self.key, When(mask=f"#{self.key}/starts")):
                for item, (_, value) in zip(sets, self._new_values(sets), strict=True):
                    self.frame.write(item.name, value)
            return
        self._gradual(sets, delay_s, continuous)

    def _triggered(self, repeats: bool) -> Value:
        """Return whether the event triggers in this frame."""
        frame, b = self.frame, self.frame.builder
        scope = frame.scope(self.document)
        conditions = self.node.all("condition")
        if len(conditions) != 1:
            scope.refuse(self.node, f"an event has one <condition>; received {len(conditions)}")
        true = condition(scope, conditions[0])
        before = frame.memory(f"{self.key}/triggered").ne(0.0)
        triggered = true if repeats else b.op("or", true, before)
        frame.remember(f"{self.key}/triggered", triggered.choose(1.0, 0.0))
        return b.op("and", true, b.op("not", before))

    def _gradual(self, sets: Sequence[SetAction], delay_s: float, continuous: bool) -> None:
        """Add the sections of an event that acts later, gradually or repeatedly."""
        frame, key = self.frame, self.key
        # When it triggers: remember old and new values, and the time of action.
        with frame.section(f"{key}: begin", When(mask=f"#{key}/starts")):
            for number, (old, new) in enumerate(self._new_values(sets)):
                for name, value in (("from", old), ("to", new), ("moves", 1.0)):
                    frame.remember(f"{key}/{number}/{name}", value)
            frame.remember(f"{key}/at", frame.get(TIME) + delay_s)
        with frame.section(f"{key}: whether it acts"):
            b = frame.builder
            is_acting = b.op(
                "and",
                frame.memory(f"{key}/triggered").ne(0.0),
                frame.get(TIME).ge(frame.memory(f"{key}/at")),
            )
            for number in range(len(sets)):
                moves = b.op("and", is_acting, frame.memory(f"{key}/{number}/moves").ne(0.0))
                frame.remember(f"{key}/{number}/acts", moves.choose(1.0, 0.0))
        # Each action ends at its own time.
        for number, item in enumerate(sets):
            with frame.section(f"{key}: set {number}", When(mask=f"#{key}/{number}/acts")):
                self._act(item, f"{key}/{number}", continuous)

    def _act(self, item: SetAction, key: str, continuous: bool) -> None:
        """Write the value of one action in this frame."""
        frame, b = self.frame, self.frame.builder
        old, new = frame.memory(f"{key}/from"), frame.memory(f"{key}/to")
        since = frame.get(TIME) - frame.memory(f"{self.key}/at")
        # Step, ramp or exponential
        if item.action == "step":
            if continuous and item.function is not None:
                new = function_value(frame.scope(self.document), item.function)
            over, value = b.truth(True), new
        elif item.action == "ramp":
            over = b.op("not", since.le(item.tc_s))
            value = over.choose(new, since / item.tc_s * (new - old) + old)
        else:
            over, value = (
                b.truth(False),
                (1.0 - b.op("exp", -since / item.tc_s)) * (new - old) + old,
            )
        frame.write(item.name, value)
        if not continuous:
            frame.remember(f"{key}/moves", over.choose(0.0, frame.memory(f"{key}/moves")))

    def _set(self, scope: Scope, node: Node) -> SetAction:
        """Read a ``<set>``; refuse what the engine does not support."""
        scope.only(node, ("name", "value", "type", "action", "tc"))
        name = canonical(node.attributes.get("name", ""))
        if not writable(name):
            scope.refuse(
                node,
                f"property {name} cannot be set by an event: JSBSim does more with it than keep its"
                " value",
            )
        if self.frame.read(name) is None or (
            self.frame.written_properties is None and name not in self.frame.values
        ):
            scope.refuse(node, f"property {name} is not computed by the batch engine")
        # JSBSim accepts the kinds with and without FG_.
        words = [
            node.attributes.get(word, "").strip().lower().removeprefix("fg_")
            for word in ("type", "action")
        ]
        if words[0] not in _TYPES or words[1] not in _ACTIONS:
            scope.refuse(
                node,
                "a <set> has type FG_VALUE, FG_DELTA or FG_BOOL and action FG_STEP, FG_RAMP or"
                " FG_EXP",
            )
        # Either a number or one function.
        functions = node.all("function")
        if (
            bool(node.attributes.get("value", "")) == bool(functions)
            or len(functions) > 1
            or len(node.children) != len(functions)
        ):
            scope.refuse(node, "a <set> has either a value or a function")
        tc_s = scope.number(node, node.attributes["tc"]) if node.attributes.get("tc", "") else 1.0
        return SetAction(
            node,
            name,
            _TYPES[words[0]] == "delta",
            _ACTIONS[words[1]],
            tc_s,
            functions[0] if functions else None,
        )

    def _new_values(self, sets: Sequence[SetAction]) -> list[tuple[Value, Value]]:
        """Return for each action the present and the new value of its property."""
        scope = self.frame.scope(self.document)
        out = []
        for item in sets:
            old = self.frame.get(item.name)
            if item.function is None:
                value = scope.builder.constant(
                    scope.number(item.node, item.node.attributes["value"])
                )
            else:
                value = function_value(scope, item.function)
            out.append((old, old + value if item.delta else value))
        return out
