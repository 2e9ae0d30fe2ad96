"""Draw the charts of report pages as SVG text: axes, lines, bands, dots, legends.

The functions are pure: the same arrays give the same bytes. No mark sets a colour; each
has a class of templates/figure.css, whose variables follow the reader's light or dark scheme, and a
dash or a shape in addition to its colour. A chart is 360 units wide, so that its text stays legible
on a phone; wide screens show several side by side.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import resources

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.display import visible

WIDTH = 360
"""Width of a chart in drawing units."""
_GAP = 16
_MIN_LEFT, _RIGHT, _TOP, _BOTTOM = 34, 12, 24, 38
_CHARACTER = 6.9
"""Width reserved for a character of the 11-unit text, for any font."""
_MAX_POINTS = 400
_MAX_LOG_TICKS = 9


@dataclass(frozen=True)
class Scale:
    """An axis.

    Attributes
    ----------
    label : str
        Quantity and unit.
    low, high : float
        Range of the axis.
    names : tuple of (float, str)
        Named ticks at given values; empty for numbers.
    log : bool
        Whether the axis is logarithmic.
    """

    label: str
    low: float
    high: float
    names: tuple[tuple[float, str], ...] = ()
    log: bool = False

    def place(self, value: FloatArray | float) -> FloatArray:
        """Return the position of values along the axis, 0 to 1; NaN where a logarithmic axis has
        none.
        """
        value, low, high = np.asarray(value, dtype=float), self.low, self.high
        # Logarithms of the ends and of positive values; others become NaN.
        if self.log:
            value, low, high = (
                np.log(np.where(value > 0.0, value, np.nan)),
                math.log(low),
                math.log(high),
            )
        return np.asarray((value - low) / ((high - low) or 1.0))

    def ticks(self) -> list[tuple[float, str]]:
        """Return values and labels of the ticks."""
        if self.names:
            return list(self.names)
        if self.log:
            return _log_ticks(self.low, self.high)
        if not self.high > self.low:
            return [(self.low, f"{self.low:.4g}")]
        if not math.isfinite(self.high - self.low):
            return [(self.low, f"{self.low:.3g}"), (self.high, f"{self.high:.3g}")]
        step = _step(self.high / 5.0 - self.low / 5.0)
        if step == 0.0:
            return [(self.low, f"{self.low:.4g}")]
        first = math.ceil(self.low / step - 1e-9)
        return [
            (k * step, _number(k * step, step))
            for k in range(first, math.floor(self.high / step + 1e-9) + 1)
        ]


def scale(
    label: str, values: Sequence[FloatArray], margin: float = 0.06, minimum: float | None = None
) -> Scale:
    """Return a linear scale around all finite values.

    Parameters
    ----------
    label : str
        Quantity and unit.
    values : sequence of array
        Data; without a finite value the scale is 0 to 1.
    margin : float
        Room on both sides as a share of the range.
    minimum : float, optional
        The axis does not go below it.
    """
    finite = (
        np.concatenate([np.ravel(v)[np.isfinite(np.ravel(v))] for v in values])
        if values
        else np.empty(0)
    )
    if not finite.size:
        return Scale(label, 0.0, 1.0)
    # Room on both sides; a constant gets a tenth of its size.
    low, high = float(finite.min()), float(finite.max())
    room = margin * (high - low) or 0.1 * abs(high) or 1.0
    low, high = low - room, high + room
    return Scale(label, low if minimum is None else max(minimum, low), high)


def log_scale(label: str, values: Sequence[FloatArray], margin: float = 0.06) -> Scale:
    """Return a logarithmic scale around all finite positive values; 0.1 to 1 if there are none."""
    positive = np.concatenate([np.ravel(v) for v in values]) if values else np.empty(0)
    positive = positive[np.isfinite(positive) & (positive > 0.0)]
    if not positive.size:
        return Scale(label, 0.1, 1.0, log=True)
    low, high = math.log(positive.min()), math.log(positive.max())
    room = margin * (high - low) if high > low else 0.5
    return Scale(label, math.exp(low - room), math.exp(high + room), log=True)


def _log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Return ticks at 1, 2 and 5 times the powers of ten, or fewer if there are too many."""
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    # Take the densest set of ticks that is not too many.
    for factors in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
        values = [
            f * 10.0**k
            for k in powers
            for f in factors
            if low * (1 - 1e-9) <= f * 10.0**k <= high * (1 + 1e-9)
        ]
        if len(values) <= _MAX_LOG_TICKS:
            break
    return [(value, f"{value:g}") for value in values]


