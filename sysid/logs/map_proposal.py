"""Propose a signal map for a log: field, unit and sign of each signal, with the evidence.

Fields are matched to signals by name. The unit comes from the name, from a line of units or from
the size of the values. Units and signs are then tested by the kinematic relations between channels
(`sysid.logs.checking.physics`), and corrected where they contradict them. The result is TOML to be
read and edited, with a comment on the evidence for each signal.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import LogError
from sysid.foreign.raw import MessageTable, ProgressCallback, RawLog, TimeColumn
from sysid.logs.assemble import assemble
from sysid.logs.card import AirframeCard, read_card
from sysid.logs.channels import Times, resolve
from sysid.logs.checking.physics import evaluate_laws
from sysid.logs.csv_dialects import CSV_DIALECTS
from sysid.logs.detect import detect
from sysid.logs.load import map_of_dialect, read_raw
from sysid.logs.sensors import Sensors
from sysid.logs.signal_map import Entry, SignalMap
from sysid.record import FlightRecord
from sysid.units import FT_M, G0_MPS2, UNITS
from sysid.vocabulary import LABELS, SIGNALS

_RAD = math.pi / 180.0
_SUFFIXES = frozenset(u for units in UNITS.values() for u in units if u.isalnum()) - {"n", "gs"}


def _axes(signals: Sequence[str], patterns: str, names: Sequence[Sequence[str]]) -> dict[str, str]:
    """Return patterns of three signals that differ in the words of their axis."""
    return {
        signal: "|".join(patterns.replace("AXIS", f"(?:{'|'.join(words)})").split())
        for signal, words in zip(signals, names, strict=True)
    }


_XYZ = (
    ("x", "lon", "longitudinal", "0"),
    ("y", "lat", "lateral", "1"),
    ("z", "norm", "normal", "vert", "vertical", "2"),
)
_BODY = (("x", "roll", "0"), ("y", "pitch", "1"), ("z", "yaw", "2"))
_LETTERS = {"p_radps": "p", "q_radps": "q", "r_radps": "r"}
_RATE = (
    "(?:imu_)?gyro?_?AXIS AXIS_?gyro? AXIS_?rate AXIS_?speed omega_?AXIS w_?AXIS rate_?AXIS"
    " ang(?:ular)?_?vel(?:ocity)?_?AXIS body_rate_AXIS"
)
_FORCE = (
    "(?:imu_)?acc(?:el|eleration)?_?AXIS AXIS_?acc(?:el|eleration)? a_?AXIS n_?AXIS AXIS_?ac"
    " body_accel_AXIS specific_force_AXIS load_factor_AXIS"
)
_NAMES: Mapping[str, str] = {
    "V_mps": (
        "tas|true_?air_?speed|v_?tas|v_?true|v_?t|v_?total|air_?speed|air_?spd|arspd|v|va|v_?a"
        "|eas|cas|ias|v_?ias|v_?cas|indicated_air_?speed|speed|velocity"
    ),
    "alpha_rad": "alpha|alfa|aoa|angle_of_attack|vane_alpha",
    "beta_rad": "beta|aos|ssa|side_?slip|side_?slip_angle|angle_of_side_?slip|slip|vane_beta",
    "phi_rad": "phi|roll|roll_angle|bank|bank_angle|euler_(?:roll|phi)|att(?:itude)?_roll",
    "theta_rad": "theta|pitch|pitch_angle|euler_(?:pitch|theta)|att(?:itude)?_pitch",
    "psi_rad": (
        "psi|heading|hdg|true_heading|heading_true|yaw|yaw_angle|euler_(?:yaw|psi)"
        "|att(?:itude)?_yaw|mag_?heading"
    ),
    **{
        s: f"{a}|{a}_body|{p}"
        for (s, p), a in zip(_axes(tuple(_LETTERS), _RATE, _BODY).items(), "pqr", strict=True)
    },
    **_axes(("ax_mps2", "ay_mps2", "az_mps2"), _FORCE, _XYZ),
    "h_m": (
        "h|alt|altitude|height|(?:baro|pressure|msl|asl|gps)_alt(?:itude)?"
        "|alt(?:itude)?_(?:baro|msl|asl|agl|gps|ind|b)|h_(?:msl|asl|baro)"
    ),
    "throttle_pct": (
        "throttle|thr|thrtl|throttle_(?:cmd|command|position|pos|lever)|d_?thr|d_?t|power|pwr|pla"
    ),
    "north_m": "north|p_?n|pos_?n(?:orth)?|north_position|x_?n(?:ed)?|n_pos",
    "east_m": "east|p_?e|pos_?e(?:ast)?|east_position|y_?n?e(?:d)?|e_pos",
    "vn_mps": "v_?n|v_?north|vel_?n(?:orth)?|velocity_north|north_vel(?:ocity)?|gps_v_?n",
    "ve_mps": "v_?e|v_?east|vel_?e(?:ast)?|velocity_east|east_vel(?:ocity)?|gps_v_?e",
    "vd_mps": "v_?d|v_?down|vel_?d(?:own)?|velocity_down|down_vel(?:ocity)?|gps_v_?d",
    "rpm": "(?:engine|eng|prop|propeller|e_?1|motor)?_?rpm|rpm_?1|n_?prop",
    "thrust_N": "thrust|total_thrust|propulsion_thrust",
    "rho_kgpm3": "rho|density|air_density",
}
_SURFACES = {
    "elevator": "elevator|elev|ele|de|d_?e|delta_?e|stab|stabilator|stabiliser|stabilizer",
    "aileron": "aileron|ail|da|d_?a|delta_?a|left_aileron|aileron_left",
    "rudder": "rudder|rud|dr|d_?r|delta_?r",
}
_CLIMB = r"v_?s|vertical_?speed|climb|climb_rate|roc|rate_of_climb|v_?up|h_?dot|vspd|v_?spd"
_LATITUDE, _LONGITUDE = (
    r"lat|latitude|gps_lat(?:itude)?",
    r"lon|lng|long|longitude|gps_lon(?:gitude)?",
)
_PAIR_FIELDS = frozenset({"north_m", "east_m"})
# Before a capital that begins a word: RollRate, accX, GPSAlt; but not within AoA, AoS and RoC.
_CAMEL = re.compile(r"(?<=[a-z])(?<![A-Z][a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})")
_INDICATED = re.compile(r"ias|cas|eas|indicated")
_FOREIGN_SIGNALS = ("V_mps", "alpha_rad", "beta_rad", "rpm", "thrust_N")
_NO_SENSORS = re.compile(
    r"innov|test|ratio|setpoint|status|estimator|variance|PID|TUNE|^X?[NX]K", re.IGNORECASE
)
"""Messages whose fields have the names of signals but hold errors, demands or ratios of them."""
_ROUNDS = 4


@dataclass(frozen=True)
class Proposal:
    """One signal of a proposed map, its evidence, and what is uncertain about it."""

    signal: str
    entry: Entry
    evidence: tuple[str, ...]
    unsure: tuple[str, ...] = ()


@dataclass(frozen=True)
class MapProposal:
    """A signal map with its evidence.

    Attributes
    ----------
    source, dialect : str
        Name of the log and its dialect.
    time : TimeColumn or None
        Column of a table's times; None for logs with one time.
    signals : tuple of Proposal
        What is mapped.
    absent : tuple of str
        Signals of a complete record for which nothing in the log was recognised.
    unused : Mapping
        Fields that no signal uses, with their sizes.
    from_servos : tuple of str
        Surfaces and throttle that come from servo outputs by the card, without a line in the map.
    """

    source: str
    dialect: str
    time: TimeColumn | None
    signals: tuple[Proposal, ...]
    absent: tuple[str, ...]
    unused: Mapping[str, str]
    from_servos: tuple[str, ...] = ()

    def to_toml(self) -> str:
        """Return the map as TOML, with comments on the evidence; uncertain points are marked
        "unsure".
        """
        lines = [
            (
                f"# Signal map proposed for {self.source} ({self.dialect}). Check each line, above"
                " all those"
            ),
            "# marked 'unsure', then: uqharness log info FILE --map THIS-FILE",
        ]
        # Time first, then one table per signal with its evidence above it.
        if self.time is not None:
            unit = self.time.unit
            lines += [
                "",
                "[signals.time_s]",
                f"field = {_quoted(self.time.field)}",
                f'unit = "{unit}"',
            ]
        for proposal in self.signals:
            lines += [
                "",
                *_comments("", proposal.evidence),
                *_comments("unsure: ", proposal.unsure),
            ]
            lines += _entry_lines(proposal.signal, proposal.entry)
        # What the card supplies, what is missing, and what was left unused.
        if self.from_servos:
            lines += ["", f"# From the servo outputs, by the card: {', '.join(self.from_servos)}"]
        if self.absent:
            lines += ["", f"# No field was recognised for: {', '.join(self.absent)}"]
        if self.unused:
            lines += ["", "# Fields that are not used, with median and range:"]
            lines += [f"#   {name}: {size}" for name, size in self.unused.items()]
        return "\n".join(lines) + "\n"


def propose_map(
    path: Path, card_path: Path | None = None, *, callback: ProgressCallback | None = None
) -> MapProposal:
    """Propose a signal map for a log of any dialect.

    Parameters
    ----------
    path : Path
        Table (CSV or Parquet), DataFlash, MAVLink or ULog file.
    card_path : Path, optional
        airframe.toml or its folder; gives servo outputs their angles.
    callback : callable, optional
        Called with the share of the file that has been read, 0..1.

    Returns
    -------
    MapProposal
        Its `to_toml` is the text of a map.

    Raises
    ------
    LogError
        For a file that is no log or cannot be read.
    """
    dialect = detect(path)
    card = None if card_path is None else read_card(card_path)
    raw = read_raw(path, dialect, None, callback)
    base = map_of_dialect(dialect)
    # First the dialect's own map, then names, then corrections by kinematics.
    proposals = _by_dialect(raw, base)
    proposals.update(_by_name(raw, proposals))
    proposals, record = _by_kinematics(raw, base, proposals, card, path.name)
    used = {(p.entry.message, f) for p in proposals.values() for f in p.entry.fields}
    available = set(proposals) if record is None else set(record.columns)
    return MapProposal(
        path.name,
        dialect,
        _time_of(raw),
        tuple(proposals[n] for n in SIGNALS if n in proposals),
        tuple(n for n, s in SIGNALS.items() if s.core and n != "time_s" and n not in available),
        _unused(raw, used) if dialect in (*CSV_DIALECTS, "parquet") else {},
        tuple(
            n
            for n in SIGNALS
            if n in available and n not in proposals and n not in ("time_s", *LABELS)
        ),
    )


def _time_of(raw: RawLog) -> TimeColumn | None:
    """Return the time column of a table; None for other logs."""
    column = raw.facts.get("time column")
    return None if column is None else TimeColumn(str(column), str(raw.facts["time unit"]))


def _by_dialect(raw: RawLog, base: SignalMap) -> dict[str, Proposal]:
    """Return the entries of the dialect's map whose fields the log has."""
    times, sensors, out = Times(raw), Sensors(raw, base.sensors), {}
    for signal, candidates in base.entries.items():
        if signal in LABELS:
            continue
        for entry in candidates:
            if resolve(raw, signal, (entry,), times, sensors) is not None:
                out[signal] = Proposal(signal, entry, (f"{entry.label}: the dialect's own field",))
                break
    return out


