"""Identification from an ordinary flight: an autopilot's, in wind and gusts, without manoeuvres.

The complete flight is used, not the stretches in which surfaces move most, by equation error: the
coefficients that the measured motion demands are regressed on the terms of the model, with earlier
motion and controls as instruments. Air data measure the gusts, so that these are regressors and no
errors; a replay, which does not know them, would fit the controls' answer to them. The delay of the
controls comes from a regression of the angular accelerations, errors of the air data from
`uqharness.identification.air_data`. Angles that no vane measures are reconstructed.

Standard errors have four parts: the sandwich over blocks of time; its widening by what the model
does not explain (`_regress`); the largest change of the estimate with filters, delay of the
controls and time constants that the flight does not decide; and errors of the air data.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.aerodynamics import Piece, demanded, half_width, kernel, regressor, smooth, split_name
from sysid.arrays import FloatArray, runs
from sysid.estimation import channel_noise, command_steps_of, filtered_steps, fuller, lagged
from sysid.foreign.regular_files import parse_json, read_regular
from sysid.logs import find_manoeuvres
from sysid.record import FlightRecord
from sysid.units import percent
from uqharness.heartbeat import Callback, silent
from uqharness.identification.air_data import (
    PRIOR,
    AirDataError,
    air_data_errors,
    basis_of,
    motion_angle,
)
from uqharness.identification.replay_fit import OUTPUTS, Identification, forced_at
from uqharness.replay import (
    CHANNELS,
    CONTROLS,
    Flight,
    ForcedModel,
    ReplayJob,
    ReplayModel,
    Segment,
    control_columns,
    fly_all,
    measured_outputs,
    states,
)
from uqharness.replay.flights import segments
from uqharness.simulator import Aircraft

MIN_S = 30.0
"""Shortest ordinary flight, s."""
MANOEUVRE_S = 40.0
"""Longest test manoeuvre, s."""
PIECE_S = 20.0
MANOEUVRE_SHARE, _MARGIN_S = 0.1, 2.0
"""Share of the flight below which manoeuvres, with a margin [s] on both sides, are ignored."""
_DELAYS_S = tuple(0.01 * k for k in range(21))
_PAST_ROWS = 10  # of a rate, from which its change to the next row is predicted
_AXES = (
    ("p_radps", ("beta_rad", "p_radps", "r_radps"), ("aileron", "rudder")),
    ("q_radps", ("alpha_rad", "q_radps"), ("elevator",)),
    ("r_radps", ("beta_rad", "p_radps", "r_radps"), ("rudder", "aileron")),
)
"""Angular rate whose derivative is regressed, its other regressors, and its controls."""


def is_ordinary(flight: Flight) -> bool:
    """Return whether a flight has no test manoeuvres.

    What the controls do decides, not labels, which also name modes, legs and events: a few pulses
    that the search finds in an autopilot's commands do not make a test flight, and a label does
    only where the controls move more than elsewhere.
    """
    record = flight.record
    time_s = record["time_s"]
    if float(time_s[-1] - time_s[0]) < MIN_S:
        return False
    # Commands jump where rows are missing; that is no input.
    gaps = time_s[:-1][np.diff(time_s) > 1.5 * record.dt_s]
    pulses = [
        m
        for m in find_manoeuvres(record)
        if not np.any((gaps > m.start_s - _MARGIN_S) & (gaps < m.end_s + _MARGIN_S))
    ]
    covered_s = sum(m.end_s - m.start_s + 2.0 * _MARGIN_S for m in pulses)
    if covered_s > MANOEUVRE_SHARE * len(record) * record.dt_s:
        return False
    return not _moves_in_labels(record)


def _moves_in_labels(record: FlightRecord) -> bool:
    """Return whether a surface moves more in short labelled stretches than elsewhere.

    A longer label names a phase of the flight. Labels of (nearly) all rows say nothing.
    """
    if "manoeuvre" not in record:
        return False
    labels, time_s = record["manoeuvre"], record["time_s"]
    in_label = np.zeros(len(labels), dtype=bool)
    for run in runs(labels):
        last_s = time_s[run.stop - 1]
        in_label[run] = bool(labels[run.start]) and last_s - time_s[run.start] < MANOEUVRE_S
    if not in_label.any() or np.mean(~in_label) < MANOEUVRE_SHARE:
        return False
    for column in ("elevator_deg", "aileron_deg", "rudder_deg"):
        if column in record:
            # A surface that follows turns and heights moves slowly; an input is quick.
            values = np.nan_to_num(record[column])
            quick = values - smooth(values[:, None], record.dt_s, _QUICK_HZ)[:, 0]
            if quick[in_label].std() > _INPUT_RATIO * quick[~in_label].std():
                return True
    return False


_QUICK_HZ, _INPUT_RATIO = 0.3, 2.0
"""Frequency above which a surface's movement counts, and its size in units of that elsewhere."""


_MOTION = ("V_mps", "phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps")


def whole_flight(
    flight: Flight, measured: Sequence[str], needed: Sequence[str] = _MOTION
) -> Flight:
    """Return the flight cut into pieces of at most PIECE_S that cover all rows with the needed
    channels and the controls.
    """
    record = flight.record
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
    seconds = sum(p.end_s - p.start_s for p in pieces)
    note = f"{flight.name}: {len(pieces)} pieces, {seconds:.0f} s; no test manoeuvre, all is used"
    return replace(flight, pieces=tuple(pieces), notes=(*flight.notes[:-1], note))


def unmeasured_angles(flight: Flight) -> tuple[str, ...]:
    """Return the angles of attack and sideslip that no vane measures."""
    record = flight.record
    return tuple(
        c
        for c in ("alpha_rad", "beta_rad")
        if c not in record or not np.isfinite(record[c]).any() or c in record.metadata.estimates
    )


SLOW_S = 3.0
"""Time constant above which the accelerations do not tell an angle's changes from a bias, s."""
_FORCES = {"alpha_rad": ("CZ", "alpha"), "beta_rad": ("CY", "beta")}
_START_SHARE = 0.5
"""Standard deviation of a start value without a prior, as a share of it."""


def _with_motion_angles(flight: Flight, absent: Sequence[str], slow_s: float = SLOW_S) -> Flight:
    """Return the flight with the absent angles of its motion, without the gusts.

    The part faster than ``slow_s`` is that of `air_data.motion_angle`. The slow part of the angle
    of attack is the pitch angle minus the climb angle, that of sideslip zero.
    """
    record = flight.record
    columns: dict[str, FloatArray] = {}
    if "alpha_rad" in absent:
        columns["alpha_rad"] = lagged(_level_angle(record), record.dt_s, slow_s) + motion_angle(
            record, "alpha_rad", slow_s
        )
    if "beta_rad" in absent:
        part = record.with_columns(columns)
        columns["beta_rad"] = motion_angle(part, "beta_rad", slow_s)
    meta = replace(record.metadata, estimates=tuple({*record.metadata.estimates, *absent}))
    return replace(flight, record=record.with_columns(columns, meta))


def _level_angle(record: FlightRecord) -> FloatArray:
    """Return the angle of attack of flight through air that does not move vertically (n,), rad."""
    speed = np.maximum(record["V_mps"], 1.0)
    if "vd_mps" in record and np.isfinite(record["vd_mps"]).any():
        climb = -record["vd_mps"]
    elif "h_m" in record:
        climb = smooth(record["h_m"][:, None], record.dt_s, 0.5, derivative=1)[:, 0]
    else:
        climb = np.zeros(len(record))
    gamma = np.arcsin(np.clip(np.nan_to_num(climb) / np.nan_to_num(speed, nan=1.0), -0.9, 0.9))
    # In a bank the vertical plane is not the plane of symmetry.
    return np.nan_to_num((record["theta_rad"] - gamma) / np.maximum(np.cos(record["phi_rad"]), 0.5))


