"""What every report page must be, judged from its text alone."""

from __future__ import annotations

import re
from collections import Counter
from itertools import pairwise
from pathlib import Path

from lxml import etree, html

from uqharness.report.write import write_report

MAX_BYTES = 3_000_000
_REFERENCES = ("src", "href", "srcset", "data", "action", "poster", "background")


def problems(page: str) -> list[str]:
    """Everything that is wrong with a page; empty for a good one."""
    tree = html.document_fromstring(page)
    result = [
        *_form(page, tree),
        *_fetched(page, tree),
        *_figures(tree),
        *_tables(tree),
        *_text(tree),
    ]
    if len(page.encode()) > MAX_BYTES:
        result.append(f"{len(page.encode())} bytes")
    return result


def page_of(folder: Path) -> str:
    """The page that a folder of results is given, once it was judged to be sound."""
    text = write_report(folder).path.read_text(encoding="utf-8")
    assert problems(text) == []
    return text


def words_of(page: str) -> str:
    """All text of a page on one line."""
    return re.sub(r"\s+", " ", html.document_fromstring(page).text_content())


def _form(page: str, tree: html.HtmlElement) -> list[str]:
    result = []
    # Tags that were opened are closed: an XML parser agrees once the few void elements are made so,
    # and scripts are left out.
    strict = re.sub(r"<(meta[^>]*)>", r"<\1/>", page.replace("<!DOCTYPE html>", ""))
    strict = re.sub(r"(?s)(<script[^>]*>).*?(</script>)", r"\1\2", strict)
    try:
        etree.fromstring(strict.encode())
    except etree.XMLSyntaxError as error:
        result.append(f"not well formed: {error}")
    if tree.get("lang") != "en" or not tree.findtext(".//title"):
        result.append("no language or no title")
    double = [name for name, count in Counter(tree.xpath("//@id")).items() if count > 1]
    result += [f"id {name} is there twice" for name in double]
    levels = [int(e.tag[1]) for e in tree.iter("h1", "h2", "h3", "h4", "h5", "h6")]
    if levels[:1] != [1] or levels.count(1) != 1:
        result.append("not one h1 at the top")
    result += [f"h{a} is followed by h{b}" for a, b in pairwise(levels) if b > a + 1]
    result += [
        "an empty heading"
        for e in tree.iter("h1", "h2", "h3", "h4")
        if not e.text_content().strip()
    ]
    first = [e for e in tree.find(".//main") if isinstance(e.tag, str)][1]
    if first.get("class") != "verdict" or not first.findall(".//li"):
        result.append("the verdict does not come first")
    return result


def _fetched(page: str, tree: html.HtmlElement) -> list[str]:
    result = []
    for element in tree.iter(etree.Element):
        for name, value in element.attrib.items():
            if name.rpartition("}")[2].rpartition(":")[2] in _REFERENCES and not value.startswith(
                "#"
            ):
                result.append(f"{element.tag} fetches {value}")
            if re.search(r"https?://|url\((?!#)", value):
                result.append(f"{element.tag} names {value}")
    for element in tree.iter("link", "iframe", "img", "object", "embed", "base"):
        result.append(f"<{element.tag}>")
    for code in tree.iter("style", "script"):
        if re.search(r"https?://|@import|url\(|fetch\(|XMLHttp|import\(", code.text or ""):
            result.append(f"{code.tag} reaches out")
    return result


def _figures(tree: html.HtmlElement) -> list[str]:
    result = []
    for figure in tree.iter("figure"):
        svg, caption = figure.find("svg"), figure.find("figcaption")
        name = figure.get("id")
        if svg is None or svg.get("role") != "img" or not svg.get("aria-label"):
            result.append(f"figure {name} has no label")
            continue
        if caption is None or not caption.text_content().strip():
            result.append(f"figure {name} has no caption")
        axes = [e.text or "" for e in svg.iter("text") if e.get("class") == "label"]
        listed = [text for text in axes if text and not text.startswith("probability")]
        if not listed or not all(re.search(r"\[[^\]]+\]", text) for text in listed):
            result.append(f"figure {name} has an axis without a unit: {axes}")
        drawing = [e.get("d") for e in svg.iter("path")] + list(svg.iter("circle"))
        if not any(drawing):
            result.append(f"figure {name} is empty")
        if any("nan" in (d or "") or "inf" in (d or "") for d in svg.xpath(".//@d")):
            result.append(f"figure {name} draws what is not finite")
    for svg in tree.iter("svg"):
        if not svg.get("aria-label") and svg.get("aria-hidden") != "true":
            result.append("a drawing without a label")
    return result


def _tables(tree: html.HtmlElement) -> list[str]:
    result = []
    for table in tree.iter("table"):
        caption = table.findtext("caption")
        if not caption:
            result.append("a table without a caption")
        heads = table.findall("thead/tr/th")
        if not heads or any(e.get("scope") != "col" or not e.text_content().strip() for e in heads):
            result.append(f"table {caption}: a column without a head")
        for row in table.findall("tbody/tr"):
            if len(row) != len(heads) or row[0].tag != "th" or row[0].get("scope") != "row":
                result.append(f"table {caption}: a row that does not fit its head")
            for cell in row:
                if cell.get("class") and not cell.find(".//span[@class='sign']") is not None:
                    result.append(
                        f"table {caption}: '{cell.text_content()}' is told by colour alone"
                    )
    return result


def _text(tree: html.HtmlElement) -> list[str]:
    visible = [e for e in tree.find("body").iter(etree.Element) if e.tag != "script"]
    text = " ".join(part for e in visible for part in (e.text, e.tail) if part)
    return [
        f"'{word}' in the text"
        for word in re.findall(r"(?<![\w-])(?:nan|NaN|inf|Infinity)(?![\w-])|None(?!\.)", text)
    ]