def _by_name(raw: RawLog, present: Mapping[str, Proposal]) -> dict[str, Proposal]:
    """Return proposals for fields whose name is that of a signal.

    In logs that have separate messages, short names are ambiguous and are left out.
    """
    table = raw.dialect == "mat" or any(message == "csv" for message, _ in raw.messages)
    used_fields = {(p.entry.message, f) for p in present.values() for f in p.entry.fields}
    matches: dict[str, list[tuple[int, str, str]]] = {}
    for (message, instance), content in raw.messages.items():
        if instance or (not table and _NO_SENSORS.search(message)):
            continue
        for field, values in content.fields.items():
            if (message, field) in used_fields or not _usable(values):
                continue
            base, _ = _split(field)
            for signal, rank in _signals_of(base, field):
                foreign = not table and (signal not in _FOREIGN_SIGNALS or len(base) < 3)
                if signal not in present and not foreign:
                    matches.setdefault(signal, []).append((rank, message, field))
    out: dict[str, Proposal] = {}
    # The best pattern wins; other matches are listed as uncertain.
    for signal, fields in matches.items():
        _, message, field = min(fields, key=lambda match: match[0])
        alternatives = [f for _, m, f in fields if (m, f) != (message, field)]
        out[signal] = _propose_field(signal, message, field, raw, alternatives, table)
    if table:
        out.update({n: p for n, p in _divided_surfaces(raw).items() if n not in present})
    out.update(_places(raw, {**present, **out}))
    return _accelerations_alike({n: p for n, p in out.items() if n not in present}, raw)


