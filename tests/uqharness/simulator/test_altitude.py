"""The air's density of a record that does not say how high it was flown."""

import numpy as np
import pytest

from sysid.record import FlightRecord, Metadata
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder, write_bytes
from uqharness.simulator.aircraft import with_start_altitude

TIME = {"time_s": np.arange(5) * 0.02, "V_mps": np.full(5, 20.0)}
INITIAL = '<initialize name="a">{}</initialize>'


def test_the_aircrafts_initial_conditions_say_where_it_flies(tmp_path):
    (tmp_path / "model.xml").write_text("<fdm_config/>")
    record, said = with_start_altitude(FlightRecord(TIME), tmp_path)
    assert "alt_m" not in record.metadata.start
    assert "air of sea level" in said
    for text, altitude in (
        ('<elevation unit="M">30</elevation><altitudeAGL unit="M">100</altitudeAGL>', 130.0),
        ("<altitude>1000</altitude>", 304.8),
        ('<altitudeMSL unit="FT">500</altitudeMSL>', 152.4),
    ):
        (tmp_path / "start.xml").write_text(INITIAL.format(text))
        record, said = with_start_altitude(FlightRecord(TIME), tmp_path)
        assert record.metadata.start["alt_m"] == pytest.approx(altitude)
        assert f"{altitude:g} m above sea level were taken from start.xml" in said
    (tmp_path / "other.xml").write_text(INITIAL.format("<altitude>9000</altitude>"))
    assert "air of sea level" in with_start_altitude(FlightRecord(TIME), tmp_path)[1]


def test_what_the_record_knows_is_left_alone(tmp_path):
    (tmp_path / "start.xml").write_text(INITIAL.format("<altitude>1000</altitude>"))
    for record in (
        FlightRecord({**TIME, "rho_kgpm3": np.full(5, 1.1)}),
        FlightRecord(TIME, Metadata(start={"alt_m": 7.0})),
    ):
        assert with_start_altitude(record, tmp_path) == (record, "")


def test_folders_on_the_way_are_made_and_a_file_in_the_way_is_refused_early(tmp_path):
    write_bytes(tmp_path / "a" / "b" / "c.txt", b"x")
    assert (tmp_path / "a" / "b" / "c.txt").read_bytes() == b"x"
    check_output_folder(tmp_path / "new" / "deep")
    assert not (tmp_path / "new").exists()
    for path in (tmp_path / "a" / "b" / "c.txt", tmp_path / "a" / "b" / "c.txt" / "d"):
        with pytest.raises(BadInputError, match="is no folder"):
            check_output_folder(path)