@dataclass(frozen=True)
class _AngleSlope:
    """Slope of the force that stands for the vane of an angle.

    Attributes
    ----------
    angle, coefficient : str
        "alpha" or "beta", and the force: "CZ" or "CY".
    place : int
        Of the slope among the parameters.
    value, std : float
        Slope and its standard error.
    basis : str
        Where it comes from; empty if it is a start value.
    terms : Mapping
        Other terms of the force to their standard deviations.
    motion : _Regression
        Estimate of the force from the motion without gusts.
    steps : _StepFit, optional
        The better one, from steps of the commands.
    """

    angle: str
    coefficient: str
    place: int
    value: float
    std: float
    basis: str
    terms: Mapping[str, float]
    motion: _Regression
    steps: _StepFit | None = None

    def scales(self, name: str) -> bool:
        """Return whether a parameter is inversely proportional to the angle's scale."""
        return _term(name).rstrip("2") == self.angle and not name.startswith(
            f"aero/{self.coefficient}_"
        )

    def undetermined(self, name: str) -> bool:
        """Return whether a parameter needs a slope that neither flight nor prior has."""
        return not self.basis and _term(name).rstrip("2") == self.angle

    def errors_in(
        self, theta: FloatArray, terms: Sequence[str], means: Mapping[str, float]
    ) -> FloatArray:
        """Return the covariance (k, k) that errors of the angle add to another coefficient.

        An error of the slope scales the angle; an error of another term of the force moves the
        same term of the coefficient.
        """
        channel = f"{self.angle}_rad"
        scale = AirDataError(channel, "scale", 1.0, self.std / abs(self.value), self.basis)
        offset = AirDataError(channel, "offset", 0.0, PRIOR[channel, "offset"][1], self.basis)
        out = _from_air_data(theta, terms, [scale, offset], means)
        if self.angle in terms:
            ratio = float(theta[terms.index(self.angle)]) / self.value
            std = np.array([self.terms.get(t, 0.0) for t in terms])
            out += np.diag((ratio * std) ** 2)
        return out

    @property
    def note(self) -> str:
        """Describe how the angle is measured."""
        name = f"{self.coefficient}_{self.angle}"
        if not self.basis:
            return (
                f"no vane measures {self.angle}_rad: the accelerometer does, by the start value of"
                f" {name}; slopes over {self.angle} need a prior of it (--prior FILE)"
            )
        return (
            f"no vane measures {self.angle}_rad: the accelerometer does, by {name} ="
            f" {self.value:.3g} ± {1.96 * self.std:.2g} ({self.basis})"
        )


def _with_measured_forces(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    models: tuple[ReplayModel, ReplayModel],
    names: Sequence[str],
    initial: FloatArray,
    measured: Sequence[str],
    *,
    delay_s: float,
    unmeasured: Sequence[str],
    prior: Mapping[str, tuple[float, float]],
    ideal_servos: bool,
) -> tuple[list[Flight], FloatArray, list[_AngleSlope]]:
    """Return flights with the angles that no vane measures, start values, and slopes.

    Lift and side force are the vanes: an angle is the one at which the model has the measured
    force, gusts included. Its scale is the slope's, which a prior gives, or the motion after steps
    of the commands: accelerations and rates tell how the angle changed then, apart from gusts that
    the steps do not know.
    """
    moving = [_with_motion_angles(f, unmeasured) for f in flights]
    begin = np.array(
        [prior[n][0] if n in prior else v for n, v in zip(names, initial, strict=True)]
    )
    # Filters and the limit of the fast part are choices, whose effect on the estimate counts.
    slower = [_with_motion_angles(f, unmeasured, 2.0 * SLOW_S) for f in flights]
    data, other = (
        _regression_data(aircraft, some, models, names, begin, measured, delay_s, v, ideal_servos)
        for some, v in ((moving, _VIEWS[0]), (slower, _SMOOTHER))
    )
    groups, angles = _groups(names), tuple(c.removesuffix("_rad") for c in unmeasured)
    fits = _StepInstruments.of(moving, measured, [data, other], ideal_servos, angles).estimates(
        groups, names, begin, {}
    )
    columns = [{c: f.record[c].copy() for c in unmeasured} for f in moving]
    slopes = []
    for channel in unmeasured:
        coefficient, angle = _FORCES[channel]
        name, members = f"aero/{coefficient}_{angle}", groups.get(coefficient, ())
        if name not in names or begin[names.index(name)] == 0.0:
            continue
        place, steps = names.index(name), fits.get(coefficient)
        # What is assumed of the other terms: their priors, or the start values. A constant is an
        # offset of the angle, which counts apart.
        assumed = [
            prior.get(
                names[i],
                None
                if i == place or _term(names[i]) == "0"
                else (begin[i], max(_START_SHARE * abs(begin[i]), 1e-9)),
            )
            for i in members
        ]
        index, values = list(members).index(place), begin[list(members)]
        std = np.array([np.inf if a is None else a[1] for a in assumed])
        if steps is not None:
            posterior, cov = _with_prior(steps.theta, steps.cov, assumed)
            # A slope of the wrong sign tells nothing.
            if posterior[index] * values[index] > 0.0:
                values, std = posterior, np.sqrt(np.diagonal(cov))
            else:
                steps = None
        value = float(values[index])
        basis = "data" if steps is not None else ""
        if name in prior:
            basis = basis_of(float(std[index]), prior[name][1])
        fixed = {place: float(std[index]) if basis else 0.0}
        motion = _regress(data, coefficient, members, begin, fixed)
        shift = begin[list(members)] - values
        row = 0
        for f, of_flight in zip(moving, columns, strict=True):
            for piece in f.pieces:
                terms = np.column_stack([data.columns[i][row] for i in members])
                force = data.excess[row][:, _ORDER.index(coefficient)] + terms @ shift
                of_flight[channel][piece.rows] += force / value
                row += 1
        begin[list(members)] = values
        slopes.append(
            _AngleSlope(
                angle,
                coefficient,
                place,
                value,
                float(std[index]) if np.isfinite(std[index]) else _START_SHARE * abs(value),
                basis,
                {
                    _term(names[i]): float(s)
                    for i, s in zip(members, std, strict=True)
                    if i != place and np.isfinite(s)
                },
                motion,
                steps,
            )
        )
    return (
        [replace(f, record=f.record.with_columns(c)) for f, c in zip(moving, columns, strict=True)],
        begin,
        slopes,
    )


