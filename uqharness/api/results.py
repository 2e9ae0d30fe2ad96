"""Commands in Python whose result is a document: campaign folders, studies, pages, dossiers.

They return what the command prints with ``--json``. Those that load an aircraft or write a page run
the command in a separate process, which an invalid aircraft cannot take down; those that only read
results call the library.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from uqharness.arguments import flag, instance, integer, number, one_of, path
from uqharness.arguments import workers as given_workers
from uqharness.child_process import run_command
from uqharness.commands import AnyPath
from uqharness.errors import BadInputError, TerminatedError
from uqharness.heartbeat import notebook_line


def check_campaign(
    campaign: AnyPath,
    *,
    hours: float | None = None,
    samples: int | None = None,
    engine: Literal["auto", "batch", "jsbsim"] | None = None,
    workers: int | None = None,
) -> dict[str, Any]:
    """Work out what a campaign costs before it is flown, as ``uqharness campaign check`` does.

    Parameters
    ----------
    campaign : str or Path
        A campaign.toml, or the name of a folder under campaigns/.
    hours, samples, engine, workers
        As for `run_campaign`.

    Returns
    -------
    dict
        ``flights``, ``flight_hours`` [h], ``expected_s`` [s], ``disk_bytes``, ``engine`` and why,
        ``bounds_hold_at``.

    Raises
    ------
    BadInputError
        For mistakes in the campaign, each with its line, and a model that does not fly.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.check_campaign("demo", hours=0.05, engine="jsbsim")["flights"]
    64
    """
    words = ["campaign", "check", str(path("campaign", campaign))]
    sizes = {"--hours": hours, "--samples": samples, "--engine": engine, "--workers": workers}
    return _document(
        words + [str(w) for pair in sizes.items() if pair[1] is not None for w in pair]
    )


def verify(folder: AnyPath) -> dict[str, Any]:
    """Check a folder of results against its digests, as ``uqharness campaign verify`` does.

    Parameters
    ----------
    folder : str or Path
        Folder of a campaign.

    Returns
    -------
    dict
        ``whole``, ``complete``, and of each file its ``state``.

    Raises
    ------
    BadInputError
        For a folder that is none of a campaign.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.verify("results")["whole"]
    True
    """
    return _document(["campaign", "verify", str(path("folder", folder))])


def campaign_status(folder: AnyPath) -> dict[str, Any]:
    """Read the progress of a campaign, also while it runs, as ``uqharness campaign status`` does.

    Parameters
    ----------
    folder : str or Path
        Folder of a campaign.

    Returns
    -------
    dict
        ``state`` (complete, running or interrupted), ``cases``, ``done``, ``failed``, ``statuses``,
        ``engine`` and ``answers``.

    Raises
    ------
    BadInputError
        For a folder that is none of a campaign, or is damaged.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> status = uq.campaign_status("results")
    >>> status["state"], status["done"], status["failed"]
    ('complete', 2, 0)
    """
    # Imported here, as below: `import uqharness` loads no numerical library.
    from uqharness.campaign.folder import read_status

    return read_status(path("folder", folder)).as_dict()


def campaign_report(folder: AnyPath, *, tracks: bool = True) -> dict[str, Any]:
    """Write the page and the figures of a campaign, as ``uqharness campaign report`` does.

    Parameters
    ----------
    folder : str or Path
        Folder of a campaign.
    tracks : bool
        Whether the worst and the median flight of a short campaign are flown again for the ground
        track.

    Returns
    -------
    dict
        ``report``, the page's path; ``figures``, ``verdict``, and ``flown_again``, ids of cases.

    Raises
    ------
    BadInputError
        For a folder that is none of a campaign, or is damaged.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.campaign_report("results", tracks=False)["flown_again"]
    []
    """
    words = ["campaign", "report", str(path("folder", folder))]
    return _document(words + ([] if flag("tracks", tracks) else ["--no-tracks"]))


def merge_campaign(folder: AnyPath) -> dict[str, Any]:
    """Bring the shards of a campaign together and write its tables, as ``uqharness campaign merge``
    does.

    Parameters
    ----------
    folder : str or Path
        The ``--out`` of the runs with ``--shard``.

    Returns
    -------
    dict
        ``cases``, ``done``, ``missing``, ``statuses`` and ``shards``. Flights are missing where
        ``missing`` is not 0: fly the shards that lack, then merge again.

    Raises
    ------
    BadInputError
        For a folder without shards, and one whose shards are of different campaigns.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.merge_campaign("missing")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    uqharness.errors.BadInputError: missing
    """
    from uqharness.campaign.folder import merge

    return merge(path("folder", folder)).as_dict()


def rerun_case(folder: AnyPath, case: str) -> dict[str, Any]:
    """Fly one case of a campaign again with full output and a plot, as ``uqharness campaign rerun``
    does.

    Parameters
    ----------
    folder : str or Path
        Folder of a campaign.
    case : str
        Case id, or the beginning of one.

    Returns
    -------
    dict
        ``case_id``, ``status``, ``reason``, ``same_as_stored`` (None: not flown before),
        ``differences`` and ``files``.

    Raises
    ------
    BadInputError
        For an unknown case, and an aircraft that has changed.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.rerun_case("results", flown.cases["case_id"][0])["same_as_stored"]
    True
    """
    case = instance("case", case, str, "the id of a case, or the beginning of one,")
    return _document(["campaign", "rerun", str(path("folder", folder)), f"--case={case}"])


def salvage_campaign(
    folder: AnyPath,
    *,
    campaign: AnyPath | None = None,
    hours: float | None = None,
    samples: int | None = None,
    workers: int | None = None,
    yes: bool = False,
) -> dict[str, Any]:
    """Repair a damaged campaign, as ``uqharness campaign salvage`` does: keep sound flights, fly
    the others again.

    Parameters
    ----------
    folder : str or Path
        Folder of a campaign, or that of a shard.
    campaign : str or Path, optional
        The campaign file, where manifest.json is damaged or missing.
    hours, samples
        As `run_campaign` got them, with ``campaign``.
    workers : int, optional
        Processes; by default one a core.
    yes : bool
        Whether more than a day of flying is agreed to.

    Returns
    -------
    dict
        ``kept``, ``flown`` and ``missing`` flights, ``statuses``, files ``rewritten`` and put
        ``aside``, and the same of ``shards``.

    Raises
    ------
    BadInputError
        For a folder that cannot be repaired; nothing is lost then.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.salvage_campaign("results")["kept"]
    2
    """
    words = ["campaign", "salvage", str(path("folder", folder))]
    words += _files(campaign=campaign)
    sizes = {"--hours": hours, "--samples": samples, "--workers": given_workers(workers)}
    words += [str(w) for pair in sizes.items() if pair[1] is not None for w in pair]
    return _document(words + (["--yes"] if flag("yes", yes) else []))


def campaign_convergence(
    folder: AnyPath, *, repeats: int = 10, metric: str | Sequence[str] = ()
) -> dict[str, Any]:
    """Study the convergence of a campaign over flights and epistemic samples, as ``uqharness
    campaign convergence`` does.

    Parameters
    ----------
    folder : str or Path
        Folder of a complete campaign; convergence.csv and figures are written into it.
    repeats : int
        Number of parts into which the flights are divided.
    metric : str or sequence of str
        Columns of cases.parquet; by default the usual ones.

    Returns
    -------
    dict
        ``table`` and ``figures``, paths of what was written, and ``rows``, those of the table.

    Raises
    ------
    BadInputError
        For too few flights or samples, and an unknown metric.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 4, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> found = uq.campaign_convergence("results", repeats=2, metric="speed_median_mps")
    >>> found["rows"][0]["metric"], found["rows"][0]["flights"]
    ('speed_median_mps', 2)
    """
    from uqharness.campaign import convergence_document, write_convergence
    from uqharness.report import convergence_section, write_figures

    place = path("folder", folder)
    results = write_convergence(place, _several(metric), integer("repeats", repeats, 2))
    sections = [convergence_section(item) for item in results if item.repeats or item.growth]
    figures = write_figures(place, sections, "Convergence")
    return convergence_document(place, results, figures)


def campaign_area(
    folder: AnyPath, *, flight: AnyPath | None = None, value: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Compare real flights with a campaign's p-boxes by the area metric, as ``uqharness campaign
    area`` does.

    Parameters
    ----------
    folder : str or Path
        Folder of a complete campaign; area.csv is written into it.
    flight : str or Path, optional
        Table of flights, .csv or .parquet: one row a flight, columns as in cases.parquet.
    value : Mapping, optional
        Metrics of a single flight, such as ``{"cross_track_median_m_measured": 9.41}``.

    Returns
    -------
    dict
        ``table``, the path of area.csv, and ``rows``: of each metric and condition the ``area`` by
        which the flights lie outside the p-box in the metric's unit, ``beyond_chance`` and the
        ``verdict``.

    Raises
    ------
    BadInputError
        Where no flight is given, or none has a metric of the campaign.

    References
    ----------
    S. Ferson, W. L. Oberkampf, L. Ginzburg, Model validation and predictive capability for the
    thermal challenge problem, 2008.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 4, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> inside = float(flown.cases["speed_median_mps"][0])
    >>> found = uq.campaign_area("results", value={"speed_median_mps": inside})
    >>> {row["verdict"] for row in found["rows"]}
    {'no contradiction'}
    """
    from uqharness.campaign import area_document, read_flights, write_area

    place = path("folder", folder)
    values = instance("value", {} if value is None else value, Mapping, "a mapping of metrics")
    measured = {str(name): number(f"value: {name}", item) for name, item in values.items()}
    table = None if flight is None else path("flight", flight)
    return area_document(place, write_area(place, read_flights(table, measured)))


