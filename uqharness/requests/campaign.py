"""Requests of `uqharness campaign`: check, run, status, report, merge, rerun, verify, salvage,
convergence and area; and of `uqharness sensitivity`, which ranks the inputs of a campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, model_validator

from uqharness.requests import fields
from uqharness.requests.base import FilePath, Flag, Names, Number, Request, WholeNumber, option

MAX_SAMPLES = 1_000_000
"""Largest number of epistemic samples."""


def _numbers_by_name(value: Any) -> Any:
    """Return a mapping with text keys as a dictionary."""
    return {str(k): v for k, v in value.items()} if hasattr(value, "items") else value


def _workers() -> Any:
    """Return the field of the number of processes of a campaign."""
    return fields.workers("one a core")


def _campaign(default: Any, text: str, **how: Any) -> Any:
    """Return the field of the campaign that is flown."""
    return option(
        default,
        text,
        metavar="CAMPAIGN.toml",
        kind="str, Path, Mapping or CampaignSpec",
        toml=False,
        **how,
    )


def _hours() -> Any:
    """Return the field of the flight hours."""
    return option(
        None,
        "flight hours per corner and condition, in place of [aleatory] flights",
        gt=0,
        metavar="H",
        toml=False,
    )


def _samples() -> Any:
    """Return the field of the number of epistemic samples."""
    return option(
        None,
        "epistemic samples to draw, in place of [epistemic] samples",
        ge=1,
        le=MAX_SAMPLES,
        metavar="N",
        toml=False,
    )


def _yes(python: bool) -> Any:
    """Return the field of the consent to long campaigns."""
    return option(
        False, "run even if it takes more than a day on this machine", toml=False, python=python
    )


class CampaignRequest(Request):
    """Fields of the campaign that is flown, and what replaces its settings."""

    campaign: Any = _campaign(
        ...,
        "a campaign.toml, the name of a folder under campaigns/, or the file's sections as a"
        " dictionary",
        help="a file, or the name of a folder under campaigns/",
        flag="",
        positional=True,
    )
    hours: Number | None = _hours()
    samples: WholeNumber | None = _samples()
    engine: Literal["auto", "batch", "jsbsim"] | None = option(
        None,
        "engine, in place of [campaign] engine; auto: batch if it supports aircraft and"
        " mission, else jsbsim",
        toml=False,
    )
    workers: fields.Workers = _workers()


class CheckRequest(CampaignRequest):
    """Print the cost of a campaign, without running it."""

    command: ClassVar[str] = "campaign check"
    done: ClassVar[str] = "done (a model that cannot be simulated is bad input)"
    no: ClassVar[str] = "the batch engine differs from JSBSim"
    examples: ClassVar[str] = """
  uqharness campaign check campaigns/demo/campaign.toml

Prints flights, flight hours, expected time and disk space, the engine (batch, or jsbsim with the
reason, file and line), and the joint confidence of the intervals of a model-form.json. Only check
flights are simulated; no result is stored."""


class RunRequest(CampaignRequest):
    """Run a campaign, or resume it."""

    command: ClassVar[str] = "campaign run"
    done: ClassVar[str] = "all flights done (failed ones are counted and reported)"
    no: ClassVar[str] = "the batch engine differs from JSBSim"
    flies: ClassVar[bool] = True
    examples: ClassVar[str] = """
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results
  uqharness campaign run campaigns/demo/campaign.toml --out big --hours 10 --workers 8
  uqharness campaign run campaigns/demo/campaign.toml --out big --dask tcp://192.168.0.2:8786
  uqharness campaign run demo --out anywhere
  uqharness campaign run campaigns/demo/campaign.toml --out big --shard 3/16

The fourth example runs a campaign of the package by its name, the fifth one of 16 shards, which
campaign merge combines. The same command resumes an interrupted run: only missing flights are
simulated.

