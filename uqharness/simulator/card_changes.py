"""airframe.toml changed in place: the author's remarks, order and spacing stay."""

from __future__ import annotations

from pathlib import Path

import tomlkit
from tomlkit.exceptions import TOMLKitError

from uqharness.errors import BadInputError

DECIMALS = 7
"""Places of a metre that a sensor's position is written with."""


def sensors_from_cg(path: Path, forward_m: float, remark: str) -> None:
    """Positions in the card for a centre of gravity further forward by ``forward_m``; the sensors stay in the airframe.

    The card's positions are from the centre of gravity, x forward. Accelerometers without one sat at it. A folder without a card
    stays without. Raises BadInputError with the file where it is no TOML.
    """
    if not path.is_file():
        return
    try:
        card = tomlkit.parse(path.read_bytes().decode("utf-8"))
        sensors = card.setdefault("sensors", tomlkit.table())
        places = sensors.setdefault("position_m", tomlkit.inline_table())
        for name in dict.fromkeys(("accelerometer", *places)):
            x, *rest = (float(v) for v in places.get(name, (0.0, 0.0, 0.0)))
            places[name] = [round(x - forward_m, DECIMALS), *rest]
        if isinstance(places, tomlkit.items.InlineTable):
            places.comment(remark.replace("\n", " "))
    except (TOMLKitError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}") from None
    path.write_bytes(tomlkit.dumps(card).encode("utf-8"))
