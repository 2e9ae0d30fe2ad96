"""Read STUDY.toml, the input of `uqharness study`, and check it strictly.

A study file names flights (simulated or logged), what is estimated from them, and one campaign that
is flown before and after refinement. The sections of the campaign have the names that they have in
campaign.toml. Each section is a pydantic model; `read_chain` adds the checks that need several
sections (names of flights, flights with two incompatible roles).

Errors name file, line, the value received and the values allowed. Paths are relative to the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from uqharness.campaign import CampaignSpec, campaign_from
from uqharness.errors import BadInputError
from uqharness.requests.base import Request, read_section
from uqharness.requests.identification import BoundsRequest, CompareRequest, IdentifyRequest
from uqharness.requests.logs import LogImportRequest
from uqharness.requests.refinement import RefineRequest
from uqharness.requests.simulation import FlyRequest
from uqharness.toml import (
    Section,
    as_toml,
    as_tuple,
    explain,
    line_of,
    list_as_tuple,
    read_toml,
)

Names = Annotated[tuple[str, ...], BeforeValidator(as_tuple), Field(min_length=1)]
_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
CAMPAIGN_SECTIONS = ("campaign", "aleatory", "epistemic", "metrics", "stop", "start")


class StudySection(Section):
    """The question, the aircraft and the options that all stages share.

    ``servos`` is passed to every stage that replays a flight. ``air`` is passed to `instrument`,
    which runs only if the aircraft has no plugin yet.
    """

    name: str = Field(pattern=rf"^{_NAME}$")
    question: str = Field(min_length=1)
    aircraft: str = Field(min_length=1)
    servos: Literal["auto", "card", "ideal"] = "auto"
    air: bool = False


class StageSection(Section):
    """The keys of a section that belong to the study; the others are options of its command.

    ``options`` are the fields of the command's request that the section sets.
    """

    model_config = ConfigDict(extra="allow")

    options: Mapping[str, Any] = Field(default_factory=dict, exclude=True)


class FlySection(StageSection):
    """One flight of a simulated truth that is written as a log."""

    name: str = Field(pattern=rf"^{_NAME}$")
    aircraft: str = Field(min_length=1)
    script: str = Field(min_length=1)


class LogSection(StageSection):
    """One log of the user; paths are relative to the study file."""

    name: str = Field(pattern=rf"^{_NAME}$")
    file: str = Field(min_length=1)
    map: str | None = Field(default=None, min_length=1)
    manoeuvres: str | None = Field(default=None, min_length=1)


class IdentifySection(StageSection):
    """The flights that the parameters are estimated from."""

    flights: Names


class CompareSection(StageSection):
    """The flights that the model is compared with, before and after refinement."""

    flights: Names


class BoundsSection(StageSection):
    """The flights of the model-form bounds and those that check them.

    ``samples`` = "all" is ``as_published``, by its earlier name.
    """

    flights: Names
    validate_on: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    samples: Literal["effective", "all"] = "effective"


class RefineSection(StageSection):
    """Training and hold-out flights."""

    train: Names
    test: Names


STAGE_SECTIONS: Mapping[str, tuple[type[StageSection], type[Request], Mapping[str, Any]]] = {
    "fly": (FlySection, FlyRequest, {"aircraft": "a", "script": "s"}),
    "logs": (
        LogSection,
        LogImportRequest,
        {"log": "l", "out": "o.parquet", "aircraft": None, "cache": None, "use_cache": False},
    ),
    "identify": (IdentifySection, IdentifyRequest, {"aircraft": "a", "flights": "f"}),
    "compare": (CompareSection, CompareRequest, {"aircraft": "a", "flight": "f"}),
    "bounds": (BoundsSection, BoundsRequest, {"aircraft": "a", "flights": "f"}),
    "refine": (
        RefineSection,
        RefineRequest,
        {"aircraft": "a", "train": "f", "test": "g", "out": "o"},
    ),
}
"""Section to its own keys, the request whose other keys it has, and what the study sets itself."""


class _Document(Section):
    """All sections of a study file; the campaign's are validated later, with the aircraft
    added.
    """

    study: StudySection
    fly: Annotated[tuple[FlySection, ...], BeforeValidator(list_as_tuple)] = ()
    logs: Annotated[tuple[LogSection, ...], BeforeValidator(list_as_tuple)] = ()
    identify: IdentifySection | None = None
    compare: CompareSection | None = None
    bounds: BoundsSection | None = None
    refine: RefineSection | None = None
    campaign: Any = None
    aleatory: Any = None
    epistemic: Any = None
    metrics: Any = None
    stop: Any = None
    start: Any = None

    @model_validator(mode="after")
    def _require_stage(self) -> _Document:
        """Refuse a study that runs no stage."""
        if not (
            self.identify or self.compare or self.bounds or self.refine or self.campaign is not None
        ):
            raise ValueError(
                "runs no stage; give at least one of [identify], [compare], [bounds], [refine],"
                " [campaign]"
            )
        return self


@dataclass(frozen=True)
class ChainSpec:
    """A validated study.

    Attributes
    ----------
    path : Path
        The study file.
    source : str
        Its text, for line numbers in later errors.
    study, fly, logs, identify, compare, bounds, refine
        Sections of the file; None or empty if absent.
    campaign : CampaignSpec or None
        The campaign, validated without the bounds that the study makes.
    campaign_data : mapping
        The campaign's sections as they are written in the file.
    """

    path: Path
    source: str
    study: StudySection
    fly: tuple[FlySection, ...]
    logs: tuple[LogSection, ...]
    identify: IdentifySection | None
    compare: CompareSection | None
    bounds: BoundsSection | None
    refine: RefineSection | None
    campaign: CampaignSpec | None
    campaign_data: Mapping[str, Any]

    @property
    def folder(self) -> Path:
        """Return the folder that the file's relative paths start from."""
        return self.path.resolve().parent

    @property
    def flights(self) -> tuple[str, ...]:
        """Return the names of all flights, simulated flights first."""
        return (*(item.name for item in self.fly), *(item.name for item in self.logs))

    def resolve(self, name: str) -> Path:
        """Return the path of a name in the file."""
        return self.folder / name


