"""Does ``uqharness diff`` find what is wrong, and nothing else? Faults of ten kinds in three
aircraft, and benign pairs: rewritings that change nothing.

python -m campaigns.diff-faults.reproduce [--benign N] [--out DIR]
"""

from __future__ import annotations

import copy
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from campaigns.library.study import study_parser, write_csv
from uqharness.differences import (
    MatchedRequest,
    by_channel,
    differences,
    differing_terms,
    fly_matched,
)
from uqharness.files import scratch_folder
from uqharness.simulator import Aircraft, copy_folder, copy_shared_parts, engine, find_aircraft

Edit = Callable[[Any], None]
_BODY = (
    ("SIDE", "CY"),
    ("X", "CX"),
    ("Y", "CY"),
    ("Z", "CZ"),
    ("ROLL", "Cl"),
    ("PITCH", "Cm"),
    ("YAW", "Cn"),
)
CHANNEL = {"DRAG": ("CX", "CZ"), "LIFT": ("CZ", "CX")} | {axis: (c,) for axis, c in _BODY}
"""Wind axes turn with incidence, so that a change of drag or lift shows in both."""
_ONE_LATE = "2"
"""JSBSim's count: its ring of n values returns the one of n - 1 frames before, so that 1 delays
nothing."""


HOME = Path(__file__).parent


@dataclass(frozen=True)
class Subject:
    """An aircraft, the speed of its manoeuvres [m/s], a term for every axis, and the elevator's
    position."""

    name: str
    V_mps: float
    terms: dict[str, str]
    elevator: str


def _subject(name: str, V_mps: float, prefix: str, unit: str, axes: str, terms: str) -> Subject:
    names = (f"{prefix}{term}" for term in terms.split())
    elevator = f"fcs/elevator-pos-{unit}"
    return Subject(name, V_mps, dict(zip(axes.split(), names, strict=True)), elevator)


_WIND, _COEFFICIENT = "DRAG SIDE LIFT ROLL PITCH YAW", "aero/coefficient/"
AIRCRAFT = (
    _subject("c172p", 50.0, _COEFFICIENT, "rad", _WIND, "CDo CYb CLq Clp Cmq Cnb"),
    _subject("c310", 65.0, _COEFFICIENT, "rad", _WIND, "CDbeta CYr CLadot Clbeta Cmadot Cnr"),
    _subject(
        "espaaro",
        22.0,
        "aero/",
        "deg",
        "X Y Z ROLL PITCH YAW",
        "CX_alpha2 CY_r CZ_de Cl_beta Cm_q Cn_da",
    ),
)


@dataclass(frozen=True)
class Fault:
    """A kind, the change in words, the channels that may come first, and the edit of the parsed
    file."""

    kind: str
    words: str
    first: tuple[str, ...]
    edit: Edit


def faults(root: Any, terms: dict[str, str], surface: str) -> Iterator[Fault]:
    """Yield every fault of an aircraft. terms: axis -> name of a function, or of a property, that
    carries a coefficient there.

    surface: ``<output>`` or actuator of the elevator's position.
    """
    kinds: tuple[tuple[str, float], ...] = (("sign", -1.0), ("scale", 1.05), ("missing term", 0.0))
    for number, (axis, term) in enumerate(terms.items()):
        kind, factor = kinds[number % 3]
        yield Fault(kind, f"{term} times {factor:g}", CHANNEL[axis], _times(term, factor))
    roll, pitch = (next(t for a, t in terms.items() if a == name) for name in ("ROLL", "PITCH"))
    if root.find(f".//axis/function[@name='{pitch}']") is not None:
        yield Fault("frame", f"{pitch} about the roll axis", ("Cl", "Cm"), _to_axis(pitch, "ROLL"))
        yield Fault("frame", f"{roll} about the yaw axis", ("Cn", "Cl"), _to_axis(roll, "YAW"))
    else:
        yield Fault(
            "frame", "pitching moment about the yaw axis", ("Cm", "Cn"), _swap_axes("PITCH", "YAW")
        )
    yield Fault("inertia product", "Ixz 2 % of Ixx more", ("Ixz",), _inertia("ixz", 0.02))
    yield Fault("inertia", "Iyy 3 % more", ("Iyy",), _inertia("iyy", 0.03))
    yield Fault("mass", "1 % more", ("mass",), _scaled("mass_balance/emptywt", 1.01))
    yield Fault("centre of gravity", "1 % of the chord aft", ("CG x",), _cg)
    yield Fault("reference length", "chord 2 % longer", ("Cm",), _scaled("metrics/chord", 1.02))
    yield Fault("one frame late", "elevator's position", ("elevator position",), _late(surface))


