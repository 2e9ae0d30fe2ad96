"""Damage to XML, and what an attacker would put in: outputs, inputs, entities, names that lead out
of the folder, depth.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import numpy as np
from lxml import etree

from tests.fuzz import damage_bytes, hostile
from tests.fuzz.damage_text import damaged_text

_OUT = hostile.OUTSIDE
_ELEMENTS = (
    (
        f'<output name="{_OUT}/o.csv" type="CSV" rate="10"><property caption="&#10;touch'
        ' X&#10;#">position/h-sl-ft</property></output>'
    ),
    '<output name="../../canary.csv" type="CSV" rate="10"><velocities>ON</velocities></output>',
    f'<output name="{_OUT}/t.csv" type="TABULAR" rate="1"/>',
    (
        '<output name="127.0.0.1" type="SOCKET" protocol="TCP" port="5155"'
        ' rate="1"><simulation>ON</simulation></output>'
    ),
    '<output name="127.0.0.1" type="SOCKET" protocol="UDP" port="5155" rate="1"/>',
    '<output name="127.0.0.1" type="FLIGHTGEAR" protocol="UDP" port="5156" rate="1"/>',
    '<output name="127.0.0.1" type="TERMINAL" port="5157" rate="1"/>',
    '<output file="../../canary"/>',
    '<input type="SOCKET" port="5158"/>',
    '<input type="QTJSBSIM" port="5159"/>',
    '<input port="5160"/>',
    '<system file="gusts"/>',
    '<system file="dart"/>',
    '<system file="../../dart"/>',
    '<system file="/etc/passwd"/>',
    '<autopilot file="/dev/zero"/>',
    '<aerodynamics file="../../../etc/passwd"/>',
    '<propulsion file="/dev/zero"/>',
    '<engine file="../Systems/gusts"/>',
    f'<thruster file="{_OUT}/prop"/>',
    (
        "<function"
        ' name="aero/loop"><sum><property>aero/loop</property><value>1</value></sum></function>'
    ),
    '<function name="../x"><value>nan</value></function>',
    '<property value="1">a b/c$d</property>',
    '<property value="1e999">gusts/more</property>',
    "<table><independentVar>aero/nothing</independentVar><tableData>0 1\n0 1</tableData></table>",
    '<axis name="X"><function name="q"><nosuch/></function></axis>',
    '<axis name="WARP"/>',
    (
        '<event name="e" continuous="true"><condition>1 gt 0</condition><set'
        ' name="fcs/elevator-cmd-norm" value="nan"/></event>'
    ),
    "<event><condition/><notify><property>position/h-agl-ft</property></notify></event>",
    (
        '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="file:///etc/passwd"'
        ' parse="text"/>'
    ),
    '<?xml-stylesheet href="http://127.0.0.1:5161/x.xsl"?>',
    '<tank type="FUEL"><location unit="IN"/><capacity unit="LBS">-1</capacity></tank>',
    (
        '<channel name="c" execrate="0"><pure_gain'
        ' name="g"><input>g</input><gain>g</gain></pure_gain></channel>'
    ),
    '<pid name="p"><input>p</input><kp>nan</kp></pid>',
    (
        '<sensor name="s"><input>s</input><quantization'
        ' name="q"><bits>99999999</bits><min>0</min><max>0</max></quantization></sensor>'
    ),
    '<sensor name="d"><input>x</input><delay type="frames">999999999</delay></sensor>',
)
_DOCTYPES = (
    '<!DOCTYPE a [<!ENTITY x "y">]>',
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE a [<!ENTITY % x SYSTEM "http://127.0.0.1:5162/x.dtd"> %x;]>',
    '<!DOCTYPE a SYSTEM "http://127.0.0.1:5163/x.dtd">',
    '<!DOCTYPE a [<!ENTITY a0 "ha">'
    + "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12))
    + "]>",
    '<!DOCTYPE a [<!ENTITY x "&x;">]>',
    '<!DOCTYPE a [<!ATTLIST property value CDATA "7">]>',
)
_ENTITIES = ("&x;", "&a12;", "&amp;", "&#0;", "&#x1b;", "&#xD800;", "&nosuch;")
_NUMBERS = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "0",
    "-1",
    "1e-320",
    "1,5",
    "0x1F",
    "one",
    "1 2 3",
    "--1",
    "1e18",
    "999999999999",
)


def xml_damage(data: bytes, rng: np.random.Generator, others: Sequence[bytes] = ()) -> bytes:
    """An XML document with injured content; ``others`` lend it elements.

    One in five is injured as text or bytes instead.
    """
    kind = rng.random()
    if kind < 0.12:
        return damaged_text(data, rng)
    if kind < 0.2:
        return damage_bytes.damaged(data, rng)
    if kind < 0.3:
        return _declared(data, rng)
    if kind < 0.33:
        return _deep(data, rng)
    root = etree.fromstring(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 2, 3, 5]))):
        nodes = [node for node in root.iter() if isinstance(node.tag, str)]
        node = nodes[int(rng.integers(0, len(nodes)))]
        _KINDS[int(rng.integers(0, len(_KINDS)))](node, nodes, rng, others)
    return etree.tostring(
        root,
        xml_declaration=True,
        encoding=str(rng.choice(["UTF-8"] * 8 + ["UTF-16", "ISO-8859-1"])),
    )


def _xml_text(text: str) -> str:
    """What of a text XML may hold at all."""
    return "".join(
        c
        for c in text
        if c in "\t\n\r" or (c >= " " and not "\ud800" <= c <= "\udfff" and c not in "\ufffe\uffff")
    )


def _delete(node, nodes, rng, others) -> None:
    if node.getparent() is not None:
        node.getparent().remove(node)


def _double(node, nodes, rng, others) -> None:
    if node.getparent() is not None:
        for _ in range(int(rng.choice([1, 1, 30]))):
            node.addnext(copy.deepcopy(node))


def _rename(node, nodes, rng, others) -> None:
    node.tag = str(
        rng.choice(
            [
                "x",
                "nosuch",
                "function",
                "property",
                "output",
                "input",
                "system",
                "value",
                "table",
                "a-b.c",
            ]
        )
    )


def _move(node, nodes, rng, others) -> None:
    other = nodes[int(rng.integers(0, len(nodes)))]
    other.append(copy.deepcopy(node))


def _attribute(node, nodes, rng, others) -> None:
    names = list(node.attrib) or ["name"]
    name = (
        names[int(rng.integers(0, len(names)))]
        if rng.random() < 0.8
        else str(rng.choice(["file", "name", "unit", "type", "value"]))
    )
    node.set(
        name, _xml_text(hostile.string(rng)) if rng.random() < 0.6 else str(rng.choice(_NUMBERS))
    )


def _lose_attribute(node, nodes, rng, others) -> None:
    if node.attrib:
        names = list(node.attrib)
        del node.attrib[names[int(rng.integers(0, len(names)))]]


def _text(node, nodes, rng, others) -> None:
    node.text = _xml_text(hostile.string(rng)) if rng.random() < 0.4 else str(rng.choice(_NUMBERS))


def _number(node, nodes, rng, others) -> None:
    """Something absurd where a number stands."""
    found = [
        n for n in nodes if n.text and n.text.strip().replace(".", "").replace("-", "").isdigit()
    ]
    if found:
        found[int(rng.integers(0, len(found)))].text = str(rng.choice(_NUMBERS))


def _plant(node, nodes, rng, others) -> None:
    """An element that an attacker would add, at the top or anywhere."""
    where = nodes[0] if rng.random() < 0.5 else node
    text = _ELEMENTS[int(rng.integers(0, len(_ELEMENTS)))]
    where.insert(int(rng.integers(0, len(where) + 1)), etree.fromstring(f"<r>{text}</r>")[0])


def _lend(node, nodes, rng, others) -> None:
    """An element of another file."""
    if others:
        donor = [
            n
            for n in etree.fromstring(others[int(rng.integers(0, len(others)))]).iter()
            if isinstance(n.tag, str)
        ]
        node.append(copy.deepcopy(donor[int(rng.integers(0, len(donor)))]))


_KINDS: tuple[Callable[..., None], ...] = (
    _delete,
    _delete,
    _double,
    _rename,
    _move,
    _attribute,
    _attribute,
    _lose_attribute,
    _text,
    _number,
    _number,
    _plant,
    _plant,
    _lend,
)


def _declared(data: bytes, rng: np.random.Generator) -> bytes:
    """A document type with entities, and a use of one."""
    head, _, rest = data.partition(b"?>")
    doctype = _DOCTYPES[int(rng.integers(0, len(_DOCTYPES)))].encode()
    entity = str(rng.choice(_ENTITIES)).encode()
    places = [k for k in range(len(rest)) if rest[k : k + 2] == b"</"]
    a = places[int(rng.integers(0, len(places)))] if places else 0
    return head + b"?>" + doctype + rest[:a] + entity + rest[a:]


def _deep(data: bytes, rng: np.random.Generator) -> bytes:
    """Elements within elements, or very many, or a very long one."""
    a = data.rfind(b"</")
    kind = int(rng.integers(0, 4))
    depth = int(rng.choice([60, 300, 3000, 30_000]))
    tag = str(rng.choice(["a", "sum", "function", "system"])).encode()
    if kind == 0:
        more = b"<%s>" % tag * depth + b"</%s>" % tag * depth
    elif kind == 1:
        more = (
            b'<function name="deep">'
            + b"<sum>" * depth
            + b"<value>1</value>"
            + b"</sum>" * depth
            + b"</function>"
        )
    elif kind == 2:
        more = b'<property value="1">a/b</property>' * depth
    else:
        more = b'<property value="' + b"9" * depth + b'">' + b"x" * depth + b"</property>"
    return data[:a] + more + data[a:]
