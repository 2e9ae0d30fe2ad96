"""The only module that imports JSBSim: opens models and scripts, and turns failures into messages.

JSBSim 1.3.3 fails in four ways: a loader returns False, an exception, a silent NaN, and the end of
the process (a property that a function reads but nothing defines: first an exception, then an abort
when the object is destroyed). All are handled here, so that callers only see
:class:`~uqharness.errors.BadInputError`.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import jsbsim

from uqharness.errors import BadInputError
from uqharness.simulator import settling
from uqharness.simulator.staging import Staging

JSBSIM_VERSION: str = jsbsim.__version__

RuntimeFailure = RuntimeError
"""Exception class of JSBSim's errors, and of illegal property names."""

_MISSING = re.compile(
    r"[Pp]roperty\s+\"?([^\s\"]+?)\"?\s+(?:does not exist|is not defined|not found|is undefined)"
)
_MAX_MESSAGES, _MAX_PATHS = 200, 64
_LEGAL_NAME = re.compile(r"/?[A-Za-z_][\w.\-]*(\[\d+\])?(/[A-Za-z_][\w.\-]*(\[\d+\])?)*")


LEANING = 0.8
"""Share of the pressure at sea level (1.8 km) from where rich mixtures are leaned."""
_SEA_LEVEL_PSF = 2116.22


class _Collector(jsbsim.FGLogger):
    """Logger that keeps warnings and errors, with their place in the XML, for messages."""

    def __init__(self) -> None:
        super().__init__()
        self.entries: list[tuple[int, str, str]] = []
        self._level = 0
        self._place = ""
        self.mirror: int | None = None

    def set_level(self, level: jsbsim.LogLevel) -> None:
        """Start a message of a level."""
        self._level = int(level)
        self._place = ""

    def file_location(self, filename: str, line: int) -> None:
        """Set the place of the message."""
        self._place = f"{filename}:{line}: "

    def message(self, message: str) -> None:
        """Keep a message if it is a warning or an error."""
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
        """Return the collected text and clear it."""
        text = " ".join((place + message).strip() for _, place, message in self.entries)
        self.entries.clear()
        return re.sub(r"\s+", " ", _with_user_paths(text)).strip()


_collector: _Collector | None = None
_user_paths: dict[str, str] = {}


def _register_user_paths(staging: Staging) -> None:
    """Remember which user folders a staging's copies stand for."""
    # Messages name the user's folders, of the newest stagings only.
    _user_paths.update((str(staged), str(real)) for staged, real in staging.user_folders)
    while len(_user_paths) > _MAX_PATHS:
        del _user_paths[next(iter(_user_paths))]


def _with_user_paths(text: str) -> str:
    """Return a message with the user's folders in place of the copies."""
    for staged, real in _user_paths.items():
        text = text.replace(staged, real)
    return text


def _collect() -> _Collector:
    """Return the process's only logger, installed at first use."""
    # JSBSim holds one logger; importing this module must not change it.
    global _collector
    if _collector is None:
        _collector = _Collector()
        jsbsim.set_logger(_collector)
    return _collector


def mirror_messages(descriptor: int) -> None:
    """Write each message to a file descriptor at once, for a process that may crash."""
    _collect().mirror = descriptor


def default_root() -> Path:
    """Return the folder of the aircraft, engines and scripts that come with JSBSim."""
    return Path(jsbsim.get_default_root_dir())


def _new(staging: Staging, dt_s: float) -> Any:
    """Return a quiet instance with the paths of a staging."""
    _collect().take()
    _register_user_paths(staging)
    fdm = jsbsim.FGFDMExec(str(staging.root))
    # Without a debug level JSBSim prints nothing.
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(staging.root / "aircraft"))
    fdm.set_engine_path(str(staging.root / "engine"))
    fdm.set_systems_path(str(staging.root / "systems"))
    # This folder does not exist: a model may request a state file in every frame
    # (simulation/write-state-file).
    fdm.set_output_path(str(staging.root / "nowhere"))
    fdm.set_dt(dt_s)
    return fdm


