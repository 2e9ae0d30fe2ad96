"""An aircraft that comes without airframe.toml, given one: an instrumented copy that lasts as long as the process."""

from __future__ import annotations

import logging

from uqharness.plugin.apply import instrument_aircraft
from uqharness.plugin.instrument import Bounds
from uqharness.scratch import Scratch, scratch_folder
from uqharness.simulator import Aircraft, check_loadable, content_hash, find_aircraft

_LOG = logging.getLogger("uqharness")
_made: dict[str, tuple[Scratch, Aircraft]] = {}


def with_card(aircraft: Aircraft) -> Aircraft:
    """``aircraft`` itself where it has a card, else a copy as ``instrument`` writes it, with bounds of zero: it flies the same.

    Made once a process for the same files. Raises BadInputError for an aircraft that does not fly or cannot be instrumented.
    """
    if aircraft.has_card:
        return aircraft
    key = content_hash(aircraft)
    if key not in _made:
        check_loadable(
            aircraft
        )  # names the user's file; later checks would name the copy and its lines
        scratch = scratch_folder("card")
        folder = scratch.path / "aircraft" / aircraft.folder.name
        folder.parent.mkdir()
        done = instrument_aircraft(aircraft, Bounds(), folder, check=False)
        for control, reason in done.unmeasured.items():
            _LOG.info(
                "%s: %s could not be measured and is assumed: %s", aircraft.name, control, reason
            )
        _made[key] = scratch, find_aircraft(folder)
    return _made[key][1]
