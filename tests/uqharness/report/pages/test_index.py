"""`uqharness report`: every kind of folder has a page, the page is sound, and it says what the folder's files say."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil

import numpy as np
import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.model_forms import made_up_form
from tests.helpers.page_checks import problems
from tests.helpers.report_folders import refinement, stage, study, written
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.report.pages.index import KINDS, write_report
from uqharness.report.pbox import DrawnBox, pbox_figure
from uqharness.report.svg import Chart, Scale, scale, style, thinned
from uqharness.statistics.pbox import Sample, pbox


@pytest.fixture
def identified(tmp_path):
    return folders.identified(tmp_path / "identified")


@pytest.fixture
def compared(tmp_path):
    return folders.compared(tmp_path / "compared")


@pytest.fixture
def refined(tmp_path):
    return folders.refined(tmp_path / "refined")


@pytest.fixture
def bounded(tmp_path):
    return folders.bounded(tmp_path / "bounds")


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    return folders.campaigns(tmp_path_factory.mktemp("campaigns"))


def page_of(folder):
    text = write_report(folder).read_text(encoding="utf-8")
    assert problems(text) == []
    return text


def words_of(page):
    return re.sub(r"\s+", " ", html.document_fromstring(page).text_content())


def test_an_identification(identified):
    page = page_of(identified)
    words = words_of(page)
    assert "2 of 3 parameters are identified; not identified: aero/Cn_p." in words
    assert "rms over noise is q 2.50" in words
    assert "&lt;no&gt; roll" in page
    assert "a&lt;b&gt;.parquet" in page
    # An unknown noise, a share without a value and a parameter that is not identified say so.
    assert "undefined" in words
    assert "not identified" in words
    row = [e.text_content().strip() for e in html.document_fromstring(page).xpath("//tr[th[contains(., 'V [m/s]')]]/td")]
    assert row == ["0.5", "undefined", "undefined", "undefined"]
    # 0.01 rad/s is 0.573 deg/s.
    assert "0.573" in words


def test_a_channel_without_a_value_draws_nothing_and_says_so(identified):
    tree = html.document_fromstring(page_of(identified))
    figure = tree.get_element_by_id("fit-history-0-V_mps")
    assert "The log has no value of it here." in figure.find("svg").get("aria-label")
    assert not figure.xpath(".//path[contains(@class, 'dots')]")


def test_a_comparison_ranks_by_judged_channels_only(compared):
    words = words_of(page_of(compared))
    assert "The model does not reach the noise floor: q_radps 5.00." in words
    assert "not judged" in words
    assert "Farthest in q" in words
    assert "Farthest in psi" not in words


def test_a_refinement(refined):
    page = page_of(refined)
    words = words_of(page)
    assert "Pitching moment due to roll rate squared: 2.9963 ± 0.018." in words
    assert "The flights do not tell it from: aileron squared." in words
    assert "Would separate them: a roll at rest." in words
    assert "goes from 0.407 to 0.195 deg/s (rms), beside noise of 0.201 deg/s" in words
    assert "+ <property>aero/Cm_p2</property>" in words
    assert "p 28.6 to 115 deg/s" in words
    assert "aero/Cm_p2 = 0 restores the model without it" in words
    assert "Withdrawn: Yawing moment due to elevator: 2.9963 ± 0.018; on the test flights the gap grew" in words
    assert "97.0 ± 1.0" in words
    assert "96.0 ± undefined" in words
    assert "Not shown: no loiter here." in words


@pytest.mark.parametrize(
    ("verdict", "level", "text"),
    [
        ("effects-found", "good", "Effects were found"), ("no-missing-effect", "good", "Nothing is missing"),
        ("unexplained", "bad", "Something is missing that no effect of the catalogue explains"),
    ],
)  # fmt: skip
def test_verdicts_of_a_refinement(tmp_path, verdict, level, text):
    left = {"unexplained": verdict == "unexplained", "where": [], "channels_above_noise": {}, "coloured_channels": []}
    changes = {"verdict": verdict, "effects": [], "withdrawn": [], "disagreement": [], "remaining": left}
    page = page_of(written(tmp_path / "refined", "refinement.json", refinement(**changes)))
    first = html.document_fromstring(page).find(".//section[@class='verdict']//li")
    assert first.get("class") == level
    assert text in first.text_content()


def test_bounds_from_the_form_alone(bounded):
    form = made_up_form()
    page = page_of(bounded)
    tree = html.document_fromstring(page)
    slices = {e.get("id") for e in tree.iter("figure")}
    assert slices == {f"slice-{c}-{s}" for c, b in form.coefficients.items() for s in b.states}
    assert form.aircraft.sha256 in page


def test_a_validation(tmp_path):
    page = page_of(folders.covered(tmp_path / "check"))
    words = words_of(page)
    assert "The bounds do not hold: inside the 95 % bounds are only Cm 40.0 %; at least 85 % is asked for." in words
    assert "97.0 ± 1.0" in words
    assert "40.0 ± undefined" in words
    # 0.8 bounds two pieces of a sine and a cosine: what lies outside is counted by hand.
    share = np.mean(np.abs(np.concatenate(folders.wave())) <= 0.8)
    assert f"{100 * share:.1f} % of the samples inside" in words
    assert "dots dotout" in page


def test_sensitivity_joins_the_page_once_it_was_computed(tmp_path, campaigns):
    folder = tmp_path / "copy"
    shutil.copytree(campaigns / "before", folder)
    assert "Which uncertainty makes the width" not in page_of(folder)
    assert main(["sensitivity", str(folder), "--json"]) == 0
    tree = html.document_fromstring(page_of(folder))
    table = csv.DictReader((folder / "sensitivity.csv").read_text().splitlines())
    rows = [row for row in table if row["metric"] == "cross_track_median_m"]
    assert len(rows) == 6
    for row in rows:
        ends = f"{float(row['share_min']):.2g} to {float(row['share_max']):.2g}"
        cells = tree.xpath("//tr[th='median cross-track error'][td[1]=$name]/td[2]", name=row["coefficient"])
        assert [cell.text for cell in cells] == [ends]
    assert tree.get_element_by_id("sensitivity-cross-track-median-m") is not None


def test_a_study_with_two_campaigns_over_each_other(tmp_path, campaigns, refined):
    for place in (campaigns / "before", campaigns / "after", refined):
        shutil.copytree(place, tmp_path / "study" / place.name)
    stages = [stage(name, "campaign", name) for name in ("before", "after")]
    stages.append(stage("refine", "refine", refined.name, exit=1))
    stages.append(stage("bounds", "bounds", "gone"))
    stages.append(stage("later", "sensitivity", "later", state="waiting"))
    both = {"before": "before", "after": "after"}
    folder = written(tmp_path / "study", "study.json", study(stages, before_after=both))
    page = page_of(folder)
    words = words_of(page)
    assert words.index("It holds.") < words.index("Is it good enough?") < words.index("Two p-boxes over each other")
    tree = html.document_fromstring(page)
    overlays = [e for e in tree.iter("figure") if e.get("id").startswith("before-after-")]
    assert len(overlays) == 6
    for figure in overlays:
        assert len(json.loads(figure.findtext("script"))["boxes"]) == 2
    assert "Not the same flights otherwise: flights differ" in words
    assert "ran, the answer is no" in words
    assert "Pitching moment due to roll rate squared" in words
    # A stage whose folder cannot be read is named, not left out in silence.
    assert "What could not be read" in words
    assert "model-form.json" in words
    assert "cd" * 32 in words


@pytest.mark.parametrize(
    ("state", "stage_state", "said"),
    [("running", "running", "is not finished: 0 of 1"), ("failed", "failed", "fly failed")],
)
def test_a_study_that_is_not_done_says_so_first(tmp_path, state, stage_state, said):
    folder = written(tmp_path, "study.json", study([stage("fly", "fly", "fly", state=stage_state, error="no wind")], state=state))
    first = html.document_fromstring(page_of(folder)).find(".//section[@class='verdict']//li")
    assert said in first.text_content()
    assert first.get("class") in ("warn", "bad")


def test_the_command(identified, capsys):
    assert main(["report", str(identified), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "identify"
    assert found["report"] == str(identified / "report.html")
    first = (identified / "report.html").read_bytes()
    assert main(["report", str(identified)]) == 0
    assert (identified / "report.html").read_bytes() == first
    assert "report.html: written" in capsys.readouterr().out


def test_a_folder_of_nothing_is_refused_with_what_was_looked_for(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert all(name in said for name, _ in KINDS)
    assert main(["report", str(tmp_path / "gone")]) == 2
    assert "is no folder" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "[]", '{"effects": []}', "{"])
def test_a_spoilt_document_is_refused_by_name(tmp_path, text):
    (tmp_path / "refinement.json").write_text(text)
    with pytest.raises(BadInputError, match=r"refinement\.json.*run its command again"):
        write_report(tmp_path)


def test_the_checks_say_no(identified):
    page = write_report(identified).read_text(encoding="utf-8")
    for old, new, said in (
        ("<figcaption>", "<figcaption><img src='http://example.org/a.png'/>", "fetches"), ('role="img" ', "", "no label"),
        ("<caption>", "<caption/><b>", "not well formed"), ("[deg/s]", "", "without a unit"), ('scope="col"', "", "without a head"),
        ("undefined", "nan", "'nan' in the text"), ("<h3>", "<h4>", "not well formed"),
        ('<span class="sign"', "<span", "colour alone"),
        ('id="parameters"', 'id="fit-history-0-V_mps"', "twice"),
    ):  # fmt: skip
        assert old in page
        assert any(said in text for text in problems(page.replace(old, new))), said


# Colours.


def luminance(colour):
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a, b):
    """WCAG 2.2, relative luminance and contrast ratio."""
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_contrast_as_published():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("scheme", [0, 1])
def test_text_and_lines_stand_out_in_both_schemes(scheme):
    blocks = re.findall(r":root, svg\.chart \{(.*?)\}", style(), re.S)
    assert len(blocks) == 2
    colours = dict(re.findall(r"--([\w-]+): (#\w{6})", blocks[scheme]))
    for text in ("ink", "soft", "good", "warn", "bad"):
        for ground in ("paper", "box"):
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)
    for level in ("good", "warn", "bad"):
        for text in (level, "ink"):
            assert contrast(colours[text], colours[f"{level}-paper"]) >= 4.5, (text, level)
    for line in ("first", "second", "third"):
        assert contrast(colours[line], colours["paper"]) >= 3.0, line


def test_lines_are_told_apart_without_colour():
    """Solid, dashed, dotted: no two of the series' classes have the same dash."""
    rules = re.findall(r"\.chart \.line\.(first|second|third) \{(.*?)\}", style())
    dashes = [re.findall(r"stroke-dasharray: ([\d .]+)", rule) for _, rule in rules]
    assert len(rules) == 3
    assert len({str(d) for d in dashes}) == 3


