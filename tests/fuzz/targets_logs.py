"""Flight logs and tables of samples: what ``log info`` and ``log import`` read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.damage_bytes import damaged
from tests.fuzz.damage_tables import parquet_damage
from tests.fuzz.damage_text import damaged_table, damaged_text
from tests.fuzz.formats import Format, Mutator
from tests.fuzz.outcome import command


def _read(name: str, *options: str) -> Callable[[Path, int], None]:
    """``log info`` or ``log import`` of one file, with and without the card."""

    def run(folder: Path, seed: int) -> None:
        log = str(folder / name)
        more = [
            str(folder / option) if option.endswith((".toml", ".csv")) else option
            for option in options
        ]
        if seed % 3:
            command(
                "log",
                "info",
                log,
                "--no-cache",
                *(["--json"] if seed % 2 else []),
                *_without_times(more),
            )
        else:
            command(
                "log",
                "import",
                log,
                "--no-cache",
                "--out",
                str(folder / ("out.csv" if seed % 2 else "out.parquet")),
                *more,
            )

    return run


def _without_times(options: list[str]) -> list[str]:
    """``log info`` takes no --manoeuvres."""
    if "--manoeuvres" not in options:
        return options
    at = options.index("--manoeuvres")
    return options[:at] + options[at + 2 :]


def _log(kind: str, mutate: Mutator, share: float = 1.0) -> Format:
    # Renamed: the content tells what it is.
    source = {"flight.dat": f"logs/flight.{kind}", "airframe.toml": "aircraft/dart/airframe.toml"}
    sources = (
        (*(source,) * 9, source | {"flight.dat": "logs/bomb.parquet"})
        if kind == "parquet"
        else (source,)
    )
    return Format(
        f"log-{kind}",
        sources,
        ("flight.dat",),
        mutate,
        _read("flight.dat", "--aircraft", "airframe.toml"),
        share,
    )


def _text_log(data: bytes, rng: np.random.Generator) -> bytes:
    return damaged_text(data, rng) if rng.random() < 0.7 else damaged(data, rng)


def _manoeuvres(folder: Path, seed: int) -> None:
    command(
        "log",
        "import",
        str(folder / "flight.parquet"),
        "--no-cache",
        "--out",
        str(folder / "out.parquet"),
        "--manoeuvres",
        str(folder / "manoeuvres.csv"),
    )


_MAPPED = {"map.toml": "settings/map.toml"}

_TABLES = (
    *({"table.parquet": "logs/table.parquet", **_MAPPED},) * 9,
    {"table.parquet": "logs/bomb-of-table.parquet", **_MAPPED},
)
FORMATS = (
    _log("bin", damaged),
    _log("log", _text_log),
    _log("tlog", damaged),
    _log("ulg", damaged),
    _log("csv", damaged_table),
    _log("jsbsim", damaged_table),
    _log("parquet", parquet_damage),
    Format(
        "mapped-csv",
        ({"table.csv": "logs/table.csv", **_MAPPED},),
        ("table.csv",),
        damaged_table,
        _read("table.csv", "--map", "map.toml"),
    ),
    Format(
        "mapped-parquet",
        _TABLES,
        ("table.parquet",),
        parquet_damage,
        _read("table.parquet", "--map", "map.toml"),
    ),
    Format(
        "manoeuvres",
        ({"manoeuvres.csv": "settings/manoeuvres.csv", "flight.parquet": "logs/flight.parquet"},),
        ("manoeuvres.csv",),
        damaged_table,
        _manoeuvres,
    ),
)
"""Importers, tables under a user's map, tables of manoeuvres."""
