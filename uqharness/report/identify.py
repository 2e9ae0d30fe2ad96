"""What an identification leaves on disk: fit.json, the parameter table, the aircraft with the estimates."""

from __future__ import annotations

import csv
import io
import json
import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sysid.estimation.diagnostics import colour
from sysid.estimation.gaps import rms
from uqharness.files import write_whole
from uqharness.identification.identify import Identification
from uqharness.plugin.estimates import Estimate, write_estimates
from uqharness.replay.histories import columns_of, write_histories
from uqharness.replay.model import CONTROLS
from uqharness.report.pages.index import write_report
from uqharness.simulator.aircraft import Aircraft


def fit_document(
    found: Identification, flights: Sequence[str], command: Sequence[str], hashes: Sequence[str] = ()
) -> dict[str, Any]:
    """fit.json as a dictionary (docs/identification.md describes it); figures that are not finite are null."""
    names = found.identified
    residual = [np.concatenate([block[:, k] for block in found.residual]) for k in range(len(found.outputs))]
    tint = colour(list(found.residual), list(found.modelled))
    fit = {}
    for k, channel in enumerate(found.outputs):
        fit[channel] = {
            "rms": _finite(rms(residual[k])),
            "noise": _finite(found.noise[channel]),
            "whiteness_p": _finite(tint.p_value[k]),
            "predictable_share": _finite(tint.predictable[k]),
        }
    return {
        "aircraft": found.aircraft,
        "method": found.method,
        "converged": found.converged,
        "parameters": {
            n: {
                "value": _finite(found.theta[i]),
                "std": _finite(found.std[i]),
                "std_crb": _finite(found.std_crb[i]),
                "status": found.status[n],
                "reason": found.reason[n],
                "initial": _finite(found.initial[i]),
            }
            for i, n in enumerate(found.names)
        },
        "names": list(names),
        "cov": [[float(v) for v in row] for row in found.cov],
        "warnings": list(found.warnings),
        "fit": fit,
        "nuisance": {n: {"value": _finite(v), "std": _finite(s)} for n, (v, s) in found.nuisance.items()},
        "segments": [
            {"flight": s.flight, "label": s.label, "start_s": float(s.time_s[0]), "end_s": float(s.time_s[-1])}
            for s in found.segments
        ],
        "flights": list(flights),
        "flights_sha256": list(hashes),
        "notes": list(found.notes),
        "command": shlex.join(command),
        "simulations": found.simulations,
        "seconds": round(found.seconds, 2),
        "speed": None if found.speed is None else {k: round(v, 1) for k, v in asdict(found.speed).items()},
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def parameter_rows(found: Identification) -> list[dict[str, str]]:
    """The table as text, columns as Table 2.6: initial value, estimate, corrected standard error, Cramer-Rao bound, status."""
    rows = []
    for i, name in enumerate(found.names):
        known = found.status[name] == "identified"
        rows.append(
            {
                "parameter": name,
                "initial": f"{found.initial[i]:.5g}",
                "estimate": f"{found.theta[i]:.5g}",
                "std": f"{found.std[i]:.2g}" if known else "",
                "crb": f"{found.std_crb[i]:.2g}" if known else "",
                "status": found.status[name],
                "reason": found.reason[name],
            }
        )
    return rows


def markdown_table(rows: Sequence[dict[str, str]]) -> str:
    """Rows of equal keys as a markdown table."""
    keys = list(rows[0])
    lines = ["| " + " | ".join(keys) + " |", "|" + "---|" * len(keys)]
    return "\n".join([*lines, *("| " + " | ".join(r[k].replace("|", "/") for k in keys) + " |" for r in rows)]) + "\n"


def csv_text(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of equal keys as CSV."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def write_text(path: Path, text: str) -> None:
    """The file whole or not at all."""
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


def report_text(found: Identification, document: dict[str, Any]) -> str:
    """report.md: parameters, fit by channel, segments, warnings."""
    fit_rows = [
        {
            "channel": c,
            "rms": f"{v['rms']:.4g}",
            "noise": f"{v['noise']:.4g}" if v["noise"] is not None else "",
            "ratio": f"{v['rms'] / v['noise']:.2f}" if v["noise"] else "",
            "whiteness p": f"{v['whiteness_p']:.2g}" if v["whiteness_p"] is not None else "",
            "predictable share": f"{v['predictable_share']:.2f}" if v["predictable_share"] is not None else "",
        }
        for c, v in document["fit"].items()
    ]
    lines = [
        f"# {found.aircraft}: identified by {found.method} from {', '.join(document['flights'])}",
        "",
        f"    {document['command']}",
        "",
        markdown_table(parameter_rows(found)),
        "std is one standard deviation, corrected for coloured residuals; crb the uncorrected Cramer-Rao bound.",
        "",
        markdown_table(fit_rows),
        "predictable share: part of the residual's variance that its own past predicts (0 when white).",
        "",
    ]
    lines += [f"- {text}" for text in (*found.warnings, *found.notes)]
    if found.speed is not None:
        lines += ["", f"{found.simulations} simulations, {found.seconds:.1f} s: {found.speed.text()}."]
    return "\n".join(lines) + "\n"


def write_results(
    found: Identification,
    aircraft: Aircraft,
    flights: Sequence[str],
    command: Sequence[str],
    out: Path,
    hashes: Sequence[str] = (),
) -> dict[str, Any]:
    """fit.json, parameters.csv, histories.parquet, report.md, report.html and aircraft/ in ``out``; the document.

    Raises BadInputError.

    hashes: SHA-256 of the flights' files, by which bounds know a flight that the model was identified from.
    """
    document = fit_document(found, flights, command, hashes)
    estimates = {
        n: Estimate(
            float(found.theta[i]),
            f"{found.theta[i]:.4g} +/- {found.std[i]:.2g} by {found.method} from {', '.join(flights)}: uqharness identify",
        )
        for i, n in enumerate(found.names)
        if found.status[n] == "identified"
    }
    unwritten = write_estimates(aircraft, estimates, out / "aircraft")
    if unwritten:
        document["warnings"].append(
            f"not written into the XML, which does not declare them as <property value=...>: {', '.join(unwritten)}"
        )
    write_text(out / "parameters.csv", csv_text(parameter_rows(found)))
    write_text(out / "report.md", report_text(found, document))
    write_histories(
        out,
        found.segments,
        {
            **columns_of(found.outputs, found.measured), **columns_of(found.outputs, found.modelled, "_model"),
            **columns_of(CONTROLS, [s.controls for s in found.segments]),
        },
    )  # fmt: skip
    write_text(out / "fit.json", json.dumps(document, indent=1) + "\n")
    write_report(out)
    return document