_SIDES = {"l": 0, "left": 0, "port": 0, "lh": 0, "r": 1, "right": 1, "starboard": 1, "rh": 1}


def _divided_surfaces(raw: RawLog) -> dict[str, Proposal]:
    """Return proposals for surfaces that the log has on the left and on the right.

    Where the two move oppositely, half of their difference counts, otherwise their mean.
    """
    sides: dict[tuple[str, str], dict[int, str]] = {}
    for (message, instance), content in raw.messages.items():
        for field, values in content.fields.items():
            words = _split(field)[0].split("_")
            side = {_SIDES[w] for w in words if w in _SIDES}
            base = "_".join(w for w in words if w not in _SIDES)
            if instance or len(side) != 1 or not _usable(values):
                continue
            for signal, _ in _signals_of(base, field):
                if signal.removesuffix("_pos_deg").removesuffix("_deg") in _SURFACES:
                    sides.setdefault((signal, message), {})[side.pop()] = field
                    break
    out: dict[str, Proposal] = {}
    for (signal, message), of_side in sides.items():
        if len(of_side) < 2:
            continue
        left, right = of_side[0], of_side[1]
        fields = raw.messages[message, 0].fields
        pair = np.stack([fields[f].astype(np.float64) for f in (left, right)])
        moving = pair[:, np.isfinite(pair).all(axis=0)]
        opposite = moving.shape[1] > 1 and float(np.cov(moving)[0, 1]) < 0.0
        proposal = _propose_field(signal, message, left, raw, (), True)
        if proposal.entry.table:
            continue
        weights = (0.5, -0.5) if opposite else (0.5, 0.5)
        entry = replace(proposal.entry, fields=(left, right), function="sum", weights=weights)
        text = f"{left} and {right} move {'oppositely' if opposite else 'together'}"
        out[signal] = replace(proposal, entry=entry, evidence=(*proposal.evidence, text))
    return out