def read_chain(path: str | Path) -> ChainSpec:
    """Read and validate a study file.

    Parameters
    ----------
    path : str or Path
        A STUDY.toml.

    Returns
    -------
    ChainSpec
        Its sections, checked one by one and against each other.

    Raises
    ------
    BadInputError
        If anything is wrong; it lists every mistake as ``file:line: ...``.
    """
    path = Path(path)
    data, text = read_toml(path)
    lines: list[str] = []
    options = _options(path, text, data, lines)
    try:
        document = _Document.model_validate(data)
    except ValidationError as error:
        problems = explain(_Document, text, data, error)
        lines += [f"{path}:{line}: {message}" for line, message in problems]
    if lines:
        numbers = {line: int(line.removeprefix(f"{path}:").partition(":")[0]) for line in lines}
        raise BadInputError(*sorted(numbers, key=lambda line: numbers[line]))
    document = document.model_copy(update=_with_options(document, options))
    # pydantic has validated each section by itself; the campaign and the roles of flights follow.
    sections = {name: data[name] for name in CAMPAIGN_SECTIONS if name in data}
    spec = ChainSpec(
        path,
        text,
        document.study,
        document.fly,
        document.logs,
        document.identify,
        document.compare,
        document.bounds,
        document.refine,
        _campaign(document, sections, path, text),
        sections,
    )
    _check(spec)
    return spec


def _tables(data: Mapping[str, Any]) -> Iterator[tuple[str, int | None, dict[str, Any]]]:
    """Yield the stage sections of a file: name, number in an array of tables, content."""
    for name in STAGE_SECTIONS:
        content = data.get(name)
        if isinstance(content, dict):
            yield name, None, content
        elif isinstance(content, list):
            yield from ((name, k, item) for k, item in enumerate(content) if isinstance(item, dict))


