"""Choose the sensor instance and the valid rows, row by row.

A `SensorRule` of the signal map names the fields by which a log marks the sensor in use and a
valid row. Among the instances with a valid row at a time, the one in use is read, then the one
that is valid most of the time, then the lowest number. A row in which none is valid is NaN: an
autopilot logs zeros or the last value there, which no sensor measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.signal_map import Entry, SensorRule
from sysid.logs.time_base import GAP_STEPS, SAME_S, clean

BoolArray = NDArray[np.bool_]
_MAX_SPANS = 4
_HEALTH = ("present", "enabled", "health")


@dataclass(frozen=True)
class _Instance:
    """Usable rows of one sensor instance, in order of time.

    Attributes
    ----------
    number, key : int, tuple
        Instance number and key of its message table.
    keep : ndarray of bool
        Rows of the table that can be placed in time.
    time_s, step_s : ndarray of shape (n,), float
        Their times and usual step, s.
    valid : ndarray of bool, shape (n,)
        Rows that are data.
    in_use : ndarray of bool, shape (n,), or None
        Rows that mark the instance as used; None if rows do not say so.
    primary : tuple or None
        Times and numbers of the instance in use, from another message.
    primary_number : int
        Number of this instance in ``primary``.
    reason : str
        Conditions that invalid rows do not meet.
    """

    number: int
    key: tuple[str, int]
    keep: BoolArray
    time_s: FloatArray
    step_s: float
    valid: BoolArray
    in_use: BoolArray | None
    primary: tuple[FloatArray, FloatArray] | None
    primary_number: int
    reason: str

    @property
    def says_use(self) -> bool:
        """Whether the log marks the instance in use at all."""
        return self.primary is not None or self.in_use is not None

    def used_at(self, at_s: FloatArray) -> BoolArray:
        """Return whether the autopilot used the instance at the times ``at_s``."""
        if self.primary is not None:
            time_s, numbers = self.primary
            at = np.searchsorted(time_s, at_s + SAME_S, side="right") - 1
            # Before the first message the instance in use is unknown; every instance may be it.
            return (at < 0) | (numbers[np.maximum(at, 0)] == self.primary_number)
        if self.in_use is not None:
            return _state_at(self, self.in_use, at_s)
        return np.ones(len(at_s), dtype=bool)

    @property
    def name(self) -> str:
        """Name as in labels: "GPS", "IMU[1]", "IMU2"."""
        return f"{self.key[0]}[{self.key[1]}]" if self.key[1] else self.key[0]


class Sensors:
    """Selects instances for the entries of a map and records each choice as a finding.

    The table of a selection is composed once and added to the messages of the log.
    """

    def __init__(self, raw: RawLog, rules: Sequence[SensorRule]) -> None:
        self._raw = raw
        self._rules = tuple(rules)
        # Rule, binding instance and carriers -> table to read, its name in labels, what there is to
        # say.
        self._entries: dict[tuple[object, ...], tuple[tuple[str, int], str, Finding | None]] = {}
        self._carriers: dict[tuple[int, tuple[str, ...]], tuple[tuple[str, int], ...]] = {}
        self._used: dict[tuple[str, int], Finding] = {}

    def resolve(self, entry: Entry) -> Entry:
        """Return the entry with message, instance and label of the table to read."""
        number = next((k for k, rule in enumerate(self._rules) if rule.covers(entry)), None)
        if number is None:
            if entry.instance is None and (entry.message, 0) not in self._raw.messages:
                logged = [i for m, i in self._raw.messages if m == entry.message and i >= 0]
                return replace(entry, instance=min(logged, default=0))
            return entry
        cache_key = self._cache_key(number, entry)
        if cache_key not in self._entries:
            self._entries[cache_key] = self._select(number, entry)
        (message, instance), source, _ = self._entries[cache_key]
        return replace(entry, message=message, instance=instance, source=source)

    def note_use(self, entry: Entry) -> None:
        """Keep the finding about the sensor of an entry that became a channel."""
        number = next((k for k, rule in enumerate(self._rules) if rule.covers(entry)), None)
        if number is None:
            return
        _, source, finding = self._entries[self._cache_key(number, entry)]
        if finding is not None:
            self._used[source, number] = finding

    def _cache_key(self, number: int, entry: Entry) -> tuple[object, ...]:
        """Return what a selection depends on: the rule, a fixed instance, and the instances with
        the fields.
        """
        messages = (self._rules[number].message, *self._rules[number].also)
        if self._carriers.get((number, entry.fields)) is None:
            self._carriers[number, entry.fields] = tuple(
                sorted(
                    key
                    for key, table in self._raw.messages.items()
                    if key[0] in messages and key[1] >= 0 and {*entry.fields} <= {*table.fields}
                )
            )
        return (number, entry.message, entry.instance, self._carriers[number, entry.fields])

    def findings(self) -> list[Finding]:
        """Return the choices as at most one finding of each severity."""
        out = []
        for severity in ("warning", "info"):
            messages = [f.message for f in self._used.values() if f.severity == severity]
            numbers = {k: v for f in self._used.values() for k, v in f.numbers.items()}
            if messages:
                text = "; ".join(dict.fromkeys(messages))
                out.append(Finding("sensor-choice", "", severity, text, numbers))
        return out

    def _select(self, number: int, entry: Entry) -> tuple[tuple[str, int], str, Finding | None]:
        """Return key and label of the table to read for an entry, and a finding on the choice."""
        rule = self._rules[number]
        instances = self._instances(rule, entry)
        if not instances:
            return (entry.message, entry.instance or 0), "", None
        # The usual case: one instance without invalid rows is read as it is.
        first = instances[0]
        if len(instances) == 1 and first.valid.all():
            return first.key, first.name, None
        if entry.instance is not None and not any(i.valid.any() for i in instances):
            text = (
                f"{first.name} is read because the map names it, though no row is valid"
                f" ({first.reason})"
            )
            return first.key, first.name, Finding("sensor-choice", "", "warning", text, {})
        chosen = _select_rows(instances)
        finding = _describe(rule, entry, instances, chosen)
        read = [i for i, rows in zip(instances, chosen, strict=True) if rows.any()]
        if not read:
            # A key that no table has: the next candidate of the map is taken.
            self._used[first.name, number] = finding
            return (entry.message, -1000 - number), first.name, finding
        if len(read) == 1 and read[0].valid.all():
            return read[0].key, read[0].name, finding
        key = (rule.message, -1 - len(self._entries))
        self._raw.messages[key] = self._composed(instances, chosen, read)  # type: ignore[index]
        if len(read) == 1:
            return key, read[0].name, finding
        numbers = ",".join(str(i.number) for i in sorted(read, key=lambda i: i.number))
        return key, f"{rule.message}[{numbers}]", finding

    def _instances(self, rule: SensorRule, entry: Entry) -> list[_Instance]:
        """Return the instances that were logged with the entry's fields, the most valid first."""
        names = (rule.message, *rule.also)
        keys = {i: (rule.message, i) for m, i in self._raw.messages if m == rule.message and i >= 0}
        for k, name in enumerate(names[1:], start=1):
            if (name, 0) in self._raw.messages:
                keys.setdefault(k, (name, 0))
        # A map that names the message of a further instance fixes that instance.
        if entry.message != rule.message:
            number = names.index(entry.message)
            keys = {number: (entry.message, entry.instance or 0)}
            keys = {n: key for n, key in keys.items() if key in self._raw.messages}
        elif entry.instance is not None:
            keys = {entry.instance: keys[entry.instance]} if entry.instance in keys else {}
        out = []
        for number, key in sorted(keys.items()):
            table = self._raw.messages[key]
            if all(f in table.fields for f in entry.fields) and len(table.time_s):
                out.append(self._instance(rule, number, key, table))
        return sorted((i for i in out if len(i.time_s)), key=lambda i: (-i.valid.mean(), i.number))

    def _instance(
        self, rule: SensorRule, number: int, key: tuple[str, int], table: MessageTable
    ) -> _Instance:
        """Apply the rule to the rows of one instance."""
        cleaned = clean(table.time_s)
        keep, time_s = cleaned.keep, table.time_s[cleaned.keep]
        valid, reasons = np.ones(len(time_s), dtype=bool), []

        def require(rows: BoolArray, reason: str) -> None:
            """Exclude the rows that do not meet a condition, and note the condition."""
            nonlocal valid
            if not rows.all():
                reasons.append(reason)
            valid = valid & rows

        # Fields of the row itself, then states of other messages at its time.
        for name, (low, high) in rule.valid.items():
            if (values := _numbers(table, name)) is not None:
                text = f"{name} must be {_range(low, high)}"
                require((values[keep] >= low) & (values[keep] <= high), text)
        if rule.needs:
            states = [(pair, self._held_state(pair[0], pair[1], time_s)) for pair in rule.needs]
            logged = [(pair, values) for pair, values in states if values is not None]
            if logged:
                rows = np.zeros(len(time_s), dtype=bool)
                for (_, _, low, high), values in logged:
                    # Before the state is first sent it is unknown, and the row counts as valid.
                    rows |= np.isnan(values) | ((values >= low) & (values <= high))
                (message, name, low, high), _ = logged[0]
                require(rows, f"{message}.{name} must be {_range(low, high)}")
        # The autopilot's own health flags: a sensor that is present and enabled must be healthy.
        if rule.health and number < len(rule.bits):
            message, prefix = rule.health
            bit = 1 << rule.bits[number]
            flags = [self._held_state(message, f"{prefix}_{part}", time_s) for part in _HEALTH]
            if all(f is not None for f in flags):
                present, enabled, healthy = (
                    (np.nan_to_num(f).astype(np.int64) & bit) > 0 for f in flags if f is not None
                )
                text = f"bit {rule.bits[number]} of {message}.{prefix}_health must be set"
                require(~(present & enabled) | healthy, text)
        # The instance that the autopilot uses, by its own account.
        primary = self._primary(rule)
        in_use = None if primary is not None else self._in_use(rule, table, keep, time_s)
        instance = _Instance(
            number,
            key,
            keep,
            time_s,
            cleaned.step_s,
            valid,
            in_use,
            primary,
            number + rule.primary_first,
            "",
        )
        if primary is not None:
            at = np.searchsorted(primary[0], time_s + SAME_S, side="right") - 1
            rejected = (at >= 0) & (primary[1][np.maximum(at, 0)] < rule.primary_first)
            require(~rejected, "the autopilot uses no sensor of this kind then")
        return replace(instance, valid=valid, reason=", ".join(reasons))

    def _primary(self, rule: SensorRule) -> tuple[FloatArray, FloatArray] | None:
        """Return times and numbers of the instance in use, from the first of the rule's fields in
        the log.
        """
        for message, name in rule.primary:
            names = (message, *rule.also) if message == rule.message else (message,)
            is_rule_message = message == rule.message
            times, numbers = [], []
            # The selection may be logged with every instance, or in one other message.
            for (logged, instance), table in self._raw.messages.items():
                values = _numbers(table, name) if logged in names and instance >= 0 else None
                if values is None or (not is_rule_message and instance != 0):
                    continue
                keep = clean(table.time_s).keep & np.isfinite(values)
                times.append(table.time_s[keep])
                numbers.append(values[keep])
            if times and sum(map(len, times)):
                time_s = np.concatenate(times)
                order = np.argsort(time_s, kind="stable")
                return time_s[order], np.concatenate(numbers)[order]
        return None

    def _in_use(
        self, rule: SensorRule, table: MessageTable, keep: BoolArray, time_s: FloatArray
    ) -> BoolArray | None:
        """Return which rows of an instance say that it is in use; None if the log does not say."""
        if rule.selected is not None:
            identity, message, name = rule.selected
            values, selected = _numbers(table, identity), self._held_state(message, name, time_s)
            if values is not None and selected is not None:
                return values[keep] == selected
        if rule.in_use and (values := _numbers(table, rule.in_use)) is not None:
            return values[keep] > 0
        return None

    def _held_state(self, message: str, name: str, at_s: FloatArray) -> FloatArray | None:
        """Return a state of another message, held at the times ``at_s``.

        NaN before its first row; None if it is not logged.
        """
        table = self._raw.messages.get((message, 0))
        values = None if table is None else _numbers(table, name)
        if table is None or values is None:
            return None
        keep = clean(table.time_s).keep
        if not keep.any():
            return None
        at = np.searchsorted(table.time_s[keep], at_s + SAME_S, side="right") - 1
        return np.where(at >= 0, values[keep][np.maximum(at, 0)], np.nan)

    def _composed(
        self, instances: Sequence[_Instance], chosen: Sequence[BoolArray], read: list[_Instance]
    ) -> MessageTable:
        """Return one table of the chosen rows, with rows of NaN where no instance is valid.

        The rows of NaN have the times of the instance that is read most.
        """
        # Where no instance is valid, the one that is read most supplies the times of the rows
        # of NaN.
        counts = [int(rows.sum()) for rows in chosen]
        filler = int(np.argmax(counts))
        names = set.intersection(*(set(self._raw.messages[i.key].fields) for i in read))
        times: list[FloatArray] = []
        columns: dict[str, list[FloatArray]] = {name: [] for name in names}
        for k, (instance, rows) in enumerate(zip(instances, chosen, strict=True)):
            missing = _none_valid(instances, instance.time_s) & (k == filler)
            emitted = rows | missing
            times.append(instance.time_s[emitted])
            table = self._raw.messages[instance.key]
            for name in list(columns):
                values = _numbers(table, name)
                if values is None:
                    del columns[name]
                    continue
                columns[name].append(np.where(missing, np.nan, values[instance.keep])[emitted])
        time_s = np.concatenate(times)
        order = np.argsort(time_s, kind="stable")
        return MessageTable(
            time_s[order], {name: np.concatenate(v)[order] for name, v in columns.items()}
        )


