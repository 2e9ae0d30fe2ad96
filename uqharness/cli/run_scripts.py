"""Write the run scripts of the identification flights: ``python -m uqharness.cli.run_scripts
scripts``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from uqharness.files import write_bytes
from uqharness.simulator import PLANS, script


def main(arguments: Sequence[str] | None = None) -> int:
    """Write one script a plan; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where to write flight-*.xml")
    folder = parser.parse_args(arguments).folder
    for plan in PLANS:
        write_bytes(folder / f"{plan.name}.xml", script(plan).encode())
        print(f"{folder / plan.name}.xml: {len(plan.manoeuvres)} manoeuvres, {plan.end_s:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
