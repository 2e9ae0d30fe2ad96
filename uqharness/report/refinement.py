"""What a refinement leaves on disk and on the screen."""

from __future__ import annotations

import difflib
import json
import math
from pathlib import Path
from typing import Any

from sysid.aerodynamics.terms import COEFFICIENTS
from uqharness.files import inner_folder, write_bytes
from uqharness.refinement.run import Refinement
from uqharness.refinement.showing.mission import DRAWN
from uqharness.refinement.showing.show import most_improved
from uqharness.refinement.showing.words import carried_by, interval_lines, left_over, nowhere, pbox_lines, test_says
from uqharness.replay.histories import columns_of, write_histories
from uqharness.replay.model import CONTROLS
from uqharness.report.pages.index import write_report as write_page

FIGURES = ("gap.svg", "history.svg", "intervals.svg", "pbox.svg", "candidates.svg", "coefficients.svg")


def clean(value: Any) -> Any:
    """The same with null for figures that are not finite, ready for JSON."""
    if isinstance(value, dict):
        return {k: clean(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [clean(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def write_report(done: Refinement, out: Path, figures: bool = True) -> None:
    """refinement.json, model.diff, histories.parquet, figures and, from the first three, report.html."""
    for key, value in clean(done.document).items():
        done.document[key] = value
    write_bytes(out / "refinement.json", (json.dumps(done.document, indent=1) + "\n").encode())
    diff = model_diff(done)
    write_bytes(out / "model.diff", diff.encode("utf-8", errors="surrogateescape"))
    _write_histories(done, out)
    for name in FIGURES:
        (out / "figures" / name).unlink(missing_ok=True)
    if figures:
        _figures(done, out)
    write_page(out)


def _write_histories(done: Refinement, out: Path) -> None:
    """Test flights under both models, in channels and coefficients."""
    setup, before, after = done.judged.test
    models = {"_before": before, "_after": after}
    columns = columns_of(setup.outputs, setup.measured) | columns_of(CONTROLS, [s.controls for s in setup.segments])
    for suffix, shown in models.items():
        modelled = [z - r for z, r in zip(setup.measured, shown.residual, strict=True)]
        columns |= columns_of(setup.outputs, modelled, suffix)
        columns |= columns_of(COEFFICIENTS, shown.coefficients, f"_gap{suffix}")
    write_histories(out, setup.segments, columns)


def _figures(done: Refinement, out: Path) -> None:
    """Figures as files in ``out/figures``."""
    from uqharness.report.plots.refine import candidates_figure, residual_figure, shrinkage_figure
    from uqharness.report.plots.refine_show import history_figure, intervals_figure, pbox_figure

    folder = inner_folder(out, "figures")
    gap = done.document["gap"]["test"]
    setup, before, after = done.judged.test
    shrinkage_figure(gap, folder / "gap.svg", "Test flights: gap before and after")
    stands = bool(done.document["effects"])
    if stands:
        label, history = most_improved(setup, before, after)
        how = ", predicted one sample ahead" if done.chosen.gusty else ""
        history_figure(history, folder / "history.svg", f"Test flights, most improved: {label}{how}")
    if gap["intervals"]["reason"] is None:
        title = "Model-form intervals from the train flights, judged on the test flights"
        intervals_figure(gap["intervals"], folder / "intervals.svg", title)
    if done.mission.boxes:
        shown = [b for b in done.mission.boxes if b.metric in DRAWN] or list(done.mission.boxes)
        title = f"{gap['pbox']['mission']}: p-box within the intervals"
        pbox_figure(shown[:6], folder / "pbox.svg", title)
    found = done.chosen
    if found.scoreboard:
        chosen = [f"{e.get('coefficient') or e['subsystem']} {e['term']}" for e in done.document["chosen"]]
        title = "Train flights: what explains the disagreement"
        candidates_figure(found.scoreboard, found.limit, chosen, folder / "candidates.svg", title)
    touched = list(dict.fromkeys(e["coefficient"] for e in done.document["effects"] if "coefficient" in e))
    if touched:
        columns = [COEFFICIENTS.index(c) for c in touched]
        residual_figure(
            [s.time_s for s in setup.segments], [g[:, columns] for g in before.coefficients],
            [g[:, columns] for g in after.coefficients], touched, after.floor[columns], folder / "coefficients.svg",
            "Test flights: coefficient demanded minus the model's",
        )  # fmt: skip


def model_diff(done: Refinement) -> str:
    """Unified difference of every XML file of the two aircraft folders."""
    old, new = done.given.folder, done.aircraft.folder
    names = sorted({p.relative_to(f).as_posix() for f in (old, new) for p in f.rglob("*.xml")})
    out: list[str] = []
    for name in names:
        a, b = (
            (f / name).read_bytes().decode("utf-8", errors="surrogateescape").splitlines(keepends=True)
            if (f / name).is_file()
            else []
            for f in (old, new)
        )
        out += difflib.unified_diff(a, b, f"a/{name}", f"b/{name}")
    return "".join(out)


def summary(document: dict[str, Any], out: Path) -> str:
    """What stands on the screen."""
    lines = [f"verdict: {document['verdict']}"]
    lines += [f"disagreement: {d['words']}" for d in document["disagreement"][:5]]
    if not document["disagreement"]:
        lines.append(f"disagreement: {nowhere(document)}")
    for e in document["effects"]:
        lines.append(
            f"effect: {e['name']}: {e['value']:.5g} +/- {e['std']:.2g} {e['unit']} "
            f"({carried_by(e)}), |t| {abs(e['evidence']['t']):.1f}"
        )
        lines.append(f"        {e['why']}")
        for a in e["alternatives"]:
            lines.append(
                f"        {'told from' if a['separable'] else 'NOT told from'} {a['name']}"
                + ("" if a["separable"] else f"; would separate: {a['would_separate']}")
            )
        lines.append(f"        {test_says(e)}")
    for e in document["withdrawn"]:
        lines.append(f"withdrawn: {e['name']}: {test_says(e)}")
    gap = document["gap"]["test"]
    lines.append(f"{'test flights':<14}{'before':>10}{'after':>10}{'noise':>10}")
    for kind in ("channels", "coefficients"):
        for name, row in gap[kind].items():
            lines.append(f"{name:<14}{row['rms_before']:>10.4g}{row['rms_after']:>10.4g}{row['noise_rms']:>10.4g}")
    lines += interval_lines(gap["intervals"]) + pbox_lines(gap["pbox"])
    left = left_over(document["remaining"])
    lines += [f"{'unexplained' if document['remaining']['unexplained'] else 'left'}: {text}" for text in left[:6]]
    lines += [f"note: {n}" for n in document["notes"]]
    lines.append(f"{document['seconds']} s; results in {out}")
    return "\n".join(lines)
