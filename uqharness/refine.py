"""Refinement: find where a model and flights disagree, name the missing effect, put it into the model, and show on other
flights what it did.

Train flights choose; test flights only show. A choice is made on the train flights' linearised likelihood
(sysid.effect_choice), the
chosen effects are then written into a copy of the aircraft, flown and estimated with everything else, and the choice is made again
around that flight until it stands.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.effect_choice import Choice, Selection, select, threshold
from sysid.effect_score import Evidence, corrected, gather, scores, solve
from sysid.effects import Effect, catalogue, subsystem_effects
from sysid.gaps import channel_noise, process_noise_shown
from sysid.prediction import whiten
from uqharness.actuators import Actuator, actuators
from uqharness.aircraft import Aircraft, find_aircraft
from uqharness.errors import BadInputError
from uqharness.flights import Flight, measured_outputs, segments
from uqharness.identify import BIASES, OUTPUTS
from uqharness.identify_start import equation_error_start
from uqharness.refine_candidates import effect_columns
from uqharness.refine_fit import PRIOR, Fit, Map, Point, Setup, fly, merged, positions, refit, states_of
from uqharness.refine_gusts import gust_evidence, gust_refit, middles
from uqharness.refine_stages import Stages
from uqharness.refine_timing import CONTROLS_LATE, MOST_CORRECTIONS, controls_late, later, words
from uqharness.refine_xml import Written, carrier, in_dynamics, write_effects
from uqharness.replay import SENSOR_OF
from uqharness.replay_model import CONTROLS, ReplayFolder, ReplayModel
from uqharness.xml_estimates import Estimate

Array = NDArray[np.float64]
ROUNDS = 4
LEAST_LATE_ROWS = 0.15
"""A delay or lag below this share of a row is within what a replay resolves, and is no effect."""
GUST_LIMIT = 5.5
"""|t| asked of an effect in turbulence, where the air's spectrum is a model, too."""
GUST_ODDS = 30.0
"""Odds against what a gust model that is a little off would look like."""
RESOLVED_ROWS = 0.03
"""Standard error, in rows, of a time told by replay."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class Model:
    """An aircraft at hand with the effects it carries by key -> value, and the values of its parameters."""

    aircraft: Aircraft
    effects: tuple[Effect, ...]
    values: Mapping[str, float]


@dataclass(frozen=True)
class Found:
    """What the train flights say: fits without and with the effects, the choice, everything estimated.

    before, after   fits of the model without and with the effects; after is before where there are none
    parameters      property -> (value, standard error corrected for colour); plain: property -> value without the effects
    scoreboard      the candidates that explain most of what the parameters leave, each alone: (name, t); limit: |t| asked
    gusty           whether the flights were judged by one-step predictions, because the air was turbulent
    late_s          by how much all controls were moved later than recorded before the choice was made
    """

    setup: Setup
    names: tuple[str, ...]
    before: Fit
    after: Fit
    selection: Selection
    effects: Mapping[str, Effect]
    parameters: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]
    plain: Mapping[str, float] = field(default_factory=dict)
    gusty: bool = False
    scoreboard: tuple[tuple[str, float], ...] = ()
    limit: float = float("nan")
    staged: Aircraft | None = None
    late_s: float = 0.0
    trail: tuple[str, ...] = field(default=())


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content. Raises BadInputError."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None


def refuse_shared(train: Sequence[Path], test: Sequence[Path]) -> None:
    """BadInputError when a test file has the content of a train file: a flight that chose cannot prove."""
    seen = {file_hash(path): path for path in train}
    for path in test:
        other = seen.get(file_hash(path))
        if other is not None:
            raise BadInputError(
                f"--test {path}: the same flight as --train {other}; a flight that helped to choose proves "
                f"nothing: give another one"
            )


def make_setup(
    aircraft: Aircraft, flights: Sequence[Flight], measured: Sequence[str], ideal: Sequence[str] = ()
) -> Setup:
    """Segments, measured outputs and noise of some flights."""
    arm = aircraft.card.sensors.position_m.get("accelerometer", (0.0, 0.0, 0.0))
    cut = [s for f in flights for s in segments(f, measured, arm)]
    outputs = tuple(c for c in OUTPUTS if any(c in f.record and np.isfinite(f.record[c]).any() for f in flights))
    data = [b for f in flights for b in measured_outputs(f, outputs)]
    known = channel_noise(data, outputs, aircraft.card.sensors.noise_std)
    late = {
        f.name: list(dict.fromkeys(SENSOR_OF.get(c, c) for c in outputs))
        for f in flights
        if f.record.metadata.native_hz
    }
    return Setup(
        tuple(flights), tuple(cut), states_of(flights), outputs, tuple(data), np.array([known[c] for c in outputs]),
        tuple(b for b in BIASES if b in outputs), late, servos=servos_of(aircraft, measured, ideal),
    )  # fmt: skip


def servos_of(aircraft: Aircraft, measured: Sequence[str], ideal: Sequence[str]) -> dict[str, Actuator]:
    """Actuators of the surfaces that the flights know by their commands alone; none where the XML has none by that name."""
    out: dict[str, Actuator] = {}
    for surface in ("elevator", "aileron", "rudder"):
        if surface in measured or surface in ideal or surface not in aircraft.card.inputs:
            continue
        with contextlib.suppress(BadInputError):
            out |= actuators(aircraft, [surface])
    return out


class Bench:
    """An aircraft staged for replay, as it flies and with every control straight through. A context."""

    def __init__(self, aircraft: Aircraft, measured: Sequence[str], ideal: Sequence[str]) -> None:
        self.aircraft, self.measured, self.ideal = aircraft, tuple(measured), tuple(ideal)
        self._stack = ExitStack()

    def __enter__(self) -> Bench:
        self.model: ReplayModel = self._stack.enter_context(
            ReplayFolder(self.aircraft, measured=self.measured, ideal=self.ideal)
        )
        self.straight: ReplayModel = self._stack.enter_context(
            ReplayFolder(self.aircraft, measured=self.measured, ideal=CONTROLS)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def candidates_for(setup: Setup, names: Sequence[str], extra: Sequence[Effect]) -> list[Effect]:
    """The catalogue less what the model estimates already, and the user's own effects."""
    surfaces = list(setup.servos)
    sensors = list(dict.fromkeys(SENSOR_OF.get(c, c) for c in setup.outputs)) if not setup.late else []
    every = [*extra, *catalogue(), *subsystem_effects(surfaces, setup.outputs, sensors)]
    out: dict[str, Effect] = {}
    for e in every:
        if e.coefficient is not None and e.property_name in names:
            continue
        out.setdefault(e.key, e)
    return list(out.values())


