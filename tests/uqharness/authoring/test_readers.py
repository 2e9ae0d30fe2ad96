"""Readers of derivatives: the same flight condition from two outputs, turns, and moved points.

kite.* is the output of AVL 3.4 for kite.avl: ST and SB at 3 degrees about one moment centre, and ST
about another (kite-aft). The outputs about different axes and points test each other.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from uqharness.authoring.avl_input import read_geometry, read_masses, run_avl
from uqharness.authoring.avl_text import read_avl_text
from uqharness.authoring.derivative_table import read_table_file
from uqharness.authoring.read import read_sources
from uqharness.authoring.slips import find_slips
from uqharness.authoring.source import (
    BODY,
    TOTAL,
    Entry,
    Point,
    about,
    body_coefficients,
    rotate_forces,
)
from uqharness.authoring.vspaero import read_stab
from uqharness.authoring.xflr5 import read_xflr5
from uqharness.errors import BadInputError

DATA = Path(__file__).parent / "data"


def read(name):
    (source,) = read_avl_text(DATA / name, (DATA / name).read_text())
    return source


def body(source):
    return body_coefficients(source.points[0], source.surfaces)


def test_stability_output_turned_equals_body_output():
    stability, specific = body(read("kite.st")), body(read("kite.sb"))
    # AVL prints no drag derivatives with ST: they are estimated from the span efficiency.
    for key in specific:
        tolerance = 0.01 if key in (("CX", "q"), ("CX", "elevator")) else 2e-4
        assert specific[key] == pytest.approx(stability[key], abs=tolerance, rel=2e-3), key


def test_a_turn_the_other_way_is_noticed():
    """Negative control: the comparison above sees the sign of alpha."""
    source = read("kite.st")
    point = source.points[0]
    turned = Point(Entry(-point.alpha.value), point.mach, "stability", "stability", point.entries)
    invalid, specific = body_coefficients(turned, source.surfaces), body(read("kite.sb"))
    assert abs(invalid["Cn", "p"] - specific["Cn", "p"]) > 0.02
    assert abs(invalid["CX", "alpha"] - specific["CX", "alpha"]) > 0.2


def test_turn_agrees_with_numerical_rotation():
    """Differences of rotated totals are the derivatives."""
    cl, cd, roll, yaw = 0.37, 0.03, 0.02, -0.01
    slopes = {"CL": 5.1, "CD": 0.2, "Cl": 0.3, "Cn": -0.1}
    alpha = math.radians(7.0)

    def forces(a):
        d = a - alpha
        cx, cz = rotate_forces(cl + slopes["CL"] * d, cd + slopes["CD"] * d, a)
        moments = [roll + slopes["Cl"] * d, yaw + slopes["Cn"] * d]
        turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        return np.array([cx, cz, *(turn @ moments)])

    entries = {
        (name, TOTAL): Entry(v) for name, v in (("CL", cl), ("CD", cd), ("Cl", roll), ("Cn", yaw))
    } | {(name, "alpha"): Entry(v) for name, v in slopes.items()}
    values = body_coefficients(
        Point(Entry(alpha), Entry(0.0), "stability", "stability", entries), ()
    )
    h = 1e-6
    numerical = (forces(alpha + h) - forces(alpha - h)) / (2 * h)
    got = [values[name, "alpha"] for name in ("CX", "CZ", "Cl", "Cn")]
    np.testing.assert_allclose(got, numerical, atol=1e-8)


def test_moved_moments_and_rates_equal_a_run_about_the_other_point():
    aft, forward = read("kite-aft.st"), body(read("kite.st"))
    x, z = (aft.reference[key].value - read("kite.st").reference[key].value for key in "xz")
    assert (x, z) == pytest.approx((0.08, 0.05))
    moved = about(body(aft), (-x, 0.0, -z), 1.6, 0.2163, aft.points[0].alpha.value)
    for name in BODY:
        for variable in (TOTAL, "alpha", "beta", "p", "q", "r", *aft.surfaces):
            if (name, variable) == ("CX", "q"):  # AVL prints no CD_q
                continue
            tolerance = 0.07 if (name, variable) == ("Cm", "q") else 4e-4
            assert moved[name, variable] == pytest.approx(
                forward[name, variable], abs=tolerance, rel=2e-3
            ), (name, variable)
    # Negative control: the points differ by 37 % of the chord.
    assert abs(body(aft)["Cm", "alpha"] - forward["Cm", "alpha"]) > 1.0


def test_geometric_axes_are_reversed():
    text = (DATA / "kite.st").read_text()
    (source,) = read_avl_text(Path("g.st"), text.replace("Standard axis", "Geometric axis"))
    standard = read("kite.st").points[0]
    point = source.points[0]
    assert point.value("Cl", "beta") == -standard.value("Cl", "beta")
    assert point.value("Cl", "p") == standard.value("Cl", "p")
    assert point.value("CY", "r") == -standard.value("CY", "r")
    assert point.value("CL", "alpha") == standard.value("CL", "alpha")


def test_lines_of_numbers():
    source = read("kite.st")
    lines = (DATA / "kite.st").read_text().splitlines()
    entry = source.points[0].entries["Cm", "q"]
    assert f"{entry.value:.6f}" in lines[entry.line - 1]
    assert source.surfaces == ("aileron", "elevator", "rudder")


def test_two_digits_of_later_versions():
    text = re.sub(r"(C[LYlmn])d([123]) =", r"\1d0\2 =", (DATA / "kite.st").read_text())
    (source,) = read_avl_text(Path("later.st"), text)
    assert source.surfaces == ("aileron", "elevator", "rudder")
    assert source.points[0].entries == {
        key: Entry(entry.value, Path("later.st"), entry.line)
        for key, entry in read("kite.st").points[0].entries.items()
    }


def test_one_file_of_several_cases(tmp_path):
    """AVL appends FT, ST and SB of one case, and cases of several alphas, to one file."""
    st, sb, other = ((DATA / n).read_text() for n in ("kite.st", "kite.sb", "kite-7deg.st"))
    totals = st[: st.index(" Stability-axis")]
    path = tmp_path / "log.txt"
    path.write_text(totals + other + st + sb)
    source = read_sources([path]).derivatives
    assert [round(math.degrees(p.alpha.value)) for p in source.points] == [3, 7]
    line = source.points[0].entries["Cm", "q"].line
    assert "Cmq = -17.968149" in path.read_text().splitlines()[line - 1]
    assert any("2 of 3 cases" in note for note in source.notes)
    assert source.facts["x_np"].value == 0.1779
    # Another span, moment centre or surface is another aircraft.
    for change in (("1.6", "1.7"), ("0.12", "0.15"), ("rudder ", "fin    ")):
        (tmp_path / "b.st").write_text(other.replace(*change))
        with pytest.raises(BadInputError, match=r"kite-7deg|b\.st"):
            read_sources([DATA / "kite.st", tmp_path / "b.st"])


def test_totals_of_a_trimmed_run_are_moved_to_zero_deflection():
    """The same wing at the same alpha, elevator at -4 degrees, as AVL prints it."""
    text, de = (
        (DATA / "kite.st")
        .read_text()
        .replace("aileron         =   0.0", "aileron         = 100.0"),
        -4.0,
    )
    for old, new in (
        ("elevator        =   0.00000", f"elevator        =  {de:.5f}"),
        ("CLtot =   0.37030", f"CLtot =   {0.3703 + 0.010051 * de:.5f}"),
        ("Cmtot =   0.00452", f"Cmtot =   {0.00452 - 0.032619 * de:.5f}"),
    ):
        assert old in text
        text = text.replace(old, new)
    (trim,) = read_avl_text(Path("t.st"), text)
    plain = read("kite.st").points[0]
    for name in ("CL", "Cm"):
        assert trim.points[0].value(name, TOTAL) == pytest.approx(
            plain.value(name, TOTAL), abs=2e-5
        )
    assert "aileron 100 deg, elevator -4 deg" in trim.notes[0]


@pytest.mark.parametrize(
    ("name", "encoding"),
    [("kite.st", "utf-16"), ("kite.st", "utf-16-le"), ("kite.st", "utf-8-sig"), ("", "cp1252")],
)
def test_encodings_and_decimal_commas(name, encoding, tmp_path):
    text = (DATA / name).read_text() if name else XFLR5
    path = tmp_path / "source.txt"
    content = text if name else re.sub(r"(\d)\.(?=\d)", r"\1,", text)
    path.write_bytes(content.replace("\n", "\r\n").encode(encoding))
    plain = tmp_path / "plain.txt"
    plain.write_text(text)
    source, expected = (read_sources([p]).derivatives for p in (path, plain))
    assert {k: (e.value, e.line) for k, e in source.points[0].entries.items()} == {
        k: (e.value, e.line) for k, e in expected.points[0].entries.items()
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("CLtot =   0.37030", "CLtot = *********"), "finite number"),
        (("  Alpha =", "  Angle ="), "broken.st:2: .*Alpha"),
    ],
)
def test_broken_output_is_refused_with_its_line(change, message):
    text = (DATA / "kite.st").read_text()
    assert change[0] in text
    with pytest.raises(BadInputError, match=message):
        read_avl_text(Path("broken.st"), text.replace(*change))


TABLE = """# a textbook
name,value,unit,source
S,184,ft2,book
b,33.4,ft,book
c,5.7,ft,book
CL_0,0.41,1,book
CL_alpha,0.0775,1/deg,book
CD_0,0.05,1,book
Cm_alpha,-0.683,1/rad,book
Cm_q,-9.96,1,book
Cl_p,-0.41,1,book
Cm_de,-0.923,1/rad,book
"""


def test_table_units():
    source = read_table_file(Path("navion.csv"), TABLE)
    assert source.length("S") == pytest.approx(184 * 0.3048**2)
    point = source.points[0]
    assert point.value("CL", "alpha") == pytest.approx(4.440, abs=1e-3)
    assert point.value("Cm", "elevator") == -0.923
    assert point.entries["Cm", "q"].line == 10


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), ("\t", "."), ("\t", ",")])
def test_tables_of_spreadsheets(delimiter, decimal, tmp_path):
    text = (DATA / "kite.csv").read_text()
    (tmp_path / "plain.csv").write_text(text)
    rows = [row.split(",") for row in text.splitlines()]
    foreign = [delimiter.join(word.replace(".", decimal) for word in row) for row in rows]
    (tmp_path / "foreign.csv").write_text("\r\n".join(foreign).replace("1/rad", "rad^-1"))
    plain, source = (
        read_sources([tmp_path / name]).derivatives for name in ("plain.csv", "foreign.csv")
    )
    for key, entry in plain.points[0].entries.items():
        assert source.points[0].entries[key].value == entry.value, key
    assert source.length("S") == plain.length("S")


def test_table_in_toml_equals_csv():
    text = """
