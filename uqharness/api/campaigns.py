"""Campaigns in Python: run, opened, and p-boxes of any samples.

A campaign is given as a file, by its name, as a dictionary of its sections, or as a `CampaignSpec`.
"""

from __future__ import annotations

import io
import math
import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from uqharness.arguments import integer, number, one_of, path, require, share
from uqharness.arguments import workers as given_workers
from uqharness.campaign import (
    CONFIDENCE,
    STATEMENTS,
    Progress,
    band_confidence,
    bounds_notes,
    noise_notes,
    pboxes,
)
from uqharness.campaign import run as running
from uqharness.campaign.folder import read_cases, read_checked, read_complete
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.spec import read as reading
from uqharness.commands import AnyPath
from uqharness.errors import BadInputError
from uqharness.files import find_campaign
from uqharness.heartbeat import STATE, Rate, clock, notebook_line
from uqharness.isolation import isolated
from uqharness.statistics import PBox, Sample
from uqharness.statistics import pbox as boxes

if TYPE_CHECKING:
    import pandas as pd


_NO_FILE = Path("campaign.toml")
"""File name in the messages of a campaign that has no file."""
_FILE_AND_LINE = re.compile(rf"^{re.escape(str(_NO_FILE))}:\d+: (the file: )?")


@dataclass(frozen=True)
class CampaignResult:
    """Results of a complete campaign, read from its folder on demand.

    Attributes
    ----------
    folder : Path
        The results; every ``uqharness campaign`` command takes it.
    manifest : Mapping
        What was flown: settings, versions, hashes.
    notes : tuple of str
        Remarks on the bounds that were flown.
    """

    folder: Path
    manifest: Mapping[str, Any] = field(repr=False)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        settings = self.manifest["campaign"]
        name = Path(settings["campaign"]["aircraft"]).name
        return (
            f"CampaignResult({str(self.folder)!r}: {self.manifest['cases']} flights of {name}, "
            f"epistemic samples by {settings['epistemic']['method']})"
        )

    def _repr_html_(self) -> str:
        # Imported here: only notebooks need charts.
        from uqharness.report import campaign_view

        return campaign_view(self.folder, self.manifest, self.cases, self.statements())

    @cached_property
    def cases(self) -> pd.DataFrame:
        """Table with one row a flight (docs/campaigns.md describes the columns).

        Raises BadInputError where the file is damaged.
        """
        return read_cases(self.folder, self.manifest)

    def pboxes(self) -> dict[tuple[str, str], PBox]:
        """Return the p-box of each (metric, condition), the rows of pbox.parquet."""
        confidence = band_confidence(self.manifest["campaign"], CONFIDENCE)
        return {
            (metric, condition.label): box
            for metric, condition, box in pboxes(self.cases, confidence)
        }

    def statements(self) -> pd.DataFrame:
        """Return statements.csv: excursions per hour and their limits by condition and radius
        (docs/statements.md).
        """
        import pandas as pd

        content = read_checked(self.folder, self.manifest, STATEMENTS)
        return pd.read_csv(
            io.BytesIO(content),
            dtype={"best": str, "worst": str},
            keep_default_na=False,
            na_values=[""],
        )


