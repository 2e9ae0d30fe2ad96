"""A campaign run that a test may kill, or that kills itself in the middle of a write.

python -m tests.helpers.torture FOLDER OUT FLIGHTS FAKE HOW [MOMENT]: HOW is fork, spawn or the
address of a Dask scheduler; MOMENT is journal:N (killed with the N-th batch half in the journal),
table:N (killed with the N-th file written and not yet in place) or step:N (killed before the N-th
change of a folder). FAKE is of campaign_fakes."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def tear(moment: str) -> None:
    """Arrange for this process to be killed at that moment."""
    kind, _, number = moment.partition(":")
    remaining = [int(number)]
    if kind == "journal":
        from uqharness.campaign.store import Store

        add = Store.add

        def torn(self: Any, outcomes: Any) -> None:
            batch = list(outcomes)
            remaining[0] -= bool(batch)
            if remaining[0] == 0:
                # A small cache spills, so that half a transaction is in the file when its writer
                # dies.
                self._database.execute("pragma cache_size = 1")
                self._database.execute("begin")
                rows = [
                    (item.case_id, item.status, item.reason, item.flown_s, "{}", "{}", "")
                    for item in batch
                ]
                rows += [
                    (f"torn-{index}", "ok", "x" * 1000, 1.0, "{}", "{}", "") for index in range(100)
                ]
                self._database.executemany(
                    "insert or replace into outcome values (?,?,?,?,?,?,?)", rows
                )
                _die()
            add(self, batch)

        Store.add = torn  # type: ignore[method-assign]
    elif kind == "step":

        def counted(function: Any) -> Any:
            def call(*inputs: Any, **listed: Any) -> Any:
                remaining[0] -= 1
                if remaining[0] == 0:
                    _die()
                return function(*inputs, **listed)

            return call

        for name in ("replace", "link", "unlink", "mkdir"):
            setattr(os, name, counted(getattr(os, name)))
    else:
        replace = os.replace

        def stopped(source: Any, target: Any) -> None:
            remaining[0] -= 1
            if remaining[0] == 0:
                _die()
            replace(source, target)

        os.replace = stopped  # type: ignore[assignment]


def main() -> None:
    from tests.helpers import campaign_fakes as fakes
    from uqharness.campaign.processes import Executor, ProcessExecutor
    from uqharness.campaign.run import run_campaign

    folder, out, flights, fake, options = sys.argv[1:6]
    if len(sys.argv) > 6:
        tear(sys.argv[6])
    executor: Executor
    if options in ("fork", "spawn"):
        executor = ProcessExecutor(2, options)
    else:
        from uqharness.campaign.dask import DaskExecutor

        executor = DaskExecutor(options)
    spec = fakes.small_spec(Path(folder), int(flights))
    run_campaign(spec, out, executor=executor, fly=getattr(fakes, fake))


if __name__ == "__main__":
    import tests.helpers.torture

    tests.helpers.torture.main()
