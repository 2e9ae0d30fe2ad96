"""The aircraft of a campaign where it is not the author's own files: with bounds from a model form, with a trimmed start, or both.

Such an aircraft is a copy in the campaign's folder, so that what was flown stays with what came out.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from sysid.digests import sha256_hex
from uqharness.campaign.cases import Mission
from uqharness.campaign.inputs import read_bounds
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.errors import BadInputError
from uqharness.files import inner_folder
from uqharness.plugin.model_form_xml import model_form_xml
from uqharness.scratch import scratch_folder
from uqharness.simulator import (
    SCRIPT,
    Aircraft,
    content_hash,
    copy_beside,
    copy_folder,
    engine,
    find_aircraft,
    parse_xml,
    read_xml,
    walk,
    write_steady_start,
)

SYSTEM = "model-form"
_COPIED = "aircraft"
_UNFINISHED = ".aircraft-"
_SENSOR = b"sensor/V-mps"
"""Property by which a sensors system is recognised."""
_ACTIVE = b"uq/active"  # the switch of the plugin's deltas


def needs_copy(spec: CampaignSpec) -> bool:
    """Whether the campaign flies a copy of the aircraft."""
    return spec.inputs.model_form is not None or spec.start is not None


def named_aircraft(spec: CampaignSpec) -> Aircraft:
    """The aircraft that the campaign names: beside its own file, else as ``uqharness fly`` finds it. Raises BadInputError."""
    named = spec.path.resolve().parent / spec.campaign.aircraft
    return find_aircraft(named if named.is_dir() else spec.campaign.aircraft)


def has_sensors(aircraft: Aircraft) -> bool:
    """Whether the aircraft's files have a sensors system, whose output the noise of the sensors is added to."""
    paths = (path for _, path in walk(aircraft.folder) if path.suffix.lower() == ".xml")
    return any(_SENSOR in path.read_bytes() for path in paths)


def require_plugin(spec: CampaignSpec, aircraft: Aircraft) -> None:
    """Raise BadInputError where the campaign moves coefficients and nothing in the aircraft's files adds their deltas."""
    if spec.epistemic.method == "none" or not spec.epistemic.coefficients:
        return
    paths = (path for _, path in walk(aircraft.folder) if path.suffix.lower() == ".xml")
    if not any(_ACTIVE in path.read_bytes() for path in paths):
        system_file(aircraft)


def with_own_noise(spec: CampaignSpec, aircraft: Aircraft) -> CampaignSpec:
    """The campaign with ``sensor_noise`` settled: where the file does not say, on if the aircraft has a sensors system."""
    if spec.aleatory.sensor_noise is not None:
        return spec
    return spec.with_sensor_noise(has_sensors(aircraft))


def with_default_noise(spec: CampaignSpec, mission: Mission) -> CampaignSpec:
    """Return the campaign with ``sensor_noise`` settled by the aircraft that the mission flies."""
    # A copy of the aircraft may not have been made yet; its sensors are those of its source.
    source = mission.source if mission.source != Path() else mission.aircraft
    return with_own_noise(spec, find_aircraft(source))


def noise_notes(spec: CampaignSpec) -> list[str]:
    """That a campaign which says nothing of sensor noise flies without. Raises BadInputError."""
    aircraft = named_aircraft(spec)
    if spec.aleatory.sensor_noise is not None or has_sensors(aircraft):
        return []
    return [
        f"aircraft '{aircraft.name}' has no sensors system: it is flown without sensor noise ([aleatory] sensor_noise = false)"
    ]


