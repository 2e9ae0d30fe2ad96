"""Identification in Python: parameters, the gap to a flight, and bounds of the model error.

The functions take aircraft and flights in any form (names, paths, records), prepare them as the
commands do, and return typed results.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from sysid.model_form import ModelForm
from uqharness.arguments import instance, one_of, path
from uqharness.arguments import workers as given_workers
from uqharness.commands import (
    AnyAircraft,
    AnyFlight,
    AnyPath,
    Flight,
    carded_aircraft,
    flights_of,
)
from uqharness.commands import identification as commands
from uqharness.errors import BadInputError
from uqharness.heartbeat import notebook_line
from uqharness.identification import (
    SERVOS,
    Comparison,
    Identification,
    MadeBounds,
    Validation,
    choose_servos,
    load_form,
    parse_channels,
    validate,
)
from uqharness.identification import compare as comparing
from uqharness.identification import identify as identifying
from uqharness.isolation import isolated
from uqharness.replay import cut_for_residuals
from uqharness.replay import flights as replayed
from uqharness.requests.base import accepts
from uqharness.requests.identification import BoundsRequest
from uqharness.simulator import Aircraft

Servos = Literal["auto", "card", "ideal"]


@notebook_line("identify")
@isolated
def identify(
    aircraft: AnyAircraft,
    flights: AnyFlight | Iterable[AnyFlight],
    *,
    parameters: Sequence[str] | None = None,
    start: Literal["current", "initial"] = "current",
    method: Literal["auto", "output-error", "filter-error"] = "auto",
    biases: Sequence[str] | None = None,
    delays: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    servos: Servos = "auto",
    workers: int | None = None,
) -> Identification:
    """Estimate an aircraft's parameters from flights, as ``uqharness identify`` does.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model.
    flights : flight or sequence of flights
        Paths, FlightRecords, or what `fly` and `read_flights` give.
    parameters : sequence of str, optional
        JSBSim properties to estimate, such as ``["aero/Cm_q"]``; by default those of the card that
        the flights excite.
    start : {"current", "initial"}
        Start from the values in the XML, or from the card's first guesses.
    method : {"auto", "output-error", "filter-error"}
        ``auto`` takes filter error where the residuals show turbulence.
    biases : sequence of str, optional
        Channels with a constant sensor bias to estimate, short (``"p"``) or whole (``"p_radps"``);
        by default p, q, r.
    delays : sequence of str, optional
        What is late by a delay to be estimated: channels, or ``"controls"``; by default the
        controls, and all channels of a log.
    outputs : sequence of str, optional
        Channels that are fitted; by default all that are recorded, without ``parameters`` those
        that some parameter acts on.
    servos : {"auto", "card", "ideal"}
        Commands go through the aircraft's actuators, or surfaces and throttle follow them at once;
        ``auto``: of a log, the likelier of the two, which a note of the result names.
    workers : int, optional
        Processes; by default one a core, 8 at most.

    Returns
    -------
    Identification
        ``names`` (k,), ``theta`` (k,) the estimates in the properties' own units, ``std`` (k,)
        corrected for coloured residuals, ``cov`` (k, k) of the identified ones, ``status``,
        ``warnings``, the segments with measured and modelled channels. ``to_dataframe()`` is the
        table of parameters.

    Raises
    ------
    BadInputError
        For flights that lack a channel, unknown parameters or channels, and a model that cannot fly
        the segments.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, eq. 2.4 to 2.9: output error. R. V. Jategaonkar,
    Flight Vehicle System Identification, 2nd ed., 2015: filter error. docs/method.md has the
    equations.

    Examples
    --------
    >>> import uqharness as uq
    >>> flight = uq.fly("espaaro", "doublet-elevator", noise=True, seed=1)
    >>> fit = uq.identify("espaaro", flight, parameters=["aero/Cm_q", "aero/Cm_de"], workers=1)
    >>> fit.converged, fit.identified
    (True, ('aero/Cm_q', 'aero/Cm_de'))
    """
    model, workers = carded_aircraft(aircraft), given_workers(workers)
    names = None if parameters is None else _names("parameters", parameters)
    if names == []:
        raise BadInputError(
            "parameters is empty; name properties such as aero/Cm_q, or leave it out"
        )
    late, biased, fitted = (
        _channels("delays", delays),
        _channels("biases", biases),
        _channels("outputs", outputs),
    )
    ready, measured = _prepared(flights_of(flights, model), model)
    choice = choose_servos(model, ready, measured, one_of("servos", servos, SERVOS), workers)
    return identifying.identify(
        model,
        choice.with_note(ready),
        measured,
        names,
        start=one_of("start", start, ("current", "initial")),
        biases=identifying.BIASES if biased is None else biased,
        delays=late,
        outputs=fitted,
        ideal_servos=choice.ideal,
        method=one_of("method", method, ("auto", "output-error", "filter-error")),
        workers=workers,
    )


@notebook_line("compare")
@isolated
def compare(
    aircraft: AnyAircraft,
    flight: AnyFlight,
    *,
    biases: Sequence[str] | None = None,
    delays: Sequence[str] | None = None,
    servos: Servos = "auto",
    workers: int | None = None,
) -> Comparison:
    """Replay a flight and measure the gap to the model against the sensors' noise, as ``uqharness
    compare`` does.

    A record's late channels stay late; ``delays`` allows for them.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model.
    flight : str, Path, FlightRecord or Flight
        What was measured.
    biases, delays, servos, workers
        As for `identify`.

    Returns
    -------
    Comparison
        ``channels`` with rms and noise of each in the channel's own unit, ``coefficients`` [-],
        ``manoeuvres``, the worst ``moments``, and per segment the channels ``measured`` and
        ``modelled`` (n, m). ``reached`` says whether every judged channel is within 1.15 of its
        noise. ``to_dataframe()`` is the table of channels.

    Raises
    ------
    BadInputError
        For a flight that lacks a channel and a model that cannot fly any segment.

    References
    ----------
    H. Theil, Economic Forecasts and Policy, 1961: inequality coefficient with its shares of bias,
    variance and covariance. docs/identification.md describes the other measures.

    Examples
    --------
    >>> import uqharness as uq
    >>> flight = uq.fly("espaaro", "doublet-elevator", noise=True, seed=1)
    >>> gap = uq.compare("espaaro", flight, workers=1)
    >>> gap.reached, gap.above
    (True, ())
    """
    model, workers = carded_aircraft(aircraft), given_workers(workers)
    late, biased = _channels("delays", delays), _channels("biases", biases)
    flights = flights_of(flight, model)
    if len(flights) != 1:
        raise BadInputError(
            f"compare takes one flight, {len(flights)} were given; call it once for each"
        )
    # Late channels stay late: their delay is part of the comparison.
    ready, measured = _prepared(flights, model, align=False)
    choice = choose_servos(model, ready, measured, one_of("servos", servos, SERVOS), workers)
    return comparing.compare(
        model,
        choice.with_note(ready)[0],
        measured,
        biases=identifying.BIASES if biased is None else biased,
        delays=late,
        ideal_servos=choice.ideal,
        workers=workers,
    )


@notebook_line("fit_model_form")
@accepts(BoundsRequest)
@isolated
def fit_model_form(request: BoundsRequest) -> MadeBounds:
    """Bounds of what a model does not know, from flights that it was not identified from, as
    ``uqharness bounds`` makes them.

    Returns
    -------
    MadeBounds
        ``form``, the model form that `instrument` and campaigns take (``form.to_json()`` is
        model-form.json), the residual coefficients [-] it was fitted to, ``widths`` and ``noise``
        [-] per coefficient, ``warnings``. Sensor noise is in no bounds. ``to_dataframe()`` is the
        table of coefficients, with the parts of model error [-] and whether any was found.

    Raises
    ------
    BadInputError
        For flights that lack a channel or are too short, and for unknown states or terms.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, eq. 2.11 to 2.18: residual coefficients, and the
    prediction interval of their regression on the flight states.

    Examples
    --------
    >>> import uqharness as uq
    >>> flight = uq.fly(
    ...     "espaaro_truth", "flight-bounds", duration_s=40, turbulence="light", noise=True, seed=2
    ... )
    >>> bounds = uq.fit_model_form("espaaro", flight, checks=False)
    >>> sorted(bounds.form.coefficients)
    ['CX', 'CY', 'CZ', 'Cl', 'Cm', 'Cn']
    """
    return commands.bounds(request).value


def validate_bounds(
    aircraft: AnyAircraft,
    form: ModelForm | MadeBounds | AnyPath,
    flights: AnyFlight | Iterable[AnyFlight],
    *,
    servos: Servos = "auto",
) -> Validation:
    """Count how much of a new flight lies within bounds from other flights, as ``uqharness
    validate-bounds`` does.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model that the bounds were made for.
    form : ModelForm, MadeBounds, str or Path
        The bounds: what `fit_model_form` gave, or a model-form.json.
    flights : flight or sequence of flights
        Flights that the bounds were not made from.
    servos : {"auto", "card", "ideal"}
        As for `identify`.

    Returns
    -------
    Validation
        ``coverage`` of each coefficient's intervals [-], the ``residuals`` [-], and ``warnings``.

    Raises
    ------
    BadInputError
        For bounds of another aircraft, flights that they were made from, and flights that lack a
        channel.

    Examples
    --------
    >>> import uqharness as uq
    >>> first, second = (
    ...     uq.fly("espaaro", "flight-bounds", duration_s=40, noise=True, seed=n) for n in (1, 2)
    ... )
    >>> made = uq.fit_model_form("espaaro", first, checks=False)
    >>> sorted(uq.validate_bounds("espaaro", made, second).coverage)
    ['CX', 'CY', 'CZ', 'Cl', 'Cm', 'Cn']
    """
    model = carded_aircraft(aircraft)
    if isinstance(form, MadeBounds):
        form = form.form
    if not isinstance(form, ModelForm):
        form = load_form(path("form", form))
    new = flights_of(flights, model)
    ready, measured = _prepared(new, model)
    hashes = [flight.sha256 for flight in new]
    with notebook_line("validate_bounds"):
        ready = [cut_for_residuals(flight, measured) for flight in ready]
        choice = choose_servos(model, ready, measured, one_of("servos", servos, SERVOS))
        return validate(
            model, form, choice.with_note(ready), measured, hashes, ideal_servos=choice.ideal
        )


def _prepared(
    flights: Sequence[Flight], aircraft: Aircraft, align: bool = True
) -> tuple[list[replayed.Flight], tuple[str, ...]]:
    """Prepare flights for replay; return them and the surfaces with measured positions."""
    return replayed.prepare_together(
        [f.name for f in flights], [f.record for f in flights], aircraft, align=align
    )


def _channels(argument: str, names: Sequence[str] | None) -> tuple[str, ...] | None:
    """Check channel names as the command line does; None where they were not given."""
    return parse_channels(
        f"--{argument}", None if names is None else ",".join(_names(argument, names))
    )


def _names(argument: str, names: Sequence[str]) -> list[str]:
    """Return one name or several as a list of str. Raises BadInputError."""
    several = (
        [names]
        if isinstance(names, str)
        else instance(argument, names, Iterable, "a name or several")
    )
    return [instance(argument, name, str, "a name, as a str,") for name in several]


def _designs(argument: str, by_coefficient: Mapping[str, Sequence[str]] | None) -> list[str]:
    """Convert a mapping of coefficients to the form of the command line, ``CX=V,alpha``."""
    mapping = (
        {}
        if by_coefficient is None
        else instance(argument, by_coefficient, Mapping, 'a mapping such as {"CX": ["V", "alpha"]}')
    )
    return [f"{c}={','.join(_names(argument, names))}" for c, names in mapping.items()]
