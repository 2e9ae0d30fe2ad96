"""The numbers by which effects are looked for, judged and named: one table, each with its reason.

Standard errors are those of an estimate; |t| is an estimate over its standard error; gain is what an effect adds to twice the log
likelihood. Steps, tolerances and sizes of computations are not here: smaller ones give the same answer.
"""

from __future__ import annotations

FAMILY = 0.02
"""Chance that the best of all candidates, or of all smooth terms, passes where nothing is missing: at most one null in fifty."""
DIFFERENT = 3.0
"""Standard errors, or |t| above a limit, that are no chance: 3 in 1,000. Its square is a gain that is none."""
CERTAIN_T = 10.0
"""|t| that no chance and no colour of residuals reaches: a candidate with as much is told though it was not chosen,
and moments that gain its square in twice the log likelihood; air whose gusts across the path gain less is calm."""
OVERWHELMING = 15.0
"""|t| from which what linearisation leaves of an effect is itself above the limit: it flies before others are chosen."""
COMPARABLE = 0.5
"""Share of the strongest's gain, or |t|, from which another is its equal until both have flown. A servo's lag and rate limit are
half of one another."""
ALIKE = 0.99
"""Correlation from which two candidates are one: at |t| 7 their gains differ by 1."""
UNLIKE = 0.3
"""Correlation below which a candidate is asked although flights contradict each other in the best one: a tenth of the variance in
common."""
INSEPARABLE_SHARE = 0.1
"""Share of its information that an effect must keep beside a confounded one to be distinguished from it. In theory nothing is left;
replays and filters leave a little."""
SEVERAL = 3
"""Effects asked for beside what flew that may be one cause's shares, and candidates that fly in its place."""
EARNED = 0.6
"""Share of limit^2 by which each effect must lower the cost of the flight itself: a linearised gain is not reached to the last.
Flown, an effect of less than its square root times the limit is none."""
STANDS = 0.5
"""Standard errors by which a number that JSBSim reads once may differ from the one flown: the error that stays is a ninth of the
interval's."""
GUST_LIMIT = 6.0
"""|t| asked of an effect in turbulence, where the air's spectrum is a model, too."""
GUST_ODDS = 30.0
"""Gain asked besides of what a gust model that is a little off would look like: rates of the wind angles, sensors, servos,
masses."""
RESOLVED_ROWS = 0.01
"""Standard error, in rows, that a time has besides its own: a servo's lag by Tustin's rule at 10 ms is off by as much. Lags of
servos and delays of gyros and wind vanes that are not there come to .007 to .018 rows (rms). Three times this is the least time
that counts as an effect."""
UNKNOWN_ROWS = 0.5
"""A delay or lag below this share of a row is no effect in an autopilot's log, nor is a rate limit that delays a doublet by
less: the log does not say when within a row a command changed, and a simulator's flights act as much early."""
QUIETER = 0.5
"""Least share of its card's noise that a sensor in calm air is taken to have: below it, what a simulation's own steps in time do
could look like effects."""
COLOURED_P = 1e-7
"""Chance below which residuals in calm air are called coloured: so small that only what is seen on a plot passes."""
FAR = 5.0
"""Test flights that lie this many times as far from either model as the train flights do are not of the same aircraft or not
sound; a difference between the models is lost in what is wrong with them."""
DISAGREES = 0.12
"""Share of samples outside the 95 % interval from which a region is told: that of residuals a quarter above what is allowed."""
ODDS = 1.0
"""Gain asked besides of what is no coefficient's term: a part of the aircraft once, a sensor twice, one channel of a sensor alone
four times. It decides between candidates that explain the same, no more."""
