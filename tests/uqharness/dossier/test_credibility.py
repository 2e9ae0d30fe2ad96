"""Factors of credibility: evidence where the folder has some, "not assessed" never replaced by a
level.
"""

import json

from tests.helpers import report_folders as folders
from uqharness.dossier.evidence import factors, read_evidence, simulating_models
from uqharness.dossier.match import Match

NAMES = [
    "Data pedigree",
    "Verification",
    "Validation",
    "Input pedigree",
    "Uncertainty characterisation",
    "Results robustness",
    "Use history",
    "People",
]


def evidence_of(folder, match=None):
    result = read_evidence(folder)
    return {f.name: f.evidence for f in factors(result, match or Match((), {}))}


def test_all_eight_and_none_made_up(tmp_path):
    result = evidence_of(folders.refined(tmp_path / "r"))
    assert list(result) == NAMES
    assert result["Use history"] == result["People"] == result["Input pedigree"] == ()
    assert result["Validation"] == (
        "refine: on the hold-out flights rms over noise is at most 0.97 (q_radps)",
    )
    assert "level" not in str(result).lower()


def test_credibility_of_an_identification(tmp_path):
    result = evidence_of(folders.identified(tmp_path / "i"))
    assert "identified from a<b>.parquet, recorded with SHA-256" in result["Data pedigree"][0]
    assert "estimated for 1 of 2 channels" in result["Data pedigree"][1]
    assert result["Verification"] == ("identify: the estimation converged",)
    assert result["Uncertainty characterisation"] == (
        "identify: standard errors of 2 of 3 parameters; 1 are not identified",
    )


def test_flights_of_a_simulation_are_called_that(tmp_path):
    fly = folders.stage("fly", "fly", None, command="uqharness fly plane_truth --script s.xml")
    real = folders.stage("import", "import", None)
    for stages, expected in (([fly, real], ["plane_truth"]), ([real], [])):
        (tmp_path / "study.json").write_text(json.dumps(folders.study(stages)))
        assert simulating_models(read_evidence(tmp_path)) == expected
