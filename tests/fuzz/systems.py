"""Random systems, each flown by JSBSim and by the batch engine: functions, tables, components,
numbers of any size.

    python -m tests.fuzz.systems --systems 1300 [--seed 0]

A system follows from its seed. JSBSim flies it in a child process, twice: as it is, and with inputs
moved by one unit in the last place. Outcomes: agreed; rounding (no further from JSBSim than
rounding takes JSBSim from itself); refused, with a reason; dead (JSBSim ends the process, or
refuses the model); differs. Exit code: 1 if one differs."""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import os
import sys
from collections import Counter
from collections.abc import Sequence
from multiprocessing.connection import Connection

import numpy as np

from tests.helpers import batch_oracle as oracle
from tests.helpers import batch_systems as systems
from uqharness.batch.translate.channels import System
from uqharness.batch.translate.frame import OUT_OF_RANGE
from uqharness.batch.translate.functions import ROTATIONS, RULES
from uqharness.errors import BadInputError

AGREED, ROUNDING, REFUSED, DEAD, DIFFERS = "agreed", "rounding", "refused", "dead", "differs"
OUTCOMES = (AGREED, ROUNDING, REFUSED, DEAD, DIFFERS)
FRAMES = 400
_INPUTS = ("i/a", "i/b", "i/c")
_EXTREME = (0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 1e-300, 1e15, -1e15, 1e19, 1e300, -1e300, 2147483648.0)
_TIMES_ROUNDING = 1e5
_LEAST = 1e-9
"""Difference over size that the engine's functions, right to some units in the last place, may make
without a recursion.
"""
_OPERATIONS = tuple(name for name in RULES if name not in ROTATIONS)


