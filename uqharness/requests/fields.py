"""Fields that several requests share: each is defined once, with one sentence and one check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from uqharness.requests.base import FilePath, Names, WholeNumber, one_or_several, option

FLIGHT_FILE = "record (.parquet, .csv) or any log that `log import` reads"

AircraftSource = Any
"""Name or folder of an aircraft, or in Python what `find_aircraft` returns."""


def _path_or_object(value: Any) -> Any:
    """Return a text or path object as Path, other objects unchanged."""
    return Path(value) if isinstance(value, str | PathLike) else value


FileOrObject = Annotated[Any, BeforeValidator(_path_or_object)]


def _flight_source(value: Any) -> Any:
    """Return a flight, a path as Path; pydantic's error for what is neither."""
    path = _path_or_object(value)
    if not (isinstance(path, Path) or hasattr(path, "record") or hasattr(path, "columns")):
        raise PydanticCustomError("flight", "is no flight")
    return path


FlightSources = Annotated[
    tuple[Annotated[Any, BeforeValidator(_flight_source)], ...],
    BeforeValidator(one_or_several),
    Field(min_length=1),
]
"""Files of flights, or in Python FlightRecords and what `fly` and `read_flights` return."""
FlightNumbers = Annotated[
    tuple[Annotated[WholeNumber, Field(ge=1)], ...], BeforeValidator(one_or_several)
]
Workers = WholeNumber | None

Split = Literal["auto", "none"]
Servos = Literal["auto", "card", "ideal"]

CHANNELS: Mapping[str, str] = {
    "V": "V_mps",
    "alpha": "alpha_rad",
    "beta": "beta_rad",
    "phi": "phi_rad",
    "theta": "theta_rad",
    "p": "p_radps",
    "q": "q_radps",
    "r": "r_radps",
    "ax": "ax_mps2",
    "ay": "ay_mps2",
    "az": "az_mps2",
}
"""Short and full names of the channels that are fitted; height and heading are integrals of the
others and drift in real sensors.
"""
CONTROL_DELAY = "controls"
"""Stands for all controls among the signals with a delay."""


def channel_names(names: Iterable[str] | None) -> tuple[str, ...] | None:
    """Return the full names of channels, each once; None where none were given.

    >>> channel_names(["p", "q_radps", "p_radps"])
    ('p_radps', 'q_radps')
    """
    return None if names is None else tuple(dict.fromkeys(CHANNELS.get(n, n) for n in names))