def _numbers(table: MessageTable, name: str) -> FloatArray | None:
    """Return a numeric field as float array; None if it is absent or not numeric."""
    values = table.fields.get(name)
    if values is None or values.dtype == object or values.ndim != 1:
        return None
    return values.astype(np.float64)


def _range(low: float, high: float) -> str:
    """Format a range of allowed values."""
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _state_at(instance: _Instance, rows: BoolArray, at_s: FloatArray) -> BoolArray:
    """Return a state of an instance at other times, held as long as its rows continue."""
    at = np.searchsorted(instance.time_s, at_s + SAME_S, side="right") - 1
    age = at_s - instance.time_s[np.maximum(at, 0)]
    step = instance.step_s if np.isfinite(instance.step_s) else 0.0
    return (at >= 0) & (age <= GAP_STEPS * step + SAME_S) & rows[np.maximum(at, 0)]


def _none_valid(instances: Sequence[_Instance], at_s: FloatArray) -> BoolArray:
    """Return where no instance has a valid row."""
    return ~np.any([_state_at(i, i.valid, at_s) for i in instances], axis=0)


def _select_rows(instances: Sequence[_Instance]) -> list[BoolArray]:
    """Return for each instance the rows that are read."""
    out = []
    for index, instance in enumerate(instances):
        rank = np.empty((len(instances), len(instance.time_s)))
        for k, other in enumerate(instances):
            valid = _state_at(other, other.valid, instance.time_s)
            # Lowest rank wins: validity first, then use by the autopilot.
            rank[k] = np.where(valid, 0.0, 2.0)
            rank[k] += np.where(other.used_at(instance.time_s), 0.0, 1.0)
        best = np.argmin(rank, axis=0)  # the first of equals
        out.append((best == index) & instance.valid)
    return out


