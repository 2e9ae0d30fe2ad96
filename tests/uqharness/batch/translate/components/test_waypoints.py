"""Waypoints against JSBSim: headings and distances of geodesics."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_systems import compared, refusal


def _body(kind: str, unit: str, degrees: bool = False) -> str:
    angle = ' unit="DEG"' if degrees else ""
    places = "".join(
        f"<{tag}{angle}>i/{name}</{tag}>"
        for tag, name in (
            ("target_latitude", "a"),
            ("target_longitude", "b"),
            ("source_latitude", "c"),
            ("source_longitude", "d"),
        )
    )
    return f'<waypoint_{kind} name="o/{kind}-{unit}" unit="{unit}">{places}</waypoint_{kind}>'


def _places(scale: float) -> dict[str, np.ndarray]:
    """Near and far targets in all quadrants, in units of ``scale`` per radian."""
    rng = np.random.default_rng(0)
    lat, lon = rng.uniform(-1.5, 1.5, 1500), rng.uniform(-3.1, 3.1, 1500)
    near = rng.random(1500) < 0.6
    to_lat = np.where(near, lat + rng.normal(0.0, 1e-3, 1500), rng.uniform(-1.4, 1.4, 1500))
    to_lon = lon + np.where(near, rng.normal(0.0, 1e-3, 1500), rng.uniform(-2.4, 2.4, 1500))
    places = {"i/a": to_lat, "i/b": to_lon, "i/c": lat, "i/d": lon}
    return {name: values * scale for name, values in places.items()}


def _gap(body: str, places: dict[str, np.ndarray], changed: str | None = None) -> float:
    pair = compared(
        f"<channel>{body}</channel>", places, changed and f"<channel>{changed}</channel>"
    )
    return max(
        float(np.max(np.abs(pair.ours[name] - there) / np.maximum(np.abs(there), 1e-3)))
        for name, there in pair.theirs.items()
    )


@pytest.mark.parametrize(("degrees", "scale"), [(False, 1.0), (True, 180.0 / np.pi)])
def test_headings_and_distances_are_jsbsims(degrees: bool, scale: float) -> None:
    body = "".join(
        _body(kind, unit, degrees)
        for kind, unit in (
            ("heading", "RAD"),
            ("heading", "DEG"),
            ("distance", "FT"),
            ("distance", "M"),
        )
    )
    assert _gap(body, _places(scale)) < 1e-8


def test_a_wrong_unit_is_noticed() -> None:
    right, wrong = _body("distance", "M"), _body("distance", "M", degrees=True)
    assert _gap(right, _places(1.0), wrong) > 1e-3


def test_unknown_units_are_refused() -> None:
    said = refusal(f"<channel>{_body('heading', 'GRAD')}</channel>", [f"i/{k}" for k in "abcd"])
    assert "unit='GRAD' of <waypoint_heading>: allowed are RAD and DEG" in said