def control_delay_s(flights: Sequence[Flight], measured: Sequence[str]) -> float:
    """Return how late the angular accelerations follow the controls, s.

    The change of each rate to the next row is regressed on earlier rows of the motion and on the
    controls, moved by the delay; the delay with the least sum of logarithms of residual squares
    over the three axes is the likeliest. A prediction from the past alone: the controls answer the
    motion of the same instant, so a regression of that instant finds them too early or too late.
    """
    columns = dict(zip(CONTROLS, control_columns(measured), strict=True))
    cost = np.zeros(len(_DELAYS_S))
    for rate, motion, controls in _AXES:
        square, samples = np.zeros(len(_DELAYS_S)), 0
        for flight in flights:
            record = flight.record
            for piece in flight.pieces:
                rows, last = piece.rows, -1
                time_s, rates = record["time_s"][rows], record[rate][rows]
                other_motion = [record[c][rows] for c in motion if c in record and c != rate]
                commands = [record[columns[c]][rows] for c in controls]
                if len(time_s) < 5 * _PAST_ROWS or not all(
                    np.isfinite(v).all() for v in (rates, *other_motion, *commands)
                ):
                    continue
                past = [np.ones(len(time_s) - _PAST_ROWS - 1)]
                for values, count in ((rates, _PAST_ROWS), *((v, 3) for v in other_motion)):
                    past += [values[_PAST_ROWS - k : last - k] for k in range(count)]
                basis = np.linalg.qr(np.column_stack(past))[0]
                change = np.diff(rates)[_PAST_ROWS:]
                change = change - basis @ (basis.T @ change)
                samples += len(change)
                for k, delay in enumerate(_DELAYS_S):
                    moved = [np.interp(time_s - delay, time_s, v) for v in commands]
                    x = np.column_stack(moved)[_PAST_ROWS:last]
                    x = x - basis @ (basis.T @ x)
                    residual = change - x @ np.linalg.lstsq(x, change, rcond=None)[0]
                    square[k] += float(residual @ residual)
        if samples:
            cost += samples * np.log(np.maximum(square, 1e-300))
    return float(_DELAYS_S[int(np.argmin(cost))])


@dataclass(frozen=True)
class _View:
    """One way to regress: half-power frequency of the filters [Hz], further delay of the controls
    [s], and lags of the instruments in the time in which the aircraft flies its span.
    """

    cutoff_hz: float = 6.0
    late_s: float = 0.0
    lags: tuple[float, float] = (1.4, 2.2)


_VIEWS = (
    _View(),
    _View(lags=(2.2, 3.3)),
    _View(lags=(1.0, 1.8)),
    _View(cutoff_hz=4.0),
    _View(late_s=0.015),
    _View(late_s=-0.015),
)
"""The first gives the estimates, the others their sensitivity to choices that a flight does not
decide: memory of gusts and noise, noise in the regressors, and the servos' dynamics."""
_SMOOTHER = _VIEWS[3]
_MIN_HZ = 20.0
"""Sample rate below which short period and roll are not resolved, Hz."""
_GUESSED = 0.5
"""Unexplained share of a coefficient above which its intervals depend on the start values."""
ENDOGENEITY = {"positions": 0.05, "commands": 0.2}
"""Correlation between what the model does not explain and a regressor, one standard deviation:
where the surfaces are known, and where an unknown servo moves them after their commands."""
BLOCK_S = 10.0
"""Length of a block of time, s: several short periods, Dutch rolls and gusts."""
_ORDER = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")


@dataclass(frozen=True)
class _Regression:
    """Least squares of one coefficient: estimates (k,), covariance (k, k), share of the demanded
    coefficient's variance beyond noise that is not explained, standard errors (k,) of white
    residuals, and whether the instruments determine every combination of the terms.
    """

    theta: FloatArray
    cov: FloatArray
    unexplained: float
    white_std: FloatArray
    determined: bool


def identify_ordinary(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    models: tuple[ReplayModel, ReplayModel],
    names: tuple[str, ...],
    initial: FloatArray,
    limits: Sequence[tuple[float, float]],
    measured: Sequence[str],
    *,
    prior: Mapping[str, tuple[float, float]],
    ideal_servos: bool = False,
    callback: Callback = silent,
) -> Identification:
    """Estimate coefficient terms from ordinary flights by equation error, with intervals that allow
    for what the model does not explain.

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
    measured : sequence of str
        Surfaces whose positions the record has.
    prior : Mapping
        Parameter to mean and standard deviation known beforehand.
    ideal_servos : bool
        Whether surfaces follow their commands at once; else a lag beyond the card's is estimated
        where the commands move in steps.
    callback : callable
        Called with the name of each stage.

    Returns
    -------
    Identification
        ``modelled`` are replays of the pieces from their measured starts.
    """
    start_s = time.perf_counter()
    callback("air data")
    # One set of sensors: the longest flight tells most.
    longest = max(flights, key=lambda f: len(f.record))
    errors = air_data_errors(longest.record)
    flights = [_calibrated(f, errors) for f in flights]
    callback("delay of the controls")
    delay_s = control_delay_s(flights, measured)
    unmeasured = sorted({c for f in flights for c in unmeasured_angles(f)})
    groups, begin = _groups(names), initial.copy()
    slopes: list[_AngleSlope] = []
    if unmeasured:
        callback("angles without a vane")
        flights, begin, slopes = _with_measured_forces(
            aircraft,
            flights,
            models,
            names,
            initial,
            measured,
            delay_s=delay_s,
            unmeasured=unmeasured,
            prior=prior,
            ideal_servos=ideal_servos,
        )
    fixed_terms = {s.place: s.std if s.basis else 0.0 for s in slopes}
    views: list[dict[str, _Regression]] = []
    of_filters = []
    for number, view in enumerate(_VIEWS):
        callback(f"regression {number + 1} of {len(_VIEWS)}")
        data = _regression_data(
            aircraft, flights, models, names, begin, measured, delay_s, view, ideal_servos
        )
        views.append(
            {c: _regress(data, c, members, begin, fixed_terms) for c, members in groups.items()}
        )
        if view in (_VIEWS[0], _SMOOTHER):
            of_filters.append(data)
    callback("steps of the commands")
    instruments = _StepInstruments.of(flights, measured, of_filters, ideal_servos)
    by_steps = instruments.estimates(groups, names, begin, fixed_terms)
    # Servos are known by the steps alone; other controls keep the common delay.
    servos = {
        f.control: (delay_s + f.late_s, f.lag_s)
        for f in by_steps.values()
        if instruments.commanded and f.control not in measured
    }
    means = _mean_angles(flights)
    estimates = {
        c: _coefficient_estimate(
            c,
            [names[i] for i in members],
            begin[list(members)],
            [v[c] for v in views],
            by_steps.get(c),
            slopes,
            errors=errors,
            means=means,
            prior=prior,
            fixed=[i in fixed_terms for i in members],
        )
        for c, members in groups.items()
    }
    theta, cov = begin.copy(), np.zeros((len(names), len(names)))
    std_crb = np.full(len(names), np.nan)
    for c, members in groups.items():
        place = list(members)
        theta[place], cov[np.ix_(place, place)] = estimates[c].theta, estimates[c].cov
        std_crb[place] = estimates[c].white_std
    theta = _within_bounds(theta, cov, limits)
    std = np.sqrt(np.diagonal(cov))
    reason = {
        name: _reason(name, theta[i], std[i], limits[i], name in prior, slopes)
        for i, name in enumerate(names)
    }
    ok = np.array([not reason[n] for n in names])
    theta, std, std_crb = (
        np.where(ok, theta, initial),
        np.where(ok, std, np.nan),
        np.where(ok, std_crb, np.nan),
    )
    callback("replays")
    corrected = [Instruments(delay_s, servos).correct(f) for f in flights]
    outputs, flight_segments, observed, modelled = _replays(
        aircraft,
        corrected,
        models[0],
        dict(zip(names, theta.tolist(), strict=True)),
        measured,
        unmeasured,
    )
    result = Identification(
        aircraft=aircraft.name,
        names=names,
        initial=initial,
        theta=theta,
        std=std,
        std_crb=std_crb,
        status={n: "not-identified" if reason[n] else "identified" for n in names},
        reason=reason,
        cov=cov[np.ix_(ok, ok)],
        nuisance=_nuisance(flights, delay_s, servos, errors),
        outputs=outputs,
        segments=flight_segments,
        measured=observed,
        modelled=modelled,
        residual=[z - y for z, y in zip(observed, modelled, strict=True)],
        whiteness=np.full(len(outputs), np.nan),
        noise=channel_noise(observed, outputs, aircraft.card.sensors.noise_std),
        method=METHOD,
        converged=all(e.determined for e in estimates.values()),
        warnings=tuple(
            f"{f.name}: rows come at {1.0 / f.record.dt_s:.0f} Hz; below {_MIN_HZ:.0f} Hz faster"
            " motion is lost, and dampings and control powers may be beyond their intervals"
            for f in flights
            if f.record.dt_s > 1.01 / _MIN_HZ
        ),
        notes=(),
        simulations=len(_VIEWS),
        seconds=0.0,
    )
    assumed = (
        "servos without lag" if ideal_servos else "the lags and rate limits of the card's servos"
    )
    notes = (
        "estimated by equation error on all rows, because the flight has no test manoeuvres;"
        " intervals allow for the unexplained share of each coefficient: "
        + ", ".join(f"{c} {percent(e.unexplained)}" for c, e in estimates.items()),
        f"controls act {1e3 * delay_s:.0f} ms after their rows"
        + ("" if len(measured) == len(_CONTROL_TERMS) else ", in addition to " + assumed),
        *(e.note for e in estimates.values() if e.note),
        *(f"air data: {e.text()}" for e in errors),
        *_combination_notes(result),
        *(s.note for s in slopes),
    )
    guessed = {
        names[i] for c, members in groups.items() if estimates[c].depends_on_start for i in members
    }
    return replace(
        result,
        notes=notes,
        labels=_labels(result, prior, guessed, slopes),
        seconds=time.perf_counter() - start_s,
    )


