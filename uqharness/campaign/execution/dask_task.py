"""What a Dask worker does for a campaign: flies a group of cases in a process beside it, if it has what the campaign flies.

They never run in the Dask worker itself. A flight that ends the interpreter or hangs then costs a child process, is blamed for
certain and counted with the words of a local run, and Dask sees nothing of it. Children stay for the next group.
"""

from __future__ import annotations

import multiprocessing
import os
import socket
from functools import lru_cache
from pathlib import Path

from sysid.digests import file_sha256
from uqharness.campaign.execution.dask_orders import (
    Answer,
    Order,
    answer_text,
    group_function,
    order_from,
)
from uqharness.campaign.execution.flying import BATCH, JSBSIM, JUDGE, ONE_ULP_OFF, why_not
from uqharness.campaign.execution.processes import ProcessExecutor
from uqharness.campaign.execution.worker import CaseOutcome, Group
from uqharness.campaign.folder.manifest import binding_versions
from uqharness.child_process import CHILD_ENVIRONMENT
from uqharness.errors import BadInputError
from uqharness.simulator import folder_hash

ABSENT = "not there"
_LONGEST_S, _FASTEST_HZ = 1e7, 1e5
"""Above what a campaign file allows; a flight without an end would hold the worker for good."""


def content_of(aircraft: Path, script: Path) -> tuple[str, str]:
    """Hashes of the aircraft's and the script's content on this machine, ``ABSENT`` where there is none."""
    return (
        folder_hash(aircraft) if aircraft.is_dir() else ABSENT,
        file_sha256(script) if script.is_file() else ABSENT,
    )


def fly_order(text: str) -> str:
    """Fly an order and give the answer, both as text; refused where this machine's files or versions are not the campaign's."""
    try:
        return answer_text(Answer(tuple(_flown(order_from(text)))))
    except BadInputError as error:
        return answer_text(Answer(None, f"Dask worker on {socket.gethostname()}: {error}"))


def _flown(order: Order) -> list[CaseOutcome]:
    fly = group_function(order)
    _refuse_unfit(order.group)
    _, flight = order.group.cases[0]
    _refuse_unlike(order.versions, order.content, flight.aircraft, flight.script)
    _refuse_without_engine(order.group.engine)
    executor = _take(order.fly)
    try:
        found = {
            item.case_id: item
            for batch in executor.run_groups(fly, [order.group])
            for item in batch
        }
    finally:
        _idle.append((order.fly, executor))
    return [found[case_id] for case_id in order.case_ids]


def _refuse_unfit(group: Group) -> None:
    """Refuse a group that no campaign sends: its files would not be compared, or its flights would not end."""
    if not group.cases:
        raise BadInputError("malformed order on the Dask cluster: no case in it")
    # An executor that was given a function of its own names no engine.
    if group.engine not in ("", BATCH, JSBSIM, JUDGE, ONE_ULP_OFF):
        raise BadInputError(
            f"malformed order on the Dask cluster: engine {group.engine[:40]!r}; allowed are {BATCH} and {JSBSIM}"
        )
    if len({case_id for case_id, _ in group.cases}) < len(group.cases):
        raise BadInputError("malformed order on the Dask cluster: one case twice")
    if len({(flight.aircraft, flight.script) for _, flight in group.cases}) > 1:
        raise BadInputError(
            "malformed order on the Dask cluster: its cases are of several aircraft or scripts"
        )
    for _, flight in group.cases:
        limits = {
            "duration_s": (flight.duration_s, _LONGEST_S),
            "burn_in_s": (flight.burn_in_s, _LONGEST_S),
            "record_rate_hz": (flight.record_rate_hz, _FASTEST_HZ),
        }
        for name, (value, most) in limits.items():
            # NaN is within no limits.
            if not 0.0 <= value <= most:
                raise BadInputError(
                    f"malformed order on the Dask cluster: {name} {value:g}; allowed is 0 to {most:g}"
                )


def _refuse_without_engine(name: str) -> None:
    reason = why_not(name)
    if reason is not None:
        raise BadInputError(f"the campaign flies in the batch engine, and {reason}")


# One process per thread of this worker; list operations are atomic, so that threads need no lock.
_idle: list[tuple[str, ProcessExecutor]] = []


def _take(fly: str) -> ProcessExecutor:
    while _idle:
        try:
            found, executor = _idle.pop()
        except IndexError:
            break
        if found == fly:
            return executor
        executor.close()
    # Dask's nannies start workers as daemons, which Python forbids children, lest they be orphaned: ours follow their parent.
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
    # For good: the executors of several threads would otherwise restore it under one another's feet.
    os.environ.update(CHILD_ENVIRONMENT)
    # This process has threads, so that a fork of it may hang.
    return ProcessExecutor(1, "spawn", keep=True)


_versions_here = lru_cache(maxsize=1)(binding_versions)


def _refuse_unlike(
    versions: tuple[tuple[str, str], ...], content: tuple[str, str], aircraft: Path, script: Path
) -> None:
    there, here = dict(versions), dict(_versions_here())
    unlike = [
        f"{name} {there.get(name, 'unknown')} there, {here.get(name, 'unknown')} here"
        for name in dict.fromkeys([*there, *here])
        if there.get(name) != here.get(name)
    ]
    found = content_of(aircraft, script)
    for what, path, wanted, have in zip(
        ("aircraft", "script"), (aircraft, script), content, found, strict=True
    ):
        if have == ABSENT:
            unlike.append(f"{what} {path} is not here")
        elif have != wanted:
            unlike.append(f"{what} {path} has other content here")
    if unlike:
        raise BadInputError(
            f"{'; '.join(unlike)}. Every machine needs the same versions, and the files "
            "under the same path: a common disk, or copies"
        )
