"""Identification of a JSBSim aircraft's parameters from flights: equation error to come near, output error by replay to settle.

Output error takes a replay of every segment for its simulation; start states of the segments and sensor biases are estimated
beside the parameters. Where the residuals show process noise (turbulence), filter error on one-step predictions takes over, and the
result says so.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

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
from uqharness.identification.excitation import excited_alone
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
from uqharness.parallel import process_count, worker_map
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
    misplaced,
    replay_pool,
    shown_channel,
)
from uqharness.replay.flights import segments
from uqharness.simulator import MEMS_NOISE_STD, Aircraft

# Whether a fit explains its flights at all. One that does not gives the nearest values of a
# wrong model, and identifies none.

UNEXPLAINED_SIGMA = 10.0
"""Residual in sigma above which a channel may count as unexplained: small missing terms, which `refine` names, leave some 4."""
UNEXPLAINED_SHARE = 0.1
"""Share of a channel's variance left over above which it does: a third of the motion's size."""


def unexplained(
    residual: Sequence[FloatArray],
    measured: Sequence[FloatArray],
    outputs: Sequence[str],
    noise: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """Channels that a fit does not explain: rms of the residual in sigma, and its share of the channel's variance.

    residual, measured  [(n, m)] by segment, NaN where nothing was logged; the variance is about each segment's mean
    noise               by channel, its own unit; a record cleaner than a small MEMS unit is judged by that unit's noise
    """
    out = {}
    for k, channel in enumerate(outputs):
        left, moved, samples = 0.0, 0.0, 0
        for r, z in zip(residual, measured, strict=True):
            good = np.isfinite(r[:, k]) & np.isfinite(z[:, k])
            if good.any():
                left += float(np.sum(r[good, k] ** 2))
                moved += float(np.sum((z[good, k] - z[good, k].mean()) ** 2))
                samples += int(good.sum())
        size = max(noise[channel], MEMS_NOISE_STD.get(channel, 0.0))
        if not samples or not size > 0.0:
            continue
        sigma = float(np.sqrt(left / samples)) / size
        share = left / moved if moved > 0.0 else np.inf
        if sigma > UNEXPLAINED_SIGMA and share > UNEXPLAINED_SHARE:
            out[channel] = (sigma, share)
    return out


def withdrawn(found: Identification) -> Identification:
    """``found`` itself where it converged and explains its flights; else the same with no parameter identified, each at its start,
    and why: neither values nor standard errors hold of a fit that has not ended, or of a model that is not the aircraft's."""
    why = _why_withdrawn(found) if found.identified else ""
    if not why:
        return found
    advice = "check units, signs, mass, inertia and servos with compare, or let refine look for a missing effect"
    return replace(
        found,
        theta=found.initial.copy(),
        std=np.full(len(found.names), np.nan),
        std_crb=np.full(len(found.names), np.nan),
        status=dict.fromkeys(found.names, "not-identified"),
        reason={
            n: why if found.status[n] == "identified" else found.reason[n] for n in found.names
        },
        cov=np.zeros((0, 0)),
        warnings=(f"no parameter is identified: {why}; {advice}", *found.warnings),
    )


def _why_withdrawn(found: Identification) -> str:
    """Empty where the estimates stand."""
    wrong = unexplained(found.residual, found.measured, found.outputs, found.noise)
    if wrong:
        channel = max(wrong, key=lambda c: wrong[c][1])
        sigma, share = wrong[channel]
        others = (
            f" ({', '.join(c for c in wrong if c != channel)} as well)" if len(wrong) > 1 else ""
        )
        return (
            f"the model does not explain the flights: the residual of {channel} is {sigma:.0f} sigma, "
            f"{100.0 * share:.0f} % of its variance{others}"
        )
    return "" if found.converged else "not converged; values unchanged"


# What is said of an estimation's course: its iteration, how far it has to go, and about how
# long that takes.