def _channels_and(*more: str) -> Callable[[tuple[str, ...]], tuple[str, ...]]:
    """Return a check of channel names."""
    short = (*more, *CHANNELS)

    def check(names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in (*short, *CHANNELS.values()):
                raise ValueError(f"unknown channel {name}; allowed are none, {', '.join(short)}")
        return names

    return check


Channels = Annotated[Names, AfterValidator(_channels_and())] | None
DelayedSignals = Annotated[Names, AfterValidator(_channels_and(CONTROL_DELAY))] | None


def aircraft() -> Any:
    """Return the field of the aircraft."""
    return option(
        ...,
        "name under aircraft/ or in JSBSim's collection, or a folder",
        flag="",
        metavar="AIRCRAFT",
        kind="str, Path or Aircraft",
        positional=True,
        toml=False,
    )


def flights(
    flag: str = "--flight", text: str = "flight", positional: bool = True, toml: bool = False
) -> Any:
    """Return the field of one or several flights."""
    return option(
        ...,
        f"{text}: {FLIGHT_FILE}",
        flag=flag,
        metavar="FILE",
        many=True,
        positional=positional,
        kind="flight or sequence of flights",
        needed="at least one flight (a path, a FlightRecord, a Flight)",
        toml=toml,
    )


def out(required: bool = True, positional: bool = False) -> Any:
    """Return the field of the folder of the results."""
    text = "folder for the results, created if missing" + (
        "" if required else " (default: nothing is written)"
    )
    return option(
        ... if required else None,
        text,
        metavar="DIR",
        positional=positional,
        provenance=False,
        toml=False,
    )


def _ends_with(*endings: str) -> Callable[[Path], Path]:
    """Return a check of the ending of a file's name."""

    def check(path: Path) -> Path:
        if path.suffix.lower() not in endings:
            raise ValueError(f"the name must end with {' or '.join(endings)}")
        return path

    return check


def _page(path: Path) -> Path:
    """Refuse a page that cannot be written."""
    if path.suffix.lower() != ".html" or path.is_dir():
        folder = "is a folder; " if path.is_dir() else ""
        raise ValueError(f"{folder}a page, FILE.html, is written")
    return path


Page = Annotated[FilePath, AfterValidator(_page)] | None
TableFile = Annotated[FilePath, AfterValidator(_ends_with(".parquet", ".csv"))]
RecordFile = Annotated[FilePath, AfterValidator(_ends_with(".csv", ".parquet", ".bin"))]


def page(content: str, flag: str = "--out") -> Any:
    """Return the field of a page that is written as a file."""
    return option(
        None,
        f"write a page with {content} (default: no page)",
        flag=flag,
        metavar="FILE.html",
        provenance=False,
        toml=False,
    )


def workers(default: str = "one a core, 8 at most") -> Any:
    """Return the field of the number of processes."""
    return option(None, f"processes (default: {default})", ge=1, metavar="N", toml=False)


def seed(of: str, default: int = 0) -> Any:
    """Return the field of the seed of what is drawn at random."""
    return option(default, f"seed of {of}", ge=0, metavar="N")


def figures() -> Any:
    """Return the field that leaves out the figures."""
    return option(
        True,
        "whether figures are drawn",
        flag="--no-figures",
        off=True,
        help="leave out the figures",
        toml=False,
    )


def checks(skipped: str) -> Any:
    """Return the field that skips what a command does to prove its result."""
    return option(
        True, f"whether {skipped} are made", flag="--no-check", off=True, help=f"skip {skipped}"
    )


def signal_map() -> Any:
    """Return the field of the signal map."""
    return option(
        None,
        "signal map; its lines replace those of the log's format",
        flag="--map",
        metavar="MAP.toml",
        key="map",
        toml=False,
    )


def flight_number() -> Any:
    """Return the field of the flights in logs with several boots."""
    return option(
        (),
        "flight to read from logs with several boots of the autopilot: one number, or one per file"
        " (default: the longest)",
        metavar="N",
        kind="int or sequence of int",
        many=True,
        needed="whole numbers of at least 1",
        toml=False,
    )


def boot() -> Any:
    """Return the field of the flight in one log with several boots."""
    return option(
        None,
        "flight to read from a log with several boots of the autopilot (default: the longest)",
        ge=1,
        metavar="N",
    )


def from_s() -> Any:
    """Return the field of the first time of a log that is used."""
    return option(
        None,
        "first time that is used, s of the log (default: its beginning)",
        metavar="T",
        toml=False,
    )


def to_s() -> Any:
    """Return the field of the last time of a log that is used."""
    return option(
        None, "last time that is used, s of the log (default: its end)", metavar="T", toml=False
    )


def manoeuvres() -> Any:
    """Return the field of the table of manoeuvres."""
    return option(
        None,
        "table of manoeuvres: columns manoeuvre, start_s, end_s (and flight); or the word found:"
        " the manoeuvres that `log info` lists",
        metavar="FILE.csv",
        toml=False,
    )


def servos() -> Any:
    """Return the field of how commands reach the surfaces."""
    return option(
        "auto",
        "card: actuators of the aircraft; ideal: surfaces and throttle follow commands without lag;"
        " auto: for a log, the likelier of the two",
        toml=False,
    )


def split() -> Any:
    """Return the field of how one ordinary flight is divided."""
    return option(
        "auto",
        "auto: of one flight without manoeuvres use every second block of time and leave the others"
        " to the next command; none: use all",
        toml=False,
    )


def biases() -> Any:
    """Return the field of the channels with a constant bias."""
    return option(
        None,
        "channels with a constant bias to estimate, or none (default p,q,r)",
        metavar="C,C",
        kind="str or sequence of str, optional",
    )


def delays() -> Any:
    """Return the field of the signals with a delay."""
    return option(
        None,
        "signals with a delay to estimate: channels, controls, or none (default: controls; for a"
        " log, all)",
        metavar="C,C",
        kind="str or sequence of str, optional",
    )


def script(
    use: str = "run script, a path or a name under scripts/", positional: bool = True
) -> Any:
    """Return the field of the run script."""
    return option(
        Path("loiter"),
        use,
        metavar="S",
        positional=positional,
        kind="str or Path",
        needed="a path or a name",
    )


def turbulence(of: str) -> Any:
    """Return the field of the intensity of turbulence."""
    return option("none", f"MIL-F-8785C intensity of turbulence{of}")


def autopilot() -> Any:
    """Return the field of the gains of an autopilot."""
    return option(
        None,
        "ArduPlane parameter file (.parm, .param): gains of the autopilot (default: the"
        " aircraft's)",
        metavar="FILE",
    )


def altitude(of: str, default: float = 200.0) -> Any:
    """Return the field of the altitude of generated manoeuvres."""
    return option(default, f"height of {of}, m", gt=0, le=30_000, metavar="H")


OptionalPath = FilePath | None
Turbulence = Literal["none", "light", "moderate", "severe"]
Coefficient = Literal["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
