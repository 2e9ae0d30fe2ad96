"""Small folders of results, written by hand, one for each kind of report page."""

from __future__ import annotations

import atexit
import json
import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from tests.helpers import campaign_fakes as fakes
from tests.helpers.flying_here import flying_here
from tests.helpers.model_forms import made_up_form
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.run import run_campaign
from uqharness.replay.histories import write_pieces

TIME = np.arange(0.0, 4.0, 0.02)


def write_document(folder, name, document):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(document))
    return folder


def pieces(folder, name, columns):
    write_pieces(
        folder / name,
        [("flight1", "roll doublet", TIME), ("flight1", "yaw doublet", TIME + 9.0)],
        columns,
    )


def wave(scale=1.0):
    return [scale * np.sin(TIME), scale * np.cos(3.0 * TIME)]


def identified(folder):
    """An identification with a parameter that is not identified and a channel without noise or
    value.
    """
    names = ("value", "std", "std_crb", "status", "reason", "initial")
    rows = {
        "aero/Cm_q": (-13.5, 0.4, 0.1, "identified", "", -9.7),
        "aero/Cl_0": (0.001, 1e-5, 1e-5, "identified", "", 0.0),
        "aero/Cn_p": (0.2, None, None, "not-identified", "<no> roll", 0.2),
    }
    channels = {
        "q_radps": {"rms": 0.01, "noise": 0.004, "predictable_share": None},
        "V_mps": {"rms": 0.5, "noise": None},
    }
    fit = {key: [] for key in ("names", "cov", "notes")} | {
        "aircraft": "plane & co",
        "method": "output error",
        "converged": True,
        "parameters": {name: dict(zip(names, row, strict=True)) for name, row in rows.items()},
        "warnings": ["coloured residuals"],
        "flights": ["a<b>.parquet"],
        "flights_sha256": ["ab" * 32],
        "fit": channels,
        "command": "uqharness identify plane --flight 'a<b>.parquet' --out out",
    }
    out = write_document(folder, "fit.json", fit)
    empty = [np.full(TIME.size, np.nan)] * 2
    columns = {"q_radps": wave(0.3), "q_radps_model": wave(0.29), "elevator": wave(5.0)}
    columns |= {"V_mps": empty, "V_mps_model": wave()}
    pieces(out, "histories.parquet", columns)
    return out


def compared(folder):
    """A comparison with a channel that is not judged."""
    channel = {"theil_u": 0.1, "delay_s": 0.0, "delay_std_s": None, "rms": 0.02}
    moment = {"time_s": 1.0, "channel": "q_radps", "manoeuvre": "roll doublet", "gap": 0.1}
    document = {
        "aircraft": "plane",
        "flight": "flight1",
        "reached_noise_floor": False,
        "above": ["q_radps"],
        "rule": "a rule",
        "channels": {
            "q_radps": channel | {"noise": 0.004, "ratio": 5.0, "judged": True},
            "psi_rad": channel | {"noise": 1e-9, "ratio": 2e7, "judged": False},
        },
        "coefficients": {"Cm": {"rms": 0.002, "noise": 0.001, "mean": None}},
        "manoeuvres": {
            "roll doublet": {"channels": {"q_radps": 5.0}, "coefficients": {"Cm": None}}
        },
        "moments": [moment | {"noises": 9.0}],
        "notes": [],
    }
    out = write_document(folder, "compare.json", document)
    columns = {"q_radps": wave(0.3), "q_radps_model": wave(0.2)}
    columns |= {"psi_rad": wave(), "psi_rad_model": wave()}
    pieces(out, "histories.parquet", columns | {"Cm_flight": wave(0.01), "Cm_model": wave(0.02)})
    return out


def refinement(**changes):
    """refinement.json."""
    rivals = [
        {"term": "da^2", "name": "aileron squared", "would_separate": "a roll at rest"},
        {"term": "r_hat^2", "name": "yaw rate squared"},
    ]
    effect = {
        "coefficient": "Cm",
        "term": "p_hat^2",
        "name": "pitching moment due to roll rate squared",
        "why": "the tail gains angle",
        "value": 2.9963,
        "std": 0.018,
        "unit": "1",
        "property": "aero/Cm_p2",
        "withdrawn": False,
        "evidence": {"t": 164.7, "twice_log_likelihood": None, "interval_95": [2.961, 3.032]},
        "alternatives": [row | {"separable": k == 1} for k, row in enumerate(rivals)],
    }
    where = {"coefficient": "Cm", "manoeuvre": "roll", "region": {"p_radps": [0.5, 2.0]}}
    where |= {"share_outside_95": 0.7, "size": 4.2}
    row = {"rms_before": 0.0071, "rms_after": 0.0034, "noise_rms": 0.0035}
    gap = {"channels": {"q_radps": row}, "coefficients": {"Cm": row}}
    gap["theil"] = {"before": 0.1, "after": 0.05}
    inside = {"width_before": 0.04, "width_after": 0.03, "coverage_before": 0.97}
    inside |= {"coverage_after": 0.96, "coverage_std_before": 0.01, "coverage_std_after": None}
    test = gap | {
        "intervals": {"reason": None, "confidence": 0.95, "coefficients": {"Cm": inside}},
        "pbox": {"reason": "no loiter here"},
    }
    remaining = {"unexplained": False, "where": []}
    remaining |= {"channels_above_noise": {}, "coloured_channels": []}
    scores = [{"effect": "Cm p_hat^2", "t": 164.7}, {"effect": "Cm da^2", "t": -90.0}]
    harmful = effect | {
        "name": "yawing moment due to elevator",
        "alternatives": [],
        "withdrawn": True,
        "test": {"gap": "grew", "change_of_twice_log_likelihood": -30.0, "std": 5.0},
    }
    return {
        "verdict": "effects-found",
        "effects": [effect],
        "withdrawn": [harmful],
        "gap": {"train": gap, "test": test},
        "model": "aircraft/plane/plane.xml",
        "disagreement": [where],
        "remaining": remaining,
        "parameters": {"aero/Cm_q": {"value": -13.8, "std": 0.1}},
        "switch": [{"property": "aero/Cm_p2", "off": 0.0}],
        "best_refused": None,
        "notes": [],
        "train": ["a"],
        "test": ["b"],
        "candidates": {"limit": 4.2, "scores": scores},
        "command": "uqharness refine plane --train a --test b",
        "seconds": 9.0,
    } | changes


