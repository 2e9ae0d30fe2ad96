"""Folders, modules and functions of a size that can be read. The exceptions may only become fewer."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping

from tests.architecture.rooms import modules
from tests.helpers.places import ROOT

MOST_MODULES, MOST_LINES, MOST_ARGUMENTS, MOST_BRANCHES = 25, 500, 8, 15

# Functions with more arguments, by file.
MANY_ARGUMENTS: Mapping[str, int] = {
    # What a user sets is given by name, as scipy.optimize.minimize takes it.
    "sysid/estimation/filter_error.py": 1,
    "sysid/estimation/output_error.py": 1,
    "sysid/estimation/regression.py": 1,
    "sysid/model_form/fit.py": 1,
    "uqharness/api/flights.py": 1,
    "uqharness/api/identification.py": 2,
    "uqharness/api/refinement.py": 1,
    "uqharness/campaign/run.py": 1,
    "uqharness/identification/identify.py": 2,
    "uqharness/sensitivity/study.py": 1,
    # Motion, rates, controls and air along a flight, each an array of its own.
    "sysid/aerodynamics/coefficients.py": 1,
    "sysid/aerodynamics/terms.py": 1,
    "uqharness/identification/compare.py": 1,
    # Matrices of one recursion.
    "sysid/effects/turbulence.py": 1,
    "sysid/estimation/ekf.py": 1,
    "sysid/estimation/report.py": 1,
    "sysid/estimation/sensitivities.py": 1,
    # Refinement's inside is to be rewritten.
    "uqharness/identification/linearised/gusts.py": 1,
}
MANY_BRANCHES: Mapping[str, int] = {
    # Refinement's inside is to be rewritten.
    "uqharness/identification/linearised/columns.py": 1,
}


def judged(source: str, path: str = "-") -> list[tuple[str, str]]:
    """(rule, place) of functions with too many arguments or branches in a source, or in the project where ``path`` is a folder."""
    settings = [f"lint.mccabe.max-complexity={MOST_BRANCHES}", f"lint.pylint.max-args={MOST_ARGUMENTS}"]
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "C901,PLR0913", "--output-format", "json"]
    command += [word for setting in settings for word in ("--config", setting)]
    done = subprocess.run([*command, *path.split()], input=source, capture_output=True, text=True, cwd=ROOT, check=False)
    return [(item["code"], f"{item['filename']}:{item['location']['row']}") for item in json.loads(done.stdout)]


def without_rows(found: list[tuple[str, str]], rule: str) -> dict[str, int]:
    """How many functions of each file break a rule."""
    return dict(Counter(place.rpartition(":")[0].removeprefix(f"{ROOT}/") for code, place in found if code == rule))


def test_folders():
    many = Counter(path.parent for path in modules().values() if path.name != "__init__.py")
    assert {folder.relative_to(ROOT).as_posix(): count for folder, count in many.items() if count > MOST_MODULES} == {}


def test_modules():
    lines = {name: path.read_text(encoding="utf-8").count("\n") for name, path in modules().items()}
    assert {name: count for name, count in lines.items() if count > MOST_LINES} == {}


def test_functions():
    found = judged("", "sysid uqharness")
    assert without_rows(found, "PLR0913") == MANY_ARGUMENTS
    assert without_rows(found, "C901") == MANY_BRANCHES


def test_a_function_too_large_is_seen():
    names = ", ".join(f"a{k}" for k in range(MOST_ARGUMENTS + 1))
    branches = "\n".join(f"    if a0 == {k}:\n        return {k}" for k in range(MOST_BRANCHES + 1))
    codes = {code for code, _ in judged(f"def f({names}):\n{branches}\n")}
    assert codes == {"PLR0913", "C901"}
    assert judged("def f(a):\n    return a\n") == []