[reference]
S = { value = 184, unit = "ft2" }
b = { value = 33.4, unit = "ft" }
c_m = 1.73736
[condition]
alpha_deg = 0
axes = "stability"
[derivatives]
CL_0 = 0.41
CL_alpha = { value = 0.0775, unit = "1/deg", source = "book" }
CD_0 = 0.05
Cm_alpha = -0.683
Cm_q = -9.96
Cl_p = -0.41
Cm_de = -0.923
"""
    a = read_table_file(Path("a.csv"), TABLE)
    b = read_table_file(Path("a.toml"), text)
    assert {k: e.value for k, e in a.points[0].entries.items()} == pytest.approx(
        {k: e.value for k, e in b.points[0].entries.items()}
    )
    assert {k: e.value for k, e in a.reference.items()} == pytest.approx(
        {k: e.value for k, e in b.reference.items()}
    )


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("CX_alpha,1,1/rad,x", "axes are body|axes are stability"),
        ("CL_alpha,1,1/grad,x", "unit"),
        ("lift,1,1,x", "unknown name"),
        ("CL_alpha,much,1/rad,x", "finite number"),
    ],
)
def test_table_refuses_with_file_and_line(line, message):
    with pytest.raises(BadInputError, match=message) as error:
        read_table_file(Path("t.csv"), "name,value,unit,source\nCL_0,0.3,1,x\n" + line)
    assert "t.csv:" in str(error.value)


STAB = """
# Name                   Value      Units
Sref_                   0.3438000 Lunit^2
Cref_                   0.2163000 Lunit
Bref_                   1.6000000 Lunit
Xcg_                    0.1500000 Lunit
Ycg_                    0.0000000 Lunit
Zcg_                    0.0000000 Lunit
Mach_                   {mach} no_unit
AoA_                    {alpha} deg
Beta_                   0.0000000 deg
Rho_                    1.2250000 Munit/Lunit^3
Vinf_                  20.0000000 Lunit/Tunit
Roll__Rate              0.0000000 rad/Tunit
Pitch_Rate              0.0000000 rad/Tunit
Yaw___Rate              0.0000000 rad/Tunit
Elev                    0.0000000 deg
#
Coef          Total        Alpha        Beta          p            q            r           Mach         U        ConGrp_1
#              -           per          per
CFx       {cfx}  -0.2000000    0.0000000    0.0000000   -0.2000000    0.0000000    0.0 0.0 0.0
CFy       0.0000000    0.0000000   -0.1900000   -0.0900000    0.0000000    0.2000000    0.0 0.0 0.0
CFz       {cfz}    5.1000000    0.0000000    0.0000000    9.8000000    0.0000000    0.0 0.0 0.57
CMl       0.0000000    0.0000000   -0.0700000   -0.5000000    0.0000000    0.0800000    0.0 0.0 0.0
CMm       {cmm}   -0.7000000    0.0000000    0.0000000  -17.0000000    0.0000000    0.0 0.0 -1.8
CMn       0.0000000    0.0000000    0.0700000   -0.0500000    0.0000000   -0.0800000    0.0 0.0 0.0
# Result                 Value      Units
SM                      0.1372549 no_unit
X_np                    0.1796882 Lunit
"""


def stab_text():
    rows = []
    for mach in ("0.0500000", "0.1000000"):
        for degrees in (0.0, 4.0, 8.0):
            a = math.radians(degrees)
            lift, drag = 0.1 + 5.1 * a, 0.02 + 0.04 * (0.1 + 5.1 * a) ** 2
            cx, cz = rotate_forces(lift, drag, a)
            rows.append(
                STAB.format(
                    mach=mach,
                    alpha=f"{degrees:.7f}",
                    cfx=f"{-cx:.7f}",
                    cfz=f"{-cz:.7f}",
                    cmm=f"{0.02 - 0.7 * a:.7f}",
                )
            )
    return "\n".join(rows)


def test_stab_points_and_signs():
    source = read_stab(Path("kite.stab"), stab_text())
    assert [round(math.degrees(p.alpha.value)) for p in source.points] == [0, 4, 8]
    assert source.surfaces == ("Elev",)
    spaced = read_stab(
        Path("kite.stab"), re.sub(r"^Elev ", "Tail Group 1 ", stab_text(), flags=re.M)
    )
    assert spaced.surfaces == ("Tail_Group_1",)
    # Groups at zero have no row: their cases name them, or else their columns.
    anonymous = read_stab(Path("kite.stab"), re.sub(r"^Elev .*deg.*$", "", stab_text(), flags=re.M))
    assert anonymous.surfaces == ("ConGrp_1",)
    text = (DATA / "kite.stab").read_text()
    rows = re.sub(r"^(?!AoA_|Beta_)\w+ +-?[\d.]+ deg *$", "", text, flags=re.M)
    assert rows != text
    listed = [read_stab(Path("kite.stab"), t).surfaces for t in (text, rows)]
    assert listed[0] == listed[1]
    values = body_coefficients(source.points[1], source.surfaces)
    assert values["CZ", "alpha"] == -5.1
    assert values["Cm", "Elev"] == -1.8
    assert values["CY", "beta"] == -0.19
    with pytest.raises(BadInputError, match="no block with derivatives"):
        read_stab(Path("kite.stab"), stab_text().split("Coef")[0])


# The layout of XFLR5 6: a glider of 0.19 kg, its lengths hidden in the dimensional derivatives.
XFLR5 = """
      Calculation for control position -8.00
         Rotating the elevator by -8.00°, total angle is -8.00°
      Searching for zero-moment angle... Alpha=0.50000°
      Longitudinal derivatives
      Zw= -3.0  CLa= 4.1
      Calculation for control position -2.00
   Mass=       0.190 kg
    CoG_x=      0.0600 m
    CoG_z=      0.0100 m
    Ibxx=       0.004 kg.m²
    Ibyy=       0.005 kg.m²
    Ibzz=       0.008 kg.m²
         Rotating the elevator by -2.00°, total angle is -2.00°
      Searching for zero-moment angle... Alpha=1.50000°
      Calculating speed to balance the weight...VInf = 10.00000 m/s
      Longitudinal derivatives
      Xu=  -0.03675         Cxu=       -0.04
      Xw=   0.13781         Cxa=        0.15
      Zw=    -3.9506        CLa=         4.3
      Zq=      -0.63        CLq=         6.9
      Mw=   -0.10005        Cma=      -0.605
      Mq=      -0.12        Cmq=        -8.7
      Neutral Point position=   0.08533 m
      Lateral derivatives
      Yv=   -0.77175        CYb=       -0.84
      Lv=  -0.055860        Clb=      -0.076
      Lp=      -0.09        Clp=       -0.39
      Nv=      0.2646       Cnb=        0.36
      Nr=      -0.09        Cnr=       -0.41
      Control derivatives
      Xde=   -0.09        CXde=    -0.01
      Yde= -4.9e-06       CYde=  -7.8e-07
      Zde=     -8.54      CZde=    -0.93
      Lde= -2.5e-08       CLde= -4.9e-09
      Mde=     -2.90      CMde=     -1.80
      Nde= -3.8e-06       CNde= -7.6e-07
      _____State matrices__________
             -0.155991             0.58972
      Eigenvalue:     -20.88+   -10.57i   |      -20.88+    10.57i
