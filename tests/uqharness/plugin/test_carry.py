"""Parts from beside an aircraft's folder that a copy elsewhere has to carry."""

from __future__ import annotations

from uqharness.plugin.apply import carried_files
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.staging import copy_folder, copy_shared_parts


def root_of(tmp_path):
    """A JSBSim root with one aircraft and its engines and systems."""
    folder = tmp_path / "root" / "aircraft" / "c172x"
    copy_folder(find_aircraft("c172x").folder, folder)
    copy_shared_parts(find_aircraft("c172x"), tmp_path / "root", stock=tmp_path / "elsewhere")
    return find_aircraft(folder)


def test_what_every_jsbsim_has_is_not_carried(tmp_path):
    assert carried_files(find_aircraft("c172x"), tmp_path / "out" / "aircraft" / "c172x") == {}
    assert carried_files(root_of(tmp_path), tmp_path / "out" / "aircraft" / "c172x") == {}


def test_a_part_of_ones_own_is_carried_unless_it_is_found_there(tmp_path):
    aircraft = root_of(tmp_path)
    (part, *_) = sorted((tmp_path / "root" / "engine").iterdir())
    part.write_bytes(part.read_bytes() + b"<!-- tuned -->\n")
    found = carried_files(aircraft, tmp_path / "out" / "aircraft" / "c172x")
    assert list(found.values()) == [part.read_bytes()]
    (name,) = found
    assert name.rpartition("/")[2] == part.name
    # Beside the original it is found where it is.
    assert carried_files(aircraft, tmp_path / "root" / "aircraft" / "copy") == {}
