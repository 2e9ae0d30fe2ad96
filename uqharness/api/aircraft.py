"""Aircraft in Python: steady flight, linear models, the model-form plugin, and export."""

from __future__ import annotations

from uqharness.commands import AnyAircraft, aircraft_of, simulation
from uqharness.commands import authoring as authoring_commands
from uqharness.commands import exchange as commands
from uqharness.errors import BadInputError
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated, run_unsupervised
from uqharness.plugin import Instrumented
from uqharness.requests.authoring import AuthorRequest, ExportRequest, PerformanceRequest
from uqharness.requests.base import accepts
from uqharness.requests.simulation import (
    DiffRequest,
    InstrumentRequest,
    MarginsRequest,
    TrimRequest,
)
from uqharness.results.authoring import Authored, Loss, ModelDifference, Performance
from uqharness.results.simulation import Differences, Margins
from uqharness.simulator import LinearModel, SteadyCondition, Trim, linear, trim


@accepts(TrimRequest)
def find_trim(request: TrimRequest) -> Trim:
    """Trim an aircraft in steady flight in still air, as ``uqharness modes`` does.

    Returns
    -------
    Trim
        Angles [rad], body rates [rad/s], ``controls`` in their own units, ``thrust_N`` [N], ``rpm``
        [1/min], ``residual`` (6,) the accelerations left [m/s2 and rad/s2]. Where no steady flight
        exists, ``converged`` is False and ``reason`` says why.

    Raises
    ------
    BadInputError
        For an unknown aircraft, one that does not load, and numbers that mean no flight.

    References
    ----------
    B. L. Stevens, F. L. Lewis, Aircraft Control and Simulation: the rate-of-climb constraint.

    Examples
    --------
    >>> import uqharness as uq
    >>> steady = uq.find_trim("espaaro", 22.2, altitude_m=100)
    >>> steady.converged, round(steady.controls["throttle"])
    (True, 60)
    """
    condition = SteadyCondition(
        request.V_mps,
        request.altitude_m,
        request.climb_rad,
        request.bank_rad,
        request.heading_rad,
        properties=request.properties,
    )
    return run_unsupervised(trim.find_trim, aircraft_of(request.aircraft), condition)


def linearise(aircraft: AnyAircraft, steady: Trim) -> LinearModel:
    """Linearise an aircraft about a steady flight.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model that was trimmed.
    steady : Trim
        What `find_trim` gave.

    Returns
    -------
    LinearModel
        dx/dt = A x + B u: ``A`` (8, 8) for x = (u, v, w, p, q, r, phi, theta) in m/s, rad/s and
        rad, ``B`` (8, c) for the ``controls`` in their own units.
        ``uqharness.simulator.linear.modes`` names its modes.

    Raises
    ------
    BadInputError
        If the trim did not converge or is of another aircraft.

    References
    ----------
    B. L. Stevens, F. L. Lewis, Aircraft Control and Simulation: numerical linearisation by central
    differences.

    Examples
    --------
    >>> import uqharness as uq
    >>> model = uq.linearise("espaaro", uq.find_trim("espaaro", 22.2))
    >>> model.A.shape, model.controls
    ((8, 8), ('elevator', 'aileron', 'rudder', 'throttle'))
    """
    return run_unsupervised(linear.linearise, aircraft_of(aircraft), steady)


@notebook_line("margins")
@accepts(MarginsRequest)
@isolated
def margins(request: MarginsRequest) -> Margins:
    """Measure the autopilot's stability margins in flight, as ``uqharness margins`` does.

    Returns
    -------
    Margins
        ``loops``: of each loop the gain [dB], phase [deg] and delay [s] margins, crossovers [rad/s]
        and the modulus margin [-].

    Raises
    ------
    BadInputError
        For an aircraft without an autopilot, and an unknown loop.

    Examples
    --------
    >>> import uqharness as uq
    >>> result = uq.margins("espaaro", loop=["elevator"], flight="straight")
    >>> result.loops["elevator"].phase_deg > 30.0
    True
    """
    return simulation.margins(request).value


@notebook_line("diff")
@accepts(DiffRequest)
@isolated
def diff(request: DiffRequest) -> Differences | ModelDifference:
    """Fly two models side by side and list their differences, as ``uqharness diff`` does.

    Returns
    -------
    Differences
        ``differ``, the ``differences`` of channels, the likeliest cause first, ``terms`` of the XML
        that differ, ``flights``. Where a model file of ArduPilot or Gazebo is compared, a
        ModelDifference with the ``findings`` in its coefficients, geometry and mass.

    Raises
    ------
    BadInputError
        For unknown aircraft, and where neither a speed nor a script is named.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.diff("espaaro", "espaaro", script="trim").differ
    False
    """
    return simulation.diff(request).value


