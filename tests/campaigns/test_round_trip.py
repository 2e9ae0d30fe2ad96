"""Log, identify, XML, a flight not used: the right form reaches the noise floor, the form without
pitch damping does not.
"""

import json

import pytest

from campaigns.identification import round_trip
from campaigns.identification.round_trip import FORMS, Form, aircraft_of, markdown, run, says_which
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft, open_aircraft


@pytest.mark.slow
def test_short_round_trip_says_which_form_is_right(tmp_path):
    right, _, no_damping = FORMS
    free = ["aero/Cm_0", "aero/Cm_alpha", "aero/Cm_q", "aero/Cm_de"]
    # Not DataFlash: half a microsecond of aileron rolls the aircraft 0.002 rad/s, which one short
    # manoeuvre shows.
    trips = run(
        tmp_path, 1, (right, no_damping), free, workers=1, duration_s=12.0, suffix=".parquet"
    )
    assert [t.gap.reached for t in trips] == [True, False]
    assert says_which(trips)
    assert not says_which([trips[1], trips[0].__class__(no_damping, trips[0].fit, trips[0].gap)])
    assert "q_radps" in trips[1].gap.above
    assert set(trips[1].fit.names) == set(free) - {"aero/Cm_q"}
    # What was flown again is the XML that was written.
    fdm = open_aircraft(find_aircraft(tmp_path / "right"))
    assert fdm["aero/Cm_de"] == pytest.approx(
        trips[0].fit.theta[trips[0].fit.names.index("aero/Cm_de")], rel=1e-4
    )
    text = (tmp_path / "round-trip.md").read_text()
    assert text == markdown(trips)
    assert "| SLM |" in text
    assert "NOT reached" in text
    said = json.loads((tmp_path / "round-trip.json").read_text())
    assert said["forms"]["right"]["reached"] is True
    ratios = [said["forms"][form]["ratio"]["q_radps"] for form in ("SLM", "right")]
    assert ratios[0] > said["limit"] > ratios[1]


def test_an_effect_that_the_xml_lacks_cannot_be_switched_off(tmp_path):
    with pytest.raises(BadInputError, match="aero/ground"):
        aircraft_of(Form("odd", ("aero/ground",), "nothing"), tmp_path / "odd")


def test_command_reports_bad_input_and_exit_code(tmp_path, monkeypatch, capsys):
    def fail(*arguments, **options):
        raise BadInputError("the flight did not end well")

    monkeypatch.setattr(round_trip, "run", fail)
    assert round_trip.main(["--out", str(tmp_path)]) == 2
    assert "did not end well" in capsys.readouterr().err
