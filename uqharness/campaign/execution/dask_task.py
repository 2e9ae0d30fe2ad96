"""What a Dask worker does for a campaign: flies a group of cases in a process beside it, if it has
what the campaign flies.

They never run in the Dask worker itself. A flight that ends the interpreter or hangs then costs a
child process, is blamed for certain and counted with the words of a local run, and Dask sees
nothing of it. Children stay for the next group."""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import socket
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache, lru_cache
from pathlib import Path, PurePath
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from sysid.digests import file_sha256
from uqharness.campaign.execution.processes import ProcessExecutor
from uqharness.campaign.execution.worker import (
    BATCH,
    JSBSIM,
    JUDGE,
    ONE_ULP_OFF,
    CaseOutcome,
    FlightFunction,
    Group,
    GroupFunction,
    OneByOne,
    unavailable_reason,
)
from uqharness.campaign.folder.manifest import binding_versions
from uqharness.child_process import CHILD_ENVIRONMENT
from uqharness.errors import BadInputError
from uqharness.flight import STATUSES
from uqharness.simulator import folder_hash
from uqharness.toml import dotted

# What travels between a campaign and a Dask worker: orders and answers, as JSON that is data
# and names what it wants flown.

T = TypeVar("T")
OWN_FLIGHT = "uqharness.flight.fly:fly"
OWN_GROUP = "uqharness.campaign.execution.worker:fly_group"
MODULES_VARIABLE = "UQHARNESS_FLIGHT_MODULES"
"""Environment variable of a worker: modules whose functions it may fly with beside this program's
own, separated by commas.
"""


@dataclass(frozen=True)
class Order:
    """Cases for a worker elsewhere. ``fly`` names the function that flies them, "module:function",
    ``together`` whether it takes the group; ``content`` and ``versions`` are what aircraft, script
    and program must be there."""

    fly: str
    together: bool
    group: Group
    content: tuple[str, str]
    versions: tuple[tuple[str, str], ...]

    @property
    def case_ids(self) -> tuple[str, ...]:
        """Ids of its cases, in order."""
        return tuple(case_id for case_id, _ in self.group.cases)


@dataclass(frozen=True)
class Answer:
    """Of a worker: the outcomes, or why it did not fly the cases, in a sentence."""

    outcomes: tuple[CaseOutcome, ...] | None
    refused: str = ""


def order_text(order: Order) -> str:
    """The order as JSON; numbers and paths come back as they are.

    Raises BadInputError for a path that is no text.
    """
    text = json.dumps(order, default=_as_json_type, ensure_ascii=False)
    try:
        text.encode()
    except UnicodeEncodeError:
        case_id, flight = order.group.cases[0]
        raise BadInputError(
            f"case {case_id}: a name with bytes that are no UTF-8 cannot be sent to a Dask cluster:"
            f" aircraft {str(flight.aircraft)!r}, script {str(flight.script)!r}; rename it, or fly"
            " without --dask"
        ) from None
    return text


def order_from(text: str) -> Order:
    """The order that `order_text` wrote. Raises BadInputError for any other text."""
    return _read(Order, text, "order")


def answer_text(answer: Answer) -> str:
    """The answer as JSON."""
    return (
        json.dumps(answer, default=_as_json_type, ensure_ascii=False)
        .encode("utf-8", "replace")
        .decode()
    )


def answer_from(text: Any, case_ids: tuple[str, ...]) -> list[CaseOutcome]:
    """Outcomes of the cases asked for.

    Raises BadInputError where the worker refused them, or for any other text.
    """
    answer = _read(Answer, text, "answer")
    if answer.outcomes is None:
        raise BadInputError(
            answer.refused or "a Dask worker gave neither an outcome nor a reason; look at its log"
        )
    if len(answer.outcomes) != len(case_ids):
        raise BadInputError(
            f"a Dask worker answered with {len(answer.outcomes)} flights; asked for were"
            f" {len(case_ids)}"
        )
    for outcome, case_id in zip(answer.outcomes, case_ids, strict=True):
        if outcome.case_id != case_id or outcome.status not in STATUSES:
            raise BadInputError(
                f"a Dask worker answered for case {outcome.case_id!r} with the status"
                f" {outcome.status!r}; asked for was case {case_id!r} with one of"
                f" {', '.join(STATUSES)}: every machine needs the same version of uqharness"
            )
    return list(answer.outcomes)


def flight_name(fly: FlightFunction | GroupFunction) -> str:
    """The name by which a worker finds a flight function.

    Raises BadInputError for what is not a function of a module.
    """
    name = f"{getattr(fly, '__module__', '')}:{getattr(fly, '__qualname__', '')}"
    try:
        function = _function(name)
    except BadInputError:
        function = None
    if function is not fly:
        raise BadInputError(
            "a Dask cluster flies with a function that its module holds by name, and not with"
            f" {fly!r}; fly this campaign without --dask"
        )
    return name


def group_function(order: Order) -> GroupFunction:
    """What flies an order's group. Raises BadInputError as `flight_function` does."""
    function = flight_function(order.fly)
    return function if order.together else OneByOne(function)


def flight_function(name: str) -> Any:
    """The function of that name, if this machine flies with it: the program's own, or one of a
    module that its operator named.

    Nothing else is imported, for importing a module runs it. Raises BadInputError.
    """
    allowed = {module.strip() for module in os.environ.get(MODULES_VARIABLE, "").split(",")}
    if name not in (OWN_FLIGHT, OWN_GROUP) and name.partition(":")[0] not in allowed - {""}:
        raise BadInputError(
            f"this worker flies with {OWN_FLIGHT} alone, and not with {name!r}; whoever trusts that"
            " module starts the worker with the environment variable"
            f" {MODULES_VARIABLE}={name.partition(':')[0]}"
        )
    return _function(name)