def sensitivity(
    folder: AnyPath | None = None,
    *,
    interior: AnyPath | None = None,
    modal: Literal["as_corrected", "as_published"] | None = None,
    repeats: int = 10,
    seed: int = 0,
) -> dict[str, Any]:
    """Rank uncertain coefficients by the width they give to the p-box, as ``uqharness sensitivity``
    does.

    `uqharness.sensitivity` is the package too: ``uq.sensitivity.run_study`` takes any function.

    Parameters
    ----------
    folder : str or Path, optional
        Folder of a finished campaign of corners.
    interior : str or Path, optional
        A campaign of levels between the bounds, to check that its flights lie inside the corners'
        p-box.
    modal : {"as_corrected", "as_published"}, optional
        The dissertation's modal example, in place of a folder.
    repeats : int
        With ``modal``: independent repeats.
    seed : int
        Of the repeats or of the resampling.

    Returns
    -------
    dict
        What ``uqharness sensitivity --json`` prints (docs/sensitivity.md).

    Raises
    ------
    BadInputError
        For a folder that is no finished campaign of corners, and where both or neither of folder
        and modal are given.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, chapter 4.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.sensitivity("missing")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    uqharness.errors.BadInputError: missing
    """
    # The command checks which arguments may be combined.
    words = ["sensitivity"] + ([] if folder is None else [str(path("folder", folder))])
    words += _files(interior=interior)
    words += [] if modal is None else ["--modal", modal]
    words += [
        "--repeats",
        str(integer("repeats", repeats, 2)),
        "--seed",
        str(integer("seed", seed)),
    ]
    return _document(words)


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


