"""One definition of each result: what is printed, stored, read again and described by a schema."""

DOCUMENTS: dict[str, str] = {
    "bounds": "identification:Bounds",
    "compare": "identification:Compare",
    "identify": "identification:Fit",
    "validate-bounds": "identification:Coverage",
}
"""Command, with "-" for blanks, to the model of what it prints with ``--json`` (module:class)."""
