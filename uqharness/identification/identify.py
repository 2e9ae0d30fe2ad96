"""Identification of a JSBSim aircraft's parameters from flights.

Equation error gives start values, output error on replays of every segment gives the estimates;
start states of the segments and sensor biases are estimated with them. Where the residuals show
process noise (turbulence), filter error on one-step predictions follows, and the result says so. A
fit that has not converged or does not explain its flights identifies no parameter.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.aerodynamics import split_name
from sysid.arrays import FloatArray
from sysid.estimation import (
    NOISE_FLOOR,
    channel_noise,
    colour,
    colour_warnings,
    rms,
    shows_process_noise,
)
from uqharness.errors import BadInputError
from uqharness.heartbeat import Callback, silent
from uqharness.identification.excitation import restrict_to_excited
from uqharness.identification.ordinary import (
    identify_ordinary,
    is_ordinary,
    whole_flight,
    with_prior,
)
from uqharness.identification.replay_fit import (
    BIASES,
    OUTPUTS,
    Identification,
    Observed,
    ReplayFit,
    by_channel,
    equation_error_start,
    fit_replays,
)
from uqharness.identification.replay_fit import MAX_ITERATIONS as OUTPUT_ITERATIONS
from uqharness.identification.replay_fit import TOLERANCE as OUTPUT_TOLERANCE
from uqharness.parallel import SHORT_COMMAND_S, process_count, worker_map
from uqharness.replay import (
    CONTROLS,
    UNSEEN,
    Flight,
    ReplayFolder,
    ReplayModel,
    Speed,
    bare_rate,
    counter,
    delayed,
    measured_outputs,
    replay_pool,
    shifted_command_warnings,
    shown_channel,
)
from uqharness.replay.flights import segments
from uqharness.simulator import MEMS_NOISE_STD, Aircraft

# Fits that do not explain their flights: their estimates are the best values of a wrong model.

UNEXPLAINED_SIGMA = 10.0
"""Residual in units of the noise above which a channel may count as unexplained. Small missing
terms, which `refine` finds, leave about 4."""
UNEXPLAINED_SHARE = 0.1
"""Residual share of a channel's variance above which it does: a third of the motion's amplitude."""


def unexplained(
    residual: Sequence[FloatArray],
    measured: Sequence[FloatArray],
    outputs: Sequence[str],
    noise: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """Find the channels that a fit does not explain.

    Parameters
    ----------
    residual, measured : sequence of ndarray
        (n, m) by segment, NaN where nothing was logged; variances are about each segment's mean.
    outputs : sequence of str
        Their channels.
    noise : Mapping
        Standard deviation by channel, in the channel's unit; a record cleaner than a small MEMS
        unit is judged by that unit's noise.

    Returns
    -------
    dict
        Channel to the residual's rms in units of the noise, and to its share of the variance.
    """
    out = {}
    for k, channel in enumerate(outputs):
        residual_square, motion_square, samples = 0.0, 0.0, 0
        for r, z in zip(residual, measured, strict=True):
            logged = np.isfinite(r[:, k]) & np.isfinite(z[:, k])
            if logged.any():
                residual_square += float(np.sum(r[logged, k] ** 2))
                motion_square += float(np.sum((z[logged, k] - z[logged, k].mean()) ** 2))
                samples += int(logged.sum())
        # A very clean record must not fail for residuals that any real sensor would hide.
        size = max(noise[channel], MEMS_NOISE_STD.get(channel, 0.0))
        if not samples or not size > 0.0:
            continue
        sigma = float(np.sqrt(residual_square / samples)) / size
        share = residual_square / motion_square if motion_square > 0.0 else np.inf
        # Both tests must fail: a large ratio alone may be a small missing term in a clean channel.
        if sigma > UNEXPLAINED_SIGMA and share > UNEXPLAINED_SHARE:
            out[channel] = (sigma, share)
    return out


def withdraw_invalid(result: Identification) -> Identification:
    """Return the result unchanged, or without any identified parameter if it is not valid.

    A fit that has not ended, or whose model is not the aircraft's, has neither meaningful values
    nor standard errors: each parameter returns to its start value with the reason.
    """
    reason = _invalid_reason(result) if result.identified else ""
    if not reason:
        return result
    advice = (
        "check units, signs, mass, inertia and servos with compare, or let refine look for a"
        " missing effect"
    )
    # Keep everything that describes the fit, so that the user can see why it failed.
    return replace(
        result,
        theta=result.initial.copy(),
        std=np.full(len(result.names), np.nan),
        std_crb=np.full(len(result.names), np.nan),
        status=dict.fromkeys(result.names, "not-identified"),
        reason={
            n: reason if result.status[n] == "identified" else result.reason[n]
            for n in result.names
        },
        cov=np.zeros((0, 0)),
        warnings=(f"no parameter is identified: {reason}; {advice}", *result.warnings),
    )


def _invalid_reason(result: Identification) -> str:
    """Return why no parameter is identified; empty where the estimates are valid."""
    # Innovations in turbulence are as large as the filter predicts, not as small as the noise.
    scale = {c: max(n, result.innovation_std.get(c, 0.0)) for c, n in result.noise.items()}
    unexplained_channels = unexplained(result.residual, result.measured, result.outputs, scale)
    if unexplained_channels:
        # Name the channel that is explained worst.
        channel = max(unexplained_channels, key=lambda c: unexplained_channels[c][1])
        sigma, share = unexplained_channels[channel]
        other_channels = (
            f" ({', '.join(c for c in unexplained_channels if c != channel)} as well)"
            if len(unexplained_channels) > 1
            else ""
        )
        return (
            f"the model does not explain the flights: the residual of {channel} is {sigma:.0f}"
            f" sigma, {100.0 * share:.0f} % of its variance{other_channels}"
        )
    return "" if result.converged else "not converged; values unchanged"


# Progress of an estimation: its iteration, the length of the step, and the remaining time.


@dataclass
class DescentProgress:
    """Callback of an estimator that reports each iteration and the remaining time.

    Steps shorten by about a constant factor, so the remaining time is that of the iterations until
    they are ``tolerance`` standard errors long, at most ``max_iterations``. A second descent starts
    anew.

    Attributes
    ----------
    method : str
        Name of the estimator.
    callback : callable
        Receives one sentence an iteration.
    tolerance : float
        Step in standard errors below which the search ends.
    max_iterations : int
        Largest number of iterations.
    clock : callable
        Time [s].
    """

    method: str
    callback: Callback
    tolerance: float
    max_iterations: int
    clock: Callable[[], float] = time.monotonic
    _start_s: float = 0.0
    _lengths: list[float] = field(default_factory=list)

    def __call__(self, iteration: int, length: float) -> None:
        """Report that an iteration begins, whose step would be ``length`` standard errors long."""
        # A new descent starts its own clock.
        if iteration == 1 or not self._lengths:
            self._start_s, self._lengths = self.clock(), []
        self._lengths.append(length)
        text = f"{self.method}: iteration {iteration}"
        if math.isfinite(length):
            text += f", next step {length:.2g} standard errors (stops below {self.tolerance:g})"
        remaining_s = self.seconds_left(iteration)
        self.callback(
            text if remaining_s is None else f"{text}, about {max(1, round(remaining_s))} s left"
        )

    def seconds_left(self, iteration: int) -> float | None:
        """Estimate the remaining time [s]; None in the first iterations of a descent."""
        done = len(self._lengths) - 1
        if done < 2:
            return None
        # Without convergence all allowed iterations may be needed.
        iterations_left = max(float(self.max_iterations - iteration), 1.0)
        first, last = self._lengths[0], self._lengths[-1]
        # Geometric extrapolation of the step length down to the tolerance.
        if 0.0 < last < first and last > self.tolerance:
            iterations_left = min(
                iterations_left, math.log(last / self.tolerance) * done / math.log(first / last)
            )
        elif last <= self.tolerance:
            iterations_left = 1.0
        return iterations_left * (self.clock() - self._start_s) / done


def identify(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    parameters: Sequence[str] | None = None,
    *,
    start: str = "current",
    biases: Sequence[str] = BIASES,
    delays: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    ideal_servos: bool = False,
    method: str = "auto",
    prior: Mapping[str, tuple[float, float]] | None = None,
    workers: int | None = None,
    callback: Callback = silent,
    message_callback: Callable[[str], None] | None = None,
) -> Identification:
    """Estimate JSBSim properties from flights.

    Parameters
    ----------
    aircraft : Aircraft
        The model.
    flights : sequence of Flight
        Flights ready for replay.
    measured : sequence of str
        Surfaces whose columns are positions, as `read_flights` returns them.
    parameters : sequence of str, optional
        Properties to estimate; by default those of the card's [parameters] that the flights excite.
    start : {"current", "initial"}
        Start from the values in the XML, or from the card's first guesses.
    biases : sequence of str
        Channels with a constant sensor bias in each flight.
    delays : sequence of str, optional
        Channels whose delay after the commands is estimated for each flight; by default the
        controls, and all channels of a log.
    outputs : sequence of str, optional
        Fitted channels; by default all recorded ones of OUTPUTS, without ``parameters`` those on
        which a parameter acts.
    ideal_servos : bool
        Whether surfaces and throttle follow their commands at once.
    method : {"auto", "output-error", "filter-error"}
        ``auto`` uses filter error where the residuals of output error show turbulence.
    prior : Mapping, optional
        Parameter to mean and standard deviation known beforehand, which the estimates are combined
        with.
    workers : int, optional
        Processes.
    callback : callable
        Called with the name of each stage.
    message_callback : callable, optional
        Called with a sentence for each choice of a method: the reason, and the amount of work.

    Returns
    -------
    Identification
        Estimates, standard errors, residuals and notes.

    Raises
    ------
    BadInputError
        For unknown parameters, and for a model that cannot fly the segments.
    """
    # Commands pass the actuators unless the servos are ideal; measured positions never do.
    names = _parameter_names(aircraft, parameters)
    ideal = tuple(c for c in CONTROLS if c not in measured) if ideal_servos else ()
    terms_only = all(split_name(n) is not None for n in names)
    if prior and not (terms_only and method == "auto"):
        raise BadInputError(
            "--prior needs parameters that are coefficient terms such as aero/Cm_q, and --method"
            " auto"
        )
    if method == "auto" and terms_only and all(map(is_ordinary, flights)):
        return _identify_whole_flight(
            aircraft,
            flights,
            names,
            measured,
            ideal,
            prior or {},
            start=start,
            callback=callback,
            message_callback=message_callback,
        )
    request = _FitRequest(
        names, parameters is None, start, biases, delays, outputs, measured, ideal, method, workers
    )
    with ReplayFolder(aircraft, measured=measured, ideal=ideal) as model:
        calm = _fit_output_error(aircraft, flights, model, request, callback, message_callback)
        # The residuals choose the method.
        gusty = shows_process_noise(*_inertial_channels(calm.result))
        if method == "output-error" or (method == "auto" and not gusty):
            if message_callback is not None:
                message_callback(_no_filter_message(method, gusty))
            result = calm.result if gusty else _in_calm_air(calm.result)
        else:
            if message_callback is not None:
                message_callback(_filter_error_message(calm.result, method))
            result = _fit_filter_error(aircraft, flights, model, request, calm, callback)
    estimates = withdraw_invalid(result)
    return with_prior(estimates, prior) if prior else estimates


@dataclass(frozen=True)
class _FitRequest:
    """Parameters to estimate and options of the fits, as in `identify`.

    ``excited_only`` leaves out what the manoeuvres do not excite.
    """

    names: tuple[str, ...]
    excited_only: bool
    start: str
    biases: Sequence[str]
    delays: Sequence[str] | None
    outputs: Sequence[str] | None
    measured: Sequence[str]
    ideal: tuple[str, ...]
    method: str
    workers: int | None


@dataclass(frozen=True)
class _OutputErrorFit:
    """Result of output error, its fit, the fixed parameters and the limits of all."""

    result: Identification
    fitted: ReplayFit
    fixed: Mapping[str, str]
    limits: Sequence[tuple[float, float]]


def _fit_output_error(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    model: ReplayModel,
    request: _FitRequest,
    callback: Callback,
    message_callback: Callable[[str], None] | None,
) -> _OutputErrorFit:
    """Estimate by output error on replays of the manoeuvres."""
    names = request.names
    cut_segments = [
        s for f in flights for s in segments(f, request.measured, aircraft.accelerometer_m)
    ]
    initial = _initial(aircraft, model, names, request.start)
    limits = _limits(aircraft, names, initial)
    # Stage 1: equation error, linear and fast, gives start values.
    start_s = time.perf_counter()
    callback("equation error")
    with ReplayFolder(aircraft, measured=request.measured, ideal=CONTROLS) as direct_model:
        equation_error_theta, start_notes = equation_error_start(
            model, direct_model, flights, cut_segments, names, initial, limits=limits
        )
    # Observations: fitted channels of every segment, with biases and delays to estimate.
    channels = _outputs(flights, request.outputs)
    data = [block for f in flights for block in measured_outputs(f, channels)]
    all_observed = Observed(
        cut_segments,
        channels,
        data,
        [b for b in request.biases if b in channels],
        delayed(flights, channels, request.delays),
    )
    # The noise scales residuals until output error estimates its own.
    noise = channel_noise(data, channels, aircraft.card.sensors.noise_std)
    # Speed of the bare loop and number of simulated rows, for the report on speed.
    bare_flight_s_per_s, rows_before, fit_start_s = (
        bare_rate(model, cut_segments[0]),
        counter["rows"],
        time.perf_counter(),
    )
    with replay_pool(request.workers) as pool:
        # Stage 2: by default fix what the manoeuvres do not excite.
        observed, excitation_notes = all_observed, list[str]()
        if request.excited_only:
            callback("parameters that the flights excite")
            observed, excitation_notes = restrict_to_excited(
                model,
                all_observed,
                names,
                initial,
                limits,
                noise,
                pool=pool,
                choose=request.outputs is None,
            )
        # Stage 3: output error.
        callback("output error")
        if message_callback is not None:
            message_callback(_output_error_message(observed, names, request.method))
        # Start from equation error, and from the initial values if the model cannot fly with
        # those.
        fitted = fit_replays(
            model,
            observed,
            names,
            (equation_error_theta, initial),
            limits,
            pool,
            callback=DescentProgress("output error", callback, OUTPUT_TOLERANCE, OUTPUT_ITERATIONS),
        )
    fit_s = time.perf_counter() - fit_start_s
    flown_s = (counter["rows"] - rows_before) * cut_segments[0].dt_s
    result = _assemble(
        aircraft,
        names,
        initial,
        fitted,
        observed,
        noise,
        notes=[*start_notes, *excitation_notes],
        seconds=time.perf_counter() - start_s,
        speed=Speed(
            fitted.fit.n_simulations / fit_s,
            flown_s / fit_s,
            process_count(request.workers),
            bare_flight_s_per_s,
        ),
    )
    shifted = shifted_command_warnings(flights, cut_segments, result.nuisance)
    return _OutputErrorFit(
        replace(result, warnings=(*shifted, *result.warnings)), fitted, observed.fixed, limits
    )


def _fit_filter_error(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    model: ReplayModel,
    request: _FitRequest,
    start: _OutputErrorFit,
    callback: Callback,
) -> Identification:
    """Estimate by filter error in turbulence, from the result of output error."""
    # Imported here: most flights need no filter.
    from uqharness.identification.linearised.flight_data import StagedModels
    from uqharness.identification.linearised.prediction_error import (
        TOLERANCE as FILTER_TOLERANCE,
    )
    from uqharness.identification.turbulence import ITERATIONS as FILTER_ITERATIONS
    from uqharness.identification.turbulence import (
        FilterRequest,
        filter_data,
        identify_in_turbulence,
    )

    callback("filter error")
    # The simulations of output error are no longer needed.
    start.fitted.replay.forget()
    filter_request = FilterRequest(
        request.outputs, request.biases, request.delays, request.measured, request.ideal
    )
    data = filter_data(aircraft, flights, filter_request, start.result)
    with (
        ReplayFolder(aircraft, measured=request.measured, ideal=CONTROLS) as direct_model,
        worker_map(request.workers, SHORT_COMMAND_S) as pool,
    ):
        return identify_in_turbulence(
            start.result,
            start.fitted,
            StagedModels(model, direct_model),
            data,
            start.limits,
            start.fixed,
            pool=pool,
            callback=DescentProgress("filter error", callback, FILTER_TOLERANCE, FILTER_ITERATIONS),
        )


def _identify_whole_flight(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    names: tuple[str, ...],
    measured: Sequence[str],
    ideal: Sequence[str],
    prior: Mapping[str, tuple[float, float]],
    *,
    start: str,
    callback: Callback,
    message_callback: Callable[[str], None] | None,
) -> Identification:
    """Estimate by equation error from the complete flights, which have no manoeuvres."""
    complete = [whole_flight(f, measured) for f in flights]
    seconds = sum(p.end_s - p.start_s for f in complete for p in f.pieces)
    if message_callback is not None:
        message_callback(
            f"no test manoeuvre in the flight: equation error on all of its {seconds:.0f} s;"
            " --method output-error or filter-error uses the stretches in which surfaces move"
        )
    with (
        ReplayFolder(aircraft, measured=measured, ideal=ideal) as model,
        ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as direct_model,
    ):
        initial = _initial(aircraft, model, names, start)
        limits = _limits(aircraft, names, initial)
        result = identify_ordinary(
            aircraft,
            complete,
            (model, direct_model),
            names,
            initial,
            limits,
            measured,
            prior=prior,
            ideal_servos=bool(ideal),
            callback=callback,
        )
    return result


def _in_calm_air(result: Identification) -> Identification:
    """Reword the warnings of coloured residuals of a flight that shows no turbulence."""
    coloured = [w for w in result.warnings if w.startswith("coloured residuals")]
    if not coloured:
        return result
    tint = colour(result.residual, result.modelled)
    text = colour_warnings(tint, result.std, result.std_crb, "output error", calm_air=True)
    remaining_warnings = tuple(w for w in result.warnings if w not in coloured)
    return replace(result, warnings=(*remaining_warnings, *by_channel(text, result.outputs)))


def _outputs(flights: Sequence[Flight], requested: Sequence[str] | None) -> tuple[str, ...]:
    """Return the fitted channels that some flight has.

    Raises BadInputError for a requested channel that none has.
    """
    # A channel counts as recorded if any flight has finite values.
    available = tuple(
        c for c in OUTPUTS if any(c in f.record and np.isfinite(f.record[c]).any() for f in flights)
    )
    missing = [] if requested is None else [c for c in requested if c not in available]
    if missing or requested == ():
        problem = f"no flight has {', '.join(missing)}" if missing else "no outputs are selected"
        raise BadInputError(f"{problem}; the flights have {', '.join(available)}")
    return available if requested is None else tuple(c for c in available if c in requested)


def _output_error_message(observed: Observed, names: Sequence[str], method: str) -> str:
    """Describe the output error estimation: its size and the reason for it."""
    seconds = sum(float(s.time_s[-1] - s.time_s[0]) for s in observed.segments)
    free = len(names) - len(observed.fixed)
    reason = {
        "auto": "assumes calm air; its residuals are then checked for turbulence",
        "output-error": "requested by --method",
        "filter-error": "start of filter error, requested by --method",
    }[method]
    return (
        f"output error: {len(observed.segments)} segments, {seconds:.0f} s, {free} parameters"
        f" ({reason})"
    )


def _no_filter_message(method: str, gusty: bool) -> str:
    """Explain why the result of output error is kept."""
    sign = "show turbulence; estimates may be biased" if gusty else "show no sign of turbulence"
    requested = " (requested by --method)" if method == "output-error" else ""
    return f"keeping output error{requested}: the rate and acceleration residuals {sign}"


def _filter_error_message(result: Identification, method: str) -> str:
    """Explain why filter error follows, and how large the problem is."""
    residual, _, noise = _inertial_channels(result)
    # The test for process noise uses the inertial channels only, so the message does too.
    channels = [c for c in result.outputs if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")]
    # Only channels above their noise are named.
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = {c: rms(np.concatenate(residual)[:, k]) / noise[k] for k, c in enumerate(channels)}
    ratios_text = ", ".join(
        f"{shown_channel(c)[0]} {r:.2f}" for c, r in ratio.items() if np.isfinite(r) and r > 1.0
    )
    reason = "requested by --method"
    if method != "filter-error":
        reason = (
            "the residuals of output error show turbulence; rms over noise:"
            f" {ratios_text or 'none above 1'}"
        )
    rows = sum(len(r) for r in residual)
    return (
        f"filter error after {result.seconds:.0f} s of output error ({reason}): {rows} samples, "
        f"{len(result.names)} parameters; --method output-error skips it"
    )


def _inertial_channels(
    result: Identification,
) -> tuple[list[FloatArray], list[FloatArray], FloatArray]:
    """Return residuals, modelled motion and noise of the channels that sensors measure directly.

    Attitudes and wind angles from an estimator have coloured errors of their own, which say nothing
    of the air.
    """
    columns = [
        k for k, c in enumerate(result.outputs) if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")
    ]
    return (
        [r[:, columns] for r in result.residual],
        [y[:, columns] for y in result.modelled],
        np.array([result.noise[result.outputs[k]] for k in columns]),
    )


def _parameter_names(aircraft: Aircraft, requested: Sequence[str] | None) -> tuple[str, ...]:
    """Return the properties to estimate, those of the card by default.

    Raises BadInputError where there are none, and for a name given twice.
    """
    declared = list(aircraft.card.parameters)
    if requested is None:
        if not declared:
            raise BadInputError(
                f"aircraft '{aircraft.name}': airframe.toml has no [parameters]; name parameters"
                " with --params aero/Cm_q,..."
            )
        return tuple(declared)
    names = tuple(n if "/" in n else f"aero/{n}" for n in requested)
    if len(set(names)) < len(names):
        raise BadInputError(f"--params names {max(names, key=names.count)} twice")
    return names


def _initial(
    aircraft: Aircraft, model: ReplayModel, names: Sequence[str], start: str
) -> FloatArray:
    """Return the start values (k,), from the XML or from the card's guesses where it has any."""
    current = model.current_values(aircraft.dt_s, names)
    if start == "current":
        return current
    card = aircraft.card.parameters
    guesses = [card[n].initial if n in card else None for n in names]
    return np.array([c if g is None else g for g, c in zip(guesses, current, strict=True)])


