"""``uqharness campaign verify | salvage``: is a folder as it was written, and how it becomes so again."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uqharness.campaign.execution import ProcessExecutor
from uqharness.campaign.folder import Flying, Salvaged, Verified
from uqharness.campaign.folder.salvage import salvage
from uqharness.campaign.folder.verify import verify
from uqharness.cli.campaign.folder import add_folder
from uqharness.cli.campaign.run import add_size, add_yes, asked_campaign, flying_command, tell_cost
from uqharness.cli.options import add_workers, describe
from uqharness.cli.progress import ProgressView
from uqharness.errors import BadInputError
from uqharness.parallel import usable_cores

_VERIFY_EXAMPLE = """
  uqharness campaign verify campaigns/demo/results

Compares manifest, journal and tables, also of shards, with their stored digests. Changes nothing."""
_SALVAGE_EXAMPLE = """
  uqharness campaign salvage campaigns/demo/results
  uqharness campaign salvage results --campaign campaigns/demo/campaign.toml      where manifest.json is damaged too

Keeps every flight that fits its digest, gives damaged files another name (journal.damaged-1.sqlite), flies the rest again and
writes the tables: the bytes of an undamaged run. Nothing is deleted; the same command resumes after an interruption.
Give --hours and --samples with --campaign if the campaign was flown with them."""
_REMADE = {
    "sensitivity": "sensitivity",
    "convergence": "campaign convergence",
    "area": "campaign area",
}
"""Tables that other commands write: the command by the table's name."""


def add_verify(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``verify``."""
    no = "something is damaged or has no digests (made by uqharness 0.1)"
    describe(
        parser,
        _verify,
        "Check a folder against its digests.",
        _VERIFY_EXAMPLE,
        done="all whole",
        no=no,
    )
    add_folder(parser)


def add_salvage(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``salvage``."""
    text, no = (
        "Repair a damaged campaign: keep sound flights, fly the rest again.",
        "flights of shards that were never flown are missing",
    )
    describe(parser, _salvage, text, _SALVAGE_EXAMPLE, no=no)
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="campaign folder, or that of a shard"
    )
    parser.add_argument(
        "--campaign",
        type=Path,
        metavar="CAMPAIGN.toml",
        help="the campaign file, where manifest.json is damaged or missing",
    )
    add_size(parser)
    add_workers(parser)
    add_yes(parser)


def _verify(args: argparse.Namespace) -> int:
    found = verify(args.folder)
    print(json.dumps(_verified_json(found)) if args.json else "\n".join(_verified_lines(found)))
    return 0 if found.whole else 1


def _verified_json(found: Verified) -> dict[str, Any]:
    items = [
        {
            "name": item.name,
            "state": item.state,
            "remark": item.remark,
            "digest": item.digest or None,
        }
        for item in found.items
    ]
    document: dict[str, Any] = {
        "folder": str(found.folder),
        "whole": found.whole,
        "complete": found.complete,
        "items": items,
    }
    return document | {"shards": [_verified_json(part) for part in found.shards]}


def _verified_lines(found: Verified) -> Iterator[str]:
    state = "whole" if found.whole else "NOT whole"
    running = (
        ""
        if found.complete in (True, None)
        else "; the campaign is not complete; existing files were checked"
    )
    yield f"{found.folder}: {state}{running}"
    for item in found.items:
        said = "; ".join(
            text for text in (item.remark, item.digest and f"SHA-256 {item.digest}") if text
        )
        yield f"  {item.name}: {item.state}" + (f" ({said})" if said else "")
    for part in found.shards:
        yield from _verified_lines(part)


def _salvage(args: argparse.Namespace) -> int:
    if args.campaign is None and (args.hours is not None or args.samples is not None):
        raise BadInputError(
            "--hours and --samples belong to --campaign, the file they were given with"
        )
    spec = None if args.campaign is None else asked_campaign(args)
    command = "" if spec is None else shlex.join(flying_command(args, args.folder))
    with ProgressView() as view:
        flying = Flying(
            ProcessExecutor(args.workers or usable_cores()),
            tell_cost(args.yes, args.folder),
            view.update,
        )
        found = salvage(args.folder, flying, spec, command)
    print(json.dumps(_salvaged_json(found)) if args.json else "\n".join(_salvaged_lines(found)))
    return 1 if found.missing else 0


def _salvaged_json(found: Salvaged) -> dict[str, Any]:
    document: dict[str, Any] = {
        "folder": str(found.folder),
        "kept": found.kept,
        "flown": found.flown,
        "missing": found.missing,
    }
    document |= {
        "statuses": dict(found.statuses),
        "rewritten": list(found.rewritten),
        "aside": list(found.aside),
    }
    return document | {"shards": [_salvaged_json(part) for part in found.parts]}


def _salvaged_lines(found: Salvaged) -> Iterator[str]:
    for part in found.parts:
        yield from _salvaged_lines(part)
    text = f"{found.folder}: {found.kept} flights kept, {found.flown} flown again"
    text += f", {found.missing} are in no shard" if found.missing else ""
    text += f"; written again: {', '.join(found.rewritten)}" if found.rewritten else ""
    yield text + (f"; damaged, under another name: {', '.join(found.aside)}" if found.aside else "")
    for name, command in _REMADE.items():
        if any(item.startswith(f"{name}.damaged-") for item in found.aside):
            yield f"  {name}.csv is written again by: uqharness {command} {shlex.quote(str(found.folder))}"