def _mean_angles(flights: Sequence[Flight]) -> dict[str, float]:
    """Return the mean angle of attack and sideslip, rad; zero for one that a flight lacks."""
    return {
        c.removesuffix("_rad"): float(np.nanmean(np.concatenate([f.record[c] for f in flights])))
        if all(c in f.record for f in flights)
        else 0.0
        for c in ("alpha_rad", "beta_rad")
    }


@dataclass(frozen=True)
class _CoefficientEstimate:
    """Estimates (k,) and covariance (k, k) of a coefficient's terms, with priors; the unexplained
    share, standard errors (k,) of white residuals and whether every combination is determined;
    whether the start values count, and how steps of the commands were used.
    """

    theta: FloatArray
    cov: FloatArray
    unexplained: float
    white_std: FloatArray
    determined: bool
    depends_on_start: bool
    note: str


def _coefficient_estimate(
    coefficient: str,
    names: Sequence[str],
    start: FloatArray,
    views: Sequence[_Regression],
    steps: _StepFit | None,
    slopes: Sequence[_AngleSlope],
    *,
    errors: Sequence[AirDataError],
    means: Mapping[str, float],
    prior: Mapping[str, tuple[float, float]],
    fixed: Sequence[bool],
) -> _CoefficientEstimate:
    """Choose between earlier motion and steps as instruments, and add what makes the estimates
    uncertain: choices that the flight does not decide, air data, angles without a vane.

    Parameters
    ----------
    coefficient, names, start
        Coefficient, its k parameters and their values before the flight (k,).
    views : sequence of _Regression
        By `_VIEWS`.
    steps : _StepFit, optional
        Estimate from steps of the commands.
    slopes : sequence of _AngleSlope
        Forces that stand for vanes.
    errors, means
        Of the air data, and mean angles.
    prior : Mapping
        Parameter to mean and standard deviation.
    fixed : sequence of bool
        Which parameters are slopes of such a force.
    """
    # The force does not explain itself: that of a vane has one estimate, from motion or steps.
    of_vane = next((s for s in slopes if s.coefficient == coefficient), None)
    if of_vane is not None:
        views, steps = [of_vane.motion] * len(views), of_vane.steps
    main = views[0]
    deviations = np.array([v.theta - main.theta for v in views[1:]])
    # Motion that a regression does not explain may be gusts that its instruments remember: the
    # values before the flight are then as likely, in the share that is unexplained.
    guess = np.maximum((main.theta - start) ** 2, (_START_SHARE * start) ** 2)
    value = main.theta
    cov = main.cov + np.diag(np.max(deviations**2, axis=0) + main.unexplained * guess)
    by_steps = steps is not None and (of_vane is not None or _is_better(steps, value, cov))
    if steps is not None and by_steps:
        value, cov = steps.theta, steps.cov
    terms = [_term(n) for n in names]
    cov = cov + _from_air_data(value, terms, errors, means)
    for slope in slopes:
        if slope is not of_vane:
            cov += slope.errors_in(value, terms, means)
    # A slope that stands for a vane has its prior already, unless steps told it.
    priors = [
        prior.get(n) if by_steps or not f else None for n, f in zip(names, fixed, strict=True)
    ]
    theta, cov = _with_prior(value, cov, priors)
    return _CoefficientEstimate(
        theta,
        cov,
        main.unexplained,
        main.white_std,
        main.determined,
        not by_steps and main.unexplained > _GUESSED,
        steps.note if steps is not None and by_steps else "",
    )


def _reason(
    name: str,
    value: float,
    std: float,
    limits: tuple[float, float],
    has_prior: bool,
    slopes: Sequence[_AngleSlope],
) -> str:
    """Return why a parameter is not identified; empty if it is."""
    if not has_prior and any(s.undetermined(name) for s in slopes):
        return "no vane measures its angle; give --prior FILE"
    if not np.isfinite(std) or std == 0.0:
        return "no effect in these data"
    low, high = limits
    return "" if low <= value <= high else f"beyond its bound [{low:g}, {high:g}]"


def _nuisance(
    flights: Sequence[Flight],
    delay_s: float,
    servos: Mapping[str, tuple[float, float]],
    errors: Sequence[AirDataError],
) -> dict[str, tuple[float, float]]:
    """Return values and standard errors of delays, servo lags and air data by their names."""
    out = {f"delay/{f.name}/controls": (delay_s, DELAY_STD_S) for f in flights}
    for f in flights:
        for control, pair in servos.items():
            for kind, value in zip(("delay", "lag"), pair, strict=True):
                out[f"{kind}/{f.name}/{control}"] = (value, DELAY_STD_S)
    return out | {f"sensor.{e.channel}/{e.kind}": (e.value, e.std) for e in errors}


def _replays(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    model: ReplayModel,
    values: Mapping[str, float],
    measured: Sequence[str],
    unmeasured: Sequence[str],
) -> tuple[tuple[str, ...], tuple[Segment, ...], list[FloatArray], list[FloatArray]]:
    """Return the measured channels, the segments, and log and model in each (n, m)."""
    outputs = tuple(
        c
        for c in OUTPUTS
        if c not in unmeasured
        and any(c in f.record and np.isfinite(f.record[c]).any() for f in flights)
    )
    flight_segments = tuple(
        s for f in flights for s in segments(f, measured, aircraft.accelerometer_m)
    )
    jobs = [ReplayJob(model, s, values, s.start) for s in flight_segments]
    columns = [CHANNELS.index(c) for c in outputs]
    observed = [block for f in flights for block in measured_outputs(f, outputs)]
    return outputs, flight_segments, observed, [out[:, columns] for out in fly_all(jobs)]


