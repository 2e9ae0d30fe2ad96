"""What an identification leaves on disk: fit.json, the parameter table, the aircraft with the estimates."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sysid.estimation import colour, rms
from uqharness.files import finite, write_json, write_text
from uqharness.identification import Identification
from uqharness.plugin import Estimate, write_estimates
from uqharness.replay import CONTROLS, columns_of, write_histories
from uqharness.simulator import Aircraft
from uqharness.text_tables import csv_text


def fit_document(
    found: Identification,
    flights: Sequence[str],
    command: Sequence[str],
    hashes: Sequence[str] = (),
) -> dict[str, Any]:
    """fit.json as a dictionary (docs/identification.md describes it); figures that are not finite are null."""
    names = found.identified
    residual = [
        np.concatenate([block[:, k] for block in found.residual]) for k in range(len(found.outputs))
    ]
    tint = colour(list(found.residual), list(found.modelled))
    fit = {}
    for k, channel in enumerate(found.outputs):
        fit[channel] = {
            "rms": finite(rms(residual[k])),
            "noise": finite(found.noise[channel]),
            "whiteness_p": finite(tint.p_value[k]),
            "predictable_share": finite(tint.predictable[k]),
        }
    return {
        "aircraft": found.aircraft,
        "method": found.method,
        "converged": found.converged,
        "parameters": {
            n: {
                "value": finite(found.theta[i]),
                "std": finite(found.std[i]),
                "std_crb": finite(found.std_crb[i]),
                "status": found.status[n],
                "reason": found.reason[n],
                "initial": finite(found.initial[i]),
            }
            for i, n in enumerate(found.names)
        },
        "names": list(names),
        "cov": [[float(v) for v in row] for row in found.cov],
        "warnings": list(found.warnings),
        "fit": fit,
        "nuisance": {
            n: {"value": finite(v), "std": finite(s)} for n, (v, s) in found.nuisance.items()
        },
        "segments": [
            {
                "flight": s.flight,
                "label": s.label,
                "start_s": float(s.time_s[0]),
                "end_s": float(s.time_s[-1]),
            }
            for s in found.segments
        ],
        "flights": list(flights),
        "flights_sha256": list(hashes),
        "notes": list(found.notes),
        "command": shlex.join(command),
        "simulations": found.simulations,
        "seconds": round(found.seconds, 2),
        "speed": None
        if found.speed is None
        else {k: round(v, 1) for k, v in asdict(found.speed).items()},
    }


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


def write_results(
    found: Identification,
    aircraft: Aircraft,
    flights: Sequence[str],
    command: Sequence[str],
    out: Path,
    hashes: Sequence[str] = (),
) -> dict[str, Any]:
    """fit.json, parameters.csv, histories.parquet and aircraft/ in ``out``; the document. Raises BadInputError.

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
    write_histories(
        out,
        found.segments,
        {
            **columns_of(found.outputs, found.measured),
            **columns_of(found.outputs, found.modelled, "_model"),
            **columns_of(CONTROLS, [s.controls for s in found.segments]),
        },
    )
    write_json(out / "fit.json", document)
    return document