def _limits(
    aircraft: Aircraft, names: Sequence[str], initial: FloatArray
) -> list[tuple[float, float]]:
    """Return the card's bounds of each parameter, infinite by default.

    Raises BadInputError for a start value outside its bounds.
    """
    out = []
    for name, value in zip(names, initial, strict=True):
        # Parameters that the card does not list are unbounded.
        card = aircraft.card.parameters.get(name)
        low, high = (
            card.bounds if card is not None and card.bounds is not None else (-np.inf, np.inf)
        )
        if not low <= value <= high:
            raise BadInputError(
                f"{name}: its start {value:g} lies outside the card's bounds [{low:g}, {high:g}]"
            )
        out.append((float(low), float(high)))
    return out


def _noise_warning(
    residual: Sequence[FloatArray], outputs: Sequence[str], noise: Mapping[str, float]
) -> list[str]:
    """Return a warning where residuals exceed the noise although nothing looks coloured."""
    # All segments together: a single one may exceed the limit by chance.
    pooled = np.concatenate(residual)
    ratio = {c: rms(pooled[:, k]) / noise[c] for k, c in enumerate(outputs) if noise[c] > 0.0}
    above = {c: r for c, r in ratio.items() if r > NOISE_FLOOR}
    if not above:
        return []
    return [
        "residuals exceed the sensor noise: "
        + ", ".join(f"{c} {r:.2f} times" for c, r in above.items())
        + ". The replay lacks something (autopilot commands between rows, gusts or a model"
        " term), and errors of the estimates may exceed std. Label the manoeuvres, log surface"
        " positions, or log faster"
    ]