def _place_of(path: Path, text: str, section: tuple[str, ...], key: str) -> tuple[Path, int]:
    """Return file and line of a key."""
    return path, line_of(text, (*section, key))


def _options(
    path: Path, text: str, data: Mapping[str, Any], lines: list[str]
) -> dict[tuple[str, int | None], dict[str, Any]]:
    """Return the options of the commands by section; mistakes are added to ``lines``."""
    options = {}
    for name, number, content in _tables(data):
        section, request, also = STAGE_SECTIONS[name]
        place: tuple[str, ...] = (name,) if number is None else (name, str(number))
        option_keys = [key for key in section.model_fields if key != "options"]
        try:
            options[name, number] = read_section(
                request,
                {key: value for key, value in content.items() if key not in option_keys},
                heading=f"[{name}]" if number is None else f"[[{name}]] number {number + 1}",
                line=partial(_place_of, path, text, place),
                also=also,
                own=option_keys,
            )
        except BadInputError as error:
            lines += error.args
    return options


def _with_options(
    document: _Document, options: Mapping[tuple[str, int | None], Mapping[str, Any]]
) -> dict[str, Any]:
    """Return the sections with the options of their commands."""
    sections: dict[str, Any] = {}
    for name in STAGE_SECTIONS:
        part = getattr(document, name)
        if isinstance(part, tuple):
            sections[name] = tuple(
                item.model_copy(update={"options": options[name, k]}) for k, item in enumerate(part)
            )
        elif part is not None:
            sections[name] = part.model_copy(update={"options": options[name, None]})
    return sections


def _campaign(
    document: _Document, sections: Mapping[str, Any], path: Path, text: str
) -> CampaignSpec | None:
    """Validate the campaign's sections as campaign.toml would be.

    The study itself sets the aircraft and the bounds, so sections that set them too are refused.
    None if the file has no section of a campaign.
    """
    if not sections:
        return None
    campaign, epistemic = sections.get("campaign"), sections.get("epistemic")

    def located_error(location: tuple[str, ...], reason: str) -> BadInputError:
        """Return an error that names file, line, section and key."""
        return BadInputError(
            f"{path}:{line_of(text, location)}: [{'.'.join(location[:-1])}] {location[-1]}:"
            f" {reason}"
        )

    # Settings that the study makes itself must not be in the file.
    if isinstance(campaign, dict) and "aircraft" in campaign:
        raise located_error(
            ("campaign", "aircraft"),
            "the study flies its own aircraft, before and after; leave it out",
        )
    if isinstance(epistemic, dict) and "parameters" in epistemic:
        raise located_error(
            ("epistemic", "parameters"),
            "a draw of parameters belongs to one model, and a study flies two; use `uqharness"
            " campaign run` for it",
        )
    if document.bounds is not None and isinstance(epistemic, dict) and "bounds" in epistemic:
        raise located_error(
            ("epistemic", "bounds"),
            "the section [bounds] makes them from flights; leave out one of the two",
        )
    # The base aircraft stands in for the models that the study makes: both have its properties.
    data = dict(sections)
    if isinstance(campaign, dict):
        data["campaign"] = {**campaign, "aircraft": document.study.aircraft}
    return campaign_from(data, path, text)


def _check(spec: ChainSpec) -> None:
    """Raise BadInputError for missing, unused or repeated flights, and for flights in two roles of
    which one would test the result of the other.
    """
    # All problems are collected before raising, so that one run shows them all.
    problems = [*_name_problems(spec), *_unknown_flight_problems(spec), *_role_problems(spec)]
    if problems:
        raise BadInputError(*(f"{spec.path}:{line}: {text}" for line, text in problems))


