"""The tables of a campaign's folder: no byte of one is believed before its digest is what the manifest says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.digests import sha256_hex
from sysid.foreign.regular_files import read_regular
from uqharness.campaign.folder.case_table import CASES, checked_table
from uqharness.campaign.folder.digests import DamageError
from uqharness.campaign.folder.engine_file import ENGINE_CHECK, CheckRow, read_check
from uqharness.campaign.folder.manifest import has_digests, read_manifest, write_manifest
from uqharness.campaign.folder.manifest_content import COMPLETE
from uqharness.campaign.rounds import DECISIONS, decision_rows
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.parquet_files import parse_table

if TYPE_CHECKING:
    import pandas as pd

TABLE_NAMES = (
    CASES,
    "pbox.parquet",
    "excursions.csv",
    "statements.csv",
    DECISIONS,
    "sensitivity.csv",
    "convergence.csv",
    "area.csv",
    ENGINE_CHECK,
)
"""Names of the tables that a campaign's folder may have."""
MOST_BYTES = 1_000_000_000
"""A table of a million flights has a third of it."""
_MOST_TEXT_BYTES = 64_000_000


def is_sealed(manifest: Mapping[str, Any]) -> bool:
    """Whether the manifest holds the digests of all tables there are: of a complete campaign, not of uqharness 0.1."""
    return has_digests(manifest) and manifest["state"] == COMPLETE


def table_digests(folder: Path, manifest: Mapping[str, Any]) -> dict[str, str | None]:
    """Digest of each table that the manifest names as it is on the disk now; None for one that is not there.

    Raises BadInputError for one that cannot be read.
    """
    found: dict[str, str | None] = {}
    for name in manifest.get("tables", {}):
        try:
            found[name] = sha256_hex(read_regular(folder / name, MOST_BYTES))
        except FileNotFoundError:
            found[name] = None
        except OSError as error:
            raise BadInputError(
                f"{folder / name}: cannot be read: {error.strerror or error}"
            ) from None
    return found


def read_checked(folder: Path, manifest: Mapping[str, Any], name: str) -> bytes:
    """Bytes of a table of a campaign. Raises BadInputError where it is not there, DamageError where it is not as it was written."""
    path = folder / name
    try:
        content = read_regular(path, MOST_BYTES if path.suffix == ".parquet" else _MOST_TEXT_BYTES)
    except FileNotFoundError:
        raise BadInputError(
            f"{path}: not there; run the campaign first: uqharness campaign run"
        ) from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if is_sealed(manifest):
        expected = manifest.get("tables", {}).get(name)
        if expected is None:
            raise DamageError(
                path,
                "the manifest knows of no such table; the command that wrote it writes it again",
                folder,
            )
        if sha256_hex(content) != expected:
            raise DamageError(path, "its content does not fit the digest in the manifest", folder)
    return content


def read_cases(folder: Path, manifest: Mapping[str, Any]) -> pd.DataFrame:
    """Flights of a complete campaign, with every column that such a table has. Raises BadInputError."""
    path = folder / CASES
    table = parse_table(read_checked(folder, manifest, CASES), path, int(manifest["cases"]))
    return checked_table(table, path, manifest["campaign"]).to_pandas()


def read_decisions(folder: Path, manifest: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows of decisions.csv, as text; none where the campaign has no such table. Raises BadInputError."""
    known = is_sealed(manifest)
    if DECISIONS not in manifest.get("tables", {}) if known else not (folder / DECISIONS).exists():
        return []
    return decision_rows(read_checked(folder, manifest, DECISIONS), folder / DECISIONS)


def read_engine_check(folder: Path, manifest: Mapping[str, Any]) -> list[CheckRow]:
    """Rows of engine-check.csv; none where the campaign has no such file.

    Raises BadInputError where it is lost or damaged.
    """
    if ENGINE_CHECK in manifest.get("tables", {}):
        read_checked(folder, manifest, ENGINE_CHECK)
    return read_check(folder)


def record_table(folder: Path, name: str, content: bytes) -> None:
    """Write a table that a command adds to a complete campaign's folder, and its digest into the manifest. Raises BadInputError."""
    write_bytes(folder / name, content)
    manifest = read_manifest(folder)
    if has_digests(manifest):
        tables = manifest.get("tables", {}) | {name: sha256_hex(content)}
        if tables != manifest.get("tables"):
            write_manifest(folder, manifest | {"tables": tables})
