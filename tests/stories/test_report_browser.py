"""Report pages in a real browser: what a reader sees, can reach by keyboard and touch, and hears
read out.

Needs the package playwright (extra ``browser``) and a Chromium: playwright's own, one on the path,
or the one named by UQ_BROWSER."""

from __future__ import annotations

import json
import os
import shutil
from itertools import pairwise

import pyarrow.parquet as pq
import pytest

from tests.helpers import report_folders as folders
from uqharness.cli.main import main
from uqharness.report.write import write_report

pytestmark = pytest.mark.browser

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ASKED = {
    "modes": "modes espaaro --speed-mps 22.2 --speeds 20:25 --out {}",
    "margins": "margins espaaro --loop throttle --out {}",
    "fly": "fly espaaro --duration-s 40 --rate-hz 10 --noise --out {folder}/flight.bin --page {}",
    "log-info": "log info {fly}/flight.bin --aircraft espaaro --no-cache --out {}",
    "instrument": (
        "instrument espaaro --constant CX=0.01,Cm=0.02 --no-check --out {folder}/bounded --page {}"
    ),
    "diff": "diff espaaro espaaro_truth --speed-mps 22 --out {}",
    "dossier": "dossier {compare} --out {}",
}
"""Pages that a command of their own writes when asked, {} the page."""
KINDS = ("identify", "compare", "refine", "bounds", "validate-bounds", "campaign", "study", *ASKED)
VIEWS = [(1400, "light", False), (390, "dark", True), (390, "light", True)]

LAYOUT = """() => {
  const wrong = [], wide = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > wide) wrong.push(`page is ${document.documentElement.scrollWidth} wide in ${wide}`);
  for (const svg of document.querySelectorAll("svg.chart")) {
    const box = svg.getBoundingClientRect(), name = svg.getAttribute("aria-label") || "a swatch";
    const least = svg.getAttribute("aria-hidden") ? [20, 8] : [200, 80];
    if (box.width < least[0] || box.height < least[1] || box.left < 0 || box.right > wide + 1)
      wrong.push(`${name}: ${box.width} x ${box.height} at ${box.left}`);
    if (!svg.checkVisibility({ opacityProperty: true, visibilityProperty: true })) wrong.push(`${name}: hidden`);
    const texts = [...svg.querySelectorAll("text")], boxes = texts.map((text) => text.getBBox());
    texts.forEach((text, i) => {
      const b = boxes[i], area = svg.viewBox.baseVal;
      if (b.x < -0.5 || b.x + b.width > area.width + 0.5 || b.y + b.height > area.height + 0.5)
        wrong.push(`${name}: '${text.textContent}' leaves the drawing`);
      for (let j = 0; j < i; j += 1) {
        const c = boxes[j];
        const across = b.x < c.x + c.width - 1 && c.x < b.x + b.width - 1;
        const down = b.y < c.y + c.height - 3 && c.y < b.y + b.height - 3;
        if (b.width && c.width && across && down)
          wrong.push(`${name}: '${text.textContent}' lies over '${texts[j].textContent}'`);
      }
    });
  }
  return wrong;
}"""