def _names_of(root: Any, name: str) -> Any:
    function = root.find(f".//function[@name='{name}']")
    if function is not None:
        return function
    return next(e for e in root.iter("property") if (e.text or "").strip() == name)


def _times(name: str, factor: float) -> Edit:
    def edit(root: Any) -> None:
        node = _names_of(root, name)
        if node.tag == "property":
            node.set("value", repr(float(node.get("value")) * factor))
            return
        product = node.find("product")
        assert product is not None, name
        etree.SubElement(product, "value").text = repr(factor)

    return edit


def _to_axis(name: str, axis: str) -> Edit:
    def edit(root: Any) -> None:
        root.find(f".//axis[@name='{axis}']").append(_names_of(root, name))

    return edit


def _swap_axes(one: str, two: str) -> Edit:
    def edit(root: Any) -> None:
        first, second = (root.find(f".//axis[@name='{name}']") for name in (one, two))
        first.set("name", two)
        second.set("name", one)

    return edit


def _inertia(tag: str, share: float) -> Edit:
    def edit(root: Any) -> None:
        balance = root.find("mass_balance")
        node = balance.find(tag)
        more = share * float(balance.find("ixx" if tag == "ixz" else tag).text)
        if node is None:
            node = etree.SubElement(balance, tag, dict(balance.find("ixx").attrib))
            node.text = "0"
            balance.remove(node)
            balance.insert(0, node)
        node.text = repr(float(node.text) + more)

    return edit


def _scaled(path: str, factor: float) -> Edit:
    def edit(root: Any) -> None:
        node = root.find(path)
        node.text = repr(factor * float(node.text))

    return edit


def _cg(root: Any) -> None:
    chord = root.find("metrics/chord")
    place = root.find("mass_balance/location[@name='CG']")
    inches = {"FT": 12.0, "M": 39.37007874, "IN": 1.0}
    moved = (
        0.01 * float(chord.text) * inches[chord.get("unit", "FT")] / inches[place.get("unit", "IN")]
    )
    place.find("x").text = repr(float(place.find("x").text) + moved)


def _late(surface: str) -> Edit:
    """Delay the component that sets the surface's position by a frame."""

    def edit(root: Any) -> None:
        actuator = root.find(f".//actuator[@name='{surface}']")
        if actuator is not None:
            etree.SubElement(actuator, "delay", {"type": "frames"}).text = _ONE_LATE
            return
        output = next(e for e in root.iter("output") if (e.text or "").strip() == surface)
        component = output.getparent()
        output.text = "late/elevator-before"
        late = etree.Element("actuator", name="late/elevator")
        etree.SubElement(late, "input").text = "late/elevator-before"
        etree.SubElement(late, "delay", {"type": "frames"}).text = _ONE_LATE
        etree.SubElement(late, "output").text = surface
        component.addnext(late)

    return edit


def benign(root: Any, seed: int) -> str:
    """Rewrite an aircraft so that only the last digits of its results change, and return the kinds
    of edits."""
    rng = random.Random(seed)
    kinds = rng.sample(tuple(_REWRITE), 3)
    for kind in kinds:
        _REWRITE[kind](root, rng)
    return ", ".join(sorted(kinds))


def _comments(root: Any, rng: random.Random) -> None:
    for node in rng.sample(list(root.iter("value", "property", "function")), 12):
        node.addprevious(etree.Comment(f" note {rng.randint(0, 999)} "))


def _spaces(root: Any, rng: random.Random) -> None:
    for node in root.iter("value", "input", "output", "gain"):
        if node.text and rng.random() < 0.5:
            node.text = f"\n   {node.text.strip()}  "


def _numbers(root: Any, rng: random.Random) -> None:
    for node in root.iter("value"):
        if node.text and rng.random() < 0.5:
            node.text = f"{float(node.text):.17e}"


