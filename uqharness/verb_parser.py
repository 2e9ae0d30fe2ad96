"""What the verbs of ``uqharness campaign`` have in common on the command line."""

from __future__ import annotations

import argparse
from typing import Any


def add_verb(verbs: Any, name: str, text: str, example: str) -> argparse.ArgumentParser:
    """A verb with its help, an example and ``--json``."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    return parser
