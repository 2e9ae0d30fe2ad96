"""Run scripts: finding and reading one, and a staged copy for any aircraft and duration.

`read_script` extracts what a host needs to know. `StagedMission` copies aircraft and script into a
private folder, from which fresh instances are opened.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from lxml import etree

from sysid.foreign.regular_files import sha256_hex
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, Aircraft, check_loadable, parse_xml, stage
from uqharness.simulator.mass import MassChange
from uqharness.simulator.staging import Staging, leads_out, read_xml, screen_file, walk

ENDLESS_S = 1e9
"""End time of a staged script [s]; the host counts steps."""
MANOEUVRE_PROPERTY = "flight/manoeuvre"
"""Number of the manoeuvre in progress; 0 between manoeuvres.

The name of the event that sets it is the manoeuvre's name.
"""


@dataclass(frozen=True)
class Script:
    """Content of a run script.

    Attributes
    ----------
    path : Path
        The file.
    aircraft, initialize : str
        Aircraft and initial conditions that it names.
    end_s, dt_s : float
        End time and step [s].
    event_properties : tuple of (str, int)
        Properties that events set, with their lines.
    run_properties : tuple of str
        Properties set at the start.
    manoeuvres : mapping
        Number to name of each manoeuvre.
    """

    path: Path
    aircraft: str
    initialize: str
    end_s: float
    dt_s: float
    event_properties: tuple[tuple[str, int], ...]
    run_properties: tuple[str, ...]
    manoeuvres: Mapping[int, str] = field(default_factory=dict)


def find_script(name_or_path: str | Path, folder: Path | None = None) -> Path:
    """Return the file of a run script.

    Parameters
    ----------
    name_or_path : str or Path
        Path relative to ``folder``, the working folder or the project, or a name in scripts/.
    folder : Path, optional
        Folder that is searched first.

    Raises
    ------
    BadInputError
        If there is none; the message lists the names.
    """
    requested = Path(name_or_path)
    candidates = [
        *([] if folder is None else [folder / requested]),
        requested,
        requested.with_suffix(".xml"),
    ]
    # Names are searched in the working folder before the project.
    for root in (Path.cwd(), PROJECT_ROOT):
        candidates += [
            root / requested,
            root / "scripts" / requested,
            (root / "scripts" / requested).with_suffix(".xml"),
        ]
    for path in candidates:
        if path.is_file():
            return path.resolve()
    available = sorted(path.stem for path in (PROJECT_ROOT / "scripts").glob("*.xml"))
    raise BadInputError(
        f"script '{name_or_path}' not found: no such file, and scripts/ has"
        f" {', '.join(available) or 'none'}"
    )


def read_script(path: Path) -> Script:
    """Parse a run script. Raises BadInputError with file and line."""
    root = parse_xml(path).getroot()
    if root.tag != "runscript":
        raise BadInputError(
            f"{path}:{root.sourceline}: the root element is <{root.tag}>, a run script begins with"
            " <runscript>"
        )
    # Both elements are required by JSBSim.
    use, run = root.find("use"), root.find("run")
    if use is None or run is None:
        raise BadInputError(
            f"{path}:{root.sourceline}: a run script needs <use aircraft=... initialize=...> and"
            " <run end=... dt=...>"
        )
    numbers = {key: _number(path, run, key) for key in ("end", "dt")}
    return Script(
        path=path,
        aircraft=use.get("aircraft", ""),
        initialize=use.get("initialize", ""),
        end_s=numbers["end"],
        dt_s=numbers["dt"],
        event_properties=tuple(
            (item.get("name", ""), _line(item)) for item in run.iterfind("event/set")
        ),
        run_properties=tuple((item.text or "").strip() for item in run.iterfind("property")),
        manoeuvres=_manoeuvres(path, run),
    )


def _manoeuvres(path: Path, run: etree._Element) -> dict[int, str]:
    """Return number and name of the manoeuvres that events announce."""
    names: dict[int, str] = {}
    for event in run.iterfind("event"):
        for item in event.iterfind("set"):
            if item.get("name") != MANOEUVRE_PROPERTY:
                continue
            text = item.get("value", "")
            if not text.isdigit():
                raise BadInputError(
                    f"{path}:{item.sourceline}: {MANOEUVRE_PROPERTY} is set to '{text}'; a whole"
                    " number of at least 0 is needed"
                )
            # Zero ends a manoeuvre and has no name.
            if int(text):
                names[int(text)] = event.get("name", text)
    return names


def _line(element: etree._Element) -> int:
    """Return the line of an element; 0 if unknown."""
    line = element.sourceline
    return line if isinstance(line, int) else 0


def _number(path: Path, element: etree._Element, key: str) -> float:
    """Return a positive attribute of <run>."""
    text = element.get(key)
    try:
        value = float(text if text is not None else "")
    except ValueError:
        raise BadInputError(
            f"{path}:{element.sourceline}: <run {key}=...> is {text!r}, a positive number of"
            " seconds is needed"
        ) from None
    if not 0.0 < value < float("inf"):
        raise BadInputError(
            f"{path}:{element.sourceline}: <run {key}=...> is {text!r}, a positive number of"
            " seconds is needed"
        )
    return value


def refuse_conflicts(script: Script, varied: Iterable[str]) -> None:
    """Raise BadInputError if an event sets a property that the host varies.

    The event would silently replace the host's value.
    """
    varied_names = set(varied)
    for name, line in script.event_properties:
        if name in varied_names:
            raise BadInputError(
                f"{script.path}:{line}: an event sets {name}, which this run varies; "
                'set it as <property value="...">' + name + "</property> within <run> instead"
            )


class StagedMission:
    """A script made ready for an aircraft; opens new instances until it is closed.

    The copy uses this aircraft, ends at ``end_s``, and neither writes files nor listens on the
    network. It cannot be shared between processes.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft, whatever the script names.
    script_path : Path
        The run script.
    end_s : float
        End time [s].

    Raises
    ------
    BadInputError
        If the aircraft cannot be loaded or lacks the initial conditions.
    """

    def __init__(self, aircraft: Aircraft, script_path: Path, end_s: float = ENDLESS_S) -> None:
        self.aircraft = aircraft
        self.script = read_script(script_path)
        check_loadable(aircraft, self.script.run_properties)
        # Initial conditions are read by JSBSim directly, so their name is checked here.
        if leads_out(self.script.initialize) or "\\" in self.script.initialize:
            raise BadInputError(
                f"{script_path}: starts from '{self.script.initialize}'; initial conditions must"
                " lie in the aircraft's folder"
            )
        start = aircraft.folder / self.script.initialize
        if not any(path.is_file() for path in (start, start.with_name(start.name + ".xml"))):
            raise BadInputError(
                f"{script_path}: starts from the initial conditions '{self.script.initialize}',"
                f" which aircraft '{aircraft.name}' does not have ({start}.xml); give a script made"
                " for this aircraft, or a mission for any: steady, doublets, 3-2-1-1 (fly --mission"
                " doublets --speed-mps V)"
            )
        self._scratch = scratch_folder("mission")
        self._staging = stage(aircraft, self._scratch.path)
        # The script passes the gate as well.
        script = screen_file(read_xml(script_path), str(script_path))
        document = etree.fromstring(script.content, etree.XMLParser(resolve_entities=False))
        use, run = document.find("use"), document.find("run")
        assert use is not None
        assert run is not None
        use.set("aircraft", aircraft.name)
        run.set("end", repr(end_s))
        self._mass: MassChange | None = None
        self._staged = self._staging.root / "script.xml"
        document.getroottree().write(str(self._staged), encoding="UTF-8", xml_declaration=True)

    def open(self, dt_s: float | None = None, changed: Mapping[str, float] | None = None) -> Any:
        """Return a new ``FGFDMExec`` with script, aircraft and initial conditions loaded.

        Parameters
        ----------
        dt_s : float, optional
            Integration step [s]; the card's by default.
        changed : mapping, optional
            Mass properties (of CHANGEABLE) that differ from the XML.

        Raises
        ------
        BadInputError
            If JSBSim does not accept the script or a mass property.
        """
        if not changed:
            return self._open(self._staging, dt_s)
        # Mass properties need a copy of the XML; made once and reused.
        if self._mass is None:
            self._mass = MassChange(self.aircraft, self._staging, self._open)
        return self._open(self._mass.realise(changed), dt_s)

    def _open(self, staging: Staging, dt_s: float | None = None) -> Any:
        """Open an instance; messages name the user's script, not the copy."""
        try:
            return engine.open_script(staging, self._staged, dt_s or self.aircraft.dt_s)
        except BadInputError as error:
            # Messages name the user's file.
            raise BadInputError(
                str(error).replace(str(self._staged), str(self.script.path))
            ) from None

    @cached_property
    def content(self) -> str:
        """Digest of all that decides how the mission flies, equal for copies of its files."""
        files = [(name, sha256_hex(path.read_bytes())) for name, path in walk(self._staging.root)]
        return sha256_hex(repr((self.aircraft.name, self.aircraft.card, files)).encode())

    def close(self) -> None:
        """Remove the staged copy."""
        self._scratch.close()

    def __enter__(self) -> StagedMission:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
