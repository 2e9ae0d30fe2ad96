"""manifest.json: what a campaign folder belongs to, and the refusal to mix two campaigns in one folder."""

from __future__ import annotations

import contextlib
import json
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import uqharness
from sysid.foreign.regular_files import read_regular
from uqharness.campaign.cases import Mission
from uqharness.campaign.folder.digests import DamageError, digest_of_text
from uqharness.campaign.folder.manifest_content import (
    COMPLETE,
    FORMAT,
    FORMAT_WITHOUT_DIGESTS,
    RUNNING,
    checked_content,
)
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.campaign.spec.read import campaign_from
from uqharness.errors import BadInputError
from uqharness.files import write_bytes

MANIFEST = "manifest.json"
_MOST_BYTES = 16_000_000

# A change in one of these may change a flight; the others are recorded for the reader.
_BINDING_VERSIONS = ("uqharness", "jsbsim", "numpy")
_RECORDED_VERSIONS = ("scipy", "pyarrow", "pandas", "llvmlite")


def versions() -> dict[str, str]:
    """Versions of this program, of what it flies with and of what writes its tables."""
    found = {"uqharness": uqharness.__version__, "python": platform.python_version()}
    for name in (*_BINDING_VERSIONS[1:], *_RECORDED_VERSIONS):
        # llvmlite may be left out.
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def binding_versions() -> tuple[tuple[str, str], ...]:
    """Names and versions of what must be alike wherever flights of one campaign are flown."""
    found = versions()
    return tuple((name, found[name]) for name in _BINDING_VERSIONS)


def describe(spec: CampaignSpec, mission: Mission, cases: int, command: str) -> dict[str, Any]:
    """Manifest of a campaign that is about to run."""
    inputs = spec.inputs
    bounds = {"confidence": inputs.confidence, "transient": list(inputs.transient_rates)}
    return {
        "format": FORMAT,
        "state": RUNNING,
        "command": command,
        "seed": spec.campaign.seed,
        "cases": cases,
        "campaign": spec.as_dict(),
        "campaign_file": str(spec.path.resolve()),
        "versions": versions(),
        "hashes": {
            "aircraft": mission.aircraft_hash,
            "script": mission.script_hash,
            **inputs.hashes,
        },
        **({} if inputs.confidence is None else {"bounds": bounds}),
    }


def spec_of(manifest: Mapping[str, Any]) -> CampaignSpec:
    """The campaign that a manifest describes. Raises BadInputError, if a file it names has gone for one."""
    return campaign_from(manifest["campaign"], Path(manifest.get("campaign_file", "campaign.toml")))


def read_manifest(folder: Path) -> dict[str, Any]:
    """Manifest of a campaign folder, every part of it checked.

    Raises BadInputError if there is none or it is another program's; DamageError, which is one, if it is not as it was written.
    """
    path = folder / MANIFEST
    try:
        content = read_regular(path, _MOST_BYTES)
    except FileNotFoundError:
        raise BadInputError(
            f"{folder}: not a campaign folder (no {MANIFEST}); make one with: uqharness campaign run CAMPAIGN.toml --out DIR"
        ) from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        return _parsed(content, path)
    except (ValueError, RecursionError) as error:
        text = str(error) if isinstance(error, ValueError) else "nested too deeply"
        raise DamageError(path, " ".join(text.split()), folder) from None


def _parsed(content: bytes, path: Path) -> dict[str, Any]:
    """ValueError for damage, BadInputError for what this program did not write."""
    try:
        manifest = json.loads(content.decode("utf-8"))
    except UnicodeDecodeError:
        raise ValueError("not text in UTF-8") from None
    except ValueError as error:
        raise ValueError(f"not JSON: {error}") from None
    known = (FORMAT, FORMAT_WITHOUT_DIGESTS)
    if (
        not isinstance(manifest, dict)
        or type(found := manifest.get("format")) is not int
        or found not in known
    ):
        raise BadInputError(f"{path}: written by another version of uqharness, or not by uqharness")
    digest = manifest.pop("digest", None)
    if digest != (digest_of_text(manifest) if found == FORMAT else None):
        raise ValueError("its content does not fit its digest")
    return checked_content(manifest)


def has_digests(manifest: Mapping[str, Any]) -> bool:
    """Whether the folder's journal and tables can be held against digests; not those of uqharness 0.1."""
    return bool(manifest["format"] != FORMAT_WITHOUT_DIGESTS)


def refuse_without_digests(folder: Path, manifest: Mapping[str, Any]) -> None:
    """BadInputError for a folder of uqharness 0.1: it may be read, but nothing may be flown into it."""
    if not has_digests(manifest):
        raise BadInputError(
            f"{folder}: made by uqharness 0.1, whose flights carry no digests: finish it there, or fly it anew with another --out"
        )


def read_complete(folder: Path) -> dict[str, Any]:
    """Manifest of a campaign folder whose flights are all done. Raises BadInputError, also where some are missing."""
    manifest = read_manifest(folder)
    if manifest["state"] != COMPLETE:
        command = manifest["command"] or "the command that began it"
        raise BadInputError(
            f"{folder}: the campaign is not complete; finish it first with: {command}"
        )
    return manifest


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write it, with a digest over its content, whole or not at all."""
    content = {**manifest, "digest": digest_of_text(dict(manifest))}
    write_bytes(folder / MANIFEST, (json.dumps(content, indent=2) + "\n").encode())


def refuse_if_different(
    folder: Path, old: Mapping[str, Any], new: Mapping[str, Any], but_for: tuple[str, ...] = ()
) -> None:
    """BadInputError naming every difference that makes the folder's flights no part of the campaign now asked for.

    Versions and hashes named in ``but_for`` may differ.
    """
    differences = [
        f"{name} {old['versions'].get(name)} then, {new['versions'].get(name)} now"
        for name in _BINDING_VERSIONS
        if name not in but_for and old["versions"].get(name) != new["versions"].get(name)
    ]
    was, now = _flat(old["campaign"]), _flat(new["campaign"])
    for key in sorted(was.keys() | now.keys()):
        if key == "campaign.engine" and now.get(key, "auto") == "auto":
            continue  # whichever flew before
        if key not in ("campaign.aircraft", "campaign.mission") and was.get(key) != now.get(key):
            section, _, name = key.partition(".")
            differences.append(
                f"[{section}] {name} was {json.dumps(was.get(key))}, is {json.dumps(now.get(key))}"
            )
    for name, setting in (("aircraft", "aircraft"), ("script", "mission")):
        before, after = old["hashes"][name], new["hashes"][name]
        if name not in but_for and before != after:
            what = now.get(f"campaign.{setting}")
            differences.append(
                f"the content of the {name} ({what}) has changed: {before[:12]} then, {after[:12]} now"
            )
    for role in sorted((old["hashes"].keys() | new["hashes"].keys()) - {"aircraft", "script"}):
        before, after = (
            hashes.get(role, "absent")[:12] for hashes in (old["hashes"], new["hashes"])
        )
        if before != after:
            differences.append(
                f"the content of the file named as {role} has changed: {before} then, {after} now"
            )
    if differences:
        raise BadInputError(
            f"{folder}: this folder holds another campaign: {'; '.join(differences)}. Choose another --out, or restore what changed"
        )


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
