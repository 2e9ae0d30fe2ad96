"""The study's tables and pictures, and which of its results fail."""

from __future__ import annotations

import math

import pandas as pd

from sysid.aerodynamics.coefficients import COEFFICIENTS
from uqharness.text_tables import markdown_table

from .flights import CASES, SPEEDS
from .judge import CARDS, EXACT

COVERAGE = ("case", "way", "coefficient", "speed_mps")
PARTS = ("case", "way", "coefficient")
MIN_INSIDE = 0.93
MAX_WIDTH = 1.5
THIRD = (0.93, 0.99)
VISIBLE = 36 / 40
EFFECTS = {"CX_q": "CX", "Cm_p2": "Cm", "separation": "CZ", "Cl_de": "Cl"}
"""Effects that the model lacks -> coefficient that shows them."""
TITLES = {
    "nominal-calm": "The model itself flies, still air",
    "nominal-light": "The model itself flies, light turbulence",
    "truth-calm": "The reference truth flies, still air",
    "truth-light": "The reference truth flies, light turbulence",
}


def summary(rows: pd.DataFrame, by: tuple[str, ...]) -> pd.DataFrame:
    """Return means over seeds of all figures, and how many seeds."""
    numbers = rows.drop(columns=["seed"]).astype({"found": float} if "found" in rows else {})
    groups = numbers.groupby(list(by), sort=False)
    means = groups.mean().map(lambda v: float(f"{v:.4g}"))
    return means.assign(seeds=groups.size()).reset_index()


def tables(rows: pd.DataFrame, fits: pd.DataFrame) -> str:
    """Return the study as markdown."""
    seeds = rows["seed"].nunique()
    text = f"{seeds} seed(s); means over seeds, ± standard errors of the mean.\n\n"
    for case in (c.name for c in CASES if c.name in set(rows["case"])):
        part = rows[rows["case"] == case]
        text += f"## {TITLES[case]}\n\n{part['seed'].nunique()} seeds. What the parts are:\n\n"
        text += markdown_table(_part_rows(fits[fits["case"] == case]))
        text += "\n\nWhat they hold of three other flights:\n\n"
        text += markdown_table(_coverage_rows(part)) + "\n\n"
    text += "## Noise in the card wrong by two\n\n"
    text += "Least share of the true error inside over the speeds [%], (mean width over "
    return text + "that of noise known exactly):\n\n" + markdown_table(_card_rows(rows))


def _part_rows(fits: pd.DataFrame) -> list[dict[str, str]]:
    table = []
    for c in COEFFICIENTS:
        part = fits[(fits["coefficient"] == c) & (fits["way"] == "default")]
        mean = part.drop(columns=["case", "way", "coefficient", "found"]).mean()
        table.append(
            {
                "coefficient": c,
                "true error, rms": f"{mean['true_rms']:.3g}",
                "beside the polynomial": f"{mean['left_rms']:.3g}",
                "persistent": f"{mean['persistent']:.2g}",
                "transient": f"{mean['transient']:.2g}",
                "time [s]": f"{mean['transient_time_s']:.2g}",
                "found in": f"{int(part['found'].sum())} of {len(part)}",
                "log odds": f"{part['log_odds'].median():.3g}",
                "not above ±": f"{1.96 * mean['not_above']:.2g}",
                "width": f"{mean['width']:.3g}",
                "of it persistent": f"{mean['persistent_width']:.3g}",
                "as published": f"{mean['published_width']:.3g}",
                "of that": f"{100 * mean['persistent_width'] / mean['published_width']:.1f} %",
            }
        )
    return table


