"""Write a flight record to CSV, Parquet or DataFlash, whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from uqharness.errors import BadInputError
from uqharness.files import write_whole

if TYPE_CHECKING:
    import pandas as pd

    from uqharness.simulator import Aircraft

FORMATS = (".csv", ".parquet", ".bin")


def write_record(
    table: pd.DataFrame,
    path: Path,
    aircraft: Aircraft | None = None,
    start: Mapping[str, float] | None = None,
) -> tuple[str, ...]:
    """Write ``table`` by the path's suffix; the columns that the format has no place for.

    ``aircraft``, whose card turns surface angles into servo pulses, and ``start`` (lat_deg, lon_deg, alt_m) serve DataFlash alone.
    Raises BadInputError for another suffix, a folder that cannot be written, or a card without servo tables.
    """
    if path.suffix not in FORMATS:
        raise BadInputError(
            f"--out {path}: the format follows the name's ending, {', '.join(FORMATS)}; received '{path.suffix}'"
        )
    if path.suffix == ".bin":
        return _write_dataflash(table, path, aircraft, start or {})
    if path.suffix == ".csv":
        # repr round trip: 17 digits bring every double back.
        write_whole(
            path,
            lambda target: table.to_csv(
                target, index=False, float_format="%.17g", lineterminator="\n"
            ),
        )
    else:
        write_whole(path, lambda target: table.to_parquet(target, index=False))
    return ()


def _write_dataflash(
    table: pd.DataFrame, path: Path, aircraft: Aircraft | None, start: Mapping[str, float]
) -> tuple[str, ...]:
    from sysid.errors import LogError
    from sysid.logs import read_card, write_dataflash
    from sysid.record import FlightRecord, Metadata
    from sysid.vocabulary import SIGNALS

    known = {str(name): table[name].to_numpy() for name in table.columns if name in SIGNALS}
    left: list[str] = [str(name) for name in table.columns if name not in SIGNALS]
    try:
        card = (
            read_card(aircraft.folder)
            if aircraft is not None and (aircraft.folder / "airframe.toml").is_file()
            else None
        )
        record = FlightRecord(known, Metadata(dialect="simulation", start=dict(start)))
        write_whole(
            path, lambda target: left.extend(write_dataflash(record, target, card, surfaces=True))
        )
    except LogError as error:
        raise BadInputError(str(error)) from None
    return tuple(left)
