"""AVL's input: geometry (``.avl``) and masses (``.mass``), and a run through the optvl package.

Geometry gives what checks compare: planform area, span and mean chord of the wing. A run needs
optvl (``pip install uqharness[avl]``), which contains AVL. Its `set_reference_data` leaves the
moment centre of the derivatives where the file has it, so the moment centre is read from the file
and moved afterwards (`uqharness.authoring.source.about`).
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import FT_M, IN_M, LB_KG, SLUG_KG
from uqharness.authoring.source import LARGEST, STABILITY, STATES, TOTAL, Entry, Point, Source
from uqharness.errors import BadInputError

_KEYWORDS = (
    *("SURFACE", "BODY", "COMPONENT", "INDEX", "YDUPLICATE", "SCALE", "TRANSLATE", "ANGLE"),
    *("NOWAKE", "NOALBE", "NOLOAD", "SECTION", "NACA", "AIRFOIL", "AFILE", "AFIL", "DESIGN"),
    *("CONTROL", "CLAF", "CDCL", "BFILE", "BFIL"),
)


@dataclass
class Section:
    """Leading edge x, y, z, chord and incidence, in the file's units, with its line."""

    x: float
    y: float
    z: float
    chord: float
    line: int


@dataclass
class Surface:
    """One surface: sections after scaling and translation, and its controls by name.

    ``controls`` maps a name to gain, sign of the duplicate, and line, in each section that has it.
    """

    name: str
    line: int
    sections: list[Section] = field(default_factory=list)
    duplicated: bool = False
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    controls: dict[str, list[tuple[float, float, int]]] = field(default_factory=dict)

    def points(self) -> FloatArray:
        """Return leading edges and chords (n, 4) in the frame of the aircraft."""
        rows = [(s.x, s.y, s.z, s.chord) for s in self.sections]
        scale = (*self.scale, self.scale[0])
        return np.array(rows) * scale + (*self.shift, 0.0)

    def area(self) -> float:
        """Return the area projected on the x-y plane, both sides where it is duplicated."""
        p = self.points()
        one = float(np.sum(np.abs(np.diff(p[:, 1])) * 0.5 * (p[:-1, 3] + p[1:, 3])))
        return 2.0 * one if self.duplicated else one

    def span(self) -> float:
        """Return the extent in y, of both sides where it is duplicated."""
        y = self.points()[:, 1]
        return float(2.0 * np.max(np.abs(y))) if self.duplicated else float(np.ptp(y))

    def mean_chord(self) -> float:
        """Return the mean aerodynamic chord, NaN for a vertical surface."""
        p = self.points()
        dy = np.abs(np.diff(p[:, 1]))
        a, b = p[:-1, 3], p[1:, 3]
        area = float(np.sum(dy * 0.5 * (a + b)))
        return float(np.sum(dy * (a * a + a * b + b * b) / 3.0)) / area if area else math.nan

    def dihedral(self) -> float:
        """Return the mean dihedral [rad] from the first to the last section."""
        p = self.points()
        return math.atan2(float(p[-1, 2] - p[0, 2]), abs(float(p[-1, 1] - p[0, 1])))


@dataclass(frozen=True)
class Geometry:
    """Content of an ``.avl`` file in its own length unit.

    ``airfoils`` are files of airfoils, relative to the geometry's folder, with their lines.
    """

    path: Path
    name: str
    reference: Mapping[str, Entry]
    mach: Entry
    profile_drag: Entry
    surfaces: tuple[Surface, ...]
    airfoils: tuple[tuple[str, int], ...] = ()

    def missing_airfoils(self) -> list[tuple[str, int]]:
        """Return names and lines of files of airfoils that are not there, each name once."""
        lines: dict[str, int] = {}
        for name, line in self.airfoils:
            if not (self.path.parent / name).is_file():
                lines.setdefault(name, line)
        return list(lines.items())

    def wings(self) -> list[Surface]:
        """Return the surface of the largest area times span, and its mirror image if listed.

        A fuselage of flat plates may have more area than the wing, but has no span.
        """
        main = max(self.surfaces, key=lambda surface: surface.area() * surface.span())
        if main.duplicated:
            return [main]
        mirror = [
            other
            for other in self.surfaces
            if other is not main
            and math.isclose(other.area(), main.area(), rel_tol=0.02)
            and abs(float(np.mean(other.points()[:, 1]) + np.mean(main.points()[:, 1])))
            < 0.2 * main.span()
        ]
        return [main, *mirror[:1]]


