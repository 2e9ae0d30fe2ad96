"""The step loop of a flight: JSBSim's run() with what the host feeds in before each step.

Throughput is decided here.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain, islice, repeat
from typing import Any, Protocol

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.flight.dryden import (
    PAGE_STEPS,
    DrydenGusts,
    dryden_parameters,
    gust_blocks,
    refuse_above_ceiling,
)
from uqharness.flight.random_numbers import (
    Normals,
    Pairs,
    Source,
    Split,
    numpy_pairs,
    splice,
    transient_stream,
    walk_stream,
)
from uqharness.flight.spec import (
    COEFFICIENTS,
    TURBULENCE_W20_KT,
    FlightSpec,
    LevelDriver,
    TransientDriver,
)
from uqharness.simulator import engine

# Levels that move in flight: f redrawn each step (white), or a Gaussian random walk between
# reflecting ends.
#
# Hale (2016), section 3.7: a delta coefficient is lower + f (upper - lower) with f in 0..1. A
# walk's rate is given in 1/sqrt(s), so that the variance gathered per second is the same at any
# step. Streams belong to the epistemic sample and the coefficient, not to the flight: one walk
# is one epistemic sample, the same in all its flights. The levels are the same bytes on every
# processor.
#
# Beside them moves the transient part of a model's error, a walk between -1 and 1 with streams
# of the air.

BLOCK_STEPS = 8192
"""Steps drawn at once. The values do not depend on it; memory does."""


def level_blocks(
    driver: LevelDriver | TransientDriver, steps: int, dt_s: float, block_steps: int = BLOCK_STEPS
) -> Iterator[FloatArray]:
    """Levels of ``steps`` steps as arrays (<= block_steps, 6), columns in the order of
    COEFFICIENTS.

    A coefficient that the driver does not move stays at 0.5, of a transient one at 0. The same
    driver gives the same levels, whatever the block. ValueError for a kind that is not white or
    walk, a step that is not positive, or a rate below 0."""
    levels = Levels(driver, dt_s)
    for first in range(0, steps, block_steps):
        yield levels.take(min(block_steps, steps - first))


class Levels:
    """The same without end. ``pairs`` may be a compiled form of ``numpy_pairs``. Behind each of
    ``splits`` transient levels, which belong to the air, walk on otherwise.

    ``copy.deepcopy`` gives levels that go on from where these stand.
    """

    def __init__(
        self,
        driver: LevelDriver | TransientDriver,
        dt_s: float,
        pairs: Pairs = numpy_pairs,
        splits: Sequence[Split] = (),
    ) -> None:
        if not dt_s > 0.0:
            raise ValueError(f"dt_s = {dt_s}: a step must be positive")
        self._columns: list[_Column]
        if isinstance(driver, TransientDriver):
            self._columns = [
                _transient_column(driver, name, dt_s, pairs, splits) for name in COEFFICIENTS
            ]
        else:
            self._columns = [_column(driver, name, dt_s, pairs) for name in COEFFICIENTS]

    def take(self, steps: int) -> FloatArray:
        """Levels of the next steps (steps, 6)."""
        return np.column_stack([column.take(steps) for column in self._columns])


def reflect(position: FloatArray) -> FloatArray:
    """Fold a free path into 0..1: mirrors at every whole number.

    A Gaussian walk folded so is a walk with reflecting ends.
    """
    # To the bit what np.mod(position, 2.0) gives, in a third of its time.
    folded = position - 2.0 * np.floor(0.5 * position)
    return np.minimum(folded, 2.0 - folded)


class _Column(Protocol):
    def take(self, size: int) -> FloatArray: ...


class _Constant:
    def __init__(self, level: float) -> None:
        self._level = level

    def take(self, size: int) -> FloatArray:
        return np.full(size, self._level)


class _White:
    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator

    def take(self, size: int) -> FloatArray:
        return self._generator.random(size)


class _Walk:
    """f(0) is uniform: at the rates that flights show, a walk needs most of an hour to forget where
    it began.
    """

    def __init__(
        self,
        generator: np.random.PCG64,
        rate_per_sqrt_s: float,
        dt_s: float,
        pairs: Pairs,
        spliced_to: Callable[[Source], Source] = lambda first: first,
    ) -> None:
        if not rate_per_sqrt_s >= 0.0:
            raise ValueError(f"walk rate {rate_per_sqrt_s}: 0 or more per square root of a second")
        # Eq 3.38 with the rates where the print has periods: sigma_sim = sigma_rec
        # sqrt(rate_rec/rate_sim) = rate sqrt(dt)
        self._sigma = rate_per_sqrt_s * math.sqrt(dt_s)
        self._next = float(np.random.Generator(generator).random())
        self._normals = spliced_to(Normals(generator, pairs))

    def take(self, size: int) -> FloatArray:
        path = np.empty(size + 1)
        path[0] = self._next
        np.multiply(self._normals.take(size), self._sigma, out=path[1:])
        # Summed one after the other from the carried position: a block's end is no place where
        # rounding differs.
        np.cumsum(path, out=path)
        self._next = float(path[-1])
        return reflect(path[:-1])


class _Centred:
    """A walk between -1 and 1."""

    def __init__(self, walk: _Walk) -> None:
        self._walk = walk

    def take(self, size: int) -> FloatArray:
        return np.asarray(2.0 * self._walk.take(size) - 1.0)


def _transient_column(
    driver: TransientDriver, coefficient: str, dt_s: float, pairs: Pairs, splits: Sequence[Split]
) -> _Column:
    if coefficient not in driver.coefficients:
        return _Constant(0.0)
    generator = np.random.PCG64(transient_stream(driver.root_seed, driver.aleatory_id, coefficient))
    rate = driver.rates_per_sqrt_s[driver.coefficients.index(coefficient)]
    number = COEFFICIENTS.index(coefficient)
    return _Centred(
        _Walk(
            generator,
            rate,
            dt_s,
            pairs,
            lambda first: splice(first, splits, "transient", number, lambda g: Normals(g, pairs)),
        )
    )


def _column(driver: LevelDriver, coefficient: str, dt_s: float, pairs: Pairs) -> _Column:
    if coefficient not in driver.coefficients:
        return _Constant(0.5)
    generator = np.random.PCG64(walk_stream(driver.root_seed, driver.epistemic_id, coefficient))
    if driver.kind == "white":
        return _White(np.random.Generator(generator))
    if driver.kind == "walk":
        rate = driver.rates_per_sqrt_s[driver.coefficients.index(coefficient)]
        return _Walk(generator, rate, dt_s, pairs)
    raise ValueError(f"level driver '{driver.kind}': white or walk")


Rows = Iterator[tuple[float, ...]]

_GUSTS = tuple(
    f"air/host/{name}"
    for name in ("u-mps", "v-mps", "w-mps", "p-rad_sec", "q-rad_sec", "r-rad_sec")
)
# All six at once: a coefficient that does not move gets a level nobody reads, which is cheaper than
# asking.
_LEVELS = tuple(f"uq/{name}/level" for name in COEFFICIENTS)
_TRANSIENTS = tuple(f"uq/{name}/transient-level" for name in COEFFICIENTS)


def stepper(
    fdm: Any, spec: FlightSpec, dt_s: float, steps: int, splits: Sequence[Split] = ()
) -> Callable[[int], None]:
    """A function that runs n steps, at most ``steps`` in all, feeding gusts and levels before each.
    Call it after initialising.

    Behind each of ``splits``, in their order, gusts and noise are those of a branch. Raises
    ValueError where JSBSim's own turbulence or a transient model error would have to branch."""
    if not splits:
        return _unbranched(fdm, spec, dt_s, steps)
    if spec.transient is not None or (
        spec.turbulence != "none" and spec.turbulence_source != "spec"
    ):
        raise ValueError(
            "a branch is flown in JSBSim with the host's gusts alone, without transient model error"
        )
    return _branched(fdm, _unbranched(fdm, spec, dt_s, steps, splits), splits)