def _function(name: str) -> Any:
    module, _, qualname = name.partition(":")
    try:
        function = vars(importlib.import_module(module)).get(qualname)
    except (ImportError, ValueError) as error:
        raise BadInputError(
            f"the module of the flight function {name!r} cannot be imported: {error}"
        ) from None
    if not isinstance(function, types.FunctionType):
        raise BadInputError(f"there is no flight function {name!r}")
    return function


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _read(kind: Callable[..., T], text: Any, kind_name: str) -> T:
    try:
        parsed: T = _adapter(kind).validate_json(text, strict=True)
        return parsed
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = dotted(first["loc"]) or "the whole"
        raise BadInputError(
            f"malformed {kind_name} on the Dask cluster: {place}: {first['msg']}; every machine needs"
            " the same version of uqharness"
        ) from None


def _as_json_type(value: Any) -> Any:
    """What json does not know, in what it knows."""
    if is_dataclass(value):
        return vars(value)
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"an order holds a {type(value).__name__}, which is no data")


ABSENT = "not there"
_LONGEST_S, _FASTEST_HZ = 1e7, 1e5
"""Above what a campaign file allows; a flight without an end would hold the worker for good."""


def content_of(aircraft: Path, script: Path) -> tuple[str, str]:
    """Hashes of the aircraft's and the script's content on this machine, ``ABSENT`` where there is
    none.
    """
    return (
        folder_hash(aircraft) if aircraft.is_dir() else ABSENT,
        file_sha256(script) if script.is_file() else ABSENT,
    )


def fly_order(text: str) -> str:
    """Fly an order and give the answer, both as text; refused where this machine's files or
    versions are not the campaign's.
    """
    try:
        return answer_text(Answer(tuple(_fly_group(order_from(text)))))
    except BadInputError as error:
        return answer_text(Answer(None, f"Dask worker on {socket.gethostname()}: {error}"))


def _fly_group(order: Order) -> list[CaseOutcome]:
    fly = group_function(order)
    _refuse_unfit(order.group)
    _, flight = order.group.cases[0]
    _refuse_other_versions(order.versions, order.content, flight.aircraft, flight.script)
    _refuse_without_engine(order.group.engine)
    executor = _take_executor(order.fly)
    try:
        outcomes = {
            item.case_id: item
            for batch in executor.run_groups(fly, [order.group])
            for item in batch
        }
    finally:
        _idle.append((order.fly, executor))
    return [outcomes[case_id] for case_id in order.case_ids]


def _refuse_unfit(group: Group) -> None:
    """Refuse a group that no campaign sends: its files would not be compared, or its flights would
    not end.
    """
    if not group.cases:
        raise BadInputError("malformed order on the Dask cluster: no case in it")
    # An executor that was given a function of its own names no engine.
    if group.engine not in ("", BATCH, JSBSIM, JUDGE, ONE_ULP_OFF):
        raise BadInputError(
            f"malformed order on the Dask cluster: engine {group.engine[:40]!r}; allowed are"
            f" {BATCH} and {JSBSIM}"
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
        for name, (value, upper) in limits.items():
            # NaN is within no limits.
            if not 0.0 <= value <= upper:
                raise BadInputError(
                    f"malformed order on the Dask cluster: {name} {value:g}; allowed is 0 to"
                    f" {upper:g}"
                )


def _refuse_without_engine(name: str) -> None:
    reason = unavailable_reason(name)
    if reason is not None:
        raise BadInputError(f"the campaign flies in the batch engine, and {reason}")


# One process per thread of this worker; list operations are atomic, so that threads need no lock.
_idle: list[tuple[str, ProcessExecutor]] = []


def _take_executor(fly: str) -> ProcessExecutor:
    while _idle:
        try:
            name, executor = _idle.pop()
        except IndexError:
            break
        if name == fly:
            return executor
        executor.close()
    # Dask's nannies start workers as daemons, which Python forbids children, lest they be orphaned:
    # ours follow their parent.
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
    # For good: the executors of several threads would otherwise restore it under one another's
    # feet.
    os.environ.update(CHILD_ENVIRONMENT)
    # This process has threads, so that a fork of it may hang.
    return ProcessExecutor(1, "spawn", keep=True)


_versions_here = lru_cache(maxsize=1)(binding_versions)


def _refuse_other_versions(
    versions: tuple[tuple[str, str], ...], content: tuple[str, str], aircraft: Path, script: Path
) -> None:
    campaign_versions, local_versions = dict(versions), dict(_versions_here())
    unlike = [
        f"{name} {campaign_versions.get(name, 'unknown')} there, {local_versions.get(name, 'unknown')} here"
        for name in dict.fromkeys([*campaign_versions, *local_versions])
        if campaign_versions.get(name) != local_versions.get(name)
    ]
    local_content = content_of(aircraft, script)
    for kind, path, expected_hash, local_hash in zip(
        ("aircraft", "script"), (aircraft, script), content, local_content, strict=True
    ):
        if local_hash == ABSENT:
            unlike.append(f"{kind} {path} is not here")
        elif local_hash != expected_hash:
            unlike.append(f"{kind} {path} has other content here")
    if unlike:
        raise BadInputError(
            f"{'; '.join(unlike)}. Every machine needs the same versions, and the files "
            "under the same path: a common disk, or copies"
        )