def read_geometry(path: Path, text: str) -> Geometry:
    """Read an ``.avl`` file.

    Raises
    ------
    BadInputError
        With the line, for a header or section that cannot be read.
    """
    lines = _content(text)
    if len(lines) < 5:
        raise BadInputError(f"{path}: an AVL geometry begins with five lines of header")
    # Header: name, Mach number, symmetry, reference lengths, reference point.
    name = lines[0][1].strip()
    mach = Entry(_numbers(path, lines[1], 1)[0], path, lines[1][0])
    header = _numbers(path, lines[3], 3)
    centre = _numbers(path, lines[4], 3)
    reference = {
        key: Entry(value, path, lines[3][0]) for key, value in zip("Scb", header, strict=False)
    } | {key: Entry(value, path, lines[4][0]) for key, value in zip("xyz", centre, strict=False)}
    # The profile drag is optional: the next line is a number or a keyword.
    sections = lines[5:]
    drag = Entry(0.0, path)
    if sections and _keyword(sections[0][1]) is None:
        drag = Entry(_numbers(path, sections[0], 1)[0], path, sections[0][0])
        sections = sections[1:]
    # Keywords with the lines that belong to them; unknown ones are passed over.
    surfaces: list[Surface] = []
    airfoils: list[tuple[str, int]] = []
    i = 0
    while i < len(sections):
        keyword = _keyword(sections[i][1])
        following = sections[i + 1] if i + 1 < len(sections) else (sections[i][0], "")
        if keyword == "SURFACE":
            surfaces.append(Surface(following[1].strip(), sections[i][0]))
            i += 1
        elif surfaces and keyword == "YDUPLICATE":
            surfaces[-1].duplicated = True
            i += 1
        elif surfaces and keyword in ("SCALE", "TRANSLATE"):
            x, y, z = _numbers(path, following, 3)[:3]
            setattr(surfaces[-1], "scale" if keyword == "SCALE" else "shift", (x, y, z))
            i += 1
        elif surfaces and keyword == "SECTION":
            x, y, z, chord = _numbers(path, following, 4)[:4]
            surfaces[-1].sections.append(Section(x, y, z, chord, following[0]))
            i += 1
        elif surfaces and keyword == "CONTROL":
            words = following[1].split()
            numbers = _numbers(path, (following[0], " ".join(words[1:])), 1)
            sign = numbers[5] if len(numbers) > 5 else 1.0
            places = surfaces[-1].controls.setdefault(words[0], [])
            places.append((numbers[0], sign, following[0]))
            i += 1
        elif surfaces and keyword in ("AFILE", "AFIL"):
            airfoils.append((following[1].strip().strip('"'), following[0]))
            i += 1
        i += 1
    # A surface needs two sections; bodies have none.
    surfaces = [surface for surface in surfaces if len(surface.sections) > 1]
    if not surfaces:
        raise BadInputError(f"{path}: holds no SURFACE with two sections")
    return Geometry(path, name, reference, mach, drag, tuple(surfaces), tuple(airfoils))


def _content(text: str) -> list[tuple[int, str]]:
    """Return numbered lines without comments and blank lines."""
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        code = line.split("#")[0].split("!")[0].rstrip()
        if code.strip():
            rows.append((number, code))
    return rows


def _keyword(line: str) -> str | None:
    """Return the keyword that a line begins with; AVL reads four letters."""
    word = line.split()[0].upper() if line.split() else ""
    for keyword in _KEYWORDS:
        if len(word) >= 4 and keyword[:4] == word[:4] and word.isalpha():
            return keyword
    return None


def _numbers(path: Path, row: tuple[int, str], count: int) -> list[float]:
    """Return the numbers at the beginning of a line; BadInputError below ``count``."""
    numbers = []
    for word in row[1].replace(",", " ").split():
        try:
            numbers.append(float(word.replace("D", "E")))
        except ValueError:
            break
    if len(numbers) < count or not all(abs(n) < LARGEST for n in numbers):
        raise BadInputError(
            f"{path}:{row[0]}: received {row[1].strip()[:60]!r}, {count} numbers are needed"
        )
    return numbers


@dataclass(frozen=True)
class Masses:
    """Mass, centre of gravity and inertia about it, SI, in AVL's axes (x aft, y right, z up).

    Attributes
    ----------
    mass_kg : Entry
        Sum, with the line of the heaviest item.
    centre_m : tuple of float
        Centre of gravity.
    inertia_kgm2 : array (3, 3)
        Inertia tensor about the centre of gravity.
    length_unit_m : float
        Lunit of the file, which scales the ``.avl`` as well.
    lines : mapping of str to int
        Lines of Lunit, Munit and the first item.
    """

    path: Path
    mass_kg: Entry
    centre_m: tuple[float, float, float]
    inertia_kgm2: FloatArray
    length_unit_m: float
    lines: Mapping[str, int]
    density: float = 1.225


_LENGTH = {"m": 1.0, "ft": FT_M, "in": IN_M, "cm": 0.01, "mm": 0.001}
_MASS = {"kg": 1.0, "g": 1e-3, "lb": LB_KG, "lbm": LB_KG, "slug": SLUG_KG}