"""


def test_xflr5_log():
    source = read_xflr5(Path("glider.txt"), XFLR5)
    lengths = {"S": 0.15, "b": 0.8, "c": 0.18}
    assert {key: source.length(key) for key in lengths} == pytest.approx(lengths, rel=1e-3)
    assert (source.facts["Iyy"].value, source.facts["x_np"].value) == (0.005, 0.08533)
    point = source.points[0]
    assert math.degrees(point.alpha.value) == pytest.approx(1.5)
    # The weight over the pressure and area; the trim's surface stands at -2 degrees.
    lift, angle = 0.19 * 9.81 / (0.5 * 1.225 * 100 * 0.15), math.radians(-2.0)
    assert point.value("CL", TOTAL) == pytest.approx(lift - 0.93 * angle, rel=1e-3)
    assert point.value("Cm", TOTAL) == pytest.approx(1.80 * angle)
    # Along stability axes CX_alpha = CL - CD_alpha, and CZ is minus lift; CLde is a rolling moment.
    assert point.value("CD", "alpha") == pytest.approx(lift - 0.15, rel=1e-3)
    surfaces = {name: point.value(name, "elevator") for name in ("CL", "Cm", "Cl")}
    assert surfaces == pytest.approx({"CL": 0.93, "Cm": -1.80, "Cl": -4.9e-9})
    with pytest.raises(BadInputError, match="no Zw with CLa"):
        read_xflr5(Path("glider.txt"), XFLR5.replace("CLa=", "CLz:"))


def test_flow5_log_with_two_controls_per_degree():
    """flow5 prints Z in place of lift, a name above each control, and degrees."""
    control = " elevator\n Xde = 0 CXde = 0\n Zde = -.5 CZde = -0.016\n Mde = -.2 CMde = -0.031\n"
    control += " ailerons\n Xde = 0 CXde = 0\n Lde = .1 CLde = 0.004\n Mde = 0 CMde = 0\n"
    text = re.sub(r"      Xde=.*(?=      _____State)", control, XFLR5, flags=re.DOTALL)
    text = text.replace("CLa=         4.3", "CZa =  -4.3").replace("CLq=         6.9", "CZq = -6.9")
    text = text.replace("Zq=", "Xq  = 0.01 CXq = 0.1\n Zq=")
    source = read_xflr5(Path("glider.txt"), text)
    point = source.points[0]
    assert source.surfaces == ("elevator", "aileron")
    assert (point.value("CL", "alpha"), point.value("CL", "q")) == (4.3, 6.9)
    assert point.value("Cm", "elevator") == pytest.approx(-math.degrees(0.031))
    assert point.value("Cl", "aileron") == pytest.approx(math.degrees(0.004))


def test_masses_against_hand_computation():
    text = "Lunit = 1 ft\nMunit = 1 slug\n 1 0 0 0\n 1 2 0 0\n"
    masses = read_masses(Path("two.mass"), text)
    slug, foot = 14.593903, 0.3048
    assert masses.mass_kg.value == pytest.approx(2 * slug)
    assert masses.centre_m[0] == pytest.approx(foot)
    # Two points one foot from their centre.
    assert masses.inertia_kgm2[1, 1] == pytest.approx(2 * slug * foot**2)
    assert masses.inertia_kgm2[0, 0] == pytest.approx(0.0)
    with pytest.raises(BadInputError, match="more than 0"):
        read_masses(Path("none.mass"), "Lunit = 1 m\n 0 0 0 0\n")


def test_geometry():
    geometry = read_geometry(DATA / "kite.avl", (DATA / "kite.avl").read_text())
    (wing,) = geometry.wings()
    assert wing.area() == pytest.approx(2 * (0.4 * 0.235 + 0.4 * 0.5 * (0.235 + 0.1545)))
    assert wing.span() == pytest.approx(1.6)
    assert wing.dihedral() == pytest.approx(math.atan2(0.056, 0.8))
    assert wing.controls["aileron"] == [(1.0, -1.0, 21), (1.0, -1.0, 25)]


def test_elliptical_flat_plate_through_avl(tmp_path):
    """Lift slope 2 pi A/(A + 2), neutral point at c/4, no sideslip derivatives, Cl_p from strips."""
    pytest.importorskip("optvl")
    span, root = 10.0, 0.8
    y = span / 2 * np.sin(np.linspace(0, 0.5 * np.pi, 25))
    chords = np.maximum(root * np.sqrt(1 - (2 * y / span) ** 2), 0.01)
    sections = "".join(
        f"SECTION\n{-0.25 * c:.6f} {v:.6f} 0 {c:.6f} 0\n" for v, c in zip(y, chords, strict=True)
    )
    area = math.pi / 4 * span * root
    path = tmp_path / "ellipse.avl"
    path.write_text(
        f"ellipse\n0\n0 0 0\n{area} {8 * root / 3 / math.pi} {span}\n0.1 0 0\nSURFACE\nWing\n"
        f"8 1.0 40 1.0\nYDUPLICATE\n0\n{sections}"
    )
    geometry = read_geometry(path, path.read_text())
    source = run_avl(geometry, [math.radians(1.0)])
    aspect_ratio = span**2 / area
    slope = source.points[0].value("CL", "alpha")
    # Lifting-line theory is above a lifting surface by some percent at aspect ratio 16.
    assert slope == pytest.approx(2 * math.pi * aspect_ratio / (aspect_ratio + 2), rel=0.03)
    assert source.facts["x_np"].value == pytest.approx(0.0, abs=0.01 * root)
    assert source.facts["e"].value == pytest.approx(1.0, abs=0.01)
    values = body_coefficients(source.points[0], ())
    # About the quarter chord the lift has no moment: the moment centre is that of the file.
    centred = about(values, (-0.1, 0.0, 0.0), span, source.length("c"), math.radians(1.0))
    assert values["Cm", "alpha"] / slope == pytest.approx(0.1 / source.length("c"), rel=0.03)
    assert centred["Cm", "alpha"] == pytest.approx(0.0, abs=0.1)
    # Elliptical loading: Cl_p = -A pi/(4 (A + 4)) ... within lifting-line accuracy.
    assert values["Cl", "p"] == pytest.approx(
        -math.pi * aspect_ratio / (4.0 * (aspect_ratio + 4.0)), rel=0.06
    )


def test_several_outputs_make_points_in_order():
    sources = read_sources([DATA / "kite-7deg.st", DATA / "kite.st", DATA / "kite.mass"])
    assert [round(math.degrees(p.alpha.value)) for p in sources.derivatives.points] == [3, 7]
    assert sources.masses is not None


def test_unknown_file_is_refused(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing\n")
    with pytest.raises(BadInputError, match="not a known source"):
        read_sources([path])
    with pytest.raises(BadInputError, match="no source of derivatives"):
        read_sources([DATA / "kite.mass"])


def results_csv(stab: str) -> str:
    """Return the results CSV that OpenVSP exports beside a ``.stab``."""
    lines, columns = ["Results_Name,VSPAERO_History", "CL,0.1,0.2"], []
    groups = {f"ConGrp_{i}": n for i, n in enumerate(("AilR", "AilL", "Rud", "Elev"), 1)}
    for line in stab.splitlines():
        words = line.split()
        if words[:3] == ["#", "Name", "Value"]:
            lines += ["Results_Name,VSPAERO_Stab", "Results_Timestamp,1", "StabilityType,1"]
            columns = ["FC"]
        elif words[:3] == ["#", "Result", "Value"]:
            columns = ["result"]
        elif not words or words[0].startswith(("#", "*")):
            continue
        elif columns == ["FC"] and words[0] != "Case":
            lines.append(f"FC_{words[0]},{words[-2]}")
        elif columns == ["result"]:
            lines.append(f"{words[0]},{words[1]}")
        elif words[0] in ("Case", "Coef"):
            columns = [groups.get(word, word) for word in words[1:]]
        else:
            lines += [f"{words[0]}_{c},{w}" for c, w in zip(columns, words[1:], strict=True)]
    return "\n".join(lines) + "\n"


def test_results_csv_of_openvsp_is_its_stab(tmp_path):
    stab = (DATA / "kite.stab").read_text()
    text = results_csv(stab)
    expected, source = (read_stab(Path("kite"), t) for t in (stab, text))
    assert {k: e.value for k, e in source.reference.items()} == {
        k: e.value for k, e in expected.reference.items()
    }
    assert source.facts["x_np"].value == expected.facts["x_np"].value
    assert len(source.points) == len(expected.points) > 1
    for point, other in zip(source.points, expected.points, strict=True):
        assert {k: e.value for k, e in point.entries.items()} == {
            k: e.value for k, e in other.entries.items()
        }
        assert point.steps == other.steps
    line = source.points[0].entries["Cm", "alpha"].line
    assert text.splitlines()[line - 1].startswith("CMm_Alpha,")
    # A missing case row, or a section without a name, leaves the derivatives as they are.
    damaged = re.sub(r"Beta_CL,.*\n", "", text).replace(
        "Results_Name,VSPAERO_History", "Results_Name"
    )
    path = tmp_path / "results.csv"
    path.write_text(damaged)
    assert find_slips(read_sources([path])) == []


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ("# DEGEN GEOM CSV FILE\n# NUMBER OF COMPONENTS\n3\n", "DegenGeom is a geometry"),
        ("Results_Name,VSPAERO_Polar\nFC_Sref_,1\nCL,0.1,0.2\n", "stability option"),
        ("Results_Name,Mass_Properties\nTotal_Mass,1\n", "no VSPAERO_Stab"),
        ("  Beta  Mach  AoA  Re/1e6  CLo\n 0 0.1 1 1 0.3\n", "polar has no derivatives"),
        ("xflr5 v6.47\n\n Plane name : a\n Polar name : b\n alpha  beta  CL\n", "save the log"),
        ("flow5 v7.23\n\n Plane name : a\n Polar name : b\n alpha  beta  CL\n", "save the log"),
        (" Surface and Strip Forces by surface\n", "write ST"),
        ("\n Run case  1:  cruise\n alpha -> alpha = 0\n", "write ST"),
        ("1 THE USAF AUTOMATED DATCOM / DIGITAL DATCOM\n CASEID\n", "copy its derivatives"),
    ],
)
@pytest.mark.parametrize("suffix", ["csv", "txt"])
def test_files_without_derivatives_are_refused_by_name(text, advice, suffix, tmp_path):
    path = tmp_path / f"x.{suffix}"
    path.write_text(text)
    with pytest.raises(BadInputError, match=advice) as error:
        read_sources([path])
    assert str(path) in str(error.value)