def _describe(
    rule: SensorRule,
    entry: Entry,
    instances: Sequence[_Instance],
    chosen: Sequence[BoolArray],
) -> Finding:
    """Return the finding on what is read, why, and which rows are not data."""
    several = len(instances) > 1
    names = [f"{i.key[0]}[0]" if several and i.name == rule.message else i.name for i in instances]
    spans = _read_spans(instances, chosen)
    read = list(dict.fromkeys(k for k, _, _ in spans))
    # Name the field that marks the sensor in use.
    marked = next((f"{m}.{n}" for m, n in rule.primary), "")
    marked = marked or (".".join(rule.selected[1:]) if rule.selected else rule.in_use)
    invalid = [i for i in instances if not i.valid.all()]
    parts = []
    # Which instance is read, and why.
    if not read:
        parts.append(f"no row of {rule.message} is valid")
    elif len(instances) == 1:
        parts.append(f"{names[0]} is read where it is valid")
    elif entry.instance is not None:
        parts.append(f"{names[read[0]]} is read because the map names it")
    elif len(read) == 1:
        k = read[0]
        used = instances[k].used_at(instances[k].time_s[chosen[k]])
        if instances[k].says_use and used.mean() > 0.5:
            reason = f"the autopilot used it ({marked})" if marked else "the autopilot used it"
        elif invalid and instances[k].valid.all():
            reason = "it is valid throughout"
        else:
            reason = "the first of equal instances"
        parts.append(f"{names[k]} is read of {len(instances)} instances: {reason}")
    else:
        reason = (
            f"the one in use ({marked})"
            if marked and any(i.says_use for i in instances)
            else "the valid one"
        )
        if len(spans) <= _MAX_SPANS:
            turns = ", then ".join(
                f"{names[k]} from {start:.1f} to {end:.1f} s" for k, start, end in spans
            )
        else:
            alternating = " and ".join(names[k] for k in read)
            turns = f"{alternating} in turn, {len(spans) - 1} changes"
        parts.append(f"{rule.message} is read from {reason}: {turns}")
    # Rows of each instance that are no data.
    for name, instance in zip(names, instances, strict=True):
        if instance.valid.all():
            continue
        share = 100.0 * float(np.mean(~instance.valid))
        where = _invalid_spans(instance) if instance.valid.any() else ""
        parts.append(f"{share:.3g} % of the rows of {name} are no data{where} ({instance.reason})")
    if rule.fields:
        parts[0] = f"{', '.join(rule.fields)}: {parts[0]}"
    severity = "warning" if invalid or len(read) > 1 else "info"
    return Finding("sensor-choice", "", severity, ", ".join(parts), {})


