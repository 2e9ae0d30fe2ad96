"""Coefficients added to aerodynamics in any axes; the author's other bytes stay."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import COEFFICIENTS
from tests.jsbsim_defects.small_models import SKELETON
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.staging import Staging
from uqharness.xml.aerodynamics import (
    Reference,
    SectionEdit,
    add_deltas,
    add_functions,
    add_system,
    read_section,
)
from uqharness.xml.document import parse_document

DELTAS = {name: [f"d/{name}"] for name in COEFFICIENTS}
DECLARED = [f'<property value="0">d/{name}</property>' for name in COEFFICIENTS]
FORCES = [f"forces/fb{axis}-aero-lbs" for axis in "xyz"]
MOMENTS = [f"moments/{axis}-aero-lbsft" for axis in "lmn"]
AXES = {
    "body": '<axis name="X">{0}</axis><axis name="Y">{1}</axis><axis name="Z">{2}</axis>',
    "body-by-frame": '<axis name="X" frame="BODY">{0}</axis><axis name="Z" frame="BODY">{2}</axis>',
    "lift-drag-side": (
        '<axis name="LIFT">{2}</axis><axis name="DRAG">{0}</axis><axis name="SIDE">{1}</axis>'
    ),
    "drag-alone": '<axis name="DRAG">{0}</axis>',
    "side-alone": '<axis name="SIDE">{1}</axis>',
    "axial-normal": (
        '<axis name="AXIAL">{0}</axis><axis name="SIDE">{1}</axis><axis name="NORMAL">{2}</axis>'
    ),
    "side-before-normal": '<axis name="SIDE">{1}</axis><axis name="NORMAL">{2}</axis>',
    "wind-by-frame": '<axis name="X" frame="WIND">{0}</axis><axis name="Y" frame="WIND">{1}</axis>',
    "stability": (
        '<axis name="X" frame="STABILITY">{0}</axis><axis name="Z" frame="STABILITY">{2}</axis>'
    ),
    "none": "",
    "empty": "EMPTY",
    "replaced": (
        '<axis name="LIFT">{2}</axis><axis name="DRAG">{0}</axis><axis name="LIFT"><!-- counts'
        " --></axis>"
    ),
}
MOMENT_AXES = {
    "body": '<axis name="PITCH">{0}</axis><axis name="YAW">{1}</axis>',
    "none": "",
    "stability": '<axis name="ROLL" frame="STABILITY">{0}</axis>',
    "wind": '<axis name="YAW" frame="WIND">{0}</axis><axis name="PITCH" frame="WIND">{1}</axis>',
}


def function(name: str, value: float) -> str:
    return (
        "<function"
        f' name="own/{name}"><product><property>aero/qbar-psf</property><value>{value}</value></product></function>'
    )


def write(root: Path, aero: str) -> Path:
    folder = root / "aircraft" / "small"
    folder.mkdir(parents=True, exist_ok=True)
    skeleton = (
        SKELETON.replace("<aerodynamics>{aero}</aerodynamics>", "<aerodynamics/>")
        if "EMPTY" in aero
        else SKELETON
    )
    aero = aero.replace("EMPTY", "")
    text = skeleton.format(
        fcs="", aero=aero, ixz="<ixz unit='KG*M2'>0.4</ixz>", mass_attributes="", aerorp=-0.3
    )
    (folder / "small.xml").write_text(text)
    return folder


def added(folder: Path, reference: Reference | None = None) -> None:
    """Instrument the folder in place."""
    edit = add_functions(SectionEdit(read_section(folder, "small.xml")), DECLARED)
    for path, content in add_deltas(edit, DELTAS, "d", reference).files().items():
        path.write_bytes(content)


def steps(folder: Path, deltas: dict[str, float], count: int = 20):
    """Forces and moments of a banked, slipping flight whose last frame, and no other, has the
    deltas.
    """
    fdm = engine.open_fdm(Staging(folder.parent.parent, "small"), 0.01)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"], fdm["ic/p-rad_sec"] = (
        3000,
        70,
        9,
        12,
        0.3,
    )
    engine.run_ic(fdm)
    rows = []
    for k in range(count):
        if k == count - 1:
            for name, value in deltas.items():
                engine.set_property(fdm, f"d/{name}", value)
        fdm.run()
        rows.append(
            [
                fdm[n]
                for n in (*FORCES, *MOMENTS, "aero/qbar-psf", "aero/alpha-rad", "position/h-sl-ft")
            ]
        )
    return np.array(rows), [fdm[f"metrics/{n}"] for n in ("Sw-sqft", "bw-ft", "cbarw-ft")]


@pytest.mark.parametrize(
    ("forces", "moments"),
    [*itertools.product(AXES, ["body"]), *itertools.product(["stability"], MOMENT_AXES)],
)
def test_a_delta_is_qS_and_lengths_in_body_axes_whatever_the_authors_axes(
    tmp_path, forces, moments
):
    specific = [function(name, value) for name, value in (("a", 0.3), ("b", -0.2), ("c", 1.1))]
    turned = [function(name, value) for name, value in (("l", 0.05), ("m", -0.07))]
    folder = write(tmp_path, AXES[forces].format(*specific) + MOMENT_AXES[moments].format(*turned))
    untouched, _ = steps(folder, {})
    added(folder)
    idle, (S, b, c) = steps(folder, {})
    assert np.array_equal(untouched, idle)
    assert np.abs(idle[-1, 7]) > 0.1, "a test at zero incidence could not tell the axes apart"
    for index, name in enumerate(COEFFICIENTS):
        delta = 0.013 * (index + 1)
        moved, _ = steps(folder, {name: delta})
        assert np.array_equal(moved[:-1], idle[:-1])
        expected = np.zeros(9)
        expected[index] = idle[-1, 6] * S * (1, 1, 1, b, c, b)[index] * delta
        scale = np.abs(expected).max() + np.abs(idle[-1, :6]).max()
        assert moved[-1] - idle[-1] == pytest.approx(expected, rel=1e-9, abs=1e-12 * scale), name


@pytest.mark.parametrize(
    ("aero", "message"),
    [
        (
            '<axis name="X"/>\n<axis name="LIFT"/>',
            r"small\.xml:\d+: force axes are mixed.*LIFT.*wind.*X.*body",
        ),
        ('<axis name="DRAG"/>\n<axis name="NORMAL"/>', r"mixed.*NORMAL.*axial"),
        ('<axis name="ROLL"/><axis name="YAW" frame="WIND"/>', r"moment axes are mixed.*YAW.*wind"),
        ('<axis name="lift"/>', r"axis 'lift' is unknown.*LIFT"),
        ('<axis name="X" frame="EARTH"/>', r"frame 'EARTH' is unknown.*STABILITY"),
        (
            '<axis name="X"><function name="d/force/X"><value>1</value></function></axis>',
            r":\d+: the aircraft already has",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_line(tmp_path, aero, message):
    folder = write(tmp_path, aero)
    with pytest.raises(BadInputError, match=message):
        added(folder)


INCLUDED = """<?xml version="1.0" encoding="ISO-8859-1"?>\r
<!-- Tragfl\xe4che <axis name="X"> -->\r
<aerodynamics>\r
\t<!-- wind > axes -->\r
\t<axis name = 'LIFT' >\r
\t\t<function name="own/lift">  <!-- lbf > 0 -->\r
\t\t\t<product><property>aero/qbar-psf</property><value>1.1</value></product>\r
\t\t</function>\r
\t</axis>   <!-- end of LIFT -->\r
\t<axis name="DRAG"/>\r
</aerodynamics>\r
"""


def test_an_included_file_keeps_encoding_tabs_line_ends_and_comments(tmp_path):
    folder = write(tmp_path, "")
    main = folder / "small.xml"
    main.write_text(
        main.read_text().replace(
            "<aerodynamics></aerodynamics>", '<aerodynamics file="parts/Aero"/>'
        )
    )
    (folder / "parts").mkdir()
    before = INCLUDED.encode("latin-1")
    (folder / "parts" / "Aero.xml").write_bytes(before)
    original = main.read_bytes()
    section = read_section(folder, "small.xml")
    edit = add_system(
        add_deltas(SectionEdit(section), DELTAS, "d", remark="model form"), "model-form"
    )
    files = edit.files()
    assert set(files) == {main, folder / "parts" / "Aero.xml"}
    after = files[folder / "parts" / "Aero.xml"]
    assert after.count(b"\n") == after.count(b"\r\n")
    # Nothing of the author's is missing, and nothing moved: what was added comes in whole lines,
    # <axis .../> opened apart.
    author = [line for line in before.split(b"\r\n") if line != b'\t<axis name="DRAG"/>']
    remaining = iter(after.split(b"\r\n"))
    assert all(line in remaining for line in author)
    assert (
        b'\t\t<function name="d/force/LIFT" apply_at_cg="true">\r\n\t\t\t<!-- model form -->\r\n'
        in after
    )
    assert b'\t<axis name="SIDE">\r\n\t\t<function' in after
    added_lines = files[main].splitlines(), original.splitlines()
    assert [line for line in added_lines[0] if line not in added_lines[1]] == [
        b'  <system file="model-form"/>'
    ]


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"<a>\n<b></a>", r"a\.xml:2: not well-formed"),
        ("<a/>".encode("utf-16"), "UTF-16"),
        (b"<!DOCTYPE a [<!ENTITY e '<b/>'>]>\n<a>&e;</a>", "entity"),
        (b"", "not well-formed"),
    ],
)
def test_files_that_are_not_edited(tmp_path, raw, message):
    with pytest.raises(BadInputError, match=message):
        parse_document(tmp_path / "a.xml", raw)
