"""Names that sections of campaign.toml share: turbulence, coefficients."""

from __future__ import annotations

from typing import Literal

from uqharness.flight import COEFFICIENTS, TURBULENCE_W20_KT

Turbulence = Literal["none", "light", "moderate", "severe"]
Coefficient = Literal["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
assert set(TURBULENCE_W20_KT) == set(Turbulence.__args__)  # type: ignore[attr-defined]
assert Coefficient.__args__ == COEFFICIENTS  # type: ignore[attr-defined]


def ordered(value: tuple[str, ...]) -> tuple[str, ...]:
    """Coefficients in the order in which they are always listed. ValueError for none or one twice."""
    if not value or len(set(value)) != len(value):
        raise ValueError("must name at least one coefficient, and none twice")
    return tuple(name for name in COEFFICIENTS if name in value)
