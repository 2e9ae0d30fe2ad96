"""Read and write manifest.json, which says what campaign a folder belongs to.

The manifest holds settings, versions, hashes of the inputs and, once the campaign is complete,
digests of journal and tables. It is validated before use and carries a digest of itself, so damage
is detected. `refuse_if_different` prevents flights of two campaigns in one folder.
"""

from __future__ import annotations

import contextlib
import json
import platform
import shlex
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

import uqharness
from sysid.foreign.regular_files import read_regular, sha256_hex, sha256_of_parts
from uqharness.campaign.cases import Mission
from uqharness.campaign.read_spec import campaign_from, checked_settings
from uqharness.campaign.spec import CampaignSpec, Document, without_flights
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.results.base import Part

# Content of manifest.json, validated before use.

FORMAT = 2
FORMAT_WITHOUT_DIGESTS = 1
"""Format of uqharness 0.1."""
RUNNING, INTERRUPTED, COMPLETE, MIXED = "running", "interrupted", "complete", "spoilt"
"""States; spoilt: aircraft or script was edited while it flew."""

_Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
_FileName = Annotated[str, Field(pattern="^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]


class _Journal(Part):
    """Number of journal rows and a digest over them."""

    rows: int = Field(ge=0)
    digest: _Digest


class _Engine(Part):
    """Requested engine and reasons of the choice; fields are keys of the file."""

    asked: Literal["auto", "batch", "jsbsim"]
    why: list[str]


class _Bounds(Part):
    """Confidence of the model form and coefficients with a transient part."""

    confidence: float = Field(gt=0, lt=1)
    transient: list[str]


class Manifest(Part):
    """Content of manifest.json; fields are keys of the file.

    ``campaign`` holds the settings as plain types, `settings` as the sections of a campaign file.
    """

    format: Literal[1, 2]
    state: Literal["running", "interrupted", "complete", "spoilt"]
    command: str
    seed: int = Field(ge=0, lt=2**63)
    cases: int = Field(ge=0, lt=2**53)
    campaign: dict[str, Any]
    campaign_file: str = "campaign.toml"
    versions: dict[str, str]
    hashes: dict[str, _Digest]
    shard: Annotated[str, Field(pattern=r"^[0-9]{1,6}/[0-9]{1,6}$")] | None = None
    tables: dict[_FileName, _Digest] = Field(default_factory=dict)
    journal: _Journal | None = None
    engine: _Engine | None = None
    bounds: _Bounds | None = None
    sums: Literal["SHA256SUMS"] | None = None

    @model_validator(mode="after")
    def _check_complete(self) -> Manifest:
        """Require the hashes, and for a complete campaign the digest of its journal."""
        missing = [name for name in ("aircraft", "script") if name not in self.hashes]
        if missing:
            raise ValueError(f"hashes lack {missing[0]}")
        if self.format == FORMAT and self.state == COMPLETE and self.journal is None:
            raise ValueError("it is complete and has no digest of the journal")
        return self

    @cached_property
    def settings(self) -> Document:
        """Return the validated settings; no file that they name is read."""
        return Document.model_validate(without_flights(self.campaign))

    @property
    def engine_reasons(self) -> tuple[str, ...]:
        """Return why the campaign's engine was chosen; empty for manifests without reasons."""
        return () if self.engine is None else tuple(self.engine.why)


def checked_content(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content with all settings of the campaign filled in.

    Raises ValueError naming the first invalid entry.
    """
    try:
        content = Manifest.model_validate(data)
    except ValidationError as error:
        raise ValueError(_error_text(error)) from None
    try:
        settings = checked_settings(_fill_old_defaults(content.campaign))
    except ValidationError as error:
        raise ValueError(_error_text(error, "campaign")) from None
    if settings["campaign"]["seed"] != content.seed:
        raise ValueError(
            f"seed is {content.seed}, that of the campaign in it {settings['campaign']['seed']}"
        )
    return {**data, "campaign": settings}


def _fill_old_defaults(campaign: dict[str, Any]) -> dict[str, Any]:
    """Fill in what older versions flew: JSBSim, and corners without interior points or nominal
    model.
    """
    filled = dict(campaign)
    if isinstance(section := campaign.get("campaign"), dict):
        filled["campaign"] = {"engine": "jsbsim", **section}
    if isinstance(section := campaign.get("aleatory"), dict):
        filled["aleatory"] = {"sensor_noise": True, **section}
    section = campaign.get("epistemic")
    if isinstance(section, dict) and section.get("method") == "corners":
        filled["epistemic"] = {"interior": 0, "nominal": False, **section}
    return filled


def _error_text(error: ValidationError, *section: str) -> str:
    """Return the first validation error with its place in the file."""
    first = error.errors()[0]
    place = ".".join(map(str, (*section, *first["loc"])))
    if first["type"] == "missing":
        return f"{place} is missing"
    message = first["msg"].removeprefix("Value error, ").replace("Input should", "must")
    return f"{place}: {message}" if place else message


# Digests that reveal damage.

_MODULUS = 2**256


class DamageError(BadInputError):
    """Report that a file of a campaign folder is not as it was written.

    Attributes
    ----------
    what : str
        The reason without path and advice.
    """

    def __init__(self, path: Path, problem: str, folder: Path) -> None:
        """Compose the message with the commands that help."""
        self.what = problem
        place = shlex.quote(str(folder))
        super().__init__(
            f"{path}: damaged: {problem}; nothing was changed. `uqharness campaign verify {place}`"
            f" lists what is whole, `uqharness campaign salvage {place}` keeps it and makes the"
            " rest again"
        )


_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"))


def digest_of_text(values: Any) -> str:
    """Return a SHA-256 over the canonical JSON of plain values.

    Raises TypeError or ValueError for values that JSON cannot hold.
    """
    return sha256_hex(_CANONICAL.encode(values).encode())


def row_digest(columns: Sequence[Any]) -> str:
    """Return the digest of a journal row, over all columns but the digest itself."""
    return digest_of_text(list(columns))


def digest_of_rows(digests: Iterable[str]) -> str:
    """Return one digest over those of all rows, in the order given."""
    return sha256_of_parts(digest.encode() for digest in digests)


def sum_digests(total: str, added: Iterable[str], removed: Iterable[str] = ()) -> str:
    """Return a sum of digests modulo 2**256, after rows were added and removed.

    The sum shows whether a set of rows is complete and can be updated row by row.

    Parameters
    ----------
    total : str
        Sum so far, hexadecimal.
    added, removed : iterable of str
        Digests of rows.
    """
    number = (
        int(total, 16)
        + sum(int(item, 16) for item in added)
        - sum(int(item, 16) for item in removed)
    )
    return f"{number % _MODULUS:064x}"


MANIFEST = "manifest.json"
_MAX_BYTES = 16_000_000

# Only these versions can change a flight; the others are recorded for information.
_BINDING_VERSIONS = ("uqharness", "jsbsim", "numpy")
_RECORDED_VERSIONS = ("scipy", "pyarrow", "pandas", "llvmlite")


def versions() -> dict[str, str]:
    """Return the versions of this program and of the libraries that fly and write tables."""
    result = {"uqharness": uqharness.__version__, "python": platform.python_version()}
    for name in (*_BINDING_VERSIONS[1:], *_RECORDED_VERSIONS):
        # llvmlite may be left out.
        with contextlib.suppress(metadata.PackageNotFoundError):
            result[name] = metadata.version(name)
    return result


def binding_versions() -> tuple[tuple[str, str], ...]:
    """Return names and versions that must agree for all flights of a campaign."""
    installed = versions()
    return tuple((name, installed[name]) for name in _BINDING_VERSIONS)


def describe(spec: CampaignSpec, mission: Mission, cases: int, command: str) -> dict[str, Any]:
    """Return the manifest of a campaign that is about to run."""
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
    """Return the campaign that a manifest describes.

    Raises BadInputError, e.g. if a file that it names is gone.
    """
    return campaign_from(manifest["campaign"], Path(manifest.get("campaign_file", "campaign.toml")))


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read and validate the manifest of a campaign folder.

    Raises
    ------
    BadInputError
        If there is no manifest or another program wrote it.
    DamageError
        If it is not as it was written.
    """
    path = folder / MANIFEST
    try:
        content = read_regular(path, _MAX_BYTES)
    except FileNotFoundError:
        raise BadInputError(
            f"{folder}: not a campaign folder (no {MANIFEST}); make one with: uqharness campaign"
            " run CAMPAIGN.toml --out DIR"
        ) from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        return _parsed(content, path)
    except (ValueError, RecursionError) as error:
        text = str(error) if isinstance(error, ValueError) else "nested too deeply"
        raise DamageError(path, " ".join(text.split()), folder) from None


def _parsed(content: bytes, path: Path) -> dict[str, Any]:
    """Parse a manifest. ValueError means damage, BadInputError a file of another program."""
    try:
        manifest = json.loads(content.decode("utf-8"))
    except UnicodeDecodeError:
        raise ValueError("not text in UTF-8") from None
    except ValueError as error:
        raise ValueError(f"not JSON: {error}") from None
    readable_formats = (FORMAT, FORMAT_WITHOUT_DIGESTS)
    if (
        not isinstance(manifest, dict)
        or type(file_format := manifest.get("format")) is not int
        or file_format not in readable_formats
    ):
        raise BadInputError(f"{path}: written by another version of uqharness, or not by uqharness")
    # The digest covers everything but itself.
    digest = manifest.pop("digest", None)
    if digest != (digest_of_text(manifest) if file_format == FORMAT else None):
        raise ValueError("its content does not fit its digest")
    return checked_content(manifest)


def has_digests(manifest: Mapping[str, Any]) -> bool:
    """Return whether journal and tables have digests; those of uqharness 0.1 do not."""
    return bool(manifest["format"] != FORMAT_WITHOUT_DIGESTS)


def refuse_without_digests(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Raise BadInputError for a folder of uqharness 0.1, which can be read but not continued."""
    if not has_digests(manifest):
        raise BadInputError(
            f"{folder}: made by uqharness 0.1, whose flights have no digests: finish it with that"
            " version, or run it with another --out"
        )


def read_complete(folder: Path) -> Manifest:
    """Read the manifest of a complete campaign. Raises BadInputError if flights are missing."""
    manifest = read_manifest(folder)
    if manifest["state"] != COMPLETE:
        command = manifest["command"] or "the command that began it"
        raise BadInputError(
            f"{folder}: the campaign is not complete; finish it first with: {command}"
        )
    return Manifest.model_validate(manifest)


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest with its digest in one atomic step."""
    content = {**manifest, "digest": digest_of_text(dict(manifest))}
    write_bytes(folder / MANIFEST, (json.dumps(content, indent=2) + "\n").encode())


def refuse_if_different(
    folder: Path, old: Mapping[str, Any], new: Mapping[str, Any], ignore: tuple[str, ...] = ()
) -> None:
    """Raise BadInputError if the flights of a folder do not belong to the requested campaign.

    The message names every difference. Versions and hashes listed in ``ignore`` may differ.
    """
    differences = [
        f"{name} {old['versions'].get(name)} then, {new['versions'].get(name)} now"
        for name in _BINDING_VERSIONS
        if name not in ignore and old["versions"].get(name) != new["versions"].get(name)
    ]
    old_settings, new_settings = _flatten(old["campaign"]), _flatten(new["campaign"])
    # Settings, except paths and an engine that was chosen automatically.
    for key in sorted(old_settings.keys() | new_settings.keys()):
        if key == "campaign.engine" and new_settings.get(key, "auto") == "auto":
            continue  # whichever flew before
        if key not in ("campaign.aircraft", "campaign.mission") and old_settings.get(
            key
        ) != new_settings.get(key):
            section, _, name = key.partition(".")
            differences.append(
                f"[{section}] {name} was {json.dumps(old_settings.get(key))}, is"
                f" {json.dumps(new_settings.get(key))}"
            )
    for name, setting in (("aircraft", "aircraft"), ("script", "mission")):
        old_hash, new_hash = old["hashes"][name], new["hashes"][name]
        if name not in ignore and old_hash != new_hash:
            setting_value = new_settings.get(f"campaign.{setting}")
            differences.append(
                f"the content of the {name} ({setting_value}) has changed: {old_hash[:12]} then,"
                f" {new_hash[:12]} now"
            )
    # Further input files: bounds and fit.
    for role in sorted((old["hashes"].keys() | new["hashes"].keys()) - {"aircraft", "script"}):
        old_hash, new_hash = (
            hashes.get(role, "absent")[:12] for hashes in (old["hashes"], new["hashes"])
        )
        if old_hash != new_hash:
            differences.append(
                f"the content of the file named as {role} has changed: {old_hash} then,"
                f" {new_hash} now"
            )
    if differences:
        raise BadInputError(
            f"{folder}: this folder holds another campaign: {'; '.join(differences)}. Choose"
            " another --out, or restore what changed"
        )


def _flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested mapping with dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