With method = "corners" the nominal model ([epistemic] nominal = false omits it) and points between
the corners are simulated too: 16 with bounds = "model-form.json", else as many as corners, at most
16 (interior = N). Transient model error is included if the file has this part (transient = false
omits it); set = "ellipsoid" uses the joint confidence set."""

    out: FilePath = fields.out(positional=True)
    start_method: Literal["spawn", "forkserver", "fork"] = option(
        "spawn", "start method of the processes", toml=False
    )
    dask: str | None = option(
        None,
        "use the Dask cluster of this scheduler (address or scheduler file)",
        metavar="ADDRESS",
        toml=False,
    )
    serial: Flag = option(False, "run in this process, for debugging", toml=False)
    shard: str | None = option(
        None,
        "run the i-th of n shares only, for campaign merge",
        metavar="i/n",
        toml=False,
        python=False,
    )
    # A Python program that flies a campaign has decided to.
    yes: Flag = _yes(python=False)
    on_progress: Callable[..., object] | None = option(
        None,
        "called with the `Progress` after each batch of flights",
        kind="callable, optional",
        needed="a function of a Progress",
        cli=False,
        toml=False,
    )

    @model_validator(mode="after")
    def _check_executor(self) -> RunRequest:
        """Refuse processes of this machine on a cluster."""
        if self.dask is not None and (self.serial or self.workers is not None):
            raise ValueError(
                "{dask}: the flights run on the cluster's workers; omit {workers} and {serial}, and"
                " give the number to: dask worker --nworkers"
            )
        return self


class FolderRequest(Request):
    """The folder of a campaign."""

    folder: FilePath = option(
        ..., "campaign folder", flag="", metavar="DIR", positional=True, toml=False
    )


class StatusRequest(FolderRequest):
    """Print the progress of a campaign."""

    command: ClassVar[str] = "campaign status"
    done: ClassVar[str] = "complete"
    no: ClassVar[str] = "not complete"
    examples: ClassVar[str] = """
  uqharness campaign status campaigns/demo/results

Works from another terminal while the campaign runs."""


class ReportRequest(FolderRequest):
    """Write report.html and the figures."""

    command: ClassVar[str] = "campaign report"
    no: ClassVar[str] = "files of the folder were changed after they were written"
    examples: ClassVar[str] = """
  uqharness campaign report campaigns/demo/results

