"""Where the ``uqharness`` command starts, and ``python -m uqharness``.

Every process that is spawned reads the file its parent was started from: what this file imports, each worker of a campaign
imports as well, and the command line with all its commands would be 130 MB and more than a second in each of them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the process's exit code."""
    from uqharness.cli import main as command_line

    return command_line(argv)


if __name__ == "__main__":
    sys.exit(main())
