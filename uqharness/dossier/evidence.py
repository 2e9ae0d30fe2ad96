"""Inventory of a folder of results: the steps in order, their source files, and what is missing.

`read_evidence` finds the results of every command below a folder by their marker files, checks
recorded SHA-256 digests, and lists gaps as sentences. `factors` then sorts the evidence by the
eight credibility factors of NASA-STD-7009. The report page `dossier` prints both.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from sysid.foreign.regular_files import file_sha256
from uqharness.campaign import Manifest, read_complete
from uqharness.dossier.match import FAIL, INCONCLUSIVE, PASS, Match
from uqharness.errors import BadInputError
from uqharness.replay import HISTORIES, History, read_histories
from uqharness.results.base import Part, Shape, read_result
from uqharness.results.identification import Bounds, Compare, Coverage, Fit
from uqharness.results.refinement import Refinement
from uqharness.results.study import Study

STUDY = "study"
_MARKS: tuple[tuple[str, str, type[Part] | None], ...] = (
    ("study.json", STUDY, Study),
    ("fit.json", "identify", Fit),
    ("compare.json", "compare", Compare),
    ("refinement.json", "refine", Refinement),
    ("model-form.json", "bounds", None),
    ("coverage.json", "validate-bounds", Coverage),
    ("manifest.json", "campaign", None),
)
"""Marker file of a command's results, the command, and the model that validates the file."""
_LEFTOVERS = (
    ("model.diff", "refine", "refinement.json"),
    ("journal.sqlite", "campaign", "manifest.json"),
    ("cases.parquet", "campaign", "manifest.json"),
    ("parameters.csv", "identify", "fit.json"),
    ("channels.csv", "compare", "compare.json"),
    ("model-form.xml", "bounds", "model-form.json"),
    ("campaign-before.toml", STUDY, "study.json"),
)
"""Further file of a command; without the marker file (third entry), the results are damaged."""
_COMPANIONS: Mapping[str, tuple[str, ...]] = {
    "identify": (HISTORIES, "aircraft"),
    "refine": (HISTORIES, "model.diff", "aircraft"),
    "compare": (HISTORIES,),
    "bounds": ("bounds.json",),
    "campaign": ("cases.parquet", "statements.csv", "pbox.parquet"),
}
"""Files that a command writes next to its marker file."""
_NOT_LISTED = frozenset({"report.html", "dossier.html", "run.lock"})
_NOT_ENTERED = frozenset(
    {"figures", "aircraft", "log", "before", "intervals", "shards", "flights", "Systems", "systems"}
)
_ORDER = ("identify", "compare", "bounds", "validate-bounds", "campaign", "refine", STUDY)
_MAX_DEPTH = 3


def _mapping_or_empty(value: Any) -> Any:
    """Return a mapping; {} for the name that older files have."""
    return value if isinstance(value, dict) else {}


class BoundsEvidence(Part):
    """What the dossier reads of bounds: bounds.json, and model-form.json where it is missing."""

    aircraft: str
    aircraft_sha256: str
    """Digest of the aircraft, to compare with that of the aircraft that a campaign flew."""
    coefficients: list[str]
    confidence: float
    command: str | None
    version: str


class _Form(Part):
    """Keys of model-form.json that the dossier reads."""

    aircraft: Annotated[dict[str, Any], BeforeValidator(_mapping_or_empty)] = Field(default={})
    coefficients: dict[str, Any] = Field(default={})
    confidence: float | None = None


@dataclass(frozen=True)
class Step:
    """Results of one command.

    Attributes
    ----------
    kind : str
        Command, such as ``identify`` or ``refine``.
    place : str
        Folder relative to the folder of results; ``"."`` for that folder itself.
    folder : Path
        The same folder as a path.
    document : mapping or None
        Content of the marker file; None if it cannot be read.
    """

    kind: str
    place: str
    folder: Path
    document: Mapping[str, Any] | None

    @property
    def command(self) -> str:
        """Return the command line that wrote the results; empty if it is not recorded."""
        return str((self.document or {}).get("command") or "")

    @property
    def version(self) -> str:
        """Return the version of uqharness that wrote the results; empty if it is not recorded."""
        document = self.document or {}
        return str(document.get("version") or document.get("versions", {}).get("uqharness") or "")


