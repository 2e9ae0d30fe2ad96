"""What may stand in manifest.json, checked before anything of it is believed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from uqharness.campaign.spec.read import checked_settings

FORMAT = 2
FORMAT_WITHOUT_DIGESTS = 1
"""What uqharness 0.1 wrote."""
RUNNING, INTERRUPTED, COMPLETE, SPOILT = "running", "interrupted", "complete", "spoilt"
"""States; spoilt: aircraft or script was edited while it flew."""

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
_FileName = Annotated[str, Field(pattern="^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")


class _Journal(_Part):
    rows: int = Field(ge=0)
    digest: _Digest


class _Engine(_Part):
    asked: Literal["auto", "batch", "jsbsim"]
    why: list[str]


class _Bounds(_Part):
    confidence: float = Field(gt=0, lt=1)
    transient: list[str]


class _Content(_Part):
    format: Literal[1, 2]
    state: Literal["running", "interrupted", "complete", "spoilt"]
    command: str
    seed: int = Field(ge=0, lt=2**63)
    cases: int = Field(ge=0, lt=2**53)
    campaign: dict[str, Any]
    campaign_file: str = "campaign.toml"
    versions: dict[str, str]
    hashes: dict[str, _Digest]
    shard: Annotated[str, Field(pattern=r"^[0-9]{1,6}/[0-9]{1,6}$")] | None = None
    tables: dict[_FileName, _Digest] = Field(default_factory=dict)
    journal: _Journal | None = None
    engine: _Engine | None = None
    bounds: _Bounds | None = None
    sums: Literal["SHA256SUMS"] | None = None

    @model_validator(mode="after")
    def _whole(self) -> _Content:
        missing = [name for name in ("aircraft", "script") if name not in self.hashes]
        if missing:
            raise ValueError(f"hashes lack {missing[0]}")
        if self.format == FORMAT and self.state == COMPLETE and self.journal is None:
            raise ValueError("it is complete and has no digest of the journal")
        return self


def checked_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """The content with every setting of the campaign filled in. ValueError naming the first thing that is not what it must be."""
    try:
        found = _Content.model_validate(data)
    except ValidationError as error:
        raise ValueError(_words(error)) from None
    try:
        settings = checked_settings(_as_it_was(found.campaign))
    except ValidationError as error:
        raise ValueError(_words(error, "campaign")) from None
    if settings["campaign"]["seed"] != found.seed:
        raise ValueError(
            f"seed is {found.seed}, that of the campaign in it {settings['campaign']['seed']}"
        )
    return {**data, "campaign": settings}


def _as_it_was(campaign: dict[str, Any]) -> dict[str, Any]:
    """Fill in what older versions flew: JSBSim as the engine, and corners without interior points or the nominal model."""
    filled = dict(campaign)
    if isinstance(section := campaign.get("campaign"), dict):
        filled["campaign"] = {"engine": "jsbsim", **section}
    if isinstance(section := campaign.get("aleatory"), dict):
        filled["aleatory"] = {"sensor_noise": True, **section}
    section = campaign.get("epistemic")
    if isinstance(section, dict) and section.get("method") == "corners":
        filled["epistemic"] = {"interior": 0, "nominal": False, **section}
    return filled


def _words(error: ValidationError, *section: str) -> str:
    first = error.errors()[0]
    place = ".".join(map(str, (*section, *first["loc"])))
    if first["type"] == "missing":
        return f"{place} is missing"
    said = first["msg"].removeprefix("Value error, ").replace("Input should", "must")
    return f"{place}: {said}" if place else said
