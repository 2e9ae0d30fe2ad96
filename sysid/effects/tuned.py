"""Tuned limits of the search for effects, each with its reason.

No theory gives these numbers. |t| is an estimate over its standard error; a gain is the increase of
twice the log likelihood. Steps and tolerances of computations stand where they are used, because
smaller ones give the same answer.
"""

from __future__ import annotations

FAMILY_ERROR_RATE = 0.02
"""Probability that the best of all candidates, or of all smooth terms, passes if nothing is
missing."""
SIGNIFICANT_Z = 3.0
"""Standard errors beyond which a difference is not chance (3 in 1,000). Its square is a negligible
gain."""
CERTAIN_T = 10.0
"""|t| that neither chance nor coloured residuals reach: such candidates are reported though not
chosen. Moments that gain its square in twice the log likelihood are reported; air whose gusts
across the path gain less is calm."""
OVERWHELMING_T = 15.0
"""|t| above which the linearisation error of an effect exceeds critical_t: it is simulated before
others are chosen."""
COMPARABLE_SHARE = 0.5
"""Share of the strongest candidate's gain, or |t|, above which another is simulated as well. A
servo's lag and rate limit reach half of one another."""
ALIKE_CORRELATION = 0.99
"""Correlation above which two candidates count as one: at |t| 7 their gains differ by 1."""
UNRELATED_CORRELATION = 0.3
"""Correlation below which another candidate is tried although flights contradict each other in the
best one: a tenth of the variance in common."""
INSEPARABLE_SHARE = 0.1
"""Share of its information that an effect must keep with a confounded one present to be
distinguished from it."""
MAX_COMPETITORS = 3
"""Additional effects that may be shares of one cause, and candidates simulated in its place."""
REQUIRED_GAIN_SHARE = 0.6
"""Share of critical_t^2 by which each effect must lower the cost of the simulation, since the
linearised gain is not fully reached. A simulated effect below its square root times critical_t is
dropped."""
READ_ONCE_TOLERANCE_STD = 0.5
"""Tolerance, in standard errors, of values that JSBSim reads once."""
TURBULENCE_CRITICAL_T = 6.0
"""|t| required in turbulence, where the spectrum of the air is a model as well."""
GUST_PENALTY = 30.0
"""Additional gain required of candidates that a slightly wrong gust model resembles: rates of the
wind angles, sensors, servos, masses."""
RESOLVED_ROWS = 0.01
"""Additional standard error of times, in rows: estimates of absent lags and delays are .007 to .018
rows (rms). Three times this is the smallest time that counts as an effect."""
UNRESOLVED_ROWS = 0.5
"""Delay or lag, in rows, below which nothing is reported in autopilot logs, which do not record
when within a row a command changed; the same for a rate limit that delays a doublet by less."""
MIN_NOISE_SHARE = 0.5
"""Smallest share of the card's noise assumed for a sensor in calm air; below it the simulation's
time steps could look like effects."""
COLOURED_P = 1e-7
"""Probability below which residuals in calm air are called coloured: small enough to be visible on
a plot."""
MAX_RESIDUAL_RATIO = 5.0
"""Ratio of hold-out to train residuals above which hold-out flights withdraw nothing: another
aircraft, or faulty flights."""
DISAGREEMENT_SHARE = 0.12
"""Share of samples outside the 95 % interval above which a region is reported: that of residuals a
quarter larger than allowed."""
SUBSYSTEM_PENALTY = 1.0
"""Additional gain required of effects that are no coefficient term: a part of the aircraft once, a
sensor twice, one channel of a sensor four times. It decides between candidates of equal gain."""
