"""Channel names as options give them."""

from __future__ import annotations

from uqharness.errors import BadInputError


def parse_channels(option: str, text: str | None) -> tuple[str, ...] | None:
    """Channel names of an option; short forms p, alpha, ax stand for p_radps, alpha_rad, ax_mps2; None where it was not given.

    Raises BadInputError.
    """
    from uqharness.identification.identify import OUTPUTS
    from uqharness.replay import CONTROL_DELAY

    if text is None:
        return None
    if text in ("none", ""):
        return ()
    short = {c.split("_")[0]: c for c in OUTPUTS}
    names = [short.get(n.strip(), n.strip()) for n in text.split(",")]
    further = (CONTROL_DELAY,) if option == "--delays" else ()
    unknown = [n for n in names if n not in (*OUTPUTS, *further)]
    if unknown:
        raise BadInputError(f"{option} {text}: unknown channel {unknown[0]}; allowed are none, {', '.join((*further, *short))}")
    return tuple(dict.fromkeys(names))
