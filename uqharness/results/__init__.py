"""One definition of each result: what is printed, stored, read again and described by a schema."""

DOCUMENTS: dict[str, str] = {
    "bounds": "identification:Bounds",
    "export": "exchange:Loss",
}
"""Command, its words joined by "-", to the model of what it prints with ``--json``."""