# Drawing.


def test_many_samples_make_no_large_page():
    draw = np.random.default_rng(1)
    samples = [Sample(f"s{k}", draw.gamma(4.0, size=200) * (1.0 + k / 2000.0)) for k in range(2000)]
    box = pbox(samples)
    words = {sample.epistemic_id: f"level of {sample.epistemic_id}" for sample in samples}
    figure = pbox_figure("many", "error", "m", [DrawnBox("", box, samples, words)], "caption")
    assert len(figure.svg) + len(json.dumps(figure.cursor)) < 150_000
    assert "96 of 2000 samples" in figure.svg
    (cursor,) = figure.cursor["boxes"]
    assert [cursor["corners"][k] for k in cursor["at_least"]] == [words[str(name)] for name in box.corner_lower]
    assert f'data-corner="0.{cursor["at_least"][0]}"' in figure.svg


def test_a_chart_of_one_moment_is_still_drawn():
    chart = Chart("a", "label", Scale("time [s]", 3.0, 3.0), Scale("y [m]", 0.0, 0.0))
    chart.line(np.array([3.0]), np.array([0.0]), "first")
    assert "nan" not in chart.svg()


def test_a_point_lands_where_its_axes_put_it():
    chart = Chart("a", "label", Scale("x [m]", 0.0, 10.0), Scale("y [m]", -1.0, 1.0))
    left, top, width, height = chart.plot
    u, v = chart.at(5.0, 0.5)
    assert (float(u), float(v)) == pytest.approx((left + width / 2, top + height / 4))