def open_fdm(staging: Staging, dt_s: float) -> Any:
    """Return a new ``FGFDMExec`` with the staged aircraft loaded, before initialisation.

    Parameters
    ----------
    staging : Staging
        Copy of the aircraft that passed the gate.
    dt_s : float
        Integration step [s], set before loading: filters compute their coefficients while read.

    Raises
    ------
    BadInputError
        With file and line, if JSBSim does not accept the model.
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
        reason = log.take() or "no reason given"
        hint = (
            "correct the XML at the first of these lines"
            if re.search(r"\.xml:\d+", reason)
            else f"expected {name}/{name}.xml with <metrics>, <mass_balance>,"
            " <ground_reactions> and <aerodynamics>"
        )
        raise BadInputError(f"aircraft '{name}': JSBSim could not load it: {reason}; {hint}")
    return fdm


def open_script(staging: Staging, script: str | Path, dt_s: float) -> Any:
    """Return a new ``FGFDMExec`` with run script, aircraft and initial conditions loaded.

    Raises BadInputError if JSBSim does not accept the script.
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
    """Initialise an instance.

    Raises BadInputError, which names properties that the XML reads but nothing defines. They are
    created first: destroying an instance without them aborts the interpreter.
    """
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
    # The instance must not be destroyed while a property is missing.
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
    """Start every engine with rich mixture and fine pitch; the throttles end wide open.

    Those of engines that lift are closed, as in the cruise of a quadplane.
    """
    fdm["propulsion/set-running"] = -1
    for name in levers(fdm):
        fdm[name] = 1.0
    for name in throttles(fdm)[1]:
        fdm[name] = 0.0


THROTTLE = "fcs/throttle-cmd-norm"
"""JSBSim's first throttle, which stands for the throttles of all engines that pull."""
_LIFTS = 0.87  # sine of the pitch of a thruster that lifts


def throttles(fdm: Any) -> tuple[list[str], list[str]]:
    """Return the throttle commands of the engines that pull, and of those that lift."""
    pulling: list[str] = []
    lifting: list[str] = []
    exists = fdm.get_property_manager().hasNode
    for k in range(fdm.get_propulsion().get_num_engines()):
        pitch = f"propulsion/engine[{k}]/pitch-angle-rad"
        is_lifting = exists(pitch) and abs(math.sin(fdm[pitch])) > _LIFTS
        (lifting if is_lifting else pulling).append(THROTTLE + (f"[{k}]" if k else ""))
    return (pulling, lifting) if pulling else (lifting, [])


def levers(fdm: Any) -> list[str]:
    """Return the command properties of mixture and propeller pitch of every engine."""
    engines = range(fdm.get_propulsion().get_num_engines())
    names = [
        f"fcs/{lever}-cmd-norm" + (f"[{k}]" if k else "")
        for k in engines
        for lever in ("mixture", "advance")
    ]
    manager = fdm.get_property_manager()
    return [name for name in names if manager.hasNode(name)]


def lean_mixtures(fdm: Any) -> dict[str, float]:
    """Lean rich mixtures where the air is thin, as a pilot does; return the levers and settings.

    JSBSim's piston engine mixes by 1.3 times the lever over the pressure ratio and dies of a ratio
    of 1.8. Below LEANING of the pressure at sea level the lever follows the pressure, which keeps
    the mixture of sea level. Levers that are not at 1 are somebody's choice.
    """
    ratio = fdm["atmosphere/P-psf"] / _SEA_LEVEL_PSF
    if not ratio < LEANING:
        return {}
    rich = [name for name in levers(fdm) if "mixture" in name and fdm[name] == 1.0]
    for name in rich:
        fdm[name] = ratio
    return dict.fromkeys(rich, ratio)


def settle_engines(fdm: Any) -> str:
    """Bring engines to the steady state of their levers with the aircraft's state unchanged.

    Uses JSBSim's own method if it converges, else frames with frozen motion (`settling`). Returns
    an empty text, or which engine does not settle or stops.
    """
    changing = ""
    lean_mixtures(fdm)
    fdm.get_propulsion().get_steady_state()
    renew_forces(fdm)
    # JSBSim's half-second steps did not converge.
    if not settling.is_balanced(fdm):
        try:
            changing = settling.settle(fdm)
        except RuntimeFailure as error:
            raise BadInputError(explain(fdm, error)) from None
        if not settling.has_turboprop(fdm):
            renew_forces(fdm)
    return settling.stopped_engines(fdm) or changing


