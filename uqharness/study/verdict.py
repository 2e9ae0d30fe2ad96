"""What a study found, in sentences computed from its stages' results: the answer first, then what it rests on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.model_form import HOLDS_FROM
from uqharness.errors import BadInputError
from uqharness.result_documents import Coverage, Fit, Part, read_document
from uqharness.study.performance import BAD, GOOD, PLAIN, SAME, WARN, Flown, Sentence, performance
from uqharness.study.spec import ChainSpec
from uqharness.study.stages import AFTER, BEFORE, Stage

REFINEMENT = Path("refine") / "refinement.json"
_ABOVE_NOISE = 1.15  # as `compare` and `refine` have it


def judge(
    spec: ChainSpec,
    stages: Sequence[Stage],
    rows: Sequence[Mapping[str, Any]],
    out: Path,
    flown: Mapping[str, Flown],
) -> list[Sentence]:
    """Every sentence, from what the stages left in ``out`` and the campaigns ``flown``.

    Raises BadInputError for a document that is damaged.
    """
    kinds = {stage.kind for stage in stages}
    codes = {row["name"]: row["exit"] for row in rows}
    found: list[Sentence] = []
    if flown:
        found += performance(flown)
    if "refine" in kinds:
        found += _of_refinement(out / REFINEMENT)
    if "validate-bounds" in kinds:
        found += _coverage(out, spec.bounds.validate_on if spec.bounds else (), "refine" in kinds)
    if "identify" in kinds:
        found.append(
            _identified(read_document(out / "identify" / "fit.json", Fit), codes["identify"])
        )
    ended = [
        stage.name.removeprefix("fly-")
        for stage in stages
        if stage.kind == "fly" and codes[stage.name] == 1
    ]
    if ended:
        found.append(
            (
                f"Flown but ended early: {', '.join(ended)}; what was recorded until then was used.",
                WARN,
            )
        )
    return found


def _of_refinement(path: Path) -> list[Sentence]:
    document = read_document(path, Part)
    try:
        return list(_refined(document))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BadInputError(
            f"{path}: is no refinement's document ({error}); run the study again"
        ) from None


def _refined(document: Mapping[str, Any]) -> Iterator[Sentence]:
    effects = [e for e in document["effects"] if not e["withdrawn"]]
    flights = f"from {', '.join(_stems(document['train']))}"
    if effects:
        named = "; ".join(
            f"{e['name']}, {e['value']:.4g} ± {e['std']:.2g}{'' if e['unit'] in ('', '1') else ' ' + e['unit']}"
            + (f" ({e['property']})" if e["property"] else "")
            for e in effects
        )
        yield (
            f"Refinement named, {flights}: {named}.",
            GOOD if document["verdict"] == "effects-found" else WARN,
        )
    elif document["verdict"] == "no-missing-effect":
        yield f"Refinement found nothing missing {flights}.", GOOD
    if document["verdict"] == "unexplained":
        yield "Refinement leaves something unexplained: " + _unexplained(document) + ".", BAD
    test = document["gap"]["test"]
    # In turbulence replays hold what the gusts did, and predictions judge.
    predictions = test.get("predictions") or {}
    gap = predictions or test["channels"]
    ratios = {
        c: (g["rms_before"] / g["noise_rms"], g["rms_after"] / g["noise_rms"])
        for c, g in gap.items()
        if all(g[k] is not None for k in g) and g["noise_rms"] > 0.0
    }
    whose = "rms of one-step predictions" if predictions else "rms"
    flown = f"On the hold-out flights ({', '.join(_stems(document['test']))}) {whose} over noise"
    above = {c: r for c, r in ratios.items() if max(r) > _ABOVE_NOISE}
    if not above:
        most = max((max(r) for r in ratios.values()), default=math.nan)
        yield f"{flown} is at most {most:.2f} in every channel, before and after.", GOOD
        return
    words = ", ".join(
        f"{c} {b:.2f} to {a:.2f}"
        for c, (b, a) in sorted(above.items(), key=lambda item: -max(item[1]))
    )
    shrank = all(a <= b * (1 + SAME) for b, a in above.values())
    reached = all(a <= _ABOVE_NOISE for _, a in above.values())
    yield (
        f"{flown} went, from before to after: {words} (1: the sensors' noise).",
        GOOD if shrank and reached else WARN,
    )


def _stems(names: Sequence[str]) -> list[str]:
    return [Path(name).stem for name in names]


def _unexplained(document: Mapping[str, Any]) -> str:
    withdrawn = [e["name"] for e in document["effects"] if e["withdrawn"]]
    if withdrawn:
        return (
            f"{', '.join(withdrawn)} did not shrink the gap on the test flights and was withdrawn"
        )
    where = [
        w.get("words") or w.get("coefficient", "")
        for w in document["remaining"]["where"]
        if "words" in w or "t" not in w
    ]
    return (
        "; ".join(w for w in where if w) or "the residuals are not white, and no place stands out"
    )


def _coverage(out: Path, flights: Sequence[str], both: bool) -> Iterator[Sentence]:
    documents = {
        when: read_document(out / f"validate-{when}" / "coverage.json", Coverage)
        for when in ((BEFORE, AFTER) if both else (BEFORE,))
    }
    found = {when: document["coverage"] for when, document in documents.items()}
    named = ", ".join(flights)
    for when, coverage in found.items():
        shares = {c: row["0.95"] for c, row in coverage.items()}
        low, high = min(shares, key=lambda c: shares[c]), max(shares, key=lambda c: shares[c])
        which = f" {when} refinement" if both else ""
        text = f"Of {named}, {100 * shares[low]:.1f} % ({low}) to {100 * shares[high]:.1f} % ({high}) lies inside"
        text += f" the 95 % bounds{which}"
        verdicts = documents[when].get("verdicts", {})
        bad = [c for c, said in verdicts.items() if said == "fails"] or [
            c for c in shares if not shares[c] >= HOLDS_FROM
        ]
        open_ = [c for c, said in verdicts.items() if said == "inconclusive"]
        if bad:
            text += f": those of {', '.join(bad)} do not hold."
        elif open_:
            text += f": too short a flight to tell of {', '.join(open_)}."
        else:
            text += "."
        yield text, BAD if bad else WARN if open_ else GOOD
    if both:
        widths = {
            w: {c: row["mean_width"] for c, row in coverage.items()}
            for w, coverage in found.items()
        }
        change = {
            c: _change(widths[BEFORE][c], width)
            for c, width in widths[AFTER].items()
            if c in widths[BEFORE]
        }
        moved = ", ".join(f"{c} {100 * x:+.0f} %" for c, x in change.items() if abs(x) > SAME)
        still = ", ".join(c for c, x in change.items() if abs(x) <= SAME)
        unknown = ", ".join(c for c, x in change.items() if math.isnan(x))
        ends = (
            (moved, ""),
            (still, " as before"),
            (unknown, " undefined, a width is 0 or not known"),
        )
        words = "; ".join(names + end for names, end in ends if names)
        text = f"Mean width of the bounds on {named}, after against before refinement: {words}"
        shrank = [c for c, x in change.items() if x < -SAME]
        yield f"{text}{'' if shrank else '; none is narrower'}.", PLAIN if shrank else WARN


def _change(before: float | None, after: float | None) -> float:
    """Relative change; NaN where one is not known or there was nothing to change from."""
    return math.nan if not before or after is None else after / before - 1.0


def _identified(document: Mapping[str, Any], code: int) -> Sentence:
    done = [row for row in document["parameters"].values() if row["status"] == "identified"]
    flights = ", ".join(_stems(document["flights"]))
    text = f"{len(done)} of {len(document['parameters'])} parameters were identified from {flights} by {document['method']}"
    ratios = {
        c: v["rms"] / v["noise"]
        for c, v in document["fit"].items()
        if v["rms"] is not None and v["noise"]
    }
    worst = max(ratios, key=lambda c: ratios[c], default="")
    if worst:
        text += f"; the largest residual is {ratios[worst]:.2f} times the noise ({worst})"
    if code:
        return f"{text}. The estimation did NOT converge, or nothing was identified.", BAD
    tested = GOOD if worst else PLAIN
    return f"{text}.", tested if not worst or ratios[worst] <= _ABOVE_NOISE else WARN
