"""Seeded faults of units and signs become findings with channel and size; sound flights have
none.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.errors import Finding
from sysid.logs.checking.checks import AXES, check_motion, effect, recheck
from sysid.logs.checking.kinematics import (
    LAWS,
    estimate_relation,
    stretches,
    to_body,
    to_earth,
)
from sysid.logs.checking.physics import check_physics
from sysid.logs.checking.signals import (
    detect_wraps,
    interpolation_interval,
    sample_hold,
    stuck_span,
)
from sysid.logs.load import import_log
from sysid.record import FlightRecord, Metadata
from tests.helpers.few import few
from tests.helpers.log_faults import FAULTS, SURFACE_FAULTS, seeded
from tests.helpers.synthetic import flight

NOISE = {
    "V_mps": 0.5,
    "alpha_rad": 0.002,
    "beta_rad": 0.002,
    "phi_rad": 0.003,
    "theta_rad": 0.003,
    "psi_rad": 0.005,
    "p_radps": 0.004,
    "q_radps": 0.004,
    "r_radps": 0.004,
    "ax_mps2": 0.16,
    "ay_mps2": 0.16,
    "az_mps2": 0.16,
    "h_m": 0.3,
    "vn_mps": 0.05,
    "ve_mps": 0.05,
    "vd_mps": 0.05,
}

QUICK = (
    "airspeed in knots",
    "accelerations in g",
    "az reversed",
)
"""Faults of the fast set."""
GENUINE = (
    "airspeed in knots",
    "accelerations in g",
    "height in feet",
    "az reversed",
    "ay reversed",
    "q in deg/s",
)


def noisy(seed: int, amplitude: float = 1.0) -> FlightRecord:
    record, rng = (
        flight(90.0, seed=seed, wind=(3.0, -2.0), amplitude=amplitude),
        np.random.default_rng(seed),
    )
    return record.with_columns(
        {n: record[n] + s * rng.standard_normal(len(record)) for n, s in NOISE.items()}
    )


def slips(result: list[Finding]) -> dict[str, float]:
    return {f.channel: f.numbers["slope"] for f in result if f.code in ("unit", "sign")}


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FAULTS],
)
def test_a_slip_is_named_with_its_channel_and_size(name: str) -> None:
    result = check_physics(seeded(noisy(1), FAULTS[name]))
    assert slips(result) == pytest.approx(FAULTS[name], rel=0.02)
    assert all(f.spoils and f.mend for f in result if f.code in ("unit", "sign"))


@pytest.mark.parametrize("amplitude", few([0.0, 0.1, 1.0], 2))
def test_noise_is_no_finding(amplitude: float) -> None:
    for seed in range(3):
        assert [f for f in check_motion(noisy(seed, amplitude)) if f.severity != "info"] == []


@pytest.mark.parametrize("fault", ["", *GENUINE, *SURFACE_FAULTS])
def test_a_genuine_flight(fault: str, flight_data: Path, card_path: Path) -> None:
    record = import_log(flight_data / "espaaro-ardupilot" / "flight1_ident.BIN", None, card_path)
    start, _ = record.metadata.free_flight_s[0]
    part = record.between(start, start + 120.0)
    invalid = {**FAULTS, **SURFACE_FAULTS}.get(fault, {})
    assert slips(check_motion(seeded(part, invalid))) == pytest.approx(dict(invalid), rel=0.02)


# The surfaces.


def driven(sense: float) -> FlightRecord:
    """A damped pitch axis with steps of the elevator, and noise."""
    rng, dt, n = np.random.default_rng(5), 0.02, 3000
    elevator = np.repeat(rng.choice([-4.0, 0.0, 4.0], n // 50), 50)
    q, out = 0.0, np.zeros(n)
    for k in range(n):
        q += dt * (-3.0 * q + sense * 0.3 * elevator[k])
        out[k] = q
    columns = {
        "time_s": dt * np.arange(n),
        "elevator_deg": elevator,
        "q_radps": out + 0.004 * rng.standard_normal(n),
    }
    return FlightRecord(columns, Metadata(dialect="record"))


def test_a_reversed_surface_is_told_from_a_right_one() -> None:
    right, invalid = (effect(driven(s), AXES[0]) for s in (-1.0, 1.0))
    assert right is not None
    assert right.certain
    assert right.slope == pytest.approx(-0.3, rel=0.15)
    assert invalid is not None
    assert invalid.certain
    assert invalid.slope == pytest.approx(0.3, rel=0.15)
    assert slips(check_motion(driven(-1.0))) == {}
    assert slips(check_motion(driven(1.0))) == {"elevator_deg": -1.0}


# Samples.


def test_coarse_held_interpolated_stuck_and_wrapped() -> None:
    rng = np.random.default_rng(3)
    smooth = np.cumsum(np.convolve(rng.standard_normal(4000), np.ones(40) / 40, "same"))
    coarse = sample_hold(np.round(smooth / 2.0) * 2.0)
    assert coarse is not None
    assert not coarse.is_held
    assert coarse.quantum == pytest.approx(2.0)
    retained = sample_hold(np.repeat(smooth[::5], 5))
    assert retained is not None
    assert retained.is_held
    assert retained.run == pytest.approx(5.0, rel=0.02)
    assert sample_hold(smooth) is None
    at = np.arange(len(smooth))
    assert interpolation_interval(np.interp(at, at[::5], smooth[::5])) == pytest.approx(
        5.0, rel=0.05
    )
    assert interpolation_interval(smooth) is None
    assert (
        interpolation_interval(np.round(at * 0.0909) * 0.011 + 0.002 * at) is None
    )  # a steady motion in steps of 11 mm
    steady = smooth + rng.standard_normal(4000)
    assert stuck_span(steady, 0.02) is None
    steady[1000:1200] = steady[1000]
    assert stuck_span(steady, 0.02) == (1000, 1199)
    assert detect_wraps(np.mod(np.cumsum(np.full(500, 3.0)), 256.0)) == (5, 256.0, "8-bit")
    assert detect_wraps(np.where(at > 2000, 256.0, 0.0) + rng.standard_normal(4000)) is None


# Pieces.


def test_every_law_holds_in_an_exact_flight() -> None:
    record = flight(120.0, seed=2)
    result = {
        law: estimate_relation(law, part)
        for law in LAWS
        if (part := stretches(record, law)) is not None
    }
    assert len(result) == len(LAWS)
    off = {
        f"{law.subject}: {law.statement}"
        for law, relation in result.items()
        if relation.evident and not relation.allows(1.0, 0.05)
    }
    assert off <= {
        "h_m: airspeed and pitch angle",
        "V_mps: the turns that the accelerometers feel",
    }  # which are approximations
    vector = np.random.default_rng(0).standard_normal((3, len(record)))
    np.testing.assert_allclose(
        to_body(record.columns, to_earth(record.columns, vector)), vector, atol=1e-12
    )


@pytest.mark.slow
def test_a_record_imported_before_a_fault_was_known_is_checked_again(tmp_path: Path) -> None:
    old = FlightRecord(
        seeded(noisy(1), FAULTS["az reversed"]).columns, Metadata(dialect="dataflash", findings=())
    )
    old.write(tmp_path / "old.parquet")
    assert slips(list(import_log(tmp_path / "old.parquet").metadata.findings)) == {"az_mps2": -1.0}
    assert slips(recheck(noisy(1))) == {}


def test_coarse_barometer_that_reads_the_flow_is_in_no_other_unit() -> None:
    """Its error in the band of the check is dynamic: no constant factor, so no unit."""
    record = noisy(1)
    time_s, h = record["time_s"], record["h_m"]
    fast = h - np.convolve(np.pad(h, 75, mode="edge"), np.ones(151) / 151, mode="valid")
    constant = (np.arange(len(time_s)) // round(0.55 / record.dt_s)) * round(0.55 / record.dt_s)
    columns = {n: record[n][constant] for n in ("vn_mps", "ve_mps", "vd_mps")}
    port = 1.76 * np.round((h + 2.0 * fast) / 1.76)
    findings = check_physics(record.with_columns({**columns, "h_m": port}))
    assert not [f.message for f in findings if f.severity == "error"]