def _split(field: str) -> tuple[str, str | None]:
    """Return the words of a field name joined by "_", and the unit at its end or in brackets."""
    unit = None
    bracket = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$", field)
    if bracket and not bracket.group(1).isdigit():
        unit, field = bracket.group(1).lower(), field[: bracket.start()]
    words = re.findall(r"[a-z]+\d*|\d+", _CAMEL.sub(" ", re.sub(r"[{}]", "", field)).lower())
    if unit is None:
        # Units of several words such as "m/s" are tried first.
        for count in (3, 2, 1):
            suffix = "/".join(words[-count:])
            suffix_unit = suffix if count > 1 and any(suffix in u for u in UNITS.values()) else None
            if count == 1 and words and words[-1] in _SUFFIXES:
                suffix_unit = words[-1]
            if suffix_unit is not None and len(words) > count:
                unit, words = suffix_unit, words[:-count]
                break
    return "_".join(words), unit


def _signals_of(base: str, field: str) -> Iterable[tuple[str, int]]:
    """Yield the signals that a name may mean, with the rank of the matching pattern (lower is
    likelier).
    """
    if field in SIGNALS and field not in LABELS:
        yield field, -1  # the record's own name
        return
    for signal, pattern in _NAMES.items():
        for rank, alternative in enumerate(_alternatives(pattern)):
            if re.fullmatch(alternative, base):
                yield signal, rank
                break
    if re.fullmatch(_CLIMB, base):
        yield "vd_mps", 50
    words = base.split("_")
    for surface, pattern in _SURFACES.items():
        position = {"pos", "position", "deflection", "deflect", "meas", "measured", "surface"} & {
            *words
        }
        command = {"cmd", "command", "in", "input", "demand", "ref"} & {*words}
        surface_words = "_".join(w for w in words if w not in position | command)
        if re.fullmatch(pattern, surface_words):
            yield f"{surface}_{'pos_' if position else ''}deg", 0 if position or command else 1


