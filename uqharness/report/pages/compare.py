"""Build the page of a comparison of a flight with a model, and write its tables.

The page comes from compare.json and histories.parquet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from uqharness.files import write_text
from uqharness.identification import LIMIT, OUTPUTS, Comparison
from uqharness.replay import (
    CHANNELS,
    CONTROLS,
    HISTORIES,
    History,
    columns_of,
    have_columns,
    read_histories,
    shown_channel,
    with_shown_names,
    write_histories,
)
from uqharness.report.history import MAX_SEGMENTS, Model, end_to_end, file_name, history_section
from uqharness.report.parts import (
    Cell,
    Figure,
    Figures,
    Level,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    provenance,
    remarks,
)
from uqharness.report.svg import Scale, rows_chart
from uqharness.results.base import read_result
from uqharness.results.identification import Channel, Compare, Gap
from uqharness.text_tables import csv_text

COMPARE = "compare.json"


def compare_page(folder: Path, prefix: str = "", segments: int | None = MAX_SEGMENTS) -> Page:
    """Return the page of a folder that ``uqharness compare`` wrote.

    Parameters
    ----------
    folder : Path
        Folder of results.
    prefix : str
        Prefix of figure names.
    segments : int, optional
        Number of segments with histories; None for all.

    Raises
    ------
    BadInputError
        If the folder cannot be read.
    """
    return compare_page_of(
        read_result(folder / COMPARE, Compare), read_histories(folder / HISTORIES), prefix, segments
    )


def compare_page_of(
    gap: Compare,
    histories: Sequence[History] = (),
    prefix: str = "",
    segments: int | None = MAX_SEGMENTS,
) -> Page:
    """Return the page of a comparison from its document and the replayed segments.

    The other parameters are those of `compare_page`.
    """
    # The noise of channels that are not compared (height, heading) may be meaningless.
    noise = {c: row.noise if row.judged else None for c, row in gap.channels.items()}
    sections = [_channel_section(gap.channels, prefix)]
    sections += history_section(
        histories,
        noise,
        [Model("_model", "first", "model")],
        "Log against model",
        f"{prefix}gap-",
        segments,
        file=lambda _, h: file_name(f"{h.number:02d}-{h.manoeuvre}"),
    )
    sections += [
        _coefficient_section(gap.coefficients, histories, prefix),
        _manoeuvre_section(gap),
    ]
    sections += remarks({"notes": [with_shown_names(n, CHANNELS) for n in gap.notes]})
    files = (
        "compare.json, channels.csv, coefficients.csv, manoeuvres.csv, moments.csv,"
        " histories.parquet, next to this page"
    )
    facts = (
        ("Command", gap.command or "not recorded"),
        ("Rule", gap.rule or "not recorded"),
        ("Files", files),
    )
    sections.append(provenance(*facts))
    question = f"Does {gap.aircraft} reproduce {gap.flight} within the sensors' noise?"
    return Page(
        f"{gap.aircraft} compared with {gap.flight}",
        question,
        _verdict(gap),
        tuple(sections),
    )


def noise_floor(reached: bool, above: Mapping[str, float], rule: str = "") -> str:
    """Return one sentence on whether a model reaches the noise floor.

    Parameters
    ----------
    reached : bool
        Whether it does.
    above : mapping of str to float
        Ratio of residual rms to noise of the channels that do not.
    rule : str
        Rule to quote.
    """
    by = f" ({rule})" if rule else ""
    # The rule is quoted where it was recorded.
    if reached:
        return f"The model reaches the noise floor{by}."
    worst = ", ".join(f"{c} {ratio:.2f}" for c, ratio in above.items())
    return f"The model does not reach the noise floor: rms over noise is {worst}{by}."


def _verdict(gap: Compare) -> tuple[Sentence, ...]:
    """Return the verdict and the largest residual of a coefficient."""
    above = {c: r for c in gap.above if (r := gap.channels[c].ratio) is not None}
    text = with_shown_names(gap.verdict or noise_floor(gap.reached_noise_floor, above), CHANNELS)
    sentences = [Sentence(text, "good" if gap.reached_noise_floor else "bad")]
    ratios = {
        c: ratio for c, row in gap.coefficients.items() if (ratio := row.ratio_to_noise) is not None
    }
    if ratios:
        worst = max(ratios, key=lambda c: ratios[c])
        sentences.append(
            Sentence(
                f"Largest residual of a coefficient: {worst}, {ratios[worst]:.2f} times its noise"
                " rms."
            )
        )
    return tuple(sentences)


def in_shown_unit(name: str, row: Mapping[str, Any], *keys: str) -> tuple[str, list[float | None]]:
    """Return a label with unit, and numbers of a row in that unit.

    Parameters
    ----------
    name : str
        Channel or coefficient.
    row : mapping
        Numbers in SI units.
    keys : str
        Keys of the numbers.

    Returns
    -------
    tuple of (str, list of float or None)
        Label such as ``q [deg/s]``; None for unknown numbers.
    """
    quantity, unit, factor = shown_channel(name)
    return f"{quantity} [{unit}]", [
        None if row.get(key) is None else factor * row[key] for key in keys
    ]


def _channel_section(channels: Mapping[str, Channel], prefix: str) -> Section:
    """Return the residuals by channel."""
    rows = []
    for name, row in channels.items():
        label, (rms, noise) = in_shown_unit(name, row, "rms", "noise")
        # Ratio of residual rms to noise, with the limit of "at the noise".
        ratio, is_judged = row.ratio, row.judged
        level: Level = "" if not is_judged or ratio is None else "good" if ratio <= LIMIT else "bad"
        # Neither noise nor ratio is meaningful for channels that are not compared.
        sizes = (format_value(noise), format_value(ratio, ".2f")) if is_judged else ("-", "-")
        answer = "undefined" if ratio is None else "at the noise" if level == "good" else "above"
        answer = answer if is_judged else _why_not_judged(name)
        # A delay that cannot be estimated carries its reason.
        delay = f"{_milli(row.delay_s)} ± {_milli(row.delay_std_s)}"
        if row.delay_s is None:
            delay = f"undefined: {row.delay_undefined or 'no reason recorded'}"
        theil = format_value(row.theil_u, ".3f")
        rows.append((label, format_value(rms), *sizes, Cell(answer, level), delay, theil))
    head = (
        "Channel",
        "rms of log minus model",
        "Noise",
        "Ratio",
        "Answer",
        "Delay [ms]",
        "Theil's U",
    )
    ratios = {
        shown_channel(c)[0]: {"model": r.ratio}
        for c, r in channels.items()
        if r.ratio is not None and r.judged
    }
    figure = ratio_figure(
        f"{prefix}gap-ratios", ratios, [("model", "first", "disc")], "judged channels"
    )
    blocks = (Figures((figure,), file="gaps"),) if figure else ()
    table = Table("Log minus model, by channel.", head, tuple(rows), key=True)
    return Section("Residuals by channel", (*blocks, table))


def _why_not_judged(channel: str) -> str:
    """Return why a channel is not compared with its noise."""
    if channel in OUTPUTS:
        return "not tested: computed by the log's autopilot"
    return "not tested: integral of other channels, drifts"


def _milli(value: float | None) -> str:
    # Adding 0 removes the sign of a rounded zero.
    """Format seconds as milliseconds."""
    return format_value(None if value is None else round(1e3 * value, 1) + 0.0, ".1f")


def ratio_figure(
    name: str,
    ratios: Mapping[str, Mapping[str, float]],
    series: Sequence[tuple[str, str, str]],
    subject: str,
) -> Figure | None:
    """Draw the ratio of residual rms to noise by row.

    Parameters
    ----------
    name : str
        Name of the figure.
    ratios : mapping
        Row -> key -> ratio; without rows the result is None.
    series : sequence of (str, str, str)
        Key, class and shape of each mark.
    subject : str
        What the rows are, for the caption.
    """
    if not ratios:
        return None
    # Axis from 0 to the largest ratio, at least beyond the limit.
    largest = max(v for row in ratios.values() for v in row.values())
    label = "; ".join(
        f"{row}: {' to '.join(f'{v:.2f}' for v in values.values())}"
        for row, values in ratios.items()
    )
    x = Scale("rms of log minus model over noise [-]", 0.0, 1.08 * max(largest, 1.3))
    label = f"Residual over noise [-] of the {subject}. {label}."
    chart = rows_chart(name, label, x, tuple(ratios))
    chart.upright(1.0, "zero", "the noise itself")
    chart.upright(LIMIT, "limit", f"limit {LIMIT:g}")
    for k, row in enumerate(ratios):
        values = [ratios[row][key] for key, _, _ in series if key in ratios[row]]
        # A line joins the values of a row.
        if len(values) > 1:
            chart.across(min(values), max(values), k, "link")
        for key, kind, shape in series:
            if key in ratios[row]:
                chart.marker(ratios[row][key], float(k), kind, shape)
    shapes = ", ".join(f"{shape}: {key}" for key, _, shape in series)
    return Figure(
        name,
        chart.svg(),
        f"Residual over noise [-] of the {subject}; {shapes}. 1: noise alone.",
    )


def _coefficient_section(
    rows: Mapping[str, Gap], histories: Sequence[History], prefix: str
) -> Section:
    """Return the residuals by coefficient."""
    cells = []
    for name, row in rows.items():
        # Residual of the coefficient, and what noise alone would give.
        measured = format_value(row.rms), format_value(row.noise)
        cells.append(
            (
                f"{name} [-]",
                *measured,
                format_value(row.ratio_to_noise, ".2f"),
                format_value(row.mean, ".2g"),
            )
        )
    head = ("Coefficient", "rms of flight minus model", "rms of noise alone", "Ratio", "Mean")
    table = Table(
        "Measured minus modelled coefficients (dimensionless, body axes).",
        head,
        tuple(cells),
        key=True,
    )
    figures = []
    series = [("{}_flight", "second thin", ""), ("{}_model", "first thin", "")]
    for c in COEFFICIENTS:
        if have_columns(histories, (f"{c}_flight", f"{c}_model")):
            coefficient_series = [(key.format(c), kind, words) for key, kind, words in series]
            label = f"{c} [-], measured and modelled, segments end to end."
            figures.append(
                end_to_end(
                    histories,
                    f"{prefix}gap-{c}",
                    coefficient_series,
                    None,
                    label,
                    f"{c} [-]",
                    caption=f"{c} [-], segments end to end",
                )
            )
    legend = (("second thin", "flight"), ("first thin", "model"))
    blocks = (Figures(tuple(figures), legend, file="coefficients"),) if figures else ()
    return Section("Gap by coefficient", (*blocks, table))


def _manoeuvre_section(gap: Compare) -> Section:
    """Return the residuals by manoeuvre and the largest deviations."""
    blocks: list[Any] = []
    ratios = {m: {**row.channels, **row.coefficients} for m, row in gap.manoeuvres.items()}
    if ratios:
        # All manoeuvres have the same channels and coefficients.
        names = list(next(iter(ratios.values())))
        head = ("Manoeuvre", *(shown_channel(n)[0] for n in names))
        rows = tuple(
            (label, *(format_value(row.get(n), ".2f") for n in names))
            for label, row in ratios.items()
        )
        blocks.append(
            Table("rms over noise [-] by manoeuvre, channels then coefficients.", head, rows)
        )
    moments = [
        (
            f"{m.time_s:.2f}",
            shown_channel(m.channel)[0],
            m.manoeuvre,
            format_value(m.noises, ".1f"),
        )
        for m in gap.moments[:10]
    ]
    if moments:
        head = ("Time [s]", "Channel", "Manoeuvre", "Gap in sigma [-]")
        blocks.append(Table("The largest deviations.", head, tuple(moments), key=True))
    return Section("Place of the residuals", tuple(blocks) or (Words("Not recorded."),))


# Tables of a comparison, and the sentence that says what it shows.

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
            "Signs or scales differ between record and model; correct them before delays:"
            f" {'; '.join(comparison.slips)}. Correct the channel's map or the servo table (see"
            " uqharness log info), or the model."
        )
    # Next, a common delay of the controls.
    if not comparison.reached and not comparison.aligned:
        when = "early" if comparison.controls_late_s < 0.0 else "late"
        return (
            "The record is not aligned: its controls act"
            f" {1e3 * abs(comparison.controls_late_s):.1f} ms {when}, and"
            f" {1e3 * comparison.late_limit_s:.1f} ms are allowed. A command belongs to the first"
            " row whose acceleration it affects: shift the command columns, otherwise a model"
            " identified from this flight has this lag in addition."
        )
    return noise_floor(
        comparison.reached,
        {c: comparison.channels[c].ratio for c in comparison.above},
        NOISE_FLOOR_RULE,
    )