def _labels(
    result: Identification,
    prior: Mapping[str, tuple[float, float]],
    guessed: Collection[str],
    slopes: Sequence[_AngleSlope],
) -> dict[str, str]:
    """Return parameter to where its value comes from; ``guessed`` depend on the start values."""
    labels = prior_labels(result, prior)
    free = [n for n in result.identified if n not in prior]
    labels |= {n: "start value and data" for n in free if n in guessed}
    for slope in slopes:
        if slope.basis not in ("", "data"):
            labels |= {n: "prior and data" for n in free if slope.scales(n)}
    return labels


_OWN_CONTROL = {"Cl": ("da", "aileron"), "Cm": ("de", "elevator"), "Cn": ("dr", "rudder")}
_CONTROL_TERMS = {"da": "aileron", "de": "elevator", "dr": "rudder"}
_SERVO_LAGS_S = (0.0, 0.03, 0.06, 0.1)
_SERVO_DELAYS_ROWS, DELAY_STD_S = (-1, 0, 1), 0.015
"""First-order lags of servos whose positions are not logged, their further delay in rows, and the
standard error of the controls' delay, s."""
DISAGREEMENT = 2.0
"""Difference of two estimates of a control power, in standard errors, above which earlier motion is
no valid instrument (Hausman, Econometrica 46, 1978)."""


@dataclass(frozen=True)
class _StepFit:
    """Estimates (k,) and covariance (k, k) of a coefficient from steps of the commands; moment and
    variance as `fuller` has them, the place of its own control's term, and that control with its
    further delay and lag, s.
    """

    coefficient: str
    theta: FloatArray
    cov: FloatArray
    moment: float
    variance: float
    control_term: int
    control: str = ""
    late_s: float = 0.0
    lag_s: float = 0.0

    @property
    def note(self) -> str:
        """Describe the estimate and its servo."""
        out = f"{self.coefficient} is estimated from steps of the {self.control} command"
        return out + (f"; surfaces lag by {1e3 * self.lag_s:.0f} ms more" if self.lag_s else "")


@dataclass(frozen=True)
class Instruments:
    """How a log differs from the flight, as an identification has it.

    Attributes
    ----------
    delay_s : float
        Delay of the controls, s.
    servos : Mapping
        Control to delay and lag, s, where steps of its commands show them.
    errors : sequence of AirDataError
        Scales and offsets of the air data.
    ideal : bool
        Whether surfaces follow their commands at once.
    """

    delay_s: float
    servos: Mapping[str, tuple[float, float]]
    errors: Sequence[AirDataError] = ()
    ideal: bool = False

    def correct(self, flight: Flight) -> Flight:
        """Return the flight with true air data, and controls as late as they act."""
        late = dict.fromkeys(CONTROLS, self.delay_s)
        late |= {c: delay for c, (delay, _) in self.servos.items()}
        calibrated = _calibrated(flight, self.errors)
        return calibrated.with_delayed_commands(late, {c: s for c, (_, s) in self.servos.items()})

    @property
    def text(self) -> str:
        """Describe what is corrected."""
        servos = "".join(
            f", {control} {1e3 * late_s:.0f} ms with a lag of {1e3 * lag_s:.0f} ms"
            for control, (late_s, lag_s) in self.servos.items()
        )
        air = " and the errors of the air data" if self.errors else ""
        return (
            f"controls act {1e3 * self.delay_s:.0f} ms late{servos}, as identified; the log is"
            f" corrected for that{air}; --servos card uses it as it is"
        )

    @classmethod
    def of_model(cls, aircraft: Aircraft, sha256: str) -> Instruments | None:
        """Read them from the fit.json beside an aircraft that was identified from an ordinary
        flight; None without one.

        Those of the flight with the digest are preferred to another flight's.
        """
        # The file is optional and may be of any origin: unreadable content is ignored.
        try:
            document = parse_json(read_regular(aircraft.folder.parent / "fit.json"))
            if document["method"] != METHOD:
                return None
            rows = {
                n: (float(v["value"]), float(v["std"])) for n, v in document["nuisance"].items()
            }
            delays = [n for n in rows if n.startswith("delay/") and n.endswith("/controls")]
            digests = document["flights_sha256"]
            common = delays[digests.index(sha256) if sha256 in digests else 0]
            flight = common.removeprefix("delay/").removesuffix("controls")
            lags = {
                n.removeprefix(f"lag/{flight}"): value
                for n, (value, _) in rows.items()
                if n.startswith(f"lag/{flight}")
            }
            sensors = {
                n.removeprefix("sensor."): row for n, row in rows.items() if n.startswith("sensor.")
            }
            errors = [
                AirDataError(n.partition("/")[0], n.partition("/")[2], value, std, "")
                for n, (value, std) in sensors.items()
            ]
            return cls(
                rows[common][0],
                {c: (rows[f"delay/{flight}{c}"][0], lag) for c, lag in lags.items()},
                errors,
                document.get("servos") == "ideal",
            )
        except (OSError, ValueError, AttributeError, TypeError, KeyError, IndexError):
            return None


METHOD = "equation error"
"""Name of this estimator in fit.json."""


def _is_better(fit: _StepFit, theta: FloatArray, cov: FloatArray) -> bool:
    """Return whether steps tell the control power more exactly than earlier motion does, or
    disagree with it.
    """
    k = fit.control_term
    variance = float(cov[k, k]) if cov[k, k] > 0.0 else np.inf
    deviation = abs(float(fit.theta[k] - theta[k])) / np.sqrt(float(fit.cov[k, k]) + variance)
    return bool(fit.cov[k, k] < variance) or deviation > DISAGREEMENT


