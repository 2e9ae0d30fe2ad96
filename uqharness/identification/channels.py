"""Channels that identification compares, and their names as options give them."""

from __future__ import annotations

from uqharness.errors import BadInputError

OUTPUTS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
"""Channels that are compared. Height and heading follow from the others and drift in real sensors."""
BIASES = ("p_radps", "q_radps", "r_radps")
"""Channels whose sensors have a constant bias in each flight."""


def parse_channels(option: str, text: str | None) -> tuple[str, ...] | None:
    """Channel names of an option; short forms p, alpha, ax stand for p_radps, alpha_rad, ax_mps2; None where it was not given.

    Raises BadInputError.
    """
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
        raise BadInputError(
            f"{option} {text}: unknown channel {unknown[0]}; allowed are none, {', '.join((*further, *short))}"
        )
    return tuple(dict.fromkeys(names))