def bounds_notes(spec: CampaignSpec) -> list[str]:
    """What to know before flying: bounds that were made for other files than the aircraft's. Raises BadInputError."""
    if spec.inputs.model_form is None:
        return []
    made_for, aircraft = read_bounds(spec.inputs.model_form).aircraft, named_aircraft(spec)
    if made_for.sha256 == content_hash(aircraft):
        return []
    whose = f"'{made_for.name}' as it was then"
    if made_for.name != aircraft.name:
        whose = f"'{made_for.name}', not '{aircraft.name}'"
    meant = "they mean something only if its aerodynamics are the same"
    path = spec.inputs.model_form
    return [
        f"{path}: the bounds were made for aircraft {whose} (SHA-256 {made_for.sha256[:12]}...); {meant}"
    ]


def find_copied_mission(
    spec: CampaignSpec, aircraft: Aircraft, script: Path | None, folder: Path
) -> Mission:
    """The mission that a copy in ``folder`` is going to fly, with the hashes of what it will hold; nothing is left behind.

    ``script`` None: the steady flight of [start]. Raises BadInputError as :func:`make_copy` does.
    """
    with scratch_folder("copy") as scratch:
        made = _copy(spec, aircraft, scratch.path)
        aircraft_hash = content_hash(find_aircraft(made))
        script_hash = sha256_hex(read_xml(script or scratch.path / SCRIPT))
    place = folder.resolve()
    return Mission(
        place / _COPIED / made.name,
        aircraft_hash,
        (script or place / SCRIPT).resolve(),
        script_hash,
        aircraft.folder,
    )


def make_copy(spec: CampaignSpec, mission: Mission, folder: Path) -> None:
    """Make the copy that ``mission`` flies in ``folder``, unless it is there already.

    Raises BadInputError if the aircraft does not carry the plugin, cannot have these bounds, or has no trim.
    """
    for left in folder.glob(f"{_UNFINISHED}*"):
        shutil.rmtree(left, ignore_errors=True)
    target = mission.aircraft
    if target.exists() and content_hash(find_aircraft(target)) == mission.aircraft_hash:
        return
    with tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=folder) as name:
        made = _copy(spec, find_aircraft(mission.source), Path(name))
        # A folder with flights of another aircraft is refused before; what is left to find here is half a copy.
        shutil.rmtree(target, ignore_errors=True)
        for sub in ("engine", "systems", SCRIPT):
            if (Path(name) / sub).exists():
                shutil.rmtree(folder / sub, ignore_errors=True)
                os.replace(Path(name) / sub, folder / sub)
        os.replace(made, inner_folder(folder, _COPIED) / target.name)


def _copy(spec: CampaignSpec, aircraft: Aircraft, root: Path) -> Path:
    made = root / _COPIED / aircraft.folder.name
    copy_folder(aircraft.folder, made)
    copy_beside(aircraft, root, engine.default_root())
    if spec.inputs.model_form is not None:
        put_bounds(made, aircraft, spec.inputs.model_form)
    if spec.start is not None:
        write_steady_start(find_aircraft(made), spec.start, root / SCRIPT, str(spec.path))
    return made


def put_bounds(made: Path, aircraft: Aircraft, model_form: Path) -> None:
    """Give the copy ``made`` of an aircraft the bounds of a model-form.json. Raises BadInputError as :func:`make_copy` does."""
    text = model_form_xml(read_bounds(model_form), aircraft)
    destination = made / system_file(aircraft).relative_to(aircraft.folder)
    destination.unlink()
    destination.write_bytes(text)


def system_file(aircraft: Aircraft) -> Path:
    """The file of the aircraft's model-form system."""
    for system in parse_xml(aircraft.xml).getroot().iter("system"):
        named = system.get("file", "").removesuffix(".xml")
        if named == SYSTEM:
            for path in (
                aircraft.folder / "Systems" / f"{SYSTEM}.xml",
                aircraft.folder / f"{SYSTEM}.xml",
            ):
                if path.is_file():
                    return path
    raise BadInputError(
        f'{aircraft.xml}: carries no <system file="{SYSTEM}"/>, so no bounds can act on it; '
        f"add the plugin first: uqharness instrument {aircraft.name} --out DIR"
    )
