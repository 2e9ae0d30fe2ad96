"""Write a FlightRecord as a DataFlash .bin, with ArduPlane's message names, columns and units.

Tests and simulated flights use it to make logs that pass through the whole import. Servo outputs
are whole microseconds (0.5 us is 0.025 deg at 20 deg per 400 us), positions 1e-7 degrees (1.1 cm),
times whole microseconds, everything else 32-bit floats. Measured alpha and beta also go into a
message VANE (degrees), because ArduPlane's AOA is an estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray, runs
from sysid.errors import LogError
from sysid.logs.card import AirframeCard, Mix, Servo
from sysid.logs.dataflash import CHARACTERS, FMT_LENGTH, FMT_TYPE, MAGIC, Format
from sysid.logs.servo import FUNCTIONS, PANEL_FUNCTIONS, USUAL_CHANNELS
from sysid.record import FlightRecord
from sysid.units import SEA_LEVEL_KGPM3
from sysid.vocabulary import MANOEUVRE_TEXT, MODE_NUMBERS

_FUNCTION = {name: number for number, name in FUNCTIONS.items()}
_DEFAULT_START = {"lat_deg": 45.0, "lon_deg": 0.0, "alt_m": 0.0}

_FMT = Format(FMT_TYPE, FMT_LENGTH, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
_LAYOUT = {
    "PARM": ("QNff", "TimeUS,Name,Value,Default"),
    "MSG": ("QZ", "TimeUS,Message"),
    "MODE": ("QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "IMU": ("QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "ATT": ("QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
    "RCOU": ("QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14"),
    "ARSP": ("QBffcffBBffB", "TimeUS,I,Airspeed,DiffPress,Temp,RawPress,Offset,U,H,Hp,TR,Pri"),
    "CTUN": ("QccccffffBffi", "TimeUS,NavRoll,Roll,NavPitch,Pitch,ThO,RdO,ThD,As,AsT,SAs,E2T,GU"),
    "BARO": ("QBfffcfIffBf", "TimeUS,I,Alt,AltAMSL,Press,Temp,CRt,SMS,Offset,GndTemp,H,CPress"),
    "GPS": ("QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    "AOA": ("Qff", "TimeUS,AOA,SSA"),
    "VANE": ("Qff", "TimeUS,Alpha,Beta"),
    "SURF": ("Qffff", "TimeUS,Elev,Ail,Rud,Thr"),
    "RPM": ("Qff", "TimeUS,rpm1,rpm2"),
    "NTUN": ("QfcccfffLLeee", "TimeUS,Dist,TBrg,NavBrg,AltE,XT,XTi,AsE,TLat,TLng,TAW,TAT,TAsp"),
    "TECS": ("QfffffffffffffB", "TimeUS,h,dh,hin,hdem,dhdem,spdem,sp,dsp,th,ph,pmin,pmax,dspdem,f"),
}


def _format(name: str) -> Format:
    """Return the format of a message of _LAYOUT."""
    characters, columns = _LAYOUT[name]
    layout = Format(10 + list(_LAYOUT).index(name), 0, name, characters, tuple(columns.split(",")))
    return Format(layout.type, layout.dtype.itemsize + 3, name, characters, layout.columns)


@dataclass
class _Message:
    """Rows of one message type as columns in the field's unit; scalars count for all rows."""

    name: str
    time_us: NDArray[np.int64]
    values: dict[str, Any] = field(default_factory=dict)

    def bytes(self) -> NDArray[np.uint8]:
        """Return the records as bytes, shape (n, length), headers included."""
        fmt = _format(self.name)
        n = len(self.time_us)
        header = np.dtype([("magic", "S2"), ("type", "u1")])
        full = np.zeros(n, dtype=np.dtype([("head", header), ("body", fmt.dtype)]))
        full["head"]["magic"] = MAGIC
        full["head"]["type"] = fmt.type
        full["body"]["TimeUS"] = self.time_us
        for column, values in self.values.items():
            kind, multiplier = CHARACTERS[fmt.characters[fmt.columns.index(column)]]
            full["body"][column] = _stored(np.asarray(values), kind, multiplier)
        return np.frombuffer(full.tobytes(), dtype=np.uint8).reshape(n, fmt.length)


def _stored(values: NDArray[Any], kind: str, multiplier: float) -> NDArray[Any]:
    """Convert values to the stored type of a field."""
    if kind.startswith("S"):
        return np.array([str(v).encode("latin-1", "replace") for v in np.atleast_1d(values)])
    if kind[1] == "f":
        return values.astype(kind)
    info = np.iinfo(kind)
    # NaN has no integer; an autopilot writes 0 for an output or position that it does not have.
    integers = np.rint(np.nan_to_num(values.astype(np.float64) / multiplier, nan=0.0))
    return np.clip(integers, info.min, info.max).astype(kind)