class _Maker:
    """Writes one random system."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.readable = list(_INPUTS)

    def system(self) -> str:
        """The body of a ``<system>``."""
        parts = []
        for number in range(int(self.rng.integers(1, 5))):
            name = f"f/n{number}"
            parts.append(
                f'<function name="{name}">{self.tree(int(self.rng.integers(1, 4)))}</function>'
            )
            self.readable.append(name)
        components = [self.component(k) for k in range(int(self.rng.integers(0, 4)))]
        channel = "".join(components)
        return "".join(parts) + (f'<channel name="c">{channel}</channel>' if channel else "")

    def number(self) -> str:
        if self.rng.random() < 0.2:
            return repr(float(self.rng.choice(_EXTREME)))
        return repr(float(np.round(self.rng.normal() * 10.0 ** self.rng.integers(-1, 3), 3)))

    def name(self) -> str:
        return str(self.rng.choice(self.readable))

    def tree(self, depth: int) -> str:
        draw = self.rng.random()
        if depth == 0 or draw < 0.1:
            return f"<v>{self.number()}</v>" if self.rng.random() < 0.3 else f"<p>{self.name()}</p>"
        if draw < 0.25:
            return self.table()
        tag = str(self.rng.choice(_OPERATIONS))
        rule = RULES[tag]
        count = (
            rule.min_arguments
            if rule.max_arguments == rule.min_arguments
            else rule.min_arguments + int(self.rng.integers(0, 3))
        )
        count = count if rule.max_arguments is None else min(count, rule.max_arguments)
        if tag == "interpolate1d":
            count = 5 + 2 * int(self.rng.integers(0, 3))
        condition = tag in ("and", "or", "not", "ifthen")
        arguments = [
            self.condition() if condition and (tag != "ifthen" or k == 0) else self.tree(depth - 1)
            for k in range(count)
        ]
        return f"<{tag}>{''.join(arguments)}</{tag}>"

    def condition(self) -> str:
        tag = self.rng.choice(("lt", "le", "gt", "ge", "eq", "nq"))
        return f"<{tag}><p>{self.name()}</p>{self.tree(0)}</{tag}>"

    def table(self) -> str:
        sizes = [int(self.rng.integers(1, 5)) for _ in range(int(self.rng.integers(1, 4)))]
        if len(sizes) == 3:
            sizes[2] = max(sizes[2], 2)
        points = [np.sort(np.round(self.rng.normal(size=n) * 2.0, 3)).tolist() for n in sizes]
        heads = "".join(
            f'<independentVar lookup="{axis}">{self.name()}</independentVar>'
            for axis, _ in zip(("row", "column", "table"), sizes, strict=False)
        )
        if len(sizes) < 3:
            return f"<table>{heads}<tableData>\n{self.grid(points)}</tableData></table>"
        grids = "".join(
            f'<tableData breakPoint="{at!r}">\n{self.grid(points[:2])}</tableData>'
            for at in points[2]
        )
        return f"<table>{heads}{grids}</table>"

    def grid(self, points: Sequence[Sequence[float]]) -> str:
        columns = points[1] if len(points) > 1 else []
        lines = [" ".join(map(repr, columns))] if columns else []
        for at in points[0]:
            values = [float(x) for x in np.round(self.rng.normal(size=max(len(columns), 1)), 3)]
            lines.append(" ".join(map(repr, [at, *values])))
        return "\n".join(lines) + "\n"

    def component(self, number: int) -> str:
        out, source = f"c/n{number}", f"<input>{self.name()}</input>"
        gain, low = self.number(), round(float(self.rng.normal()), 2)
        rate = round(float(self.rng.uniform(0.1, 40.0)), 2)
        clip = f"<clipto><min>{low}</min><max>{low + rate}</max></clipto>" if rate > 20 else ""
        bodies = {
            "pure_gain": f"{source}<gain>{gain}</gain>{clip}",
            "summer": f"{source}<input>-{self.name()}</input><bias>{gain}</bias>{clip}",
            "lag_filter": f"{source}<c1>{rate}</c1>{clip}",
            "lead_lag_filter": f"{source}<c1>1</c1><c2>{rate}</c2><c3>2</c3><c4>{rate}</c4>{clip}",
            "washout_filter": f"{source}<c1>{rate}</c1>{clip}",
            "integrator": f"{source}<c1>{rate}</c1>{clip}",
            "deadband": f"{source}<width>{rate}</width>{clip}",
            "switch": f'<default value="{gain}"/><test logic="AND" value="{self.name()}">'
            f"{self.name()} gt {low}</test>",
            "fcs_function": f"<function>{self.tree(2)}</function>{clip}",
            "actuator": f"{source}<lag>{rate}</lag><rate_limit>{rate}</rate_limit>"
            f"<clipto><min>-{rate}</min><max>{rate}</max></clipto>",
            "sensor": f"{source}<lag>{rate}</lag><bias>{low}</bias>",
            "pid": f"{source}<kp>{low}</kp><ki>{rate}</ki><kd>0.1</kd>{clip}",
        }
        kind = str(self.rng.choice(list(bodies)))
        self.readable.append(out)
        return f'<{kind} name="{out}">{bodies[kind]}<output>{out}</output></{kind}>'

    def inputs(self) -> dict[str, np.ndarray]:
        """Noise, with a number of any size in some systems now and then."""
        series = {}
        for name in _INPUTS:
            values = self.rng.normal(size=FRAMES) * 10.0 ** self.rng.integers(-1, 2)
            if self.rng.random() < 0.4:
                values[self.rng.integers(0, FRAMES, 4)] = self.rng.choice(_EXTREME, 4)
            series[name] = values
        return series


def build(seed: int) -> tuple[str, dict[str, np.ndarray]]:
    """The body of a system and its inputs."""
    maker = _Maker(seed)
    return maker.system(), maker.inputs()


def attempt(seed: int) -> tuple[str, str]:
    """Outcome and reason of one system."""
    body, inputs = build(seed)
    return judge(body, inputs)


def judge(body: str, inputs: dict[str, np.ndarray]) -> tuple[str, str]:
    """Outcome and reason of a system's two flights."""
    text = systems.declared(list(inputs)) + body
    theirs = by_jsbsim(text, inputs)
    if isinstance(theirs, str):
        return DEAD, theirs
    first, records, flight, moved = theirs
    document = systems.document_of(text)
    values = systems.Values(first.get)
    try:
        frames = systems.traced([System(document, document.root)], values, list(inputs))
        for name in (*records, OUT_OF_RANGE):
            values.setdefault(name)
        ours = systems.run(frames, inputs, [*records, OUT_OF_RANGE])
    except BadInputError as error:
        return REFUSED, str(error)
    if np.any(ours.pop(OUT_OF_RANGE) != 0.0):
        return REFUSED, "an argument beyond the engine's range, in flight"
    outcome, reason = AGREED, ""
    for name in records:
        a, b, c = ours[name], flight[name], moved[name]
        same = (a == b) | (np.isnan(a) & np.isnan(b))
        with np.errstate(all="ignore"):
            close = np.abs(a - b) <= _LEAST * np.maximum(np.abs(b), 1e-300)
            drift = np.maximum.accumulate(np.nan_to_num(np.abs(c - b), nan=np.inf))
            excused = np.abs(a - b) <= _TIMES_ROUNDING * drift
            excused |= drift == np.inf
        if np.all(same | close):
            continue
        if np.all(same | close | excused):
            outcome = ROUNDING
            continue
        row = int(np.argmin(same | close | excused))
        return DIFFERS, f"{name} frame {row}: {a[row]!r}, in JSBSim {b[row]!r} (moved {c[row]!r})"
    return outcome, reason