@dataclass
class Descent:
    """Told each iteration (`sysid.estimation.gauss_newton.IterationCallback`), tells ``on_stage`` a sentence.

    Steps become shorter by about a constant factor from one iteration to the next: the time left is that of the iterations until
    they are ``tolerance`` standard errors long, at most of all that are allowed (``most``). Descents that follow one another count
    anew.
    """

    what: str
    on_stage: Callable[[str], None]
    tolerance: float
    most: int
    clock: Callable[[], float] = time.monotonic
    _begun: float = 0.0
    _lengths: list[float] = field(default_factory=list)

    def __call__(self, iteration: int, length: float) -> None:
        """An iteration begins from which the next step would be ``length`` standard errors long."""
        if iteration == 1 or not self._lengths:
            self._begun, self._lengths = self.clock(), []
        self._lengths.append(length)
        text = f"{self.what}: iteration {iteration}"
        if math.isfinite(length):
            text += f", {length:.2g} standard errors to go"
        left = self.seconds_left(iteration)
        self.on_stage(text if left is None else f"{text}, about {max(1, round(left))} s left")

    def seconds_left(self, iteration: int) -> float | None:
        """None in the first iterations of a descent."""
        done = len(self._lengths) - 1
        if done < 2:
            return None
        wanted = max(float(self.most - iteration), 1.0)
        first, last = self._lengths[0], self._lengths[-1]
        if 0.0 < last < first and last > self.tolerance:
            wanted = min(wanted, math.log(last / self.tolerance) * done / math.log(first / last))
        elif last <= self.tolerance:
            wanted = 1.0
        return wanted * (self.clock() - self._begun) / done


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
    workers: int | None = None,
    on_stage: Callable[[str], None] = lambda stage: None,
    tell: Callable[[str], None] | None = None,
) -> Identification:
    """Estimate JSBSim properties from flights.

    measured    surfaces whose columns are positions (`read_flights` says which)
    parameters  properties; default: those of the card's [parameters] that the flights excite (see excited.py)
    start       "initial": the card's first guesses; "current": the values in the XML
    biases      channels with a constant sensor bias, one a flight
    delays      channels whose delay after the commands is estimated, one a flight; None: all, of flights that come from a log
    outputs     channels that are fitted; default: all of OUTPUTS that are recorded; where parameters follow from the flights,
                without those that say nothing of any
    ideal_servos  surfaces and throttle follow their commands at once, whatever actuators the XML has
    method      "auto" | "output-error" | "filter-error"
    on_stage    told what is being done
    tell        called with a sentence for each route that is taken, output error or filter error: why, and how much there is to do
    Raises BadInputError for unknown parameters and for a model that cannot fly the segments.
    """
    names = _parameter_names(aircraft, parameters)
    ideal = tuple(c for c in CONTROLS if c not in measured) if ideal_servos else ()
    with ReplayFolder(aircraft, measured=measured, ideal=ideal) as model:
        arm = aircraft.accelerometer_m
        cut = [s for f in flights for s in segments(f, measured, arm)]
        initial = _initial(aircraft, model, names, start)
        limits = _limits(aircraft, names, initial)
        begun = time.perf_counter()
        on_stage("equation error")
        with ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as straight:
            near, notes = equation_error_start(
                model, straight, flights, cut, names, initial, limits
            )
        channels = _outputs(flights, outputs)
        data = [block for f in flights for block in measured_outputs(f, channels)]
        observed = Observed(
            cut,
            channels,
            data,
            [b for b in biases if b in channels],
            delayed(flights, channels, delays),
        )
        noise = channel_noise(data, channels, aircraft.card.sensors.noise_std)
        bare, flown, started = bare_rate(model, cut[0]), counter["rows"], time.perf_counter()
        with replay_pool(workers) as spread:
            if parameters is None:
                on_stage("what the flights excite")
                observed, more = excited_alone(
                    model, observed, names, initial, limits, noise, spread, outputs is None
                )
                notes = [*notes, *more]
            on_stage("output error")
            if tell is not None:
                tell(_why_output_error(observed, names, method))
            descent = Descent("output error", on_stage, OUTPUT_TOLERANCE, OUTPUT_ITERATIONS)
            fitted = fit_replays(
                model, observed, names, (near, initial), limits, spread, told=descent
            )
        fit = fitted.found
        taken = time.perf_counter() - started
        seconds = time.perf_counter() - begun
        flown_s = (counter["rows"] - flown) * cut[0].dt_s
        speed = Speed(fit.n_simulations / taken, flown_s / taken, process_count(workers), bare)
        found = _assemble(aircraft, names, initial, fitted, observed, noise, notes, seconds, speed)
        found = replace(found, warnings=(*misplaced(flights, cut, found.nuisance), *found.warnings))
        gusty = shows_process_noise(*_sensed(found))
        if method == "output-error" or (method == "auto" and not gusty):
            if tell is not None:
                tell(_why_it_stays(method, gusty))
            return withdrawn(found if gusty else _in_calm_air(found))
        if tell is not None:
            tell(_why_filter_error(found, method))
        from uqharness.identification.linearised.gusts import TOLERANCE as FILTER_TOLERANCE
        from uqharness.identification.turbulence import ITERATIONS as FILTER_ITERATIONS
        from uqharness.identification.turbulence import Asked, filter_route, filter_setup

        on_stage("filter error")
        fitted.replay.forget()
        setup = filter_setup(
            aircraft, flights, Asked(outputs, biases, delays, measured, ideal), found
        )
        with (
            ReplayFolder(aircraft, measured=measured, ideal=CONTROLS) as straight,
            worker_map(workers) as map_,
        ):
            descent = Descent("filter error", on_stage, FILTER_TOLERANCE, FILTER_ITERATIONS)
            return withdrawn(
                filter_route(
                    found, fitted, (model, straight), setup, limits, observed.held, map_, descent
                )
            )