@dataclass(frozen=True)
class Source:
    """A file that the dossier cites.

    Attributes
    ----------
    file : str
        Path relative to the folder of results.
    sha256 : str
        Digest of its content.
    command, version : str
        Of the step that wrote the file; empty if not recorded.
    """

    file: str
    sha256: str
    command: str
    version: str


@dataclass
class Evidence:
    """Content of a folder of results.

    Attributes
    ----------
    folder : Path
        The folder.
    steps : list of Step
        Steps in the order in which they were run.
    sources : list of Source
        Files of the steps, with their digests.
    missing : list of str
        One sentence for each file that is missing, unreadable or altered.
    """

    folder: Path
    steps: list[Step] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    def of(self, kind: str) -> list[Step]:
        """Return the readable steps of one kind, in order."""
        return [s for s in self.steps if s.kind == kind and s.document is not None]

    def results(self, shape: type[Shape]) -> list[tuple[Step, Shape]]:
        """Return the readable steps whose result has this model, each with its result."""
        return [(s, s.document) for s in self.steps if isinstance(s.document, shape)]

    def histories(self, step: Step) -> list[History]:
        """Return the replayed segments of a step; an unreadable file is reported in `missing`."""
        try:
            return read_histories(step.folder / HISTORIES)
        except BadInputError as error:
            self.add_error(error)
            return []

    def add_error(self, error: BadInputError) -> None:
        """Add an error message to `missing`, with paths relative to the folder.

        A copy of the folder elsewhere must give the same dossier.
        """
        self.add_missing(str(error).replace(f"{self.folder}/", "").replace(str(self.folder), "DIR"))

    def add_missing(self, text: str) -> None:
        """Add a sentence to `missing` unless it is there already."""
        if text not in self.missing:
            self.missing.append(text)


def read_evidence(folder: Path) -> Evidence:
    """Read all results in a folder and its subfolders.

    Incomplete or damaged results are listed in `Evidence.missing`; they are no error.

    Parameters
    ----------
    folder : Path
        Output folder of ``study``, ``refine``, ``campaign run`` or ``identify``.

    Returns
    -------
    Evidence
        Steps, source files and gaps.

    Raises
    ------
    BadInputError
        If the path is no folder, or no command of this program wrote to it.
    """
    if not folder.is_dir():
        raise BadInputError(
            f"{folder}: is no folder; dossier takes the --out of study, refine, campaign run or"
            " identify"
        )
    evidence = Evidence(folder)
    for subfolder in _folders(folder):
        _read_folder(evidence, subfolder)
    if not evidence.steps:
        marker_files = ", ".join(name for name, _, _ in _MARKS)
        raise BadInputError(
            f"{folder}: no results of this program; looked for {marker_files}, also in the folders"
            " below"
        )
    # Gaps reported by a study come first, then missing companions of each step.
    _read_study(evidence)
    evidence.steps = sorted(evidence.steps, key=lambda s: _sort_key(evidence, s))
    for step in evidence.steps:
        _read_companions(evidence, step)
    _list_sources(evidence)
    return evidence


def _folders(folder: Path) -> Iterator[Path]:
    """Yield the folder and its subfolders, sorted, at most `_MAX_DEPTH` levels deep."""
    yield folder

    def below(at: Path, depth: int) -> Iterator[Path]:
        for path in sorted(
            p
            for p in at.iterdir()
            if p.is_dir() and not p.is_symlink() and p.name not in _NOT_ENTERED
        ):
            yield path
            if depth < _MAX_DEPTH:
                yield from below(path, depth + 1)

    yield from below(folder, 1)