def _assemble(
    aircraft: Aircraft,
    names: tuple[str, ...],
    initial: FloatArray,
    fitted: ReplayFit,
    observed: Observed,
    noise: Mapping[str, float],
    *,
    notes: Sequence[str],
    seconds: float,
    speed: Speed,
) -> Identification:
    """Collect the result of output error."""
    k, fit, outputs = len(names), fitted.fit, observed.outputs
    # The covariance has only the identified parameters.
    identified = [i for i in range(k) if fit.status[names[i]] == "identified"]
    nuisance = {
        n: (float(fit.theta[i]), float(fit.std[i]))
        for i, n in enumerate(fitted.layout.names)
        if i >= k
    }
    # Warnings of nuisance parameters do not concern the user.
    parameter_warnings = [
        w for w in fit.warnings if not w.startswith(("start/", "bias/", "delay/", f"{UNSEEN}/"))
    ]
    warnings = by_channel(parameter_warnings, outputs)
    assert isinstance(fit.residual, list)
    # Coloured residuals are the more specific warning and include this one.
    if not any(w.startswith("coloured") for w in warnings):
        warnings += _noise_warning(fit.residual, outputs, noise)
    return Identification(
        aircraft=aircraft.name,
        names=names,
        initial=initial,
        theta=fit.theta[:k],
        std=fit.std[:k],
        std_crb=fit.std_crb[:k],
        status={n: fit.status[n] for n in names},
        reason={n: fit.reason[n] for n in names},
        cov=fit.cov[np.ix_(identified, identified)],
        nuisance=nuisance,
        outputs=outputs,
        segments=tuple(observed.segments),
        measured=list(observed.data),
        modelled=fitted.replay(fit.theta),
        residual=fit.residual,
        whiteness=fit.whiteness,
        noise=noise,
        method="output error",
        converged=fit.converged,
        warnings=tuple(warnings),
        notes=tuple(notes),
        simulations=fit.n_simulations,
        seconds=seconds,
        speed=speed,
    )
