"""Numbers that JSBSim reads once fly until they stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.effects.selection import Choice, Selection
from uqharness.refinement import rounds as module
from uqharness.refinement.round import Round
from uqharness.refinement.rounds import fly


def round_with(*chosen: Choice, held: dict[str, float], merit: float = 0.0) -> Round:
    """A round that flew with numbers ``held`` and has effects estimated there."""
    own = Selection(chosen)
    return Round(None, None, None, own, own, merit, None, held=held)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("flown_s", "far", "standing"),
    [(0.0626, False, True), (0.0622, False, False), (0.0454, True, False)],
)
def test_a_number_stands_within_half_a_standard_error_and_is_far_off_by_three(
    flown_s, far, standing
):
    now = round_with(Choice("lag", 0.0626, 2e-4, 9.0, 81.0, 1.0, 0.0), held={"lag": flown_s})
    assert now.far == ({"lag": flown_s} if far else {})
    assert now.standing is standing


def lag_of(value: float) -> Round:
    """The flights want a lag of 0.16 s; a replay tells a third of what is left."""
    wanted = Choice("lag", value + (0.16 - value) / 3.0, 1e-3, 60.0, 3600.0, 1.0, 0.0)
    return round_with(
        wanted,
        Choice("Cm", 1.0, 0.1, 10.0, 100.0, 1.0, 0.0),
        held={"lag": value},
        merit=1e6 * (0.16 - value) ** 2,
    )


def proposed(**values: float) -> Selection:
    return Selection(tuple(Choice(k, v, 1.0, 9.0, 81.0, 1.0, 0.0) for k, v in values.items()))


def test_calm_rounds_fly_again_until_a_lag_stands(monkeypatch, tmp_path):
    seen: list[tuple[str, float, float]] = []

    def once(start: object, selection: Selection, about: object, folder: Path) -> Round:
        lag, other = selection.chosen
        seen.append((folder.name, lag.value, other.value))
        return lag_of(lag.value)

    monkeypatch.setattr(module, "_fly_once", once)
    now = fly(None, proposed(lag=0.04, Cm=1.0), None, tmp_path / "round2")  # type: ignore[arg-type]
    assert now is not None
    assert now.held["lag"] == pytest.approx(0.16, abs=3e-3)
    assert 3 <= len(seen) <= 5
    assert [name for name, _, _ in seen] == [
        "round2",
        *(f"round2-{k}" for k in range(len(seen) - 1)),
    ]
    assert {cm for _, _, cm in seen} == {1.0}
    seen.clear()
    now = fly(None, proposed(lag=0.159, Cm=1.0), None, tmp_path / "round2")  # type: ignore[arg-type]
    assert now is not None
    assert now.held == {"lag": 0.159}
    assert len(seen) == 1


def test_where_no_filter_follows_a_number_the_one_before_stands(monkeypatch, tmp_path):
    monkeypatch.setattr(
        module,
        "_fly_once",
        lambda _, selection, *__: lag_of(0.04) if selection.chosen[0].value == 0.04 else None,
    )
    now = fly(None, proposed(lag=0.04, Cm=1.0), None, tmp_path / "round2")  # type: ignore[arg-type]
    assert now is not None
    assert now.held == {"lag": 0.04}
    assert fly(None, proposed(lag=0.05, Cm=1.0), None, tmp_path / "round2") is None  # type: ignore[arg-type]


@pytest.mark.parametrize(("earned", "kept"), [(0.0, ["scale"]), (1e3, ["cg", "scale"])])
def test_a_number_that_runs_away_is_left_out_unless_every_change_makes_the_flights_likelier(
    monkeypatch, tmp_path, earned, kept
):
    scale = Choice("scale", 0.027, 7e-4, 38.0, 1444.0, 1.0, 0.0)

    def once(start: object, selection: Selection, *_: object) -> Round:
        value = next((c.value for c in selection.chosen if c.key == "cg"), None)
        if value is None:
            return round_with(scale, held={}, merit=1e3)
        wanted = Choice("cg", value - 0.012, 2e-3, -5.0, 25.0, 1.0, 0.0)
        return round_with(wanted, scale, held={"cg": value}, merit=1e3 + earned * value)

    monkeypatch.setattr(module, "_fly_once", once)
    left = fly(None, proposed(cg=-0.012, scale=0.027), None, tmp_path / "round2")  # type: ignore[arg-type]
    assert left is not None
    assert [c.key for c in left.selection.chosen] == kept
