"""Flight path reconstruction: what biases, scale errors and wind make a flight's channels agree with one another.

The body-axis kinematics are driven by the measured accelerations and rates, stretch by stretch and never across a gap,
and compared with V, alpha, beta, attitude, height, ground velocity and position (Klein & Morelli, Aircraft System
Identification, ch. 10). The inertial sensors' noise is integrated with the motion, so it counts as process noise: an
iterated Kalman smoother carries states, wind and sensor errors together. Output error leaves that noise out, and its
bounds are then too small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.flight_record import FlightRecord
from sysid.log_errors import LogError
from sysid.path_data import FIRST_NOISE, NOISE_FLOOR, PathData, build, first_path, input_noise, thinned
from sysid.path_excitation import possible
from sysid.path_judgement import PRIOR_STD, judge, long_run_variance
from sysid.path_kinematics import INPUT_BIASES, INPUTS, NAMES, OUTPUTS, SENSOR_TERMS, STATES, WIND, outputs
from sysid.path_smoother import Noise, Pass, run

FloatArray = NDArray[np.float64]
MIN_RATE_HZ = 20.0
DEFAULT_FREE = (*INPUT_BIASES, "scale_V", *SENSOR_TERMS[2:], *WIND[:2])
_PASSES = 6
# Levels tried, from none upwards: gusts (m/s per root second), wandering gyro biases (rad/s per root second).
WIND_WALKS = (0.0, 0.05, 0.2, 0.5, 1.0, 2.0)
GYRO_WALKS = (0.0, 1e-5, 3e-5, 1e-4)
_STATE_STD = np.array([20.0, 20.0, 20.0, 0.5, 0.5, 3.0, 1e3, 1e4, 1e4])
_D = len(STATES)


@dataclass(frozen=True)
class PathParameter:
    """One estimate. Not identified: value and std are NaN and `reason` says why; it is carried along with what such
    sensors are off by anyway (path_judgement.PRIOR_STD), so that the other parameters' standard errors allow for it.

    std  standard error, widened where the innovations are not white; std_crb  without that widening
    """

    value: float
    std: float
    std_crb: float
    status: str
    reason: str = ""


@dataclass(frozen=True)
class PathReconstruction:
    """Result of `reconstruct_path`.

    parameters  name -> estimate; measured = (1 + scale) * true + bias, accelerations and rates with bias only; wind is
                the air's motion over the ground; what walks (wind, gyro biases) is given at the end of the flight
    names, cov  the identified parameters and their (k, k) covariance
    corrected   the record with biases and scale errors taken out of its measured channels
    path        the record with V, alpha, beta, attitude, height and ground velocity of the smoothed path (NaN outside
                the stretches used), thinned to 60 Hz at most
    fit         channel -> {"noise": estimated standard deviation, "whiteness": long-run variance of its innovations
                over their variance, 1 when white}
    wind_walk   gusts, m/s per square root of a second, 0 in calm air
    gyro_walk   wander of the gyro biases, rad/s per square root of a second
    """

    parameters: Mapping[str, PathParameter]
    names: tuple[str, ...]
    cov: FloatArray
    corrected: FlightRecord
    path: FlightRecord
    stretches_s: tuple[tuple[float, float], ...]
    fit: Mapping[str, Mapping[str, float]]
    wind_walk: float
    gyro_walk: float
    converged: bool
    warnings: tuple[str, ...]


def reconstruct_path(
    record: FlightRecord,
    free: Sequence[str] = DEFAULT_FREE,
    *,
    min_s: float = 10.0,
    max_s: float = 60.0,
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    delays_s: Mapping[str, float] | None = None,
    use_estimates: bool = False,
    wind_walk: float | None = None,
) -> PathReconstruction:
    """Estimate sensor errors and wind.

    record         needs accelerations, rates, attitude and V; alpha, beta, h, ground velocity, position where present
    free           parameters to estimate (also bias_V, wind_d)
    min_s, max_s   shortest stretch used; longer ones are cut (each has its own start state)
    arm_m          place of the accelerometers from the CG
    delays_s       channel -> how late it comes; default: what the record's findings say
    use_estimates  use alpha and beta although an estimator computed them
    wind_walk      gusts in m/s per root second; None: the most likely of a few
    Raises LogError, with the reason, for a record that cannot serve.
    """
    known = (*INPUT_BIASES, *SENSOR_TERMS, *WIND)
    unknown = sorted(set(free) - set(known))
    if unknown:
        raise LogError(f"unknown parameters {unknown}; allowed are {list(known)}")
    rate = 1.0 / record.dt_s
    if not rate >= 0.95 * MIN_RATE_HZ:
        raise LogError(f"rates and accelerations at {rate:.1f} Hz cannot be integrated; at least {MIN_RATE_HZ:g} Hz")
    data = build(thinned(record), min_s, max_s, arm_m, delays_s, use_estimates)
    data, names, refused = possible(free, data)
    search = _Search(data, wind_walk)
    mean, cov, passes, converged = search.solve({n: PRIOR_STD[n] for n in names})
    inflation = max(1.0, long_run_variance(passes))
    index = [NAMES.index(n) for n in names]
    refused |= judge(names, inflation * cov[np.ix_(index, index)])
    names = tuple(n for n in names if n not in refused)
    index = [NAMES.index(n) for n in names]
    block = cov[np.ix_(index, index)]
    values = {n: float(mean[NAMES.index(n)]) for n in names}
    std_crb = np.sqrt(np.diag(block))
    estimates = {
        n: PathParameter(values[n], float(std_crb[i] * np.sqrt(inflation)), float(std_crb[i]), "identified")
        for i, n in enumerate(names)
    }
    nan = float("nan")
    missing = {n: PathParameter(nan, nan, nan, "not-identified", why) for n, why in refused.items()}
    fit = search.fit(passes)
    return PathReconstruction(
        parameters={n: estimates.get(n) or missing[n] for n in dict.fromkeys(free)},
        names=names,
        cov=block * inflation,
        corrected=_corrected(record, values),
        path=_path(thinned(record), data, passes),
        stretches_s=data.spans_s,
        fit=fit,
        wind_walk=search.noise.wind_walk,
        gyro_walk=search.noise.gyro_walk,
        converged=converged,
        warnings=(*data.notes, *_warnings(fit, inflation, converged, search.noise.wind_walk)),
    )


class _Search:
    """Repeated smoothing with the noise levels re-estimated; the path and noise found serve the next set of names."""

    def __init__(self, data: PathData, wind_walk: float | None) -> None:
        self.data = data
        self.nominal = [first_path(s) for s in data.stretches]
        levels = np.array([FIRST_NOISE[c] for c in OUTPUTS])
        self.noise = Noise(input_noise(data), levels, wind_walk or 0.0)
        self.choices: list[tuple[Callable[[Noise, float], Noise], tuple[float, ...]]] = [(_with_gyro_walk, GYRO_WALKS)]
        if wind_walk is None and any(c in data.channels for c in ("vn_mps", "north_m")):
            self.choices.append((_with_wind_walk, WIND_WALKS))

    def solve(self, prior: Mapping[str, float]) -> tuple[FloatArray, FloatArray, list[Pass], bool]:
        """Augmented mean and covariance at the end, the passes over all stretches, and whether it settled.

        prior  parameter -> standard deviation before the flight; what is not named stands at zero
        """
        before = np.full(len(NAMES), np.inf)
        for i in range(_PASSES):
            mean, cov, passes = self._sweep(prior, self.noise, smooth=True)
            self._update(passes, mean)
            if i == 1:
                self._choose_walks(prior)
            index = [NAMES.index(n) for n in prior]
            change = np.abs(mean - before)[index]
            settled = bool(np.all(change <= 0.1 * np.sqrt(np.diag(cov)[index])))
            before = mean
            if settled and i >= 2:
                break
        return mean, cov, passes, settled

    def _sweep(self, prior: Mapping[str, float], noise: Noise, smooth: bool) -> tuple[FloatArray, FloatArray, list[Pass]]:
        """All stretches in turn: sensor errors and wind are carried from one to the next, the state begins anew."""
        mean, cov = np.zeros(len(NAMES)), np.zeros((len(NAMES), len(NAMES)))
        for n, std in prior.items():
            cov[NAMES.index(n), NAMES.index(n)] = std**2
        passes = []
        for stretch, nominal in zip(self.data.stretches, self.nominal, strict=True):
            start = mean.copy()
            start[:_D] = nominal[:_D, 0]
            fresh = cov.copy()
            fresh[:_D, :], fresh[:, :_D] = 0.0, 0.0
            fresh[:_D, :_D] = np.diag(_STATE_STD**2)
            found = run(stretch, nominal, start, fresh, noise, self.data.dt_s, smooth)
            passes.append(found)
            mean, cov = found.mean, found.cov
        return mean, cov, passes

    def _update(self, passes: list[Pass], mean: FloatArray) -> None:
        fixed = [NAMES.index(n) for n in (*INPUT_BIASES, *SENSOR_TERMS)]
        for k, found in enumerate(passes):
            path = found.path.copy()
            # Linearise everywhere about the newest sensor errors, not about those known when the stretch was passed.
            path[fixed] = mean[fixed, None]
            self.nominal[k] = path
        joined = np.concatenate([p.residual2 * np.where(np.isfinite(p.innovation), 1.0, np.nan) for p in passes], axis=1)
        floor = NOISE_FLOOR * np.array([FIRST_NOISE[c] for c in OUTPUTS])
        compared = np.isfinite(joined).any(axis=1)
        levels = self.noise.outputs.copy()
        levels[compared] = np.sqrt(np.nanmean(joined[compared], axis=1))
        self.noise = replace(self.noise, outputs=np.maximum(levels, floor))

    def _choose_walks(self, prior: Mapping[str, float]) -> None:
        """Gusts and wandering gyro biases by the likelihood of the innovations, each from none upwards."""
        for with_walk, candidates in self.choices:
            likely = -np.inf
            for walk in candidates:
                noise = with_walk(self.noise, walk)
                total = sum(p.loglik for p in self._sweep(prior, noise, smooth=False)[2])
                # A walk has to earn its keep: two units of log likelihood for one parameter.
                if total <= likely + 2.0:
                    break
                best, likely = noise, total
            self.noise = best
        self.choices = []

    def fit(self, passes: list[Pass]) -> dict[str, dict[str, float]]:
        """Noise and whiteness by channel."""
        return {
            c: {"noise": float(self.noise.outputs[k]), "whiteness": long_run_variance(passes, k)}
            for k, c in enumerate(OUTPUTS)
            if c in self.data.channels
        }


def _with_gyro_walk(noise: Noise, walk: float) -> Noise:
    return replace(noise, gyro_walk=walk)


def _with_wind_walk(noise: Noise, walk: float) -> Noise:
    return replace(noise, wind_walk=walk)


def _warnings(fit: Mapping[str, Mapping[str, float]], inflation: float, converged: bool, walk: float) -> list[str]:
    out = []
    coloured = [f"{c} {v['whiteness']:.1f}" for c, v in fit.items() if v["whiteness"] > 3.0]
    if coloured:
        out.append(f"innovations are not white (long-run variance, 1 when white: {', '.join(coloured)})")
    if inflation > 1.5:
        out.append(f"standard errors were widened by {np.sqrt(inflation):.2f} for it")
    if walk > 0:
        out.append(f"gusty air: the wind walks by {walk:g} m/s per root second")
    if not converged:
        out.append("the search stopped before it settled: do not trust the figures")
    return out


def _corrected(record: FlightRecord, values: Mapping[str, float]) -> FlightRecord:
    columns: dict[str, FloatArray] = {}
    for bias, channel in zip(INPUT_BIASES, INPUTS, strict=True):
        columns[channel] = record[channel] - values.get(bias, 0.0)
    for sensor, channel in (("V", "V_mps"), ("alpha", "alpha_rad"), ("beta", "beta_rad")):
        if channel in record:
            shifted = record[channel] - values.get(f"bias_{sensor}", 0.0)
            columns[channel] = shifted / (1.0 + values.get(f"scale_{sensor}", 0.0))
    return record.with_columns(columns)


def _path(record: FlightRecord, data: PathData, passes: list[Pass]) -> FlightRecord:
    """The record with the smoothed motion, sensor errors not added, on the record's own rows."""
    columns = {c: np.full(len(record), np.nan) for c in OUTPUTS}
    for stretch, found in zip(data.stretches, passes, strict=True):
        clean = found.path.copy()
        clean[18:24] = 0.0
        for c, values in zip(OUTPUTS, outputs(clean), strict=True):
            columns[c][stretch.rows] = values
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2 * np.pi)
    absent = {"h_m", "north_m", "east_m", "vn_mps", "ve_mps", "vd_mps"} - set(data.channels)
    return record.with_columns({c: v for c, v in columns.items() if c not in absent})