def read_masses(path: Path, text: str) -> Masses:
    """Read a ``.mass`` file.

    Raises
    ------
    BadInputError
        With the line, for a row that cannot be read, and a total mass that is not positive.
    """
    units = {"Lunit": 1.0, "Munit": 1.0}
    lines: dict[str, int] = {}
    density = 1.225
    factors, offsets = [np.ones(10)], [np.zeros(10)]
    items: list[tuple[float, FloatArray, FloatArray, int]] = []
    for number, line in _content(text):
        # Units and constants.
        if "=" in line:
            name, value = (part.strip() for part in line.split("=", 1))
            words = value.split()
            if name in units:
                scale = (_LENGTH if name == "Lunit" else _MASS).get(
                    words[1].lower() if len(words) > 1 else "", 1.0
                )
                units[name] = _numbers(path, (number, value), 1)[0] * scale
                lines[name] = number
            elif name == "rho":
                density = _numbers(path, (number, value), 1)[0]
            continue
        # Factors and offsets hold for the items below them.
        word = line.split()[0]
        if word in "*+":
            row = np.zeros(10) if word == "+" else np.ones(10)
            numbers = _numbers(path, (number, line[line.index(word) + 1 :]), 1)
            row[: len(numbers)] = numbers[:10]
            (offsets if word == "+" else factors).append(row)
            continue
        numbers = _numbers(path, (number, line), 4)[:10]
        row = np.zeros(10)
        row[: len(numbers)] = numbers
        row = row * factors[-1] + offsets[-1]
        # AVL's products are integrals of xy dm: the tensor has them with a minus.
        xx, yy, zz, xy, xz, yz = row[4:]
        tensor = np.array([[xx, -xy, -xz], [-xy, yy, -yz], [-xz, -yz, zz]])
        items.append((float(row[0]), row[1:4], tensor, number))
        lines.setdefault("items", number)
    mass = sum(item[0] for item in items) * units["Munit"]
    if not mass > 0.0:
        raise BadInputError(
            f"{path}: the items' masses sum up to {mass:g} kg; more than 0 is needed"
        )
    length = units["Lunit"]
    weights = np.array([item[0] for item in items]) * units["Munit"]
    places = np.array([item[1] for item in items]) * length
    centre = weights @ places / mass
    # Parallel axes: each item's own inertia, and its mass at its distance from the centre.
    inertia = np.zeros((3, 3))
    for weight, place, item in zip(weights, places - centre, items, strict=True):
        inertia += item[2] * units["Munit"] * length**2
        inertia += weight * (place @ place * np.eye(3) - np.outer(place, place))
    heaviest = max(items, key=lambda item: item[0])
    x, y, z = (float(v) for v in centre)
    return Masses(path, Entry(mass, path, heaviest[3]), (x, y, z), inertia, length, lines, density)


def can_run_avl() -> bool:
    """Return whether the optvl package is installed."""
    return importlib.util.find_spec("optvl") is not None


def run_avl(geometry: Geometry, alphas_rad: Sequence[float]) -> Source:
    """Run AVL on a geometry through optvl, at zero sideslip and rates.

    Parameters
    ----------
    geometry : Geometry
        As `read_geometry` returns it; the file is read again by AVL.
    alphas_rad : sequence of float
        Angles of attack [rad].

    Returns
    -------
    Source
        A point at each alpha, in stability axes and the file's units of length.

    Raises
    ------
    BadInputError
        Where AVL refuses the file.
    """
    solver_class = importlib.import_module("optvl").OVLSolver
    try:
        # AVL looks for airfoils where it is started, and takes flat plates without a word.
        with contextlib.chdir(geometry.path.resolve().parent):
            solver = solver_class(geo_file=geometry.path.name)
    except Exception as error:  # optvl raises bare exceptions for bad geometry
        raise BadInputError(f"{geometry.path}: AVL refuses the file: {error}") from None
    points = []
    names = list(solver.get_control_names())
    neutral = math.nan
    span_efficiency = math.nan
    for alpha in alphas_rad:
        solver.set_variable("alpha", math.degrees(alpha))
        solver.execute_run()
        totals: Mapping[str, Any] = solver.get_total_forces()
        states: Mapping[str, Any] = solver.get_stab_derivs()
        controls: Mapping[str, Any] = solver.get_control_stab_derivs()
        points.append(
            Point(
                Entry(alpha),
                geometry.mach,
                "stability",
                "stability",
                _entries(geometry.path, totals, states, controls, names),
            )
        )
        neutral = float(states["neutral point"])
        span_efficiency = float(totals["e"])
    return Source(
        path=geometry.path,
        tool="AVL",
        name=geometry.name,
        reference=geometry.reference,
        points=tuple(points),
        surfaces=tuple(names),
        facts={"x_np": Entry(neutral), "e": Entry(span_efficiency)},
        notes=("AVL was run through optvl",),
    )


def _entries(
    path: Path,
    totals: Mapping[str, Any],
    states: Mapping[str, Any],
    controls: Mapping[str, Any],
    names: Sequence[str],
) -> dict[tuple[str, str], Entry]:
    """Return optvl's results at one alpha in stability axes, per radian."""
    out = {}
    for name in STABILITY:
        # Moments and rates about stability axes carry a prime in AVL.
        primed = f"{name}'" if name in ("Cl", "Cn") else name
        out[name, TOTAL] = Entry(float(totals[primed]), path)
        for state in STATES:
            variable = f"{state}'" if state in "pqr" else state
            out[name, state] = Entry(float(states[f"d{primed}/d{variable}"]), path)
        for surface in names:
            value = controls.get(f"d{primed}/d{surface}", 0.0)
            out[name, surface] = Entry(math.degrees(float(value)), path)
    return out
