"""One importer per log format, each `read(path, wanted, progress) -> RawLog`; `detect` finds the format by content."""
