"""A recorded manoeuvre cut out of a flight, ready for replay.

A `Segment` holds the sample times, the controls at each row, the commands before the first row and
an estimated start state. A record faster than the replay keeps its commands at the record's own
rate in `Commands`, so that outputs are compared at fewer rows without moving any command in time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import sha256_hex


@dataclass(frozen=True)
class Commands:
    """Controls at a record's own rate, where the rows of a segment were thinned.

    Attributes
    ----------
    per_row : int
        Commands from one row to the next.
    controls, targets : ndarray
        ((n - 1) per_row + 1, c), as those of `Segment`.
    """

    per_row: int
    controls: FloatArray
    targets: FloatArray | None = None


@dataclass(frozen=True)
class Segment:
    """One piece of a flight to replay.

    Attributes
    ----------
    label, flight : str
        Manoeuvre and flight, for reports.
    time_s : ndarray
        (n,) equidistant sample times of the record [s].
    controls : ndarray
        (n, c) in the record's units [deg, %], in the model's order of controls.
    start : ndarray
        (9,) start state, ordered as `replay.STATES` [m/s, rad, rad/s].
    altitude_m, h_m : float
        Altitude above sea level and recorded height at the first row [m].
    arm_m : tuple
        Position of the accelerometers from the CG, body axes [m].
    targets : ndarray, optional
        (n, c) commands behind measured positions; NaN where none were logged.
    above_ground : bool
        Whether ``h_m`` is a height above the ground.
    commands : Commands, optional
        The same controls between the rows; None where the record has no more rows.
    before : ndarray, optional
        (k, c) controls at the commands before the first row, the latest last; None where unknown.
    reach : ndarray, optional
        (9,) distance of the measured states from ``start`` within the first rows, by which an
        estimate of the start may move.
    unmeasured : tuple of str
        States that the record lacks; their start of 0 is no measurement.
    """

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
    unmeasured: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Return the kind of the manoeuvre: its label without the speed after a comma."""
        return self.label.split(",")[0]

    @property
    def dt_s(self) -> float:
        """Return the mean time between rows [s]."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    @property
    def per_row(self) -> int:
        """Return the number of commands from one row to the next."""
        return 1 if self.commands is None else self.commands.per_row

    @property
    def command_s(self) -> float:
        """Return the time between two commands [s]."""
        return self.dt_s / self.per_row

    @cached_property
    def controlled(self) -> str:
        """Return a digest of controls, earlier controls and targets, the key of caches."""
        arrays = (part for part in (self.controls, self.targets, self.before) if part is not None)
        return sha256_hex(b"".join(part.tobytes() for part in arrays))

    def at_commands(self) -> Segment:
        """Return the same piece with one row for each command."""
        return self if self.commands is None else self._at_commands

    @cached_property
    def _at_commands(self) -> Segment:
        commands = self.commands
        assert commands is not None
        # The last command of a segment is at its last row.
        time_s = np.linspace(self.time_s[0], self.time_s[-1], len(commands.controls))
        return replace(
            self, time_s=time_s, controls=commands.controls, targets=commands.targets, commands=None
        )

    def part(self, rows: slice) -> Segment:
        """Cut out a range of rows.

        The start state and height are kept, so a caller that cuts behind the first row must replace
        them. Controls of the rows in front of the cut are appended to ``before``.
        """
        first, last = rows.start, rows.stop
        # The finer grid of commands covers the same time span as the rows.
        fine = slice(first * self.per_row, (last - 1) * self.per_row + 1)
        original = self.commands
        commands, before = original, self.before
        if original is not None:
            targets = None if original.targets is None else original.targets[fine]
            commands = Commands(original.per_row, original.controls[fine], targets)
        # Commands that are cut away still determine the actuators' initial positions.
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
        """Average values at the commands (N,) to the rows (n,).

        Linear interpolation of the result has the same area as that of the values.
        """
        k = self.per_row
        # Triangular weights integrate the piecewise linear values against the rows' hat functions.
        hat = np.append(np.arange(1, k + 1), np.arange(k - 1, 0, -1)) / k**2
        padded = np.concatenate(
            [np.repeat(values[:1], k - 1), values, np.repeat(values[-1:], k - 1)]
        )
        return np.asarray(np.convolve(padded, hat, mode="valid")[::k])