def _read_folder(evidence: Evidence, place: Path) -> None:
    """Add the steps whose marker files lie in one folder."""
    relative = place.relative_to(evidence.folder).as_posix()
    marks = [mark for mark in _MARKS if (place / mark[0]).is_file()]
    for name, kind, shape in marks:
        try:
            document = _read_result(place, name, kind, shape)
        except BadInputError as error:
            evidence.add_error(error)
            document = None
        evidence.steps.append(Step(kind, relative, place, document))
    # A command's other files without its marker file mean that the marker was lost.
    marked_kinds = {kind for _, kind, _ in marks}
    for leftover, kind, mark in _LEFTOVERS:
        if kind not in marked_kinds and (place / leftover).is_file():
            marked_kinds.add(kind)
            evidence.add_missing(
                f"{_join(relative, mark)} is missing, but {leftover} is there: the results"
                f" of {kind} are unknown"
            )
            evidence.steps.append(Step(kind, relative, place, None))


def _read_result(place: Path, name: str, kind: str, shape: type[Part] | None) -> Mapping[str, Any]:
    """Read and validate a marker file."""
    # A campaign's folder has a stricter reader of its own.
    if kind == "campaign":
        return read_complete(place)
    if kind == "bounds":
        form = read_result(place / name, _Form)
        bounds_file = place / "bounds.json"
        bounds = read_result(bounds_file, Bounds) if bounds_file.is_file() else None
        confidence = form.confidence if bounds is None else bounds.confidence
        return BoundsEvidence(
            aircraft="" if bounds is None else bounds.aircraft,
            aircraft_sha256=str(form.aircraft.get("sha256", "")),
            coefficients=list(form.coefficients if bounds is None else bounds.coefficients),
            confidence=0.95 if confidence is None else confidence,
            command=None if bounds is None else bounds.command,
            version="" if bounds is None else bounds.version,
        )
    assert shape is not None
    return read_result(place / name, shape)


def _read_study(evidence: Evidence) -> None:
    """Report stages of a study that are unfinished, lack their folder, or have altered outputs."""
    for step, study in evidence.results(Study):
        for stage in study.stages:
            # Stages that did not finish have no outputs to check.
            if stage.state != "done":
                evidence.add_missing(
                    f"stage {stage.name} is {stage.state}"
                    + (f": {stage.error}" if stage.error else "")
                )
                continue
            if stage.folder and not (step.folder / stage.folder).is_dir():
                evidence.add_missing(
                    f"stage {stage.name}: its folder {_join(step.place, stage.folder)} is not there"
                )
            for file, digest in stage.outputs.items():
                _check_digest(evidence, step.folder / file, digest, f"stage {stage.name}")


def _check_digest(evidence: Evidence, path: Path, digest: str, recorded_by: str) -> None:
    """Report a file that is missing or whose SHA-256 differs from the recorded one.

    ``recorded_by`` begins the sentence, such as ``stage fit``. Folders and values that are no
    digest are ignored.
    """
    name = (
        path.relative_to(evidence.folder).as_posix()
        if path.is_relative_to(evidence.folder)
        else path.name
    )
    # Folders and values that are no SHA-256 are not checked.
    if not re.fullmatch(r"[0-9a-f]{64}", digest) or path.is_dir():
        return
    if not path.is_file():
        evidence.add_missing(f"{recorded_by}: {name} is not there")
    elif file_sha256(path) != digest:
        evidence.add_missing(
            f"{recorded_by}: {name} is not the file that was written (its SHA-256 differs)"
        )


def _read_companions(evidence: Evidence, step: Step) -> None:
    """Report missing companion files of a step, and campaign tables that were altered."""
    tables = step.document.tables if isinstance(step.document, Manifest) else {}
    for name in _COMPANIONS.get(step.kind, ()):
        if name not in tables and not (step.folder / name).exists():
            evidence.add_missing(
                f"{_join(step.place, name)} is not there, which {step.kind} writes"
            )
    for name, digest in tables.items():
        _check_digest(evidence, step.folder / name, str(digest), "campaign")