def _in_calm_air(found: Identification) -> Identification:
    """Return the result with warnings of coloured residuals that no longer suspect turbulence."""
    coloured = [w for w in found.warnings if w.startswith("coloured residuals")]
    if not coloured:
        return found
    tint = colour(found.residual, found.modelled)
    text = colour_warnings(tint, found.std, found.std_crb, "output error", calm_air=True)
    others = tuple(w for w in found.warnings if w not in coloured)
    return replace(found, warnings=(*others, *by_channel(text, found.outputs)))


def _outputs(flights: Sequence[Flight], asked: Sequence[str] | None) -> tuple[str, ...]:
    """Channels that some flight has. Raises BadInputError for one asked for that none has."""
    there = tuple(
        c for c in OUTPUTS if any(c in f.record and np.isfinite(f.record[c]).any() for f in flights)
    )
    missing = [] if asked is None else [c for c in asked if c not in there]
    if missing or asked == ():
        raise BadInputError(
            f"no flight has {', '.join(missing) or 'the outputs asked for: none'}; there are {', '.join(there)}"
        )
    return there if asked is None else tuple(c for c in there if c in asked)


def _why_output_error(observed: Observed, names: Sequence[str], method: str) -> str:
    seconds = sum(float(s.time_s[-1] - s.time_s[0]) for s in observed.cut)
    free = len(names) - len(observed.held)
    why = {
        "auto": "assumes calm air; its residuals are then checked for turbulence",
        "output-error": "requested by --method",
        "filter-error": "start of filter error, requested by --method",
    }[method]
    return f"output error: {len(observed.cut)} segments, {seconds:.0f} s, {free} parameters ({why})"


def _why_it_stays(method: str, gusty: bool) -> str:
    sign = "show turbulence; estimates may be biased" if gusty else "show no sign of turbulence"
    requested = " (requested by --method)" if method == "output-error" else ""
    return f"keeping output error{requested}: the rate and acceleration residuals {sign}"