CONTRAST = """() => {
  const parts = (c) => (c.match(/[\\d.]+/g) || []).map(Number);
  const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = (c) => { const [r, g, b] = c.map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = (e) => { for (let at = e; at; at = at.parentElement) { const c = parts(getComputedStyle(at).backgroundColor);
    if (c.length === 3 || c[3] > 0) return c.slice(0, 3); } return [255, 255, 255]; };
  const wrong = new Set();
  for (const e of document.querySelectorAll("body *")) {
    if (!e.checkVisibility() || e.matches("script, style")) continue;
    if (![...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())) continue;
    const style = getComputedStyle(e), colour = parts(e.matches("text") ? style.fill : style.color).slice(0, 3);
    const [high, low] = [light(colour), light(ground(e))].sort((a, b) => b - a), ratio = (high + 0.05) / (low + 0.05);
    if (ratio < 4.5) wrong.add(`${e.tagName}.${e.className.baseVal ?? e.className} ${colour} on ${ground(e)}: ${ratio.toFixed(2)}`);
  }
  return [...wrong];
}"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """One report of every kind, and the folders they stand in."""
    root = tmp_path_factory.mktemp("pages")
    campaigns = folders.campaigns(root)
    assert main(["sensitivity", str(campaigns / "before"), "--json"]) == 0
    result = {
        "identify": folders.identified(root / "identified"),
        "compare": folders.compared(root / "compared"),
        "refine": folders.refined(root / "refined"),
        "bounds": folders.bounded(root / "bounds"),
        "validate-bounds": folders.covered(root / "check"),
        "campaign": campaigns / "before",
    }
    for kind, folder in result.items():
        write_report(folder)
        shutil.copytree(folder, root / "study" / kind)
    shutil.copytree(campaigns / "after", root / "study" / "after")
    stages = [folders.stage(kind, kind, kind) for kind in result]
    stages.append(folders.stage("after", "campaign", "after"))
    pair = {"before": "campaign", "after": "after"}
    question = "Can the E-SPAARO hold 15 m of the circle in moderate turbulence?"
    document = folders.study(
        stages, before_after=pair, answer=folders.ANSWER, tracks=folders.TRACKS, question=question
    )
    result["study"] = folders.write_document(root / "study", "study.json", document)
    folders.tracks(result["study"])
    write_report(result["study"])
    for kind, line in ASKED.items():
        folder = root / kind
        folder.mkdir()
        result[kind] = folder
        words = [
            word.format(folder / "report.html", folder=folder, **result) for word in line.split()
        ]
        assert main(words) in (0, 1), kind
    return result


@pytest.fixture(scope="module")
def browser():
    """The first Chromium that starts; without one the tests are skipped, with what was tried."""
    # Here and not above: a module that is skipped whole leaves pytest -m browser without a test,
    # which it calls a failure.
    playwright = pytest.importorskip(
        "playwright.sync_api",
        reason="no browser test: playwright is not installed (pip install -e '.[browser]')",
    )
    trial = []
    with playwright.sync_playwright() as play:
        for path in dict.fromkeys((os.environ.get("UQ_BROWSER"), None, *map(shutil.which, _NAMES))):
            try:
                result = play.chromium.launch(
                    executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage"]
                )
            except playwright.Error as error:
                trial.append(f"{path or 'its own'}: {str(error).splitlines()[0]}")
                continue
            yield result
            result.close()
            return
    pytest.skip(f"no browser test: no Chromium starts ({'; '.join(trial)})")


@pytest.fixture
def opened(browser, pages):
    """Opens a page and collects everything that goes wrong while it is open."""
    contexts = []

    def visit(
        kind, width=1400, scheme="light", touch=False, script=True, *, height=900, unfold=True
    ):
        size = {"width": width, "height": height}
        context = browser.new_context(
            viewport=size, color_scheme=scheme, has_touch=touch, java_script_enabled=script
        )
        contexts.append(context)
        page = context.new_page()
        page.wrong = []
        page.on("console", lambda message: page.wrong.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: page.wrong.append(f"error: {error}"))
        page.on(
            "request",
            lambda request: (
                request.url.startswith("file:") or page.wrong.append(f"fetched {request.url}")
            ),
        )
        page.goto((pages[kind] / "report.html").as_uri())
        if script and unfold:
            page.evaluate(
                "document.querySelectorAll('details').forEach((part) => { part.open = true; })"
            )
        return page

    yield visit
    for context in contexts:
        context.close()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("width", "scheme", "touch"), VIEWS)
def test_everything_is_seen_and_nothing_overflows(opened, kind, width, scheme, touch):
    page = opened(kind, width, scheme, touch)
    # The dossier draws the objective tests that its flights contain; these contain none.
    assert (page.locator("figure svg").count() > 0) == (kind != "dossier")
    assert page.evaluate(LAYOUT) == []
    assert page.evaluate(CONTRAST) == []
    assert page.wrong == []


@pytest.mark.parametrize("kind", KINDS)
def test_the_accessibility_tree_has_a_name_for_everything(opened, kind):
    """What a screen reader gets, from the browser's own tree."""
    page = opened(kind)
    nodes = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    visible = [n for n in nodes if not n.get("ignored")]
    roles = [n["role"]["value"] for n in visible]
    for node in visible:
        if node["role"]["value"] in (
            "image",
            "img",
            "slider",
            "table",
            "region",
            "heading",
            "columnheader",
            "RootWebArea",
        ):
            assert node.get("name", {}).get("value", "").strip(), node["role"]
    levels = [
        p["value"]["value"]
        for n in visible
        if n["role"]["value"] == "heading"
        for p in n["properties"]
        if p["name"] == "level"
    ]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))
    figures = page.locator("figure").count()
    assert sum(role in ("image", "img") for role in roles) == figures
    assert "main" in roles