def _sort_key(evidence: Evidence, step: Step) -> tuple[float, int, str]:
    """Return the sort key of a step: a study's own order, else the usual order of commands.

    Refinements follow the step that wrote their aircraft.
    """
    for _, study in evidence.results(Study):
        # Within a study, its order of stages decides.
        order = [stage.folder for stage in study.stages]
        if step.place in order:
            return float(order.index(step.place)), 0, step.place
    if step.kind == STUDY:
        return 1e9, 0, step.place
    return 1e6 + _ORDER.index(step.kind), _generation(evidence, step, frozenset()), step.place


def _generation(evidence: Evidence, step: Step, visited: frozenset[str]) -> int:
    """Return the number of steps between a step's aircraft and an external aircraft."""
    # The third word of a command line is the aircraft.
    words = step.command.split()
    for other in evidence.steps:
        name = Path(other.place).name
        if (
            other is not step
            and other.place not in visited
            and name
            and any(name in Path(w).parts for w in words[2:3])
        ):
            return 1 + _generation(evidence, other, visited | {step.place})
    return 0


def _list_sources(evidence: Evidence) -> None:
    """List each file of each step once, with its digest."""
    listed: set[Path] = set()
    for step in evidence.steps:
        for path in _files(step.folder):
            if path not in listed:
                listed.add(path)
                name = path.relative_to(evidence.folder).as_posix()
                evidence.sources.append(Source(name, file_sha256(path), step.command, step.version))


def _files(folder: Path) -> Sequence[Path]:
    """Return the files of a step's folder, its aircraft and its flights, sorted."""
    step_files = [
        p
        for p in folder.iterdir()
        if p.is_file() and not p.is_symlink() and p.name not in _NOT_LISTED
    ]
    aircraft_and_flights = [
        p
        for name in ("aircraft", "before", "flights")
        for p in (folder / name).rglob("*")
        if p.is_file() and not p.is_symlink() and p.suffix in (".xml", ".toml", ".bin", ".parquet")
    ]
    # SQLite rewrites a database on reading, so its digest is no evidence.
    return sorted(
        p
        for p in (*step_files, *aircraft_and_flights)
        if p.suffix not in (".sqlite", ".lock") and not p.name.endswith(("-wal", "-shm"))
    )


def _join(place: str, name: str) -> str:
    """Return a file name relative to the folder of results."""
    return name if place == "." else f"{place}/{name}"


# Credibility factors of NASA-STD-7009. No level is assigned: that is left to the user of the model.

STANDARD = "NASA-STD-7009B"
NOT_ASSESSED = "not assessed"
ENGINE_CHECK = "engine-check.csv"


@dataclass(frozen=True)
class Factor:
    """One credibility factor.

    Attributes
    ----------
    name, about : str
        Name in the standard, and what it covers.
    evidence : tuple of str
        Statements; empty if the folder holds no evidence ("not assessed").
    """

    name: str
    about: str
    evidence: tuple[str, ...]


def factors(evidence: Evidence, match: Match) -> tuple[Factor, ...]:
    """Return the eight credibility factors of NASA-STD-7009 with their evidence.

    Parameters
    ----------
    evidence : Evidence
        Content of the folder.
    match : Match
        Objective tests of its segments.

    Returns
    -------
    tuple of Factor
        In the order of the standard.
    """
    return tuple(
        Factor(name, about, tuple(collect(evidence, match))) for name, about, collect in _FACTORS
    )


def simulating_models(evidence: Evidence) -> list[str]:
    """Return the models that simulated the flights of a study, each once, in order."""
    flights = [s for _, study in evidence.results(Study) for s in study.stages if s.kind == "fly"]
    return list(
        dict.fromkeys(words[2] for s in flights if len(words := (s.command or "").split()) > 2)
    )


