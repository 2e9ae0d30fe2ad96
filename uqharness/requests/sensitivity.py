"""Request of sensitivity."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import model_validator

from uqharness.requests import fields
from uqharness.requests.base import Request, WholeNumber, option


class SensitivityRequest(Request):
    """Rank uncertain coefficients by the width they give to the p-box."""

    command: ClassVar[str] = "sensitivity"
    no: ClassVar[str] = "nothing could be compared (too many flights failed, or no metric differs)"
    examples: ClassVar[str] = """
  uqharness sensitivity campaigns/demo/results
  uqharness sensitivity campaigns/demo/results --interior campaigns/demo/middle --json
  uqharness sensitivity --modal as_published

For a campaign, writes DIR/sensitivity.csv and DIR/figures/sensitivity-*.svg; nothing is flown.
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
        "with modal: independent repeats, whose spread is shown",
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