def confirming_segments(setup: Setup) -> NDArray[np.bool_]:
    """(S,) every third manoeuvre of each kind confirms what the others found; the kind is its label without speeds and numbers."""
    count: dict[str, int] = {}
    out = []
    for s in setup.segments:
        kind = s.label.split(",")[0]
        count[kind] = count.get(kind, -1) + 1
        out.append(count[kind] % 3 == 1)
    found = np.array(out)
    if not found.any() and len(found) > 2:
        found[1::3] = True
    return found


def find_effects(
    aircraft: Aircraft, setup: Setup, measured: Sequence[str], ideal: Sequence[str], extra: Sequence[Effect], work: Path, map_: Map,
    say: Say = lambda _: None, stages: Stages | None = None, put_right: tuple[float, ...] = (),
) -> Found:  # fmt: skip
    """Choose and estimate the missing effects on the train flights. ``work``: folder for staged copies of the aircraft;
    put_right: by how much the setup's controls have been moved later already, step by step."""
    names = tuple(aircraft.card.parameters)
    if not names:
        raise BadInputError(
            f"aircraft '{aircraft.name}': its airframe.toml lists no [parameters], so nothing says what may be re-identified first"
        )
    confirming = confirming_segments(setup)
    limits = {n: (c.bounds if c.bounds is not None else (-np.inf, np.inf)) for n, c in aircraft.card.parameters.items()}
    with Bench(aircraft, measured, ideal) as bench:
        say("re-identifying the parameters")
        keep = stages or Stages(None, ())
        asked = names
        stage = f"parameters{len(put_right) or ''}"
        before, names, notes = keep(stage, lambda: _base_fit(aircraft, bench, setup, asked, limits, map_))
        effects = candidates_for(setup, names, extra)
        by_key = {e.key: e for e in effects}
        if turbulent(setup, before):
            say(f"the air was turbulent: predicting one sample ahead, scoring {len(effects)} candidate effects")
            return _in_gusts(
                bench, setup_in_gusts(aircraft, setup), before, names, limits, effects, confirming, notes, map_
            )
        say(f"scoring {len(effects)} candidate effects")
        timed = () if setup.late else (CONTROLS_LATE,)
        evidence = candidate_evidence(setup, before, [*effects, *timed])
        odds = _eligible(effects, setup, before, evidence)
        dt = setup.segments[0].dt_s
        late = (
            controls_late(
                evidence, before.columns[0].names, odds, confirming, threshold(len(odds) + 1), LEAST_LATE_ROWS * dt, dt
            )
            if timed and len(put_right) < MOST_CORRECTIONS
            else None
        )
    if late is not None:
        say(f"all controls act {1e3 * late[0]:.1f} ms after their rows; putting the records right")
        right = make_setup(aircraft, later(setup.flights, late[0]), measured, ideal)
        found = find_effects(
            aircraft, right, measured, ideal, extra, work, map_, say, stages, (*put_right, late[0])
        )
        if not put_right:
            found = replace(found, notes=(words(found.late_s, late[1], dt), *found.notes))
        return found
    board = score_table(evidence, before.columns[0].names, odds, by_key)
    limit = threshold(len(odds))
    selection = select(evidence, before.columns[0].names, odds, confirming)
    trail = [f"round 1: {line}" for line in selection.trail]
    after, staged, chosen_setup = before, None, setup
    for number in range(2, ROUNDS + 1):
        if not selection.chosen:
            break
        chosen = [by_key[c.key] for c in selection.chosen]
        say(f"round {number}: flying with {', '.join(_short(e) for e in chosen)}")
        staged, chosen_setup = _stage(aircraft, setup, chosen, selection, before, work / f"round{number}")
        with Bench(staged, measured, ideal) as bench:
            start = _with_effects(before.flown.point, chosen_setup, selection, staged)
            keys = [e.key for e in chosen]
            after = refit(
                bench.model, bench.straight, chosen_setup, positions(bench.model, chosen_setup, map_), start, [*names, *keys],
                limits, map_,
            )  # fmt: skip
            rest = [e for e in effects if e.key not in keys]
            evidence = candidate_evidence(chosen_setup, after, rest)
            written = {c.key: c.value for c in selection.chosen}
            evidence = evidence.taken_out(
                {
                    e.key: effect_value(e, after.flown.point, chosen_setup.carriers, staged, written[e.key])
                    for e in chosen
                }
            )
            free = [n for n in after.columns[0].names if n not in keys]
            odds = {**_eligible(rest, setup, after, evidence), **{k: by_key[k].odds for k in keys}}
            again = select(evidence, free, odds, confirming, chosen=keys)
        trail += [f"round {number}: {line}" for line in again.trail]
        # What JSBSim reads once (mass, servos) has to be written anew until the number stands.
        moving = [
            c for c in again.chosen
            if c.key in written and c.key not in chosen_setup.carriers and in_dynamics(by_key[c.key])
            and abs(c.value - written[c.key]) > 0.5 * c.std
        ]  # fmt: skip
        same = {c.key for c in again.chosen} == set(keys) and not moving
        selection = again
        if same:
            break
    selection = with_resolution(selection, by_key, setup.segments[0].dt_s)
    parameters = _parameters(evidence, names, after, selection)
    return Found(
        chosen_setup if selection.chosen else setup, names, before, after if selection.chosen else before, selection,
        by_key, parameters,
        tuple(notes), {n: before.flown.point.values[n] for n in names}, False, board, limit,
        staged if selection.chosen else None, sum(put_right), tuple(trail),
    )  # fmt: skip


