"""A whole refinement: flights in, refinement.json and a better aircraft out. Train flights choose, test flights show."""

from __future__ import annotations

import shlex
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.aero_terms import COEFFICIENTS
from sysid.disagreement import Disagreement, dependence, disagreements
from sysid.effect_choice import Alternative, Choice, Refusal
from sysid.effects import Effect
from uqharness import __version__
from uqharness.aircraft import Aircraft, content_hash, find_aircraft
from uqharness.flights import read_flights, renamed
from uqharness.refine import (
    Found,
    control_slopes,
    estimates_of,
    file_hash,
    find_effects,
    make_setup,
    refuse_shared,
    remark,
    setup_in_gusts,
)
from uqharness.refine_fit import Setup, positions, worker_map
from uqharness.refine_show import Shown, air_of, gap_document, show, state_ranges, whiteness, write_bytes_tree
from uqharness.refine_stages import FOLDER, Stages
from uqharness.refine_timing import later
from uqharness.refine_words import separating_manoeuvre, why
from uqharness.refine_xml import Written, carrier, in_dynamics, write_effects
from uqharness.replay import Segment
from uqharness.replay_model import CONTROLS

LIMIT = 1.15
"""As `compare` has it: a channel is at the noise floor when its rms is not above this many times its noise."""
COLOURED_P = 1e-7
Say = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What the command was asked."""

    aircraft: Aircraft
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    out: Path
    extra: tuple[Effect, ...] = ()
    manoeuvres: Path | None = None
    map_path: Path | None = None
    ideal_servos: bool = False
    workers: int | None = None
    command: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refinement:
    """The document, and what figures are drawn from."""

    document: dict[str, Any]
    found: Found
    train: tuple[Setup, Shown, Shown]
    test: tuple[Setup, Shown, Shown]
    disagreement: list[Disagreement]
    aircraft: Aircraft
    given: Aircraft


def refine(request: Request, say: Say = lambda _: None) -> Refinement:
    """Find, name, add and show. Raises BadInputError."""
    begun = time.perf_counter()
    aircraft = request.aircraft
    refuse_shared(request.train, request.test)
    say("reading the flights")
    flights, measured = read_flights(request.train, aircraft, request.manoeuvres, request.map_path)
    others, measured_test = read_flights(request.test, aircraft, request.manoeuvres, request.map_path)
    others = [replace(f, name=n) for f, n in zip(others, renamed([f.name for f in others]), strict=True)]
    ideal = tuple(c for c in CONTROLS if c not in measured) if request.ideal_servos else ()
    ideal_test = tuple(c for c in CONTROLS if c not in measured_test) if request.ideal_servos else ()
    setup = make_setup(aircraft, flights, measured, ideal)
    test = make_setup(aircraft, others, measured_test, ideal_test)
    names = [p.name for p in request.train]
    command = shlex.join(request.command)
    with worker_map(request.workers) as map_, tempfile.TemporaryDirectory(prefix="uqharness-") as temporary:
        work = Path(temporary)
        stages = Stages(request.out / FOLDER, _identity(request))
        found = stages(
            "effects",
            lambda: find_effects(aircraft, setup, measured, ideal, request.extra, work, map_, say, stages),
        )
        if found.late_s:
            setup = make_setup(aircraft, later(flights, found.late_s), measured, ideal)
            test = make_setup(aircraft, later(others, found.late_s), measured_test, ideal_test)
        say("writing the aircraft")
        initial = _initial(aircraft, found.names)
        estimates = estimates_of(found, names, initial)
        base = replace(found, parameters={n: (found.plain[n], found.parameters[n][1]) for n in found.names})
        plain = _write(aircraft, [], estimates_of(base, names, initial), work / "plain")
        slopes = control_slopes(found.before)
        written = [
            Written(found.effects[c.key], c.value, remark(c, found.effects[c.key], names, command), slopes)
            for c in found.selection.chosen
        ]
        better = _write(aircraft, written, estimates, work / "better") if written else plain
        sensed = {c.key: c.value for c in found.selection.chosen if not in_dynamics(found.effects[c.key])}
        say("flying the test flights with both models")
        pairs = []
        for which, straight_through, surfaces in ((setup, ideal, measured), (test, ideal_test, measured_test)):
            air = None
            if found.gusty:
                which = setup_in_gusts(aircraft, which)
                air = air_of(better, which, surfaces, straight_through, map_)
            before = show(plain, which, surfaces, straight_through, map_, {}, air)
            after = show(better, which, surfaces, straight_through, map_, sensed, air) if written else before
            pairs.append((which, before, after))
        shrank = pairs[1][2].cost < pairs[1][1].cost
        final = better if shrank or not written else plain
        controls = _controls(plain, setup, measured, ideal, map_)
        where = _disagreements(setup, pairs[0][1], pairs[0][2], controls)
        left = _disagreements(setup, pairs[0][2], pairs[0][2], controls)
        document = _document(request, found, pairs, where, left, shrank, controls)
        target = request.out / "aircraft" / aircraft.folder.name
        target.parent.mkdir(parents=True, exist_ok=True)
        write_bytes_tree(final.folder, target)
    stages.forget()
    document["seconds"] = round(time.perf_counter() - begun, 1)
    refined = find_aircraft(target)
    return Refinement(document, found, pairs[0], pairs[1], where, refined, aircraft)


def _identity(request: Request) -> list[str]:
    """Everything that the choice depends on: aircraft, train flights, own effects, options, version. The test flights are
    not in it."""
    tables = [p for p in (request.manoeuvres, request.map_path) if p is not None]
    return [
        __version__, content_hash(request.aircraft), *(file_hash(p) for p in (*request.train, *tables)),
        *(p.name for p in request.train), repr(request.extra), str(request.ideal_servos),
    ]  # fmt: skip


def _initial(aircraft: Aircraft, names: Sequence[str]) -> dict[str, float]:
    from uqharness.aircraft import open_aircraft

    fdm = open_aircraft(aircraft)
    return {n: float(fdm[n]) for n in names}


def _write(aircraft: Aircraft, effects: Sequence[Written], estimates: Mapping[str, Any], folder: Path) -> Aircraft:
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    write_effects(aircraft, effects, estimates, target)
    made = find_aircraft(target)
    return replace(made, engine_path=aircraft.engine_path, systems_path=aircraft.systems_path)


def _controls(aircraft: Aircraft, setup: Setup, measured: Sequence[str], ideal: Sequence[str], map_: Any) -> list[Any]:
    from uqharness.refine import Bench

    with Bench(aircraft, measured, ideal) as bench:
        return positions(bench.model, setup, map_)


def _disagreements(setup: Setup, shown: Shown, settled: Shown, controls: Sequence[Any]) -> list[Disagreement]:
    """Where ``shown`` lies outside what noise gives. A model that is at the noise in flight leaves more than that in coefficients,
    because held commands and gusts have their share there; then what it leaves is what is allowed."""
    quiet = all(settled.channel_rms(k) <= LIMIT * float(settled.noise[k]) for k in range(len(setup.outputs)))
    together: dict[str, list[Any]] = {}
    for s, g in zip(setup.segments, settled.coefficients, strict=True):
        together.setdefault(kind_of(s), []).append(g)
    by_kind = {kind: np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)) for kind, parts in together.items()}
    allowed = [
        np.broadcast_to(np.maximum(settled.floor, by_kind[kind_of(s)]) if quiet else settled.floor, g.shape)
        for s, g in zip(setup.segments, shown.coefficients, strict=True)
    ]
    labels = [kind_of(s) for s in setup.segments]
    return disagreements(
        shown.coefficients, allowed, state_ranges(setup, shown.flown, controls), labels, setup.segments[0].dt_s
    )


def kind_of(segment: Segment) -> str:
    """The kind of a manoeuvre: its label without the speed behind a comma."""
    return segment.label.split(",")[0]


def _remaining(
    found: Found, setup: Setup, shown: Shown, left: Sequence[Disagreement], controls: Sequence[Any]
) -> dict[str, Any]:
    """Whether anything is left that noise does not explain, where, and on what it depends."""
    p = whiteness(setup, shown.residual)
    ratios = {c: shown.channel_rms(k) / float(shown.noise[k]) for k, c in enumerate(setup.outputs)}
    above = {c: r for c, r in ratios.items() if r > LIMIT}
    # A gust spectrum is a model: the colour of one-step predictions says nothing of the aircraft.
    coloured = {} if found.gusty else {c: v for c, v in p.items() if v < COLOURED_P}
    refused = found.selection.refused
    strong = refused is not None and refused.strong
    unexplained = bool(above) or bool(coloured) or strong
    where: list[dict[str, Any]] = []
    if refused is not None and strong:
        where.append(_unconfirmed(found.effects[refused.key], refused))
    if above or coloured:
        where += [_disagreement(d) for d in left]
        states = state_ranges(setup, shown.flown, controls)
        for k, c in enumerate(COEFFICIENTS):
            ratio = shown.coefficient_rms(k) / float(shown.floor[k])
            if ratio > LIMIT:
                where.append({
                    "coefficient": c, "rms_over_noise": ratio,
                    "depends_on": [{"state": n, "share": s} for n, s in dependence(shown.coefficients, states, k)],
                })  # fmt: skip
    return {
        "unexplained": unexplained, "where": where, "channels_above_noise": above,
        "coloured_channels": sorted(coloured),
    }  # fmt: skip


def _unconfirmed(effect: Effect, refused: Refusal) -> dict[str, Any]:
    """Where the residual is and on what it depends, told from the candidate that came nearest without being right."""
    term = effect.parsed
    depends = [] if term is None else [{"state": v} for v in term.variables]
    words = (
        f"something is missing in {effect.coefficient or effect.subsystem} that depends on "
        f"{', '.join(d['state'] for d in depends) or effect.term}: {effect.name} comes "
        f"nearest (|t| {abs(refused.t):.1f}), but {refused.why}"
    )
    return {**_label(effect), "depends_on": depends, "t": refused.t, "words": words}


def _disagreement(d: Disagreement) -> dict[str, Any]:
    return {
        "coefficient": d.coefficient, "manoeuvre": d.manoeuvre, "region": {d.region.state: [d.region.low, d.region.high]},
        "share_outside_95": d.share, "size": d.size, "words": d.words,
    }  # fmt: skip


def _document(
    request: Request, found: Found, pairs: Sequence[tuple[Setup, Shown, Shown]], where: Sequence[Disagreement],
    left: Sequence[Disagreement], shrank: bool, controls: Sequence[Any],
) -> dict[str, Any]:  # fmt: skip
    setup, _, after = pairs[0]
    remaining = _remaining(found, setup, after, left, controls)
    effects = [_effect(found, c, shrank, pairs) for c in found.selection.chosen]
    if effects and shrank and not remaining["unexplained"]:
        verdict = "effects-found"
    elif remaining["unexplained"] or (effects and not shrank):
        verdict = "unexplained"
    else:
        verdict = "no-missing-effect"
    refused = found.selection.refused
    return {
        "verdict": verdict,
        "disagreement": [_disagreement(d) for d in where],
        "effects": effects,
        "remaining": remaining,
        "gap": {"train": gap_document(*pairs[0]), "test": gap_document(*pairs[1])},
        "model": f"aircraft/{request.aircraft.folder.name}/{request.aircraft.xml.name}",
        "switch": [
            {"property": found.setup.carriers[c.key], "off": off}
            for c in found.selection.chosen
            if c.key in found.setup.carriers and (off := _off(found, c.key, request)) is not None
        ],
        "parameters": {n: {"value": v, "std": s} for n, (v, s) in found.parameters.items()},
        "best_refused": None
        if refused is None
        else {"effect": refused.key.removeprefix("effect/"), "t": refused.t, "why": refused.why},
        "candidates": {
            "limit": found.limit, "scores": [{"effect": name, "t": t} for name, t in found.scoreboard],
        },
        "timing": {"controls_late_s": found.late_s},
        "trail": list(found.trail),
        "notes": [*found.notes, *(n for f in setup.flights for n in f.notes)],
        "train": [p.name for p in request.train],
        "test": [p.name for p in request.test],
        "command": shlex.join(request.command),
    }


def _off(found: Found, key: str, request: Request) -> float | None:
    carried = carrier(found.effects[key], request.aircraft.folder)
    return None if carried is None else carried[1]


def _label(effect: Effect) -> dict[str, str]:
    where = (
        {"coefficient": effect.coefficient} if effect.coefficient is not None else {"subsystem": effect.subsystem or ""}
    )
    return {**where, "term": effect.term}


def _effect(found: Found, c: Choice, shrank: bool, pairs: Sequence[tuple[Setup, Shown, Shown]]) -> dict[str, Any]:
    e = found.effects[c.key]
    value, std, unit = _as_written(found, e, c)
    return {
        **_label(e),
        "name": e.name,
        "why": why(e, c),
        "value": value,
        "std": std,
        "unit": unit,
        "property": e.property_name if in_dynamics(e) else None,
        "evidence": {
            "t": c.t, "twice_log_likelihood": c.gain, "confirmed_on_held_out_manoeuvres": c.confirmed_gain,
            "held_out_estimate_differs_by_std": c.difference, "interval_95": [value - 1.96 * std, value + 1.96 * std],
        },
        "withdrawn": not shrank,
        "alternatives": [_alternative(found, e, a) for a in c.alternatives],
    }  # fmt: skip


def _as_written(found: Found, e: Effect, c: Choice) -> tuple[float, float, str]:
    """Value, standard error and unit as the number stands in the XML: a servo's lag there is 1/s, its rate limit deg/s."""
    surface = (e.subsystem or "").partition(".")[2]
    servo = found.setup.servos.get(surface)
    if e.term == "lag" and servo is not None:
        rate = 1.0 / ((1.0 / servo.lag if servo.lag else 0.0) + c.value)
        return rate, rate**2 * c.std, "1/s"
    if e.term == "rate_limit":
        limit = 1.0 / max(c.value, 1e-9)
        return limit, limit**2 * c.std, "deg/s"
    return c.value, c.std, e.unit


def _alternative(found: Found, own: Effect, a: Alternative) -> dict[str, Any]:
    other = found.effects[a.key]
    row: dict[str, Any] = {
        **_label(other), "name": other.name,
        "evidence": {"twice_log_likelihood": a.gain, "t_of_the_effect_beside_it": a.t_beside, "likeness": a.likeness},
        "separable": a.separable,
    }  # fmt: skip
    if not a.separable:
        row["would_separate"] = separating_manoeuvre(own, other)
    return row
