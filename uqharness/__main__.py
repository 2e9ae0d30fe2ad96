"""Entry point of the ``uqharness`` command and of ``python -m uqharness``.

Every spawned process reads the file that its parent was started from, with all its imports. The
command line with all commands would cost each worker 130 MB and more than a second, so this file
imports it only when it runs.
"""

import os
import sys


def _leave_working_folder() -> None:
    """Remove the working folder, which ``python -m`` puts first, from the import path.

    A ``socket.py`` there would replace Python's own. The folder stays if this package lives in it.
    """
    package_root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if (
        sys.path
        and not sys.flags.safe_path
        and sys.path[0] in ("", os.getcwd())
        and os.getcwd() != package_root
    ):
        del sys.path[0]


if __name__ == "__main__":
    # Before anything else is imported.
    # Before any other import.
    _leave_working_folder()


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code."""
    try:
        from uqharness.cli import run
    except KeyboardInterrupt:
        os.write(2, b"uqharness: interrupted\n")
        os._exit(130)
    return run(argv)


if __name__ == "__main__":
    sys.exit(main())
