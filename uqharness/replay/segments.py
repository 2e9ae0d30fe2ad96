"""A recorded manoeuvre cut out to be flown again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid.arrays import FloatArray
from sysid.digests import sha256_hex


@dataclass(frozen=True)
class Commands:
    """Controls at a record's own rate where its rows were thinned, ``per_row`` of them from row to
    row.

    controls, targets ((n - 1) per_row + 1, c): as those of a Segment.
    """

    per_row: int
    controls: FloatArray
    targets: FloatArray | None = None


@dataclass(frozen=True)
class Segment:
    """One piece to fly through.

    time_s (n,) equidistant; controls (n, c) in the record's units, in the model's order of
    controls; start (9,) as STATES; altitude_m above sea level at the start; h_m what the record
    calls its height there; arm_m place of the accelerometers from the CG; targets (n, c) the
    commands behind measured positions, NaN where there are none. above_ground: whether h_m is that.
    commands: the same controls between the rows as well, where the record had more rows; None: it
    had no more. before (k, c): the controls at the commands before the first row, the last of them
    behind; None where none is known. reach (9,): how far the measured states are from ``start``
    within the first rows, by which an estimate of it may move."""

    label: str
    flight: str
    time_s: FloatArray
    controls: FloatArray
    start: FloatArray
    altitude_m: float
    h_m: float
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    targets: FloatArray | None = None
    above_ground: bool = False
    commands: Commands | None = None
    before: FloatArray | None = None
    reach: FloatArray | None = None

    @property
    def kind(self) -> str:
        """Kind of the manoeuvre: its label without the speed behind a comma."""
        return self.label.split(",")[0]

    @property
    def dt_s(self) -> float:
        """Mean time between rows [s]."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    @property
    def per_row(self) -> int:
        """Commands from one row to the next."""
        return 1 if self.commands is None else self.commands.per_row

    @property
    def command_s(self) -> float:
        """Time between two commands [s]."""
        return self.dt_s / self.per_row

    @cached_property
    def controlled(self) -> str:
        """Digest of controls, those before and targets, by which whatever is made of them is
        remembered.
        """
        arrays = (part for part in (self.controls, self.targets, self.before) if part is not None)
        return sha256_hex(b"".join(part.tobytes() for part in arrays))

    def at_commands(self) -> Segment:
        """The same piece with a row for each command."""
        return self if self.commands is None else self._at_commands

    @cached_property
    def _at_commands(self) -> Segment:
        commands = self.commands
        assert commands is not None
        time_s = np.linspace(self.time_s[0], self.time_s[-1], len(commands.controls))
        return replace(
            self, time_s=time_s, controls=commands.controls, targets=commands.targets, commands=None
        )

    def part(self, rows: slice) -> Segment:
        """Cut out some rows; start and height stay those of the first row."""
        first, last = rows.start, rows.stop
        fine = slice(first * self.per_row, (last - 1) * self.per_row + 1)
        original = self.commands
        commands, before = original, self.before
        if original is not None:
            targets = None if original.targets is None else original.targets[fine]
            commands = Commands(original.per_row, original.controls[fine], targets)
        if first > 0:
            preceding = (self.controls if original is None else original.controls)[: fine.start]
            before = preceding if before is None else np.vstack([before, preceding])
        return replace(
            self,
            time_s=self.time_s[rows],
            controls=self.controls[rows],
            targets=None if self.targets is None else self.targets[rows],
            commands=commands,
            before=before,
        )

    def on_rows(self, values: FloatArray) -> FloatArray:
        """(n,) values at the rows of what is known at each command (N,): their straight lines have
        the same area.
        """
        k = self.per_row
        hat = np.append(np.arange(1, k + 1), np.arange(k - 1, 0, -1)) / k**2
        padded = np.concatenate(
            [np.repeat(values[:1], k - 1), values, np.repeat(values[-1:], k - 1)]
        )
        return np.asarray(np.convolve(padded, hat, mode="valid")[::k])