@notebook_line("run_campaign")
@isolated
def run_campaign(
    campaign: AnyPath | CampaignSpec | Mapping[str, Any],
    out: AnyPath,
    *,
    hours: float | None = None,
    samples: int | None = None,
    workers: int | None = None,
    engine: Literal["auto", "batch", "jsbsim"] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> CampaignResult:
    """Fly a campaign, as ``uqharness campaign run`` does.

    The same call or command resumes an interrupted campaign.

    Parameters
    ----------
    campaign : str, Path, Mapping or CampaignSpec
        A campaign.toml, the name of a folder under campaigns/, or the file's sections as a
        dictionary.
    out : str or Path
        Folder for the results.
    hours : float, optional
        Flight hours per corner and condition [h], in place of ``[aleatory] flights``.
    samples : int, optional
        Epistemic samples to draw, in place of ``[epistemic] samples``.
    workers : int, optional
        Processes; by default one a core.
    engine : {"auto", "batch", "jsbsim"}, optional
        What flies, in place of ``[campaign] engine``.
    on_progress : callable, optional
        Called with the `Progress` after each batch of flights.

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
    # Check the arguments before anything is created.
    folder, workers = path("out", out), given_workers(workers)
    if on_progress is not None:
        require("on_progress", on_progress, callable(on_progress), "a function of a Progress")
    spec = campaign_of(campaign)
    if hours is not None:
        spec = spec.with_hours(
            number(
                "hours",
                hours,
                "a number of flight hours above 0",
                lambda value: 0.0 < value < math.inf,
            )
        )
    if samples is not None:
        samples = integer("samples", samples, 1)
        spec = reading.with_samples(spec, samples)
    if engine is not None:
        spec = spec.with_engine(one_of("engine", engine, ("auto", "batch", "jsbsim")))
    # The folder stores the command that resumes the campaign.
    command = ["uqharness", "campaign", "run", str(campaign), "--out", str(folder)]
    command += [] if hours is None else ["--hours", f"{hours:g}"]
    command += [] if samples is None else ["--samples", str(samples)]
    command += [] if engine is None else ["--engine", engine]
    # A campaign without a file can be resumed by the same call, not by a command.
    resume_command = shlex.join(command) if isinstance(campaign, str | PathLike) else ""
    notes = (*noise_notes(spec), *bounds_notes(spec))
    rate = Rate()

    def show(progress: Progress) -> None:
        done, total = progress.done - progress.done_before, progress.cases - progress.done_before
        remaining_s = rate.seconds_left(done, total)
        STATE.stage = f"{progress.done} of {progress.cases} flights"
        STATE.stage += "" if remaining_s is None else f", {clock(remaining_s)} to go"
        if on_progress is not None:
            on_progress(progress)

    running.run_campaign(spec, folder, workers, on_progress=show, command=resume_command)
    return CampaignResult(folder, read_complete(folder), notes)


def read_campaign(folder: AnyPath) -> CampaignResult:
    """Open the results of a campaign that was flown before.

    Parameters
    ----------
    folder : str or Path
        The ``--out`` of ``uqharness campaign run``, or the ``out`` of `run_campaign`.

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
    place = path("folder", folder)
    return CampaignResult(place, read_complete(place))


def pbox(
    samples: Mapping[str, ArrayLike] | Sequence[ArrayLike | Sample],
    confidence: float = 0.95,
) -> PBox:
    """The p-box of samples: the envelope of their distribution functions, with a band for their
    finite number.

    Parameters
    ----------
    samples : Mapping or sequence
        One array (n,) of values for each epistemic sample, all of one quantity; a mapping names
        them. A value that is not finite counts as unknown: it may lie anywhere and is not dropped.
    confidence : float
        Of the band [-], over all values and samples at once.

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
    confidence = share("confidence", confidence)
    require(
        "samples",
        samples,
        isinstance(samples, Iterable) and not isinstance(samples, str),
        "a mapping or sequence of arrays",
    )
    # Samples without names are numbered.
    labelled = samples.items() if isinstance(samples, Mapping) else enumerate(samples)
    try:
        return boxes.pbox([_sample(str(name), values) for name, values in labelled], confidence)
    except (ValueError, TypeError) as error:
        raise BadInputError(f"samples: {error}") from None


def _sample(name: str, values: ArrayLike | Sample) -> Sample:
    """Return a sample with its finite values and the number of others."""
    if isinstance(values, Sample):
        return values
    array = np.asarray(values, dtype=float).ravel()
    finite = np.isfinite(array)
    return Sample(name, array[finite], int(np.count_nonzero(~finite)))


def campaign_of(campaign: AnyPath | CampaignSpec | Mapping[str, Any]) -> CampaignSpec:
    """Return the campaign of a file, name or dictionary. Raises BadInputError."""
    if isinstance(campaign, CampaignSpec):
        return campaign
    if isinstance(campaign, Mapping):
        try:
            # The dictionary passes the same checks as a file; messages omit the missing file's
            # name.
            return reading.campaign_from(_plain(campaign), _NO_FILE)
        except BadInputError as error:
            raise BadInputError(*(_FILE_AND_LINE.sub("", line) for line in error.args)) from None
    if not isinstance(campaign, str | PathLike):
        raise BadInputError(
            "a campaign is a file, a name or its sections as a dictionary; received"
            f" {type(campaign).__name__}"
        )
    return reading.read_campaign(find_campaign(Path(campaign)))


def _plain(value: Any) -> Any:
    """Convert numpy values and paths to what TOML can hold."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return os.fspath(value) if isinstance(value, PathLike) else value
