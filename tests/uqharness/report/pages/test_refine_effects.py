"""An effect on the page of a refinement: error bar, and the lines of the XML that are its own."""

from __future__ import annotations

from tests.helpers.report_folders import refinement
from uqharness.report.pages.refinement import effect_section, lines_naming
from uqharness.report.parts import Code, Figures
from uqharness.results.refinement import Refinement

DIFF = """--- a/plane.xml
+++ b/plane.xml
@@ -1,9 +1,10 @@
 one
 two
 three
-  <property value="1">aero/Cm_q</property>
+  <property value="2">aero/Cm_q</property>
 four
+  <property value="3">aero/Cm_p2</property>
 five
 six
 seven aero/Cm_p2 as it was
"""


def test_lines_that_name_an_effect_with_what_stands_around_them():
    text = lines_naming(DIFF, ["aero/Cm_p2"], 1)
    assert text.splitlines() == [" four", '+  <property value="3">aero/Cm_p2</property>', " five"]
    assert lines_naming(DIFF, ["aero/Cn_de"]) == ""


def test_an_effect_has_its_error_bar_and_its_change():
    part = effect_section(Refinement.model_validate(refinement()), DIFF).parts[0]
    assert any(
        isinstance(b, Code) and "aero/Cm_p2" in b.text and " six" in b.text for b in part.blocks
    )
    (bar,) = [b for b in part.blocks if isinstance(b, Figures)]
    assert "2.961 to 3.032" in bar.items[0].svg
    assert "without the effect" in bar.items[0].svg
    unknown = refinement()
    unknown["effects"][0]["evidence"] = {}
    part = effect_section(Refinement.model_validate(unknown)).parts[0]
    assert not any(isinstance(b, Figures) for b in part.blocks)