def _branched(
    fdm: Any, advance: Callable[[int], None], splits: Sequence[Split]
) -> Callable[[int], None]:
    """The same steps, with the sensors' generator seeded anew behind each split."""
    remaining, done = list(splits), 0

    def stepped(count: int) -> None:
        nonlocal done
        while count:
            while remaining and remaining[0].frame == done:
                fdm["simulation/randomseed"] = remaining.pop(0).seed("noise")
            part = min(count, remaining[0].frame - done) if remaining else count
            advance(part)
            done, count = done + part, count - part

    return stepped


def _unbranched(
    fdm: Any, spec: FlightSpec, dt_s: float, steps: int, splits: Sequence[Split] = ()
) -> Callable[[int], None]:
    run = fdm.run
    gusty = spec.turbulence != "none" and spec.turbulence_source == "spec"
    moving = [level_blocks(driver, steps, dt_s) for driver, _ in _drivers(spec)]
    names = [columns for _, columns in _drivers(spec)]
    if gusty and not has_air(fdm):
        gusts = _rows(_gust_blocks(fdm, spec, dt_s, steps, splits))
        return _with_turned_gusts(
            fdm, gusts, tuple(chain(*names)), _rows(*moving) if moving else repeat(())
        )
    if gusty:
        moving.insert(0, _gust_blocks(fdm, spec, dt_s, steps, splits))
        names.insert(0, _GUSTS)
    if moving:
        with_them = (_with_six, _with_twelve, _with_many)[len(moving) - 1]
        return with_them(fdm, _rows(*moving), tuple(chain(*names)))

    def plain(count: int) -> None:
        for _ in repeat(None, count):
            run()

    return plain


