"""JSBSim: the one file that imports it. Opens models and scripts quietly, turns its failures into
sentences.

JSBSim 1.3.3 has four ways to fail: ``False`` from a loader, an exception, a silent NaN, and the end
of the whole process (a property that a function reads but nobody made: the exception comes first,
the abort when the object is destroyed). Each is met here, so that the callers see
:class:`~uqharness.errors.BadInputError` and nothing else."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jsbsim

from uqharness.errors import BadInputError
from uqharness.simulator import settling
from uqharness.simulator.staging import Staging

JSBSIM_VERSION: str = jsbsim.__version__

RuntimeFailure = RuntimeError
"""What JSBSim throws: its own errors, which derive from it, and the bare one of an illegal property
name.
"""

_MISSING = re.compile(
    r"[Pp]roperty\s+\"?([^\s\"]+?)\"?\s+(?:does not exist|is not defined|not found|is undefined)"
)
_MAX_MESSAGES, _MAX_PATHS = 200, 64
_LEGAL_NAME = re.compile(r"/?[A-Za-z_][\w.\-]*(\[\d+\])?(/[A-Za-z_][\w.\-]*(\[\d+\])?)*")


class _Collector(jsbsim.FGLogger):
    """Keeps warnings and errors with their place in the XML instead of printing them."""

    def __init__(self) -> None:
        super().__init__()
        self.entries: list[tuple[int, str, str]] = []
        self._level = 0
        self._place = ""
        self.mirror: int | None = None

    def set_level(self, level: jsbsim.LogLevel) -> None:
        self._level = int(level)
        self._place = ""

    def file_location(self, filename: str, line: int) -> None:
        self._place = f"{filename}:{line}: "

    def message(self, message: str) -> None:
        if self._level >= int(jsbsim.LogLevel.ERROR) and self._level != int(jsbsim.LogLevel.STDOUT):
            # A model may complain in every frame of an hour.
            if len(self.entries) >= _MAX_MESSAGES:
                return
            self.entries.append((self._level, self._place, message))
            if self.mirror is not None:
                os.write(self.mirror, f"{_with_user_paths(self._place + message)}\n".encode())

    def format(self, format: jsbsim.LogFormat) -> None:
        pass

    def flush(self) -> None:
        pass

    def take(self) -> str:
        """Text of what was collected, and forget it."""
        text = " ".join((place + message).strip() for _, place, message in self.entries)
        self.entries.clear()
        return re.sub(r"\s+", " ", _with_user_paths(text)).strip()


_collector: _Collector | None = None
_user_paths: dict[str, str] = {}


def _register_user_paths(staging: Staging) -> None:
    # The reader knows their own folder, not a copy's; of many stagings only the newest are still
    # spoken of.
    _user_paths.update((str(staged), str(real)) for staged, real in staging.user_folders)
    while len(_user_paths) > _MAX_PATHS:
        del _user_paths[next(iter(_user_paths))]


def _with_user_paths(text: str) -> str:
    for staged, real in _user_paths.items():
        text = text.replace(staged, real)
    return text


def _collect() -> _Collector:
    # One logger for the process, set at first use: JSBSim keeps a single one, and importing this
    # file must change nothing.
    global _collector
    if _collector is None:
        _collector = _Collector()
        jsbsim.set_logger(_collector)
    return _collector


def mirror_messages(descriptor: int) -> None:
    """Write every message to that file descriptor as it comes: for a process that may not live to
    report it.
    """
    _collect().mirror = descriptor


def default_root() -> Path:
    """Folder of the aircraft, engines and scripts that come with JSBSim."""
    return Path(jsbsim.get_default_root_dir())


def _new(staging: Staging, dt_s: float) -> Any:
    _collect().take()
    _register_user_paths(staging)
    fdm = jsbsim.FGFDMExec(str(staging.root))
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(staging.root / "aircraft"))
    fdm.set_engine_path(str(staging.root / "engine"))
    fdm.set_systems_path(str(staging.root / "systems"))
    # No such folder: a model may ask for the state to be written in every frame
    # (simulation/write-state-file).
    fdm.set_output_path(str(staging.root / "nowhere"))
    fdm.set_dt(dt_s)
    return fdm


def open_fdm(staging: Staging, dt_s: float) -> Any:
    """A fresh ``FGFDMExec`` with the staged aircraft loaded and nothing run.

    The step is set before loading, because filters compute their coefficients while they are read.

    Raises BadInputError with file and line when JSBSim does not accept the model.
    """
    log = _collect()
    fdm = _new(staging, dt_s)
    name = staging.name
    try:
        loaded = fdm.load_model(name)
    except RuntimeFailure as error:
        raise BadInputError(
            f"aircraft '{name}': JSBSim refused its XML: {log.take() or _one_line(error)}"
        ) from None
    if not loaded:
        raise BadInputError(
            f"aircraft '{name}': JSBSim could not load it: {log.take() or 'no reason given'};"
            f" expected {name}/{name}.xml with <metrics>, <mass_balance>, <ground_reactions> and"
            " <aerodynamics>"
        )
    return fdm


def open_script(staging: Staging, script: str | Path, dt_s: float) -> Any:
    """A fresh ``FGFDMExec`` with a run script that passed the gate, the staged aircraft and its
    initial conditions, nothing run.
    """
    log = _collect()
    fdm = _new(staging, dt_s)
    try:
        loaded = fdm.load_script(str(script), dt_s)
    except RuntimeFailure as error:
        raise BadInputError(
            f"script {script}: JSBSim refused it: {log.take() or _one_line(error)}"
        ) from None
    if not loaded:
        raise BadInputError(
            f"script {script}: JSBSim could not load it: {log.take() or 'no reason given'}"
        )
    return fdm


def run_ic(fdm: Any) -> None:
    """Initialise, and name a property that the XML reads but never makes.

    Raises BadInputError. The missing properties are created first: destroying an ``FGFDMExec`` that
    lacks them aborts the interpreter, whatever Python catches."""
    log = _collect()
    log.take()
    try:
        if fdm.run_ic():
            if not fdm["inertia/mass-slugs"] > 0.0:
                raise BadInputError(
                    f"the model's mass is {fdm['inertia/mass-slugs']:g} slug: a positive one is"
                    " needed in <mass_balance>"
                )
            return
        raise BadInputError(
            f"JSBSim could not initialise the flight: {log.take() or 'no reason given'}"
        )
    except RuntimeFailure as error:
        text = log.take() or _one_line(error)
    missing = disarm(fdm, text)
    log.take()
    if missing:
        raise BadInputError(
            f"the model reads {_plural('property', missing)} that nothing defines:"
            f" {', '.join(missing)} ({text}); declare it in the XML, as <property"
            ' value="0">name</property>'
        )
    raise BadInputError(f"JSBSim could not initialise the flight: {text}")


def start_engines(fdm: Any) -> None:
    """Every engine runs, with rich mixture and fine pitch, which no flight record tells; its
    throttle is left wide open.
    """
    fdm["propulsion/set-running"] = -1
    for name in levers(fdm):
        fdm[name] = 1.0


def levers(fdm: Any) -> list[str]:
    """The commands of every engine's mixture and propeller pitch: 1 is rich and fine."""
    engines = range(fdm.get_propulsion().get_num_engines())
    names = [
        f"fcs/{lever}-cmd-norm" + (f"[{k}]" if k else "")
        for k in engines
        for lever in ("mixture", "advance")
    ]
    manager = fdm.get_property_manager()
    return [name for name in names if manager.hasNode(name)]


