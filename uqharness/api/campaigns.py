"""Campaigns in Python: cost, flights, results, checks, and p-boxes of any samples.

A campaign is given as a file, by its name, as a dictionary of its sections, or as a `CampaignSpec`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from uqharness.campaign import Progress, read_complete
from uqharness.commands import CampaignResult
from uqharness.commands import campaign as commands
from uqharness.commands.next_flight import next_flight as plan_next_flight
from uqharness.commands.sensitivity import sensitivity as rank_coefficients
from uqharness.errors import BadInputError
from uqharness.heartbeat import STATE, Rate, clock, notebook_line
from uqharness.isolation import isolated
from uqharness.requests.base import accepts
from uqharness.requests.campaign import (
    AreaRequest,
    CheckRequest,
    ConvergenceRequest,
    FolderRequest,
    MergeRequest,
    PboxRequest,
    ReportRequest,
    RerunRequest,
    RunRequest,
    SalvageRequest,
    SensitivityRequest,
    StatusRequest,
    SurrogateCheckRequest,
    VerifyRequest,
)
from uqharness.requests.next_flight import NextFlightRequest
from uqharness.results.campaign import (
    Areas,
    CampaignCost,
    CampaignPage,
    CampaignSensitivity,
    CampaignStatus,
    Convergence,
    FolderCheck,
    Merged,
    ModalSensitivity,
    Rerun,
    Salvaged,
    SurrogateCheck,
)
from uqharness.results.next_flight import AchievedNarrowing, NextFlightPlan
from uqharness.statistics import PBox, Sample
from uqharness.statistics import pbox as boxes


@notebook_line("run_campaign")
@accepts(RunRequest)
def run_campaign(request: RunRequest) -> CampaignResult:
    """Fly a campaign, as ``uqharness campaign run`` does.

    The same call or command resumes an interrupted campaign.

    Returns
    -------
    CampaignResult
        ``cases`` a DataFrame of one row a flight, ``pboxes()`` (metric, condition) to PBox,
        ``statements()`` a DataFrame. A flight that failed is a row with its reason.

    Raises
    ------
    BadInputError
        For mistakes in the campaign, each with its line, a model that does not fly, and a folder of
        another campaign.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, chapter 3: nested sampling of epistemic and
    aleatory uncertainty.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 3, "duration_s": 10, "burn_in_s": 2, "turbulence": "light"},
    ...     "epistemic": {"method": "corners", "coefficients": ["CX"], "bounds": {"CX": 0.008}},
    ... }
    >>> result = uq.run_campaign(campaign, "results", workers=1)
    >>> len(result.cases), result.statements()["radius_m"].tolist()[:2]
    (15, [15, 25])
    >>> box = result.pboxes()["speed_median_mps", "0 m/s light"]
    >>> bool((box.lower <= box.upper).all())
    True
    """
    rate, on_progress = Rate(), request.on_progress

    def show(progress: Progress) -> None:
        done, total = progress.done - progress.done_before, progress.cases - progress.done_before
        remaining_s = rate.seconds_left(done, total)
        STATE.stage = f"{progress.done} of {progress.cases} flights"
        STATE.stage += "" if remaining_s is None else f", {clock(remaining_s)} to go"
        if on_progress is not None:
            on_progress(progress)

    # A callback that is an argument is called in this process.
    return _fly(request.changed(on_progress=None), show)


@isolated
def _fly(request: RunRequest, callback: Callable[[Progress], object]) -> CampaignResult:
    """Fly a campaign in the worker process."""
    # Whoever calls a function has decided to fly.
    result = commands.run(request, callback, agreed=True).value
    assert result is not None
    return result


@accepts(FolderRequest)
def read_campaign(request: FolderRequest) -> CampaignResult:
    """Open the results of a campaign that was flown before.

    Returns
    -------
    CampaignResult
        As `run_campaign` gives it.

    Raises
    ------
    BadInputError
        For a folder that is none of a campaign, is not complete, or is not as it was written.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.read_campaign("results").cases.equals(flown.cases)
    True
    """
    return CampaignResult(request.folder, read_complete(request.folder))


@notebook_line("check_campaign")
@accepts(CheckRequest)
@isolated
def check_campaign(request: CheckRequest) -> CampaignCost:
    """Work out what a campaign costs before it is flown, as ``uqharness campaign check`` does.

    Returns
    -------
    CampaignCost
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
    return commands.check(request).value


@notebook_line("verify")
@accepts(VerifyRequest)
def verify(request: VerifyRequest) -> FolderCheck:
    """Check a folder of results against its digests, as ``uqharness campaign verify`` does.

    Returns
    -------
    FolderCheck
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
    return commands.verify(request).value


@notebook_line("campaign_status")
@accepts(StatusRequest)
def campaign_status(request: StatusRequest) -> CampaignStatus:
    """Read the progress of a campaign, also while it runs, as ``uqharness campaign status`` does.

    Returns
    -------
    CampaignStatus
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
    return commands.status(request).value


@notebook_line("campaign_report")
@accepts(ReportRequest)
@isolated
def campaign_report(request: ReportRequest) -> CampaignPage:
    """Write the page and the figures of a campaign, as ``uqharness campaign report`` does.

    Returns
    -------
    CampaignPage
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
    return commands.report(request).value


@notebook_line("merge_campaign")
@accepts(MergeRequest)
def merge_campaign(request: MergeRequest) -> Merged:
    """Bring the shards of a campaign together and write its tables, as ``uqharness campaign merge``
    does.

    Returns
    -------
    Merged
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
    return commands.merge(request).value


