"""The vocabulary joined with the shipped signal maps as a Markdown table: that of docs/log-reference.md."""

from __future__ import annotations

from sysid.logs.signal_map import shipped_dialects, shipped_map
from sysid.vocabulary import SIGNALS


def markdown_table() -> str:
    """One row per signal: name, unit, meaning, and its sources in every dialect."""
    maps = {dialect: shipped_map(dialect) for dialect in shipped_dialects()}
    lines = [
        "| signal | unit | meaning | " + " | ".join(maps) + " |",
        "|---" * (3 + len(maps)) + "|",
    ]
    for signal in SIGNALS.values():
        labels = [
            dict.fromkeys(entry.label for entry in m.entries.get(signal.name, ()))
            for m in maps.values()
        ]
        cells = [" or ".join(found) or "-" for found in labels]
        lines.append(
            f"| `{signal.name}` | {signal.unit} | {signal.meaning} | " + " | ".join(cells) + " |"
        )
    return "\n".join(lines)