def settle_engines(fdm: Any) -> str:
    """Bring <propulsion> engines to the steady state of their throttles and renew the forces, the
    aircraft's state unmoved.

    JSBSim's own way where it arrives, else by frames with the motion frozen (see settling). Empty,
    or which engine does not settle or stands still."""
    changing = ""
    fdm.get_propulsion().get_steady_state()
    renew_forces(fdm)
    if not settling.is_balanced(fdm):
        try:
            changing = settling.settle(fdm)
        except RuntimeFailure as error:
            raise BadInputError(explain(fdm, error)) from None
        if not settling.has_turboprop(fdm):
            renew_forces(fdm)
    return settling.stopped_engines(fdm) or changing


def renew_forces(fdm: Any) -> None:
    """One frame in which time stands still."""
    fdm.suspend_integration()
    try:
        fdm.run()
    except RuntimeFailure as error:
        raise BadInputError(explain(fdm, error)) from None
    finally:
        fdm.resume_integration()


def undefined_properties(fdm: Any, function_properties: Iterable[str] = ()) -> list[str]:
    """Names that the loaded model reads and nobody makes. Initialises the instance, which serves
    for nothing else afterwards.

    ``function_properties`` are the names in the functions of the model's XML. Initialising does not
    evaluate all of them (a branch of an <ifthen> that is not taken), but JSBSim evaluates named
    functions once more when the instance is destroyed: one that is missing then aborts the
    interpreter."""
    log = _collect()
    log.take()
    exists = fdm.get_property_manager().hasNode
    unmade = [name for name in dict.fromkeys(function_properties) if not exists(name)]
    missing: list[str] = []
    try:
        fdm.run_ic()
    except RuntimeFailure as error:
        missing = disarm(fdm, log.take() or _one_line(error))
    for name in unmade:
        if not exists(name):
            fdm[name] = 0.0
            missing.append(name)
    return missing


