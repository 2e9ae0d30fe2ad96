"""Write the tables of a comparison, and say in a sentence what it shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from uqharness.files import write_text
from uqharness.identification import LIMIT, Comparison
from uqharness.replay import CONTROLS, columns_of, write_histories
from uqharness.report.pages.compare import noise_floor
from uqharness.text_tables import csv_text

NOISE_FLOOR_RULE = (
    f"the noise floor is reached when no judged channel's rms is above {LIMIT} times its noise"
)


def channel_rows(comparison: Comparison) -> list[dict[str, str]]:
    """Return the table of channels as text."""
    return [
        {
            "channel": c,
            "rms": f"{g.rms:.4g}",
            "noise": f"{g.noise:.4g}",
            "ratio": f"{g.ratio:.2f}",
            "verdict": (
                ("at the noise" if g.ratio <= LIMIT else "above") if g.judged else "not judged"
            ),
            "delay [ms]": _delay(g),
            "Theil U": f"{g.theil.u:.3f}",
            "bias": f"{g.theil.bias:.2f}",
            "variance": f"{g.theil.variance:.2f}",
            "covariance": f"{g.theil.covariance:.2f}",
        }
        for c, g in comparison.channels.items()
    ]


def _delay(g: Any) -> str:
    """Format a delay with its standard error [ms], or the reason why it is undefined."""
    if g.undefined:
        return f"undefined: {g.undefined}"
    return f"{1e3 * (g.allowed_s + g.shift.seconds):.1f} +/- {1e3 * g.shift.std:.1f}"


def coefficient_rows(comparison: Comparison) -> list[dict[str, str]]:
    """Return the table of coefficients as text."""
    return [
        {
            "coefficient": c,
            "rms": f"{g.rms:.3g}",
            "noise": f"{g.noise:.3g}",
            "ratio": f"{g.rms / g.noise:.2f}" if g.noise > 0.0 else "no noise known",
            "mean": f"{g.mean:.3g}",
        }
        for c, g in comparison.coefficients.items()
    ]


def manoeuvre_rows(comparison: Comparison) -> list[dict[str, str]]:
    """Return residual rms over noise, a row per manoeuvre, channels before coefficients."""
    return [
        {
            "manoeuvre": m,
            **{c: f"{v:.2f}" for c, v in row.items()},
            **{c: f"{v:.2f}" for c, v in comparison.manoeuvre_coefficients[m].items()},
        }
        for m, row in comparison.manoeuvres.items()
    ]


def moment_rows(comparison: Comparison) -> list[dict[str, str]]:
    """Return the largest deviations, one row each."""
    return [
        {
            "time_s": f"{m.time_s:.2f}",
            "channel": m.channel,
            "manoeuvre": m.manoeuvre,
            "gap": f"{m.gap:.4g}",
            "in sigma": f"{m.noises:.1f}",
        }
        for m in comparison.moments
    ]


def write_tables(comparison: Comparison, out: Path) -> None:
    """Write histories.parquet and the CSV tables of a comparison into a folder."""
    tables = {
        "channels": channel_rows(comparison),
        "coefficients": coefficient_rows(comparison),
        "manoeuvres": manoeuvre_rows(comparison),
        "moments": moment_rows(comparison),
    }
    for name, rows in tables.items():
        if rows:
            write_text(out / f"{name}.csv", csv_text(rows))
    write_histories(
        out,
        comparison.segments,
        {
            **columns_of(comparison.outputs, comparison.measured),
            **columns_of(comparison.outputs, comparison.modelled, "_model"),
            **columns_of(CONTROLS, [s.controls for s in comparison.segments]),
            **columns_of(COEFFICIENTS, comparison.demanded, "_flight"),
            **columns_of(COEFFICIENTS, comparison.predicted, "_model"),
        },
    )


def gap_verdict(comparison: Comparison) -> str:
    """Return one sentence on whether the model reaches the noise floor, and if not, why."""
    # Wrong signs or scales come first: delays and residuals mean nothing before they are corrected.
    if not comparison.reached and comparison.slips:
        return (
            "Signs or scales differ between record and model, which comes before any delay:"
            f" {'; '.join(comparison.slips)}. Correct the channel's map or the servo table (see"
            " uqharness log info), or the model."
        )
    # Next, a common delay of the controls.
    if not comparison.reached and not comparison.aligned:
        when = "early" if comparison.controls_late_s < 0.0 else "late"
        return (
            "The record is not aligned: its controls act"
            f" {1e3 * abs(comparison.controls_late_s):.1f} ms {when}, and"
            f" {1e3 * comparison.late_limit_s:.1f} ms are allowed. A command belongs to the row"
            " whose acceleration has seen it first: shift the command columns, otherwise a model"
            " identified from this flight gets this lag in addition."
        )
    return noise_floor(
        comparison.reached,
        {c: comparison.channels[c].ratio for c in comparison.above},
        NOISE_FLOOR_RULE,
    )
