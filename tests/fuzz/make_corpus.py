"""Writes the parts of the corpus that the project's own writers make: logs and results. ``python -m
tests.fuzz.make_corpus``.

Settings and the aircraft are written by hand. Folders of results keep the paths they were made
under, so they are made under one that is no machine's own."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from tests.fuzz.formats import CORPUS

_SCRATCH = Path("/tmp/uq-fuzz-corpus")
_ROWS = 70


def main() -> None:
    """Make everything anew."""
    sys.path[:0] = [str(CORPUS.parents[1]), str(CORPUS.parents[1] / "sysid")]
    shutil.rmtree(_SCRATCH, ignore_errors=True)
    _SCRATCH.mkdir()
    logs()
    results()
    shutil.rmtree(_SCRATCH)


def logs() -> None:
    """One short flight in every dialect, and tables with names of their own."""
    from sysid.logs.card import read_card
    from sysid.logs.dataflash_writer import write_dataflash
    from tests.helpers.log_writers import write_text_log, write_tlog, write_ulog
    from tests.helpers.synthetic import flight

    out = CORPUS / "logs"
    out.mkdir(exist_ok=True)
    trajectory = flight(duration_s=_ROWS / 50.0, start_s=5.0)
    trajectory = replace(
        trajectory, columns={n: np.round(v, 6) for n, v in trajectory.columns.items()}
    )
    card = read_card(CORPUS.parents[1] / "sysid" / "data" / "airframe.toml")
    write_dataflash(trajectory, out / "flight.bin", card, vehicle="ArduPlane V4.6.0")
    write_text_log(out / "flight.log", trajectory)
    write_tlog(out / "flight.tlog", trajectory, every=2)
    us = np.rint(trajectory["time_s"] * 1e6).astype(np.int64)
    names = {
        "gyro_rad": ("p_radps", "q_radps", "r_radps"),
        "accelerometer_m_s2": ("ax_mps2", "ay_mps2", "az_mps2"),
    }
    imu = {
        f"{g}[{i}]": trajectory[n] for g, members in names.items() for i, n in enumerate(members)
    }
    write_ulog(
        out / "flight.ulg",
        {
            "sensor_combined": (us, imu),
            "airspeed": (us, {"true_airspeed_m_s": trajectory["V_mps"]}),
        },
    )
    trajectory.write(out / "flight.csv")
    trajectory.write(out / "flight.parquet")
    settings = CORPUS / "settings"
    pd.read_csv(settings / "flights.csv").to_parquet(settings / "flights.parquet", index=False)
    _bomb(out / "bomb.parquet", "time_s", "V_mps", "q_radps")
    _bomb(out / "bomb-of-table.parquet", "time", "speed_kts", "q_degps")
    header = "Time,/fdm/jsbsim/velocities/vtrue-fps,/fdm/jsbsim/velocities/q-rad_sec,/fdm/jsbsim/fcs/elevator-cmd-deg"
    columns = [
        trajectory["time_s"],
        trajectory["V_mps"] / 0.3048,
        trajectory["q_radps"],
        trajectory["elevator_deg"],
    ]
    np.savetxt(
        out / "flight.jsbsim",
        np.column_stack(columns),
        delimiter=",",
        header=header,
        comments="",
        fmt="%.7g",
    )
    specific = pd.DataFrame(
        {
            "time": trajectory["time_s"],
            "speed_kts": trajectory["V_mps"] / 0.514444,
            "q_degps": np.degrees(trajectory["q_radps"]),
            "pitch_deg": np.degrees(trajectory["theta_rad"]),
            "C2": 1500 + 20 * trajectory["elevator_deg"],
            "lat": 45.0 + 1e-5 * trajectory["time_s"],
            "lon": 0.0,
            "alt_m": trajectory["h_m"],
            "one": 1.0,
        }
    ).round(5)
    specific.to_csv(out / "table.csv", index=False)
    specific.assign(note="fine").to_parquet(out / "table.parquet", index=False)


def _bomb(path: Path, *names: str) -> None:
    """Two hundred million rows of the same numbers: some kilobytes of file, gigabytes of memory for
    who believes in it.
    """
    rows = 10_000_000
    piece = pa.table({name: np.zeros(rows) for name in names})
    with pq.ParquetWriter(
        path, piece.schema, compression="zstd", write_statistics=False, max_rows_per_page=rows
    ) as writer:
        for _ in range(20):
            writer.write_table(piece, row_group_size=rows)


def results() -> None:
    """A small folder of each kind of results."""
    import tests.helpers.report_folders as folders

    folders.TIME = np.arange(0.0, 1.0, 0.02)
    from sysid.foreign.typed_files import dump
    from tests.helpers.model_forms import made_up_form
    from uqharness.sensitivity.study import run_study, write_study

    root = _SCRATCH / "results"
    root.mkdir()
    folders.identified(root / "fit")
    folders.compared(root / "compare")
    _fit(root / "fit")
    (root / "bounds").mkdir()
    form = made_up_form(
        {"CX": ("V_mps", "alpha_rad"), "Cm": ("alpha_rad", "q_radps")}, orders={"CX": 1, "Cm": 2}
    )
    form.write(root / "bounds" / "model-form.json")
    folders.covered(root / "coverage")
    folders.refined(root / "refined")
    _campaign(root / "campaign")
    _study(root)
    _instrumented(root)
    result = run_study(
        lambda a, b, w: {"y": a * b + w, "z": a - b},
        {"a": (0.0, 1.0), "b": (-1.0, 2.0)},
        {"w": _normal()},
        samples=16,
        draws=4,
    )
    write_study(result, root / "study.npz")
    (root / "stage.data").write_bytes(dump(_stage()))
    _wire(root)
    shutil.rmtree(CORPUS / "results", ignore_errors=True)
    shutil.copytree(
        root,
        CORPUS / "results",
        ignore=shutil.ignore_patterns("*.lock", "report.html", "figures", "input"),
    )


def _normal() -> object:
    from scipy import stats

    return stats.norm(0.0, 0.1)


def _fit(folder: Path) -> None:
    """A covariance for the parameters that are identified, so that a campaign can draw from it."""
    path = folder / "fit.json"
    document = json.loads(path.read_text())
    path.write_text(
        json.dumps(
            document | {"names": ["aero/Cm_q", "aero/Cl_0"], "cov": [[0.16, 1e-7], [1e-7, 1e-10]]}
        )
    )


def _campaign(folder: Path) -> None:
    """Two coefficients, two conditions, a rule that decides."""
    import tests.helpers.campaign_fakes as fakes
    from uqharness.campaign.processes import SerialExecutor
    from uqharness.campaign.read_spec import read_campaign
    from uqharness.campaign.run import run_campaign

    reference = folder.parent / "input"
    reference.mkdir()
    text = fakes.CAMPAIGN.replace("wind_mps = 3", "wind_mps = [3, 6]")
    text = text.replace(
        "bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }",
        'coefficients = ["CX", "CY"]\nbounds = { CX = 0.008, CY = 0.01 }',
    )
    text = (
        text.replace("flights = 3", "flights = 2") + '\n[stop]\nrule = "decide"\nlook_every = 1\n'
    )
    spec = read_campaign(fakes.campaign_file(reference, text))
    run_campaign(spec, folder, executor=SerialExecutor(), fly=fakes.by_corner)


def _study(root: Path) -> None:
    """A study whose stages are the other folders."""
    import tests.helpers.report_folders as folders

    inside = root / "study"
    for name in ("fit", "coverage"):
        shutil.copytree(root / name, inside / name)
    stages = [
        folders.stage("identify", "identify", "fit"),
        folders.stage("validate", "validate-bounds", "coverage"),
    ]
    folders.write_document(inside, "study.json", {"format": "study 1", **folders.study(stages)})


def _instrumented(root: Path) -> None:
    """The small aircraft with the plugin and its record."""
    from uqharness.cli.main import main as command_line

    copy = _SCRATCH / "aircraft" / "dart"
    shutil.copytree(CORPUS / "aircraft" / "dart", copy)
    with contextlib.redirect_stdout(io.StringIO()):
        code = command_line(
            [
                "instrument",
                str(copy),
                "--out",
                str(root / "instrumented" / "dart"),
                "--constant",
                "CX=0.01,Cm=0.02",
                "--no-check",
            ]
        )
    assert code == 0
    shutil.move(root / "instrumented" / "dart", root / "moved")
    (root / "instrumented").rmdir()
    shutil.move(root / "moved", root / "instrumented")


def _stage() -> object:
    """What a stage may hold: numbers, arrays, texts, nested."""
    return {
        "values": np.arange(6.0).reshape(2, 3),
        "names": ["a", "b"],
        ("pair", 1): (1, 2.5, None, True),
        "flags": np.array([True, False]),
        "labels": np.array(["x", "y"], dtype=object),
        "text": "fine",
        "where": {"deep": [{"er": b"bytes"}]},
        "nan": float("nan"),
    }


def _wire(root: Path) -> None:
    """An order and an answer as they go over Dask's wire."""
    from tests.helpers.campaign_fakes import small_spec
    from uqharness.campaign.cases import build_cases
    from uqharness.campaign.dask import OWN_FLIGHT, Answer, Order, answer_text, order_text
    from uqharness.campaign.processes import CaseOutcome, Group
    from uqharness.campaign.run import find_mission

    spec = small_spec(_SCRATCH / "wire")
    case = build_cases(spec, find_mission(spec, _SCRATCH / "wire"))[0]
    group = Group("", ((case.case_id, case.flight),))
    order = Order(
        OWN_FLIGHT, False, group, ("ab" * 32, "cd" * 32), (("uqharness", "0"), ("jsbsim", "1.3.3"))
    )
    (root / "order.json").write_text(order_text(order))
    outcome = CaseOutcome("4c4000eebc386034", "ok", "", 210.0, {"cross_track_median_m": 2.5}, {})
    (root / "answer.json").write_text(answer_text(Answer((outcome,))))


if __name__ == "__main__":
    main()
