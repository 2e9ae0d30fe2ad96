"""Aircraft in Python: steady flight, linear models, and the model-form plugin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real

from sysid.aerodynamics import COEFFICIENTS
from sysid.model_form import ModelForm, read_model_form
from uqharness.arguments import flag, instance, number, path, require
from uqharness.arguments import properties as settings
from uqharness.commands import AnyAircraft, AnyPath, aircraft_of
from uqharness.errors import BadInputError
from uqharness.files import check_output_folder
from uqharness.heartbeat import notebook_line
from uqharness.identification import MadeBounds
from uqharness.isolation import run_unsupervised
from uqharness.plugin import Bounds, Instrumented, MassProperties, instrument_aircraft
from uqharness.simulator import LinearModel, SteadyCondition, Trim, linear, trim


def find_trim(
    aircraft: AnyAircraft,
    V_mps: float,
    *,
    altitude_m: float = 0.0,
    climb_rad: float = 0.0,
    bank_rad: float = 0.0,
    heading_rad: float = 0.0,
    properties: Mapping[str, float] | None = None,
) -> Trim:
    """Trim an aircraft in steady flight in still air, as ``uqharness modes`` does.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model.
    V_mps : float
        True airspeed [m/s].
    altitude_m : float
        Above sea level [m].
    climb_rad, bank_rad, heading_rad : float
        Flight-path angle, bank of a coordinated turn, true heading [rad].
    properties : Mapping, optional
        JSBSim properties to set first.

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
    number("V_mps", V_mps, "a positive true airspeed [m/s]", lambda value: 0.0 < value < math.inf)
    for name, angle in (
        ("climb_rad", climb_rad),
        ("bank_rad", bank_rad),
        ("heading_rad", heading_rad),
        ("altitude_m", altitude_m),
    ):
        number(name, angle)
    # The limits of the command line, in its units.
    if not (abs(bank_rad) < math.radians(85.0) and abs(climb_rad) < math.radians(60.0)):
        raise BadInputError(
            f"bank_rad = {bank_rad:g}, climb_rad = {climb_rad:g}: less than 85 and 60 degrees"
            " either way are needed"
        )
    condition = SteadyCondition(
        V_mps, altitude_m, climb_rad, bank_rad, heading_rad, properties=settings(properties)
    )
    return run_unsupervised(trim.find_trim, aircraft_of(aircraft), condition)


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


@notebook_line("instrument")
def instrument(
    aircraft: AnyAircraft,
    form: ModelForm | MadeBounds | AnyPath | None = None,
    *,
    out: AnyPath,
    constant: Mapping[str, float | tuple[float, float]] | None = None,
    air: bool = False,
    check: bool = True,
    mass: Mapping[str, float] | None = None,
) -> Instrumented:
    """Give a copy of an aircraft the model-form plugin, as ``uqharness instrument`` does.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        The model; any JSBSim aircraft.
    form : MadeBounds, ModelForm, str or Path, optional
        What `fit_model_form` gave, or a file model-form.json.
    out : str or Path
        Folder of the copy.
    constant : Mapping, optional
        In place of a form, bounds that stay: coefficient to half width [-] or to (lower, upper)
        [-], as ``{"CX": 0.01}``.
    air : bool
        Whether this project's wind and turbulence are added (docs/air.md).
    check : bool
        Whether check flights compare the copy with the original.
    mass : Mapping, optional
        Mass properties of the aircraft as it flew, in place of the XML's: ``mass_kg``,
        ``ixx_kgm2``, ``iyy_kgm2``, ``izz_kgm2``, ``ixz_kgm2`` (the product of inertia), ``cg_x_m``,
        ``cg_y_m``, ``cg_z_m`` (the XML's structural frame).

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
    folder = path("out", out)
    if form is None and constant is None:
        raise BadInputError(
            'instrument: no bounds; give form, or constant such as {"CX": 0.01}, or {} for bounds'
            " of zero"
        )
    if form is not None and constant is not None:
        raise BadInputError(
            "instrument: form and constant are two sources of bounds; give one of them"
        )
    if isinstance(form, MadeBounds):
        form = form.form
    elif form is not None and not isinstance(form, ModelForm):
        form = read_model_form(path("form", form))
    constant_bounds = instance(
        "constant", {} if constant is None else constant, Mapping, 'a mapping such as {"CX": 0.01}'
    )
    bounds = Bounds(form, {name: _pair(name, value) for name, value in constant_bounds.items()})
    model = aircraft_of(aircraft)
    # Fail before the flights if the copy cannot be written.
    check_output_folder(folder)
    return run_unsupervised(
        instrument_aircraft,
        model,
        bounds,
        folder,
        air=flag("air", air),
        check=flag("check", check),
        mass=_mass(mass),
    )


def _mass(mass: Mapping[str, float] | None) -> MassProperties:
    """Check the names and values of mass properties. Raises BadInputError."""
    allowed = tuple(MassProperties.__dataclass_fields__)
    numbers = instance(
        "mass", {} if mass is None else mass, Mapping, 'a mapping such as {"mass_kg": 900.0}'
    )
    if unknown := [name for name in numbers if name not in allowed]:
        raise BadInputError(f"mass: {unknown[0]!r} is unknown; allowed are {', '.join(allowed)}")
    return MassProperties(**{name: number(name, value) for name, value in numbers.items()})


def _pair(name: str, value: float | tuple[float, float]) -> tuple[float, float]:
    """Check one constant bound; return its lower and upper limit. Raises BadInputError."""
    ends = tuple(value) if isinstance(value, tuple | list) else (value,)
    numbers = all(
        isinstance(end, Real) and not isinstance(end, bool) and math.isfinite(end) for end in ends
    )
    needed = f"one of {', '.join(COEFFICIENTS)} with a half width, or (lower <= 0, upper >= 0),"
    require(
        f"constant: {name}", value, name in COEFFICIENTS and numbers and len(ends) in (1, 2), needed
    )
    low, high = ends if len(ends) == 2 else (-ends[0], ends[0])
    require(f"constant: {name}", value, low <= 0.0 <= high, needed)
    return float(low) + 0.0, float(high)
