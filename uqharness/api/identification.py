"""Identification in Python: parameters, the gap to a flight, and bounds of the model error.

The functions take aircraft and flights in any form (names, paths, records), prepare them as the
commands do, and return typed results.
"""

from __future__ import annotations

from uqharness.commands import identification as commands
from uqharness.commands import refinement as refinement_commands
from uqharness.heartbeat import Callback, notebook_line, silent
from uqharness.identification import (
    Comparison,
    ForecastContest,
    Identification,
    MadeBounds,
    Validation,
)
from uqharness.isolation import isolated
from uqharness.refinement import Refinement
from uqharness.requests.base import accepts
from uqharness.requests.identification import (
    BoundsRequest,
    CompareRequest,
    IdentifyRequest,
    ValidateBoundsRequest,
)
from uqharness.requests.refinement import RefineRequest


@notebook_line("identify")
@accepts(IdentifyRequest)
@isolated
def identify(request: IdentifyRequest) -> Identification:
    """Estimate an aircraft's parameters from flights, as ``uqharness identify`` does.

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
    return commands.identify(request).value


@notebook_line("compare")
@accepts(CompareRequest)
@isolated
def compare(request: CompareRequest) -> Comparison | ForecastContest:
    """Replay a flight and measure the gap to the model against the sensors' noise, as ``uqharness
    compare`` does.

    A record's late channels stay late; ``delays`` allows for them.

    Returns
    -------
    Comparison
        ``channels`` with rms and noise of each in the channel's own unit, ``coefficients`` [-],
        ``manoeuvres``, the worst ``moments``, and per segment the channels ``measured`` and
        ``modelled`` (n, m). ``reached`` says whether every judged channel is within 1.15 of its
        noise. ``to_dataframe()`` is the table of channels. With ``other`` a ForecastContest, whose
        ``better`` is "A", "B" or "no difference".

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
    return commands.compare(request).value


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


@notebook_line("validate_bounds")
@accepts(ValidateBoundsRequest)
@isolated
def validate_bounds(request: ValidateBoundsRequest) -> Validation:
    """Count how much of a new flight lies within bounds from other flights, as ``uqharness
    validate-bounds`` does.

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
    return commands.validate_bounds(request).value


# Refinement in Python: the function that ``uqharness refine`` corresponds to.
#
# Flights in memory are written to temporary files, because a refinement reads files and names
# them in its provenance.


@notebook_line("refine")
@accepts(RefineRequest)
def refine(request: RefineRequest) -> Refinement:
    """Find effects that a model lacks, and add them, as ``uqharness refine`` does.

    The same call resumes an interrupted refinement.

    Returns
    -------
    Refinement
        ``document``, which is refinement.json (`uqharness.results.refinement.Refinement`), and
        ``aircraft``, the refined one, which every function here takes.

    Raises
    ------
    BadInputError
        For flights that cannot be used or that train and test share, and a card without
        ``[parameters]``.
    LogError
        For a file of effects that cannot be used.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, section 2.7. docs/refine.md has the method.

    Examples
    --------
    >>> import uqharness as uq
    >>> train, test = (
    ...     uq.fly("espaaro_truth", "flight-ident", noise=True, seed=seed) for seed in (1, 2)
    ... )
    >>> result = uq.refine(
    ...     "espaaro", train=train, test=test, out="refined", pbox=False, figures=False
    ... )
    >>> result.document.verdict
    'effects-found'
    """
    callback = request.on_stage or silent
    return _refine(request.model_copy(update={"on_stage": None}), callback)


@isolated
def _refine(request: RefineRequest, callback: Callback) -> Refinement:
    """Refine in the worker, which calls back at each stage."""
    return refinement_commands.refine(request, callback).value
