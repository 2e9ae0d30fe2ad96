"""What a refinement leaves on disk and on the screen."""

from __future__ import annotations

import difflib
import json
import math
from pathlib import Path
from typing import Any

from sysid.aero_terms import COEFFICIENTS
from uqharness.histories import columns_of, write_histories
from uqharness.refine_run import Refinement
from uqharness.replay_model import CONTROLS
from uqharness.report_page import write_report as write_page
from uqharness.whole_files import write_bytes


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
    if figures:
        _figures(done, out)
    write_page(out)


def _write_histories(done: Refinement, out: Path) -> None:
    """Test flights under both models, in channels and coefficients."""
    setup, before, after = done.test
    models = {"_before": before, "_after": after}
    columns = columns_of(setup.outputs, setup.measured) | columns_of(CONTROLS, [s.controls for s in setup.segments])
    for suffix, shown in models.items():
        modelled = [z - r for z, r in zip(setup.measured, shown.residual, strict=True)]
        columns |= columns_of(setup.outputs, modelled, suffix)
        columns |= columns_of(COEFFICIENTS, shown.coefficients, f"_gap{suffix}")
    write_histories(out, setup.segments, columns)


def _figures(done: Refinement, out: Path) -> None:
    """Figures as files in ``out/figures``."""
    from uqharness.refine_plot import candidates_figure, residual_figure, shrinkage_figure

    folder = out / "figures"
    folder.mkdir(exist_ok=True)
    setup, before, after = done.test
    shrinkage_figure(done.document["gap"]["test"], folder / "gap.svg", "Test flights: gap before and after")
    if done.found.scoreboard:
        chosen = [f"{e.get('coefficient') or e['subsystem']} {e['term']}" for e in done.document["effects"]]
        candidates_figure(
            done.found.scoreboard,
            done.found.limit,
            chosen,
            folder / "candidates.svg",
            "Train flights: what explains the disagreement",
        )
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
    for e in document["effects"]:
        lines.append(
            f"effect: {e['name']}: {e['value']:.5g} +/- {e['std']:.2g} {e['unit']} "
            f"({e['property'] or 'a sensor'}), |t| {abs(e['evidence']['t']):.1f}"
        )
        lines.append(f"        {e['why']}")
        for a in e["alternatives"]:
            lines.append(
                f"        {'told from' if a['separable'] else 'NOT told from'} {a['name']}"
                + ("" if a["separable"] else f"; would separate: {a['would_separate']}")
            )
        if e["withdrawn"]:
            lines.append("        withdrawn: the gap on the test flights did not shrink")
    gap = document["gap"]["test"]
    lines.append(f"{'test flights':<14}{'before':>10}{'after':>10}{'noise':>10}")
    for kind in ("channels", "coefficients"):
        for name, row in gap[kind].items():
            lines.append(f"{name:<14}{row['rms_before']:>10.4g}{row['rms_after']:>10.4g}{row['noise_rms']:>10.4g}")
    left = document["remaining"]
    if left["unexplained"]:
        lines.append(
            f"unexplained: channels above noise {left['channels_above_noise']}, coloured {', '.join(left['coloured_channels'])}"
        )
        for w in left["where"][:4]:
            lines.append(
                f"  {w['words']}"
                if "words" in w
                else f"  {w['coefficient']}: {w['rms_over_noise']:.2f} noise, with {w['depends_on'][0]['state']}"
            )
    lines += [f"note: {n}" for n in document["notes"]]
    lines.append(f"{document['seconds']} s; results in {out}")
    return "\n".join(lines)
