"""Servo outputs: PWM to surface deflection, and steps of commands between logged samples.

Channel, neutral and sense come from the autopilot's parameters if the log has them, else from the
card; without either, the usual order applies (1 aileron, 2 elevator, 3 throttle, 4 rudder).
Degrees come from the card. V-tails and elevons are separated into elevator and rudder or aileron.
`place_steps` re-times slowly logged command steps by the gyro. All functions are pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.card import AirframeCard, Mix, Servo, Table

# Parameters of the autopilot: channel, PWM at both ends and at neutral, and sense.
#
# ArduPilot: SERVOn_FUNCTION, _MIN, _MAX, _TRIM, _REVERSED; before version 3.8 RCn_MIN, _MAX, _TRIM,
# _REV in the usual order. A positive demand raises the PWM unless reversed; it rolls right, pitches
# up and yaws right. PX4: PWM_MAIN_FUNCn, _MINn, _MAXn, _REV and CA_SV_CSi_TYPE, _TRQ_R, _TRQ_P,
# _TRQ_Y, _TRIM; torques are positive right wing down, nose up and nose right.

USUAL_CHANNELS = {"aileron": 1, "elevator": 2, "throttle": 3, "rudder": 4}
"""Servo output of each input, unless parameters or card name another."""
FUNCTIONS = {4: "aileron", 19: "elevator", 21: "rudder", 70: "throttle"}
"""SERVOn_FUNCTION numbers as ArduPilot documents them."""
_SENSE = {"aileron": 1.0, "elevator": -1.0, "rudder": -1.0, "throttle": 1.0}
"""Sign of a flight record over that of ArduPilot: in a record, positive elevator is nose down and
positive rudder is nose left.
"""
_PX4_SURFACES = {
    1: ("aileron", "R", -1.0),
    2: ("aileron", "R", 1.0),
    15: ("aileron", "R", 1.0),
    3: ("elevator", "P", 1.0),
    4: ("rudder", "Y", 1.0),
}
_PX4_MOTOR, _PX4_SERVO = 101, 201


@dataclass(frozen=True)
class Output:
    """A servo output as the log's parameters describe it.

    Attributes
    ----------
    channel : int
        Counted from 1.
    low, neutral, high : float
        PWM, us; NaN if unknown.
    sense : float
        +1 if more PWM is positive in a flight record, -1 if negative, 0 if unknown.
    source : str
        Names of the parameters, for messages.
    """

    channel: int
    low: float
    neutral: float
    high: float
    sense: float
    source: str

    @property
    def spans(self) -> bool:
        """Whether both ends and the neutral are known and in order."""
        return self.low < self.neutral < self.high


def functions(parameters: Mapping[str, float]) -> dict[int, int]:
    """Return channel to SERVOn_FUNCTION number, without disabled channels."""
    by_channel = {n: parameters.get(f"SERVO{n}_FUNCTION", 0.0) for n in range(1, 33)}
    return {n: int(v) for n, v in by_channel.items() if v and math.isfinite(v)}


def outputs(parameters: Mapping[str, float]) -> dict[str, tuple[Output, ...]]:
    """Return input (aileron, elevator, rudder, throttle) to the outputs that move it.

    Inputs that no parameter describes are absent. Several outputs of one input share it equally.
    """
    by_name: dict[str, list[Output]] = {}
    # A damaged log may hold parameters that are not finite.
    parameters = {key: value for key, value in parameters.items() if math.isfinite(value)}
    for name, output in (
        _ardupilot(parameters)
        if functions(parameters)
        else (*_old_ardupilot(parameters), *_px4(parameters))
    ):
        by_name.setdefault(name, []).append(output)
    return {name: tuple(members) for name, members in by_name.items()}


def _ardupilot(parameters: Mapping[str, float]) -> Iterator[tuple[str, Output]]:
    """Yield inputs and outputs by SERVOn parameters (ArduPilot 3.8 and later)."""
    names = set()
    for n, function in functions(parameters).items():
        name = FUNCTIONS.get(function)
        if name is None or name in names:
            continue
        names.add(name)
        low, high, neutral, reversed_ = (
            parameters.get(f"SERVO{n}_{k}", math.nan) for k in ("MIN", "MAX", "TRIM", "REVERSED")
        )
        sense = 0.0 if math.isnan(reversed_) else _SENSE[name] * (-1.0 if reversed_ else 1.0)
        yield (
            name,
            Output(
                n, low, neutral, high, sense, f"SERVO{n}_FUNCTION, _MIN, _TRIM, _MAX, _REVERSED"
            ),
        )


def _old_ardupilot(parameters: Mapping[str, float]) -> Iterator[tuple[str, Output]]:
    """Yield inputs and outputs by RCn parameters (ArduPilot before 3.8)."""
    if any(key == "SYS_AUTOSTART" or key.startswith("RC_MAP_") for key in parameters):
        # PX4: its RCn_MIN and similar calibrate the receiver and do not describe servos.
        return
    for name, usual in USUAL_CHANNELS.items():
        n = int(
            parameters.get(
                {"aileron": "RCMAP_ROLL", "elevator": "RCMAP_PITCH", "rudder": "RCMAP_YAW"}.get(
                    name, ""
                ),
                usual,
            )
        )
        if f"RC{n}_REV" in parameters:
            low, high, neutral, direction = (
                parameters.get(f"RC{n}_{k}", math.nan) for k in ("MIN", "MAX", "TRIM", "REV")
            )
            yield (
                name,
                Output(
                    n,
                    low,
                    neutral,
                    high,
                    _SENSE[name] * math.copysign(1.0, direction),
                    f"RC{n}_MIN, _TRIM, _MAX, _REV",
                ),
            )


def _px4(parameters: Mapping[str, float]) -> Iterator[tuple[str, Output]]:
    """Yield inputs and outputs by PWM_MAIN and CA_SV parameters (PX4)."""
    for n in range(1, 17):
        function = int(parameters.get(f"PWM_MAIN_FUNC{n}", 0.0))
        low, high = (
            parameters.get(f"PWM_MAIN_MIN{n}", 1000.0),
            parameters.get(f"PWM_MAIN_MAX{n}", 2000.0),
        )
        direction = -1.0 if int(parameters.get("PWM_MAIN_REV", 0.0)) >> (n - 1) & 1 else 1.0
        if function == _PX4_MOTOR:
            yield (
                "throttle",
                Output(
                    n,
                    low,
                    0.5 * (low + high),
                    high,
                    direction,
                    f"PWM_MAIN_FUNC{n}, _MIN{n}, _MAX{n}, _REV",
                ),
            )
        k = function - _PX4_SERVO
        kind = (
            _PX4_SURFACES.get(int(parameters.get(f"CA_SV_CS{k}_TYPE", 0.0))) if 0 <= k < 8 else None
        )
        if kind is None:
            continue
        name, axis, usual = kind
        # Without a torque in the parameters the usual sign of the surface type applies.
        torque = parameters.get(f"CA_SV_CS{k}_TRQ_{axis}", 0.0) or usual
        neutral = 0.5 * (low + high) + 0.5 * (high - low) * parameters.get(f"CA_SV_CS{k}_TRIM", 0.0)
        sense = _SENSE[name] * direction * math.copysign(1.0, torque)
        yield (
            name,
            Output(
                n,
                low,
                neutral,
                high,
                sense,
                f"PWM_MAIN_FUNC{n}, _MIN{n}, _MAX{n}, _REV and CA_SV_CS{k}_*",
            ),
        )


def _number(word: str) -> float:
    """Return a number as ArduPilot reads it: no underscores, no digits of other scripts."""
    if "_" in word or not word.isascii():
        raise ValueError(word)
    return float(word)


def parse_parameters(text: str) -> dict[str, float]:
    r"""Parse a `.parm` or `.param` file: one name and value a line, # comments.

    Lines of QGroundControl, which have vehicle and component before the name and a type after the
    value, are accepted too.

    Raises
    ------
    ValueError
        With line number and text, for any other line, and for a file without parameters.

    Examples
    --------
    >>> parse_parameters("SERVO2_TRIM 1500\nSERVO2_REVERSED,1")
    {'SERVO2_TRIM': 1500.0, 'SERVO2_REVERSED': 1.0}
    """
    parameters: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) == 5 and words[0].isdigit() and words[1].isdigit():
            words = words[2:4]
        try:
            name, value = words[0], _number(words[1])
        except (IndexError, ValueError):
            raise ValueError(
                f"line {number}: '{line.strip()[:60]}' is no parameter; a line is a name and a"
                " number"
            ) from None
        plain = name.isascii() and name.replace("_", "").isalnum()
        if not plain or not math.isfinite(value):
            raise ValueError(
                f"line {number}: '{line.strip()[:60]}' is no parameter; a line is a name and a"
                " number"
            )
        parameters[name] = value
    if not parameters:
        raise ValueError(
            "holds no parameter; a line is a name and a number, such as SERVO2_TRIM 1500"
        )
    return parameters


PANEL_FUNCTIONS = {"elevon": (77, 78), "vtail": (79, 80)}
"""SERVOn_FUNCTION of the left and the right panel of a mix."""
COLUMNS = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}


@dataclass(frozen=True)
class Control:
    """How one command column is computed: weights times the deflections of servo channels.

    Attributes
    ----------
    parts : tuple of (channel, Servo, weight)
        Terms of the sum.
    basis : str
        Source of the channel, in a few words.
    description : str
        Channel, table and their sources, for a finding.
    conflicts : str
        Differences between card and log; "" if none.
    """

    parts: tuple[tuple[int, Servo, float], ...]
    basis: str
    description: str = ""
    conflicts: str = ""

    @property
    def label(self) -> str:
        """Label for the metadata of a record."""
        return (
            " ".join(f"{w:+g}*servo{c}" if w != 1.0 else f"servo{c}" for c, _, w in self.parts)
            + f" ({self.basis})"
        )


def deflection(pwm: FloatArray, servo: Servo) -> FloatArray:
    """Convert PWM [us], shape (n,), to deflection, limited to the stops.

    NaN where the output was off (500 us or less).

    Examples
    --------
    >>> servo = Servo(((1000.0, -20.0), (2000.0, 20.0)))
    >>> deflection(np.array([1500.0, 0.0]), servo)
    array([ 0., nan])
    """
    out = extrapolating_table(pwm, servo.table)
    out = np.clip(out, *servo.limits)
    return np.where(np.isfinite(pwm) & (pwm > 500.0), out, np.nan)


def extrapolating_table(x: FloatArray, table: Table) -> FloatArray:
    """Evaluate a piecewise linear table, its first and last slope continued beyond the ends."""
    xs, ys = (np.array(v, dtype=np.float64) for v in zip(*table, strict=True))
    out = np.interp(x, xs, ys)
    first = (ys[1] - ys[0]) / (xs[1] - xs[0])
    last = (ys[-1] - ys[-2]) / (xs[-1] - xs[-2])
    return np.where(
        x < xs[0],
        ys[0] + first * (x - xs[0]),
        np.where(x > xs[-1], ys[-1] + last * (x - xs[-1]), out),
    )


def controls(
    card: AirframeCard | None, parameters: Mapping[str, float]
) -> tuple[dict[str, Control], list[Finding]]:
    """Return command column to its control, and findings.

    Parameters of the log have priority over the card; degrees are always the card's. Without a
    card only the throttle can be computed.
    """
    described, by_channel = outputs(parameters), functions(parameters)
    out: dict[str, Control] = {}
    findings: list[Finding] = []
    if card is not None:
        for mix in card.mixes:
            _mixed(mix, "card", out)
        findings += _assumed_mixes(card, by_channel, out)
        for name in COLUMNS:
            if COLUMNS[name] in out or (name not in card.servos and name not in card.throws):
                continue
            control = (
                _control_by_log(card, name, described[name])
                if name in described
                else _control_by_card(card, name, bool(by_channel))
            )
            if control is not None:
                out[COLUMNS[name]] = control
    # Throttle needs no degrees: MIN and MAX are 0 and 100 %.
    if "throttle_pct" not in out and "throttle" in described:
        output = described["throttle"][0]
        low, high = _or_default(output.low, 1000.0), _or_default(output.high, 2000.0)
        if high > low:
            servo = Servo(((low, 0.0), (high, 100.0)), (0.0, 100.0), output.channel)
            out["throttle_pct"] = Control(
                ((output.channel, servo, 1.0),), "MIN and MAX of the log's parameters"
            )
    return out, findings


def _or_default(value: float, default: float) -> float:
    """Return the value, or a default for NaN."""
    return default if math.isnan(value) else value


def _assumed_mixes(
    card: AirframeCard, by_channel: Mapping[int, int], out: dict[str, Control]
) -> list[Finding]:
    """Add mixes that SERVOn_FUNCTION declares and the card lacks; return findings on the
    assumption.
    """
    findings = []
    for kind, panel_functions in PANEL_FUNCTIONS.items():
        channels = [
            next((n for n, f in by_channel.items() if f == side), None) for side in panel_functions
        ]
        servo = card.servos.get("elevator")
        if None in channels or servo is None or any(m.kind == kind for m in card.mixes):
            continue
        panels = [Servo(servo.table, servo.limits, channel) for channel in channels]
        _mixed(Mix(kind, panels[0], panels[1]), "SERVOn_FUNCTION", out)
        text = (
            f"outputs {channels[0]} and {channels[1]} are {kind} panels by SERVOn_FUNCTION; the"
            f" card has no [mixing.{kind}], so the elevator's table was used for both, + trailing"
            " edge down: check the signs"
        )
        findings.append(Finding("mixing-assumed", f"{kind}", "warning", text, {}))
    return findings


def _control_by_card(card: AirframeCard, name: str, has_functions: bool) -> Control | None:
    """Return the control by the card alone, on the card's or the usual channel; None if
    impossible.
    """
    servo = card.servos.get(name)
    if servo is None or (has_functions and not servo.channel):
        # The autopilot declares its outputs, and none of them drives this input.
        return None
    channel = servo.channel or USUAL_CHANNELS[name]
    basis = "card" if servo.channel else "usual order"
    return Control(
        ((channel, servo, 1.0),),
        basis,
        f"{_as_words(name, channel, servo)} by the card's servo_pwm",
    )


def _control_by_log(card: AirframeCard, name: str, members: tuple[Output, ...]) -> Control | None:
    """Return the control of an input whose outputs the log's parameters describe; None if
    impossible.
    """
    parts, descriptions, conflicts = [], [], []
    for output in members:
        table = _table(card, name, output)
        if table is None:
            return None
        servo, degrees = table
        parts.append((output.channel, servo, 1.0 / len(members)))
        descriptions.append(
            f"{_as_words(name, output.channel, servo)} by {output.source}, {degrees}"
        )
        conflicts += _conflicts(card.servos.get(name), servo, output)
    return Control(
        tuple(parts), members[0].source.split(",")[0], "; ".join(descriptions), "; ".join(conflicts)
    )


def _table(card: AirframeCard, name: str, output: Output) -> tuple[Servo, str] | None:
    """Return the servo table of an output, and where its degrees come from.

    The card's table keeps its slope, because MIN and MAX of an autopilot may not use the full
    throw.
    """
    card_servo, throw = card.servos.get(name), card.throws.get(name)
    limits = card_servo.limits if card_servo is not None else (-math.inf, math.inf)
    if name == "throttle":
        low, high = _or_default(output.low, 1000.0), _or_default(output.high, 2000.0)
        if card_servo is not None and not output.low < output.high:
            return card_servo, "the card's servo_pwm"
        ends = (0.0, 100.0) if output.sense >= 0.0 else (100.0, 0.0)
        return Servo(((low, ends[0]), (high, ends[1])), (0.0, 100.0), output.channel), "0 and 100 %"
    sense = output.sense or (
        1.0
        if card_servo is None
        else math.copysign(1.0, card_servo.table[-1][1] - card_servo.table[0][1])
    )
    if throw is not None and output.spans and (throw.key == "throw_deg" or card_servo is None):
        ends = (throw.low, throw.high) if sense > 0.0 else (throw.high, throw.low)
        table: Table = ((output.low, ends[0]), (output.neutral, 0.0), (output.high, ends[1]))
        return (
            Servo(table, limits, output.channel),
            f"degrees assumed: the card's {throw.key} at the ends of travel",
        )
    if card_servo is None:
        return None
    # The card's table, moved to the log's neutral and mirrored if the log reverses it.
    neutral = _neutral(card_servo)
    shift = _or_default(output.neutral, neutral) - neutral
    turn = 1.0 if sense * (card_servo.table[-1][1] - card_servo.table[0][1]) > 0.0 else -1.0
    if turn < 0.0:  # the other way round about the neutral
        table = tuple(
            (2.0 * neutral - pwm + shift, angle) for pwm, angle in reversed(card_servo.table)
        )
    else:
        table = tuple((pwm + shift, angle) for pwm, angle in card_servo.table)
    return Servo(table, card_servo.limits, output.channel), "degrees per us by the card's servo_pwm"


def _neutral(servo: Servo) -> float:
    """Return the PWM of zero deflection, us."""
    rows = sorted(servo.table, key=lambda row: row[1])
    return float(np.interp(0.0, [angle for _, angle in rows], [pwm for pwm, _ in rows]))


_SAME_NEUTRAL_US = 5.0


def _conflicts(card_servo: Servo | None, used: Servo, output: Output) -> list[str]:
    """Return the differences between the card's servo and the one in use, as sentences."""
    if card_servo is None:
        return []
    conflicts = []
    if card_servo.channel not in (None, output.channel):
        conflicts.append(f"the card says channel {card_servo.channel}, the log {output.channel}")
    if (card_servo.table[-1][1] - card_servo.table[0][1]) * (
        used.table[-1][1] - used.table[0][1]
    ) < 0.0:
        conflicts.append(f"servo {output.channel} turns the other way in the card")
    if (
        abs(_neutral(card_servo) - _neutral(used)) > _SAME_NEUTRAL_US
        and used.table[0][1] * used.table[-1][1] < 0.0
    ):
        conflicts.append(
            f"the neutral of servo {output.channel} is {_neutral(used):g} us in the log,"
            f" {_neutral(card_servo):g} us in the card"
        )
    return conflicts