def _alternatives(pattern: str) -> list[str]:
    """Split a pattern at its outermost "|"."""
    out, depth, begin = [], 0, 0
    for k, c in enumerate(pattern):
        depth += (c == "(") - (c == ")")
        if c == "|" and depth == 0:
            out.append(pattern[begin:k])
            begin = k + 1
    return [*out, pattern[begin:]]


def _usable(values: NDArray[np.generic]) -> bool:
    """Return whether a field holds numbers."""
    return (
        values.dtype != object
        and values.ndim == 1
        and bool(np.isfinite(values.astype(float)).any())
    )


def _values(raw: RawLog, message: str, field: str) -> FloatArray:
    """Return the finite values of a field."""
    values = raw.messages[message, 0].fields[field].astype(np.float64)
    return values[np.isfinite(values)]


def _propose_field(
    signal: str, message: str, field: str, raw: RawLog, alternatives: Sequence[str], table: bool
) -> Proposal:
    """Return the proposal for one field: scale by name, line of units, or size of the values."""
    base, unit = _split(field)
    unit = str(raw.facts.get(f"unit {field}", unit or "")).strip("[]() ").lower() or None
    values = _values(raw, message, field)
    signal_unit = SIGNALS[signal].unit
    evidence, unsure = [f'named "{field}"; {_size(values)}'], []
    scale, function = 1.0, "value"
    pwm: tuple[tuple[float, float], ...] = ()
    # A unit by name counts most; without one the size of the values decides.
    if unit is not None and unit in UNITS.get(signal_unit, {}):
        scale = UNITS[signal_unit][unit]
        evidence.append(
            f"unit {unit}"
            f" {'by the line of units' if f'unit {field}' in raw.facts else 'by its name'}"
        )
    elif raw.dialect in CSV_DIALECTS and CSV_DIALECTS[raw.dialect].names_state_units:
        evidence.append(f"the names of {raw.dialect} state units; the values are in SI")
    else:
        scale, note = _scale_by_size(signal_unit, signal, values)
        unsure.append(note)
    if signal == "psi_rad":
        function = "heading"
    if signal == "h_m":
        function = "above_start"
    if signal == "vd_mps" and re.fullmatch(_CLIMB, base):
        scale = -scale
        evidence.append("a rate of climb is + up, vd_mps + down")
    if signal == "V_mps" and _INDICATED.search(base):
        unsure.append("an indicated airspeed: V_mps is true airspeed, larger by sqrt(rho0/rho)")
    if signal_unit == "deg" and values.size and 700.0 < float(np.median(values)) < 2300.0:
        pwm = ((1100.0, -20.0), (1500.0, 0.0), (1900.0, 20.0))
        scale = 1.0
        unsure = ["pulse widths in us: put the surface's own angles into the table"]
    elif signal.endswith("_deg") and "_pos_" not in signal and not re.search("cmd|command", base):
        unsure.append(
            "if it was measured at the surface, write"
            f" [signals.{signal.replace('_deg', '_pos_deg')}]"
        )
    if alternatives:
        unsure.append(f"other fields with such a name: {', '.join(alternatives[:5])}")
    if not table:
        unsure.append("recognised by its name alone")
    entry = Entry(message, 0, (field,), scale, 0.0, pwm, function)
    return Proposal(signal, entry, tuple(evidence), tuple(unsure))


