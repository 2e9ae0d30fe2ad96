"""Run scripts of the identification flights."""

from __future__ import annotations

import pytest

from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import PROJECT_ROOT
from uqharness.simulator.mission import read_script
from uqharness.simulator.own_mission import PLANS, script


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
def test_scripts_are_as_the_plans_say(plan):
    assert (PROJECT_ROOT / "scripts" / f"{plan.name}.xml").read_text(encoding="utf-8") == script(
        plan
    )


def test_a_script_names_every_manoeuvre_and_ends_after_the_last():
    found = read_script(PROJECT_ROOT / "scripts" / f"{PLANS[0].name}.xml")
    assert list(found.manoeuvres.values()) == [m.name for m in PLANS[0].manoeuvres]
    assert found.end_s == pytest.approx(PLANS[0].end_s)


def test_a_manoeuvre_number_that_is_none_is_refused(tmp_path):
    text = script(PLANS[0]).replace(
        'name="flight/manoeuvre" value="2"', 'name="flight/manoeuvre" value="x"'
    )
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(BadInputError, match="flight/manoeuvre is set to 'x'"):
        read_script(path)
