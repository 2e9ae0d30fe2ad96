"""The end of a campaign: digests of its journal and tables in the manifest, and whether they still fit."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.digests import sha256_hex
from sysid.foreign.regular_files import read_regular
from uqharness import checksums
from uqharness.campaign.cases import Case
from uqharness.campaign.folder.digests import DamageError
from uqharness.campaign.folder.engine_file import ENGINE_CHECK, MOST_CHECK_BYTES
from uqharness.campaign.folder.files import TABLE_NAMES, table_digests
from uqharness.campaign.folder.manifest import MANIFEST, write_manifest
from uqharness.campaign.folder.manifest_content import COMPLETE
from uqharness.campaign.folder.store import JOURNAL, Store
from uqharness.campaign.folder.tables import make_tables, write_tables
from uqharness.campaign.rounds import Rounds
from uqharness.campaign.spec.campaign import CampaignSpec


def sealed(
    manifest: Mapping[str, Any], store: Store, tables: Mapping[str, bytes]
) -> dict[str, Any]:
    """The manifest of a campaign that is complete now: with digests of the journal's flights and of the tables."""
    digests = dict(manifest.get("tables", {})) | {
        name: sha256_hex(content) for name, content in tables.items()
    }
    check = store.folder / ENGINE_CHECK
    with contextlib.suppress(OSError):
        digests[ENGINE_CHECK] = sha256_hex(read_regular(check, MOST_CHECK_BYTES))
    ending = {"state": COMPLETE, "tables": digests, "journal": store.summary()}
    return {**manifest, **ending, "sums": checksums.SUMS}


def seal_files(folder: Path, earlier: checksums.Earlier | None = None) -> None:
    """Write SHA256SUMS of a complete campaign's folder, the last file that a run writes. Raises BadInputError."""
    damaged = {} if earlier is None else dict(earlier.damaged)
    for name in (MANIFEST, JOURNAL, *TABLE_NAMES):
        damaged.pop(name, None)  # they have just been held against digests of their own, or written
    checksums.write_sums(folder, checksums.Earlier(damaged))


def refuse_if_not_whole(folder: Path, store: Store, manifest: Mapping[str, Any]) -> None:
    """DamageError where the journal of a complete campaign is not the one that the manifest lists."""
    store.finished()
    if store.summary() != manifest["journal"]:
        raise DamageError(
            folder / JOURNAL, "its flights are not those that the manifest lists", folder
        )


def mend_tables(
    folder: Path,
    manifest: Mapping[str, Any],
    spec: CampaignSpec,
    cases: Sequence[Case],
    store: Store,
) -> tuple[str, ...]:
    """Write the tables of a complete campaign again if one is not as it was written; names of those that were not.

    The journal must be whole. A table of another command (sensitivity.csv) is left as it is.
    """
    written = manifest.get("tables", {})
    damaged = {
        name for name, digest in table_digests(folder, manifest).items() if digest != written[name]
    }
    if not damaged:
        return ()
    rounds = Rounds(spec, cases, None)
    for _ in rounds(store):
        pass
    tables = make_tables(spec, cases, store.outcomes(), rounds.decisions)
    if not damaged & set(tables):
        return ()
    # Another version of a library may write other bytes of the same content: then all of them belong together.
    write_tables(folder, tables)
    write_manifest(folder, sealed(manifest, store, tables))
    return tuple(name for name in tables if name in damaged)
