"""What a foreign XML may ask for: elements blanked byte by byte, names that lead out, entities."""

from __future__ import annotations

import random

import pytest

from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.staging import MAX_DEPTH, leads_out, screen_file, tag_end


def test_what_is_taken_out_leaves_every_other_byte_and_line() -> None:
    raw = (
        b'<a>\r\n<output name="x>y"/>\n<b><output>kept</output></b>\n<output>\n<c'
        b' file="/etc"/></output><input/><c/>\n</a>\n'
    )
    found = screen_file(raw, "a.xml")
    assert [(tag, line) for tag, line in found.removed] == [
        ("output", 2),
        ("output", 4),
        ("input", 5),
    ]
    assert len(found.content) == len(raw)
    assert found.content.count(b"\n") == raw.count(b"\n")
    assert b"<b><output>kept</output></b>" in found.content
    assert found.content.rstrip().endswith(b"<c/>\n</a>")
    assert found.references == ()
    assert screen_file(b"<a><b/></a>", "b.xml").content == b"<a><b/></a>"


def test_an_element_made_by_an_entity_is_refused() -> None:
    sly = b"<!DOCTYPE a [<!ENTITY o \"<output name='/tmp/x' type='CSV'/>\">]><a>&o;</a>"
    with pytest.raises(BadInputError, match="comes from an entity"):
        screen_file(sly, "a.xml")
    path = b'<!DOCTYPE a [<!ENTITY p "/etc/passwd">]><a><system file="&p;"/></a>'
    with pytest.raises(BadInputError, match="leads out"):
        screen_file(path, "a.xml")
    # Text from an entity is what stock systems have.
    assert screen_file(b'<!DOCTYPE a [<!ENTITY on "1">]><a><v>&on;</v></a>', "a.xml").removed == ()


def test_entities_do_not_multiply() -> None:
    lines = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    bomb = f'<!DOCTYPE a [<!ENTITY e0 "0123456789">{lines}]><a>&e11;</a>'.encode()
    with pytest.raises(BadInputError, match="not well-formed"):
        screen_file(bomb, "bomb.xml")


def test_every_stock_file_passes() -> None:
    stock = engine.default_root()
    roots = {screen_file(path.read_bytes(), path.name).root for path in stock.rglob("*.xml")}
    assert {
        "fdm_config",
        "system",
        "runscript",
        "turbine_engine",
        "propeller",
        "initialize",
    } <= roots


@pytest.mark.parametrize("name", ["engine", "a/b.xml", "Engines/prop", "..hidden", "a..b", ""])
def test_names_within_the_aircraft(name):
    assert not leads_out(name)


@pytest.mark.parametrize(
    "name",
    [
        "/etc/passwd",
        "~/x",
        "../x",
        "a/../../x",
        "a/..",
        "C:\\x",
        "C:x",
        "\\\\host\\share",
        "..\\x",
        "a\\..\\x",
        "a\0b",
    ],
)
def test_names_that_lead_out_on_some_system(name):
    assert leads_out(name)


def test_a_tag_ends_behind_its_own_bracket():
    raw = b"<a b='>' c=\"'>\">text</a>"
    assert raw[: tag_end(raw, 0)] == b"<a b='>' c=\"'>\">"
    assert tag_end(b"<a b='>", 0) == len(b"<a b='>")


def test_a_tags_end_byte_by_byte():
    rng = random.Random(1)
    ends = set()
    for _ in range(2000):
        raw = bytes(rng.choice(b"<a \"'>") for _ in range(rng.randrange(12)))
        start = rng.randrange(len(raw) + 1)
        quote, expected = 0, len(raw)
        for at in range(start, len(raw)):
            if quote:
                quote = 0 if raw[at] == quote else quote
            elif raw[at] in b"\"'":
                quote = raw[at]
            elif raw[at : at + 1] == b">":
                expected = at + 1
                break
        assert tag_end(raw, start) == expected
        ends.add(expected == len(raw))
    assert ends == {True, False}


def test_a_quote_that_never_ends_is_looked_through_once():
    raw = b"<a b='" + b'x"' * 200_000
    assert tag_end(raw, 0) == len(raw)


def test_references_are_named_as_jsbsim_opens_them():
    found = screen_file(
        b'<fdm_config>\n<system file="mine"/>\n<engine file=" b.xml "/></fdm_config>', "a.xml"
    )
    assert [(r.tag, r.name, r.line) for r in found.references] == [
        ("system", "mine.xml", 2),
        ("engine", "b.xml", 3),
    ]
    assert found.root == "fdm_config"
    with pytest.raises(BadInputError, match=r"a\.xml:1: .*longer than a file's name may be"):
        screen_file(b'<a><system file="' + b"x" * 300 + b'"/></a>', "a.xml")
    with pytest.raises(BadInputError, match="nested more than"):
        screen_file(b"<a>" * (MAX_DEPTH + 1) + b"</a>" * (MAX_DEPTH + 1), "a.xml")


def test_an_encoding_in_which_nothing_can_be_taken_out():
    with pytest.raises(BadInputError, match="UTF-16"):
        screen_file("<a><output/></a>".encode("utf-16"), "a.xml")
    assert screen_file("<a><b/></a>".encode("utf-16"), "a.xml").removed == ()
