"""Servos by likelihood: whether commands reach the surfaces through the card's actuators or at
once.

A log of commands does not show how its servos moved. Both alternatives are fitted, by output error
with linearised sensitivities, to the segments in which the surfaces move most; parameters, biases,
delays and start states are estimated in each. The larger likelihood decides, with the noise of each
channel at its own maximum-likelihood value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sysid.aerodynamics import Piece
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    FlightData,
    ModelState,
    Trajectory,
    best_replay,
    make_flight_data,
    parameter_limits,
    refit,
    stage_models,
    with_jumping_flights,
)
from uqharness.identification.ordinary import is_ordinary
from uqharness.identification.replay_fit import equation_error_start
from uqharness.parallel import SHORT_COMMAND_S, worker_map
from uqharness.replay import CONTROLS, LATE_ROWS, Flight, control_columns
from uqharness.simulator import Aircraft

SURFACES = CONTROLS[:3]
WINDOWS_PER_SURFACE = 2
"""Fitted windows a surface, those in which it moves fastest on average."""
MAX_WINDOW_S = 12.0
"""Longest window [s]."""


@dataclass(frozen=True)
class ServoChoice:
    """Servos with which flights are replayed.

    Attributes
    ----------
    ideal : bool
        Whether commands are passed through.
    gain : float
        Log likelihood of the choice minus that of the alternative; NaN where they were not
        compared.
    note : str
        Sentence for the results; empty where nothing was compared.
    """

    ideal: bool
    gain: float = math.nan
    note: str = ""

    def with_note(self, flights: Sequence[Flight]) -> list[Flight]:
        """Return the flights, the first with the note."""
        if not self.note:
            return list(flights)
        return [replace(flights[0], notes=(*flights[0].notes, self.note)), *flights[1:]]


def choose_servos(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    request: str = "auto",
    workers: int | None = None,
) -> ServoChoice:
    """Choose between the card's servos and ideal ones.

    Parameters
    ----------
    measured : sequence of str
        Surfaces whose columns are positions: servos do not act on them.
    request : {"auto", "card", "ideal"}
        Anything but "auto" is binding and compares nothing.

    Returns
    -------
    ServoChoice
        The card's where no commanded surface has an actuator with a lag, and where neither can be
        flown. Records of a simulation that hold no logged rates (``native_hz``) keep the card's as
        well: they were flown with the card's servos.
    """
    if request != "auto":
        return ServoChoice(request == "ideal")
    # Without logged rates the flights are simulations, flown with the card's servos.
    logged = [f for f in flights if f.record.metadata.native_hz]
    moved = [c for c in SURFACES if c in aircraft.card.inputs and c not in measured]
    if not logged or not moved:
        return ServoChoice(False)
    # Without manoeuvres a delay of the controls stands for the servos, and replays are slow.
    if all(is_ordinary(f) for f in flights):
        return ServoChoice(False)
    # One flight is enough: servos are a property of the aircraft.
    busiest = [_busiest(f, moved, measured) for f in logged[:1]]
    unmeasured = tuple(c for c in CONTROLS if c not in measured)
    with worker_map(workers, SHORT_COMMAND_S) as pool:
        card = _fit(aircraft, busiest, measured, (), pool)
        # Actuators without a lag are ideal already.
        if card is not None and not card.lagging:
            return ServoChoice(False)
        ideal = _fit(aircraft, busiest, measured, unmeasured, pool)
    if card is None and ideal is None:
        return ServoChoice(False)
    # A model that cannot fly has log likelihood minus infinity.
    gain = (ideal.log_likelihood if ideal else -math.inf) - (
        card.log_likelihood if card else -math.inf
    )
    chosen, other = ("ideal", "the card's") if gain > 0.0 else ("the card's", "ideal")
    best = ideal if gain > 0.0 else card
    assert best is not None
    option = "card" if gain > 0.0 else "ideal"
    margin = (
        f"log likelihood {abs(gain):,.0f} higher than with {other} servos"
        if math.isfinite(gain)
        else f"the flights cannot be replayed with {other} servos"
    )
    note = (
        f"{logged[0].name}: using {chosen} servos ({margin}, {len(busiest[0].pieces)} segments, all"
        f" other parameters estimated for both); --servos {option} selects the alternative"
    )
    # A delay of all channels is not an effect of the servos.
    if abs(best.common_s) > LATE_ROWS * logged[0].record.dt_s:
        note += (
            f"; all channels {'lag' if best.common_s > 0.0 else 'lead'} the commands by"
            f" {1e3 * abs(best.common_s):.0f} ms, a clock offset or transport delay, which is"
            " estimated and removed"
        )
    return ServoChoice(gain > 0.0, abs(gain), note)


@dataclass(frozen=True)
class _ServoFit:
    """Log likelihood of a fit, surfaces with a lag, and the delay common to all sensors [s]."""

    log_likelihood: float
    lagging: tuple[str, ...]
    common_s: float


def _busiest(flight: Flight, surfaces: Sequence[str], measured: Sequence[str]) -> Flight:
    """Return the flight reduced to the windows in which each surface moves fastest."""
    columns = dict(zip(CONTROLS, control_columns(measured), strict=True))
    rows = math.ceil(MAX_WINDOW_S / flight.record.dt_s)
    windows = [w for piece in flight.pieces for w in _windows(flight, piece, rows)]
    # A window may serve several surfaces, but counts once.
    picked: set[int] = set()
    for surface in surfaces:
        values = flight.record[columns[surface]]
        rate = [float(np.nanmean(np.abs(np.diff(values[w.rows])))) for w in windows]
        order = [k for k in np.argsort(rate)[::-1].tolist() if k not in picked]
        picked |= set(order[:WINDOWS_PER_SURFACE])
    return replace(flight, pieces=tuple(windows[k] for k in sorted(picked)))


def _windows(flight: Flight, piece: Piece, rows: int) -> list[Piece]:
    """Divide a piece into equal windows of at most ``rows`` rows."""
    n = piece.rows.stop - piece.rows.start
    # Equal lengths: a short remainder would carry little information.
    edges = np.linspace(piece.rows.start, piece.rows.stop, math.ceil(n / rows) + 1).astype(int)
    time = flight.record["time_s"]
    return [
        replace(piece, rows=slice(a, b), start_s=float(time[a]), end_s=float(time[b - 1]))
        for a, b in pairwise(edges.tolist())
    ]


def _fit(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    ideal: Sequence[str],
    pool: Processes,
) -> _ServoFit | None:
    """Fit the flights with one kind of servos; None where the model cannot fly them."""
    names = tuple(aircraft.card.parameters)
    limits = parameter_limits(aircraft)
    # The same model flies with the card's servos or with ideal ones.
    data = make_flight_data(aircraft, flights, measured, ideal)
    with stage_models(aircraft, data) as models:
        data = with_jumping_flights(data, models.model)
        lagging = tuple(c for c in models.model.lagging if c in SURFACES)
        current = models.model.current_values(aircraft.dt_s, names)
        equation_error_theta, _ = equation_error_start(
            models.model,
            models.direct_model,
            flights,
            data.segments,
            names,
            current,
            limits=[limits[n] for n in names],
        )
        starts = tuple(s.start.copy() for s in data.segments)
        # Start from equation error, or from the values of the XML if these fly better.
        points = [
            ModelState(
                dict(zip(names, values.tolist(), strict=True)),
                dict.fromkeys(data.nuisance, 0.0),
                starts,
            )
            for values in (equation_error_theta, current)
        ]
        try:
            best = best_replay(models.model, data, points, pool)
            fit = refit(models, data, best.point, names, limits, pool)
        except np.linalg.LinAlgError:
            return None
    return _ServoFit(
        _log_likelihood(data, fit.trajectory), lagging, _common_s(data, fit.trajectory.point)
    )


def _log_likelihood(data: FlightData, replays: Trajectory) -> float:
    """Return the log likelihood of replays up to a constant, each channel's noise its own
    residual.
    """
    residual = np.concatenate([z - y for z, y in zip(data.measured, replays.outputs, strict=True)])
    count = np.isfinite(residual).sum(axis=0)
    square = np.nansum(residual**2, axis=0) / np.maximum(count, 1)
    # Floor for channels without any error, whose log likelihood would be infinite.
    floor = (1e-6 * data.noise) ** 2
    return -0.5 * float(np.sum(count * np.log(np.maximum(square, floor))))


def _common_s(data: FlightData, point: ModelState) -> float:
    """Return the time by which every inertial sensor lags the commands [s]; 0 where signs
    differ.
    """
    delays = [
        value
        for name, value in point.nuisance.items()
        if name.startswith("delay/") and name.endswith(("/rates", "/accelerations", "/attitude"))
    ]
    # Delays of both signs have no common part.
    if not delays or min(delays) * max(delays) <= 0.0:
        return 0.0
    return min(delays, key=abs)
