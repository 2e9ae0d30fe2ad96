"""Identification from an ordinary flight: an autopilot's, in wind and gusts, without manoeuvres.

The complete flight is used, not the stretches in which surfaces move most. There is no calm air to
replay, so filter error starts at equation error: no replays, no output error. The delay of the
controls comes from a regression of the angular accelerations. Scale and zero of airspeed, angle of
attack and sideslip are estimated with the parameters, with priors, because air data of such
aircraft are seldom calibrated. Angles that no vane measures are states of the filter alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sysid.aerodynamics import Piece, smooth
from sysid.arrays import FloatArray
from sysid.effects.catalogue import Effect, subsystem_effects
from sysid.estimation import channel_noise
from sysid.logs import find_manoeuvres
from uqharness.identification.linearised.types import Point, lateness
from uqharness.identification.replay_fit import (
    OUTPUTS,
    Identification,
    equation_error_start,
)
from uqharness.identification.turbulence import (
    FilterRequest,
    filter_setup,
    identify_in_turbulence,
)
from uqharness.parallel import worker_map
from uqharness.replay import CONTROLS, Flight, ReplayModel, measured_outputs
from uqharness.replay.flights import control_columns, segments
from uqharness.simulator import Aircraft

MIN_S = 30.0
"""Shortest ordinary flight, s."""
PIECE_S = 20.0
AIR_DATA = ("V_mps", "alpha_rad", "beta_rad")
PRIOR: Mapping[str, tuple[float, float]] = {
    "effect/sensor.V_mps/scale": (0.0, 0.05),
    "effect/sensor.alpha_rad/scale": (0.0, 0.3),
    "effect/sensor.alpha_rad/bias": (0.0, 0.05),
    "effect/sensor.beta_rad/scale": (0.0, 0.3),
    "effect/sensor.beta_rad/bias": (0.0, 0.05),
}
"""Errors of uncalibrated air data: mean and standard deviation, angles in rad. A probe's position
beside a fuselage or wing changes angles by up to a half, speeds by some percent."""
_DELAYS_S = tuple(0.01 * k for k in range(-3, 21))
_AXES = (
    ("p_radps", ("beta_rad", "p_radps", "r_radps"), ("aileron", "rudder")),
    ("q_radps", ("alpha_rad", "q_radps"), ("elevator",)),
    ("r_radps", ("beta_rad", "p_radps", "r_radps"), ("rudder", "aileron")),
)
"""Angular rate whose derivative is regressed, its other regressors, and its controls."""


def is_ordinary(flight: Flight) -> bool:
    """Return whether a flight is a log without test manoeuvres, labelled or found."""
    record = flight.record
    labelled = "manoeuvre" in record and any(record["manoeuvre"])
    seconds = float(record["time_s"][-1] - record["time_s"][0])
    if labelled or not record.metadata.native_hz or seconds < MIN_S:
        return False
    return not find_manoeuvres(record)


def whole_flight(flight: Flight, measured: Sequence[str]) -> Flight:
    """Return the flight cut into pieces of at most PIECE_S that cover all of it, without the angles
    that no sensor measured.
    """
    record = flight.record
    needed = ("V_mps", "phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps")
    pieces = []
    for stretch in record.segments((*needed, *control_columns(measured)), 2.0):
        rows = np.arange(stretch.start, stretch.stop)
        seconds = float(record["time_s"][rows[-1]] - record["time_s"][rows[0]])
        for part in np.array_split(rows, max(1, int(np.ceil(seconds / PIECE_S)))):
            a, b = int(part[0]), int(part[-1])
            pieces.append(
                Piece(
                    "flight",
                    slice(a, b + 1),
                    float(record["time_s"][a]),
                    float(record["time_s"][b]),
                )
            )
    return replace(_with_angles(flight), pieces=tuple(pieces))


def unmeasured_angles(flight: Flight) -> tuple[str, ...]:
    """Return the angles of attack and sideslip that no vane measures."""
    record = flight.record
    return tuple(
        c
        for c in ("alpha_rad", "beta_rad")
        if c not in record or not np.isfinite(record[c]).any() or c in record.metadata.estimates
    )


def _with_angles(flight: Flight) -> Flight:
    """Return the flight with the absent angles taken from the attitude: a start for the filter.

    Angle of attack: pitch angle minus the climb angle; sideslip: zero.
    """
    record = flight.record
    absent = [c for c in ("alpha_rad", "beta_rad") if c not in record]
    if not absent:
        return flight
    columns: dict[str, FloatArray] = {}
    if "alpha_rad" in absent:
        speed = np.maximum(record["V_mps"], 1.0)
        if "vd_mps" in record:
            climb = -record["vd_mps"]
        elif "h_m" in record:
            climb = smooth(record["h_m"][:, None], record.dt_s, 0.5, derivative=1)[:, 0]
        else:
            climb = np.zeros(len(record))
        gamma = np.arcsin(np.clip(climb / speed, -0.9, 0.9))
        # Turning flight: the angle lies in the plane of symmetry, which banks.
        alpha = (record["theta_rad"] - gamma) / np.maximum(np.cos(record["phi_rad"]), 0.5)
        columns["alpha_rad"] = np.clip(alpha, -0.3, 0.4)
    if "beta_rad" in absent:
        columns["beta_rad"] = np.zeros(len(record))
    meta = replace(record.metadata, estimates=(*record.metadata.estimates, *absent))
    return replace(flight, record=record.with_columns(columns, meta))


def control_delay_s(flights: Sequence[Flight], measured: Sequence[str]) -> float:
    """Return how late the angular accelerations follow the controls, s.

    Each rate's derivative is regressed on the motion and on the controls, moved by the delay; the
    delay with the least sum of logarithms of residual squares over the three axes is the likeliest.
    """
    columns = dict(zip(CONTROLS, control_columns(measured), strict=True))
    cost = np.zeros(len(_DELAYS_S))
    for rate, motion, controls in _AXES:
        square = np.zeros(len(_DELAYS_S))
        samples = 0
        for flight in flights:
            record = flight.record
            for piece in flight.pieces:
                rows = piece.rows
                time_s = record["time_s"][rows]
                channels = [record[c][rows] for c in motion if c in record]
                fixed = np.column_stack([np.ones(len(time_s)), *channels])
                acting = [record[columns[c]][rows] for c in controls]
                if not all(np.isfinite(v).all() for v in (fixed, *acting, record[rate][rows])):
                    continue
                rate_dot = smooth(record[rate][rows][:, None], record.dt_s, derivative=1)[:, 0]
                fixed = smooth(fixed, record.dt_s)
                samples += len(time_s)
                for k, delay in enumerate(_DELAYS_S):
                    moved = [np.interp(time_s - delay, time_s, v) for v in acting]
                    x = np.column_stack([fixed, smooth(np.column_stack(moved), record.dt_s)])
                    left = rate_dot - x @ np.linalg.lstsq(x, rate_dot, rcond=None)[0]
                    square[k] += float(left @ left)
        if samples:
            cost += samples * np.log(np.maximum(square, 1e-300))
    best = int(np.argmin(cost))
    if 0 < best < len(cost) - 1:
        bend = cost[best - 1] - 2.0 * cost[best] + cost[best + 1]
        shift = 0.5 * (cost[best - 1] - cost[best + 1]) / bend if bend > 0.0 else 0.0
        return float(_DELAYS_S[best] + shift * 0.01)
    return float(_DELAYS_S[best])


def air_data_effects(outputs: Sequence[str]) -> list[Effect]:
    """Return the errors of the measured air data that are estimated with the parameters."""
    return [
        e
        for e in subsystem_effects((), [c for c in outputs if c in AIR_DATA], ())
        if e.key in PRIOR
    ]


def identify_ordinary(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    models: tuple[ReplayModel, ReplayModel],
    names: tuple[str, ...],
    initial: FloatArray,
    limits: Sequence[tuple[float, float]],
    request: FilterRequest,
    *,
    prior: Mapping[str, tuple[float, float]],
    workers: int | None = None,
    callback: Callable[[str], object] = lambda stage: None,
    iteration: Callable[[int, float], None] | None = None,
) -> Identification:
    """Estimate parameters and air-data errors from ordinary flights.

    Parameters
    ----------
    aircraft : Aircraft
        The model.
    flights : sequence of Flight
        Flights as `whole_flight` returns them.
    models : tuple of ReplayModel
        The aircraft with its actuators, and with every control passed through.
    names, initial, limits
        Parameters, their start values (k,) and bounds.
    request : FilterRequest
        Options of filter error.
    prior : Mapping
        Parameter to mean and standard deviation known beforehand.
    workers : int, optional
        Processes.
    callback : callable
        Called with the name of each stage.
    iteration : callable, optional
        Called with the number of each iteration and the length of its step in standard errors.
    """
    start_s = time.perf_counter()
    model, direct_model = models
    callback("delay of the controls")
    delay_s = control_delay_s(flights, request.measured)
    callback("equation error")
    late_flights = [f.with_delayed_commands(delay_s) for f in flights]
    cut = [s for f in late_flights for s in segments(f, request.measured, aircraft.accelerometer_m)]
    begin = np.array(
        [prior[n][0] if n in prior else v for n, v in zip(names, initial, strict=True)]
    )
    theta, notes = equation_error_start(
        model, direct_model, late_flights, cut, names, begin, limits=limits
    )
    # A prior that is narrower than equation error's scatter is the better start.
    theta = np.array(
        [
            m if n in prior and abs(t - (m := prior[n][0])) > 3.0 * prior[n][1] else t
            for n, t in zip(names, theta.tolist(), strict=True)
        ]
    )
    unmeasured = {c for f in flights for c in unmeasured_angles(f)}
    outputs = tuple(
        c
        for c in OUTPUTS
        if c not in unmeasured
        and (request.outputs is None or c in request.outputs)
        and any(c in f.record and np.isfinite(f.record[c]).any() for f in flights)
    )
    template = _empty_result(aircraft, flights, names, initial, outputs, request, notes)
    setup = filter_setup(aircraft, flights, replace(request, outputs=outputs), template)
    active = air_data_effects(outputs)
    priors = {**{e.key: PRIOR[e.key] for e in active}, **{n: prior[n] for n in names if n in prior}}
    setup = replace(setup, active=tuple(active), prior=priors)
    nuisance = dict.fromkeys(setup.nuisance, 0.0)
    nuisance |= {lateness(f): delay_s for f in setup.timed}
    point = Point(
        dict(zip(names, theta.tolist(), strict=True)),
        nuisance,
        tuple(s.start for s in setup.segments),
        dict.fromkeys([e.key for e in active], 0.0),
    )
    callback("filter error")
    with worker_map(workers) as pool:
        result = identify_in_turbulence(
            template,
            point,
            (model, direct_model),
            setup,
            limits,
            {},
            pool=pool,
            callback=iteration,
            whole_flight=True,
        )
    notes = [
        *_air_data_notes(result),
        *(
            [f"no vane measures {', '.join(sorted(unmeasured))}: states of the filter"]
            if unmeasured
            else []
        ),
        *_combination_notes(result),
    ]
    return replace(
        result,
        notes=(*result.notes, *notes),
        labels=prior_labels(result, prior),
        seconds=time.perf_counter() - start_s,
    )


def prior_labels(
    result: Identification, prior: Mapping[str, tuple[float, float]]
) -> dict[str, str]:
    """Return parameter to where its value comes from: "data", "prior and data" or "prior only".

    The share of the information that the flight adds decides: 1 - (std / prior std)^2 below a fifth
    is nothing to speak of, above nine tenths the prior is.
    """
    out = {}
    for name, std in zip(result.names, result.std.tolist(), strict=True):
        if name not in prior:
            out[name] = "data" if name in result.identified else "start value"
            continue
        added = 1.0 - (std / prior[name][1]) ** 2 if np.isfinite(std) else 0.0
        out[name] = "prior only" if added < 0.2 else "data" if added > 0.9 else "prior and data"
    return out


def _empty_result(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    names: tuple[str, ...],
    initial: FloatArray,
    outputs: tuple[str, ...],
    request: FilterRequest,
    notes: Sequence[str],
) -> Identification:
    """Return a result without estimates, which filter error fills."""
    cut = [s for f in flights for s in segments(f, request.measured, aircraft.accelerometer_m)]
    data = [block for f in flights for block in measured_outputs(f, outputs)]
    noise = channel_noise(data, outputs, aircraft.card.sensors.noise_std)
    empty = np.full(len(names), np.nan)
    return Identification(
        aircraft=aircraft.name,
        names=names,
        initial=initial,
        theta=initial.copy(),
        std=empty,
        std_crb=empty,
        status=dict.fromkeys(names, "not-identified"),
        reason=dict.fromkeys(names, ""),
        cov=np.zeros((0, 0)),
        nuisance={},
        outputs=outputs,
        segments=tuple(cut),
        measured=data,
        modelled=data,
        residual=[np.zeros_like(d) for d in data],
        whiteness=np.full(len(outputs), np.nan),
        noise=noise,
        method="filter error",
        converged=False,
        warnings=(),
        notes=tuple(notes),
        simulations=0,
        seconds=0.0,
    )


def _air_data_notes(result: Identification) -> list[str]:
    """Return a sentence for each air-data error, with its 95 % interval."""
    out = []
    for name, (value, std) in result.nuisance.items():
        if not name.startswith("sensor."):
            continue
        channel, kind = name.removeprefix("sensor.").split("/")
        prior_std = PRIOR[f"effect/{name}"][1]
        basis = " (prior only)" if std > 0.9 * prior_std else ""
        if kind == "scale":
            text = f"reads {1.0 + value:.3f} ± {1.96 * std:.3f} times the truth"
        elif channel.endswith("_rad"):
            text = f"is offset by {np.degrees(value):+.2f} ± {np.degrees(1.96 * std):.2f} deg"
        else:
            text = f"is offset by {value:+.2f} ± {1.96 * std:.2f}"
        out.append(f"air data: {channel} {text}{basis}")
    return out


COLLINEAR = 0.9
"""Correlation of two estimates above which their combination is reported."""


def _combination_notes(result: Identification) -> list[str]:
    """Return a sentence for each pair of estimates that the flight knows as a combination only."""
    names = list(result.identified)
    std = np.sqrt(np.diagonal(result.cov)) if len(result.cov) else np.zeros(0)
    value = dict(zip(result.names, result.theta.tolist(), strict=True))
    out = []
    for i, a in enumerate(names):
        for j in range(i + 1, len(names)):
            r = float(result.cov[i, j] / (std[i] * std[j])) if std[i] * std[j] > 0.0 else 0.0
            if abs(r) < COLLINEAR:
                continue
            # The combination a - k b whose error does not depend on b.
            k = float(result.cov[i, j] / std[j] ** 2)
            b = names[j]
            width = 1.96 * float(std[i]) * np.sqrt(max(0.0, 1.0 - r**2))
            out.append(
                f"{a} and {b} are known as a combination (correlation {r:.2f}):"
                f" {a} {-k:+.3g} {b} = {value[a] - k * value[b]:.4g} ± {width:.2g}"
            )
    return out
