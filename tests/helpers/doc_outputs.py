"""Result files held against the reference that the documentation prints of them."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pandas as pd

from tests.helpers.places import ROOT

SITE = ROOT / "docs" / "site"


def check_outputs(folder: Path) -> int:
    """Hold every result file under ``folder`` against the reference; how many were looked at."""
    sys.path.insert(0, str(SITE))
    try:
        import reference
        import reference_words as words
    finally:
        sys.path.remove(str(SITE))
    tables = {"pbox.parquet": words.PBOX, "sensitivity.csv": words.SENSITIVITY}
    tables |= dict.fromkeys(("excursions.csv", "statements.csv", "decisions.csv"), words.RATES)
    observed = 0
    for name, reports in {"cases.parquet": words.CASES, **tables}.items():
        for path in folder.rglob(name):
            frame = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)
            for column in frame.columns:
                words.meaning(re.sub(r"^(level|variable)_.*/.*", r"\1_<property>", column), reports)
            observed += 1
    documents = {name: reports for name, _, reports in reference.DOCUMENTS} | {
        "model-form.json": words.MODEL_FORM
    }
    for name, reports in documents.items():
        for path in folder.rglob(name):
            assert set(json.loads(path.read_text(encoding="utf-8"))) == set(reports), path
            observed += 1
    return observed
