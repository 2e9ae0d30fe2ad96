"""Flights on order: cases of the battery by id, or one known effect at a given strength.

python -m tests.hidden_effects.make --list                                       ids and kinds, no
truths
python -m tests.hidden_effects.make --case ID... --out DIR
DIR/ID/flight-1.parquet ... (1 to 3 train, 4 test)
python -m tests.hidden_effects.make --effect "Cm:p_hat^2" --t 20 --out DIR       a known one, for
development
python -m tests.hidden_effects.make --null --out DIR                             none
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.airframes import aircraft_folder
from tests.hidden_effects.cases import LIGHT_KT, SECOND, Case, battery, cards, write
from tests.hidden_effects.catalogue import ENTRIES


def known(
    keys: list[str],
    t: float,
    seed: int,
    air: str,
    rate_hz: float,
    positions: bool,
    size: float | None,
) -> Case:
    """A case of one's own making: hidden effects by key."""
    entries = [ENTRIES[k] for k in keys]
    flown = next((e.flown for e in entries if e.flown != "mixed"), "mixed")
    four = cards(
        f"made {seed}",
        flown,
        LIGHT_KT if air == "light" else 0.0,
        rate_hz=rate_hz,
        positions=positions,
    )
    effects = tuple(e.effect(t) for e in entries)
    if size is not None:
        effects = tuple(replace(e, size=size) for e in effects)
    return Case(
        f"made {keys} {t} {seed} {air}",
        "known",
        air,
        tuple(keys),
        effects,
        four[:3],
        four[3:],
        Airframe(),
    )


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--case", nargs="+", default=[], metavar="ID")
    parser.add_argument(
        "--effect", nargs="+", default=[], metavar="KEY", help="known are: " + ", ".join(ENTRIES)
    )
    parser.add_argument("--null", action="store_true")
    parser.add_argument("--t", type=float, default=20.0, help="|t| aimed at (default %(default)s)")
    parser.add_argument("--size", type=float, help="size in the term's own unit instead of --t")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--air", choices=("calm", "light"), default="calm")
    parser.add_argument("--rate-hz", type=float, default=50.0)
    parser.add_argument("--positions", action="store_true", help="record the surfaces' positions")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(argv)
    every = {c.id: c for c in battery()}
    if given.list:
        print("\n".join(sorted(every)))
        return
    if given.out is None:
        parser.error("--out DIR is needed")
    cases = [every[i] for i in given.case]
    if given.effect or given.null:
        cases.append(
            known(
                given.effect,
                given.t,
                given.seed,
                given.air,
                given.rate_hz,
                given.positions,
                given.size,
            )
        )
        print(
            "hidden:",
            *(f"{e.key} = {e.size:.4g}" for e in cases[-1].effects)
            if cases[-1].effects
            else ["nothing"],
        )
    given.out.mkdir(parents=True, exist_ok=True)
    if lost := write(cases, given.out):
        raise SystemExit(
            f"{', '.join(sorted(lost))}: a flight comes to grief; choose a smaller effect"
        )
    for case in cases:
        files = case.files(given.out)
        aircraft = (
            "espaaro"
            if case.aircraft == "espaaro"
            else str(aircraft_folder(case.aircraft, SECOND, given.out))
        )
        train, test = (" ".join(map(str, files[which])) for which in ("train", "test"))
        print(f"uqharness refine {aircraft} --train {train} --test {test} --out ...")


if __name__ == "__main__":
    main()