@notebook_line("instrument")
@accepts(InstrumentRequest)
@isolated
def instrument(request: InstrumentRequest) -> Instrumented:
    """Give a copy of an aircraft the model-form plugin, as ``uqharness instrument`` does.

    Returns
    -------
    Instrumented
        ``folder``, ``notes``, and the ``verdict`` of that flight: works, wrong or fails; None
        without one.

    Raises
    ------
    BadInputError
        For an aircraft that cannot be instrumented, with file and line, and for a folder that may
        not be written.
    LogError
        For a file that is no model form.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, section 2.6: delta coefficients between bounds.

    Examples
    --------
    >>> import uqharness as uq
    >>> done = uq.instrument("espaaro", constant={"CX": 0.008, "Cm": (-0.01, 0.02)}, out="bounded")
    >>> uq.find_aircraft(done.folder).name
    'espaaro'
    """
    if request.form is None and request.constant is None:
        raise BadInputError(
            'instrument: no bounds; give form, or constant such as {"CX": 0.01}, or {} for bounds'
            " of zero"
        )
    done = simulation.instrument(request).value
    assert done is not None  # only --undo has no result
    return done


# Models for other simulators.


@notebook_line("export")
@accepts(ExportRequest)
@isolated
def export(request: ExportRequest) -> Loss:
    """Write an aircraft's aerodynamics in another simulator's format, and measure what the format
    loses, as ``uqharness export`` does.

    Returns
    -------
    Loss
        ``coefficients`` with the difference [-] between the model as the other program computes it
        and the source, over random states around steady flight; ``verdict``; ``lost``, what the
        format cannot hold; ``files``.

    Raises
    ------
    BadInputError
        For an aircraft that does not trim, and bounds that cannot be read.

    References
    ----------
    ArduPilot, libraries/SITL/SIM_Plane.cpp; gz-sim, AdvancedLiftDrag.cc, with change 3817.

    Examples
    --------
    >>> import uqharness as uq
    >>> loss = uq.export("espaaro", "gazebo", out="espaaro-gazebo", speed_mps=22.2, states=100)
    >>> loss.verdict, loss.files[:2]
    ('no bounds', ['model-classic.sdf', 'model.sdf'])
    >>> loss.coefficients["Cm"].rms < 0.001
    True
    """
    return commands.export(request).value


# Models from geometry in Python, and an aircraft's performance.


@notebook_line("author")
@accepts(AuthorRequest)
@isolated
def author(request: AuthorRequest) -> Authored:
    """Write a JSBSim aircraft from derivatives of AVL, VSPAERO, XFLR5 or a table, with a prior of
    their errors, as ``uqharness author`` does.

    Returns
    -------
    Authored
        ``aircraft``, the folder, None where slips were found; ``terms`` with value and prior
        standard deviation in body axes about the centre of gravity, surfaces per degree;
        ``static_margin``; ``slips``; ``notes``, what was assumed.

    Raises
    ------
    BadInputError
        For files that cannot be read or hold no derivatives, and without a mass.

    References
    ----------
    B. Etkin, L. D. Reid, Dynamics of Flight, 3rd ed., appendix B.12.

    Examples
    --------
    >>> from pathlib import Path
    >>> import uqharness as uq
    >>> rows = ["name,value,unit", "S,0.35,m2", "b,1.6,m", "c,0.22,m", "CL_0,0.3,1"]
    >>> rows += ["CL_alpha,4.6,1/rad", "CD_0,0.03,1", "Cm_alpha,-0.6,1/rad", "Cm_q,-9,1"]
    >>> rows += ["Cm_de,-0.018,1/deg", "CL_de,0.007,1/deg", "Cl_p,-0.42,1"]
    >>> _ = Path("plane.csv").write_text("\\n".join(rows))
    >>> plane = uq.author("plane.csv", out="plane", mass_kg=2.0)
    >>> round(plane.static_margin, 2)
    0.13
    """
    return authoring_commands.author(request).value


@notebook_line("performance")
@accepts(PerformanceRequest)
@isolated
def performance(request: PerformanceRequest) -> Performance:
    """Compute an aircraft's performance sheet, as ``uqharness performance`` does.

    Returns
    -------
    Performance
        ``figures`` by name, each with value, unit and the interval over the corners of the
        aircraft's model-form bounds: stall, best glide and least sink, climb, greatest speed,
        sustained turn, ceiling; ``speeds``, lift over drag and climb against true airspeed.

    Raises
    ------
    BadInputError
        For an aircraft that does not trim.

    References
    ----------
    J. D. Anderson, Aircraft Performance and Design, chapters 5 and 6.

    Examples
    --------
    >>> import uqharness as uq
    >>> sheet = uq.performance("espaaro", bounds=False)
    >>> sheet.figures["best_glide_ratio"].value > 5
    True
    """
    return authoring_commands.performance(request).value
