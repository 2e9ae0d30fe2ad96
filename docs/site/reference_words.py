"""Meanings of the columns and keys of what the commands write.

Names come from the code; the build fails where the two disagree.
"""

from __future__ import annotations

import re

CASES = {
    r"case_id": "hash of everything that defines the flight",
    r"epistemic_id": (
        "corner or draw: `010011` (a digit a coefficient), `lhs-000007`; `+0` and `+p000003` for"
        " intervals and draws"
    ),
    r"level_C\w": (
        "where the delta stood between its bounds, 0 to 1; null where it moves or is switched off"
    ),
    r"aleatory_id": (
        "number of the air: flights of all corners with the same number meet the same gusts and"
        " noise"
    ),
    r"wind_mps": "steady wind, m/s",
    r"turbulence": "none, light, moderate or severe",
    r"seed": "seed of the flight's own streams",
    r"duration_s": "scored time; of a flight that failed, what it flew of it",
    r"engine": "batch or jsbsim, the engine that flew it",
    r"status": "ok, diverged, ground-contact, crashed or timeout",
    r"reason": "why it failed, or why a metric is undefined",
    r"(cross_track|altitude|speed)_(median|mean|max)_(m|mps)": (
        "median, mean or largest |error|, true signal"
    ),
    r"(cross_track|altitude|speed)_(median|mean|max)_(m|mps)_measured": (
        "the same of the signal as the noise-laden sensors saw it"
    ),
    r"excursions_\d+m": "how often the horizontal distance from the path first exceeded the radius",
    r"excursions_\d+m_3d": "the same by distance in three dimensions",
    r"loss_of_control": (
        "1 if bank, incidence or altitude left the limits, or the state was not finite"
    ),
    r"extrapolated_share": (
        "share of scored time outside the data that the bounds came from; null where the aircraft"
        " does not say"
    ),
    r"heading_(median|mean|max)_deg": (
        "of a flight without a commanded path: absolute deviation of heading"
    ),
    r"load_factor_max": "of a flight without a commanded path: largest load factor",
    r"level_<property>": "of a variable whose mean is an interval: which end of it",
    r"variable_<property>": (
        "value of a variable that differs from flight to flight, in the property's unit"
    ),
}
PBOX = {
    "metric": "a metric of cases.parquet",
    "condition": "wind and turbulence",
    "value": "value of the metric",
    "lower": (
        "least of the corners' distribution functions there: P(metric <= value) is at least this"
    ),
    "upper": "greatest of them",
    "band_lower": "lower side of the 95 % band over all corners and values at once",
    "band_upper": "upper side of it",
    "corner_lower": "epistemic_id that sets the lower side",
    "corner_upper": "epistemic_id that sets the upper side",
}
RATES = {
    "condition": "wind and turbulence in words",
    "wind_mps": "steady wind, m/s",
    "turbulence": "none, light, moderate or severe",
    "radius_m": "radius of the excursions, m",
    "distance": "horizontal or 3d",
    "epistemic_id": "the corner",
    "best": "1 at the corner with the least rate; in statements.csv that corner's name",
    "worst": "1 at the corner with the greatest rate; in statements.csv that corner's name",
    "flights": "flights behind the number",
    "failed": "how many of them failed",
    "hours": "scheduled flight hours",
    "excursions": "excursions counted",
    "excursions_upper": "the same with one more for every flight that failed or has no count",
    "rate_per_h": "excursions over hours",
    "rate_upper_per_h": "excursions_upper over hours",
    "limit_lower_per_h": "exact Poisson limit of this corner alone, 95 %, two-sided",
    "limit_upper_per_h": "its upper side",
    "simultaneous_lower_per_h": "the same over all corners at once",
    "simultaneous_upper_per_h": "its upper side",
    "flights_lower_per_h": "limit with the flight as the unit, over all corners at once",
    "flights_upper_per_h": "its upper side",
    "dispersion": "variance over mean of the excursions per flight that the limit allowed for",
    "extrapolated_share": "mean share of scored time outside the data of the bounds",
    "best_per_h": "rate of the best corner",
    "best_lower_per_h": "its lower limit",
    "best_upper_per_h": "its upper limit",
    "worst_per_h": "rate of the worst corner",
    "worst_lower_per_h": "its lower limit",
    "worst_upper_per_h": "its upper limit",
    "acceptable_per_h": "rate that was asked about",
    "flight_share_upper": (
        "upper 95 % limit of the share of flights with an excursion, worst corner"
    ),
    "acceptable_loss_per_h": "rate of aborted flights that was asked about",
    "loss_upper_per_h": "upper limit of aborted flights per hour flown, worst corner",
    "aborted": "flights that lost control or ended early, all corners",
    "loss_of_control": "of them: control was lost and the flight went on",
    "ground_contact": "of them: ended on the ground",
    "diverged": "of them: ended by a state that was not finite or out of bounds",
    "answer": (
        "yes, no or open: at most acceptable_per_h and acceptable_loss_per_h at every corner?"
    ),
    "reason": "why it is settled, or why it is not",
    "confidence": "of the limits",
    "dispersion_allowed": (
        "variance over mean of the excursions per flight that upper limits allow for"
    ),
    "dispersion_observed": "largest ratio that corners with enough excursions show",
    "dispersion_measured_at": (
        "corners whose ratio was measured in the same air at a smaller radius"
    ),
    "dispersion_radius_m": "the smallest radius it was measured at",
    "quiet_hours_needed": "flight hours after which a corner without an excursion gives yes",
    "bounds_hold_at": "points of the box of bounds that were flown",
    "yes_up_to_dispersion": (
        "the largest dispersion, at every corner alike, with which a yes would still be one"
    ),
    "error_rate": "of a wrong yes or no",
}
SENSITIVITY = {
    "condition": "wind and turbulence in words",
    "wind_mps": "steady wind, m/s",
    "turbulence": "none, light, moderate or severe",
    "metric": "a metric of cases.parquet, or an excursion count per flight",
    "unit": "of the metric",
    "coefficient": "whose uncertainty",
    "share_min": (
        "least share of the p-box over all pairs of corners that differ in this coefficient alone"
    ),
    "share_max": "greatest share",
    "share_low": "lower end of the 95 % band, all coefficients at once",
    "share_high": "upper end",
    "shrink_min": (
        "by which share the p-box narrows with the coefficient known at a bound, the lesser of"
        " the two"
    ),
    "shrink_max": "the greater",
    "shrink_low": "lower end of its band",
    "shrink_high": "upper end",
    "width": "area of the p-box in the metric's unit",
    "width_low": "lower end of its 95 % interval",
    "width_high": "upper end",
    "flights": "flights per corner compared",
    "left_out": "airs left out because a flight of theirs failed in some corner",
    "interior_outside": (
        "share of the width by which the worst sample between the bounds leaves the corners' p-box"
    ),
    "reason": "why a number is missing",
}
MANIFEST = {
    "format": "version of this file",
    "state": (
        "running, interrupted, complete, or spoilt where aircraft or script was edited meanwhile"
    ),
    "command": "what repeats the run",
    "seed": "root of every random stream",
    "cases": "number of flights",
    "campaign": "every setting, defaults included",
    "campaign_file": "where it was read from",
    "versions": "of this program, Python and the libraries that fly and write",
    "engine": (
        "what was asked for (auto, batch, jsbsim), and why the campaign flies in the engine of its"
        " settings"
    ),
    "hashes": "SHA-256 of aircraft, script and files named in the campaign",
    "tables": "once complete: table → SHA-256 of its bytes",
    "sums": (
        "once complete: name of the file with the SHA-256 of every file in the folder, SHA256SUMS"
    ),
    "journal": (
        "once complete: rows, and digest (SHA-256) over the digests of all rows in the order of the"
        " case ids"
    ),
    "digest": "SHA-256 of all of the above, as JSON without spaces, keys in order",
}
MODEL_FORM = {
    "format": "version of this file",
    "aircraft": "name and SHA-256 of XML and card",
    "flights": "name, sha256, seconds, samples, channels that are estimates",
    "filtering": "cut-offs in Hz, samples a second",
    "confidence": "of the intervals",
    "outside": "grow (the polynomial goes on) or clamp (states are held at the data's box)",
    "coefficients": "coefficient → the keys below",
}
BOUNDS = {
    "states": "flight states it depends on",
    "centre": "subtracted from each state",
    "scale": "divided by",
    "terms": "monomials of the normalised states",
    "beta_hat": "their coefficients",
    "XtX_inv": "(X'X)^-1",
    "s2": "residual variance",
    "dof": "degrees of freedom",
    "t": "Student's quantile at the confidence",
    "confidence": "of t",
    "leverage_factor": "how many samples make one that counts",
    "n": "samples",
    "n_effective": "of them as good as independent",
    "hull": "the data's box and greatest leverage",
    "walk_rate": "of the transient part, or of the normalised residual, 1/sqrt(s)",
    "parts": "persistent and transient model error and noise; see model-form.md",
}
PROPERTIES = {
    r"uq/active": "0: bit for bit the aircraft without the plugin; 1: deltas act",
    r"uq/extrapolated": "1 while the state lies outside the data that the bounds came from",
    r"uq/<C>/lower": "lower bound of the delta at the present state, never above 0",
    r"uq/<C>/upper": "upper bound, never below 0",
    r"uq/<C>/level": "0 to 1, set by the host: delta = lower + level (upper - lower)",
    r"uq/<C>/active": "0 switches this coefficient's delta off",
    r"uq/<C>/delta": "what acts now",
}


def meaning(name: str, words: dict[str, str]) -> str:
    """What a column means. KeyError for one that nobody described."""
    if name in words:
        return words[name]
    for pattern, text in words.items():
        if re.fullmatch(pattern, name):
            return text
    raise KeyError(
        f"'{name}' is written by the code and described nowhere in docs/site/reference_words.py"
    )
