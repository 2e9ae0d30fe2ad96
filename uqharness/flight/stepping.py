"""The step loop of a flight: JSBSim's run() with gusts and levels fed before each step.

`stepper` returns the fastest loop for what a spec moves. `Levels` are the moving levels of model
errors: white, or random walks with reflecting ends. The loops determine the throughput of campaigns
that JSBSim flies.
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

# Moving levels (Hale 2016, section 3.7). A delta coefficient is lower + f (upper - lower) with f in
# 0..1. A walk's rate is in 1/sqrt(s), so that the variance per second does not depend on the step.
# Streams belong to the epistemic sample and the coefficient: a walk is one epistemic sample in all
# its flights. Transient model error is a walk between -1 and 1 with streams of the air.

BLOCK_STEPS = 8192
"""Steps drawn at once; the values do not depend on it."""


def level_blocks(
    driver: LevelDriver | TransientDriver, steps: int, dt_s: float, block_steps: int = BLOCK_STEPS
) -> Iterator[FloatArray]:
    """Yield the levels of ``steps`` steps as arrays (<= block_steps, 6), columns as COEFFICIENTS.

    Parameters
    ----------
    driver : LevelDriver or TransientDriver
        Other coefficients stay at 0.5, of a transient driver at 0.
    steps : int
        Number of steps.
    dt_s : float
        Step [s].
    block_steps : int
        Longest block; it does not change the levels.

    Raises
    ------
    ValueError
        For an unknown kind, a step that is not positive, or a negative rate.
    """
    levels = Levels(driver, dt_s)
    for first in range(0, steps, block_steps):
        yield levels.take(min(block_steps, steps - first))


class Levels:
    """Endless levels.

    Parameters
    ----------
    driver : LevelDriver or TransientDriver
        What moves.
    dt_s : float
        Step [s].
    pairs : callable
        ``numpy_pairs`` or a compiled equivalent.
    splits : sequence of Split
        Steps behind which transient levels, which belong to the air, differ.

    Notes
    -----
    ``copy.deepcopy`` gives levels that continue from the present ones.
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
        """Return the levels of the next steps (steps, 6)."""
        return np.column_stack([column.take(steps) for column in self._columns])


def reflect(position: FloatArray) -> FloatArray:
    """Fold a free path into 0..1 by reflection at every whole number.

    A folded Gaussian walk is a walk with reflecting ends.

    Examples
    --------
    >>> reflect(np.array([0.25, 1.25, -0.5])).tolist()
    [0.25, 0.75, 0.5]
    """
    # Bit-identical to np.mod(position, 2.0), three times faster.
    folded = position - 2.0 * np.floor(0.5 * position)
    return np.minimum(folded, 2.0 - folded)


class _Column(Protocol):
    """Levels of one coefficient."""

    def take(self, size: int) -> FloatArray: ...


class _Constant:
    """A level that does not move."""

    def __init__(self, level: float) -> None:
        self._level = level

    def take(self, size: int) -> FloatArray:
        return np.full(size, self._level)


class _White:
    """Uniform levels, independent in each step."""

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator

    def take(self, size: int) -> FloatArray:
        return self._generator.random(size)


class _Walk:
    """Random walk with reflecting ends; the initial level is uniform.

    At the rates of real flights a walk forgets its start only after most of an hour.
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
        # Eq 3.38, with rates where the print has periods: sigma_sim = sigma_rec
        # sqrt(rate_rec/rate_sim) = rate sqrt(dt).
        self._sigma = rate_per_sqrt_s * math.sqrt(dt_s)
        self._next = float(np.random.Generator(generator).random())
        self._normals = spliced_to(Normals(generator, pairs))

    def take(self, size: int) -> FloatArray:
        path = np.empty(size + 1)
        path[0] = self._next
        np.multiply(self._normals.take(size), self._sigma, out=path[1:])
        # Sequential sums from the last position: rounding does not depend on the blocks.
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
    """Return the transient levels of one coefficient."""
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
    """Return the levels of one coefficient."""
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
# All six: setting a level that nothing reads is cheaper than a test.
_LEVELS = tuple(f"uq/{name}/level" for name in COEFFICIENTS)
_TRANSIENTS = tuple(f"uq/{name}/transient-level" for name in COEFFICIENTS)


def stepper(
    fdm: Any, spec: FlightSpec, dt_s: float, steps: int, splits: Sequence[Split] = ()
) -> Callable[[int], None]:
    """Return a function that runs n steps and feeds gusts and levels before each.

    Parameters
    ----------
    fdm : FGFDMExec
        Initialised instance.
    spec : FlightSpec
        What moves.
    dt_s : float
        Step [s].
    steps : int
        Number of steps in all.
    splits : sequence of Split
        Steps behind which gusts and noise are those of a branch, in order.

    Raises
    ------
    ValueError
        If JSBSim's own turbulence or a transient model error would have to branch.
    """
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
    """Return the steps with the sensors' generator seeded again behind each split."""
    remaining, done = list(splits), 0

    def stepped(count: int) -> None:
        nonlocal done
        while count:
            while remaining and remaining[0].frame == done:
                fdm["simulation/randomseed"] = remaining.pop(0).seed("noise")
            # Run up to the next split at most.
            part = min(count, remaining[0].frame - done) if remaining else count
            advance(part)
            done, count = done + part, count - part

    return stepped


