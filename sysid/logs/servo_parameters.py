"""What an autopilot's parameters say of its servo outputs: channel, PWM at the ends and at neutral, and the sense. Pure numerics.

ArduPilot: SERVOn_FUNCTION, _MIN, _MAX, _TRIM, _REVERSED; before version 3.8 RCn_MIN, _MAX, _TRIM, _REV in the usual order. A
positive demand, which raises the PWM unless reversed, rolls right, pitches up and yaws right. PX4: PWM_MAIN_FUNCn, _MINn, _MAXn,
_REV and CA_SV_CSi_TYPE, _TRQ_R, _TRQ_P, _TRQ_Y, _TRIM; torques are positive right wing down, nose up and nose right.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

USUAL = {"aileron": 1, "elevator": 2, "throttle": 3, "rudder": 4}
FUNCTIONS = {4: "aileron", 19: "elevator", 21: "rudder", 70: "throttle"}
"""SERVOn_FUNCTION numbers as ArduPilot documents them."""
_SENSE = {"aileron": 1.0, "elevator": -1.0, "rudder": -1.0, "throttle": 1.0}
"""Of a flight record's sign over the autopilot's: + elevator is nose down there, + rudder nose left."""
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
    """A servo output.

    channel  counted from 1          low, neutral, high  PWM, us; NaN where the parameters do not say
    sense    +1 where more PWM is + in a flight record, -1 where it is -, 0 where the parameters do not say
    source   the parameters' names, for messages
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
    """SERVOn_FUNCTION of a log: channel -> function number, the disabled ones left out."""
    found = {n: parameters.get(f"SERVO{n}_FUNCTION", 0.0) for n in range(1, 33)}
    return {n: int(v) for n, v in found.items() if v and math.isfinite(v)}


def outputs(parameters: Mapping[str, float]) -> dict[str, tuple[Output, ...]]:
    """aileron, elevator, rudder, throttle -> the outputs that move it, in equal parts; without a name where none is described."""
    found: dict[str, list[Output]] = {}
    # A damaged log may hold any number, also none.
    parameters = {key: value for key, value in parameters.items() if math.isfinite(value)}
    for name, output in (
        _ardupilot(parameters)
        if functions(parameters)
        else (*_old_ardupilot(parameters), *_px4(parameters))
    ):
        found.setdefault(name, []).append(output)
    return {name: tuple(members) for name, members in found.items()}


def _ardupilot(parameters: Mapping[str, float]) -> Iterator[tuple[str, Output]]:
    seen = set()
    for n, function in functions(parameters).items():
        name = FUNCTIONS.get(function)
        if name is None or name in seen:
            continue
        seen.add(name)
        low, high, neutral, turned = (
            parameters.get(f"SERVO{n}_{k}", math.nan) for k in ("MIN", "MAX", "TRIM", "REVERSED")
        )
        sense = 0.0 if math.isnan(turned) else _SENSE[name] * (-1.0 if turned else 1.0)
        yield (
            name,
            Output(
                n, low, neutral, high, sense, f"SERVO{n}_FUNCTION, _MIN, _TRIM, _MAX, _REVERSED"
            ),
        )


def _old_ardupilot(parameters: Mapping[str, float]) -> Iterator[tuple[str, Output]]:
    if any(key == "SYS_AUTOSTART" or key.startswith("RC_MAP_") for key in parameters):
        return  # PX4: its RCn_MIN and the like calibrate the receiver's inputs and say nothing of servos
    for name, usual in USUAL.items():
        n = int(
            parameters.get(
                {"aileron": "RCMAP_ROLL", "elevator": "RCMAP_PITCH", "rudder": "RCMAP_YAW"}.get(
                    name, ""
                ),
                usual,
            )
        )
        if f"RC{n}_REV" in parameters:
            low, high, neutral, turned = (
                parameters.get(f"RC{n}_{k}", math.nan) for k in ("MIN", "MAX", "TRIM", "REV")
            )
            yield (
                name,
                Output(
                    n,
                    low,
                    neutral,
                    high,
                    _SENSE[name] * math.copysign(1.0, turned),
                    f"RC{n}_MIN, _TRIM, _MAX, _REV",
                ),
            )


def _px4(parameters: Mapping[str, float]) -> Iterator[tuple[str, Output]]:
    for n in range(1, 17):
        function = int(parameters.get(f"PWM_MAIN_FUNC{n}", 0.0))
        low, high = (
            parameters.get(f"PWM_MAIN_MIN{n}", 1000.0),
            parameters.get(f"PWM_MAIN_MAX{n}", 2000.0),
        )
        turned = -1.0 if int(parameters.get("PWM_MAIN_REV", 0.0)) >> (n - 1) & 1 else 1.0
        if function == _PX4_MOTOR:
            yield (
                "throttle",
                Output(
                    n,
                    low,
                    0.5 * (low + high),
                    high,
                    turned,
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
        torque = parameters.get(f"CA_SV_CS{k}_TRQ_{axis}", 0.0) or usual
        neutral = 0.5 * (low + high) + 0.5 * (high - low) * parameters.get(f"CA_SV_CS{k}_TRIM", 0.0)
        sense = _SENSE[name] * turned * math.copysign(1.0, torque)
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
    """Read a number as ArduPilot does: Python's underscores and digits of other scripts are none."""
    if "_" in word or not word.isascii():
        raise ValueError(word)
    return float(word)


def parse_parameters(text: str) -> dict[str, float]:
    """Parameters of a `.parm` or `.param` file: a name and a value a line, with blanks, a comma or tabs between; # comments.

    QGroundControl's lines have vehicle and component in front of the name and a type behind the value. Raises ValueError with the
    line's number and text for a line that is neither.
    """
    found: dict[str, float] = {}
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
                f"line {number}: '{line.strip()[:60]}' is no parameter; a line is a name and a number"
            ) from None
        plain = name.isascii() and name.replace("_", "").isalnum()
        if not plain or not math.isfinite(value):
            raise ValueError(
                f"line {number}: '{line.strip()[:60]}' is no parameter; a line is a name and a number"
            )
        found[name] = value
    if not found:
        raise ValueError(
            "holds no parameter; a line is a name and a number, such as SERVO2_TRIM 1500"
        )
    return found
