"""Models from geometry in Python, and an aircraft's performance."""

from __future__ import annotations

from uqharness.commands import authoring as commands
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.requests.authoring import AuthorRequest, PerformanceRequest
from uqharness.requests.base import accepts
from uqharness.results.authoring import Authored, Performance


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
    return commands.author(request).value


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
    return commands.performance(request).value
