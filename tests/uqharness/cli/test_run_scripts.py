"""The run scripts that come with the project, made again."""

from __future__ import annotations

from uqharness.cli.run_scripts import main
from uqharness.simulator.own_mission import PLANS, script


def test_every_plan_is_written(tmp_path, capsys):
    assert main([str(tmp_path)]) == 0
    assert {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()} == {
        f"{plan.name}.xml": script(plan) for plan in PLANS
    }
    assert capsys.readouterr().out.count("manoeuvres") == len(PLANS)