def _data_pedigree(evidence: Evidence, _: Match) -> list[str]:
    """State the flights that the model was identified and refined from."""
    statements = []
    for aircraft in simulating_models(evidence):
        statements.append(
            f"the flights are simulated, by the model {aircraft}: none is of a real aircraft"
        )
    for step, fit in evidence.results(Fit):
        with_digest = "with SHA-256" if fit.flights_sha256 else "without a digest"
        statements.append(
            f"{_place_of(step)}: identified from {', '.join(fit.flights)}, recorded {with_digest}"
        )
        n_estimated = sum(row.noise is not None for row in fit.fit.values())
        statements.append(
            f"{_place_of(step)}: sensor noise estimated for {n_estimated} of {len(fit.fit)}"
            " channels"
        )
    for step, refinement in evidence.results(Refinement):
        train, test = (
            ", ".join(names) or "not recorded" for names in (refinement.train, refinement.test)
        )
        statements.append(
            f"{_place_of(step)}: effects chosen on {train}, shown on the hold-out flights {test}"
        )
    return statements


def _verification(evidence: Evidence, _: Match) -> list[str]:
    """State the comparison of engines and the convergence of estimations."""
    # Imported here: loading it is slow, and folders without a campaign need none of it.
    from uqharness.campaign import read_check

    statements = []
    for step in evidence.of("campaign"):
        rows = read_check(step.folder)
        if not rows and (step.folder / ENGINE_CHECK).is_file():
            evidence.add_missing(f"{_place_of(step)}: {ENGINE_CHECK} cannot be read")
        if rows:
            alike = sum(row.verdict == "alike" for row in rows)
            excused = sum(row.verdict == "excused" for row in rows)
            flights = len({row.case_id for row in rows})
            statements.append(
                f"{_place_of(step)}: {flights} flights flown by a second engine as well; of"
                f" {len(rows)} metrics {alike} are alike, {excused} excused with a reason,"
                f" {len(rows) - alike - excused} differ (engine-check.csv)"
            )
    for step, fit in evidence.results(Fit):
        converged = "converged" if fit.converged else "did not converge"
        statements.append(f"{_place_of(step)}: the estimation {converged}")
    return statements


def _validation(evidence: Evidence, match: Match) -> list[str]:
    """State the outcome of objective tests, refinement and comparison."""
    statements = []
    counts = {
        answer: sum(j.answer == answer for j in match.results)
        for answer in (PASS, FAIL, INCONCLUSIVE)
    }
    if match.results:
        statements.append(
            f"proof of match: {len(match.results)} segments judged by objective tests,"
            f" {counts[PASS]} pass, {counts[FAIL]} fail, {counts[INCONCLUSIVE]} inconclusive;"
            f" {len(match.missing)} tests are not in the data"
        )
    for step, refinement in evidence.results(Refinement):
        test = refinement.gap.test
        # In turbulence, replay residuals contain the gust response; one-step predictions do not.
        predicted = test.predictions
        # Rms over noise of each channel, after refinement.
        ratios = {
            c: r.rms_after / r.noise_rms
            for c, r in (predicted or test.channels).items()
            if r.rms_after and r.noise_rms
        }
        if ratios:
            worst = max(ratios, key=lambda c: ratios[c])
            rms_name = "rms of one-step predictions" if predicted else "rms"
            statements.append(
                f"{_place_of(step)}: on the hold-out flights {rms_name} over noise is at most"
                f" {ratios[worst]:.2f} ({worst})"
            )
    for step, comparison in evidence.results(Compare):
        verb = "reaches" if comparison.reached_noise_floor else "does not reach"
        statements.append(
            f"{_place_of(step)}: the model {verb} the noise floor on {comparison.flight}"
        )
    return statements