def first_levels(spec: FlightSpec, dt_s: float) -> dict[str, float]:
    """Levels of the first step as properties: what initialising has to see."""
    levels: dict[str, float] = {}
    for driver, columns in _drivers(spec):
        row = _first_row(driver, dt_s)
        moved = zip(COEFFICIENTS, columns, row, strict=True)
        levels |= {
            name: float(value)
            for coefficient, name, value in moved
            if coefficient in driver.coefficients
        }
    return levels


@lru_cache(maxsize=4096)
def _first_row(driver: LevelDriver | TransientDriver, dt_s: float) -> tuple[float, ...]:
    # All flights of an epistemic sample, or of an air, begin with the same; to draw it takes a
    # millisecond.
    return tuple(float(value) for value in next(level_blocks(driver, 1, dt_s))[0])


def _drivers(spec: FlightSpec) -> list[tuple[LevelDriver | TransientDriver, tuple[str, ...]]]:
    """What moves levels in flight, with the properties that it moves."""
    drivers: list[tuple[LevelDriver | TransientDriver, tuple[str, ...]]] = []
    drivers += [(spec.levels, _LEVELS)] if spec.levels is not None else []
    drivers += [(spec.transient, _TRANSIENTS)] if spec.transient is not None else []
    return drivers


def _rows(*series: Iterable[FloatArray]) -> Rows:
    """Rows as tuples of Python floats, a block at a time: a whole hour would fill the memory.

    Several series stand side by side.
    """
    return chain.from_iterable(
        # array's iterator makes a float as it is asked for one: a third of the time of a list that
        # holds them all.
        zip(*(array("d", column.tobytes()) for block in blocks for column in block.T), strict=True)
        for blocks in zip(*series, strict=True)
    )


def _setters(fdm: Any, names: Iterable[str]) -> list[Callable[[float], None]]:
    return [engine.handle(fdm, name).set_double_value for name in names]


# The loops below are written out: in a step of ten microseconds every call between them would show.
def _with_six(fdm: Any, rows: Rows, names: Sequence[str]) -> Callable[[int], None]:
    run = fdm.run
    set_1, set_2, set_3, set_4, set_5, set_6 = _setters(fdm, names)

    def fed(count: int) -> None:
        for one, two, three, four, five, six in islice(rows, count):
            set_1(one)
            set_2(two)
            set_3(three)
            set_4(four)
            set_5(five)
            set_6(six)
            run()

    return fed


