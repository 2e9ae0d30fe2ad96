"""Refinement in Python: the function that ``uqharness refine`` corresponds to.

Flights in memory are written to temporary files, because a refinement reads files and names them in
its provenance.
"""

from __future__ import annotations

from uqharness.commands import refinement as commands
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.refinement import Refinement
from uqharness.requests.base import Callback, accepts, silent
from uqharness.requests.refinement import RefineRequest


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
    return commands.refine(request, callback).value
