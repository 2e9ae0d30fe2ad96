"""Detect wrong units, signs and delays by relations that hold for any aircraft.

A violated relation says that one of its channels is wrong, but not which. `check_physics`
therefore tests every unit and sign error that is common for each channel, and selects the one that
repairs most violated relations and breaks none. Delays are estimated from the corrected channels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.checking.kinematics import (
    ACCELERATIONS,
    AIR,
    ATTITUDE,
    GROUND,
    RATES,
    Law,
    Relation,
    all_laws,
    estimate_relation,
    stretches,
)
from sysid.logs.checking.signals import sample_hold
from sysid.logs.checking.timing import channel_lateness
from sysid.logs.signal_map import shipped_dialects, shipped_map
from sysid.record import FlightRecord, Metadata
from sysid.units import FT_M, G0_MPS2, KT_MPS
from sysid.vocabulary import LABELS, SIGNALS, SURFACES

# Results that a wrong unit or sign affects, and the lines of a signal map that correct it.

_SPOILS = {
    "V_mps": (
        "dynamic pressure goes with its square: every coefficient and derivative, trim, thrust,"
        " dimensionless rates"
    ),
    "alpha_rad": "every derivative by alpha, lift and drag slopes, static stability",
    "beta_rad": "every derivative by beta: side force, weathercock and dihedral effects",
    "h_m": "air density, energy, the height errors of a loiter",
    "a": "every force coefficient, the path reconstruction, the lever arm",
    "attitude": "gravity's part in every force, the replay's start state, the path reconstruction",
    "rates": (
        "damping and control derivatives, angular accelerations, thus every moment coefficient"
    ),
    "ground": "wind, the path reconstruction, checks of the accelerometers",
    "surface": "the surface's derivatives change sign or size with it, and a replay departs",
}


def affected_results(channel: str) -> str:
    """Return the results that are wrong if this channel is."""
    if channel in _SPOILS:
        return _SPOILS[channel]
    if channel.endswith("_radps"):
        return _SPOILS["rates"]
    if channel.endswith("_mps2"):
        return _SPOILS["a"]
    if channel.removesuffix("_pos_deg") + "_deg" in SURFACES or channel in SURFACES:
        return _SPOILS["surface"]
    return _SPOILS["attitude" if channel.endswith("_rad") else "ground"]


def map_correction(channel: str, factor: float, meta: Metadata) -> str:
    """Return lines of a signal map that multiply a channel by ``factor``."""
    label = meta.channels.get(channel, "")
    shipped = (
        shipped_map(meta.dialect.removesuffix("-text"))
        if meta.dialect.removesuffix("-text") in shipped_dialects()
        else None
    )
    entries = () if shipped is None else shipped.entries.get(channel, ())
    # A label such as "ARSP[1].Airspeed" names the instance; "ARSP[0,1]" names several in turn.
    name = re.match(r"(\w+)\[([\d,]+)\](\..*)", label)
    shipped_label = label if name is None else name[1] + name[3]
    instance = name[2] if name is not None and "," not in name[2] else ""
    for entry in entries:
        if shipped_label == entry.label:
            fields = (
                f'field = "{entry.fields[0]}"'
                if len(entry.fields) == 1
                else f"fields = {_listed(entry.fields)}"
            )
            extra = "" if entry.function == "value" else f'\nfunction = "{entry.function}"'
            extra += "" if entry.times is None else f"\ntimes = {_listed(entry.times)}"
            extra += f"\ninstance = {instance}" if instance else ""
            return (
                f'[signals.{channel}]\nmessage = "{entry.message}"\n{fields}\nscale ='
                f" {factor * entry.scale:.6g}{extra}"
            )
    if not label or label == "column":
        return f'[signals.{channel}]\nmessage = "csv"\nfield = "{channel}"\nscale = {factor:.6g}'
    if "servo" in label:
        return (
            f"in the card, [inputs.{channel.split('_')[0]}] servo_pwm: every angle times"
            f" {factor:.6g}"
        )
    return (
        f"[signals.{channel}] ({label}): multiply its scale, or every value of its table, by"
        f" {factor:.6g}"
    )


def _listed(names: tuple[str, ...]) -> str:
    """Return names as a TOML list."""
    return "[" + ", ".join(f'"{n}"' for n in names) + "]"


SAME = 1.33
"""Factor within which a scale counts as right: a smaller error is a matter of calibration, not of
units.
"""
_SHARP = 2.0  # largest ratio of the limits of an informative scale
_CLEAR = 1.5  # of one that proves a unit
_MAX_FAULTS = 4
_MAX_HZ = 40.0
_ALIKE = 8.0  # factor between noise levels of sensors of one kind
_DEG = 180.0 / math.pi

_SPEEDS = {
    1.0 / KT_MPS: "knots",
    3.6: "km/h",
    1.0 / FT_M: "feet per second",
    2.236936: "miles per hour",
    100.0: "cm/s",
}
_LENGTHS = {1.0 / FT_M: "feet", 100.0: "cm", 1000.0: "mm", 1e-3: "km"}
_FORCES = {1.0 / G0_MPS2: "g", 1000.0 / G0_MPS2: "mg", 1.0 / FT_M: "ft/s2", 100.0: "cm/s2"}
_TURNS = {_DEG: "degrees per second", 1000.0: "mrad/s"}
_ANGLES = {_DEG: "degrees"}
_PLACES = ("north_m", "east_m")
_FAMILIES: tuple[tuple[tuple[str, ...], Mapping[float, str], str], ...] = (
    # Channels that share a unit, units that come instead of the due one, and the due one.
    (("V_mps",), _SPEEDS, "m/s"),
    (("h_m",), _LENGTHS, "m"),
    (ACCELERATIONS, _FORCES, "m/s2"),
    (RATES, _TURNS, "rad/s"),
    (ATTITUDE, _ANGLES, "rad"),
    (("alpha_rad",), _ANGLES, "rad"),
    (("beta_rad",), _ANGLES, "rad"),
    (GROUND, _SPEEDS, "m/s"),
    (_PLACES, _LENGTHS, "m"),
)


_MIN_LATE_S, _MIN_LATE_RATIO = 0.01, 4.0
# Least coherence of a relation that is reported without an explanation; below it, side forces of
# gusts look like turns.
_COHERENT = 0.7
_LATE_COHERENCE = 0.7  # least coherence of a relation that yields a delay
_MAX_LATE_S = 0.45
_GUST_S = 0.1
"""Delay of a relation that assumes still air, above which it shows gusts, s. Vanes and filters
are late by at most 0.04 s.
"""


@dataclass(frozen=True)
class ChannelFault:
    """A possible error: ``channels`` are ``factor`` times their true values.

    ``words`` describes it; a lower ``rank`` is likelier.
    """

    channels: tuple[str, ...]
    factor: float
    words: str
    rank: int

    def corrected(self, record: FlightRecord) -> FlightRecord:
        """Return the record without the error."""
        return record.with_columns(
            {c: record[c] / self.factor for c in self.channels if c in record}
        )


@dataclass(frozen=True)
class LawResult:
    """A law and its relation as estimated from a flight."""

    law: Law
    relation: Relation

    @property
    def assumes_still_air(self) -> bool:
        """Whether the law neglects the acceleration of the air. In gusts, to which the aircraft
        responds, that acceleration looks like a scale.
        """
        return {"alpha_rad", "beta_rad"} <= set(self.law.uses)

    @property
    def has_evidence(self) -> bool:
        """Whether enough bands count. A law that assumes still air needs two, because one may be
        a single gust.
        """
        return self.relation.bands > (1 if self.assumes_still_air else 0)

    @property
    def agrees(self) -> bool:
        """Whether the scale is known and equal to 1 within SAME."""
        r = self.relation
        return (
            self.has_evidence
            and r.low > 0.0
            and r.high < _SHARP * r.low
            and r.allows(1.0, SAME - 1.0)
        )

    @property
    def differs(self) -> bool:
        """Whether the scale cannot be 1.

        Gusts reach the air data before the aircraft responds, so that a law with a delay proves
        nothing; a wrong unit or sign causes no delay.
        """
        gust = self.assumes_still_air and abs(self.relation.late_s) > _GUST_S
        return self.has_evidence and not gust and not self.relation.allows(1.0, SAME - 1.0)


def check_physics(record: FlightRecord) -> list[Finding]:
    """Return findings on units, signs and delays of the channels of a flight.

    Parameters
    ----------
    record : FlightRecord
        Free flight.

    Returns
    -------
    list of Finding
        Codes "unit", "sign", "kinematics-disagree" and "delay". Noise of any size is no finding.
    """
    corrected, late_s = _align_ground_velocity(_to_radians(_thinned(_at_own_rates(record))))
    out: list[Finding] = []
    # Remove one error after the other, the best explanation first.
    for _ in range(_MAX_FAULTS):
        results = evaluate_laws(corrected)
        if not any(h.differs for h in results):
            break
        explanation = _explanation(corrected, results)
        if explanation is None:
            out += [
                _unexplained(h)
                for h in results
                if h.differs and not h.assumes_still_air and h.relation.coherence > _COHERENT
            ]
            break
        fault, rivals = explanation
        out += _fault_findings(
            fault, rivals, record, results, _evaluate_corrected(corrected, results, fault)
        )
        corrected = fault.corrected(corrected)
    return [*out, *_delays(corrected, evaluate_laws(corrected), late_s)]


def evaluate_laws(record: FlightRecord) -> list[LawResult]:
    """Return the relation of every law for which the record has the channels."""
    return [
        LawResult(law, estimate_relation(law, parts))
        for law in all_laws()
        if (parts := stretches(record, law)) is not None
    ]


def _evaluate_corrected(
    record: FlightRecord, results: Sequence[LawResult], fault: ChannelFault
) -> list[LawResult]:
    """Return the results with an error corrected; laws without its channels keep their result."""
    corrected = fault.corrected(record)
    out = []
    for h in results:
        if set(h.law.uses) & set(fault.channels):
            parts = stretches(corrected, h.law)
            h = h if parts is None else LawResult(h.law, estimate_relation(h.law, parts))
        out.append(h)
    return out


def _at_own_rates(record: FlightRecord) -> FlightRecord:
    """Return the record with the rates at which held ground velocities and places change.

    The laws are compared up to a share of a channel's rate; steps above it are no motion.
    """
    rates = dict(record.metadata.native_hz)
    for name in (*GROUND, *_PLACES):
        repetition = sample_hold(record[name]) if name in record else None
        if repetition is not None and repetition.is_held:
            rates[name] = 1.0 / (record.dt_s * repetition.run)
    return FlightRecord(record.columns, replace(record.metadata, native_hz=rates))


def _thinned(record: FlightRecord) -> FlightRecord:
    """Return at most _MAX_HZ rows a second, each a mean: the laws concern much slower motion."""
    n = math.floor(1.0 / (record.dt_s * _MAX_HZ) + 1e-6)
    if n < 2:
        return record
    rows = len(record) // n * n
    columns: dict[str, NDArray[Any]] = {}
    for name, values in record.columns.items():
        if name in LABELS:
            columns[name] = values[:rows:n]
        elif SIGNALS[name].kind == "heading" or name == "phi_rad":
            # The mean direction on the circle.
            parts = [part(values[:rows]).reshape(-1, n).mean(axis=1) for part in (np.sin, np.cos)]
            direction = np.arctan2(*parts)
            columns[name] = np.mod(direction, 2.0 * np.pi) if name == "psi_rad" else direction
        else:
            columns[name] = values[:rows].reshape(-1, n).mean(axis=1)
    return FlightRecord(columns, record.metadata)


def _align_ground_velocity(record: FlightRecord) -> tuple[FlightRecord, float]:
    """Return the record with the ground velocity shifted by its delay, and the delay, s.

    In a turn, the acceleration of the path and gravity nearly cancel along the wings: a delay of
    0.1 s between them would look like a scale. Along the lift only the acceleration of the path
    varies.
    """
    law = next(x for x in all_laws() if x.subject == "az_mps2" and set(GROUND) <= set(x.uses))
    parts = stretches(record, law)
    relation = None if parts is None else estimate_relation(law, parts)
    if relation is None or not relation.evident or relation.coherence < _LATE_COHERENCE:
        return record, 0.0
    late = -relation.late_s
    if not surely_late(late, relation.late_std_s):
        return record, 0.0
    time = record["time_s"]
    moved = {n: np.interp(time + late, time, record[n], left=np.nan, right=np.nan) for n in GROUND}
    return record.with_columns(moved), late


def _to_radians(record: FlightRecord) -> FlightRecord:
    """Return the record with angles far outside their range converted from degrees.

    The range check reports them; the laws require radians.
    """
    converted = {
        name: record[name] / _DEG
        for name in MAX_RAD
        if name in record and SIGNALS[name].unit == "rad" and degrees_by_size(name, record[name])
    }
    return record.with_columns(converted) if converted else record


MAX_RAD = {
    "phi_rad": 3.3,
    "theta_rad": 1.65,
    "psi_rad": 6.6,
    "alpha_rad": 1.65,
    "beta_rad": 1.65,
    "p_radps": 20.0,
    "q_radps": 20.0,
    "r_radps": 20.0,
}
"""Angles [rad] and rates [rad/s] that fewer than 1 % of the samples of any flight exceed."""


def degrees_by_size(name: str, values: FloatArray) -> bool:
    """Return whether the size of a channel shows that it is in degrees.

    It exceeds the limit for radians, in steps as small as its others. Damaged samples jump there
    instead.
    """
    finite = values[np.isfinite(values)]
    limit = MAX_RAD[name]
    if finite.size < 3 or float(np.quantile(np.abs(finite), 0.99)) <= limit:
        return False
    outside = np.abs(finite) > limit
    if outside.all():
        return True
    steps = np.abs(np.diff(finite))
    steps_across = steps[outside[1:] != outside[:-1]]
    inside = steps[~outside[1:] & ~outside[:-1]]
    usual = float(np.quantile(inside, 0.95)) if inside.size else 0.0
    return float(np.median(steps_across)) < max(0.5 * limit, 5.0 * usual)


def _candidate_faults(
    record: FlightRecord, violated: Sequence[LawResult]
) -> Iterator[ChannelFault]:
    """Yield every error that affects a violated law.

    Sensors of one kind share a unit if they have the same noise.
    """
    # Only channels that a violated law uses can explain it.
    touched = {n for h in violated for n in h.law.uses}
    for family, units, signal_unit in _FAMILIES:
        same_noise = len(family) > 1 and _same_noise(record, family)
        for channels in (*([family] if same_noise else []), *((n,) for n in family)):
            if not touched & set(channels) or not all(n in record for n in channels):
                continue
            # A fault of a whole family of sensors is more usual than that of one of them.
            usual = 0 if len(channels) == len(family) or not same_noise else 1
            yield ChannelFault(channels, -1.0, "the sign is reversed", 1)
            for factor, unit in units.items():
                yield ChannelFault(
                    channels, factor, f"it is in {unit}, not in {signal_unit}", usual
                )
                yield ChannelFault(
                    channels,
                    1.0 / factor,
                    f"it was in {signal_unit} and has been converted from {unit} once too often",
                    2,
                )
                yield ChannelFault(
                    channels,
                    -factor,
                    f"it is in {unit}, not in {signal_unit}, and its sign is reversed",
                    3,
                )
    for h in violated:
        if h.assumes_still_air:
            continue
        yield ChannelFault(
            (h.law.subject,), h.relation.scale, "scale or unit is wrong in one of them", 4
        )


def _same_noise(record: FlightRecord, channels: tuple[str, ...]) -> bool:
    """Return whether the noise of the channels has one size, as far as they show any (third
    differences).
    """
    if not all(n in record for n in channels):
        return False
    steps = [np.abs(np.diff(record[n][np.isfinite(record[n])], 3)) for n in channels]
    sizes = [size for d in steps if d.size and (size := float(np.median(d))) > 0.0]
    return not sizes or max(sizes) < _ALIKE * min(sizes)


def _points(laws: Sequence[LawResult]) -> int:
    """Return the score of a set of laws: +1 for each that agrees, -2 for each that is violated."""
    return sum(1 if h.agrees else -2 if h.differs else 0 for h in laws)


def _explanation(
    record: FlightRecord, results: Sequence[LawResult]
) -> tuple[ChannelFault, list[ChannelFault]] | None:
    """Return the error that repairs most, and others that repair as much; None if none repairs
    anything.
    """
    violated = [h for h in results if h.differs]
    base = _points(results)
    scored = []
    for fault in _candidate_faults(record, violated):
        # A unit or sign is one exact factor: afterwards the scale itself must be right, and known,
        # not only its limits reach there. Bands that disagree show dynamics, as those of a
        # barometer do whose static port reads the flow too.
        mended = [h.relation for h in _evaluate_corrected(record, violated, fault) if h.agrees]
        if not any(
            abs(math.log(abs(r.scale))) <= math.log(SAME) and r.high < _CLEAR * r.low
            for r in mended
        ):
            # It repairs nothing: the other laws need not be evaluated.
            continue
        corrected = _evaluate_corrected(record, results, fault)
        gain = _points(corrected) - base
        if gain > 0:
            # Among equal gains prefer scales close to 1 after the correction.
            log_scales = [abs(math.log(abs(h.relation.scale))) for h in corrected if h.agrees]
            scored.append(
                (
                    -gain,
                    fault.rank,
                    round(float(np.mean(log_scales)), 2),
                    len(fault.channels),
                    fault,
                )
            )
    if not scored:
        return None
    scored.sort(key=lambda row: row[:-1])
    best = scored[0]
    rivals = [
        s
        for g, rank, *_, s in scored[1:]
        if g == best[0] and rank <= best[1] and set(s.channels) != set(best[-1].channels)
    ]
    return best[-1], rivals[:2]


def _fault_findings(
    fault: ChannelFault,
    rivals: Sequence[ChannelFault],
    record: FlightRecord,
    before: Sequence[LawResult],
    after: Sequence[LawResult],
) -> Iterator[Finding]:
    """Yield a finding for each channel of an error."""
    results_after = {h.law: h for h in after}
    repaired_or_confirmed = [
        h for h in before if h.law in results_after and results_after[h.law].agrees and not h.agrees
    ]
    violated = [h for h in before if h.differs]
    repaired = [h for h in repaired_or_confirmed if h.differs]
    relevant = (
        [h for h in repaired_or_confirmed if h.law.subject in fault.channels]
        or repaired_or_confirmed
        or violated
    )
    # Quote the law with the narrowest limits of the scale.
    best = min(
        relevant,
        key=lambda h: (
            h.relation.high / h.relation.low if h.relation.evident and h.relation.low else math.inf
        ),
    )
    relation_after = (
        results_after[best.law].relation
        if best.law in results_after and results_after[best.law].agrees
        else None
    )
    relation = relation_after or best.relation
    low, high = sorted(
        (fault.factor if relation_after else 1.0) * end for end in (relation.low, relation.high)
    )
    size = f"{fault.factor:.4g}" if fault.factor == -1.0 else f"{fault.factor:.3g}"
    either = "".join(f"; or {' '.join(r.channels)}: {r.words}" for r in rivals)
    for channel in fault.channels:
        text = (
            f"{channel} is {size} times {best.law.statement} (between {low:.3g} and {high:.3g},"
            f" coherence {relation.coherence:.2f}): {fault.words}; without it {len(repaired)} of"
            f" the {len(violated)} relations that do not hold do{either}"
        )
        numbers = {
            "slope": fault.factor,
            "low": low,
            "high": high,
            "correlation": math.sqrt(max(relation.coherence, 0.0)),
            "relations_mended": float(len(repaired)),
            "relations_broken": float(len(violated)),
        }
        code = "sign" if -SAME < fault.factor < 0.0 else "unit"
        yield Finding(
            code,
            channel,
            "error",
            text,
            numbers,
            affected_results(channel),
            map_correction(channel, 1.0 / fault.factor, record.metadata),
        )


def _unexplained(h: LawResult) -> Finding:
    """Return the finding on a violated law that no single error explains."""
    r = h.relation
    text = (
        f"{h.law.subject} is {r.scale:.3g} times {h.law.statement} (between {r.low:.3g} and"
        f" {r.high:.3g}, coherence {r.coherence:.2f}), and no unit or sign of one channel explains"
        f" it: look at {', '.join(h.law.uses)}"
    )
    numbers = {
        "slope": r.scale,
        "low": r.low,
        "high": r.high,
        "correlation": math.sqrt(max(r.coherence, 0.0)),
    }
    return Finding(
        "kinematics-disagree",
        h.law.subject,
        "warning",
        text,
        numbers,
        affected_results(h.law.subject),
    )


def _delays(record: FlightRecord, laws: Sequence[LawResult], ground_late_s: float) -> list[Finding]:
    """Return findings on delays of attitude, ground velocity and air data.

    References are the rates, and the rates with the accelerations.
    """
    path = [h for h in laws if h.law.subject in ACCELERATIONS and set(GROUND) <= set(h.law.uses)]
    out = [
        *_common_delay(
            "attitude", "the body rates", [h for h in laws if h.law.subject in RATES], 0.0
        ),
        *_common_delay("ground velocity", "the accelerations", path, ground_late_s),
    ]
    for h in laws:
        if h.law.subject in AIR and "rates" in h.law.statement and not h.differs:
            late = channel_lateness(
                record, h.law, h.agrees and h.relation.coherence > _LATE_COHERENCE
            )
            if surely_late(late.late_s, late.std_s):
                out.append(
                    _delay(
                        h.law.subject,
                        "rates and accelerations",
                        late.late_s,
                        late.std_s,
                        h.relation.coherence,
                        late.by,
                    )
                )
    return out


def _common_delay(
    channel: str, reference: str, members: Sequence[LawResult], corrected_s: float
) -> Iterator[Finding]:
    """Yield a finding on the delay that several laws share, none of which gusts enter.

    ``corrected_s`` is the part that was corrected before.
    """
    relations = [h.relation for h in members if h.agrees and h.relation.coherence > _LATE_COHERENCE]
    if relations:
        # Weighted mean by inverse variance.
        weight = np.array([r.late_std_s**-2 for r in relations])
        late = corrected_s - float(weight @ [r.late_s for r in relations]) / float(weight.sum())
        std = float(weight.sum()) ** -0.5
        if surely_late(late, std):
            yield _delay(
                channel, reference, late, std, min(r.coherence for r in relations), "motion"
            )


def surely_late(late_s: float, std_s: float) -> bool:
    """Return whether an estimated delay counts: above 10 ms and four standard errors, below 0.45
    s.

    Parameters
    ----------
    late_s, std_s : float
        Delay and standard error [s], as in a finding ``delay``. NaN is no delay.

    Returns
    -------
    bool
        Whether the channel is late and may be shifted.

    Examples
    --------
    >>> from sysid.logs import surely_late
    >>> surely_late(0.03, 0.002), surely_late(0.03, 0.0125)
    (True, False)
    """
    size = abs(late_s)
    return _MIN_LATE_S < size < _MAX_LATE_S and size > _MIN_LATE_RATIO * std_s


def _delay(
    channel: str, reference: str, late_s: float, std_s: float, coherence: float, by: str
) -> Finding:
    """Return the finding on a delay; a warning from 50 ms on."""
    basis = "in what the controls moved" if by == "controls" else f"coherence {coherence:.2f}"
    side = "after" if late_s > 0 else "before"
    text = (
        f"{channel} comes {abs(late_s) * 1e3:.0f} +- {std_s * 1e3:.1f} ms {side} {reference}"
        f" ({basis})"
    )
    numbers = {"delay_s": late_s, "std_s": std_s, "correlation": math.sqrt(max(coherence, 0.0))}
    severity = "info" if abs(late_s) < 0.05 else "warning"
    return Finding(
        "delay", channel, severity, text, numbers, "phases, and with them damping derivatives"
    )
