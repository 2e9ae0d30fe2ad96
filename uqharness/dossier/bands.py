"""Objective tests of 14 CFR Part 60, Appendix A, Attachment 2, Table A2A with their tolerances, as data.

Checked line by line against the edition of 1 January 2014 (14 CFR Ch. I, pages 53 to 58). Where a test gives two tolerances for a
parameter, the less restrictive one counts (paragraph 2 of that attachment). A tolerance in percent is taken of the measured value
at each moment, except where the table says of the peak.

Left out: tests of ground handling, take-off, landing, engines, forces on the controls and failures, of which a flight record says
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

from sysid.units import DEG_RAD, FT_M, G0_MPS2, KT_MPS

REGULATION = "14 CFR Part 60, Appendix A, Attachment 2, Table A2A"


@dataclass(frozen=True)
class Band:
    """A tolerance of a channel throughout a time history.

    channel   of a flight record, in its unit; absolute: half width in that unit; share: of the measured value, 0 for none
    of_peak   the share is of the greatest measured value, not of that of each moment
    one_of    bands with the same word are alternatives, of which one has to hold
    """

    channel: str
    absolute: float
    share: float = 0.0
    of_peak: bool = False
    one_of: str = ""


@dataclass(frozen=True)
class Oscillation:
    """Tolerances of a mode that the controls, once at rest, leave to itself.

    channel     in which it is measured
    period_s    absolute tolerance of the period [s], 0 for none; the greater of it and period_share counts
    half_share  of the time to half or double amplitude; damping: absolute, of the damping ratio; one of the two has to hold
    cycles      that the test needs; 0: as many as tell the time to half or double amplitude
    shortest_s, longest_s  periods [s] that are looked for
    """

    channel: str
    period_s: float
    period_share: float
    half_share: float
    damping: float
    cycles: float
    shortest_s: float
    longest_s: float


@dataclass(frozen=True)
class Test:
    """One test of the table.

    entry      number of its line; tolerance: in words, as the table means it
    control    that makes the manoeuvre; "" for none
    before_s, after_s  record that it needs before and after the input
    peak_radps  least and greatest peak of the measured rate with which the input counts as such; None: any
    """

    entry: str
    title: str
    tolerance: str
    control: str
    bands: tuple[Band, ...] = ()
    oscillation: Oscillation | None = None
    before_s: float = 0.0
    after_s: float = 0.0
    peak_radps: tuple[float, float] | None = None


_SMALL = (0.5 * DEG_RAD, 2.0 * DEG_RAD)


def _small(entry: str, axis: str, control: str, channel: str) -> Test:
    return Test(
        entry,
        f"Small control inputs, {axis}",
        f"±0.15°/s body {axis} rate or ±20 % of its peak, throughout",
        control,
        (Band(channel, 0.15 * DEG_RAD, 0.20, of_peak=True),),
        before_s=5.0,
        after_s=5.0,
        peak_radps=_SMALL,
    )


TESTS = (
    _small("2.b.4", "pitch", "elevator", "q_radps"),
    _small("2.b.5", "roll", "aileron", "p_radps"),
    _small("2.b.6", "yaw", "rudder", "r_radps"),
    Test(
        "2.c.1",
        "Power change dynamics",
        "±3 kt airspeed, ±100 ft altitude, ±20 % or ±1.5° pitch angle",
        "throttle",
        (
            Band("V_mps", 3.0 * KT_MPS),
            Band("h_m", 100.0 * FT_M),
            Band("theta_rad", 1.5 * DEG_RAD, 0.20),
        ),
        before_s=5.0,
        after_s=15.0,
    ),
    Test(
        "2.c.9",
        "Phugoid dynamics",
        "±10 % period; ±10 % time to half or double amplitude, or ±0.02 damping ratio",
        "",
        oscillation=Oscillation("V_mps", 0.0, 0.10, 0.10, 0.02, 3.0, 5.0, 120.0),
    ),
    Test(
        "2.c.10",
        "Short period dynamics",
        "±1.5° pitch angle or ±2°/s pitch rate; ±0.10 g acceleration",
        "elevator",
        (
            Band("theta_rad", 1.5 * DEG_RAD, one_of="pitch"),
            Band("q_radps", 2.0 * DEG_RAD, one_of="pitch"),
            Band("az_mps2", 0.10 * G0_MPS2),
        ),
    ),
    Test(
        "2.d.2",
        "Roll response (rate)",
        "±10 % or ±2°/s roll rate",
        "aileron",
        (Band("p_radps", 2.0 * DEG_RAD, 0.10),),
    ),
    Test(
        "2.d.4",
        "Spiral stability",
        "correct trend and ±2° or ±10 % bank angle in 20 s",
        "",
        (Band("phi_rad", 2.0 * DEG_RAD, 0.10),),
        after_s=20.0,
    ),
    Test(
        "2.d.6",
        "Rudder response",
        "±2°/s or ±10 % yaw rate",
        "rudder",
        (Band("r_radps", 2.0 * DEG_RAD, 0.10),),
    ),
    Test(
        "2.d.7",
        "Dutch roll",
        "±0.5 s or ±10 % period; ±10 % time to half or double amplitude, or ±0.02 damping ratio",
        "rudder",
        oscillation=Oscillation("r_radps", 0.5, 0.10, 0.10, 0.02, 6.0, 0.3, 20.0),
    ),
)
"""In the table's order. Of 2.d.7 the time between the peaks of bank and sideslip is not judged."""
