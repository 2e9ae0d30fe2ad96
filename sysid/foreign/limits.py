"""What reading a foreign file may cost: time and memory that grow with the file, so that a long log is read and a bomb is not."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.foreign.regular_files import in_words

MOST_COLUMNS = 5_000
"""Columns of a table. JSBSim's fullest output has about a thousand; a header of a million is no flight."""
MOST_LINE = 1_000_000
"""Bytes of a table's header and first rows, each."""
MOST_COMMENT = 50_000_000
"""Bytes of a comment before the header, where a flight record keeps what is known of it."""


@dataclass(frozen=True)
class Limit:
    """base_s, bytes_per_s: time allowed; base_bytes, per_byte: memory above what the reader itself takes."""

    base_s: float
    bytes_per_s: float
    base_bytes: int
    per_byte: float

    def seconds(self, size: int) -> float:
        """Wall-clock time for a file of `size` bytes."""
        return self.base_s + size / self.bytes_per_s

    def bytes(self, size: int) -> int:
        """Memory for a file of `size` bytes; the values that are handed over may take as much."""
        return int(self.base_bytes + self.per_byte * size)


LIMITS = {
    # pyulog reads 10 to 40 MB/s and holds each topic twice while it decodes; a damaged length held it for minutes.
    "ulog": Limit(10.0, 1e6, 400_000_000, 8.0),
    # pymavlink decodes 2 to 4 MB/s; a packet of 25 bytes becomes up to ten numbers of 8.
    "tlog": Limit(10.0, 0.25e6, 300_000_000, 8.0),
    # pandas reads 20 to 100 MB/s; a cell of two characters becomes a number of 8 bytes, and is held twice on the way.
    "csv": Limit(10.0, 2e6, 400_000_000, 16.0),
    # Parquet packs: ten times is usual for a flight, thousands of times is a bomb.
    "parquet": Limit(10.0, 1e6, 600_000_000, 40.0),
}


def too_much(what: str, needed: float, allowed: float) -> str:
    """The sentence for a file that asks for more memory than one of its size should."""
    return (
        f"{what} would take {in_words(needed)} of memory; a file of its size may take {in_words(allowed)}: "
        "it is damaged or made to fill the memory; keep fewer rows and columns, or export it again"
    )