def _as_words(name: str, channel: int, servo: Servo) -> str:
    """Describe channel and table of an input."""
    pwm = "/".join(f"{p:g}" for p, _ in servo.table)
    angles = "/".join(f"{a:g}" for _, a in servo.table)
    return f"{name} is servo {channel}, {pwm} us = {angles} {'%' if name == 'throttle' else 'deg'}"


def _mixed(mix: Mix, basis: str, out: dict[str, Control]) -> None:
    """Add the two controls of a v-tail or of elevons."""
    first, second = mix.outputs
    left_channel, right_channel = mix.left.channel or 0, mix.right.channel or 0
    out[COLUMNS[first]] = Control(
        ((left_channel, mix.left, 0.5), (right_channel, mix.right, 0.5)), f"{mix.kind}, {basis}"
    )
    out[COLUMNS[second]] = Control(
        ((left_channel, mix.left, 0.5), (right_channel, mix.right, -0.5)), f"{mix.kind}, {basis}"
    )


def elevator_channel(parameters: Mapping[str, float]) -> int:
    """Return the servo output that pitches the aircraft, for checks that need its activity only."""
    for n, function in functions(parameters).items():
        if function in (19, 77, 79):
            return n
    return USUAL_CHANNELS["elevator"]


# Re-timing of command steps. A servo output logged at 25 Hz is known to 40 ms: a step happened
# at some time between the last sample without it and the first sample with it. It causes a kink
# in the angular rate of its axis, which the gyro locates. Filters delay all kinks by one common
# time, which is estimated from all steps together; otherwise about half of them would be placed
# on the wrong side.