def refined(folder):
    """A refinement with one effect, a rival it is not told from and one it is."""
    out = write_document(folder, "refinement.json", refinement())
    (out / "model.diff").write_text(
        "--- a/plane.xml\n+++ b/plane.xml\n+  <property>aero/Cm_p2</property>\n"
    )
    q = {"q_radps": wave(0.3), "q_radps_before": wave(0.2), "q_radps_after": wave(0.3)}
    pieces(out, "histories.parquet", q | {"Cm_gap_before": wave(0.01), "Cm_gap_after": wave(0.001)})
    return out


def bounded(folder):
    """A form alone, without the flights behind it."""
    folder.mkdir()
    made_up_form().write(folder / "model-form.json")
    return folder


def covered(folder):
    """A validation in which one coefficient's bounds do not hold, with the samples behind it."""
    row = {"0.95": 0.97, "0.68": 0.7, "n_effective": 80.0, "mean_width": 0.02}
    coverage = {"CX": row, "Cm": row | {"0.95": 0.4, "n_effective": None}}
    document = {"coverage": coverage, "errors": {"CX": {"0.95": 0.01, "0.68": None}}}
    document |= {"failed": ["Cm"], "warnings": [], "notes": []}
    out = write_document(folder, "coverage.json", document)
    edge = [np.full(TIME.size, 0.8)] * 2
    columns = {c: wave() for c in ("CX", "Cm")}
    for c in ("CX", "Cm"):
        columns |= {f"{c}_lower": [-v for v in edge], f"{c}_upper": edge}
    pieces(out, "residuals.parquet", columns)
    return out


def campaigns(root):
    """Two small campaigns, before and after, which differ in the number of flights."""
    shutil.copytree(_flown_campaigns(), root, dirs_exist_ok=True)
    return root


@cache
def _flown_campaigns():
    """The folder in which these campaigns were flown, once a process."""
    root = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, root, ignore_errors=True)
    with flying_here():
        for name, flights in (("before", 2), ("after", 3)):
            (root / f"{name}-input").mkdir()
            spec = fakes.small_spec(root / f"{name}-input", flights)
            run_campaign(spec, root / name, executor=SerialExecutor(), fly=fakes.steady)
    return root


ANSWER = {
    "level": "warn",
    "answer": "Yes in 3 and 7 m/s, no in 12 m/s wind with moderate turbulence (95 % confidence).",
    "why": (
        "Why: excursions beyond 15 m, worst corner: at most 1.55/h in 7 m/s, 12.2/h (6.4 to 19.9)"
        " in 12 m/s; acceptable 2/h; 400 h a condition, no flights aborted."
    ),
    "lacked": (
        "The model lacked rolling moment due to elevator, pitching moment due to roll rate squared,"
        " axial force due to pitch rate. With them: held-out residual of p from 4.04 to 1.01 sigma,"
        " cross-track p-box 57 % narrower, same answers."
    ),
    "next": (
        "Next: change the autopilot, the radius or the wind limit: 12 m/s moderate fails at the"
        " best corner too (at least 5.7/h), so no better model changes it."
    ),
}
"""A study's answer as long as that of `make demo`."""
TRACKS = {"wind_mps": 3.0, "turbulence": "moderate", "aleatory_id": 0, "radius_m": 15.0}


def tracks(folder):
    """tracks.parquet: circles of 120 m, nominal and worst corner, before and after, each off by its
    own amount.
    """
    time_s = np.arange(0.0, 60.0, 0.2)
    offset = {
        ("before", "nominal"): 8.0,
        ("before", "worst corner"): 18.0,
        ("after", "nominal"): 10.0,
        ("after", "worst corner"): 14.0,
    }
    rows = []
    for (when, model), largest in offset.items():
        distance = largest * np.sin(0.3 * time_s) ** 2
        north, east = ((120.0 + distance) * f(0.2 * time_s) for f in (np.cos, np.sin))
        columns = {"when": when, "model": model, "epistemic_id": "1", "time_s": time_s}
        rows.append(
            pd.DataFrame(columns | {"north_m": north, "east_m": east, "distance_m": distance})
        )
    pd.concat(rows).to_parquet(folder / "tracks.parquet", index=False)


def stage(name, kind, folder, **changes):
    """A stage of study.json."""
    row = {"name": name, "kind": kind, "folder": folder, "command": f"uqharness {kind} ..."}
    row |= {"state": "done", "exit": 0, "seconds": 1.5, "inputs": {"flight.bin": "cd" * 32}}
    return row | {"error": ""} | changes


def study(stages, **changes):
    """study.json."""
    row = {"study": "small", "question": "Is it good enough?", "file": "small.toml"}
    row |= {"hash": "ef" * 32, "version": "0", "state": "done", "stages": stages}
    row |= {"command": "uqharness study small.toml --out out"}
    return row | {"verdict": [{"text": "It holds.", "level": "good"}]} | changes
