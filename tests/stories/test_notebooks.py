"""The notebooks of docs/notebooks: committed without outputs, run in a kernel, and what
they show.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.helpers.places import ROOT

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SLOW = {
    "hidden-effect": "refines: a minute on two quiet cores",
    "log-beside-simulation": "flies ten minutes and compares: 19 s",
    "own-aircraft": "flies a campaign in processes: 18 s of processor time",
}
FIGURES = {"own-aircraft": 1, "log-beside-simulation": 1, "hidden-effect": 1, "sensitivity": 1}
WORDS = {
    "own-aircraft": ("<th>quantile [%]</th>", "PBox("),
    "log-beside-simulation": ("reaches the noise floor", "<th>q_radps</th>"),
    "hidden-effect": ("effects-found", "aero/Cm_p2"),
    "sensitivity": ("Cm_alpha", "anova"),
}


def run(
    book: nbformat.NotebookNode, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> list[dict[str, str]]:
    """What each output shows, by MIME type."""
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(folder / ".jupyter"))
    monkeypatch.setenv(
        "PYTHONPATH",
        os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep),
    )
    monkeypatch.delenv("MPLBACKEND", raising=False)
    nbclient.NotebookClient(
        book, timeout=1500, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    ).execute()
    return [
        dict(output.get("data", {})) for cell in book.cells for output in cell.get("outputs", ())
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_valid_and_has_no_outputs(path: Path):
    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert len(code) >= 4
    assert [cell.outputs for cell in code] == [[]] * len(code)
    assert {cell.execution_count for cell in code} == {None}
    assert book.cells[0].source.startswith("# ")


@pytest.mark.filterwarnings("ignore")  # of the kernel's client, not of this project
@pytest.mark.timeout(1600)
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(p, id=p.stem, marks=[pytest.mark.slow] if p.stem in SLOW else [])
        for p in NOTEBOOKS
    ],
)
def test_a_notebook_runs_and_shows_tables_and_figures(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    visible = run(nbformat.read(path, as_version=4), tmp_path, monkeypatch)
    tables = "".join(data["text/html"] for data in visible if "text/html" in data)
    assert [word for word in WORDS[path.stem] if word not in tables] == []
    assert sum("image/png" in data for data in visible) == FIGURES[path.stem]


@pytest.mark.filterwarnings("ignore")
def test_a_cell_that_fails_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    book = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell("import uqharness as uq\nuq.find_aircraft('nowhere')")]
    )
    with pytest.raises(nbclient.exceptions.CellExecutionError, match="nowhere"):
        run(book, tmp_path, monkeypatch)
