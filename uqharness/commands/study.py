"""Command study: from flights to a statement about performance, before and after refinement."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any

from uqharness.campaign import Progress
from uqharness.files import find_campaign
from uqharness.heartbeat import Callback, silent
from uqharness.report import write_report
from uqharness.requests.base import Request, command_line
from uqharness.requests.folders import StudyRequest
from uqharness.results.base import Outcome
from uqharness.results.study import Study
from uqharness.study import read_chain, run_chain

_FUNCTIONS: Mapping[str, str] = {
    "instrument": "simulation:instrument",
    "fly": "simulation:fly",
    "log import": "logs:import_record",
    "identify": "identification:identify",
    "compare": "identification:compare",
    "bounds": "identification:bounds",
    "validate-bounds": "identification:validate_bounds",
    "campaign run": "campaign:run",
    "sensitivity": "sensitivity:sensitivity",
    "refine": "refinement:refine",
}
"""Command of a stage to the function that runs its request, within uqharness.commands."""


def study(request: StudyRequest, callback: Callback = silent) -> Outcome[Study]:
    """Run or resume a study; the answer is no where a stage answered no."""
    spec = read_chain(find_campaign(request.study, "chain.toml"))
    command = command_line(request.model_copy(update={"workers": None}), full=True)
    done = run_chain(run_request, spec, request.out, request.workers, command, callback)
    report = write_report(request.out).path
    document = done.model_copy(update={"report": str(report)})
    # Stages that ran but answered no, such as a comparison above the noise floor.
    code = int(any(stage.exit == 1 for stage in done.stages))
    answer = done.answer
    assert answer is not None
    lines = [f"{done.question} {answer.answer}", answer.why, answer.lacked, answer.next]
    return Outcome(document, document, [line for line in lines if line], code, report)


def run_request(request: Request, callback: Callback) -> Outcome[Any]:
    """Run the request of a stage."""
    # Imported here: a study loads only what its stages need.
    module, _, name = _FUNCTIONS[request.command].partition(":")
    function: Callable[..., Outcome[Any]] = getattr(
        importlib.import_module(f"uqharness.commands.{module}"), name
    )

    def show(progress: Progress) -> None:
        """Name the progress of a campaign as a stage."""
        callback(f"{progress.done} of {progress.cases} flights")

    return function(request, show if request.flies else callback)
