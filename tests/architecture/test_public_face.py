"""The public face: which names there are, what their docstrings tell, and that the import costs
next to nothing.
"""

from __future__ import annotations

import inspect
import subprocess
import sys
from types import ModuleType

import pytest

import sysid
import uqharness as uq
from tests.helpers.docstrings import sections
from tests.helpers.places import ROOT

NAMES = {
    "uqharness": (
        "BadInputError LogError author campaign_area campaign_convergence campaign_report"
        " campaign_status check_campaign check_surrogate compare diff dossier export export_log"
        " find_aircraft find_trim fit_model_form fly identify instrument linearise log_info margins"
        " merge_campaign next_flight pbox performance plot_pbox propose_map read_campaign"
        " read_flights refine report rerun_case run_campaign salvage_campaign sensitivity study"
        " validate_bounds verify"
    ),
    "uqharness.sensitivity": (
        "Evaluations Index METHODS MethodResult PairRange Sensitivity Study analyse average"
        " read_study run_study write_study"
    ),
    "sysid": (
        "FlightRecord LogError ModelForm equation_error filter_error output_error"
        " read_model_form stepwise"
    ),
}
FACES = {"uqharness": uq, "uqharness.sensitivity": uq.sensitivity, "sysid": sysid}
HEAVY = ("numpy", "scipy", "pandas", "pyarrow", "jsbsim", "matplotlib", "pydantic", "lxml")


@pytest.mark.parametrize("face", NAMES)
def test_the_public_names(face: str):
    module = FACES[face]
    assert sorted(module.__all__) == NAMES[face].split()
    assert dir(module) == module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
    assert not hasattr(module, "no_such_name")


def documented() -> list[tuple[str, str]]:
    return [(face, name) for face, names in NAMES.items() for name in names.split()]


@pytest.mark.parametrize(("face", "name"), documented())
def test_a_public_name_is_told_of(face: str, name: str):
    thing = getattr(FACES[face], name)
    if name == "METHODS":
        return
    assert thing.__doc__, f"{face}.{name} has no docstring"
    if not isinstance(thing, ModuleType | type):
        assert lacking(thing) == []


def lacking(function: object) -> list[str]:
    """Sections that a function's docstring should have and does not, and parameters that it passes
    over.
    """
    result = sections(inspect.getdoc(function) or "")
    signature = inspect.signature(function)  # type: ignore[arg-type]
    expected = ["Parameters"] if signature.parameters else []
    expected += ["Examples"] + (
        ["Returns"] if signature.return_annotation not in (None, "None") else []
    )
    if "raise" in inspect.getsource(function) or "Raises" in (inspect.getdoc(function) or ""):  # type: ignore[arg-type]
        expected.append("Raises")
    listed = {
        name.strip()
        for line in result.get("Parameters", "").splitlines()
        if line and not line.startswith(" ")
        for name in line.partition(" :")[0].split(",")
    }
    return [s for s in expected if s not in result] + [
        p for p in signature.parameters if p not in listed
    ]


def test_a_docstring_that_passes_something_over_is_seen():
    def short(a: int, b: int) -> int:
        """Add.

        Parameters
        ----------
        a : int
            One.
        """
        return a + b

    assert lacking(short) == ["Examples", "Returns", "b"]


CODE = """
import sys
import {module} as face
loaded = [name for name in {heavy} if name in sys.modules]
face.LogError
print(loaded + [name for name in {heavy} if name in sys.modules], face.__name__)
"""


@pytest.mark.parametrize("module", ["uqharness", "sysid"])
def test_the_import_loads_no_numerical_library(module: str):
    def loaded(code: str) -> str:
        command = [sys.executable, "-c", code.format(module=module, heavy=HEAVY)]
        return subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.strip()

    assert loaded(CODE) == f"[] {module}"
    assert "'numpy'" in loaded(CODE.replace("face.LogError", "import sysid.record"))