def _name_problems(spec: ChainSpec) -> Iterable[tuple[int, str]]:
    """Yield (line, message) for flights with a name that is taken, and for flights that no section
    uses.
    """
    places = [(item.name, ("fly", str(k))) for k, item in enumerate(spec.fly)]
    places += [(item.name, ("logs", str(k))) for k, item in enumerate(spec.logs)]
    used_names = {name for _, _, group in _flight_uses(spec) for name in group}
    visited: set[str] = set()
    # Each flight needs a unique name and a section that uses it.
    for name, place in places:
        line = line_of(spec.source, (*place, "name"))
        if name in visited:
            yield (
                line,
                (
                    f"[[{place[0]}]] name = {as_toml(name)}: another flight has this name; give"
                    " each its own"
                ),
            )
        elif name not in used_names:
            yield (
                line,
                (
                    f"[[{place[0]}]] name = {as_toml(name)}: no section uses this flight; name it"
                    " in one, or leave it out"
                ),
            )
        visited.add(name)


def _flight_uses(spec: ChainSpec) -> list[tuple[str, str, tuple[str, ...]]]:
    """List section, key and the flights named there."""
    uses: list[tuple[str, str, tuple[str, ...]]] = []
    for section in ("identify", "compare", "bounds"):
        part = getattr(spec, section)
        if part is not None:
            uses.append((section, "flights", part.flights))
    if spec.bounds is not None:
        uses.append(("bounds", "validate_on", spec.bounds.validate_on))
    if spec.refine is not None:
        uses += [("refine", "train", spec.refine.train), ("refine", "test", spec.refine.test)]
    return uses


def _unknown_flight_problems(spec: ChainSpec) -> Iterable[tuple[int, str]]:
    """Yield (line, message) for flights that are not declared, and for flights named twice in one
    list.
    """
    declared = spec.flights
    for section, key, names in _flight_uses(spec):
        line = line_of(spec.source, (section, key))
        for name in names:
            if name not in declared:
                declared_names = ", ".join(declared) or "none"
                yield (
                    line,
                    (
                        f"[{section}] {key}: no flight is named {as_toml(name)}; [[fly]] and"
                        f" [[logs]] have: {declared_names}"
                    ),
                )
        for name in dict.fromkeys(n for n in names if names.count(n) > 1):
            yield line, f"[{section}] {key}: {as_toml(name)} is named twice"


# Two roles that one flight must not have, and the reason.
_SEPARATE_ROLES: Sequence[tuple[tuple[str, str], tuple[str, str], str]] = (
    (("refine", "test"), ("refine", "train"), "a test flight must not choose the effect"),
    (("refine", "test"), ("identify", "flights"), "a test flight must not have made the model"),
    (
        ("bounds", "flights"),
        ("identify", "flights"),
        "residuals of a flight that made the model are too small for bounds",
    ),
    (
        ("bounds", "flights"),
        ("refine", "train"),
        "residuals of a flight that chose the effect are too small for bounds",
    ),
    (
        ("bounds", "validate_on"),
        ("bounds", "flights"),
        "bounds are not checked on the flight they were made from",
    ),
    (
        ("bounds", "validate_on"),
        ("identify", "flights"),
        "coverage of a flight that made the model says nothing",
    ),
    (
        ("bounds", "validate_on"),
        ("refine", "train"),
        "coverage of a flight that chose the effect says nothing",
    ),
)


def _role_problems(spec: ChainSpec) -> Iterable[tuple[int, str]]:
    """Yield (line, message) for flights in two roles that must be held by different flights."""
    # Only roles of sections that exist are compared.
    roles = {(section, key): names for section, key, names in _flight_uses(spec)}
    for role, excluded_role, reason in _SEPARATE_ROLES:
        for name in roles.get(role, ()):
            if name in roles.get(excluded_role, ()):
                line = line_of(spec.source, role)
                yield (
                    line,
                    (
                        f"[{role[0]}] {role[1]}: {as_toml(name)} is also in [{excluded_role[0]}]"
                        f" {excluded_role[1]}; {reason}. Name another flight"
                    ),
                )
