"""One definition of each result: what is printed, stored, read again and described by a schema."""

DOCUMENTS: dict[str, str] = {
    "bounds": "identification:Bounds",
    "diff": "simulation:Differences",
    "fly": "simulation:FlownFlight",
    "instrument": "simulation:PluginOutcome",
    "log-export": "logs:Playback",
    "log-import": "logs:ImportedLog",
    "log-info": "logs:LogContents",
    "log-map": "logs:ProposedMap",
    "margins": "simulation:Margins",
    "modes": "simulation:Modes",
}
"""Command, its words joined by "-", to the model of what it prints with ``--json``."""