def _why_filter_error(found: Identification, method: str) -> str:
    residual, _, noise = _sensed(found)
    channels = [c for c in found.outputs if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = {c: rms(np.concatenate(residual)[:, k]) / noise[k] for k, c in enumerate(channels)}
    left = ", ".join(
        f"{shown_channel(c)[0]} {r:.2f}" for c, r in ratio.items() if np.isfinite(r) and r > 1.0
    )
    why = "requested by --method"
    if method != "filter-error":
        why = f"the residuals of output error show turbulence; rms over noise: {left or 'none above 1'}"
    rows = sum(len(r) for r in residual)
    return (
        f"filter error after {found.seconds:.0f} s of output error ({why}): {rows} samples, "
        f"{len(found.names)} parameters; --method output-error skips it"
    )


def _sensed(found: Identification) -> tuple[list[FloatArray], list[FloatArray], FloatArray]:
    """Residual, motion and noise of the channels that sensors measure directly.

    An estimator's attitude or wind angles have coloured errors of their own, which say nothing of the air.
    """
    columns = [
        k for k, c in enumerate(found.outputs) if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")
    ]
    return (
        [r[:, columns] for r in found.residual],
        [y[:, columns] for y in found.modelled],
        np.array([found.noise[found.outputs[k]] for k in columns]),
    )


def _parameter_names(aircraft: Aircraft, asked: Sequence[str] | None) -> tuple[str, ...]:
    known = list(aircraft.card.parameters)
    if asked is None:
        if not known:
            raise BadInputError(
                f"aircraft '{aircraft.name}': its airframe.toml lists no [parameters]; name some with --params aero/Cm_q,..."
            )
        return tuple(known)
    names = tuple(n if "/" in n else f"aero/{n}" for n in asked)
    if len(set(names)) < len(names):
        raise BadInputError(f"--params names {max(names, key=names.count)} twice")
    return names


def _initial(
    aircraft: Aircraft, model: ReplayModel, names: Sequence[str], start: str
) -> FloatArray:
    from uqharness.simulator import engine

    fdm = model.open(aircraft.dt_s)
    engine.require(fdm, names)
    current = np.array([fdm[name] for name in names])
    if start == "current":
        return current
    card = aircraft.card.parameters
    guesses = [card[n].initial if n in card else None for n in names]
    return np.array([c if g is None else g for g, c in zip(guesses, current, strict=True)])


def _limits(
    aircraft: Aircraft, names: Sequence[str], initial: FloatArray
) -> list[tuple[float, float]]:
    out = []
    for name, value in zip(names, initial, strict=True):
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


def _left_over(
    residual: Sequence[FloatArray], outputs: Sequence[str], noise: Mapping[str, float]
) -> list[str]:
    """A sentence when a channel is left further off than its noise explains although nothing looks coloured."""
    whole = np.concatenate(residual)
    ratio = {c: rms(whole[:, k]) / noise[c] for k, c in enumerate(outputs) if noise[c] > 0.0}
    above = {c: r for c, r in ratio.items() if r > NOISE_FLOOR}
    if not above:
        return []
    return [
        "residuals above the noise: "
        + ", ".join(f"{c} {r:.2f} times" for c, r in above.items())
        + "; something acted that the "
        "replay does not have (commands between rows while an autopilot flew, gusts, a missing term), and estimates may be off by "
        "more than std: label the manoeuvres, record surface positions or log faster"
    ]


def _assemble(
    aircraft: Aircraft,
    names: tuple[str, ...],
    initial: FloatArray,
    fitted: ReplayFit,
    observed: Observed,
    noise: Mapping[str, float],
    notes: Sequence[str],
    seconds: float,
    speed: Speed,
) -> Identification:
    k, fit, outputs = len(names), fitted.found, observed.outputs
    identified = [i for i in range(k) if fit.status[names[i]] == "identified"]
    hidden = {
        n: (float(fit.theta[i]), float(fit.std[i]))
        for i, n in enumerate(fitted.layout.names)
        if i >= k
    }
    # A start state that two channels cannot tell apart is nobody's concern; a parameter is.
    mine = [
        w for w in fit.warnings if not w.startswith(("start/", "bias/", "delay/", f"{UNSEEN}/"))
    ]
    warnings = by_channel(mine, outputs)
    assert isinstance(fit.residual, list)
    if not any(w.startswith("coloured") for w in warnings):
        warnings += _left_over(fit.residual, outputs, noise)
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
        nuisance=hidden,
        outputs=outputs,
        segments=tuple(observed.cut),
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