def _order(tag: str) -> Callable[[Any, random.Random], None]:
    def edit(root: Any, rng: random.Random) -> None:
        for node in root.iter(tag):
            children = [c for c in node if isinstance(c.tag, str)]
            if len(children) > 1 and rng.random() < 0.5:
                rng.shuffle(children)
                for child in children:
                    node.append(child)

    return edit


def _names(root: Any, rng: random.Random) -> None:
    """Rename functions of an axis that nothing else reads."""
    text = etree.tostring(root, encoding="unicode")
    for node in root.iter("function"):
        name = node.get("name", "")
        unread = name and f">{name}<" not in text
        if node.getparent().tag == "axis" and unread and rng.random() < 0.5:
            node.set("name", f"{name}-renamed")


_REWRITE: dict[str, Callable[[Any, random.Random], None]] = {
    "comments": _comments,
    "spaces": _spaces,
    "numbers": _numbers,
    "order of products": _order("product"),
    "order of sums": _order("sum"),
    "names of functions": _names,
}


def main(words: Sequence[str] | None = None) -> int:
    """Fly everything and write faults.csv and benign.csv; exit code 1 where a fault is missed or a
    benign pair is reported."""
    parser = study_parser(__doc__, out=HOME)
    parser.add_argument("--benign", type=int, default=100, metavar="N", help="benign pairs (100)")
    args = parser.parse_args(words)
    faulty = [row for subject in AIRCRAFT for row in _with_faults(subject)]
    pairs = [_rewritten(AIRCRAFT[k % len(AIRCRAFT)], k) for k in range(args.benign)]
    for name, rows in (("faults.csv", faulty), ("benign.csv", pairs)):
        write_csv(args.out / name, [{key: str(v) for key, v in row.items()} for row in rows])
    count, false = (sum(row["found"] for row in rows) for rows in (faulty, pairs))
    first = f"{sum(row['right_first'] for row in faulty)} with the right channel first"
    print(
        f"{count} of {len(faulty)} faults found, {first}; {false} of {len(pairs)} benign pairs "
        "reported"
    )
    return 0 if count == len(faulty) and not false else 1


def _with_faults(subject: Subject) -> list[dict[str, Any]]:
    root = etree.parse(str(find_aircraft(subject.name).xml)).getroot()
    rows = []
    for fault in faults(root, subject.terms, subject.elevator):
        changed = copy.deepcopy(root)
        fault.edit(changed)
        row = {"aircraft": subject.name, "kind": fault.kind, "fault": fault.words}
        row |= {"expected": " or ".join(fault.first)}
        rows.append(row | _difference(subject, changed, fault.first))
        print(*rows[-1].values(), sep=", ", flush=True)
    return rows


def _rewritten(subject: Subject, seed: int) -> dict[str, Any]:
    root = etree.parse(str(find_aircraft(subject.name).xml)).getroot()
    edits = benign(root, seed)
    row = {"aircraft": subject.name, "rewritten": edits, **_difference(subject, root, ())}
    row.pop("right_first")
    return row


def _difference(subject: Subject, changed: Any, first: Sequence[str]) -> dict[str, Any]:
    """Compare an aircraft with a copy of it that has another XML, by `diff`."""
    with scratch_folder("sown") as scratch:
        original = find_aircraft(subject.name)
        folder = scratch.path / "aircraft" / original.folder.name
        copy_folder(original.folder, folder)
        copy_shared_parts(original, scratch.path, engine.default_root())
        (folder / original.xml.name).write_bytes(etree.tostring(changed))
        other: Aircraft = find_aircraft(folder)
        terms = differing_terms(original.folder, folder)
        channels, flights = fly_matched(original, other, MatchedRequest((subject.V_mps,)))
        ranked = by_channel(differences(channels, flights, terms))
        refusal = next((f.reason for f in flights if f.reason), "")
    name = ranked[0].channel if ranked else ""
    return {
        "found": int(bool(ranked or refusal)),
        "first": name or refusal,
        "right_first": int(name in first),
        "channels": len(ranked),
        "terms": len(terms),
    }


if __name__ == "__main__":
    sys.exit(main())
