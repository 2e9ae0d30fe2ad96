"""Motors at rest and reversed, against JSBSim."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers.few import few


@pytest.mark.parametrize("motor", ["motor", "brushless"])
@pytest.mark.parametrize("events", few(["", engines.RUNNING], 1))
def test_a_motor_starts_and_brakes(motor: str, events: str) -> None:
    throttle = np.concatenate(
        [np.full(21, 1e-5), np.full(40, -0.5), np.full(40, 2e-5), np.full(20, 0.0)]
    )
    made = engines.Case(
        engines.aircraft(engines.mounted(motor, "fixed", 0), engines.HEAVY),
        [*engines.of(0, engines.PROPELLER), *engines.TOTALS],
        {"fcs/throttle-cmd-norm": throttle},
        engines.FILES,
        events,
    )
    theirs = made.theirs()
    assert flights.worst(flights.apart(theirs, made.ours())) < 1e-10
    changed = {
        name: text.replace("<coilresistance>0.05", "<coilresistance>0.0501")
        for name, text in engines.FILES.items()
    }
    changed["Engines/motor.xml"] = engines.MOTOR.replace("600", "600.01")
    assert flights.worst(flights.apart(theirs, made.ours(files=changed))) > 1e-9


def test_a_number_that_lacks_is_refused() -> None:
    files = {
        **engines.FILES,
        "Engines/brushless.xml": engines.BRUSHLESS.replace("<maxvolts>12</maxvolts>", ""),
    }
    said = engines.refusal(engines.aircraft(engines.mounted("brushless", "fixed")), files)
    assert "brushless.xml:1: <brushless_dc_motor> has no <maxvolts>" in said
