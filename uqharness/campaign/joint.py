"""What the intervals flown say together: the joint level of a campaign's epistemic set, and the transient part."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uqharness.campaign.spec import ellipsoid


def joint_level(manifest: Mapping[str, Any]) -> float | None:
    """Probability that all intervals flown hold at once, if the coefficients are independent; None where no interval's is known.

    ``manifest``: that of a campaign; ``bounds`` in it is the confidence of its model form.
    """
    epistemic, bounds = manifest["campaign"]["epistemic"], manifest.get("bounds")
    if bounds is None or epistemic["method"] == "none":
        return None
    confidence = float(bounds["confidence"])
    return (
        confidence
        if epistemic["set"] == "ellipsoid"
        else float(confidence ** len(epistemic["coefficients"]))
    )


def joint_words(manifest: Mapping[str, Any]) -> list[str]:
    """Sentences without their stops: the set and its joint level, and whether transient model error flies; none without a form."""
    level, bounds = joint_level(manifest), manifest.get("bounds")
    if level is None or bounds is None:
        return []
    epistemic, each = manifest["campaign"]["epistemic"], float(bounds["confidence"])
    names = epistemic["coefficients"]
    one = ellipsoid.marginal_radius(each)
    if epistemic["set"] == "ellipsoid":
        radius = ellipsoid.reach(len(names), each) * one
        said = f"joint {_percent(each)} ellipsoid of {len(names)} intervals, {radius:.2f} standard deviations from their middles"
    else:
        said = (
            f"box of {len(names)} intervals of {_percent(each)} each: together they hold at {_percent(level)} if independent; "
            f"its corners lie at {math.sqrt(len(names)) * one:.2f} standard deviations"
        )
    return [said, *_transient(epistemic, bounds["transient"])]


def points_flown(epistemic: Mapping[str, Any]) -> str:
    """Return the points of the box of bounds at which the results hold, ``corners and nominal model``; empty for drawn samples.

    ``epistemic``: that section of a campaign's settings.
    """
    method, interior = epistemic.get("method"), epistemic.get("interior", 0)
    if method == "levels":
        return "combinations of levels"
    if method != "corners":
        return ""
    points = ["corners"]
    points += [f"{interior} interior points"] if interior else []
    points += ["nominal model"] if epistemic.get("nominal") else []
    return ", ".join(points[:-1]) + f" and {points[-1]}" if points[1:] else points[0]


def corners_only_words(epistemic: Mapping[str, Any]) -> list[str]:
    """Return the sentence, without its stop, that no point between the corners was flown; none where interior points were."""
    points = points_flown(epistemic)
    if epistemic["method"] != "corners" or epistemic.get("interior"):
        return []
    nominal = epistemic.get("nominal")
    keys = "interior = 0" if nominal else "interior = 0, nominal = false"
    # The nominal model is one point: it leaves the others between the corners unknown.
    missing = (
        "no interior point" if nominal else "neither the nominal model nor a point between them"
    )
    text = (
        f"bounds hold at the {points} only: {missing} was flown ([epistemic] {keys}), "
        "and a response that is not monotonic may go beyond them there"
    )
    return [text]


def _transient(epistemic: Mapping[str, Any], moved: list[str]) -> list[str]:
    if moved:
        return [f"transient model error of {', '.join(moved)} walks in every flight"]
    if "transient" in epistemic:
        return ["no transient model error is flown"]
    return []


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"