Writes DIR/report.html (one file, no network needed) and DIR/figures/*.svg. For a complete campaign
of short flights the worst and the median flight are repeated into DIR/rerun/ID for the ground
track, unless flight records exist."""

    tracks: Flag = option(
        True,
        "whether the worst and the median flight of a short campaign are repeated for the ground"
        " track",
        flag="--no-tracks",
        off=True,
        help="no ground tracks: do not repeat two flights",
        toml=False,
    )


class MergeRequest(FolderRequest):
    """Merge shards and write the tables."""

    command: ClassVar[str] = "campaign merge"
    done: ClassVar[str] = "complete"
    no: ClassVar[str] = "flights are missing (the message lists the shards to run)"
    examples: ClassVar[str] = """
  uqharness campaign merge big

Merges the shards in DIR/shards and writes DIR's tables, bit-identical to those of a single run."""


class RerunRequest(FolderRequest):
    """Repeat one case with full output and a plot."""

    command: ClassVar[str] = "campaign rerun"
    done: ClassVar[str] = "the result is as stored (or was not stored yet)"
    no: ClassVar[str] = "the result differs"
    examples: ClassVar[str] = """
  uqharness campaign rerun campaigns/demo/results --case 4c4000eebc386034

Writes record.parquet (all signals at 50 Hz, burn-in included), flight.svg and result.json into
DIR/rerun/ID."""

    case: str = option(
        ...,
        "case id, or the beginning of one",
        metavar="ID",
        needed="the id of a case, or the beginning of one,",
        positional=True,
        toml=False,
    )


class SurrogateCheckRequest(FolderRequest):
    """Repeat cases with a real autopilot in the same air, and correct the p-boxes."""

    command: ClassVar[str] = "campaign surrogate-check"
    done: ClassVar[str] = "no metric differs beyond chance, and every flight ended well"
    no: ClassVar[str] = "a metric differs beyond chance, or a flight failed"
    examples: ClassVar[str] = """
  uqharness campaign surrogate-check results --flights 12 --autopilot-warmup-s 40 \\
    --autopilot-process "arduplane --model JSON:127.0.0.1 --defaults plane.parm --home 45,0,0,0"

Repeats cases of the hardest condition with the air, noise and epistemic member of the stored
flights. Prints the difference of each metric with its interval, and the p-box with the stored
flights as control variate (docs/autopilot.md)."""

    autopilot_process: str = option(
        ...,
        "command that starts the real autopilot; {port} in it is the UDP port",
        metavar="COMMAND",
        needed="a command line, such as 'arduplane --model JSON:127.0.0.1',",
    )
    flights: WholeNumber = option(8, "flights with the real autopilot", ge=4, le=1000, metavar="K")
    autopilot_warmup_s: Number = option(
        0.0,
        "time before the real autopilot takes over from the run script, s; at most the burn-in",
        ge=0,
        le=1e5,
        metavar="T",
    )
    autopilot_port: WholeNumber = option(
        9002, "UDP port; 0 lets the system choose", ge=0, le=65535, metavar="PORT"
    )
    metric: Names = option(
        (),
        "metric to compare, a column of cases.parquet (default: medians of the true errors)",
        repeat=True,
        metavar="M",
    )


class VerifyRequest(FolderRequest):
    """Check a folder against its digests."""

    command: ClassVar[str] = "campaign verify"
    done: ClassVar[str] = "nothing is damaged"
    no: ClassVar[str] = "something is damaged or has no digests (made by uqharness 0.1)"
    examples: ClassVar[str] = """
  uqharness campaign verify campaigns/demo/results

Compares manifest, journal and tables, also those of shards, with their digests. Changes nothing."""


class SalvageRequest(FolderRequest):
    """Repair a damaged campaign: keep undamaged flights, repeat the others."""

    command: ClassVar[str] = "campaign salvage"
    no: ClassVar[str] = "flights of missing shards are missing"
    flies: ClassVar[bool] = True
    examples: ClassVar[str] = """
  uqharness campaign salvage campaigns/demo/results
  uqharness campaign salvage results --campaign campaigns/demo/campaign.toml

Keeps every flight that matches its digest, renames damaged files (journal.damaged-1.sqlite),
repeats the other flights and writes the tables, bit-identical to those of an undamaged run. Nothing
is deleted; the same command resumes after an interruption. Give --campaign if manifest.json is
damaged too, with the --hours and --samples of the run."""

    campaign: Any = _campaign(None, "the campaign file, if manifest.json is damaged or missing")
    hours: Number | None = _hours()
    samples: WholeNumber | None = _samples()
    workers: fields.Workers = _workers()
    yes: Flag = _yes(python=True)

    @model_validator(mode="after")
    def _check_size(self) -> SalvageRequest:
        """Refuse a size without the campaign it belongs to."""
        if self.campaign is None and (self.hours is not None or self.samples is not None):
            raise ValueError("{hours} and {samples} need {campaign}, the campaign file of the run")
        return self


class ConvergenceRequest(FolderRequest):
    """Measure convergence over flights and epistemic samples."""

    command: ClassVar[str] = "campaign convergence"
    done: ClassVar[str] = "done (too few flights or samples are bad input)"
    examples: ClassVar[str] = """
  uqharness campaign convergence campaigns/demo/results --repeats 4
  uqharness campaign convergence fig35 --metric cross_track_median_m

Writes DIR/convergence.csv and DIR/figures/convergence-*.svg from the stored flights."""

    repeats: WholeNumber = option(
        10, "number of parts into which the flights are divided", ge=2, metavar="N", toml=False
    )
    metric: Names = option((), "column of cases.parquet", metavar="NAME", repeat=True, toml=False)


class AreaRequest(FolderRequest):
    """Compute the area metric of real flights against the p-boxes."""

    command: ClassVar[str] = "campaign area"
    done: ClassVar[str] = "no contradiction"
    no: ClassVar[str] = "flights lie outside by more than sampling error"
    examples: ClassVar[str] = """
  uqharness campaign area campaigns/demo/results --value cross_track_median_m_measured=9.41
  uqharness campaign area results --flight flights.csv

flights.csv has one row per flight and columns as in cases.parquet. Writes DIR/area.csv: the area by
which the flights lie outside the p-box, in the metric's unit."""

    flight: fields.OptionalPath = option(
        None, "table of flights, .csv or .parquet", metavar="FILE", toml=False
    )
    value: Annotated[dict[str, Number], BeforeValidator(_numbers_by_name)] = option(
        {},
        "metrics of a single flight",
        metavar="METRIC=NUMBER",
        repeat=True,
        kind="Mapping of str to float",
        needed="a metric with its number, such as cross_track_median_m_measured=9.41,",
        toml=False,
    )


def _several_samples(value: Any) -> Any:
    """Refuse what holds no samples."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise ValueError("a mapping or sequence of arrays is needed")
    return value


class PboxRequest(Request):
    """Samples of one quantity; only Python has this request."""

    samples: Annotated[Any, BeforeValidator(_several_samples)] = option(
        ...,
        "one array (n,) of values for each epistemic sample; a mapping names them; a value that is"
        " not finite counts as unknown: it may lie anywhere and is not dropped",
        kind="Mapping or sequence",
        positional=True,
    )
    confidence: Number = option(
        0.95,
        "confidence of the band [-], over all values and samples at once",
        gt=0,
        lt=1,
        positional=True,
    )


# Request of sensitivity.


class SensitivityRequest(Request):
    """Rank uncertain coefficients by the width they give to the p-box."""

    command: ClassVar[str] = "sensitivity"
    no: ClassVar[str] = "nothing could be compared (too many flights failed, or no metric differs)"
    examples: ClassVar[str] = """
  uqharness sensitivity campaigns/demo/results
  uqharness sensitivity campaigns/demo/results --interior campaigns/demo/middle --json
  uqharness sensitivity --modal as_published

For a campaign, writes DIR/sensitivity.csv and DIR/figures/sensitivity-*.svg.
--interior names a second campaign, method = "levels" and the same seed, whose flights check that
levels between the bounds stay inside the corners' p-box."""

    folder: fields.OptionalPath = option(
        None,
        "folder of a finished corner campaign",
        flag="",
        metavar="DIR",
        positional=True,
        toml=False,
    )
    interior: fields.OptionalPath = option(
        None, "check: a campaign of levels between the bounds", metavar="DIR2", toml=False
    )
    modal: Literal["as_corrected", "as_published"] | None = option(
        None, "the dissertation's modal example, in one of two readings", toml=False
    )
    repeats: WholeNumber = option(
        10,
        "with modal: number of independent repeats, for the standard deviation",
        ge=2,
        le=1000,
        metavar="R",
        toml=False,
    )
    seed: WholeNumber = fields.seed("the repeats or of the resampling")

    @model_validator(mode="after")
    def _check_form(self) -> SensitivityRequest:
        """Require one of the two forms."""
        if (self.folder is None) == (self.modal is None):
            raise ValueError(
                "sensitivity takes either {folder}, the folder of a campaign, or {modal}"
                " as_corrected|as_published"
            )
        if self.modal is not None and self.interior is not None:
            raise ValueError("{interior} belongs to a campaign folder, not to {modal}")
        return self