@dataclass(frozen=True)
class _StepInstruments:
    """Filtered steps of the commands at the rows of each piece, of each control that has any, and
    regressions with different filters; whether surfaces are known by their commands alone, and
    whether they may lag; angles of which only the fast part is reconstructed.
    """

    steps: Mapping[str, list[FloatArray]]
    data: Sequence[_RegressionData]
    dt_s: float
    commanded: bool
    lagging: bool
    reconstructed: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        flights: Sequence[Flight],
        measured: Sequence[str],
        data: Sequence[_RegressionData],
        ideal_servos: bool,
        reconstructed: Sequence[str] = (),
    ) -> _StepInstruments:
        """Find the steps of the controls of all flights."""
        columns = dict(zip(CONTROLS, control_columns(measured), strict=True))
        surfaces = {c: columns[c] for c in _CONTROL_TERMS.values()}
        steps_of_flights = [command_steps_of(f.record, surfaces) for f in flights]
        common = [c for c in surfaces if all(c in steps for steps in steps_of_flights)]
        pieces = {
            c: [
                filtered_steps([steps[c]], f.record.dt_s)[piece.rows]
                for f, steps in zip(flights, steps_of_flights, strict=True)
                for piece in f.pieces
            ]
            for c in common
        }
        commanded = not all(c in measured for c in common)
        dt_s = float(flights[0].record.dt_s)
        lagging = commanded and not ideal_servos
        return cls(pieces, data, dt_s, commanded, lagging, tuple(reconstructed))

    def estimates(
        self,
        groups: Mapping[str, Sequence[int]],
        names: Sequence[str],
        initial: FloatArray,
        fixed_terms: Mapping[int, float],
    ) -> dict[str, _StepFit]:
        """Return the estimates of coefficients whose own control moves in steps."""
        out: dict[str, _StepFit] = {}
        for family in (("CY", "Cl", "Cn"), ("CZ", "Cm")):
            stepped = [c for c in family if _OWN_CONTROL.get(c, ("", ""))[1] in self.steps]
            # The force of an angle that only motion tells.
            angle, force = ("beta", "CY") if family[0] == "CY" else ("alpha", "CZ")
            if angle in self.reconstructed:
                stepped = [force] if stepped else []
            present = [c for c in family if c in groups]
            if not any(c in groups for c in stepped):
                continue
            # A servo is the same in all coefficients: their misfits add.
            fits: dict[tuple[int, float], dict[str, _StepFit]] = {}
            for setting in ((r, s) for r in self._delays for s in self._lags):
                of_setting = {
                    c: self._fit(0, c, setting, groups[c], names, initial, fixed_terms)
                    for c in present
                }
                complete = {c: f for c, f in of_setting.items() if f is not None}
                if len(complete) == len(present):
                    fits[setting] = complete
            if not fits:
                continue
            settings = list(fits)
            # The smallest variance for all: a bad setting has large residuals.
            scale = {c: min(f[c].variance for f in fits.values()) for c in present}
            cost = np.array(
                [sum(f[c].moment / scale[c] for c in present) for f in fits.values()]
            ) + np.array([(rows * self.dt_s / DELAY_STD_S) ** 2 for rows, _ in settings])
            weights = np.exp(-0.5 * (cost - cost.min()))
            weights /= weights.sum()
            best = settings[int(np.argmin(cost))]
            rows, lag_s = (np.asarray(weights) @ np.array(settings, dtype=float)).tolist()
            for c in (c for c in stepped if c in groups):
                of_settings = [f[c] for f in fits.values()]
                # Delays and lags that the flight does not tell apart widen the interval.
                theta = np.sum(
                    [w * f.theta for w, f in zip(weights, of_settings, strict=True)], axis=0
                )
                differences = [f.theta - theta for f in of_settings]
                parts = [
                    w * (f.cov + np.outer(d, d))
                    for w, f, d in zip(weights, of_settings, differences, strict=True)
                ]
                cov = np.sum(parts, axis=0)
                other = self._fit(1, c, best, groups[c], names, initial, fixed_terms)
                if other is not None:
                    cov += np.diag((other.theta - fits[best][c].theta) ** 2)
                term, control = _OWN_CONTROL.get(c, (angle, next(iter(self.steps))))
                control_term = [_term(names[i]) for i in groups[c]].index(term)
                out[c] = _StepFit(
                    c, theta, cov, 0.0, scale[c], control_term, control, rows * self.dt_s, lag_s
                )
        return out

    @property
    def _delays(self) -> tuple[int, ...]:
        """Return further delays of the surfaces, rows."""
        return _SERVO_DELAYS_ROWS if self.commanded else (0,)

    @property
    def _lags(self) -> tuple[float, ...]:
        """Return lags of the surfaces, s."""
        return _SERVO_LAGS_S if self.lagging else (0.0,)

    def _regressors(
        self,
        data: _RegressionData,
        members: Sequence[int],
        names: Sequence[str],
        rows: int,
        lag_s: float,
    ) -> FloatArray:
        """Return the regressors (n, k) with surfaces that move later and lag."""
        columns = []
        for i in members:
            pieces = data.columns[i]
            if _term(names[i]) in _CONTROL_TERMS:
                pieces = [lagged(_later(v, rows), self.dt_s, lag_s) for v in pieces]
            columns.append(np.concatenate(pieces))
        return np.column_stack(columns)

    def _fit(
        self,
        number: int,
        coefficient: str,
        setting: tuple[int, float],
        members: Sequence[int],
        names: Sequence[str],
        initial: FloatArray,
        fixed_terms: Mapping[int, float],
    ) -> _StepFit | None:
        """Estimate a coefficient with one delay and lag of the surfaces.

        Constants follow from the means; fixed terms keep their values, and their errors add.
        """
        data, k = self.data[number], _ORDER.index(coefficient)
        z = np.concatenate([np.column_stack(v) for v in zip(*self.steps.values(), strict=True)])
        x = self._regressors(data, members, names, *setting)
        block = np.concatenate(data.block)
        # Demanded coefficients: the start values' part moves with the surfaces as well.
        plain = self._regressors(data, members, names, 0, 0.0)
        fixed = np.array([i in fixed_terms for i in members])
        values = np.array([initial[i] for i in members])
        theta = np.where(fixed, values, 0.0)
        y = np.concatenate([e[:, k] for e in data.excess]) + plain @ values - x @ theta
        moving = x.std(axis=0) > 1e-9 * np.maximum(np.abs(x).max(axis=0), 1e-300)
        free = moving & ~fixed
        term = _OWN_CONTROL.get(coefficient, ("", ""))[0]
        control_term = [_term(names[i]) for i in members].index(term) if term else -1
        target, design = y, x[:, free]
        if any(_term(names[i]).rstrip("2") in self.reconstructed for i in members):
            # Only the fast part of the angle is available: all others are reduced to theirs.
            slow_s = (1 + number) * SLOW_S
            target = y - lagged(y, self.dt_s, slow_s)
            places = np.array(members)[free]
            design = np.column_stack(
                [
                    v
                    if _term(names[i]).rstrip("2") in self.reconstructed
                    else v - lagged(v, self.dt_s, slow_s)
                    for i, v in zip(places, design.T, strict=True)
                ]
            )
        fit = fuller(target, design, z, block)
        if fit is None:
            return None
        theta[free] = fit.theta
        # A model that the instruments refute is as uncertain as its misfit.
        inflation = max(1.0, fit.moment / fit.variance / max(1, fit.excess))
        cov = np.zeros((len(members), len(members)))
        cov[np.ix_(free, free)] = inflation * fit.cov
        change = np.zeros((len(members), int(fixed.sum())))
        change[free] = -fit.solve @ (x[:, fixed] - x[:, fixed].mean(axis=0))
        change[fixed] = np.eye(int(fixed.sum()))
        variances = np.array([fixed_terms[i] ** 2 for i in members if i in fixed_terms])
        cov += (change * variances) @ change.T
        # The constant makes the residual zero on average.
        sums = np.bincount(np.unique(block, return_inverse=True)[1], weights=fit.residual)
        mean_variance = float(np.sum(sums**2)) / len(y) ** 2
        mean = x[:, free].mean(axis=0)
        for j in np.flatnonzero(~moving & ~fixed & (np.abs(x).max(axis=0) > 0.0)):
            level = float(x[:, j].mean())
            theta[j] = (float(y.mean()) - float(mean @ fit.theta)) / level
            cov[j, free] = cov[free, j] = -(mean @ cov[np.ix_(free, free)]) / level
            cov[j, j] = (float(mean @ cov[np.ix_(free, free)] @ mean) + mean_variance) / level**2
        return _StepFit(coefficient, theta, cov, fit.moment, fit.variance, control_term)


def _term(name: str) -> str:
    """Return the term of a parameter, such as "da" of "aero/Cl_da"."""
    return name.removeprefix("aero/").partition("_")[2]


def _later(values: FloatArray, rows: int) -> FloatArray:
    """Return values (n,) moved to later rows; the first or last one is held."""
    place = np.arange(len(values))
    return values[np.clip(place - rows, 0, len(values) - 1)]


def _within_bounds(
    theta: FloatArray, cov: FloatArray, limits: Sequence[tuple[float, float]]
) -> FloatArray:
    """Return the likeliest parameters within their bounds, where the intervals reach these.

    An estimate beyond a bound is moved onto it, and those that correlate with it along.
    """
    theta, variance = theta.copy(), np.diagonal(cov)
    for i in np.argsort([-abs(t) / max(v, 1e-300) for t, v in zip(theta, variance, strict=True)]):
        nearest = float(np.clip(theta[i], *limits[i]))
        change = nearest - theta[i]
        if change and np.isfinite(variance[i]) and abs(change) < 1.96 * np.sqrt(variance[i]):
            theta += cov[i] / variance[i] * change
            theta[i] = nearest
    return theta


