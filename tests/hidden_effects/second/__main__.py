"""Asks `uqharness refine` a draw of the second generation's examination and marks the answers.

    python -m tests.hidden_effects.second --draw N --out DIR             a draw (1, 2 or 3), each
    met once; goes on after a stop
    python -m tests.hidden_effects.second --draw N --out DIR --again     the same cases for later
    code, kept apart
    python -m tests.hidden_effects.second --development --out DIR        the development draw, never
    counted

Flights, aircraft and answers stand in DIR, the draws' table in tests/hidden_effects/second/met.csv,
development's in DIR/met.csv. Exit code 0: every mark is reached by the lines first met (with
--again: by the later ones); 1: not; 2: bad input."""

from __future__ import annotations

import argparse
import json
import math
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from tests.hidden_effects import sealed
from tests.hidden_effects.cases import write
from tests.hidden_effects.second import table
from tests.hidden_effects.second.drawn import DEVELOPMENT, SEEDS, Question, slots
from tests.hidden_effects.second.folders import folder_of
from tests.hidden_effects.second.marks import marks
from tests.hidden_effects.second.verdict import judge
from tests.hidden_effects.second.weighing import question

TIMEOUT_S = 3600.0


def ask(asked: Question, folder: Path, place: Path) -> dict[str, Any]:
    """Run refine on a question, then compare with the model it wrote: found, exit, error, cpu_s,
    peak_MB, apart.
    """
    files = asked.files(folder / "flights")
    aircraft = folder_of(asked, folder / "aircraft")
    out = folder / "refined" / asked.id
    shutil.rmtree(out, ignore_errors=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    train, test = (list(map(str, files[which])) for which in ("train", "test"))
    given = [
        "refine",
        str(aircraft),
        "--train",
        *train,
        "--test",
        *test,
        "--no-pbox",
        "--no-figures",
        "--workers",
        "1",
    ]
    done = sealed.run_measured(
        place, ["-m", "uqharness.cli.main", *given, "--out", str(out)], TIMEOUT_S
    )
    path = out / "refinement.json"
    good = done.returncode in (0, 1) and path.is_file()
    found = json.loads(path.read_text(encoding="utf-8")) if good else {}
    error = (
        ""
        if good
        else (
            done.stderr.strip().splitlines()
            or [f"exit code {done.returncode} without refinement.json"]
        )[-1]
    )
    apart = (
        compared(found, out / "aircraft" / asked.aircraft, test[0], out / "compare", place)
        if good
        else None
    )
    return {
        "found": found,
        "exit": done.returncode,
        "error": error,
        "cpu_s": done.cpu_s,
        "peak_MB": done.peak_MB,
        "apart": apart,
    }


def compared(
    found: Mapping[str, Any], model: Path, flight: str, out: Path, place: Path
) -> float | None:
    """Largest relative difference of rms over noise, channel by channel, between refine's table of
    the test flight and `compare`.

    None where the two answer different questions: a fault of sensor or clock is no part of the
    model that was written."""
    if any(str(e.get("subsystem", "")).startswith("sensor.") for e in found.get("effects") or []):
        return None
    if (found.get("timing") or {}).get("controls_late_s"):
        return None
    given = [
        "compare",
        str(model),
        "--flight",
        flight,
        "--out",
        str(out),
        "--no-figures",
        "--workers",
        "1",
    ]
    sealed.run_measured(place, ["-m", "uqharness.cli.main", *given], TIMEOUT_S)
    path = out / "compare.json"
    return (
        apart_of(found, json.loads(path.read_text(encoding="utf-8")))
        if path.is_file()
        else math.inf
    )


def apart_of(found: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Largest relative difference of rms over noise between a refinement.json's table of test
    flights and a compare.json.
    """
    own = ((found.get("gap") or {}).get("test") or {}).get("channels") or {}
    ratios = {c: row["ratio"] for c, row in other["channels"].items() if row.get("judged")}
    both = [(own[c]["rms_after"] / own[c]["noise_rms"], r) for c, r in ratios.items() if c in own]
    return max((abs(a / b - 1.0) for a, b in both), default=math.inf)


def todo(
    lines: Sequence[Mapping[str, str]], draw: int, numbers: Sequence[int], commit: str, again: bool
) -> list[int]:
    """Numbers still to be asked: those never met; with ``again`` those that were met, but not by
    this commit.
    """
    first = {int(r["number"]) for r in lines if int(r["draw"]) == draw and r["met"] == table.FIRST}
    now = {int(r["number"]) for r in lines if int(r["draw"]) == draw and r["commit"] == commit}
    return [n for n in numbers if (n in first and n not in now if again else n not in first)]


def answers(
    numbers: Sequence[int],
    made: Callable[[int], Question | None],
    ask: Callable[[Question], dict[str, Any]],
    workers: int = 1,
) -> Iterator[tuple[Question, dict[str, Any]]]:
    """Questions with their answers as they come, ``workers`` asked side by side; none where
    ``made`` gives none. A stop ends those that are being answered, and they are not told."""
    with ThreadPoolExecutor(workers) as pool:
        pending: dict[Future[dict[str, Any]], Question] = {}
        try:
            for number in [*numbers, None]:
                while pending and (number is None or len(pending) == workers):
                    for done in wait(pending, return_when=FIRST_COMPLETED).done:
                        yield pending.pop(done), done.result()
                asked = None if number is None else made(number)
                if asked is not None:
                    pending[pool.submit(ask, asked)] = asked
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            # One that was about to begin may begin now.
            while not all(one.done() for one in pending):
                sealed.stop()
                wait(pending, timeout=0.1)
            raise


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--draw", type=int, choices=sorted(SEEDS))
    which.add_argument("--development", action="store_true", help="the development draw")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for flights, aircraft and answers"
    )
    parser.add_argument("--again", action="store_true", help="ask what was met before again")
    parser.add_argument(
        "--numbers", type=int, nargs="+", metavar="N", help="of the development draw, these alone"
    )
    parser.add_argument(
        "--seconds", type=float, help="of the development draw, length of a flight (default 90)"
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="cases answered side by side (default 1)"
    )
    parser.add_argument(
        "--keep", action="store_true", help="keep all that refine wrote, not refinement.json alone"
    )
    given = parser.parse_args(argv)
    draw = DEVELOPMENT if given.development else given.draw
    if draw != DEVELOPMENT and (given.numbers or given.seconds):
        parser.error("--numbers and --seconds are for --development: a draw is met whole")
    commit, changed = table.code_of()
    if changed and draw != DEVELOPMENT:
        print(
            "sysid, uqharness, aircraft, scripts or the examination differ from the commit: commit"
            " them first",
            file=sys.stderr,
        )
        return 2
    commit += "+" if changed else ""
    folder = given.out.resolve()
    path = folder / "met.csv" if draw == DEVELOPMENT else table.PATH
    secret = folder / "questions"
    secret.mkdir(parents=True, exist_ok=True)
    place = sealed.seal(folder / "sealed", [secret, path])
    numbers = given.numbers or range(len(slots(draw)))

    def made(number: int) -> Question | None:
        never = secret / f"{draw}-{number}.never"
        try:
            if never.is_file():
                raise RuntimeError(never.read_text(encoding="utf-8"))
            asked = question(draw, number, secret, given.seconds)
        except RuntimeError as error:
            # No attempt is as strong as the case's kind asks: it is left out, which is told.
            never.write_text(str(error), encoding="utf-8")
            print(f"{number}: left out: {error}", file=sys.stderr, flush=True)
            return None
        if write([asked], folder / "flights"):
            raise SystemExit(f"draw {draw}, case {number}: a flight comes to grief")
        return asked

    still = todo(table.read(path), draw, numbers, commit, given.again)
    for asked, got in answers(still, made, lambda asked: ask(asked, folder, place), given.workers):
        verdict = judge(asked, got["found"], got["exit"])
        line = table.line_of(
            asked, verdict, got, commit, table.LATER if given.again else table.FIRST
        )
        table.add(path, line)
        if not given.keep:
            _clear(folder / "refined" / asked.id)
        print(
            f"{asked.number}: {line['kind']} {line['air']} {line['truth']} {line['wrong']} ->"
            f" {line['verdict']} {line['answer']} ({got['cpu_s']:.0f} s) {got['error']}",
            file=sys.stderr,
            flush=True,
        )
    rows = table.of_draw(table.read(path), draw, table.LATER if given.again else table.FIRST)
    reached, text = marks(rows, whole=draw != DEVELOPMENT)
    print(text)
    return 0 if reached else 1


def _clear(folder: Path) -> None:
    for path in list(folder.iterdir()) if folder.is_dir() else []:
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name != "refinement.json":
            path.unlink()


if __name__ == "__main__":
    # Whoever ends this process ends refine with it: the exit is an exception, at which the child's
    # group is killed.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(130))
    sys.exit(main())