MIN_STEP_DEG = 1.0
"""Steps below this size, deg, cause no visible kink."""
MAX_LATE_S = 0.05
"""Longest delay of the kinks after the steps, s: gyro filter and servo lag."""
_AROUND_S = 0.08  # time on either side of the step to which the kink is fitted
_MIN_ROWS = 4  # minimum number of rows on either side
# Delays whose sums of squares differ by less than this many noise variances are equally good.
_MISFIT_TOLERANCE = 4.0
_FINE_S = 0.001
_KINK_PARAMETERS = 4
_PLACED_PROBABILITY = 0.9  # probability from which a step counts as placed


@dataclass(frozen=True)
class PlacedSteps:
    """Result of `place_steps`.

    Attributes
    ----------
    command : ndarray of shape (n,)
        Re-timed command, deg.
    steps : int
        Steps that were placed with a probability above 0.9.
    late_s : float
        Delay of the kinks after the steps, s; NaN without steps.
    """

    command: FloatArray
    steps: int
    late_s: float


@dataclass(frozen=True)
class _Step:
    """A step first logged at ``row``.

    ``misfit`` has shape (places, offsets): the sum of squares of a fit with a kink that much after
    each possible place.
    """

    row: int
    places: Sequence[int]
    misfit: FloatArray


def place_steps(
    command: FloatArray, logged: NDArray[np.bool_], rate: FloatArray, noise: float, dt_s: float
) -> PlacedSteps:
    """Estimate a command between its logged rows from the angular rate of its axis.

    An isolated step happened at one of the rows since the logged sample before it. The probability
    of each row follows from the fit of a kink of the rate there, delayed by the one time that fits
    all steps best; the command between is its expected value. All other rows are interpolated
    linearly: for a command that moves all the time, a held value would be late on average.

    Parameters
    ----------
    command : ndarray of shape (n,)
        Command, held between logged rows, deg.
    logged : ndarray of bool, shape (n,)
        Rows at which it was logged.
    rate : ndarray of shape (n,)
        Angular rate of its axis, rad/s.
    noise : float
        Standard deviation of the rate, rad/s.
    dt_s : float
        Step of the rows, s.

    Returns
    -------
    PlacedSteps
        Re-timed command, number of certain steps, and delay of the kinks.
    """
    rows = np.flatnonzero(logged)
    out = (
        np.interp(np.arange(len(command)), rows, command[rows])
        if rows.size
        else np.array(command, dtype=float)
    )
    offsets = np.arange(0.0, MAX_LATE_S + 0.5 * _FINE_S, _FINE_S) / dt_s
    around = max(_MIN_ROWS, round(_AROUND_S / dt_s))
    steps = list(_steps(command, rows.tolist(), rate, offsets, around))
    if not steps:
        return PlacedSteps(out, 0, float("nan"))
    # The smallest delay that is not significantly worse than the best one, common to all steps.
    total_misfit = np.sum([s.misfit.min(axis=0) for s in steps], axis=0)
    late = int(np.flatnonzero(total_misfit <= total_misfit.min() + _MISFIT_TOLERANCE * noise**2)[0])
    placed = 0
    for s in steps:
        misfit = s.misfit[:, late]
        # Probability of each place from a Gaussian likelihood.
        variance = max(noise**2, float(misfit.min()) / (2 * around - _KINK_PARAMETERS))
        likelihood = np.exp(-0.5 * (misfit - misfit.min()) / variance)
        likelihood /= likelihood.sum()
        before = command[s.places[0] - 1]
        out[s.places[0] : s.row + 1] = before + np.cumsum(likelihood) * (command[s.row] - before)
        placed += int(likelihood.max() > _PLACED_PROBABILITY)
    return PlacedSteps(out, placed, late * _FINE_S)