def _with_twelve(fdm: Any, rows: Rows, names: Sequence[str]) -> Callable[[int], None]:
    run = fdm.run
    set_u, set_v, set_w, set_p, set_q, set_r, set_1, set_2, set_3, set_4, set_5, set_6 = _setters(
        fdm, names
    )

    def fed(count: int) -> None:
        for u, v, w, p, q, r, one, two, three, four, five, six in islice(rows, count):
            set_u(u)
            set_v(v)
            set_w(w)
            set_p(p)
            set_q(q)
            set_r(r)
            set_1(one)
            set_2(two)
            set_3(three)
            set_4(four)
            set_5(five)
            set_6(six)
            run()

    return fed


def _with_many(fdm: Any, rows: Rows, names: Sequence[str]) -> Callable[[int], None]:
    run = fdm.run
    setters = _setters(fdm, names)

    def fed(count: int) -> None:
        for row in islice(rows, count):
            for set_value, one in zip(setters, row, strict=True):
                set_value(one)
            run()

    return fed


def _with_turned_gusts(
    fdm: Any, gusts: Rows, names: Sequence[str], levels: Iterable[tuple[float, ...]]
) -> Callable[[int], None]:
    """Gust velocities through JSBSim's own properties, heading axes turned to north and east by the
    heading of the frame before.

    JSBSim keeps the gusts' rotation to itself, so the aircraft meets u, v and w alone.
    """
    run = fdm.run
    heading = engine.handle(fdm, "attitude/psi-rad").get_double_value
    set_north, set_east, set_down = _setters(
        fdm, [f"atmosphere/gust-{axis}-fps" for axis in ("north", "east", "down")]
    )
    level_setters = _setters(fdm, names)
    cos, sin, per_ft = math.cos, math.sin, 1.0 / FT_M

    def fed(count: int) -> None:
        for (u, v, w, _, _, _), row in islice(zip(gusts, levels, strict=False), count):
            psi = heading()
            c, s = cos(psi) * per_ft, sin(psi) * per_ft
            set_north(u * c - v * s)
            set_east(u * s + v * c)
            set_down(w * per_ft)
            for set_level, level in zip(level_setters, row, strict=True):
                set_level(level)
            run()

    return fed


def _gust_blocks(
    fdm: Any, spec: FlightSpec, dt_s: float, steps: int, splits: Sequence[Split]
) -> Iterator[FloatArray]:
    air = (
        max(_airspeed_mps(fdm, spec), 1.0),
        max(float(fdm["position/h-agl-ft"]) * FT_M, 3.048),
        TURBULENCE_W20_KT[spec.turbulence],
        float(fdm["metrics/bw-ft"]) * FT_M,
    )
    refuse_above_ceiling(spec.turbulence, air[1])
    if splits:
        branching = DrydenGusts(dryden_parameters(*air), dt_s, spec.seed_turbulence, splits=splits)
        return (branching.page().T[: steps - first] for first in range(0, steps, PAGE_STEPS))
    blocks = gust_blocks(steps, dt_s, *air, seed=spec.seed_turbulence, block=BLOCK_STEPS)
    return (
        np.column_stack(
            [gusts.u_mps, gusts.v_mps, gusts.w_mps, gusts.p_radps, gusts.q_radps, gusts.r_radps]
        )
        for gusts in blocks
    )


def has_air(fdm: Any) -> bool:
    """Whether the aircraft carries the air system; asked by what it publishes, for a script makes
    any property that it sets.
    """
    return bool(fdm.get_property_manager().hasNode("air/wind-north-fps"))


def _airspeed_mps(fdm: Any, spec: FlightSpec) -> float:
    if has_air(fdm):
        return float(fdm["velocities/vt-fps"]) * FT_M
    # The wind has only just been set and JSBSim has not met it yet.
    toward = math.radians(spec.wind_from_deg + 180.0)
    north = float(fdm["velocities/v-north-fps"]) * FT_M - spec.wind_mps * math.cos(toward)
    east = float(fdm["velocities/v-east-fps"]) * FT_M - spec.wind_mps * math.sin(toward)
    return math.hypot(north, east, float(fdm["velocities/v-down-fps"]) * FT_M)
