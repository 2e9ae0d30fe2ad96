"""What `refine` estimates beside an effect is what `identify` estimates of the refined model on the
same flights.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from uqharness.cli.main import main

BETA2 = """<function name="aero/coefficient/Cmbeta2"> <product>
    <property>aero/qbar-psf</property> <property>metrics/Sw-sqft</property> <property>metrics/cbarw-ft</property>
    <property>aero/beta-rad</property> <property>aero/beta-rad</property> <value>1.0</value>
</product> </function>
"""
AIRCRAFT = {
    # stock aircraft: speeds of the two train flights and of the test flight, property off by a
    # factor
    "sgs126": ((30, 36, 33), "uq/scale/Cmq"),
    "sgs233": ((28, 33, 30), "uq/scale/Cmq"),
    "c172x": ((50, 55, 52), "uq/scale/Cmq"),
}


def flights(truth: Path, folder: Path, speeds: tuple[int, ...], scale: str) -> list[str]:
    """Two train flights and a test flight of the truth, with noise."""
    out = []
    for k, (speed, mission) in enumerate(
        zip(speeds, ("doublets", "3-2-1-1", "doublets"), strict=True)
    ):
        path = folder / f"{'abc'[k]}.parquet"
        words = ["--mission", mission, "--speed-mps", str(speed), "--altitude-m", "500"]
        words += ["--duration-s", "17", "--noise", "--seed", str(51 + k), "--set", f"{scale}=1.4"]
        assert main(["fly", str(truth), *words, "--out", str(path)]) == 0
        out.append(str(path))
    return out


@pytest.mark.timeout(3600)
@pytest.mark.slow
@pytest.mark.parametrize("name", ["sgs126", "sgs233", "c172x"])
def test_refine_states_the_optimum_that_identify_states(name, tmp_path):
    speeds, scale = AIRCRAFT[name]
    inputs, truth = tmp_path / "given" / name, tmp_path / "truth" / name
    for folder in (inputs, truth):
        assert main(["instrument", name, "--out", str(folder), "--no-check"]) == 0
    xml = truth / f"{name}.xml"
    text = xml.read_text()
    place = text.index('<function name="uq/scaled/PITCH">')
    xml.write_text(text[:place] + BETA2 + text[place:])
    *train, test = flights(truth, tmp_path, speeds, scale)
    refined, fit = tmp_path / "refined", tmp_path / "fit"
    words = ["--out", str(refined), "--no-pbox", "--no-figures", "--workers", "1"]
    main(["refine", str(inputs), "--train", *train, "--test", test, *words])
    document = json.loads((refined / "refinement.json").read_text())
    assert [(e["coefficient"], e["term"]) for e in document["effects"]] == [("Cm", "beta^2")]
    words = ["--out", str(fit), "--no-figures", "--workers", "1"]
    assert main(["identify", str(refined / "aircraft" / name), "--flight", *train, *words]) == 0
    estimates = json.loads((fit / "fit.json").read_text())["parameters"]
    compared = 0
    for parameter, stated in document["parameters"].items():
        estimate = estimates[parameter]
        if estimate["status"] == "identified":
            difference = abs(stated["value"] - estimate["value"])
            assert difference < 0.1 * estimate["std"], parameter
            compared += 1
    assert compared >= 10
    off = document["parameters"][scale]
    assert abs(off["value"] - 1.4) < 3.5 * off["std"]
    effect = document["effects"][0]
    assert abs(effect["value"] - 1.0) < 3.5 * effect["std"]