def _coverage_rows(rows: pd.DataFrame) -> list[dict[str, str]]:
    table = []
    for (c, speed), part in rows.groupby(["coefficient", "speed_mps"], sort=False):
        usual, exact = part[part["way"] == "default"], part[part["way"] == EXACT]
        table.append(
            {
                "coefficient": c,
                "m/s": f"{speed:g}",
                "true error inside [%]": _percent(usual["inside"]),
                "stretched to zero": _percent(usual["inside_stretched"]),
                "noisy samples [%]": _percent(usual["third"]),
                "width": f"{usual['width'].mean():.3g}",
                "over noise known": f"{usual['width'].mean() / exact['width'].mean():.2f}",
                "outside the data [%]": f"{100 * usual['outside'].mean():.1f}",
                "conformal": f"{usual['conformal'].mean():.2f}",
            }
        )
    order = [(c, f"{speed:g}") for c in COEFFICIENTS for speed in SPEEDS]
    return sorted(table, key=lambda row: order.index((row["coefficient"], row["m/s"])))


def _percent(shares: pd.Series) -> str:
    percent = 100.0 * shares.dropna()
    n = len(percent)
    error = float(percent.std(ddof=1) / math.sqrt(n)) if n > 1 else math.nan
    return f"{float(percent.mean()):.1f} ± {error:.1f}"


def _card_rows(rows: pd.DataFrame) -> list[dict[str, str]]:
    table = []
    for case in (c.name for c in CASES if c.name in set(rows["case"])):
        of_case = rows[rows["case"] == case].groupby("way")
        exact = of_case.get_group(EXACT).groupby("coefficient")["width"].mean()
        for way in CARDS:
            part = of_case.get_group(way)
            inside = part.groupby(["coefficient", "speed_mps"])["inside"].mean()
            minimum = inside.groupby("coefficient").min()
            width = part.groupby("coefficient")["width"].mean() / exact
            figures = {c: f"{100 * minimum[c]:.1f} ({width[c]:.2f})" for c in COEFFICIENTS}
            table.append({"case": case, "card": way, **figures})
    return table


def verdict(rows: pd.DataFrame, fits: pd.DataFrame) -> list[str]:
    """List failures, none when all is well.

    Mean shares of the true error below MIN_INSIDE (bounds not stretched to hold zero, the card
    right or wrong by two), widths above MAX_WIDTH times those of the noise known exactly, noisy
    samples outside THIRD, effects not found.
    """
    failures = []
    keys = ["case", "way", "coefficient", "speed_mps"]
    means = rows.groupby(keys, sort=False).mean(numeric_only=True)
    for (case, way, c, speed), row in means.iterrows():  # type: ignore[misc]
        where = f"{case}, {way}, {c} at {speed:g} m/s"
        if row["inside"] < MIN_INSIDE:
            stretched = f"{100 * row['inside_stretched']:.1f} % with the bounds stretched to zero"
            inside = f"{100 * row['inside']:.1f} % of the true error inside"
            failures.append(f"{where}: {inside}, {stretched}")
        if way != "default":
            continue
        ratio = row["width"] / means.loc[(case, EXACT, c, speed), "width"]
        if ratio > MAX_WIDTH:
            failures.append(f"{where}: {ratio:.2f} times as wide as with the noise known")
        if not THIRD[0] <= row["third"] <= THIRD[1]:
            failures.append(f"{where}: {100 * row['third']:.1f} % of the noisy samples inside")
    usual = fits[fits["way"] == "default"].astype({"found": float})
    share = usual.groupby(["case", "coefficient"])["found"].mean()
    for effect, c in EFFECTS.items():
        calm = share.get(("truth-calm", c), math.nan)
        if calm < VISIBLE:
            words = f"is found in {100 * calm:.0f} % of the seeds in still air"
            failures.append(f"{effect}: a model error of {c} {words}")
    for c in COEFFICIENTS:
        nominal = share.get(("nominal-calm", c), math.nan)
        if nominal > 1.0 - VISIBLE:
            words = f"that is not there is found in {100 * nominal:.0f} % of the seeds"
            failures.append(f"nominal-calm: a model error of {c} {words}")
    return failures
