"""The same flights of two models: nothing differs between one and itself; a changed term shows
where it acts.
"""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest

from tests.helpers.places import ROOT
from uqharness.differences import (
    MatchedRequest,
    by_channel,
    differences,
    differing_terms,
    fly_matched,
)
from uqharness.errors import BadInputError
from uqharness.simulator import find_aircraft

ASKED = MatchedRequest((22.0,), missions=("doublets",))


@pytest.fixture(scope="module")
def inputs():
    return find_aircraft("espaaro")


def changed(folder, old: str, new: str):
    out = shutil.copytree(ROOT / "aircraft" / "espaaro", folder / "espaaro")
    path = out / "espaaro.xml"
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")
    return find_aircraft(out)


def test_a_model_is_itself(inputs):
    reports = []
    channels, flights = fly_matched(
        inputs, inputs, ASKED, lambda done, total: reports.append((done, total))
    )
    assert reports == [(k + 1, len(flights)) for k in range(len(flights))]
    assert [f.name for f in flights] == ["doublets at 22 m/s"]
    assert {"CX", "Cm", "q_dot", "Ixz", "elevator position"} <= {c.name for c in channels}
    assert differences(channels, flights, ()) == []
    # The start one unit in the last place away is another flight, and hardly.
    difference = max(
        float(np.max(np.abs(flights[0].nudged[c] - flights[0].a[c]))) for c in ("q", "alpha")
    )
    assert 0.0 < difference < 1e-10


def test_a_wrong_sign_shows_in_its_coefficient_first(inputs, tmp_path):
    other = _negated(tmp_path)
    channels, flights = fly_matched(inputs, other, ASKED)
    terms = differing_terms(inputs.folder, other.folder)
    result = by_channel(differences(channels, flights, terms))
    assert result[0].channel == "Cn"
    assert result[0].terms[0].path.endswith("property aero/Cn_p")
    assert result[0].from_s > 1.0  # the roll doublet, not before


def _negated(folder):
    text = (ROOT / "aircraft" / "espaaro" / "espaaro.xml").read_text(encoding="utf-8")
    (specific,) = re.findall(r'<property value="(-?[\d.e-]+)">aero/Cn_p</property>', text)
    return changed(
        folder,
        f'<property value="{specific}">aero/Cn_p</property>',
        f'<property value="{-float(specific)}">aero/Cn_p</property>',
    )


def test_scripts_are_flown_too(inputs):
    script = ROOT / "scripts" / "doublet-elevator.xml"
    _, (flight,) = fly_matched(
        inputs, inputs, MatchedRequest(scripts=(script,), properties=("aero/qbar-psf",))
    )
    assert flight.name == "doublet-elevator"
    assert "aero/qbar-psf" in flight.a


def test_nothing_to_fly_is_refused(inputs):
    with pytest.raises(BadInputError, match="no manoeuvre"):
        fly_matched(inputs, inputs, MatchedRequest())


@pytest.mark.slow
def test_no_trim_is_refused(inputs):
    with pytest.raises(BadInputError, match="no steady flight"):
        fly_matched(inputs, inputs, MatchedRequest((300.0,)))