def test_the_cursor_reads_the_pbox_by_keyboard_mouse_and_touch(opened, pages):
    page = opened("campaign", 390, touch=True)
    figure = page.locator("#pbox-cross-track-median-m-3mps-moderate")
    slider, output = figure.locator("input"), figure.locator("output")
    slider.focus()
    before = output.inner_text()
    for _ in range(30):
        page.keyboard.press("ArrowRight")
    assert output.inner_text() != before
    assert slider.get_attribute("aria-valuetext").split() == output.inner_text().split()
    at = float(slider.input_value())
    table = pq.read_table(pages["campaign"] / "pbox.parquet").to_pandas()
    rows = table[(table["metric"] == "cross_track_median_m") & (table["value"] <= at)].iloc[-1]
    read = output.inner_text()
    assert [
        f"{100 * rows[k]:.0f} %" in read or f"{100 * rows[k]:.1f} %" in read
        for k in ("lower", "upper")
    ] == [True, True]
    corners = json.loads(figure.locator("script").text_content())["boxes"][0]["corners"]
    assert any(corner in read for corner in corners)
    assert figure.locator(".picked").count() >= 1
    svg = figure.locator("svg")
    svg.scroll_into_view_if_needed()
    box = svg.bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.4 * box["height"])
    by_mouse = output.inner_text()
    page.touchscreen.tap(box["x"] + 0.7 * box["width"], box["y"] + 0.4 * box["height"])
    assert len({read, by_mouse, output.inner_text()}) == 3
    assert page.wrong == []


FIRST = """() => [...document.querySelectorAll("h1, .verdict, .verdict + .figures figure")].map((part) => {
  const box = part.getBoundingClientRect();
  return { name: part.id || part.tagName.toLowerCase(), top: box.top, bottom: box.bottom };
})"""
"""Where the question, the answer and the first figures of a page stand [px]."""


def test_a_study_shows_question_answer_and_figures_on_the_first_screen(opened):
    page = opened("study", 1280, height=800, unfold=False)
    parts = page.evaluate(FIRST)
    assert [part["name"] for part in parts] == [
        "h1",
        "section",
        "ground-track",
        "track-distance",
        "answer-pbox",
    ]
    assert [part["name"] for part in parts if part["bottom"] > 800] == []
    # Side by side, each wide enough for its text.
    assert len({round(part["top"]) for part in parts[2:]}) == 1
    assert page.evaluate("document.documentElement.scrollHeight") <= 12_000
    for name in ("track-distance", "answer-pbox"):
        assert page.locator(f"#{name} svg").bounding_box()["height"] <= 350


@pytest.mark.parametrize("width", [1280, 420])
def test_the_reader_of_a_studys_p_box_tells_shares_and_no_empty_band(opened, width):
    page = opened("study", width, unfold=False)
    figure = page.locator("#answer-pbox")
    slider, output = figure.locator("input"), figure.locator("output")
    low, high = (float(slider.get_attribute(end)) for end in ("min", "max"))
    observed, tops = set(), set()
    for share in (0.2, 0.5, 0.8):
        slider.evaluate(
            "(slider, at) => { slider.value = at; slider.dispatchEvent(new Event('input')); }",
            low + share * (high - low),
        )
        message = output.inner_text()
        assert "after: " in message
        assert "before: " in message
        assert "0 % to 100 %." not in message
        observed.add(message)
        tops.add(figure.locator("figcaption").bounding_box()["y"])
    assert len(observed) == 3
    # The text has its room: the page does not move under the pointer.
    assert len(tops) == 1


@pytest.mark.parametrize("kind", ["campaign", "study"])
def test_without_scripts_the_page_says_the_same(opened, kind):
    page = opened(kind, 390, script=False)
    assert page.locator(".reader").count() == 0
    assert page.locator("figure svg").count() > 0
    assert page.locator("table").count() > 0


@pytest.mark.parametrize("kind", KINDS)
def test_on_paper_it_is_dark_on_white_and_fits(opened, kind):
    page = opened(kind, 718, "dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate(CONTRAST) == []
    assert page.locator(".reader").first.is_hidden() if page.locator(".reader").count() else True
    section = (
        "[...document.querySelectorAll('figure svg')].filter((s) => s.getBoundingClientRect().right"
        " > innerWidth + 1).length"
    )
    assert page.evaluate(section) == 0


def test_the_checks_say_no(opened):
    page = opened("campaign")
    page.evaluate("""() => {
      document.querySelector("h2").style.cssText = "color: #999; width: 3000px";
      document.querySelector("figure svg").style.width = "0";
      console.error("trouble");
    }""")
    assert any("page is 3" in text for text in page.evaluate(LAYOUT))
    assert any("P-box" in text for text in page.evaluate(LAYOUT))
    assert any("H2" in text for text in page.evaluate(CONTRAST))
    assert page.wrong == ["console: trouble"]