def write_dataflash(
    record: FlightRecord,
    path: Path,
    card: AirframeCard | None = None,
    parameters: Mapping[str, float] | None = None,
    vehicle: str = "ArduPlane (written by uqharness)",
    surfaces: bool = False,
) -> tuple[str, ...]:
    """Write a record as a binary DataFlash log.

    Parameters
    ----------
    record : FlightRecord
        Record to write.
    path : Path
        File to create.
    card : AirframeCard, optional
        Servo tables, required if the record has surface or throttle commands.
    parameters : mapping, optional
        Further PARM records.
    vehicle : str
        Text of the first message to the pilot.
    surfaces : bool
        Also write the exact commands (message SURF), for simulated flights without PWM.

    Returns
    -------
    tuple of str
        Columns that DataFlash has no message for, and that were left out.

    Raises
    ------
    LogError
        If a time is negative, the card is missing, or it lacks a servo table.
    """
    time = record["time_s"]
    if len(time) and time[0] < 0:
        raise LogError(
            f"the record begins at {time[0]:.3f} s; DataFlash times cannot be negative: shift"
            " time_s",
            path,
        )
    time_us = np.rint(time * 1e6).astype(np.int64)
    stored = {"time_s"}
    messages = _sensors(record, time_us, stored)
    servo_parameters: dict[str, float] = {}
    outputs = _servo_outputs(record, card, servo_parameters, stored, path)
    if outputs:
        messages.append(_Message("RCOU", time_us, {f"C{n}": pwm for n, pwm in outputs.items()}))
    if outputs and surfaces:
        messages.append(_surfaces(record, time_us))
    # The first message names the vehicle, as an autopilot does at start.
    texts = [
        (int(time_us[0]) if len(time_us) else 0, vehicle),
        *_manoeuvre_texts(record, time_us, stored),
    ]
    messages.insert(
        0, _Message("MSG", np.array([t for t, _ in texts]), {"Message": [m for _, m in texts]})
    )
    all_parameters = {**servo_parameters, **(parameters or {})}
    if all_parameters:
        start = np.full(len(all_parameters), time_us[0] if len(time_us) else 0)
        rows = {
            "Name": list(all_parameters),
            "Value": list(all_parameters.values()),
            "Default": list(all_parameters.values()),
        }
        messages.insert(0, _Message("PARM", start, rows))
    if "mode" in record:
        messages.append(_modes(record, time_us, stored))
    with path.open("wb") as handle:
        handle.write(_formats())
        handle.write(_interleave(messages))
    return tuple(n for n in record.columns if n not in stored)


def _sensors(record: FlightRecord, time_us: NDArray[np.int64], stored: set[str]) -> list[_Message]:
    """Return the messages of sensors and estimates; add their columns to ``stored``."""

    def column(name: str, factor: float = 1.0) -> FloatArray | float:
        """Return a column in the unit of the field and mark it as stored; 0 if it is absent."""
        if name not in record:
            return 0.0
        stored.add(name)
        return record[name] * factor

    def any_of(*names: str) -> bool:
        """Return whether the record has any of these columns."""
        return any(n in record for n in names)

    degrees = 180.0 / np.pi
    n = len(time_us)
    out = []
    # Airspeed sensors show equivalent airspeed: true airspeed over EAS2TAS.
    ratio: FloatArray = np.ones(n)
    if "rho_kgpm3" in record:
        ratio = np.sqrt(
            SEA_LEVEL_KGPM3 / np.where(record["rho_kgpm3"] > 0, record["rho_kgpm3"], np.nan)
        )
        stored.add("rho_kgpm3")
        out.append(_Message("CTUN", time_us, {"E2T": ratio, "As": column("V_mps") / ratio}))
    # Inertial sensors; health flags of 1, which readers look at.
    if any_of("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2"):
        pairs = {
            "GyrX": "p_radps",
            "GyrY": "q_radps",
            "GyrZ": "r_radps",
            "AccX": "ax_mps2",
            "AccY": "ay_mps2",
            "AccZ": "az_mps2",
        }
        out.append(
            _Message("IMU", time_us, {**{c: column(s) for c, s in pairs.items()}, "GH": 1, "AH": 1})
        )
    # Attitude and airspeed, in the units of the format: degrees, m/s.
    if any_of("phi_rad", "theta_rad", "psi_rad"):
        pairs = {"Roll": "phi_rad", "Pitch": "theta_rad", "Yaw": "psi_rad"}
        out.append(_Message("ATT", time_us, {c: column(s, degrees) for c, s in pairs.items()}))
    if "V_mps" in record:
        out.append(
            _Message(
                "ARSP", time_us, {"Airspeed": column("V_mps") / ratio, "U": 1, "H": 1, "Hp": 1.0}
            )
        )
    if "h_m" in record:
        out.append(
            _Message("BARO", time_us, {"Alt": column("h_m"), "AltAMSL": column("h_m"), "H": 1})
        )
    # AOA is ArduPilot's estimate; VANE says that a sensor measured it.
    if any_of("alpha_rad", "beta_rad"):
        angles = column("alpha_rad", degrees), column("beta_rad", degrees)
        out.append(_Message("AOA", time_us, {"AOA": angles[0], "SSA": angles[1]}))
        if not {"alpha_rad", "beta_rad"} & set(record.metadata.estimates):
            out.append(_Message("VANE", time_us, {"Alpha": angles[0], "Beta": angles[1]}))
    # Position needs all of its columns: half a GPS fix is none.
    if all(n in record for n in ("north_m", "east_m", "vn_mps", "ve_mps")):
        out.append(_gps(record, time_us, column))
    if "rpm" in record:
        out.append(_Message("RPM", time_us, {"rpm1": column("rpm")}))
    if "cross_track_m" in record:
        out.append(_Message("NTUN", time_us, {"XT": column("cross_track_m")}))
    # Demands of the autopilot, beside the height that it sees.
    if any_of("h_demand_m", "V_demand_mps"):
        rows = {
            "hdem": column("h_demand_m"),
            "spdem": column("V_demand_mps") / ratio,
            "h": column("h_m"),
        }
        out.append(_Message("TECS", time_us, rows))
    return out