def _unbranched(
    fdm: Any, spec: FlightSpec, dt_s: float, steps: int, splits: Sequence[Split] = ()
) -> Callable[[int], None]:
    """Return the fastest loop for what the spec moves."""
    run = fdm.run
    gusty = spec.turbulence != "none" and spec.turbulence_source == "spec"
    moving = [level_blocks(driver, steps, dt_s) for driver, _ in _drivers(spec)]
    names = [columns for _, columns in _drivers(spec)]
    # Without the air system, gusts go through JSBSim's own properties.
    if gusty and not has_air_system(fdm):
        gusts = _rows(_gust_blocks(fdm, spec, dt_s, steps, splits))
        return _with_rotated_gusts(
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
    """Return the properties of the first step's levels, which initialisation must see."""
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
    """Return the levels of the first step."""
    # Cached: all flights of an epistemic sample or an air start equally, and drawing takes 1 ms.
    return tuple(float(value) for value in next(level_blocks(driver, 1, dt_s))[0])


def _drivers(spec: FlightSpec) -> list[tuple[LevelDriver | TransientDriver, tuple[str, ...]]]:
    """Return what moves levels in flight, and the properties that it moves."""
    drivers: list[tuple[LevelDriver | TransientDriver, tuple[str, ...]]] = []
    drivers += [(spec.levels, _LEVELS)] if spec.levels is not None else []
    drivers += [(spec.transient, _TRANSIENTS)] if spec.transient is not None else []
    return drivers


def _rows(*series: Iterable[FloatArray]) -> Rows:
    """Return rows as tuples of floats, block by block; several series are joined side by side."""
    return chain.from_iterable(
        # array creates floats when iterated, three times faster than a list of all of them.
        zip(*(array("d", column.tobytes()) for block in blocks for column in block.T), strict=True)
        for blocks in zip(*series, strict=True)
    )


def _setters(fdm: Any, names: Iterable[str]) -> list[Callable[[float], None]]:
    """Return the setters of properties."""
    return [engine.handle(fdm, name).set_double_value for name in names]


# The loops are written out: in a step of 10 us each call would show.
def _with_six(fdm: Any, rows: Rows, names: Sequence[str]) -> Callable[[int], None]:
    """Return a loop that feeds six properties."""
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
    """Return a loop that feeds six gusts and six levels."""
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
    """Return a loop that feeds any number of properties."""
    run = fdm.run
    setters = _setters(fdm, names)

    def fed(count: int) -> None:
        for row in islice(rows, count):
            for set_value, one in zip(setters, row, strict=True):
                set_value(one)
            run()

    return fed


def _with_rotated_gusts(
    fdm: Any, gusts: Rows, names: Sequence[str], levels: Iterable[tuple[float, ...]]
) -> Callable[[int], None]:
    """Return a loop that feeds gusts through JSBSim's own properties.

    Gusts in heading axes are turned to north and east by the heading of the frame before. JSBSim
    has no input for rotation, so that only u, v and w act.
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
    """Yield gusts (n, 6) at the airspeed and height of the start."""
    # Airspeed, height above ground, intensity and span of the start.
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


def has_air_system(fdm: Any) -> bool:
    """Return whether the aircraft has the air system, by a property that only it creates."""
    return bool(fdm.get_property_manager().hasNode("air/wind-north-fps"))


def _airspeed_mps(fdm: Any, spec: FlightSpec) -> float:
    """Return the initial airspeed [m/s]."""
    if has_air_system(fdm):
        return float(fdm["velocities/vt-fps"]) * FT_M
    # The wind was set after initialisation, and JSBSim's airspeed does not include it yet.
    toward = math.radians(spec.wind_from_deg + 180.0)
    north = float(fdm["velocities/v-north-fps"]) * FT_M - spec.wind_mps * math.cos(toward)
    east = float(fdm["velocities/v-east-fps"]) * FT_M - spec.wind_mps * math.sin(toward)
    return math.hypot(north, east, float(fdm["velocities/v-down-fps"]) * FT_M)
