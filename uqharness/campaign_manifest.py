"""manifest.json: what a campaign folder belongs to, and the refusal to mix two campaigns in one folder."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import uqharness
from uqharness.campaign_spec import CampaignSpec, campaign_from
from uqharness.cases import Mission
from uqharness.errors import BadInputError
from uqharness.whole_files import write_bytes

MANIFEST = "manifest.json"
SPOILT = "spoilt"
"""State of a folder whose aircraft or script was edited while it flew."""

_FORMAT = 1
# A change in one of these may change a flight; the others are recorded for the reader.
_BINDING_VERSIONS = ("uqharness", "jsbsim", "numpy")
_RECORDED_VERSIONS = ("scipy", "pyarrow", "pandas")


def versions() -> dict[str, str]:
    """Versions of this program, of what it flies with and of what writes its tables."""
    found = {"uqharness": uqharness.__version__, "python": platform.python_version()}
    for name in (*_BINDING_VERSIONS[1:], *_RECORDED_VERSIONS):
        found[name] = metadata.version(name)
    return found


def binding_versions() -> tuple[tuple[str, str], ...]:
    """Names and versions of what must be alike wherever flights of one campaign are flown."""
    found = versions()
    return tuple((name, found[name]) for name in _BINDING_VERSIONS)


def describe(spec: CampaignSpec, mission: Mission, cases: int, command: str) -> dict[str, Any]:
    """Manifest of a campaign that is about to run."""
    return {
        "format": _FORMAT,
        "state": "running",
        "command": command,
        "seed": spec.campaign.seed,
        "cases": cases,
        "campaign": spec.as_dict(),
        "campaign_file": str(spec.path.resolve()),
        "versions": versions(),
        "hashes": {"aircraft": mission.aircraft_hash, "script": mission.script_hash, **spec.inputs.hashes},
    }


def spec_of(manifest: Mapping[str, Any]) -> CampaignSpec:
    """The campaign that a manifest describes. Raises BadInputError, if a file it names has gone for one."""
    return campaign_from(manifest["campaign"], Path(manifest.get("campaign_file", "campaign.toml")))


def read_manifest(folder: Path) -> dict[str, Any]:
    """Manifest of a campaign folder. Raises BadInputError if there is none or it cannot be read."""
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadInputError(
            f"{folder}: not a campaign folder (no {MANIFEST}); "
            "make one with: uqharness campaign run CAMPAIGN.toml --out DIR"
        ) from None
    except (OSError, ValueError) as error:
        raise BadInputError(f"{path}: cannot be read: {error}") from None
    if not isinstance(manifest, dict) or manifest.get("format") != _FORMAT:
        raise BadInputError(f"{path}: written by another version of uqharness, or not by uqharness")
    return manifest


def read_complete(folder: Path) -> dict[str, Any]:
    """Manifest of a campaign folder whose flights are all done. Raises BadInputError, also where some are missing."""
    manifest = read_manifest(folder)
    if manifest["state"] != "complete":
        command = manifest["command"] or "the command that began it"
        raise BadInputError(f"{folder}: the campaign is not complete; finish it first with: {command}")
    return manifest


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write it whole or not at all."""
    write_bytes(folder / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())


def refuse_if_different(folder: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """BadInputError naming every difference that makes the folder's flights no part of the campaign now asked for."""
    differences = [
        f"{name} {old['versions'].get(name)} then, {new['versions'].get(name)} now"
        for name in _BINDING_VERSIONS
        if old["versions"].get(name) != new["versions"].get(name)
    ]
    was, now = _flat(old["campaign"]), _flat(new["campaign"])
    for key in sorted(was.keys() | now.keys()):
        if key not in ("campaign.aircraft", "campaign.mission") and was.get(key) != now.get(key):
            section, _, name = key.partition(".")
            differences.append(f"[{section}] {name} was {json.dumps(was.get(key))}, is {json.dumps(now.get(key))}")
    for name, setting in (("aircraft", "aircraft"), ("script", "mission")):
        before, after = old["hashes"][name], new["hashes"][name]
        if before != after:
            what = now.get(f"campaign.{setting}")
            differences.append(f"the content of the {name} ({what}) has changed: {before[:12]} then, {after[:12]} now")
    for role in sorted((old["hashes"].keys() | new["hashes"].keys()) - {"aircraft", "script"}):
        before, after = (hashes.get(role, "absent")[:12] for hashes in (old["hashes"], new["hashes"]))
        if before != after:
            differences.append(f"the content of the file named as {role} has changed: {before} then, {after} now")
    if differences:
        raise BadInputError(
            f"{folder}: this folder holds another campaign: {'; '.join(differences)}. "
            "Choose another --out, or restore what changed"
        )


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
