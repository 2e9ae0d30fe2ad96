"""How a campaign's command ends: exit codes, and one line for a person instead of a traceback."""

from __future__ import annotations

import sys
from collections.abc import Callable

from uqharness.errors import BadInputError, EnginesDifferError


def ending(act: Callable[[], int]) -> int:
    """Exit code of ``act``: its own; 2 for bad input, 1 where the engines differ, both with their sentence on stderr; 130
    interrupted."""
    try:
        return act()
    except BadInputError as error:
        print(f"reproduce: error: {error}", file=sys.stderr)
        return 2
    except EnginesDifferError as error:
        print(f"reproduce: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
