"""Draws rooms.svg, the picture of docs/architecture.md: `python docs/figures/make_rooms.py`.

Rooms stand in their order of import, the lowest at the bottom."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path

PICTURE = Path(__file__).with_name("rooms.svg")
WIDTH, FLOOR, GAP, TOP = 1000, 40, 6, 84

STYLE = """
  .ground { fill: #ffffff } .house { fill: #eef1f5 } .room { fill: #ffffff; stroke: #c3ccd6 }
  text { font-family: system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; font-size: 15.5px; fill: #1c2430 }
  .name { font-family: ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; font-weight: 600 }
  .title { font-size: 18px; font-weight: 600 } .soft { fill: #4c5866 } .arrow { stroke: #4c5866; fill: none; stroke-width: 2 }
  .head { fill: #4c5866 }
  @media (prefers-color-scheme: dark) {
    .ground { fill: #12161b } .house { fill: #1b2129 } .room { fill: #252d37; stroke: #46525f }
    text { fill: #e8ecf1 } .soft { fill: #b3bdc9 } .arrow { stroke: #b3bdc9 } .head { fill: #b3bdc9 }
  }
"""


@dataclass(frozen=True)
class Room:
    """A package and what it is for. "base" are the modules beside the packages."""

    name: str
    words: str


SYSID = (
    Room("effects", "candidate effects, scores, choice"),
    Room("model_form", "intervals of the coefficients"),
    Room("estimation", "output error, filter error, ..."),
    Room("aerodynamics", "terms, coefficients, residuals"),
    Room("logs", "dialects, checks, assembly"),
    Room("base, foreign", "records, arithmetic, files of others"),
)

UQHARNESS = (
    Room("cli", "words to requests, printing, exit codes"),
    Room("api", "the Python interface: import uqharness as uq"),
    Room("commands", "requests to files and outcomes"),
    Room("report", "report.html, charts, figures"),
    Room("dossier", "the evidence of a folder"),
    Room("study", "the whole chain, stage by stage"),
    Room("refinement", "which effect is missing, in the XML"),
    Room("next_flight", "test points and their script"),
    Room("campaign", "cases, execution, journal, tables"),
    Room("sensitivity", "five methods, of any function"),
    Room("authoring", "aircraft from geometry, slips, prior"),
    Room("exchange", "models of other programs, their loss"),
    Room("identification", "parameters, comparison, bounds"),
    Room("replay", "recorded flights flown again"),
    Room("statistics", "p-boxes, rates, decisions"),
    Room("plugin", "intervals as a JSBSim system"),
    Room("batch", "the compiled engine: many flights"),
    Room("differences", "two models side by side"),
    Room("flight", "one flight: air, steps, scores"),
    Room("xml", "JSBSim's XML read and edited"),
    Room("simulator", "JSBSim's one door, aircraft, trim"),
    Room("base, requests, results", "files; what commands take and give"),
)


def text(x: float, y: float, words: str, kind: str = "", anchor: str = "start") -> str:
    """One line of text, its middle at height ``y``."""
    place = f' text-anchor="{anchor}"' if anchor != "start" else ""
    return f'<text class="{kind}" x="{x:g}" y="{y + 5:g}"{place}>{escape(words)}</text>'


def picture() -> str:
    """The picture as SVG text."""
    height = TOP + len(UQHARNESS) * (FLOOR + GAP) + 74
    bottom = height - 64
    out = [f'<rect class="ground" width="{WIDTH}" height="{height}" rx="10"/>']
    out.append(
        text(24, 28, "Each room imports its own layer and lower ones, never a higher one.", "title")
    )
    # The two houses.
    out.append(
        f'<rect class="house" x="14" y="{TOP - 34}" width="356" height="{bottom - TOP + 42}"'
        ' rx="10"/>'
    )
    out.append(text(28, TOP - 16, "sysid: logs and identification", "title"))
    out.append(
        f'<rect class="house" x="410" y="{TOP - 34}" width="576" height="{bottom - TOP + 42}"'
        ' rx="10"/>'
    )
    out.append(text(424, TOP - 16, "uqharness: JSBSim, campaigns, command line", "title"))
    whole = bottom - TOP
    each = whole / len(SYSID)
    for k, room in enumerate(SYSID):
        top = TOP + k * each
        out.append(
            f'<rect class="room" x="26" y="{top:g}" width="332" height="{each - GAP:g}" rx="6"/>'
        )
        middle = top + (each - GAP) / 2
        out.append(
            text(40, middle - 11, room.name, "name") + text(40, middle + 12, room.words, "soft")
        )
    for k, room in enumerate(UQHARNESS):
        top = TOP + k * (FLOOR + GAP)
        out.append(f'<rect class="room" x="422" y="{top:g}" width="552" height="{FLOOR}" rx="6"/>')
        middle = top + FLOOR / 2
        out.append(text(434, middle, room.name, "name") + text(584, middle, room.words, "soft"))
    # uqharness takes from sysid, never the other way.
    y = TOP + whole * 0.5
    out.append(
        f'<path class="arrow" d="M 408 {y:g} H 384"/><path class="head" d="M 372 {y:g} l 14 -8 v 16'
        ' z"/>'
    )
    out.append(
        text(
            WIDTH / 2,
            height - 32,
            "Files of others: logs, aircraft in JSBSim's XML, TOML settings",
            "soft",
            "middle",
        )
    )
    label = "Rooms of sysid and uqharness in their order of import"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" width="{WIDTH}"'
        f' height="{height:g}" role="img">'
    )
    return "\n".join([head, f"<title>{label}</title><style>{STYLE}</style>", *out, "</svg>\n"])


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
