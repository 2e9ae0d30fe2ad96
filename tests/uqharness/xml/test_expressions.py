"""Expressions as JSBSim's XML."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from uqharness.xml.aerodynamics import (
    Expression,
    call,
    function_lines,
    horner,
    property_value,
    value,
)


def test_an_operation_stands_on_one_line_with_its_arguments():
    sum_of = call("sum", property_value("aero/alpha-rad"), value(0.1), value(2, "g"))
    assert (
        sum_of.line()
        == "<sum> <property>aero/alpha-rad</property> <value>0.1</value> <value>2</value> </sum>"
    )
    assert sum_of.lines() == [sum_of.line()]


def test_a_long_one_has_its_arguments_on_lines_of_their_own():
    long = call("product", *(property_value(f"aero/property-{k}") for k in range(6)))
    assert long.lines() == [
        "<product>",
        *(f"  <property>aero/property-{k}</property>" for k in range(6)),
        "</product>",
    ]


@pytest.mark.parametrize(
    ("number", "form", "text"),
    [(1 / 3, "", "0.3333333333333333"), (1 / 3, ".4g", "0.3333"), (-2, "g", "-2")],
)
def test_the_digits_of_a_number(number, form, text):
    assert value(number, form).text == text


@pytest.mark.parametrize("tag", ["sum", "product", "min", "max"])
def test_an_operation_on_one_argument_is_the_argument(tag):
    assert call(tag, property_value("a")) == property_value("a")
    assert (
        Expression(tag, "", (property_value("a"),)).line()
        == f"<{tag}> <property>a</property> </{tag}>"
    )
    assert call("sqrt", property_value("a")) != property_value("a")


def test_a_name_with_signs_of_xml_is_read_back_as_it_was():
    assert ElementTree.fromstring(property_value("aero/a<b&c").line()).text == "aero/a<b&c"


def test_a_polynomial_without_terms_is_zero():
    assert horner({(1, 0): 0.0}, ("x", "y")) == value(0.0)
    assert (
        horner({(1, 1): 2.0, (0, 0): 1.0}, ("x", "y")).line()
        == "<sum> <product> <property>x</property> <property>y</property> <value>2.0</value>"
        " </product> <value>1.0</value> </sum>"
    )


def test_a_function_of_one_operation():
    lines = function_lines(
        "uq/a",
        "product",
        [property_value("a").line(), value(2, "g").line()],
        at_cg=True,
        remark="of -- two",
    )
    assert lines == [
        '<function name="uq/a" apply_at_cg="true">',
        "  <!-- of - - two -->",
        "  <product>",
        "    <property>a</property>",
        "    <value>2</value>",
        "  </product>",
        "</function>",
    ]
    assert function_lines("a", "sum", [])[0] == '<function name="a">'


def test_blanks_between_tags_are_left_out_where_that_is_asked_for():
    assert (
        Expression("cos", "", (property_value("a"),), tight=True).line()
        == "<cos><property>a</property></cos>"
    )
