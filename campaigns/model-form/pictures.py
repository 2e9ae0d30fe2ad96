"""A picture per coefficient: the bounds as published, the new parts and the true error along the flights that judge them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sysid.aerodynamics.coefficients import COEFFICIENTS
from uqharness.files import write_text
from uqharness.report.svg import Chart, Scale, scale, standalone

from .flights import SPEEDS
from .tables import TITLES

LEGEND = (
    ("fillrange", "as published"),
    ("fill2", "whole model error"),
    ("first", "its persistent part"),
    ("third", "true error"),
)


def write_pictures(answers: Sequence[Mapping[str, Any]], out: Path) -> list[Path]:
    """figures/<C>.svg of the cases' histories; nothing where no seed has any."""
    place, paths = out / "figures", []
    found = {a["case"]: a for a in answers}
    for c in COEFFICIENTS if found else ():
        charts = [
            (_chart(c, case, found[case]["histories"][c]).svg(), words)
            for case, words in TITLES.items()
            if case in found
        ]
        seed = next(iter(found.values()))["seed"]
        place.mkdir(parents=True, exist_ok=True)
        paths.append(place / f"{c}.svg")
        write_text(
            paths[-1], standalone(charts, f"{c}: bounds and true error, seed {seed}", LEGEND, 2)
        )
    return paths


def _chart(coefficient: str, case: str, curves: Mapping[str, Sequence[float]]) -> Chart:
    data = {name: np.asarray(values, dtype=float) for name, values in curves.items()}
    n = len(data["true"])
    at, length = np.arange(n), n / len(SPEEDS)
    bands = (("today_lower", "today_upper", "fillrange"), ("lower", "upper", "fill2"))
    y = scale(
        f"model error, {coefficient} [-]",
        [data[k] for low, high, _ in bands for k in (low, high)] + [data["true"]],
    )
    label = (
        f"{coefficient}, {TITLES[case]}: bounds as published from {data['today_lower'].min():.2g} to "
        f"{data['today_upper'].max():.2g}, of the model error {data['lower'].min():.2g} to {data['upper'].max():.2g}."
    )
    names = tuple(((k + 0.5) * length, f"{speed:g}") for k, speed in enumerate(SPEEDS))
    x = Scale("along the flights at these speeds [m/s]", 0.0, n - 1.0, names)
    chart = Chart(f"{coefficient}-{case}", label, x, y)
    for low, high, kind in bands:
        chart.band(at, data[low], data[high], kind)
    for name in ("lasting_lower", "lasting_upper"):
        chart.line(at, data[name], "first thin")
    for k in range(1, len(SPEEDS)):
        chart.upright(k * length - 0.5, "joint")
    chart.level(0.0, "zero")
    chart.line(at, data["true"], "third")
    return chart
