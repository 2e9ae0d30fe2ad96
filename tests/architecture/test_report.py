"""The report of readability counts what it says."""

from __future__ import annotations

from tests.architecture.report import main, measure, table

SOURCE = '''"""One docstring line."""

import os


def wanted(own):
    # A comment.
    found = own
    residual = found
    return residual, os
'''


def test_a_source_is_measured(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(SOURCE + "x = " + "1" * 100 + "\n")
    result = measure([path])
    assert (result.modules, result.median_lines, result.wide_lines) == (1, 11, 1)
    assert result.vague_names == {"wanted": 1, "own": 1, "found": 1}
    assert result.bindings == 5
    assert result.docstring_share == result.import_share == result.comment_share == 1 / 11
    fulfilled = {name: ok for name, _, _, ok in table(result)}
    assert fulfilled["modules"]
    assert not fulfilled["median lines"]
    assert not fulfilled["vague names per 1000"]


def test_a_folder_without_python_is_refused(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "no Python file" in capsys.readouterr().err