def _step(rough: float) -> float:
    """Return a round step (1, 2, 2.5 or 5 times a power of ten) of at least the given size."""
    if not 0.0 < rough < math.inf:
        return rough  # of numbers near the largest there are: one tick
    # The smallest round step that is not below the rough one.
    power = 10.0 ** math.floor(math.log10(rough))
    steps = (m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= rough * 0.999999)
    return next(steps, rough)  # the power of a denormal number may be 0


def _number(value: float, step: float) -> str:
    """Format a tick with the decimals that its step needs."""
    if value != 0.0 and (abs(value) >= 1e5 or step < 1e-4):
        return f"{value:.3g}".replace("-", "−")
    # One decimal more for steps such as 2.5.
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    if abs(step * 10**decimals - round(step * 10**decimals)) > 1e-6:
        decimals += 1
    return f"{value:.{decimals}f}".replace("-", "−") if abs(value) > 1e-12 else "0"


@dataclass
class Chart:
    """Marks of a chart, written as SVG.

    Attributes
    ----------
    name : str
        Unique name within the page.
    label : str
        Description of the picture for screen readers.
    x, y : Scale
        Axes.
    height : int
        Height in drawing units, without the legend.
    marks : list of str
        SVG elements inside the axes.
    legend : list of (str, str)
        Class and words of the entries.
    """

    name: str
    label: str
    x: Scale
    y: Scale
    height: int = 220
    marks: list[str] = field(default_factory=list)
    legend: list[tuple[str, str]] = field(default_factory=list)

    @cached_property
    def left_margin(self) -> int:
        """Width reserved for the widest tick label."""
        widest = max((len(words) for _, words in self.y.ticks()), default=0)
        return max(_MIN_LEFT, min(190, 9 + math.ceil(_CHARACTER * widest)))

    @property
    def plot(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the area inside the axes."""
        return (
            self.left_margin,
            _TOP,
            WIDTH - self.left_margin - _RIGHT,
            self.height - _TOP - _BOTTOM,
        )

    def at(self, x: FloatArray | float, y: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Return the drawing coordinates of data."""
        x0, top, width, height = self.plot
        u, v = x0 + width * self.x.place(x), top + height * (1.0 - self.y.place(y))
        # Far outside the frame the arithmetic of browsers fails before clipping.
        u, v = (np.where(np.isfinite(w), np.clip(w, -5000.0, 5000.0), np.nan) for w in (u, v))
        return u, v

    def line(
        self,
        x: FloatArray,
        y: FloatArray,
        kind: str,
        words: str = "",
        steps: bool = False,
        data: str = "",
    ) -> None:
        """Draw a line through finite points, with a gap at NaN.

        Parameters
        ----------
        x, y : array
            Points (n,).
        kind : str
            Class of figure.css.
        words : str
            Legend entry; empty for none.
        steps : bool
            Whether each value holds until the next.
        data : str
            Further attributes of the SVG element.
        """
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        # Lines are thinned, steps are not: every value counts.
        if not steps:
            x, y = thin_line(x, y)
        path = _path(*self.at(x, y), steps)
        if path:
            self.marks.append(f'<path class="line {kind}"{data} d="{path}"/>')
            self._entry(kind, words)

    def path(self, x: FloatArray, y: FloatArray, kind: str, words: str = "") -> None:
        """Draw a line through all points in their order, without thinning."""
        self.marks.append(f'<path class="line {kind}" d="{_path(*self.at(x, y))}"/>')
        self._entry(kind, words)

    def band(
        self,
        x: FloatArray,
        low: FloatArray,
        high: FloatArray,
        kind: str,
        words: str = "",
        steps: bool = False,
    ) -> None:
        """Fill the area between two lines where both are finite."""
        x, low, high = (np.asarray(v, dtype=float) for v in (x, low, high))
        for run in _runs(np.isfinite(x) & np.isfinite(low) & np.isfinite(high)):
            u, v = self.at(x[run], low[run])
            _, w = self.at(x[run], high[run])
            # Double the points so that each value holds until the next.
            if steps:
                u, v, w = np.repeat(u, 2)[1:], np.repeat(v, 2)[:-1], np.repeat(w, 2)[:-1]
            elif u.size > _MAX_POINTS:
                keep = np.unique(np.linspace(0, u.size - 1, _MAX_POINTS).round().astype(int))
                u, v, w = u[keep], v[keep], w[keep]
            outline = _path(np.concatenate([u, u[::-1]]), np.concatenate([w, v[::-1]]))
            self.marks.append(f'<path class="band {kind}" d="{outline}Z"/>')
            self._entry(kind, words)

    def area(self, x: FloatArray, y: FloatArray, kind: str, words: str = "") -> None:
        """Fill a closed outline of finite points."""
        self.marks.append(f'<path class="band {kind}" d="{_path(*self.at(x, y))}Z"/>')
        self._entry(kind, words)

    def dots(
        self, x: FloatArray, y: FloatArray, kind: str, words: str = "", radius: float = 1.3
    ) -> None:
        """Draw small discs at finite points, as one SVG path."""
        u, v = self.at(x, y)
        finite = np.isfinite(u) & np.isfinite(v)
        if finite.any():
            # A line of zero length with round caps is a disc, in the fewest bytes.
            path = _format_pairs("M%.1f %.1fh0" * int(finite.sum()), u[finite], v[finite])
            self.marks.append(
                f'<path class="dots {kind}" stroke-width="{2 * radius:g}" d="{path}"/>'
            )
            self._entry(kind, words)

    def marker(self, x: float, y: float, kind: str, shape: str, words: str = "") -> None:
        """Draw one marker; ``shape`` is disc, ring, square, bar or cross."""
        (u,), (v,) = (np.atleast_1d(w) for w in self.at(x, y))
        if not (math.isfinite(u) and math.isfinite(v)):
            return
        shapes = {
            "disc": f'<circle class="mark {kind}" cx="{u:.1f}" cy="{v:.1f}" r="4"/>',
            "ring": f'<circle class="mark hollow {kind}" cx="{u:.1f}" cy="{v:.1f}" r="4"/>',
            "square": (
                f'<rect class="mark {kind}" x="{u - 3.5:.1f}" y="{v - 3.5:.1f}" width="7"'
                ' height="7"/>'
            ),
            "bar": f'<path class="line {kind}" d="M{u:.1f} {v - 5:.1f}v10"/>',
            "cross": f'<path class="line {kind}" d="M{u - 4:.1f} {v - 4:.1f}l8 8m0 -8l-8 8"/>',
        }
        self.marks.append(shapes[shape])
        self._entry(f"mark-{shape} {kind}", words)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        anchor: str = "start",
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Write words at a point.

        Parameters
        ----------
        x, y : float
            Point in data coordinates.
        words : str
            Text.
        anchor : str
            Which end of the text is at the point: start, middle or end.
        shift : tuple of float
            Offset to the right and downwards in drawing units.
        """
        (u,), (v,) = (np.atleast_1d(w) for w in self.at(x, y))
        if math.isfinite(u) and math.isfinite(v):
            place = f'x="{u + shift[0]:.1f}" y="{v + shift[1]:.1f}"'
            self.marks.append(
                f'<text class="inside" text-anchor="{anchor}" {place}>{escape(words)}</text>'
            )

    def cells(self, x: FloatArray, y: FloatArray, share: FloatArray, kind: str) -> None:
        """Draw a map of cells.

        Parameters
        ----------
        x, y : array
            Edges (n + 1,) and (m + 1,).
        share : array
            Opacity (n, m), 0 to 1; cells of 0 are left out.
        kind : str
            Class of figure.css.
        """
        # Edges in drawing coordinates.
        u, v = self.at(x, y[0])[0], self.at(x[0], y)[1]
        for i, j in zip(*np.nonzero(share), strict=True):
            place = (
                f'x="{u[i]:.1f}" y="{v[j + 1]:.1f}" width="{u[i + 1] - u[i]:.1f}"'
                f' height="{v[j] - v[j + 1]:.1f}"'
            )
            self.marks.append(
                f'<rect class="cell {kind}" {place} fill-opacity="{share[i, j]:.3f}"/>'
            )

    def upright(self, x: float, kind: str, words: str = "") -> None:
        """Draw a vertical line at ``x``."""
        self.line(np.array([x, x]), np.array([self.y.low, self.y.high]), kind, words)

    def level(self, y: float, kind: str, words: str = "") -> None:
        """Draw a horizontal line at ``y``."""
        self.across(self.x.low, self.x.high, y, kind, words)

    def across(self, low: float, high: float, y: float, kind: str, words: str = "") -> None:
        """Draw a horizontal line from ``low`` to ``high``."""
        self.line(np.array([low, high]), np.array([y, y], dtype=float), kind, words)

    def _entry(self, kind: str, words: str) -> None:
        """Add a legend entry once."""
        if words and (kind, words) not in self.legend:
            self.legend.append((kind, words))

    def svg(self) -> Markup:
        """Return the SVG element, for a page that contains templates/figure.css."""
        x0, top, width, height = self.plot
        # The legend grows the drawing downwards.
        entries, rows = _legend(self.legend, WIDTH)
        total = self.height + (16 * rows + 4 if rows else 0)
        # The root element carries plot area and ranges for the page's script.
        out = [
            (
                f'<svg class="chart" role="img" aria-label="{escape(self.label)}" viewBox="0 0'
                f' {WIDTH} {total}" '
            ),
            (
                f'data-plot="{x0},{top},{width},{height}"'
                f' data-x="{self.x.low:.6g},{self.x.high:.6g}">'
            ),
            (
                f'<clipPath id="{self.name}-clip"><rect x="{x0}" y="{top}" width="{width}"'
                f' height="{height}"/></clipPath>'
            ),
            *self._grid(),
            f'<g clip-path="url(#{self.name}-clip)">{"".join(self.marks)}</g>',
            f'<path class="axis" d="M{x0} {top}v{height}h{width}"/>',
            f'<text class="label" x="2" y="13">{escape(self.y.label)}</text>',
        ]
        middle, low = x0 + width / 2, self.height - 5
        out.append(
            f'<text class="label" text-anchor="middle" x="{middle:g}"'
            f' y="{low}">{escape(self.x.label)}</text>'
        )
        for kind, words, x, row in entries:
            y = self.height + 12 + 16 * row
            out.append(
                f'<g class="key">{_swatch(kind, x, y - 4)}<text x="{x + 28}"'
                f' y="{y}">{escape(words)}</text></g>'
            )
        return Markup("".join([*out, "</svg>"]))

    def _grid(self) -> list[str]:
        """Return grid lines and tick labels."""
        x0, top, width, height = self.plot
        out = []
        # Keep the last tick label inside the drawing.
        for value, words in self.x.ticks():
            u = x0 + width * float(self.x.place(value))
            out.append(f'<path class="grid" d="M{u:.1f} {top}v{height}"/>')
            u = min(u, WIDTH - 2 - 0.5 * _CHARACTER * len(words))
            out.append(
                f'<text text-anchor="middle" x="{u:.1f}"'
                f' y="{self.height - _BOTTOM + 14}">{escape(words)}</text>'
            )
        for value, words in self.y.ticks():
            v = top + height * (1.0 - float(self.y.place(value)))
            if not self.y.names:
                out.append(f'<path class="grid" d="M{x0} {v:.1f}h{width}"/>')
            out.append(
                f'<text text-anchor="end" x="{x0 - 5}" y="{v + 3.5:.1f}">{escape(words)}</text>'
            )
        return out


def rows_chart(name: str, label: str, x: Scale, rows: Sequence[str], height: int = 17) -> Chart:
    """Return a chart with a named row per entry; row k lies at y = k, the first on top."""
    names = tuple((float(k), row) for k, row in enumerate(rows))
    return Chart(name, label, x, Scale("", len(rows) - 0.5, -0.5, names), 68 + height * len(rows))


def standalone(
    charts: Sequence[tuple[Markup, str]],
    title: str = "",
    legend: Sequence[tuple[str, str]] = (),
    columns: int = 1,
) -> str:
    """Return charts with captions as one SVG file that refers to no other file.

    Parameters
    ----------
    charts : sequence of (Markup, str)
        SVG elements and their captions.
    title : str
        Heading.
    legend : sequence of (str, str)
        Class and words of entries that hold for all charts.
    columns : int
        Charts per row.
    """
    columns = min(columns, len(charts))
    width = columns * (WIDTH + _GAP) + _GAP
    # Parts of the file from top to bottom.
    parts, y = [], 0
    # Title, legend, then the charts row by row.
    for line in textwrap.wrap(title, int(width / 9.5)):
        y += 20
        parts.append(f'<text class="title" x="{_GAP}" y="{y}">{escape(line)}</text>')
    entries, rows = _legend(legend, width - 8)
    for kind, words, x, row in entries:
        at = y + 20 + 16 * row
        parts.append(
            f'{_swatch(kind, x + 8, at - 4)}<text x="{x + 36:g}" y="{at}">{escape(words)}</text>'
        )
    y += 16 * rows + _GAP
    for first in range(0, len(charts), columns):
        tallest = 0
        # Chart and caption; the tallest of a row sets its height.
        for column, (svg, caption) in enumerate(charts[first : first + columns]):
            x = _GAP + column * (WIDTH + _GAP)
            height, placed = _placed(svg, x, y)
            parts.append(placed)
            for line in textwrap.wrap(caption, 58):
                height += 14
                parts.append(
                    f'<text class="caption" x="{x}" y="{y + height}">{escape(line)}</text>'
                )
            tallest = max(tallest, height)
        y += tallest + _GAP
    # A single chart is shown at twice its size.
    size = f'width="{2 * width if columns == 1 else width}" viewBox="0 0 {width} {y}"'
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" class="chart" role="img"'
        f' aria-label="{escape(title)}" {size}>'
    )
    paper = f'<rect width="{width}" height="{y}" fill="#ffffff"/>'
    return (
        visible("".join([head, f"<style>{_plain_style()}</style>", paper, *parts, "</svg>"])) + "\n"
    )


def _placed(svg: Markup, x: int, y: int) -> tuple[int, str]:
    """Return the height of a chart and the chart moved to a place in another drawing."""
    view_box = re.search(r'viewBox="0 0 (\d+) (\d+)"', svg)
    assert view_box is not None
    height = int(view_box[2])
    return height, str(svg).replace(
        "<svg ", f'<svg x="{x}" y="{y}" width="{WIDTH}" height="{height}" ', 1
    )


@cache
def style() -> str:
    """Return the style sheet of all charts, which pages use as well."""
    return (
        resources.files("uqharness.report")
        .joinpath("templates/figure.css")
        .read_text(encoding="utf-8")
    )


@cache
def _plain_style() -> str:
    """Return the style sheet with colours in place of variables, for drawing programs."""
    # Take the colours of the light scheme and put them in place of the variables.
    colours = dict(re.findall(r"--([\w-]+): (#\w+)", style()))
    rules = style().partition("}\n")[2]
    return re.sub(r"var\(--([\w-]+)\)", lambda variable: colours[variable[1]], rules)


def thin_line(
    x: FloatArray, y: FloatArray, max_points: int = _MAX_POINTS
) -> tuple[FloatArray, FloatArray]:
    """Thin a line to about ``max_points`` points and keep the extremes of every bucket.

    Peaks and gaps survive: each bucket keeps its smallest and largest value and its first NaN.
    """
    # Short lines stay as they are.
    if x.size <= max_points:
        return x, y
    # Two points per bucket.
    edges = np.linspace(0, x.size, max_points // 2 + 1).astype(int)
    first, sizes = edges[:-1], np.diff(edges)
    bucket, missing = np.repeat(np.arange(first.size), sizes), np.isnan(y)
    # The first NaN keeps the gap; a bucket without values is represented by it.
    keep = [_first_of(bucket, missing)]
    # fmin and fmax ignore NaN.
    for extreme in (np.fmin, np.fmax):
        keep.append(_first_of(bucket, y == np.repeat(extreme.reduceat(y, first), sizes)))
    order = np.unique(np.concatenate(keep))
    return x[order], y[order]


def _first_of(bucket: NDArray[np.intp], is_selected: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the place of the first selected sample of each bucket; ``bucket`` ascends."""
    places = np.flatnonzero(is_selected)
    bucket_of_place = bucket[places]
    return places[np.append(True, bucket_of_place[1:] != bucket_of_place[:-1])[: places.size]]


def _runs(is_finite: NDArray[np.bool_]) -> list[slice]:
    """Return slices of consecutive True values, at least two long."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_finite, [False]]).astype(int)))
    return [
        slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1
    ]


def _path(u: FloatArray, v: FloatArray, steps: bool = False) -> str:
    """Return the path data of a line with gaps at NaN."""
    is_finite = np.isfinite(u) & np.isfinite(v)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_finite, [False]]).astype(int)))
    going_on = "H%.1fV%.1f" if steps else "L%.1f %.1f"
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return "".join(
        _format_pairs("M%.1f %.1f" + going_on * (b - a - 1), u[a:b], v[a:b]) for a, b in runs
    )


def _format_pairs(form: str, u: FloatArray, v: FloatArray) -> str:
    """Format pairs of numbers with one decimal, without a trailing ".0"."""
    return (form % tuple(np.column_stack([u, v]).ravel().tolist())).replace(".0", "")


def _legend(
    items: Sequence[tuple[str, str]], width: float
) -> tuple[list[tuple[str, str, float, int]], int]:
    """Return legend entries with their places, and the number of rows."""
    out, x, row = [], 8.0, 0
    for kind, words in items:
        # An entry that does not fit starts a new row.
        needed = 28 + _CHARACTER * len(words) + 12
        if x > 8.0 and x + needed > width:
            x, row = 8.0, row + 1
        out.append((kind, words, x, row))
        x += needed
    return out, row + 1 if items else 0


def _swatch(kind: str, x: float, y: float) -> str:
    """Return the sample mark of a legend entry."""
    # The class begins with the shape of the mark.
    shape, _, css_class = kind.partition(" ")
    if shape == "mark-disc":
        return f'<circle class="mark {css_class}" cx="{x + 11:g}" cy="{y:g}" r="4"/>'
    if shape == "mark-ring":
        return f'<circle class="mark hollow {css_class}" cx="{x + 11:g}" cy="{y:g}" r="4"/>'
    if shape == "mark-square":
        return (
            f'<rect class="mark {css_class}" x="{x + 7.5:g}" y="{y - 3.5:g}" width="7" height="7"/>'
        )
    if shape == "mark-cross":
        return f'<path class="line {css_class}" d="M{x + 7:g} {y - 4:g}l8 8m0 -8l-8 8"/>'
    if shape.startswith("fill"):
        return f'<rect class="band {kind}" x="{x:g}" y="{y - 5:g}" width="22" height="10"/>'
    if shape.startswith("dot"):
        return f'<path class="dots {kind}" stroke-width="4" d="M{x + 4:g} {y:g}h0m7 0h0m7 0h0"/>'
    return f'<path class="line {kind}" d="M{x:g} {y:g}h22"/>'