def test_a_gap_in_the_data_is_a_gap_in_the_line():
    chart = Chart("a", "label", Scale("x [m]", 0.0, 4.0), Scale("y [m]", 0.0, 1.0))
    chart.line(np.arange(5.0), np.array([0.1, 0.2, math.nan, 0.3, 0.4]), "first")
    assert chart.marks[0].count("M") == 2
    chart.line(np.arange(2.0), np.array([math.nan, math.inf]), "first")
    assert len(chart.marks) == 1


def test_thinning_keeps_the_peaks():
    x = np.linspace(0.0, 1.0, 20001)
    y = np.zeros(x.size)
    y[12345], y[777] = 5.0, -3.0
    few, values = thinned(x, y)
    assert few.size <= 402
    assert (values.max(), values.min()) == (5.0, -3.0)
    assert few[values.argmax()] == x[12345]


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3e-5, 2e-5), (1000.0, 1003.0), (-0.5, 7.3), (1e-12, 3e-12), (2e6, 9e6)])
def test_ticks_are_round_inside_and_distinct(low, high):
    ticks = Scale("x [m]", low, high).ticks()
    assert 3 <= len(ticks) <= 8
    assert all(low - 1e-9 * (high - low) <= v <= high + 1e-9 * (high - low) for v, _ in ticks)
    assert len({text for _, text in ticks}) == len(ticks)
    for value, text in ticks:
        assert float(text.replace("−", "-")) == pytest.approx(value, abs=0.01 * (high - low))


def test_a_scale_of_nothing_known_is_still_a_scale():
    assert scale("x [m]", [np.array([math.nan])]).ticks()
    one = scale("x [m]", [np.array([3.0])])
    assert one.low < 3.0 < one.high
