"""Which elements of two models' XML differ: numbers by value, names, what was added or is gone; not
how it is written.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.differences import differing_terms
from uqharness.errors import BadInputError

XML = """<?xml version="1.0"?>
<fdm_config name="x" version="2.0" release="BETA">
  <fileheader><author>A</author></fileheader>
  <mass_balance>
    <ixx unit="SLUG*FT2"> 900 </ixx>
  </mass_balance>
  <aerodynamics>
    <property value="-0.5">aero/Cm_alpha</property>
    <axis name="PITCH">
      <function name="aero/coefficient/Cmq">
        <product><property>aero/qbar-psf</property><value>-12.4</value></product>
      </function>
    </axis>
  </aerodynamics>
</fdm_config>
"""


def build(folder: Path, text: str) -> Path:
    folder.mkdir()
    (folder / f"{folder.name}.xml").write_text(text)
    return folder


@pytest.fixture
def inputs(tmp_path):
    return build(tmp_path / "a", XML)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<value>-12.4</value>", "<value>  -1.24e1 </value>"),
        ("<mass_balance>", "<mass_balance><!-- a word -->"),
        ('version="2.0" release="BETA"', 'release="BETA" version="2.0"'),
        ("<author>A<", "<author>B<"),
    ],
)
def test_how_it_is_written_does_not_count(inputs, tmp_path, old, new):
    assert old in XML
    assert differing_terms(inputs, build(tmp_path / "b", XML.replace(old, new))) == []


@pytest.mark.parametrize(
    ("old", "new", "path", "output", "group", "channel"),
    [
        ("-12.4", "12.4", "value", ("-12.4", "12.4"), "force coefficients", "Cm"),
        (
            "> 900 <",
            "> 950 <",
            "ixx",
            ('900.0 unit="SLUG*FT2"', '950.0 unit="SLUG*FT2"'),
            "mass and CG",
            "",
        ),
        (
            'value="-0.5"',
            'value="-0.6"',
            "property aero/Cm_alpha",
            ('value="-0.5"', 'value="-0.6"'),
            "force coefficients",
            "",
        ),
    ],
)
def test_a_number_that_differs_is_told_with_its_lines(
    inputs, tmp_path, old, new, path, output, group, channel
):
    (term,) = differing_terms(inputs, build(tmp_path / "b", XML.replace(old, new)))
    assert term.path.endswith(path)
    assert (
        all(word in text for word, text in zip(output, (term.a, term.b), strict=True))
        or (term.a, term.b) == output
    )
    line = 1 + XML[: XML.index(old)].count("\n")
    assert (term.a_where, term.b_where) == (f"a.xml:{line}", f"b.xml:{line}")
    assert (term.group, term.channel) == (group, channel)


def test_what_is_added_or_gone_stands_alone(inputs, tmp_path):
    less = build(tmp_path / "b", XML.replace("<value>-12.4</value>", ""))
    (absent,) = differing_terms(inputs, less)
    assert (absent.a, absent.b, absent.b_where) == ("-12.4", "", "")
    (added,) = differing_terms(less, inputs)
    assert (added.a, added.b, added.a_where) == ("", "-12.4", "")


def test_a_function_that_is_added_is_one_line(inputs, tmp_path):
    more = (
        "<function"
        ' name="aero/Cmadot"><product><value>1</value><value>2</value></product></function>'
    )
    (added,) = differing_terms(
        inputs, build(tmp_path / "b", XML.replace("    </axis>", f"{more}</axis>"))
    )
    assert added.path.endswith("function aero/Cmadot")


def test_a_folder_without_xml_is_refused(inputs, tmp_path):
    (tmp_path / "b").mkdir()
    with pytest.raises(BadInputError, match="no XML"):
        differing_terms(inputs, tmp_path / "b")