def _input_pedigree(evidence: Evidence, _: Match) -> list[str]:
    """State the digests of a campaign's inputs, and its wind and turbulence."""
    statements = []
    for step, manifest in evidence.results(Manifest):
        roles = ", ".join(sorted(manifest.hashes))
        air = manifest.settings.aleatory
        statements.append(f"{_place_of(step)}: SHA-256 recorded of {roles}")
        statements.append(
            f"{_place_of(step)}: wind {_comma_separated(air.wind_mps)} m/s, turbulence"
            f" {_comma_separated(air.turbulence)} (Dryden, source {air.turbulence_source}); no"
            " measured air"
        )
    return statements


def _uncertainty(evidence: Evidence, _: Match) -> list[str]:
    """State standard errors, error bounds, their coverage, and the p-boxes."""
    statements = []
    # Parameters, then bounds, then their coverage, then what they do to the performance.
    for step, fit in evidence.results(Fit):
        rows = fit.parameters.values()
        n_identified = sum(r.status == "identified" for r in rows)
        unidentified_note = (
            "" if n_identified == len(rows) else f"; {len(rows) - n_identified} are not identified"
        )
        statements.append(
            f"{_place_of(step)}: standard errors of {n_identified} of {len(rows)}"
            f" parameters{unidentified_note}"
        )
    for step, bounds in evidence.results(BoundsEvidence):
        statements.append(
            f"{_place_of(step)}: intervals of the model's error for "
            f"{len(bounds.coefficients)} coefficients at {100 * bounds.confidence:g} % as functions"
            " of the flight state"
        )
    for step, validation in evidence.results(Coverage):
        shares = [row.share_95 for row in validation.coverage.values()]
        low, high = min(shares), max(shares)
        statements.append(
            f"{_place_of(step)}: {100 * low:.1f} to {100 * high:.1f} % of a new flight's"
            " samples lie inside the 95 % intervals"
        )
    for step, manifest in evidence.results(Manifest):
        statements.append(
            f"{_place_of(step)}: p-boxes: epistemic uncertainty by intervals, aleatory"
            f" uncertainty by {manifest.cases} flights"
        )
    return statements


def _robustness(evidence: Evidence, _: Match) -> list[str]:
    """State sensitivities of the p-boxes and the sampling of epistemic variables."""
    statements = []
    for step, manifest in evidence.results(Manifest):
        if (step.folder / "sensitivity.csv").is_file():
            statements.append(
                f"{_place_of(step)}: share of each coefficient in the width of every p-box"
                " (sensitivity.csv)"
            )
        epistemic = manifest.settings.epistemic
        between = f", {epistemic.interior} samples between them" if epistemic.interior else ""
        statements.append(f"{_place_of(step)}: epistemic samples by {epistemic.method}{between}")
    return statements


def _no_evidence(_: Evidence, __: Match) -> list[str]:
    """Return no statement: no command records evidence for this factor."""
    return []


_FACTORS: Sequence[tuple[str, str, Callable[[Evidence, Match], list[str]]]] = (
    ("Data pedigree", "data that the model was made from", _data_pedigree),
    ("Verification", "the model is computed as it is written", _verification),
    ("Validation", "the model against the aircraft", _validation),
    ("Input pedigree", "data that the model was used with", _input_pedigree),
    ("Uncertainty characterisation", "sources of uncertainty in the results", _uncertainty),
    ("Results robustness", "sensitivity of the results", _robustness),
    ("Use history", "earlier use of the model for the same purpose", _no_evidence),
    ("People", "qualification of those who made and used the model", _no_evidence),
)
"""Factor, what it covers, and the function that collects its evidence."""


def _place_of(step: Step) -> str:
    """Return the name that statements use for a step."""
    return step.kind if step.place == "." else step.place


def _comma_separated(value: object) -> str:
    """Return a list as text separated by commas."""
    return ", ".join(str(v) for v in value) if isinstance(value, (list, tuple)) else str(value)