def _gps(record: FlightRecord, time_us: NDArray[np.int64], column: Any) -> _Message:
    """Return GPS messages: positions on the WGS 84 ellipsoid about the start point."""
    start = {**_DEFAULT_START, **record.metadata.start}
    lat0 = np.radians(start["lat_deg"])
    w = 1.0 - 6.69437999014e-3 * np.sin(lat0) ** 2
    meridian = 6378137.0 * (1.0 - 6.69437999014e-3) / w**1.5
    parallel = 6378137.0 / np.sqrt(w) * np.cos(lat0)
    vn, ve = column("vn_mps"), column("ve_mps")
    rows = {
        "Status": 3,
        "NSats": 10,
        "HDop": 1.0,
        "Lat": start["lat_deg"] + np.degrees(column("north_m") / meridian),
        "Lng": start["lon_deg"] + np.degrees(column("east_m") / parallel),
        "Alt": start["alt_m"] + column("h_m"),
        "Spd": np.hypot(vn, ve),
        "GCrs": np.mod(np.degrees(np.arctan2(ve, vn)), 360.0),
        "VZ": column("vd_mps"),
        "U": 1,
    }
    return _Message("GPS", time_us, rows)


def _servo_outputs(
    record: FlightRecord,
    card: AirframeCard | None,
    parameters: dict[str, float],
    stored: set[str],
    path: Path,
) -> dict[int, FloatArray]:
    """Return servo channel to PWM, and add their SERVOn parameters."""
    commands = {n: f"{n}_deg" if n != "throttle" else "throttle_pct" for n in USUAL_CHANNELS}
    commands = {n: c for n, c in commands.items() if c in record}
    if not commands:
        return {}
    if card is None:
        raise LogError(
            f"the record has {sorted(commands.values())}; their PWM needs an airframe card", path
        )
    # Mixed pairs (elevons, v-tails) use two commands at once.
    out: dict[int, FloatArray] = {}
    for mix in card.mixes:
        first, second = mix.outputs
        if first in commands and second in commands:
            out |= _panels(
                mix, record[commands.pop(first)], record[commands.pop(second)], parameters
            )
            stored |= {f"{first}_deg", f"{second}_deg"}
    # A surface without a mix has a servo.
    for name, column in commands.items():
        servo = card.servos.get(name)
        if servo is None:
            raise LogError(
                f"{column} has no [inputs.{name}] servo_pwm in {card.path or card.name}; add it",
                path,
            )
        channel = servo.channel or USUAL_CHANNELS[name]
        out[channel] = pwm_of(record[column], servo)
        _describe(channel, _FUNCTION[name], servo, parameters)
        stored.add(column)
    return out


def _surfaces(record: FlightRecord, time_us: NDArray[np.int64]) -> _Message:
    """Return the exact commands, which PWM rounds to a twentieth of a degree."""
    columns = {
        "Elev": "elevator_deg",
        "Ail": "aileron_deg",
        "Rud": "rudder_deg",
        "Thr": "throttle_pct",
    }
    missing = np.full(len(time_us), np.nan)
    return _Message(
        "SURF", time_us, {f: record.columns.get(c, missing) for f, c in columns.items()}
    )


