"""What a planned flight starts from: the campaign's own bounds, and what makes a plan less certain
than it looks.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sysid.foreign.regular_files import file_sha256
from uqharness.errors import BadInputError
from uqharness.next_flight.plan import bounds_of, warnings_of
from uqharness.simulator.aircraft import content_hash, find_aircraft


def campaign(form: Path | None, bounds: object = None, failed: int = 0, same: bool = True) -> Any:
    spec = SimpleNamespace(
        inputs=SimpleNamespace(model_form=form),
        epistemic=SimpleNamespace(bounds=bounds),
        start=None,
    )
    return SimpleNamespace(spec=spec, failed=failed, same_aircraft=same)


def test_the_campaigns_own_form_is_taken_and_other_bounds_are_refused_with_what_to_do(
    tmp_path: Path,
) -> None:
    form = tmp_path / "model-form.json"
    assert bounds_of(campaign(form), tmp_path, "CY") == form
    with pytest.raises(
        BadInputError, match=r"flew constant bounds of CY.*uqharness bounds AIRCRAFT"
    ):
        bounds_of(campaign(None, {"CY": 0.01}), tmp_path, "CY")
    with pytest.raises(BadInputError, match="flew the bounds that the aircraft carries"):
        bounds_of(campaign(None, "model-form.json"), tmp_path, "CY")


def test_a_sound_plan_has_no_warning_and_each_weakness_has_its_own(tmp_path: Path) -> None:
    aircraft = find_aircraft("espaaro")
    own, other, record = (tmp_path / name for name in ("own.json", "other.json", "flight.csv"))
    for path in (own, other, record):
        path.write_text(path.name)
    form: Any = SimpleNamespace(
        aircraft=SimpleNamespace(sha256=content_hash(aircraft)),
        flights=[SimpleNamespace(sha256=file_sha256(record))],
    )
    flight: Any = SimpleNamespace(aircraft=aircraft, noise=True, has_autopilot=True)
    assert (
        warnings_of(form, campaign(own, failed=3), flight, None, [record], from_campaign=False)
        == []
    )
    assert warnings_of(form, campaign(own), flight, own, [], from_campaign=True) == []
    bare: Any = SimpleNamespace(aircraft=aircraft, noise=False, has_autopilot=False)
    changed: Any = SimpleNamespace(aircraft=SimpleNamespace(sha256="0" * 64), flights=[])
    said = warnings_of(
        changed, campaign(own, failed=3, same=False), bare, other, [record], from_campaign=True
    )
    for part in (
        "has changed",
        "uqharness 0.1",
        "other bounds",
        "flight.csv: not among",
        "3 flights",
        "no sensors",
        "autopilot",
    ):
        assert sum(part in text for text in said) >= 1, part
    assert len(said) == 7
    (constant,) = warnings_of(
        form, campaign(None, {"CY": 0.01}), flight, own, [], from_campaign=True
    )
    assert "(constant ones)" in constant
