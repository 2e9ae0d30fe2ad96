"""What settings files share: strict sections, numbers, lists."""

from __future__ import annotations

import sys
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

_LARGEST = sys.float_info.max
Number = Annotated[float, Field(allow_inf_nan=False)]


class Section(BaseModel):
    """A section of the file: unknown keys are refused, types are not bent, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def listed(value: Any) -> Any:
    """A single value stands for a list of one; TOML's lists become tuples, which strict validation wants."""
    return tuple(value) if isinstance(value, list) else (value,)


def tupled(value: Any) -> Any:
    """A TOML array as a tuple; anything else as it is."""
    return tuple(value) if isinstance(value, list) else value


def is_number(value: Any) -> bool:
    """Whether a TOML value is a finite number, true and false excluded."""
    # Compared, not converted: an integer may be larger than any float.
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and -_LARGEST <= value <= _LARGEST
    )