def with_resolution(selection: Selection, effects: Mapping[str, Effect], dt_s: float) -> Selection:
    """Standard errors of times with what a replay resolves added: a servo's lag by Tustin's rule at 10 ms is off by a
    part of a ms."""

    def widened(c: Choice) -> Choice:
        if effects[c.key].unit != "s":
            return c
        std = float(np.hypot(c.std, RESOLVED_ROWS * dt_s))
        return replace(c, std=std, t=c.value / std)

    return replace(selection, chosen=tuple(widened(c) for c in selection.chosen))


def turbulent(setup: Setup, fit: Fit) -> bool:
    """Whether what the replay leaves is coloured, no function of the motion, and there in quiet flight as well."""
    columns = [k for k, c in enumerate(setup.outputs) if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")]
    residual = [(z - y)[:, columns] for z, y in zip(setup.measured, fit.flown.outputs, strict=True)]
    return process_noise_shown(residual, [y[:, columns] for y in fit.flown.outputs], setup.noise[columns])


def setup_in_gusts(aircraft: Aircraft, setup: Setup) -> Setup:
    """The same with the card's sensor noise where it says one: third differences of an accelerometer see gusts as noise."""
    stated = aircraft.card.sensors.noise_std
    return replace(
        setup, noise=np.array([stated.get(c, n) for c, n in zip(setup.outputs, setup.noise.tolist(), strict=True)])
    )


def gust_like(effect: Effect) -> bool:
    """Whether a gust model that is a little off looks like this effect: rates of the wind angles, sensors of the wind."""
    parsed = effect.parsed
    if parsed is not None:
        return any(v in ("alphadot_hat", "betadot_hat") for v in parsed.variables)
    return (effect.subsystem or "").startswith(("sensor.", "actuator.", "mass"))


def _in_gusts(
    bench: Bench, setup: Setup, base: Fit, names: tuple[str, ...], limits: Mapping[str, tuple[float, float]],
    effects: Sequence[Effect], confirming: NDArray[np.bool_], notes: Sequence[str], map_: Map,
) -> Found:  # fmt: skip
    """The same choice made on one-step predictions."""
    controls, bends = positions(bench.model, setup, map_), middles(bench.model, setup, map_)
    found = gust_refit(bench.straight, setup, controls, bends, base.flown.point, names, limits, map_)
    evidence = gust_evidence(setup, found, effect_columns(setup, found.fit.probes, found.fit.flown, effects))
    free = found.fit.columns[0].names
    odds = _eligible(effects, setup, found.fit, evidence)
    odds = {k: o + (GUST_ODDS if gust_like(next(e for e in effects if e.key == k)) else 0.0) for k, o in odds.items()}
    selection = select(evidence, free, odds, confirming, limit=max(threshold(len(odds)), GUST_LIMIT))
    chosen = [c.key for c in selection.chosen]
    delta = dict(zip(evidence.names, evidence.fitted(evidence.index([*free, *chosen])), strict=True))
    values = found.fit.flown.point.values
    parameters = {
        n: (values[n] + delta[n], corrected(evidence, [f for f in (*free, *chosen) if f != n], n)[1]) for n in names
    }
    by_key = {e.key: e for e in effects}
    carriers = {k: c[0] for k in chosen if (c := carrier(by_key[k], bench.aircraft.folder)) is not None}
    note = (
        "the residuals of replays showed turbulence: effects and parameters were judged by "
        "predictions one sample ahead, with process "
        f"noise estimated ({found.gain:.0f} more in twice the log likelihood than calm air)"
    )
    return Found(
        replace(setup, carriers=carriers), names, found.fit, found.fit, selection, by_key, parameters, (*notes, note),
        {n: values[n] for n in names}, True,
        score_table(evidence, free, odds, by_key), max(threshold(len(odds)), GUST_LIMIT), None,
        trail=tuple(f"one-step predictions: {line}" for line in selection.trail),
    )  # fmt: skip


def score_table(
    evidence: Evidence, free: Sequence[str], odds: Mapping[str, float], effects: Mapping[str, Effect]
) -> tuple[tuple[str, float], ...]:
    """The twelve candidates with the largest gain, alone beside the parameters: (name, t)."""
    found = scores(evidence, free, list(odds))
    order = np.argsort(-np.nan_to_num(found.gain, nan=-1.0))[:12]
    return tuple((_short(effects[found.names[i]]), float(found.t[i])) for i in order)


def _short(e: Effect) -> str:
    return f"{e.coefficient or e.subsystem} {e.term}"


def _base_fit(
    aircraft: Aircraft,
    bench: Bench,
    setup: Setup,
    names: tuple[str, ...],
    limits: Mapping[str, tuple[float, float]],
    map_: Map,
) -> tuple[Fit, tuple[str, ...], list[str]]:
    """The fit of the model as it is; parameters that the flights do not determine stay where they are and are named in a note."""
    from uqharness import engine

    fdm = bench.model.open(aircraft.dt_s)
    engine.require(fdm, names)
    current = np.array([fdm[n] for n in names])
    del fdm
    near, notes = equation_error_start(
        bench.model, bench.straight, setup.flights, setup.segments, names, current, [limits[n] for n in names]
    )
    controls = positions(bench.model, setup, map_)
    starts = tuple(s.start for s in setup.segments)
    options = [Point(dict(zip(names, values.tolist(), strict=True)), {}, starts) for values in (near, current)]
    flown = [fly(bench.model, setup, p, map_) for p in options]
    best = min(flown, key=lambda f: f.cost)
    if not np.isfinite(best.cost):
        raise BadInputError(
            "the model leaves the flight in some segment (its state is no longer finite); check its XML and the controls' signs"
        )
    # One step tells what the flights hold nothing of; it must not be carried to a bound by rounding.
    first = refit(bench.model, bench.straight, setup, controls, best.point, names, limits, map_, max_iterations=1)
    lost = undetermined(first.evidence, names, limits)
    fit = first if lost else refit(bench.model, bench.straight, setup, controls, first.flown.point, names, limits, map_)
    if lost:
        kept = tuple(n for n in names if n not in lost)
        values = {**fit.flown.point.values, **{n: float(current[names.index(n)]) for n in lost}}
        fit = refit(
            bench.model, bench.straight, setup, controls, replace(fit.flown.point, values=values), kept, limits, map_
        )
        notes = [*notes, f"not determined by these flights and left as they are: {', '.join(lost)}"]
        return fit, kept, notes
    return fit, names, notes


def undetermined(evidence: Evidence, names: Sequence[str], limits: Mapping[str, tuple[float, float]]) -> list[str]:
    """Parameters of which the flights hold next to nothing that the others do not, or less than their bounds alone say."""
    G, _ = evidence.everything
    some = evidence.index(names)
    scale = np.sqrt(np.maximum(np.diagonal(G), 0.0))
    dead = [n for n, i in zip(names, some, strict=True) if scale[i] == 0.0]
    alive = np.flatnonzero(scale > 0.0)
    corr = G[np.ix_(alive, alive)] / np.outer(scale[alive], scale[alive])
    values, vectors = np.linalg.eigh(corr)
    for k in np.flatnonzero(values < 1e-8).tolist():
        share = np.abs(vectors[:, k])
        members = [evidence.names[alive[j]] for j in np.argsort(-share) if share[j] > 0.1]
        worst = next((m for m in members if m in names and m not in dead), None)
        if worst is not None:
            dead.append(worst)
    inverse = solve(corr, np.eye(len(alive)))
    for k, column in enumerate(alive.tolist()):
        name = evidence.names[column]
        low, high = limits.get(name, (-np.inf, np.inf))
        if (
            name in names
            and name not in dead
            and float(np.sqrt(inverse[k, k])) / scale[column] > (high - low) / np.sqrt(12.0)
        ):
            dead.append(name)
    return dead


def candidate_evidence(setup: Setup, fit: Fit, effects: Sequence[Effect]) -> Evidence:
    """Evidence of a fit's own columns and of every candidate's."""
    columns = merged(fit.columns, effect_columns(setup, fit.probes, fit.flown, effects))
    white = whiten(fit.steps, setup.measured, columns, setup.which, setup.noise)
    return gather(white, columns[0].names, [s.flight for s in setup.segments], PRIOR)


def _eligible(effects: Sequence[Effect], setup: Setup, fit: Fit, evidence: Evidence) -> dict[str, float]:
    """Candidates worth scoring and their odds: delays that a replay cannot resolve are left out."""
    found = scores(evidence, fit.columns[0].names, [e.key for e in effects])
    least = LEAST_LATE_ROWS * setup.segments[0].dt_s
    out = {}
    for e, estimate, share in zip(effects, found.estimate, found.share, strict=True):
        if not share > 0.0:
            continue
        if e.positive and not estimate > 0.0:
            continue
        if e.unit == "s" and not abs(estimate) > least:
            continue
        out[e.key] = e.odds
    return out


def _stage(
    aircraft: Aircraft, setup: Setup, chosen: Sequence[Effect], selection: Selection, fit: Fit, folder: Path
) -> tuple[Aircraft, Setup]:
    """A copy of the aircraft that carries the effects, and the setup that knows of them."""
    value = {c.key: c.value for c in selection.chosen}
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    written = [Written(e, value[e.key], "", control_slopes(fit)) for e in chosen]
    write_effects(aircraft, written, {}, target)
    staged = find_aircraft(target)
    staged = replace(staged, engine_path=aircraft.engine_path, systems_path=aircraft.systems_path)
    carriers = {e.key: found[0] for e in chosen if (found := carrier(e, aircraft.folder)) is not None}
    return staged, replace(setup, active=tuple(chosen), carriers=carriers)


def control_slopes(fit: Fit) -> dict[str, float]:
    """Mean change of the coefficients by a degree of elevator and rudder, and of CZ by a radian of alpha."""
    by = np.concatenate([p.by_control for p in fit.probes])
    out = {
        f"{c}_{u}": float(by[:, k, j].mean())
        for u, j in (("de", 0), ("dr", 2))
        for k, c in enumerate(("CX", "CY", "CZ", "Cl", "Cm", "Cn"))
    }
    slope = np.concatenate([p.reference.slopes[:, 2, 1] / (p.reference.qbar * p.mass.S) for p in fit.probes])
    return {**out, "CZ_alpha": float(slope.mean())}


def _with_effects(point: Point, setup: Setup, selection: Selection, staged: Aircraft) -> Point:
    values, sensed = dict(point.values), dict(point.sensed)
    for c in selection.chosen:
        effect = next(e for e in setup.active if e.key == c.key)
        if c.key in setup.carriers:
            found = carrier(effect, staged.folder)
            values[setup.carriers[c.key]] = c.value + (found[1] if found else 0.0)
        elif not in_dynamics(effect):
            sensed[c.key] = c.value
    return replace(point, values=values, sensed=sensed)


def effect_value(effect: Effect, point: Point, carriers: Mapping[str, str], staged: Aircraft, written: float) -> float:
    """An effect's value at a point of the staged model."""
    if effect.key in carriers:
        found = carrier(effect, staged.folder)
        return point.values[carriers[effect.key]] - (found[1] if found else 0.0)
    return point.sensed.get(effect.key, written)


def _parameters(
    evidence: Evidence, names: Sequence[str], fit: Fit, selection: Selection
) -> dict[str, tuple[float, float]]:
    free = [*[n for n in fit.columns[0].names if not n.startswith("effect/")], *[c.key for c in selection.chosen]]
    out = {}
    for n in names:
        _, std, _ = corrected(evidence, [f for f in free if f != n], n)
        out[n] = (float(fit.flown.point.values[n]), std)
    return out


def remark(choice: Choice, effect: Effect, flights: Sequence[str], command: str) -> str:
    """What stands beside the number in the XML."""
    low, high = choice.value - 1.96 * choice.std, choice.value + 1.96 * choice.std
    return (
        f"{effect.name}: {choice.value:.5g} +/- {choice.std:.2g}, 95 % [{low:.5g}, {high:.5g}]; "
        f"from {', '.join(flights)}; {command}; 0 switches it off"
    )


def estimates_of(found: Found, flights: Sequence[str], initial: Mapping[str, float]) -> dict[str, Estimate]:
    """New numbers of the re-identified parameters with their remarks."""
    out = {}
    for n, (value, std) in found.parameters.items():
        out[n] = Estimate(
            value, f"{value:.5g} +/- {std:.2g}, was {initial.get(n, float('nan')):.5g}; refine; {', '.join(flights)}"
        )
    return out


__all__ = ["Found", "Selection", "find_effects", "make_setup", "refuse_shared", "threshold"]
