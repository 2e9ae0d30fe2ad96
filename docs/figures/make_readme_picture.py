"""Draws readme.svg, the picture of the README, from the results of `make demo`.

    python docs/figures/make_readme_picture.py campaigns/chain/results

Left: one manoeuvre of the hold-out log beside the model before and after refinement.
Right: the p-boxes of the mission flown with both models.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

PICTURE = Path(__file__).with_name("readme.svg")
MANOEUVRE = "roll doublet, 20 m/s"
METRIC, CONDITION = "cross_track_median_m", "3 m/s moderate"
# Each colour of the light page and what takes its place on a dark one.
INK, SOFT, BEFORE, AFTER, PAGE = "#1c2430", "#5d6a78", "#b4530a", "#1b64a5", "#ffffff"
DARK = {INK: "#e8ecf1", SOFT: "#98a4b3", BEFORE: "#f0954a", AFTER: "#62b0f0", PAGE: "#12161b"}


def history(axes: Axes, study: Path) -> None:
    """Pitch rate as logged, and as both models have it."""
    table = pd.read_parquet(study / "refine" / "histories.parquet")
    rows = table[table["manoeuvre"] == MANOEUVRE]
    rows = rows[rows["segment"] == rows["segment"].iloc[0]]
    time = rows["time_s"].to_numpy() - rows["time_s"].iloc[0]
    axes.plot(time, np.degrees(rows["q_radps"]), ".", ms=3.2, color=SOFT, label="log")
    axes.plot(
        time, np.degrees(rows["q_radps_before"]), "--", lw=1.8, color=BEFORE, label="model before"
    )
    axes.plot(time, np.degrees(rows["q_radps_after"]), lw=1.8, color=AFTER, label="model after")
    axes.set(xlabel="time [s]", ylabel="pitch rate [deg/s]", title=f"Hold-out log, {MANOEUVRE}")
    axes.margins(x=0.02)


def boxes(axes: Axes, study: Path) -> None:
    """The envelope of all corners before and after, in one condition."""
    found, labels = {}, {}
    for name in ("before", "after"):
        table = pd.read_parquet(study / f"campaign-{name}" / "pbox.parquet")
        found[name] = table[(table["metric"] == METRIC) & (table["condition"] == CONDITION)]
        cases = pd.read_parquet(
            study / f"campaign-{name}" / "cases.parquet",
            columns=["wind_mps", "turbulence", "status"],
        )
        status = cases["status"][
            cases["wind_mps"].map("{:g} m/s ".format) + cases["turbulence"] == CONDITION
        ]
        failed = int((status != "ok").sum())
        labels[name] = f"{name}: {failed} of {len(status)}\nflights failed"
    end = 1.04 * max(box["value"].max() for box in found.values())
    for name, colour, line in (("before", BEFORE, "--"), ("after", AFTER, "-")):
        box = found[name]
        # A distribution function goes on to both sides: 0 before the first value, its last value
        # after it.
        value = np.concatenate([[0.0], box["value"], [end]])
        upper, lower = (
            np.concatenate([[0.0], box[side], [box[side].iloc[-1]]]) for side in ("upper", "lower")
        )
        axes.step(value, upper, line, where="post", lw=1.8, color=colour, label=labels[name])
        changes = (
            (np.diff(upper, prepend=-1.0) != 0.0)
            | (np.diff(lower, prepend=-1.0) != 0.0)
            | (value == end)
        )
        value, upper, lower = value[changes], upper[changes], lower[changes]
        # Both lower sides lie at zero for a while: the dashed one is drawn above the other.
        axes.step(
            value,
            lower,
            line,
            where="post",
            lw=1.8,
            color=colour,
            zorder=3 if name == "before" else 2,
        )
        axes.fill_between(
            value,
            lower,
            upper,
            step="post",
            color=colour,
            alpha=0.07 if name == "before" else 0.16,
            lw=0,
        )
    axes.set(
        xlabel="median cross-track error [m]",
        ylabel="cumulative probability [-]",
        xlim=(0.0, end),
        ylim=(-0.03, 1.03),
    )
    axes.set_title("p-box of the loiter, moderate turbulence")


def draw(study: Path) -> str:
    """The picture as SVG text."""
    matplotlib.rcParams.update(
        {
            "svg.hashsalt": "uqharness",
            "svg.fonttype": "path",
            "font.size": 10,
            "axes.titlesize": 10.5,
            "axes.edgecolor": SOFT,
        }
        | {"text.color": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK}
    )
    figure = Figure(figsize=(8.0, 3.5), layout="constrained", facecolor=PAGE)
    left, right = figure.subplots(1, 2)
    for axes, panel in ((left, history), (right, boxes)):
        axes.set_facecolor(PAGE)
        axes.spines[["top", "right"]].set_visible(False)
        panel(axes, study)
        axes.legend(
            frameon=False,
            fontsize=9,
            handlelength=1.6,
            loc="upper right" if axes is left else "upper left",
        )
    path = PICTURE.with_suffix(".part")
    figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None})
    text = path.read_text(encoding="utf-8")
    path.unlink()
    return with_dark(text)


def with_dark(text: str) -> str:
    """The SVG with a second set of colours for readers whose pages are dark."""
    rules = [
        f'[style*="{what}: {light}"] {{ {what}: {dark} !important }}'
        for light, dark in DARK.items()
        for what in ("fill", "stroke")
    ]
    style = "<style>@media (prefers-color-scheme: dark) {\n" + "\n".join(rules) + "\n}</style>"
    title = (
        "<title>Log against model before and after refinement, and the p-boxes of the"
        " mission</title>"
    )
    return re.sub(r"(<svg [^>]*>)", lambda found: f"{found[1]}\n{title}\n{style}", text, count=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the picture of the README.")
    parser.add_argument("study", type=Path, help="folder that `make demo` has written")
    PICTURE.write_text(draw(parser.parse_args().study), encoding="utf-8")
