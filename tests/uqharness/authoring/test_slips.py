"""Twenty kinds of slips, seeded one at a time into three files, are found with their line."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from tests.uqharness.authoring.test_readers import XFLR5
from uqharness.authoring import Entry, find_slips, mass_slips, read_sources
from uqharness.errors import BadInputError

DATA = Path(__file__).parent / "data"
ST = (DATA / "kite.st").read_text()
MASS = (DATA / "kite.mass").read_text()
TABLE = (DATA / "kite.csv").read_text()
STAB = (DATA / "kite.stab").read_text()


def number(text, name, change):
    """Return the text with a number changed, and its line."""
    match = re.search(rf"(?<![\w']){re.escape(name)}(\s*[=,]\s*|\s+)([-+.\dE]+)", text)
    assert match, name
    value = change(float(match[2]))
    assert value != float(match[2])
    line = text[: match.start(2)].count("\n") + 1
    return text[: match.start(2)] + f"{value:.7g}" + text[match.end(2) :], line


def reverse(value):
    return -value


def times(factor):
    return lambda value: value * factor


def swapped(text, first, second):
    """Return the text with two numbers exchanged, and the lines of both."""
    a = float(re.search(rf"{first}(?:\s*[=,]\s*|\s+)([-+.\dE]+)", text)[1])
    b = float(re.search(rf"{second}(?:\s*[=,]\s*|\s+)([-+.\dE]+)", text)[1])
    text, line_a = number(text, first, lambda _: b)
    text, line_b = number(text, second, lambda _: a)
    return text, (line_a, line_b)


D = 57.29578
SLIPS = {
    "st": {
        "Cm_alpha sign": ("Cma", reverse),
        "Cn_beta sign": ("Cnb", reverse),
        "Cl_beta sign": ("Clb", reverse),
        "CY_beta sign": ("CYb", reverse),
        "CL_alpha per degree": ("CLa", times(1 / D)),
        "Cm_q per degree": ("Cmq", times(1 / D)),
        "Cm_q sign": ("Cmq", reverse),
        "Cl_p per radian of degrees": ("Clp", times(D)),
        "Cl_p sign": ("Clp", reverse),
        "Cn_r sign": ("Cnr", reverse),
        "Cn_r per degree": ("Cnr", times(1 / D)),
        "CY_r sign": ("CYr", reverse),
        "span of one side": ("Bref", times(0.5)),
        "chord in mm": ("Cref", times(1000)),
        "area in dm2": ("Sref", times(100)),
        "moment centre at the nose": ("Xref", lambda _: -0.3),
        "elevator sign": ("Cmd2", reverse),
        "elevator per radian": ("Cmd2", times(D)),
        "aileron per radian": ("Cld1", times(D)),
        "rudder sign": ("Cnd3", reverse),
        "aileron of one side": ("CLd1", lambda _: -0.008),
        "elevator of one side": ("Cld2", lambda _: 0.004),
        "elevator of a v-tail": ("CYd2", lambda _: 0.003),
        "rudder of a v-tail": ("Cmd3", lambda _: 0.015),
        "ventral rudder": ("Cld3", lambda _: 0.0006),
        "z up": ("CZtot", reverse),
        "lift downwards": ("CLtot", reverse),
        "alpha in rad": ("Alpha", lambda _: 0.05236),
        "columns of alpha and beta": ("CLb", lambda _: 5.1),
        "columns of q and r": ("Cnq", lambda _: -0.08),
        "CY_beta per degree": ("CYb", times(1 / D)),
        "area of half a wing": ("Sref", times(0.5)),
        "half a chord": ("Cref", times(0.5)),
        "aileron without effect": ("Cld1", lambda _: 0.0),
    },
    "csv": {
        "Cm_alpha sign": ("Cm_alpha", reverse),
        "Cn_beta sign": ("Cn_beta", reverse),
        "Cl_beta sign": ("Cl_beta", reverse),
        "CY_beta sign": ("CY_beta", reverse),
        "CL_alpha per degree": ("CL_alpha", times(1 / D)),
        "Cm_q per degree": ("Cm_q", times(1 / D)),
        "Cm_q sign": ("Cm_q", reverse),
        "Cl_p per radian of degrees": ("Cl_p", times(D)),
        "Cl_p sign": ("Cl_p", reverse),
        "Cn_r sign": ("Cn_r", reverse),
        "Cn_r per degree": ("Cn_r", times(1 / D)),
        "Cn_beta per degree": ("Cn_beta", times(1 / D)),
        "CL_q sign": ("CL_q", reverse),
        "Cl_r sign": ("Cl_r", reverse),
        "CY_r sign": ("CY_r", reverse),
        "Cm_alpha per degree squared": ("Cm_alpha", times(D)),
        "span of one side": ("b", times(0.5)),
        "chord in mm": ("c", times(1000)),
        "area in dm2": ("S", times(100)),
        "elevator sign": ("Cm_elevator", reverse),
        "elevator per radian": ("Cm_elevator", times(D)),
        "aileron per radian": ("Cl_aileron", times(D)),
        "rudder sign": ("Cn_rudder", reverse),
        "rudder of a v-tail": ("Cm_rudder", lambda _: 0.02),
        "aileron of one side": ("CL_aileron", lambda _: 0.01),
        "ventral rudder": ("Cl_rudder", lambda _: 0.0006),
        "area of half a wing": ("S", times(0.5)),
        "span doubled": ("b", times(2.0)),
        "CY_beta per degree": ("CY_beta", times(1 / D)),
        "yaw of the aileron per radian": ("Cn_aileron", lambda _: 0.4),
    },
    "stab": {
        "lift slope": ("CFz", None),
        "moment sign": ("CMm", None),
        "moment centre": ("Xcg_", times(1.4)),
        "span of one side": ("Bref_", times(0.5)),
        "chord in mm": ("Cref_", times(1000)),
        "area in dm2": ("Sref_", times(100)),
        "neutral point": ("X_np", times(1.2)),
        "alpha in rad": ("AoA_", lambda value: 0.0349 if value else 2.0),
    },
}
CASES = [(kind, name) for kind, rows in SLIPS.items() for name in rows]
TEXTS = {"st": ST, "csv": TABLE, "stab": STAB}


def seeded(kind, name):
    """Return the seeded text and its line."""
    key, change = SLIPS[kind][name]
    if change is not None:
        return number(TEXTS[kind], key, change)
    # A derivative of the .stab with respect to alpha: the second column after Coef.
    lines = TEXTS[kind].splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("Coef"))
    at = next(i for i in range(head, len(lines)) if lines[i].startswith(key))
    words = lines[at].split()
    words[2] = f"{-float(words[2]) if name.endswith('sign') else float(words[2]) / D:.7f}"
    lines[at] = "  ".join(words)
    return "\n".join(lines) + "\n", at + 1


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_seeded_slip_is_found_with_its_line(kind, name, tmp_path):
    text, line = seeded(kind, name)
    path = tmp_path / f"kite.{kind}"
    path.write_text(text)
    places = [slip.place for slip in find_slips(read_sources([path]))]
    assert f"{path}:{line}" in places, places


# A twin of 5.7 t: at its lift the wing's part of Cn_beta hides a slip of the fin's.
TWIN = (
    "Sref 39.02 Cref 1.98 Bref 19.81 Alpha 0 CLtot 0.53447 CDtot 0.0101 CXtot -0.0101 CZtot"
    " -0.53447 CLff 0.53447 CDff 0.0092 CDind 0.0101 e 0.98 Xref 5.875 Xnp 6.7158 CLa 5.4408 Cma"
    " -2.3099 CYb -0.5022 Clb -0.0773 Cnb 0.1903 CYr 0.4681 Cnr -0.1811 Clp -0.5836 Cmq -28.41 CLq"
    " 11.729"
)


@pytest.mark.parametrize("name", ["CYb", "Cnb", "Cnr", "CYr"])
def test_the_fins_derivatives_show_the_one_that_is_off(name, tmp_path):
    text = ST
    for key, value in re.findall(r"(\S+) (\S+)", TWIN):
        text, _ = number(text, key, lambda _, value=value: float(value) + 1e-9)
    path = tmp_path / "twin.st"
    path.write_text(text)
    assert find_slips(read_sources([path])) == []
    text, line = number(text, name, times(1 / D))
    path.write_text(text)
    assert [slip.place for slip in find_slips(read_sources([path]))] == [f"{path}:{line}"]


@pytest.mark.parametrize("kind", TEXTS)
def test_clean_files_have_none(kind, tmp_path):
    path = tmp_path / f"kite.{kind}"
    path.write_text(TEXTS[kind])
    (tmp_path / "kite.mass").write_text(MASS)
    assert find_slips(read_sources([path])) == []
    assert find_slips(read_sources([path, tmp_path / "kite.mass"])) == []


def test_messages_say_line_expectation_and_effect(tmp_path):
    text, line = number(ST, "Cnb", reverse)
    path = tmp_path / "kite.st"
    path.write_text(text)
    (slip,) = find_slips(read_sources([path]))
    assert str(slip).startswith(f"{path}:{line}: sign: Cn_beta -0.074")
    assert "above 0 is expected" in str(slip)
    assert "swaps ends" in str(slip)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (("Munit = 0.001", "Munit = 1"), "mass units"),
        (("Lunit = 1.0 m", "Lunit = 0.01 m"), "mass units"),
    ],
)
def test_masses(change, kind, tmp_path):
    (tmp_path / "kite.st").write_text(ST)
    assert change[0] in MASS
    (tmp_path / "kite.mass").write_text(MASS.replace(*change))
    result = find_slips(read_sources([tmp_path / "kite.st", tmp_path / "kite.mass"]))
    assert kind in {slip.kind for slip in result}


def test_mass_in_grams(tmp_path):
    source = read_sources([DATA / "kite.csv"]).derivatives
    inertia = [Entry(value, Path("--ixx-kgm2")) for value in (0.06, 0.08, 0.13)]
    assert list(mass_slips(source, Entry(1.47, Path("--mass-kg")), inertia)) == []
    kinds = [(s.place, s.kind) for s in mass_slips(source, Entry(1470.0, Path("--mass-kg")), [])]
    assert kinds == [("--mass-kg", "mass units")]
    grams = [replace(entry, value=1e3 * entry.value) for entry in inertia]
    kinds = [s.kind for s in mass_slips(source, Entry(1.47), grams)]
    assert kinds == ["mass units"]


AVL = (DATA / "kite.avl").read_text()


@pytest.mark.parametrize(
    ("old", "new", "line", "kind"),
    [
        ("0.3438 0.2163 1.6", "34.38 0.2163 1.6", 7, "reference area"),
        ("0.3438 0.2163 1.6", "0.3438 0.2163 0.8", 7, "reference length"),
        ("0.3438 0.2163 1.6", "0.3438 216.3 1.6", 7, "reference length"),
        ("aileron 1.0 0.75 0 0 0 -1.0", "aileron 1.0 0.75 0 0 0 1.0", 21, "control sign"),
        ("elevator 1.0 0.6 0 0 0 1.0", "elevator 1.0 0.6 0 0 0 -1.0", 34, "control sign"),
        ("rudder 1.0 0.6", "rudder 57.3 0.6", 45, "deg/rad"),
        ("CONTROL\nrudder 1.0 0.6 0 0 0 1.0\nSECTION", "SECTION", 47, "control"),
    ],
)
def test_slips_of_a_geometry(old, new, line, kind, tmp_path):
    assert old in AVL
    path = tmp_path / "kite.avl"
    for name, text in (("kite.mass", MASS), ("kite.st", ST), ("kite.avl", AVL)):
        (tmp_path / name).write_text(text)
    files = [path, tmp_path / "kite.mass", tmp_path / "kite.st"]
    assert find_slips(read_sources(files)) == []
    path.write_text(AVL.replace(old, new, 1))
    result = find_slips(read_sources(files))
    assert (f"{path}:{line}", kind) in {(slip.place, slip.kind) for slip in result}, result


@pytest.mark.parametrize(("gain", "kinds"), [(1.0, ["control sign"]), (-1.0, [])])
def test_ailerons_on_two_wings_need_opposite_gains(gain, kinds, tmp_path):
    def wing(side, gain):
        rows = "\n".join(
            f"SECTION\n0 {side * y} 0 0.25 0\nCONTROL\naileron {gain} 0.75 0 0 0 {side}"
            for y in (0.2, 0.8)
        )
        return f"SURFACE\nwing {side}\n8 1 12 1\nSECTION\n0 0 0 0.25 0\n{rows}\n"

    path = tmp_path / "glider.avl"
    path.write_text("glider\n0\n0 0 0\n0.4 0.25 1.6\n0 0 0\n" + wing(-1, gain) + wing(1, 1.0))
    (tmp_path / "kite.st").write_text(ST.replace("0.3438", "0.4   ").replace("0.2163", "0.25  "))
    slips = find_slips(read_sources([path, tmp_path / "kite.st"]))
    assert [slip.kind for slip in slips if slip.place.startswith(str(path))] == kinds


def test_a_reversed_convention_is_no_slip(tmp_path):
    """Lift and moment of an elevator that are both reversed are a convention of its sign."""
    text, _ = number(ST, "CLd2", reverse)
    text, _ = number(text, "Cmd2", reverse)
    path = tmp_path / "kite.st"
    path.write_text(text)
    assert find_slips(read_sources([path])) == []


# A human-powered aircraft: the wing's dihedral nearly cancels the fin at a CL of 1.2.
HUGE_SPAN = (
    "Sref 30.69 Cref 1.0058 Bref 33 Alpha 10.98762 CLtot 1.23521 CDtot 0.0209 CXtot 0.21849 CZtot"
    " -1.21585 CLff 1.2352 CDff 0.0171 CDind 0.0171 e 0.8 Xnp 0.3936 CLa 5.348 Cma -1.4547 CYb"
    " -0.245 Clb -0.1405 Cnb 0.0044 Clp -0.6 Clr 0.2866 Cnp -0.1276 Cnr -0.0137 CYr 0.1747 CLq"
    " 5.93 Cmq -9.37"
)


@pytest.mark.parametrize("change", [None, ("Cnb", 1 / D), ("Cnr", D), ("Cnb", -1)])
def test_a_wing_that_nearly_cancels_the_fin_is_no_slip(change, tmp_path):
    text = ST
    for name, value in re.findall(r"(\S+) (\S+)", HUGE_SPAN):
        text, _ = number(text, name, lambda _, value=value: float(value))
    line = None
    if change:
        text, line = number(text, change[0], times(change[1]))
    path = tmp_path / "hpa.st"
    path.write_text(text)
    places = [slip.place for slip in find_slips(read_sources([path]))]
    if line is None:
        assert places == []
    else:
        assert f"{path}:{line}" in places, places


def test_a_canard_is_no_slip_where_it_is_stated(tmp_path):
    text, line = number(ST, "Cmd2", reverse)
    path = tmp_path / "kite.st"
    path.write_text(text)
    sources = read_sources([path])
    (slip,) = find_slips(sources)
    assert slip.place == f"{path}:{line}"
    assert "--control elevator=elevator" in slip.message
    assert find_slips(sources, {"elevator": {"elevator": 1.0}}) == []
    path.write_text(text.replace("elevator", "canard  "))
    assert find_slips(read_sources([path])) == []


def test_ailerons_that_move_the_same_way(tmp_path):
    """SgnDup 1 in AVL: lift and no roll."""
    text, _ = number(ST, "CLd1", lambda _: 0.0175)
    text, line = number(text, "Cld1", lambda _: 0.0)
    path = tmp_path / "kite.st"
    path.write_text(text)
    places = {(slip.place, slip.kind) for slip in find_slips(read_sources([path]))}
    assert (f"{path}:{line}", "control sign") in places


def test_steps_of_later_vspaero_are_no_slip(tmp_path):
    """Versions 6 and 7 print differences over 0.01 deg with seven decimals."""
    lines = STAB.splitlines()
    base: list[str] = []
    for i, line in enumerate(lines):
        words = line.split()
        if line.startswith("Base_Aero"):
            base = words
        elif base and len(words) == len(base) and words[1] == "+1.000":
            values = [
                float(b) + 0.01 * (float(v) - float(b))
                for v, b in zip(words[3:], base[3:], strict=True)
            ]
            lines[i] = " ".join([words[0], "+0.010", words[2], *(f"{v:.7f}" for v in values)])
    path = tmp_path / "kite.stab"
    path.write_text("\n".join(lines) + "\n")
    assert "+0.010" in path.read_text()
    assert find_slips(read_sources([path])) == []


@pytest.mark.parametrize(
    ("name", "change"),
    [("Bref_", 0.5), ("Bref_", 2.0), ("Cref_", 2.0), ("Sref_", 0.5), ("SM", -1.0), ("CMl", -1.0)],
)
def test_one_block_of_a_stab_shows_which_number_is_wrong(name, change, tmp_path):
    """Its cases and derivatives are made with the true span and chord."""
    block = STAB.split("# Name")[1]
    text, path = "# Name" + block, tmp_path / "kite.stab"
    path.write_text(text)
    assert find_slips(read_sources([path])) == []
    if name == "CMl":  # of one case, the last with differences
        lines = text.splitlines()
        index = next(
            i for i, line in enumerate(lines) if line.startswith("Yaw___Rate  ") and "+" in line
        )
        words = lines[index].split()
        words[-3] = f"{-float(words[-3]):.7f}"
        lines[index], line = "  ".join(words), index + 1
        text = "\n".join(lines) + "\n"
    else:
        text, line = number(text, name, times(change))
    path.write_text(text)
    places = [slip.place for slip in find_slips(read_sources([path]))]
    assert places[0] == f"{path}:{line}", places


@pytest.mark.parametrize(
    ("row", "seeded"),
    [
        ("Zw=    -3.9506", "Zw=    -7.9012"),
        ("CLa=         4.3", "CLa=         2.1"),
        ("Mw=   -0.10005", "Mw=   -0.20010"),
        ("Lv=  -0.055860", "Lv=  -0.0032"),
        ("Cnb=        0.36", "Cnb=        -0.36"),
    ],
)
def test_pairs_of_a_stability_log_share_their_lengths(row, seeded, tmp_path):
    path = tmp_path / "glider.txt"
    path.write_text(XFLR5)
    assert find_slips(read_sources([path])) == []
    text = XFLR5.replace(row, seeded)
    path.write_text(text)
    line = text[: text.index(seeded)].count("\n") + 1
    places = [slip.place for slip in find_slips(read_sources([path]))]
    assert f"{path}:{line}" in places, places


def test_an_airfoil_that_avl_would_not_find(tmp_path):
    """AVL takes a flat plate for it without a word."""
    path = tmp_path / "kite.avl"
    path.write_text(AVL.replace("CONTROL\naileron", "AFILE\nclarky.dat\nCONTROL\naileron", 1))
    line = path.read_text().splitlines().index("clarky.dat") + 1
    slips = find_slips(read_sources([path]))
    assert (f"{path}:{line}", "geometry") in {(slip.place, slip.kind) for slip in slips}
    (tmp_path / "clarky.dat").write_text("Clark Y\n")
    assert find_slips(read_sources([path])) == []
    # Derivatives from AVL's own output do not depend on the file.
    (tmp_path / "clarky.dat").unlink()
    (tmp_path / "kite.st").write_text(ST)
    assert find_slips(read_sources([path, tmp_path / "kite.st"])) == []


@pytest.mark.parametrize(
    ("text", "change"),
    [
        (ST, ("Sref =     0.3438", "Sref =     0.0000")),
        (ST, ("Bref =        1.6", "Bref =        0.0")),
        (ST + ST, ("Beta  =   0.00000", "Beta  =   1e9")),
        (STAB, ("Coef          Total", "Coef          Sum")),
        (STAB, ("Units         CFx", "Units\n#     CFx")),
    ],
)
def test_damaged_files_are_bad_input_or_slips(text, change, tmp_path):
    assert change[0] in text
    path = tmp_path / "kite.txt"
    path.write_text(text.replace(*change))
    with suppress(BadInputError):
        assert find_slips(read_sources([path])) != []


def test_an_alpha_that_fits_no_force_is_named_although_drag_is_small(tmp_path):
    """CX changes its sign between the two angles by chance: the angle is wrong all the same."""
    text = ST.replace("Alpha =   3.00000", "Alpha =   0.05236")
    assert text != ST
    lift = float(re.search(r"CLtot\s*=\s*([-\d.]+)", ST)[1])
    # At this drag CX of 3 degrees is about the negative of CX at 0.05 degrees, to a third.
    half = 1.15 * lift * (0.05234 + 0.00091) / 2.0
    text, _ = number(text, "CDtot", lambda _: half)
    text, _ = number(text, "CXtot", lambda _: lift * 0.05234 - half)
    path = tmp_path / "x.st"
    path.write_text(text)
    line = text[: text.index("Alpha =")].count("\n") + 1
    places = [slip.place for slip in find_slips(read_sources([path])) if slip.kind == "deg/rad"]
    assert f"{path}:{line}" in [str(place) for place in places]


def test_a_chord_of_the_panels_beside_the_body_is_no_slip(tmp_path):
    """0.91 of the mean chord, as a published model of a VTOL has it."""
    path = tmp_path / "x.st"
    reference = {
        name: float(re.search(rf"{name}\s*=\s*([-\d.]+)", ST)[1]) for name in ("Sref", "Bref")
    }
    chord = 0.91 * reference["Sref"] / reference["Bref"]
    path.write_text(number(ST, "Cref", lambda _: chord)[0])
    assert not [s for s in find_slips(read_sources([path])) if s.kind == "reference length"]
    path.write_text(number(ST, "Cref", lambda _: 0.7 * chord)[0])
    assert [s for s in find_slips(read_sources([path])) if s.kind == "reference length"]


def test_second_order_of_one_sided_steps_is_no_slip(tmp_path):
    """A difference over one radian per second of roll has the drag of rolling, which is even."""
    lines = STAB.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("Coef"))
    at = next(i for i in range(head, len(lines)) if lines[i].startswith("CD "))
    words = lines[at].split()
    words[4] = "-0.0342"
    path = tmp_path / "x.stab"

    def slips(step):
        text = "\n".join([*lines[:at], "  ".join(words), *lines[at + 1 :]])
        path.write_text(re.sub(r"(Roll__Rate +)\+[\d.]+( +rad/Tunit)", rf"\g<1>+{step}\g<2>", text))
        return [s for s in find_slips(read_sources([path])) if s.kind == "axes"]

    assert any("CD_p" in slip.message for slip in slips("0.010"))
    assert not any("CD_p" in slip.message for slip in slips("1.000"))
