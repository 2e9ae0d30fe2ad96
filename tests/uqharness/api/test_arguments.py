"""What every function of the public face refuses: one sentence with the argument's name, nothing
printed, nothing left behind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import uqharness as uq
from uqharness.commands.flights import Flight

pytestmark = pytest.mark.usefixtures("flights_here")

CAMPAIGN = {
    "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    "aleatory": {"flights": 2, "duration_s": 2, "burn_in_s": 0},
    "epistemic": {"method": "none"},
}


@pytest.fixture(scope="module")
def flight() -> Flight:
    return uq.fly("espaaro", "trim", duration_s=3, noise=True)


CALLS: list[tuple[str, Callable[..., Any], dict[str, Any], str]] = [
    ("aircraft", uq.find_aircraft, {"name_or_folder": 5}, "aircraft = 5"),
    ("fly-aircraft", uq.fly, {"aircraft": None}, "aircraft = None"),
    ("fly-script", uq.fly, {"aircraft": "espaaro", "script": 5}, "script = 5"),
    ("fly-noise", uq.fly, {"aircraft": "espaaro", "noise": 3}, "noise = 3: True or False"),
    (
        "fly-seed",
        uq.fly,
        {"aircraft": "espaaro", "seed": "a"},
        "seed = 'a': a whole number of at least 0",
    ),
    ("fly-seed-half", uq.fly, {"aircraft": "espaaro", "seed": 1.5}, "seed = 1.5"),
    ("fly-duration", uq.fly, {"aircraft": "espaaro", "duration_s": "10"}, "duration_s = '10'"),
    (
        "fly-properties",
        uq.fly,
        {"aircraft": "espaaro", "properties": {"aero/Cm_q": math.nan}},
        r"properties = \{'aero/Cm_q': nan\}",
    ),
    ("read-paths", uq.read_flights, {"paths": 5, "aircraft": "espaaro"}, "paths = 5"),
    (
        "read-map",
        uq.read_flights,
        {"paths": "a.csv", "aircraft": "espaaro", "signal_map": 5},
        "signal_map = 5",
    ),
    ("trim-speed", uq.find_trim, {"aircraft": "espaaro", "V_mps": "fast"}, "V_mps = 'fast'"),
    (
        "trim-nan",
        uq.find_trim,
        {"aircraft": "espaaro", "V_mps": 22, "properties": {"aero/Cm_q": math.nan}},
        r"properties = \{'aero/Cm_q': nan\}",
    ),
    (
        "linearise-none",
        uq.linearise,
        {"aircraft": "espaaro", "steady": None},
        "trim = None: a Trim",
    ),
    (
        "instrument-list",
        uq.instrument,
        {"aircraft": "espaaro", "constant": ["CX"], "out": "out"},
        r"constant = \['CX'\]",
    ),
    (
        "instrument-number",
        uq.instrument,
        {"aircraft": "espaaro", "constant": 5, "out": "out"},
        "constant = 5: C=B with C one of",
    ),
    (
        "instrument-value",
        uq.instrument,
        {"aircraft": "espaaro", "constant": {"CX": "a"}, "out": "out"},
        "constant = {'CX': 'a'}: CX: a half width",
    ),
    (
        "instrument-three",
        uq.instrument,
        {"aircraft": "espaaro", "constant": {"CX": (0, 0, 1)}, "out": "out"},
        "constant = .*: CX: a half width",
    ),
    (
        "instrument-negative",
        uq.instrument,
        {"aircraft": "espaaro", "constant": {"CX": -1}, "out": "out"},
        "constant = {'CX': -1}: CX: a half width",
    ),
    (
        "instrument-nothing",
        uq.instrument,
        {"aircraft": "espaaro", "out": "out"},
        "no bounds; give form, or constant",
    ),
    ("instrument-out", uq.instrument, {"aircraft": "espaaro", "constant": {}, "out": 5}, "out = 5"),
    (
        "instrument-check",
        uq.instrument,
        {"aircraft": "espaaro", "constant": {}, "out": "out", "check": 5},
        "check = 5",
    ),
    ("identify-flights", uq.identify, {"aircraft": "espaaro", "flights": 5}, "flights = 5"),
    (
        "identify-workers",
        uq.identify,
        {"aircraft": "espaaro", "flights": "a.csv", "workers": "2"},
        "workers = '2': a whole number",
    ),
    (
        "identify-none",
        uq.identify,
        {"aircraft": "espaaro", "flights": "a.csv", "parameters": []},
        r"parameters = \[\]: a property or several",
    ),
    (
        "identify-type",
        uq.identify,
        {"aircraft": "espaaro", "flights": "a.csv", "parameters": 5},
        "parameters = 5",
    ),
    (
        "compare-workers",
        uq.compare,
        {"aircraft": "espaaro", "flight": "a.csv", "workers": 1.5},
        "workers = 1.5",
    ),
    (
        "form-confidence",
        uq.fit_model_form,
        {"aircraft": "espaaro", "flights": "a.csv", "confidence": "x"},
        "confidence = 'x'",
    ),
    (
        "form-states",
        uq.fit_model_form,
        {"aircraft": "espaaro", "flights": "a.csv", "states": ["CX"]},
        "states = ",
    ),
    ("campaign-out", uq.run_campaign, {"campaign": CAMPAIGN, "out": None}, "out = None"),
    (
        "campaign-hours",
        uq.run_campaign,
        {"campaign": CAMPAIGN, "out": "out", "hours": True},
        "hours = True",
    ),
    (
        "campaign-samples",
        uq.run_campaign,
        {"campaign": CAMPAIGN, "out": "out", "samples": "8"},
        "samples = '8'",
    ),
    (
        "campaign-progress",
        uq.run_campaign,
        {"campaign": CAMPAIGN, "out": "out", "on_progress": 5},
        "on_progress = 5: a function",
    ),
    *(
        (
            f"campaign-workers-{wrong}",
            uq.run_campaign,
            {"campaign": CAMPAIGN, "out": "out", "workers": wrong},
            "workers = ",
        )
        for wrong in (0, -1, 1.5, "2", True)
    ),
    ("read-campaign", uq.read_campaign, {"folder": 5}, "folder = 5"),
    ("pbox-confidence", uq.pbox, {"samples": [[1.0]], "confidence": "x"}, "confidence = 'x'"),
    ("pbox-samples", uq.pbox, {"samples": None}, "samples = None"),
    ("plot-none", uq.plot_pbox, {"box": None}, "box = None: a PBox"),
    (
        "plot-axes",
        uq.plot_pbox,
        {"box": uq.pbox([[1.0, 2.0]]), "ax": 5},
        "ax = 5: matplotlib's Axes",
    ),
    *(
        (
            f"quantile-{wrong}",
            uq.pbox([[1.0, 2.0]]).quantile,
            {"probability": wrong},
            f"probability = {wrong}: a number",
        )
        for wrong in (2, -1, math.nan)
    ),
    ("band", uq.pbox([[1.0, 2.0]]).band_quantile, {"probability": 2}, "probability = 2"),
    ("analyse", uq.sensitivity.analyse, {"study": None}, "study = None: a Study"),
    (
        "write-study",
        uq.sensitivity.write_study,
        {"study": None, "path": "out"},
        "study = None: a Study",
    ),
    (
        "run-study",
        uq.sensitivity.run_study,
        {"model": abs, "epistemic": {"a": (0, 1)}, "seed": "a"},
        "seed = 'a'",
    ),
]


@pytest.mark.parametrize(
    ("call", "given", "message"), [pytest.param(*rest, id=name) for name, *rest in CALLS]
)
def test_what_is_refused_is_named_and_leaves_nothing(
    call: Callable,
    given: dict,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture,
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(uq.BadInputError, match=message) as caught:
        call(**given)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("other", ["espaaro_truth", "c172x"])
def test_a_trim_belongs_to_its_aircraft(other: str):
    steady = uq.find_trim("espaaro", 22.2, bank_rad=0.2)
    with pytest.raises(uq.BadInputError, match=f"not of aircraft '{other}'"):
        uq.linearise(other, steady)
    assert uq.linearise("espaaro", steady).A.shape == (8, 8)


def test_results_are_shown_in_a_line_and_as_a_table(flight: Flight):
    assert repr(flight) == "Flight('trim', 151 rows, 3 s, ok)"
    assert repr(uq.find_aircraft("espaaro")).startswith("Aircraft('espaaro', '")
    steady = uq.find_trim("espaaro", 22.2)
    gap = uq.compare(
        "espaaro", uq.fly("espaaro", "doublet-elevator", noise=True, seed=1), workers=1
    )
    study = uq.sensitivity.run_study(lambda a: a, {"a": (0, 1)}, samples=16)
    shown = [
        flight.record,
        steady,
        replace(steady, converged=False, reason="no steady flight at 5 m/s"),
        uq.linearise("espaaro", steady),
        uq.pbox([[1.0, 2.0]]),
        gap,
        study,
    ]
    for result in (*shown, uq.sensitivity.analyse(study)):
        assert repr(result).startswith(f"{type(result).__name__}(")
        assert len(repr(result)) < 250
        assert "\n" not in repr(result)
    assert "<th>q_radps</th>" in gap._repr_html_()
    assert "151 rows" in flight._repr_html_()
    assert "reaches the noise floor: yes" in gap._repr_html_()
    assert "<td>50</td><td>1</td>" in uq.pbox([[1.0, 2.0]])._repr_html_()