def next_flight(
    folder: AnyPath,
    out: AnyPath,
    *,
    bounds: AnyPath | None = None,
    metric: str | None = None,
    coefficient: str | None = None,
    minutes: float = 5.0,
    speeds: Sequence[float] = (),
    turbulence: Literal["none", "light", "moderate", "severe"] = "none",
    cases: int = 6,
    occupancy: Sequence[AnyPath] = (),
    flights: Sequence[AnyPath] = (),
    redone: AnyPath | None = None,
    seed: int = 1,
    figures: bool = True,
) -> dict[str, Any]:
    """Plan the test flight that most narrows the p-box, as ``uqharness next-flight`` does.

    Parameters
    ----------
    folder : str or Path
        Folder of a finished campaign of corners.
    out : str or Path
        Folder for the run script, the table of test points and the page.
    bounds : str or Path, optional
        model-form.json; by default the bounds that the campaign flew.
    metric, coefficient : str, optional
        Column of the campaign's table, and coefficient; by default the one to which the metric is
        most sensitive.
    minutes : float
        Length of the flight at most [min].
    speeds : sequence of float
        True airspeeds of the test points [m/s]; by default those of the mission.
    turbulence : {"none", "light", "moderate", "severe"}
        Of the simulated test flight.
    cases : int
        Campaign flights that are repeated to record the mission's flight states.
    occupancy, flights : sequence of paths
        Records of the mission in place of campaign flights; flights that the bounds were made from.
    redone : str or Path, optional
        Bounds that include the new flight: they are compared with the old ones and nothing is
        planned.
    seed : int
        Of the simulated flights.
    figures : bool
        Whether figures are drawn.

    Returns
    -------
    dict
        The content of next-flight.json; with ``redone`` the narrowing of each coefficient.

    Raises
    ------
    BadInputError
        For a folder that is no finished campaign of corners, and bounds of another aircraft.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.next_flight("missing", "next")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    uqharness.errors.BadInputError: missing
    """
    words = ["next-flight", str(path("folder", folder)), "--out", str(path("out", out))]
    one_of("turbulence", turbulence, ("none", "light", "moderate", "severe"))
    for option, file in (("--bounds", bounds), ("--redone", redone)):
        words += [] if file is None else [option, str(path(option[2:], file))]
    for option, text in (("--metric", metric), ("--coefficient", coefficient)):
        words += [] if text is None else [option, text]
    words += ["--minutes", str(minutes), "--turbulence", turbulence]
    words += ["--cases", str(integer("cases", cases, 1)), "--seed", str(integer("seed", seed))]
    words += ["--speeds", ",".join(map(str, speeds))] if speeds else []
    for option, files in (("--occupancy", occupancy), ("--flight", flights)):
        words += [option, *(str(path(option[2:], file)) for file in files)] if files else []
    words += [] if figures else ["--no-figures"]
    return _document(words)


def report(folder: AnyPath) -> Path:
    """Write the page of a folder of results from its files, as ``uqharness report`` does.

    Parameters
    ----------
    folder : str or Path
        The ``--out`` of another command, or the ``out`` of a function.

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
    from uqharness.report import write_report

    return write_report(path("folder", folder)).path


def dossier(folder: AnyPath, *, out: AnyPath | None = None) -> dict[str, Any]:
    """Write the evidence of a folder of results as one document, as ``uqharness dossier`` does.

    Parameters
    ----------
    folder : str or Path
        Results of study, refine, run_campaign, identify or compare, or a folder with several of
        them.
    out : str or Path, optional
        File to write; by default dossier.html in the folder.

    Returns
    -------
    dict
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
    >>> "sources" in uq.dossier("results")
    True
    """
    words = ["dossier", str(path("folder", folder))]
    return _document(words + ([] if out is None else ["--out", str(path("out", out))]))


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
