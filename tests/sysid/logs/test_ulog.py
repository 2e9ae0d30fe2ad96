"""PX4's ULog: topics, units of time, damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs import ulog
from sysid.logs.load import import_log
from tests.helpers.log_writers import write_ulog
from tests.helpers.synthetic import flight


def test_ulog_quaternions_become_angles(tmp_path: Path) -> None:
    record = flight(30.0, start_s=2.0)
    us = np.rint(record["time_s"] * 1e6).astype(np.int64)
    half = [record[c] / 2 for c in ("phi_rad", "theta_rad", "psi_rad")]
    (cp, ct, cs), (sp, st, ss) = [np.cos(a) for a in half], [np.sin(a) for a in half]
    q = {
        "q[0]": cp * ct * cs + sp * st * ss,
        "q[1]": sp * ct * cs - cp * st * ss,
        "q[2]": cp * st * cs + sp * ct * ss,
        "q[3]": cp * ct * ss - sp * st * cs,
    }
    gyro = {f"gyro_rad[{i}]": record[c] for i, c in enumerate(("p_radps", "q_radps", "r_radps"))}
    path = tmp_path / "a.ulg"
    topics = {
        "vehicle_attitude": (us, q),
        "sensor_combined": (us, gyro),
        "airspeed": (us, {"true_airspeed_m_s": record["V_mps"]}),
    }
    write_ulog(path, topics)
    back = import_log(path)
    assert back.metadata.vehicle == "PX4 fixed wing"
    for name in ("phi_rad", "theta_rad", "psi_rad", "q_radps", "V_mps"):
        np.testing.assert_allclose(back[name], record[name], atol=1e-5, rtol=1e-5, err_msg=name)


def test_a_log_of_nothing_wanted_and_no_log_are_refused(tmp_path: Path) -> None:
    us = np.arange(0, 1_000_000, 20_000)
    write_ulog(tmp_path / "a.ulg", {"airspeed": (us, {"v": np.ones(len(us))})})
    with pytest.raises(LogError, match="no topic with flight data"):
        ulog.read(tmp_path / "a.ulg", {"battery_status": frozenset({"v"})})
    (tmp_path / "b.ulg").write_bytes(b"no log at all")
    with pytest.raises(LogError, match="damaged or not a ULog file"):
        ulog.read(tmp_path / "b.ulg")
