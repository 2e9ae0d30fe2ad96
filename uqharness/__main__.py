"""Where the ``uqharness`` command starts, and ``python -m uqharness``.

Every process that is spawned reads the file its parent was started from: what this file imports,
each worker of a campaign imports as well, and the command line with all its commands would be 130
MB and more than a second in each of them."""

import os
import sys


def _leave_working_folder() -> None:
    """Take the working folder, which ``python -m`` puts first, off the path: a ``socket.py`` there
    is not Python's own.

    It stays if this package lives there.
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
    _leave_working_folder()


def main(argv: list[str] | None = None) -> int:
    """Run one command; the process's exit code."""
    try:
        from uqharness.cli import run
    except KeyboardInterrupt:
        os.write(2, b"uqharness: interrupted\n")
        os._exit(130)
    return run(argv)


if __name__ == "__main__":
    sys.exit(main())
