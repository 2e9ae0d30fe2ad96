"""Names of the columns that a campaign's flights are scored by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

ERROR_METRICS = tuple(
    f"{quantity}_{statistic}_{unit}{suffix}"
    for suffix in ("", "_measured")
    for quantity, unit in (("cross_track", "m"), ("altitude", "m"), ("speed", "mps"))
    for statistic in ("median", "mean", "max")
)
"""Statistics of |error| over a flight, true and (``_measured``) as the noise-laden sensors saw it."""

UNCOMMANDED_METRICS = (
    "heading_median_deg",
    "heading_mean_deg",
    "heading_max_deg",
    "load_factor_max",
)
"""What a flight without a commanded path is scored by besides; columns only of a campaign that has them."""


def excursion_columns(radii_m: Iterable[float]) -> tuple[str, ...]:
    """Names of the excursion counts: horizontal distance first, then the 3-D ones."""
    radii = tuple(radii_m)
    return tuple(
        excursion_column(radius, distance) for distance in ("horizontal", "3d") for radius in radii
    )


def excursion_column(radius_m: float, distance: str) -> str:
    """Name of the excursion counts beyond one radius; ``distance``: horizontal or 3d."""
    return f"excursions_{radius_m:g}m" + ("_3d" if distance == "3d" else "")


def counted_radii(metrics: Mapping[str, Any]) -> tuple[float, ...]:
    """Radii [m] at which a campaign counts excursions, from its section [metrics] as plain types: asked about, then the others."""
    return (
        *map(float, metrics["excursion_radius_m"]),
        *map(float, metrics.get("dispersion_radius_m") or ()),
    )
