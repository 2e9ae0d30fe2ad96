"""A frame while it is traced: what stands in each property at this place of the frame, and the sections that come of it.

Properties are slots of the state. A property that nothing ever writes is a constant, folded where it is read, unless it is one of
the ``inputs`` that differ from lane to lane. ``writers`` must be known before the first section is traced, because a property may
be read before it is written: it then has the value of the frame before.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager

from uqharness.batch.form.angles import without_angles
from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.form.program import Program, Section, Stream, When
from uqharness.batch.translate.scope import Scope, canonical
from uqharness.errors import BadInputError
from uqharness.xml import Document, Node

TIME = "simulation/sim-time-sec"
STEP = "#step"
"""Slot of the step [s] where it is a number of the lane."""
MOST_SECTIONS, MOST_OPERATIONS, MOST_SLOTS = 2_000, 60_000, 2_500
"""Of a frame: E-SPAARO has 40, 3,800 and 520. At the limits compiling takes some ten seconds."""
BEYOND = "#beyond"
"""Slot that is not 0 once a function had an argument beyond the engine's range: what the lane flies from there is not JSBSim's."""
INITIALISED = "initialised:"
"""Before a property's name: its value behind JSBSim's initialising frames."""


class Values(dict[str, float]):
    """Values of properties before the first frame, by their canonical names, each asked for once.

    value_of   the value, None: there is no such property
    constant   whether a property that nobody writes keeps its value: others change in JSBSim, which nobody computes here
    """

    def __init__(
        self,
        value_of: Callable[[str], float | None],
        constant: Callable[[str], bool] = lambda _: True,
    ) -> None:
        super().__init__()
        self._value_of = value_of
        self.constant = constant
        self._absent: set[str] = set()

    def __contains__(self, name: object) -> bool:
        return self._found(str(name)) is not None

    def __missing__(self, name: str) -> float:
        found = self._found(name)
        if found is None:
            raise KeyError(name)
        return found

    def get(self, name: str, default: float | None = None) -> float | None:  # type: ignore[override]
        """The value; ``default`` where there is no such property."""
        found = self._found(name)
        return default if found is None else found

    def setdefault(self, name: str, default: float = 0.0) -> float:
        """The value; where there is none, ``default`` from now on."""
        found = self._found(name)
        if found is None:
            self[name] = found = default
        return found

    def _found(self, name: str) -> float | None:
        if dict.__contains__(self, name):
            return dict.__getitem__(self, name)
        if name in self._absent:
            return None
        value = None if name.startswith("#") else self._value_of(name)
        if value is None:
            self._absent.add(name)
            return None
        self[name] = value
        return value


class Frame:
    """Traces one frame.

    dt_s       step of the frame, 0 while JSBSim initialises
    values     property to its value before the first frame: declared ones, and those of JSBSim's own models
    written    properties that are written in some frame: they are state; None: not known yet, every property is taken for one,
               and ``writes`` has them when all is traced
    inputs     properties whose value may differ between lanes and is never written

    ``live`` has properties that are computed wherever they are read, as JSBSim does with a function that has not been run yet;
    ``hooks`` those whose setting moves more than themselves.
    """

    def __init__(
        self,
        dt_s: float,
        values: Mapping[str, float],
        written: Collection[str] | None,
        inputs: Collection[str] = (),
        any_step: bool = False,
    ) -> None:
        self.dt_s, self.any_step = dt_s, any_step
        self.values = (
            values
            if isinstance(values, Values)
            else {canonical(n): float(v) for n, v in values.items()}
        )
        self.written = None if written is None else frozenset(canonical(name) for name in written)
        self.writes: set[str] = set()
        self.inputs = frozenset(canonical(name) for name in inputs)
        self.builder = Builder()
        self.sections: list[Section] = []
        self.streams: list[Stream] = []
        self.draws: list[tuple[str, int]] = []
        self.live: dict[str, Callable[[], Value]] = {}
        self.hooks: dict[str, Callable[[Frame, Value], None]] = {}
        self._when: When | None = None
        self._name = ""
        self._operations = 0
        self._slots: set[str] = set()

    @property
    def step(self) -> Value:
        """The step of the frame [s]."""
        return self.builder.constant(self.dt_s) if self.initialising else self.load_step

    @property
    def load_step(self) -> Value:
        """The step at which the aircraft was loaded [s], from which its filters' coefficients are made."""
        return (
            self.memory(STEP[1:], self.dt_s) if self.any_step else self.builder.constant(self.dt_s)
        )

    @property
    def initialising(self) -> bool:
        """Whether time stands still: JSBSim runs two such frames before a flight."""
        return self.dt_s == 0.0

    @contextmanager
    def section(self, name: str, when: When | None = None) -> Iterator[None]:
        """What is traced inside becomes one section. Sections do not nest; values of one are not for use in another."""
        if self._when is not None:
            raise RuntimeError(f"section {name} inside section {self._name}")
        self._when, self._name = when or When(), name
        self.builder = Builder()
        yield
        self.sections.append(Section(name, self.builder.finish({}), self._when))
        self._when = None
        self._refuse_too_large()

    def _refuse_too_large(self) -> None:
        """Refuse a frame that would keep the compiler busy for minutes, as soon as it is one."""
        function = self.sections[-1].function
        self._operations += len(function.nodes)
        self._slots.update(function.slots)
        for count, most, words in (
            (len(self.sections), MOST_SECTIONS, "components and functions"),
            (self._operations, MOST_OPERATIONS, "operations a frame"),
            (len(self._slots), MOST_SLOTS, "numbers of state (each frame of a delay is one)"),
        ):
            if count > most:
                raise BadInputError(
                    f"too large for the batch engine: more than {most} {words}; "
                    'fly this aircraft with engine = "jsbsim"'
                )

    def read(self, name: str) -> Value | None:
        """What the property stands at here; None if nothing makes it."""
        name = canonical(name)
        if name in self.live:
            return self.live[name]()
        if self.written is None:
            return self.builder.load(name)
        if name in self.written or name in self.inputs:
            self.values.setdefault(name, 0.0)
            return self.builder.load(name)
        if isinstance(self.values, Values) and not self.values.constant(name):
            return None
        value = self.values.get(name)
        return None if value is None else self.builder.constant(value)

    def get(self, name: str) -> Value:
        """The same of a property that the engine itself makes. KeyError if it does not."""
        value = self.read(name)
        if value is None:
            raise KeyError(name)
        return value

    def write(self, name: str, value: Value | float) -> None:
        """Put a value into a property, from here on, as the XML does: what JSBSim does besides is done by its hook."""
        name = canonical(name)
        hook = self.hooks.get(name)
        if hook is None:
            self.store(name, value)
        else:
            hook(self, self.builder.value(value))

    def store(self, name: str, value: Value | float) -> None:
        """The same without the hook."""
        name = canonical(name)
        self.writes.add(name)
        if self.written is not None and name not in self.written:
            raise KeyError(f"{name} is written here, which was not foreseen")
        self.values.setdefault(name, 0.0)
        self.builder.store(name, value)

    def memory(self, name: str, first: float = 0.0) -> Value:
        """A slot that is no property: what ``remember`` put there, in the frame before ``first``. Its name begins with '#'."""
        self.values.setdefault(f"#{name}", first)
        return self.builder.load(f"#{name}")

    def remember(self, name: str, value: Value | float, first: float = 0.0) -> None:
        """Put a value into such a slot."""
        self.values.setdefault(f"#{name}", first)
        self.builder.store(f"#{name}", value)

    def scope(self, document: Document) -> Scope:
        """For translating elements of ``document`` inside the present section."""
        return Scope(self.builder, document, self.read, self._draw_for(document), self._note_beyond)

    def _note_beyond(self, condition: Value) -> None:
        if condition.constant is not None and not condition.constant:
            return
        self.remember(BEYOND[1:], condition.choose(1.0, self.memory(BEYOND[1:])))

    def normal(self) -> Value | None:
        """A standard normal that is drawn here; None in a section in which lanes draw at different times."""
        assert self._when is not None
        if self.written is not None and (self._when.mask is not None or self._when.at is not None):
            return None
        name = f"#draw/{len(self.draws)}"
        self.draws.append((name, self._when.every))
        self.values[name] = 0.0
        return self.builder.load(name)

    def _draw_for(self, document: Document) -> Callable[[Node], Value | None]:
        def draw(node: Node) -> Value | None:
            return None if node.tag != "random" or "seed" in node.attributes else self.normal()

        return draw

    def program(self, records: Collection[str], streams: Collection[Stream] = ()) -> Program:
        """All sections as a program."""
        slots: dict[str, float] = {}
        for section in self.sections:
            for name in section.function.slots:
                slots.setdefault(name, self.values[name])
        for stream in streams:
            for name in stream.columns:
                slots.setdefault(name, 0.0)
        for name in records:
            slots.setdefault(canonical(name), self.values[canonical(name)])
        return without_angles(
            Program(
                tuple(self.sections),
                slots,
                tuple(streams),
                tuple(canonical(name) for name in records),
            )
        )
