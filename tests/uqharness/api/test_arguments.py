"""What every function of the public face refuses: one sentence with the argument's name, nothing
printed, nothing left behind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
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


E = {"aircraft": "espaaro"}
ON_FILE = E | {"flights": "a.csv"}
PLUGIN = E | {"out": "out"}
RUN = {"campaign": CAMPAIGN, "out": "out"}
BOX = uq.pbox([[1.0, 2.0]])
CALLS: list[tuple[Callable[..., Any], dict[str, Any], str]] = [
    (uq.find_aircraft, {"name_or_folder": 5}, "aircraft = 5"),
    (uq.fly, E | {"noise": 3}, "noise = 3: True or False"),
    (uq.fly, E | {"seed": "a"}, "seed = 'a': a whole number of at least 0"),
    (uq.fly, E | {"duration_s": "10"}, "duration_s = '10'"),
    (uq.fly, E | {"properties": {"aero/Cm_q": math.nan}}, r"properties = \{'aero/Cm_q': nan\}"),
    (uq.read_flights, E | {"paths": "a.csv", "signal_map": 5}, "signal_map = 5"),
    (uq.find_trim, E | {"V_mps": "fast"}, "V_mps = 'fast'"),
    (uq.find_trim, E | {"V_mps": 22, "bank_rad": 2.0}, "bank_rad = 2"),
    (uq.linearise, E | {"steady": None}, "trim = None: a Trim"),
    (uq.instrument, PLUGIN | {"constant": ["CX"]}, r"constant = \['CX'\]"),
    (uq.instrument, PLUGIN | {"constant": {"CX": (0, 0, 1)}}, "constant = .*: CX: a half width"),
    (uq.instrument, PLUGIN | {"constant": {"CX": -1}}, "constant = {'CX': -1}: CX: a half width"),
    (uq.instrument, PLUGIN, "no bounds; give form, or constant"),
    (uq.identify, E | {"flights": 5}, "flights = 5"),
    (uq.identify, ON_FILE | {"workers": "2"}, "workers = '2': a whole number"),
    (uq.identify, ON_FILE | {"parameters": []}, r"parameters = \[\]: a property or several"),
    (uq.compare, E | {"flight": "a.csv", "workers": 1.5}, "workers = 1.5"),
    (uq.fit_model_form, ON_FILE | {"confidence": "x"}, "confidence = 'x'"),
    (uq.fit_model_form, ON_FILE | {"states": ["CX"]}, "states = "),
    (uq.run_campaign, RUN | {"out": None}, "out = None"),
    (uq.run_campaign, RUN | {"on_progress": 5}, "on_progress = 5: a function"),
    *((uq.run_campaign, RUN | {"workers": wrong}, "workers = ") for wrong in (0, 1.5, "2", True)),
    (uq.read_campaign, {"folder": 5}, "folder = 5"),
    (uq.pbox, {"samples": [[1.0]], "confidence": "x"}, "confidence = 'x'"),
    (uq.plot_pbox, {"box": None}, "box = None: a PBox"),
    (uq.plot_pbox, {"box": BOX, "ax": 5}, "ax = 5: matplotlib's Axes"),
    (BOX.quantile, {"probability": 2}, "probability = 2: a number"),
    (uq.sensitivity.analyse, {"study": None}, "study = None: a Study"),
    (uq.sensitivity.write_study, {"study": None, "path": "out"}, "study = None: a Study"),
    (uq.sensitivity.run_study, {"model": abs, "epistemic": {"a": (0, 1)}, "seed": "a"}, "seed ="),
]


@pytest.mark.parametrize(("call", "inputs", "message"), CALLS)
def test_what_is_refused_is_named_and_leaves_nothing(
    call, inputs, message, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(uq.BadInputError, match=message) as caught:
        call(**inputs)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("other", ["espaaro_truth", "c172x"])
def test_a_trim_belongs_to_its_aircraft(other: str):
    steady = uq.find_trim("espaaro", 22.2, bank_rad=0.2)
    with pytest.raises(uq.BadInputError, match=f"'{other}' is not in steady flight"):
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
    visible = [
        flight.record,
        steady,
        replace(steady, converged=False, reason="no steady flight at 5 m/s"),
        uq.linearise("espaaro", steady),
        uq.pbox([[1.0, 2.0]]),
        gap,
        study,
    ]
    for result in (*visible, uq.sensitivity.analyse(study)):
        assert repr(result).startswith(f"{type(result).__name__}(")
        assert len(repr(result)) < 250
        assert "\n" not in repr(result)
    assert "<th>q_radps</th>" in gap._repr_html_()
    assert "151 rows" in flight._repr_html_()
    assert "reaches the noise floor: yes" in gap._repr_html_()
    assert "<td>50</td><td>1</td>" in uq.pbox([[1.0, 2.0]])._repr_html_()