def _groups(names: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return coefficient to the places of its parameters."""
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        if (parsed := split_name(name)) is not None:
            groups.setdefault(parsed[0], []).append(i)
    return {c: tuple(members) for c, members in groups.items()}


@dataclass(frozen=True)
class _RegressionData:
    """A flight in one view: of each piece, demanded minus predicted coefficients (n, 6), regressors
    by parameter (n,) and block of time (n,); variance of the demanded coefficients (6,) and of the
    noise in them (6,); lags of the instruments in rows, and ENDOGENEITY.
    """

    excess: list[FloatArray]
    columns: Mapping[int, list[FloatArray]]
    block: list[FloatArray]
    variance: FloatArray
    noise: FloatArray
    lags: tuple[int, ...]
    endogeneity: float = ENDOGENEITY["commands"]


def _regression_data(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    models: tuple[ReplayModel, ReplayModel],
    names: Sequence[str],
    initial: FloatArray,
    measured: Sequence[str],
    delay_s: float,
    view: _View,
    ideal_servos: bool,
) -> _RegressionData:
    """Evaluate the model along the flights, in one view."""
    model, direct_model = models
    late = [f.with_delayed_commands(delay_s + view.late_s) for f in flights]
    flight_segments = [s for f in late for s in segments(f, measured, aircraft.accelerometer_m)]
    channels_of = [states(f, piece) for f in late for piece in f.pieces]
    # Forces of the start values at the measured states: what the aircraft would have, and the
    # variables
    # of each term.
    forced_models = forced_at(
        model,
        direct_model,
        flight_segments,
        channels_of,
        dict(zip(names, initial.tolist(), strict=True)),
    )
    terms = {i: parsed[1] for i, n in enumerate(names) if (parsed := split_name(n)) is not None}
    excess, demand, blocks = [], [], []
    columns: dict[int, list[FloatArray]] = {i: [] for i in terms}
    # Sensor noise is what the model may leave without being wrong.
    noise_std = channel_noise(
        [np.column_stack([c[n] for n in _INERTIAL]) for c in channels_of],
        _INERTIAL,
        aircraft.card.sensors.noise_std,
    )
    noise, first = np.zeros(6), 0
    for segment, channels, (forced, variables) in zip(
        flight_segments, channels_of, forced_models, strict=True
    ):
        # What the measured motion demands of the aerodynamics (2.11 to 2.16), filtered
        # like the regressors.
        demand_of_flight = demanded(
            np.column_stack([channels[f"a{a}_mps2"] for a in "xyz"]),
            np.column_stack([channels[f"{a}_radps"] for a in "pqr"]),
            forced.qbar,
            forced.mass,
            forced.other_force,
            forced.other_moment,
            dt_s=segment.dt_s,
            arm_m=np.array(segment.arm_m),
            cutoff_hz=view.cutoff_hz,
        )
        demand.append(demand_of_flight)
        excess.append(demand_of_flight - smooth(forced.coefficients, segment.dt_s, view.cutoff_hz))
        regressors = {k: smooth(v, segment.dt_s, view.cutoff_hz) for k, v in variables.items()}
        for i, term in terms.items():
            columns[i].append(regressor(term, regressors))
        # Blocks of equal length, numbered through all segments: the clusters of the sandwich.
        count = max(1, round((segment.time_s[-1] - segment.time_s[0]) / BLOCK_S))
        blocks.append(first + (np.arange(len(demand_of_flight)) * count // len(demand_of_flight)))
        first += count
        noise += len(demand_of_flight) * _noise_of(forced, segment, noise_std, view.cutoff_hz)
    demands = np.concatenate(demand)
    # Gusts that rotate the air are as long as the span, and filters remember their own width.
    speed = float(np.mean(np.concatenate([c["V_mps"] for c in channels_of])))
    span_s = forced_models[0][0].mass.b / max(speed, 1.0)
    shortest = 2 * half_width(flight_segments[0].dt_s, view.cutoff_hz) + 1
    lags = tuple(
        max(shortest + k, round(lag * span_s / flight_segments[0].dt_s))
        for k, lag in enumerate(view.lags)
    )
    surfaces_known = ideal_servos or all(c in measured for c in _CONTROL_TERMS.values())
    return _RegressionData(
        excess,
        columns,
        blocks,
        demands.var(axis=0),
        noise / len(demands),
        lags,
        ENDOGENEITY["positions" if surfaces_known else "commands"],
    )


_INERTIAL = ("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2")


def _noise_of(
    forced: ForcedModel, segment: Segment, noise_std: Mapping[str, float], cutoff_hz: float
) -> FloatArray:
    """Return the variance (6,) that sensor noise has in the demanded coefficients of a piece."""
    mass, half = forced.mass, half_width(segment.dt_s, cutoff_hz)
    level, slope = (float(np.sum(kernel(half, segment.dt_s, d) ** 2)) for d in (0, 1))
    per_qbar = float(np.mean(1.0 / np.maximum(forced.qbar, 1e-3)))
    force = mass.mass / mass.S * per_qbar
    out = np.array([noise_std[f"a{a}_mps2"] * force for a in "xyz"]) ** 2 * level
    inertia = np.diagonal(mass.inertia)
    rates = np.array([noise_std[f"{a}_radps"] for a in "pqr"])
    moments = (rates * inertia / (mass.S * mass.lengths) * per_qbar) ** 2 * slope
    return np.concatenate([out, moments])


def _regress(
    data: _RegressionData,
    coefficient: str,
    members: Sequence[int],
    initial: FloatArray,
    fixed_terms: Mapping[int, float] | None = None,
) -> _Regression:
    """Regress one coefficient by instrumental variables, with the covariance of clusters of time.

    A gust moves the aircraft and adds to the coefficient, noise enters the regressors and, through
    the autopilot, the controls: both correlate with the regressors of the same instant, and least
    squares has dampings and control powers at half. The regressors one or two spans of flight
    before are the instruments: the motion remembers them, gusts and noise hardly (Soderstrom and
    Stoica, "Instrumental Variable Methods for System Identification", 1983; two-stage least
    squares).

    The sandwich over blocks allows for correlation within them. Beyond it, what the model does not
    explain (gusts that rotate the air, missing terms) may correlate with the regressors in every
    block alike, because controls answer the motion. Its correlation with what a regressor has
    alone is taken as random with the standard deviation `ENDOGENEITY`: the bias of an estimate is
    that correlation times the unexplained part's standard deviation over that of what the
    regressor has alone. It does not fall with the length of the flight, and it is zero for a model
    that leaves sensor noise.

    Parameters that are ``fixed_terms`` keep their start values with a standard deviation, which
    adds to the covariance of the others.
    """
    k, fixed_terms = _ORDER.index(coefficient), fixed_terms or {}
    first, last = max(data.lags), min(data.lags)
    # Rows whose instruments lie in the same segment.
    x, y, z, block = [], [], [], []
    for piece, (excess, of) in enumerate(zip(data.excess, data.block, strict=True)):
        n = len(excess)
        if n <= first + len(members):
            continue
        part = np.column_stack([data.columns[i][piece] for i in members])
        x.append(part[first:])
        y.append(excess[first:, k])
        z.append(np.column_stack([part[first - lag : n - lag] for lag in (first, last)]))
        block.append(of[first:])
    regressors, target, instruments = (np.concatenate(v) for v in (x, y, z))
    # Terms that keep their values are taken out of regressors and instruments.
    fixed = np.array([i in fixed_terms for i in members])
    fixed_columns = regressors[:, fixed]
    regressors = np.where(fixed, 0.0, regressors)
    instruments = np.where(np.tile(fixed, 2), 0.0, instruments)
    cluster = np.concatenate(block)
    # Columns of unit size: their units differ by orders of magnitude.
    scale = np.sqrt(np.mean(regressors**2, axis=0))
    usable = scale > 0.0
    scale = np.where(usable, scale, 1.0)
    design = regressors / scale
    spread = np.sqrt(np.mean(instruments**2, axis=0))
    instruments = instruments / np.where(spread > 0.0, spread, 1.0)
    # Two-stage least squares: regress the regressors on the instruments, then the target on
    # the result.
    fitted = instruments @ _solve(instruments.T @ instruments, instruments.T @ design)
    inverse = _solve(fitted.T @ fitted, np.eye(len(members)))
    delta = inverse @ (fitted.T @ target)
    residual = target - design @ delta
    # Sandwich over clusters: scores summed within each block of time.
    numbers, position = np.unique(cluster, return_inverse=True)
    scores = np.zeros((len(numbers), len(members)))
    np.add.at(scores, position, fitted * residual[:, None])
    count = len(numbers)
    sandwich = count / max(1, count - 1) * inverse @ (scores.T @ scores) @ inverse
    # Bias by what the model does not explain beyond sensor noise.
    # Noise has no part in either: a coefficient that is mostly noise would seem explained.
    variance = max(float(data.variance[k] - data.noise[k]), 1e-300)
    unexplained = max(float(np.mean(residual**2)) - float(data.noise[k]), 0.0)
    bias = data.endogeneity**2 * unexplained * len(target) * inverse
    rho = min(unexplained / variance, 1.0)
    # Back to the units of the parameters; a column of zeros determines nothing.
    cov = (sandwich + bias) / np.outer(scale, scale)
    cov[~usable, :] = 0.0
    cov[:, ~usable] = 0.0
    # Errors of the fixed terms move the others.
    change = np.zeros((len(members), int(fixed.sum())))
    change[usable] = -(inverse @ (fitted.T @ fixed_columns) / scale[:, None])[usable]
    change[fixed] = np.eye(int(fixed.sum()))
    fixed_variance = np.diag([fixed_terms[i] ** 2 for i in members if i in fixed_terms])
    cov += change @ fixed_variance @ change.T
    theta = initial[list(members)] + np.where(usable, delta / scale, 0.0)
    white = np.sqrt(np.mean(residual**2) * np.diagonal(inverse)) / scale
    eigenvalues = np.linalg.eigvalsh(fitted.T @ fitted)
    rank = int(np.sum(eigenvalues > _SINGULAR * max(eigenvalues[-1], 1e-300)))
    determined = rank == int(usable.sum()) and bool(np.isfinite(theta).all())
    return _Regression(theta, cov, rho, np.where(usable, white, np.nan), determined)


_SINGULAR = 1e-10
"""Share of the largest eigenvalue below which a direction has no information."""


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return matrix^-1 right for a symmetric matrix; directions without information get nothing."""
    values, vectors = np.linalg.eigh(matrix)
    significant = values > _SINGULAR * max(values[-1], 1e-300)
    return np.asarray(
        (vectors[:, significant] / values[significant]) @ (vectors[:, significant].T @ right)
    )


def _from_air_data(
    theta: FloatArray,
    terms: Sequence[str],
    errors: Sequence[AirDataError],
    mean: Mapping[str, float],
) -> FloatArray:
    """Return the covariance (k, k) that errors of the air data add.

    All terms scale with 1/V^2 and each angle's terms with the angle's scale; an offset of an angle
    moves the constant term, and the slope where there is a quadratic term.
    """
    out = np.zeros((len(theta), len(theta)))
    place = {term: k for k, term in enumerate(terms)}
    for e in errors:
        if e.kind == "position":  # of a barometer: no coefficient depends on it
            continue
        change = np.zeros(len(theta))
        if e.channel == "V_mps":
            change = 2.0 * theta / e.value
        else:
            angle = e.channel.removesuffix("_rad")
            slope, bend = (theta[place[t]] if t in place else 0.0 for t in (angle, f"{angle}2"))
            if e.kind == "scale":
                for term, power in ((angle, 1), (f"{angle}2", 2)):
                    if term in place:
                        change[place[term]] = power * theta[place[term]] / e.value
            else:
                if "0" in place:
                    change[place["0"]] = -(slope + 2.0 * bend * mean[angle])
                if angle in place:
                    change[place[angle]] = -2.0 * bend
        out += e.std**2 * np.outer(change, change)
    return out


def _with_prior(
    theta: FloatArray, cov: FloatArray, priors: Sequence[tuple[float, float] | None]
) -> tuple[FloatArray, FloatArray]:
    """Combine estimates and covariance with normal priors of some of the parameters."""
    if not any(p is not None for p in priors):
        return theta, cov
    scale = np.sqrt(np.maximum(np.diagonal(cov), 1e-300))
    information = np.linalg.pinv(cov / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
    prior_information = np.diag([0.0 if p is None else 1.0 / p[1] ** 2 for p in priors])
    mean = np.array([0.0 if p is None else p[0] for p in priors])
    posterior = np.linalg.inv(information + prior_information)
    return posterior @ (information @ theta + prior_information @ mean), posterior


def with_prior(result: Identification, prior: Mapping[str, tuple[float, float]]) -> Identification:
    """Combine the estimates of output or filter error with normal priors.

    Near its end the fit is linear in the parameters, so that mean and covariance of the posterior
    follow from the estimates, their covariance and the priors. Parameters that the flights do not
    excite were held at their start values; their priors become the estimates.
    """
    members = [i for i, name in enumerate(result.names) if name in result.identified]
    theta, std = result.theta.copy(), result.std.copy()
    if members:
        theta[members], cov = _with_prior(
            theta[members], result.cov, [prior.get(result.names[i]) for i in members]
        )
        std[members] = np.sqrt(np.diagonal(cov))
    else:
        cov = np.zeros((0, 0))
    status, reason = dict(result.status), dict(result.reason)
    added = [i for i, n in enumerate(result.names) if i not in members and n in prior]
    for i in added:
        name = result.names[i]
        theta[i], std[i] = prior[name]
        status[name], reason[name] = "identified", ""
    # The covariance is ordered as the identified parameters are.
    order = members + added
    joint = np.diag([0.0] * len(members) + [float(std[i]) ** 2 for i in added])
    joint[: len(members), : len(members)] = cov
    places = np.argsort(order)
    combined = replace(
        result,
        theta=theta,
        std=std,
        status=status,
        reason=reason,
        cov=joint[np.ix_(places, places)],
        notes=(*result.notes, "estimates of the manoeuvres are combined with the prior"),
    )
    return replace(combined, labels=prior_labels(combined, prior))


def _calibrated(flight: Flight, errors: Sequence[AirDataError]) -> Flight:
    """Return the flight with scales and offsets of its air data taken out."""
    columns = {
        e.channel: flight.record[e.channel] / e.value
        for e in errors
        if e.kind == "scale" and e.channel in flight.record
    }
    for e in errors:
        if e.kind == "offset" and e.channel in columns:
            scale = next(x.value for x in errors if (x.channel, x.kind) == (e.channel, "scale"))
            columns[e.channel] = columns[e.channel] - e.value / scale
    return replace(flight, record=flight.record.with_columns(columns))


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
        out[name] = basis_of(std if np.isfinite(std) else np.inf, prior[name][1])
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