def _scale_by_size(signal_unit: str, signal: str, values: FloatArray) -> tuple[float, str]:
    """Return the scale of a field without a unit, by the size of its values, and a note."""
    size = float(np.quantile(np.abs(values), 0.99)) if values.size else 0.0
    middle = float(np.median(values)) if values.size else 0.0
    # Largest plausible angles in rad: a larger value must be in degrees.
    limit = {"theta_rad": 1.65, "phi_rad": 3.3, "psi_rad": 6.6, "alpha_rad": 1.65, "beta_rad": 1.65}
    if signal_unit == "rad" and size > limit.get(signal, math.inf):
        return _RAD, f"no unit in the name; values up to {size:.3g} are degrees"
    if signal_unit == "rad/s" and size > 20.0:
        return _RAD, f"no unit in the name; values up to {size:.3g} are deg/s"
    # The vertical accelerometer shows gravity in level flight, in whatever unit and sign.
    if signal_unit == "m/s2" and signal == "az_mps2":
        for unit, factor in (("m/s2", 1.0), ("g", G0_MPS2), ("ft/s2", FT_M)):
            if 0.7 < abs(middle) * factor / G0_MPS2 < 1.4:
                sign = -1.0 if middle > 0.0 else 1.0
                sign_note = " with + up" if middle > 0.0 else ""
                return (
                    sign * factor,
                    (
                        f"no unit in the name; a median of {middle:.3g} is gravity in"
                        f" {unit}{sign_note}"
                    ),
                )
    # Small throttles and surfaces are normalised.
    if signal_unit == "%" and size <= 1.5:
        return 100.0, f"no unit in the name; values up to {size:.3g} are 0 to 1"
    if signal_unit == "deg" and size <= 1.0:
        return (
            1.0 / _RAD,
            (
                f"no unit in the name; values up to {size:.3g} are taken for rad, and may be -1 to"
                " 1 of the throw"
            ),
        )
    return 1.0, f"no unit in the name; {signal_unit} is assumed"


def _size(values: FloatArray) -> str:
    """Return median and range of values as text."""
    if not values.size:
        return "no numbers"
    low, middle, high = np.quantile(values, [0.01, 0.5, 0.99])
    return f"median {middle:.4g}, range {low:.4g} to {high:.4g}"


def _places(raw: RawLog, present: Mapping[str, Proposal]) -> dict[str, Proposal]:
    """Return proposals for north and east from latitude and longitude columns of a table."""
    content = raw.messages.get(("csv", 0))
    if content is None or _PAIR_FIELDS & set(present):
        return {}
    pair = []
    for pattern in (_LATITUDE, _LONGITUDE):
        matching = [
            f
            for f, v in content.fields.items()
            if _usable(v) and re.fullmatch(pattern, _split(f)[0])
        ]
        pair.append(next(iter(matching), None))
    lat, lon = pair
    if lat is None or lon is None:
        return {}
    size = float(np.quantile(np.abs(_values(raw, "csv", lat)), 0.99))
    scale = 1e-7 if size > 1e3 else 1.0
    note = (
        f'latitude "{lat}" and longitude "{lon}" in degrees' + (" x 1e7" if scale < 1.0 else ""),
    )
    return {
        n: Proposal(
            n, Entry("csv", 0, (lat, lon), scale, function=f"{n.removesuffix('_m')}_of_start"), note
        )
        for n in ("north_m", "east_m")
    }


def _accelerations_alike(proposals: dict[str, Proposal], raw: RawLog) -> dict[str, Proposal]:
    """Give accelerations without a unit the unit of the vertical one, which shows gravity."""
    vertical = proposals.get("az_mps2")
    if vertical is None:
        return proposals
    for name in ("ax_mps2", "ay_mps2"):
        p = proposals.get(name)
        if p is not None and any("no unit" in text for text in p.unsure):
            entry = replace(p.entry, scale=abs(vertical.entry.scale))
            text = f"no unit in the name; the unit of {vertical.entry.fields[0]} is taken"
            unsure = tuple(text if "no unit" in x else x for x in p.unsure)
            proposals[name] = replace(p, entry=entry, unsure=unsure)
    return proposals


def _by_kinematics(
    raw: RawLog,
    base: SignalMap,
    proposals: Mapping[str, Proposal],
    card: AirframeCard | None,
    source: str,
) -> tuple[dict[str, Proposal], FlightRecord | None]:
    """Correct units and signs that the relations between channels contradict, and add
    confirmations.
    """
    out, record = dict(proposals), None
    for _ in range(_ROUNDS):
        entries = {n: (p.entry,) for n, p in out.items()}
        try:
            record = assemble(raw, replace(base, entries={**base.entries, **entries}), card, source)
        except LogError:
            return out, None
        changed = False
        # Each finding on a unit or sign of a mapped channel changes its scale; repeat until
        # none is left.
        for f in record.metadata.findings:
            p = out.get(f.channel)
            slope = f.numbers.get("slope", math.nan)
            if p is None or f.code not in ("unit", "sign") or not math.isfinite(slope) or not slope:
                continue
            factor = 1.0 / slope
            dialects_own = any("dialect" in text for text in p.evidence)
            note = f"the flight contradicts the unit or sign: {f.message}"
            if p.entry.table:
                out[f.channel] = replace(p, unsure=(*p.unsure, note))
                continue
            out[f.channel] = replace(
                p,
                entry=replace(
                    p.entry, scale=factor * p.entry.scale, offset=factor * p.entry.offset
                ),
                evidence=_without_undone(p.evidence, factor, f.message),
                unsure=tuple(x for x in p.unsure if "no unit" not in x)
                + (("the dialect's own field has another scale",) if dialects_own else ()),
            )
            changed = True
        if not changed:
            break
    return (_confirmed(out, record), record) if record is not None else (out, record)


