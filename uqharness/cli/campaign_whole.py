"""``uqharness campaign verify | salvage``: is a folder as it was written, and how it becomes so again."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqharness.cli.verb_parser import add_verb, asked_campaign

if TYPE_CHECKING:
    from uqharness.campaign.folder.salvage import Salvaged
    from uqharness.campaign.folder.verify import Verified

_VERIFY_EXAMPLE = """example:
  uqharness campaign verify campaigns/demo/results

Holds manifest, journal and tables, those of shards too, against the digests they were written with. Changes nothing.
Exit codes: 0 all whole, 1 something is damaged or has no digests (made by uqharness 0.1), 2 not a campaign folder."""
_SALVAGE_EXAMPLE = """examples:
  uqharness campaign salvage campaigns/demo/results
  uqharness campaign salvage results --campaign campaigns/demo/campaign.toml      where manifest.json is damaged too

Keeps every flight that fits its digest, gives damaged files another name (journal.damaged-1.sqlite), flies the rest again and
writes the tables: the bytes of an undamaged run. Nothing is deleted; after a stop the same command goes on.
Exit codes: 0 done, 1 flights of shards that were never flown are missing, 2 bad input, 130 interrupted."""


def register(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verbs to those of ``campaign``."""
    verify = add_verb(verbs, "verify", "is everything as it was written", _VERIFY_EXAMPLE)
    verify.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    verify.set_defaults(handler=_verify)
    salvage = add_verb(verbs, "salvage", "keep what is sound of a damaged campaign and fly the rest again", _SALVAGE_EXAMPLE)
    salvage.add_argument("folder", type=Path, metavar="DIR", help="campaign folder, or that of a shard")
    salvage.add_argument(
        "--campaign", type=Path, metavar="CAMPAIGN.toml", help="what was flown, where manifest.json is damaged or gone"
    )
    salvage.add_argument("--hours", type=float, metavar="H", help="with --campaign: as it was flown with")
    salvage.add_argument("--samples", type=int, metavar="N", help="with --campaign: as it was flown with")
    salvage.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    salvage.add_argument("--yes", action="store_true", help="fly even if it takes more than a day of this machine")
    salvage.set_defaults(handler=_salvage)


def _verify(args: argparse.Namespace) -> int:
    from uqharness.campaign.folder.verify import verify

    found = verify(args.folder)
    print(json.dumps(_verified_json(found)) if args.json else "\n".join(_verified_lines(found)))
    return 0 if found.whole else 1


def _verified_json(found: Verified) -> dict[str, Any]:
    items = [{"name": item.name, "state": item.state, "remark": item.remark, "digest": item.digest or None} for item in found.items]
    document: dict[str, Any] = {
        "folder": str(found.folder),
        "whole": found.whole,
        "complete": found.complete,
        "items": items,
    }
    return document | {"shards": [_verified_json(part) for part in found.shards]}


def _verified_lines(found: Verified) -> Iterator[str]:
    state = "whole" if found.whole else "NOT whole"
    running = "" if found.complete in (True, None) else "; the campaign is not complete, what is there was looked at"
    yield f"{found.folder}: {state}{running}"
    for item in found.items:
        said = "; ".join(text for text in (item.remark, item.digest and f"SHA-256 {item.digest}") if text)
        yield f"  {item.name}: {item.state}" + (f" ({said})" if said else "")
    for part in found.shards:
        yield from _verified_lines(part)


def _salvage(args: argparse.Namespace) -> int:
    from uqharness.campaign.cost import Cost, refuse_if_long
    from uqharness.campaign.execution.processes import ProcessExecutor, usable_cores
    from uqharness.campaign.folder.salvage import Flying, salvage
    from uqharness.cli.progress import ProgressView
    from uqharness.errors import BadInputError

    if args.campaign is None and (args.hours is not None or args.samples is not None):
        raise BadInputError("--hours and --samples belong to --campaign, the file they were given with")
    spec = None if args.campaign is None else asked_campaign(args)
    command = ["uqharness", "campaign", "run", str(args.campaign), "--out", str(args.folder)]
    command += [] if args.hours is None else ["--hours", f"{args.hours:g}"]
    command += [] if args.samples is None else ["--samples", str(args.samples)]

    def told(cost: Cost) -> None:
        refuse_if_long(cost, args.yes, args.folder)
        print(f"{args.folder}: {cost.words}", file=sys.stderr)

    with ProgressView() as view:
        executor = ProcessExecutor(usable_cores() if args.workers is None else args.workers)
        flying = Flying(executor, told, view.update)
        found = salvage(args.folder, flying, spec, "" if spec is None else shlex.join(command))
    print(json.dumps(_salvaged_json(found)) if args.json else "\n".join(_salvaged_lines(found)))
    return 1 if found.missing else 0


def _salvaged_json(found: Salvaged) -> dict[str, Any]:
    document: dict[str, Any] = {
        "folder": str(found.folder),
        "kept": found.kept,
        "flown": found.flown,
        "missing": found.missing,
    }
    document |= {"statuses": dict(found.statuses), "rewritten": list(found.rewritten), "aside": list(found.aside)}
    return document | {"shards": [_salvaged_json(part) for part in found.parts]}


def _salvaged_lines(found: Salvaged) -> Iterator[str]:
    for part in found.parts:
        yield from _salvaged_lines(part)
    text = f"{found.folder}: {found.kept} flights kept, {found.flown} flown again"
    text += f", {found.missing} are in no shard" if found.missing else ""
    text += f"; written again: {', '.join(found.rewritten)}" if found.rewritten else ""
    yield text + (f"; damaged, under another name: {', '.join(found.aside)}" if found.aside else "")
    for name, command in (
        ("sensitivity", "sensitivity"),
        ("convergence", "campaign convergence"),
        ("area", "campaign area"),
    ):
        if any(item.startswith(f"{name}.damaged-") for item in found.aside):
            yield f"  {name}.csv is written again by: uqharness {command} {shlex.quote(str(found.folder))}"
