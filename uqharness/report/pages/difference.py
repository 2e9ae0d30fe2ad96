"""Build the page of two models flown with the same controls: differences, histories, XML."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uqharness.differences import Channel, Difference, MatchedFlight, Term, scale_of
from uqharness.report.parts import (
    Bullets,
    Figure,
    Figures,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    provenance,
)
from uqharness.report.svg import Chart, Scale, scale

MAX_HISTORIES = 8
"""Number of channels whose histories are drawn."""
_LEGEND = (("first", "A"), ("second", "B"))


def difference_page(
    names: tuple[str, str],
    channels: Sequence[Channel],
    flights: Sequence[MatchedFlight],
    differences: Sequence[Difference],
    terms: Sequence[Term],
    command: str,
) -> Page:
    """Return the page of a comparison of two models.

    Parameters
    ----------
    names : tuple of str
        Names of the models A and B.
    channels : sequence of Channel
        Channels compared.
    flights : sequence of Matched
        Flights of both models.
    differences : sequence of Difference
        One per channel that differs, ranked.
    terms : sequence of Term
        XML elements that differ.
    command : str
        Command line.
    """
    a, b = names
    question = f"Does {b} fly as {a} does, with the same controls in the same air?"
    sections = [
        _channels(differences),
        *_histories(flights, differences),
        _elements(terms, differences),
        _flights(flights, channels),
    ]
    files = provenance(("Command", command or "not recorded"), ("A", a), ("B", b))
    return Page(f"{a} and {b}", question, _verdict(flights, differences, terms), (*sections, files))


def _verdict(
    flights: Sequence[MatchedFlight], differences: Sequence[Difference], terms: Sequence[Term]
) -> tuple[Sentence, ...]:
    """Return whether the models differ, first where, and the likeliest cause."""
    sentences = [Sentence(f"{f.name}: {f.reason}.", "bad") for f in flights if f.reason]
    # Channels that only one model has count as a difference.
    for f in flights:
        sentences += [
            Sentence(f"{f.name}: only {s} has {', '.join(n)}.", "bad")
            for s, n in (("A", f.only_a), ("B", f.only_b))
            if n
        ]
    if differences:
        # The first difference in time is the most informative.
        d = differences[0]
        sentences.append(
            Sentence(
                f"The models differ in {len(differences)} channels, first in {d.channel} at"
                f" {d.from_s:g} s of {d.flight}.",
                "bad",
            )
        )
        if d.terms:
            sentences.append(Sentence(f"Likeliest cause: {_where(d.terms[0])}, {d.terms[0].path}."))
    elif not sentences:
        sentences.append(Sentence("No output differs beyond rounding.", "good"))
        if terms:
            sentences.append(
                Sentence(
                    f"{len(terms)} elements of the XML differ; these flights do not show them.",
                    "warn",
                )
            )
    return tuple(sentences)


def _channels(differences: Sequence[Difference]) -> Section:
    """Return the table of channels that differ."""
    if not differences:
        return Section("Channels", (Words("None differs."),))
    # One row a channel, in the order of cause and effect.
    rows = tuple(
        (
            d.channel,
            d.group,
            d.flight,
            f"{d.from_s:g}",
            _with_unit(d),
            f"{100.0 * d.share:.2g}",
            f"{d.times:.1g}",
        )
        for d in differences
    )
    head = (
        "Channel",
        "Group",
        "Flight",
        "Differs from [s]",
        "Largest difference",
        "Share of range [%]",
        "Times rounding",
    )
    note = Words(
        "Ranked by time, then cause before effect: a surface moves a coefficient, a coefficient an"
        " acceleration.",
        note=True,
    )
    return Section(
        "Channels", (Table("First difference of each channel.", head, rows, key=True), note)
    )


def _histories(
    flights: Sequence[MatchedFlight], differences: Sequence[Difference]
) -> list[Section]:
    """Return the histories of the first channels that differ."""
    by_name = {f.name: f for f in flights}
    figures = [
        _history(by_name[d.flight], d, number)
        for number, d in enumerate(differences[:MAX_HISTORIES])
    ]
    return (
        [Section("Histories", (Figures(tuple(figures), _LEGEND, narrow=True),))] if figures else []
    )


def _history(flight: MatchedFlight, d: Difference, number: int) -> Figure:
    """Draw one channel of both models."""
    a, b = flight.a[d.channel], flight.b[d.channel]
    label = f"{d.channel} [{d.unit}] against time [s], {flight.name}: A and B."
    time = Scale("time [s]", float(flight.time_s[0]), float(flight.time_s[-1]))
    chart = Chart(
        f"history-{number}", label, time, scale(f"{d.channel} [{d.unit}]", [a, b]), height=180
    )
    chart.line(flight.time_s, a, "first")
    chart.line(flight.time_s, b, "second")
    unit = "" if d.unit == "-" else f" {d.unit}"
    # Root mean square of B minus A.
    rms = float(np.sqrt(np.nanmean((b - a) ** 2)))
    return Figure(
        chart.name,
        chart.svg(),
        f"{d.channel}, {flight.name}: B minus A {rms:.3g}{unit} rms, from {d.from_s:g} s.",
    )


def _elements(terms: Sequence[Term], differences: Sequence[Difference]) -> Section:
    """Return the table of XML elements that differ."""
    if not terms:
        return Section(
            "XML that differs",
            (Words("None: comments, spaces and the order of attributes do not count."),),
        )
    # The likeliest cause first, if there is a difference.
    ordered = differences[0].terms if differences else terms
    rows = tuple((_where(t), t.path, t.a or "nothing", t.b or "nothing") for t in ordered)
    first = (
        "the likeliest cause of the first difference on top"
        if differences
        else "in the order of the files"
    )
    return Section(
        "XML that differs", (Table(f"Elements, {first}.", ("Line", "Element", "A", "B"), rows),)
    )


def _flights(flights: Sequence[MatchedFlight], channels: Sequence[Channel]) -> Section:
    """Return the flights and the channels compared."""
    frame_counts = tuple(f"{f.name}: {len(f.time_s)} frames" for f in flights)
    compared = tuple(f"{c.name} [{c.unit}]" + _range(c, flights) for c in channels)
    parts = (Section("Channels compared", (Bullets(compared),)),)
    return Section("What was flown", (Bullets(frame_counts),), parts)


def _range(channel: Channel, flights: Sequence[MatchedFlight]) -> str:
    """Return the range of a channel as text."""
    reach = [scale_of(channel, f.a[channel.name]) for f in flights if channel.name in f.a]
    return f", range {max(reach):.3g}" if reach else ""


def _with_unit(d: Difference) -> str:
    """Format the size of a difference with its unit."""
    return f"{d.size:.3g}" if d.unit == "-" else f"{d.size:.3g} {d.unit}"


def _where(term: Term) -> str:
    """Return the line of an XML element."""
    return f"B {term.b_where}" if term.b_where else f"A {term.a_where}"