def _without_undone(evidence: tuple[str, ...], factor: float, message: str) -> tuple[str, ...]:
    """Return the evidence with a change of scale added, or removed if this change reverses it."""
    opposite = f"scale changed by {1.0 / factor:.6g}: "
    if evidence and evidence[-1].startswith(opposite):
        return evidence[:-1]
    return (*evidence, f"scale changed by {factor:.6g}: {message}")


def _confirmed(proposals: dict[str, Proposal], record: FlightRecord) -> dict[str, Proposal]:
    """Add the relations that hold to the evidence; what they confirm is no longer uncertain."""
    free = record.metadata.free_flight_s
    flight = record.between(*free[0]) if free else record
    out = dict(proposals)
    for h in evaluate_laws(flight) if len(flight) > 3 else ():
        p = out.get(h.law.subject)
        if p is None or not h.agrees:
            continue
        text = (
            f"{h.relation.scale:.2f} times {h.law.statement} ({h.relation.low:.2f} to"
            f" {h.relation.high:.2f})"
        )
        confirmed = tuple(x for x in p.unsure if "no unit" in x)
        unsure = tuple(x for x in p.unsure if "no unit" not in x)
        out[h.law.subject] = replace(p, evidence=(*p.evidence, *confirmed, text), unsure=unsure)
    # Errors that remain are shown with the signal.
    for f in record.metadata.findings:
        if f.channel in out and f.severity == "error":
            p = out[f.channel]
            out[f.channel] = replace(p, unsure=(*p.unsure, f.message))
    return out


def _unused(raw: RawLog, used: set[tuple[str, str]]) -> dict[str, str]:
    """Return the fields that no signal uses, with their sizes, at most 200."""
    out = {}
    for (message, _), table in raw.messages.items():
        for field, values in table.fields.items():
            if (message, field) not in used:
                out[field] = (
                    _size(_values(raw, message, field)) if _usable(values) else _first(table, field)
                )
    return dict(list(out.items())[:200])


def _first(table: MessageTable, field: str) -> str:
    """Return the first text of a field."""
    values = table.fields[field]
    return f"text such as '{str(values[0])[:40]}'" if len(values) else "empty"


def _comments(prefix: str, texts: Iterable[str]) -> list[str]:
    """Return comment lines of a map."""
    return [f"# {prefix}{' '.join(text.split())}" for text in texts]


def _quoted(text: str) -> str:
    """Return a text as a TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t")
    return f'"{escaped}"'


def _entry_lines(signal: str, entry: Entry) -> list[str]:
    """Return the TOML lines of one entry."""
    lines = [f"[signals.{signal}]", f"message = {_quoted(entry.message)}"]
    if entry.instance:
        lines.append(f"instance = {entry.instance}")
    if len(entry.fields) == 1:
        lines.append(f"field = {_quoted(entry.fields[0])}")
    else:
        lines.append(f"fields = [{', '.join(_quoted(f) for f in entry.fields)}]")
    if entry.function != "value":
        lines.append(f'function = "{entry.function}"')
    if entry.weights:
        lines.append(f"weights = [{', '.join(f'{w:g}' for w in entry.weights)}]")
    if entry.table:
        pairs = ", ".join(f"[{x:g}, {y:g}]" for x, y in entry.table)
        lines.append(f"table = [{pairs}]")
    else:
        lines.append(f"scale = {float(entry.scale):.12g}")
        if entry.offset:
            lines.append(f"offset = {float(entry.offset):.12g}")
    if entry.times is not None:
        lines.append(f"times = [{', '.join(_quoted(x) for x in entry.times)}]")
    if entry.estimate:
        lines.append("estimate = true")
    return lines
