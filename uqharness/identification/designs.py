"""How the polynomials of bounds are written on the command line: --states, --terms, --order, --roll-terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from uqharness.errors import BadInputError

if TYPE_CHECKING:
    from sysid.model_form import Design

_SHORT = {
    "V": "V_mps",
    "alpha": "alpha_rad",
    "beta": "beta_rad",
    "phi": "phi_rad",
    "theta": "theta_rad",
    "p": "p_radps",
    "q": "q_radps",
    "r": "r_radps",
    "de": "elevator_pos_deg",
    "da": "aileron_pos_deg",
    "dr": "rudder_pos_deg",
    "dt": "throttle_pct",
}


def parse_designs(
    states: Sequence[str], terms: Sequence[str], order: int, roll_terms: bool
) -> dict[str, Design]:
    """Designs from --states, --terms, --order and --roll-terms. Raises BadInputError."""
    from sysid.aerodynamics import parse_term
    from sysid.aerodynamics.polynomial import STATES
    from sysid.model_form import Design, default_designs

    designs = {c: Design(d.states, None, order) for c, d in default_designs().items()}
    if roll_terms:
        designs["Cm"] = Design((*designs["Cm"].states, "p_radps"), None, order)
    for text in states:
        coefficient, names = _assignment("--states", text, list(designs))
        unknown = [n for n in names if _SHORT.get(n, n) not in STATES]
        if unknown or len(set(names)) < len(names):
            raise BadInputError(
                f"--states {text}: {f'unknown state {unknown[0]}' if unknown else 'a state is named twice'}; "
                f"allowed are {', '.join(_SHORT)}"
            )
        designs[coefficient] = Design(tuple(_SHORT.get(n, n) for n in names), None, order)
    for text in terms:
        coefficient, names = _assignment("--terms", text, list(designs))
        written = ["*".join(_long(f) for f in name.split("*")) for name in names]
        used = tuple(
            s
            for s in STATES
            if any(s == f.split("^")[0] for name in written for f in name.split("*"))
        )
        try:
            chosen = tuple(parse_term(name, used) for name in written)
        except ValueError as error:
            raise BadInputError(
                f"--terms {text}: {error}; states are {', '.join(_SHORT)}"
            ) from None
        if len(set(chosen)) < len(chosen) or not used:
            raise BadInputError(
                f"--terms {text}: {'a term is named twice' if used else 'no term depends on a state'}"
            )
        designs[coefficient] = Design(used, chosen)
    return designs


def _long(factor: str) -> str:
    state, caret, power = factor.strip().partition("^")
    return f"{_SHORT.get(state, state)}{caret}{power}"


def _assignment(option: str, text: str, known: list[str]) -> tuple[str, list[str]]:
    coefficient, equals, rest = text.partition("=")
    names = [n.strip() for n in rest.split(",") if n.strip()]
    if not equals or not names or coefficient not in known:
        raise BadInputError(
            f"{option} {text}: C=name,name with C one of {', '.join(known)} is needed, such as {option} CX=V,alpha"
        )
    return coefficient, names