def _invalid_spans(instance: _Instance) -> str:
    """Return the time spans in which an instance has no data, as text."""
    edges = np.flatnonzero(
        np.diff(np.concatenate([[True], instance.valid, [True]]).astype(np.int8))
    )
    spans = [
        f"{instance.time_s[first]:.1f} to {instance.time_s[end - 1]:.1f}"
        for first, end in zip(edges[::2], edges[1::2], strict=True)
    ]
    if len(spans) <= _MAX_SPANS:
        return f" from {' and '.join(spans)} s"
    invalid_s = instance.time_s[~instance.valid]
    return f" in {len(spans)} spans between {invalid_s[0]:.1f} and {invalid_s[-1]:.1f} s"


def _read_spans(
    instances: Sequence[_Instance], chosen: Sequence[BoolArray]
) -> list[tuple[int, float, float]]:
    """Return (instance index, first time, last time) of each stretch read from one instance."""
    times = np.concatenate([i.time_s[rows] for i, rows in zip(instances, chosen, strict=True)])
    instance_index = np.concatenate([np.full(int(rows.sum()), k) for k, rows in enumerate(chosen)])
    if not len(times):
        return []
    order = np.argsort(times, kind="stable")
    times, instance_index = times[order], instance_index[order]
    ends = np.append(np.flatnonzero(np.diff(instance_index)), len(instance_index) - 1)
    starts = np.concatenate([[0], ends[:-1] + 1])
    return [
        (int(instance_index[a]), float(times[a]), float(times[b]))
        for a, b in zip(starts, ends, strict=True)
    ]
