"""Dialects of CSV logs: how the columns of one program are recognised and converted.

A user's file with column names of its own needs no dialect: `uqharness log map` writes a map, and
`--map` reads it. A dialect is for a program whose files everybody should be able to read without a
map. To add one, write an entry of `CSV_DIALECTS` and a map `sysid/logs/signal_maps/NAME.toml`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sysid.units import FT_M, KT_MPS, LBF_N, PSF_PA, SLUG_FT2_KGM2, SLUG_FT3_KGPM3, SLUG_KG


@dataclass(frozen=True)
class CsvDialect:
    """A CSV layout of one program.

    Attributes
    ----------
    name : str
        Name of the dialect, and of its map in signal_maps/.
    vehicle : str
        Name that a record shows.
    prefix : str
        Part of column names that is removed.
    is_header : callable
        Whether the column names of a file are those of this dialect.
    si_factor : callable
        Column name to the factor from its unit to SI.
    names_state_units : bool
        Whether all column names include their unit, so that values are in SI once read.
    """

    name: str
    vehicle: str = ""
    prefix: str = ""
    is_header: Callable[[Sequence[str]], bool] = lambda names: False
    si_factor: Callable[[str], float] = lambda name: 1.0
    names_state_units: bool = False

    def column_name(self, heading: object) -> str:
        """Return the column's name without blanks and without the dialect's prefix."""
        return str(heading).strip().removeprefix(self.prefix)


PLAIN = CsvDialect("csv")
"""A table of numbers with any names; a user's map says what they are."""


JSBSIM_HEADINGS = frozenset(
    {
        "V_{Total} (ft/s)",
        "V_{Inertial} (ft/s)",
        "P (deg/s)",
        "Phi (deg)",
        "Alpha (deg)",
        "Altitude ASL (ft)",
        "Aileron Command (norm)",
        "Rho (slugs/ft^3)",
        "F_{Total x} (lbs)",
    }
)
"""At least one heading of each group of JSBSim's <output> (FGOutputTextFile.cpp, version 1.3.3)."""


# Suffix of a JSBSim property to its factor into SI. Angles keep their unit; a map converts them.
_SUFFIXES = {
    "-ft_sec2": FT_M,
    "-fps_sec": FT_M,
    "-fps": FT_M,
    "-ft": FT_M,
    "-kts": KT_MPS,
    "-slugs_ft3": SLUG_FT3_KGPM3,
    "-lbs": LBF_N,
    "-lbs_ft2": PSF_PA,
    "-psf": PSF_PA,
    "-slugs": SLUG_KG,
    "-slug_ft2": SLUG_FT2_KGM2,
    # Headings of JSBSim's <output>.
    "(ft/s)": FT_M,
    "(ft)": FT_M,
    "(lbs)": LBF_N,
    "(psf)": PSF_PA,
    "(slugs/ft^3)": SLUG_FT3_KGPM3,
}
_FT_S2 = frozenset(f"BodyAccel_{axis}" for axis in "XYZ")
"""Headings of JSBSim's <output> without a unit, in ft/s2."""


def si_factor(name: str) -> float:
    """Return the factor from the unit of a JSBSim property or heading to SI; 1 for angles and
    unknown units.

    Examples
    --------
    >>> round(si_factor("velocities/vt-fps"), 3)
    0.305
    """
    if name in _FT_S2:
        return FT_M
    return next((f for s, f in _SUFFIXES.items() if name.endswith(s)), 1.0)


def is_jsbsim_name(name: str) -> bool:
    """Return whether a column is named as a JSBSim property or a heading of its <output>."""
    return "/" in name.split(" (")[0] or "fdm" in name or name in JSBSIM_HEADINGS


def _is_jsbsim_header(names: Sequence[str]) -> bool:
    """Return whether columns are those of JSBSim's <output type="CSV">, which starts with Time."""
    return names[0] == "Time" and any(is_jsbsim_name(name) for name in names)


CSV_DIALECTS: Mapping[str, CsvDialect] = {
    dialect.name: dialect
    for dialect in (
        PLAIN,
        CsvDialect(
            "jsbsim-csv",
            "JSBSim",
            "/fdm/jsbsim/",
            _is_jsbsim_header,
            si_factor,
            names_state_units=True,
        ),
    )
}


def csv_dialect_of(names: Sequence[str]) -> str:
    """Return the name of the dialect whose program wrote these column names; "csv" if none did."""
    return next((d.name for d in CSV_DIALECTS.values() if d.is_header(names)), PLAIN.name)
