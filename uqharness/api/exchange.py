"""Export in Python: models for other simulators."""

from __future__ import annotations

from uqharness.commands import exchange as commands
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.requests.base import accepts
from uqharness.requests.exchange import ExportRequest
from uqharness.results.exchange import Loss


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