def _panels(
    mix: Mix, first: FloatArray, second: FloatArray, parameters: dict[str, float]
) -> dict[int, FloatArray]:
    """Return the PWM of the two panels of a v-tail or of elevons."""
    out = {}
    for servo, deflection, function in zip(
        (mix.left, mix.right),
        (first + second, first - second),
        PANEL_FUNCTIONS[mix.kind],
        strict=True,
    ):
        channel = servo.channel or 0
        out[channel] = pwm_of(deflection, servo)
        _describe(channel, function, servo, parameters)
    return out


def _describe(channel: int, function: int, servo: Servo, parameters: dict[str, float]) -> None:
    """Add the SERVOn parameters of one output."""
    pwm = [p for p, _ in servo.table]
    middle = float(pwm_of(np.zeros(1), servo)[0]) if function != _FUNCTION["throttle"] else pwm[0]
    # ArduPilot's positive elevator is nose up and its rudder nose right; a record has opposite
    # signs.
    rising = servo.table[-1][1] > servo.table[0][1]
    is_reversed = rising if function in (_FUNCTION["elevator"], _FUNCTION["rudder"]) else not rising
    settings = {
        "FUNCTION": function,
        "MIN": pwm[0],
        "MAX": pwm[-1],
        "TRIM": middle,
        "REVERSED": float(is_reversed),
    }
    parameters.update({f"SERVO{channel}_{k}": float(v) for k, v in settings.items()})


def pwm_of(deflection: FloatArray, servo: Servo) -> FloatArray:
    """Convert deflection, shape (n,), to PWM between 800 and 2200 us by the inverse of a servo
    table.

    The end slopes are continued; NaN stays NaN. Raises LogError if the table is not monotone.
    """
    pwm, angle = (np.array(v) for v in zip(*servo.table, strict=True))
    if angle[-1] < angle[0]:
        pwm, angle = pwm[::-1], angle[::-1]
    if np.any(np.diff(angle) <= 0):
        raise LogError(f"the servo table {servo.table} is not monotone and cannot be inverted")
    out = np.interp(deflection, angle, pwm)
    # Continue the first and last slope beyond the ends of the table.
    low = pwm[0] + (deflection - angle[0]) * (pwm[1] - pwm[0]) / (angle[1] - angle[0])
    high = pwm[-1] + (deflection - angle[-1]) * (pwm[-1] - pwm[-2]) / (angle[-1] - angle[-2])
    out = np.where(deflection < angle[0], low, np.where(deflection > angle[-1], high, out))
    return np.clip(out, 800.0, 2200.0)


def _manoeuvre_texts(
    record: FlightRecord, time_us: NDArray[np.int64], stored: set[str]
) -> list[tuple[int, str]]:
    """Return messages to the pilot that mark the begin and end of manoeuvres."""
    if "manoeuvre" not in record:
        return []
    stored.add("manoeuvre")
    labels = record["manoeuvre"]
    changes = [run.start for run in runs(labels)]
    # The autopilot's message holds 64 characters.
    return [
        (int(time_us[k]), f"{MANOEUVRE_TEXT}{labels[k] or 'end'}"[:64])
        for k in changes
        if k or labels[k]
    ]


def _modes(record: FlightRecord, time_us: NDArray[np.int64], stored: set[str]) -> _Message:
    """Return the messages of changes of the flight mode."""
    stored.add("mode")
    modes = record["mode"]
    changes = [run.start for run in runs(modes)]
    numbers = np.array([MODE_NUMBERS.get(str(modes[k]), 0) for k in changes])
    return _Message("MODE", time_us[changes], {"Mode": numbers, "ModeNum": numbers})


def _formats() -> bytes:
    """Return the FMT records of all messages."""
    out = []
    for fmt in (_FMT, *(_format(n) for n in _LAYOUT)):
        body = np.zeros(1, dtype=_FMT.dtype)
        body["Type"], body["Length"], body["Name"] = fmt.type, fmt.length, fmt.name.encode()
        body["Format"], body["Columns"] = fmt.characters.encode(), ",".join(fmt.columns).encode()
        out.append(MAGIC + bytes([FMT_TYPE]) + body.tobytes())
    return b"".join(out)


def _interleave(messages: list[_Message]) -> bytes:
    """Return all records in order of time; records of one time in the order of ``messages``."""
    blocks = [m.bytes() for m in messages if len(m.time_us)]
    times = np.concatenate([m.time_us for m in messages if len(m.time_us)])
    lengths = np.concatenate([np.full(len(b), b.shape[1]) for b in blocks])
    order = np.argsort(times, kind="stable")
    # Byte offset of every record in the file, then copy message by message.
    starts = np.empty(len(order), dtype=np.int64)
    starts[order] = np.concatenate([[0], np.cumsum(lengths[order])[:-1]])
    out = np.empty(int(lengths.sum()), dtype=np.uint8)
    done = 0
    for block in blocks:
        at = starts[done : done + len(block)]
        out[at[:, None] + np.arange(block.shape[1])] = block
        done += len(block)
    return out.tobytes()
