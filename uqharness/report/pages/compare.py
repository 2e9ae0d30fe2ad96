"""The page of a comparison of a flight with a model, from compare.json and histories.parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.aerodynamics import COEFFICIENTS
from uqharness.identification import OUTPUTS
from uqharness.replay import (
    CHANNELS,
    HISTORIES,
    History,
    have_columns,
    read_histories,
    shown_channel,
    with_shown_names,
)
from uqharness.report.history import MOST_SEGMENTS, Model, end_to_end, file_name, history_section
from uqharness.report.parts import (
    Cell,
    Figure,
    Figures,
    Level,
    Page,
    Say,
    Section,
    Table,
    Words,
    provenance,
    remarks,
    shown,
)
from uqharness.report.svg import Scale, rows_chart
from uqharness.result_documents import Compare, read_document

COMPARE = "compare.json"
LIMIT = 1.15


def compare_page(folder: Path, prefix: str = "", segments: int | None = MOST_SEGMENTS) -> Page:
    """The page of the folder that ``uqharness compare`` wrote, with so many segments' histories (None: all).

    Raises BadInputError.
    """
    found = read_document(folder / COMPARE, Compare)
    histories = read_histories(folder / HISTORIES)
    # What is not judged (height, heading) may have a noise that says nothing.
    noise = {
        c: row["noise"] if row.get("judged", True) else None for c, row in found["channels"].items()
    }
    sections = [_channel_section(found["channels"], prefix)]
    sections += history_section(
        histories,
        noise,
        [Model("_model", "first", "model")],
        "Log against model",
        f"{prefix}gap-",
        segments,
        lambda _, h: file_name(f"{h.number:02d}-{h.manoeuvre}"),
    )
    sections += [
        _coefficient_section(found["coefficients"], histories, prefix),
        _manoeuvre_section(found),
    ]
    sections += remarks({"notes": [with_shown_names(n, CHANNELS) for n in found.get("notes", ())]})
    files = "compare.json, channels.csv, coefficients.csv, manoeuvres.csv, moments.csv, histories.parquet, beside this page"
    facts = (
        ("Command", found.get("command") or "not recorded"),
        ("Rule", found.get("rule", "not recorded")),
        ("Files", files),
    )
    sections.append(provenance(*facts))
    asked = f"Does {found['aircraft']} fly {found['flight']} as it was flown, to within the sensors' noise?"
    return Page(
        f"{found['flight']} beside {found['aircraft']}", asked, _verdict(found), tuple(sections)
    )


def noise_floor(reached: bool, above: Mapping[str, float], rule: str = "") -> str:
    """Whether a model reaches the noise floor, in a sentence. above: channel -> rms over noise of those that do not."""
    by = f" ({rule})" if rule else ""
    if reached:
        return f"The model reaches the noise floor{by}."
    worst = ", ".join(f"{c} {ratio:.2f}" for c, ratio in above.items())
    return f"The model does not reach the noise floor: rms over noise is {worst}{by}."


def _verdict(found: Mapping[str, Any]) -> tuple[Say, ...]:
    reached = bool(found["reached_noise_floor"])
    above = {c: found["channels"][c]["ratio"] for c in found.get("above", ())}
    text = with_shown_names(found.get("verdict") or noise_floor(reached, above), CHANNELS)
    said = [Say(text, "good" if reached else "bad")]
    known = {
        c: r["rms"] / r["noise"]
        for c, r in found["coefficients"].items()
        if r.get("rms") is not None and r.get("noise")
    }
    if known:
        worst = max(known, key=lambda c: known[c])
        said.append(
            Say(
                f"Largest gap of a coefficient: {worst}, {known[worst]:.2f} times the rms that noise alone gives."
            )
        )
    return tuple(said)


def in_shown_unit(name: str, row: Mapping[str, Any], *keys: str) -> tuple[str, list[float | None]]:
    """``q [deg/s]`` of a channel or coefficient, and numbers of its row in that unit; None for one that is not known."""
    quantity, unit, factor = shown_channel(name)
    return f"{quantity} [{unit}]", [
        None if row.get(key) is None else factor * row[key] for key in keys
    ]


def _channel_section(channels: Mapping[str, Mapping[str, Any]], prefix: str) -> Section:
    rows = []
    for name, row in channels.items():
        label, (rms, noise) = in_shown_unit(name, row, "rms", "noise")
        ratio = row["ratio"]
        judged = row.get("judged", True)
        level: Level = "" if not judged or ratio is None else "good" if ratio <= LIMIT else "bad"
        # The noise of what is not judged says nothing, and neither does a ratio to it.
        sizes = (shown(noise), shown(ratio, ".2f")) if judged else ("-", "-")
        answer = "undefined" if ratio is None else "at the noise" if level == "good" else "above"
        answer = answer if judged else _why_not_judged(name)
        delay = f"{_milli(row.get('delay_s'))} ± {_milli(row.get('delay_std_s'))}"
        if row.get("delay_s") is None:
            delay = f"undefined: {row.get('delay_undefined') or 'no reason recorded'}"
        theil = shown(row.get("theil_u"), ".3f")
        rows.append((label, shown(rms), *sizes, Cell(answer, level), delay, theil))
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
        shown_channel(c)[0]: {"model": r["ratio"]}
        for c, r in channels.items()
        if r.get("ratio") is not None and r.get("judged", True)
    }
    figure = ratio_figure(
        f"{prefix}gap-ratios", ratios, [("model", "first", "disc")], "judged channels"
    )
    blocks = (Figures((figure,), file="gaps"),) if figure else ()
    table = Table("Gap between log and model, by channel.", head, tuple(rows), key=True)
    return Section("Gap by channel", (*blocks, table))


def _why_not_judged(channel: str) -> str:
    if channel in OUTPUTS:
        return "not judged: the log's own estimate"
    return "not judged: integral of other channels, drifts"


def _milli(value: float | None) -> str:
    # Adding 0 takes the sign off what rounds to zero.
    return shown(None if value is None else round(1e3 * value, 1) + 0.0, ".1f")


def ratio_figure(
    name: str,
    ratios: Mapping[str, Mapping[str, float]],
    series: Sequence[tuple[str, str, str]],
    what: str,
) -> Figure | None:
    """rms over noise by row, one mark a series (key, class, shape); 1 is the noise itself. None without rows."""
    if not ratios:
        return None
    largest = max(v for row in ratios.values() for v in row.values())
    label = "; ".join(
        f"{row}: {' to '.join(f'{v:.2f}' for v in values.values())}"
        for row, values in ratios.items()
    )
    x = Scale("rms of log minus model over noise [-]", 0.0, 1.08 * max(largest, 1.3))
    label = f"Gap over noise [-] of the {what}. {label}."
    chart = rows_chart(name, label, x, tuple(ratios))
    chart.upright(1.0, "zero", "the noise itself")
    chart.upright(LIMIT, "limit", f"limit {LIMIT:g}")
    for k, row in enumerate(ratios):
        values = [ratios[row][key] for key, _, _ in series if key in ratios[row]]
        if len(values) > 1:
            chart.across(min(values), max(values), k, "link")
        for key, kind, shape in series:
            if key in ratios[row]:
                chart.marker(ratios[row][key], float(k), kind, shape)
    shapes = ", ".join(f"{shape}: {key}" for key, _, shape in series)
    return Figure(
        name,
        chart.svg(),
        f"Gap over noise [-] of the {what}; {shapes}. 1 is what noise alone gives.",
    )


def _coefficient_section(
    rows: Mapping[str, Mapping[str, Any]], histories: Sequence[History], prefix: str
) -> Section:
    cells = []
    for name, row in rows.items():
        ratio = (
            row["rms"] / row["noise"] if row.get("rms") is not None and row.get("noise") else None
        )
        measured = shown(row.get("rms")), shown(row.get("noise"))
        cells.append((f"{name} [-]", *measured, shown(ratio, ".2f"), shown(row.get("mean"), ".2g")))
    head = ("Coefficient", "rms of flight minus model", "rms of noise alone", "Ratio", "Mean")
    table = Table(
        "Gap between demanded and modelled coefficients (dimensionless, body axes).",
        head,
        tuple(cells),
        key=True,
    )
    figures = []
    series = [("{}_flight", "second thin", ""), ("{}_model", "first thin", "")]
    for c in COEFFICIENTS:
        if have_columns(histories, (f"{c}_flight", f"{c}_model")):
            drawn = [(key.format(c), kind, words) for key, kind, words in series]
            label = (
                f"{c} [-] that the flight demanded and that the model gives, segments end to end."
            )
            figures.append(
                end_to_end(
                    histories,
                    f"{prefix}gap-{c}",
                    drawn,
                    None,
                    label,
                    f"{c} [-]",
                    f"{c} [-], segments end to end",
                )
            )
    legend = (("second thin", "flight"), ("first thin", "model"))
    blocks = (Figures(tuple(figures), legend, file="coefficients"),) if figures else ()
    return Section("Gap by coefficient", (*blocks, table))


def _manoeuvre_section(found: Mapping[str, Any]) -> Section:
    manoeuvres = found.get("manoeuvres", {})
    blocks: list[Any] = []
    if manoeuvres:
        first = next(iter(manoeuvres.values()))
        names = [*first["channels"], *first["coefficients"]]
        head = ("Manoeuvre", *(shown_channel(n)[0] for n in names))
        rows = tuple(
            (
                label,
                *(shown(({**row["channels"], **row["coefficients"]}).get(n), ".2f") for n in names),
            )
            for label, row in manoeuvres.items()
        )
        blocks.append(
            Table("rms over noise [-] by manoeuvre, channels then coefficients.", head, rows)
        )
    moments = [
        (
            f"{m['time_s']:.2f}",
            shown_channel(m["channel"])[0],
            m["manoeuvre"],
            shown(m["noises"], ".1f"),
        )
        for m in found.get("moments", ())[:10]
    ]
    if moments:
        head = ("Time [s]", "Channel", "Manoeuvre", "Gap in sigma [-]")
        blocks.append(Table("The largest deviations.", head, tuple(moments), key=True))
    return Section("Where the gap is", tuple(blocks) or (Words("Not recorded."),))