def disarm(fdm: Any, text: str) -> list[str]:
    """Create the properties whose absence ``text`` complains of until initialising no longer does;
    their names.
    """
    missing: list[str] = []
    for _ in range(1000):
        match = _MISSING.search(text)
        if match is None or match.group(1) in missing:
            break
        missing.append(match.group(1))
        fdm[match.group(1)] = 0.0
        try:
            fdm.run_ic()
            break
        except RuntimeFailure as error:
            text = _one_line(error)
    return missing


def explain(fdm: Any, error: BaseException) -> str:
    """A sentence for a RuntimeFailure; leaves ``fdm`` in a state in which it can be destroyed."""
    text = _collect().take() or _one_line(error)
    disarm(fdm, text)
    return f"JSBSim stopped at {fdm.get_sim_time():.2f} s: {text}"


def set_property(fdm: Any, name: str, value: float) -> None:
    """Set an existing property. JSBSim itself would create a misspelt one without a word; here that
    is BadInputError.
    """
    require(fdm, [name])
    fdm[name] = value


def require(fdm: Any, names: Iterable[str]) -> None:
    """BadInputError unless every property exists; suggests the nearest names."""
    manager = fdm.get_property_manager()
    for name in names:
        if not is_legal_name(name):
            # Property trees of other JSBSim builds end the interpreter at such a name, so it must
            # never get there.
            raise BadInputError(
                f"property '{name}': not a legal JSBSim property name (letters, digits, _, -, / and"
                " [index])"
            )
        if not manager.hasNode(name):
            similar = difflib.get_close_matches(name, catalog(fdm), n=3, cutoff=0.6)
            hint = (
                f"; did you mean {', '.join(similar)}?"
                if similar
                else "; see the aircraft's XML for its properties"
            )
            raise BadInputError(f"property '{name}' does not exist in this model{hint}")


def is_legal_name(name: str) -> bool:
    """Whether JSBSim's property tree accepts the name; at another one it may end the
    interpreter.
    """
    return _LEGAL_NAME.fullmatch(name) is not None


def catalog(fdm: Any) -> list[str]:
    """Names of all properties of the loaded model, without JSBSim's access remarks."""
    listing = fdm.query_property_catalog("")
    rows = listing.splitlines() if isinstance(listing, str) else list(listing)
    return [row.split(" (")[0].strip() for row in rows if row.strip()]


def handle(fdm: Any, name: str) -> Any:
    """Bound node of a property (``get_double_value``, ``set_double_value``), for hot loops."""
    require(fdm, [name])
    return fdm.get_property_manager().get_node(name)


def _one_line(error: BaseException) -> str:
    return re.sub(r"\s+", " ", str(error)).strip()


def _plural(word: str, items: list[str]) -> str:
    return f"a {word}" if len(items) == 1 else f"{len(items)} {word[:-1]}ies"
