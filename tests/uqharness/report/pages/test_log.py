"""The quick look at a log: purposes and findings as `log info` has them, each flagged in the
channel it concerns.
"""

from __future__ import annotations

import numpy as np
from lxml import html

from sysid.errors import Finding
from sysid.logs import log_info
from sysid.record import FlightRecord, Metadata
from tests.helpers.page_checks import problems, words_of
from uqharness.report.pages.flight import log_page
from uqharness.report.parts import render

TIME = np.arange(0.0, 60.0, 0.1)
STUCK = Finding(
    "stuck",
    "V_mps",
    "error",
    "V_mps stands at 20",
    {"start_s": 15.0, "end_s": 25.0},
    "speeds",
    "[signals.V_mps]\nscale = 2",
)
LATE = Finding("delay", "q_radps", "warning", "q comes late")
COLUMNS = {
    "time_s": TIME,
    "V_mps": np.full(TIME.size, 20.0),
    "q_radps": np.sin(TIME),
    "north_m": 20.0 * TIME,
    "east_m": 0.0 * TIME,
    "mode": np.where(TIME < 30.0, "MANUAL", "AUTO").astype(object),
    "manoeuvre": np.where((TIME > 40.0) & (TIME < 50.0), "pitch doublet", "").astype(object),
}
META = Metadata(
    source="a.bin",
    dialect="dataflash",
    vehicle="ArduPlane",
    free_flight_s=((10.0, 55.0),),
    findings=(LATE, STUCK),
)


def page(meta=META, columns=COLUMNS):
    record = FlightRecord(columns, meta)
    return render(log_page(log_info(record), record, "uqharness log info a.bin"))


def bands(text, channel, kind):
    return len(
        html.document_fromstring(text).xpath(
            f"//figure[@id='channel-{channel}']//path[@class='band {kind}']"
        )
    )


def test_findings_stand_in_the_verdict_in_the_table_and_in_their_channel():
    text = page()
    assert problems(text) == []
    words = words_of(text)
    assert "1 error: stuck." in words
    assert "V_mps: 15.00 to 25.00 s" in words
    assert "Findings: error stuck." in words
    assert "Findings: warning delay." in words
    assert "# stuck, V_mps [signals.V_mps] scale = 2" in words
    assert words.index("V_mps stands at 20") < words.index("q comes late")  # errors first
    assert (bands(text, "V_mps", "fillbad"), bands(text, "q_radps", "fillbad")) == (1, 0)


def test_phases_modes_and_manoeuvres_are_shaded_in_every_channel():
    text = page()
    for channel in ("V_mps", "q_radps", "north_m"):
        assert (bands(text, channel, "fillrange"), bands(text, channel, "fill1")) == (2, 1)
        lines = html.document_fromstring(text).xpath(
            f"//figure[@id='channel-{channel}']//path[@class='line joint']"
        )
        assert len(lines) == 1
    assert "40.10 50.00" in words_of(text).replace("pitch doublet", "").replace(
        "40.1050.00", "40.10 50.00"
    )
