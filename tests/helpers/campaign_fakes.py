"""Flight functions that do on purpose what real flights do by accident, importable by worker
processes of any start method.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uqharness.flight.spec import COEFFICIENTS, FlightResult, FlightSpec

if TYPE_CHECKING:
    from uqharness.campaign import CampaignSpec

# Nothing heavy is imported here: each worker that dies costs its successor these imports.
ERROR_METRICS = [
    f"{name}{suffix}"
    for name in (
        "cross_track_median_m",
        "cross_track_mean_m",
        "cross_track_max_m",
        "altitude_median_m",
        "altitude_mean_m",
        "altitude_max_m",
        "speed_median_mps",
        "speed_mean_mps",
        "speed_max_mps",
    )
    for suffix in ("", "_measured")
]
EXCURSIONS = ["excursions_15m", "excursions_25m", "excursions_15m_3d", "excursions_25m_3d"]

CAMPAIGN = """
[campaign]
aircraft = "plane"
mission = "loiter.xml"
seed = 7

[aleatory]
flights = 3
duration_s = 150
burn_in_s = 60
wind_mps = 3
turbulence = "moderate"
turbulence_source = "jsbsim"

[epistemic]
method = "corners"
bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }
interior = 0
nominal = false
"""


def campaign_file(folder: Path, text: str = CAMPAIGN) -> Path:
    """A campaign file with an aircraft and a script beside it."""
    (folder / "plane").mkdir(parents=True, exist_ok=True)
    (folder / "plane" / "plane.xml").write_text(
        '<fdm_config><property value="0">sensor/V-mps</property></fdm_config>'
    )
    (folder / "loiter.xml").write_text("<runscript/>")
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def small_spec(folder: Path, flights: int = 3, **changes: object) -> CampaignSpec:
    """CAMPAIGN with other numbers."""
    from uqharness.campaign.read_spec import read_campaign

    spec = read_campaign(campaign_file(folder))
    return replace(spec, aleatory=spec.aleatory.model_copy(update={"flights": flights, **changes}))


def level_sum(spec: FlightSpec) -> float:
    return sum(spec.properties.get(f"uq/{name}/level", 0.5) for name in COEFFICIENTS)


def steady(spec: FlightSpec) -> FlightResult:
    """Numbers that depend on the spec alone."""
    draw = np.random.default_rng([spec.seed_turbulence, spec.seed_noise])
    base = 1.0 + level_sum(spec) + spec.wind_mps
    metrics = {name: base * float(draw.gamma(4.0)) for name in ERROR_METRICS}
    metrics |= {name: float(draw.poisson(0.1)) for name in EXCURSIONS}
    metrics |= {"loss_of_control": 0.0, "extrapolated_share": 0.0}
    return FlightResult("ok", "", spec.burn_in_s + spec.duration_s, metrics, {}, {})


def by_corner(spec: FlightSpec) -> FlightResult:
    """Excursions in clusters of two, at a rate that two levels and the wind set: 0, 0.2 or 4 a
    flight.
    """
    levels = [spec.properties.get(f"uq/{name}/level", 0.5) for name in ("CX", "CY")]
    rate = 0.0 if spec.wind_mps < 5.0 else {0.0: 0.0, 0.5: 0.2, 1.0: 4.0}[sum(levels) / 2.0]
    draw = np.random.default_rng([spec.seed_turbulence, int(4 * sum(levels))])
    result = steady(spec)
    return replace(
        result, metrics=dict(result.metrics) | {"excursions_15m": 2.0 * draw.poisson(rate / 2.0)}
    )


_TRIVIAL = dict.fromkeys(
    [*ERROR_METRICS, *EXCURSIONS, "loss_of_control", "extrapolated_share"], 0.0
)


def trivial(spec: FlightSpec) -> FlightResult:
    """Costs nothing, so that what is left is the harness."""
    return FlightResult(
        "ok", "", spec.burn_in_s + spec.duration_s, _TRIVIAL | {"cross_track_max_m": 1.0}, {}, {}
    )


def slow(spec: FlightSpec) -> FlightResult:
    time.sleep(0.02)
    return steady(spec)


def kills_its_parent(spec: FlightSpec) -> FlightResult:
    """One flight in ten takes the process with it that started this one."""
    if _nth(spec) == 0:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(10)
    return steady(spec)


def _nth(spec: FlightSpec) -> int:
    """A number from 0 to 9 that tells flights apart."""
    return int(round(level_sum(spec)) * 7 + spec.seed_turbulence) % 10


def hazardous(spec: FlightSpec) -> FlightResult:
    """One flight in ten aborts the interpreter, one faults, one diverges, one raises, one leaves
    with an exit code.
    """
    kind = _nth(spec)
    if kind == 0:
        os.kill(os.getpid(), signal.SIGABRT)
    if kind == 1:
        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == 2:
        return FlightResult(
            "diverged",
            "the state was no longer finite at 90.0 s",
            90.0,
            {"excursions_15m": 2.0},
            {},
            {},
        )
    if kind == 3:
        raise RuntimeError("a flight that raises")
    if kind == 4:
        os._exit(3)
    return steady(spec)


def hazardous_but_alive(spec: FlightSpec) -> FlightResult:
    """The hazards that leave the process alive."""
    return hazardous(spec) if _nth(spec) in (2, 3) else steady(spec)


def hangs_sometimes(spec: FlightSpec) -> FlightResult:
    if _nth(spec) == 0:
        time.sleep(3600)
    return steady(spec)


def diverges(spec: FlightSpec) -> FlightResult:
    return FlightResult("diverged", "the state was no longer finite at 61.0 s", 61.0, {}, {}, {})


def aborts_always(spec: FlightSpec) -> FlightResult:
    os.abort()


def refuses(spec: FlightSpec) -> FlightResult:
    from uqharness.errors import BadInputError

    raise BadInputError("property 'uq/active' does not exist in this model")


def reports_threads(spec: FlightSpec) -> FlightResult:
    names = {"omp": "OMP_NUM_THREADS", "openblas": "OPENBLAS_NUM_THREADS"}
    return FlightResult(
        "ok", "", 1.0, {key: float(os.environ[name]) for key, name in names.items()}, {}, {}
    )


def _end_at_once() -> None:
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    os._exit(7)


class NotThere:
    """A flight function that ends the process which unpickles it."""

    def __reduce__(self) -> tuple[Callable[[], None], tuple[()]]:
        return _end_at_once, ()

    def __call__(self, spec: FlightSpec) -> FlightResult:
        raise NotImplementedError


@contextlib.contextmanager
def dask_cluster(workers: int = 2, processes: bool = True) -> Iterator[Any]:
    """A Dask cluster of processes, or of threads, whose operator trusts this module."""
    import pytest
    from distributed import LocalCluster

    from uqharness.campaign.dask import MODULES_VARIABLE

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(MODULES_VARIABLE, "tests.helpers.campaign_fakes")
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=processes, dashboard_address=":0"
        ) as result:
            yield result


def undefined_speed(spec: FlightSpec) -> FlightResult:
    result = steady(spec)
    metrics = dict(result.metrics) | {"speed_median_mps": float("nan")}
    return replace(
        result, metrics=metrics, undefined={"speed_median_mps": "no speed was commanded"}
    )


def undefined_excursions(spec: FlightSpec) -> FlightResult:
    result = steady(spec)
    metrics = {
        name: value for name, value in result.metrics.items() if not name.startswith("excursions")
    }
    return replace(result, metrics=metrics)


def main() -> None:
    """python -m tests.helpers.campaign_fakes FOLDER OUT FLIGHTS FAKE WORKERS START_METHOD: a run
    that a test may kill.
    """
    from uqharness.campaign.processes import ProcessExecutor
    from uqharness.campaign.run import run_campaign

    folder, out, flights, fake, workers, method = sys.argv[1:7]
    executor = ProcessExecutor(int(workers), method)
    local = sys.modules["tests.helpers.campaign_fakes"]
    run_campaign(
        small_spec(Path(folder), int(flights)), out, executor=executor, fly=getattr(local, fake)
    )


if __name__ == "__main__":
    import tests.helpers.campaign_fakes

    tests.helpers.campaign_fakes.main()
