"""What a channel in a wrong unit or of the wrong sign would spoil, and the lines of a signal map that mend it."""

from __future__ import annotations

import re

from sysid.logs.signal_map import shipped_dialects, shipped_map
from sysid.record import Metadata
from sysid.vocabulary import SURFACES

_SPOILS = {
    "V_mps": "dynamic pressure goes with its square: every coefficient and derivative, trim, thrust, dimensionless rates",
    "alpha_rad": "every derivative by alpha, lift and drag slopes, static stability",
    "beta_rad": "every derivative by beta: side force, weathercock and dihedral effects",
    "h_m": "air density, energy, the height errors of a loiter",
    "a": "every force coefficient, the path reconstruction, the lever arm",
    "attitude": "gravity's part in every force, the replay's start state, the path reconstruction",
    "rates": "damping and control derivatives, angular accelerations, thus every moment coefficient",
    "ground": "wind, the path reconstruction, checks of the accelerometers",
    "surface": "the surface's derivatives change sign or size with it, and a replay departs",
}


def spoils(channel: str) -> str:
    """What comes out wrong with this channel."""
    if channel in _SPOILS:
        return _SPOILS[channel]
    if channel.endswith("_radps"):
        return _SPOILS["rates"]
    if channel.endswith("_mps2"):
        return _SPOILS["a"]
    if channel.removesuffix("_pos_deg") + "_deg" in SURFACES or channel in SURFACES:
        return _SPOILS["surface"]
    return _SPOILS["attitude" if channel.endswith("_rad") else "ground"]


def mend(channel: str, factor: float, meta: Metadata) -> str:
    """Lines of a signal map after which the channel is ``factor`` times what it is now."""
    label = meta.channels.get(channel, "")
    shipped = (
        shipped_map(meta.dialect.removesuffix("-text"))
        if meta.dialect.removesuffix("-text") in shipped_dialects()
        else None
    )
    entries = () if shipped is None else shipped.entries.get(channel, ())
    # A label such as "ARSP[1].Airspeed" names the instance that was read, "ARSP[0,1]" those read in turn.
    name = re.match(r"(\w+)\[([\d,]+)\](\..*)", label)
    shipped_label = label if name is None else name[1] + name[3]
    instance = name[2] if name is not None and "," not in name[2] else ""
    for entry in entries:
        if shipped_label == entry.label:
            fields = (
                f'field = "{entry.fields[0]}"'
                if len(entry.fields) == 1
                else f"fields = {_listed(entry.fields)}"
            )
            extra = "" if entry.function == "value" else f'\nfunction = "{entry.function}"'
            extra += "" if entry.times is None else f"\ntimes = {_listed(entry.times)}"
            extra += f"\ninstance = {instance}" if instance else ""
            return f'[signals.{channel}]\nmessage = "{entry.message}"\n{fields}\nscale = {factor * entry.scale:.6g}{extra}'
    if not label or label == "column":
        return f'[signals.{channel}]\nmessage = "csv"\nfield = "{channel}"\nscale = {factor:.6g}'
    if "servo" in label:
        return f"in the card, [inputs.{channel.split('_')[0]}] servo_pwm: every angle times {factor:.6g}"
    return f"[signals.{channel}] ({label}): multiply its scale, or every value of its table, by {factor:.6g}"


def _listed(names: tuple[str, ...]) -> str:
    return "[" + ", ".join(f'"{n}"' for n in names) + "]"
