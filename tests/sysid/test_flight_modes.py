"""Flight modes by number and name, against the table of pymavlink."""

from __future__ import annotations

from pymavlink.mavutil import mode_mapping_apm

from sysid.vocabulary import MODE_NUMBERS, PLANE_MODES


def test_numbers_are_those_of_pymavlink():
    shared = set(PLANE_MODES) & set(mode_mapping_apm)
    assert len(shared) >= 20
    assert {n: PLANE_MODES[n] for n in shared} == {n: mode_mapping_apm[n] for n in shared}


def test_every_name_leads_back_to_its_number():
    assert len(MODE_NUMBERS) == len(PLANE_MODES)
    assert all(PLANE_MODES[MODE_NUMBERS[name]] == name for name in MODE_NUMBERS)