def logged_rows(command: FloatArray, stride: int) -> NDArray[np.bool_]:
    """Return the rows at which a held command was logged, about every ``stride`` rows.

    These are the rows at which it changes, and the rows ``stride`` before, at which it had not
    changed. While the command is constant the choice of rows has no effect, and no regular clock
    is assumed.

    Parameters
    ----------
    command : ndarray of shape (n,)
        Command, held between its samples.
    stride : int
        Rows between two logged samples.

    Returns
    -------
    ndarray of bool, shape (n,)
        True at logged rows.
    """
    changes = np.flatnonzero(np.diff(command) != 0.0) + 1
    last = np.concatenate([[0], changes[:-1]])
    out = np.zeros(len(command), dtype=bool)
    out[changes] = out[np.maximum(changes - stride, last)] = True
    return out


def _steps(
    command: FloatArray, rows: list[int], rate: FloatArray, offsets: FloatArray, around: int
) -> Iterator[_Step]:
    """Yield the isolated steps, with the misfit of a kink at each possible place and delay."""
    for before, row in pairwise(rows):
        size = command[row] - command[before]
        first, last = before - around + 1, row + around + 1
        if row - before < 2 or not abs(size) > MIN_STEP_DEG or first < 0 or last > len(rate):
            continue
        at, axis_rate = np.arange(first, last), rate[first:last]
        other_steps = np.abs(
            np.diff(np.concatenate([command[first : before + 1], command[row + 1 : last]]))
        )
        # The step itself must be one jump: nothing may follow within its interval.
        other_steps[before - first] = abs(command[min(row + 1, len(command) - 1)] - command[row])
        if not np.isfinite(axis_rate).all() or other_steps.max(initial=0.0) > MIN_STEP_DEG:
            continue
        places = range(before + 1, row + 1)
        yield _Step(
            row,
            places,
            np.array(
                [[_misfit(at.astype(float), axis_rate, p + o) for o in offsets] for p in places]
            ),
        )


def _misfit(at: FloatArray, rate: FloatArray, kink: float) -> float:
    """Return the sum of squares of the rate about a line that turns into a parabola at ``kink``.

    The parabola allows for damping after the turn.
    """
    after = np.maximum(at - kink, 0.0)
    design = np.column_stack([np.ones_like(at), at - kink, after, after**2])
    return float(np.sum((rate - design @ np.linalg.lstsq(design, rate, rcond=None)[0]) ** 2))
