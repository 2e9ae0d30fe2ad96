"""Figure of the measured gust spectra over the specification's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from campaigns.air.pinned import Seen
from campaigns.air.reproduce import specified_density, spectrum
from uqharness.flight.dryden import COMPONENTS

_COLOURS = {"jsbsim": "#1b6ca8", "host": "#d1701e", "plain-tustin": "#b0b0b0"}
_LABELS = {
    "jsbsim": "source 0 (JSBSim, corrected)",
    "host": "source 1 (host)",
    "plain-tustin": "plain JSBSim, Tustin",
}


def plot_air(flights: Sequence[Seen], path: Path) -> None:
    """Six panels of density per Hz times frequency over its maximum as specified; one line a heading."""
    matplotlib.rcParams["svg.hashsalt"] = "uqharness"
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    for axes, name in zip(figure.subplots(2, 3, sharex=True).flat, COMPONENTS, strict=True):
        for source in ("plain-tustin", "jsbsim", "host"):
            label = _LABELS[source]
            for seen in (flight for flight in flights if flight.source == source):
                frequency, density = _smoothed(*spectrum(seen.series[name], seen.condition.dt_s))
                axes.loglog(frequency, density, color=_COLOURS[source], linewidth=0.8, label=label)
                label = "_nolegend_"
        frequency = np.geomspace(0.01, 30.0, 300)
        axes.loglog(
            frequency,
            specified_density(name, frequency, flights[0].condition),
            "k--",
            label="MIL-F-8785C",
        )
        axes.set_title(f"{name}, " + ("(m/s)²/Hz" if name in "uvw" else "(rad/s)²/Hz"))
        axes.grid(True, which="major", alpha=0.3)
        axes.set_xlim(0.01, 30.0)
        if name in "pqr":
            axes.set_xlabel("frequency, Hz")
        if name == "u":
            axes.legend(fontsize=8)
    figure.savefig(
        path, metadata={"Date": None, "Creator": None} if path.suffix == ".svg" else None
    )


def _smoothed(frequency: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Means over logarithmic bins, 12 to a decade.
    edges = np.geomspace(0.01, 30.0, 43)
    bins = np.digitize(frequency, edges)
    kept = [index for index in range(1, len(edges)) if np.any(bins == index)]
    return (
        np.array([np.mean(frequency[bins == index]) for index in kept]),
        np.array([np.mean(density[bins == index]) for index in kept]),
    )
