"""Checks JSBSim XML files against the grammar in schema/."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from lxml import etree

from tests.helpers.places import TESTS

GRAMMAR = TESTS / "schema" / "jsbsim.rng"
RNG = "http://relaxng.org/ns/structure/1.0"


@cache
def root_elements() -> frozenset[str]:
    """The elements a file may have at its root."""
    refs = etree.parse(str(GRAMMAR)).iterfind(f".//{{{RNG}}}start//{{{RNG}}}ref")
    return frozenset(str(ref.attrib["name"]) for ref in refs)


@cache
def _grammar(root: str) -> etree.RelaxNG:
    # libxml2 says nothing of what fails within a choice, so the one among root elements is made
    # here.
    start = f'<start><ref name="{root}"/></start>'
    text = f'<grammar xmlns="{RNG}"><include href="{GRAMMAR.name}">{start}</include></grammar>'
    return etree.RelaxNG(etree.fromstring(text, base_url=GRAMMAR.as_uri()))


def schema_errors(path: str | Path) -> list[str]:
    """What is wrong with a file, as "file:line: message"; empty when it fits the grammar."""
    # A comment within a number or a table would split its text in two for the validator.
    parser = etree.XMLParser(remove_comments=True, remove_pis=True)
    try:
        document = etree.parse(str(path), parser)
    except etree.XMLSyntaxError as err:
        return [f"{path}:{err.lineno or 0}: {err.msg}"]
    root = document.getroot()
    if root.tag not in root_elements():
        return [f"{path}:{root.sourceline}: no known root element: {root.tag}"]
    grammar = _grammar(root.tag)
    if grammar.validate(document):
        return []
    errors = dict.fromkeys(f"{path}:{entry.line}: {entry.message}" for entry in grammar.error_log)
    return list(errors) or [f"{path}:{root.sourceline}: {root.tag} does not fit the grammar"]
