"""Numbers that JSBSim reads once fly until they stand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from sysid.effects.selection import Choice, Selection
from uqharness.refinement.read_once import at_values, far_off


@pytest.mark.parametrize(("flown_s", "far"), [(0.0626, False), (0.0622, False), (0.0454, True)])
def test_a_number_is_far_off_by_three_of_its_standard_errors(flown_s, far):
    lag = Choice("lag", 0.0626, 2e-4, 9.0, 81.0, 1.0, 0.0)
    assert far_off([lag], {"lag": flown_s}) == ({"lag": flown_s} if far else {})


def test_calm_rounds_fly_again_until_a_lag_stands(tmp_path):
    """The flights want a lag of 0.16 s; a replay tells a third of what is left."""

    def flown_at(value: float) -> SimpleNamespace:
        wanted = Choice("lag", value + (0.16 - value) / 3.0, 1e-3, 60.0, 3600.0, 1.0, 0.0)
        other = Choice("Cm", 1.0, 0.1, 10.0, 100.0, 1.0, 0.0)
        return SimpleNamespace(
            selection=Selection((wanted, other)), far=far_off([wanted], {"lag": value}), about=None, value=value,
            merit=1e6 * (0.16 - value) ** 2,
        )  # fmt: skip

    seen: list[tuple[float, float]] = []

    def fly(selection: Selection, about: object, folder: Path) -> SimpleNamespace:
        lag, other = selection.chosen
        assert folder.name == f"round2-{len(seen)}"
        seen.append((lag.value, other.value))
        return flown_at(lag.value)

    now = at_values(flown_at(0.04), fly, tmp_path / "round2")  # type: ignore[arg-type]
    assert now.value == pytest.approx(0.16, abs=3e-3)  # type: ignore[attr-defined]
    assert 2 <= len(seen) <= 4
    assert {cm for _, cm in seen} == {1.0}
    seen.clear()

    earned = [0.0]

    def runs_away(value: float, *others: Choice) -> SimpleNamespace:
        wanted = Choice("cg", value - 0.012, 2e-3, -5.0, 25.0, 1.0, 0.0)
        return SimpleNamespace(
            selection=Selection((wanted, *others)), far=far_off([wanted], {"cg": value}), about=None,
            merit=1e3 + earned[0] * value,
        )  # fmt: skip

    def fly_away(selection: Selection, about: object, folder: Path) -> SimpleNamespace:
        keys = [c.key for c in selection.chosen]
        if "cg" not in keys:
            return SimpleNamespace(selection=selection, far={}, about=None, merit=1e3)
        return runs_away(*(c.value for c in selection.chosen if c.key == "cg"), selection.chosen[-1])

    scale = Choice("scale", 0.027, 7e-4, 38.0, 1444.0, 1.0, 0.0)
    left = at_values(runs_away(-0.012, scale), fly_away, tmp_path / "round2")  # type: ignore[arg-type]
    assert [c.key for c in left.selection.chosen] == ["scale"]
    # Where every change makes the flights likelier, the number goes on.
    earned[0] = 1e3
    left = at_values(runs_away(-0.012, scale), fly_away, tmp_path / "round2")  # type: ignore[arg-type]
    assert [c.key for c in left.selection.chosen] == ["cg", "scale"]
    assert at_values(flown_at(0.159), fly, tmp_path / "round2").value == 0.159  # type: ignore
    first = flown_at(0.04)
    assert at_values(first, lambda *_: None, tmp_path / "round2") is first  # type: ignore
