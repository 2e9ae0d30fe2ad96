"""What travels between a campaign and a Dask worker: orders and answers, as JSON that is data and names what it wants flown."""

from __future__ import annotations

import importlib
import json
import os
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache
from pathlib import PurePath
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from uqharness.campaign.execution.worker import (
    CaseOutcome,
    FlightFunction,
    Group,
    GroupFunction,
    OneByOne,
)
from uqharness.errors import BadInputError
from uqharness.flight import STATUSES
from uqharness.toml import dotted

T = TypeVar("T")
OWN_FLIGHT = "uqharness.flight.fly:fly"
OWN_GROUP = "uqharness.campaign.execution.flying:fly_group"
MODULES_VARIABLE = "UQHARNESS_FLIGHT_MODULES"
"""Environment variable of a worker: modules whose functions it may fly with beside this program's own, separated by commas."""


@dataclass(frozen=True)
class Order:
    """Cases for a worker elsewhere. ``fly`` names the function that flies them, "module:function", ``together`` whether it takes
    the group; ``content`` and ``versions`` are what aircraft, script and program must be there."""

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
    """The order as JSON; numbers and paths come back as they are. Raises BadInputError for a path that is no text."""
    text = json.dumps(order, default=_plain, ensure_ascii=False)
    try:
        text.encode()
    except UnicodeEncodeError:
        case_id, flight = order.group.cases[0]
        raise BadInputError(
            f"case {case_id}: a name with bytes that are no UTF-8 cannot be sent to a Dask cluster: aircraft "
            f"{str(flight.aircraft)!r}, script {str(flight.script)!r}; rename it, or fly without --dask"
        ) from None
    return text


def order_from(text: str) -> Order:
    """The order that `order_text` wrote. Raises BadInputError for any other text."""
    return _read(Order, text, "order")


def answer_text(answer: Answer) -> str:
    """The answer as JSON."""
    return (
        json.dumps(answer, default=_plain, ensure_ascii=False).encode("utf-8", "replace").decode()
    )


def answer_from(text: Any, case_ids: tuple[str, ...]) -> list[CaseOutcome]:
    """Outcomes of the cases asked for. Raises BadInputError where the worker refused them, or for any other text."""
    answer = _read(Answer, text, "answer")
    if answer.outcomes is None:
        raise BadInputError(
            answer.refused or "a Dask worker gave neither an outcome nor a reason; look at its log"
        )
    if len(answer.outcomes) != len(case_ids):
        raise BadInputError(
            f"a Dask worker answered with {len(answer.outcomes)} flights; asked for were {len(case_ids)}"
        )
    for outcome, case_id in zip(answer.outcomes, case_ids, strict=True):
        if outcome.case_id != case_id or outcome.status not in STATUSES:
            raise BadInputError(
                f"a Dask worker answered for case {outcome.case_id!r} with the status {outcome.status!r}; asked for was "
                f"case {case_id!r} with one of {', '.join(STATUSES)}: every machine needs the same version of uqharness"
            )
    return list(answer.outcomes)


def flight_name(fly: FlightFunction | GroupFunction) -> str:
    """The name by which a worker finds a flight function. Raises BadInputError for what is not a function of a module."""
    name = f"{getattr(fly, '__module__', '')}:{getattr(fly, '__qualname__', '')}"
    try:
        found = _function(name)
    except BadInputError:
        found = None
    if found is not fly:
        raise BadInputError(
            f"a Dask cluster flies with a function that its module holds by name, and not with {fly!r}; fly this campaign without "
            "--dask"
        )
    return name


def group_function(order: Order) -> GroupFunction:
    """What flies an order's group. Raises BadInputError as `flight_function` does."""
    found = flight_function(order.fly)
    return found if order.together else OneByOne(found)


def flight_function(name: str) -> Any:
    """The function of that name, if this machine flies with it: the program's own, or one of a module that its operator named.

    Nothing else is imported, for importing a module runs it. Raises BadInputError.
    """
    allowed = {module.strip() for module in os.environ.get(MODULES_VARIABLE, "").split(",")}
    if name not in (OWN_FLIGHT, OWN_GROUP) and name.partition(":")[0] not in allowed - {""}:
        raise BadInputError(
            f"this worker flies with {OWN_FLIGHT} alone, and not with {name!r}; whoever trusts that module starts the worker with "
            f"the environment variable {MODULES_VARIABLE}={name.partition(':')[0]}"
        )
    return _function(name)


def _function(name: str) -> Any:
    module, _, qualname = name.partition(":")
    try:
        found = vars(importlib.import_module(module)).get(qualname)
    except (ImportError, ValueError) as error:
        raise BadInputError(
            f"the module of the flight function {name!r} cannot be imported: {error}"
        ) from None
    if not isinstance(found, types.FunctionType):
        raise BadInputError(f"there is no flight function {name!r}")
    return found


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _read(kind: Callable[..., T], text: Any, what: str) -> T:
    try:
        found: T = _adapter(kind).validate_json(text, strict=True)
        return found
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = dotted(first["loc"]) or "the whole"
        raise BadInputError(
            f"malformed {what} on the Dask cluster: {place}: {first['msg']}; every machine needs the same version of uqharness"
        ) from None


def _plain(value: Any) -> Any:
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
