"""report.html and figures/*.svg: which drawings go into which file, and that a terminal shows the
page's first lines.
"""

from __future__ import annotations

import numpy as np
import pytest
from lxml import etree, html

from tests.helpers import report_folders as folders
from tests.helpers.model_forms import made_up_form
from tests.helpers.page_checks import problems
from uqharness.report.write import (
    write_report,
)

FILES = {
    "identified": {"flight1-00-roll-doublet", "flight1-01-yaw-doublet"},
    "compared": {"gaps", "coefficients", "00-roll-doublet", "01-yaw-doublet"},
    "bounded": {f"slices-{c}" for c in made_up_form().coefficients},
    "covered": {"coverage"},
    "refined": {"gap", "history", "intervals", "candidates", "coefficients"},
}


def labels(path):
    """What the charts of a file show, in words."""
    return [e.get("aria-label") for e in etree.parse(str(path)).getroot().findall("{*}svg")]


@pytest.mark.parametrize("kind", FILES)
def test_a_file_holds_the_charts_of_the_page(tmp_path, kind):
    folder = getattr(folders, kind)(tmp_path / "results")
    report = write_report(folder, figures=True)
    assert (
        {path.stem for path in report.figures}
        == {path.stem for path in (folder / "figures").iterdir()}
        == FILES[kind]
    )
    page = report.path.read_text(encoding="utf-8")
    assert problems(page) == []
    first = {path: path.read_bytes() for path in report.figures}
    for path in report.figures:
        assert labels(path)
    drawing = {chart for path in report.figures for chart in labels(path)}
    assert drawing <= {svg.get("aria-label") for svg in html.document_fromstring(page).iter("svg")}
    write_report(folder, figures=True)
    assert {path: path.read_bytes() for path in report.figures} == first


def test_every_segment_has_its_file_and_the_page_the_worst_alone(tmp_path):
    folder = folders.identified(tmp_path / "results")
    many = [(f"flight{k}", "roll doublet", folders.TIME) for k in range(5)]
    columns = {
        "q_radps": [np.sin(folders.TIME)] * 5,
        "q_radps_model": [0.1 * k * np.sin(folders.TIME) for k in range(5)],
    }
    folders.write_pieces(folder / "histories.parquet", many, columns)
    report = write_report(folder, figures=True)
    assert len(report.figures) == 5
    page = report.path.read_text(encoding="utf-8")
    assert [f"fit-history-{k}-q_radps" in page for k in range(5)] == [
        True,
        True,
        True,
        False,
        False,
    ]


def test_names_of_flights_and_manoeuvres_are_safe_as_names_of_files(tmp_path):
    folder = folders.identified(tmp_path / "results")
    odd = [("../a b", "3-2-1-1, 22 m/s", folders.TIME)]
    columns = {"q_radps": [np.sin(folders.TIME)], "q_radps_model": [np.cos(folders.TIME)]}
    folders.write_pieces(folder / "histories.parquet", odd, columns)
    (path,) = write_report(folder, figures=True).figures
    assert path == folder / "figures" / "..-a-b-00-3-2-1-1-22-m-s.svg"
