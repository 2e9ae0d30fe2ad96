"""Write the files of a refinement: its document, the difference of the XML and the histories.

They stand apart from `uqharness.report.write`, which every command with a page loads: a refinement
loads the estimators.
"""

from __future__ import annotations

import difflib
from pathlib import Path

from sysid.aerodynamics import COEFFICIENTS
from uqharness.checksums import write_sums
from uqharness.files import remove, write_bytes, write_json
from uqharness.refinement import Refinement
from uqharness.replay import CONTROLS, columns_of, write_histories

FIGURES = (
    "gap.svg",
    "history.svg",
    "intervals.svg",
    "pbox.svg",
    "candidates.svg",
    "coefficients.svg",
    "unnamed.svg",
)
"""Figures of a refinement; those of an earlier run are removed."""


def write_results(done: Refinement, out: Path) -> None:
    """Write the files of a refinement.

    Parameters
    ----------
    done : Refinement
        Result.
    out : Path
        Folder for refinement.json, model.diff and histories.parquet.
    """
    write_json(out / "refinement.json", done.document.as_json())
    write_bytes(out / "model.diff", model_diff(done).encode("utf-8", errors="surrogateescape"))
    for name in FIGURES:
        remove(out / "figures" / name)
    # Histories of the hold-out flights: measurement, controls, and both models.
    setup, before, after = done.hold_out.test
    models = {"_before": before, "_after": after}
    columns = columns_of(setup.outputs, setup.measured) | columns_of(
        CONTROLS, [s.controls for s in setup.segments]
    )
    for suffix, evaluation in models.items():
        # Model output = measurement minus residual.
        modelled = [z - r for z, r in zip(setup.measured, evaluation.residual, strict=True)]
        columns |= columns_of(setup.outputs, modelled, suffix)
        columns |= columns_of(COEFFICIENTS, evaluation.coefficients, f"_gap{suffix}")
    write_histories(out, setup.segments, columns)
    write_sums(out, done.earlier_damage)


def model_diff(done: Refinement) -> str:
    """Return the unified difference of all XML files of two aircraft folders."""
    old, new = done.original.folder, done.aircraft.folder
    # Compare every XML file that exists in either folder.
    names = sorted({p.relative_to(f).as_posix() for f in (old, new) for p in f.rglob("*.xml")})
    out: list[str] = []
    for name in names:
        a, b = (
            (
                (f / name)
                .read_bytes()
                .decode("utf-8", errors="surrogateescape")
                .splitlines(keepends=True)
                if (f / name).is_file()
                else []
            )
            for f in (old, new)
        )
        out += difflib.unified_diff(a, b, f"a/{name}", f"b/{name}")
    return "".join(out)