def renew_forces(fdm: Any) -> None:
    """Run one frame without integration."""
    fdm.suspend_integration()
    try:
        fdm.run()
    except RuntimeFailure as error:
        raise BadInputError(explain(fdm, error)) from None
    finally:
        fdm.resume_integration()


def undefined_properties(fdm: Any, function_properties: Iterable[str] = ()) -> list[str]:
    """Return the properties that a loaded model reads and nothing defines.

    The instance is initialised and useless afterwards.

    Parameters
    ----------
    fdm : FGFDMExec
        The loaded model.
    function_properties : iterable of str
        Names in the functions of its XML. Initialisation does not evaluate all of them (a branch of
        an <ifthen>), but destroying the instance does, and aborts if one is missing.
    """
    log = _collect()
    log.take()
    exists = fdm.get_property_manager().hasNode
    # Before initialisation, which may create some.
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
    """Create the properties that ``text`` reports as missing until initialisation succeeds.

    Returns their names.
    """
    missing: list[str] = []
    # Each attempt reports one missing property.
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
    """Return a sentence for a RuntimeFailure, and make ``fdm`` safe to destroy."""
    text = _collect().take() or _one_line(error)
    disarm(fdm, text)
    return f"JSBSim stopped at {fdm.get_sim_time():.2f} s: {text}"


def set_property(fdm: Any, name: str, value: float) -> None:
    """Set an existing property; BadInputError if it does not exist.

    JSBSim itself would create a misspelt property silently.
    """
    require(fdm, [name])
    fdm[name] = value


def require(fdm: Any, names: Iterable[str]) -> None:
    """Raise BadInputError unless every property exists; the message suggests similar names."""
    manager = fdm.get_property_manager()
    for name in names:
        if not is_legal_name(name):
            # Other builds of JSBSim crash at such a name.
            raise BadInputError(
                f"property '{name}': not a legal JSBSim property name (letters, digits, _, -, / and"
                " [index])"
            )
        # Similar names of the loaded model help against typing errors.
        if not manager.hasNode(name):
            similar = difflib.get_close_matches(name, catalog(fdm), n=3, cutoff=0.6)
            hint = (
                f"; did you mean {', '.join(similar)}?"
                if similar
                else "; see the aircraft's XML for its properties"
            )
            raise BadInputError(f"property '{name}' does not exist in this model{hint}")


def is_legal_name(name: str) -> bool:
    """Return whether JSBSim's property tree accepts a name; others may crash the interpreter.

    Examples
    --------
    >>> is_legal_name("fcs/elevator-cmd-norm"), is_legal_name("a b")
    (True, False)
    """
    return _LEGAL_NAME.fullmatch(name) is not None


def catalog(fdm: Any) -> list[str]:
    """Return the names of all properties of the loaded model."""
    listing = fdm.query_property_catalog("")
    rows = listing.splitlines() if isinstance(listing, str) else list(listing)
    return [row.split(" (")[0].strip() for row in rows if row.strip()]


@lru_cache(maxsize=1)
def _without_model() -> Any:
    """Return the properties of an instance without a model."""
    _collect().take()
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    return fdm.get_property_manager(), fdm


@lru_cache(maxsize=4096)
def exists_without_model(name: str) -> bool:
    """Return whether JSBSim has a property whatever the model is."""
    return bool(_without_model()[0].hasNode(name))


def writable(fdm: Any) -> list[str]:
    """Return the names of the loaded model's properties that can be set."""
    listing = fdm.query_property_catalog("")
    rows = listing.splitlines() if isinstance(listing, str) else list(listing)
    return [row.split(" (")[0].strip() for row in rows if "W" in row.rpartition("(")[2]]


def handle(fdm: Any, name: str) -> Any:
    """Return the node of a property, whose getter and setter are fast enough for loops."""
    require(fdm, [name])
    return fdm.get_property_manager().get_node(name)


def _one_line(error: BaseException) -> str:
    """Return an error's text in one line."""
    return re.sub(r"\s+", " ", str(error)).strip()


def _plural(word: str, items: list[str]) -> str:
    """Return "a property", or their number."""
    return f"a {word}" if len(items) == 1 else f"{len(items)} {word[:-1]}ies"
