"""STUDY.toml of `uqharness study`: flights, what is done with them, and the campaign flown before
and after, strictly validated.

The sections of a campaign stand in the same file under the names they have in campaign.toml. Errors
name file, line, what was received and what is allowed. Paths are relative to the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, field_validator, model_validator

from uqharness.campaign.spec import CampaignSpec, Coefficient, Turbulence, campaign_from
from uqharness.errors import BadInputError
from uqharness.flight import DEFAULT_TURBULENCE_SOURCE
from uqharness.toml import Number, Section, as_toml, explain, line_of, listed, read_toml, tupled

Names = Annotated[tuple[str, ...], BeforeValidator(listed), Field(min_length=1)]
_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
CAMPAIGN_SECTIONS = ("campaign", "aleatory", "epistemic", "metrics", "stop", "start")


class StudySection(Section):
    """What is asked, of which aircraft. ``servos`` goes to every stage that replays a flight;
    ``air`` to `instrument`, where the aircraft lacks the plugin."""

    name: str = Field(pattern=rf"^{_NAME}$")
    question: str = Field(min_length=1)
    aircraft: str = Field(min_length=1)
    servos: Literal["auto", "card", "ideal"] = "auto"
    air: bool = False


class FlySection(Section):
    """One flight of a simulated truth, written as a log: the arguments of `uqharness fly`."""

    name: str = Field(pattern=rf"^{_NAME}$")
    aircraft: str = Field(min_length=1)
    script: str = Field(min_length=1)
    seed: int = Field(default=0, ge=0)
    noise: bool = True
    turbulence: Turbulence = "none"
    turbulence_source: Literal["jsbsim", "spec"] = DEFAULT_TURBULENCE_SOURCE
    wind_mps: Number = Field(default=0.0, ge=0, le=100)
    wind_from_deg: Number = Field(default=270.0, ge=0, le=360)
    duration_s: Annotated[Number, Field(gt=0, le=1e6)] | None = None
    rate_hz: Number = Field(default=50.0, gt=0, le=1e5)
    set: dict[str, Number] = Field(default_factory=dict)


class LogSection(Section):
    """One log of your own: the arguments of `uqharness log import`."""

    name: str = Field(pattern=rf"^{_NAME}$")
    file: str = Field(min_length=1)
    map: str | None = Field(default=None, min_length=1)
    manoeuvres: str | None = Field(default=None, min_length=1)


class IdentifySection(Section):
    """Flights that the parameters are estimated from, and options of `uqharness identify`."""

    flights: Names
    params: Annotated[tuple[str, ...] | None, BeforeValidator(tupled)] = None
    start: Literal["initial", "current"] = "current"
    method: Literal["auto", "output-error", "filter-error"] = "auto"
    biases: Annotated[tuple[str, ...] | None, BeforeValidator(tupled)] = None
    delays: Annotated[tuple[str, ...] | None, BeforeValidator(tupled)] = None


class CompareSection(Section):
    """Flights that the model is replayed beside, before and after refinement."""

    flights: Names


class BoundsSection(Section):
    """Flights that the model-form bounds are made from, flights that they are checked on, and
    options of `uqharness bounds`.
    """

    flights: Names
    validate_on: Annotated[tuple[str, ...], BeforeValidator(listed)] = ()
    confidence: Number = Field(default=0.95, gt=0, lt=1)
    states: dict[Coefficient, tuple[str, ...]] = Field(default_factory=dict)
    terms: dict[Coefficient, tuple[str, ...]] = Field(default_factory=dict)
    order: int = Field(default=2, ge=0, le=3)
    roll_terms: bool = False
    select: Literal["full", "stepwise"] = "full"
    samples: Literal["effective", "all"] = "effective"
    outside: Literal["grow", "clamp"] = "grow"
    cutoff_hz: Number = Field(default=6.0, gt=0)
    airspeed_cutoff_hz: Number = Field(default=2.0, ge=0)
    walk_cutoff_hz: Number = Field(default=0.5, gt=0)
    checks: bool = True

    @field_validator("states", "terms", mode="before")
    @classmethod
    def _lists(cls, value: Any) -> Any:
        return (
            {name: tupled(item) for name, item in value.items()}
            if isinstance(value, dict)
            else value
        )


class RefineSection(Section):
    """Flights that choose the effect, flights that only show what it did, and an effects file of
    your own.
    """

    train: Names
    test: Names
    effects: str | None = Field(default=None, min_length=1)


class _Document(Section):
    study: StudySection
    fly: Annotated[tuple[FlySection, ...], BeforeValidator(tupled)] = ()
    logs: Annotated[tuple[LogSection, ...], BeforeValidator(tupled)] = ()
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
    def _something(self) -> _Document:
        if not (
            self.identify or self.compare or self.bounds or self.refine or self.campaign is not None
        ):
            raise ValueError(
                "asks for nothing; give at least one of [identify], [compare], [bounds], [refine],"
                " [campaign]"
            )
        return self


@dataclass(frozen=True)
class ChainSpec:
    """A validated study. ``path`` is its file, ``source`` the file's text; ``campaign`` is
    validated without the aircraft's bounds.

    ``campaign_data`` holds the campaign's sections as they stand in the file.
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
        """Where the file's relative paths begin."""
        return self.path.resolve().parent

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of all flights, those to be flown first."""
        return (*(item.name for item in self.fly), *(item.name for item in self.logs))

    def beside(self, name: str) -> Path:
        """A path that the file names."""
        return self.folder / name


def read_chain(path: str | Path) -> ChainSpec:
    """Read and validate a study file.

    Raises BadInputError that lists every mistake as ``file:line: ...``.
    """
    path = Path(path)
    data, text = read_toml(path)
    try:
        document = _Document.model_validate(data)
    except ValidationError as error:
        problems = [explain(_Document, text, data, dict(item)) for item in error.errors()]
        lines = [f"{path}:{line}: {message}" for line, message in sorted(problems)]
        raise BadInputError(*dict.fromkeys(lines)) from None
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


def _campaign(
    document: _Document, sections: Mapping[str, Any], path: Path, text: str
) -> CampaignSpec | None:
    """The campaign's sections as campaign.toml would be validated; the study itself says which
    aircraft and which bounds.
    """
    if not sections:
        return None
    campaign, epistemic = sections.get("campaign"), sections.get("epistemic")

    def refuse(location: tuple[str, ...], why: str) -> BadInputError:
        return BadInputError(
            f"{path}:{line_of(text, location)}: [{'.'.join(location[:-1])}] {location[-1]}: {why}"
        )

    if isinstance(campaign, dict) and "aircraft" in campaign:
        raise refuse(
            ("campaign", "aircraft"),
            "the study flies its own aircraft, before and after; leave it out",
        )
    if isinstance(epistemic, dict) and "parameters" in epistemic:
        raise refuse(
            ("epistemic", "parameters"),
            "a draw of parameters belongs to one model, and a study flies two; use `uqharness"
            " campaign run` for it",
        )
    if document.bounds is not None and isinstance(epistemic, dict) and "bounds" in epistemic:
        raise refuse(
            ("epistemic", "bounds"),
            "the section [bounds] makes them from flights; leave out one of the two",
        )
    data = dict(sections)
    if isinstance(campaign, dict):
        data["campaign"] = {**campaign, "aircraft": document.study.aircraft}
    return campaign_from(data, path, text)


def _check(spec: ChainSpec) -> None:
    """BadInputError for flights that are not there, are named twice, or would judge what was made
    from them.
    """
    problems = [*_naming(spec), *_unknown(spec), *_roles(spec)]
    if problems:
        raise BadInputError(*(f"{spec.path}:{line}: {text}" for line, text in problems))


def _naming(spec: ChainSpec) -> Iterable[tuple[int, str]]:
    places = [(item.name, ("fly", str(k))) for k, item in enumerate(spec.fly)]
    places += [(item.name, ("logs", str(k))) for k, item in enumerate(spec.logs)]
    wanted = {name for _, _, group in _uses(spec) for name in group}
    seen: set[str] = set()
    for name, place in places:
        line = line_of(spec.source, (*place, "name"))
        if name in seen:
            yield (
                line,
                (
                    f"[[{place[0]}]] name = {as_toml(name)}: another flight has this name; give"
                    " each its own"
                ),
            )
        elif name not in wanted:
            yield (
                line,
                (
                    f"[[{place[0]}]] name = {as_toml(name)}: no section uses this flight; name it"
                    " in one, or leave it out"
                ),
            )
        seen.add(name)


def _uses(spec: ChainSpec) -> list[tuple[str, str, tuple[str, ...]]]:
    """(section, key, flights named there)."""
    found: list[tuple[str, str, tuple[str, ...]]] = []
    for section in ("identify", "compare", "bounds"):
        part = getattr(spec, section)
        if part is not None:
            found.append((section, "flights", part.flights))
    if spec.bounds is not None:
        found.append(("bounds", "validate_on", spec.bounds.validate_on))
    if spec.refine is not None:
        found += [("refine", "train", spec.refine.train), ("refine", "test", spec.refine.test)]
    return found


def _unknown(spec: ChainSpec) -> Iterable[tuple[int, str]]:
    known = spec.flights
    for section, key, names in _uses(spec):
        line = line_of(spec.source, (section, key))
        for name in names:
            if name not in known:
                there = ", ".join(known) or "none"
                yield (
                    line,
                    (
                        f"[{section}] {key}: no flight is named {as_toml(name)}; [[fly]] and"
                        f" [[logs]] have: {there}"
                    ),
                )
        for name in dict.fromkeys(n for n in names if names.count(n) > 1):
            yield line, f"[{section}] {key}: {as_toml(name)} is named twice"


_APART: Sequence[tuple[tuple[str, str], tuple[str, str], str]] = (
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


def _roles(spec: ChainSpec) -> Iterable[tuple[int, str]]:
    roles = {(section, key): names for section, key, names in _uses(spec)}
    for mine, other, why in _APART:
        for name in roles.get(mine, ()):
            if name in roles.get(other, ()):
                line = line_of(spec.source, mine)
                yield (
                    line,
                    (
                        f"[{mine[0]}] {mine[1]}: {as_toml(name)} is also in [{other[0]}]"
                        f" {other[1]}; {why}. Name another flight"
                    ),
                )
