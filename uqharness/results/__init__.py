"""One definition of each result: what is printed, stored, read again and described by a schema."""

DOCUMENTS: dict[str, str] = {
    "bounds": "identification:Bounds",
    "completion": "folders:CompletionScript",
    "dossier": "folders:DossierFile",
    "refine": "refinement:Refinement",
    "report": "folders:ReportFile",
}
"""Command, with "-" for blanks, to the model of its document, ``module:Class``."""
