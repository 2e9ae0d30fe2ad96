"""The study's tables, and what of it falls short of what was asked."""

from __future__ import annotations

import math

import pandas as pd

from sysid.aerodynamics.coefficients import COEFFICIENTS
from uqharness.text_tables import markdown_table

from .flights import CASES, SPEEDS
from .judge import CARDS, EXACT

COVERAGE = ("case", "way", "coefficient", "speed_mps")
PARTS = ("case", "way", "coefficient")
LEAST_INSIDE = 0.93
MOST_WIDTH = 1.5
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
    """Means over seeds of all figures, and how many seeds."""
    grouped = (
        rows.drop(columns=["seed"])
        .astype({"found": float} if "found" in rows else {})
        .groupby(list(by), sort=False)
    )
    return (
        grouped.mean().map(lambda v: float(f"{v:.4g}")).assign(seeds=grouped.size()).reset_index()
    )


def mean_and_error(values: pd.Series) -> tuple[float, float]:
    """Mean over seeds and its standard error."""
    known = values.dropna()
    error = float(known.std(ddof=1) / math.sqrt(len(known))) if len(known) > 1 else math.nan
    return float(known.mean()), error


def tables(rows: pd.DataFrame, fits: pd.DataFrame) -> str:
    """The study as markdown."""
    lines = [
        f"{rows['seed'].nunique()} seed(s); means over seeds, ± standard errors of the mean.",
        "",
    ]
    for case in (c.name for c in CASES if c.name in set(rows["case"])):
        mine, made = rows[rows["case"] == case], fits[fits["case"] == case]
        lines += [
            f"## {TITLES[case]}",
            "",
            f"{mine['seed'].nunique()} seeds. What the parts are:",
            "",
        ]
        lines += [
            markdown_table(_part_rows(made)),
            "",
            "What they hold of three other flights:",
            "",
        ]
        lines += [markdown_table(_coverage_rows(mine)), ""]
    lines += [
        "## Noise in the card wrong by two",
        "",
        "Least share of the true error inside over the speeds [%], (mean width over ",
    ]
    lines[-1] += "that of noise known exactly):"
    lines += ["", markdown_table(_card_rows(rows))]
    return "\n".join(lines)


def _part_rows(fits: pd.DataFrame) -> list[dict[str, str]]:
    out = []
    for c in COEFFICIENTS:
        mine = fits[(fits["coefficient"] == c) & (fits["way"] == "default")]
        mean = mine.drop(columns=["case", "way", "coefficient", "found"]).mean()
        out.append(
            {
                "coefficient": c,
                "true error, rms": f"{mean['true_rms']:.3g}",
                "beside the polynomial": f"{mean['left_rms']:.3g}",
                "persistent": f"{mean['persistent']:.2g}",
                "transient": f"{mean['transient']:.2g}",
                "time [s]": f"{mean['transient_time_s']:.2g}",
                "found in": f"{int(mine['found'].sum())} of {len(mine)}",
                "log odds": f"{mine['log_odds'].median():.3g}",
                "not above ±": f"{1.96 * mean['not_above']:.2g}",
                "width": f"{mean['width']:.3g}",
                "of it persistent": f"{mean['persistent_width']:.3g}",
                "as published": f"{mean['published_width']:.3g}",
                "of that": f"{100 * mean['persistent_width'] / mean['published_width']:.1f} %",
            }
        )
    return out


def _coverage_rows(rows: pd.DataFrame) -> list[dict[str, str]]:
    out = []
    for c in COEFFICIENTS:
        for speed in SPEEDS:
            mine = rows[(rows["coefficient"] == c) & (rows["speed_mps"] == speed)]
            usual, known = mine[mine["way"] == "default"], mine[mine["way"] == EXACT]
            inside, stretched, third = (
                _percent(usual[k]) for k in ("inside", "inside_stretched", "third")
            )
            out.append(
                {
                    "coefficient": c,
                    "m/s": f"{speed:g}",
                    "true error inside [%]": inside,
                    "stretched to zero": stretched,
                    "noisy samples [%]": third,
                    "width": f"{usual['width'].mean():.3g}",
                    "over noise known": f"{usual['width'].mean() / known['width'].mean():.2f}",
                    "outside the data [%]": f"{100 * usual['outside'].mean():.1f}",
                    "conformal": f"{usual['conformal'].mean():.2f}",
                }
            )
    return out


def _percent(values: pd.Series) -> str:
    mean, error = mean_and_error(100.0 * values)
    return f"{mean:.1f} ± {error:.1f}"


def _card_rows(rows: pd.DataFrame) -> list[dict[str, str]]:
    out = []
    for case in (c.name for c in CASES if c.name in set(rows["case"])):
        mine = rows[rows["case"] == case]
        known = mine[mine["way"] == EXACT].groupby("coefficient")["width"].mean()
        for way in CARDS:
            part = mine[mine["way"] == way]
            least = (
                part.groupby(["coefficient", "speed_mps"])["inside"]
                .mean()
                .groupby("coefficient")
                .min()
            )
            width = part.groupby("coefficient")["width"].mean() / known
            out.append(
                {
                    "case": case,
                    "card": way,
                    **{c: f"{100 * least[c]:.1f} ({width[c]:.2f})" for c in COEFFICIENTS},
                }
            )
    return out


def verdict(rows: pd.DataFrame, fits: pd.DataFrame) -> list[str]:
    """What fails, in words. Empty when all is well.

    Mean shares of the true error below LEAST_INSIDE (bounds not stretched to hold zero, the card right or wrong by two), widths
    above MOST_WIDTH times those of the noise known exactly, noisy samples outside THIRD, effects not found.
    """
    out = []
    means = rows.groupby(["case", "way", "coefficient", "speed_mps"], sort=False).mean(
        numeric_only=True
    )
    for (case, way, c, speed), row in means.iterrows():  # type: ignore[misc]
        where = f"{case}, {way}, {c} at {speed:g} m/s"
        if row["inside"] < LEAST_INSIDE:
            stretched = f"{100 * row['inside_stretched']:.1f} % with the bounds stretched to zero"
            out.append(
                f"{where}: {100 * row['inside']:.1f} % of the true error inside, {stretched}"
            )
        if way != "default":
            continue
        ratio = row["width"] / means.loc[(case, EXACT, c, speed), "width"]
        if ratio > MOST_WIDTH:
            out.append(f"{where}: {ratio:.2f} times as wide as with the noise known")
        if not THIRD[0] <= row["third"] <= THIRD[1]:
            out.append(f"{where}: {100 * row['third']:.1f} % of the noisy samples inside")
    calm = fits[(fits["case"] == "truth-calm") & (fits["way"] == "default")]
    for effect, c in EFFECTS.items():
        share = calm[calm["coefficient"] == c]["found"].astype(float).mean()
        if share < VISIBLE:
            out.append(
                f"{effect}: a model error of {c} is found in {100 * share:.0f} % of the seeds in still air"
            )
    nominal = fits[(fits["case"] == "nominal-calm") & (fits["way"] == "default")]
    for c in COEFFICIENTS:
        share = nominal[nominal["coefficient"] == c]["found"].astype(float).mean()
        if share > 1.0 - VISIBLE:
            out.append(
                f"nominal-calm: a model error of {c} that is not there is found in {100 * share:.0f} % of the seeds"
            )
    return out
