"""Commands in Python whose result is a document: margins, differences, campaign folders, studies,
pages, dossiers.

They return what the command prints with ``--json``. Those that load an aircraft or write a page run
the command in a separate process, which an invalid aircraft cannot take down; those that only read
results call the library.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from uqharness.arguments import integer, path
from uqharness.arguments import workers as given_workers
from uqharness.child_process import run_command
from uqharness.commands.flights import AnyAircraft, AnyPath
from uqharness.errors import BadInputError, TerminatedError
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.requests.base import accepts
from uqharness.requests.folders import DossierRequest, ReportRequest
from uqharness.results.folders import DossierFile
from uqharness.simulator import Aircraft


def margins(
    aircraft: AnyAircraft,
    *,
    script: AnyPath = "loiter",
    loop: Sequence[str] = (),
    flight: Literal["loiter", "straight"] = "loiter",
    autopilot: AnyPath | None = None,
    out: AnyPath | None = None,
) -> dict[str, Any]:
    """Measure the autopilot's stability margins in flight, as ``uqharness margins`` does.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model.
    script : str or Path
        Run script that engages the autopilot.
    loop : sequence of str
        Actuators whose loops are measured, such as ``["elevator"]``; by default all.
    flight : {"loiter", "straight"}
        On the circle, or straight.
    autopilot : str or Path, optional
        ArduPlane parameter file with gains, in place of the aircraft's own.
    out : str or Path, optional
        FILE.html for a page with the charts.

    Returns
    -------
    dict
        ``loops``: of each loop the gain [dB], phase [deg] and delay [s] margins, crossovers [rad/s]
        and the modulus margin [-].

    Raises
    ------
    BadInputError
        For an aircraft without an autopilot, and an unknown loop.

    Examples
    --------
    >>> import uqharness as uq
    >>> found = uq.margins("espaaro", loop=["elevator"], flight="straight")
    >>> found["loops"]["elevator"]["phase_deg"] > 30.0
    True
    """
    words = ["margins", _aircraft(aircraft), "--script", str(script), "--flight", flight]
    words += [word for name in _several(loop) for word in ("--loop", name)]
    return _document(words + _files(autopilot=autopilot, out=out))


def diff(
    a: AnyAircraft,
    b: AnyAircraft,
    *,
    speed_mps: float | Sequence[float] = (),
    altitude_m: float = 200.0,
    script: AnyPath | Sequence[AnyPath] = (),
    turbulence: Literal["none", "light", "moderate", "severe"] = "none",
    seed: int = 0,
    properties: Sequence[str] = (),
    tolerance: float | None = None,
    repeats: int = 0,
    bounds: bool = False,
    python_b: AnyPath | None = None,
    out: AnyPath | None = None,
) -> dict[str, Any]:
    """Fly two models side by side and list their differences, as ``uqharness diff`` does.

    Parameters
    ----------
    a, b : str, Path or Aircraft
        The models; a str may be REVISION:FOLDER of a git repository.
    speed_mps : float or sequence of float
        True airspeeds at which A is trimmed and its manoeuvres are flown [m/s].
    altitude_m : float
        Height of the manoeuvres above sea level [m].
    script : path or sequence of paths
        Run scripts that both fly too.
    turbulence, seed
        The same air for both.
    properties : sequence of str
        JSBSim properties that are compared too.
    tolerance : float, optional
        Share of a channel's range up to which differences count as equal [-]; by default rounding.
    repeats : int
        Flights of A in other turbulence, whose differences count as equal.
    bounds : bool
        Whether differences within A's model-form bounds count as equal.
    python_b : str or Path, optional
        Interpreter that flies B.
    out : str or Path, optional
        FILE.html for a page.

    Returns
    -------
    dict
        ``differ``, the ``differences`` of channels, the likeliest cause first, ``terms`` of the XML
        that differ, ``flights``.

    Raises
    ------
    BadInputError
        For unknown aircraft, and where neither a speed nor a script is named.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.diff("espaaro", "espaaro", script="trim")["differ"]
    False
    """
    words = ["diff", _aircraft(a), _aircraft(b), "--altitude-m", str(altitude_m)]
    speeds = speed_mps if isinstance(speed_mps, Sequence) else [speed_mps]
    words += [word for value in speeds for word in ("--speed-mps", str(value))]
    words += [word for value in _several(script) for word in ("--script", str(value))]
    words += [word for value in _several(properties) for word in ("--property", str(value))]
    words += ["--turbulence", turbulence, "--seed", str(integer("seed", seed))]
    words += ["--repeats", str(integer("repeats", repeats))]
    words += [] if tolerance is None else ["--tolerance", str(tolerance)]
    words += ["--bounds"] if bounds else []
    return _document(words + _files(python_b=python_b, out=out))


def study(study: AnyPath, out: AnyPath, *, workers: int | None = None) -> dict[str, Any]:
    """Run a study file stage by stage, or resume it, as ``uqharness study`` does.

    Parameters
    ----------
    study : str or Path
        The study file (docs/study.md), or the name of a folder under campaigns/.
    out : str or Path
        Folder for the results.
    workers : int, optional
        Processes; by default one a core.

    Returns
    -------
    dict
        The content of study.json: ``question``, ``answer``, ``stages`` with their exit codes, and
        ``report``, the page's path.

    Raises
    ------
    BadInputError
        For mistakes in the file, each with its line, and a stage that cannot use its input.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.study("missing.toml", "results")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    uqharness.errors.BadInputError: missing.toml
    """
    words = ["study", str(path("study", study)), "--out", str(path("out", out))]
    number = given_workers(workers)
    words += [] if workers is None else ["--workers", str(number)]
    return _document(words)


@accepts(ReportRequest)
def report(request: ReportRequest) -> Path:
    """Write the page of a folder of results from its files, as ``uqharness report`` does.

    Returns
    -------
    Path
        report.html, one file that needs no network.

    Raises
    ------
    BadInputError
        For a folder of no results, or one that is damaged.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.report("results").name
    'report.html'
    """
    from uqharness.commands import folders

    return folders.report(request).value


@accepts(DossierRequest)
@isolated
def dossier(request: DossierRequest) -> DossierFile:
    """Write the evidence of a folder of results as one document, as ``uqharness dossier`` does.

    Returns
    -------
    DossierFile
        ``dossier``, the page's path; ``missing``, what the folder lacks; ``tests``,
        ``not_in_the_data`` and ``sources``.

    Raises
    ------
    BadInputError
        For a folder of no results, and a file whose name does not end with .html.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.dossier("results").tests
    []
    """
    from uqharness.commands import folders

    return folders.dossier(request).value


def _aircraft(aircraft: AnyAircraft) -> str:
    """Return the word that names an aircraft on a command line."""
    return str(aircraft.folder if isinstance(aircraft, Aircraft) else path("aircraft", aircraft))


def _several(values: Any) -> list[Any]:
    """Return one value or several as a list."""
    return [values] if isinstance(values, str | Path) else list(values)


def _files(**files: AnyPath | None) -> list[str]:
    """Return the words of options that name files."""
    pairs = {
        f"--{name.replace('_', '-')}": file for name, file in files.items() if file is not None
    }
    return [
        word for option, file in pairs.items() for word in (option, str(path(option[2:], file)))
    ]


def _document(words: Sequence[str]) -> dict[str, Any]:
    """Run a command in a separate process; return the document that it prints.

    Raises BadInputError with the command's message.
    """
    with notebook_line(f"uqharness {words[0]}"):
        code, printed, errors = run_command([*words, "--json"])
    # Exit code 1 is an answer, with a document of its own.
    if code in (0, 1) and printed.strip():
        document: dict[str, Any] = json.loads(printed)
        return document
    if code in (130, 143):
        raise TerminatedError
    # The last line of the command is its error message.
    lines = errors.strip().splitlines() or [f"uqharness {words[0]} ended with {code}"]
    raise BadInputError(lines[-1].removeprefix("uqharness: error: "))