def by_jsbsim(text: str, inputs: dict[str, np.ndarray]):
    """First values, records and two flights of JSBSim in a child; why there are none, as text."""
    local, present = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(
        target=_child, args=(present, text, inputs)
    )
    process.start()
    present.close()
    try:
        answer = local.recv() if local.poll(60.0) else "no answer in 60 s"
    except EOFError:
        answer = None
    process.join(1.0)
    if process.is_alive():
        process.kill()
        process.join()
    return f"the process ends with {process.exitcode}" if answer is None else answer


def _child(out: Connection, text: str, inputs: dict[str, np.ndarray]) -> None:
    faulthandler.disable()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        fdm = oracle.loaded(oracle.model(text), systems.DT_S)
        for name, series in inputs.items():
            fdm[name] = float(series[0])
        document = systems.document_of(text)
        reference = systems.values_of(fdm)
        frames = systems.traced([System(document, document.root)], reference, list(inputs))
        records = sorted(set(frames[2].writes) - set(inputs))
        for name in records:
            reference.setdefault(name)
        first = dict(reference)
        flight = systems.by_jsbsim(fdm, inputs, records)
        moved = {name: np.nextafter(series, np.inf) for name, series in inputs.items()}
        repeat = oracle.loaded(oracle.model(text), systems.DT_S)
        for name, series in moved.items():
            repeat[name] = float(series[0])
        out.send((first, records, flight, systems.by_jsbsim(repeat, moved, records)))
    except BadInputError as error:
        out.send(f"refused: {error}")
    except Exception as error:  # whatever JSBSim raises
        out.send(f"JSBSim: {type(error).__name__}: {str(error)[:200]}")


def main(argv: list[str] | None = None) -> int:
    """Try systems; 1 if one differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--systems", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    inputs = parser.parse_args(argv)
    counts: Counter[str] = Counter()
    for seed in range(inputs.seed, inputs.seed + inputs.systems):
        outcome, reason = attempt(seed)
        # What the translation refuses is refused in the child already.
        if outcome == DEAD and reason.startswith("refused: "):
            outcome, reason = REFUSED, reason.removeprefix("refused: ")
        counts[outcome] += 1
        if outcome in (DIFFERS, DEAD):
            print(f"{seed}: {outcome}: {reason}", file=sys.stderr, flush=True)
    print(", ".join(f"{counts[name]} {name}" for name in OUTCOMES))
    return int(counts[DIFFERS] > 0)


if __name__ == "__main__":
    sys.exit(main())