@notebook_line("rerun_case")
@accepts(RerunRequest)
@isolated
def rerun_case(request: RerunRequest) -> Rerun:
    """Fly one case of a campaign again with full output and a plot, as ``uqharness campaign rerun``
    does.

    Returns
    -------
    Rerun
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
    return commands.rerun(request).value


@notebook_line("check_surrogate")
@accepts(SurrogateCheckRequest)
@isolated
def check_surrogate(request: SurrogateCheckRequest) -> SurrogateCheck:
    """Fly cases of a campaign with a real autopilot in the same air, as ``uqharness campaign
    surrogate-check`` does.

    Returns
    -------
    SurrogateCheck
        ``flights`` with the real autopilot, and by metric its ``difference`` from the campaign's
        flights with limits, and the ``quantiles`` of the corrected p-box.

    Raises
    ------
    BadInputError
        For an incomplete campaign, an aircraft that has changed, and a command that cannot start.

    Examples
    --------
    A command that ends at once flies nothing.

    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {
    ...         "aircraft": "espaaro", "mission": "loiter", "seed": 1, "engine": "jsbsim"
    ...     },
    ...     "aleatory": {"flights": 4, "duration_s": 2, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.check_surrogate("results", autopilot_process="true", flights=4, autopilot_port=0)[
    ...     "failed"
    ... ]
    4
    """
    return commands.surrogate_check(request).value


@notebook_line("salvage_campaign")
@accepts(SalvageRequest)
@isolated
def salvage_campaign(request: SalvageRequest) -> Salvaged:
    """Repair a damaged campaign, as ``uqharness campaign salvage`` does: keep sound flights, fly
    the others again.

    Returns
    -------
    Salvaged
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
    return commands.salvage(request).value


@notebook_line("campaign_convergence")
@accepts(ConvergenceRequest)
def campaign_convergence(request: ConvergenceRequest) -> Convergence:
    """Study the convergence of a campaign over flights and epistemic samples, as ``uqharness
    campaign convergence`` does.

    Returns
    -------
    Convergence
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
    return commands.convergence(request).value


@notebook_line("campaign_area")
@accepts(AreaRequest)
def campaign_area(request: AreaRequest) -> Areas:
    """Compare real flights with a campaign's p-boxes by the area metric, as ``uqharness campaign
    area`` does.

    Returns
    -------
    Areas
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
    >>> areas = uq.campaign_area("results", value={"speed_median_mps": inside})
    >>> {row.verdict for row in areas.rows}
    {'no contradiction'}
    """
    return commands.area(request).value


@notebook_line("sensitivity")
@accepts(SensitivityRequest)
@isolated
def sensitivity(request: SensitivityRequest) -> CampaignSensitivity | ModalSensitivity:
    """Rank uncertain coefficients by the width they give to the p-box, as ``uqharness sensitivity``
    does.

    `uqharness.sensitivity` is the package too: ``uq.sensitivity.run_study`` takes any function.

    Returns
    -------
    CampaignSensitivity or ModalSensitivity
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
    return rank_coefficients(request).value


@notebook_line("next_flight")
@accepts(NextFlightRequest)
@isolated
def next_flight(request: NextFlightRequest) -> NextFlightPlan | AchievedNarrowing:
    """Plan the test flight that most narrows the p-box, as ``uqharness next-flight`` does.

    Returns
    -------
    NextFlightPlan or AchievedNarrowing
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
    return plan_next_flight(request).value


@accepts(PboxRequest)
def pbox(request: PboxRequest) -> PBox:
    """The p-box of samples: the envelope of their distribution functions, with a band for their
    finite number.

    Returns
    -------
    PBox
        At each ``value`` (m,), the probability of at most that lies between ``lower`` and ``upper``
        (m,) [-]; ``band_lower`` and ``band_upper`` (m,) [-] add what chance leaves open.
        ``quantile(p)`` is the interval of a quantile.

    Raises
    ------
    BadInputError
        For no sample, an empty one, no known value, or a confidence outside 0 to 1.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, chapter 3. S. Ferson et al., Constructing
    probability boxes and Dempster-Shafer structures, SAND2002-4015, 2003. The band: Bonferroni over
    the samples on Kolmogorov's statistic.

    Examples
    --------
    >>> import uqharness as uq
    >>> box = uq.pbox({"low": [1.0, 2.0, 3.0, 4.0], "high": [2.0, 3.0, 4.0, 5.0]})
    >>> box.quantile(0.5)
    (2.0, 3.0)
    """
    # Samples without names are numbered.
    samples = request.samples
    labelled = samples.items() if isinstance(samples, Mapping) else enumerate(samples)
    try:
        return boxes.pbox(
            [_sample(str(name), values) for name, values in labelled], request.confidence
        )
    except (ValueError, TypeError) as error:
        raise BadInputError(f"samples: {error}") from None


def _sample(name: str, values: ArrayLike | Sample) -> Sample:
    """Return a sample with its finite values and the number of others."""
    if isinstance(values, Sample):
        return values
    array = np.asarray(values, dtype=float).ravel()
    finite = np.isfinite(array)
    return Sample(name, array[finite], int(np.count_nonzero(~finite)))
